//! Fits that wait for an operator, and what the operator says.

use super::audit::{Action, AuditEntry, note};
use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::idempotency::{KeyState, RequestKey, look_up, remember};
use super::packed::decompress;
use super::params;
use super::revisions::{Cause, NewRevision, publish};
use super::row::row;
use super::statement::{query, query_as};
use super::value::{from_json, instant, millis, parse, to_json};
use super::words::words;
use jiff::Timestamp;
use lampyris_core::estimate::assess::metrics::CurrentState;
use lampyris_core::estimate::{Fit, Offer};

words! {
    /// An operator's word on an offer.
    Decision {
        /// It is served.
        Promoted = "promoted",
        /// It never will be.
        Rejected = "rejected",
    }
}

/// A decision as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct DecisionRecord {
    /// The word.
    pub decision: Decision,
    /// Why.
    pub reason: String,
    /// When.
    pub decided_at: Timestamp,
}

/// What became of a decision.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decided {
    /// It is done; the system, and the revision that it published.
    Done(String, Option<i64>),
    /// It was made before; nothing changes.
    Already,
    /// The idempotency key belongs to another request.
    KeyReused,
    /// There is no such fit.
    NoFit,
    /// The fit does not wait for an operator; the gate's verdict on it.
    NotOffered(String),
    /// The operator has said the opposite.
    Final(Decision),
    /// The system is pinned.
    Pinned,
    /// The system has another model by now.
    OtherModel(String),
}

row! {
    struct OfferRow {
        system: String,
        job: String,
        model: String,
        own_model: String,
        document: Vec<u8>,
        verdict: String,
        created_at: i64,
        served: Option<String>,
        state: Option<String>,
        decision: Option<String>,
        pinned: bool,
    }
}

/// Keeps what a fit would serve, until an operator decides.
pub(super) async fn offer(
    tx: &mut Session,
    fit: &str,
    offer: &Offer,
    state: Option<&CurrentState>,
) -> Result<(), StoreError> {
    query("INSERT INTO offers (fit, served, state) VALUES ($1, $2, $3)")
        .bind(fit)
        .bind(to_json("an offer", offer)?)
        .bind(state.map(|state| to_json("a state", state)).transpose()?)
        .execute(tx)
        .await?;
    Ok(())
}

/// Decides an offer. A promotion publishes in the same transaction.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn decide(
    store: &Store,
    fit: &str,
    decision: Decision,
    reason: &str,
    key: Option<&RequestKey>,
    (who, now): (&str, Timestamp),
) -> Result<Decided, StoreError> {
    let mut tx = store.write().await?;
    match look_up(&mut tx, key).await? {
        KeyState::Reused => return Ok(Decided::KeyReused),
        KeyState::Seen(_) => return Ok(Decided::Already),
        KeyState::Fresh => remember(&mut tx, key, fit, 200, now).await?,
    }
    let sql = "SELECT f.system, f.job, f.model, s.model AS own_model, f.document, f.verdict, f.created_at, \
        o.served, o.state, d.decision, \
        EXISTS (SELECT 1 FROM pins p WHERE p.system = f.system) AS pinned \
        FROM fits f JOIN systems s ON s.system = f.system \
        LEFT JOIN offers o ON o.fit = f.id LEFT JOIN decisions d ON d.fit = f.id WHERE f.id = $1";
    let row: Option<OfferRow> = query_as(sql).bind(fit).fetch_optional(&mut *tx).await?;
    let Some(row) = row else { return Ok(Decided::NoFit) };
    let Some(served) = &row.served else { return Ok(Decided::NotOffered(row.verdict)) };
    if let Some(earlier) = &row.decision {
        let earlier: Decision = parse("a decision", earlier)?;
        if earlier != decision {
            return Ok(Decided::Final(earlier));
        }
        // The key belongs to this request from now on, although nothing else changes.
        tx.commit().await?;
        return Ok(Decided::Already);
    }
    if decision == Decision::Promoted && row.pinned {
        return Ok(Decided::Pinned);
    }
    if decision == Decision::Promoted && row.model != row.own_model {
        return Ok(Decided::OtherModel(row.own_model));
    }
    query("INSERT INTO decisions (fit, decision, reason, decided_at) VALUES ($1, $2, $3, $4)")
        .bind(fit)
        .bind(decision.as_str())
        .bind(reason)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    let action = match decision {
        Decision::Promoted => Action::PromoteFit,
        Decision::Rejected => Action::RejectFit,
    };
    note(
        &mut tx,
        &AuditEntry { who, action, system: Some(&row.system), subject: fit, reason: Some(reason) },
        now,
    )
    .await?;
    let mut revision = None;
    if decision == Decision::Promoted {
        let found: Fit = decompress("a fit", &row.document)?;
        let new = NewRevision {
            system: &row.system,
            fit,
            job: &row.job,
            served,
            model_hash: &found.model_hash,
            window: found.window(),
            measured_to: None,
            // It is as old as the gate's look at it, however late the operator came.
            fitted_at: row.created_at,
            validated_at: row.created_at,
            cause: Cause::Promoted,
            reason: Some(reason),
        };
        revision = Some(publish(&mut tx, &new, now).await?);
        if let Some(state) = &row.state {
            params::keep_state(&mut tx, &row.system, &from_json("a state", state)?).await?;
        }
    }
    tx.commit().await?;
    Ok(Decided::Done(row.system, revision))
}

/// What an operator has said of a fit, and whether the fit waits for it.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn of(store: &Store, fit: &str) -> Result<(bool, Option<DecisionRecord>), StoreError> {
    let sql = "SELECT d.decision, d.reason, d.decided_at FROM offers o LEFT JOIN decisions d ON d.fit = \
        o.fit WHERE o.fit = $1";
    let row: Option<(Option<String>, Option<String>, Option<i64>)> =
        query_as(sql).bind(fit).fetch_optional(&store.reader).await?;
    Ok(match row {
        None => (false, None),
        Some((Some(decision), Some(reason), Some(decided_at))) => (
            false,
            Some(DecisionRecord {
                decision: parse("a decision", &decision)?,
                reason,
                decided_at: instant(decided_at)?,
            }),
        ),
        Some(_) => (true, None),
    })
}
