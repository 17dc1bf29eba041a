//! RFC 3339 time stamps as whole milliseconds since 1970-01-01T00:00:00Z.

use super::duration::SECOND;
use crate::fault::Fault;

/// 2101-01-01T00:00:00Z: stamps beyond are slips of the pen.
const END: i64 = 4_133_980_800 * SECOND;
const MAX_LENGTH: usize = 64;

/// Why a stamp was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BadStamp {
    /// A local time without offset: it could mean many instants, and twice a year it means none or two.
    Naive,
    /// A bare number: seconds or milliseconds since somewhen.
    Number,
    /// An instant outside 1970..2100.
    OutOfRange,
    /// Not a time at all.
    Unreadable,
}

impl BadStamp {
    /// The reason in words, as rejected rows show it.
    pub fn reason(self) -> &'static str {
        match self {
            BadStamp::Naive => "the time has no offset",
            BadStamp::Number => "the time is a bare number",
            BadStamp::OutOfRange => "the time is outside the years 1970 to 2100",
            BadStamp::Unreadable => "the time cannot be read",
        }
    }
}

/// Reads one stamp; fractions of a millisecond are dropped.
///
/// A leap second (`23:59:60`) counts as the second before it: UTC seconds have no number of its own for it.
pub(super) fn read_stamp(text: &str) -> Result<i64, BadStamp> {
    let text = text.trim();
    if text.is_empty() || text.len() > MAX_LENGTH {
        return Err(BadStamp::Unreadable);
    }
    if let Ok(instant) = text.parse::<jiff::Timestamp>() {
        // Rounds down, also below zero, so that nothing before 1970 slips in as time 0.
        let millis = instant.as_nanosecond().div_euclid(1_000_000);
        return i64::try_from(millis)
            .ok()
            .filter(|millis| (0..END).contains(millis))
            .ok_or(BadStamp::OutOfRange);
    }
    if text.parse::<f64>().is_ok_and(f64::is_finite) {
        return Err(BadStamp::Number);
    }
    if text.parse::<jiff::civil::DateTime>().is_ok() || text.parse::<jiff::civil::Date>().is_ok() {
        return Err(BadStamp::Naive);
    }
    Err(BadStamp::Unreadable)
}

/// Reads one stamp of a request, such as the `from` of a range.
///
/// # Errors
/// A fault at `pointer` where it is no RFC 3339 time with offset between 1970 and 2100.
pub fn read_time(pointer: &str, text: &str) -> Result<i64, Fault> {
    read_stamp(text).map_err(|bad| {
        let fault = Fault::new(pointer, "bad-time", bad.reason());
        match bad {
            BadStamp::Naive => fault.suggest(format!("append an offset, `Z` for UTC: {}", in_utc(text))),
            _ => fault.suggest("write it like 2026-01-31T12:00:00Z"),
        }
    })
}

/// A text without offset as it would read in UTC, for suggestions; a bare date means its first instant.
pub(super) fn in_utc(text: &str) -> String {
    let text = crate::fault::shown(text.trim());
    if text.contains(':') { format!("{text}Z") } else { format!("{text}T00:00:00Z") }
}

/// A time as text in UTC, such as `2016-01-11T16:00:00Z`; times that no calendar holds print as their
/// milliseconds.
pub fn rfc3339(millis: i64) -> String {
    jiff::Timestamp::from_millisecond(millis)
        .map_or_else(|_| millis.to_string(), |instant| instant.to_string())
}

#[cfg(test)]
mod tests {
    use super::{BadStamp, read_stamp, read_time, rfc3339};
    use crate::data::HOUR;
    use proptest::prelude::{any, prop_assert_eq, proptest};

    #[test]
    fn offsets_lead_to_one_instant() {
        for text in [
            "2016-01-11T16:00:00Z",
            "2016-01-11T17:00:00+01:00",
            "2016-01-11 16:00:00Z",
            "2016-01-11T16:00:00.0009Z",
            " 2016-01-11t16:00:00z ",
        ] {
            assert_eq!(read_stamp(text), Ok(1_452_528_000_000), "{text}");
        }
        assert_eq!(rfc3339(1_452_528_000_000), "2016-01-11T16:00:00Z");
        assert_eq!(rfc3339(read_stamp("2016-01-11T17:00:00.01+01:00").unwrap()), "2016-01-11T16:00:00.01Z");
    }

    #[test]
    fn both_sides_of_a_clock_change_keep_their_distance() {
        let before = read_stamp("2026-10-25T02:30:00+02:00").unwrap();
        let after = read_stamp("2026-10-25T02:30:00+01:00").unwrap();
        assert_eq!(after - before, HOUR);
    }

    #[test]
    fn every_bad_kind_is_told_apart() {
        for naive in ["2016-01-11T16:00:00", "2016-01-11 16:00", "2016-01-11"] {
            assert_eq!(read_stamp(naive), Err(BadStamp::Naive), "{naive}");
        }
        for number in ["1452528000", "1452528000000", "42380.5"] {
            assert_eq!(read_stamp(number), Err(BadStamp::Number), "{number}");
        }
        for outside in
            ["0001-01-01T00:00:00Z", "1969-12-31T23:59:59.5Z", "2101-01-01T00:00:00Z", "9998-01-01T00:00:00Z"]
        {
            assert_eq!(read_stamp(outside), Err(BadStamp::OutOfRange), "{outside}");
        }
        for rubbish in ["", "NaN", "yesterday", "2016-13-01T00:00:00Z", "2016-01-11T25:00:00Z"] {
            assert_eq!(read_stamp(rubbish), Err(BadStamp::Unreadable), "{rubbish}");
        }
        let leap = read_stamp("2016-12-31T23:59:60Z").unwrap();
        assert_eq!(rfc3339(leap), "2016-12-31T23:59:59Z");
        for (text, meant) in [
            ("2016-01-11T16:00:00", "2016-01-11T16:00:00Z"),
            ("2016-01-11", "2016-01-11T00:00:00Z"),
            ("2016-01-11 16:00", "2016-01-11 16:00Z"),
        ] {
            assert!(read_time("/from", text).unwrap_err().suggestion.unwrap().ends_with(meant));
            assert!(read_stamp(meant).is_ok(), "{meant}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in any::<String>()) {
            let _ = read_stamp(&text);
        }

        #[test]
        fn every_instant_survives_its_text(millis in 0i64..4_000_000_000_000) {
            prop_assert_eq!(read_stamp(&rfc3339(millis)), Ok(millis));
        }
    }
}
