//! What was ever served: revisions count up by one and never go back, and exactly one of a system is current.

use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::fits::{self, FitRecord};
use super::row::row;
use super::statement::{query, query_as, query_scalar};
use super::value::{from_json, instant, millis, parse};
use super::words::words;
use jiff::Timestamp;
use lampyris_core::data::SystemId;

words! {
    /// How a revision came to be served.
    Cause {
        /// The gate accepted its fit.
        Accepted = "accepted",
        /// An operator promoted a held or suggested fit.
        Promoted = "promoted",
        /// An operator pinned it.
        Pinned = "pinned",
    }
}

/// A revision to be made.
#[derive(Debug)]
pub(super) struct NewRevision<'a> {
    pub system: &'a str,
    pub fit: &'a str,
    pub job: &'a str,
    /// The parameters as the gate or an operator let them out, JSON.
    pub served: &'a str,
    pub model_hash: &'a str,
    pub window: (&'a str, &'a str),
    /// The newest measurement on which a gate has found it fit to be served, where that is not the end of the
    /// window.
    pub measured_to: Option<&'a str>,
    pub fitted_at: i64,
    pub validated_at: i64,
    pub cause: Cause,
    pub reason: Option<&'a str>,
}

/// A revision with the fit behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct Revision {
    /// Its number.
    pub revision: i64,
    /// Whether it is served now.
    pub current: bool,
    /// How it came to be served.
    pub cause: Cause,
    /// The operator's reason, where there was one.
    pub reason: Option<String>,
    /// The fit behind it.
    pub fit: String,
    /// The job that found the fit.
    pub job: String,
    /// The gate's verdict on the fit.
    pub verdict: String,
    /// The verdict in a sentence.
    pub summary: String,
    /// The parameters, as they were let out.
    pub served: serde_json::Value,
    /// First instant of the measurements, RFC 3339.
    pub window_from: String,
    /// Last instant.
    pub window_to: String,
    /// When the fit was found.
    pub fitted_at: Timestamp,
    /// When a gate last found it fit to be served.
    pub validated_at: Timestamp,
    /// When it was published.
    pub published_at: Timestamp,
}

row! {
    struct Row {
        revision: i64,
        current: bool,
        cause: String,
        reason: Option<String>,
        fit: String,
        job: String,
        verdict: String,
        summary: String,
        served: String,
        window_from: String,
        window_to: String,
        fitted_at: i64,
        validated_at: i64,
        published_at: Option<i64>,
    }
}

impl Row {
    fn record(self) -> Result<Revision, StoreError> {
        Ok(Revision {
            revision: self.revision,
            current: self.current,
            cause: parse("a cause", &self.cause)?,
            reason: self.reason,
            fit: self.fit,
            job: self.job,
            verdict: self.verdict,
            summary: self.summary,
            served: from_json("a revision", &self.served)?,
            window_from: self.window_from,
            window_to: self.window_to,
            fitted_at: instant(self.fitted_at)?,
            validated_at: instant(self.validated_at)?,
            published_at: instant(self.published_at.unwrap_or(self.fitted_at))?,
        })
    }
}

/// The newest revision that a system of this name ever had, 0 without any.
async fn newest(tx: &mut Session, system: &str) -> Result<i64, StoreError> {
    let sql = "SELECT MAX(COALESCE((SELECT MAX(revision) FROM revisions WHERE system = $1), 0), \
        COALESCE((SELECT revision FROM retired WHERE system = $1), 0))";
    Ok(query_scalar(sql).bind(system).fetch_one(tx).await?)
}

/// Remembers the newest revision of a system that is about to be deleted: a controller that has seen it takes
/// nothing older for news, also from another system of the same name.
pub(super) async fn retire(tx: &mut Session, system: &str) -> Result<(), StoreError> {
    let newest = newest(tx, system).await?;
    if newest > 0 {
        query("INSERT INTO retired (system, revision) VALUES ($1, $2) ON CONFLICT (system) DO UPDATE SET revision = \
            excluded.revision")
            .bind(system)
            .bind(newest)
            .execute(tx)
            .await?;
    }
    Ok(())
}

