//! What is old and named by nothing that is kept: found and removed in small transactions, so that nobody
//! waits for long.
//!
//! What was ever served stays, with the fits and jobs behind it and the windows that those fits have read. So
//! do the newest job, diagnosis and ladder of a system, its newest offer while that waits for an operator,
//! and the newest batch of a schedule. What diagnoses saw of every effect (`evidence`) stays as long as its
//! system.

use super::database::Store;
use super::error::StoreError;
use super::statement::{query, query_as};
use super::value::{millis, to_json};
use jiff::Timestamp;
use lampyris_core::data::DAY;

/// Most jobs, windows or systems whose rows one transaction removes.
pub(super) const HANDFUL: i64 = 200;

/// Jobs that ended before an instant, one for estimates and one for diagnoses and ladders, and that nothing
/// names any more. `$3` limits the answer to some of them, or is null.
const DISPENSABLE_JOBS: &str = "SELECT j.sequence, j.id FROM jobs j \
    WHERE j.ended_at < CASE j.kind WHEN 'estimate' THEN $1 ELSE $2 END \
    AND ($3 IS NULL OR j.id IN (SELECT value FROM json_each($3))) AND j.sequence > $4 \
    AND NOT EXISTS (SELECT 1 FROM revisions r WHERE r.job = j.id) \
    AND NOT EXISTS (SELECT 1 FROM revisions r WHERE r.fit = j.fit) \
    AND NOT EXISTS (SELECT 1 FROM fallbacks f WHERE f.system = j.system AND (f.job = j.id OR f.fit = j.fit)) \
    AND NOT (EXISTS (SELECT 1 FROM offers o WHERE o.fit = j.fit) \
    AND NOT EXISTS (SELECT 1 FROM decisions d WHERE d.fit = j.fit) \
    AND NOT EXISTS (SELECT 1 FROM jobs n JOIN offers o ON o.fit = n.fit WHERE n.system = j.system AND \
    n.sequence > j.sequence)) \
    AND NOT EXISTS (SELECT 1 FROM jobs again WHERE again.retry_of = j.id) \
    AND NOT EXISTS (SELECT 1 FROM batch_jobs b JOIN schedules s ON s.last_batch = b.batch WHERE b.job = \
    j.id) \
    AND j.sequence < (SELECT MAX(n.sequence) FROM jobs n WHERE n.system = j.system) \
    AND NOT EXISTS (SELECT 1 FROM diagnoses d WHERE d.job = j.id \
    AND d.sequence = (SELECT MAX(n.sequence) FROM diagnoses n WHERE n.system = d.system)) \
    AND NOT EXISTS (SELECT 1 FROM ladders l WHERE l.job = j.id \
    AND l.sequence = (SELECT MAX(n.sequence) FROM ladders n WHERE n.system = l.system)) \
    ORDER BY j.sequence LIMIT $5";

/// What goes with a job, in an order that the keys allow.
const BELONGINGS: [&str; 8] = [
    "UPDATE jobs SET diagnosis = NULL WHERE id IN (SELECT value FROM json_each($1))",
    "DELETE FROM diagnoses WHERE job IN (SELECT value FROM json_each($1))",
    "DELETE FROM ladders WHERE job IN (SELECT value FROM json_each($1))",
    "DELETE FROM decisions WHERE fit IN (SELECT id FROM fits WHERE job IN (SELECT value FROM json_each($1)))",
    "DELETE FROM offers WHERE fit IN (SELECT id FROM fits WHERE job IN (SELECT value FROM json_each($1)))",
    "DELETE FROM fits WHERE job IN (SELECT value FROM json_each($1))",
    "DELETE FROM batch_jobs WHERE job IN (SELECT value FROM json_each($1))",
    "DELETE FROM jobs WHERE id IN (SELECT value FROM json_each($1))",
];

