//! The searches that can be asked for by name, and what each needs to know of the task.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::agreement::AgreementOptions;
use super::budget::Budgeted;
use super::clustered::{CfaThesis, CfaThesisOptions};
use super::ctsm::{CtsmOptions, likely};
use super::hybrid::{Cfa, CfaOptions};
use super::local::LocalOptions;
use super::multistart::{LmMultistart, LmOptions};
use super::{Candidate, Optimiser};

/// A search method with its hyperparameters: `{"cfa": {"n": 60}}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The default: clustered fireflies, then a local stage, with restarts.
    Cfa(CfaOptions),
    /// Algorithm 2 of the thesis.
    CfaThesis(CfaThesisOptions),
    /// Levenberg-Marquardt from a Latin hypercube.
    LmMultistart(LmOptions),
    /// Maximum likelihood of the stochastic model: swarms on the likelihood, then Fisher scoring on its slopes.
    Ctsm(CtsmOptions),
}

impl Default for Method {
    fn default() -> Self {
        Method::Cfa(CfaOptions::default())
    }
}

/// The task of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Search {
    /// How many parameters are free.
    pub dimensions: usize,
    /// Fixes every random number of the search.
    pub seed: u64,
    /// Most evaluations, each candidate of each batch being one.
    pub budget: usize,
    /// Candidates to begin with, such as the parameters in use. Those of another dimension are ignored.
    pub warm: Vec<Candidate>,
    /// Whether the caller can answer [`super::Ask::Residuals`]; otherwise it is asked for costs only.
    pub residuals: bool,
}

impl Search {
    /// The warm starts that fit, inside the cube.
    pub(super) fn warm_starts(&self) -> Vec<Candidate> {
        let fits = |start: &&Candidate| start.0.len() == self.dimensions && start.0.iter().all(|x| x.is_finite());
        let inside = |start: &Candidate| Candidate(start.0.iter().map(|x| x.clamp(0.0, 1.0)).collect());
        self.warm.iter().filter(fits).map(inside).collect()
    }
}

/// A hyperparameter and the range in which its method makes sense, ends included.
#[derive(Debug, Clone, PartialEq)]
pub struct Range {
    /// Its path below the method, such as `local.trials`.
    pub field: String,
    /// What it is.
    pub value: f64,
    /// The least that it may be.
    pub from: f64,
    /// The most that it may be.
    pub to: f64,
}

impl Range {
    /// Whether the value lies inside; NaN lies in no range.
    pub fn holds(&self) -> bool {
        (self.from..=self.to).contains(&self.value)
    }
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "must be from {} to {}, not {}", self.from, self.to, self.value)
    }
}

/// Collects the ranges of a method's hyperparameters.
#[derive(Default)]
struct Ranges(Vec<Range>);

impl Ranges {
    fn real(&mut self, field: &str, value: f64, from: f64, to: f64) {
        self.0.push(Range { field: field.to_owned(), value, from, to });
    }

    fn count(&mut self, field: &str, value: usize, from: usize, to: usize) {
        self.real(field, value as f64, from as f64, to as f64);
    }

    /// What both firefly methods have. The population is limited because the clusters cost its square.
    fn swarm(&mut self, n: usize, n_min: usize, targets: [f64; 2], alpha: f64, beta0: f64) {
        self.count("n", n, 2, 2000);
        self.count("n_min", n_min, 1, 2000);
        self.real("target", targets[0], 1.0, 1e6);
        self.real("target_min", targets[1], 1.0, 1e6);
        self.real("alpha", alpha, 0.0, 1.0);
        self.real("beta0", beta0, 0.0, 10.0);
    }

    fn local(&mut self, local: &LocalOptions) {
        self.count("local.iterations", local.iterations, 1, 100_000);
        self.real("local.step", local.step, 1e-12, 1e-2);
        self.real("local.tolerance", local.tolerance, 0.0, 1.0);
        self.real("local.damping", local.damping, 1e-12, 1e6);
        self.count("local.trials", local.trials, 1, 64);
        self.real("local.spread", local.spread, 1.1, 100.0);
        self.real("local.merge", local.merge, 0.0, 1.0);
        self.real("local.radius", local.radius, 1e-12, 0.5);
        self.real("local.radius_end", local.radius_end, 1e-14, 0.5);
        self.count("local.evaluations", local.evaluations, 1, 1_000_000_000);
    }

    fn agreement(&mut self, agreement: &AgreementOptions) {
        self.real("agreement.within", agreement.within, 0.0, 1.0);
        self.real("agreement.improvement", agreement.improvement, 0.0, 1.0);
        self.count("agreement.confirmations", agreement.confirmations, 1, 1000);
        self.count("agreement.patience", agreement.patience, 1, 1_000_000);
    }
}

