//! What handlers take out of a request. Every refusal is a problem document.

use super::access::Caller;
use super::origin::media_type;
use super::places::{BodyPlace, Connection};
use super::problem::ApiError;
use super::shared::Shared;
use super::unpack::{self, Housed};
use crate::service::access::tokens::LOCAL;
use crate::service::blocking;
use crate::service::decode::{self, Unread};
use crate::store::idempotency::RequestKey;
use axum::body::{Body, Bytes};
use axum::extract::{FromRequest, FromRequestParts, MatchedPath, Path, Query, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use lampyris_core::data::SystemId;
use lampyris_core::fault::Fault;
use lampyris_core::model::spec::MAX_DOCUMENT;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio_stream::StreamExt;

/// JSON beyond this size is parsed off the async threads.
const LARGE: usize = 64 << 10;
/// This much of a body that is too large is read beyond its limit and thrown away: a client that is still
/// sending when the connection closes never hears why.
pub(super) const SPARE: usize = 1 << 20;
/// How long a client is listened to whose request is refused before its body has come.
const LINGER: Duration = Duration::from_secs(1);
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

/// A document that may be sent in TOML as well.
#[derive(Debug)]
pub struct JsonOrToml(pub Json);

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

/// A body that may be packed, unpacked.
#[derive(Debug)]
pub struct Packed(pub Bytes);

/// No body, and the key of the request if it has one.
#[derive(Debug)]
pub struct Empty {
    /// The client's `Idempotency-Key`.
    pub key: Option<RequestKey>,
}

/// The query, of which every fault is named.
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
        let body = read(&parts, body, service.settings.limits.body_bytes, service).await?;
        let key = key(&parts, &body)?;
        let value = if body.len() > LARGE {
            blocking(move || decode::parse(&body)).await?
        } else {
            decode::parse(&body)
        };
        Ok(Self { value: value.map_err(unread)?, key })
    }
}

impl FromRequest<Shared> for JsonOrToml {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &Shared) -> Result<Self, ApiError> {
        match media_type(request.headers()).as_str() {
            "application/json" => Json::from_request(request, service).await.map(Self),
            "application/toml" => {
                let (parts, body) = request.into_parts();
                let body = read(&parts, body, MAX_DOCUMENT, service).await?;
                let key = key(&parts, &body)?;
                let value = decode::parse_toml(&body).map_err(ApiError::Malformed)?;
                Ok(Self(Json { value, key }))
            }
            _ => Err(ApiError::MediaType("application/json or application/toml")),
        }
    }
}

impl FromRequest<Shared> for Raw {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &Shared) -> Result<Self, ApiError> {
        let media_type = media_type(request.headers());
        let (parts, body) = request.into_parts();
        let body = read(&parts, body, service.settings.limits.window_bytes, service).await?;
        let key = key(&parts, &body)?;
        Ok(Self { body, media_type, key })
    }
}

impl FromRequest<Shared> for Packed {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &Shared) -> Result<Self, ApiError> {
        let (parts, body) = request.into_parts();
        let limit = service.settings.limits.window_bytes;
        match encoding(&parts.headers) {
            None => read(&parts, body, limit, service).await.map(Self),
            Some(b"gzip" | b"x-gzip") => {
                let body = read_packed(&parts, body, limit, service).await?;
                let place = parts.extensions.get::<Arc<Connection>>().cloned().map(Connection::body);
                blocking(move || unpack::gzip(&body, limit, place)).await?.map(Self)
            }
            Some(_) => Err(ApiError::Encoded),
        }
    }
}

impl FromRequest<Shared> for Empty {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &Shared) -> Result<Self, ApiError> {
        let (parts, body) = request.into_parts();
        let body = read(&parts, body, service.settings.limits.body_bytes, service).await?;
        if !body.iter().all(u8::is_ascii_whitespace) && body.as_ref() != b"{}" {
            return Err(ApiError::Invalid(vec![Fault::new(
                "",
                "unexpected-body",
                "this request has no body",
            )]));
        }
        Ok(Self { key: key(&parts, &body)? })
    }
}

