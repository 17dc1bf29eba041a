//! The end of a job: job, fit, verdict and revision in one transaction, or none of them.
//!
//! It publishes where it has an [`Acceptance`](lampyris_core::estimate::Acceptance), the policy is automatic
//! and no pin is set; what passes otherwise becomes an offer to the operator.

use super::database::Store;
use super::diagnoses::{self, Report};
use super::engine::Session;
use super::error::StoreError;
use super::fits::PackedFit;
use super::job::{JobFailure, Outcome};
use super::job_record::Lease;
use super::revisions::{self, Cause, NewRevision};
use super::row::row;
use super::sequence::id_of;
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, from_json, millis, to_json, word};
use super::{decisions, failpoint, params, systems};
use jiff::Timestamp;
use lampyris_core::estimate::assess::metrics::CurrentState;
use lampyris_core::estimate::problem::method::SeededMethod;
use lampyris_core::estimate::tune::Tuning;
use lampyris_core::estimate::{Fit, Judgement, Offer, ServedParameters, Verdict};
use serde::Deserialize;

/// How a job ended.
#[derive(Debug)]
pub enum JobEnd<'a> {
    /// With a fit, whatever the gate says of it.
    Fitted(&'a JudgedFit),
    /// With settings of the search.
    Tuned(&'a Tuned),
    /// Without one.
    Failed(&'a JobFailure),
    /// Somebody called it off.
    Cancelled,
}

/// A fit with its judgement.
#[derive(Debug)]
pub struct JudgedFit {
    /// What was found.
    pub fit: Fit,
    /// The fit and what the gate looked at, as their row has them.
    pub packed: PackedFit,
    /// The uploaded windows that it cites.
    pub windows: Vec<String>,
    /// What the gate says.
    pub judgement: Judgement,
    /// Whether the policy of the system lets an accepted fit be served without an operator.
    pub automatic: bool,
    /// The states at the newest sample by this fit.
    pub state: Option<CurrentState>,
    /// The states at the newest sample by the parameters that are served now.
    pub incumbent_state: Option<CurrentState>,
    /// What the fit was asked for, where not for itself.
    pub report: Option<Report>,
}

/// Settings of the search, and what may be done with them.
#[derive(Debug)]
pub struct Tuned {
    /// What was found.
    pub tuning: Tuning,
    /// Whether the policy of the system lets better settings be taken without an operator.
    pub automatic: bool,
}

/// What the end of a job led to.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Finished {
    /// The outcome, if it succeeded.
    pub outcome: Option<Outcome>,
    /// The id of the fit.
    pub fit: Option<String>,
    /// The revision that was published.
    pub revision: Option<i64>,
    /// The id of the diagnosis.
    pub diagnosis: Option<String>,
    /// Whether it was called off before, so that nothing of what it came to is kept.
    pub cancelled: bool,
}

row! {
    /// The job as the transaction needs it.
    struct Leased {
        system: String,
        experiment: bool,
        own_model: bool,
        pinned: bool,
        cancelling: bool,
    }
}

/// Ends a job, if the lease still holds. A job that was called off ends so, whatever it came to meanwhile.
///
/// # Errors
/// [`StoreError::LeaseLost`] where somebody else has the job by now; otherwise where the database fails.
pub async fn finish(
    store: &Store,
    lease: &Lease,
    ending: &JobEnd<'_>,
    now: Timestamp,
) -> Result<Finished, StoreError> {
    failpoint::reached("before_finish");
    let document = match ending {
        JobEnd::Fitted(finding) => finding.report.as_ref().map(Report::document).transpose()?,
        _ => None,
    };
    // Whoever may take the job away, or touches what is said of its system, writes alone.
    let mut tx = store.write_beside().await?;
    let sql = "SELECT j.system, j.experiment, j.model = s.model AS own_model,
                   EXISTS (SELECT 1 FROM pins p WHERE p.system = j.system) AS pinned, j.cancelling
               FROM jobs j JOIN systems s ON s.system = j.system
               WHERE j.id = $1 AND j.state = 'running' AND j.boot = $2 AND j.attempt = $3
               AND EXISTS (SELECT 1 FROM workers w WHERE w.worker = $2)";
    let leased: Option<Leased> =
        query_as(sql).bind(&lease.job).bind(lease.boot).bind(lease.attempt).fetch_optional(&mut *tx).await?;
    let Some(leased) = leased else {
        return Err(StoreError::LeaseLost);
    };
    // An experiment, or a fit of another model than the system's, never alters what is served nor its status.
    let counts = leased.own_model && !leased.experiment;
    // Whoever called it off was told so by a transaction before this one.
    let ending = if leased.cancelling { &JobEnd::Cancelled } else { ending };
    let finished = match ending {
        JobEnd::Fitted(finding) => {
            let mut finished = keep_fit(&mut tx, (lease, &leased), finding, counts, now).await?;
            if let (Some(report), Some(document), Some(fit)) = (&finding.report, &document, &finished.fit) {
                finished.diagnosis = diagnoses::keep(
                    &mut tx,
                    lease,
                    &leased.system,
                    (fit, &finding.fit.model_hash),
                    (report, document),
                    now,
                )
                .await?;
                // The fit was a means: what the gate says of it is in its document, and no outcome of the
                // job.
                finished.outcome = None;
            }
            query(
                "UPDATE jobs SET state = 'succeeded', boot = NULL, outcome = $2, fit = $3, revision = $4, \
                stopped_by = $5, evaluations = $6, \
                ended_at = $7, diagnosis = $8 WHERE id = $1",
            )
            .bind(&lease.job)
            .bind(finished.outcome.map(Outcome::as_str))
            .bind(&finished.fit)
            .bind(finished.revision)
            .bind(word(&finding.fit.stopped_by)?)
            .bind(i64::try_from(finding.fit.evaluations).unwrap_or(i64::MAX))
            .bind(millis(now))
            .bind(&finished.diagnosis)
            .execute(&mut *tx)
            .await?;
            finished
        }
        JobEnd::Tuned(tuned) => keep_tuning(&mut tx, lease, &leased, tuned, now).await?,
        JobEnd::Failed(failure) => {
            query("UPDATE jobs SET state = 'failed', boot = NULL, error = $2, ended_at = $3 WHERE id = $1")
                .bind(&lease.job)
                .bind(to_json("a failure", failure)?)
                .bind(millis(now))
                .execute(&mut *tx)
                .await?;
            if counts {
                params::fall_back(&mut tx, &leased.system, &lease.job, None, now).await?;
            }
            Finished::default()
        }
        JobEnd::Cancelled => {
            query("UPDATE jobs SET state = 'cancelled', boot = NULL, ended_at = $2 WHERE id = $1")
                .bind(&lease.job)
                .bind(millis(now))
                .execute(&mut *tx)
                .await?;
            Finished { cancelled: true, ..Finished::default() }
        }
    };
    failpoint::reached("before_commit");
    tx.commit().await?;
    failpoint::reached("after_commit");
    Ok(finished)
}

/// Keeps what a tuning found; better settings become those of the system where its policy says so and the
/// model is its own.
async fn keep_tuning(
    tx: &mut Session,
    lease: &Lease,
    leased: &Leased,
    Tuned { tuning, automatic }: &Tuned,
    now: Timestamp,
) -> Result<Finished, StoreError> {
    // Better than what the job was asked to compare with is not better than what an operator has set
    // meanwhile.
    let sql = "SELECT document FROM systems WHERE system = $1";
    let document: String = query_scalar(sql).bind(&leased.system).fetch_one(&mut *tx).await?;
    let mut document: serde_json::Value = from_json("a system", &document)?;
    let set = match document.get("method").filter(|method| !method.is_null()) {
        Some(method) => SeededMethod::deserialize(method).map_err(|error| corrupt("a method", &error))?,
        None => SeededMethod::default(),
    };
    let compared = set.method == tuning.before.method;
    let outcome = match (tuning.better, *automatic && leased.own_model && compared) {
        (true, true) => Outcome::Accepted,
        (true, false) => Outcome::Suggested,
        (false, _) => Outcome::Unchanged,
    };
    if outcome == Outcome::Accepted {
        document["method"] =
            serde_json::to_value(&tuning.tuned).map_err(|error| corrupt("a method", &error))?;
        let document = to_json("a system", &document)?;
        systems::take_method(tx, &leased.system, &document, (&lease.job, &tuning.summary), now).await?;
    }
    query(
        "UPDATE jobs SET state = 'succeeded', boot = NULL, outcome = $2, tuning = $3, evaluations = $4, \
        ended_at = $5 WHERE id = $1",
    )
    .bind(&lease.job)
    .bind(outcome.as_str())
    .bind(to_json("a tuning", tuning)?)
    .bind(i64::try_from(tuning.evaluations).unwrap_or(i64::MAX))
    .bind(millis(now))
    .execute(tx)
    .await?;
    Ok(Finished { outcome: Some(outcome), ..Finished::default() })
}

/// Keeps a fit with its verdict, and draws the consequences for what is served.
async fn keep_fit(
    tx: &mut Session,
    (lease, leased): (&Lease, &Leased),
    finding: &JudgedFit,
    counts: bool,
    now: Timestamp,
) -> Result<Finished, StoreError> {
    let JudgedFit { fit, judgement, packed, .. } = finding;
    let system = leased.system.as_str();
    let id = id_of("fit", &format!("{} {}", lease.job, lease.attempt));
    let in_trend = !leased.experiment && finding.report.is_none();
    let sql = "INSERT INTO fits (id, job, system, model, document, replay, verdict, checks, summary, \
        created_at, listed, validation_rmse) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12)";
    query(sql)
        .bind(&id)
        .bind(&lease.job)
        .bind(system)
        .bind(&fit.model)
        .bind(&packed.document)
        .bind(&packed.replay)
        .bind(judgement.verdict.as_str())
        .bind(&packed.checks)
        .bind(&judgement.summary)
        .bind(millis(now))
        .bind(&packed.listed.listed)
        .bind(packed.listed.validation_rmse.filter(|_| in_trend))
        .execute(&mut *tx)
        .await?;
    // Windows that a running job may read cannot be deleted; should one be gone nevertheless, the fit still
    // counts.
    query(
        "INSERT INTO fit_windows (fit, window_id) SELECT $1, id FROM windows WHERE id IN (SELECT value \
        FROM json_each($2))",
    )
    .bind(&id)
    .bind(to_json("cited windows", &finding.windows)?)
    .execute(&mut *tx)
    .await?;
    let mut finished = Finished { fit: Some(id.clone()), ..Finished::default() };
    finished.outcome = Some(match &judgement.verdict {
        Verdict::Accepted(acceptance) if counts && finding.automatic && !leased.pinned => {
            let served = to_json("served parameters", &ServedParameters::new(acceptance, fit))?;
            let new = NewRevision {
                system,
                fit: &id,
                job: &lease.job,
                served: &served,
                model_hash: &fit.model_hash,
                window: fit.window(),
                measured_to: None,
                fitted_at: millis(now),
                validated_at: millis(now),
                cause: Cause::Accepted,
                reason: None,
            };
            finished.revision = Some(revisions::publish(tx, &new, now).await?);
            Outcome::Accepted
        }
        Verdict::Accepted(acceptance) if counts => {
            decisions::offer(tx, &id, &Offer::of_accepted(acceptance, fit), finding.state.as_ref()).await?;
            Outcome::Suggested
        }
        Verdict::Accepted(_) => Outcome::Accepted,
        Verdict::Unchanged => {
            if counts {
                revisions::confirm(tx, system, fit.window().1, now).await?;
            }
            Outcome::Unchanged
        }
        Verdict::Held(holding) => {
            if counts {
                decisions::offer(tx, &id, &Offer::of_held(holding, fit), finding.state.as_ref()).await?;
            }
            Outcome::Held
        }
        Verdict::Rejected => {
            if counts {
                params::fall_back(tx, system, &lease.job, Some((&id, &judgement.failed())), now).await?;
            }
            Outcome::Rejected
        }
    });
    let state = if finished.revision.is_some() { &finding.state } else { &finding.incumbent_state };
    if let (true, Some(state)) = (counts, state) {
        params::keep_state(tx, system, state).await?;
    }
    Ok(finished)
}
