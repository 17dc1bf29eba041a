//! What was found, with its verdict.

use super::database::Store;
use super::error::StoreError;
use super::job::{JobKind, Origin};
use super::offers::waits;
use super::packed::{compress, decompress};
use super::page;
use super::reach::SystemScope;
use super::row::row;
use super::statement::{query, query_as, query_scalar};
use super::value::{from_json, instant, parse, to_json};
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::Fit;
use lampyris_core::estimate::fit::covariance::Covariance;
use lampyris_core::estimate::fit::parameter_change::ParameterChange;
use lampyris_core::estimate::fit::{OutputMetrics, Parts, TracePoint};
use lampyris_core::estimate::gate::check::CheckResult;
use lampyris_core::model::ModelId;
use serde::{Deserialize, Serialize};

/// So many fits that have seen a change are looked at.
const CHANGES_BACK: i64 = 60;

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
    pub metrics: IndexMap<String, OutputMetrics>,
    /// The parts of the window.
    pub parts: Parts,
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
pub(crate) async fn served(store: &Store, system: &SystemId) -> Result<Option<FitRecord>, StoreError> {
    let sql = "SELECT f.* FROM fits f JOIN revisions r ON r.fit = f.id WHERE r.system = $1 AND r.current";
    let row: Option<Row> = query_as(sql).bind(system.to_string()).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// The fits that other systems of a building serve: those of the same kind, tenant and model, by name, so
/// many at most.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn of_siblings(
    store: &Store,
    system: &SystemId,
    (tenant, building): (&str, &str),
    model: &ModelId,
    limit: i64,
) -> Result<Vec<FitRecord>, StoreError> {
    let sql = "SELECT f.* FROM systems s JOIN revisions r ON r.system = s.system AND r.current \
        JOIN fits f ON f.id = r.fit WHERE s.building = $5 AND s.building <> '' AND s.tenant = $4 \
        AND s.system <> $1 AND glob($2, s.system) AND f.model = $3 ORDER BY s.system LIMIT $6";
    let rows: Vec<Row> = query_as(sql)
        .bind(system.to_string())
        .bind(format!("{}/*", system.kind()))
        .bind(model.to_string())
        .bind(tenant)
        .bind(building)
        .bind(limit)
        .fetch_all(&store.reader)
        .await?;
    rows.into_iter().map(Row::record).collect()
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
    /// What lists read of it.
    pub(super) listed: ListedColumns,
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
            listed: ListedColumns::new(&ListedFit::of(fit))?,
        })
    }
}

/// What lists read of a fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ListedFit {
    /// Errors by output channel.
    pub metrics: IndexMap<String, OutputMetrics>,
    /// The parts of the window.
    pub parts: Parts,
    /// In which circumstances it fails most, in a sentence.
    #[serde(default)]
    pub worst_regime: Option<String>,
    /// A parameter that has changed within the weeks before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed: Option<ParameterChange>,
}

impl ListedFit {
    fn of(fit: &Fit) -> Self {
        Self {
            metrics: fit.metrics.clone(),
            parts: fit.parts.clone(),
            worst_regime: fit.worst_regime.clone(),
            changed: fit.changed.clone(),
        }
    }

    /// The validation error of the first output, unless a part was kept aside for a test: such fits are
    /// judged on other weeks than those before and after them.
    fn validation_rmse(&self) -> Option<f64> {
        let first = self.metrics.values().next().filter(|_| self.parts.test.is_none())?;
        first.validation_rmse.filter(|rmse| rmse.is_finite())
    }
}

/// What lists read of a fit, as its row has it.
#[derive(Debug, Clone)]
pub struct ListedColumns {
    /// All of it, JSON.
    pub(super) listed: String,
    /// What stands in the trend of its system, if it counts there.
    pub(super) validation_rmse: Option<f64>,
}

impl ListedColumns {
    fn new(listed: &ListedFit) -> Result<Self, StoreError> {
        Ok(Self { listed: to_json("what lists read", listed)?, validation_rmse: listed.validation_rmse() })
    }
}

/// What lists read of a fit, not read yet: a short text, or in a row of an earlier program the document.
#[derive(Debug, Clone)]
pub struct FitText {
    listed: Option<String>,
    document: Option<Vec<u8>>,
}

impl FitText {
    pub(super) fn new(listed: Option<String>, document: Option<Vec<u8>>) -> Self {
        Self { listed, document }
    }

    /// Reads it. Of a document this is work for a blocking thread.
    ///
    /// # Errors
    /// Where the row holds something else.
    pub fn read(&self) -> Result<ListedFit, StoreError> {
        match &self.listed {
            Some(listed) => from_json("what lists read", listed),
            None => decompress("a fit", self.document.as_deref().unwrap_or_default()),
        }
    }

