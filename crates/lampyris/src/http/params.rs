//! What the controller asks for: 200 use these, 304 keep yours, 404 use your own baseline.
//!
//! The handlers answer from the snapshot. No layer lies around them: no trace, no compression, no time-out,
//! and they ask the guard themselves.

use super::access::{Caller, admitted, declared};
use super::conditions::{is_known, not_modified, set_tag, unless_known};
use super::problem::{ApiError, Problems};
use super::shared::{Shared, shared_body};
use super::waiting::newest;
use crate::service::serving::body::{Body as ParamsBody, Rendered, tag_of};
use crate::service::serving::snapshot::{Answer, Entry};
use crate::store;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::IF_NONE_MATCH;
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use lampyris_core::fault::Fault;
use serde_json::Value;
use std::collections::BTreeSet;
use std::time::Duration;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Where the name of the system begins in the path.
const PREFIX: &str = "/params/";
/// How long an answer waits for the database at most.
const READ_THROUGH: Duration = Duration::from_secs(1);

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_params)).routes(routes!(list_params))
}

/// What a client accepts beside a validated set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = AcceptedParams)]
enum Accept {
    /// Nominal values, if nothing was ever validated.
    Nominal,
    /// Fresh ones only.
    Fresh,
}

/// What a client wants beside the set itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = MoreParams)]
enum More {
    /// The covariance of the estimates.
    Covariance,
}

/// The parameters of a system.
///
/// The body changes at events only. `If-None-Match` with the tag of the last answer gives 304; with
/// `Prefer: wait=N` the answer waits up to N seconds (60 at most) for news.
#[utoipa::path(
    get,
    path = "/params/{kind}/{id}",
    tag = "params",
    params(
        ("kind" = String, Path, description = "Kind of the system", example = "room"),
        ("id" = String, Path, description = "Id of the system", example = "4"),
        ("accept" = inline(Option<Accept>), Query, description = "`nominal`: the model's nominal values \
            where nothing was ever validated; `fresh`: 404 rather than a stale set"),
        ("with" = inline(Option<More>), Query, description = "`covariance`: how the estimates err together \
            as well, under a tag of its own and without waiting for news"),
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: wait up to N seconds for news"),
    ),
    responses(
        (
            status = 200,
            description = "Use these",
            body = ParamsBody,
            headers(("ETag" = String), ("Params-Status" = String))
        ),
        (status = 304, description = "Keep yours"),
        (
            status = 404,
            description = "Use your own baseline",
            body = super::problem::Problem,
            content_type = "application/problem+json"
        ),
        Problems,
    )
)]
async fn get_params(State(service): State<Shared>, request: Request) -> Response {
    polled(&service, request).await
}

/// Whether a request is a poll of one system, which needs no router to be found.
pub fn is_poll(parts: &Parts) -> bool {
    let names = parts.uri.path().strip_prefix(PREFIX).and_then(|system| system.split_once('/'));
    let is_name = |text: &str| !text.is_empty() && !text.contains('/');
    parts.method == Method::GET && names.is_some_and(|(kind, id)| is_name(kind) && is_name(id))
}

/// The answer to a poll of one system.
pub(crate) async fn polled(service: &Shared, request: Request) -> Response {
    let asked = declared("get_params");
    let response = admitted(service, asked, request, |caller, request| poll(service, caller, request)).await;
    service.metrics.polls.count(response.status().as_u16());
    response
}

async fn poll(service: &Shared, caller: Caller, request: Request) -> Response {
    let system = request.uri().path().get(PREFIX.len()..).unwrap_or_default();
    if !caller.may_see(system) {
        return ApiError::NotFound("system", system.to_owned()).into_response();
    }
    // What few ask for is kept apart: an answer is moved as a whole, with all that it might wait for.
    if service.store.is_shared() {
        Box::pin(read_through(service, system, request.headers())).await;
    }
    let Some(slot) = service.params.slot(system) else {
        return ApiError::NotFound("system", system.to_owned()).into_response();
    };
    let (accept, more) = match asked(request.uri().query()) {
        Ok(asked) => asked,
        Err(error) => return error.into_response(),
    };
    let headers = request.headers();
    if more.is_some() {
        let answer = Box::pin(with_covariance(service, &slot.entry(), system, accept, headers)).await;
        return answer.unwrap_or_else(IntoResponse::into_response);
    }
    match newest(service, system, slot, headers, |entry| is_old(entry, accept, headers)).await {
        Some(entry) => answer(&entry, system, accept, headers),
        None => ApiError::NotFound("system", system.to_owned()).into_response(),
    }
}

/// Looks into the database where a caller shows another tag than ours, or where there is nothing to answer
/// with yet: another service, which the caller has asked before, may know more by now.
async fn read_through(service: &Shared, system: &str, headers: &HeaderMap) {
    let shows_other =
        |rendered: &Rendered| headers.contains_key(IF_NONE_MATCH) && !is_known(headers, &rendered.etag);
    let is_behind = match service.params.slot(system) {
        Some(slot) => slot.entry().validated().is_none_or(shows_other),
        None => true,
    };
    let Some(system) = system.parse().ok().filter(|_| is_behind) else { return };
    // Where the database is away, what is known is the best that there is.
    let _ = tokio::time::timeout(READ_THROUGH, service.store.read_anew(BTreeSet::from([system]))).await;
}

/// The parameters of all systems that have validated ones, in one poll.
#[utoipa::path(
    get,
    path = "/params",
    tag = "params",
    responses(
        (status = 200, description = "All of them", body = super::page::Page<ParamsBody>),
        (status = 304, description = "Keep yours"),
        Problems
    )
)]
async fn list_params(State(service): State<Shared>, request: Request) -> Response {
    let asked = declared("list_params");
    let answer = async |caller, request| poll_all(&service, &caller, &request);
    let response = admitted(&service, asked, request, answer).await;
    service.metrics.all_polls.count(response.status().as_u16());
    response
}

