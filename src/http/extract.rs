//! What handlers take out of a request. Every refusal is a problem document.

use super::Shared;
use super::problem::ApiError;
use crate::data::SystemId;
use crate::fault::Fault;
use crate::jobs::{blocking, decode};
use crate::store::idempotency::RequestKey;
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, header};
use serde::de::DeserializeOwned;
use serde_json::Value;

/// JSON beyond this size is parsed off the async threads.
const LARGE: usize = 64 << 10;
/// The longest idempotency key.
const LONGEST_KEY: usize = 255;

/// A JSON document, and the key of the request if it has one.
#[derive(Debug)]
pub struct Json {
    /// The document.
    pub value: Value,
    /// The client's `Idempotency-Key`.
    pub key: Option<RequestKey>,
}

/// A body of any type, and the key of the request if it has one.
#[derive(Debug)]
pub struct Raw {
    /// The body.
    pub body: Bytes,
    /// The media type without its parameters, in lower case.
    pub media_type: String,
    /// The client's `Idempotency-Key`.
    pub key: Option<RequestKey>,
}

/// No body, and the key of the request if it has one.
#[derive(Debug)]
pub struct Empty {
    /// The client's `Idempotency-Key`.
    pub key: Option<RequestKey>,
}

/// The query, of which every unknown field is a fault.
#[derive(Debug)]
pub struct Asked<T>(pub T);

/// The system that a path names.
#[derive(Debug)]
pub struct Named(pub SystemId);

impl FromRequest<Shared> for Json {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &Shared) -> Result<Self, ApiError> {
        if media_type(request.headers()) != "application/json" {
            return Err(ApiError::MediaType("application/json"));
        }
        let (parts, body) = request.into_parts();
        let body = read(&parts.headers, body, service.settings.limits.body_bytes).await?;
        let key = key(&parts, &body)?;
        let value = if body.len() > LARGE { blocking(move || decode::parse(&body)).await? } else { decode::parse(&body) };
        Ok(Self { value: value.map_err(ApiError::Malformed)?, key })
    }
}

impl FromRequest<Shared> for Raw {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &Shared) -> Result<Self, ApiError> {
        let media_type = media_type(request.headers());
        let (parts, body) = request.into_parts();
        let body = read(&parts.headers, body, service.settings.limits.window_bytes).await?;
        let key = key(&parts, &body)?;
        Ok(Self { body, media_type, key })
    }
}

impl FromRequest<Shared> for Empty {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &Shared) -> Result<Self, ApiError> {
        let (parts, body) = request.into_parts();
        let body = read(&parts.headers, body, service.settings.limits.body_bytes).await?;
        if !body.iter().all(u8::is_ascii_whitespace) && body.as_ref() != b"{}" {
            return Err(ApiError::Invalid(vec![Fault::new("", "unexpected-body", "this request has no body")]));
        }
        Ok(Self { key: key(&parts, &body)? })
    }
}

impl<T: DeserializeOwned> FromRequestParts<Shared> for Asked<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, service: &Shared) -> Result<Self, ApiError> {
        match Query::<T>::from_request_parts(parts, service).await {
            Ok(Query(asked)) => Ok(Self(asked)),
            Err(rejection) => {
                let text = rejection.body_text();
                let detail = text.split_once(": ").map_or(text.as_str(), |(_, detail)| detail);
                let detail: String = detail.chars().take(300).collect();
                Err(ApiError::Invalid(vec![Fault::new("query", "invalid-query", detail)]))
            }
        }
    }
}

impl FromRequestParts<Shared> for Named {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, service: &Shared) -> Result<Self, ApiError> {
        let Ok(Path((kind, id))) = Path::<(String, String)>::from_request_parts(parts, service).await else {
            return Err(ApiError::NoSuchPath);
        };
        match SystemId::new(&kind, &id) {
            Ok(system) => Ok(Self(system)),
            // Making a system with a name that cannot be is a fault of the request; asking for it is asking for nothing.
            Err(error) if parts.method == Method::PUT => {
                Err(ApiError::Invalid(vec![Fault::new("path", "invalid-system", error.to_string())]))
            }
            Err(_) => Err(ApiError::NotFound("system", format!("{kind}/{id}"))),
        }
    }
}

/// The media type of a body without its parameters.
fn media_type(headers: &HeaderMap) -> String {
    let text = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// Reads a body up to a limit, and none of it where its length says that it is too large.
async fn read(headers: &HeaderMap, body: Body, limit: usize) -> Result<Bytes, ApiError> {
    let said = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()).and_then(|text| text.parse::<u64>().ok());
    if said.is_some_and(|said| usize::try_from(said).map_or(true, |said| said > limit)) {
        return Err(ApiError::TooLarge(limit));
    }
    to_bytes(body, limit).await.map_err(|error| {
        let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(&error);
        while let Some(one) = cause {
            // The framework hides the type of this error; its words are part of its documentation.
            if one.to_string().contains("length limit exceeded") {
                return ApiError::TooLarge(limit);
            }
            cause = one.source();
        }
        ApiError::BrokenBody
    })
}

/// The client's key with the hash of what it asks: the same key for anything else is refused.
fn key(parts: &Parts, body: &[u8]) -> Result<Option<RequestKey>, ApiError> {
    let Some(value) = parts.headers.get("idempotency-key") else {
        return Ok(None);
    };
    let fault = |detail: &str| ApiError::Invalid(vec![Fault::new("header Idempotency-Key", "invalid-key", detail)]);
    let key = value.to_str().map_err(|_| fault("a key is made of visible ASCII characters"))?.trim();
    if key.is_empty() || key.len() > LONGEST_KEY {
        return Err(fault("a key has 1 to 255 characters"));
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update(parts.method.as_str().as_bytes()).update(b" ").update(parts.uri.path().as_bytes()).update(b"\n").update(body);
    Ok(Some(RequestKey { key: key.to_owned(), fingerprint: hasher.finalize().to_hex().to_string() }))
}
