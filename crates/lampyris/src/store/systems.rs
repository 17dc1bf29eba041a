//! Documents of rooms and plants. What is in a document is for `service` to know; here it is a text.

use super::audit::{Action, AuditEntry, note};
use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::reach::SystemScope;
use super::revisions::retire;
use super::row::row;
use super::statement::{query, query_as, query_scalar};
use super::value::{instant, millis, parse, to_json};
use super::windows::{readers, reads};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::model::ModelId;

/// Stands in the column of the model where a system has none; no model has this name.
const NO_MODEL: &str = "";

/// A system as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct SystemRecord {
    /// Its name.
    pub system: SystemId,
    /// The model whose fits count; `None` of a site that only holds measurements.
    pub model: Option<ModelId>,
    /// The document, JSON.
    pub document: String,
    /// When it was made.
    pub created_at: Timestamp,
    /// When it was last changed.
    pub updated_at: Timestamp,
}

/// What a document says that the database looks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SystemColumns<'a> {
    /// The model; `None` of a site that only holds measurements.
    pub model: Option<&'a ModelId>,
    /// Whose it is.
    pub tenant: &'a str,
    /// Where it is: the first level of its group.
    pub building: &'a str,
}

/// What became of a document of a system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SystemPut {
    /// There is a system more.
    Made,
    /// The document before is gone.
    Replaced,
    /// What is there, or that nothing is, does not allow it.
    Refused {
        /// Whether there is such a system.
        is_there: bool,
    },
}

/// What became of a system that was to be deleted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SystemDeletion {
    /// It is gone, with everything that was its own.
    Gone,
    /// There was none.
    NotThere,
    /// These jobs wait, run, or read its measurements.
    Busy(Vec<String>),
    /// Nobody forced it, and something depends on it.
    Needed(Needs),
}

/// Something that belongs to one system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Thing {
    /// A job.
    Job,
    /// A fit.
    Fit,
    /// A diagnosis.
    Diagnosis,
    /// A window.
    Window,
}

impl Thing {
    /// The word for it.
    pub const fn as_str(self) -> &'static str {
        match self {
            Thing::Job => "job",
            Thing::Fit => "fit",
            Thing::Diagnosis => "diagnosis",
            Thing::Window => "window",
        }
    }
}

/// What would be lost, or would miss a system, if it were deleted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Needs {
    /// Fits of the system.
    pub fits: i64,
    /// Revisions that were served.
    pub revisions: i64,
    /// Other systems that name it as a neighbour, or whose fits cite its measurements.
    pub dependents: Vec<String>,
}

row! {
    struct Row {
        system: String,
        model: String,
        document: String,
        created_at: i64,
        updated_at: i64,
    }
}

impl Row {
    fn record(self) -> Result<SystemRecord, StoreError> {
        Ok(SystemRecord {
            system: parse("a system", &self.system)?,
            model: match self.model.as_str() {
                NO_MODEL => None,
                model => Some(parse("a model", model)?),
            },
            document: self.document,
            created_at: instant(self.created_at)?,
            updated_at: instant(self.updated_at)?,
        })
    }
}

/// Makes a system or replaces its document, with the columns that this names, where what is there (`None`
/// without any) allows it; who does it, and why, is noted.
///
/// # Errors
/// Where the database fails.
pub async fn put(
    store: &Store,
    system: &SystemId,
    SystemColumns { model, tenant, building }: SystemColumns<'_>,
    document: &str,
    (who, reason, now): (&str, Option<&str>, Timestamp),
    allows: impl FnOnce(Option<&str>) -> bool,
) -> Result<SystemPut, StoreError> {
    let mut tx = store.write().await?;
    let known: Option<String> = query_scalar("SELECT document FROM systems WHERE system = $1")
        .bind(system.to_string())
        .fetch_optional(&mut *tx)
        .await?;
    if !allows(known.as_deref()) {
        return Ok(SystemPut::Refused { is_there: known.is_some() });
    }
    let sql = "INSERT INTO systems (system, model, tenant, building, document, created_at, updated_at) \
        VALUES ($1, $2, $3, $4, $5, $6, $6) \
        ON CONFLICT (system) DO UPDATE SET model = excluded.model, tenant = excluded.tenant, \
        building = excluded.building, document = excluded.document, updated_at = excluded.updated_at";
    query(sql)
        .bind(system.to_string())
        .bind(model.map_or_else(|| NO_MODEL.to_owned(), ToString::to_string))
        .bind(tenant)
        .bind(building)
        .bind(document)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    let name = system.to_string();
    note(
        &mut tx,
        &AuditEntry { who, action: Action::PutSystem, system: Some(&name), subject: &name, reason },
        now,
    )
    .await?;
    tx.commit().await?;
    Ok(if known.is_none() { SystemPut::Made } else { SystemPut::Replaced })
}

