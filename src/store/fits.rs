//! What was found, with its verdict.

use super::{Store, StoreError, from_json, instant, parse};
use crate::data::SystemId;
use crate::estimate::Fit;
use jiff::Timestamp;
use sqlx::FromRow;

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

#[derive(FromRow)]
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
    let sql = "SELECT id, job, system, document, verdict, checks, summary, created_at FROM fits WHERE id = $1";
    let row: Option<Row> = sqlx::query_as(sql).bind(id).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// The fit whose parameters a system serves.
///
/// # Errors
/// Where the database fails.
pub async fn served(store: &Store, system: &SystemId) -> Result<Option<FitRecord>, StoreError> {
    let sql = "SELECT f.id, f.job, f.system, f.document, f.verdict, f.checks, f.summary, f.created_at
               FROM fits f JOIN revisions r ON r.fit = f.id WHERE r.system = $1 AND r.current";
    let row: Option<Row> = sqlx::query_as(sql).bind(system.to_string()).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}
