//! What forecasts said, kept until it can be compared with what came.

use super::database::Store;
use super::error::StoreError;
use super::row::row;
use super::statement::{query, query_as};
use super::value::{corrupt, instant, millis};
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::{Series, SystemId};
use lampyris_core::estimate::forecast::score::Said;

/// For so long what was said is kept.
pub const KEPT: SignedDuration = SignedDuration::from_hours(30 * 24);
/// Of a system at most one forecast is kept in so many milliseconds.
const QUARTER_MS: i64 = 900_000;

/// What a forecast said of an output, packed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PackedSaid {
    /// The output.
    pub output: String,
    /// When it was made.
    pub made_at: Timestamp,
    /// The revision that made it.
    pub revision: i64,
    at_ms: i64,
    said: Vec<u8>,
    sd: Vec<u8>,
}

row! {
    /// What a forecast said, as it stands in the table.
    struct SaidRow {
        output: String,
        made_at: i64,
        revision: i64,
        at_ms: i64,
        said: Vec<u8>,
        sd: Vec<u8>,
    }
}

/// The quarter of an hour in which an instant lies.
pub fn quarter(instant: Timestamp) -> i64 {
    millis(instant).div_euclid(QUARTER_MS)
}

impl PackedSaid {
    /// Packs what was said. This is work for a blocking thread or the CPU pool.
    pub fn new(said: &Said, revision: i64, made_at: Timestamp) -> Self {
        Self {
            output: said.values.channel().to_owned(),
            made_at,
            revision,
            at_ms: said.at,
            said: said.values.encode(),
            sd: said.sd.encode(),
        }
    }

    /// The newest measurement that the forecast knew, in milliseconds.
    pub fn at(&self) -> i64 {
        self.at_ms
    }

    fn bytes(&self) -> usize {
        self.said.len() + self.sd.len()
    }

    /// Unpacks it. This is work for a blocking thread or the CPU pool.
    ///
    /// # Errors
    /// Where it is not what was written.
    pub fn decode(&self) -> Result<Said, StoreError> {
        let series = |block: &[u8]| {
            Series::decode(block)
                .map_err(|error| corrupt(format!("what was said of `{}`", self.output), &error))
        };
        Ok(Said { at: self.at_ms, values: series(&self.said)?, sd: series(&self.sd)? })
    }
}

/// Keeps what forecasts of systems said, as far as none of the same quarter of an hour is kept. What is said
/// of a system that is gone goes with it.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn keep(store: &Store, said: &[(SystemId, Vec<PackedSaid>)]) -> Result<(), StoreError> {
    let bytes: usize = said.iter().flat_map(|(_, outputs)| outputs).map(PackedSaid::bytes).sum();
    let mut tx = store.write().await?;
    store.require_room(&mut tx, bytes).await?;
    let sql = "INSERT INTO said_forecasts (system, output, quarter, made_at, revision, at_ms, said, sd) \
        SELECT $1, $2, $3, $4, $5, $6, $7, $8 WHERE EXISTS (SELECT 1 FROM systems WHERE system = $1) \
        ON CONFLICT DO NOTHING";
    for (system, outputs) in said {
        for one in outputs {
            query(sql)
                .bind(system.to_string())
                .bind(&one.output)
                .bind(quarter(one.made_at))
                .bind(millis(one.made_at))
                .bind(one.revision)
                .bind(one.at_ms)
                .bind(&one.said)
                .bind(&one.sd)
                .execute(&mut *tx)
                .await?;
        }
    }
    tx.commit().await
}

/// What forecasts of a system said since an instant, by output and time.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn since(
    store: &Store,
    system: &SystemId,
    from: Timestamp,
) -> Result<Vec<PackedSaid>, StoreError> {
    let sql = "SELECT output, made_at, revision, at_ms, said, sd FROM said_forecasts WHERE system = $1 AND \
        made_at >= $2 ORDER BY output, quarter";
    let query = query_as(sql).bind(system.to_string()).bind(millis(from));
    let rows: Vec<SaidRow> = query.fetch_all(&store.reader).await?;
    let packed = |row: SaidRow| {
        Ok(PackedSaid {
            output: row.output,
            made_at: instant(row.made_at)?,
            revision: row.revision,
            at_ms: row.at_ms,
            said: row.said,
            sd: row.sd,
        })
    };
    rows.into_iter().map(packed).collect()
}

/// How many forecasts of a system were kept, and when the newest was made: what an answer about them depends
/// on.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn version(store: &Store, system: &SystemId) -> Result<(i64, i64), StoreError> {
    let sql = "SELECT COUNT(*), COALESCE(MAX(made_at), 0) FROM said_forecasts WHERE system = $1";
    Ok(query_as(sql).bind(system.to_string()).fetch_one(&store.reader).await?)
}

/// Forgets what was said too long ago.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn forget_old(store: &Store, now: Timestamp) -> Result<(), StoreError> {
    let before = now.saturating_sub(KEPT).map_or(0, millis);
    let mut tx = store.write().await?;
    query("DELETE FROM said_forecasts WHERE made_at < $1").bind(before).execute(&mut *tx).await?;
    tx.commit().await
}
