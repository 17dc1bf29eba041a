//! What the rules of the gate look at: a fit, put to its problem again.

use super::fit::{AheadError, Fit};
use super::limits::Measure;
use super::metrics::{FilterRun, ahead, filter_fit, free_run_ahead, horizon_name, lead};
use super::problem::Problem;
use super::validate::{Incumbent, Past, Policy};
use crate::simulate::Trajectory;

/// What the rules look at: a fit that is simulated again from its stored numbers.
pub(super) struct Case<'a> {
    pub problem: Problem,
    pub fit: &'a Fit,
    pub theta: Vec<f64>,
    pub trajectory: Trajectory,
    /// Of the fit, on unseen data.
    pub forecast: Option<AheadError>,
    /// The parameters served now, where they are parameters of the same model.
    pub incumbent: Option<Vec<f64>>,
    pub policy: &'a Policy,
}

impl<'a> Case<'a> {
    pub fn new(problem: &Problem, fit: &'a Fit, past: &Past, policy: &'a Policy) -> Result<Self, &'static str> {
        // The fit may have needed shorter steps than the problem started with.
        let problem = problem.with_substeps(fit.substeps);
        let theta = reread(fit);
        if theta.len() != problem.model().parameters().len() || theta.iter().any(|value| !value.is_finite()) {
            return Err("a parameter is missing or no finite number");
        }
        let trajectory = problem.simulate(&theta);
        if trajectory.diverged {
            return Err("the simulation of the stored parameters leaves the numbers");
        }
        let forecast = if problem.filters() {
            forecast(&problem, &theta, &filter_fit(&problem, fit), policy)
        } else {
            free_run(&problem, &trajectory, policy)
        };
        let incumbent = past.incumbent.as_ref().and_then(|incumbent| incumbent_theta(&problem, incumbent));
        Ok(Self { problem, fit, theta, trajectory, forecast, incumbent, policy })
    }

    /// The outputs, with what the limits mean for each.
    pub fn measures(&self) -> Vec<Measure<'_>> {
        Measure::of(&self.problem)
    }

    /// The output that comes nearest to its limit or leaves it farthest behind, with its statistic and its limit.
    pub fn worst(&self, kelvin: f64, statistic: impl Fn(&Measure) -> f64) -> Option<(Measure<'_>, f64, f64)> {
        let judged = self.measures().into_iter().map(|measure| (measure, statistic(&measure), measure.limit(kelvin)));
        judged.max_by(|(_, one, limit), (_, other, their)| (one / limit).total_cmp(&(other / their)))
    }

    /// The first sample of this many seconds before the end.
    pub fn since(&self, seconds: i64) -> usize {
        self.problem.grid().len().saturating_sub((seconds / self.problem.grid().step()) as usize)
    }
}

/// Forecast errors at the policy's horizon on unseen data: of the parameters, and of persistence. `None` where nothing is
/// comparable, or a forecast that could be made left the numbers: the others do not speak for it.
pub(super) fn forecast(problem: &Problem, theta: &[f64], run: &FilterRun, policy: &Policy) -> Option<AheadError> {
    let name = horizon_name(policy.horizon);
    let horizon = [(name.as_str(), policy.horizon.seconds())];
    let unseen = problem.split().validation.clone();
    let error = ahead(problem, theta, run, unseen.clone(), &horizon).into_values().next()?;
    let lead = lead(policy.horizon.seconds(), problem.grid().step())?;
    let (_, valid) = problem.measured()[0];
    let known = problem.known();
    let possible =
        (unseen.start + lead..unseen.end).filter(|k| valid[*k] && valid[k - lead] && known[k - lead..*k].iter().all(|known| *known));
    (error.n >= possible.count()).then_some(error)
}

/// The same for a model without a filter, which forecasts by its free run alone.
pub(super) fn free_run(problem: &Problem, trajectory: &Trajectory, policy: &Policy) -> Option<AheadError> {
    let lead = lead(policy.horizon.seconds(), problem.grid().step())?;
    free_run_ahead(problem, trajectory, problem.split().validation.clone(), lead).filter(|_| !trajectory.diverged)
}

/// The parameters as a reader of the stored document gets them.
fn reread(fit: &Fit) -> Vec<f64> {
    let text = serde_json::to_string(fit).unwrap_or_default();
    serde_json::from_str::<Fit>(&text).map(|fit| fit.theta()).unwrap_or_default()
}

/// The incumbent's vector where it belongs to the same model.
fn incumbent_theta(problem: &Problem, incumbent: &Incumbent) -> Option<Vec<f64>> {
    let same = incumbent.model == *problem.model().id();
    let theta: Option<Vec<f64>> =
        problem.model().parameters().iter().map(|parameter| incumbent.theta.get(&parameter.name).copied()).collect();
    theta.filter(|_| same)
}
