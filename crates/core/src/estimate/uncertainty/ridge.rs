//! What lies along a ridge: one parameter of a pair that the data can hardly tell apart is held at values
//! about its estimate and all others are estimated again (a profile; Raue et al. 2009, Bioinformatics 25,
//! 1923-1929).

use crate::estimate::assess::summary::digits;
use crate::estimate::fit::{CorrelatedPair, RidgePoint};
use crate::estimate::problem::Problem;
use crate::estimate::search::control::{Control, EstimateError};
use crate::estimate::search::drive::polish;
use crate::estimate::uncertainty::Uncertainty;
use crate::model::Model;

/// So many pairs are followed, the closest ones.
const PAIRS: usize = 2;
/// Values on either side of an estimate.
const POINTS: usize = 2;
/// They go as far as the 95 % interval is wide, and at most so far, as a share of the box.
const FARTHEST: f64 = 0.25;
/// Simulations for each value.
const EVALUATIONS: usize = 60;
/// By how much the error may rise where a ridge is as good as its middle.
const AS_GOOD: f64 = 1.01;

/// Follows the ridges of the closest pairs, and tells how many simulations that has taken.
///
/// # Errors
/// [`EstimateError::Interrupted`] where the estimation was cancelled. A deadline leaves out what it left no
/// time for.
pub(in crate::estimate) fn follow(
    problem: &Problem,
    theta: &[f64],
    cost: f64,
    known: &mut Uncertainty,
    control: &Control,
) -> Result<usize, EstimateError> {
    let Uncertainty { ci95, correlated, .. } = known;
    let mut closest: Vec<&mut CorrelatedPair> = correlated.iter_mut().collect();
    closest.sort_by(|a, b| b.correlation.abs().total_cmp(&a.correlation.abs()));
    let dimensions = problem.space().dimensions();
    let mut evaluations = 0;
    for pair in closest.into_iter().take(PAIRS) {
        let place = |name: &String| dimensions.iter().position(|dimension| dimension.name == *name);
        let [Some(held), Some(other)] = pair.parameters.each_ref().map(place) else { continue };
        // How well each is determined, as a share of its box.
        let [width, follows] = [held, other].map(|place| {
            ci95[place]
                .map_or(FARTHEST, |[low, high]| dimensions[place].unit(high) - dimensions[place].unit(low))
        });
        let slope = if width > 0.0 { pair.correlation * follows / width } else { 0.0 };
        let step = width.min(FARTHEST) / POINTS as f64;
        let walk = |step: f64| side(problem, theta, [held, other], [step, slope * step], control);
        let (below, above) = rayon::join(|| walk(-step), || walk(step));
        let ((below, first), (above, second)) = (below?, above?);
        evaluations += first + second;
        let values = [held, other].map(|place| theta[problem.free()[place]]);
        pair.ridge = below.into_iter().rev().chain([RidgePoint { values, cost }]).chain(above).collect();
    }
    Ok(evaluations)
}

/// One side of a ridge, from the estimate outwards, and the simulations that it has taken. The other
/// parameter starts from where the ridge leads; steps are shares of the boxes.
fn side(
    problem: &Problem,
    theta: &[f64],
    pair: [usize; 2],
    steps: [f64; 2],
    control: &Control,
) -> Result<(Vec<RidgePoint>, usize), EstimateError> {
    // What is found on the way is no news of the search.
    let control = Control { interrupt: control.interrupt, progress: &|_| () };
    let dimensions = pair.map(|place| &problem.space().dimensions()[place]);
    let [held, other] = pair.map(|place| problem.free()[place]);
    let (mut points, mut evaluations) = (Vec::new(), 0);
    let mut here = theta.to_vec();
    for _ in 0..POINTS {
        let before = here[held];
        for ((dimension, step), index) in dimensions.into_iter().zip(steps).zip([held, other]) {
            here[index] = dimension.value((dimension.unit(here[index]) + step).clamp(0.0, 1.0));
        }
        if here[held] == before {
            break;
        }
        let Some(found) = polish(&problem.with_fixed(&[(held, here[held])]), &here, EVALUATIONS, &control)?
        else {
            break;
        };
        evaluations += found.evaluations;
        here = found.theta;
        points.push(RidgePoint { values: [here[held], here[other]], cost: found.cost });
    }
    Ok((points, evaluations))
}

/// What a pair means for an operator: how far its ridge goes, and what would tell the two apart where their
/// documents say it.
pub fn sentence(pair: &CorrelatedPair, model: &Model) -> String {
    let [a, b] = &pair.parameters;
    let correlation = pair.correlation;
    let excite = |name: &String| {
        model.parameters().iter().find(|parameter| parameter.name == *name)?.excite.as_deref()
    };
    let mut ways: Vec<&str> = pair.parameters.iter().filter_map(excite).collect();
    ways.dedup();
    let along = along(pair);
    if ways.is_empty() {
        return format!(
            "{a} and {b} move together (correlation {correlation:.2}){along}: trust their effect, not their \
            separate values"
        );
    }
    let ways = ways.join(" or ");
    format!(
        "{a} and {b} can hardly be told apart with these data (correlation {correlation:.3}){along}: {ways} \
        would separate them"
    )
}

/// How far the error hardly changes along a ridge; nothing where it was not followed, or has sides that are
/// steep.
fn along(pair: &CorrelatedPair) -> String {
    let least = pair.ridge.iter().map(|point| point.cost).fold(f64::INFINITY, f64::min);
    let flat: Vec<&RidgePoint> =
        pair.ridge.iter().filter(|point| point.cost <= AS_GOOD * AS_GOOD * least).collect();
    let (Some(first), Some(last)) = (flat.first(), flat.last()) else { return String::new() };
    if flat.len() < 2 {
        return String::new();
    }
    let ([a, b], percent) = (&pair.parameters, 100.0 * (AS_GOOD - 1.0));
    let [from, to] = [first, last].map(|point| point.values.map(|value| digits(value, 3.0)));
    format!(
        "; with {a} from {} to {} and {b} from {} to {} the error rises by less than {percent:.0} %",
        from[0], to[0], from[1], to[1]
    )
}
