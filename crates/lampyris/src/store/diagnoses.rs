//! Which effects models are missing, and the error ladders. A job writes one of them when it ends.

use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::evidence;
use super::job_record::Lease;
use super::page;
use super::reach::SystemScope;
use super::row::row;
use super::sequence::{derive_id, next};
use super::statement::{query, query_as};
use super::value::{from_json, instant, millis, parse, to_json, word};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::ladder::Ladder;
use lampyris_core::diagnose::report::{Adequacy, Diagnosis, EffectSize, Finding};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A diagnosis as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnosisRecord {
    /// Its id.
    pub id: String,
    /// The order of everything.
    pub sequence: i64,
    /// The job that made it.
    pub job: String,
    /// The system.
    pub system: SystemId,
    /// The fit that it starts from.
    pub fit: String,
    /// The verdict, in a word.
    pub verdict: String,
    /// The whole document.
    pub document: Value,
    /// When.
    pub created_at: Timestamp,
}

/// A ladder as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct LadderRecord {
    /// The job that made it.
    pub job: String,
    /// The fit of its base.
    pub fit: String,
    /// The whole document.
    pub document: Value,
    /// When.
    pub created_at: Timestamp,
}

row! {
    struct Row {
        id: String,
        sequence: i64,
        job: String,
        system: String,
        fit: String,
        verdict: String,
        document: String,
        created_at: i64,
    }
}

impl Row {
    fn record(self) -> Result<DiagnosisRecord, StoreError> {
        Ok(DiagnosisRecord {
            system: parse("a system", &self.system)?,
            document: from_json("a diagnosis", &self.document)?,
            created_at: instant(self.created_at)?,
            id: self.id,
            sequence: self.sequence,
            job: self.job,
            fit: self.fit,
            verdict: self.verdict,
        })
    }
}

/// The first effect that a diagnosis has named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MissingEffect {
    /// The effect's id.
    pub effect: String,
    /// A short title for people.
    pub title: String,
    /// What a forecast loses without it, where that is known.
    pub size: Option<EffectSize>,
}

impl MissingEffect {
    fn of(diagnosis: &Diagnosis) -> Option<Self> {
        let Finding { effect, title, size, .. } = diagnosis.findings.first()?;
        Some(Self { effect: effect.clone(), title: title.clone(), size: size.clone() })
    }
}

/// What a job found out with the help of its fit.
#[derive(Debug)]
pub enum Report {
    /// Which effect the model is missing.
    Diagnosis(Box<Diagnosis>),
    /// Effects one after another.
    Ladder(Box<Ladder>),
}

/// Keeps what a job found out from a fit, which is named with the hash of its model; gives the id of a
/// diagnosis.
pub(super) async fn keep(
    tx: &mut Session,
    lease: &Lease,
    system: &str,
    (fit, model_hash): (&str, &str),
    report: &Report,
    now: Timestamp,
) -> Result<Option<String>, StoreError> {
    let sequence = next(tx, "sequence").await?;
    match report {
        Report::Diagnosis(diagnosis) => {
            let id = derive_id("dia", sequence, now);
            let named = Diagnosis {
                system: Some(system.to_owned()),
                fit: Some(fit.to_owned()),
                ..Diagnosis::clone(diagnosis)
            };
            let sql = "INSERT INTO diagnoses (id, sequence, job, system, fit, verdict, document, created_at, \
                missing) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)";
            let missing = MissingEffect::of(&named).filter(|_| named.verdict == Adequacy::Named);
            let missing = missing.map(|missing| to_json("a missing effect", &missing)).transpose()?;
            query(sql)
                .bind(&id)
                .bind(sequence)
                .bind(&lease.job)
                .bind(system)
                .bind(fit)
                .bind(word(&named.verdict)?)
                .bind(to_json("a diagnosis", &named)?)
                .bind(millis(now))
                .bind(missing)
                .execute(&mut *tx)
                .await?;
            evidence::keep(tx, system, sequence, &named.entries(&id, Some(model_hash))).await?;
            Ok(Some(id))
        }
        Report::Ladder(ladder) => {
            let named = Ladder { system: Some(system.to_owned()), ..Ladder::clone(ladder) };
            let sql = "INSERT INTO ladders (job, sequence, system, fit, document, created_at) VALUES ($1, \
                $2, $3, $4, $5, $6)";
            query(sql)
                .bind(&lease.job)
                .bind(sequence)
                .bind(system)
                .bind(fit)
                .bind(to_json("a ladder", &named)?)
                .bind(millis(now))
                .execute(tx)
                .await?;
            Ok(None)
        }
    }
}

/// One diagnosis.
///
/// # Errors
/// Where the database fails.
pub async fn get(store: &Store, id: &str) -> Result<Option<DiagnosisRecord>, StoreError> {
    let row: Option<Row> =
        query_as("SELECT * FROM diagnoses WHERE id = $1").bind(id).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// Diagnoses made before a sequence number, of one system or all, newest first: one page of a list.
///
/// # Errors
/// Where the database fails.
pub async fn page(
    store: &Store,
    reach: &SystemScope,
    system: Option<&SystemId>,
    before: i64,
    limit: i64,
) -> Result<Vec<DiagnosisRecord>, StoreError> {
    let sql = "SELECT * FROM diagnoses WHERE ($1 IS NULL OR system = $1) AND ($4 IS NULL OR EXISTS (SELECT 1 FROM \
        json_each($4) WHERE glob(value, system))) \
        AND sequence < $2 ORDER BY sequence DESC LIMIT $3";
    let rows: Vec<Row> = page::rows(store, sql, reach, system, before, limit).await?;
    rows.into_iter().map(Row::record).collect()
}

/// The newest ladder of a system.
///
/// # Errors
/// Where the database fails.
pub async fn newest_ladder(store: &Store, system: &SystemId) -> Result<Option<LadderRecord>, StoreError> {
    let sql =
        "SELECT job, fit, document, created_at FROM ladders WHERE system = $1 ORDER BY sequence DESC LIMIT 1";
    let row: Option<(String, String, String, i64)> =
        query_as(sql).bind(system.to_string()).fetch_optional(&store.reader).await?;
    row.map(|(job, fit, document, at)| {
        Ok(LadderRecord { job, fit, document: from_json("a ladder", &document)?, created_at: instant(at)? })
    })
    .transpose()
}
