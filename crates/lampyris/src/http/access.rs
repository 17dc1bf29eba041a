//! Who may do what. Every operation is declared here, once; the description takes its `security` from here,
//! and the guard that lies around all operations decides by it.

use super::dialect::{self, InfluxRefusal};
use super::origin;
use super::places::Connection;
use super::problem::ApiError;
use super::shared::Shared;
use crate::service::Service;
use crate::service::access::tokens::{LOCAL, TokenCheck};
use crate::store;
use crate::store::reach::SystemScope;
use crate::store::systems::Thing;
use crate::store::tokens::{Scope, TokenRecord};
use axum::body::Body;
use axum::extract::{FromRequestParts, MatchedPath, Path, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use lampyris_core::data::{SystemId, SystemPattern};
use lampyris_core::fault::Fault;
use serde_json::Value;
use std::borrow::Cow;
use std::collections::HashMap;
use std::net::{IpAddr, Ipv4Addr};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio_stream::Stream;

/// What the path of an operation names: by it the system is found that a token must be good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum About {
    /// Nothing that belongs to a system, or what the handler itself keeps from a caller that may not see it.
    Several,
    /// Several, told by a client of InfluxDB, which shows its token and writes its body in ways of its own,
    /// and reads errors in another form.
    Lines,
    /// A system, by kind and id.
    System,
    /// Something that belongs to one system.
    Thing(Thing),
    /// A batch, which has patterns of systems.
    Batch,
    /// A schedule, which has them, too.
    Schedule,
}

use About::{Batch, Lines, Schedule, Several, System};
use Scope::{Admin, Operate, Read};
const JOB: About = About::Thing(Thing::Job);
const FIT: About = About::Thing(Thing::Fit);
const DIAGNOSIS: About = About::Thing(Thing::Diagnosis);
const WINDOW: About = About::Thing(Thing::Window);

/// Every operation by its id: the scope that it needs, and what it is about. Those that need none hold no
/// data.
const OPERATIONS: &[(&str, Option<Scope>, About)] = &[
    ("healthz", None, Several),
    ("readyz", None, Several),
    ("version", None, Several),
    ("openapi", None, Several),
    ("openapi_as_json", None, Several),
    ("get_docs", None, Several),
    ("get_docs_file", None, Several),
    ("get_language", None, Several),
    ("get_metrics", Some(Read), Several),
    ("list_params", Some(Read), Several),
    ("get_params", Some(Read), Several),
    ("get_history", Some(Read), System),
    ("put_pin", Some(Operate), System),
    ("delete_pin", Some(Operate), System),
    ("list_systems", Some(Read), Several),
    ("get_system", Some(Read), System),
    ("put_system", Some(Admin), System),
    ("delete_system", Some(Admin), System),
    ("get_state", Some(Read), System),
    ("get_forecast", Some(Read), System),
    ("post_forecast", Some(Read), System),
    ("get_forecast_inputs", Some(Read), System),
    ("post_experiments", Some(Read), System),
    ("get_forecast_scores", Some(Read), System),
    ("get_model_in_force", Some(Read), System),
    ("get_linearisation", Some(Read), System),
    ("post_linearisation", Some(Read), System),
    ("get_ladder", Some(Read), System),
    ("get_evidence", Some(Read), System),
    ("get_changes", Some(Read), System),
    ("get_matrix", Some(Read), Several),
    ("get_series", Some(Read), System),
    ("list_windows", Some(Read), System),
    ("post_window", Some(Operate), System),
    ("post_samples", Some(Operate), System),
    ("post_many_samples", Some(Operate), Several),
    ("get_window", Some(Read), WINDOW),
    ("delete_window", Some(Admin), WINDOW),
    ("write_lines", Some(Operate), Lines),
    ("write_lines_v2", Some(Operate), Lines),
    ("ping", None, Several),
    ("get_influx", Some(Admin), Several),
    ("put_influx", Some(Admin), Several),
    ("get_prometheus", Some(Admin), Several),
    ("put_prometheus", Some(Admin), Several),
    ("propose_layout", Some(Read), Several),
    ("recognise_window", Some(Read), Several),
    ("list_models", Some(Read), Several),
    ("get_model", Some(Read), Several),
    ("get_equations", Some(Read), Several),
    ("validate_model", Some(Read), Several),
    ("preview_model", Some(Read), Several),
    ("post_model", Some(Admin), Several),
    ("post_model_effect", Some(Admin), Several),
    ("list_effects", Some(Read), Several),
    ("get_effect", Some(Read), Several),
    ("post_effect", Some(Admin), Several),
    ("list_jobs", Some(Read), Several),
    ("count_jobs", Some(Read), Several),
    ("post_job", Some(Operate), Several),
    ("get_job", Some(Read), JOB),
    ("get_job_events", Some(Read), JOB),
    ("get_events", Some(Read), Several),
    ("cancel_job", Some(Operate), JOB),
    ("retry_job", Some(Operate), JOB),
    ("list_batches", Some(Read), Several),
    ("get_batch", Some(Read), Batch),
    ("list_nights", Some(Read), Several),
    ("get_night", Some(Read), Several),
    ("list_fits", Some(Read), Several),
    ("get_fit", Some(Read), FIT),
    ("get_covariance", Some(Read), FIT),
    ("get_fit_model", Some(Read), FIT),
    ("get_comparison", Some(Read), FIT),
    ("get_compare", Some(Read), Several),
    ("get_diagnostics", Some(Read), FIT),
    ("get_missing_heat", Some(Read), FIT),
    ("get_proposals", Some(Read), FIT),
    ("promote_fit", Some(Operate), FIT),
    ("reject_fit", Some(Operate), FIT),
    ("list_diagnoses", Some(Read), Several),
    ("get_diagnosis", Some(Read), DIAGNOSIS),
    ("get_missing_heat_of_diagnosis", Some(Read), DIAGNOSIS),
    ("list_audit", Some(Read), Several),
    ("list_schedules", Some(Read), Several),
    ("get_schedule", Some(Read), Schedule),
    ("preview_schedule", Some(Read), Schedule),
    ("put_schedule", Some(Operate), Schedule),
    ("delete_schedule", Some(Operate), Schedule),
    ("run_schedule", Some(Operate), Schedule),
];