impl<T: DeserializeOwned> FromRequestParts<Shared> for Asked<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &Shared) -> Result<Self, ApiError> {
        let mut faults = Vec::new();
        let mut fields = Map::new();
        for (name, text) in pairs(parts)? {
            if fields.contains_key(&name) {
                faults.push(Fault::new(
                    format!("/{name}"),
                    "duplicate-field",
                    "the name is there twice, and only one can be meant",
                ));
            }
            fields.insert(name, text.into());
        }
        match self::fields(fields) {
            Ok(asked) if faults.is_empty() => Ok(Self(asked)),
            asked => {
                faults.extend(asked.err().into_iter().flatten());
                Err(ApiError::Invalid(faults.into_iter().map(in_query).collect()))
            }
        }
    }
}

/// Reads the fields of a query. They are texts; where a number or a truth value is wanted, the text is read
/// as one.
fn fields<T: DeserializeOwned>(mut fields: Map<String, Value>) -> Result<T, Vec<Fault>> {
    let faults = match decode::decode(Value::Object(fields.clone())) {
        Ok(read) => return Ok(read),
        Err(faults) => faults,
    };
    let mut is_another = false;
    for fault in faults.iter().filter(|fault| fault.code == "wrong-type") {
        if let Some(field) = fields.get_mut(fault.pointer.trim_start_matches('/'))
            && let Some(Ok(value @ (Value::Number(_) | Value::Bool(_)))) =
                field.as_str().map(|text| decode::parse(text.as_bytes()))
        {
            *field = value;
            is_another = true;
        }
    }
    if is_another { decode::decode(Value::Object(fields)) } else { Err(faults) }
}

impl FromRequestParts<Shared> for Named {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, service: &Shared) -> Result<Self, ApiError> {
        let Ok(Path((kind, id))) = Path::<(String, String)>::from_request_parts(parts, service).await else {
            return Err(ApiError::NoSuchPath);
        };
        match SystemId::new(&kind, &id) {
            Ok(system) => Ok(Self(system)),
            // Making a system with a name that cannot be is a fault of the request; asking for it is asking
            // for nothing.
            Err(error) if parts.method == Method::PUT => {
                Err(ApiError::Invalid(vec![Fault::new("path", "invalid-system", error.to_string())]))
            }
            Err(_) => Err(ApiError::NotFound("system", format!("{kind}/{id}"))),
        }
    }
}

/// The form of an answer that a client wants most (RFC 9110, 12.5.1); the first one where it does not say.
///
/// # Errors
/// 406 where it accepts none of them.
pub fn accepted(headers: &HeaderMap, forms: &'static [&'static str]) -> Result<&'static str, ApiError> {
    let texts: Vec<&str> =
        headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).collect();
    if texts.iter().all(|text| text.trim().is_empty()) {
        return forms.first().copied().ok_or(ApiError::NotAcceptable(forms));
    }
    let ranges: Vec<(&str, f32)> = texts.iter().flat_map(|text| text.split(',')).map(weighted).collect();
    // The most specific range that names a form decides on it.
    let weight = |form: &str| {
        let group = form.split('/').next().unwrap_or_default();
        let of = |wanted: &dyn Fn(&str) -> bool| {
            ranges.iter().find(|(range, _)| wanted(range)).map(|(_, weight)| *weight)
        };
        let exact = of(&|range| range.eq_ignore_ascii_case(form));
        exact
            .or_else(|| {
                of(&|range| range.strip_suffix("/*").is_some_and(|of| of.eq_ignore_ascii_case(group)))
            })
            .or_else(|| of(&|range| range == "*/*"))
    };
    let mut best = (0.0, None);
    for form in forms {
        let weight = weight(form).unwrap_or(0.0);
        if weight > best.0 {
            best = (weight, Some(*form));
        }
    }
    best.1.ok_or(ApiError::NotAcceptable(forms))
}

