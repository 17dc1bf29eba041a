//! How far off forecasts were, by how far ahead they looked, once the truth has come.

use super::Forecast;
use crate::data::{Duration, Hold, Series, read_time};
use crate::fault::Fault;
use serde::Serialize;
use utoipa::ToSchema;

/// How far ahead forecasts are compared with the truth, in hours.
const LEADS_H: [i64; 9] = [1, 3, 6, 12, 24, 48, 72, 120, 240];
/// Most instants of a forecast that are kept: ten days by the hour.
const MOST_KEPT: usize = 240;
/// The half of a band that holds 95 of 100, in standard deviations.
const BAND: f64 = 1.96;

/// What a forecast has said of one output.
#[derive(Debug, Clone, PartialEq)]
pub struct Said {
    /// The newest measurement that it knew, in milliseconds.
    pub at: i64,
    /// What it said.
    pub values: Series,
    /// The standard deviations of that, at the same instants.
    pub sd: Series,
}

/// How far off the forecasts of an output were, so far ahead.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LeadScore {
    /// How far ahead of the newest measurement that a forecast knew.
    #[schema(example = "PT6H")]
    pub lead: String,
    /// Forecasts that reach so far and whose truth was measured.
    pub n: usize,
    /// Root of the mean square of what was said less what came; `null` where nothing has come.
    pub rmse: Option<f64>,
    /// Mean of what was said less what came.
    pub bias: Option<f64>,
    /// Share of what came that lies within 1.96 standard deviations of what was said.
    pub within95: Option<f64>,
    /// The error of holding the newest measurement instead, over the same forecasts.
    pub persistence: Option<f64>,
}

impl Said {
    /// What is kept of a forecast with so long a step: each output, thinned to the hour where it is long, in
    /// single precision, which is finer than any sensor.
    ///
    /// # Errors
    /// A fault where it is no series.
    pub fn of(forecast: &Forecast, step: Duration) -> Result<Vec<Self>, Fault> {
        let at = read_time("/at", &forecast.at)?;
        let stride = forecast.time.len().saturating_sub(1).div_ceil(MOST_KEPT).max(1);
        let kept = |channel: &str, unit: &str, values: &[f64]| {
            let instants = (0..values.len()).step_by(stride);
            let (times, values) =
                instants.map(|k| (at + k as i64 * step.millis(), f64::from(values[k] as f32))).unzip();
            Series::new(channel, unit, Hold::Linear, times, values)
        };
        let outputs = forecast.outputs.iter();
        let said = outputs.map(|(channel, series)| {
            let values = kept(channel, &series.unit, &series.values)?;
            Ok(Self { at, values, sd: kept(channel, &series.unit, &series.sd)? })
        });
        said.collect()
    }
}

/// Compares forecasts of one output, in the order of time, with what was measured of it. There is a row for
/// every lead that one of them reaches.
pub fn scores(said: &[Said], measured: &Series) -> Vec<LeadScore> {
    // Where the unit of the output has changed, the newest counts.
    let Some(unit) = said.last().map(|newest| newest.values.unit()) else { return Vec::new() };
    let Some(measured) = measured.in_unit(unit) else { return Vec::new() };
    let said: Vec<&Said> = said.iter().filter(|one| one.values.unit() == unit).collect();
    let truth = Truth { reach: measured.median_step().unwrap_or_default() / 2, measured };
    let leads = LEADS_H.iter().map(|hours| Duration::from_hours(*hours));
    leads.filter_map(|lead| score(&said, &truth, lead)).collect()
}

fn score(said: &[&Said], truth: &Truth, lead: Duration) -> Option<LeadScore> {
    let reaching: Vec<&&Said> = said.iter().filter(|one| one.at + lead.millis() <= one.values.to()).collect();
    let compared: Vec<Compared> = reaching.iter().filter_map(|one| compared(one, truth, lead)).collect();
    let n = compared.len();
    let mean =
        |of: &dyn Fn(&Compared) -> f64| (n > 0).then(|| compared.iter().map(of).sum::<f64>() / n as f64);
    (!reaching.is_empty()).then(|| LeadScore {
        lead: lead.to_string(),
        n,
        rmse: mean(&|one| one.error.powi(2)).map(f64::sqrt),
        bias: mean(&|one| one.error),
        within95: mean(&|one| f64::from(u8::from(one.error.abs() <= BAND * one.sd))),
        persistence: mean(&|one| one.persistence.powi(2)).map(f64::sqrt),
    })
}

/// A forecast beside the truth.
struct Compared {
    error: f64,
    sd: f64,
    persistence: f64,
}

/// `None` where the truth, or the newest measurement of then, is not there.
fn compared(said: &Said, truth: &Truth, lead: Duration) -> Option<Compared> {
    let then = said.at + lead.millis();
    let (came, held) = (truth.at(then)?, truth.at(said.at)?);
    Some(Compared {
        error: on_line(&said.values, then)? - came,
        sd: on_line(&said.sd, then)?,
        persistence: held - came,
    })
}

/// What was measured, and how far from an instant a sample stands for it: half a step, in milliseconds.
struct Truth {
    measured: Series,
    reach: i64,
}

impl Truth {
    /// The sample nearest to an instant: outputs are never interpolated.
    fn at(&self, instant: i64) -> Option<f64> {
        let times = self.measured.times();
        let next = times.partition_point(|time| *time < instant);
        let around = next.saturating_sub(1)..(next + 1).min(times.len());
        let distance = |index: &usize| times[*index].abs_diff(instant);
        let index = around.min_by_key(distance)?;
        (distance(&index) <= self.reach.unsigned_abs()).then(|| self.measured.values()[index])
    }
}

/// The value of a forecast between two of its instants.
fn on_line(series: &Series, at: i64) -> Option<f64> {
    let (times, values) = (series.times(), series.values());
    let next = times.partition_point(|time| *time < at);
    let (to, value) = (*times.get(next)?, values[next]);
    if to == at {
        return Some(value);
    }
    let before = next.checked_sub(1)?;
    let weight = (at - times[before]) as f64 / (to - times[before]) as f64;
    Some(values[before] + (value - values[before]) * weight)
}
