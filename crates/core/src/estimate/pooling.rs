//! What the systems of a building have in common: where a parameter of one more of them is taken to lie.
//!
//! ```text
//! fits of the siblings --what their data alone say--> value, variance of each --pooled--> KnownPrior
//! ```
//!
//! The parameters of the siblings are draws from a normal distribution (of logarithms, where they are
//! searched on a logarithmic scale), of which each fit shows one with an error of its own. Its mean and
//! variance are estimated by moments (DerSimonian and Laird 1986, Controlled Clinical Trials 7, 177-188:
//! random effects); a further system is another draw. That is partial pooling: a system with much data
//! keeps its own estimates, one with little gets those of its siblings.

use super::fit::Fit;
use super::problem::prior::{KnownParameter, KnownPrior};
use super::segments::is_start;
use crate::estimate::Problem;
use crate::model::{Parameter, Scale};
use indexmap::IndexMap;

/// A parameter is known from so many siblings on.
pub const FEWEST: usize = 3;
/// Systems differ by this at least, in the logarithm of a parameter, however alike a few of them look; and
/// by this share of the interval of one on a linear scale.
const LEAST_LOG: f64 = 0.1;
const LEAST_SHARE: f64 = 0.02;

/// What one sibling says of a parameter, on the scale of the search.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Said {
    value: f64,
    variance: f64,
}

/// What the fits of siblings, by their names, say of the parameters of a problem. Where a state starts is a
/// matter of each window, and not of the building. `None` where nothing is known from [`FEWEST`] of them.
pub fn pooled(problem: &Problem, siblings: &[(String, Fit)]) -> Option<KnownPrior> {
    let mut parameters = IndexMap::new();
    for index in problem.free().iter().filter(|index| !is_start(problem, **index)) {
        let parameter = &problem.model().parameters()[*index];
        let said: Vec<Said> = siblings.iter().flat_map(|(_, fit)| said(parameter, fit)).collect();
        let [lower, upper] = problem.bounds()[*index];
        let least = match parameter.scale {
            Scale::Log => LEAST_LOG,
            Scale::Linear => LEAST_SHARE * (upper - lower),
        };
        if let Some(Said { value, variance }) = one_more(&said, least) {
            let value = if parameter.scale == Scale::Log { value.exp() } else { value };
            let known = KnownParameter { value: value.clamp(lower, upper), deviation: variance.sqrt() };
            parameters.insert(parameter.name.clone(), known);
        }
    }
    let from = siblings.iter().map(|(name, _)| name.clone()).collect();
    (!parameters.is_empty()).then_some(KnownPrior { from, parameters })
}

/// The name that the members of a family share: each wall to a neighbour is a draw of its own.
pub fn family(name: &str) -> &str {
    name.split('[').next().unwrap_or(name)
}

/// What the data of a fit say of a parameter, or of each of its family.
fn said(parameter: &Parameter, fit: &Fit) -> Vec<Said> {
    let names = fit.parameters.keys().filter(|name| family(name) == family(&parameter.name));
    names.filter_map(|name| of_data(parameter.scale, name, fit)).collect()
}

/// What the data of a fit alone say of a parameter: what it was drawn to itself is taken away again, so that
/// siblings do not confirm each other night after night. `None` where that is nothing.
fn of_data(scale: Scale, name: &str, fit: &Fit) -> Option<Said> {
    let estimate = fit.parameters.get(name).filter(|one| !one.fixed && !one.at_bound)?;
    let covariance = fit.covariance.as_ref()?;
    let place = covariance.parameters.iter().position(|known| known == name)?;
    let variance = covariance.matrix[place][place];
    let is_log = scale == Scale::Log;
    let on_scale = |value: f64| if is_log { value.ln() } else { value };
    let value = on_scale(estimate.value);
    let variance = if is_log { variance / estimate.value.powi(2) } else { variance };
    let known = fit.prior.as_ref().and_then(|prior| prior.parameters.get(name));
    let alone = match known {
        Some(known) => {
            let (middle, drawn) = (on_scale(known.value), known.deviation.powi(2));
            let weight = 1.0 / variance - 1.0 / drawn;
            Said { value: (value / variance - middle / drawn) / weight, variance: 1.0 / weight }
        }
        None => Said { value, variance },
    };
    (alone.value.is_finite() && alone.variance.is_finite() && alone.variance > 0.0).then_some(alone)
}

/// Where one more is taken to lie: the mean of the draws, with their variance and that of the mean.
fn one_more(said: &[Said], least: f64) -> Option<Said> {
    let count = said.len();
    if count < FEWEST {
        return None;
    }
    let mean = |between: f64| {
        let weights: f64 = said.iter().map(|one| 1.0 / (one.variance + between)).sum();
        let sum: f64 = said.iter().map(|one| one.value / (one.variance + between)).sum();
        (sum / weights, weights)
    };
    let (middle, weights) = mean(0.0);
    let scatter: f64 = said.iter().map(|one| (one.value - middle).powi(2) / one.variance).sum();
    let squares: f64 = said.iter().map(|one| one.variance.powi(-2)).sum();
    let between = (scatter - (count - 1) as f64) / (weights - squares / weights);
    let between = between.max(least.powi(2));
    let (middle, weights) = mean(between);
    let found = Said { value: middle, variance: between + 1.0 / weights };
    (found.value.is_finite() && found.variance.is_finite()).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_with_errors_of_their_own_give_the_distribution_behind_them() {
        // The example of Borenstein et al. 2009, Introduction to Meta-Analysis, table 14.1 (Hedges' g of six
        // studies): tau^2 = .0372 and a mean of .3582 with a variance of .0111.
        let table = [
            (0.0945, 0.0329),
            (0.2774, 0.0307),
            (0.3665, 0.0499),
            (0.6644, 0.0105),
            (0.4618, 0.0432),
            (0.1852, 0.0234),
        ];
        let said = table.map(|(value, variance)| Said { value, variance });
        let found = one_more(&said, 0.0).unwrap();
        assert!((found.value - 0.3582).abs() < 1e-3, "{found:?}");
        assert!((found.variance - (0.0372 + 0.0111)).abs() < 1e-3, "{found:?}");
        // However alike they are, a further one may differ.
        let alike = [Said { value: 1.0, variance: 1e-6 }; 5];
        let found = one_more(&alike, 0.1).unwrap();
        assert!((found.value - 1.0).abs() < 1e-12 && found.variance > 0.01, "{found:?}");
        assert_eq!(one_more(&alike[..2], 0.1), None);
    }
}
