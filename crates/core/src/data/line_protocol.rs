//! The line protocol of InfluxDB: what Home Assistant, Telegraf and many others send.
//!
//! ```text
//! measurement,tag=value,tag=value field=20.5,field="text" 1767571200000000000
//! ```
//!
//! A backslash takes their meaning from commas, blanks and equals signs of names, and from quotes and
//! backslashes of texts; before anything else it is a backslash. Texts may go over several lines.

use super::duration::{HOUR, MINUTE, SECOND};
use std::borrow::Cow;

use crate::fault::{Fault, shown};

/// One line: fields that were measured at a time, with tags that say where.
#[derive(Debug, Clone, PartialEq)]
pub struct LinePoint<'a> {
    /// The line on which it begins, counted from 1.
    pub line: usize,
    /// What is measured, by the word of whoever sends it.
    pub measurement: Cow<'a, str>,
    /// Tags with their values, in the order of the line.
    pub tags: Vec<(Cow<'a, str>, Cow<'a, str>)>,
    /// Fields with their values, at least one.
    pub fields: Vec<(Cow<'a, str>, FieldValue<'a>)>,
    /// When, in the precision that the sender says elsewhere; `None` leaves it to whoever receives it.
    pub time: Option<i64>,
}

impl LinePoint<'_> {
    /// The value of a tag.
    pub fn tag(&self, name: &str) -> Option<&str> {
        self.tags.iter().find(|(tag, _)| tag == name).map(|(_, value)| &**value)
    }
}

/// What a field holds.
#[derive(Debug, Clone, PartialEq)]
pub enum FieldValue<'a> {
    /// A finite number; integers and truth values are numbers as well.
    Number(f64),
    /// A text, such as `unavailable`.
    Text(Cow<'a, str>),
}

/// In which unit the times of lines are counted since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TimePrecision {
    /// Nanoseconds.
    #[default]
    Nanoseconds,
    /// Microseconds.
    Microseconds,
    /// Milliseconds.
    Milliseconds,
    /// Seconds.
    Seconds,
    /// Minutes.
    Minutes,
    /// Hours.
    Hours,
}

impl TimePrecision {
    /// The precision of a word of the query: `ns`, `us`, `ms`, `s`, and those of version 1, `n`, `u`, `µ`,
    /// `m` and `h`.
    pub fn of_word(word: &str) -> Option<Self> {
        Some(match word {
            "ns" | "n" => Self::Nanoseconds,
            "us" | "u" | "µ" => Self::Microseconds,
            "ms" => Self::Milliseconds,
            "s" => Self::Seconds,
            "m" => Self::Minutes,
            "h" => Self::Hours,
            _ => return None,
        })
    }

    /// The millisecond in which a time lies.
    pub fn millis(self, time: i64) -> i64 {
        match self {
            Self::Nanoseconds => time.div_euclid(1_000_000),
            Self::Microseconds => time.div_euclid(1_000),
            Self::Milliseconds => time,
            Self::Seconds => time.saturating_mul(SECOND),
            Self::Minutes => time.saturating_mul(MINUTE),
            Self::Hours => time.saturating_mul(HOUR),
        }
    }
}

/// The points of a text, line by line; a line that cannot be read is a fault that names it and the reason,
/// and the next line goes on. Empty lines and those that begin with `#` are left out.
pub fn line_points(text: &str) -> LinePoints<'_> {
    LinePoints { text, at: 0, line: 1 }
}

/// The points of a text.
#[derive(Debug)]
pub struct LinePoints<'a> {
    text: &'a str,
    /// The byte that is read next.
    at: usize,
    /// Its line, counted from 1.
    line: usize,
}

impl<'a> Iterator for LinePoints<'a> {
    type Item = Result<LinePoint<'a>, Fault>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            while let Some(byte) = self.peek().filter(u8::is_ascii_whitespace) {
                self.line += usize::from(byte == b'\n');
                self.at += 1;
            }
            match self.peek()? {
                b'#' => self.skip_line(),
                _ => break,
            }
        }
        let (line, start) = (self.line, self.at);
        let read = self.point();
        if read.is_err() {
            // The texts of a line that cannot be read may end nowhere: what follows begins behind its first
            // end.
            (self.line, self.at) = (line, start);
            self.skip_line();
        }
        Some(read.map_err(|(code, detail)| Fault::new(format!("line {line}"), code, detail)))
    }
}

