//! A job as it is kept: what every job has, and what its state implies.

use super::error::StoreError;
use super::job::{JobFailure, JobKind, JobStatus, Origin, Outcome, Priority};
use super::row::row;
use super::value::{corrupt, from_json, instant, parse};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::model::ModelId;

/// A job as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRecord {
    /// Its id.
    pub id: String,
    /// The order of submission.
    pub sequence: i64,
    /// What it does.
    pub kind: JobKind,
    /// To which system.
    pub system: SystemId,
    /// With which model.
    pub model: ModelId,
    /// The request with all defaults filled in.
    pub request: serde_json::Value,
    /// Whether it never alters what is served.
    pub experiment: bool,
    /// Who asked.
    pub origin: Origin,
    /// Who goes first.
    pub priority: Priority,
    /// When it was submitted.
    pub created_at: Timestamp,
    /// How often it was started.
    pub attempt: i64,
    /// The job that it repeats.
    pub retry_of: Option<String>,
    /// Where it stands, with what is known of it there.
    pub state: JobState,
}

/// Where a job stands, with what is known of it there.
#[derive(Debug, Clone, PartialEq)]
pub enum JobState {
    /// It waits for a worker.
    Queued {
        /// When it was last started, where an interruption has put it back into the queue.
        started_at: Option<Timestamp>,
    },
    /// A worker has it.
    Running {
        /// The boot that runs it.
        boot: i64,
        /// When it was started.
        started_at: Timestamp,
        /// Whether somebody has called it off.
        cancelling: bool,
    },
    /// It came to a result, whatever the gate said of it.
    Succeeded {
        /// What it came to.
        result: JobResult,
        /// Its end.
        ended: Ended,
    },
    /// It came to none.
    Failed {
        /// Why.
        failure: JobFailure,
        /// Its end.
        ended: Ended,
    },
    /// Somebody called it off.
    Cancelled {
        /// Its end.
        ended: Ended,
    },
}

/// The end of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ended {
    /// When it was last started, if it ever was.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub at: Timestamp,
    /// The place of its end in the order of everything; jobs of before that order was kept have none.
    pub sequence: Option<i64>,
}

/// What a job that succeeded came to.
#[derive(Debug, Clone, PartialEq)]
pub enum JobResult {
    /// A fit for its own sake.
    Estimated {
        /// What it led to.
        outcome: Outcome,
        /// The fit.
        found: FoundFit,
    },
    /// Which effect the model is missing.
    Diagnosed {
        /// The fit that it starts from.
        found: FoundFit,
        /// The id of the diagnosis.
        diagnosis: String,
    },
    /// Effects one after another.
    Climbed {
        /// The fit of the base.
        found: FoundFit,
    },
    /// Settings of the search.
    Tuned {
        /// What it led to.
        outcome: Outcome,
        /// The settings, and why.
        tuning: serde_json::Value,
        /// What the searches cost.
        evaluations: i64,
    },
}

/// A fit that a job has found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoundFit {
    /// Its id.
    pub id: String,
    /// The revision that it published.
    pub revision: Option<i64>,
    /// Why the search ended.
    pub stopped_by: String,
    /// What the search cost.
    pub evaluations: i64,
}

/// The right to end a job: void as soon as it was claimed again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub job: String,
    /// The boot that claimed it.
    pub boot: i64,
    /// The attempt that was counted.
    pub attempt: i64,
}

impl JobRecord {
    /// The right to end this job, while it runs.
    pub fn lease(&self) -> Option<Lease> {
        match self.state {
            JobState::Running { boot, .. } => {
                Some(Lease { job: self.id.clone(), boot, attempt: self.attempt })
            }
            _ => None,
        }
    }
}

impl JobState {
    /// The word for it.
    pub const fn status(&self) -> JobStatus {
        match self {
            JobState::Queued { .. } => JobStatus::Queued,
            JobState::Running { .. } => JobStatus::Running,
            JobState::Succeeded { .. } => JobStatus::Succeeded,
            JobState::Failed { .. } => JobStatus::Failed,
            JobState::Cancelled { .. } => JobStatus::Cancelled,
        }
    }

    /// Whether nothing more will happen.
    pub const fn is_final(&self) -> bool {
        self.status().is_final()
    }

    /// The end, if it has come.
    pub const fn ended(&self) -> Option<&Ended> {
        match self {
            JobState::Queued { .. } | JobState::Running { .. } => None,
            JobState::Succeeded { ended, .. }
            | JobState::Failed { ended, .. }
            | JobState::Cancelled { ended } => Some(ended),
        }
    }

    /// The place of the end in the order of everything.
    pub fn end_sequence(&self) -> Option<i64> {
        self.ended().and_then(|ended| ended.sequence)
    }

