//! What a maximised likelihood says, as the part of a fit's document, and the test of nested models.

use crate::model::Model;
use crate::optimise::Origin;
use crate::schema::Interval;
use crate::simulate::kalman::Noise;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A standard deviation of the stochastic model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NoiseEstimate {
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// The 95 % confidence interval; `None` where the data do not determine it.
    #[schema(value_type = Option<Interval>)]
    pub ci95: Option<[f64; 2]>,
    /// The interval that was searched.
    #[schema(value_type = Interval)]
    pub bounds: [f64; 2],
    /// Whether the value lies within one per cent of a bound, on the logarithmic scale. A diffusion on its
    /// lower bound is one that the data do not ask for.
    pub at_bound: bool,
}

/// The likelihood along one parameter, with all others at their best.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = LikelihoodProfile)]
pub struct Profile {
    /// Values of the parameter, ascending, the estimate among them.
    pub values: Vec<f64>,
    /// The largest log-likelihood at each.
    pub log_likelihood: Vec<f64>,
    /// Where it falls by 1.92, half the 95 % quantile of chi-squared; `None` on a side where the profile does
    /// not reach that far.
    pub ci95: [Option<f64>; 2],
}

/// A local run of the search, from its start to its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = LikelihoodStart)]
pub struct StartReport {
    /// Where it came from: `warm` (the parameters in use, or the nominal ones), `cluster`, `random`, or
    /// `profile`: a point of a profile that was better than the optimum.
    pub origin: Origin,
    /// Log-likelihood at the start; `None` where it could not be computed.
    pub from: Option<f64>,
    /// Log-likelihood at the end.
    pub to: Option<f64>,
    /// Filter passes.
    pub passes: usize,
    /// Whether it ended at an optimum, rather than short of it or on the way of a better run.
    pub settled: bool,
}

/// What the likelihood says of a fit. Estimated are the free parameters, a diffusion per state and a standard
/// deviation per output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Likelihood)]
pub struct LikelihoodReport {
    /// Its natural logarithm, constants included, over the training part.
    pub log_likelihood: f64,
    /// One-step innovations that it is made of.
    pub innovations: usize,
    /// How many numbers were estimated.
    pub estimated: usize,
    /// Akaike's criterion, `2 k - 2 l`.
    pub aic: f64,
    /// Schwarz's criterion, `k ln n - 2 l`.
    pub bic: f64,
    /// Whether the steps between samples are exact, as for equations that are linear in the states; otherwise
    /// the filter is the extended one.
    pub exact: bool,
    /// The diffusion of each state.
    #[schema(value_type = HashMap<String, NoiseEstimate>)]
    pub diffusion: IndexMap<String, NoiseEstimate>,
    /// The standard deviation of each measured channel.
    #[schema(value_type = HashMap<String, NoiseEstimate>)]
    pub measurement: IndexMap<String, NoiseEstimate>,
    /// Standard errors from the curvature at the optimum, in the unit of each; `None` where the data do not
    /// determine it.
    #[schema(value_type = HashMap<String, Option<f64>>)]
    pub standard_errors: IndexMap<String, Option<f64>>,
    /// Correlations of the estimates, in the order of `standard_errors`, by rows.
    pub correlations: Vec<Vec<f64>>,
    /// Profile likelihoods of the parameters.
    #[schema(value_type = HashMap<String, Profile>)]
    pub profiles: IndexMap<String, Profile>,
    /// Every local run of the search.
    pub starts: Vec<StartReport>,
    /// Why the search ended, in a sentence.
    pub reason: String,
}

impl LikelihoodReport {
    /// The noise for a filter of a model; `None` where it has other states or outputs than the model that was
    /// estimated.
    pub fn noise(&self, model: &Model) -> Option<Noise> {
        let value = |of: &IndexMap<String, NoiseEstimate>, name: &str| of.get(name).map(|sigma| sigma.value);
        let states = model.states().iter().map(|state| value(&self.diffusion, &state.name));
        let outputs = model
            .outputs()
            .iter()
            .map(|output| value(&self.measurement, &output.channel).map(|sigma| sigma.powi(2)));
        Some(Noise { process: states.collect::<Option<_>>()?, measurement: outputs.collect::<Option<_>>()? })
    }
}
