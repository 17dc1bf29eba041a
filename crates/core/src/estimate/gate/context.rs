//! What the rules of the gate look at: a fit, put to its problem again.

use super::evidence::Evidence;
use super::limits::OutputScale;
use super::past::{GatePolicy, Past, Reference};
use crate::data::Duration;
use crate::estimate::assess::metrics::{
    FilterRun, ProcessNoise, ahead, filter, filter_fit, free_run_ahead, horizon_name, lead,
};
use crate::estimate::fit::levels::ChannelLevel;
use crate::estimate::fit::{AheadError, Fit};
use crate::estimate::problem::Problem;
use crate::estimate::problem::predictor::Predictor;
use crate::simulate::Trajectory;
use indexmap::IndexMap;
use std::cell::OnceCell;
use std::ops::Range;

/// What the rules look at: a fit that is simulated again from its stored numbers.
pub(super) struct ValidationContext<'a> {
    pub problem: Problem,
    pub fit: &'a Fit,
    pub theta: Vec<f64>,
    pub trajectory: Trajectory,
    /// Of the fit, on unseen data.
    pub forecast: Option<AheadError>,
    /// The parameters served now, where they are parameters of the same model.
    pub incumbent: Option<Vec<f64>>,
    /// Older parameters of the same model, with what they are.
    pub references: Vec<(&'a str, Vec<f64>)>,
    /// The levels of the channels in windows of fits that were trusted, with what those are.
    pub levels: Vec<(&'a str, &'a IndexMap<String, ChannelLevel>)>,
    pub policy: &'a GatePolicy,
    /// What else is known.
    pub past: &'a Past,
    /// The filter over the window with the noise of the fit; a model without one has none.
    run: Option<FilterRun>,
    evidence: OnceCell<Evidence>,
}

impl<'a> ValidationContext<'a> {
    pub fn new(
        problem: &Problem,
        fit: &'a Fit,
        past: &'a Past,
        policy: &'a GatePolicy,
    ) -> Result<Self, &'static str> {
        // The fit may have needed shorter steps than the problem started with, and other starts.
        let problem = fit.simulated(problem);
        let theta = reread(fit);
        if theta.len() != problem.model().parameters().len() || theta.iter().any(|value| !value.is_finite()) {
            return Err("a parameter is missing or no finite number");
        }
        let trajectory = problem.simulate(&theta);
        if trajectory.diverged {
            return Err("the simulation of the stored parameters leaves the numbers");
        }
        let run = match problem.predictor() {
            Predictor::Filtered => Some(filter_fit(&problem, fit)),
            Predictor::FreeRun => None,
        };
        let incumbent = past.incumbent.as_ref().filter(|incumbent| incumbent.is_of(&problem));
        let incumbent = incumbent.map(|incumbent| incumbent.on(&problem));
        let reference = |reference: &'a Reference| {
            Some((reference.name.as_str(), reference_theta(&problem, &reference.fit)?))
        };
        let references = past.references.iter().filter_map(reference).collect();
        let served = past.incumbent.iter().map(|incumbent| ("the parameters served now", &incumbent.levels));
        let levels = served
            .chain(past.references.iter().map(|reference| (reference.name.as_str(), &reference.fit.levels)))
            .collect();
        let evidence = OnceCell::new();
        let mut context = Self {
            problem,
            fit,
            theta,
            trajectory,
            forecast: None,
            incumbent,
            references,
            levels,
            policy,
            past,
            run,
            evidence,
        };
        context.forecast = context.own_error(context.problem.split().validation.clone());
        Ok(context)
    }

    /// The filter over the window with the noise of the fit; a model without one has none.
    pub fn run(&self) -> Option<&FilterRun> {
        self.run.as_ref()
    }

    /// What the measurements say of the inputs. A model without a filter has no states to start segments
    /// from.
    pub fn evidence(&self) -> Option<&Evidence> {
        let run = self.run()?;
        Some(self.evidence.get_or_init(|| Evidence::of(&self.problem, &self.theta, run)))
    }

    /// What the fit errs by on some samples, as [`ValidationContext::error_of`] says it of other parameters.
    pub fn own_error(&self, samples: Range<usize>) -> Option<AheadError> {
        match &self.run {
            Some(run) => forecast(&self.problem, &self.theta, run, self.policy.horizon, samples),
            None => free_run(&self.problem, &self.trajectory, self.policy.horizon, samples),
        }
    }

    /// What parameters of the same model err by on some samples: ahead by the policy's horizon, or in the
    /// free run of a model without a filter.
    pub fn error_of(&self, theta: &[f64], samples: Range<usize>) -> Option<AheadError> {
        match &self.run {
            Some(_) => {
                let run = filter(&self.problem, theta, self.noise());
                forecast(&self.problem, theta, &run, self.policy.horizon, samples)
            }
            None => free_run(&self.problem, &self.problem.simulate(theta), self.policy.horizon, samples),
        }
    }

    /// What some parameters err by on the days before those of the fit, ahead by the policy's horizon and by
    /// a day.
    pub fn errors_before(&self, theta: &[f64]) -> Option<[f64; 2]> {
        let before = self.past.days_before.as_ref()?.with_substeps(self.fit.substeps);
        let run = filter(&before, theta, self.noise());
        let error = |horizon| Some(forecast(&before, theta, &run, horizon, 0..before.grid().len())?.rmse);
        Some([error(self.policy.horizon)?, error(Duration::from_days(1))?])
    }

    /// The noise of a filter with other parameters: the likeliest, which is hardly far from that of the fit.
    fn noise(&self) -> ProcessNoise {
        ProcessNoise::LikeliestNear(self.fit.process_noise)
    }

    /// The outputs, with what the limits mean for each.
    pub fn output_scales(&self) -> Vec<OutputScale<'_>> {
        OutputScale::of(&self.problem)
    }

    /// The output that comes nearest to its limit or leaves it farthest behind, with its statistic and its
    /// limit.
    pub fn worst(
        &self,
        kelvin: f64,
        statistic: impl Fn(&OutputScale) -> f64,
    ) -> Option<(OutputScale<'_>, f64, f64)> {
        let judged =
            self.output_scales().into_iter().map(|scale| (scale, statistic(&scale), scale.limit(kelvin)));
        judged.max_by(|(_, one, limit), (_, other, their)| (one / limit).total_cmp(&(other / their)))
    }

    /// The first sample of this many milliseconds before the end.
    pub fn since(&self, millis: i64) -> usize {
        self.problem.grid().len().saturating_sub((millis / self.problem.grid().step()) as usize)
    }
}

