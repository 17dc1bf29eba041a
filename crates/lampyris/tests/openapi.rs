//! The description of the surface and the surface agree, both ways.
//!
//! `UPDATE_OPENAPI=1 cargo test --release --workspace --test openapi` writes the committed description anew.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[path = "support/mod.rs"]
mod support;

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use support::TestApp;

const METHODS: [&str; 5] = ["get", "put", "post", "delete", "patch"];

#[test]
fn the_committed_description_is_the_generated_one() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../openapi.yaml");
    let generated = lampyris::http::openapi_yaml();
    assert!(generated.contains("openapi: 3.1"), "nothing was generated");
    if std::env::var_os("UPDATE_OPENAPI").is_some() {
        std::fs::write(&file, &generated).unwrap();
    }
    let committed = std::fs::read_to_string(&file).unwrap_or_default();
    let differs =
        committed.lines().zip(generated.lines()).position(|(committed, generated)| committed != generated);
    assert!(
        committed == generated,
        "openapi.yaml differs from the handlers from line {}: UPDATE_OPENAPI=1 cargo test --release \
        --workspace --test openapi writes it anew",
        differs.map_or(committed.lines().count().min(generated.lines().count()), |line| line + 1)
    );
}

#[test]
fn every_described_path_exists_with_these_methods_and_no_others() {
    let app = TestApp::start();
    let paths = lampyris::http::described_paths();
    assert!(paths.len() >= 20);
    for (path, described) in paths {
        let described: BTreeSet<&str> =
            described.iter().map(String::as_str).filter(|method| METHODS.contains(method)).collect();
        let concrete = path.replace("{kind}", "room").replace("{id}", "none").replace("{name}", "none");
        for method in METHODS {
            let answer = app
                .send(
                    &method.to_uppercase(),
                    &concrete,
                    // A server may close a connection whose body it has refused to read; none is used twice.
                    &[("content-type", "application/json"), ("connection", "close")],
                    (method != "get").then_some(b"[]".as_slice()),
                )
                .unwrap();
            let exists =
                answer.status != 405 && !(answer.status == 404 && answer.text.contains("\"not-found\""));
            // A thing that is not there is a 404 of its own kind, so the path itself is known.
            assert_eq!(
                exists,
                described.contains(method),
                "{method} {path}: {} {}",
                answer.status,
                answer.text
            );
        }
    }
}

/// All operations of the description.
fn operations() -> Vec<Value> {
    let description: Value = serde_json::from_str(&lampyris::http::openapi_json()).unwrap();
    let paths = description["paths"].as_object().unwrap();
    paths.values().flat_map(|item| METHODS.iter().filter_map(|method| item.get(*method)).cloned()).collect()
}

/// The successes of an operation that have a body: media types with their contents.
fn successes(operation: &Value) -> impl Iterator<Item = (&String, &Value)> {
    let responses = operation["responses"]
        .as_object()
        .into_iter()
        .flatten()
        .filter(|(status, _)| status.starts_with('2'));
    responses.flat_map(|(_, response)| response["content"].as_object().into_iter().flatten())
}

#[test]
fn every_operation_is_declared_once_with_its_scope_and_nothing_else_is() {
    let operations = operations();
    let described: BTreeSet<&str> =
        operations.iter().map(|operation| operation["operationId"].as_str().unwrap()).collect();
    let declared: Vec<&str> = lampyris::http::declared_operations().collect();
    let once: BTreeSet<&str> = declared.iter().copied().collect();
    assert_eq!(once, described);
    assert_eq!(once.len(), declared.len(), "an operation is declared twice");
}

#[test]
fn every_operation_shows_what_is_sent_and_what_is_answered() {
    let mut without = Vec::new();
    for operation in operations() {
        let name = operation["operationId"].as_str().unwrap();
        if let Some(content) = operation["requestBody"]["content"].as_object()
            && content.values().all(|content| content.get("examples").is_none())
        {
            without.push(format!("{name}: no example of its body"));
        }
        for (media_type, content) in successes(&operation) {
            if content.get("example").is_none() {
                without.push(format!("{name}: no example of its answer as {media_type}"));
            }
        }
    }
    assert!(without.is_empty(), "{without:#?}");
}

#[test]
fn every_example_belongs_to_an_operation() {
    let operations = operations();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/http/examples");
    // The page and the book are no part of the surface: their addresses are their own.
    let outside = ["web.rs", "book.rs"];
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    for file in files.filter(|path| path.is_file() && !outside.iter().any(|name| path.ends_with(name))) {
        let text = std::fs::read_to_string(file).unwrap();
        for (name, examples) in serde_json::from_str::<serde_json::Map<String, Value>>(&text).unwrap() {
            let operation = operations.iter().find(|operation| operation["operationId"] == *name);
            let operation = operation.unwrap_or_else(|| panic!("there is no operation {name}"));
            for media_type in
                examples["requests"].as_object().into_iter().flatten().map(|(media_type, _)| media_type)
            {
                assert!(
                    !operation["requestBody"]["content"][media_type].is_null(),
                    "{name} takes no {media_type}"
                );
            }
            for media_type in
                examples["answers"].as_object().into_iter().flatten().map(|(media_type, _)| media_type)
            {
                assert!(
                    successes(operation).any(|(described, _)| described == media_type),
                    "{name} answers no {media_type}"
                );
            }
        }
    }
}

#[test]
fn every_path_of_the_sources_is_described() {
    let described: BTreeSet<String> =
        lampyris::http::described_paths().into_iter().map(|(path, _)| path).collect();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/http");
    let mut undescribed = Vec::new();
    // The page and the book are no part of the surface: their addresses are their own.
    let outside = ["web.rs", "book.rs"];
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    for file in files.filter(|path| path.is_file() && !outside.iter().any(|name| path.ends_with(name))) {
        let text = std::fs::read_to_string(file).unwrap();
        // A plain `.route(` would add a path that no description knows.
        undescribed.extend(
            text.match_indices(".route(")
                .map(|(at, _)| text[at..].lines().next().unwrap_or_default().to_owned()),
        );
        let named = text
            .match_indices("path = \"/")
            .map(|(at, _)| text[at + 8..].split('"').next().unwrap_or_default().to_owned());
        undescribed.extend(named.filter(|path| !described.contains(path)));
    }
    assert!(undescribed.is_empty(), "{undescribed:?}");
}
