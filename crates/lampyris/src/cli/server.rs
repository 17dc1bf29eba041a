//! Asks a running server: one document per answer, faults as people read them.

use super::output::{Failure, print};
use crate::service::trust::trust;
use serde_json::Value;
use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::time::Duration;
use ureq::config::ConfigBuilder;
use ureq::http;
use ureq::typestate::AgentScope;

/// Longest wait for an answer that is not a long poll.
const PATIENCE: Duration = Duration::from_secs(60);
/// How addresses begin that speak TLS.
const SECURE: &str = "https://";
/// Largest answer that is read.
const LARGEST: u64 = 1 << 30;
/// Answers that say: the thing is known, but there is nothing to give.
const NOTHING: [&str; 3] = ["no-validated-parameters", "no-fresh-parameters", "no-state"];

/// Which server, and how its answers are printed.
#[derive(Debug, clap::Args)]
pub struct Server {
    /// Address of the server.
    #[arg(
        long,
        global = true,
        env = "LAMPYRIS_URL",
        default_value = "http://127.0.0.1:8080",
        value_parser = address
    )]
    url: String,
    /// Certificates (PEM) that the server's own rests on, where this system does not know them.
    #[arg(long, global = true, env = "LAMPYRIS_CA")]
    ca: Option<PathBuf>,
    /// Token, where the server wants one.
    #[arg(long, global = true, env = "LAMPYRIS_TOKEN", hide_env_values = true)]
    token: Option<String>,
    /// Print the server's document.
    #[arg(long, global = true)]
    json: bool,
}

fn address(text: &str) -> Result<String, String> {
    let host = text.strip_prefix("http://").or_else(|| text.strip_prefix(SECURE));
    match host {
        Some(host) if !host.is_empty() => Ok(text.trim_end_matches('/').to_owned()),
        Some(_) => Err("the address names no host".to_owned()),
        None => Err("write http://HOST:PORT or https://HOST:PORT".to_owned()),
    }
}

/// What is sent.
#[derive(Debug, Default)]
pub struct Call<'a> {
    /// Header fields.
    pub headers: Vec<(&'a str, String)>,
    /// Media type and bytes.
    pub body: Option<(&'a str, Vec<u8>)>,
    /// How much longer than usual the answer may take.
    pub extra: Duration,
}

impl Call<'_> {
    /// A JSON document.
    pub fn json(document: &Value) -> Self {
        Self { body: Some(("application/json", document.to_string().into_bytes())), ..Self::default() }
    }
}

/// An answer that is no fault.
#[derive(Debug)]
pub struct Answer {
    /// Its status.
    pub status: u16,
    /// The tag of the body.
    pub etag: Option<String>,
    /// The body as it came.
    pub text: String,
    /// The body as a document; null where it is none.
    pub document: Value,
}

impl Server {
    /// A server that wants no token.
    pub fn at(url: String) -> Self {
        Self { url, ca: None, token: None, json: false }
    }

    /// Whether documents are printed as they came.
    pub fn json(&self) -> bool {
        self.json
    }

    /// Asks for a document.
    pub fn get(&self, path: &str) -> Result<Answer, Failure> {
        self.call("GET", path, Call::default())
    }

    /// Sends a request and reads the answer.
    ///
    /// # Errors
    /// Where the server cannot be reached, or answers with a problem, which is shown with all its faults.
    pub fn call(&self, method: &str, path: &str, call: Call) -> Result<Answer, Failure> {
        let config = self.config()?.timeout_global(Some(PATIENCE + call.extra));
        let (parts, mut body) = self.send(&config.build().into(), method, path, call)?.into_parts();
        let text =
            body.with_config().limit(LARGEST).read_to_string().map_err(|error| self.unreachable(&error))?;
        let status = parts.status.as_u16();
        if status >= 400 {
            return Err(self.problem(status, &text));
        }
        let etag = parts.headers.get("etag").and_then(|value| value.to_str().ok()).map(str::to_owned);
        Ok(Answer { status, etag, document: serde_json::from_str(&text).unwrap_or_default(), text })
    }

