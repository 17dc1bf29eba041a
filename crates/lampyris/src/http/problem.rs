//! Every answer that is an error, as a problem document (RFC 9457) with a stable slug and all faults at once.

use super::storage;
use crate::service::{Refusal, ServiceError};
use crate::store::StoreError;
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
    slug: &'static str,
    /// The slug in words.
    title: &'static str,
    /// The status of the answer.
    #[schema(minimum = 400, maximum = 599)]
    status: u16,
    /// A sentence about this case.
    detail: String,
    /// Every fault of what was sent.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    errors: Vec<Fault>,
    /// What else a client may want to know.
    #[serde(flatten)]
    #[schema(ignore)]
    more: Map<String, Value>,
}

/// An error at the edge: what a handler answers when it cannot answer.
#[derive(Debug)]
pub enum ApiError {
    /// The text is no JSON.
    Malformed(Fault),
    /// The document has faults.
    Invalid(Vec<Fault>),
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
    QueueFull(i64),
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
    fn problem(self) -> Problem {
        let plain = |status: StatusCode, slug, title, detail: String| Problem {
            slug,
            title,
            status: status.as_u16(),
            detail,
            errors: Vec::new(),
            more: Map::new(),
        };
        match self {
            ApiError::Malformed(fault) => {
                let detail = fault.detail.clone();
                Problem {
                    errors: vec![fault],
                    ..plain(StatusCode::BAD_REQUEST, "malformed-body", "The body is not JSON", detail)
                }
            }
            ApiError::Invalid(faults) => {
                let detail = match faults.as_slice() {
                    [fault] => fault.to_string(),
                    faults => format!("there are {} faults", faults.len()),
                };
                Problem {
                    errors: faults,
                    ..plain(
                        StatusCode::UNPROCESSABLE_ENTITY,
                        "invalid-request",
                        "The request has faults",
                        detail,
                    )
                }
            }
            ApiError::NotFound(what, which) => {
                let (slug, title) = not_found(what);
                plain(StatusCode::NOT_FOUND, slug, title, format!("there is no {what} `{}`", shown(&which)))
            }
            ApiError::NoSuchPath => plain(
                StatusCode::NOT_FOUND,
                "not-found",
                "No such path",
                "the service has no such path; /openapi.yaml lists them".into(),
            ),
            ApiError::NoSuchMethod => plain(
                StatusCode::METHOD_NOT_ALLOWED,
                "method-not-allowed",
                "No such method",
                "the path does not know this method".into(),
            ),
            ApiError::NeverValidated { system, latest_job, .. } => {
                let detail = format!("no fit of {} was ever accepted: use your own baseline", shown(&system));
                let mut problem = plain(
                    StatusCode::NOT_FOUND,
                    "no-validated-parameters",
                    "No validated parameters",
                    detail,
                );
                problem.more.insert("latest_job".into(), latest_job.into());
                problem
            }
            ApiError::NotFresh(system) => {
                let detail = format!("the parameters of {} are older than its policy wants", shown(&system));
                plain(StatusCode::NOT_FOUND, "no-fresh-parameters", "No fresh parameters", detail)
            }
            ApiError::NoState(system) => {
                let detail = format!("no states of {} are known: no revision is served", shown(&system));
                plain(StatusCode::NOT_FOUND, "no-state", "No states", detail)
            }
            ApiError::Conflict(what, which) => {
                let detail = format!(
                    "there is another {what} `{}`: documents do not change, because fits refer to them",
                    shown(&which)
                );
                plain(StatusCode::CONFLICT, "already-exists", "The id is taken", detail)
            }
            ApiError::Refused(Refusal { slug, detail, because }) => {
                let mut problem = plain(StatusCode::CONFLICT, slug, "Not as things stand", detail);
                if let Some((field, members)) = because {
                    problem.more.insert(field.into(), members.into());
                }
                problem
            }
            ApiError::MediaType(wanted) => {
                let detail = format!("the body must be {wanted}, and Content-Type must say so");
                plain(
                    StatusCode::UNSUPPORTED_MEDIA_TYPE,
                    "unsupported-media-type",
                    "Unsupported media type",
                    detail,
                )
            }
            ApiError::NotAcceptable(forms) => {
                let detail =
                    format!("the answer comes as {}, and Accept must allow one of them", forms.join(" or "));
                plain(StatusCode::NOT_ACCEPTABLE, "not-acceptable", "No acceptable media type", detail)
            }
            ApiError::TooLarge(limit) => {
                let mut problem = plain(
                    StatusCode::PAYLOAD_TOO_LARGE,
                    "body-too-large",
                    "The body is too large",
                    format!("the limit is {limit} bytes"),
                );
                problem.more.insert("limit".into(), limit.into());
                problem
            }
            ApiError::BrokenBody => plain(
                StatusCode::BAD_REQUEST,
                "broken-body",
                "The body could not be read",
                "the body ended early".into(),
            ),
            ApiError::SlowBody(seconds) => {
                let detail = format!("a body comes within {seconds} seconds");
                plain(StatusCode::REQUEST_TIMEOUT, "body-too-slow", "The body came too slowly", detail)
            }
            ApiError::Encoded => {
                let detail = "a body is sent as it is: leave Content-Encoding out".to_owned();
                plain(
                    StatusCode::UNSUPPORTED_MEDIA_TYPE,
                    "unsupported-content-encoding",
                    "The body is compressed",
                    detail,
                )
            }
            ApiError::Unauthorized(detail) => {
                plain(StatusCode::UNAUTHORIZED, "unauthorized", "A token is needed", detail.to_owned())
            }
            ApiError::TooManyFailures => {
                let detail = "too many wrong tokens came from this address; one that is good would be taken"
                    .to_owned();
                plain(StatusCode::TOO_MANY_REQUESTS, "too-many-failures", "Too many wrong tokens", detail)
            }
            ApiError::NoHost => {
                let detail = "a request of HTTP/1.1 has one Host".to_owned();
                plain(StatusCode::BAD_REQUEST, "no-host", "No host", detail)
            }
            ApiError::UnknownHost(host) => {
                let detail = format!(
                    "the service does not go by the name `{}`: ask by its address, or name it in `hosts` of the \
                    settings",
                    shown(&host)
                );
                plain(StatusCode::MISDIRECTED_REQUEST, "unknown-host", "No name of this service", detail)
            }
            ApiError::ForeignPage => {
                let detail =
                    "the page of another origin changes nothing here; where a proxy gives the service \
                    another name, `hosts` of the settings names it"
                        .to_owned();
                plain(StatusCode::FORBIDDEN, "foreign-page", "Another page has sent this", detail)
            }
            ApiError::NotAsExpected(detail) => {
                plain(StatusCode::PRECONDITION_FAILED, "not-as-expected", "It is not as expected", detail)
            }
            ApiError::TooManyStreams => {
                let detail =
                    "as many streams of events are open as one token, or all together, may have".to_owned();
                plain(StatusCode::TOO_MANY_REQUESTS, "too-many-streams", "Too many streams", detail)
            }
            ApiError::Forbidden { needed, token, has } => {
                let detail = format!(
                    "this needs the scope `{}`, and the token `{token}` has `{}`",
                    needed.as_str(),
                    has.as_str()
                );
                let mut problem = plain(
                    StatusCode::FORBIDDEN,
                    "insufficient-scope",
                    "The token is not good for this",
                    detail,
                );
                problem.more.insert("scope".into(), needed.as_str().into());
                problem
            }
            ApiError::OutOfReach(pattern) => {
                let detail = format!("`{pattern}` selects systems that the token is not good for");
                plain(
                    StatusCode::FORBIDDEN,
                    "out-of-reach",
                    "The token is not good for these systems",
                    detail,
                )
            }
            ApiError::KeyReused => {
                let detail = "the Idempotency-Key was used for another request".into();
                plain(
                    StatusCode::UNPROCESSABLE_ENTITY,
                    "idempotency-key-reused",
                    "The idempotency key is taken",
                    detail,
                )
            }
            ApiError::NotFinished(job, state) => {
                let detail =
                    format!("the job `{}` is {state}: it can be done again when it has ended", shown(&job));
                plain(StatusCode::CONFLICT, "job-not-finished", "The job has not ended", detail)
            }
            ApiError::QueueFull(limit) => plain(
                StatusCode::TOO_MANY_REQUESTS,
                "queue-full",
                "The queue is full",
                format!("{limit} jobs wait already"),
            ),
            ApiError::Busy => {
                let detail = "too many answers are being computed already; nothing was started".into();
                plain(StatusCode::SERVICE_UNAVAILABLE, "busy", "Too much is asked at once", detail)
            }
            ApiError::Storage(error) => {
                let (status, slug, title) = storage::problem(&error);
                plain(status, slug, title, storage::detail(&error))
            }
            ApiError::TimedOut => plain(
                StatusCode::SERVICE_UNAVAILABLE,
                "timed-out",
                "It took too long",
                "the request was given up".into(),
            ),
            ApiError::Internal(_) => plain(
                StatusCode::INTERNAL_SERVER_ERROR,
                "internal-error",
                "A fault of the service",
                "the log of the service knows more".into(),
            ),
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
            ApiError::NeverValidated { pending: true, .. } | ApiError::Busy => Some(2),
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

/// The slug and the title for something that is not there.
fn not_found(what: &str) -> (&'static str, &'static str) {
    match what {
        "system" => ("system-not-found", "No such system"),
        "window" => ("window-not-found", "No such window"),
        "model" => ("model-not-found", "No such model"),
        "effect" => ("effect-not-found", "No such effect"),
        "job" => ("job-not-found", "No such job"),
        "batch" => ("batch-not-found", "No such batch"),
        "fit" => ("fit-not-found", "No such fit"),
        "diagnosis" => ("diagnosis-not-found", "No such diagnosis"),
        "ladder" => ("ladder-not-found", "No ladder yet"),
        "file" => ("file-not-found", "No such file"),
        "schedule" => ("schedule-not-found", "No such schedule"),
        _ => ("not-found", "No such thing"),
    }
}

/// A text of the client as an answer may repeat it: short and on one line.
fn shown(text: &str) -> String {
    text.chars().take(80).collect::<String>().escape_debug().to_string()
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        match &self {
            ApiError::Storage(error) => tracing::error!(%error, "the database failed"),
            ApiError::Internal(detail) => {
                tracing::error!(detail, "a request ran into a fault of the program")
            }
            _ => {}
        }
        let retry_after = self.retry_after();
        let challenge = self.challenge();
        let mut response = self.problem().into_response();
        if let Some(seconds) = retry_after {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if let Some(challenge) = challenge {
            response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static(challenge));
        }
        response
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
pub async fn as_problem(response: Response) -> Response {
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