/// Every operation that is declared, by its id, for the tests of the description.
pub fn declared_operations() -> impl Iterator<Item = &'static str> {
    OPERATIONS.iter().map(|(id, ..)| *id)
}

/// What an operation needs, and what it is about.
type Declared = (Option<Scope>, About);

/// What an operation needs, and what it is about. One that nobody has declared, which a test forbids, is for
/// administrators.
pub fn declared(operation: &str) -> Declared {
    let found = OPERATIONS.iter().find(|(id, _, _)| *id == operation);
    found.map_or((Some(Admin), Several), |(_, scope, about)| (*scope, *about))
}

/// Whoever sends a request.
#[derive(Debug, Clone)]
pub struct Caller {
    /// The token, where there are any.
    token: Option<Arc<TokenRecord>>,
}

impl Caller {
    /// Under which name it acts: that of the token, or [`LOCAL`].
    pub fn name(&self) -> &str {
        self.token.as_ref().map_or(LOCAL, |token| &token.name)
    }

    /// The systems that it may see.
    pub fn reach(&self) -> &SystemScope {
        self.token.as_ref().map_or(&SystemScope::ALL, |token| &token.reach)
    }

    /// Whether it may see the system of a name.
    pub fn may_see(&self, system: &str) -> bool {
        self.reach().is_all() || system.parse().is_ok_and(|system| self.reach().covers(&system))
    }

    /// Refuses a body that names a system beyond its reach as one that is not there. Who may see some systems
    /// only is told no name that is like it: it might be one of the others.
    pub fn may_name(&self, service: &Service, body: &Value) -> Result<(), ApiError> {
        let Some(system) =
            body.get("system").and_then(Value::as_str).and_then(|text| text.parse::<SystemId>().ok())
        else {
            return Ok(());
        };
        if self.reach().is_all()
            || (self.reach().covers(&system) && service.params.slot(&system.to_string()).is_some())
        {
            return Ok(());
        }
        Err(ApiError::Invalid(vec![Fault::new(
            "/system",
            "system-not-found",
            format!("there is no system `{system}`"),
        )]))
    }

