//! Systems whose revision forecasts newer measurements much worse than those that it was validated on.

use super::database::Store;
use super::error::StoreError;
use super::params;
use super::statement::{query, query_scalar};
use super::value::{millis, parse, to_json};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::assess::degradation::Degradation;
use lampyris_core::estimate::assess::metrics::CurrentState;

/// Keeps what newer measurements say of a revision, if it is still the current one: its states, and whether
/// it is degraded. Says whether that has turned: `Some(true)` where it became degraded, `Some(false)` where
/// it recovered.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn keep(
    store: &Store,
    system: &SystemId,
    revision: i64,
    found: Option<&Degradation>,
    state: Option<&CurrentState>,
    now: Timestamp,
) -> Result<Option<bool>, StoreError> {
    let mut tx = store.write().await?;
    let system = system.to_string();
    let current: Option<i64> = query_scalar("SELECT revision FROM revisions WHERE system = $1 AND current")
        .bind(&system)
        .fetch_optional(&mut *tx)
        .await?;
    if current != Some(revision) {
        return Ok(None);
    }
    if let Some(state) = state {
        params::keep_state(&mut tx, &system, state).await?;
    }
    let changed = match found {
        Some(degradation) => {
            let sql = "INSERT INTO degradations (system, revision, description, since_at) VALUES ($1, $2, \
                $3, $4) ON CONFLICT DO NOTHING";
            let query = query(sql)
                .bind(&system)
                .bind(revision)
                .bind(to_json("a degradation", degradation)?)
                .bind(millis(now));
            query.execute(&mut *tx).await? > 0
        }
        None => {
            query("DELETE FROM degradations WHERE system = $1").bind(&system).execute(&mut *tx).await? > 0
        }
    };
    tx.commit().await?;
    Ok(changed.then_some(found.is_some()))
}

/// Systems that have measurements newer than those behind their revision.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn outdated(store: &Store) -> Result<Vec<SystemId>, StoreError> {
    let sql = "SELECT r.system FROM revisions r WHERE r.current AND EXISTS \
        (SELECT 1 FROM windows w WHERE w.system = r.system AND w.uploaded_at > r.published_at) ORDER BY \
        r.system";
    let names: Vec<String> = query_scalar(sql).fetch_all(&store.reader).await?;
    names.iter().map(|name| parse("a system", name)).collect()
}
