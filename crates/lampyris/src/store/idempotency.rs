//! Keys of requests that created something. The key is written in the transaction that creates the thing, so
//! neither can survive a crash without the other.

use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::statement::{query, query_as};
use super::value::millis;
use jiff::{SignedDuration, Timestamp};

/// How long a key is remembered. Clients are promised a day.
const KEPT: SignedDuration = SignedDuration::from_hours(48);

/// The key that a client chose for a request, and the hash of what it asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestKey {
    /// The client's `Idempotency-Key`.
    pub key: String,
    /// Hash of method, path and body.
    pub fingerprint: String,
}

/// What an earlier request with the same key created.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Earlier {
    /// Id of the thing.
    pub resource: String,
    /// Status that was answered.
    pub status: u16,
}

/// The same key came with another request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeyReused;

/// What a key says before anything is created.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KeyState {
    /// Nobody has used it, or there is none.
    Fresh,
    /// The same request came before.
    Seen(Earlier),
    /// Another request came before.
    Reused,
}

/// Looks a key up inside the transaction that may create something.
pub(super) async fn look_up(tx: &mut Session, key: Option<&RequestKey>) -> Result<KeyState, StoreError> {
    let Some(key) = key else {
        return Ok(KeyState::Fresh);
    };
    let row: Option<(String, String, i64)> =
        query_as("SELECT fingerprint, resource, status FROM idempotency WHERE key = $1")
            .bind(&key.key)
            .fetch_optional(tx)
            .await?;
    Ok(match row {
        None => KeyState::Fresh,
        Some((fingerprint, _, _)) if fingerprint != key.fingerprint => KeyState::Reused,
        Some((_, resource, status)) => {
            KeyState::Seen(Earlier { resource, status: u16::try_from(status).unwrap_or(200) })
        }
    })
}

/// Remembers what a request created.
pub(super) async fn remember(
    tx: &mut Session,
    key: Option<&RequestKey>,
    resource: &str,
    status: u16,
    now: Timestamp,
) -> Result<(), StoreError> {
    let Some(key) = key else { return Ok(()) };
    query(
        "INSERT INTO idempotency (key, fingerprint, resource, status, created_at) VALUES ($1, $2, \
        $3, $4, $5)",
    )
    .bind(&key.key)
    .bind(&key.fingerprint)
    .bind(resource)
    .bind(i64::from(status))
    .bind(millis(now))
    .execute(tx)
    .await?;
    Ok(())
}

/// Forgets keys that are too old to come again.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn forget_old(store: &Store, now: Timestamp) -> Result<u64, StoreError> {
    let before = now.saturating_sub(KEPT).map_or(0, millis);
    let mut tx = store.write().await?;
    let gone = query("DELETE FROM idempotency WHERE created_at < $1").bind(before).execute(&mut *tx).await?;
    tx.commit().await?;
    Ok(gone)
}
