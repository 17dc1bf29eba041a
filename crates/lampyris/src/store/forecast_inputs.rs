//! What was forecast of the inputs of systems, apart from all that was measured.

use super::database::Store;
use super::error::StoreError;
use super::idempotency::{KeyState, RequestKey, look_up, remember};
use super::row::row;
use super::sequence::next;
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, instant, millis};
use jiff::Timestamp;
use lampyris_core::data::{Series, SystemId};

/// What counts of a channel, still packed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptInput {
    /// The channel.
    pub channel: String,
    /// When its newest issue came.
    pub issued_at: Timestamp,
    /// The first sample, in milliseconds.
    pub from_ms: i64,
    /// The last one.
    pub to_ms: i64,
    block: Vec<u8>,
    version: i64,
}

row! {
    /// What counts of a channel, as it stands in the table.
    struct InputRow {
        channel: String,
        issued_at: i64,
        version: i64,
        from_ms: i64,
        to_ms: i64,
        block: Vec<u8>,
    }
}

/// What became of an issue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IssueWritten {
    /// It is kept.
    Kept,
    /// The same request was answered before.
    Repeated,
    /// Its key has come with another request.
    KeyReused,
    /// What counted has changed since it was looked at.
    Stale,
    /// The system was deleted meanwhile.
    NoSystem,
}

impl KeptInput {
    /// Packs what counts of a channel after an issue. This is work for a blocking thread.
    pub fn new(series: &Series, issued_at: Timestamp) -> Self {
        Self {
            channel: series.channel().to_owned(),
            issued_at,
            from_ms: series.from(),
            to_ms: series.to(),
            block: series.encode(),
            version: 0,
        }
    }

    /// Unpacks what counts. This is work for a blocking thread or the CPU pool.
    ///
    /// # Errors
    /// Where it is not what was written.
    pub fn series(&self) -> Result<Series, StoreError> {
        Series::decode(&self.block)
            .map_err(|error| corrupt(format!("a forecast of `{}`", self.channel), &error))
    }
}

/// What tells one state of what was forecast from another; 0 where there is nothing.
pub fn version(inputs: &[KeptInput]) -> i64 {
    inputs.iter().map(|input| input.version).max().unwrap_or_default()
}

/// What was forecast for a system, by channel.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn of(store: &Store, system: &SystemId) -> Result<Vec<KeptInput>, StoreError> {
    let sql = "SELECT channel, issued_at, version, from_ms, to_ms, block FROM forecast_inputs \
        WHERE system = $1 ORDER BY channel";
    let query = query_as(sql).bind(system.to_string());
    let rows: Vec<InputRow> = query.fetch_all(&store.reader).await?;
    let input = |row: InputRow| {
        Ok(KeptInput {
            channel: row.channel,
            issued_at: instant(row.issued_at)?,
            from_ms: row.from_ms,
            to_ms: row.to_ms,
            block: row.block,
            version: row.version,
        })
    };
    rows.into_iter().map(input).collect()
}

/// Writes what counts of some channels after an issue, unless what counted before has another version than
/// `version`.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn write(
    store: &Store,
    system: &SystemId,
    (inputs, version): (&[KeptInput], i64),
    key: Option<&RequestKey>,
    now: Timestamp,
) -> Result<IssueWritten, StoreError> {
    let name = system.to_string();
    let mut tx = store.write().await?;
    let there = query("SELECT 1 FROM systems WHERE system = $1").bind(&name);
    if there.fetch_optional(&mut *tx).await?.is_none() {
        return Ok(IssueWritten::NoSystem);
    }
    match look_up(&mut tx, key).await? {
        KeyState::Fresh => {}
        KeyState::Seen(_) => return tx.take_back().await.map(|()| IssueWritten::Repeated),
        KeyState::Reused => return tx.take_back().await.map(|()| IssueWritten::KeyReused),
    }
    let sql = "SELECT COALESCE(MAX(version), 0) FROM forecast_inputs WHERE system = $1";
    let standing: i64 = query_scalar(sql).bind(&name).fetch_one(&mut *tx).await?;
    if standing != version {
        return tx.take_back().await.map(|()| IssueWritten::Stale);
    }
    store.require_room(&mut tx, inputs.iter().map(|input| input.block.len()).sum()).await?;
    let version = next(&mut tx, "sequence").await?;
    for input in inputs {
        let sql = "INSERT INTO forecast_inputs (system, channel, issued_at, version, from_ms, to_ms, block) \
            VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (system, channel) DO UPDATE SET \
            issued_at = excluded.issued_at, version = excluded.version, from_ms = excluded.from_ms, \
            to_ms = excluded.to_ms, block = excluded.block";
        query(sql)
            .bind(&name)
            .bind(&input.channel)
            .bind(millis(input.issued_at))
            .bind(version)
            .bind(input.from_ms)
            .bind(input.to_ms)
            .bind(&input.block)
            .execute(&mut *tx)
            .await?;
    }
    remember(&mut tx, key, &name, 201, now).await?;
    tx.commit().await?;
    Ok(IssueWritten::Kept)
}
