//! Learnt as promised? The widths that a plan has promised beside those of a record that has the experiment.

use super::information::{Knowledge, PERCENT};
use crate::estimate::Problem;
use crate::fault::Fault;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Widths that differ by no more than this share are as promised.
const AS_PROMISED: f64 = 0.25;

/// The width of a 95 % interval that a plan has promised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PromisedWidth {
    /// The parameter.
    pub parameter: String,
    /// The width.
    pub width: f64,
    /// Its unit: the parameter's own, or per cent of the estimate.
    pub width_unit: String,
}

/// What became of a promise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Learnt {
    /// The parameter.
    pub parameter: String,
    /// The estimate by segments of hours, in its unit.
    pub value: f64,
    /// The unit of the widths.
    pub width_unit: String,
    /// The width that was promised.
    pub promised: f64,
    /// The width that came.
    pub found: f64,
    /// Whether it is at most a quarter wider than promised.
    pub kept: bool,
    /// All of this in a sentence.
    pub sentence: String,
}

/// Compares what was promised with what a problem knows whose record has the experiment, from the parameters
/// of its fit on.
///
/// # Errors
/// A fault of a parameter that is not estimated, and those of [`Knowledge::of`].
pub fn learnt(
    problem: &Problem,
    theta: &[f64],
    promised: &[PromisedWidth],
) -> Result<Vec<Learnt>, Vec<Fault>> {
    let parameters = problem.model().parameters();
    let mut faults = Vec::new();
    let mut places = Vec::new();
    for (at, one) in promised.iter().enumerate() {
        let place = parameters.iter().position(|parameter| parameter.name == one.parameter);
        match place.filter(|place| problem.free().contains(place)) {
            Some(place) => places.push(place),
            None => {
                let detail = format!("`{}` is no estimated parameter of the model", one.parameter);
                faults.push(Fault::new(format!("/promised/{at}"), "unknown-parameter", detail));
            }
        }
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    let one = |fault| vec![fault];
    let in_own_unit = |(_, promised): &(&usize, &PromisedWidth)| promised.width_unit != PERCENT;
    let may_be_nothing: Vec<usize> =
        places.iter().zip(promised).filter(in_own_unit).map(|(place, _)| *place).collect();
    let known = Knowledge::of(problem, theta, &may_be_nothing).map_err(one)?;
    let covariance = known.covariance().map_err(one)?;
    let compared = |(index, promised): (&usize, &PromisedWidth)| {
        let place = known.place(*index)?;
        let (found, unit) = known.width(problem, place, covariance[(place, place)].max(0.0).sqrt());
        let kept = found <= (1.0 + AS_PROMISED) * promised.width;
        let name = parameters[*index].name.clone();
        let verdict = if kept { "as promised" } else { "less than promised" };
        let sentence = format!(
            "{name}: learnt {verdict}; the interval is {found:.2} {unit} wide, {:.2} were promised.",
            promised.width
        );
        Some(Learnt {
            parameter: name,
            value: known.theta[*index],
            width_unit: unit.to_owned(),
            promised: promised.width,
            found,
            kept,
            sentence,
        })
    };
    Ok(places.iter().zip(promised).filter_map(compared).collect())
}