/// Windows that came before `$1`, are cited by no fit that counts, and either end before the newest sample of
/// their system by `$2` milliseconds or give nothing to what counts. Those up to `$3` have been looked at.
const DISPENSABLE_WINDOWS: &str = "SELECT w.sequence, w.id FROM windows w \
    WHERE w.uploaded_at < $1 AND w.sequence > $3 \
    AND (w.to_ms < (SELECT d.to_ms FROM days d WHERE d.system = w.system ORDER BY d.day DESC LIMIT 1) - $2 \
    OR NOT EXISTS (SELECT 1 FROM days d, json_each(d.channels) c, json_each(json_extract(c.value, '$[2]')) o \
    WHERE d.system = w.system AND d.day BETWEEN w.from_ms / 86400000 - 1 AND w.to_ms / 86400000 \
    AND CAST(json_extract(o.value, '$[0]') AS BIGINT) = w.sequence)) \
    AND NOT EXISTS (SELECT 1 FROM samples s WHERE s.window_id = w.id) \
    AND NOT EXISTS (SELECT 1 FROM fit_windows c JOIN fits f ON f.id = c.fit WHERE c.window_id = w.id \
    AND f.verdict <> 'rejected') ORDER BY w.sequence LIMIT $4";

/// Removes jobs that ended before these instants (`None` keeps all of the kind), with their fits; says how
/// many.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn forget_jobs(
    store: &Store,
    estimates: Option<Timestamp>,
    diagnoses: Option<Timestamp>,
) -> Result<u64, StoreError> {
    let (estimates, diagnoses) = (estimates.map_or(i64::MIN, millis), diagnoses.map_or(i64::MIN, millis));
    let (mut gone, mut cursor) = (0, 0);
    loop {
        let find = |among: Option<String>, after: i64| {
            query_as::<(i64, String)>(DISPENSABLE_JOBS)
                .bind(estimates)
                .bind(diagnoses)
                .bind(among)
                .bind(after)
                .bind(HANDFUL)
        };
        // They are looked for without holding up anybody who writes.
        let found = find(None, cursor).fetch_all(&store.reader).await?;
        let Some((last, _)) = found.last() else { return Ok(gone) };
        cursor = *last;
        let mut tx = store.write().await?;
        let ids: Vec<String> = found.into_iter().map(|(_, id)| id).collect();
        // An operator may have published one of them meanwhile.
        let still = find(Some(to_json("jobs", &ids)?), 0).fetch_all(&mut *tx).await?;
        let ids = to_json("jobs", &still.iter().map(|(_, id)| id).collect::<Vec<_>>())?;
        for sql in BELONGINGS {
            query(sql).bind(&ids).execute(&mut *tx).await?;
        }
        tx.commit().await?;
        gone += still.len() as u64;
    }
}

/// Removes batches from before an instant of which no job is left; says how many.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn forget_batches(store: &Store, before: Timestamp) -> Result<u64, StoreError> {
    let sql = "DELETE FROM batches WHERE created_at < $1 AND NOT EXISTS (SELECT 1 FROM batch_jobs b WHERE \
        b.batch = batches.id) \
        AND NOT EXISTS (SELECT 1 FROM schedules s WHERE s.last_batch = batches.id)";
    let mut tx = store.write().await?;
    let gone = query(sql).bind(millis(before)).execute(&mut *tx).await?;
    tx.commit().await?;
    Ok(gone)
}

/// Removes what the same search would find again from fits of before an instant that were never served; says
/// from how many.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn shorten_fits(store: &Store, before: Timestamp) -> Result<u64, StoreError> {
    let sql = "UPDATE fits SET replay = NULL WHERE id IN (SELECT f.id FROM fits f WHERE f.replay IS NOT NULL AND \
        f.created_at < $1 AND NOT EXISTS (SELECT 1 FROM revisions r WHERE r.fit = f.id) \
        AND NOT EXISTS (SELECT 1 FROM offers o WHERE o.fit = f.id AND NOT EXISTS (SELECT 1 FROM decisions d \
        WHERE d.fit = f.id)) LIMIT $2)";
    let mut shortened = 0;
    loop {
        let mut tx = store.write().await?;
        let some = query(sql).bind(millis(before)).bind(HANDFUL).execute(&mut *tx).await?;
        tx.commit().await?;
        shortened += some;
        if some == 0 {
            return Ok(shortened);
        }
    }
}

/// Windows that came before an instant, that no fit needs, and that lie so many days before the newest sample
/// of their system or give nothing any more: a handful with numbers after `after`.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn dispensable_windows(
    store: &Store,
    before: Timestamp,
    days: u32,
    after: i64,
) -> Result<Vec<(i64, String)>, StoreError> {
    let find = query_as(DISPENSABLE_WINDOWS)
        .bind(millis(before))
        .bind(i64::from(days) * DAY)
        .bind(after)
        .bind(HANDFUL);
    Ok(find.fetch_all(&store.reader).await?)
}
