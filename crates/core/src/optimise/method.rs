//! The searches that can be asked for by name, and what each needs to know of the task.

use super::search::Search;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Optimiser;
use super::agreement::AgreementOptions;
use super::budget::{Budgeted, Strategy};
use super::cfa_options::CfaOptions;
use super::clustered::CfaThesis;
use super::ctsm::{CtsmOptions, likely};
use super::fa::{FaModifiedOptions, FaOptions};
use super::ga::{Ga, GaOptions};
use super::grid::{GridOptions, GridSearch};
use super::hybrid::Cfa;
use super::local_options::LocalOptions;
use super::lshade::{Lshade, LshadeOptions};
use super::multistart::{LmMultistart, LmOptions};
use super::pso::{Pso, PsoOptions};
use super::thesis_options::{CfaHierarchicalOptions, CfaThesisOptions};

/// A search method with its hyperparameters: `{"cfa": {"n": 60}}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The default: clustered fireflies, then a local stage, with restarts.
    Cfa(CfaOptions),
    /// Algorithm 2 of the thesis.
    CfaThesis(CfaThesisOptions),
    /// Algorithm 2 with several levels of clusters (section 8.1).
    CfaHierarchical(CfaHierarchicalOptions),
    /// Levenberg-Marquardt from a Latin hypercube.
    LmMultistart(LmOptions),
    /// Maximum likelihood of the stochastic model: swarms on the likelihood, then Fisher scoring on its
    /// slopes.
    Ctsm(CtsmOptions),
    /// The original Firefly Algorithm (Algorithm 1).
    Fa(FaOptions),
    /// The Firefly Algorithm with the modifications of section 4.2.
    FaModified(FaModifiedOptions),
    /// The zooming grid of section 5.2.
    Grid(GridOptions),
    /// L-SHADE, differential evolution that learns its own settings.
    Lshade(LshadeOptions),
    /// Particle swarm optimisation.
    Pso(PsoOptions),
    /// A genetic algorithm on real numbers.
    Ga(GaOptions),
}

