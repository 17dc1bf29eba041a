//! When batches are submitted. The row is the schedule: there is no other memory of what ran.

use super::audit::{Action, AuditEntry, note};
use super::batches::{NewBatch, is_unfinished, submit_in_batch};
use super::database::Store;
use super::engine::Session;
use super::entering;
use super::entry::SubmitError;
use super::error::StoreError;
use super::row::row;
use super::statement::{query, query_as, query_scalar};
use super::value::{from_json, instant, millis, parse};
use super::words::words;
use jiff::Timestamp;

words! {
    /// What the newest tick of a schedule led to.
    TickResult {
        /// A batch.
        Submitted = "submitted",
        /// The batch before has not ended yet, so this tick was left out.
        SkippedOverlap = "skipped_overlap",
        /// No system is selected.
        NothingToDo = "nothing_to_do",
    }
}

/// A schedule as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduleRecord {
    /// Its name.
    pub name: String,
    /// When, as a cron pattern.
    pub cron: String,
    /// The IANA time zone of the pattern.
    pub zone: String,
    /// What is submitted.
    pub request: serde_json::Value,
    /// Whether it runs at all.
    pub enabled: bool,
    /// The newest tick that was dealt with.
    pub last_tick_at: Timestamp,
    /// When it last submitted something.
    pub last_run_at: Option<Timestamp>,
    /// What it submitted.
    pub last_batch: Option<String>,
    /// What the newest tick led to.
    pub last_result: Option<TickResult>,
}

/// A schedule to be kept.
#[derive(Debug, Clone, PartialEq)]
pub struct NewSchedule<'a> {
    /// Its name.
    pub name: &'a str,
    /// When, as a cron pattern.
    pub cron: &'a str,
    /// The IANA time zone of the pattern.
    pub zone: &'a str,
    /// What is submitted, JSON.
    pub request: &'a str,
    /// Whether it runs at all.
    pub enabled: bool,
}

row! {
    struct Row {
        name: String,
        cron: String,
        zone: String,
        request: String,
        enabled: bool,
        last_tick_at: i64,
        last_run_at: Option<i64>,
        last_batch: Option<String>,
        last_result: Option<String>,
    }
}

impl Row {
    fn record(self) -> Result<ScheduleRecord, StoreError> {
        Ok(ScheduleRecord {
            request: from_json("a schedule", &self.request)?,
            last_tick_at: instant(self.last_tick_at)?,
            last_run_at: self.last_run_at.map(instant).transpose()?,
            last_result: self.last_result.as_deref().map(|word| parse("a result", word)).transpose()?,
            name: self.name,
            cron: self.cron,
            zone: self.zone,
            enabled: self.enabled,
            last_batch: self.last_batch,
        })
    }
}

/// Makes or replaces a schedule; says whether it is new. Ticks count from now on: a new pattern has no past.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn put(
    store: &Store,
    new: &NewSchedule<'_>,
    who: &str,
    now: Timestamp,
) -> Result<bool, StoreError> {
    let mut tx = store.write().await?;
    let known = query("SELECT 1 FROM schedules WHERE name = $1");
    let known = known.bind(new.name).fetch_optional(&mut *tx).await?;
    let sql = "INSERT INTO schedules (name, cron, zone, request, enabled, last_tick_at, updated_at) VALUES \
        ($1, $2, $3, $4, $5, $6, $6) \
        ON CONFLICT (name) DO UPDATE SET cron = excluded.cron, zone = excluded.zone, request = \
        excluded.request, \
        enabled = excluded.enabled, last_tick_at = excluded.last_tick_at, updated_at = excluded.updated_at";
    query(sql)
        .bind(new.name)
        .bind(new.cron)
        .bind(new.zone)
        .bind(new.request)
        .bind(new.enabled)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    note(
        &mut tx,
        &AuditEntry { who, action: Action::PutSchedule, system: None, subject: new.name, reason: None },
        now,
    )
    .await?;
    tx.commit().await?;
    Ok(known.is_none())
}

/// Removes a schedule; says whether there was one.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn delete(store: &Store, name: &str, who: &str, now: Timestamp) -> Result<bool, StoreError> {
    let mut tx = store.write().await?;
    let done = query("DELETE FROM schedules WHERE name = $1").bind(name).execute(&mut *tx).await?;
    let was_there = done > 0;
    if was_there {
        note(
            &mut tx,
            &AuditEntry { who, action: Action::DeleteSchedule, system: None, subject: name, reason: None },
            now,
        )
        .await?;
    }
    tx.commit().await?;
    Ok(was_there)
}

/// One schedule.
///
/// # Errors
/// Where the database fails.
pub async fn get(store: &Store, name: &str) -> Result<Option<ScheduleRecord>, StoreError> {
    let row: Option<Row> =
        query_as("SELECT * FROM schedules WHERE name = $1").bind(name).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// All schedules, by name.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn all(store: &Store) -> Result<Vec<ScheduleRecord>, StoreError> {
    let rows: Vec<Row> = query_as("SELECT * FROM schedules ORDER BY name").fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// Deals with a tick: submits the batch unless the one before still runs, and notes the tick, in one
/// transaction, so that a crash can neither lose a tick nor run it twice. Of very many jobs the first are in
/// it, and the others are known. `None` where the schedule is gone,
/// or does not wait for this tick any more.
///
/// # Errors
/// Where the queue is full or the database fails.
pub(crate) async fn tick(
    store: &Store,
    name: &str,
    tick: Timestamp,
    batch: &NewBatch,
    limit: i64,
    now: Timestamp,
) -> Result<Option<TickResult>, SubmitError> {
    let packed = entering::packed(&batch.jobs)?;
    let mut tx = store.write().await?;
    let waiting =
        query_scalar("SELECT last_batch FROM schedules WHERE name = $1 AND enabled AND last_tick_at < $2");
    let waiting: Option<Option<String>> =
        waiting.bind(name).bind(millis(tick)).fetch_optional(&mut *tx).await?;
    let Some(last) = waiting else {
        tx.take_back().await?;
        return Ok(None);
    };
    let overlapping = match last {
        Some(batch) => is_unfinished(&mut tx, &batch).await?,
        None => false,
    };
    let mut begun = None;
    let result = if overlapping {
        TickResult::SkippedOverlap
    } else if batch.jobs.is_empty() {
        TickResult::NothingToDo
    } else {
        let id = submit_in_batch(&mut tx, batch, packed.as_deref(), limit, now).await?;
        note_run_in(&mut tx, name, &id, now).await?;
        begun = packed.is_some().then_some(id);
        TickResult::Submitted
    };
    query("UPDATE schedules SET last_tick_at = $2, last_result = $3 WHERE name = $1")
        .bind(name)
        .bind(millis(tick))
        .bind(result.as_str())
        .execute(&mut *tx)
        .await?;
    tx.commit().await?;
    if let Some(id) = begun {
        entering::go_on(store, &id, &batch.jobs, now).await?;
    }
    Ok(Some(result))
}

/// Notes a batch that an operator started by hand.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn note_run(
    store: &Store,
    name: &str,
    batch: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    let mut tx = store.write().await?;
    note_run_in(&mut tx, name, batch, now).await?;
    tx.commit().await?;
    Ok(())
}

async fn note_run_in(tx: &mut Session, name: &str, batch: &str, now: Timestamp) -> Result<(), StoreError> {
    let sql =
        "UPDATE schedules SET last_batch = $2, last_run_at = $3, last_result = 'submitted' WHERE name = $1";
    query(sql).bind(name).bind(batch).bind(millis(now)).execute(tx).await?;
    Ok(())
}
