//! Documents that a verb is given.

use super::output::Failure;
use serde_json::Value;
use std::io::Read;
use std::path::Path;

/// Whether an argument is the name of a file with a document rather than the name of a thing.
pub fn is_document(argument: &Path) -> bool {
    argument.extension().is_some_and(|kind| kind == "toml" || kind == "json")
}

/// Reads a document: TOML where the name says so, otherwise JSON; `-` is standard input.
pub fn read_document(file: &Path) -> Result<Value, Failure> {
    let shown = file.display();
    let mut text = String::new();
    if file == Path::new("-") {
        std::io::stdin()
            .read_to_string(&mut text)
            .map_err(|error| Failure::Error(format!("standard input: {error}")))?;
    } else {
        text =
            std::fs::read_to_string(file).map_err(|error| Failure::NotFound(format!("{shown}: {error}")))?;
    }
    if file.extension().is_some_and(|kind| kind == "toml") {
        toml::from_str(&text).map_err(|error| Failure::Error(format!("{shown}: {error}")))
    } else {
        serde_json::from_str(&text).map_err(|error| Failure::Error(format!("{shown}: {error}")))
    }
}
