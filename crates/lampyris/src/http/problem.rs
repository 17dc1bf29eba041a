//! Every answer that is an error, as a problem document (RFC 9457) with a stable slug and all faults at once.

use crate::service::{Refusal, ServiceError};
use crate::store::StoreError;
use crate::store::jobs::JobStatus;
use crate::store::tokens::Scope;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use lampyris_core::data::SystemPattern;
use lampyris_core::fault::Fault;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use utoipa::openapi::{ContentBuilder, Ref, RefOr, Response as DocumentedResponse, ResponseBuilder};
use utoipa::{IntoResponses, ToSchema};

/// The media type of problem documents.
pub const PROBLEM_JSON: &str = "application/problem+json";

/// What went wrong.
#[derive(Debug, Serialize, ToSchema)]
pub struct Problem {
    /// A stable slug for programs.
    #[serde(rename = "type")]
    #[schema(example = "system-not-found")]
    pub(super) slug: &'static str,
    /// The slug in words.
    pub(super) title: &'static str,
    /// The status of the answer.
    #[schema(minimum = 400, maximum = 599)]
    pub(super) status: u16,
    /// A sentence about this case.
    pub(super) detail: String,
    /// Every fault of what was sent.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) errors: Vec<Fault>,
    /// What else a client may want to know.
    #[serde(flatten)]
    #[schema(ignore)]
    pub(super) more: Map<String, Value>,
}

