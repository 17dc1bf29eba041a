//! Tokens: how they are made, and what the running service knows of them.
//!
//! Every request is judged from memory, which follows the database four times a second: a token that another
//! process has made or revoked counts within a moment. Where the database is gone, what was known last holds.

use crate::service::clock::now;
use crate::service::error::{Refusal, ServiceError};
use crate::store::reach::SystemScope;
use crate::store::tokens::{self, Revoked, Scope, TokenRecord};
use crate::store::{Store, StoreError};
use arc_swap::ArcSwap;
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::{Duration as Length, SystemPattern};
use lampyris_core::fault::Fault;
use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Who asks where there are no tokens, and whoever has the database file in hand.
pub const LOCAL: &str = "local";
/// Who acts where nobody has asked.
pub const SERVICE: &str = "service";
/// What every token begins with, so that one that leaked is recognised.
const PREFIX: &str = "lampyris_";
/// How often the database is read.
const INTERVAL: Duration = Duration::from_millis(250);
/// How many wrong tokens an address may send within [`MINUTE`].
const MOST_FAILURES: u32 = 10;
const MINUTE: Duration = Duration::from_secs(60);
/// Addresses that are remembered at a time.
const MOST_ADDRESSES: usize = 10_000;

/// What is asked of a new token.
#[derive(Debug, Clone)]
pub struct NewToken {
    /// Its name.
    pub name: String,
    /// What it is good for.
    pub scope: Scope,
    /// The systems that it is good for; all where none is named.
    pub systems: Vec<SystemPattern>,
    /// How long it is good.
    pub expires: Option<Length>,
}

/// A token that was just made.
#[derive(Debug)]
pub struct Made {
    /// What is kept of it.
    pub record: TokenRecord,
    /// Its text, which nobody can read anywhere from now on.
    pub secret: String,
}

/// What a request may do by what it shows.
#[derive(Debug, Clone, PartialEq)]
pub enum TokenCheck {
    /// There are no tokens: everything.
    Open,
    /// What this token may.
    Known(Arc<TokenRecord>),
    /// Nothing: no token was shown.
    Missing,
    /// Nothing: nobody knows the token.
    Unknown,
    /// Nothing: nobody knows the token, and so many wrong ones came from this address that it is not told any
    /// more.
    TooMany,
    /// Nothing: the token has expired, or was revoked.
    Ended(&'static str),
}

/// The tokens of a running service.
#[derive(Debug)]
pub struct Tokens {
    /// By hash: a look-up by something that nobody can choose tells nothing by the time that it takes.
    by_hash: ArcSwap<HashMap<[u8; 32], Arc<TokenRecord>>>,
    changed: watch::Sender<()>,
    /// Wrong tokens by address: since when, and how many.
    failures: Mutex<HashMap<IpAddr, (Instant, u32)>>,
    refused: AtomicU64,
}

impl Tokens {
    /// Reads the tokens.
    ///
    /// # Errors
    /// Where the database fails.
    pub async fn load(store: &Store) -> Result<Self, StoreError> {
        Ok(Self {
            by_hash: ArcSwap::from_pointee(read(store).await?),
            changed: watch::Sender::new(()),
            failures: Mutex::default(),
            refused: AtomicU64::new(0),
        })
    }

    /// Whether there are none, and never were: then everybody who can reach the service may do everything.
    pub fn is_open(&self) -> bool {
        self.by_hash.load().is_empty()
    }

    /// Requests that showed no token that is good.
    pub fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    /// Judges what a request shows. A token that is good is never refused for what others at its address have
    /// tried.
    pub fn judge(&self, secret: Option<&str>, peer: IpAddr) -> TokenCheck {
        let known = self.by_hash.load();
        if known.is_empty() {
            return TokenCheck::Open;
        }
        let found = secret.map(|secret| known.get(blake3::hash(secret.as_bytes()).as_bytes()));
        let judged = match found {
            None => TokenCheck::Missing,
            Some(Some(token)) => match ended(token, now()) {
                None => return TokenCheck::Known(token.clone()),
                Some(why) => TokenCheck::Ended(why),
            },
            Some(None) if self.has_failed_often(network(peer)) => TokenCheck::TooMany,
            Some(None) => TokenCheck::Unknown,
        };
        self.refused.fetch_add(1, Ordering::Relaxed);
        judged
    }

    /// Waits until a token is good no more.
    pub async fn end_of(&self, token: &TokenRecord) {
        let mut changed = self.changed.subscribe();
        loop {
            let standing = self.by_hash.load().get(&token.hash).cloned();
            if standing.is_none_or(|token| ended(&token, now()).is_some()) {
                return;
            }
            let left = token
                .expires_at
                .map_or(MINUTE, |end| Duration::try_from(end.duration_since(now())).unwrap_or_default());
            tokio::select! {
                _ = changed.changed() => {}
                // A little late rather than too early; a clock that jumps is seen within a minute.
                () = tokio::time::sleep(left.min(MINUTE) + Duration::from_millis(1)) => {}
            }
        }
    }

