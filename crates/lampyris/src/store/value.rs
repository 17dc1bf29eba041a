//! How values stand in columns: instants, documents, words.

use super::error::StoreError;
use jiff::Timestamp;

/// Milliseconds since 1970, as instants are stored.
pub(super) fn millis(instant: Timestamp) -> i64 {
    instant.as_millisecond()
}

pub(super) fn instant(millis: i64) -> Result<Timestamp, StoreError> {
    Timestamp::from_millisecond(millis).map_err(|error| corrupt("an instant", &error))
}

pub(super) fn corrupt(what: impl Into<String>, detail: &dyn std::fmt::Display) -> StoreError {
    StoreError::Corrupt { what: what.into(), detail: detail.to_string() }
}

/// Reads a text that this program wrote.
pub(super) fn parse<T: std::str::FromStr<Err: std::fmt::Display>>(
    what: &str,
    text: &str,
) -> Result<T, StoreError> {
    text.parse().map_err(|error| corrupt(format!("{what} `{text}`"), &error))
}

/// Reads a document that this program wrote.
pub(super) fn from_json<T: serde::de::DeserializeOwned>(what: &str, text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| corrupt(what, &error))
}

/// Writes a document.
pub(super) fn to_json<T: serde::Serialize + ?Sized>(what: &str, value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| corrupt(what, &error))
}

/// The enum of a word by which it is written in documents.
pub(super) fn from_word<T: serde::de::DeserializeOwned>(what: &str, word: &str) -> Result<T, StoreError> {
    serde_json::from_value(word.into()).map_err(|error| corrupt(what, &error))
}

/// The word by which an enum is written in documents.
pub(super) fn word<T: serde::Serialize>(value: &T) -> Result<String, StoreError> {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => Ok(word),
        Ok(other) => Err(corrupt("an enum", &other)),
        Err(error) => Err(corrupt("an enum", &error)),
    }
}
