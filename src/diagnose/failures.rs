//! Where a model fails: which hours err most.

use super::residual::residual;
use crate::data::rfc3339;
use crate::estimate::Problem;
use crate::estimate::problem::mean_square;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Length of an episode in hours.
const EPISODE_HOURS: f64 = 6.0;
/// How many episodes are told.
const EPISODES: usize = 5;

/// Six hours in which the free run errs much.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// First instant, RFC 3339.
    pub from: String,
    /// Last instant.
    pub to: String,
    /// Mean of measured minus simulated, in the output's unit.
    pub bias: f64,
    /// Root mean square error.
    pub rmse: f64,
    /// Share of the squared error of the part.
    pub share: f64,
    /// Inputs that are unusual then: deviations from their mean over the part.
    pub context: IndexMap<String, f64>,
}

/// The worst episodes of a part, which do not overlap, the worst first.
pub fn episodes(problem: &Problem, theta: &[f64], range: Range<usize>) -> Vec<Episode> {
    let simulated = problem.simulate(theta);
    let error = residual(problem, &simulated.outputs[0]);
    let usable = problem.usable(0, range.clone());
    let length = ((EPISODE_HOURS / problem.grid().step_hours()) as usize).max(1);
    let total: f64 = usable.iter().map(|k| error[*k] * error[*k]).sum();
    let mut weight = vec![0.0; range.end + 1];
    usable.iter().for_each(|k| weight[*k + 1] = error[*k] * error[*k]);
    (1..weight.len()).for_each(|k| weight[k] += weight[k - 1]);
    let mut starts: Vec<(f64, usize)> =
        (range.start..range.end.saturating_sub(length)).map(|k| (weight[k + length] - weight[k], k)).collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<usize> = Vec::new();
    for (_, start) in starts {
        if chosen.iter().all(|other| other.abs_diff(start) >= length) {
            chosen.push(start);
        }
        if chosen.len() == EPISODES {
            break;
        }
    }
    let one = |start: usize| {
        let inside: Vec<f64> = usable.iter().filter(|k| (start..start + length).contains(*k)).map(|k| error[*k]).collect();
        if inside.is_empty() {
            return None;
        }
        let square = mean_square(&inside);
        Some(Episode {
            from: rfc3339(problem.grid().time(start)),
            to: rfc3339(problem.grid().time(start + length)),
            bias: inside.iter().sum::<f64>() / inside.len() as f64,
            rmse: square.sqrt(),
            share: square * inside.len() as f64 / total.max(f64::MIN_POSITIVE),
            context: context(problem, &range, start..start + length),
        })
    };
    chosen.into_iter().filter_map(one).collect()
}

/// Columns whose mean over an episode is more than a deviation from that over the part.
fn context(problem: &Problem, range: &Range<usize>, episode: Range<usize>) -> IndexMap<String, f64> {
    let mut unusual = IndexMap::new();
    for (channel, column) in problem.grid().columns() {
        let all = &column.values()[range.clone()];
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let deviation = (all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / all.len() as f64).sqrt();
        let here = &column.values()[episode.start..episode.end.min(range.end)];
        let score = (here.iter().sum::<f64>() / here.len().max(1) as f64 - mean) / deviation;
        if score.is_finite() && score.abs() > 1.0 {
            unusual.insert(channel.to_owned(), (100.0 * score).round() / 100.0);
        }
    }
    unusual
}
