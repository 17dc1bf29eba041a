//! The samples of one channel, and what can be said about them without any model.

use super::duration::SECOND;
use super::seconds::Seconds;
use serde::{Deserialize, Serialize};

use super::channel::{ChannelKind, Hold, canonical_unit};
use crate::fault::{Fault, shown};
use crate::units::Unit;
use utoipa::ToSchema;

/// The most samples that one series holds: thirty years of one-minute data.
pub(super) const MAX_SAMPLES: usize = 1 << 24;

/// The longest channel name and unit text, in bytes.
const MAX_NAME: usize = 256;
/// Times lie within some ten thousand years of 1970, so that no distance of times can overflow.
const MAX_TIME: i64 = 1 << 48;

/// Neighbours further apart than this many median steps have a gap between them.
const GAP_STEPS: i64 = 3;

/// The samples of one channel: strictly increasing times, finite values, one unit.
///
/// A missing measurement is not a value: it is the absence of a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    channel: String,
    unit: String,
    hold: Hold,
    times: Vec<i64>,
    values: Vec<f64>,
}

/// What a report says about one channel. All values are in `unit`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SeriesStatistics {
    /// The unit in which the channel is kept.
    pub unit: String,
    /// What the channel is between two samples.
    pub hold: Hold,
    /// Rows that hold a value.
    pub samples: usize,
    /// Rows that hold none.
    pub missing: usize,
    /// The lowest value.
    pub min: f64,
    /// The highest value.
    pub max: f64,
    /// The median time between two samples; `null` for a single sample.
    pub median_step_s: Option<Seconds>,
    /// The longest time between two samples: the step itself where there is no gap.
    pub longest_gap_s: Seconds,
    /// The longest time over which the value stayed exactly the same; a gap ends it.
    pub stuck_s: Seconds,
    /// The step of the quantised values, where the values lie on such a grid; a sensor's resolution.
    pub quantum: Option<f64>,
}

