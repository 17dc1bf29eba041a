//! Lines and tables of numbers, read from answers.

use crate::support::TestApp;
use serde_json::Value;

/// A fit of a room with two weeks of measurements: nine days to train, five to validate.
pub fn fitted(app: &TestApp, id: &str, more: Value) -> String {
    app.ended(&app.estimate(&format!("room/{id}"), more))["fit"].as_str().unwrap().to_owned()
}

/// The values of a line; a gap is NaN.
pub fn values(line: &Value) -> Vec<f64> {
    line.as_array()
        .unwrap_or_else(|| panic!("{line}"))
        .iter()
        .map(|value| value.as_f64().unwrap_or(f64::NAN))
        .collect()
}

pub fn root_mean_square(residuals: &[f64]) -> f64 {
    let known: Vec<f64> = residuals.iter().copied().filter(|e| !e.is_nan()).collect();
    (known.iter().map(|e| e * e).sum::<f64>() / known.len() as f64).sqrt()
}

pub fn near(found: f64, stored: &Value) -> bool {
    (found / stored.as_f64().unwrap() - 1.0).abs() < 1e-9
}

/// The samples of a part of a document.
pub fn part(document: &Value, name: &str) -> std::ops::Range<usize> {
    let span = document["parts"].as_array().unwrap().iter().find(|span| span["part"] == name).unwrap();
    let place = |field: &str| {
        document["time"].as_array().unwrap().iter().position(|time| *time == span[field]).unwrap()
    };
    place("from")..place("to") + 1
}

/// A table with its columns by name.
pub fn csv(text: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    (lines.next().unwrap(), lines.collect())
}