    /// When the job was last started.
    pub fn started_at(&self) -> Option<Timestamp> {
        match self {
            JobState::Queued { started_at } => *started_at,
            JobState::Running { started_at, .. } => Some(*started_at),
            _ => self.ended().and_then(|ended| ended.started_at),
        }
    }

    /// What the job came to.
    pub const fn result(&self) -> Option<&JobResult> {
        match self {
            JobState::Succeeded { result, .. } => Some(result),
            _ => None,
        }
    }

    /// What the job led to.
    pub fn outcome(&self) -> Option<Outcome> {
        self.result().and_then(JobResult::outcome)
    }

    /// Why the job failed.
    pub const fn failure(&self) -> Option<&JobFailure> {
        match self {
            JobState::Failed { failure, .. } => Some(failure),
            _ => None,
        }
    }
}

impl JobResult {
    /// What it led to. A fit that was only a means leads to nothing.
    pub const fn outcome(&self) -> Option<Outcome> {
        match self {
            JobResult::Estimated { outcome, .. } | JobResult::Tuned { outcome, .. } => Some(*outcome),
            JobResult::Diagnosed { .. } | JobResult::Climbed { .. } => None,
        }
    }

    /// The fit.
    pub const fn found(&self) -> Option<&FoundFit> {
        match self {
            JobResult::Estimated { found, .. }
            | JobResult::Diagnosed { found, .. }
            | JobResult::Climbed { found } => Some(found),
            JobResult::Tuned { .. } => None,
        }
    }

    /// What the search cost.
    pub fn evaluations(&self) -> i64 {
        match self {
            JobResult::Tuned { evaluations, .. } => *evaluations,
            _ => self.found().map_or(0, |found| found.evaluations),
        }
    }
}

row! {
    pub(super) struct Row {
        id: String,
        sequence: i64,
        kind: String,
        system: String,
        model: String,
        request: String,
        experiment: bool,
        origin: String,
        priority: i64,
        state: String,
        outcome: Option<String>,
        boot: Option<i64>,
        attempt: i64,
        cancelling: bool,
        fit: Option<String>,
        revision: Option<i64>,
        error: Option<String>,
        stopped_by: Option<String>,
        evaluations: Option<i64>,
        created_at: i64,
        started_at: Option<i64>,
        ended_at: Option<i64>,
        end_sequence: Option<i64>,
        diagnosis: Option<String>,
        tuning: Option<String>,
        retry_of: Option<String>,
    }
}

impl Row {
    pub(super) fn record(self) -> Result<JobRecord, StoreError> {
        let kind = parse("a kind of job", &self.kind)?;
        Ok(JobRecord {
            kind,
            state: self.state(kind)?,
            system: parse("a system", &self.system)?,
            model: parse("a model", &self.model)?,
            request: from_json("a request", &self.request)?,
            origin: parse("an origin", &self.origin)?,
            priority: Priority::from_rank(self.priority),
            created_at: instant(self.created_at)?,
            id: self.id,
            sequence: self.sequence,
            experiment: self.experiment,
            attempt: self.attempt,
            retry_of: self.retry_of,
        })
    }

    /// The state, if the row has what it implies and nothing else.
    fn state(&self, kind: JobKind) -> Result<JobState, StoreError> {
        let status = parse("a state", &self.state)?;
        let started_at = self.started_at.map(instant).transpose()?;
        let ended_at = self.ended_at.map(instant).transpose()?;
        let ended = ended_at.map(|at| Ended { started_at, at, sequence: self.end_sequence });
        let failure = self.error.as_deref().map(|text| from_json("a failure", text)).transpose()?;
        match (status, self.boot, started_at, self.result(kind)?, failure, ended) {
            (JobStatus::Queued, None, started_at, None, None, None) => Ok(JobState::Queued { started_at }),
            (JobStatus::Running, Some(boot), Some(started_at), None, None, None) => {
                Ok(JobState::Running { boot, started_at, cancelling: self.cancelling })
            }
            (JobStatus::Succeeded, None, _, Some(result), None, Some(ended)) => {
                Ok(JobState::Succeeded { result, ended })
            }
            (JobStatus::Failed, None, _, None, Some(failure), Some(ended)) => {
                Ok(JobState::Failed { failure, ended })
            }
            (JobStatus::Cancelled, None, _, None, None, Some(ended)) => Ok(JobState::Cancelled { ended }),
            _ => Err(self.contradiction()),
        }
    }

