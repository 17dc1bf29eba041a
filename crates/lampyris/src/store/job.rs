//! The words of a job: what it does, where it stands, what came of it, and why it failed.

use super::words::words;
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

words! {
    /// What a job does. Recalibrations are batches of estimates.
    JobKind {
        /// Estimate parameters, judge and publish them.
        Estimate = "estimate",
        /// Say which effect the model is missing.
        Diagnose = "diagnose",
        /// Add effects one after another while the error on unseen data falls.
        Ladder = "ladder",
        /// Choose settings of the search on the system's own past.
        Tune = "tune",
    }
}

words! {
    /// Where a job stands.
    JobStatus as "JobState" {
        /// It waits for a worker.
        Queued = "queued",
        /// A worker has it.
        Running = "running",
        /// It came to a result, whatever the gate said of it.
        Succeeded = "succeeded",
        /// It came to none.
        Failed = "failed",
        /// Somebody called it off.
        Cancelled = "cancelled",
    }
}

impl JobStatus {
    /// Whether nothing more will happen.
    pub const fn is_final(self) -> bool {
        matches!(self, JobStatus::Succeeded | JobStatus::Failed | JobStatus::Cancelled)
    }
}

words! {
    /// In which order jobs are listed, and thereby which.
    JobOrder {
        /// All, the one that was submitted last first.
        Submitted = "submitted",
        /// Those that wait, the one whose turn it is first. Where tenants share the queue, each has an order
        /// of its own, and they take turns.
        Turn = "turn",
        /// Those that have ended, the newest end first.
        Ended = "ended",
    }
}

words! {
    /// What a job that succeeded led to.
    Outcome {
        /// The gate accepted the fit; it is served if the job counts. Of a tuning: its settings are the
        /// system's now.
        Accepted = "accepted",
        /// The fit waits for an operator.
        Held = "held",
        /// The gate refused it.
        Rejected = "rejected",
        /// The gate accepted it, but nobody but an operator may publish it: by the policy of the system, or
        /// because the job had bounds or fixed values of its own. Of a tuning: its settings are better, but
        /// not taken.
        Suggested = "suggested",
        /// It passes, but what is served is better. Of a tuning: the settings in use stay.
        Unchanged = "unchanged",
    }
}

words! {
    /// Who asked for a job.
    Origin {
        /// A user or a program.
        Posted = "posted",
        /// A schedule.
        Scheduled = "scheduled",
    }
}

words! {
    /// Who goes first.
    Priority {
        /// Somebody waits in front of a page.
        Interactive = "interactive",
        /// Somebody posted it.
        Operator = "operator",
        /// The schedule's.
        Nightly = "nightly",
    }
}

impl Priority {
    /// Its number in the queue; the lowest goes first.
    pub(super) const fn rank(self) -> i64 {
        self as i64
    }

    /// The priority of a number.
    pub(super) fn from_rank(rank: i64) -> Priority {
        usize::try_from(rank).ok().and_then(|rank| Self::ALL.get(rank)).copied().unwrap_or(Priority::Nightly)
    }
}

/// Why a job came to no result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = JobError)]
pub struct JobFailure {
    /// A stable slug, such as `diverged` or `panic`.
    pub code: String,
    /// A sentence for people.
    pub detail: String,
    /// Every fault of the request, the model or the data, where that is the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<Fault>,
}
