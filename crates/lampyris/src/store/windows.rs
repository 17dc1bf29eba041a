//! Uploaded measurements: a report and one compressed block per channel.

use super::audit::{Action, AuditEntry, note};
use super::database::Store;
use super::error::StoreError;
use super::idempotency::{KeyState, RequestKey, look_up, remember};
use super::row::row;
use super::sequence::next;
use super::value::{corrupt, from_json, instant, millis, parse, to_json};
use jiff::Timestamp;
use lampyris_core::data::{Series, SystemId};
use sqlx::SqliteConnection;

/// A window as it is listed; its samples are in [`Blocks`].
#[derive(Debug, Clone, PartialEq)]
pub struct WindowRecord {
    /// `win_` and a hash of system and content.
    pub id: String,
    /// The system that it belongs to.
    pub system: SystemId,
    /// The order of upload.
    pub sequence: i64,
    /// The first sample, in seconds.
    pub from_s: i64,
    /// The last sample.
    pub to_s: i64,
    /// What was said about it when it came.
    pub report: serde_json::Value,
    /// When it came.
    pub uploaded_at: Timestamp,
}

/// A window to be kept.
#[derive(Debug)]
pub struct NewWindow<'a> {
    /// Its id, a hash of system and content.
    pub id: &'a str,
    /// The system.
    pub system: &'a SystemId,
    /// The first sample, in seconds.
    pub from_s: i64,
    /// The last sample.
    pub to_s: i64,
    /// The report, JSON.
    pub report: &'a str,
    /// A channel and its block each.
    pub blocks: &'a [(String, Vec<u8>)],
}

/// The compressed samples of one window.
#[derive(Debug, Clone, PartialEq)]
pub struct Blocks {
    /// The window.
    pub window: String,
    blocks: Vec<Vec<u8>>,
}

/// What became of a window that was to be kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WindowInsertion {
    /// It is new.
    New,
    /// The same content was there.
    Known,
    /// The idempotency key belongs to another request.
    KeyReused,
    /// The system was deleted meanwhile.
    NoSystem,
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
}

row! {
    struct Row {
        id: String,
        system: String,
        sequence: i64,
        from_s: i64,
        to_s: i64,
        report: String,
        uploaded_at: i64,
    }
}

impl Row {
    fn record(self) -> Result<WindowRecord, StoreError> {
        Ok(WindowRecord {
            system: parse("a system", &self.system)?,
            report: from_json("the report of a window", &self.report)?,
            uploaded_at: instant(self.uploaded_at)?,
            id: self.id,
            sequence: self.sequence,
            from_s: self.from_s,
            to_s: self.to_s,
        })
    }
}

impl Blocks {
    /// Unpacks the samples. This is work for the CPU pool.
    ///
    /// # Errors
    /// Where a block is not what was written.
    pub fn decode(&self) -> Result<Vec<Series>, StoreError> {
        let unpack = |block: &Vec<u8>| {
            Series::decode(block).map_err(|error| corrupt(format!("a block of {}", self.window), &error))
        };
        self.blocks.iter().map(unpack).collect()
    }
}

