//! ISO 8601 durations, `P7D` or `PT30M`, as whole seconds.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::schema;

const DAY: i64 = 86_400;
const HOUR: i64 = 3_600;
const MINUTE: i64 = 60;
/// Most digits of a number.
const MAX_DIGITS: usize = 5;
/// The most days that can be written, 273 years: longer than any record, and far from any overflow of
/// seconds.
const MAX_SECONDS: i64 = 99_999 * DAY;
/// The parts of a duration before and behind the `T`, in their order.
const DATE: [(char, i64); 2] = [('W', 7 * DAY), ('D', DAY)];
const TIME: [(char, i64); 3] = [('H', HOUR), ('M', MINUTE), ('S', 1)];

/// A length of time in whole seconds, written as an ISO 8601 duration. A day has 24 hours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Duration {
    seconds: i64,
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
    pub const ZERO: Duration = Duration { seconds: 0 };

    /// So many seconds; a negative number counts as none, and 99,999 days are the most.
    pub const fn from_seconds(seconds: i64) -> Self {
        let seconds = if seconds < 0 { 0 } else { seconds };
        Self { seconds: if seconds > MAX_SECONDS { MAX_SECONDS } else { seconds } }
    }

    /// So many hours.
    pub const fn from_hours(hours: i64) -> Self {
        Self::from_seconds(hours.saturating_mul(HOUR))
    }

    /// So many days of 24 hours.
    pub const fn from_days(days: i64) -> Self {
        Self::from_seconds(days.saturating_mul(DAY))
    }

    /// The length in seconds, never negative.
    pub const fn seconds(self) -> i64 {
        self.seconds
    }

    /// The length in hours.
    pub fn hours(self) -> f64 {
        self.seconds as f64 / HOUR as f64
    }

    /// Whether it is no time at all.
    pub const fn is_zero(self) -> bool {
        self.seconds == 0
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
        let seconds =
            sum(date, &DATE).zip(sum(time.unwrap_or_default(), &TIME)).map(|(days, rest)| days + rest);
        seconds
            .map(Self::from_seconds)
            .ok_or_else(|| bad("it is made of whole numbers of at most five digits"))
    }
}

/// The length of parts such as `6H30M`, which stand in the order of their units.
fn sum(mut text: &str, units: &[(char, i64)]) -> Option<i64> {
    let mut seconds = 0;
    let mut units = units.iter();
    while !text.is_empty() {
        let digits = text.bytes().take_while(u8::is_ascii_digit).count();
        let letter = text[digits..].chars().next()?;
        let (_, unit) = units.find(|(name, _)| *name == letter)?;
        if !(1..=MAX_DIGITS).contains(&digits) {
            return None;
        }
        seconds += text[..digits].parse::<i64>().ok()? * unit;
        text = &text[digits + 1..];
    }
    Some(seconds)
}

schema::is_text!(
    Duration,
    "Duration",
    "^P(?=[0-9T])([0-9]{1,5}W)?([0-9]{1,5}D)?(T(?=[0-9])([0-9]{1,5}H)?([0-9]{1,5}M)?([0-9]{1,5}S)?)?$",
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
    "^P(?=.*[1-9])([0-9]{1,5}W)?([0-9]{1,5}D)?(T(?=[0-9])([0-9]{1,5}H)?([0-9]{1,5}M)?([0-9]{1,5}S)?)?$",
    "PT6H",
    "A length of time that is longer than nothing, as ISO 8601 writes it."
);

impl fmt::Display for Duration {
    /// Whole days from two days on (`P7D`), else hours and less (`PT24H`): horizons are spoken of in hours,
    /// records in days.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.seconds == 0 {
            return f.write_str("P0D");
        }
        let days = if self.seconds >= 2 * DAY { self.seconds / DAY } else { 0 };
        let rest = self.seconds - days * DAY;
        f.write_str("P")?;
        if days > 0 {
            write!(f, "{days}D")?;
        }
        if rest > 0 {
            f.write_str("T")?;
        }
        for (amount, letter) in [(rest / HOUR, 'H'), (rest % HOUR / MINUTE, 'M'), (rest % MINUTE, 'S')] {
            if amount > 0 {
                write!(f, "{amount}{letter}")?;
            }
        }
        Ok(())
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
    use super::{Duration, MAX_SECONDS};
    use proptest::prelude::{any, prop_assert_eq, proptest};

    #[test]
    fn texts_are_seconds() {
        for (text, seconds) in [
            ("P7D", 604_800),
            ("PT30M", 1_800),
            ("P0D", 0),
            ("P1DT12H", 129_600),
            ("P2W", 1_209_600),
            ("PT24H", 86_400),
            ("PT90S", 90),
            ("P1W2DT3M", 777_780),
            ("P99999W", MAX_SECONDS),
        ] {
            assert_eq!(text.parse::<Duration>().unwrap().seconds(), seconds, "{text}");
        }
        for bad in [
            "",
            "7 days",
            "P",
            "PT",
            "-P7D",
            "P1M",
            "P1Y",
            "PT0.5S",
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
        for text in ["P7D", "P21D", "PT1H", "PT6H", "PT24H", "P0D", "PT30M", "P2DT3H", "PT1M30S"] {
            assert_eq!(text.parse::<Duration>().unwrap().to_string(), text);
        }
        assert_eq!(serde_json::to_string(&Duration::from_days(7)).unwrap(), "\"P7D\"");
        assert!(serde_json::from_str::<Duration>("7").is_err());
    }

    proptest! {
        #[test]
        fn every_duration_survives_its_text(seconds in 0..=MAX_SECONDS) {
            let duration = Duration::from_seconds(seconds);
            prop_assert_eq!(duration.to_string().parse::<Duration>(), Ok(duration));
        }

        #[test]
        fn no_text_panics(text in any::<String>(), digits in "P?[0-9]{0,25}[DWHT]?[0-9]{0,25}[HMS]?") {
            let _ = text.parse::<Duration>();
            let _ = digits.parse::<Duration>();
        }
    }
}
