//! The searches that can be asked for by name, and what each needs to know of the task.

use serde::{Deserialize, Serialize};

use super::budget::Budgeted;
use super::clustered::{CfaThesis, CfaThesisOptions};
use super::hybrid::{Cfa, CfaOptions};
use super::multistart::{LmMultistart, LmOptions};
use super::{Candidate, Optimiser};

/// A search method with its hyperparameters, as a job names it: `{"name": "cfa", "n": 60}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "snake_case")]
pub enum Method {
    /// The default: clustered fireflies, then a local stage, with restarts.
    Cfa(CfaOptions),
    /// Algorithm 2 of the thesis.
    CfaThesis(CfaThesisOptions),
    /// Levenberg-Marquardt from a Latin hypercube.
    LmMultistart(LmOptions),
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

impl Method {
    /// The name that a job uses.
    pub fn name(&self) -> &'static str {
        match self {
            Method::Cfa(_) => "cfa",
            Method::CfaThesis(_) => "cfa_thesis",
            Method::LmMultistart(_) => "lm_multistart",
        }
    }

    /// A search of its own, ready for the first question.
    pub fn optimiser(&self, search: Search) -> Box<dyn Optimiser> {
        match self {
            Method::Cfa(options) => Box::new(Budgeted::new(Cfa::new(options.clone(), &search), search.budget)),
            Method::CfaThesis(options) => {
                Box::new(Budgeted::new(CfaThesis::new(options.clone(), &search), search.budget))
            }
            Method::LmMultistart(options) => {
                Box::new(Budgeted::new(LmMultistart::new(options.clone(), &search), search.budget))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_method_is_named_and_its_hyperparameters_are_optional() {
        let method: Method = serde_json::from_str(r#"{"name": "cfa"}"#).unwrap();
        assert_eq!(method, Method::default());
        let method: Method =
            serde_json::from_str(r#"{"n": 60, "alpha": 1, "name": "cfa", "local": {"trials": 8}}"#).unwrap();
        let Method::Cfa(options) = &method else { panic!("{method:?}") };
        assert_eq!((options.n, options.alpha, options.local.trials, options.n_min), (60, 1.0, 8, 12));
        for method in [method, Method::CfaThesis(Default::default()), Method::LmMultistart(Default::default())] {
            let text = serde_json::to_string(&method).unwrap();
            assert!(text.contains(&format!(r#""name":"{}""#, method.name())));
            assert_eq!(serde_json::from_str::<Method>(&text).unwrap(), method);
        }
    }

    #[test]
    fn unknown_names_and_fields_are_refused() {
        for text in [
            r#"{"name": "annealing"}"#,
            r#"{}"#,
            r#"{"name": "cfa", "fireflies": 3}"#,
            r#"{"name": "cfa_thesis", "growth": 3}"#,
            r#"{"name": "cfa", "local": {"iteration": 3}}"#,
            r#"{"name": "lm_multistart", "starts": "all"}"#,
        ] {
            assert!(serde_json::from_str::<Method>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn warm_starts_are_brought_into_the_cube_or_left_out() {
        let warm = vec![Candidate(vec![0.5, 1.5]), Candidate(vec![0.5]), Candidate(vec![f64::NAN, 0.1])];
        let search = Search { dimensions: 2, seed: 1, budget: 1, warm, residuals: true };
        assert_eq!(search.warm_starts(), vec![Candidate(vec![0.5, 1.0])]);
    }
}
