//! Which pages of a browser may ask. A browser sends whatever a foreign page tells it to, also to services on
//! its own machine; what it says of the page, in `Host`, `Origin` and `Sec-Fetch-Site`, no page can change.

use super::problem::ApiError;
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, Version, header};
use std::net::{IpAddr, Ipv6Addr};

/// What bodies of changes are. No form of a page can send them, and a script of a foreign one is asked about
/// by its browser first, which then hears no consent.
const BODIES: [&str; 3] = ["application/json", "text/csv", "application/toml"];
/// What every machine calls itself.
const LOCALHOST: &str = "localhost";

/// By which authority (RFC 3986, 3.2) the service was asked.
///
/// # Errors
/// Where a request of HTTP/1.1 does not say it once (RFC 9112, 3.2).
pub fn authority(parts: &Parts) -> Result<&str, ApiError> {
    if let Some(authority) = parts.uri.authority() {
        return Ok(authority.as_str());
    }
    let mut hosts = parts.headers.get_all(header::HOST).iter();
    match (hosts.next().map(|host| host.to_str()), hosts.next()) {
        (Some(Ok(host)), None) => Ok(host.trim()),
        (None, _) if parts.version < Version::HTTP_11 => Ok(LOCALHOST),
        _ => Err(ApiError::NoHost),
    }
}

/// Refuses a request by a name that is not the service's own: a page may give its own name the address of
/// this machine (DNS rebinding), and is then of one origin with the service.
///
/// # Errors
/// 421, or 400 where there is no name at all.
pub fn require_own_name(parts: &Parts, hosts: &[String]) -> Result<(), ApiError> {
    let name = host(authority(parts)?);
    if is_address(name) || is_local(name) || is_one_of(name, hosts) {
        Ok(())
    } else {
        Err(ApiError::UnknownHost(name.to_owned()))
    }
}

/// Refuses a change that a page of another origin has its browser send.
///
/// # Errors
/// 403, or 400 where there is no host.
pub fn require_own_page(parts: &Parts, hosts: &[String]) -> Result<(), ApiError> {
    if [Method::GET, Method::HEAD, Method::OPTIONS].contains(&parts.method) {
        return Ok(());
    }
    let text = |name: &str| text(&parts.headers, name);
    let is_own = match (text("sec-fetch-site"), text("origin")) {
        (Some(site), _) => site == "same-origin" || site == "none",
        (None, Some(origin)) => is_same(origin, authority(parts)?, hosts),
        // No browser, or one that is older than both.
        (None, None) => true,
    };
    if is_own { Ok(()) } else { Err(ApiError::ForeignPage) }
}

/// Refuses a body of a change that a form could send.
///
/// # Errors
/// 415.
pub fn require_own_body(parts: &Parts) -> Result<(), ApiError> {
    let is_change = ![Method::GET, Method::HEAD, Method::OPTIONS].contains(&parts.method);
    if is_change
        && parts.headers.contains_key(header::CONTENT_TYPE)
        && !BODIES.contains(&media_type(&parts.headers).as_str())
    {
        return Err(ApiError::MediaType("application/json, text/csv or application/toml"));
    }
    Ok(())
}

/// The media type of a body without its parameters.
pub fn media_type(headers: &HeaderMap) -> String {
    let text = text(headers, header::CONTENT_TYPE.as_str()).unwrap_or_default();
    text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

fn text<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let mut lines = headers.get_all(name).iter();
    let first = lines.next()?;
    // What is no text, or said twice, names no page of ours.
    Some(if lines.next().is_none() { first.to_str().unwrap_or_default() } else { "" })
}

/// Whether an origin is that of the service's own page. A proxy that ends TLS changes the scheme, and one
/// that goes by another name is named in the settings.
fn is_same(origin: &str, authority: &str, hosts: &[String]) -> bool {
    let Some((scheme, own)) = origin.split_once("://") else { return false };
    let port = match scheme {
        "http" => ":80",
        "https" => ":443",
        _ => return false,
    };
    let same = |one: &str, other: &str| {
        let bare = |text: &'_ str| text.strip_suffix(port).unwrap_or(text).to_ascii_lowercase();
        bare(one) == bare(other)
    };
    same(own, authority) || is_one_of(host(own), hosts)
}

/// The host of an authority without its port (RFC 3986, 3.2.2). Of what is malformed, and where a user stands
/// before it, all of it, which is no host.
fn host(authority: &str) -> &str {
    let is_port = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let named = match authority.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) if address.parse::<Ipv6Addr>().is_err() => None,
        Some((address, "")) => Some((address, "")),
        Some((address, rest)) => rest.strip_prefix(':').map(|port| (address, port)),
        None => Some(authority.split_once(':').unwrap_or((authority, ""))),
    };
    match named {
        Some((host, port)) if is_port(port) => host,
        _ => authority,
    }
}

