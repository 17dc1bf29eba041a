//! What an estimation found, as the document that is stored, printed and compared.

pub mod covariance;
pub mod incumbent;
pub mod levels;
pub mod likelihood;
pub mod parameter_change;

use crate::data::{Seconds, rfc3339};
use crate::estimate::fit::covariance::Covariance;
use crate::estimate::fit::levels::ChannelLevel;
use crate::estimate::fit::likelihood::LikelihoodReport;
use crate::estimate::fit::parameter_change::ParameterChange;
use crate::estimate::problem::Problem;
use crate::estimate::problem::basis::Basis;
use crate::estimate::problem::prior::KnownPrior;
use crate::schema::Interval;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Why a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stop {
    /// Successive restarts agree on the optimum.
    Converged,
    /// Restarts bring nothing new although they disagree, or early stopping has lost its patience.
    Stalled,
    /// The evaluations are used up.
    Budget,
    /// The wall time is used up.
    Deadline,
    /// An operator or a shutdown stopped it.
    Cancelled,
    /// The cost reached the target.
    Target,
}

/// How widely was searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Searched {
    /// From the parameters that were served to the optimum next to them.
    Local,
    /// Everywhere within the bounds.
    Global,
}

/// One estimated or fixed parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Estimate {
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// The 95 % confidence interval from AR-whitened residuals; `None` where the data do not determine it.
    #[schema(value_type = Option<Interval>)]
    pub ci95: Option<[f64; 2]>,
    /// The interval that was searched.
    #[schema(value_type = Interval)]
    pub bounds: [f64; 2],
    /// Whether the value lies within one per cent of a bound, on the parameter's scale.
    pub at_bound: bool,
    /// Whether it was held fixed.
    pub fixed: bool,
}

/// Where the states start that a sensor measures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StartEstimate {
    /// The start, in the unit of the channel.
    pub value: f64,
    /// Its standard deviation, from the noise of the sensor and what the training part says beside it.
    pub deviation: f64,
}

/// Two parameters that the data can hardly tell apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CorrelatedPair {
    /// The parameters.
    pub parameters: [String; 2],
    /// Their correlation.
    pub correlation: f64,
    /// What lies along their ridge, in the order of the first; empty where it was not followed: it is for the
    /// closest pairs of models that have no filter, and with it no likelihood to profile.
    #[serde(default)]
    pub ridge: Vec<RidgePoint>,
}

/// A point of a ridge: one parameter is held, all others are estimated again.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RidgePoint {
    /// The values of the pair: the one that is held, and what the other becomes.
    pub values: [f64; 2],
    /// The least cost there, in the unit of the fit's.
    pub cost: f64,
}

/// The best cost after so many evaluations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TracePoint {
    /// Single-candidate simulations so far.
    pub evaluations: usize,
    /// Best cost so far.
    pub best: f64,
}

/// The error at a forecast horizon, beside the error of persistence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AheadError {
    /// Root mean square error of the forecast from re-estimated states.
    pub rmse: f64,
    /// The same for the measured value at the origin, held.
    pub persistence: f64,
    /// How many forecasts were compared.
    pub n: usize,
}

/// The errors of one output. The free-run errors come from one simulation from the start of the window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OutputMetrics {
    /// Unit of the errors.
    pub unit: String,
    /// Free run over the training part.
    pub train_rmse: f64,
    /// Free run over the validation part, where there is one.
    pub validation_rmse: Option<f64>,
    /// Free run over the test part, where there is one.
    pub test_rmse: Option<f64>,
    /// Forecasts from filtered states over the validation part, by horizon (`PT1H`, `PT6H`, `PT24H`).
    pub ahead: IndexMap<String, AheadError>,
    /// Mean square of all 24-hour forecasts from midnight (UTC) in the validation part.
    pub day_ahead_mse: Option<f64>,
    /// Root mean square of the one-step innovations.
    pub noise_floor: Option<f64>,
    /// Free-run error over the innovation deviation of the AR model of the free-run residual.
    pub rho: Option<f64>,
}

/// A part of the window, in times.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Span {
    /// First instant, RFC 3339.
    pub from: String,
    /// Last instant, RFC 3339.
    pub to: String,
}

/// The parts of the window that were used for fitting and judging.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Parts {
    /// Estimation data.
    pub train: Span,
    /// Validation data, unseen by the search.
    pub validation: Option<Span>,
    /// Test data, unseen by search and gate.
    pub test: Option<Span>,
}

