//! What is compared on the rooms: the default search, its variants and its rivals, each with its defaults.

use lampyris_core::optimise::agreement::AgreementOptions;
use lampyris_core::optimise::cfa_options::{CfaOptions, LocalFrom};
use lampyris_core::optimise::grid::GridOptions;
use lampyris_core::optimise::local_options::{LocalMethod, LocalOptions};
use lampyris_core::optimise::multistart::LmOptions;
use lampyris_core::optimise::{DimensionScale, Method};

pub const DEFAULT: &str = "cfa (default)";
pub const ENDLESS: &str = "cfa to the budget";
pub const MULTISTART: &str = "lm_multistart";
pub const LINEAR: &str = "cfa, linear scale";
pub const COSTS: &str = "cfa, costs only";

/// A method with what it is told of the task.
#[derive(Debug)]
pub struct Entry {
    pub name: &'static str,
    pub method: Method,
    /// Whether it may see residuals; otherwise it has costs alone.
    pub residuals: bool,
    /// How the coefficients are spread over the cube of the search.
    pub scale: DimensionScale,
    /// Searches per room.
    pub seeds: u64,
    pub note: &'static str,
}

/// Never ends before the budget, whatever its restarts say.
const ENDLESSLY: AgreementOptions =
    AgreementOptions { within: 5e-3, improvement: 1e-3, confirmations: 1000, patience: 1_000_000 };

/// Everything that runs on a room.
pub fn entries() -> Vec<Entry> {
    let cfa = CfaOptions::default();
    let on_costs = |local_from, method| {
        let local = LocalOptions { on_costs: method, ..LocalOptions::default() };
        Method::Cfa(CfaOptions { local_from, local, ..CfaOptions::default() })
    };
    let log = |name, method, note| Entry {
        name,
        method,
        residuals: true,
        scale: DimensionScale::Log,
        seeds: 5,
        note,
    };
    let linear = |name, method, note| Entry { scale: DimensionScale::Linear, ..log(name, method, note) };
    let costs = |name, method, note| Entry { residuals: false, seeds: 3, ..log(name, method, note) };
    // One candidate at a time leaves the lanes empty, and chance has no part in a grid.
    let once = |name, method, note| Entry { seeds: 1, ..costs(name, method, note) };
    vec![
        log(
            DEFAULT,
            Method::Cfa(cfa.clone()),
            "clustered fireflies, then least squares from cluster bests; ends when restarts agree",
        ),
        log(
            ENDLESS,
            Method::Cfa(CfaOptions { agreement: ENDLESSLY, ..cfa.clone() }),
            "the same without early stopping",
        ),
        log(
            "cfa from centroids",
            Method::Cfa(CfaOptions { local_from: LocalFrom::Centroids, ..cfa.clone() }),
            "least squares from the centroids",
        ),
        linear(
            LINEAR,
            Method::Cfa(cfa),
            "the default, coefficients spread evenly instead of in the logarithm",
        ),
        log(
            MULTISTART,
            Method::LmMultistart(LmOptions::default()),
            "Levenberg-Marquardt from a Latin hypercube; ends when restarts agree",
        ),
        linear(
            "lm_multistart, linear scale",
            Method::LmMultistart(LmOptions::default()),
            "the same, spread evenly",
        ),
        costs(
            COSTS,
            on_costs(LocalFrom::ClusterBests, LocalMethod::Bobyqa),
            "without residuals: BOBYQA from cluster bests",
        ),
        costs(
            "cfa, centroids, BOBYQA",
            on_costs(LocalFrom::Centroids, LocalMethod::Bobyqa),
            "without residuals: BOBYQA from the centroids (section 8.1)",
        ),
        costs(
            "cfa, centroids, simplex",
            on_costs(LocalFrom::Centroids, LocalMethod::NelderMead),
            "the same with Nelder and Mead's simplex",
        ),
        costs(
            "cfa, centroids, pattern",
            on_costs(LocalFrom::Centroids, LocalMethod::Pattern),
            "the same with a pattern search",
        ),
        once("cfa_thesis", Method::CfaThesis(Default::default()), "Algorithm 2 with Table 7.4's settings"),
        once(
            "cfa_hierarchical",
            Method::CfaHierarchical(Default::default()),
            "Algorithm 2 with two levels of clusters (section 8.1)",
        ),
        once("fa_modified", Method::FaModified(Default::default()), "section 4.2"),
        once("fa", Method::Fa(Default::default()), "Algorithm 1"),
        costs("lshade", Method::Lshade(Default::default()), "Tanabe and Fukunaga 2014"),
        costs("pso", Method::Pso(Default::default()), "Clerc and Kennedy 2002, on a ring"),
        costs("ga", Method::Ga(Default::default()), "simulated binary crossover, polynomial mutation"),
        once(
            "grid",
            Method::Grid(GridOptions { points: 2, ..GridOptions::default() }),
            "section 5.2; two points per parameter are more than the budget",
        ),
    ]
}

/// The many runs that the best known fit is the best of, together with everything that is compared.
pub fn reference() -> Method {
    Method::LmMultistart(LmOptions { starts: 64, converge: false, ..LmOptions::default() })
}
