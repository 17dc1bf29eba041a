//! Revisions that stay in service until an operator says otherwise.

use super::audit::{Action, AuditEntry, note};
use super::database::Store;
use super::error::StoreError;
use super::revisions::{Cause, NewRevision, publish};
use super::row::row;
use super::statement::{query, query_as};
use super::value::millis;
use jiff::Timestamp;
use lampyris_core::data::SystemId;

/// What became of a pin.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pinned {
    /// It is set; the revision that it made, or kept where the same fit was pinned already.
    Set(i64),
    /// There is nothing to pin: no revision names the fit, or nothing was ever served.
    NeverServed,
}

row! {
    struct Source {
        revision: i64,
        fit: String,
        job: String,
        served: String,
        model_hash: String,
        window_from: String,
        window_to: String,
        measured_to: Option<String>,
        fitted_at: i64,
        validated_at: i64,
        pinned: bool,
    }
}

/// Pins what is served now, or rolls back to an earlier fit and pins that. The pin makes a new revision that
/// names the old fit, so revisions never go back.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn put(
    store: &Store,
    system: &SystemId,
    fit: Option<&str>,
    reason: &str,
    who: &str,
    now: Timestamp,
) -> Result<Pinned, StoreError> {
    let mut tx = store.write().await?;
    let system = system.to_string();
    let sql = "SELECT r.revision, r.fit, r.job, r.served, r.model_hash, r.window_from, r.window_to, r.measured_to, \
        r.fitted_at, r.validated_at, \
        EXISTS (SELECT 1 FROM pins p WHERE p.system = r.system AND p.revision = r.revision) AS pinned \
        FROM revisions r WHERE r.system = $1 AND ($2 IS NULL AND r.current OR r.fit = $2) ORDER BY \
        r.revision DESC LIMIT 1";
    let source: Option<Source> = query_as(sql).bind(&system).bind(fit).fetch_optional(&mut *tx).await?;
    let Some(source) = source else { return Ok(Pinned::NeverServed) };
    let revision = if source.pinned {
        source.revision
    } else {
        let new = NewRevision {
            system: &system,
            fit: &source.fit,
            job: &source.job,
            served: &source.served,
            model_hash: &source.model_hash,
            window: (&source.window_from, &source.window_to),
            measured_to: source.measured_to.as_deref(),
            fitted_at: source.fitted_at,
            validated_at: source.validated_at,
            cause: Cause::Pinned,
            reason: Some(reason),
        };
        // The pin leads to the revision, so the old one goes first.
        query("DELETE FROM pins WHERE system = $1").bind(&system).execute(&mut *tx).await?;
        publish(&mut tx, &new, now).await?
    };
    let sql = "INSERT INTO pins (system, revision, reason, since_at) VALUES ($1, $2, $3, $4)
               ON CONFLICT (system) DO UPDATE SET reason = excluded.reason";
    query(sql).bind(&system).bind(revision).bind(reason).bind(millis(now)).execute(&mut *tx).await?;
    note(
        &mut tx,
        &AuditEntry {
            who,
            action: Action::Pin,
            system: Some(&system),
            subject: &source.fit,
            reason: Some(reason),
        },
        now,
    )
    .await?;
    tx.commit().await?;
    Ok(Pinned::Set(revision))
}

/// Takes a pin away: what is served stays, and the next accepted fit may follow it.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn delete(
    store: &Store,
    system: &SystemId,
    who: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    let system = system.to_string();
    let mut tx = store.write().await?;
    let gone = query("DELETE FROM pins WHERE system = $1").bind(&system).execute(&mut *tx).await?;
    if gone > 0 {
        note(
            &mut tx,
            &AuditEntry { who, action: Action::Unpin, system: Some(&system), subject: &system, reason: None },
            now,
        )
        .await?;
    }
    tx.commit().await
}