/// Keeps a window, unless the same content is there already.
///
/// # Errors
/// Where the database fails.
pub async fn insert(
    store: &Store,
    new: &NewWindow<'_>,
    key: Option<&RequestKey>,
    now: Timestamp,
) -> Result<WindowInsertion, StoreError> {
    let mut tx = store.write().await?;
    let seen = match look_up(&mut tx, key).await? {
        KeyState::Reused => return Ok(WindowInsertion::KeyReused),
        KeyState::Seen(_) => true,
        KeyState::Fresh => false,
    };
    let known: Option<i64> = sqlx::query_scalar("SELECT 1 FROM windows WHERE id = $1")
        .bind(new.id)
        .fetch_optional(&mut *tx)
        .await?;
    if !seen {
        remember(&mut tx, key, new.id, if known.is_some() { 200 } else { 201 }, now).await?;
    }
    if known.is_none() {
        // Between the first look at the system and this moment a large body was parsed.
        if sqlx::query("SELECT 1 FROM systems WHERE system = $1")
            .bind(new.system.to_string())
            .fetch_optional(&mut *tx)
            .await?
            .is_none()
        {
            return Ok(WindowInsertion::NoSystem);
        }
        let bytes = new.blocks.iter().map(|(_, block)| block.len()).sum::<usize>() + new.report.len();
        store.require_room(&mut tx, bytes).await?;
        let sequence = next(&mut tx, "sequence").await?;
        let sql = "INSERT INTO windows (id, system, sequence, from_s, to_s, report, uploaded_at) VALUES ($1, \
            $2, $3, $4, $5, $6, $7)";
        sqlx::query(sql)
            .bind(new.id)
            .bind(new.system.to_string())
            .bind(sequence)
            .bind(new.from_s)
            .bind(new.to_s)
            .bind(new.report)
            .bind(millis(now))
            .execute(&mut *tx)
            .await?;
        for (channel, block) in new.blocks {
            sqlx::query("INSERT INTO window_blocks (window, channel, block) VALUES ($1, $2, $3)")
                .bind(new.id)
                .bind(channel)
                .bind(block)
                .execute(&mut *tx)
                .await?;
        }
    }
    tx.commit().await?;
    Ok(if known.is_some() { WindowInsertion::Known } else { WindowInsertion::New })
}

/// One window.
///
/// # Errors
/// Where the database fails.
pub async fn get(store: &Store, id: &str) -> Result<Option<WindowRecord>, StoreError> {
    let sql = "SELECT * FROM windows WHERE id = $1";
    let row: Option<Row> = sqlx::query_as(sql).bind(id).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// Windows of a system uploaded before a sequence number, newest first: one page of a list.
///
/// # Errors
/// Where the database fails.
pub async fn page(
    store: &Store,
    system: &SystemId,
    before: i64,
    limit: i64,
) -> Result<Vec<WindowRecord>, StoreError> {
    let sql = "SELECT * FROM windows
               WHERE system = $1 AND sequence < $2 ORDER BY sequence DESC LIMIT $3";
    let rows: Vec<Row> = sqlx::query_as(sql)
        .bind(system.to_string())
        .bind(before)
        .bind(limit)
        .fetch_all(&store.reader)
        .await?;
    rows.into_iter().map(Row::record).collect()
}

/// Deletes a window, unless a fit cites it or a running job may be reading it.
///
/// # Errors
/// Where the database fails.
pub async fn delete(
    store: &Store,
    id: &str,
    who: &str,
    now: Timestamp,
) -> Result<WindowDeletion, StoreError> {
    let mut tx = store.write().await?;
    let system: Option<String> = sqlx::query_scalar("SELECT system FROM windows WHERE id = $1")
        .bind(id)
        .fetch_optional(&mut *tx)
        .await?;
    let Some(system) = system else { return Ok(WindowDeletion::NotThere) };
    let sql = "SELECT f.id FROM fit_windows c JOIN fits f ON f.id = c.fit WHERE c.window = $1 ORDER BY \
        f.created_at DESC";
    let cited: Vec<String> = sqlx::query_scalar(sql).bind(id).fetch_all(&mut *tx).await?;
    if !cited.is_empty() {
        return Ok(WindowDeletion::Cited(cited));
    }
    let reading = readers(&mut tx, &system).await?;
    if !reading.is_empty() {
        return Ok(WindowDeletion::InUse(reading));
    }
    sqlx::query("DELETE FROM windows WHERE id = $1").bind(id).execute(&mut *tx).await?;
    note(
        &mut tx,
        &AuditEntry { who, action: Action::DeleteWindow, system: Some(&system), subject: id, reason: None },
        now,
    )
    .await?;
    tx.commit().await?;
    Ok(WindowDeletion::Gone)
}

/// The running jobs that may read the measurements of a system: its own, and those of systems that name it as
/// a neighbour.
pub(super) async fn readers(tx: &mut SqliteConnection, system: &str) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT j.id FROM jobs j JOIN systems s ON s.system = j.system WHERE j.state = 'running' \
        AND (s.system = $1 OR $1 IN (SELECT value FROM json_each(s.document, '$.neighbours'))) ORDER BY \
        j.sequence";
    Ok(sqlx::query_scalar(sql).bind(system).fetch_all(tx).await?)
}

