//! Bodies that are the same for everybody, for ever: packed once, and shared by all answers that wait to be
//! taken.

use super::conditions::is_known;
use super::extract::weighted;
use crate::service::serving::body::tag_of;
use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use rust_embed::RustEmbed;
use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Write;
use std::sync::OnceLock;

/// A file that is part of the binary, or is made once.
#[derive(Debug)]
pub struct ConstantBody {
    kind: &'static str,
    tag: String,
    plain: Bytes,
    packed: OnceLock<Bytes>,
}

impl ConstantBody {
    /// A body; the ending of its name says what it is.
    pub fn new(name: &str, plain: impl Into<Bytes>) -> Self {
        let kind = match name.rsplit_once('.') {
            Some((_, "html")) => "text/html; charset=utf-8",
            Some((_, "css")) => "text/css; charset=utf-8",
            Some((_, "js" | "mjs")) => "text/javascript; charset=utf-8",
            Some((_, "svg")) => "image/svg+xml",
            Some((_, "png")) => "image/png",
            Some((_, "json")) => "application/json",
            Some((_, "yaml")) => "application/yaml",
            _ => "text/plain; charset=utf-8",
        };
        let plain = plain.into();
        Self { kind, tag: tag_of(&plain), plain, packed: OnceLock::new() }
    }

    /// The answer with it, under a policy where it is a part of a page; one that the client has already is
    /// not sent again.
    pub fn answer(&self, policy: Option<&'static str>, headers: &HeaderMap) -> Response {
        let mut response = if is_known(headers, &self.tag) {
            StatusCode::NOT_MODIFIED.into_response()
        } else if takes_gzip(headers) {
            let packed = self.packed.get_or_init(|| packed(&self.plain));
            ([(header::CONTENT_ENCODING, "gzip")], packed.clone()).into_response()
        } else {
            self.plain.clone().into_response()
        };
        let fields = response.headers_mut();
        // Weak, because the same file may be sent compressed.
        if let Ok(tag) = HeaderValue::try_from(format!("W/{}", self.tag)) {
            fields.insert(header::ETAG, tag);
        }
        fields.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.kind));
        fields.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        fields.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
        fields.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
        if let Some(policy) = policy {
            fields.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(policy));
        }
        response
    }
}

/// The files of a folder that is part of the binary, by their paths. They are not copied; a build for
/// development reads them.
pub fn constants<F: RustEmbed>() -> HashMap<String, ConstantBody> {
    let body = |path: Cow<'static, str>| {
        let bytes: Bytes = match F::get(&path)?.data {
            Cow::Borrowed(bytes) => Bytes::from_static(bytes),
            Cow::Owned(bytes) => bytes.into(),
        };
        Some((path.to_string(), ConstantBody::new(&path, bytes)))
    };
    F::iter().filter_map(body).collect()
}

fn packed(plain: &[u8]) -> Bytes {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    // Writing to memory cannot fail.
    let _ = encoder.write_all(plain);
    encoder.finish().unwrap_or_default().into()
}

/// Whether a client takes gzip (RFC 9110, 12.5.3).
fn takes_gzip(headers: &HeaderMap) -> bool {
    let texts = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    let mut any = false;
    for (name, weight) in texts.flat_map(|text| text.split(',')).map(weighted) {
        let wanted = weight > 0.0;
        if name.eq_ignore_ascii_case("gzip") || name.eq_ignore_ascii_case("x-gzip") {
            return wanted;
        }
        any |= name == "*" && wanted;
    }
    any
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::read::GzDecoder;
    use std::io::Read;

    #[test]
    fn gzip_is_sent_to_whoever_takes_it() {
        let takes = |text: &str| {
            takes_gzip(&HeaderMap::from_iter([(header::ACCEPT_ENCODING, text.parse().unwrap())]))
        };
        assert!(takes("gzip") && takes("br, GZIP;q=0.5") && takes("*") && takes("br;q=1, *;q=0.1"));
        assert!(!takes("") && !takes("br") && !takes("gzip;q=0") && !takes("gzip;q=0, *") && !takes("*;q=0"));
        assert!(!takes_gzip(&HeaderMap::new()));
    }

    #[test]
    fn what_is_packed_is_what_was_given() {
        let text = "a page, a page, a page".repeat(100);
        let mut unpacked = String::new();
        GzDecoder::new(&*packed(text.as_bytes())).read_to_string(&mut unpacked).unwrap();
        assert_eq!(unpacked, text);
    }
}
