//! What was found, with its verdict.

use super::database::Store;
use super::error::StoreError;
use super::page;
use super::reach::SystemScope;
use super::row::row;
use super::statement::query_as;
use super::value::{from_json, instant, parse, to_json};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::Fit;
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
    /// When.
    pub created_at: Timestamp,
}

row! {
    struct Row {
        id: String,
        job: String,
        system: String,
        document: String,
        verdict: String,
        checks: String,
        summary: String,
        created_at: i64,
    }
}

impl Row {
    fn record(self) -> Result<FitRecord, StoreError> {
        Ok(FitRecord {
            system: parse("a system", &self.system)?,
            fit: from_json("a fit", &self.document)?,
            checks: from_json("checks", &self.checks)?,
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

/// In which circumstances the served fits of these systems fail most, of those where some stand out.
///
/// # Errors
/// Where the database fails.
pub async fn worst_regimes(store: &Store, systems: &[String]) -> Result<HashMap<String, String>, StoreError> {
    let sql = "SELECT r.system, json_extract(f.document, '$.worst_regime') FROM revisions r JOIN fits f ON \
        f.id = r.fit \
        WHERE r.current AND r.system IN (SELECT value FROM json_each($1)) AND \
        json_extract(f.document, '$.worst_regime') IS NOT NULL";
    let rows: Vec<(String, String)> =
        query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    Ok(rows.into_iter().collect())
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
        metrics: String,
        parts: String,
        served: bool,
        created_at: i64,
    }
}

impl EntryRow {
    fn entry(self) -> Result<FitEntry, StoreError> {
        Ok(FitEntry {
            system: parse("a system", &self.system)?,
            metrics: from_json("the errors of a fit", &self.metrics)?,
            parts: from_json("the parts of a fit", &self.parts)?,
            created_at: instant(self.created_at)?,
            id: self.id,
            place: self.place,
            job: self.job,
            model: self.model,
            verdict: self.verdict,
            summary: self.summary,
            served: self.served,
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
    // The documents hold whole traces; the database reads the little that a list shows.
    macro_rules! listed {
        ($whose:literal) => {
            concat!(
                "SELECT f.id, f.rowid AS place, f.job, f.system, f.model, f.verdict, f.summary, f.created_at, \
                json_extract(f.document, '$.metrics') AS metrics, json_extract(f.document, '$.parts') AS \
                parts, \
                EXISTS (SELECT 1 FROM revisions r WHERE r.fit = f.id AND r.current) AS served FROM fits f WHERE ",
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
