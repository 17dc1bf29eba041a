//! Thins a series for a chart without hiding anything: every extreme stays, and so does every gap that is
//! longer than what one point stands for.
//!
//! Taking every tenth sample would lose the spike that an operator looks for. A bucket keeps its lowest, its
//! highest and its mean value instead, so that the drawn band touches every sample.

use super::channel::is_compass;
use super::duration::SECOND;
use super::series::Series;

/// What a chart draws of one channel. Where `None` stands, a line must break.
#[derive(Debug, Clone, PartialEq)]
pub enum Thinned {
    /// Every sample, with a `None` in each gap.
    Samples {
        /// The times of the samples and of the marks, strictly increasing.
        times: Vec<i64>,
        /// The samples, and the marks.
        values: Vec<Option<f64>>,
    },
    /// The envelope of buckets of equal width. A bucket without samples is left out.
    Envelope {
        /// The width of a bucket in milliseconds.
        bucket: i64,
        /// The middles of the buckets and the times of the marks, strictly increasing.
        times: Vec<i64>,
        /// What a bucket holds.
        buckets: Vec<Option<Bucket>>,
    },
}

/// The samples of one bucket.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bucket {
    /// How many there are.
    pub count: usize,
    /// The lowest.
    pub min: f64,
    /// Their mean, each sample counting once; on a compass the mean direction.
    pub mean: f64,
    /// The highest.
    pub max: f64,
}

impl Thinned {
    /// The series in at most `max_points` points.
    ///
    /// All samples, if they fit together with a mark in every gap; otherwise buckets between `from` and `to`,
    /// which several channels may share. A bucket counts as two points, its extremes, so that the marks
    /// always fit.
    pub fn new(series: &Series, (from, to): (i64, i64), max_points: usize) -> Self {
        let gaps = series.gaps();
        if series.len() + gaps.len() <= max_points {
            return samples(series, &gaps);
        }
        let count = i64::try_from(max_points / 2).unwrap_or(i64::MAX).max(1);
        let (from, to) = (from.min(series.from()), to.max(series.to()));
        let bucket = (to - from) / count + 1;
        // Widths of even seconds have their middles at whole ones.
        let even = 2 * SECOND;
        let bucket = if bucket > even { (bucket + even - 1) / even * even } else { bucket };
        // So many buckets of this width reach from the first instant beyond the last one.
        envelope(series, &gaps, from, bucket)
    }

    /// The times of all points.
    pub fn times(&self) -> &[i64] {
        match self {
            Thinned::Samples { times, .. } | Thinned::Envelope { times, .. } => times,
        }
    }
}

fn samples(series: &Series, gaps: &[usize]) -> Thinned {
    let step = series.median_step().unwrap_or(1);
    let mut times = Vec::with_capacity(series.len() + gaps.len());
    let mut values = Vec::with_capacity(times.capacity());
    let mut gaps = gaps.iter().peekable();
    for (index, (time, value)) in series.times().iter().zip(series.values()).enumerate() {
        times.push(*time);
        values.push(Some(*value));
        if gaps.next_if_eq(&&index).is_some() {
            // The gap is longer than three steps, so that this lies within.
            times.push(time + step);
            values.push(None);
        }
    }
    Thinned::Samples { times, values }
}

fn envelope(series: &Series, gaps: &[usize], from: i64, bucket: i64) -> Thinned {
    let (mut times, mut buckets): (Vec<i64>, Vec<Option<Bucket>>) = (Vec::new(), Vec::new());
    let number = |time: i64| (time - from) / bucket;
    let mut start = 0;
    while start < series.len() {
        let own = number(series.times()[start]);
        let end = start + series.times()[start..].partition_point(|time| number(*time) == own);
        let middle = from + own * bucket + bucket / 2;
        // A gap between the buckets is marked; one within a bucket is shorter than a point can show.
        if start > 0 && gaps.binary_search(&(start - 1)).is_ok() {
            let before = times.last().copied().unwrap_or(middle);
            times.push(before + (middle - before) / 2);
            buckets.push(None);
        }
        times.push(middle);
        buckets.push(Some(summary(series, start..end)));
        start = end;
    }
    Thinned::Envelope { bucket, times, buckets }
}

fn summary(series: &Series, range: std::ops::Range<usize>) -> Bucket {
    let values = &series.values()[range];
    let (mut min, mut max, mut mean) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
    for (before, value) in values.iter().enumerate() {
        (min, max) = (value.min(min), value.max(max));
        // A running mean stays within the range of the values, where a sum could overflow.
        let weight = 1.0 / (before + 1) as f64;
        mean = mean * (1.0 - weight) + value * weight;
    }
    let mean = if is_compass(series.channel()) { direction(values, min) } else { mean.clamp(min, max) };
    Bucket { count: values.len(), min, mean, max }
}

/// The mean direction of bearings in degrees: that of the sum of their unit vectors. Between 350 and 10 lies
/// 0.
fn direction(values: &[f64], min: f64) -> f64 {
    let (mut east, mut north) = (0.0, 0.0);
    for value in values {
        let (sin, cos) = value.to_radians().sin_cos();
        (east, north) = (east + sin, north + cos);
    }
    let bearing = east.atan2(north).to_degrees();
    // A sensor counts either from -180 to 180 or from 0 to 360.
    if min < 0.0 { bearing } else { bearing.rem_euclid(360.0) }
}

#[cfg(test)]
mod tests {
    use super::{Bucket, Thinned};
    use crate::data::{Hold, Series};
    use proptest::prelude::{prop_assert, prop_assert_eq, proptest};