    /// What the job came to, if the row has what its kind implies and nothing else.
    fn result(&self, kind: JobKind) -> Result<Option<JobResult>, StoreError> {
        let outcome = self.outcome.as_deref().map(|word| parse("an outcome", word)).transpose()?;
        let tuning = self.tuning.as_deref().map(|text| from_json("a tuning", text)).transpose()?;
        let found = match (&self.fit, self.revision, &self.stopped_by, self.evaluations) {
            (Some(id), revision, Some(stopped_by), Some(evaluations)) => {
                Some(FoundFit { id: id.clone(), revision, stopped_by: stopped_by.clone(), evaluations })
            }
            (None, None, None, _) => None,
            _ => return Err(self.contradiction()),
        };
        let found = (kind, outcome, found, self.diagnosis.clone(), tuning, self.evaluations);
        Ok(Some(match found {
            (_, None, None, None, None, None) => return Ok(None),
            (JobKind::Estimate, Some(outcome), Some(found), None, None, _) => {
                JobResult::Estimated { outcome, found }
            }
            (JobKind::Diagnose, None, Some(found), Some(diagnosis), None, _) => {
                JobResult::Diagnosed { found, diagnosis }
            }
            (JobKind::Ladder, None, Some(found), None, None, _) => JobResult::Climbed { found },
            (JobKind::Tune, Some(outcome), None, None, Some(tuning), Some(evaluations)) => {
                JobResult::Tuned { outcome, tuning, evaluations }
            }
            _ => return Err(self.contradiction()),
        }))
    }

    fn contradiction(&self) -> StoreError {
        corrupt(
            format!("the job {}", self.id),
            &format!("a {} that is `{}` has other columns", self.kind, self.state),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kind: JobKind, status: JobStatus) -> Row {
        Row {
            id: "job_1".into(),
            sequence: 1,
            kind: kind.as_str().into(),
            system: "room/1".into(),
            model: "rc2".into(),
            request: "{}".into(),
            experiment: false,
            origin: "posted".into(),
            priority: 1,
            state: status.as_str().into(),
            outcome: None,
            boot: None,
            attempt: 1,
            cancelling: false,
            fit: None,
            revision: None,
            error: None,
            stopped_by: None,
            evaluations: None,
            created_at: 0,
            started_at: Some(1),
            ended_at: status.is_final().then_some(2),
            end_sequence: None,
            diagnosis: None,
            tuning: None,
            retry_of: None,
        }
    }

    fn fitted(kind: JobKind) -> Row {
        Row {
            fit: Some("fit_1".into()),
            stopped_by: Some("budget".into()),
            evaluations: Some(600),
            ..row(kind, JobStatus::Succeeded)
        }
    }

    #[test]
    fn a_state_has_what_it_implies() {
        let state = |row: Row| row.record().unwrap().state;
        let back = state(row(JobKind::Estimate, JobStatus::Queued));
        assert_eq!((back.status(), back.started_at()), (JobStatus::Queued, Some(instant(1).unwrap())));
        let running = Row { boot: Some(3), ..row(JobKind::Estimate, JobStatus::Running) };
        assert_eq!(running.record().unwrap().lease().map(|lease| lease.boot), Some(3));
        let held = state(Row { outcome: Some("held".into()), ..fitted(JobKind::Estimate) });
        assert_eq!((held.outcome(), held.ended().is_some()), (Some(Outcome::Held), true));
        let diagnosed = state(Row { diagnosis: Some("dia_1".into()), ..fitted(JobKind::Diagnose) });
        assert_eq!(diagnosed.result().map(JobResult::evaluations), Some(600));
        assert_eq!(state(row(JobKind::Tune, JobStatus::Cancelled)).end_sequence(), None);
    }

    #[test]
    fn a_row_that_contradicts_itself_is_damaged() {
        let outcome = || Some("accepted".to_owned());
        let wrong = [
            row(JobKind::Estimate, JobStatus::Running),
            row(JobKind::Estimate, JobStatus::Succeeded),
            row(JobKind::Estimate, JobStatus::Failed),
            Row { boot: Some(1), ..row(JobKind::Estimate, JobStatus::Queued) },
            Row { ended_at: None, ..row(JobKind::Estimate, JobStatus::Cancelled) },
            Row { revision: Some(1), ..row(JobKind::Estimate, JobStatus::Cancelled) },
            Row { outcome: outcome(), state: "cancelled".into(), ..fitted(JobKind::Estimate) },
            Row { outcome: outcome(), stopped_by: None, ..fitted(JobKind::Estimate) },
            Row { outcome: outcome(), diagnosis: Some("dia_1".into()), ..fitted(JobKind::Diagnose) },
            fitted(JobKind::Diagnose),
            fitted(JobKind::Tune),
        ];
        for (number, row) in wrong.into_iter().enumerate() {
            assert!(matches!(row.record(), Err(StoreError::Corrupt { .. })), "{number}");
        }
    }
}
