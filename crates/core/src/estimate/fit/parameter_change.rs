//! A parameter that has changed, as documents say it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A parameter that is another one since a day.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterChange {
    /// Its name.
    pub parameter: String,
    /// Its title, for people.
    pub title: String,
    /// Its unit.
    pub unit: String,
    /// The likeliest day with whose beginning it changed (UTC).
    pub since: String,
    /// The days between which it did, at 95 %.
    pub since_95: [String; 2],
    /// Its value before, about.
    pub before: f64,
    /// Its value since.
    pub after: f64,
    /// The interval of 95 % of the value since, with the one before as it is.
    pub after_95: [f64; 2],
    /// By how much, in deviations.
    pub z: f64,
    /// Parameters that would explain nearly as much.
    pub instead: Vec<String>,
}

impl ParameterChange {
    /// What it says, in a plain sentence.
    pub fn sentence(&self) -> String {
        let day = |instant: &str| instant.chars().take(10).collect::<String>();
        let what = if self.title.is_empty() {
            format!("`{}`", self.parameter)
        } else {
            format!("{} (`{}`)", self.title, self.parameter)
        };
        let share = |value: f64| (100.0 * (value / self.before - 1.0)).round();
        let [low, high] = self.after_95.map(share);
        let since = match &self.since_95 {
            [first, last] if first == last => String::new(),
            [first, last] => format!(" (between {} and {})", day(first), day(last)),
        };
        let by = if self.before > 0.0 && self.unit != "degC" {
            let word = if self.after > self.before { "more" } else { "less" };
            let (low, high) = if self.after > self.before { (low, high) } else { (-high, -low) };
            format!("is about {} % {word} than before ({low} to {high} %)", share(self.after).abs())
        } else {
            format!("went from about {:.2} to {:.2} {}", self.before, self.after, self.unit)
        };
        let or = match self.instead.as_slice() {
            [] => String::new(),
            others => format!(" It may as well be {}.", others.join(" or ")),
        };
        format!("Since {}{since}, {what} {by}.{or}", day(&self.since))
    }
}
