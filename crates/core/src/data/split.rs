//! Training, validation and test parts of a record.

use super::duration::DAY;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::duration::{Duration, Length};
use super::seconds::Seconds;
use crate::fault::Fault;
use utoipa::ToSchema;

/// Below this training time a short record gives up its test part, then shortens its validation.
const ENOUGH_TRAINING: Duration = Duration::from_days(3);
/// What remains of validation in a short record.
const SHORT_VALIDATION: Duration = Duration::from_days(1);

/// How long the parts of a record are meant to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SplitRequest {
    /// The part on which parameters are estimated.
    #[schema(value_type = Length)]
    pub train: Duration,
    /// The part behind it, on which a fit is judged.
    pub validation: Duration,
    /// The newest part, which no decision sees; nothing where it is not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub test: Option<Duration>,
}

impl SplitRequest {
    /// For `estimate` and `recalibrate`: three weeks and one, no test part, so that the controller gets fresh
    /// physics.
    pub const ESTIMATE: SplitRequest =
        SplitRequest { train: Duration::from_days(21), validation: Duration::from_days(7), test: None };
    /// For `diagnose` and `ladder`: two weeks, one to decide on and one that no decision sees.
    pub const DIAGNOSE: SplitRequest = SplitRequest {
        train: Duration::from_days(14),
        validation: Duration::from_days(7),
        test: Some(Duration::from_days(7)),
    };

    /// The length of all parts together.
    pub fn total(&self) -> Duration {
        let test = self.test.unwrap_or_default();
        Duration::from_millis(self.train.millis() + self.validation.millis() + test.millis())
    }
}

impl Default for SplitRequest {
    fn default() -> Self {
        Self::ESTIMATE
    }
}

/// The parts of a record as ranges of grid indices: contiguous, in this order, the last one ending at the
/// newest sample.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Split {
    /// Where parameters are estimated.
    pub train: Range<usize>,
    /// Where a fit is judged; empty where none was asked for.
    pub validation: Range<usize>,
    /// What no decision sees; empty where there is none.
    pub test: Range<usize>,
}

impl Split {
    /// Splits a grid of `len` points every `step` milliseconds.
    ///
    /// A record that is longer than asked for gives its newest points. In a shorter one the parts shrink in
    /// proportion, in whole points; where less than three days of training would remain, the test part goes
    /// first, then validation shrinks to one day.
    ///
    /// # Errors
    /// A fault where no training was asked for, or fewer than two points of it remain.
    pub fn new(len: usize, step: i64, request: &SplitRequest) -> Result<Self, Fault> {
        if step <= 0 {
            return Err(Fault::new(
                "/split",
                "bad-step",
                format!("a grid needs a positive step, not {step} ms"),
            ));
        }
        if request.train.is_zero() {
            return Err(Fault::new("/split/train", "no-training", "the training part has no length")
                .suggest("such as P21D"));
        }
        // Durations end below 2^44 ms and grids below 2^21 points: no sum or product below comes near an
        // overflow.
        let points = |duration: Duration| (duration.millis() as f64 / step as f64).round() as u64;
        let test = request.test.unwrap_or_default();
        let wanted = [points(request.train).max(1), points(request.validation), points(test)];
        let [train, validation, test] =
            shrink(wanted, len as u64, points(ENOUGH_TRAINING), points(SHORT_VALIDATION))
                .map(|part| part as usize);
        if train < 2 {
            let step = Seconds::of_millis(step);
            let detail = format!("{len} points every {step} leave {train} for training; it needs two");
            return Err(Fault::new("/split", "record-too-short", detail)
                .suggest("upload a longer record, or ask for less validation"));
        }
        let validation_start = len - test - validation;
        let test_start = len - test;
        Ok(Self {
            train: validation_start - train..validation_start,
            validation: validation_start..test_start,
            test: test_start..len,
        })
    }

    /// What the record was too short for, in a sentence; `None` where every part is as long as it was asked
    /// for.
    pub fn shortfall(&self, step: i64, request: &SplitRequest) -> Option<String> {
        let days = |millis: f64| {
            let text = format!("{:.2}", millis / DAY as f64);
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        };
        let parts = [
            ("to train", &self.train, request.train),
            ("to validate", &self.validation, request.validation),
            ("to test", &self.test, request.test.unwrap_or_default()),
        ];
        let short: Vec<String> = parts
            .iter()
            .map(|(what, part, asked)| (what, (part.len() as i64 * step) as f64, asked.millis() as f64))
            // A duration that is no whole number of steps is rounded.
            .filter(|(_, has, asked)| has + 0.5 * (step as f64) < *asked)
            .map(|(what, has, asked)| format!("{} of {} days {what}", days(has), days(asked)))
            .collect();
        (!short.is_empty())
            .then(|| format!("the record is shorter than what was asked for: {}", short.join(", ")))
    }

    /// All parts together.
    pub fn all(&self) -> Range<usize> {
        self.train.start..self.test.end
    }
}

/// The parts that fit into a record of `len` points.
fn shrink(wanted: [u64; 3], len: u64, enough: u64, short_validation: u64) -> [u64; 3] {
    if wanted.iter().sum::<u64>() <= len {
        return wanted;
    }
    let enough = enough.min(wanted[0]);
    let parts = in_proportion(wanted, len);
    if parts[0] >= enough {
        return parts;
    }
    let [_, validation, _] = shrink_two([wanted[0], wanted[1]], len);
    let parts = [len - validation, validation, 0];
    if parts[0] >= enough {
        // A training part that was asked for is never exceeded, and the newest points are taken.
        return [parts[0].min(wanted[0]), validation, 0];
    }
    let validation = validation.min(short_validation);
    [(len - validation).min(wanted[0]), validation, 0]
}

