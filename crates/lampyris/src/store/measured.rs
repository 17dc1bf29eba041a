//! What readers ask of a system's measurements: where they begin and end, and what counts of them.

use super::database::Store;
use super::days::{self, Days};
use super::error::StoreError;
use super::statement::{query_as, query_scalar};
use super::value::{instant, to_json};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Days with the names of the windows that gave their samples.
#[derive(Debug, Clone)]
pub struct OwnedDays {
    /// The days.
    pub days: Days,
    /// The id of each window, by its number in the days.
    pub windows: BTreeMap<i64, String>,
}

/// The days that touch a stretch of time; of some channels, or of all.
///
/// # Errors
/// Where the database fails.
pub async fn read(
    store: &Store,
    system: &SystemId,
    span: (i64, i64),
    channels: Option<&[String]>,
) -> Result<Days, StoreError> {
    days::read_in(&mut store.reader.begin().await?, &system.to_string(), span, channels).await
}

/// The days that touch a stretch of time, of some channels or of all, with the names of the windows behind
/// them.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn read_owned(
    store: &Store,
    system: &SystemId,
    span: (i64, i64),
    channels: Option<&[String]>,
) -> Result<OwnedDays, StoreError> {
    // One moment for both: a window may get another number.
    let mut tx = store.reader.begin().await?;
    let days = days::read_in(&mut tx, &system.to_string(), span, channels).await?;
    let sql = "SELECT sequence, id FROM windows WHERE sequence IN (SELECT CAST(value AS BIGINT) \
        FROM json_each($1))";
    let names: Vec<(i64, String)> =
        query_as(sql).bind(to_json("windows", &days.owners()?)?).fetch_all(&mut tx).await?;
    Ok(OwnedDays { days, windows: names.into_iter().collect() })
}

/// The first and the last sample time of a system, `None` without any measurement.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn extent(store: &Store, system: &SystemId) -> Result<Option<(i64, i64)>, StoreError> {
    let sql = "SELECT MIN(first), MAX(last) FROM (SELECT (SELECT from_ms FROM days WHERE system = $1 ORDER BY \
        day LIMIT 1) AS first, (SELECT to_ms FROM days WHERE system = $1 ORDER BY day DESC LIMIT 1) AS last \
        UNION ALL SELECT MIN(from_ms), MAX(to_ms) FROM samples WHERE system = $1) spans";
    let (from, to): (Option<i64>, Option<i64>) =
        query_as(sql).bind(system.to_string()).fetch_one(&store.reader).await?;
    Ok(from.zip(to))
}

/// The last sample times of some systems, by name; one of which nothing was measured is left out.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn newest(
    store: &Store,
    systems: &[String],
) -> Result<HashMap<String, Timestamp>, StoreError> {
    let sql = "SELECT s.system, (SELECT d.to_ms FROM days d WHERE d.system = s.system ORDER BY d.day DESC LIMIT 1), \
        (SELECT MAX(m.to_ms) FROM samples m WHERE m.system = s.system) FROM systems s \
        WHERE s.system IN (SELECT value FROM json_each($1))";
    let rows: Vec<(String, Option<i64>, Option<i64>)> =
        query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    let known = rows.into_iter().filter_map(|(system, laid, live)| Some((system, laid.max(live)?)));
    known.map(|(system, newest)| Ok((system, instant(newest)?))).collect()
}

/// The systems of which something was measured, by name.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn systems(store: &Store) -> Result<HashSet<String>, StoreError> {
    let sql = "SELECT system FROM systems s WHERE EXISTS (SELECT 1 FROM days WHERE system = s.system) OR EXISTS \
        (SELECT 1 FROM samples WHERE system = s.system)";
    Ok(query_scalar(sql).fetch_all(&store.reader).await?.into_iter().collect())
}

/// The channels of a system, by name.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn channels(store: &Store, system: &SystemId) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT json_extract(c.value, '$[0]') FROM days d, json_each(d.channels) c WHERE d.system = $1 UNION \
        SELECT json_extract(r.value, '$[0]') FROM samples s, json_each(s.rows) r WHERE s.system = $1 ORDER BY 1";
    Ok(query_scalar(sql).bind(system.to_string()).fetch_all(&store.reader).await?)
}

/// What tells one state of a system's measurements from another; 0 where there never were any.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn version(store: &Store, system: &SystemId) -> Result<i64, StoreError> {
    days::version_in(&mut store.reader.begin().await?, &system.to_string()).await
}
