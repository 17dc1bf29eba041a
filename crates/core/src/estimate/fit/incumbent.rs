//! What a controller uses now.

use super::Fit;
use super::levels::ChannelLevel;
use crate::estimate::problem::Problem;
use crate::model::ModelId;
use indexmap::IndexMap;

/// The parameters that are served now.
#[derive(Debug, Clone, PartialEq)]
pub struct Incumbent {
    /// The model that they belong to.
    pub model: ModelId,
    /// Values by name.
    pub theta: IndexMap<String, f64>,
    /// The levels of the channels that they were fitted to; none where they are not known.
    pub levels: IndexMap<String, ChannelLevel>,
    /// What their free run erred by over the days that they were fitted to, by output; none where that is not
    /// known.
    pub errors: IndexMap<String, f64>,
    /// Parameters that the data did not determine, and stand at their nominal values.
    pub undetermined: Vec<String>,
    /// Parameters on a bound that the data ask for.
    pub limits: Vec<String>,
    /// The process noise of their filter; none where that is not known, or the model has no filter.
    pub process_noise: Option<f64>,
}

impl Incumbent {
    /// The parameters of a fit that is served; `None` where its model has no name.
    pub fn of(fit: &Fit) -> Option<Self> {
        let values = fit.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.value));
        let errors = fit.metrics.iter().map(|(channel, metrics)| (channel.clone(), metrics.train_rmse));
        let on_bound = fit.parameters.iter().filter(|(_, estimate)| estimate.at_bound);
        Some(Self {
            model: fit.model.parse().ok()?,
            theta: values.collect(),
            levels: fit.levels.clone(),
            errors: errors.collect(),
            undetermined: fit.non_identifiable.clone(),
            limits: on_bound.map(|(name, _)| name.clone()).collect(),
            process_noise: (fit.process_noise > 0.0).then_some(fit.process_noise),
        })
    }

    /// Values alone, of which nothing else is known.
    pub fn bare(model: ModelId, theta: IndexMap<String, f64>) -> Self {
        let (levels, errors) = (IndexMap::new(), IndexMap::new());
        let (undetermined, limits) = (Vec::new(), Vec::new());
        Self { model, theta, levels, errors, undetermined, limits, process_noise: None }
    }

    /// Whether they are parameters of the model of a problem, all of them.
    pub fn is_of(&self, problem: &Problem) -> bool {
        let model = problem.model();
        let mut names = model.parameters().iter().map(|parameter| &parameter.name);
        self.model == *model.id() && names.all(|name| self.theta.contains_key(name))
    }

    /// The full parameter vector of a problem, whose own values stand where it is not known.
    pub fn on(&self, problem: &Problem) -> Vec<f64> {
        let names = problem.model().parameters().iter().map(|parameter| &parameter.name);
        let known = |(own, name): (&f64, &String)| self.theta.get(name).copied().unwrap_or(*own);
        problem.nominal().iter().zip(names).map(known).collect()
    }

    /// A problem in which the parameters are fixed that the data did not determine.
    pub fn as_determined(&self, problem: &Problem) -> Problem {
        let parameters = problem.model().parameters().iter().enumerate();
        let undetermined = parameters.filter(|(_, parameter)| self.undetermined.contains(&parameter.name));
        let fixed: Vec<(usize, f64)> =
            undetermined.map(|(index, _)| (index, problem.nominal()[index])).collect();
        if fixed.is_empty() { problem.clone() } else { problem.with_fixed(&fixed) }
    }

    /// Those of the parameters that the data did not determine which are fixed in a problem still, but for
    /// some that are known.
    pub fn still_undetermined(&self, problem: &Problem, known: &[String]) -> Vec<String> {
        let is_free = |name: &String| {
            problem.free().iter().any(|index| problem.model().parameters()[*index].name == *name)
        };
        let fixed = self.undetermined.iter().filter(|name| !is_free(name) && !known.contains(name));
        fixed.cloned().collect()
    }
}
