//! Reads JSON documents and lists every fault with its place, where `serde` alone stops at the first.

use super::strict::Strict;
use lampyris_core::fault::{Fault, nearest};
use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Value};
use serde_path_to_error::{Path, Segment};
use std::collections::BTreeSet;

/// More faults than this help nobody.
const MOST_FAULTS: usize = 50;
/// From here on not every whole number is a double.
const EXACT: f64 = 9_007_199_254_740_992.0;
/// Longest detail; a message of `serde` may repeat a value of any length.
const LONGEST_DETAIL: usize = 300;

/// Why a text is no document.
#[derive(Debug, Clone, PartialEq)]
pub enum Unread {
    /// It is no JSON: line and column.
    Malformed(Fault),
    /// Names that one object has twice, of which only one could be meant.
    Repeated(Vec<Fault>),
}

/// Reads JSON text. JSON has one kind of number, so `60.0` is read as the whole number that it is.
///
/// # Errors
/// Where the text is no JSON, or a name is there twice.
pub fn parse(body: &[u8]) -> Result<Value, Unread> {
    let mut repeated = Vec::new();
    let mut text = serde_json::Deserializer::from_slice(body);
    let read = Document { pointer: String::new(), repeated: &mut repeated }.deserialize(&mut text);
    let value = read.and_then(|value| text.end().map(|()| value));
    let value = value
        .map_err(|error| Unread::Malformed(Fault::new("", "invalid-json", shorten(&error.to_string()))))?;
    if repeated.is_empty() { Ok(value) } else { Err(Unread::Repeated(repeated)) }
}

/// Reads TOML text; a name that comes twice is none to TOML either.
///
/// # Errors
/// Where the text is no TOML, with the place.
pub fn parse_toml(body: &[u8]) -> Result<Value, Fault> {
    let wrong = |error: String| Fault::new("", "invalid-toml", shorten(&error));
    let text = std::str::from_utf8(body).map_err(|error| wrong(error.to_string()))?;
    let table: toml::Table = toml::from_str(text).map_err(|error| wrong(error.to_string()))?;
    serde_json::to_value(table).map_err(|error| wrong(error.to_string()))
}

/// Reads a value and notes the names that come twice.
struct Document<'a> {
    pointer: String,
    repeated: &'a mut Vec<Fault>,
}

