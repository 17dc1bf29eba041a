//! What the controller asks for: 200 use these, 304 keep yours, 404 use your own baseline.
//!
//! The handlers answer from the snapshot. No layer lies around them but the guard: no trace, no compression,
//! no time-out.

use super::access::Caller;
use super::conditions::is_known;
use super::problem::{ApiError, Problems};
use super::shared::{Shared, shared_body};
use crate::service::serving::body::{Body as ParamsBody, Rendered, tag_of};
use crate::service::serving::snapshot::{Answer, Entry};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use lampyris_core::fault::Fault;
use std::sync::Arc;
use std::time::Duration;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The longest that a client may wait for news, in seconds.
const LONGEST_WAIT: u64 = 60;
/// Where the name of the system begins in the path.
const PREFIX: &str = "/params/";

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
    let response = poll(&service, request).await;
    service.metrics.polls.count(response.status().as_u16());
    response
}

async fn poll(service: &Shared, request: Request) -> Response {
    let system = request.uri().path().get(PREFIX.len()..).unwrap_or_default();
    let Some(slot) = service.params.slot(system) else {
        return ApiError::NotFound("system", system.to_owned()).into_response();
    };
    let accept = match accept(request.uri().query()) {
        Ok(accept) => accept,
        Err(error) => return error.into_response(),
    };
    let headers = request.headers();
    let wait = headers.get("prefer").and_then(wait);
    // Interest is registered before the entry is read, so that news that comes in between is not missed.
    let mut news = wait.map(|seconds| (slot.watch(), Duration::from_secs(seconds)));
    let entry = slot.entry();
    let Some((news, patience)) = news.as_mut().filter(|_| is_old(&entry, accept, headers)) else {
        return answer(&entry, system, accept, headers);
    };
    let mut stopping = service.stopping.subscribe();
    let told = async {
        // An event may leave this client's answer as it was, such as one job following another. A system that
        // was deleted has its place no more, also where another one of its name has come.
        let stands = || service.params.slot(system).is_some_and(|now| Arc::ptr_eq(&now, &slot));
        while news.changed().await.is_ok() && stands() && is_old(&slot.entry(), accept, headers) {}
    };
    tokio::select! {
        () = told => {}
        () = tokio::time::sleep(*patience) => {}
        _ = stopping.wait_for(|stopping| *stopping) => {}
    }
    match service.params.slot(system) {
        Some(slot) => answer(&slot.entry(), system, accept, headers),
        None => ApiError::NotFound("system", system.to_owned()).into_response(),
    }
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
async fn list_params(
    State(service): State<Shared>,
    caller: Caller,
    uri: Uri,
    headers: HeaderMap,
) -> Response {
    if uri.query().is_some_and(|query| !query.is_empty()) {
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
    let response =
        if is_known(&headers, &etag) { not_modified(&etag) } else { tagged(Body::from(body), &etag) };
    service.metrics.all_polls.count(response.status().as_u16());
    response
}

/// What the query accepts. It has one field, and this path is the busiest of all, so it is read by hand.
fn accept(query: Option<&str>) -> Result<Option<Accept>, ApiError> {
    match query {
        None | Some("") => Ok(None),
        Some("accept=nominal") => Ok(Some(Accept::Nominal)),
        Some("accept=fresh") => Ok(Some(Accept::Fresh)),
        Some(_) => {
            let fault = Fault::new(
                "query",
                "invalid-query",
                "the query is empty, `accept=nominal` or `accept=fresh`",
            );
            Err(ApiError::Invalid(vec![fault]))
        }
    }
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
                let pending = latest_job.as_ref().is_some_and(|(_, state)| !state.is_final());
                let latest_job = latest_job.as_ref().map(|(id, _)| id.clone());
                ApiError::NeverValidated { system: system.to_owned(), latest_job, pending }.into_response()
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

/// How long a client is ready to wait, in seconds, by its `Prefer` (RFC 7240): names are written as one
/// likes, and values may be quoted.
fn wait(prefer: &HeaderValue) -> Option<u64> {
    let pairs = prefer.to_str().ok()?.split([',', ';']).filter_map(|part| part.split_once('='));
    let (_, seconds) = pairs.into_iter().find(|(name, _)| name.trim().eq_ignore_ascii_case("wait"))?;
    seconds.trim().trim_matches('"').parse::<u64>().ok().map(|seconds| seconds.min(LONGEST_WAIT))
}

fn not_modified(etag: &str) -> Response {
    let mut response = StatusCode::NOT_MODIFIED.into_response();
    set_tag(&mut response, etag);
    response
}

fn tagged(body: Body, etag: &str) -> Response {
    let mut response = Response::new(body);
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    set_tag(&mut response, etag);
    response
}

fn set_tag(response: &mut Response, etag: &str) {
    if let Ok(value) = HeaderValue::from_str(etag) {
        response.headers_mut().insert(header::ETAG, value);
    }
    // A cache may keep the body, but must ask whether it still holds.
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preferences_are_read_as_the_standard_says() {
        let wait_of = |text: &'static str| wait(&HeaderValue::from_static(text));
        assert_eq!(
            (wait_of("wait=30"), wait_of("respond-async, wait=5"), wait_of("wait=9999")),
            (Some(30), Some(5), Some(60))
        );
        assert_eq!(
            (wait_of("Wait=30"), wait_of("WAIT = \"5\""), wait_of("handling=strict; x=y, wait=7")),
            (Some(30), Some(5), Some(7))
        );
        assert_eq!((wait_of("wait=soon"), wait_of("respond-async")), (None, None));
    }
}