/// A stable slug, and a sentence.
type Reason = (&'static str, String);

impl<'a> LinePoints<'a> {
    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn skip_line(&mut self) {
        let rest = &self.text.as_bytes()[self.at..];
        self.at += rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
    }

    fn skip_blanks(&mut self) {
        while self.peek().is_some_and(|byte| byte == b' ' || byte == b'\r' || byte == b'\t') {
            self.at += 1;
        }
    }

    fn point(&mut self) -> Result<LinePoint<'a>, Reason> {
        let line = self.line;
        let measurement = self.name(b", ");
        if measurement.is_empty() {
            return Err(("no-measurement", "the line does not begin with a measurement".to_owned()));
        }
        let mut tags = Vec::new();
        while self.peek() == Some(b',') {
            self.at += 1;
            let name = self.name(b"=, ");
            if name.is_empty() || self.peek() != Some(b'=') {
                return Err(("bad-tag", format!("`{}` is no tag=value", shown(&name))));
            }
            self.at += 1;
            let value = self.name(b", ");
            if value.is_empty() {
                return Err(("bad-tag", format!("the tag `{}` has no value", shown(&name))));
            }
            tags.push((name, value));
        }
        self.skip_blanks();
        let mut fields = Vec::new();
        loop {
            let name = self.name(b"=, ");
            if name.is_empty() || self.peek() != Some(b'=') {
                let detail = match fields.is_empty() && name.is_empty() {
                    true => "the line has no fields".to_owned(),
                    false => format!("`{}` is no field=value", shown(&name)),
                };
                return Err(("bad-field", detail));
            }
            self.at += 1;
            let value = self.value(&name)?;
            fields.push((name, value));
            if self.peek() != Some(b',') {
                break;
            }
            self.at += 1;
        }
        self.skip_blanks();
        let time = self.word();
        let time = match time {
            "" => None,
            text => Some(
                text.parse()
                    .map_err(|_| ("bad-time", format!("`{}` is no whole number of time", shown(text))))?,
            ),
        };
        self.skip_blanks();
        match self.peek() {
            None | Some(b'\n') => Ok(LinePoint { line, measurement, tags, fields, time }),
            Some(_) => Err(("bad-line", "something stands behind the time".to_owned())),
        }
    }

    /// A name up to one of these bytes, or the end of the line, without the backslashes that shield them.
    fn name(&mut self, ends: &[u8]) -> Cow<'a, str> {
        let bytes = self.text.as_bytes();
        let start = self.at;
        let mut is_shielding = false;
        while let Some(byte) = self.peek() {
            let is_shield = byte == b'\\' && bytes.get(self.at + 1).is_some_and(|next| b",= ".contains(next));
            if is_shield {
                is_shielding = true;
                self.at += 2;
                continue;
            }
            if ends.contains(&byte) || byte == b'\n' || byte == b'\r' {
                break;
            }
            self.at += 1;
        }
        let raw = &self.text[start..self.at];
        if is_shielding { Cow::Owned(unshielded(raw, &[',', '=', ' '])) } else { Cow::Borrowed(raw) }
    }

    /// Everything up to the next blank or comma, or the end of the line.
    fn word(&mut self) -> &'a str {
        let start = self.at;
        while self.peek().is_some_and(|byte| !b", \t\r\n".contains(&byte)) {
            self.at += 1;
        }
        &self.text[start..self.at]
    }

    fn value(&mut self, field: &str) -> Result<FieldValue<'a>, Reason> {
        if self.peek() == Some(b'"') {
            return self.quoted(field).map(FieldValue::Text);
        }
        let word = self.word();
        let number = match word {
            "t" | "T" | "true" | "True" | "TRUE" => Some(1.0),
            "f" | "F" | "false" | "False" | "FALSE" => Some(0.0),
            _ => number(word),
        };
        number.map(FieldValue::Number).ok_or_else(|| {
            let detail = format!("`{}` of the field `{}` is no value", shown(word), shown(field));
            ("bad-value", format!("{detail}: a number, 5i, 5u, true, false, or a text in quotes"))
        })
    }

    fn quoted(&mut self, field: &str) -> Result<Cow<'a, str>, Reason> {
        let bytes = self.text.as_bytes();
        self.at += 1;
        let (start, line) = (self.at, self.line);
        let mut is_shielding = false;
        while let Some(byte) = self.peek() {
            match byte {
                b'\\' if bytes.get(self.at + 1).is_some_and(|next| b"\"\\".contains(next)) => {
                    is_shielding = true;
                    self.at += 2;
                }
                b'"' => {
                    let raw = &self.text[start..self.at];
                    self.at += 1;
                    return Ok(match is_shielding {
                        true => Cow::Owned(unshielded(raw, &['"', '\\'])),
                        false => Cow::Borrowed(raw),
                    });
                }
                _ => {
                    self.line += usize::from(byte == b'\n');
                    self.at += 1;
                }
            }
        }
        self.line = line;
        Err(("open-text", format!("the text of the field `{}` has no closing quote", shown(field))))
    }
}