/// An error at the edge: what a handler answers when it cannot answer.
#[derive(Debug)]
pub enum ApiError {
    /// The text is no JSON.
    Malformed(Fault),
    /// The document has faults.
    Invalid(Vec<Fault>),
    /// The document of a model or of an effect has faults: there is a page about the language of both.
    InvalidDocument(Vec<Fault>),
    /// There is no such thing: what, and which.
    NotFound(&'static str, String),
    /// No path of the service.
    NoSuchPath,
    /// The path knows other methods.
    NoSuchMethod,
    /// Never validated: the newest job, and whether it is still to come to an end.
    NeverValidated {
        /// The system.
        system: String,
        /// The newest job.
        latest_job: Option<String>,
        /// Whether it waits or runs.
        pending: bool,
    },
    /// There is a validated set, but the client takes fresh ones only.
    NotFresh(String),
    /// There are no states yet.
    NoState(String),
    /// A fit has no covariance.
    NoCovariance(String),
    /// Another document has this id: what, and which.
    Conflict(&'static str, String),
    /// It cannot be done as things stand.
    Refused(Refusal),
    /// The media type is none that the path takes.
    MediaType(&'static str),
    /// The client takes no media type that the path has.
    NotAcceptable(&'static [&'static str]),
    /// The body is larger than this many bytes.
    TooLarge(usize),
    /// No token that is good was sent, and why not.
    Unauthorized(&'static str),
    /// So many wrong tokens came from this address that no other one is judged for now.
    TooManyFailures,
    /// A request does not say once by which name it asks.
    NoHost,
    /// The service does not go by this name.
    UnknownHost(String),
    /// A page of another origin has its browser change something.
    ForeignPage,
    /// Something is not, or is, as the client has said.
    NotAsExpected(String),
    /// The bodies of other requests take all the room that there is for them.
    TooMuchAtOnce,
    /// As many streams of events are open as may be.
    TooManyStreams,
    /// The token is not good for this.
    Forbidden {
        /// The scope that is needed.
        needed: Scope,
        /// The name of the token.
        token: String,
        /// The scope that it has.
        has: Scope,
    },
    /// A pattern that selects more systems than the token may see.
    OutOfReach(SystemPattern),
    /// The body ended early.
    BrokenBody,
    /// The body did not come within these seconds.
    SlowBody(u64),
    /// The body is compressed.
    Encoded,
    /// The idempotency key belongs to another request.
    KeyReused,
    /// The job waits or runs: which, and the word for it.
    NotFinished(String, &'static str),
    /// So many jobs wait already.
    QueueFull(String),
    /// Too many answers are being computed already.
    Busy,
    /// The database cannot do it now.
    Storage(StoreError),
    /// It took too long.
    TimedOut,
    /// A fault of the program.
    Internal(String),
}

impl From<ServiceError> for ApiError {
    fn from(error: ServiceError) -> Self {
        match error {
            ServiceError::Malformed(fault) => ApiError::Malformed(fault),
            ServiceError::Faults(faults) => ApiError::Invalid(faults),
            ServiceError::NoSystem(system) => ApiError::NotFound("system", system.to_string()),
            ServiceError::NotFound(what, which) => ApiError::NotFound(what, which),
            ServiceError::NeverValidated(system, job) => {
                ApiError::never_validated(system.to_string(), job.as_ref())
            }
            ServiceError::Conflict(what, which) => ApiError::Conflict(what, which),
            ServiceError::NotAsExpected(detail) => ApiError::NotAsExpected(detail),
            ServiceError::Refused(refusal) => ApiError::Refused(refusal),
            ServiceError::KeyReused => ApiError::KeyReused,
            ServiceError::NotFinished(job, state) => ApiError::NotFinished(job, state.as_str()),
            ServiceError::QueueFull(limit) => ApiError::QueueFull(limit),
            ServiceError::Busy => ApiError::Busy,
            ServiceError::Store(error) => ApiError::Storage(error),
            ServiceError::Internal(detail) => ApiError::Internal(detail),
        }
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        ApiError::Storage(error)
    }
}

impl ApiError {
    /// An error of work on a document of a model or of an effect.
    pub fn of_document(error: ServiceError) -> Self {
        match error {
            ServiceError::Faults(faults) => ApiError::InvalidDocument(faults),
            other => other.into(),
        }
    }

    /// No fit of a system was ever accepted, and this is its newest job.
    pub fn never_validated(system: String, latest_job: Option<&(String, JobStatus)>) -> Self {
        ApiError::NeverValidated {
            system,
            pending: latest_job.is_some_and(|(_, state)| !state.is_final()),
            latest_job: latest_job.map(|(id, _)| id.clone()),
        }
    }

    /// What would have been right, as RFC 6750 says it.
    fn challenge(&self) -> Option<&'static str> {
        match self {
            ApiError::Unauthorized(_) => Some("Bearer realm=\"lampyris\""),
            ApiError::Forbidden { needed, .. } => Some(match needed {
                Scope::Read => "Bearer realm=\"lampyris\", error=\"insufficient_scope\", scope=\"read\"",
                Scope::Operate => {
                    "Bearer realm=\"lampyris\", error=\"insufficient_scope\", scope=\"operate\""
                }
                Scope::Admin => "Bearer realm=\"lampyris\", error=\"insufficient_scope\", scope=\"admin\"",
            }),
            _ => None,
        }
    }

    /// Seconds after which it may be worth asking again.
    fn retry_after(&self) -> Option<u32> {
        match self {
            ApiError::NeverValidated { pending: true, .. } | ApiError::Busy | ApiError::TooMuchAtOnce => {
                Some(2)
            }
            ApiError::QueueFull(_) | ApiError::TooManyStreams | ApiError::Storage(StoreError::Full(_)) => {
                Some(10)
            }
            ApiError::TooManyFailures => Some(60),
            ApiError::Storage(error) if error.is_final() => Some(60),
            ApiError::Storage(_) | ApiError::TimedOut => Some(5),
            _ => None,
        }
    }
}

impl ApiError {
    /// The answer of this error, in some form.
    pub(super) fn answered(self, form: impl FnOnce(Problem) -> Response) -> Response {
        match &self {
            ApiError::Storage(error) => tracing::error!(%error, "the database failed"),
            ApiError::Internal(detail) => {
                tracing::error!(detail, "a request ran into a fault of the program")
            }
            _ => {}
        }
        let retry_after = self.retry_after();
        let challenge = self.challenge();
        let mut response = form(self.problem());
        if let Some(seconds) = retry_after {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if let Some(challenge) = challenge {
            response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static(challenge));
        }
        response
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        self.answered(Problem::into_response)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        // A problem holds nothing but texts and numbers, so this cannot fail; the slug alone would still be
        // an answer.
        let body = serde_json::to_vec(&self)
            .unwrap_or_else(|_| format!(r#"{{"type":"{}"}}"#, self.slug).into_bytes());
        (status, [(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON))], body).into_response()
    }
}

/// Turns error answers of the layers and the framework into problem documents, and keeps their headers.
pub(crate) async fn as_problem(response: Response) -> Response {
    let status = response.status();
    // A document is what a handler wanted to say; layers and the framework send texts, or nothing.
    let is_document = response
        .headers()
        .get(header::CONTENT_TYPE)
        .is_some_and(|kind| kind == PROBLEM_JSON || kind == "application/json");
    if is_document || !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let error = match status {
        StatusCode::NOT_FOUND => ApiError::NoSuchPath,
        StatusCode::METHOD_NOT_ALLOWED => ApiError::NoSuchMethod,
        StatusCode::SERVICE_UNAVAILABLE | StatusCode::REQUEST_TIMEOUT | StatusCode::GATEWAY_TIMEOUT => {
            ApiError::TimedOut
        }
        StatusCode::INTERNAL_SERVER_ERROR => {
            ApiError::Internal("an answer without a problem document".into())
        }
        _ => return bare(status).into_response(),
    };
    let mut problem = error.into_response();
    if let Some(allow) = response.headers().get(header::ALLOW) {
        problem.headers_mut().insert(header::ALLOW, allow.clone());
    }
    problem
}

/// A status that this service has no words of its own for.
fn bare(status: StatusCode) -> Problem {
    let detail = status.canonical_reason().unwrap_or("the request was refused").to_owned();
    Problem {
        slug: "refused",
        title: "The request was refused",
        status: status.as_u16(),
        detail,
        errors: Vec::new(),
        more: Map::new(),
    }
}

/// Documents that every path may answer with a problem.
#[derive(Debug)]
pub struct Problems;

impl IntoResponses for Problems {
    fn responses() -> BTreeMap<String, RefOr<DocumentedResponse>> {
        let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
        let response =
            ResponseBuilder::new().description("What went wrong").content(PROBLEM_JSON, content).build();
        BTreeMap::from([("default".to_owned(), RefOr::T(response))])
    }
}