    fn series(channel: &str, samples: &[(i64, f64)]) -> Series {
        let (times, values) = samples.iter().copied().unzip();
        Series::new(channel, "-", Hold::Linear, times, values).unwrap()
    }

    #[test]
    fn what_fits_is_not_thinned_and_gaps_are_marked() {
        // Steps of 60 s; 180 s are no gap, 181 s are one.
        let whole = series("x", &[(0, 1.0), (60, 2.0), (120, 3.0), (300, 4.0), (481, 5.0), (541, 6.0)]);
        let Thinned::Samples { times, values } = Thinned::new(&whole, (0, 541), 10) else {
            panic!("thinned")
        };
        assert_eq!(times, [0, 60, 120, 300, 360, 481, 541]);
        assert_eq!(values, [Some(1.0), Some(2.0), Some(3.0), Some(4.0), None, Some(5.0), Some(6.0)]);
        assert!(
            matches!(Thinned::new(&whole, (0, 541), 6), Thinned::Envelope { .. }),
            "seven points are no six"
        );
    }

    #[test]
    fn buckets_keep_their_extremes() {
        // Twelve samples, a minute apart, then an hour's gap and twelve more.
        let mut samples: Vec<(i64, f64)> = (0..12).map(|i| (60 * i, i as f64)).collect();
        samples.extend((0..12).map(|i| (4_320 + 60 * i, 100.0 - i as f64)));
        samples[5].1 = -7.0;
        let Thinned::Envelope { bucket, times, buckets } =
            Thinned::new(&series("x", &samples), (0, 4_980), 10)
        else {
            panic!("not thinned")
        };
        // Five buckets of 997 s: the first holds the first twelve, the last one the others.
        assert_eq!((bucket, times), (997, vec![498, 2_492, 4_486]));
        let first = Bucket { count: 12, min: -7.0, mean: (66.0 - 5.0 - 7.0) / 12.0, max: 11.0 };
        let last = Bucket { count: 12, min: 89.0, mean: 94.5, max: 100.0 };
        let [Some(a), None, Some(b)] = buckets[..] else { panic!("{buckets:?}") };
        for (found, expected) in [(a, first), (b, last)] {
            assert_eq!((found.count, found.min, found.max), (expected.count, expected.min, expected.max));
            assert!((found.mean - expected.mean).abs() < 1e-12);
        }
    }

    #[test]
    fn the_mean_of_bearings_is_a_direction() {
        let mean = |channel: &str, values: [f64; 4]| {
            let samples: Vec<(i64, f64)> = (0..12).map(|i| (i, values[i as usize % 4])).collect();
            match Thinned::new(&series(channel, &samples), (0, 11), 2) {
                Thinned::Envelope { buckets, .. } => buckets[0].unwrap().mean,
                Thinned::Samples { .. } => panic!("not thinned"),
            }
        };
        assert!((mean("wind_direction", [350.0, 10.0, 350.0, 20.0]) - 2.5).abs() < 0.1);
        assert!((mean("wind_direction", [-170.0, 170.0, -175.0, 175.0]).abs() - 180.0).abs() < 1e-6);
        assert!((mean("x", [350.0, 10.0, 350.0, 20.0]) - 182.5).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn no_sample_lies_outside_and_no_point_is_too_many(
            steps in proptest::collection::vec((1i64..2_000, -1e9f64..1e9), 2..400), max_points in 2usize..60,
            early in 0i64..5_000,
        ) {
            let mut time = 0;
            let samples: Vec<(i64, f64)> = steps.iter().map(|(step, value)| { time += step; (time, *value) }).collect();
            let whole = series("x", &samples);
            let (from, to) = (whole.from() - early, whole.to() + early);
            let thinned = Thinned::new(&whole, (from, to), max_points);
            prop_assert!(thinned.times().len() <= max_points.max(2), "{} points", thinned.times().len());
            prop_assert!(thinned.times().windows(2).all(|pair| pair[0] < pair[1]));
            if let Thinned::Envelope { bucket, times, buckets } = &thinned {
                // Counted the slow way: which samples lie in the bucket around each middle.
                let mut seen = 0;
                for (middle, found) in times.iter().zip(buckets) {
                    let Some(found) = found else { continue };
                    let start = middle - bucket / 2;
                    let inside: Vec<f64> = samples.iter().filter(|(t, _)| (start..start + bucket).contains(t)).map(|(_, v)| *v).collect();
                    prop_assert_eq!(found.count, inside.len());
                    prop_assert_eq!(found.min, inside.iter().copied().fold(f64::INFINITY, f64::min));
                    prop_assert_eq!(found.max, inside.iter().copied().fold(f64::NEG_INFINITY, f64::max));
                    prop_assert!((found.mean - inside.iter().sum::<f64>() / inside.len() as f64).abs() <= 1e-3);
                    seen += inside.len();
                }
                prop_assert_eq!(seen, samples.len(), "every sample is in one bucket");
                // A gap that spans a whole bucket must show.
                let longest = whole.gaps().iter().map(|i| whole.times()[i + 1] - whole.times()[*i]).max().unwrap_or(0);
                prop_assert!(longest <= *bucket || buckets.iter().any(Option::is_none));
            } else {
                let Thinned::Samples { values, .. } = &thinned else { unreachable!() };
                prop_assert_eq!(values.iter().filter(|value| value.is_none()).count(), whole.gaps().len());
            }
        }
    }
}