    /// Refuses patterns that select more systems than it may see.
    pub fn may_select(&self, patterns: &[SystemPattern]) -> Result<(), ApiError> {
        match self.reach().beyond(patterns) {
            None => Ok(()),
            Some(pattern) => Err(ApiError::OutOfReach(pattern.clone())),
        }
    }
}

impl FromRequestParts<Shared> for Caller {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &Shared) -> Result<Self, ApiError> {
        parts
            .extensions
            .get::<Self>()
            .cloned()
            .ok_or_else(|| ApiError::Internal("a request has passed the guard by".into()))
    }
}

/// What the guard knows: the service, and every operation by path and method.
#[derive(Debug, Clone)]
pub struct Gate {
    service: Shared,
    operations: Arc<HashMap<String, HashMap<&'static str, Declared>>>,
}

impl Gate {
    /// The guard of these operations, each with its path and method.
    pub fn new(
        service: Shared,
        operations: impl IntoIterator<Item = (String, &'static str, String)>,
    ) -> Self {
        let mut known: HashMap<String, HashMap<_, _>> = HashMap::new();
        for (path, method, id) in operations {
            known.entry(path).or_default().insert(method, declared(&id));
        }
        Self { service, operations: Arc::new(known) }
    }

    /// What the operation of a request needs, and what it is about.
    fn asked(&self, request: &Request) -> Declared {
        let path = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str).unwrap_or_default();
        let method = if request.method() == Method::HEAD { "GET" } else { request.method().as_str() };
        let found = self.operations.get(path).and_then(|methods| methods.get(method));
        // A method that a path does not know is refused further in, to those who may ask at all.
        found.copied().unwrap_or((Some(Read), Several))
    }
}

/// Lets a request through to its operation, or says why not.
pub(crate) async fn guard(State(gate): State<Gate>, request: Request, next: Next) -> Response {
    let asked = gate.asked(&request);
    admitted(&gate.service, asked, request, |caller, mut request| {
        request.extensions_mut().insert(caller);
        next.run(request)
    })
    .await
}

/// The answer to a request, if its caller may have one. Whoever reads on and on hears no more when the token
/// ends.
pub(crate) async fn admitted<F: Future<Output = Response>>(
    service: &Shared,
    asked: Declared,
    request: Request,
    answer: impl FnOnce(Caller, Request) -> F,
) -> Response {
    let (mut parts, body) = request.into_parts();
    let caller = match admit(service, asked, &mut parts).await {
        Ok(caller) => caller,
        Err(error) if asked.1 == Lines => return InfluxRefusal::from(error).into_response(),
        Err(error) => return error.into_response(),
    };
    let waits = parts.method == Method::GET;
    let token = caller.token.clone();
    let answer = answer(caller, Request::from_parts(parts, body));
    // What changes something is done to its end.
    let Some(token) = token.filter(|_| waits) else {
        return answer.await;
    };
    let response = tokio::select! {
        // An answer that is there at once is not timed against the token.
        biased;
        response = answer => response,
        () = service.tokens.end_of(&token) => return ApiError::Unauthorized("the token has ended").into_response(),
    };
    if response.headers().get(header::CONTENT_TYPE).is_none_or(|kind| kind != "text/event-stream") {
        return response;
    }
    let service = service.clone();
    response.map(|body| {
        let ended = async move { service.tokens.end_of(&token).await };
        Body::from_stream(Until { stream: body.into_data_stream(), ended: Box::pin(ended) })
    })
}