impl Series {
    /// A series of samples; negative zero and subnormal numbers become zero, so that equal data have equal
    /// hashes.
    ///
    /// # Errors
    /// A fault where the lengths differ, a time does not increase, a value is not finite, there is no sample
    /// or more than 16 million, or the name or the unit is none.
    pub fn new(
        channel: &str,
        unit: &str,
        hold: Hold,
        times: Vec<i64>,
        values: Vec<f64>,
    ) -> Result<Self, Fault> {
        let fault =
            |code, detail: String| Err(Fault::new(format!("/values/{}", shown(channel)), code, detail));
        if channel.is_empty() || channel.len() > MAX_NAME || unit.len() > MAX_NAME {
            return fault("bad-name", format!("a channel and its unit have 1 to {MAX_NAME} bytes"));
        }
        if times.len() != values.len() {
            return fault("length-mismatch", format!("{} times but {} values", times.len(), values.len()));
        }
        if times.is_empty() || times.len() > MAX_SAMPLES {
            return fault(
                "sample-count",
                format!("{} samples, where 1 to {MAX_SAMPLES} are possible", times.len()),
            );
        }
        if let Some(index) = times.windows(2).position(|pair| pair[0] >= pair[1]) {
            return fault(
                "times-not-increasing",
                format!("the time of sample {} is not after the one before", index + 1),
            );
        }
        if times[0] < -MAX_TIME || times[times.len() - 1] > MAX_TIME {
            return fault("time-out-of-range", "a time is thousands of years from now".to_owned());
        }
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            return fault("not-finite", format!("the value of sample {index} is not finite"));
        }
        let unit = canonical_unit(unit);
        if Unit::parse(unit).is_err() {
            return fault("unknown-unit", format!("`{}` is not a known unit", shown(unit)));
        }
        // Subnormal dust (-1e-323 of a weather service) means zero, and costs a processor a hundred cycles a
        // time.
        let values =
            values.into_iter().map(|value| if value.is_subnormal() { 0.0 } else { value + 0.0 }).collect();
        Ok(Self { channel: channel.to_owned(), unit: unit.to_owned(), hold, times, values })
    }

    /// The series of samples that came one by one, which are values of the kind of their channel. They may
    /// be in any order; of several at one time the last one counts.
    ///
    /// # Errors
    /// As of [`Series::new`].
    pub fn of_samples(
        channel: &str,
        kind: &ChannelKind,
        mut samples: Vec<(i64, f64)>,
    ) -> Result<Self, Fault> {
        samples.sort_by_key(|(time, _)| *time);
        let (mut times, mut values): (Vec<i64>, Vec<f64>) = (Vec::new(), Vec::new());
        for (time, value) in samples {
            if times.last() == Some(&time) {
                values.pop();
            } else {
                times.push(time);
            }
            values.push(value);
        }
        Self::new(channel, &kind.unit, kind.hold, times, values)
    }

    /// The name of the channel.
    pub fn channel(&self) -> &str {
        &self.channel
    }

    /// The unit of the values, as a unit text.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// What the channel is between two samples.
    pub fn hold(&self) -> Hold {
        self.hold
    }

    /// The times of the samples, strictly increasing.
    pub fn times(&self) -> &[i64] {
        &self.times
    }

    /// The values of the samples, all finite.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The samples, in the order of time.
    pub fn samples(&self) -> impl Iterator<Item = (i64, f64)> {
        self.times.iter().copied().zip(self.values.iter().copied())
    }

    /// The number of samples, at least one.
    #[expect(clippy::len_without_is_empty, reason = "a series is never empty")]
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// The time of the first sample.
    pub fn from(&self) -> i64 {
        self.times[0]
    }

    /// The time of the last sample.
    pub fn to(&self) -> i64 {
        self.times[self.times.len() - 1]
    }

    /// The median time between two samples in milliseconds, at least 1; `None` for a single sample.
    pub fn median_step(&self) -> Option<i64> {
        median_step(&self.times)
    }

    /// Whether all times are whole seconds.
    pub(super) fn has_whole_seconds(&self) -> bool {
        self.times.iter().all(|time| time % SECOND == 0)
    }

    /// The samples from `from` to `to`, both included; `None` where there are none.
    pub fn slice(&self, from: i64, to: i64) -> Option<Series> {
        let first = self.times.partition_point(|time| *time < from);
        let end = self.times.partition_point(|time| *time <= to);
        (first < end).then(|| Self {
            channel: self.channel.clone(),
            unit: self.unit.clone(),
            hold: self.hold,
            times: self.times[first..end].to_vec(),
            values: self.values[first..end].to_vec(),
        })
    }

    /// What can be said about the samples; `rows` is the number of rows of which they are the ones with a
    /// value.
    pub fn statistics(&self, rows: usize) -> SeriesStatistics {
        SeriesStatistics {
            unit: self.unit.clone(),
            hold: self.hold,
            samples: self.len(),
            missing: rows.saturating_sub(self.len()),
            min: self.values.iter().copied().fold(f64::INFINITY, f64::min),
            max: self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            median_step_s: self.median_step().map(Seconds::of_millis),
            longest_gap_s: Seconds::of_millis(
                self.times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0),
            ),
            stuck_s: Seconds::of_millis(self.stuck()),
            quantum: self.quantum(),
        }
    }

    /// The samples behind which there is a gap: the next one is more than three median steps away.
    pub fn gaps(&self) -> Vec<usize> {
        let limit = self.gap_limit();
        (1..self.len())
            .filter(|next| self.times[*next] - self.times[next - 1] > limit)
            .map(|next| next - 1)
            .collect()
    }

    /// The longest distance of two samples, in milliseconds, that is no gap.
    fn gap_limit(&self) -> i64 {
        GAP_STEPS.saturating_mul(self.median_step().unwrap_or(0))
    }

    /// The longest time, in milliseconds, over which the value stayed exactly the same without a gap.
    pub fn stuck(&self) -> i64 {
        let limit = self.gap_limit();
        let (mut longest, mut start) = (0, 0);
        for i in 1..self.len() {
            if self.values[i] != self.values[i - 1] || self.times[i] - self.times[i - 1] > limit {
                start = i;
            }
            longest = longest.max(self.times[i] - self.times[start]);
        }
        longest
    }

    /// The step between the levels on which the values lie, where at least four levels lie on such a grid.
    ///
    /// Works on the distances between neighbouring levels, not on multiples of the step from the lowest one,
    /// so that values rounded in print (0.0033, 0.0067) still show their step of 1/300.
    pub fn quantum(&self) -> Option<f64> {
        let mut levels = self.values.clone();
        levels.sort_by(f64::total_cmp);
        levels.dedup();
        if levels.len() < 4 {
            return None;
        }
        let steps: Vec<f64> = levels.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let smallest = steps.iter().copied().fold(f64::INFINITY, f64::min);
        let on_grid = |step: f64| {
            let multiple = step / smallest;
            (multiple - multiple.round()).abs() <= 0.05 * multiple.round().min(4.0)
        };
        // A few stray values may lie between the levels; continuous values lie on a grid only by chance.
        let strays = steps.iter().filter(|step| !on_grid(**step)).count();
        if strays * 50 > steps.len() {
            return None;
        }
        let multiples: f64 = steps.iter().map(|step| (step / smallest).round()).sum();
        let quantum = steps.iter().sum::<f64>() / multiples;
        // Six digits are more than the steps bear out, and 0.1 reads better than 0.09999999999999999.
        format!("{quantum:.5e}").parse().ok().filter(|quantum: &f64| quantum.is_finite())
    }

    /// The same samples in another unit; `None` where it does not convert or a value would overflow.
    pub fn in_unit(&self, unit: &str) -> Option<Series> {
        if self.unit == unit {
            return Some(self.clone());
        }
        let (from, to) = (Unit::parse(&self.unit).ok()?, Unit::parse(unit).ok()?);
        let values =
            self.values.iter().map(|value| from.convert(&to, *value)).collect::<Option<Vec<f64>>>()?;
        Self::new(&self.channel, unit, self.hold, self.times.clone(), values).ok()
    }
}

