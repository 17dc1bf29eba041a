//! What is served, all from one moment: the current revision, why it is not newer, what is said of it, and
//! the states.

use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::job::JobStatus;
use super::row::row;
use super::statement::{query, query_as};
use super::value::{from_json, instant, millis, parse, to_json};
use super::words::words;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::assess::degradation::Degradation;
use lampyris_core::estimate::assess::metrics::CurrentState;

words! {
    /// Why the previous revision is served although there was a newer attempt.
    FallbackReason {
        /// The gate refused the newest fit.
        ValidationFailed = "validation_failed",
        /// The newest job came to no result.
        JobFailed = "job_failed",
    }
}

/// What is known about the parameters of a system, all from one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct ServedState {
    /// The system.
    pub system: SystemId,
    /// The model whose fits count.
    pub model: String,
    /// The system's document, JSON.
    pub document: String,
    /// What is served.
    pub revision: Option<RevisionRecord>,
    /// Why it is not newer.
    pub fallback: Option<FallbackRecord>,
    /// Whether newer measurements contradict it.
    pub degradation: Option<DegradationRecord>,
    /// Whether an operator holds it.
    pub pin: Option<PinRecord>,
    /// The newest job of any kind.
    pub latest_job: Option<(String, JobStatus)>,
    /// The states at the newest sample that was looked at, JSON, and the revision by whose parameters they
    /// were found.
    pub state: Option<(i64, String)>,
}

/// A revision.
#[derive(Debug, Clone, PartialEq)]
pub struct RevisionRecord {
    /// Its number.
    pub revision: i64,
    /// The fit that it came from.
    pub fit: String,
    /// The job that found it.
    pub job: String,
    /// The parameters, as the gate let them out.
    pub served: serde_json::Value,
    /// First instant of the measurements, RFC 3339.
    pub window_from: String,
    /// Last instant.
    pub window_to: String,
    /// The newest measurement on which a gate has found it fit to be served.
    pub measured_to: Timestamp,
    /// When it was found.
    pub fitted_at: Timestamp,
    /// When a gate last found it fit to be served.
    pub validated_at: Timestamp,
}

/// Why a system is in fallback.
#[derive(Debug, Clone, PartialEq)]
pub struct FallbackRecord {
    /// The reason.
    pub reason: FallbackReason,
    /// The job behind it.
    pub job: String,
    /// The fit that was refused.
    pub fit: Option<String>,
    /// What it failed.
    pub failed_checks: Vec<String>,
    /// Since when no attempt has succeeded.
    pub since: Timestamp,
}

/// A degradation as it is kept: the numbers of the moment at which it was noticed.
#[derive(Debug, Clone, PartialEq)]
pub struct DegradationRecord {
    /// What was found.
    pub degradation: Degradation,
    /// When.
    pub since: Timestamp,
}

impl DegradationRecord {
    fn read(description: &str, since: i64) -> Result<Self, StoreError> {
        Ok(Self { degradation: from_json("a degradation", description)?, since: instant(since)? })
    }
}

/// An operator's pin.
#[derive(Debug, Clone, PartialEq)]
pub struct PinRecord {
    /// Why.
    pub reason: String,
    /// Since when.
    pub since: Timestamp,
}

row! {
    struct Row {
        system: String,
        model: String,
        document: String,
        revision: Option<i64>,
        fit: Option<String>,
        job: Option<String>,
        served: Option<String>,
        served_hash: Option<String>,
        window_from: Option<String>,
        window_to: Option<String>,
        measured_to: Option<String>,
        fitted_at: Option<i64>,
        validated_at: Option<i64>,
        reason: Option<String>,
        failed_job: Option<String>,
        refused_fit: Option<String>,
        failed_checks: Option<String>,
        since_at: Option<i64>,
        degradation: Option<String>,
        degraded_at: Option<i64>,
        pin_reason: Option<String>,
        pinned_at: Option<i64>,
        latest_job: Option<String>,
        latest_state: Option<String>,
        state_revision: Option<i64>,
        state: Option<String>,
    }
}