/// The result of an estimation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = FitBody)]
pub struct Fit {
    /// The model's readable identity.
    pub model: String,
    /// The model's content hash.
    pub model_hash: String,
    /// What was left out because its channels are not there.
    pub dropped: Vec<String>,
    /// Estimates by name, in the model's order.
    pub parameters: IndexMap<String, Estimate>,
    /// Pairs with a correlation above 0.95.
    pub correlated: Vec<CorrelatedPair>,
    /// How the estimates err together; `None` where the data do not say, or in fits of versions that did not
    /// keep it.
    #[serde(default)]
    pub covariance: Option<Covariance>,
    /// The name of the optimiser.
    pub method: String,
    /// The objective: `mse`, `swmse`, `nmse` or `likelihood`.
    pub objective: String,
    /// The best cost.
    pub cost: f64,
    /// Why the search ended.
    pub stopped_by: Stop,
    /// How widely was searched; `None` in fits of versions that always searched everywhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub searched: Option<Searched>,
    /// The seed of the search.
    pub seed: u64,
    /// Single-candidate simulations, those of Jacobian columns included.
    pub evaluations: usize,
    /// The way there.
    pub trace: Vec<TracePoint>,
    /// Errors by output channel.
    pub metrics: IndexMap<String, OutputMetrics>,
    /// Seconds between samples of the grid.
    pub sample_s: Seconds,
    /// Internal steps per sample.
    pub substeps: usize,
    /// Where the measured states of a free run start, by channel; none where a filter starts them, or in fits
    /// of versions that took the mean of the first three measurements.
    #[serde(default)]
    pub starts: IndexMap<String, StartEstimate>,
    /// Largest difference to a run with half the step, in the output's unit, or of several outputs in the
    /// noise of their sensors; `None` where one of the two left the numbers.
    pub discretisation_error: Option<f64>,
    /// Process noise of the filter, per square root of an hour.
    pub process_noise: f64,
    /// The parts of the window.
    pub parts: Parts,
    /// Hash of the stitched input.
    pub input_hash: String,
    /// What the problem was put together from; `None` in fits of versions that did not keep it.
    #[serde(default)]
    pub basis: Option<Basis>,
    /// In which circumstances its free run fails most, in a sentence; `None` where none stand out, or in fits
    /// of versions that did not look.
    #[serde(default)]
    pub worst_regime: Option<String>,
    /// A parameter that has changed within the weeks before, where nobody asked for the fit; `None` where
    /// none has, or nobody looked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed: Option<ParameterChange>,
    /// What was known of the parameters before any data; `None` where nothing was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prior: Option<KnownPrior>,
    /// What a user should know: bounds, correlations, parts dropped, weak convergence.
    pub remarks: Vec<String>,
    /// Parameters that were fixed at their nominal value because the data do not determine them.
    pub non_identifiable: Vec<String>,
    /// Level and spread of the channels that it was fitted to, by name; none in fits of versions that did not
    /// keep them.
    #[serde(default)]
    pub levels: IndexMap<String, ChannelLevel>,
    /// What the likelihood says, where it was maximised.
    #[serde(default)]
    pub likelihood: Option<LikelihoodReport>,
}

impl Fit {
    /// The parameter vector in the model's order.
    pub fn theta(&self) -> Vec<f64> {
        self.parameters.values().map(|estimate| estimate.value).collect()
    }

    /// The problem that it answers, stepped as it was found, and started so where the window begins with that
    /// of the fit.
    #[must_use]
    pub fn simulated(&self, problem: &Problem) -> Problem {
        let stepped = problem.with_substeps(self.substeps);
        let lead = self.basis.as_ref().map_or(0, |basis| basis.lead) as i64 * self.sample_s.millis();
        if rfc3339(problem.grid().start() + lead) != self.parts.train.from {
            return stepped;
        }
        let starts = self.starts.iter().map(|(channel, start)| (channel.clone(), start.value)).collect();
        stepped.with_starts(starts)
    }

    /// First and last instant of the measurements that it rests on, RFC 3339.
    pub fn window(&self) -> (&str, &str) {
        let last = [&self.parts.test, &self.parts.validation]
            .into_iter()
            .flatten()
            .next()
            .unwrap_or(&self.parts.train);
        (&self.parts.train.from, &last.to)
    }

    /// The metrics of the first output.
    pub fn first_metrics(&self) -> Option<&OutputMetrics> {
        self.metrics.values().next()
    }
}
