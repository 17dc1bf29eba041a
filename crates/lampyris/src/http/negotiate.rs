//! JSON or CSV: what the client would rather have (RFC 9110, 12.5.1).

use super::extract::accepted;
use super::problem::ApiError;
use super::shared::Shared;
use crate::service::catalogue::windows::Format;
use axum::body::Body;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderValue, header};
use axum::response::Response;

/// The format that a client takes, JSON where it does not mind.
#[derive(Debug, Clone, Copy)]
pub struct Wanted(pub Format);

impl FromRequestParts<Shared> for Wanted {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &Shared) -> Result<Self, ApiError> {
        let form = accepted(&parts.headers, &["application/json", "text/csv"])?;
        Ok(Self(if form == "text/csv" { Format::Csv } else { Format::Json }))
    }
}

/// A rendered answer in its format.
pub fn rendered(format: Format, body: Body) -> Response {
    let mut response = Response::new(body);
    let kind = match format {
        Format::Json => "application/json",
        Format::Csv => "text/csv; charset=utf-8",
    };
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
    response
}
