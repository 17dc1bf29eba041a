//! The shape of what no effect explains: heat that is missing by hour of the day, and a question to the
//! people of the house.

use super::null_model::NullModel;
use crate::data::DAY;
use crate::data::hour_of_day;
use crate::estimate::gate::physics::{jacobian, mean_inputs};
use crate::model::Initial;
use indexmap::IndexMap;

/// Heat that is missing at the room air by hour of the local day, in K/h, and a question in words.
///
/// What drives the residual e of a first-order room is de/dt + a e, where a is the rate at which the room air
/// forgets: minus the diagonal of the Jacobian.
pub(super) fn profile(
    null: &NullModel,
    states: &[Vec<f64>],
    error: &[f64],
) -> (Vec<Option<f64>>, Option<String>) {
    let problem = &null.problem;
    let theta = &null.fitted.plain;
    let Some(air) = problem.model().states().iter().position(|state| state.initial == Initial::Measured(0))
    else {
        return (vec![None; 24], None);
    };
    let mean = |series: &Vec<f64>| series.iter().sum::<f64>() / series.len().max(1) as f64;
    let states: Vec<f64> = states.iter().map(mean).collect();
    let forget = -jacobian(problem, &states, theta, &mean_inputs(problem))[(air, air)];
    let grid = problem.grid();
    let usable = problem.usable(0, problem.split().train.start..problem.split().validation.end);
    // Sums over whole hours: the slope's noise cancels within them.
    let span = ((1.0 / grid.step_hours()).round() as usize).max(1);
    let mut heat: Vec<Vec<(i64, f64)>> = vec![Vec::new(); 24];
    for pair in usable.windows(span + 1).step_by(span) {
        let (first, last) = (pair[0], pair[span]);
        if last - first == span {
            let hours = span as f64 * grid.step_hours();
            let level = pair.iter().map(|k| error[*k]).sum::<f64>() / pair.len() as f64;
            heat[hour_of_day(grid, first)].push((
                grid.time(first).div_euclid(DAY),
                (error[last] - error[first]) / hours + forget * level,
            ));
        }
    }
    let means: Vec<Option<f64>> = heat
        .iter()
        .map(|values| {
            (!values.is_empty())
                .then(|| values.iter().map(|(_, heat)| heat).sum::<f64>() / values.len() as f64)
        })
        .collect();
    (means, question(&heat))
}

/// The three hours of the day whose missing heat varies most, as a question to the people of the house.
fn question(heat: &[Vec<(i64, f64)>]) -> Option<String> {
    let spread = |hour: usize| {
        let values: Vec<f64> =
            (0..3).flat_map(|next| heat[(hour + next) % 24].iter().map(|(_, heat)| *heat)).collect();
        values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64
    };
    let hour = (0..24).max_by(|a, b| spread(*a).total_cmp(&spread(*b)))?;
    let mut days: IndexMap<i64, (f64, usize)> = IndexMap::new();
    for (day, value) in (0..3).flat_map(|next| &heat[(hour + next) % 24]) {
        let entry = days.entry(*day).or_insert((0.0, 0));
        *entry = (entry.0 + value, entry.1 + 1);
    }
    let means: Vec<f64> = days.values().map(|(sum, n)| sum / *n as f64).collect();
    let size = means.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let strong: Vec<f64> =
        means.iter().copied().filter(|mean| mean * size.signum() > 0.5 * size.abs()).collect();
    let typical = strong.iter().sum::<f64>() / strong.len().max(1) as f64;
    let what = if typical > 0.0 {
        "of heat that the model does not know"
    } else {
        "of cooling that the model does not know"
    };
    Some(format!(
        "about {:.1} K/h {what} on {} of {} days between {hour} and {} h: what happens then?",
        typical.abs(),
        strong.len(),
        means.len(),
        (hour + 3) % 24
    ))
}