/// Writes how the jobs of a system search into its document; which job found it, and why, is noted like an
/// operator's deed.
pub(super) async fn take_method(
    tx: &mut Session,
    system: &str,
    document: &str,
    (job, reason): (&str, &str),
    now: Timestamp,
) -> Result<(), StoreError> {
    query("UPDATE systems SET document = $2, updated_at = $3 WHERE system = $1")
        .bind(system)
        .bind(document)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    note(
        tx,
        &AuditEntry {
            who: job,
            action: Action::PutSystem,
            system: Some(system),
            subject: system,
            reason: Some(reason),
        },
        now,
    )
    .await
}

/// Everything that belongs to a system, in an order that the keys allow. Fits of other systems lose what they
/// cite of it; batches and schedules stay.
const BELONGINGS: [&str; 24] = [
    "DELETE FROM idempotency WHERE resource IN (SELECT id FROM jobs WHERE system = $1 UNION SELECT id FROM \
    windows WHERE system = $1)",
    "DELETE FROM fallbacks WHERE system = $1",
    "DELETE FROM states WHERE system = $1",
    "DELETE FROM pins WHERE system = $1",
    "DELETE FROM degradations WHERE system = $1",
    "DELETE FROM revisions WHERE system = $1",
    "DELETE FROM fit_windows WHERE window_id IN (SELECT id FROM windows WHERE system = $1)",
    "UPDATE jobs SET diagnosis = NULL WHERE system = $1",
    "DELETE FROM diagnoses WHERE system = $1",
    "DELETE FROM ladders WHERE system = $1",
    "DELETE FROM evidence WHERE system = $1",
    "DELETE FROM decisions WHERE fit IN (SELECT id FROM fits WHERE system = $1)",
    "DELETE FROM offers WHERE fit IN (SELECT id FROM fits WHERE system = $1)",
    "DELETE FROM fits WHERE system = $1",
    "DELETE FROM batch_jobs WHERE job IN (SELECT id FROM jobs WHERE system = $1)",
    "DELETE FROM jobs WHERE system = $1",
    "DELETE FROM samples WHERE system = $1",
    "DELETE FROM days WHERE system = $1",
    "DELETE FROM measured WHERE system = $1",
    "DELETE FROM shares WHERE window_id IN (SELECT id FROM windows WHERE system = $1)",
    "DELETE FROM windows WHERE system = $1",
    "DELETE FROM forecast_inputs WHERE system = $1",
    "DELETE FROM said_forecasts WHERE system = $1",
    "DELETE FROM systems WHERE system = $1",
];

/// Deletes a system with everything that is its own, in one transaction. Never while a job needs it; where
/// there is history, or another system depends on it, only by force.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn delete(
    store: &Store,
    system: &SystemId,
    force: bool,
    who: &str,
    now: Timestamp,
) -> Result<SystemDeletion, StoreError> {
    let name = system.to_string();
    let mut tx = store.write().await?;
    if query("SELECT 1 FROM systems WHERE system = $1").bind(&name).fetch_optional(&mut *tx).await?.is_none()
    {
        return Ok(SystemDeletion::NotThere);
    }
    let sql = "SELECT id FROM jobs WHERE system = $1 AND state IN ('queued', 'running') ORDER BY sequence";
    let mut busy: Vec<String> = query_scalar(sql).bind(&name).fetch_all(&mut *tx).await?;
    busy.extend(readers(&mut tx, &name).await?);
    busy.dedup();
    if !busy.is_empty() {
        return Ok(SystemDeletion::Busy(busy));
    }
    let needs = needs(&mut tx, &name).await?;
    if !force && needs != Needs::default() {
        return Ok(SystemDeletion::Needed(needs));
    }
    retire(&mut tx, &name).await?;
    for sql in BELONGINGS {
        query(sql).bind(&name).execute(&mut *tx).await?;
    }
    note(
        &mut tx,
        &AuditEntry { who, action: Action::DeleteSystem, system: Some(&name), subject: &name, reason: None },
        now,
    )
    .await?;
    tx.commit().await?;
    Ok(SystemDeletion::Gone)
}

