//! Samples that go by their age alone, in whole months.

use super::database::Store;
use super::error::StoreError;
use super::months;
use super::retention::HANDFUL;
use super::sequence::next;
use super::statement::{query, query_scalar};
use super::value::to_json;
use jiff::Timestamp;
use lampyris_core::data::DAY;
use sqlx::AssertSqlSafe;

/// What was forgotten of samples by their age.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ForgottenSamples {
    /// Tables of a month, or rows where a table is one.
    pub parts: u64,
    /// Windows all of whose samples lie before.
    pub windows: u64,
}

/// Forgets the samples of all months that lie before an instant wholly, whatever has read them, with the
/// windows that have no others. What was found in them stays.
///
/// # Errors
/// Where the database fails; what is gone by then stays so.
pub(crate) async fn forget(store: &Store, before: Timestamp) -> Result<ForgottenSamples, StoreError> {
    let day = months::beginning(before)?;
    let mut gone =
        ForgottenSamples { windows: forget_windows(store, day * DAY).await?, ..Default::default() };
    gone.parts = match store.is_shared() {
        true => drop_months(store, day).await?,
        false => forget_days(store, day).await?,
    };
    if gone != ForgottenSamples::default() {
        let mut tx = store.write().await?;
        let version = next(&mut tx, "sequence").await?;
        query("UPDATE measured SET version = $1").bind(version).execute(&mut *tx).await?;
        tx.commit().await?;
    }
    Ok(gone)
}

/// Removes windows that end before an instant.
async fn forget_windows(store: &Store, before: i64) -> Result<u64, StoreError> {
    let mut gone = 0;
    loop {
        let sql = "SELECT id FROM windows WHERE to_ms < $1 ORDER BY sequence LIMIT $2";
        let ids: Vec<String> = query_scalar(sql).bind(before).bind(HANDFUL).fetch_all(&store.reader).await?;
        if ids.is_empty() {
            return Ok(gone);
        }
        let mut tx = store.write().await?;
        let some = to_json("windows", &ids)?;
        for sql in [
            "DELETE FROM fit_windows WHERE window_id IN (SELECT value FROM json_each($1))",
            "DELETE FROM shares WHERE window_id IN (SELECT value FROM json_each($1))",
            "DELETE FROM windows WHERE id IN (SELECT value FROM json_each($1))",
        ] {
            query(sql).bind(&some).execute(&mut *tx).await?;
        }
        tx.commit().await?;
        gone += ids.len() as u64;
    }
}

/// Removes the days before one, some systems after the other.
async fn forget_days(store: &Store, before: i64) -> Result<u64, StoreError> {
    let (mut gone, mut after) = (0, String::new());
    loop {
        let sql = "SELECT system FROM systems WHERE system > $1 ORDER BY system LIMIT $2";
        let some: Vec<String> = query_scalar(sql).bind(&after).bind(HANDFUL).fetch_all(&store.reader).await?;
        let Some(last) = some.last() else { return Ok(gone) };
        after.clone_from(last);
        let mut tx = store.write().await?;
        let sql = "DELETE FROM days WHERE system IN (SELECT value FROM json_each($1)) AND day < $2";
        gone += query(sql).bind(to_json("systems", &some)?).bind(before).execute(&mut *tx).await?;
        tx.commit().await?;
    }
}

/// Drops the tables of months that end before a day. Whoever reads one of them is waited for a moment; a
/// month that nobody could take is there still in the next night.
async fn drop_months(store: &Store, before: i64) -> Result<u64, StoreError> {
    let mut gone = 0;
    for table in months::TABLES {
        let sql = "SELECT c.relname::TEXT FROM pg_inherits i JOIN pg_class c ON c.oid = i.inhrelid \
            WHERE i.inhparent = to_regclass($1) AND CAST(substring(pg_get_expr(c.relpartbound, c.oid) \
            FROM 'TO \\(''?(-?[0-9]+)') AS BIGINT) <= $2 ORDER BY 1";
        let names: Vec<String> = query_scalar(sql).bind(table).bind(before).fetch_all(&store.reader).await?;
        for name in names {
            let mut tx = store.write().await?;
            query("SET LOCAL lock_timeout = '2s'").execute(&mut *tx).await?;
            query(AssertSqlSafe(format!("DROP TABLE {name}"))).execute(&mut *tx).await?;
            tx.commit().await?;
            gone += 1;
        }
    }
    Ok(gone)
}
