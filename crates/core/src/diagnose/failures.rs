//! Where a model fails: which hours err most, in which circumstances, with which input, over which horizon.
//!
//! Free runs show where; only innovations show whether anything is left to explain (reference:
//! missing-effects 6).

use super::spectrum::{InputLag, Spectrum, input_lags, spectrum};
use crate::data::{Grid, Window, is_compass, local_zone, rfc3339};
use crate::estimate::assess::metrics::FilterRun;
use crate::estimate::assess::regimes::{
    Regime, circumstances, free_run_errors, regimes, sentence, small, telling,
};
use crate::estimate::problem::mean_square;
use crate::estimate::problem::widen::widen;
use crate::estimate::{Fit, Problem, Site};
use crate::fault::Fault;
use crate::units::error_unit;
use indexmap::IndexMap;
use jiff::Timestamp;
use jiff::civil::Date;
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
    /// Channels that are unusual then: how many standard deviations they lie from their mean.
    #[schema(value_type = HashMap<String, f64>)]
    pub context: IndexMap<String, f64>,
}

/// Where the free run of a fit fails. Errors are residuals of one output of the model, measured minus
/// simulated, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Failures {
    /// The free run of the output by circumstances, over the fit's window and in the light of all channels,
    /// the most telling first. All errors are measured minus simulated.
    pub by_regime: Vec<Regime>,
    /// Its mean error by day and hour of the local clock.
    pub hour_by_date: Vec<DayOfErrors>,
    /// Its worst six hours, several times, with the channels that are unusual then.
    pub episodes: Vec<Episode>,
    /// Its residual against each measured channel, with the lag at which they go together most.
    pub residual_by_input: Vec<InputLag>,
    /// Autocorrelation and cumulated periodogram of the one-step innovations.
    pub innovations: Spectrum,
}

/// Mean errors of a day by hour of the clock on the wall; `None` where nothing is comparable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DayOfErrors {
    /// The day, such as `2026-01-31`.
    pub date: String,
    /// 24 means; an hour that a clock change repeats is one of them.
    pub hours: Vec<Option<f64>>,
}

/// Where the free run of a fit fails over its window, in the light of everything that was measured, whether
/// the model uses it or not. `output` counts the model's outputs, `run` is the filter over the window at the
/// fit; the fit's seed fixes the resampling of the intervals.
///
/// # Errors
/// A fault where the window does not fit the problem, or its time zone is unknown.
pub fn failures(
    problem: &Problem,
    fit: &Fit,
    output: usize,
    run: &FilterRun,
    window: &Window,
) -> Result<Failures, Fault> {
    let (grid, _) = widen(problem, window, &Site::of(problem.basis()))?;
    let (error, usable) = free_run_errors(problem, output, &fit.theta());
    Ok(Failures {
        by_regime: regimes(problem, &grid, &error, &usable, fit.seed),
        hour_by_date: hour_by_date(problem, &error, &usable)?,
        episodes: worst(problem, &grid, &error, &usable, 0..grid.len()),
        residual_by_input: input_lags(problem, &grid, &error, &usable),
        innovations: run
            .filtered
            .innovations
            .get(output)
            .map(|series| spectrum(series, grid.step_hours()))
            .unwrap_or_default(),
    })
}

/// What a user should read first of the failures of an output.
pub fn sentences(problem: &Problem, output: usize, failures: &Failures) -> Vec<String> {
    let mut sentences: Vec<String> =
        telling(&failures.by_regime).take(2).map(|regime| sentence(problem, output, regime)).collect();
    if let Some(worst) = failures.episodes.first() {
        let unit = problem.model().outputs().get(output).map_or("", |output| error_unit(&output.unit));
        sentences.push(format!(
            "The worst six hours begin at {} and hold {:.0} % of the squared error: {}{} {unit} on average.",
            worst.from,
            100.0 * worst.share,
            if worst.bias < 0.0 { "" } else { "+" },
            small(worst.bias)
        ));
    }
    sentences
}

fn hour_by_date(problem: &Problem, error: &[f64], usable: &[usize]) -> Result<Vec<DayOfErrors>, Fault> {
    let zone = local_zone(problem.basis().zone.as_deref().unwrap_or("UTC"))?;
    let mut sums: IndexMap<Date, [(f64, usize); 24]> = IndexMap::new();
    for k in usable {
        let time = Timestamp::from_millisecond(problem.grid().time(*k))
            .map_err(|error| Fault::new("/time", "bad-time", error.to_string()))?;
        let local = zone.to_datetime(time);
        let hours = sums.entry(local.date()).or_insert([(0.0, 0); 24]);
        let (sum, count) = &mut hours[local.hour() as usize];
        (*sum, *count) = (*sum + error[*k], *count + 1);
    }
    let mean = |(sum, count): &(f64, usize)| (*count > 0).then(|| sum / *count as f64);
    Ok(sums
        .iter()
        .map(|(date, hours)| DayOfErrors { date: date.to_string(), hours: hours.iter().map(mean).collect() })
        .collect())
}

/// The worst episodes of an output in a part, which do not overlap, the worst first.
pub fn episodes(
    problem: &Problem,
    grid: &Grid,
    (output, error): (usize, &[f64]),
    range: Range<usize>,
) -> Vec<Episode> {
    worst(problem, grid, error, &problem.usable(output, range.clone()), range)
}

fn worst(
    problem: &Problem,
    grid: &Grid,
    error: &[f64],
    usable: &[usize],
    range: Range<usize>,
) -> Vec<Episode> {
    let length = ((EPISODE_HOURS / problem.grid().step_hours()) as usize).max(1);
    let total: f64 = usable.iter().map(|k| error[*k] * error[*k]).sum();
    let mut weight = vec![0.0; range.end + 1];
    usable.iter().for_each(|k| weight[*k + 1] = error[*k] * error[*k]);
    (1..weight.len()).for_each(|k| weight[k] += weight[k - 1]);
    let mut starts: Vec<(f64, usize)> = (range.start..range.end.saturating_sub(length))
        .map(|k| (weight[k + length] - weight[k], k))
        .collect();
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
        let inside: Vec<f64> =
            usable.iter().filter(|k| (start..start + length).contains(*k)).map(|k| error[*k]).collect();
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
            context: context(problem, grid, &range, start..start + length),
        })
    };
    chosen.into_iter().filter_map(one).collect()
}

/// Columns whose mean over an episode is more than a deviation from that over the part.
fn context(
    problem: &Problem,
    grid: &Grid,
    range: &Range<usize>,
    episode: Range<usize>,
) -> IndexMap<String, f64> {
    let mut unusual = IndexMap::new();
    for (channel, column) in circumstances(problem, grid).filter(|(channel, _)| !is_compass(channel)) {
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
