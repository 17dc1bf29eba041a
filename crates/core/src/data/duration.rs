//! ISO 8601 durations, `P7D`, `PT30M` or `PT0.01S`, as whole milliseconds.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::schema;

/// A second, in milliseconds, as all times and distances of times are counted.
pub const SECOND: i64 = 1_000;
/// A minute, in milliseconds.
pub const MINUTE: i64 = 60 * SECOND;
/// An hour, in milliseconds.
pub const HOUR: i64 = 60 * MINUTE;
/// A day of 24 hours, in milliseconds.
pub const DAY: i64 = 24 * HOUR;
/// Most digits of a number.
const MAX_DIGITS: usize = 5;
/// Most digits of a fraction of a second.
const MAX_FRACTION: usize = 3;
/// The most days that can be written, 273 years: longer than any record, and far from any overflow of
/// milliseconds.
const MAX_MILLIS: i64 = 99_999 * DAY;
/// The parts of a duration before and behind the `T`, in their order.
const DATE: [(char, i64); 2] = [('W', 7 * DAY), ('D', DAY)];
const TIME: [(char, i64); 3] = [('H', HOUR), ('M', MINUTE), ('S', SECOND)];

/// A length of time in whole milliseconds, written as an ISO 8601 duration. A day has 24 hours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Duration {
    millis: i64,
}

/// A text that is no duration, with the reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadDuration {
    text: String,
    reason: &'static str,
}

impl fmt::Display for BadDuration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown: String = self.text.chars().take(40).collect();
        write!(
            f,
            "`{}` is not a duration: {} (such as `P7D`, `PT6H` or `PT30M`)",
            shown.escape_debug(),
            self.reason
        )
    }
}

impl std::error::Error for BadDuration {}

impl Duration {
    /// No time at all.
    pub const ZERO: Duration = Duration { millis: 0 };

    /// So many milliseconds; a negative number counts as none, and 99,999 days are the most.
    pub const fn from_millis(millis: i64) -> Self {
        let millis = if millis < 0 { 0 } else { millis };
        Self { millis: if millis > MAX_MILLIS { MAX_MILLIS } else { millis } }
    }

    /// So many seconds.
    pub const fn from_seconds(seconds: i64) -> Self {
        Self::from_millis(seconds.saturating_mul(SECOND))
    }

    /// So many hours.
    pub const fn from_hours(hours: i64) -> Self {
        Self::from_millis(hours.saturating_mul(HOUR))
    }

    /// So many days of 24 hours.
    pub const fn from_days(days: i64) -> Self {
        Self::from_millis(days.saturating_mul(DAY))
    }

    /// The length in milliseconds, never negative.
    pub const fn millis(self) -> i64 {
        self.millis
    }

    /// The length in seconds.
    pub fn seconds(self) -> f64 {
        self.millis as f64 / SECOND as f64
    }

    /// The length in hours.
    pub fn hours(self) -> f64 {
        self.millis as f64 / HOUR as f64
    }

    /// Whether it is no time at all.
    pub const fn is_zero(self) -> bool {
        self.millis == 0
    }
}

impl FromStr for Duration {
    type Err = BadDuration;

    fn from_str(text: &str) -> Result<Self, BadDuration> {
        let bad = |reason| BadDuration { text: text.to_owned(), reason };
        let Some(parts) = text.strip_prefix('P') else {
            return Err(bad("an ISO 8601 duration starts with `P`"));
        };
        let (date, time) = parts.split_once('T').map_or((parts, None), |(date, time)| (date, Some(time)));
        if date.ends_with(['Y', 'M']) {
            return Err(bad("years and months have no fixed length; say it in days"));
        }
        if parts.is_empty() || time == Some("") {
            return Err(bad("it says no length"));
        }
        let millis =
            sum(date, &DATE).zip(sum(time.unwrap_or_default(), &TIME)).map(|(days, rest)| days + rest);
        millis.map(Self::from_millis).ok_or_else(|| {
            bad("it is made of whole numbers of at most five digits, and milliseconds at the least")
        })
    }
}

/// The length of parts such as `6H30M0.5S`, which stand in the order of their units.
fn sum(mut text: &str, units: &[(char, i64)]) -> Option<i64> {
    let mut millis = 0;
    let mut units = units.iter();
    while !text.is_empty() {
        let (whole, rest) = digits(text, MAX_DIGITS)?;
        let (fraction, rest) = match rest.strip_prefix('.') {
            Some(rest) => digits(rest, MAX_FRACTION)?,
            None => ("", rest),
        };
        let letter = rest.chars().next()?;
        let (_, unit) = units.find(|(name, _)| *name == letter)?;
        if !fraction.is_empty() && *unit != SECOND {
            return None;
        }
        millis += whole.parse::<i64>().ok()? * unit + format!("{fraction:0<3}").parse::<i64>().ok()?;
        text = &rest[letter.len_utf8()..];
    }
    Some(millis)
}

