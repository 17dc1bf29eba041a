//! Hours of the clock on the wall, which people know.

use crate::data::{HOUR, local_zone, rfc3339};
use crate::estimate::Problem;
use crate::fault::Fault;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Half of a normal distribution lies within so many deviations, and 95 % of it.
const HALF: f64 = 0.6745;
const MOST: f64 = 1.96;

fn band((rate, sd): (f64, f64), deviations: f64) -> [f64; 2] {
    [rate - deviations * sd, rate + deviations * sd]
}

/// What is missing in an hour.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Hour {
    /// Its first sample, RFC 3339.
    #[schema(format = DateTime)]
    pub from: String,
    /// The mean rate that is missing, in the unit of the answer; `null` where inputs are unknown.
    pub rate: Option<f64>,
    /// Its deviation, given the parameters of the model; `null` where inputs are unknown.
    pub sd: Option<f64>,
    /// Lower and upper end of what holds it with 50 %; `null` where inputs are unknown.
    pub band_50: Option<[f64; 2]>,
    /// The same with 95 %.
    pub band_95: Option<[f64; 2]>,
    /// The day on the wall, counted from the Monday of its week: 0 to 6.
    #[serde(skip)]
    pub(super) weekday: usize,
    /// The hour on the wall, 0 to 23.
    #[serde(skip)]
    pub(super) hour: usize,
}

impl Hour {
    /// Rate and deviation where they are known.
    pub(super) fn known(&self) -> Option<(f64, f64)> {
        self.rate.zip(self.sd)
    }
}

/// The hours of a record, of which `samples` are the first ones, with what is missing in each.
pub(super) fn hours(
    problem: &Problem,
    samples: &[usize],
    known: &[Option<(f64, f64)>],
) -> Result<Vec<Hour>, Fault> {
    let zone = local_zone(problem.basis().zone.as_deref().unwrap_or("UTC"))?;
    samples
        .iter()
        .zip(known)
        .map(|(k, known)| {
            let time = problem.grid().time(*k);
            let instant = Timestamp::from_millisecond(time)
                .map_err(|error| Fault::new("/time", "bad-time", error.to_string()))?;
            let local = zone.to_datetime(instant);
            Ok(Hour {
                from: rfc3339(time.div_euclid(HOUR) * HOUR),
                rate: known.map(|(rate, _)| rate),
                sd: known.map(|(_, sd)| sd),
                band_50: known.map(|known| band(known, HALF)),
                band_95: known.map(|known| band(known, MOST)),
                weekday: local.weekday().to_monday_zero_offset() as usize,
                hour: local.hour() as usize,
            })
        })
        .collect()
}

/// The mean of an hour of the week.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HourOfWeek {
    /// 0 is Monday.
    #[schema(maximum = 6)]
    pub weekday: usize,
    /// Of the day, on the wall.
    #[schema(maximum = 23)]
    pub hour: usize,
    /// The mean rate; `null` where the record has no such hour.
    pub rate: Option<f64>,
    /// How many hours it is of.
    pub hours: usize,
}

/// The mean week.
pub(super) fn week(hours: &[Hour]) -> Vec<HourOfWeek> {
    let mut sums = vec![(0.0, 0usize); 7 * 24];
    for (at, (rate, _)) in hours.iter().filter_map(|one| Some((one.weekday * 24 + one.hour, one.known()?))) {
        sums[at] = (sums[at].0 + rate, sums[at].1 + 1);
    }
    let mean = |(at, (sum, n)): (usize, &(f64, usize))| HourOfWeek {
        weekday: at / 24,
        hour: at % 24,
        rate: (*n > 0).then(|| sum / *n as f64),
        hours: *n,
    };
    sums.iter().enumerate().map(mean).collect()
}