/// The windows that a fit cites, in the order of upload.
///
/// # Errors
/// Where the database fails.
pub async fn cited(store: &Store, fit: &str) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT w.id FROM fit_windows c JOIN windows w ON w.id = c.window WHERE c.fit = $1 ORDER BY \
        w.sequence";
    Ok(sqlx::query_scalar(sql).bind(fit).fetch_all(&store.reader).await?)
}

/// The first and the last sample time of a system, `None` without any window.
///
/// # Errors
/// Where the database fails.
pub async fn extent(store: &Store, system: &SystemId) -> Result<Option<(i64, i64)>, StoreError> {
    let sql = "SELECT MIN(from_s), MAX(to_s) FROM windows WHERE system = $1";
    let (from, to): (Option<i64>, Option<i64>) =
        sqlx::query_as(sql).bind(system.to_string()).fetch_one(&store.reader).await?;
    Ok(from.zip(to))
}

/// What tells one state of a system's measurements from another: how many windows there are, and the newest.
///
/// # Errors
/// Where the database fails.
pub async fn version(store: &Store, system: &SystemId) -> Result<(i64, i64), StoreError> {
    let sql = "SELECT COUNT(*), COALESCE(MAX(sequence), 0) FROM windows WHERE system = $1";
    Ok(sqlx::query_as(sql).bind(system.to_string()).fetch_one(&store.reader).await?)
}

/// The channels of all windows of a system, by name.
///
/// # Errors
/// Where the database fails.
pub async fn channels(store: &Store, system: &SystemId) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT DISTINCT b.channel FROM windows w JOIN window_blocks b ON b.window = w.id WHERE \
        w.system = $1 ORDER BY b.channel";
    Ok(sqlx::query_scalar(sql).bind(system.to_string()).fetch_all(&store.reader).await?)
}

/// The unit of a channel in the newest window that has it, `None` where no window has.
///
/// # Errors
/// Where the database fails.
pub async fn unit(store: &Store, system: &SystemId, channel: &str) -> Result<Option<String>, StoreError> {
    let sql = "SELECT (SELECT value ->> '$.unit' FROM json_each(w.report, '$.channels') WHERE key = $2)
               FROM windows w JOIN window_blocks b ON b.window = w.id AND b.channel = $2
               WHERE w.system = $1 ORDER BY w.sequence DESC LIMIT 1";
    let unit: Option<Option<String>> =
        sqlx::query_scalar(sql).bind(system.to_string()).bind(channel).fetch_optional(&store.reader).await?;
    Ok(unit.flatten())
}

/// The samples of all windows of a system that touch a range of time, in the order of upload; of some
/// channels, or of all.
///
/// # Errors
/// Where the database fails.
pub async fn blocks(
    store: &Store,
    system: &SystemId,
    (from_s, to_s): (i64, i64),
    channels: Option<&[String]>,
) -> Result<Vec<Blocks>, StoreError> {
    let sql = "SELECT w.id, b.block FROM windows w JOIN window_blocks b ON b.window = w.id \
        WHERE w.system = $1 AND w.to_s >= $2 AND w.from_s <= $3 AND ($4 IS NULL OR b.channel IN (SELECT \
        value FROM json_each($4))) \
        ORDER BY w.sequence, b.channel";
    let channels = channels.map(|channels| to_json("channels", channels)).transpose()?;
    let rows: Vec<(String, Vec<u8>)> = sqlx::query_as(sql)
        .bind(system.to_string())
        .bind(from_s)
        .bind(to_s)
        .bind(channels)
        .fetch_all(&store.reader)
        .await?;
    let mut windows: Vec<Blocks> = Vec::new();
    for (window, block) in rows {
        match windows.last_mut() {
            Some(last) if last.window == window => last.blocks.push(block),
            _ => windows.push(Blocks { window, blocks: vec![block] }),
        }
    }
    Ok(windows)
}