/// The median distance of strictly increasing times; the lower one of two middle values.
pub(super) fn median_step(times: &[i64]) -> Option<i64> {
    median_of(times.windows(2).map(|pair| pair[1] - pair[0]).collect())
}

/// The lower median; `None` of nothing.
pub(super) fn median_of(mut numbers: Vec<i64>) -> Option<i64> {
    let middle = numbers.len().checked_sub(1)? / 2;
    Some(*numbers.select_nth_unstable(middle).1)
}

#[cfg(test)]
mod tests {
    use super::{Seconds, Series};
    use crate::data::{ChannelKind, Hold};

    fn series(times: Vec<i64>, values: Vec<f64>) -> Series {
        Series::new("T_room", "degC", Hold::Linear, times, values).unwrap()
    }

    #[test]
    fn only_sound_samples_make_a_series() {
        let new = |times: Vec<i64>, values: Vec<f64>| {
            Series::new("x", "degC", Hold::Linear, times, values).map_err(|fault| fault.code)
        };
        assert_eq!(new(vec![0, 1], vec![1.0]).unwrap_err(), "length-mismatch");
        assert_eq!(new(vec![], vec![]).unwrap_err(), "sample-count");
        assert_eq!(new(vec![0, 0], vec![1.0, 2.0]).unwrap_err(), "times-not-increasing");
        assert_eq!(new(vec![0, 1], vec![1.0, f64::NAN]).unwrap_err(), "not-finite");
        assert_eq!(
            Series::new("x", "furlong", Hold::Linear, vec![0], vec![0.0]).unwrap_err().code,
            "unknown-unit"
        );
        assert_eq!(new(vec![0], vec![-0.0]).unwrap().values()[0].to_bits(), 0);
    }

    #[test]
    fn samples_are_put_in_order_and_the_last_of_a_time_counts() {
        let kind = ChannelKind::of_unit("kW");
        let samples = vec![(20, 3.0), (10, 1.0), (20, 4.0), (10, 2.0)];
        let series = Series::of_samples("power", &kind, samples).unwrap();
        assert_eq!((series.times(), series.values(), series.unit()), (&[10, 20][..], &[2.0, 4.0][..], "kW"));
        assert_eq!(Series::of_samples("power", &kind, Vec::new()).unwrap_err().code, "sample-count");
    }

    #[test]
    fn statistics_count_what_they_say() {
        // Samples of one step, one gap of six inside a run of equal values.
        let times = vec![0, 600, 1_200, 1_800, 5_400, 6_000, 6_600];
        let statistics = series(times, vec![20.0, 20.5, 20.5, 20.5, 20.5, 20.5, 21.0]).statistics(9);
        assert_eq!((statistics.samples, statistics.missing), (7, 2));
        assert_eq!((statistics.min, statistics.max), (20.0, 21.0));
        assert_eq!(statistics.median_step_s.map(Seconds::millis), Some(600));
        assert_eq!(statistics.longest_gap_s.millis(), 3_600);
        assert_eq!(statistics.stuck_s.millis(), 1_200);
        assert_eq!(series(vec![5], vec![1.0]).statistics(1).median_step_s, None);
    }

    #[test]
    fn the_quantum_of_a_sensor_is_found() {
        let grid = |step: f64, digits: i32| {
            let scale = 10f64.powi(digits);
            let values: Vec<f64> =
                (0..200).map(|i| (f64::from((i * 37) % 61) * step * scale).round() / scale + 17.0).collect();
            series((0..200).collect(), values).quantum()
        };
        assert!((grid(0.1, 6).unwrap() - 0.1).abs() < 1e-6);
        assert!((grid(0.0625, 4).unwrap() - 0.0625).abs() < 1e-6);
        assert!((grid(1.0 / 300.0, 4).unwrap() - 1.0 / 300.0).abs() < 2e-5);
        // Values of a smooth curve lie on no grid; two states are no resolution.
        let smooth = (0..500).map(|i| (f64::from(i) * 0.7).sin() * 3.0).collect();
        assert_eq!(series((0..500).collect(), smooth).quantum(), None);
        assert_eq!(series((0..4).collect(), vec![0.0, 1.0, 0.0, 1.0]).quantum(), None);
    }

    #[test]
    fn slices_and_units() {
        let whole = series(vec![0, 10, 20], vec![0.0, 10.0, 20.0]);
        assert_eq!(whole.slice(1, 20).unwrap().times(), [10, 20]);
        assert!(whole.slice(11, 19).is_none());
        assert!(whole.slice(19, 11).is_none());
        assert!((whole.in_unit("degF").unwrap().values()[1] - 50.0).abs() < 1e-9);
        assert!(whole.in_unit("kW").is_none());
    }
}