/// Forecast errors at a horizon on some samples: of the parameters, and of persistence. `None` where nothing
/// is comparable, or a forecast that could be made left the numbers: the others do not speak for it.
fn forecast(
    problem: &Problem,
    theta: &[f64],
    run: &FilterRun,
    horizon: Duration,
    samples: Range<usize>,
) -> Option<AheadError> {
    let name = horizon_name(horizon);
    let error = ahead(problem, theta, run, samples.clone(), &[(name.as_str(), horizon.millis())])
        .into_values()
        .next()?;
    let lead = lead(horizon.millis(), problem.grid().step())?;
    let (_, valid) = problem.measured()[0];
    let known = problem.known();
    let possible = (samples.start + lead..samples.end)
        .filter(|k| valid[*k] && valid[k - lead] && known[k - lead..*k].iter().all(|known| *known));
    (error.n >= possible.count()).then_some(error)
}

/// The same for a model without a filter, which forecasts by its free run alone.
fn free_run(
    problem: &Problem,
    trajectory: &Trajectory,
    horizon: Duration,
    samples: Range<usize>,
) -> Option<AheadError> {
    let lead = lead(horizon.millis(), problem.grid().step())?;
    free_run_ahead(problem, trajectory, samples, lead).filter(|_| !trajectory.diverged)
}

/// The parameters as a reader of the stored document gets them.
fn reread(fit: &Fit) -> Vec<f64> {
    let text = serde_json::to_string(fit).unwrap_or_default();
    serde_json::from_str::<Fit>(&text).map(|fit| fit.theta()).unwrap_or_default()
}

/// The vector of an older fit where it is one of the same model.
fn reference_theta(problem: &Problem, fit: &Fit) -> Option<Vec<f64>> {
    let names = problem.model().parameters().iter().map(|parameter| &parameter.name);
    let same = fit.model == problem.model().id().to_string() && names.eq(fit.parameters.keys());
    same.then(|| fit.theta())
}
