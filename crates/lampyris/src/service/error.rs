//! Why something could not be done, in words that every surface can tell.

use crate::store::StoreError;
use crate::store::entry::SubmitError;
use crate::store::jobs::JobStatus;
use lampyris_core::data::SystemId;
use lampyris_core::fault::Fault;

/// Why something could not be done.
#[derive(Debug)]
pub enum ServiceError {
    /// What was sent is no JSON.
    Malformed(Fault),
    /// What was sent has faults.
    Faults(Vec<Fault>),
    /// There is no such system.
    NoSystem(SystemId),
    /// There is no such thing: what, and which.
    NotFound(&'static str, String),
    /// No fit of the system was ever accepted: its newest job, if it has any.
    NeverValidated(SystemId, Option<(String, JobStatus)>),
    /// Another document has this id: what, and which.
    Conflict(&'static str, String),
    /// What a request said to be there is not, or what was not to be there is.
    NotAsExpected(String),
    /// It cannot be done as things stand.
    Refused(Refusal),
    /// The idempotency key belongs to another request.
    KeyReused,
    /// The job waits or runs.
    NotFinished(String, JobStatus),
    /// So many jobs wait already, in a sentence.
    QueueFull(String),
    /// Too many answers are being computed already.
    Busy,
    /// The database failed.
    Store(StoreError),
    /// Something that cannot happen did.
    Internal(String),
}

/// Why something that makes sense cannot be done as things stand.
#[derive(Debug)]
pub struct Refusal {
    /// A stable slug for programs.
    pub slug: &'static str,
    /// A sentence about this case, with what to do about it.
    pub detail: String,
    /// What stands in the way, where it has names: a field, and its members.
    pub because: Option<(&'static str, Vec<String>)>,
}

impl Refusal {
    /// A refusal that names nothing in the way.
    pub fn new(slug: &'static str, detail: impl Into<String>) -> Self {
        Self { slug, detail: detail.into(), because: None }
    }
}

impl From<Refusal> for ServiceError {
    fn from(refusal: Refusal) -> Self {
        ServiceError::Refused(refusal)
    }
}

impl std::fmt::Display for ServiceError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ServiceError::Malformed(fault) => fault.fmt(f),
            ServiceError::Faults(faults) => write!(f, "{} faults", faults.len()),
            ServiceError::NoSystem(system) => write!(f, "there is no system `{system}`"),
            ServiceError::NotFound(what, which) => write!(f, "there is no {what} `{which}`"),
            ServiceError::NeverValidated(system, _) => write!(f, "no fit of {system} was ever accepted"),
            ServiceError::Conflict(what, which) => write!(f, "there is another {what} `{which}`"),
            ServiceError::NotAsExpected(detail) => f.write_str(detail),
            ServiceError::Refused(refusal) => f.write_str(&refusal.detail),
            ServiceError::KeyReused => f.write_str("the idempotency key was used for another request"),
            ServiceError::NotFinished(job, state) => {
                write!(f, "the job `{job}` has not ended: it is {}", state.as_str())
            }
            ServiceError::QueueFull(detail) => f.write_str(detail),
            ServiceError::Busy => f.write_str("too many answers are being computed already"),
            ServiceError::Store(error) => error.fmt(f),
            ServiceError::Internal(detail) => f.write_str(detail),
        }
    }
}

impl std::error::Error for ServiceError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            ServiceError::Store(error) => Some(error),
            _ => None,
        }
    }
}

impl From<StoreError> for ServiceError {
    fn from(error: StoreError) -> Self {
        ServiceError::Store(error)
    }
}

impl From<SubmitError> for ServiceError {
    fn from(error: SubmitError) -> Self {
        match error {
            SubmitError::Store(error) => ServiceError::Store(error),
            SubmitError::QueueFull(limit) => ServiceError::QueueFull(limit),
            SubmitError::KeyReused => ServiceError::KeyReused,
        }
    }
}