    /// Its columns, for a row that has none yet.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn columns(&self) -> Result<ListedColumns, StoreError> {
        ListedColumns::new(&self.read()?)
    }
}

/// A fit of an earlier program, whose row says nothing for lists.
#[derive(Debug, Clone)]
pub struct UnlistedFit {
    /// Its id.
    pub id: String,
    /// Its document.
    pub text: FitText,
    /// Whether it is one of those that tell how a system fares over time.
    pub in_trend: bool,
}

/// Some fits whose rows say nothing for lists.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn unlisted(store: &Store, limit: i64) -> Result<Vec<UnlistedFit>, StoreError> {
    let sql = "SELECT f.id, f.document, j.kind = 'estimate' AND NOT j.experiment AS in_trend FROM fits f \
        JOIN jobs j ON j.id = f.job WHERE f.listed IS NULL LIMIT $1";
    let rows: Vec<(String, Vec<u8>, bool)> = query_as(sql).bind(limit).fetch_all(&store.reader).await?;
    let unlisted =
        |(id, document, in_trend)| UnlistedFit { id, text: FitText::new(None, Some(document)), in_trend };
    Ok(rows.into_iter().map(unlisted).collect())
}

/// Writes what lists read of such fits into their rows.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn list(store: &Store, fits: &[(String, ListedColumns, bool)]) -> Result<(), StoreError> {
    let mut tx = store.write().await?;
    for (id, ListedColumns { listed, validation_rmse }, in_trend) in fits {
        query("UPDATE fits SET listed = $2, validation_rmse = $3 WHERE id = $1 AND listed IS NULL")
            .bind(id)
            .bind(listed)
            .bind(validation_rmse.filter(|_| *in_trend))
            .execute(&mut *tx)
            .await?;
    }
    tx.commit().await
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
        listed: Option<String>,
        document: Option<Vec<u8>>,
        served: bool,
        waits: bool,
        created_at: i64,
    }
}

impl EntryRow {
    fn entry(self) -> Result<FitEntry, StoreError> {
        let ListedFit { metrics, parts, .. } = FitText::new(self.listed, self.document).read()?;
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

/// What the gate says of a fit, in a sentence, and whether the fit waits for an operator.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn summary(store: &Store, id: &str) -> Result<Option<(String, bool)>, StoreError> {
    let sql = concat!("SELECT f.summary, ", waits!("f.id"), " AS waits FROM fits f WHERE f.id = $1");
    Ok(query_as(sql).bind(id).fetch_optional(&store.reader).await?)
}

/// The changes that a fit and the newest ones before it have seen, of the same system: its own first, then
/// those before it, newest first. Nothing where it has seen none itself.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn changes_up_to(store: &Store, id: &str) -> Result<Vec<ParameterChange>, StoreError> {
    // Most have seen none, and are told so by their own row.
    let sql = "SELECT f.id, f.listed FROM fits f JOIN fits own ON own.system = f.system WHERE own.id = $1 \
        AND own.listed LIKE '%\"changed\":%' AND f.created_at <= own.created_at AND f.listed LIKE '%\"changed\":%' ORDER BY f.created_at DESC, \
        f.id = own.id DESC LIMIT $2";
    let rows: Vec<(String, String)> =
        query_as(sql).bind(id).bind(CHANGES_BACK).fetch_all(&store.reader).await?;
    if rows.first().is_none_or(|(first, _)| first != id) {
        return Ok(Vec::new());
    }
    rows.iter().filter_map(|(_, listed)| change_in(listed).transpose()).collect()
}

/// The change in what lists read of a fit.
fn change_in(listed: &str) -> Result<Option<ParameterChange>, StoreError> {
    Ok(from_json::<ListedFit>("what lists read", listed)?.changed)
}

/// The change that the newest fit of a system has seen which nobody asked for: those of others do not look.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn newest_change(
    store: &Store,
    system: &SystemId,
) -> Result<Option<ParameterChange>, StoreError> {
    let sql = "SELECT f.listed FROM fits f JOIN jobs j ON j.id = f.job WHERE f.system = $1 \
        AND f.listed IS NOT NULL AND j.kind = $2 AND j.origin <> $3 ORDER BY f.created_at DESC LIMIT 1";
    let listed: Option<String> = query_scalar(sql)
        .bind(system.to_string())
        .bind(JobKind::Estimate.as_str())
        .bind(Origin::Posted.as_str())
        .fetch_optional(&store.reader)
        .await?;
    listed.map_or(Ok(None), |listed| change_in(&listed))
}

/// Fits found before a place in the order, newest first, of one system or of all: one page of a list.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
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
                f.listed, CASE WHEN f.listed IS NULL THEN f.document END AS document, \
                EXISTS (SELECT 1 FROM revisions r WHERE r.fit = f.id AND r.current) AS served, \
                ",
                waits!("f.id"),
                " AS waits FROM fits f WHERE ",
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