fn is_address(host: &str) -> bool {
    host.parse::<IpAddr>().is_ok()
}

/// Browsers resolve these names to this machine alone (RFC 6761, 6.3).
fn is_local(host: &str) -> bool {
    let host = host.trim_end_matches('.').to_ascii_lowercase();
    host == LOCALHOST || host.ends_with(".localhost")
}

fn is_one_of(host: &str, hosts: &[String]) -> bool {
    let host = host.trim_end_matches('.');
    hosts.iter().any(|known| known.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::Request;

    fn parts(method: &str, fields: &[(&str, &str)]) -> Parts {
        let request =
            fields.iter().fold(Request::builder().method(method).uri("/jobs"), |request, (name, value)| {
                request.header(*name, *value)
            });
        request.body(()).unwrap().into_parts().0
    }

    fn known() -> Vec<String> {
        vec!["rooms.example.org".to_owned()]
    }

    #[test]
    fn a_service_goes_by_addresses_by_localhost_and_by_the_names_it_was_given() {
        let own = |host: &str| require_own_name(&parts("GET", &[("host", host)]), &known());
        for host in [
            "127.0.0.1:8080",
            "10.0.0.7",
            "[::1]:8080",
            "[fe80::1]",
            "localhost",
            "LocalHost:1",
            "localhost.",
            "a.localhost:80",
            "rooms.example.org",
            "Rooms.Example.Org.:443",
        ] {
            assert!(own(host).is_ok(), "{host}");
        }
        for host in [
            "evil.example:8080",
            "127.0.0.1.evil.example",
            "localhost.evil.example",
            "",
            "x@evil.example",
            "rooms.example.org.evil.example",
            "127.0.0.1@evil.example:80",
            "0x7f000001.example",
            "[localhost]",
            "[127.0.0.1]evil.example",
            "[::1].evil.example",
            "127.0.0.1:evil.example",
            "x@127.0.0.1",
        ] {
            assert!(matches!(own(host), Err(ApiError::UnknownHost(_))), "{host}");
        }
        let none = require_own_name(&parts("GET", &[]), &[]);
        let two = require_own_name(&parts("GET", &[("host", "localhost"), ("host", "x")]), &[]);
        assert!(matches!((none, two), (Err(ApiError::NoHost), Err(ApiError::NoHost))));
    }

    #[test]
    fn a_change_comes_from_no_page_or_from_the_own_one() {
        let own = |fields: &[(&str, &str)]| {
            let fields: Vec<_> = [("host", "localhost:8080")].iter().chain(fields).copied().collect();
            require_own_page(&parts("POST", &fields), &known())
        };
        for fields in [
            &[] as &[(&str, &str)],
            &[("origin", "http://localhost:8080")],
            &[("origin", "https://rooms.example.org")],
            &[("sec-fetch-site", "same-origin"), ("origin", "https://whatever.the.proxy.is")],
            &[("sec-fetch-site", "none")],
        ] {
            assert!(own(fields).is_ok(), "{fields:?}");
        }
        for fields in [
            &[("origin", "null")] as &[(&str, &str)],
            &[("origin", "http://localhost:8081")],
            &[("origin", "http://evil.example")],
            &[("origin", "file://localhost:8080")],
            &[("origin", "http://rooms.example.org.evil.example")],
            &[("origin", "http://localhost:8080"), ("sec-fetch-site", "cross-site")],
            &[("sec-fetch-site", "same-site")],
            &[("origin", "http://localhost:8080"), ("origin", "http://evil.example")],
            &[("sec-fetch-site", "same-origin"), ("sec-fetch-site", "cross-site")],
        ] {
            assert!(matches!(own(fields), Err(ApiError::ForeignPage)), "{fields:?}");
        }
        // A port that the scheme implies may be left out.
        let fields = [("host", "rooms:443"), ("origin", "https://rooms")];
        assert!(require_own_page(&parts("PUT", &fields), &[]).is_ok());
        assert!(require_own_page(&parts("GET", &[("origin", "http://evil.example")]), &[]).is_ok());
    }

    #[test]
    fn a_body_of_a_change_is_none_that_a_form_could_send() {
        let own = |fields: &[(&str, &str)]| require_own_body(&parts("POST", fields));
        assert!(own(&[]).is_ok() && own(&[("content-type", "text/csv; charset=utf-8")]).is_ok());
        for kind in ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", ""]
        {
            assert!(matches!(own(&[("content-type", kind)]), Err(ApiError::MediaType(_))), "{kind}");
        }
        let two = [("content-type", "application/json"), ("content-type", "text/plain")];
        assert!(matches!(own(&two), Err(ApiError::MediaType(_))));
        assert!(require_own_body(&parts("GET", &[("content-type", "text/plain")])).is_ok());
    }
}