    /// Opens a stream of events after the one with an id; nothing where the server says that there is no
    /// more.
    pub fn listen(&self, path: &str, last_id: &str) -> Result<Option<Events>, Failure> {
        let config = self.config()?.timeout_recv_response(Some(PATIENCE));
        let mut call = Call::default();
        if !last_id.is_empty() {
            call.headers.push(("last-event-id", last_id.to_owned()));
        }
        let (parts, mut body) = self.send(&config.build().into(), "GET", path, call)?.into_parts();
        match parts.status.as_u16() {
            204 => Ok(None),
            200 => Ok(Some(Events {
                lines: BufReader::new(Box::new(body.into_reader())),
                last_id: last_id.to_owned(),
            })),
            status => Err(self.problem(status, &body.read_to_string().unwrap_or_default())),
        }
    }

    fn config(&self) -> Result<ConfigBuilder<AgentScope>, Failure> {
        let config = ureq::Agent::config_builder().http_status_as_error(false);
        if !self.url.starts_with(SECURE) {
            return Ok(config);
        }
        Ok(config.tls_config(trust(self.ca.as_deref()).map_err(Failure::Error)?))
    }

    fn send(
        &self,
        agent: &ureq::Agent,
        method: &str,
        path: &str,
        call: Call,
    ) -> Result<http::Response<ureq::Body>, Failure> {
        let mut request = http::Request::builder().method(method).uri(format!("{}{path}", self.url));
        for (name, value) in &call.headers {
            request = request.header(*name, value);
        }
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        let made = |error: http::Error| Failure::Error(format!("the request cannot be made: {error}"));
        let answer = match call.body {
            Some((kind, body)) => agent.run(request.header("content-type", kind).body(body).map_err(made)?),
            None if method == "GET" => agent.run(request.body(()).map_err(made)?),
            None => agent.run(request.body(Vec::new()).map_err(made)?),
        };
        answer.map_err(|error| self.unreachable(&error))
    }

    fn unreachable(&self, error: &ureq::Error) -> Failure {
        Failure::Unreachable(format!(
            "no answer from {}: {error}\n       is `lampyris serve` running there? LAMPYRIS_URL says where \
            to ask",
            self.url
        ))
    }

    /// The failure behind an answer that is a fault.
    fn problem(&self, status: u16, text: &str) -> Failure {
        if self.json {
            print(text);
        }
        let problem: Value = serde_json::from_str(text).unwrap_or_default();
        let slug = problem["type"].as_str().unwrap_or_default();
        let title = problem["title"].as_str().unwrap_or("the request was refused");
        let mut message = format!("{title} ({status}{}{slug})", if slug.is_empty() { "" } else { " " });
        let faults = problem["errors"].as_array().map(Vec::as_slice).unwrap_or_default();
        match problem["detail"].as_str() {
            Some(detail) if faults.is_empty() => {
                let _ = write!(message, ": {detail}");
            }
            _ => faults.iter().for_each(|fault| message.push_str(&format!("\n  {}", fault_line(fault)))),
        }
        if let Some(page) = problem["see"].as_str() {
            let _ = write!(message, "\n  {}", self.leads_to(page));
        }
        if let Some(job) = problem["latest_job"].as_str() {
            let _ = write!(message, "\n  the newest job is {job}");
        }
        match status {
            404 if NOTHING.contains(&slug) => Failure::Nothing(message),
            404 => Failure::NotFound(message),
            _ => Failure::Error(message),
        }
    }

    /// Where a page of the book is read that an answer names.
    pub fn leads_to(&self, page: &str) -> String {
        format!("see {}{page}", self.url)
    }

    /// Prints an answer: as it came, or as a text for people.
    pub fn show(&self, answer: &Answer, text: impl FnOnce(&Value) -> String) {
        print(&if self.json { answer.text.clone() } else { text(&answer.document) });
    }
}