/// How many systems of a scope have which model.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn by_model(store: &Store, scope: &SystemScope) -> Result<Vec<(ModelId, i64)>, StoreError> {
    let sql = "SELECT model, COUNT(*) FROM systems WHERE model <> $1 AND ($2 IS NULL OR EXISTS \
        (SELECT 1 FROM json_each($2) WHERE glob(value, system))) GROUP BY model ORDER BY model";
    let rows: Vec<(String, i64)> =
        query_as(sql).bind(NO_MODEL).bind(scope.sql()?).fetch_all(&store.reader).await?;
    rows.into_iter().map(|(model, count)| Ok((parse("a model", &model)?, count))).collect()
}

async fn needs(tx: &mut Session, system: &str) -> Result<Needs, StoreError> {
    let count = "SELECT (SELECT COUNT(*) FROM fits WHERE system = $1), (SELECT COUNT(*) FROM revisions WHERE \
        system = $1)";
    let (fits, revisions) = query_as(count).bind(system).fetch_one(&mut *tx).await?;
    let sql = concat!(
        "SELECT s.system FROM systems s WHERE s.system <> $1 AND (",
        reads!(),
        " OR EXISTS (SELECT 1 FROM fits f JOIN fit_windows c ON c.fit = f.id JOIN windows w ON w.id = c.window_id \
        WHERE f.system = s.system AND w.system = $1)) ORDER BY s.system"
    );
    let dependents = query_scalar(sql).bind(system).fetch_all(tx).await?;
    Ok(Needs { fits, revisions, dependents })
}

/// One system.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn get(store: &Store, system: &SystemId) -> Result<Option<SystemRecord>, StoreError> {
    let sql = "SELECT * FROM systems WHERE system = $1";
    let row: Option<Row> = query_as(sql).bind(system.to_string()).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// The system that something belongs to, `None` where it is not there.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn of(store: &Store, thing: Thing, id: &str) -> Result<Option<SystemId>, StoreError> {
    let sql = match thing {
        Thing::Job => "SELECT system FROM jobs WHERE id = $1",
        Thing::Fit => "SELECT system FROM fits WHERE id = $1",
        Thing::Diagnosis => "SELECT system FROM diagnoses WHERE id = $1",
        Thing::Window => {
            "SELECT system FROM windows WHERE id = $1 OR sequence = (SELECT sequence FROM window_aliases \
            WHERE id = $1)"
        }
    };
    let system: Option<String> = query_scalar(sql).bind(id).fetch_optional(&store.reader).await?;
    system.map(|system| parse("a system", &system)).transpose()
}

/// All systems, by name.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn all(store: &Store) -> Result<Vec<SystemRecord>, StoreError> {
    let sql = "SELECT * FROM systems ORDER BY system";
    let rows: Vec<Row> = query_as(sql).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// Those of some systems that are there and within a reach, by name.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn some(
    store: &Store,
    reach: &SystemScope,
    systems: &[SystemId],
) -> Result<Vec<SystemRecord>, StoreError> {
    let sql = "SELECT * FROM systems WHERE system IN (SELECT value FROM json_each($1)) \
        AND ($2 IS NULL OR EXISTS (SELECT 1 FROM json_each($2) WHERE glob(value, system))) ORDER BY system";
    let rows: Vec<Row> =
        query_as(sql).bind(to_json("systems", systems)?).bind(reach.sql()?).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// Systems within a reach that come after a name, in order: one page of a list.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
    store: &Store,
    reach: &SystemScope,
    after: &str,
    limit: i64,
) -> Result<Vec<SystemRecord>, StoreError> {
    let sql = "SELECT * FROM systems WHERE system > $1 \
        AND ($3 IS NULL OR EXISTS (SELECT 1 FROM json_each($3) WHERE glob(value, system))) ORDER BY system \
        LIMIT $2";
    let rows: Vec<Row> =
        query_as(sql).bind(after).bind(limit).bind(reach.sql()?).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}
