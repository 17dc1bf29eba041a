//! Uploaded measurements: a report, and in `shares` what they gave to what counts.

use super::audit::{Action, AuditEntry, note};
use super::database::Store;
use super::days::{self, Days, NewDay};
use super::engine::Session;
use super::error::StoreError;
use super::packed::decompress;
use super::row::row;
use super::shares::{self, PackedShares};
use super::statement::{query, query_as, query_scalar};
use super::value::{instant, parse};
use jiff::Timestamp;
use lampyris_core::data::SystemId;

/// A window as it is listed.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowRecord {
    /// `win_` and a hash of system and content.
    pub id: String,
    /// The system that it belongs to.
    pub system: SystemId,
    /// The order of upload.
    pub sequence: i64,
    /// The first sample, in milliseconds.
    pub from_ms: i64,
    /// The last sample.
    pub to_ms: i64,
    /// What was said about it when it came.
    pub report: serde_json::Value,
    /// When the newest of its uploads came.
    pub uploaded_at: Timestamp,
    /// How many uploads it is made of: those that went on with it on the same day are one window.
    pub uploads: i64,
}

/// Windows that lie over each other, the oldest first.
#[derive(Debug)]
pub struct Stack {
    /// The version of the measurements at that moment.
    pub version: i64,
    /// What each of them gave.
    pub windows: Vec<Stacked>,
    /// What counts.
    pub days: Days,
}

/// A window of a [`Stack`].
#[derive(Debug)]
pub struct Stacked {
    /// Its number.
    pub sequence: i64,
    /// Its id.
    pub id: String,
    /// What it gave.
    pub shares: PackedShares,
}

/// What follows for the others when a window leaves its place.
#[derive(Debug, Default)]
pub struct Rebuilt {
    /// New shares of windows, by their ids.
    pub shares: Vec<(String, PackedShares)>,
    /// The days that it touched.
    pub days: Vec<NewDay>,
}

/// What became of a window that was to be deleted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WindowDeletion {
    /// It is gone.
    Gone,
    /// There was none.
    NotThere,
    /// These fits cite it, the newest first.
    Cited(Vec<String>),
    /// These running jobs may be reading it.
    InUse(Vec<String>),
    /// The measurements have changed since they were looked at.
    Stale,
}

row! {
    /// A window as its row has it.
    pub(super) struct WindowRow {
        id: String,
        system: String,
        sequence: i64,
        from_ms: i64,
        to_ms: i64,
        report: Vec<u8>,
        uploaded_at: i64,
        uploads: i64,
    }
}

impl WindowRow {
    pub(super) fn record(self) -> Result<WindowRecord, StoreError> {
        Ok(WindowRecord {
            system: parse("a system", &self.system)?,
            report: decompress("the report of a window", &self.report)?,
            uploaded_at: instant(self.uploaded_at)?,
            id: self.id,
            sequence: self.sequence,
            from_ms: self.from_ms,
            to_ms: self.to_ms,
            uploads: self.uploads,
        })
    }
}

/// One window, by its id or that of an upload that went on with it.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn get(store: &Store, id: &str) -> Result<Option<WindowRecord>, StoreError> {
    get_in(&mut store.reader.begin().await?, id).await
}

pub(super) async fn get_in(connection: &mut Session, id: &str) -> Result<Option<WindowRecord>, StoreError> {
    let sql = "SELECT * FROM windows WHERE id = $1 OR sequence = (SELECT sequence FROM window_aliases WHERE \
        id = $1)";
    let row: Option<WindowRow> = query_as(sql).bind(id).fetch_optional(connection).await?;
    row.map(WindowRow::record).transpose()
}

/// Windows of a system uploaded before a sequence number, newest first: one page of a list.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
    store: &Store,
    system: &SystemId,
    before: i64,
    limit: i64,
) -> Result<Vec<WindowRecord>, StoreError> {
    let sql = "SELECT * FROM windows
               WHERE system = $1 AND sequence < $2 ORDER BY sequence DESC LIMIT $3";
    let rows: Vec<WindowRow> =
        query_as(sql).bind(system.to_string()).bind(before).bind(limit).fetch_all(&store.reader).await?;
    rows.into_iter().map(WindowRow::record).collect()
}

/// The windows of a system that touch a stretch of whole days, with what they gave and what counts there.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn stack(
    store: &Store,
    window: &WindowRecord,
    span: (i64, i64),
) -> Result<Stack, StoreError> {
    let mut tx = store.reader.begin().await?;
    let system = window.system.to_string();
    let version = days::version_in(&mut tx, &system).await?;
    let sql = "SELECT w.sequence, w.id, s.channels, s.block FROM windows w JOIN shares s ON s.window_id = w.id \
        WHERE w.system = $1 AND w.to_ms >= $2 AND w.from_ms <= $3 ORDER BY w.sequence";
    let rows: Vec<(i64, String, String, Vec<u8>)> =
        query_as(sql).bind(&system).bind(span.0).bind(span.1).fetch_all(&mut tx).await?;
    let stacked = |(sequence, id, channels, block)| Stacked {
        sequence,
        id,
        shares: PackedShares::from_row((channels, block)),
    };
    let days = days::laid_in(&mut tx, &system, span).await?;
    Ok(Stack { version, windows: rows.into_iter().map(stacked).collect(), days })
}

/// What keeps a window from being deleted, if anything does: fits that cite it, or running jobs that may be
/// reading it.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn obstacle(
    store: &Store,
    window: &WindowRecord,
) -> Result<Option<WindowDeletion>, StoreError> {
    obstacle_in(&mut store.reader.begin().await?, &window.id, &window.system.to_string()).await
}

