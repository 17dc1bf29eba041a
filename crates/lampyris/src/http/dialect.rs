//! How clients of InfluxDB speak: how they show a token, and what they read where something goes wrong.

use super::problem::{ApiError, Problem};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use std::borrow::Cow;
use std::fmt::Write;
use utoipa::ToSchema;

/// What went wrong, as InfluxDB says it.
#[derive(Debug, Serialize, ToSchema)]
pub struct InfluxError {
    /// A word for programs: `invalid`, `unauthorized`, `forbidden`, `request too large`, `unavailable` and
    /// the like.
    #[schema(example = "invalid")]
    code: &'static str,
    /// All that is wrong, in sentences.
    message: String,
}

/// An error to clients of InfluxDB.
#[derive(Debug)]
pub struct InfluxRefusal(ApiError);

impl<E: Into<ApiError>> From<E> for InfluxRefusal {
    fn from(error: E) -> Self {
        Self(error.into())
    }
}

impl IntoResponse for InfluxRefusal {
    fn into_response(self) -> Response {
        self.0.answered(answer)
    }
}

fn answer(problem: Problem) -> Response {
    // Their clients give up what was refused as invalid, and send again what was not.
    let status = match problem.status {
        422 | 415 => StatusCode::BAD_REQUEST,
        other => StatusCode::from_u16(other).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR),
    };
    let code = match status.as_u16() {
        400 => "invalid",
        401 => "unauthorized",
        403 => "forbidden",
        404 => "not found",
        413 => "request too large",
        429 => "too many requests",
        408 | 503 | 507 => "unavailable",
        _ => "internal error",
    };
    let mut message = problem.detail;
    // A single fault is the detail already.
    if problem.errors.len() > 1 {
        for fault in &problem.errors {
            // Writing to a text cannot fail.
            let _ = write!(message, "; {fault}");
        }
    }
    (status, axum::Json(InfluxError { code, message })).into_response()
}

/// The token that a request shows: as a bearer, as those of version 2 do (`Token …`), as the password of
/// version 1, in the head or the query.
pub fn token(parts: &Parts) -> Option<Cow<'_, str>> {
    in_head(&parts.headers).or_else(|| in_query(&parts.uri).map(Cow::Owned))
}

fn in_head(headers: &HeaderMap) -> Option<Cow<'_, str>> {
    let (scheme, shown) = headers.get(header::AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    let is = |name: &str| scheme.eq_ignore_ascii_case(name);
    if is("bearer") || is("token") {
        // Version 1.8 took the name of a user before the token.
        return Some(Cow::Borrowed(shown.trim().rsplit(':').next().unwrap_or_default()));
    }
    if !is("basic") {
        return None;
    }
    let decoded = String::from_utf8(STANDARD.decode(shown.trim()).ok()?).ok()?;
    decoded.split_once(':').map(|(_, password)| Cow::Owned(password.to_owned()))
}

fn in_query(uri: &Uri) -> Option<String> {
    let pairs = axum::extract::Query::<Vec<(String, String)>>::try_from_uri(uri).ok()?;
    pairs.0.into_iter().find(|(name, _)| name == "p").map(|(_, password)| password)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_shown_in_each_way_that_clients_know() {
        let token = |field: Option<&str>, query: &str| {
            let mut request = axum::http::Request::builder().uri(format!("/write{query}"));
            if let Some(field) = field {
                request = request.header(header::AUTHORIZATION, field);
            }
            super::token(&request.body(()).unwrap().into_parts().0).map(Cow::into_owned)
        };
        let shown = Some("abc".to_owned());
        for field in ["Bearer abc", "Token abc", "token  abc ", "Token user:abc", "Basic dXNlcjphYmM="] {
            assert_eq!(token(Some(field), ""), shown, "{field}");
        }
        assert_eq!(token(None, "?u=user&p=abc&db=x"), shown);
        assert_eq!(token(Some("Token abc"), "?p=other"), shown);
        for field in ["Basic abc", "Basic dXNlcg==", "Digest abc", "abc"] {
            assert_eq!(token(Some(field), ""), None, "{field}");
        }
    }
}
