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
use lampyris_core::diagnose::library::NotTestable;
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
        let mut document: Value = from_json("a diagnosis", &self.document)?;
        document["system"] = self.system.as_str().into();
        document["fit"] = self.fit.as_str().into();
        Ok(DiagnosisRecord {
            system: parse("a system", &self.system)?,
            document,
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

impl Report {
    /// The document that is kept. What is known no sooner than in the transaction, the system and the fit,
    /// stands beside it in its row.
    pub(super) fn document(&self) -> Result<String, StoreError> {
        match self {
            Report::Diagnosis(diagnosis) => to_json("a diagnosis", diagnosis),
            Report::Ladder(ladder) => to_json("a ladder", ladder),
        }
    }
}

/// Keeps what a job found out from a fit, which is named with the hash of its model; gives the id of a
/// diagnosis.
pub(super) async fn keep(
    tx: &mut Session,
    lease: &Lease,
    system: &str,
    (fit, model_hash): (&str, &str),
    (report, document): (&Report, &str),
    now: Timestamp,
) -> Result<Option<String>, StoreError> {
    let sequence = next(tx, "sequence").await?;
    match report {
        Report::Diagnosis(diagnosis) => {
            let id = derive_id("dia", sequence, now);
            let sql = "INSERT INTO diagnoses (id, sequence, job, system, fit, verdict, document, created_at, \
                missing) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)";
            let missing = MissingEffect::of(diagnosis).filter(|_| diagnosis.verdict == Adequacy::Named);
            let missing = missing.map(|missing| to_json("a missing effect", &missing)).transpose()?;
            query(sql)
                .bind(&id)
                .bind(sequence)
                .bind(&lease.job)
                .bind(system)
                .bind(fit)
                .bind(word(&diagnosis.verdict)?)
                .bind(document)
                .bind(millis(now))
                .bind(missing)
                .execute(&mut *tx)
                .await?;
            evidence::keep(tx, system, sequence, &diagnosis.entries(&id, Some(model_hash))).await?;
            Ok(Some(id))
        }
        Report::Ladder(_) => {
            let sql = "INSERT INTO ladders (job, sequence, system, fit, document, created_at) VALUES ($1, \
                $2, $3, $4, $5, $6)";
            query(sql)
                .bind(&lease.job)
                .bind(sequence)
                .bind(system)
                .bind(fit)
                .bind(document)
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
pub(crate) async fn get(store: &Store, id: &str) -> Result<Option<DiagnosisRecord>, StoreError> {
    let row: Option<Row> =
        query_as("SELECT * FROM diagnoses WHERE id = $1").bind(id).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// Diagnoses made before a sequence number, of one system or all, newest first: one page of a list.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
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
pub(crate) async fn newest_ladder(
    store: &Store,
    system: &SystemId,
) -> Result<Option<LadderRecord>, StoreError> {
    let sql =
        "SELECT job, fit, document, created_at FROM ladders WHERE system = $1 ORDER BY sequence DESC LIMIT 1";
    let row: Option<(String, String, String, i64)> =
        query_as(sql).bind(system.to_string()).fetch_optional(&store.reader).await?;
    row.map(|(job, fit, document, at)| {
        let mut document: Value = from_json("a ladder", &document)?;
        document["system"] = system.to_string().into();
        Ok(LadderRecord { job, fit, document, created_at: instant(at)? })
    })
    .transpose()
}

/// What the newest diagnosis of a system says of effects.
#[derive(Debug, Clone, PartialEq)]
pub struct NewestDiagnosis {
    /// Its id.
    pub id: String,
    /// The model that was diagnosed.
    pub model: String,
    /// What is missing.
    pub findings: Vec<NamedFinding>,
    /// What was tried.
    pub considered: Vec<TriedEffect>,
    /// What the data cannot show.
    pub not_testable: Vec<NotTestable>,
    /// When.
    pub created_at: Timestamp,
}

/// What is read of a finding.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct NamedFinding {
    /// The effect that would be added.
    pub effect: String,
    /// The effect that is named, where this is another way of it.
    pub way_of: Option<String>,
    /// A short title for people.
    pub title: String,
    /// Errors without and with it.
    pub rmse: UnseenPairs,
    /// What forecasts lose without it, of which the unit is read.
    pub size: Option<SizeUnit>,
}

/// The errors without and with an effect, on data that were not fitted.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct UnseenPairs {
    /// The validation part, which decides.
    pub validation: Option<[f64; 2]>,
    /// The test part, which no decision sees.
    pub test: Option<[f64; 2]>,
}

/// The unit of a size.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct SizeUnit {
    /// The output's unit.
    pub unit: String,
}

/// What is read of an effect that was tried.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct TriedEffect {
    /// The effect's id.
    pub effect: String,
    /// What became of it, in a sentence.
    pub why: String,
}

/// A system that has a model, with its newest diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnosedSystem {
    /// The system.
    pub system: SystemId,
    /// The model whose fits are served now.
    pub model: String,
    /// Nothing where nobody has looked yet.
    pub diagnosis: Option<NewestDiagnosis>,
}

row! {
    struct DiagnosedRow {
        system: String,
        current: String,
        id: Option<String>,
        model: Option<String>,
        findings: Option<String>,
        considered: Option<String>,
        not_testable: Option<String>,
        created_at: Option<i64>,
    }
}

impl DiagnosedRow {
    fn record(self) -> Result<DiagnosedSystem, StoreError> {
        let listed = |text: &Option<String>| text.clone().unwrap_or_else(|| "[]".to_owned());
        let diagnosis = match (self.id, self.created_at) {
            (Some(id), Some(at)) => Some(NewestDiagnosis {
                id,
                model: self.model.unwrap_or_default(),
                findings: from_json("the findings of a diagnosis", &listed(&self.findings))?,
                considered: from_json("what a diagnosis has tried", &listed(&self.considered))?,
                not_testable: from_json("what a diagnosis could not try", &listed(&self.not_testable))?,
                created_at: instant(at)?,
            }),
            _ => None,
        };
        Ok(DiagnosedSystem { system: parse("a system", &self.system)?, model: self.current, diagnosis })
    }
}

/// Systems within a reach and a selection that have a model and come after a name, in order, each with its
/// newest diagnosis: one page of a list.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn newest(
    store: &Store,
    (reach, selected): (&SystemScope, &SystemScope),
    after: &str,
    limit: i64,
) -> Result<Vec<DiagnosedSystem>, StoreError> {
    let sql = "SELECT s.system, s.model AS current, d.id, json_extract(d.document, '$.model') AS model, \
        json_extract(d.document, '$.findings') AS findings, \
        json_extract(d.document, '$.considered') AS considered, \
        json_extract(d.document, '$.not_testable') AS not_testable, d.created_at \
        FROM systems s LEFT JOIN diagnoses d ON d.system = s.system AND d.sequence = \
        (SELECT MAX(sequence) FROM diagnoses WHERE system = s.system) \
        WHERE s.system > $1 AND s.model <> '' \
        AND ($3 IS NULL OR EXISTS (SELECT 1 FROM json_each($3) WHERE glob(value, s.system))) \
        AND ($4 IS NULL OR EXISTS (SELECT 1 FROM json_each($4) WHERE glob(value, s.system))) \
        ORDER BY s.system LIMIT $2";
    let rows: Vec<DiagnosedRow> = query_as(sql)
        .bind(after)
        .bind(limit)
        .bind(reach.sql()?)
        .bind(selected.sql()?)
        .fetch_all(&store.reader)
        .await?;
    rows.into_iter().map(DiagnosedRow::record).collect()
}
