//! What a maximised likelihood says, as the part of a fit's document, and the test of nested models.

use super::fit::Fit;
use crate::model::Model;
use crate::optimise::Origin;
use crate::schema::Interval;
use crate::simulate::kalman::Noise;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use utoipa::ToSchema;

/// The level at which a model is called better than the one that is nested in it.
pub const SIGNIFICANT: f64 = 0.05;

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
    /// Whether the value lies within one per cent of a bound, on the logarithmic scale. A diffusion on its lower bound is
    /// one that the data do not ask for.
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
    /// Where it falls by 1.92, half the 95 % quantile of chi-squared; `None` on a side where the profile does not reach that far.
    pub ci95: [Option<f64>; 2],
}

/// A local run of the search, from its start to its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = LikelihoodStart)]
pub struct StartReport {
    /// Where it came from: `warm` (the parameters in use, or the nominal ones), `cluster`, `random`, or `profile`: a point
    /// of a profile that was better than the optimum.
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

/// What the likelihood says of a fit. Estimated are the free parameters, a diffusion per state and a standard deviation per
/// output.
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
    /// Whether the steps between samples are exact, as for equations that are linear in the states; otherwise the filter
    /// is the extended one.
    pub exact: bool,
    /// The diffusion of each state.
    #[schema(value_type = HashMap<String, NoiseEstimate>)]
    pub diffusion: IndexMap<String, NoiseEstimate>,
    /// The standard deviation of each measured channel.
    #[schema(value_type = HashMap<String, NoiseEstimate>)]
    pub measurement: IndexMap<String, NoiseEstimate>,
    /// Standard errors from the curvature at the optimum, in the unit of each; `None` where the data do not determine it.
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
    /// The noise for a filter of a model; `None` where it has other states or outputs than the model that was estimated.
    pub fn noise(&self, model: &Model) -> Option<Noise> {
        let value = |of: &IndexMap<String, NoiseEstimate>, name: &str| of.get(name).map(|sigma| sigma.value);
        let states = model.states().iter().map(|state| value(&self.diffusion, &state.name));
        let outputs = model.outputs().iter().map(|output| value(&self.measurement, &output.channel).map(|sigma| sigma.powi(2)));
        Some(Noise { process: states.collect::<Option<_>>()?, measurement: outputs.collect::<Option<_>>()? })
    }
}

/// The likelihood-ratio test of a model against one that is nested in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LikelihoodRatio {
    /// Twice the gain in log-likelihood.
    pub statistic: f64,
    /// How many numbers more the larger model estimates.
    pub degrees_of_freedom: usize,
    /// How often a gain this large would come by chance if the smaller model were true, from the chi-squared distribution
    /// (Wilks, Ann. Math. Stat. 9, 1938). Where the larger model is the best of several, times their number.
    pub p: f64,
    /// All of this in a sentence.
    pub sentence: String,
}

/// Tests whether the larger of two nested models, fitted to the same measurements, explains more than chance would. `None`
/// where they are not comparable: without likelihoods, with different innovations, or when the larger one has no more
/// parameters.
pub fn likelihood_ratio(smaller: &Fit, larger: &Fit) -> Option<LikelihoodRatio> {
    let (a, b) = (smaller.likelihood.as_ref()?, larger.likelihood.as_ref()?);
    if a.innovations != b.innovations {
        return None;
    }
    ratio(2.0 * (b.log_likelihood - a.log_likelihood), b.estimated.checked_sub(a.estimated)?, 1, [&smaller.model, &larger.model])
}

/// The test of a gain in twice the log-likelihood; where it is the best of several, their number multiplies the probability.
pub(super) fn ratio(gain: f64, degrees_of_freedom: usize, tried: usize, names: [&str; 2]) -> Option<LikelihoodRatio> {
    let chi = ChiSquared::new(degrees_of_freedom as f64).ok()?;
    // The larger model can always do as well; less is a search that fell short.
    let statistic = gain.max(0.0);
    let p = (chi.sf(statistic) * tried as f64).min(1.0);
    let more = if degrees_of_freedom == 1 { "one parameter more".to_owned() } else { format!("{degrees_of_freedom} parameters more") };
    let chance = if p < 1e-4 { "less than 1 in 10,000".to_owned() } else { format!("{:.2} %", 100.0 * p) };
    let [smaller, larger] = names;
    let sentence = if gain < -0.01 {
        format!("{larger} contains {smaller} but reached a lower likelihood: its search fell short, and the test says nothing")
    } else if p < SIGNIFICANT {
        format!(
            "{larger} explains more than {smaller}: twice the log-likelihood rises by {statistic:.1} for {more}, which chance alone would do with a probability of {chance}"
        )
    } else {
        format!(
            "nothing speaks for {larger} over {smaller}: twice the log-likelihood rises by {statistic:.1} for {more}, which chance alone would do with a probability of {chance}"
        )
    };
    Some(LikelihoodRatio { statistic, degrees_of_freedom, p, sentence })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ratio_is_that_of_the_tables() {
        let tested = |gain, degrees| ratio(gain, degrees, 1, ["ti", "tite"]).unwrap();
        // Upper quantiles of chi-squared.
        for (statistic, degrees, p) in [(3.841_458_8, 1, 0.05), (5.991_464_5, 2, 0.05), (16.266_236, 3, 0.001)] {
            assert!((tested(statistic, degrees).p - p).abs() < 1e-7);
        }
        assert!(tested(20.0, 1).sentence.starts_with("tite explains more than ti"));
        assert!(tested(1.0, 2).sentence.starts_with("nothing speaks for tite"));
        assert!(tested(-3.0, 2).sentence.contains("fell short"));
        assert!(ratio(3.0, 0, 1, ["a", "b"]).is_none());
        assert!((ratio(3.841_458_8, 1, 10, ["a", "b"]).unwrap().p - 0.5).abs() < 1e-6);
    }
}