/// Everything about the parameters of the systems that a condition selects.
macro_rules! standing {
    ($which:literal) => {
        concat!(
            "SELECT s.system, s.model, s.document, \
    r.revision, r.fit, r.job, r.served, r.served_hash, r.window_from, r.window_to, \
    COALESCE(r.measured_to, r.window_to) AS measured_to, r.fitted_at, r.validated_at, \
    f.reason, f.job AS failed_job, f.fit AS refused_fit, f.failed_checks, f.since_at, \
    d.description AS degradation, d.since_at AS degraded_at, p.reason AS pin_reason, p.since_at AS \
    pinned_at, \
    j.id AS latest_job, j.state AS latest_state, n.revision AS state_revision, n.document AS state \
    FROM systems s \
    LEFT JOIN revisions r ON r.system = s.system AND r.current \
    LEFT JOIN fallbacks f ON f.system = s.system \
    LEFT JOIN degradations d ON d.system = s.system AND d.revision = r.revision \
    LEFT JOIN pins p ON p.system = s.system \
    LEFT JOIN states n ON n.system = s.system \
    LEFT JOIN jobs j ON j.sequence = (SELECT MAX(sequence) FROM jobs WHERE jobs.system = s.system) ",
            $which
        )
    };
}

impl Row {
    fn standing(self) -> Result<ServedState, StoreError> {
        // A flipped bit inside of a number is no contradiction to SQLite; to a controller it would be a wrong
        // parameter.
        let hash = self.served.as_ref().map(|served| blake3::hash(served.as_bytes()).to_hex().to_string());
        if hash != self.served_hash {
            return Err(StoreError::Damaged(format!(
                "the parameters of {} are not those that were published",
                self.system
            )));
        }
        let window = self.window_from.zip(self.window_to).zip(self.measured_to);
        let times = self.fitted_at.zip(self.validated_at);
        let revision = match (self.revision, self.fit, self.job, self.served, window, times) {
            (
                Some(revision),
                Some(fit),
                Some(job),
                Some(served),
                Some(((window_from, window_to), measured_to)),
                Some((fitted_at, validated_at)),
            ) => Some(RevisionRecord {
                revision,
                fit,
                job,
                served: from_json("a revision", &served)?,
                window_from,
                window_to,
                measured_to: parse("an instant", &measured_to)?,
                fitted_at: instant(fitted_at)?,
                validated_at: instant(validated_at)?,
            }),
            _ => None,
        };
        let fallback = match (self.reason, self.failed_job, self.failed_checks, self.since_at) {
            (Some(reason), Some(job), Some(failed_checks), Some(since_at)) => Some(FallbackRecord {
                reason: parse("a reason", &reason)?,
                job,
                fit: self.refused_fit,
                failed_checks: from_json("failed checks", &failed_checks)?,
                since: instant(since_at)?,
            }),
            _ => None,
        };
        let degradation = self.degradation.zip(self.degraded_at);
        let pin = self.pin_reason.zip(self.pinned_at);
        let latest_job = match (self.latest_job, self.latest_state) {
            (Some(id), Some(state)) => Some((id, parse("a state", &state)?)),
            _ => None,
        };
        Ok(ServedState {
            system: parse("a system", &self.system)?,
            model: self.model,
            document: self.document,
            revision,
            fallback,
            degradation: degradation.map(|(text, at)| DegradationRecord::read(&text, at)).transpose()?,
            pin: pin
                .map(|(reason, at)| Ok::<_, StoreError>(PinRecord { reason, since: instant(at)? }))
                .transpose()?,
            latest_job,
            state: self.state_revision.zip(self.state),
        })
    }
}

/// What is known about the parameters of one system.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn standing(store: &Store, system: &SystemId) -> Result<Option<ServedState>, StoreError> {
    Ok(standings(store, &[system]).await?.pop())
}

/// What is known about the parameters of some systems, of those that are there.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn standings(store: &Store, systems: &[&SystemId]) -> Result<Vec<ServedState>, StoreError> {
    let sql = standing!("WHERE s.system IN (SELECT value FROM json_each($1))");
    let rows: Vec<Row> = query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    store.require_files()?;
    rows.into_iter().map(Row::standing).collect()
}