fn poll_all(service: &Shared, caller: &Caller, request: &Request) -> Response {
    if request.uri().query().is_some_and(|query| !query.is_empty()) {
        let fault = Fault::new("query", "unknown-field", "this path knows no query");
        return ApiError::Invalid(vec![fault]).into_response();
    }
    let mut body = Vec::from(br#"{"items":["#.as_slice());
    let mut first = true;
    for (system, entry) in service.params.all() {
        let Some(rendered) = entry.validated().filter(|_| caller.may_see(&system)) else {
            continue;
        };
        if !std::mem::take(&mut first) {
            body.push(b',');
        }
        body.extend_from_slice(&rendered.body);
    }
    body.extend_from_slice(br#"],"next_page_token":null}"#);
    let etag = tag_of(&body);
    if is_known(request.headers(), &etag) { not_modified(&etag) } else { tagged(Body::from(body), &etag) }
}

/// What the query accepts, and what more it wants. This path is the busiest of all, so it is read by hand.
fn asked(query: Option<&str>) -> Result<(Option<Accept>, Option<More>), ApiError> {
    let (mut accept, mut more) = (None, None);
    for part in query.unwrap_or_default().split('&').filter(|part| !part.is_empty()) {
        let known = match part {
            "accept=nominal" => accept.replace(Accept::Nominal).is_none(),
            "accept=fresh" => accept.replace(Accept::Fresh).is_none(),
            "with=covariance" => more.replace(More::Covariance).is_none(),
            _ => false,
        };
        if !known {
            let detail = "the query has `accept=nominal` or `accept=fresh`, and `with=covariance`, each once";
            return Err(ApiError::Invalid(vec![Fault::new("query", "invalid-query", detail)]));
        }
    }
    Ok((accept, more))
}

/// A validated set with the covariance of its fit, under a tag of its own; without one where the fit has
/// none.
async fn with_covariance(
    service: &Shared,
    entry: &Entry,
    system: &str,
    accept: Option<Accept>,
    headers: &HeaderMap,
) -> Result<Response, ApiError> {
    let Some(rendered) = chosen(entry, accept).filter(|rendered| rendered.revision.is_some()) else {
        return Ok(answer(entry, system, accept, headers));
    };
    let internal = |error: serde_json::Error| ApiError::Internal(error.to_string());
    let mut body: serde_json::Map<String, Value> =
        serde_json::from_slice(&rendered.body).map_err(internal)?;
    let fit = body.get("fit").and_then(Value::as_str).unwrap_or_default();
    let record = store::fits::get(&service.store, fit).await?;
    if let Some(covariance) = record.and_then(|record| record.fit.covariance) {
        body.insert("covariance".to_owned(), serde_json::to_value(covariance).map_err(internal)?);
    }
    let body = serde_json::to_vec(&body).map_err(internal)?;
    let mut response = unless_known(headers, "application/json", body.into());
    response.headers_mut().insert("params-status", HeaderValue::from_static(rendered.status.as_str()));
    Ok(response)
}

/// The answer to a request for an entry.
fn answer(entry: &Entry, system: &str, accept: Option<Accept>, headers: &HeaderMap) -> Response {
    match chosen(entry, accept) {
        Some(rendered) if is_known(headers, &rendered.etag) => not_modified(&rendered.etag),
        Some(rendered) => {
            let mut response = tagged(shared_body(rendered.body.clone()), &rendered.etag);
            response
                .headers_mut()
                .insert("params-status", HeaderValue::from_static(rendered.status.as_str()));
            response
        }
        None => match &entry.answer {
            Answer::Validated(_) => ApiError::NotFresh(system.to_owned()).into_response(),
            Answer::NeverValidated { latest_job, .. } => {
                ApiError::never_validated(system.to_owned(), latest_job.as_ref()).into_response()
            }
        },
    }
}

/// What an entry has for a client, if it has anything.
fn chosen(entry: &Entry, accept: Option<Accept>) -> Option<&Rendered> {
    match (&entry.answer, accept) {
        (Answer::Validated(rendered), Some(Accept::Fresh)) if rendered.stale => None,
        (Answer::Validated(rendered), _) => Some(rendered),
        (Answer::NeverValidated { nominal, .. }, Some(Accept::Nominal)) => nominal.as_ref(),
        (Answer::NeverValidated { .. }, _) => None,
    }
}

/// Whether an entry is no news to a client: what it has, or nothing at all.
fn is_old(entry: &Entry, accept: Option<Accept>, headers: &HeaderMap) -> bool {
    chosen(entry, accept).is_none_or(|rendered| is_known(headers, &rendered.etag))
}

fn tagged(body: Body, etag: &str) -> Response {
    let mut response = Response::new(body);
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    set_tag(&mut response, etag);
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_poll_is_known_by_its_path() {
        let is = |method: &str, path: &str| {
            let request = axum::http::Request::builder().method(method).uri(path).body(()).unwrap();
            is_poll(&request.into_parts().0)
        };
        for path in ["/params/room/4", "/params/room/4?accept=fresh", "http://house/params/room/4"] {
            assert!(is("GET", path), "{path}");
        }
        for path in
            ["/params", "/params/", "/params/room", "/params/room/", "/params/room/4/history", "/params//4"]
        {
            assert!(!is("GET", path), "{path}");
        }
        assert!(!is("HEAD", "/params/room/4") && !is("PUT", "/params/room/4"));
    }
}
