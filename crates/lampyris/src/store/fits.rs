//! What was found, with its verdict.

use super::database::Store;
use super::error::StoreError;
use super::packed::{compress, decompress};
use super::page;
use super::reach::SystemScope;
use super::row::row;
use super::statement::query_as;
use super::value::{instant, parse, to_json};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::Fit;
use lampyris_core::estimate::fit::TracePoint;
use lampyris_core::estimate::fit::covariance::Covariance;
use lampyris_core::estimate::gate::check::CheckResult;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// A fit as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct FitRecord {
    /// Its id.
    pub id: String,
    /// The job that found it.
    pub job: String,
    /// The system.
    pub system: SystemId,
    /// What was found.
    pub fit: Fit,
    /// What the gate said, in a word.
    pub verdict: String,
    /// Every check.
    pub checks: serde_json::Value,
    /// One plain sentence.
    pub summary: String,
    /// When.
    pub created_at: Timestamp,
}

/// A fit in a list: what a reader chooses by.
#[derive(Debug, Clone, PartialEq)]
pub struct FitEntry {
    /// Its id.
    pub id: String,
    /// The place in the order of finding.
    pub place: i64,
    /// The job that found it.
    pub job: String,
    /// The system.
    pub system: SystemId,
    /// The model.
    pub model: String,
    /// What the gate said, in a word.
    pub verdict: String,
    /// One plain sentence.
    pub summary: String,
    /// Errors by output channel.
    pub metrics: serde_json::Value,
    /// The parts of the window.
    pub parts: serde_json::Value,
    /// Whether its parameters are served now.
    pub served: bool,
    /// Whether it waits for an operator's word.
    pub waits: bool,
    /// When.
    pub created_at: Timestamp,
}

row! {
    struct Row {
        id: String,
        job: String,
        system: String,
        document: Vec<u8>,
        replay: Option<Vec<u8>>,
        verdict: String,
        checks: Vec<u8>,
        summary: String,
        created_at: i64,
    }
}

impl Row {
    fn record(self) -> Result<FitRecord, StoreError> {
        let mut fit: Fit = decompress("a fit", &self.document)?;
        if let Some(replay) = &self.replay {
            let replay: Replay = decompress("the way to a fit", replay)?;
            fit = Fit { trace: replay.trace, covariance: replay.covariance, ..fit };
        }
        Ok(FitRecord {
            system: parse("a system", &self.system)?,
            fit,
            checks: decompress("checks", &self.checks)?,
            created_at: instant(self.created_at)?,
            id: self.id,
            job: self.job,
            verdict: self.verdict,
            summary: self.summary,
        })
    }
}

/// One fit.
///
/// # Errors
/// Where the database fails.
pub async fn get(store: &Store, id: &str) -> Result<Option<FitRecord>, StoreError> {
    let sql = "SELECT * FROM fits WHERE id = $1";
    let row: Option<Row> = query_as(sql).bind(id).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// The fit whose parameters a system serves.
///
/// # Errors
/// Where the database fails.
pub async fn served(store: &Store, system: &SystemId) -> Result<Option<FitRecord>, StoreError> {
    let sql = "SELECT f.* FROM fits f JOIN revisions r ON r.fit = f.id WHERE r.system = $1 AND r.current";
    let row: Option<Row> = query_as(sql).bind(system.to_string()).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// What the same search would find again: it goes first where there is much to keep.
#[derive(Serialize, Deserialize)]
struct Replay {
    trace: Vec<TracePoint>,
    covariance: Option<Covariance>,
}

/// A fit as its row has it, compressed by whoever computed it and not while others wait.
#[derive(Debug)]
pub struct PackedFit {
    /// What decides.
    pub(super) document: Vec<u8>,
    /// What the same search would find again.
    pub(super) replay: Vec<u8>,
    /// What the gate has looked at.
    pub(super) checks: Vec<u8>,
}

impl PackedFit {
    /// Packs a fit and what the gate looked at.
    ///
    /// # Errors
    /// Where one of their numbers cannot be written.
    pub fn new(fit: &Fit, checks: &[CheckResult]) -> Result<Self, StoreError> {
        let mut rest = fit.clone();
        let replay = Replay { trace: std::mem::take(&mut rest.trace), covariance: rest.covariance.take() };
        Ok(Self {
            document: compress("a fit", &rest)?,
            replay: compress("the way to a fit", &replay)?,
            checks: compress("checks", checks)?,
        })
    }
}

/// In which circumstances the served fits of these systems fail most, of those where some stand out.
///
/// # Errors
/// Where the database fails.
pub async fn worst_regimes(store: &Store, systems: &[String]) -> Result<HashMap<String, String>, StoreError> {
    let sql = "SELECT r.system, f.document FROM revisions r JOIN fits f ON f.id = r.fit WHERE r.current AND r.system \
        IN (SELECT value FROM json_each($1))";
    let rows: Vec<(String, Vec<u8>)> =
        query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    let mut worst = HashMap::new();
    for (system, document) in rows {
        let Listed { worst_regime, .. } = decompress("a fit", &document)?;
        worst.extend(worst_regime.map(|regime| (system, regime)));
    }
    Ok(worst)
}

/// What a list reads of a fit.
#[derive(Deserialize)]
struct Listed {
    metrics: serde_json::Value,
    parts: serde_json::Value,
    #[serde(default)]
    worst_regime: Option<String>,
}

row! {
    struct EntryRow {
        id: String,
        place: i64,
        job: String,
        system: String,
        model: String,
        verdict: String,
        summary: String,
        document: Vec<u8>,
        served: bool,
        waits: bool,
        created_at: i64,
    }
}

impl EntryRow {
    fn entry(self) -> Result<FitEntry, StoreError> {
        let Listed { metrics, parts, .. } = decompress("a fit", &self.document)?;
        Ok(FitEntry {
            system: parse("a system", &self.system)?,
            metrics,
            parts,
            created_at: instant(self.created_at)?,
            id: self.id,
            place: self.place,
            job: self.job,
            model: self.model,
            verdict: self.verdict,
            summary: self.summary,
            served: self.served,
            waits: self.waits,
        })
    }
}

/// Fits found before a place in the order, newest first, of one system or of all: one page of a list.
///
/// # Errors
/// Where the database fails.
pub async fn page(
    store: &Store,
    reach: &SystemScope,
    system: Option<&SystemId>,
    before: i64,
    limit: i64,
) -> Result<Vec<FitEntry>, StoreError> {
    macro_rules! listed {
        ($whose:literal) => {
            concat!(
                "SELECT f.id, f.rowid AS place, f.job, f.system, f.model, f.verdict, f.summary, f.created_at, \
                f.document, EXISTS (SELECT 1 FROM revisions r WHERE r.fit = f.id AND r.current) AS served, \
                EXISTS (SELECT 1 FROM offers o WHERE o.fit = f.id) AND NOT EXISTS (SELECT 1 FROM decisions d \
                WHERE d.fit = f.id) AS waits FROM fits f WHERE ",
                $whose,
                " AND ($4 IS NULL OR EXISTS (SELECT 1 FROM json_each($4) WHERE glob(value, f.system))) \
                AND f.rowid < $2 ORDER BY f.rowid DESC LIMIT $3"
            )
        };
    }
    // An index leads to the fits of one system.
    let sql = if system.is_some() { listed!("f.system = $1") } else { listed!("$1 IS NULL") };
    let rows: Vec<EntryRow> = page::rows(store, sql, reach, system, before, limit).await?;
    rows.into_iter().map(EntryRow::entry).collect()
}
