//! Where a model fails: which hours err most, in which circumstances, with which input, over which horizon.
//!
//! Free runs show where; only innovations show whether anything is left to explain (reference: missing-effects 6).

use super::regimes::{Regime, regimes};
use super::residual::residual;
use super::spectrum::{InputLag, Spectrum, input_lags, spectrum};
use crate::data::rfc3339;
use crate::estimate::Problem;
use crate::estimate::metrics::FilterRun;
use crate::estimate::problem::mean_square;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use utoipa::ToSchema;

/// Length of an episode in hours.
const EPISODE_HOURS: f64 = 6.0;
/// How many episodes are told.
const EPISODES: usize = 5;

/// Six hours in which the free run errs much.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Episode {
    /// First instant, RFC 3339.
    #[schema(format = DateTime)]
    pub from: String,
    /// Last instant.
    #[schema(format = DateTime)]
    pub to: String,
    /// Mean of measured minus simulated, in the output's unit.
    pub bias: f64,
    /// Root mean square error.
    pub rmse: f64,
    /// Share of the squared error of the part.
    pub share: f64,
    /// Inputs that are unusual then: deviations from their mean over the part.
    #[schema(value_type = HashMap<String, f64>)]
    pub context: IndexMap<String, f64>,
}

/// Where a free run fails. Errors are measured minus simulated, in the unit of the first output.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Failures {
    /// In plain sentences, the most telling first.
    #[serde(skip)]
    pub summary: Vec<String>,
    /// Errors by circumstances.
    pub by_regime: Vec<Regime>,
    /// Mean error by day and hour.
    pub hour_by_date: Vec<DayOfErrors>,
    /// The worst six hours, several times.
    pub episodes: Vec<Episode>,
    /// The residual against each input, with the lag at which they go together most.
    pub residual_by_input: Vec<InputLag>,
    /// Autocorrelation and cumulated periodogram of the one-step innovations.
    pub innovations: Spectrum,
}

/// Mean errors of a day by hour, UTC; `None` where nothing is comparable.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct DayOfErrors {
    /// The day, as the instant of its midnight.
    #[schema(format = DateTime)]
    pub date: String,
    /// 24 means.
    pub hours: Vec<Option<f64>>,
}

/// Where the free run fails, and what is left in the innovations of a filter. `unit` is that of the errors, `seed`
/// fixes the resampling of the intervals.
pub fn failures(problem: &Problem, theta: &[f64], run: &FilterRun, unit: &str, seed: u64) -> Failures {
    let simulated = problem.simulate(theta);
    let error = residual(problem, &simulated.outputs[0]);
    let all = 0..problem.grid().len();
    let usable = problem.usable(0, all.clone());
    let by_regime = regimes(problem, &error, &usable, seed);
    let episodes = episodes(problem, theta, all);
    Failures {
        summary: sentences(unit, &by_regime, &episodes),
        hour_by_date: hour_by_date(problem, &error, &usable),
        by_regime,
        episodes,
        residual_by_input: input_lags(problem, &error, &usable),
        innovations: run.filtered.innovations.first().map(|series| spectrum(series)).unwrap_or_default(),
    }
}

fn hour_by_date(problem: &Problem, error: &[f64], usable: &[usize]) -> Vec<DayOfErrors> {
    let grid = problem.grid();
    let mut sums: IndexMap<i64, [(f64, usize); 24]> = IndexMap::new();
    for k in usable {
        let time = grid.time(*k);
        let hours = sums.entry(time.div_euclid(86_400)).or_insert([(0.0, 0); 24]);
        let (sum, count) = &mut hours[(time.rem_euclid(86_400) / 3600) as usize];
        (*sum, *count) = (*sum + error[*k], *count + 1);
    }
    let mean = |(sum, count): &(f64, usize)| (*count > 0).then(|| sum / *count as f64);
    sums.iter().map(|(day, hours)| DayOfErrors { date: rfc3339(day * 86_400), hours: hours.iter().map(mean).collect() }).collect()
}

/// What a user should read first. A regime is told where its interval leaves zero out.
fn sentences(unit: &str, regimes: &[Regime], episodes: &[Episode]) -> Vec<String> {
    let sure = |regime: &&Regime| regime.bias_ci95.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
    let told = |regime: &Regime| {
        let word = if regime.bias > 0.0 { "above" } else { "below" };
        format!(
            "With {} the measurements are {:.2} {unit} {word} the model: {:.0} % of the time, {:.0} % of the squared error.",
            regime.regime,
            regime.bias.abs(),
            100.0 * regime.time_share,
            100.0 * regime.error_share
        )
    };
    let mut sentences: Vec<String> = regimes.iter().filter(sure).take(3).map(told).collect();
    if let Some(worst) = episodes.first() {
        sentences.push(format!("The worst six hours begin at {}: {:+.2} {unit} on average.", worst.from, worst.bias));
    }
    sentences
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