/// A fault with its place, and what would have been right.
pub fn fault_line(fault: &Value) -> String {
    let text = |field: &str| fault[field].as_str().unwrap_or_default();
    let place = if text("pointer").is_empty() { "the document" } else { text("pointer") };
    match text("suggestion") {
        "" => format!("{place}: {}", text("detail")),
        suggestion => format!("{place}: {} ({suggestion})", text("detail")),
    }
}

/// A part of a path or a query; everything that could end it is escaped.
pub fn segment(text: &str) -> String {
    let mut escaped = String::new();
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~:@".contains(&byte) {
            escaped.push(char::from(byte));
        } else {
            let _ = write!(escaped, "%{byte:02X}");
        }
    }
    escaped
}

/// The query of those of these parameters that are said, from its question mark on.
pub fn query(parameters: &[(&str, &Option<String>)]) -> String {
    let said = parameters.iter().filter_map(|(name, value)| Some((name, value.as_deref()?)));
    let said: Vec<String> = said.map(|(name, value)| format!("{name}={}", segment(value))).collect();
    if said.is_empty() { String::new() } else { format!("?{}", said.join("&")) }
}

/// One event of a stream.
#[derive(Debug, PartialEq)]
pub struct Event {
    /// Its name.
    pub name: String,
    /// Its data.
    pub data: Value,
}

/// A stream of events.
pub struct Events {
    lines: BufReader<Box<dyn Read>>,
    /// With this a client comes back.
    pub last_id: String,
}

impl Iterator for Events {
    type Item = Event;

    /// The next event; nothing where the stream ends or breaks off, which a client treats alike: it comes
    /// back.
    fn next(&mut self) -> Option<Event> {
        let mut event = Event { name: String::new(), data: Value::Null };
        loop {
            let mut line = String::new();
            if self.lines.read_line(&mut line).ok()? == 0 {
                return None;
            }
            match line.trim_end().split_once(": ") {
                Some(("event", name)) => name.clone_into(&mut event.name),
                // An id counts even where no data come with it.
                Some(("id", id)) => id.clone_into(&mut self.last_id),
                Some(("data", text)) => event.data = serde_json::from_str(text).unwrap_or_default(),
                _ if line.trim_end().is_empty() && !event.name.is_empty() => return Some(event),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_names_scheme_and_host() {
        assert_eq!(address("http://localhost:8080/").unwrap(), "http://localhost:8080");
        assert_eq!(address("https://rooms.example.org").unwrap(), "https://rooms.example.org");
        for text in ["ftp://localhost", "localhost:8080", "http://", "https://"] {
            assert!(address(text).is_err(), "{text}");
        }
    }

    #[test]
    fn names_cannot_leave_their_place_in_a_path() {
        assert_eq!(
            segment("room3+metered_gain:P_x"),
            "room3%2Bmetered_gain:P_x",
            "a plus is a space in a query"
        );
        assert_eq!(segment("../a?b#c d%"), "..%2Fa%3Fb%23c%20d%25");
    }

    #[test]
    fn events_are_read_as_the_standard_says() {
        let text = "retry: 1000\n\nid: 1.0.5\n\n: a comment\n\nevent: queued\ndata: {\"id\":\"job_1\"}\nid: \
            1.1.6\n\nevent: started\ndata: {}\n\nevent: cut";
        let mut events = Events { lines: BufReader::new(Box::new(text.as_bytes())), last_id: String::new() };
        assert_eq!(
            events.next(),
            Some(Event { name: "queued".into(), data: serde_json::json!({"id": "job_1"}) })
        );
        assert_eq!(events.last_id, "1.1.6");
        assert_eq!(events.next().map(|event| event.name), Some("started".into()));
        assert_eq!((events.next(), events.last_id.as_str()), (None, "1.1.6"));
    }
}
