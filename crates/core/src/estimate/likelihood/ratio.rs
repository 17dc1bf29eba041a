//! The likelihood-ratio test of nested models.

use crate::estimate::fit::Fit;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use utoipa::ToSchema;

/// Tests whether the larger of two nested models, fitted to the same measurements, explains more than chance
/// would. `None` where they are not comparable: without likelihoods, with different innovations, or when the
/// larger one has no more parameters.
pub fn likelihood_ratio(smaller: &Fit, larger: &Fit) -> Option<LikelihoodRatio> {
    let (a, b) = (smaller.likelihood.as_ref()?, larger.likelihood.as_ref()?);
    if a.innovations != b.innovations {
        return None;
    }
    ratio(
        2.0 * (b.log_likelihood - a.log_likelihood),
        b.estimated.checked_sub(a.estimated)?,
        1,
        [&smaller.model, &larger.model],
    )
}

/// The likelihood-ratio test of a model against one that is nested in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LikelihoodRatio {
    /// Twice the gain in log-likelihood.
    pub statistic: f64,
    /// How many numbers more the larger model estimates.
    pub degrees_of_freedom: usize,
    /// How often a gain this large would come by chance if the smaller model were true, from the chi-squared
    /// distribution (Wilks, Ann. Math. Stat. 9, 1938). Where the larger model is the best of several, times
    /// their number.
    pub p: f64,
    /// All of this in a sentence.
    pub sentence: String,
}

/// The test of a gain in twice the log-likelihood; where it is the best of several, their number multiplies
/// the probability.
pub(super) fn ratio(
    gain: f64,
    degrees_of_freedom: usize,
    tried: usize,
    names: [&str; 2],
) -> Option<LikelihoodRatio> {
    let chi = ChiSquared::new(degrees_of_freedom as f64).ok()?;
    // The larger model can always do as well; less is a search that fell short.
    let statistic = gain.max(0.0);
    let p = (chi.sf(statistic) * tried as f64).min(1.0);
    let more = if degrees_of_freedom == 1 {
        "one parameter more".to_owned()
    } else {
        format!("{degrees_of_freedom} parameters more")
    };
    let chance = if p < 1e-4 { "less than 1 in 10,000".to_owned() } else { format!("{:.2} %", 100.0 * p) };
    let [smaller, larger] = names;
    let sentence = if gain < -0.01 {
        format!(
            "{larger} contains {smaller} but reached a lower likelihood: its search fell short, and the test \
            says nothing"
        )
    } else if p < SIGNIFICANT {
        format!(
            "{larger} explains more than {smaller}: twice the log-likelihood rises by {statistic:.1} for \
            {more}, which chance alone would do with a probability of {chance}"
        )
    } else {
        format!(
            "nothing speaks for {larger} over {smaller}: twice the log-likelihood rises by {statistic:.1} \
            for {more}, which chance alone would do with a probability of {chance}"
        )
    };
    Some(LikelihoodRatio { statistic, degrees_of_freedom, p, sentence })
}

/// The level at which a model is called better than the one that is nested in it.
pub const SIGNIFICANT: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ratio_is_that_of_the_tables() {
        let tested = |gain, degrees| ratio(gain, degrees, 1, ["ti", "tite"]).unwrap();
        // Upper quantiles of chi-squared.
        for (statistic, degrees, p) in
            [(3.841_458_8, 1, 0.05), (5.991_464_5, 2, 0.05), (16.266_236, 3, 0.001)]
        {
            assert!((tested(statistic, degrees).p - p).abs() < 1e-7);
        }
        assert!(tested(20.0, 1).sentence.starts_with("tite explains more than ti"));
        assert!(tested(1.0, 2).sentence.starts_with("nothing speaks for tite"));
        assert!(tested(-3.0, 2).sentence.contains("fell short"));
        assert!(ratio(3.0, 0, 1, ["a", "b"]).is_none());
        assert!((ratio(3.841_458_8, 1, 10, ["a", "b"]).unwrap().p - 0.5).abs() < 1e-6);
    }
}
