//! Who may ask: tokens, of which only hashes are kept.

use super::audit::{Action, AuditEntry, note};
use super::database::Store;
use super::error::StoreError;
use super::reach::SystemScope;
use super::row::row;
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, from_json, instant, millis, parse};
use super::words::words;
use jiff::Timestamp;
use lampyris_core::data::SystemPattern;

words! {
    /// What a token is good for. Each scope includes those before it.
    Scope {
        /// Reading, and computations of which nothing is kept.
        Read = "read",
        /// Measurements, jobs, decisions, pins and schedules of its systems.
        Operate = "operate",
        /// Systems, models, effects and deletions.
        Admin = "admin",
    }
}

impl Scope {
    /// Whether it includes another one.
    pub const fn includes(self, other: Scope) -> bool {
        self as u8 >= other as u8
    }
}

/// A token as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct TokenRecord {
    /// Its name, which nobody else ever has.
    pub name: String,
    /// The hash of its text.
    pub hash: [u8; 32],
    /// What it is good for.
    pub scope: Scope,
    /// The systems that it is good for.
    pub reach: SystemScope,
    /// When it was made.
    pub created_at: Timestamp,
    /// When it ends by itself.
    pub expires_at: Option<Timestamp>,
    /// When it was revoked.
    pub revoked_at: Option<Timestamp>,
}

/// What became of a token that was to be revoked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Revoked {
    /// It is good for nothing any more.
    Done,
    /// It was revoked before.
    Already,
    /// There is no such token.
    NotThere,
}

row! {
    struct Row {
        name: String,
        hash: Vec<u8>,
        scope: String,
        systems: Option<String>,
        created_at: i64,
        expires_at: Option<i64>,
        revoked_at: Option<i64>,
    }
}

impl Row {
    fn record(self) -> Result<TokenRecord, StoreError> {
        let what = || format!("the token `{}`", self.name);
        let patterns =
            self.systems.as_deref().map(|text| from_json::<Vec<SystemPattern>>(&what(), text)).transpose()?;
        Ok(TokenRecord {
            hash: self.hash.as_slice().try_into().map_err(|error| corrupt(what(), &error))?,
            scope: parse("a scope", &self.scope)?,
            reach: SystemScope::of(patterns.unwrap_or_default()),
            created_at: instant(self.created_at)?,
            expires_at: self.expires_at.map(instant).transpose()?,
            revoked_at: self.revoked_at.map(instant).transpose()?,
            name: self.name,
        })
    }
}

/// Keeps a new token; says whether its name was free.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn insert(store: &Store, token: &TokenRecord, who: &str) -> Result<bool, StoreError> {
    let sql = "INSERT INTO tokens (name, hash, scope, systems, created_at, expires_at) VALUES ($1, $2, $3, \
        $4, $5, $6) \
        ON CONFLICT (name) DO NOTHING";
    let mut tx = store.write().await?;
    let done = query(sql)
        .bind(&token.name)
        .bind(token.hash.as_slice())
        .bind(token.scope.as_str())
        .bind(token.reach.sql()?)
        .bind(millis(token.created_at))
        .bind(token.expires_at.map(millis))
        .execute(&mut *tx)
        .await?;
    let is_free = done > 0;
    if is_free {
        let deed =
            AuditEntry { who, action: Action::CreateToken, system: None, subject: &token.name, reason: None };
        note(&mut tx, &deed, token.created_at).await?;
    }
    tx.commit().await?;
    Ok(is_free)
}

/// Revokes a token for good.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn revoke(
    store: &Store,
    name: &str,
    who: &str,
    now: Timestamp,
) -> Result<Revoked, StoreError> {
    let mut tx = store.write().await?;
    let known: Option<Option<i64>> = query_scalar("SELECT revoked_at FROM tokens WHERE name = $1")
        .bind(name)
        .fetch_optional(&mut *tx)
        .await?;
    match known {
        None => return Ok(Revoked::NotThere),
        Some(Some(_)) => return Ok(Revoked::Already),
        Some(None) => {}
    }
    query("UPDATE tokens SET revoked_at = $2 WHERE name = $1")
        .bind(name)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    note(
        &mut tx,
        &AuditEntry { who, action: Action::RevokeToken, system: None, subject: name, reason: None },
        now,
    )
    .await?;
    tx.commit().await?;
    Ok(Revoked::Done)
}

/// All tokens, also those that have ended, by name.
///
/// # Errors
/// Where the database fails.
pub async fn all(store: &Store) -> Result<Vec<TokenRecord>, StoreError> {
    let rows: Vec<Row> = query_as("SELECT * FROM tokens ORDER BY name").fetch_all(&store.reader).await?;
    store.require_files()?;
    rows.into_iter().map(Row::record).collect()
}
