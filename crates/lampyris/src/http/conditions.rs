//! Conditions that a request sets: tags that its client knows (RFC 9110, 13.1).

use super::shared::shared_body;
use crate::service::serving::body::tag_of;
use crate::service::work::interactive::RenderedAnswer;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Whether the client has this body already. The tags may come in several lines.
pub fn is_known(headers: &HeaderMap, etag: &str) -> bool {
    names(headers, &header::IF_NONE_MATCH, etag).unwrap_or(false)
}

/// Whether a change may be made of what has this tag, `None` where nothing is there: `If-Match` names it, and
/// `If-None-Match` does not. `If-None-Match: *` asks that there be nothing.
pub fn allow(headers: &HeaderMap, etag: Option<&str>) -> bool {
    let matched = |field| match etag {
        Some(etag) => names(headers, field, etag),
        None => headers.contains_key(field).then_some(false),
    };
    matched(&header::IF_MATCH) != Some(false) && matched(&header::IF_NONE_MATCH) != Some(true)
}

/// Whether a field names a tag, or any tag; `None` where the field is not there. A star stands for any tag
/// where it stands alone.
fn names(headers: &HeaderMap, field: &HeaderName, etag: &str) -> Option<bool> {
    let mut lines = headers.get_all(field).iter().peekable();
    lines.peek()?;
    let is_one = |tag: &str| tag.strip_prefix("W/").unwrap_or(tag) == etag;
    let mut alone = true;
    let mut named = false;
    for line in lines {
        let Ok(text) = line.to_str() else { continue };
        if alone && text.trim() == "*" {
            return Some(true);
        }
        alone = false;
        named |= text.split(',').map(str::trim).any(is_one);
    }
    Some(named)
}

/// What was rendered as this media type, with its tag; 304 where the client has it.
pub fn unless_known(headers: &HeaderMap, kind: &'static str, answer: RenderedAnswer) -> Response {
    let tag = tag_of(&answer);
    if is_known(headers, &tag) {
        return not_modified(&tag);
    }
    let mut response = Response::new(shared_body(answer));
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    set_tag(&mut response, &tag);
    response
}

/// Nothing new.
pub fn not_modified(etag: &str) -> Response {
    let mut response = StatusCode::NOT_MODIFIED.into_response();
    set_tag(&mut response, etag);
    response
}

/// Names what an answer holds.
pub fn set_tag(response: &mut Response, etag: &str) {
    if let Ok(value) = HeaderValue::from_str(etag) {
        response.headers_mut().insert(header::ETAG, value);
    }
    // A cache may keep the body, but must ask whether it still holds.
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(field: HeaderName, lines: &[&str]) -> HeaderMap {
        lines.iter().map(|line| (field.clone(), line.parse().unwrap())).collect()
    }

    #[test]
    fn tags_are_read_from_all_lines() {
        let known = |lines: &[&str]| is_known(&with(header::IF_NONE_MATCH, lines), "\"b\"");
        for lines in [&["\"b\""] as &[&str], &["\"a\", W/\"b\""], &["\"a\"", "\"b\""], &["*"], &[" * "]] {
            assert!(known(lines), "{lines:?}");
        }
        for lines in [&[] as &[&str], &["\"a\""], &["\"a\", *"], &["\"a\"", "*"], &["b"], &["\"bb\""]] {
            assert!(!known(lines), "{lines:?}");
        }
    }

    #[test]
    fn a_change_asks_for_what_is_there_or_for_nothing() {
        let may = |field: HeaderName, tags: &str, etag: Option<&str>| allow(&with(field, &[tags]), etag);
        let (own, there) = (header::IF_MATCH, Some("\"b\""));
        assert!(may(own.clone(), "\"b\"", there) && may(own.clone(), "*", there));
        assert!(
            !may(own.clone(), "\"a\"", there) && !may(own.clone(), "\"b\"", None) && !may(own, "*", None)
        );
        let none = header::IF_NONE_MATCH;
        assert!(may(none.clone(), "*", None) && may(none.clone(), "\"a\"", there));
        assert!(!may(none.clone(), "*", there) && !may(none, "\"b\"", there));
        assert!(allow(&HeaderMap::new(), there) && allow(&HeaderMap::new(), None));
    }
}
