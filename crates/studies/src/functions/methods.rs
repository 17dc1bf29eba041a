//! What is compared: functions with their budgets, and methods with the settings of Tables 5.1 to 5.3.

use lampyris_core::optimise::agreement::AgreementOptions;
use lampyris_core::optimise::cfa_options::CfaOptions;
use lampyris_core::optimise::fa::{FaModifiedOptions, FaOptions};
use lampyris_core::optimise::functions::Function;
use lampyris_core::optimise::ga::GaOptions;
use lampyris_core::optimise::grid::GridOptions;
use lampyris_core::optimise::lshade::LshadeOptions;
use lampyris_core::optimise::pso::PsoOptions;
use lampyris_core::optimise::thesis_options::{CfaHierarchicalOptions, CfaThesisOptions};
use lampyris_core::optimise::{Crowd, Method};

/// A function in one of its sizes.
#[derive(Debug, PartialEq)]
pub struct Case {
    pub function: Function,
    pub dimensions: usize,
    /// The learning budget of section 5.3.
    pub budget: usize,
    /// An error below this counts as the optimum.
    pub within: f64,
}

impl Case {
    /// The function, its size and its budget.
    pub fn title(&self) -> String {
        let Self { dimensions, budget, within, .. } = self;
        format!(
            "{} in {dimensions} dimensions, {budget} evaluations, optimum within {within:e}",
            name(self.function)
        )
    }
}

pub const CASES: [Case; 6] = [
    Case { function: Function::Schwefel, dimensions: 5, budget: 20_000, within: 1e-2 },
    Case { function: Function::Schwefel, dimensions: 10, budget: 40_000, within: 1e-2 },
    Case { function: Function::Rosenbrock, dimensions: 5, budget: 100_000, within: 1e-8 },
    Case { function: Function::Rosenbrock, dimensions: 15, budget: 100_000, within: 1e-8 },
    Case { function: Function::Ackley, dimensions: 5, budget: 100_000, within: 1e-6 },
    Case { function: Function::Ackley, dimensions: 15, budget: 100_000, within: 1e-6 },
];

pub const ORIGINAL: &str = "original FA";
pub const MODIFIED: &str = "modified FA";
pub const THESIS: &str = "cFA";
pub const PRINTED: &str = "cFA, as printed";
pub const GRID: &str = "zooming grid";
pub const DEFAULT: &str = "cfa (default)";
pub const ENDLESS: &str = "cfa to the budget";
pub const LSHADE: &str = "L-SHADE";

/// A method with its settings.
pub struct Entry {
    pub name: &'static str,
    pub method: Method,
    /// Which reading of the thesis it is.
    pub reading: &'static str,
}

/// Everything that runs on a function.
pub fn entries(case: &Case) -> Vec<Entry> {
    let clustered = clustered(case);
    let step = CfaThesisOptions { crowd: Crowd::Step, ..clustered.clone() };
    let endless = CfaOptions {
        agreement: AgreementOptions {
            confirmations: 1000,
            patience: 1_000_000,
            ..AgreementOptions::default()
        },
        ..CfaOptions::default()
    };
    let entry = |name, method, reading| Entry { name, method, reading };
    vec![
        entry(ORIGINAL, Method::Fa(original(case)), "Algorithm 1; distances in the function's own units"),
        entry(
            MODIFIED,
            Method::FaModified(modified(case)),
            "section 4.2; normalised distance, S is the range, sequential moves",
        ),
        entry(
            THESIS,
            Method::CfaThesis(step.clone()),
            "Algorithm 2; sqrt(n_c) multiplies the step of eq 4.10, as its text says",
        ),
        entry(
            PRINTED,
            Method::CfaThesis(clustered),
            "Algorithm 2; sqrt(n_c) divides the distance, as eq 4.10 is printed",
        ),
        entry(
            "cFA, two levels",
            Method::CfaHierarchical(CfaHierarchicalOptions { levels: 2, cfa_thesis: step }),
            "section 8.1; clusters of clusters",
        ),
        entry(
            GRID,
            Method::Grid(grid(case)),
            "section 5.2; ends included, two steps or half of the width are kept",
        ),
        entry(
            DEFAULT,
            Method::Cfa(CfaOptions::default()),
            "greedy clustered fireflies, then BOBYQA; ends when restarts agree",
        ),
        entry(ENDLESS, Method::Cfa(endless), "the same without early stopping"),
        entry(LSHADE, Method::Lshade(LshadeOptions::default()), "Tanabe and Fukunaga 2014"),
        entry("particle swarm", Method::Pso(PsoOptions::default()), "Clerc and Kennedy 2002, on a ring"),
        entry(
            "genetic algorithm",
            Method::Ga(GaOptions::default()),
            "simulated binary crossover, polynomial mutation",
        ),
    ]
}

pub fn original(case: &Case) -> FaOptions {
    let width = 2.0 * case.function.half_width();
    match case.function {
        Function::Schwefel => FaOptions { width, ..FaOptions::default() },
        Function::Rosenbrock => FaOptions { n: 60, generations: 150, width, ..FaOptions::default() },
        Function::Ackley => FaOptions { n: 60, generations: 125, gamma: 0.1, width, ..FaOptions::default() },
    }
}

fn modified(case: &Case) -> FaModifiedOptions {
    let steep = FaModifiedOptions {
        n: 60,
        decay: 0.95,
        gamma_min: 0.1,
        gamma_max: 10.0,
        ..FaModifiedOptions::default()
    };
    match case.function {
        Function::Schwefel => FaModifiedOptions::default(),
        Function::Rosenbrock => FaModifiedOptions { generations: 150, n_min: 20, ..steep },
        Function::Ackley => FaModifiedOptions { generations: 125, n_min: 25, ..steep },
    }
}

pub fn clustered(case: &Case) -> CfaThesisOptions {
    let steep = CfaThesisOptions {
        n: 80,
        generations: 350,
        target: 8.0,
        decay: 0.95,
        gamma_min: 0.1,
        gamma_max: 10.0,
        ..CfaThesisOptions::default()
    };
    match case.function {
        Function::Schwefel => CfaThesisOptions {
            generations: 100,
            n_min: 30,
            target: 5.0,
            gamma_min: 1.0,
            gamma_max: 3.0,
            ..CfaThesisOptions::default()
        },
        Function::Rosenbrock => CfaThesisOptions { n_min: 20, ..steep },
        Function::Ackley => CfaThesisOptions { n_min: 25, ..steep },
    }
}

fn grid(case: &Case) -> GridOptions {
    let (points, iterations) = match (case.function, case.dimensions) {
        (Function::Schwefel, 5) => (5, 10),
        (Function::Schwefel, _) => (2, 40),
        (_, 5) => (7, 6),
        _ => (2, 4),
    };
    GridOptions { points, iterations, ..GridOptions::default() }
}

/// A function by its author.
pub fn name(function: Function) -> &'static str {
    match function {
        Function::Schwefel => "Schwefel",
        Function::Rosenbrock => "Rosenbrock",
        Function::Ackley => "Ackley",
    }
}
