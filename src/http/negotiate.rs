//! JSON or CSV: what the client would rather have (RFC 9110, 12.5.1).

use super::Shared;
use super::problem::ApiError;
use crate::jobs::windows::Format;
use axum::body::Body;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;

/// The format that a client takes, JSON where it does not mind.
#[derive(Debug, Clone, Copy)]
pub struct Wanted(pub Format);

impl FromRequestParts<Shared> for Wanted {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &Shared) -> Result<Self, ApiError> {
        wanted(&parts.headers).map(Self).ok_or(ApiError::NotAcceptable("application/json or text/csv"))
    }
}

/// The better liked of both formats; `None` where neither is taken.
fn wanted(headers: &HeaderMap) -> Option<Format> {
    let lines: Vec<&str> = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).collect();
    if lines.is_empty() {
        return Some(Format::Json);
    }
    let ranges: Vec<(String, f32)> = lines.iter().flat_map(|line| line.split(',')).map(range).collect();
    let (json, csv) = (liking(&ranges, "application", "json"), liking(&ranges, "text", "csv"));
    if json.max(csv) <= 0.0 { None } else { Some(if csv > json { Format::Csv } else { Format::Json }) }
}

/// A media range with its weight.
fn range(text: &str) -> (String, f32) {
    let mut parts = text.split(';').map(str::trim);
    let range = parts.next().unwrap_or_default().to_ascii_lowercase();
    let weight = parts.find_map(|part| part.strip_prefix("q=").or(part.strip_prefix("Q="))).map_or(1.0, |q| q.parse().unwrap_or(0.0));
    (range, weight)
}

/// The weight of the most specific range that names a type.
fn liking(ranges: &[(String, f32)], kind: &str, subtype: &str) -> f32 {
    let named = |name: &str| ranges.iter().find(|(range, _)| range == name).map(|(_, weight)| *weight);
    named(&format!("{kind}/{subtype}")).or_else(|| named(&format!("{kind}/*"))).or_else(|| named("*/*")).unwrap_or(0.0)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_better_liked_format_wins() {
        let of = |text: &'static str| wanted(&HeaderMap::from_iter([(header::ACCEPT, HeaderValue::from_static(text))]));
        assert_eq!(wanted(&HeaderMap::new()), Some(Format::Json));
        for json in
            ["*/*", "application/json", "application/*", "text/csv;q=0.5, application/json", "text/html, */*;q=0.1", "text/csv, */*"]
        {
            assert_eq!(of(json), Some(Format::Json), "{json}");
        }
        for csv in ["text/csv", "text/*", "TEXT/CSV;q=0.2", "text/csv, application/json;q=0.9", "text/csv; charset=utf-8; q=1, */*;q=0.1"] {
            assert_eq!(of(csv), Some(Format::Csv), "{csv}");
        }
        for neither in ["text/html", "application/xml, image/*", "*/*;q=0", "application/json;q=0, text/html"] {
            assert_eq!(of(neither), None, "{neither}");
        }
    }
}