impl Method {
    /// The names that a job may use.
    pub const NAMES: [&'static str; 4] = ["cfa", "cfa_thesis", "lm_multistart", "ctsm"];

    /// Every hyperparameter that is out of range; a method to be run has none.
    pub fn faults(&self) -> Vec<Range> {
        self.ranges().into_iter().filter(|range| !range.holds()).collect()
    }

    /// Every hyperparameter that is a number, with its range.
    pub fn ranges(&self) -> Vec<Range> {
        let mut check = Ranges::default();
        match self {
            Method::Cfa(o) => {
                check.swarm(o.n, o.n_min, [o.target, o.target_min], o.alpha, o.beta0);
                check.real("alpha_end", o.alpha_end, 0.0, 1.0);
                check.real("gamma", o.gamma, 0.0, 1e6);
                check.real("crossover", o.crossover, 0.0, 1.0);
                check.count("swarm", o.swarm, 1, 1_000_000_000);
                check.count("swarm_on_costs", o.swarm_on_costs, 1, 1_000_000_000);
                check.real("growth", o.growth, 1.0, 100.0);
                check.count("stall", o.stall, 0, 1_000_000_000);
                check.count("starts", o.starts, 0, 64);
                check.count("scouts", o.scouts, 0, 64);
                check.count("starts + scouts", o.starts.saturating_add(o.scouts), 1, 128);
                check.local(&o.local);
                check.agreement(&o.agreement);
            }
            Method::CfaThesis(o) => {
                check.swarm(o.n, o.n_min, [o.target, o.target_min], o.alpha, o.beta0);
                check.count("generations", o.generations, 1, 1_000_000);
                check.real("decay", o.decay, 0.0, 1.0);
                check.real("gamma_min", o.gamma_min, 0.0, 1e6);
                check.real("gamma_max", o.gamma_max, 0.0, 1e6);
            }
            Method::LmMultistart(o) => {
                check.count("starts", o.starts, 1, 100_000);
                check.count("lockstep", o.lockstep, 1, 64);
                check.local(&o.local);
                check.agreement(&o.agreement);
            }
            Method::Ctsm(o) => {
                check.count("n", o.n, 2, 2000);
                check.count("swarm", o.swarm, 1, 1_000_000_000);
                check.real("growth", o.growth, 1.0, 100.0);
                check.count("starts", o.starts, 0, 64);
                check.count("scouts", o.scouts, 0, 64);
                check.count("starts + scouts", o.starts.saturating_add(o.scouts), 1, 128);
                check.count("profile", o.profile, 0, 50);
                check.count("scoring.steps", o.scoring.steps, 1, 100_000);
                check.real("scoring.radius", o.scoring.radius, 1e-6, 1.0);
                check.real("scoring.tolerance", o.scoring.tolerance, 0.0, 1.0);
                check.real("scoring.merge", o.scoring.merge, 0.0, 1.0);
                check.agreement(&o.agreement);
            }
        }
        check.0
    }

    /// The name that a job uses.
    pub fn name(&self) -> &'static str {
        match self {
            Method::Cfa(_) => "cfa",
            Method::CfaThesis(_) => "cfa_thesis",
            Method::LmMultistart(_) => "lm_multistart",
            Method::Ctsm(_) => "ctsm",
        }
    }

    /// A search of its own, ready for the first question.
    pub fn optimiser(&self, search: Search) -> Box<dyn Optimiser> {
        match self {
            Method::Cfa(options) => Box::new(Budgeted::new(Cfa::new(options.clone(), &search), search.budget)),
            Method::CfaThesis(options) => Box::new(Budgeted::new(CfaThesis::new(options.clone(), &search), search.budget)),
            Method::LmMultistart(options) => Box::new(Budgeted::new(LmMultistart::new(options.clone(), &search), search.budget)),
            Method::Ctsm(options) => Box::new(Budgeted::new(likely(options, &search), search.budget)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hyperparameters_are_optional_and_known() {
        let method: Method = serde_json::from_str(r#"{"cfa": {}}"#).unwrap();
        assert_eq!(method, Method::default());
        let method: Method = serde_json::from_str(r#"{"cfa": {"n": 60, "alpha": 1, "local": {"trials": 8}}}"#).unwrap();
        let Method::Cfa(options) = &method else { panic!("{method:?}") };
        assert_eq!((options.n, options.alpha, options.local.trials, options.n_min), (60, 1.0, 8, 12));
        for text in [r#"{"annealing": {}}"#, r#"{"cfa": {"fireflies": 3}}"#, r#"{"cfa_thesis": {"growth": 3}}"#] {
            assert!(serde_json::from_str::<Method>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn every_hyperparameter_out_of_range_is_named() {
        for method in [
            Method::default(),
            Method::CfaThesis(Default::default()),
            Method::LmMultistart(Default::default()),
            Method::Ctsm(Default::default()),
        ] {
            assert_eq!(method.faults(), vec![]);
        }
        let options = CfaOptions { n: 1_000_000, alpha: f64::NAN, starts: 0, scouts: 0, ..CfaOptions::default() };
        let fields: Vec<String> = Method::Cfa(options).faults().into_iter().map(|fault| fault.field).collect();
        assert_eq!(fields, ["n", "alpha", "starts + scouts"]);
        let local = LocalOptions { trials: 0, ..LocalOptions::default() };
        let faults = Method::LmMultistart(LmOptions { local, ..LmOptions::default() }).faults();
        assert_eq!(faults[0].to_string(), "must be from 1 to 64, not 0");
    }

    #[test]
    fn warm_starts_are_brought_into_the_cube_or_left_out() {
        let warm = vec![Candidate(vec![0.5, 1.5]), Candidate(vec![0.5]), Candidate(vec![f64::NAN, 0.1])];
        let search = Search { dimensions: 2, seed: 1, budget: 1, warm, residuals: true };
        assert_eq!(search.warm_starts(), vec![Candidate(vec![0.5, 1.0])]);
    }
}
