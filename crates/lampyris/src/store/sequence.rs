//! Numbers that nothing else has, and the ids that are made of them.

use super::engine::Session;
use super::error::StoreError;
use super::statement::query_scalar;
use jiff::Timestamp;

/// The next number of a counter.
pub(super) async fn next(tx: &mut Session, counter: &'static str) -> Result<i64, StoreError> {
    next_of(tx, counter, 1).await
}

/// The first of so many numbers of a counter that nobody else has.
pub(super) async fn next_of(tx: &mut Session, counter: &'static str, count: i64) -> Result<i64, StoreError> {
    let sql = "UPDATE counters SET value = value + $2 WHERE name = $1 RETURNING value - $2 + 1";
    Ok(query_scalar(sql).bind(counter).bind(count).fetch_one(tx).await?)
}

/// An id that nobody has: a sequence number and the time, hashed so that ids neither sort nor show how many
/// there are.
pub(super) fn derive_id(prefix: &str, sequence: i64, now: Timestamp) -> String {
    id_of(prefix, &format!("{prefix} {sequence} {now}"))
}

/// An id that nobody has, of what nobody else has.
pub(super) fn id_of(prefix: &str, what: &str) -> String {
    format!("{prefix}_{}", &blake3::hash(what.as_bytes()).to_hex()[..20])
}