/// A word of a list with its weight (RFC 9110, 12.4.2): `text/csv;q=0.5`.
pub(super) fn weighted(text: &str) -> (&str, f32) {
    let mut parts = text.split(';').map(str::trim);
    let range = parts.next().unwrap_or_default();
    let weight = parts.find_map(|part| part.strip_prefix("q=").or_else(|| part.strip_prefix("Q=")));
    (range, weight.map_or(1.0, |weight| weight.parse().unwrap_or(0.0)))
}

/// Why a body is no document.
pub(super) fn unread(error: Unread) -> ApiError {
    match error {
        Unread::Malformed(fault) => ApiError::Malformed(fault),
        Unread::Repeated(faults) => ApiError::Invalid(faults),
    }
}

/// Reads a body up to a limit of bytes, and of time.
async fn read(parts: &Parts, body: Body, limit: usize, service: &Shared) -> Result<Bytes, ApiError> {
    // What unpacks to a thousand times its size is refused before anything is unpacked.
    if encoding(&parts.headers).is_some() {
        return Err(ApiError::Encoded);
    }
    read_packed(parts, body, limit, service).await
}

/// How a body is packed, where it is.
fn encoding(headers: &HeaderMap) -> Option<&[u8]> {
    let encoding = headers.get(header::CONTENT_ENCODING)?.as_bytes();
    (!encoding.eq_ignore_ascii_case(b"identity")).then_some(encoding)
}

/// Reads a body as it was sent, up to a limit of bytes, and of time.
async fn read_packed(parts: &Parts, body: Body, limit: usize, service: &Shared) -> Result<Bytes, ApiError> {
    let headers = &parts.headers;
    let declared =
        headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<usize>().ok());
    if declared.is_some_and(|length| length > limit) {
        // Who asks before sending has nothing under way; whoever is sending is listened to for a moment, to
        // hear the answer.
        if !headers.contains_key(header::EXPECT) {
            linger(body, limit.saturating_add(SPARE)).await;
        }
        return Err(ApiError::TooLarge(limit));
    }
    let patience = Duration::from_secs(service.settings.limits.body_seconds);
    let place = parts.extensions.get::<Arc<Connection>>().cloned().map(Connection::body);
    tokio::time::timeout(patience, collect(body, limit, place))
        .await
        .unwrap_or(Err(ApiError::SlowBody(patience.as_secs())))
}

/// Throws away what comes, for a moment, up to so many bytes.
pub(super) async fn linger(body: Body, most: usize) {
    let mut parts = body.into_data_stream();
    let mut length = 0;
    let drain = async {
        while let Some(Ok(part)) = parts.next().await {
            length += part.len();
            if length > most {
                break;
            }
        }
    };
    // What takes longer stays unread.
    let _ = tokio::time::timeout(LINGER, drain).await;
}

/// Reads a body to its end, or until it is clear that it is too large, or that there is no room for it. No
/// more than the limit is ever kept.
async fn collect(body: Body, limit: usize, mut place: Option<BodyPlace>) -> Result<Bytes, ApiError> {
    let mut parts = body.into_data_stream();
    let mut kept = Vec::new();
    let mut length = 0;
    while let Some(part) = parts.next().await {
        let part = part.map_err(|_| ApiError::BrokenBody)?;
        length += part.len();
        if length <= limit {
            if place.as_mut().is_some_and(|place| !place.grow(part.len())) {
                return Err(ApiError::TooMuchAtOnce);
            }
            kept.extend_from_slice(&part);
        } else if length > limit.saturating_add(SPARE) {
            break;
        } else {
            kept = Vec::new();
        }
    }
    if length > limit {
        return Err(ApiError::TooLarge(limit));
    }
    Ok(Housed::bytes(kept, place))
}