/// What is known about the parameters of the first systems after a name, in order.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn standings_after(
    store: &Store,
    system: &str,
    limit: i64,
) -> Result<Vec<ServedState>, StoreError> {
    let sql = standing!("WHERE s.system > $1 ORDER BY s.system LIMIT $2");
    let rows: Vec<Row> = query_as(sql).bind(system).bind(limit).fetch_all(&store.reader).await?;
    store.require_files()?;
    rows.into_iter().map(Row::standing).collect()
}

/// Notes why the newest attempt changed nothing. `since` stays that of the first attempt in a row.
pub(super) async fn fall_back(
    tx: &mut Session,
    system: &str,
    job: &str,
    refused: Option<(&str, &[&str])>,
    now: Timestamp,
) -> Result<(), StoreError> {
    let (reason, fit, checks) = match refused {
        Some((fit, checks)) => (FallbackReason::ValidationFailed, Some(fit), checks),
        None => (FallbackReason::JobFailed, None, &[] as &[&str]),
    };
    let sql = "INSERT INTO fallbacks (system, reason, job, fit, failed_checks, since_at) VALUES ($1, $2, $3, $4, \
        $5, $6) \
        ON CONFLICT (system) DO UPDATE SET \
        reason = excluded.reason, job = excluded.job, fit = excluded.fit, failed_checks = \
        excluded.failed_checks";
    query(sql)
        .bind(system)
        .bind(reason.as_str())
        .bind(job)
        .bind(fit)
        .bind(to_json("failed checks", checks)?)
        .bind(millis(now))
        .execute(tx)
        .await?;
    Ok(())
}

/// Keeps the states of the revision in service; a system without one has none.
pub(super) async fn keep_state(
    tx: &mut Session,
    system: &str,
    state: &CurrentState,
) -> Result<(), StoreError> {
    let sql = "INSERT INTO states (system, revision, document)
               SELECT system, revision, $2 FROM revisions WHERE system = $1 AND current
               ON CONFLICT (system) DO UPDATE SET revision = excluded.revision, document = excluded.document";
    query(sql).bind(system).bind(to_json("a state", state)?).execute(tx).await?;
    Ok(())
}

/// Keeps newer states of a revision, if it is in service still.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn keep_newer_state(
    store: &Store,
    system: &SystemId,
    revision: i64,
    state: &CurrentState,
) -> Result<(), StoreError> {
    let mut tx = store.write().await?;
    let sql = "UPDATE states SET document = $3 WHERE system = $1 AND revision = $2";
    query(sql)
        .bind(system.to_string())
        .bind(revision)
        .bind(to_json("a state", state)?)
        .execute(&mut *tx)
        .await?;
    tx.commit().await
}

#[cfg(test)]
mod tests {
    use crate::store::changes::NOTES;

    #[test]
    fn whatever_is_read_is_noted_when_it_changes() {
        let tables = standing!("").split("JOIN ").flat_map(|part| part.split("FROM ")).skip(1);
        let tables: Vec<&str> = tables.filter_map(|part| part.split_whitespace().next()).collect();
        assert!(tables.contains(&"systems") && tables.contains(&"pins"), "{tables:?}");
        let schema = include_str!("../../../../migrations/postgres/0001_initial.sql");
        let on_postgres: Vec<String> = schema
            .split("CREATE TRIGGER ")
            .filter_map(|trigger| trigger.split(" FOR EACH ROW").next())
            .map(|head| head.split_whitespace().collect::<Vec<_>>().join(" "))
            .filter(|head| head.contains(" AFTER "))
            .collect();
        for table in tables {
            assert!(NOTES.contains(&format!(" ON main.{table}\n")), "{table}");
            let notes = on_postgres.iter().any(|trigger| trigger.ends_with(&format!(" ON {table}")));
            assert!(notes, "{table} on PostgreSQL");
        }
    }
}