async fn admit(service: &Shared, (needed, about): Declared, parts: &mut Parts) -> Result<Caller, ApiError> {
    let Some(needed) = needed else { return Ok(Caller { token: None }) };
    let hosts = &service.settings.hosts;
    origin::require_own_page(parts, hosts)?;
    if about != Lines {
        origin::require_own_body(parts)?;
    }
    let place = parts.extensions.get::<Arc<Connection>>();
    let peer = place.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |place| place.peer());
    let shown = match about {
        Lines => dialect::token(parts),
        _ => shown(&parts.headers).map(Cow::Borrowed),
    };
    let token = match service.tokens.judge(shown.as_deref(), peer) {
        // A foreign page has no token to show; where none is needed, the name that it asks by gives it away.
        TokenCheck::Open => {
            origin::require_own_name(parts, hosts)?;
            return Ok(Caller { token: None });
        }
        TokenCheck::Known(token) => {
            if let Some(place) = place {
                place.show(token.hash);
            }
            token
        }
        TokenCheck::Missing => return Err(ApiError::Unauthorized("send a token: `Authorization: Bearer …`")),
        TokenCheck::Unknown => return Err(ApiError::Unauthorized("nobody knows this token")),
        TokenCheck::Ended("expired") => return Err(ApiError::Unauthorized("the token has expired")),
        TokenCheck::Ended(_) => return Err(ApiError::Unauthorized("the token was revoked")),
        TokenCheck::TooMany => return Err(ApiError::TooManyFailures),
    };
    if !token.scope.includes(needed) {
        return Err(ApiError::Forbidden { needed, token: token.name.clone(), has: token.scope });
    }
    let caller = Caller { token: Some(token) };
    if !caller.reach().is_all() {
        Box::pin(reaches(service, caller.reach(), about, parts)).await?;
    }
    Ok(caller)
}

/// The token of a request. The name of the scheme is written as one likes (RFC 9110, 11.1).
fn shown(headers: &HeaderMap) -> Option<&str> {
    let (scheme, token) = headers.get(header::AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// Answers for what lies beyond a reach as if it were not there. What is not there at all is for the handler
/// to say.
async fn reaches(
    service: &Shared,
    reach: &SystemScope,
    about: About,
    parts: &mut Parts,
) -> Result<(), ApiError> {
    if about == Several || about == Lines {
        return Ok(());
    }
    let Ok(Path(names)) = Path::<HashMap<String, String>>::from_request_parts(parts, service).await else {
        return Err(ApiError::NoSuchPath);
    };
    let name = |field: &str| names.get(field).map(String::as_str).unwrap_or_default();
    let hidden = |what: &'static str, which: &str| Err(ApiError::NotFound(what, which.to_owned()));
    match about {
        Several | Lines => Ok(()),
        System => match SystemId::new(name("kind"), name("id")) {
            Ok(system) if !reach.covers(&system) => hidden("system", &system.to_string()),
            _ => Ok(()),
        },
        About::Thing(thing) => match store::systems::of(&service.store, thing, name("id")).await? {
            Some(system) if !reach.covers(&system) => hidden(thing.as_str(), name("id")),
            _ => Ok(()),
        },
        Batch => match store::batches::request(&service.store, name("id")).await? {
            Some(request) if !within(reach, &request) => hidden("batch", name("id")),
            _ => Ok(()),
        },
        Schedule => match store::schedules::get(&service.store, name("name")).await? {
            Some(schedule) if !within(reach, &schedule.request) => hidden("schedule", name("name")),
            _ => Ok(()),
        },
    }
}

/// Whether all systems that a request of several may select lie within a reach.
pub fn within(reach: &SystemScope, request: &Value) -> bool {
    let patterns = serde_json::from_value::<Vec<SystemPattern>>(request["systems"].clone());
    reach.is_all() || patterns.is_ok_and(|patterns| reach.beyond(&patterns).is_none())
}

/// A stream that ends when something happens.
struct Until<S, F> {
    stream: S,
    ended: F,
}

impl<S: Stream + Unpin, F: Future<Output = ()> + Unpin> Stream for Until<S, F> {
    type Item = S::Item;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<S::Item>> {
        match Pin::new(&mut self.ended).poll(context) {
            Poll::Ready(()) => Poll::Ready(None),
            Poll::Pending => Pin::new(&mut self.stream).poll_next(context),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_token_is_read_as_the_standard_says() {
        let shown = |text: &str| {
            let headers = HeaderMap::from_iter([(header::AUTHORIZATION, text.parse().unwrap())]);
            shown(&headers).map(str::to_owned)
        };
        assert_eq!((shown("Bearer abc"), shown("bearer  abc ")), (Some("abc".into()), Some("abc".into())));
        assert_eq!((shown("Basic abc"), shown("abc"), shown("Bearer")), (None, None, None));
    }
}