/// A finite number: a decimal one, or a whole one that ends in `i` or `u`.
fn number(word: &str) -> Option<f64> {
    if let Some(digits) = word.strip_suffix('i') {
        return digits.parse::<i64>().ok().map(|whole| whole as f64);
    }
    if let Some(digits) = word.strip_suffix('u') {
        return digits.parse::<u64>().ok().map(|whole| whole as f64);
    }
    // `inf`, `NaN` and the like are words to a parser of numbers as well, and none to the protocol.
    let is_plain = word.bytes().all(|byte| byte.is_ascii_digit() || b"+-.eE".contains(&byte));
    word.parse().ok().filter(|value: &f64| is_plain && value.is_finite())
}

/// A text without the backslashes before these characters.
fn unshielded(raw: &str, shielded: &[char]) -> String {
    let mut text = String::with_capacity(raw.len());
    let mut characters = raw.chars().peekable();
    while let Some(character) = characters.next() {
        match characters.peek() {
            Some(next) if character == '\\' && shielded.contains(next) => {
                text.push(*next);
                characters.next();
            }
            _ => text.push(character),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{any, prop, prop_assert, prop_assert_eq, prop_oneof, proptest};
    use proptest::strategy::Strategy;

    fn points(text: &str) -> Vec<LinePoint<'_>> {
        line_points(text).collect::<Result<_, _>>().unwrap()
    }

    fn fault(text: &str) -> (String, String) {
        let fault = line_points(text).find_map(Result::err).unwrap();
        (fault.pointer, fault.code)
    }

    #[test]
    fn a_line_has_a_measurement_tags_fields_and_a_time() {
        let text = "# of a house\n\n°C,domain=sensor,entity_id=living_room_temperature value=20.5,\
            friendly_name_str=\"Living \\\"room\\\", 1\" 1767571200000000000\r\nW value=5i,on=t,u=7u\n";
        let read = points(text);
        assert_eq!(read.len(), 2);
        assert_eq!(read[0].measurement, "°C");
        assert_eq!(read[0].tag("entity_id"), Some("living_room_temperature"));
        assert_eq!(read[0].fields[0], ("value".into(), FieldValue::Number(20.5)));
        assert_eq!(read[0].fields[1].1, FieldValue::Text("Living \"room\", 1".into()));
        assert_eq!(read[0].time, Some(1_767_571_200_000_000_000));
        let numbers: Vec<&FieldValue<'_>> = read[1].fields.iter().map(|(_, value)| value).collect();
        assert_eq!(numbers, [5.0, 1.0, 7.0].map(FieldValue::Number).iter().collect::<Vec<_>>());
        assert_eq!((read[1].time, read[1].tags.len()), (None, 0));
    }

    #[test]
    fn a_backslash_shields_what_would_end_a_name() {
        let read = points(r"my\ home\,1,a\=b=c\ d\,e,path=C:\x f\ g=1 5");
        assert_eq!(read[0].measurement, "my home,1");
        assert_eq!(read[0].tags, [("a=b".into(), "c d,e".into()), ("path".into(), r"C:\x".into())]);
        assert_eq!(read[0].fields, [("f g".into(), FieldValue::Number(1.0))]);
        let text = "a t=\"two\nlines\" 1\nb v=1";
        let read = points(text);
        assert_eq!(read[0].fields[0].1, FieldValue::Text("two\nlines".into()));
        assert_eq!((read[0].line, read[1].line), (1, 3));
    }

    #[test]
    fn a_fault_names_its_line_and_the_next_one_goes_on() {
        for (text, code) in [
            ("ok v=1\n,t=1 v=1", "no-measurement"),
            ("ok v=1\na,t= v=1", "bad-tag"),
            ("ok v=1\na,t v=1", "bad-tag"),
            ("ok v=1\na,t=1", "bad-field"),
            ("ok v=1\na v=1,", "bad-field"),
            ("ok v=1\na v", "bad-field"),
            ("ok v=1\na v=", "bad-value"),
            ("ok v=1\na v=NaN", "bad-value"),
            ("ok v=1\na v=inf", "bad-value"),
            ("ok v=1\na v=1e999", "bad-value"),
            ("ok v=1\na v=1.5i", "bad-value"),
            ("ok v=1\na v=unavailable", "bad-value"),
            ("ok v=1\na v=1 noon", "bad-time"),
            ("ok v=1\na v=1 1.5", "bad-time"),
            ("ok v=1\na v=1 99999999999999999999", "bad-time"),
            ("ok v=1\na v=1 1 2", "bad-line"),
            ("ok v=1\na v=\"open 1", "open-text"),
        ] {
            assert_eq!(fault(text), ("line 2".to_owned(), code.to_owned()), "{text}");
        }
        let mixed: Vec<bool> = line_points("a v=1\nb\nc v=\"x\nd v=2").map(|read| read.is_ok()).collect();
        assert_eq!(mixed, [true, false, false, true]);
    }

    #[test]
    fn times_are_milliseconds_in_the_end() {
        let millis = |word: &str, time: i64| TimePrecision::of_word(word).unwrap().millis(time);
        assert_eq!((millis("ns", -1), millis("us", 2_999), millis("u", 3_000)), (-1, 2, 3));
        assert_eq!(
            (millis("ms", 1_999), millis("s", 7), millis("m", 2), millis("h", 1)),
            (1_999, 7_000, 120_000, 3_600_000)
        );
        assert_eq!((TimePrecision::of_word("d"), millis("h", i64::MAX)), (None, i64::MAX));
    }

    fn name() -> impl Strategy<Value = String> {
        "[a-zA-Z°_,= /-]{1,12}".prop_filter("a comment", |name| !name.starts_with('#'))
    }

    fn written(text: &str) -> String {
        text.replace(',', "\\,").replace('=', "\\=").replace(' ', "\\ ")
    }

    proptest! {
        #[test]
        fn nothing_that_is_sent_is_a_panic(text in any::<String>()) {
            let lines = text.lines().count();
            prop_assert!(line_points(&text).count() <= lines);
        }

        #[test]
        fn what_looks_like_lines_is_no_panic_either(
            parts in prop::collection::vec(prop_oneof!["[a,= \"\\\\\n#1.tie-]{0,6}", " v=1 5\n"], 0..20)
        ) {
            let text = parts.concat();
            for fault in line_points(&text).filter_map(Result::err) {
                prop_assert!(fault.pointer.starts_with("line "));
            }
        }

        #[test]
        fn what_is_written_is_what_is_read(
            measurement in name(),
            tags in prop::collection::vec((name(), name()), 0..3),
            fields in prop::collection::vec((name(), -1e300..1e300), 1..4),
            text in "[a-z\"\\\\, =\n]{0,12}",
            time in any::<i64>(),
        ) {
            let mut line = written(&measurement);
            for (tag, value) in &tags {
                line += &format!(",{}={}", written(tag), written(value));
            }
            line += " ";
            for (field, value) in &fields {
                line += &format!("{}={value:?},", written(field));
            }
            let quoted = text.replace('\\', "\\\\").replace('"', "\\\"");
            line += &format!("text=\"{quoted}\" {time}\n");
            let read = points(&line);
            prop_assert_eq!(read.len(), 1);
            prop_assert_eq!(&*read[0].measurement, measurement.as_str());
            prop_assert_eq!(read[0].time, Some(time));
            let read_tags: Vec<_> =
                read[0].tags.iter().map(|(tag, value)| (tag.to_string(), value.to_string())).collect();
            prop_assert_eq!(read_tags, tags);
            for ((name, value), (wanted, number)) in read[0].fields.iter().zip(&fields) {
                prop_assert_eq!((&**name, value), (wanted.as_str(), &FieldValue::Number(*number)));
            }
            prop_assert_eq!(&read[0].fields[fields.len()].1, &FieldValue::Text(text.into()));
        }
    }
}
