//! The description of the surface and the surface agree, both ways.
//!
//! `UPDATE_OPENAPI=1 cargo test --test openapi` writes the committed description anew.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[path = "support/mod.rs"]
mod support;

use std::collections::BTreeSet;
use std::path::Path;
use support::TestApp;

const METHODS: [&str; 5] = ["get", "put", "post", "delete", "patch"];

#[test]
fn the_committed_description_is_the_generated_one() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi.yaml");
    let generated = lampyris::http::openapi_yaml();
    assert!(generated.contains("openapi: 3.1"), "nothing was generated");
    if std::env::var_os("UPDATE_OPENAPI").is_some() {
        std::fs::write(&file, &generated).unwrap();
    }
    let committed = std::fs::read_to_string(&file).unwrap_or_default();
    let differs = committed.lines().zip(generated.lines()).position(|(committed, generated)| committed != generated);
    assert!(
        committed == generated,
        "openapi.yaml differs from the handlers from line {}: UPDATE_OPENAPI=1 cargo test --test openapi writes it anew",
        differs.map_or(committed.lines().count().min(generated.lines().count()), |line| line + 1)
    );
}

#[test]
fn every_described_path_exists_with_these_methods_and_no_others() {
    let app = TestApp::start();
    let paths = lampyris::http::described_paths();
    assert!(paths.len() >= 20);
    for (path, described) in paths {
        let described: BTreeSet<&str> = described.iter().map(String::as_str).filter(|method| METHODS.contains(method)).collect();
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
            let exists = answer.status != 405 && !(answer.status == 404 && answer.text.contains("\"not-found\""));
            // A thing that is not there is a 404 of its own kind, so the path itself is known.
            assert_eq!(exists, described.contains(method), "{method} {path}: {} {}", answer.status, answer.text);
        }
    }
}

#[test]
fn every_path_of_the_sources_is_described() {
    let described: BTreeSet<String> = lampyris::http::described_paths().into_iter().map(|(path, _)| path).collect();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/http");
    let mut undescribed = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let text = std::fs::read_to_string(entry.unwrap().path()).unwrap();
        // A plain `.route(` would add a path that no description knows.
        undescribed.extend(text.match_indices(".route(").map(|(at, _)| text[at..].lines().next().unwrap_or_default().to_owned()));
        let named = text.match_indices("path = \"/").map(|(at, _)| text[at + 8..].split('"').next().unwrap_or_default().to_owned());
        undescribed.extend(named.filter(|path| !described.contains(path)));
    }
    assert!(undescribed.is_empty(), "{undescribed:?}");
}
