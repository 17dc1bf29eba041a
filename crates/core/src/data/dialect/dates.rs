//! Dates as people write them.

use super::super::stamp::{BadStamp, read_stamp, rfc3339};
use crate::data::SECOND;
use crate::fault::Fault;
use jiff::civil::DateTime;
use jiff::fmt::strtime;
use jiff::tz::{AmbiguousOffset, TimeZone};
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;
use utoipa::ToSchema;

/// The form of dates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DateForm {
    /// 2026-01-31T12:00:00, with or without an offset.
    Iso,
    /// 2026/01/31 12:00
    YearFirst,
    /// 31.01.2026 12:00
    DayFirst,
    /// 01/31/2026 12:00 PM
    MonthFirst,
    /// Seconds since 1970.
    UnixSeconds,
    /// Milliseconds since 1970.
    UnixMilliseconds,
}

/// The forms in the order in which they are tried: numbers are told at once, and what is left to the patterns
/// of days is costly.
const FORMS: [DateForm; 6] = [
    DateForm::Iso,
    DateForm::UnixSeconds,
    DateForm::UnixMilliseconds,
    DateForm::YearFirst,
    DateForm::DayFirst,
    DateForm::MonthFirst,
];

/// Times of the day behind a date.
const CLOCKS: [&str; 7] =
    ["%n%H:%M", "%n%H:%M:%S%.f", "", "T%H:%M:%S%.f", ",%n%H:%M:%S%.f", "%n%I:%M%n%p", "%n%I:%M:%S%n%p"];

/// A file is not read as of 2001 or before where its times are numbers: smaller ones count something else.
const FIRST_UNIX: f64 = 1e9;
const LAST_UNIX: f64 = 4.2e9;

/// The share of times that a form may leave unread.
const UNREAD: f64 = 0.1;
/// The years that a time may be of.
const YEARS: std::ops::RangeInclusive<i16> = 1970..=2100;
/// No time is longer.
const LONGEST: usize = 64;
/// `1/1/26` has no fewer digits.
const LEAST_DIGITS: usize = 4;

impl std::str::FromStr for DateForm {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = serde_json::from_value(serde_json::Value::String(text.to_owned()));
        form.map_err(|_| {
            "one of iso, year_first, day_first, month_first, unix_seconds, unix_milliseconds".to_owned()
        })
    }
}

impl DateForm {
    /// What such dates are called, where that needs saying.
    pub(super) fn in_words(self) -> Option<&'static str> {
        match self {
            DateForm::Iso => None,
            DateForm::YearFirst => Some("the year before month and day"),
            DateForm::DayFirst => Some("the day before the month"),
            DateForm::MonthFirst => Some("the month before the day"),
            DateForm::UnixSeconds => Some("times as seconds since 1970"),
            DateForm::UnixMilliseconds => Some("times as milliseconds since 1970"),
        }
    }

    /// The patterns of its days with every time of the day; made once, since each cell above a header is
    /// tried.
    fn patterns(self) -> &'static [String] {
        static YEAR_FIRST: LazyLock<Vec<String>> =
            LazyLock::new(|| with_clocks(&["%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%Y%m%d"]));
        static DAY_FIRST: LazyLock<Vec<String>> =
            LazyLock::new(|| with_clocks(&["%d.%m.%Y", "%d/%m/%Y", "%d-%m-%Y", "%d.%m.%y", "%d/%m/%y"]));
        static MONTH_FIRST: LazyLock<Vec<String>> =
            LazyLock::new(|| with_clocks(&["%m/%d/%Y", "%m-%d-%Y", "%m/%d/%y"]));
        match self {
            DateForm::YearFirst => &YEAR_FIRST,
            DateForm::DayFirst => &DAY_FIRST,
            DateForm::MonthFirst => &MONTH_FIRST,
            DateForm::Iso | DateForm::UnixSeconds | DateForm::UnixMilliseconds => &[],
        }
    }
}

fn with_clocks(days: &[&str]) -> Vec<String> {
    days.iter().flat_map(|day| CLOCKS.iter().map(move |clock| format!("{day}{clock}"))).collect()
}

/// A time that was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ReadTime {
    /// An instant, in milliseconds.
    Instant(i64),
    /// What a clock on a wall showed.
    Local(DateTime),
}

/// Reads times of one form.
#[derive(Debug)]
pub(super) struct DateReader {
    /// The form.
    pub form: DateForm,
    patterns: &'static [String],
    /// The pattern that has read the time before: most files have one.
    latest: usize,
    local: bool,
    /// The instant before, for the hour that clocks show twice.
    before: i64,
}

impl DateReader {
    fn new(form: DateForm) -> Self {
        Self { form, patterns: form.patterns(), latest: 0, local: false, before: i64::MIN }
    }