/// The digits at the start of a text, at least one and at most so many, and what is behind them.
fn digits(text: &str, most: usize) -> Option<(&str, &str)> {
    let count = text.bytes().take_while(u8::is_ascii_digit).count();
    (1..=most).contains(&count).then(|| text.split_at(count))
}

schema::is_text!(
    Duration,
    "Duration",
    "^P(?=[0-9T])([0-9]{1,5}W)?([0-9]{1,5}D)?(T(?=[0-9])([0-9]{1,5}H)?([0-9]{1,5}M)?([0-9]{1,5}([.][0-9]{1,3})?S)?)?$",
    "P7D",
    "A length of time, as ISO 8601 writes it. A day has 24 hours; whatever is longer than 99,999 days counts \
    as that."
);

/// What the description calls a [`Duration`] that has to be longer than nothing.
#[derive(Debug, Clone, Copy)]
pub struct Length;

schema::is_text!(
    Length,
    "Length",
    "^P(?=.*[1-9])([0-9]{1,5}W)?([0-9]{1,5}D)?(T(?=[0-9])([0-9]{1,5}H)?([0-9]{1,5}M)?([0-9]{1,5}([.][0-9]{1,3})?S)?)?$",
    "PT6H",
    "A length of time that is longer than nothing, as ISO 8601 writes it."
);

impl fmt::Display for Duration {
    /// Whole days from two days on (`P7D`), else hours and less (`PT24H`): horizons are spoken of in hours,
    /// records in days.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.millis == 0 {
            return f.write_str("P0D");
        }
        let days = if self.millis >= 2 * DAY { self.millis / DAY } else { 0 };
        let rest = self.millis - days * DAY;
        f.write_str("P")?;
        if days > 0 {
            write!(f, "{days}D")?;
        }
        if rest > 0 {
            f.write_str("T")?;
        }
        for (amount, letter) in [(rest / HOUR, 'H'), (rest % HOUR / MINUTE, 'M')] {
            if amount > 0 {
                write!(f, "{amount}{letter}")?;
            }
        }
        match (rest % MINUTE / SECOND, rest % SECOND) {
            (0, 0) => Ok(()),
            (seconds, 0) => write!(f, "{seconds}S"),
            (seconds, millis) => {
                write!(f, "{seconds}.{}S", format!("{millis:03}").trim_end_matches('0'))
            }
        }
    }
}

impl From<Duration> for String {
    fn from(duration: Duration) -> String {
        duration.to_string()
    }
}

impl TryFrom<String> for Duration {
    type Error = BadDuration;

    fn try_from(text: String) -> Result<Self, BadDuration> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::{Duration, MAX_MILLIS};
    use proptest::prelude::{any, prop_assert_eq, proptest};

    #[test]
    fn texts_are_milliseconds() {
        for (text, millis) in [
            ("P7D", 604_800_000),
            ("PT30M", 1_800_000),
            ("P0D", 0),
            ("P1DT12H", 129_600_000),
            ("P2W", 1_209_600_000),
            ("PT24H", 86_400_000),
            ("PT90S", 90_000),
            ("PT0.5S", 500),
            ("PT1M0.01S", 60_010),
            ("P1W2DT3M", 777_780_000),
            ("P99999W", MAX_MILLIS),
        ] {
            assert_eq!(text.parse::<Duration>().unwrap().millis(), millis, "{text}");
        }
        for bad in [
            "",
            "7 days",
            "P",
            "PT",
            "-P7D",
            "P1M",
            "P1Y",
            "PT0.5H",
            "PT.5S",
            "PT1.S",
            "PT0.0005S",
            "P99999999999999D",
            "7",
            "p7d",
            "P7D ",
            "P2D1W",
            "PT5M6H",
            "P7",
            "PD",
            "P١D",
            "P6H",
        ] {
            assert!(bad.parse::<Duration>().is_err(), "{bad}");
        }
    }

    #[test]
    fn days_and_horizons_print_as_the_field_says_them() {
        for text in ["P7D", "P21D", "PT1H", "PT6H", "PT24H", "P0D", "PT30M", "P2DT3H", "PT1M30S", "PT0.01S"] {
            assert_eq!(text.parse::<Duration>().unwrap().to_string(), text);
        }
        assert_eq!(serde_json::to_string(&Duration::from_days(7)).unwrap(), "\"P7D\"");
        assert!(serde_json::from_str::<Duration>("7").is_err());
    }

    proptest! {
        #[test]
        fn every_duration_survives_its_text(millis in 0..=MAX_MILLIS) {
            let duration = Duration::from_millis(millis);
            prop_assert_eq!(duration.to_string().parse::<Duration>(), Ok(duration));
        }

        #[test]
        fn no_text_panics(text in any::<String>(), digits in "P?[0-9]{0,25}[DWHT]?[0-9]{0,25}[HMS]?") {
            let _ = text.parse::<Duration>();
            let _ = digits.parse::<Duration>();
        }
    }
}