    /// Counts a wrong token, and says whether there were too many before.
    fn has_failed_often(&self, address: IpAddr) -> bool {
        // A panic while the lock was held can at most have lost a count.
        let mut failures = self.failures.lock().unwrap_or_else(PoisonError::into_inner);
        if failures.len() >= MOST_ADDRESSES && !failures.contains_key(&address) {
            failures.retain(|_, (since, _)| since.elapsed() < MINUTE);
            if failures.len() >= MOST_ADDRESSES {
                failures.clear();
            }
        }
        let (since, count) = failures.entry(address).or_insert_with(|| (Instant::now(), 0));
        if since.elapsed() >= MINUTE {
            (*since, *count) = (Instant::now(), 0);
        }
        *count = count.saturating_add(1);
        *count > MOST_FAILURES
    }
}

/// Follows the database until the service stops.
pub(crate) async fn follow(known: &Tokens, store: &Store, mut stopping: watch::Receiver<bool>) {
    let mut is_readable = true;
    loop {
        tokio::select! {
            () = tokio::time::sleep(INTERVAL) => {}
            _ = stopping.wait_for(|stopping| *stopping) => return,
        }
        match read(store).await {
            Ok(tokens) if tokens != **known.by_hash.load() => {
                known.by_hash.store(Arc::new(tokens));
                known.changed.send_replace(());
            }
            Ok(_) => is_readable = true,
            Err(error) if is_readable => {
                tracing::error!(%error, "the tokens cannot be read; those that were known last count");
                is_readable = false;
            }
            Err(_) => {}
        }
    }
}

/// Makes a token.
///
/// # Errors
/// Every fault of what is asked, a name that is taken, or where the system or the database fails.
pub async fn create(store: &Store, new: NewToken, who: &str) -> Result<Made, ServiceError> {
    let faults = faults(&new);
    if !faults.is_empty() {
        return Err(ServiceError::Faults(faults));
    }
    let mut random = [0; 32];
    getrandom::fill(&mut random)
        .map_err(|error| ServiceError::Internal(format!("the system gives no random numbers: {error}")))?;
    let digits: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
    let secret = format!("{PREFIX}{digits}");
    let created_at = now();
    let end = |length: Length| created_at.checked_add(SignedDuration::from_millis(length.millis()));
    let expires_at =
        new.expires.map(end).transpose().map_err(|error| ServiceError::Faults(vec![too_long(&error)]))?;
    let record = TokenRecord {
        name: new.name,
        hash: *blake3::hash(secret.as_bytes()).as_bytes(),
        scope: new.scope,
        reach: SystemScope::of(new.systems),
        created_at,
        expires_at,
        revoked_at: None,
    };
    if !tokens::insert(store, &record, who).await? {
        let detail = format!("there is, or was, a token `{}`: a name never means another token", record.name);
        return Err(Refusal::new("name-taken", detail).into());
    }
    Ok(Made { record, secret })
}

/// Revokes a token; a second time changes nothing.
///
/// # Errors
/// Where there is no such token, or the database fails.
pub(crate) async fn revoke(store: &Store, name: &str, who: &str) -> Result<(), ServiceError> {
    match tokens::revoke(store, name, who, now()).await? {
        Revoked::Done | Revoked::Already => Ok(()),
        Revoked::NotThere => Err(ServiceError::NotFound("token", name.to_owned())),
    }
}

/// Why a token is good no more: `expired` or `revoked`.
pub fn ended(token: &TokenRecord, now: Timestamp) -> Option<&'static str> {
    match (token.revoked_at, token.expires_at) {
        (Some(_), _) => Some("revoked"),
        (None, Some(end)) if end <= now => Some("expired"),
        _ => None,
    }
}

fn faults(new: &NewToken) -> Vec<Fault> {
    let mut faults = Vec::new();
    let is_name = !new.name.is_empty()
        && new.name.len() <= 64
        && new.name.bytes().all(|b| b.is_ascii_alphanumeric() || b"_-.".contains(&b));
    if !is_name || [LOCAL, SERVICE].contains(&new.name.as_str()) {
        let detail = format!(
            "a name has 1 to 64 letters, digits, `_`, `-` and `.`, and is neither `{LOCAL}` nor `{SERVICE}`"
        );
        faults.push(Fault::new("name", "invalid-name", detail));
    }
    if new.scope == Scope::Admin && !new.systems.is_empty() {
        let detail = "an administrator makes systems and models, and so sees all of them";
        faults.push(Fault::new("system", "contradiction", detail).suggest("scope operate"));
    }
    if new.expires.is_some_and(Length::is_zero) {
        faults.push(
            Fault::new("expires", "out-of-range", "a token is good for more than nothing")
                .suggest("such as P90D"),
        );
    }
    faults
}

fn too_long(error: &jiff::Error) -> Fault {
    Fault::new("expires", "out-of-range", format!("no calendar reaches so far: {error}"))
}

async fn read(store: &Store) -> Result<HashMap<[u8; 32], Arc<TokenRecord>>, StoreError> {
    Ok(tokens::all(store).await?.into_iter().map(|token| (token.hash, Arc::new(token))).collect())
}

/// The part of an address that its owner cannot change at will: one line has 2^64 addresses of version 6.
pub fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() & (u128::MAX << 64)).into(),
        address => address,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_of_version_6_is_one_address() {
        let network = |text: &str| network(text.parse().unwrap());
        assert_eq!(network("2001:db8::1"), network("2001:db8::ffff:1"));
        assert_ne!(network("2001:db8::1"), network("2001:db8:0:1::1"));
        assert_eq!(network("::ffff:192.0.2.7"), network("192.0.2.7"));
        assert_ne!(network("192.0.2.7"), network("192.0.2.8"));
    }
}