/// The client's key with the hash of what it asks: the same key for anything else is refused. Every token has
/// keys of its own, so that nobody learns which ones others have used.
fn key(parts: &Parts, body: &[u8]) -> Result<Option<RequestKey>, ApiError> {
    let Some(value) = parts.headers.get("idempotency-key") else {
        return Ok(None);
    };
    let fault =
        |detail: &str| ApiError::Invalid(vec![Fault::new("header Idempotency-Key", "invalid-key", detail)]);
    let key = value
        .to_str()
        .ok()
        .filter(|key| !key.contains('\t'))
        .ok_or_else(|| fault("a key is made of visible ASCII characters"))?
        .trim();
    if key.is_empty() || key.len() > LONGEST_KEY {
        return Err(fault("a key has 1 to 255 characters"));
    }
    let mut hasher = blake3::Hasher::new();
    hasher
        .update(parts.method.as_str().as_bytes())
        .update(b" ")
        .update(parts.uri.path().as_bytes())
        .update(b"\n")
        .update(body);
    let key = match parts.extensions.get::<Caller>().map(Caller::name) {
        Some(name) if name != LOCAL => format!("{name}\t{key}"),
        _ => key.to_owned(),
    };
    Ok(Some(RequestKey { key, fingerprint: hasher.finalize().to_hex().to_string() }))
}

/// Refuses a query where the description of the path knows none.
pub(crate) async fn refuse_unknown(
    State(asking): State<Arc<BTreeSet<(String, &'static str)>>>,
    request: Request,
    next: Next,
) -> Response {
    let (parts, body) = request.into_parts();
    if parts.uri.query().is_some_and(|query| !query.is_empty()) {
        let method = if parts.method == Method::HEAD { "GET" } else { parts.method.as_str() };
        let path = parts.extensions.get::<MatchedPath>().map(MatchedPath::as_str).unwrap_or_default();
        if !asking.iter().any(|(known, with)| known == path && *with == method) {
            return match pairs(&parts) {
                Ok(pairs) => ApiError::Invalid(pairs.into_iter().map(|(name, _)| unknown(&name)).collect())
                    .into_response(),
                Err(error) => error.into_response(),
            };
        }
    }
    next.run(Request::from_parts(parts, body)).await
}

/// A query that a path does not know.
pub fn unknown(name: &str) -> Fault {
    let name: String = name.chars().take(60).collect();
    in_query(Fault::new(format!("/{name}"), "unknown-field", "this path knows no query"))
}

fn pairs(parts: &Parts) -> Result<Vec<(String, String)>, ApiError> {
    let Query(pairs) = Query::try_from_uri(&parts.uri)
        .map_err(|error| ApiError::Invalid(vec![Fault::new("query", "invalid-query", error.body_text())]))?;
    Ok(pairs)
}

/// The same fault, with its place as a client sees it.
fn in_query(fault: Fault) -> Fault {
    let name = fault.pointer.trim_start_matches('/');
    Fault { pointer: if name.is_empty() { "query".to_owned() } else { format!("query {name}") }, ..fault }
}

#[cfg(test)]
mod tests {
    use super::{HeaderMap, accepted, header};

    #[test]
    fn the_form_that_is_wanted_most_is_chosen() {
        const FORMS: &[&str] = &["application/json", "text/csv"];
        let chosen = |text: &str| {
            let headers = HeaderMap::from_iter([(header::ACCEPT, text.parse().unwrap())]);
            accepted(&headers, FORMS).ok()
        };
        let (json, csv) = (Some(FORMS[0]), Some(FORMS[1]));
        assert_eq!(accepted(&HeaderMap::new(), FORMS).ok(), json);
        assert_eq!(
            (chosen(""), chosen("*/*"), chosen("application/*"), chosen("TEXT/CSV; header=present")),
            (json, json, json, csv)
        );
        assert_eq!(
            (chosen("text/*, */*;q=0.1"), chosen("application/json;q=0.2, text/csv;q=0.9")),
            (csv, csv)
        );
        assert_eq!((chosen("application/json;q=0, */*"), chosen("text/html, text/csv;q=0.1")), (csv, csv));
        assert_eq!((chosen("text/html"), chosen("*/*;q=0"), chosen("text/csv;q=none")), (None, None, None));
    }
}
