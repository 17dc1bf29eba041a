//! What strangers send: mutated bodies, texts for the parsers, floods, and numbers that are none.

mod corpus;
mod floods;
mod fuzz;
mod numbers;
mod parsers;

use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Map, Value, json};

type Random = Xoshiro256PlusPlus;

/// Stands for a text that no JSON writer makes; [`written`] puts it in.
const RAW: [&str; 12] = [
    "1e400",
    "-1e400",
    "1e-400",
    "-0",
    "00",
    "1.",
    ".5",
    "NaN",
    "-Infinity",
    "\"\\ud800\"",
    "\"\\u0000\"",
    "'single'",
];
const PLACEHOLDER: &str = "raw text ";

/// A value where nobody expects it.
fn nasty(random: &mut Random) -> Value {
    match random.random_range(0..24) {
        0 => json!(null),
        1 => json!(true),
        2 => json!(-0.0),
        3 => json!(1e308),
        4 => json!(5e-324),
        5 => json!(i64::MIN),
        6 => json!(u64::MAX),
        7 => json!(-1),
        8 => json!(""),
        9 => json!("NaN"),
        10 => json!("\u{0}\u{feff}\u{202e}room"),
        11 => json!("../../room/1"),
        12 => json!("'; DROP TABLE systems; --"),
        13 => json!("9".repeat(random.random_range(1..3000))),
        14 => json!("Z".repeat(random.random_range(1..5000))),
        15 => json!([]),
        16 => json!({}),
        17 => (0..random.random_range(1..140)).fold(json!(1), |inner, _| json!([inner])),
        18 => (0..random.random_range(1..140)).fold(json!(1), |inner, _| json!({ "a": inner })),
        19 => json!("((".repeat(random.random_range(1..300))),
        20 => json!("P9999999999999D"),
        21 => json!("2026-10-25T02:30:00"),
        22 => json!(vec![0; random.random_range(1..300)]),
        _ => json!(format!("{PLACEHOLDER}{}", random.random_range(0..RAW.len()))),
    }
}

/// A place in a document, drawn with equal chances.
fn place<'a>(document: &'a mut Value, random: &mut Random) -> &'a mut Value {
    let chosen = random.random_range(0..size(document));
    let mut left = chosen;
    nth(document, &mut left).unwrap()
}

fn size(document: &Value) -> usize {
    1 + match document {
        Value::Array(items) => items.iter().map(size).sum(),
        Value::Object(fields) => fields.values().map(size).sum(),
        _ => 0,
    }
}

fn nth<'a>(document: &'a mut Value, left: &mut usize) -> Option<&'a mut Value> {
    if *left == 0 {
        return Some(document);
    }
    *left -= 1;
    match document {
        Value::Array(items) => items.iter_mut().find_map(|item| nth(item, left)),
        Value::Object(fields) => fields.values_mut().find_map(|field| nth(field, left)),
        _ => None,
    }
}

/// Changes a document at some place.
fn mutate(document: &mut Value, random: &mut Random) {
    let other = place(document, random).clone();
    let place = place(document, random);
    match (random.random_range(0..6), place) {
        (0, Value::Object(fields)) if !fields.is_empty() => {
            let name = fields.keys().nth(random.random_range(0..fields.len())).cloned().unwrap();
            fields.shift_remove(&name);
        }
        (1, Value::Object(fields)) if !fields.is_empty() => {
            let name = fields.keys().nth(random.random_range(0..fields.len())).cloned().unwrap();
            let value = fields.shift_remove(&name).unwrap();
            fields.insert(format!("{name}x"), value);
        }
        (2, Value::Array(items)) if !items.is_empty() => {
            let item = items[random.random_range(0..items.len())].clone();
            items.extend(std::iter::repeat_n(item, random.random_range(1..40)));
        }
        (3, place) => *place = other,
        (4, Value::Number(number)) => {
            *number = serde_json::Number::from_f64(number.as_f64().unwrap_or(1.0) * -1e9).unwrap_or(0.into())
        }
        (4, Value::String(text)) => *text = bent(text.clone().into_bytes(), random),
        (_, place) => *place = nasty(random),
    }
}

/// A text with some bytes changed, as far as that leaves a text.
fn bent(mut bytes: Vec<u8>, random: &mut Random) -> String {
    bend(&mut bytes, random);
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Flips, inserts, drops, doubles or cuts off.
fn bend(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..random.random_range(1..4) {
        let at = random.random_range(0..bytes.len() + 1);
        let end = (at + random.random_range(0..16)).min(bytes.len());
        match random.random_range(0..5) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
            1 => bytes.insert(at, random.random_range(0..=255)),
            2 => drop(bytes.drain(at..end)),
            3 => {
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            _ if random.random_range(0..8) == 0 => bytes.truncate(at),
            _ => {}
        }
    }
}

/// A document as text, with the texts that no writer makes.
fn written(document: &Value) -> Vec<u8> {
    let mut text = document.to_string();
    if text.contains(PLACEHOLDER) {
        for (index, raw) in RAW.iter().enumerate() {
            text = text.replace(&format!("\"{PLACEHOLDER}{index}\""), raw);
        }
    }
    text.into_bytes()
}

/// A field that no document has, so that nothing of it is taken however it is mutated otherwise.
fn poison(document: &mut Value) {
    if let Value::Object(fields) = document {
        let fields: &mut Map<String, Value> = fields;
        fields.insert("no such field".to_owned(), json!(1));
    }
}