async fn obstacle_in(
    connection: &mut Session,
    id: &str,
    system: &str,
) -> Result<Option<WindowDeletion>, StoreError> {
    // What the gate or an operator has rejected was never served and never will be.
    let sql = "SELECT f.id FROM fit_windows c JOIN fits f ON f.id = c.fit WHERE c.window_id = $1 AND f.verdict <> \
        'rejected' AND NOT EXISTS (SELECT 1 FROM decisions d WHERE d.fit = f.id AND d.decision = 'rejected') \
        ORDER BY f.created_at DESC";
    let cited: Vec<String> = query_scalar(sql).bind(id).fetch_all(&mut *connection).await?;
    if !cited.is_empty() {
        return Ok(Some(WindowDeletion::Cited(cited)));
    }
    let reading = readers(connection, system).await?;
    Ok((!reading.is_empty()).then_some(WindowDeletion::InUse(reading)))
}

/// Deletes a window, unless something stands in the way, or the measurements have another version than the
/// one that `rebuilt` was made from. Fits that were rejected cite it no more.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn delete(
    store: &Store,
    window: &WindowRecord,
    (version, rebuilt): (i64, &Rebuilt),
    (who, reason): (&str, Option<&str>),
    now: Timestamp,
) -> Result<WindowDeletion, StoreError> {
    let mut tx = store.write().await?;
    let (id, system) = (window.id.as_str(), window.system.to_string());
    let there = query("SELECT 1 FROM windows WHERE id = $1").bind(id).fetch_optional(&mut *tx).await?;
    if there.is_none() {
        return Ok(WindowDeletion::NotThere);
    }
    if let Some(obstacle) = obstacle_in(&mut tx, id, &system).await? {
        return Ok(obstacle);
    }
    if days::version_in(&mut tx, &system).await? != version {
        tx.take_back().await?;
        return Ok(WindowDeletion::Stale);
    }
    query("DELETE FROM fit_windows WHERE window_id = $1").bind(id).execute(&mut *tx).await?;
    query("DELETE FROM shares WHERE window_id = $1").bind(id).execute(&mut *tx).await?;
    query("DELETE FROM windows WHERE id = $1").bind(id).execute(&mut *tx).await?;
    rebuilt.write(&mut tx, &system, window.sequence, now).await?;
    let deed = AuditEntry { who, action: Action::DeleteWindow, system: Some(&system), subject: id, reason };
    note(&mut tx, &deed, now).await?;
    tx.commit().await?;
    Ok(WindowDeletion::Gone)
}

impl Rebuilt {
    /// Writes it; `arriving` is the number of the window that has come on top, if one has.
    pub(super) async fn write(
        &self,
        tx: &mut Session,
        system: &str,
        arriving: i64,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        for (window, shares) in &self.shares {
            shares::write(tx, window, shares, now).await?;
        }
        days::write(tx, system, &self.days, arriving).await
    }

    /// How much room it takes, about.
    pub(super) fn bytes(&self) -> usize {
        let shares: usize = self.shares.iter().map(|(_, shares)| shares.bytes()).sum();
        shares + self.days.iter().map(NewDay::bytes).sum::<usize>()
    }
}

/// Whether the system `s` reads measurements of `$1`: it names it as a neighbour, or binds a channel to it.
macro_rules! reads {
    () => {
        "($1 IN (SELECT value FROM json_each(s.document, '$.neighbours')) OR EXISTS (SELECT 1 FROM \
        json_each(s.document, '$.channels') c WHERE substr(c.value, 1, length($1) + 1) = $1 || ':'))"
    };
}
pub(super) use reads;

/// The running jobs that may read the measurements of a system: its own, and those of systems that read it.
pub(super) async fn readers(tx: &mut Session, system: &str) -> Result<Vec<String>, StoreError> {
    let sql = concat!(
        "SELECT j.id FROM jobs j JOIN systems s ON s.system = j.system WHERE j.state = 'running' AND (s.system \
        = $1 OR ",
        reads!(),
        ") ORDER BY j.sequence"
    );
    Ok(query_scalar(sql).bind(system).fetch_all(tx).await?)
}

/// The windows that a fit cites, in the order of upload.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn cited(store: &Store, fit: &str) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT w.id FROM fit_windows c JOIN windows w ON w.id = c.window_id WHERE c.fit = $1 ORDER BY \
        w.sequence";
    Ok(query_scalar(sql).bind(fit).fetch_all(&store.reader).await?)
}

/// A unit that a channel has in the measurements of a system, `None` where there are none of it.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn unit(
    store: &Store,
    system: &SystemId,
    channel: &str,
) -> Result<Option<String>, StoreError> {
    unit_in(&mut store.reader.begin().await?, &system.to_string(), channel).await
}

pub(super) async fn unit_in(
    connection: &mut Session,
    system: &str,
    channel: &str,
) -> Result<Option<String>, StoreError> {
    let sql = "SELECT COALESCE((SELECT json_extract(c.value, '$[1]') FROM days d, json_each(d.channels) c WHERE \
        d.system = $1 AND json_extract(c.value, '$[0]') = $2 ORDER BY d.day DESC LIMIT 1), (SELECT \
        json_extract(r.value, '$[1]') FROM samples s, json_each(s.rows) r WHERE s.system = $1 AND \
        json_extract(r.value, '$[0]') = $2 LIMIT 1))";
    Ok(query_scalar(sql).bind(system).bind(channel).fetch_one(connection).await?)
}