    /// The form that nearly all of these texts have; nothing where there is none.
    pub fn of(stamps: Vec<String>, asked: Option<DateForm>) -> Result<Option<Self>, Fault> {
        let stamps: Vec<&str> = stamps.iter().map(String::as_str).filter(|text| !text.is_empty()).collect();
        let mut fitting = Vec::new();
        for form in FORMS.into_iter().filter(|form| asked.is_none_or(|asked| asked == *form)) {
            let mut reader = Self::new(form);
            let Some(read) = reader.read_most(&stamps) else { continue };
            reader.local = read.iter().any(|time| matches!(time, ReadTime::Local(_)));
            fitting.push((reader, disorder(&read)));
            // Day and month may both come first; no other two forms read one text.
            if form != DateForm::DayFirst {
                break;
            }
        }
        let Some((second, its_disorder)) = fitting.pop() else { return Ok(None) };
        let Some((first, disorder)) = fitting.pop() else { return Ok(Some(second)) };
        // The wrong one jumps by months where the right one goes on by days.
        match disorder.cmp(&its_disorder) {
            std::cmp::Ordering::Less => Ok(Some(first)),
            std::cmp::Ordering::Greater => Ok(Some(second)),
            std::cmp::Ordering::Equal => {
                let detail = format!("`{}` could be two days: which comes first, day or month?", stamps[0]);
                Err(Fault::new("time", "ambiguous-dates", detail)
                    .suggest("say dates=day_first or dates=month_first"))
            }
        }
    }

    /// These times without those that cannot be read; nothing as soon as they are too many.
    fn read_most(&mut self, stamps: &[&str]) -> Option<Vec<ReadTime>> {
        let (mut read, mut unread) = (Vec::new(), 0_usize);
        for text in stamps {
            match self.read(text) {
                Some(time) => read.push(time),
                None => unread += 1,
            }
            if unread as f64 > UNREAD * stamps.len() as f64 {
                return None;
            }
        }
        (!read.is_empty()).then_some(read)
    }

    /// Whether times have no offset.
    pub fn is_local(&self) -> bool {
        self.local
    }

    fn read(&mut self, text: &str) -> Option<ReadTime> {
        match self.form {
            DateForm::Iso => match read_stamp(text) {
                Ok(millis) => Some(ReadTime::Instant(millis)),
                Err(BadStamp::Naive) => Some(ReadTime::Local(text.parse::<DateTime>().ok()?)),
                Err(_) => None,
            },
            DateForm::UnixSeconds | DateForm::UnixMilliseconds => {
                let seconds = if self.form == DateForm::UnixSeconds { 1.0 } else { 1e-3 };
                let number = text.trim().replace(',', ".").parse::<f64>().ok()? * seconds;
                let is_time = (FIRST_UNIX..LAST_UNIX).contains(&number);
                is_time.then(|| ReadTime::Instant((number * SECOND as f64).round() as i64))
            }
            DateForm::YearFirst | DateForm::DayFirst | DateForm::MonthFirst => {
                let text = text.trim();
                let by = |pattern: &String| {
                    let parsed = strtime::parse(pattern, text).ok()?;
                    let whole = parsed.to_datetime();
                    let time = whole.or_else(|_| parsed.to_date().map(|date| date.at(0, 0, 0, 0))).ok()?;
                    // `%Y` takes one digit and more: `26` is read as a year by it, and as 2026 by another.
                    YEARS.contains(&time.year()).then_some(time)
                };
                let known = by(&self.patterns[self.latest]);
                let found = known.or_else(|| {
                    let (at, time) = self
                        .patterns
                        .iter()
                        .enumerate()
                        .find_map(|(at, pattern)| Some((at, by(pattern)?)))?;
                    self.latest = at;
                    Some(time)
                });
                found.map(ReadTime::Local)
            }
        }
    }

    /// A time as the parser reads it: an instant where there is an offset or a zone, a local time otherwise.
    /// Of the hour that clocks show twice the first counts, until a time goes back. What cannot be read, or
    /// was skipped by the clock, stays what nobody can read.
    pub fn written(&mut self, text: &str, zone: Option<&TimeZone>) -> String {
        let instant = match (self.read(text), zone) {
            (None, _) => return text.to_owned(),
            (Some(ReadTime::Instant(millis)), _) => millis,
            (Some(ReadTime::Local(local)), None) => return local.to_string(),
            (Some(ReadTime::Local(local)), Some(zone)) => {
                let at = |offset: jiff::tz::Offset| {
                    offset.to_timestamp(local).map(|instant| instant.as_millisecond()).ok()
                };
                let found = match zone.to_ambiguous_timestamp(local).offset() {
                    AmbiguousOffset::Unambiguous { offset } => at(offset),
                    AmbiguousOffset::Gap { .. } => None,
                    AmbiguousOffset::Fold { before, after } => {
                        at(before).filter(|first| *first > self.before).or_else(|| at(after))
                    }
                };
                match found {
                    Some(millis) => millis,
                    None => return format!("{text}: skipped by the clock"),
                }
            }
        };
        self.before = instant;
        rfc3339(instant)
    }
}

/// Whether a text is a time of any form.
pub(super) fn is_stamp(text: &str) -> bool {
    let text = text.trim();
    let digits = text.bytes().filter(u8::is_ascii_digit).take(LEAST_DIGITS).count();
    if text.len() > LONGEST
        || digits < LEAST_DIGITS
        || !text.starts_with(|letter: char| letter.is_ascii_digit())
    {
        return false;
    }
    FORMS.into_iter().any(|form| DateReader::new(form).read(text).is_some())
}

/// How often times go back, and the longest step.
fn disorder(times: &[ReadTime]) -> (usize, i64) {
    let millis = |time: &ReadTime| match time {
        ReadTime::Instant(millis) => *millis,
        ReadTime::Local(local) => {
            local.to_zoned(TimeZone::UTC).map_or(0, |zoned| zoned.timestamp().as_millisecond())
        }
    };
    let steps = times.windows(2).map(|pair| millis(&pair[1]) - millis(&pair[0]));
    steps.fold((0, 0), |(back, longest), step| (back + usize::from(step < 0), longest.max(step)))
}