impl Default for Method {
    fn default() -> Self {
        Method::Cfa(CfaOptions::default())
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

    /// What Algorithm 2 has, wherever it stands in a method.
    fn clustered(&mut self, path: &str, o: &CfaThesisOptions) {
        let first = self.0.len();
        self.swarm(o.n, o.n_min, [o.target, o.target_min], o.alpha, o.beta0);
        self.count("generations", o.generations, 1, 1_000_000);
        self.real("decay", o.decay, 0.0, 1.0);
        self.real("gamma_min", o.gamma_min, 0.0, 1e6);
        self.real("gamma_max", o.gamma_max, 0.0, 1e6);
        self.0[first..].iter_mut().for_each(|range| range.field.insert_str(0, path));
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
    pub const NAMES: [&'static str; 11] = [
        "cfa",
        "cfa_thesis",
        "cfa_hierarchical",
        "lm_multistart",
        "ctsm",
        "fa",
        "fa_modified",
        "grid",
        "lshade",
        "pso",
        "ga",
    ];

    /// The same method, whose slopes are never taken over less than so far in the unit cube.
    #[must_use]
    pub fn with_least_step(&self, least: f64) -> Self {
        let mut method = self.clone();
        match &mut method {
            Method::Cfa(options) => options.local = options.local.clone().with_least_step(least),
            Method::LmMultistart(options) => options.local = options.local.clone().with_least_step(least),
            // The others take no slopes of residuals.
            _ => {}
        }
        method
    }

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
                check.count("on_costs.swarm", o.on_costs.swarm, 1, 1_000_000_000);
                check.real("on_costs.gamma", o.on_costs.gamma, 0.0, 1e6);
                check.real("on_costs.crossover", o.on_costs.crossover, 0.0, 1.0);
                check.real("on_costs.leap", o.on_costs.leap, 0.0, 1.0);
                check.real("on_costs.cloud", o.on_costs.cloud, 0.0, 1.0);
                check.real("growth", o.growth, 1.0, 100.0);
                check.count("stall", o.stall, 0, 1_000_000_000);
                check.count("starts", o.starts, 0, 64);
                check.count("scouts", o.scouts, 0, 64);
                check.count("starts + scouts", o.starts.saturating_add(o.scouts), 1, 128);
                check.local(&o.local);
                check.agreement(&o.agreement);
            }
            Method::CfaThesis(o) => check.clustered("", o),
            Method::CfaHierarchical(o) => {
                check.count("levels", o.levels, 1, 16);
                check.clustered("cfa_thesis.", &o.cfa_thesis);
            }
            Method::Fa(o) => {
                check.count("n", o.n, 2, 2000);
                check.count("generations", o.generations, 1, 1_000_000);
                check.real("alpha", o.alpha, 0.0, 1.0);
                check.real("beta0", o.beta0, 0.0, 10.0);
                check.real("gamma", o.gamma, 0.0, 1e6);
                check.real("width", o.width, 1e-6, 1e6);
            }
            Method::FaModified(o) => check.clustered("", &o.as_one_cluster()),
            Method::Grid(o) => {
                check.count("points", o.points, 2, 10_000);
                check.count("iterations", o.iterations, 1, 10_000);
                check.real("shrink", o.shrink, 0.0, 1.0);
            }
            Method::Lshade(o) => {
                check.count("n_per_parameter", o.n_per_parameter, 1, 1000);
                check.count("memory", o.memory, 1, 1000);
                check.real("p", o.p, 0.0, 1.0);
                check.real("archive", o.archive, 0.0, 100.0);
            }
            Method::Pso(o) => {
                check.count("n", o.n, 2, 10_000);
                check.real("inertia", o.inertia, 0.0, 1.0);
                check.real("pull", o.pull, 0.0, 4.0);
                check.count("neighbours", o.neighbours, 1, 10_000);
            }
            Method::Ga(o) => {
                check.count("n", o.n, 4, 10_000);
                check.real("crossover", o.crossover, 0.0, 1.0);
                check.real("crossover_index", o.crossover_index, 0.0, 1e3);
                check.real("mutation_index", o.mutation_index, 0.0, 1e3);
                check.count("elite", o.elite, 0, o.n.saturating_sub(1));
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

    /// Whether it ends by least squares, wherever else it has been.
    pub fn descends(&self) -> bool {
        matches!(self, Method::Cfa(_) | Method::LmMultistart(_))
    }

    /// The name that a job uses.
    pub fn name(&self) -> &'static str {
        match self {
            Method::Cfa(_) => "cfa",
            Method::CfaThesis(_) => "cfa_thesis",
            Method::CfaHierarchical(_) => "cfa_hierarchical",
            Method::LmMultistart(_) => "lm_multistart",
            Method::Ctsm(_) => "ctsm",
            Method::Fa(_) => "fa",
            Method::FaModified(_) => "fa_modified",
            Method::Grid(_) => "grid",
            Method::Lshade(_) => "lshade",
            Method::Pso(_) => "pso",
            Method::Ga(_) => "ga",
        }
    }

    /// A search of its own, ready for the first question.
    pub fn optimiser(&self, search: Search) -> Box<dyn Optimiser> {
        fn within<S: Strategy + 'static>(strategy: S, budget: usize) -> Box<dyn Optimiser> {
            Box::new(Budgeted::new(strategy, budget))
        }
        let budget = search.budget;
        match self {
            Method::Cfa(options) => within(Cfa::new(options.clone(), &search), budget),
            Method::CfaThesis(options) => within(CfaThesis::new(options.clone(), &search), budget),
            Method::CfaHierarchical(options) => {
                within(CfaThesis::hierarchical(options.clone(), &search), budget)
            }
            Method::LmMultistart(options) => within(LmMultistart::new(options.clone(), &search), budget),
            Method::Ctsm(options) => within(likely(options, &search), budget),
            Method::Fa(options) => within(CfaThesis::new(options.as_one_cluster(), &search), budget),
            Method::FaModified(options) => within(CfaThesis::new(options.as_one_cluster(), &search), budget),
            Method::Grid(options) => within(GridSearch::new(options.clone(), &search), budget),
            Method::Lshade(options) => within(Lshade::new(options.clone(), &search), budget),
            Method::Pso(options) => within(Pso::new(options.clone(), &search), budget),
            Method::Ga(options) => within(Ga::new(options.clone(), &search), budget),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Candidate;
    use super::*;

    #[test]
    fn hyperparameters_are_optional_and_known() {
        let method: Method = serde_json::from_str(r#"{"cfa": {}}"#).unwrap();
        assert_eq!(method, Method::default());
        let method: Method =
            serde_json::from_str(r#"{"cfa": {"n": 60, "alpha": 1, "local": {"trials": 8}}}"#).unwrap();
        let Method::Cfa(options) = &method else { panic!("{method:?}") };
        assert_eq!((options.n, options.alpha, options.local.trials, options.n_min), (60, 1.0, 8, 12));
        for text in
            [r#"{"annealing": {}}"#, r#"{"cfa": {"fireflies": 3}}"#, r#"{"cfa_thesis": {"growth": 3}}"#]
        {
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
        let options =
            CfaOptions { n: 1_000_000, alpha: f64::NAN, starts: 0, scouts: 0, ..CfaOptions::default() };
        let fields: Vec<String> =
            Method::Cfa(options).faults().into_iter().map(|fault| fault.field).collect();
        assert_eq!(fields, ["n", "alpha", "starts + scouts"]);
        let local = LocalOptions { trials: 0, ..LocalOptions::default() };
        let faults = Method::LmMultistart(LmOptions { local, ..LmOptions::default() }).faults();
        assert_eq!(faults[0].to_string(), "must be from 1 to 64, not 0");
    }

    /// What each method spends on Schwefel's function in 5 dimensions within 20,000 evaluations, and its
    /// generations: numbers that change only where the method does.
    #[test]
    fn a_seed_fixes_the_course_of_every_method() {
        use crate::optimise::functions::{Function, drive};
        let golden: [(&str, usize, usize); 10] = [
            ("cfa", 8996, 645),
            ("cfa_thesis", 17_577, 70),
            ("cfa_hierarchical", 16_603, 70),
            ("lm_multistart", 5520, 18),
            ("fa", 20_000, 9),
            ("fa_modified", 20_000, 10),
            ("grid", 20_000, 1),
            ("lshade", 20_000, 722),
            ("pso", 20_000, 399),
            ("ga", 20_000, 204),
        ];
        let course = |name: &str| {
            let method: Method = serde_json::from_value(serde_json::json!({ name: {} })).unwrap();
            assert_eq!(method.name(), name);
            let search =
                Search { dimensions: 5, seed: 42, budget: 20_000, warm: Vec::new(), residuals: false };
            let mut optimiser = method.optimiser(search);
            let run = drive(optimiser.as_mut(), |x| Function::Schwefel.cost(x));
            (run.evaluations, optimiser.generation())
        };
        // These functions have no likelihood.
        let names: Vec<&str> = Method::NAMES.into_iter().filter(|name| *name != "ctsm").collect();
        let courses: Vec<(&str, usize, usize)> =
            names.iter().map(|name| (*name, course(name).0, course(name).1)).collect();
        assert_eq!(courses, golden);
    }

    #[test]
    fn warm_starts_are_brought_into_the_cube_or_left_out() {
        let warm = vec![Candidate(vec![0.5, 1.5]), Candidate(vec![0.5]), Candidate(vec![f64::NAN, 0.1])];
        let search = Search { dimensions: 2, seed: 1, budget: 1, warm, residuals: true };
        assert_eq!(search.warm_starts(), vec![Candidate(vec![0.5, 1.0])]);
    }
}
