//! What every error is called, and what is said of it.

use super::language;
use super::problem::{ApiError, Problem};
use super::storage;
use crate::service::Refusal;
use axum::http::StatusCode;
use serde_json::Map;

impl ApiError {
    /// The document of this error.
    pub(super) fn problem(self) -> Problem {
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
            ApiError::InvalidDocument(faults) => {
                let mut problem = ApiError::Invalid(faults).problem();
                problem.more.insert("see".into(), language::PAGE.into());
                problem
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
            ApiError::NoCovariance(fit) => {
                let detail = format!(
                    "{} has no covariance: its data do not determine its parameters, or it was made by a \
                    version that did not keep one",
                    shown(&fit)
                );
                plain(StatusCode::NOT_FOUND, "no-covariance", "No covariance", detail)
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
            ApiError::TooMuchAtOnce => {
                let detail = "the bodies of other requests, of this token or of all, take all the room that \
                    there is for them: send it again"
                    .to_owned();
                plain(StatusCode::SERVICE_UNAVAILABLE, "too-much-at-once", "Too much at once", detail)
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
            ApiError::QueueFull(detail) => {
                plain(StatusCode::TOO_MANY_REQUESTS, "queue-full", "The queue is full", detail)
            }
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
        "night" => ("night-not-found", "No such night"),
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