fn shrink_two(wanted: [u64; 2], len: u64) -> [u64; 3] {
    if wanted[0] + wanted[1] <= len {
        return [wanted[0], wanted[1], 0];
    }
    in_proportion([wanted[0], wanted[1], 0], len)
}

/// Parts of `len` in the wanted proportion; what rounding leaves over goes to training.
fn in_proportion(wanted: [u64; 3], len: u64) -> [u64; 3] {
    let total: u64 = wanted.iter().sum();
    let part = |points: u64| (u128::from(points) * u128::from(len) / u128::from(total)) as u64;
    let (validation, test) = (part(wanted[1]), part(wanted[2]));
    [len - validation - test, validation, test]
}

#[cfg(test)]
mod tests {
    use super::{Split, SplitRequest};
    use crate::data::{Duration, HOUR};
    use proptest::prelude::{prop_assert, prop_assert_eq, proptest};

    fn days(record: usize, request: &SplitRequest) -> [usize; 3] {
        let split = Split::new(record * 24, HOUR, request).unwrap();
        assert_eq!(split.test.end, record * 24);
        [&split.train, &split.validation, &split.test].map(|part| part.len())
    }

    #[test]
    fn a_long_record_gives_its_newest_part() {
        let split = Split::new(100 * 24, HOUR, &SplitRequest::default()).unwrap();
        assert_eq!(split.train, 72 * 24..93 * 24);
        assert_eq!(split.validation, 93 * 24..100 * 24);
        assert!(split.test.is_empty());
        assert_eq!(split.all(), 72 * 24..2_400);
        assert_eq!(days(28, &SplitRequest::DIAGNOSE), [14 * 24, 7 * 24, 7 * 24]);
    }

    #[test]
    fn short_records_shrink_then_drop_test_then_validation() {
        let request = SplitRequest::DIAGNOSE;
        assert_eq!(days(14, &request), [7 * 24, 84, 84]);
        // Half of five days would be less than three days of training: the test part goes.
        assert_eq!(days(5, &request), [80, 40, 0]);
        // Two thirds of four days are still too little: validation shrinks to a day.
        assert_eq!(days(4, &request), [72, 24, 0]);
        assert_eq!(days(2, &request), [32, 16, 0]);
        assert_eq!(days(12, &SplitRequest::ESTIMATE), [9 * 24, 3 * 24, 0]);
    }

    #[test]
    fn every_shrinking_is_told() {
        let told = |points: usize, request: &SplitRequest| {
            Split::new(points, HOUR, request).unwrap().shortfall(HOUR, request)
        };
        assert_eq!(told(28 * 24, &SplitRequest::DIAGNOSE), None);
        let week =
            SplitRequest { train: Duration::from_days(7), validation: Duration::from_days(7), test: None };
        assert_eq!(told(14 * 24, &week), None, "explicit lengths are kept");
        let sentence = "the record is shorter than what was asked for: 6.96 of 7 days to train, 6.92 of 7 \
            days to validate";
        assert_eq!(told(14 * 24 - 3, &week).as_deref(), Some(sentence));
        let sentence = "the record is shorter than what was asked for: 3.33 of 14 days to train, 1.67 of 7 \
            days to validate, 0 of 7 days to test";
        assert_eq!(told(5 * 24, &SplitRequest::DIAGNOSE).as_deref(), Some(sentence));
    }

    #[test]
    fn parts_may_be_left_out() {
        let request = SplitRequest {
            train: Duration::from_days(2),
            validation: Duration::ZERO,
            test: Some(Duration::from_days(1)),
        };
        assert_eq!(days(10, &request), [48, 0, 24]);
        assert!(Split::new(100, HOUR, &SplitRequest { train: Duration::ZERO, ..request }).is_err());
        assert!(Split::new(1, HOUR, &request).is_err());
        assert!(Split::new(0, HOUR, &request).is_err());
        assert!(Split::new(10, 0, &request).is_err());
        let read: SplitRequest = serde_json::from_str(r#"{"train":"P14D","test":"P7D"}"#).unwrap();
        assert_eq!(
            (read.train, read.validation, read.test),
            (Duration::from_days(14), Duration::from_days(7), Some(Duration::from_days(7)))
        );
        assert!(serde_json::from_str::<SplitRequest>(r#"{"training":"P14D"}"#).is_err());
    }

    proptest! {
        #[test]
        fn parts_are_contiguous_and_end_at_the_newest_sample(
            len in 0usize..100_000, step in 1i64..100_000, train in 0i64..60, validation in 0i64..60,
            test in 0i64..60,
        ) {
            let request = SplitRequest {
                train: Duration::from_days(train),
                validation: Duration::from_days(validation),
                test: Some(Duration::from_days(test)),
            };
            if let Ok(split) = Split::new(len, step, &request) {
                prop_assert_eq!(split.train.end, split.validation.start);
                prop_assert_eq!(split.validation.end, split.test.start);
                prop_assert_eq!(split.test.end, len);
                prop_assert!(split.train.len() >= 2);
            }
        }
    }
}
