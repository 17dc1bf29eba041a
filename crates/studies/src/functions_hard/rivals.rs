//! The searches that are compared, and a run of one.

use super::bipop::bipop;
use super::task::Task;
use super::watch::{Reached, Watch};
use crate::functions::methods::{CASES, clustered};
use lampyris_core::optimise::cfa_options::{CfaOptions, OnCostsOptions};
use lampyris_core::optimise::lshade::LshadeOptions;
use lampyris_core::optimise::thesis_options::CfaThesisOptions;
use lampyris_core::optimise::{Ask, Cost, Crowd, Evaluation, Method, Search};

pub const DEFAULT: &str = "cfa";
pub const SWARMS: &str = "cfa, no clouds";
pub const LSHADE: &str = "L-SHADE";
pub const BIPOP: &str = "BIPOP-CMA";
pub const THESIS: &str = "cFA of the thesis";

/// A search with its settings.
pub struct Rival {
    pub name: &'static str,
    /// None is BIPOP-CMA-ES, which no service offers.
    method: Option<Method>,
}

/// All of them.
pub fn rivals() -> [Rival; 5] {
    let swarms = OnCostsOptions { cloud: 0.0, ..OnCostsOptions::default() };
    let swarms = CfaOptions { on_costs: swarms, ..CfaOptions::default() };
    // Table 5.3, in the reading that gives the thesis's results.
    let thesis = CfaThesisOptions { crowd: Crowd::Step, ..clustered(&CASES[4]) };
    let rival = |name, method| Rival { name, method };
    [
        rival(DEFAULT, Some(Method::Cfa(CfaOptions::default()))),
        rival(SWARMS, Some(Method::Cfa(swarms))),
        rival(LSHADE, Some(Method::Lshade(LshadeOptions::default()))),
        rival(BIPOP, None),
        rival(THESIS, Some(Method::CfaThesis(thesis))),
    ]
}

/// One run on the instance that has the seed's number, within so many evaluations per dimension.
pub fn one(task: &Task, rival: &Rival, budget: usize, seed: u64) -> Reached {
    let (dimensions, budget) = (task.dimensions, budget * task.dimensions);
    let landscape = task.instance(seed);
    let mut watch = Watch::new(&landscape, budget);
    match &rival.method {
        None => bipop(dimensions, seed, &mut watch),
        Some(method) => {
            let search = Search { dimensions, seed, budget, warm: Vec::new(), residuals: false };
            let mut optimiser = method.optimiser(search);
            while let Ask::Costs(batch) = optimiser.ask() {
                let answers: Vec<Evaluation> = batch
                    .iter()
                    .map(|candidate| Evaluation {
                        cost: Cost::new(watch.error(&candidate.0)),
                        residuals: Vec::new(),
                        slope: None,
                    })
                    .collect();
                if watch.over() {
                    break;
                }
                optimiser.tell(&answers);
            }
        }
    }
    watch.reached()
}