/// Makes a set of parameters the one that is served, under the next number. What was said of the revision
/// before it, a fallback or a degradation, does not hold for it.
pub(super) async fn publish(
    tx: &mut Session,
    new: &NewRevision<'_>,
    now: Timestamp,
) -> Result<i64, StoreError> {
    let revision = newest(tx, new.system).await? + 1;
    for sql in [
        "UPDATE revisions SET current = FALSE WHERE system = $1 AND current",
        "DELETE FROM fallbacks WHERE system = $1",
        "DELETE FROM degradations WHERE system = $1",
        "DELETE FROM states WHERE system = $1",
    ] {
        query(sql).bind(new.system).execute(&mut *tx).await?;
    }
    let sql = "INSERT INTO revisions (system, revision, fit, job, served, served_hash, model_hash, \
        window_from, window_to, current, \
        fitted_at, validated_at, published_at, cause, reason, measured_to) \
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, TRUE, $10, $11, $12, $13, $14, $15)";
    query(sql)
        .bind(new.system)
        .bind(revision)
        .bind(new.fit)
        .bind(new.job)
        .bind(new.served)
        .bind(blake3::hash(new.served.as_bytes()).to_hex().to_string())
        .bind(new.model_hash)
        .bind(new.window.0)
        .bind(new.window.1)
        .bind(new.fitted_at)
        .bind(new.validated_at)
        .bind(millis(now))
        .bind(new.cause.as_str())
        .bind(new.reason)
        .bind(new.measured_to)
        .execute(tx)
        .await?;
    Ok(revision)
}

/// Notes that the revision in service has held its ground against a new fit on measurements up to an instant,
/// and ends a fallback.
pub(super) async fn confirm(
    tx: &mut Session,
    system: &str,
    measured_to: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    // Instants of one form are in the order of their texts; a fit of older measurements makes none younger.
    let sql = "UPDATE revisions SET validated_at = $2, measured_to = MAX(COALESCE(measured_to, window_to), \
        $3) WHERE system = $1 AND current";
    query(sql).bind(system).bind(millis(now)).bind(measured_to).execute(&mut *tx).await?;
    query("DELETE FROM fallbacks WHERE system = $1").bind(system).execute(tx).await?;
    Ok(())
}

/// Fits of a system that were trusted at another time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trusted {
    /// The one that was served at an instant, where no operator has confirmed another one since.
    pub served_then: Option<FitRecord>,
    /// The last one that an operator confirmed.
    pub confirmed: Option<FitRecord>,
}

/// The fits that a new one is compared with beside the one that is served now. An operator's word makes an
/// older fit a thing of the past: whoever has promoted what is far away does not want to hear of it for a
/// month.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn trusted(
    store: &Store,
    system: &SystemId,
    then: Timestamp,
) -> Result<Trusted, StoreError> {
    let sql = "SELECT (SELECT MAX(revision) FROM revisions WHERE system = $1 AND COALESCE(published_at, \
        fitted_at) <= $2), \
        (SELECT MAX(revision) FROM revisions WHERE system = $1 AND cause IN ('promoted', 'pinned'))";
    let (then, confirmed): (Option<i64>, Option<i64>) =
        query_as(sql).bind(system.to_string()).bind(millis(then)).fetch_one(&store.reader).await?;
    let then = then.filter(|revision| confirmed.is_none_or(|confirmed| *revision > confirmed));
    Ok(Trusted {
        served_then: fit(store, system, then).await?,
        confirmed: fit(store, system, confirmed).await?,
    })
}

/// The fit behind a revision.
async fn fit(
    store: &Store,
    system: &SystemId,
    revision: Option<i64>,
) -> Result<Option<FitRecord>, StoreError> {
    let sql = "SELECT fit FROM revisions WHERE system = $1 AND revision = $2";
    let id: Option<String> =
        query_scalar(sql).bind(system.to_string()).bind(revision).fetch_optional(&store.reader).await?;
    match id {
        Some(id) => fits::get(store, &id).await,
        None => Ok(None),
    }
}

/// Revisions of a system below a number, newest first: one page of its history.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
    store: &Store,
    system: &SystemId,
    before: i64,
    limit: i64,
) -> Result<Vec<Revision>, StoreError> {
    let sql = "SELECT r.revision, r.current, r.cause, r.reason, r.fit, r.job, f.verdict, f.summary, \
        r.served, r.window_from, r.window_to, \
        r.fitted_at, r.validated_at, r.published_at \
        FROM revisions r JOIN fits f ON f.id = r.fit WHERE r.system = $1 AND r.revision < $2 ORDER BY \
        r.revision DESC LIMIT $3";
    let rows: Vec<Row> =
        query_as(sql).bind(system.to_string()).bind(before).bind(limit).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}