impl<'de> DeserializeSeed<'de> for Document<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Document<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, truth: bool) -> Result<Value, E> {
        Ok(truth.into())
    }

    fn visit_u64<E>(self, number: u64) -> Result<Value, E> {
        Ok(number.into())
    }

    fn visit_i64<E>(self, number: i64) -> Result<Value, E> {
        Ok(number.into())
    }

    fn visit_f64<E>(self, number: f64) -> Result<Value, E> {
        // Beyond this a double is not certain to be the number that was written.
        let is_whole = number.fract() == 0.0 && number.abs() < EXACT;
        Ok(if is_whole { (number as i64).into() } else { number.into() })
    }

    fn visit_str<E>(self, text: &str) -> Result<Value, E> {
        Ok(text.into())
    }

    fn visit_string<E>(self, text: String) -> Result<Value, E> {
        Ok(text.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Value, A::Error> {
        let mut items = Vec::new();
        let item = |index: usize| format!("{}/{index}", self.pointer);
        while let Some(value) =
            seq.next_element_seed(Document { pointer: item(items.len()), repeated: self.repeated })?
        {
            items.push(value);
        }
        Ok(Value::Array(items))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let mut fields = Map::new();
        while let Some(name) = map.next_key::<String>()? {
            let pointer = format!("{}/{}", self.pointer, escaped(&name));
            if fields.contains_key(&name) && self.repeated.len() < MOST_FAULTS {
                self.repeated.push(Fault::new(
                    &pointer,
                    "duplicate-field",
                    "the name is there twice, and only one can be meant",
                ));
            }
            let value = map.next_value_seed(Document { pointer, repeated: self.repeated })?;
            fields.insert(name, value);
        }
        Ok(Value::Object(fields))
    }
}

/// A name as a JSON pointer spells it.
fn escaped(name: &str) -> String {
    name.replace('~', "~0").replace('/', "~1")
}

/// As much of a document as can be read, with every fault of the rest.
#[derive(Debug)]
pub struct Read<T> {
    /// What could be read.
    pub document: Option<T>,
    /// What is wrong.
    pub faults: Vec<Fault>,
    /// Items that were taken out of lists, as they were sent.
    items: BTreeSet<String>,
}

impl<T> Read<T> {
    /// Adds what is wrong with the meaning of what could be read, at its places in the document as it was
    /// sent. What was taken out because it is wrong is not missing as well.
    pub fn add(&mut self, faults: impl IntoIterator<Item = Fault>) {
        for fault in faults {
            let fault = Fault { pointer: as_sent(&fault.pointer, &self.items), ..fault };
            let is_known = self.faults.iter().any(|known| known.pointer == fault.pointer);
            if !(is_known && fault.code == "missing-field") {
                self.faults.push(fault);
            }
        }
    }

    /// The document, if nothing is wrong.
    ///
    /// # Errors
    /// Every fault.
    pub fn finish(self) -> Result<T, Vec<Fault>> {
        self.document.filter(|_| self.faults.is_empty()).ok_or(self.faults)
    }
}

/// Reads a document of a known form.
///
/// # Errors
/// Every fault: unknown fields, missing ones, wrong types and values.
pub fn decode<T: DeserializeOwned>(value: Value) -> Result<T, Vec<Fault>> {
    read(value, &Value::Null).finish()
}

/// Reads as much of a document as can be read: whatever is wrong is taken out and the reading starts again,
/// until nothing wrong is left to be found. `stand_ins` has a value for each field of the document that must
/// be there, so that one that is not does not hide what else is wrong.
pub fn read<T: DeserializeOwned>(mut value: Value, stand_ins: &Value) -> Read<T> {
    let mut read = Read { document: None, faults: Vec::new(), items: BTreeSet::new() };
    let mut removed = BTreeSet::new();
    while read.faults.len() < MOST_FAULTS {
        let error = match serde_path_to_error::deserialize::<_, T>(Strict(&value)) {
            Ok(document) => return Read { document: Some(document), ..read },
            Err(error) => error,
        };
        let place = pointer(error.path(), &read.items);
        let fault = describe(&place, &error.inner().to_string());
        let missing = fault.pointer.clone();
        let is_missing = fault.code == "missing-field";
        // What was taken out because it is wrong is not missing as well; then its owner has to go, too.
        if !removed.contains(&missing) {
            read.faults.push(fault);
        }
        let stand_in = stand_ins.pointer(&missing).filter(|_| is_missing && place.is_empty());
        if let (Some(stand_in), Value::Object(fields)) = (stand_in, &mut value) {
            fields.insert(missing[1..].to_owned(), stand_in.clone());
        } else if remove(&mut value, error.path()) {
            if matches!(error.path().iter().next_back(), Some(Segment::Seq { .. })) {
                read.items.insert(place.clone());
            }
            removed.insert(place);
        } else {
            break;
        }
    }
    read
}

/// The place of an item of a list before others were taken out.
fn nth_sent(list: &str, index: usize, items: &BTreeSet<String>) -> String {
    let there = (0..).filter(|place: &usize| !items.contains(&format!("{list}/{place}")));
    there.skip(index).map(|place| place.to_string()).next().unwrap_or_default()
}

/// A pointer into what could be read, as a pointer into what was sent.
fn as_sent(pointer: &str, items: &BTreeSet<String>) -> String {
    let mut sent = String::new();
    for token in pointer.split('/').skip(1) {
        let is_item = items.iter().any(|item| item.rsplit_once('/').is_some_and(|(list, _)| list == sent));
        let token = match token.parse() {
            Ok(index) if is_item => nth_sent(&sent, index, items),
            _ => token.to_owned(),
        };
        sent = format!("{sent}/{token}");
    }
    if pointer.starts_with('/') { sent } else { pointer.to_owned() }
}

/// The JSON pointer of a path in the document as it was sent: items that were taken out of a list still
/// count.
fn pointer(path: &Path, items: &BTreeSet<String>) -> String {
    let mut pointer = String::new();
    for segment in path.iter() {
        let name = match segment {
            Segment::Seq { index } => nth_sent(&pointer, *index, items),
            Segment::Map { key } => escaped(key),
            Segment::Enum { .. } | Segment::Unknown => continue,
        };
        pointer.push('/');
        pointer.push_str(&name);
    }
    pointer
}

/// Takes out what a path names; the document itself cannot be taken out.
fn remove(value: &mut Value, path: &Path) -> bool {
    let steps: Vec<&Segment> = path.iter().filter(|segment| !matches!(segment, Segment::Unknown)).collect();
    let Some((last, parents)) = steps.split_last() else {
        return false;
    };
    let mut place = value;
    for step in parents {
        let next = match step {
            Segment::Seq { index } => place.get_mut(*index),
            Segment::Map { key } | Segment::Enum { variant: key } => place.get_mut(key),
            Segment::Unknown => None,
        };
        match next {
            Some(next) => place = next,
            None => return false,
        }
    }
    match (place, last) {
        (Value::Object(map), Segment::Map { key }) => map.shift_remove(key).is_some(),
        (Value::Array(items), Segment::Seq { index }) if *index < items.len() => {
            items.remove(*index);
            true
        }
        _ => false,
    }
}

/// Turns a message of `serde` into a fault, with the name that was probably meant.
fn describe(pointer: &str, message: &str) -> Fault {
    let mut quoted = message.split('`').skip(1).step_by(2);
    let first = quoted.next().unwrap_or_default();
    if message.starts_with("missing field") {
        return Fault::new(format!("{pointer}/{first}"), "missing-field", format!("`{first}` is missing"));
    }
    let code = if message.starts_with("unknown field") {
        "unknown-field"
    } else if message.starts_with("unknown variant") {
        "unknown-value"
    } else if message.starts_with("invalid type") || message.starts_with("invalid length") {
        "wrong-type"
    } else {
        "invalid-value"
    };
    let fault = Fault::new(pointer, code, shorten(&message.replace("expected f64", "expected a number")));
    let near = if code.starts_with("unknown") { nearest(first, quoted) } else { None };
    match near {
        Some(near) => fault.suggest(format!("did you mean `{near}`?")),
        None => fault,
    }
}

fn shorten(message: &str) -> String {
    let mut short: String = message.chars().take(LONGEST_DETAIL).collect();
    if short.len() < message.len() {
        short.push('…');
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        days: u32,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        name: String,
        inner: Inner,
        #[serde(default)]
        list: Vec<f64>,
    }

    #[test]
    fn every_fault_is_listed_with_its_place() {
        // What is wrong in `inner` takes `inner` along, which then is not reported as missing.
        let value =
            serde_json::json!({"nmae": "x", "inner": {"days": "7", "hours": 3}, "list": [1, "a", 2, null]});
        let faults = decode::<Outer>(value).unwrap_err();
        let seen: Vec<(&str, &str)> =
            faults.iter().map(|fault| (fault.pointer.as_str(), fault.code.as_str())).collect();
        assert_eq!(
            seen,
            [
                ("/nmae", "unknown-field"),
                ("/inner/days", "wrong-type"),
                ("/inner/hours", "unknown-field"),
                ("/list/1", "wrong-type"),
                ("/list/3", "wrong-type"),
                ("/name", "missing-field"),
            ]
        );
        assert_eq!(faults[0].suggestion.as_deref(), Some("did you mean `name`?"));
        assert_eq!(faults[3].detail, "invalid type: string \"a\", expected a number");
    }

    #[test]
    fn what_is_missing_hides_nothing() {
        let stand_ins = serde_json::json!({"name": "x", "inner": {"days": 1}});
        let mut read = read::<Outer>(serde_json::json!({"inner": [], "list": [1, "a", 3]}), &stand_ins);
        assert_eq!(
            read.document,
            Some(Outer { name: "x".into(), inner: Inner { days: 1 }, list: vec![1.0, 3.0] })
        );
        // What is second now was third.
        read.add([
            Fault::new("/list/1", "odd", "three is odd"),
            Fault::new("path", "odd", "no place in the document"),
        ]);
        let seen: Vec<(&str, &str)> =
            read.faults.iter().map(|fault| (fault.pointer.as_str(), fault.code.as_str())).collect();
        let expected = [
            ("/inner", "wrong-type"),
            ("/list/1", "wrong-type"),
            ("/name", "missing-field"),
            ("/list/2", "odd"),
            ("path", "odd"),
        ];
        assert_eq!(seen, expected);
    }

    #[test]
    fn texts_are_read_as_json_means_them() {
        assert_eq!(
            parse(br#"{"a": [1.0, 2.5, 6e2, -3, null, true, "x"]}"#).unwrap(),
            serde_json::json!({"a": [1, 2.5, 600, -3, null, true, "x"]})
        );
        for bad in [&b"{\"a\": 1e999}"[..], b"", b"{} {}", b"[NaN]", b"{\"a\":}", &[b'[', 0xff, b']']] {
            assert!(
                matches!(parse(bad), Err(Unread::Malformed(fault)) if fault.code == "invalid-json"),
                "{bad:?}"
            );
        }
        let Err(Unread::Repeated(faults)) = parse(br#"{"a": 1, "b": [{"c/d": 1, "c/d": 2}], "a": 1}"#) else {
            panic!()
        };
        assert_eq!(
            faults.iter().map(|fault| fault.pointer.as_str()).collect::<Vec<_>>(),
            ["/b/0/c~1d", "/a"]
        );
    }

    #[test]
    fn a_good_document_is_read_and_a_long_text_is_not_repeated() {
        let value = serde_json::json!({"name": "x", "inner": {"days": 7}});
        assert_eq!(
            decode::<Outer>(value).unwrap(),
            Outer { name: "x".into(), inner: Inner { days: 7 }, list: Vec::new() }
        );
        let faults =
            decode::<Outer>(serde_json::json!({"name": "x", "inner": "y".repeat(10_000)})).unwrap_err();
        assert!(faults[0].detail.len() < 400);
    }
}
