//! What each kind of user does with the built service, from beginning to end, told as a story.
#![allow(clippy::unwrap_used, reason = "a story that cannot go on has failed")]

mod controller;
mod modeller;
mod operator;
mod reports;
#[path = "../support/mod.rs"]
mod support;
mod verbs;

use lampyris_core::twin;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use support::process::Process;

/// A service of its own, with a fresh database and a folder for files.
struct Scene {
    service: Process,
    folder: tempfile::TempDir,
}

impl Scene {
    fn open() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let service = Process::start(&folder.path().join("lampyris.db"));
        Self { service, folder }
    }

    /// Writes a file into the folder and gives its path.
    fn file(&self, name: &str, text: &str) -> String {
        let path: PathBuf = self.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        shown(&path)
    }
}

fn shown(path: &Path) -> String {
    path.to_str().unwrap().to_owned()
}

/// Two weeks of a synthetic room with two neighbours: a floor that is heated, a sun that shines.
fn twin_csv(seed: u64) -> String {
    twin::room(seed, 2, 14, 30).unwrap().csv
}

/// The same two weeks, but the sensor hangs in the second one.
fn hanging_csv(seed: u64) -> String {
    let text = twin_csv(seed);
    let hang = |(line, row): (usize, &str)| {
        let mut cells: Vec<&str> = row.split(',').collect();
        if line > 336 {
            cells[1] = "20.5";
        }
        cells.join(",") + "\n"
    };
    text.lines().enumerate().map(hang).collect()
}

/// What is known of such a room. Its weeks lie in the winter of 2026, whenever the story is told.
fn room(label: &str) -> Value {
    json!({
        "label": label, "model": "room3", "neighbours": ["room/1", "room/2"],
        "policy": {"stale_after": "P36500D"}
    })
}

/// A search that is good enough for a story.
fn request(system: &str) -> Value {
    json!({
        "kind": "estimate", "system": system, "split": {"train": "P10D", "validation": "P4D"},
        "method": {"name": "lm_multistart", "seed": 1},
    })
}
