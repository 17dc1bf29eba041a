//! What is kept of a run of a study: its rows, and all that is needed to take them again.

use super::file::write;
use super::page::command;
use super::row::Row;
use jiff::Timestamp;
use lampyris::cli::Failure;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Duration;

/// Where a run is kept, and what its reader should know.
#[derive(Debug, clap::Args)]
pub struct Recording {
    /// Keep the rows, with command, seed, date and machine, as a document in this folder.
    #[arg(long = "record", global = true, value_name = "FOLDER")]
    folder: Option<PathBuf>,
    /// A sentence about the circumstances, which the document keeps.
    #[arg(long, global = true, value_name = "TEXT")]
    note: Option<String>,
}

/// A run of a study.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// The words of the command line, without folders.
    pub command: String,
    /// The first seed, where anything is drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The day on which it ended, by UTC.
    pub date: String,
    /// How long it took.
    pub seconds: f64,
    /// The release that was measured.
    pub release: String,
    pub machine: Machine,
    /// What whoever ran it says about it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
    pub rows: Vec<Row>,
}

/// What the times depend on.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    pub cpu: String,
    pub cores: usize,
}

impl Machine {
    fn this() -> Self {
        let about = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = about.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
        let cpu = model.map_or("unknown", |(_, name)| name.trim()).to_owned();
        Self { cpu, cores: std::thread::available_parallelism().map_or(1, usize::from) }
    }
}

/// Writes `<study>.json` into the folder, where one is named. The document has a line for each value, so that
/// a comparison of versions shows what a new run has changed.
pub fn keep(
    asked: &Recording,
    study: &str,
    seed: Option<u64>,
    took: Duration,
    rows: Vec<Row>,
) -> Result<(), Failure> {
    let Some(folder) = &asked.folder else { return Ok(()) };
    let record = Record {
        command: command(),
        seed,
        date: Timestamp::now().strftime("%Y-%m-%d").to_string(),
        seconds: took.as_secs_f64().round(),
        release: env!("CARGO_PKG_VERSION").to_owned(),
        machine: Machine::this(),
        note: asked.note.clone(),
        rows,
    };
    let error = |error: &dyn std::fmt::Display| Failure::Error(error.to_string());
    std::fs::create_dir_all(folder).map_err(|found| error(&found))?;
    let text = serde_json::to_string_pretty(&record).map_err(|found| error(&found))?;
    write(&folder.join(format!("{study}.json")), &format!("{text}\n"))
}
