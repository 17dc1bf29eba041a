//! Where a model fails: which hours err most, in which circumstances, with which input, over which horizon.
//!
//! Free runs show where; only innovations show whether anything is left to explain (reference: missing-effects 6).

use super::regimes::{Regime, regimes};
use super::residual::residual;
use super::spectrum::{InputLag, Spectrum, input_lags, spectrum};
use crate::data::rfc3339;
use crate::estimate::fit::{AheadError, OutputMetrics};
use crate::estimate::metrics::{FilterRun, filter, metrics};
use crate::estimate::problem::mean_square;
use crate::estimate::{Fit, Problem};
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

/// Where a model fails. Errors are measured minus simulated, in the output's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Failures {
    /// In plain sentences, the most telling first.
    pub summary: Vec<String>,
    /// How well each output is simulated.
    pub skill: IndexMap<String, Skill>,
    /// Forecast errors from re-estimated states, with `free_run` for the free run over the validation part.
    pub by_horizon: IndexMap<String, AheadError>,
    /// Errors by circumstances.
    pub by_regime: Vec<Regime>,
    /// Mean error by day and hour.
    pub hour_by_date: Vec<DayOfErrors>,
    /// The worst six hours, several times.
    pub episodes: Vec<Episode>,
    /// The residual against each input, with the lag at which they go together most.
    pub inputs: Vec<InputLag>,
    /// Autocorrelation and cumulated periodogram of the one-step innovations.
    pub innovations: Spectrum,
    /// Free-run error over the innovation deviation of its AR model.
    pub rho: Option<f64>,
    /// Root mean square of the one-step innovations.
    pub noise_floor: Option<f64>,
}

/// The skill of a free run over the whole window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Skill {
    /// Samples compared.
    pub n: usize,
    /// Mean error.
    pub bias: f64,
    /// Root mean square error.
    pub rmse: f64,
    /// The same about the bias.
    pub urmse: f64,
    /// Mean absolute error.
    pub mae: f64,
    /// Share of the variance that is explained; below zero the mean would do better.
    pub r2: f64,
}

/// Mean errors of a day by hour, UTC; `None` where nothing is comparable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DayOfErrors {
    /// The day, as the instant of its midnight.
    pub date: String,
    /// 24 means.
    pub hours: Vec<Option<f64>>,
}

/// Where the free run of a fit fails. `seed` fixes the resampling of the intervals.
pub fn failures(problem: &Problem, fit: &Fit, seed: u64) -> Failures {
    let theta = fit.theta();
    let run = filter(problem, &theta, Some(fit.process_noise));
    let measured = metrics(problem, &theta, &run);
    let first = measured.values().next().cloned();
    let simulated = problem.simulate(&theta);
    let error = residual(problem, &simulated.outputs[0]);
    let all = 0..problem.grid().len();
    let usable = problem.usable(0, all.clone());
    let by_regime = regimes(problem, &error, &usable, seed);
    let episodes = episodes(problem, &theta, all);
    let inputs = input_lags(problem, &error, &usable);
    Failures {
        summary: sentences(first.as_ref(), &by_regime, &episodes),
        skill: skill(problem, &simulated.outputs, &measured),
        by_horizon: first.as_ref().map(by_horizon).unwrap_or_default(),
        hour_by_date: hour_by_date(problem, &error, &usable),
        by_regime,
        episodes,
        inputs,
        innovations: innovations(&run),
        rho: first.as_ref().and_then(|first| first.rho),
        noise_floor: first.as_ref().and_then(|first| first.noise_floor),
    }
}

fn innovations(run: &FilterRun) -> Spectrum {
    run.filtered.innovations.first().map(|series| spectrum(series)).unwrap_or_default()
}

fn skill(problem: &Problem, simulated: &[Vec<f64>], measured: &IndexMap<String, OutputMetrics>) -> IndexMap<String, Skill> {
    let mut skills = IndexMap::new();
    for ((index, channel), (values, _)) in measured.keys().enumerate().zip(problem.measured()) {
        let usable = problem.usable(index, 0..problem.grid().len());
        let errors: Vec<f64> = usable.iter().map(|k| values[*k] - simulated[index][*k]).collect();
        if errors.is_empty() {
            continue;
        }
        let n = errors.len() as f64;
        let bias = errors.iter().sum::<f64>() / n;
        let mean = usable.iter().map(|k| values[*k]).sum::<f64>() / n;
        let variance = usable.iter().map(|k| (values[*k] - mean).powi(2)).sum::<f64>() / n;
        let square = mean_square(&errors);
        skills.insert(
            channel.clone(),
            Skill {
                n: errors.len(),
                bias,
                rmse: square.sqrt(),
                urmse: (square - bias * bias).max(0.0).sqrt(),
                mae: errors.iter().map(|error| error.abs()).sum::<f64>() / n,
                r2: 1.0 - square / variance.max(f64::MIN_POSITIVE),
            },
        );
    }
    skills
}

fn by_horizon(metrics: &OutputMetrics) -> IndexMap<String, AheadError> {
    let mut horizons = metrics.ahead.clone();
    if let (Some(rmse), Some(day)) = (metrics.validation_rmse, metrics.ahead.values().last()) {
        horizons.insert("free_run".to_owned(), AheadError { rmse, persistence: day.persistence, n: day.n });
    }
    horizons
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
fn sentences(metrics: Option<&OutputMetrics>, regimes: &[Regime], episodes: &[Episode]) -> Vec<String> {
    let mut sentences = Vec::new();
    if let Some(metrics) = metrics {
        let unit = &metrics.unit;
        if let (Some(rho), Some(floor)) = (metrics.rho, metrics.noise_floor) {
            let word = if rho < super::findings::ADEQUATE_RHO { "close to" } else { "far above" };
            sentences
                .push(format!("The free run errs by {:.2} {unit}, {word} its one-step noise of {floor:.2} {unit}.", metrics.train_rmse));
        }
        let sure = |regime: &&Regime| regime.bias_ci95.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
        for regime in regimes.iter().filter(sure).take(3) {
            let word = if regime.bias > 0.0 { "warmer" } else { "colder" };
            sentences.push(format!(
                "With {} the room is {:.2} {unit} {word} than the model: {:.0} % of the time, {:.0} % of the squared error.",
                regime.regime,
                regime.bias.abs(),
                100.0 * regime.time_share,
                100.0 * regime.error_share
            ));
        }
    }
    if let Some(worst) = episodes.first() {
        sentences.push(format!("The worst six hours begin at {}: {:+.2} on average.", worst.from, worst.bias));
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
