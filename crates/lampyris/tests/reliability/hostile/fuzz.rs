//! Mutated requests for every operation that is described, against the built service.

use super::{Random, bend, mutate, poison, written};
use crate::support::full;
use crate::support::process::Process;
use rand::{RngExt, SeedableRng};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

const CLIENTS: u64 = 3;
/// The full figure ends here at the latest.
const LONGEST: Duration = Duration::from_secs(8 * 60);
/// So much of what was sent may come back.
const ECHO: usize = 1024;
/// So many KiB more than after the first tenth.
const GROWTH: u64 = 20 << 10;
/// What judges a document and keeps nothing.
const DRY: [&str; 4] = ["/models/validate", "/models/preview", "/systems/layout", "/schedules/odd/preview"];

/// A good request.
#[derive(Clone)]
struct Good {
    method: String,
    path: String,
    media_type: String,
    body: Body,
}

#[derive(Clone)]
enum Body {
    Json(Value),
    Text(String),
}

/// The examples of the description: one for every operation that takes a body, and every path that is read.
fn good() -> Vec<Good> {
    let description: Value = serde_json::from_str(&lampyris::http::openapi_json()).unwrap();
    let mut all = Vec::new();
    for (path, item) in description["paths"].as_object().unwrap() {
        let path = match path.as_str() {
            path if path.starts_with("/models/") => path.replace("{id}", "rc2"),
            path => path.replace("{kind}", "room").replace("{id}", "1").replace("{name}", "odd"),
        };
        for (method, operation) in item.as_object().unwrap() {
            let one = |media_type: &str, body| Good {
                method: method.to_uppercase(),
                path: path.clone(),
                media_type: media_type.into(),
                body,
            };
            let content = operation["requestBody"]["content"].as_object();
            for (media_type, content) in content.into_iter().flatten() {
                let examples =
                    content["examples"].as_object().into_iter().flat_map(|examples| examples.values());
                for example in examples.map(|example| &example["value"]).chain(content.get("example")) {
                    let body = example
                        .as_str()
                        .map_or_else(|| Body::Json(example.clone()), |text| Body::Text(text.to_owned()));
                    all.push(one(media_type, body));
                }
            }
            // A stream of events does not end by itself.
            if method == "get" && !path.ends_with("/events") {
                all.push(one("", Body::Text(String::new())));
            }
        }
    }
    all
}

/// A request as it goes over the line.
fn mutated(good: &Good, random: &mut Random) -> Vec<u8> {
    let mut path = good.path.clone();
    let body = match &good.body {
        Body::Json(document) => {
            let mut document = document.clone();
            for _ in 0..random.random_range(1..4) {
                mutate(&mut document, random);
            }
            if !DRY.contains(&path.as_str()) {
                poison(&mut document);
            }
            let mut body = written(&document);
            if random.random_range(0..3) == 0 {
                bend(&mut body, random);
            }
            body
        }
        Body::Text(text) if !text.is_empty() => {
            // A column in a unit that there is not, so that nothing is taken.
            let (head, rows) = text.split_once('\n').unwrap_or((text, ""));
            let mut body = format!("{head},x[furlong]\n{rows}").into_bytes();
            bend(&mut body, random);
            body
        }
        Body::Text(_) => {
            let value = super::nasty(random);
            let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            let names = [
                "page_size",
                "page_token",
                "from",
                "to",
                "channels",
                "max_points",
                "fits",
                "state",
                "system",
                "accept",
                "mode",
                "x",
            ];
            let text = format!("?{}={value}", names[random.random_range(0..names.len())]);
            path += &text
                .bytes()
                .take(600)
                .map(|byte| {
                    if byte.is_ascii_alphanumeric() || b"?=".contains(&byte) {
                        char::from(byte).to_string()
                    } else {
                        format!("%{byte:02X}")
                    }
                })
                .collect::<String>();
            Vec::new()
        }
    };
    let head = format!(
        "{} {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {}\r\ncontent-length: {}\r\n\r\n",
        good.method,
        good.media_type,
        body.len()
    );
    [head.into_bytes(), body].concat()
}

/// A connection that is made anew where the service closes it.
struct Line {
    address: String,
    stream: Option<BufReader<TcpStream>>,
}

impl Line {
    /// Status and body of an answer.
    fn ask(&mut self, request: &[u8]) -> std::io::Result<(u16, Vec<u8>)> {
        let mut stream = match self.stream.take() {
            Some(stream) => stream,
            None => {
                let stream = TcpStream::connect(&self.address)?;
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(Duration::from_secs(60)))?;
                BufReader::new(stream)
            }
        };
        stream.get_mut().write_all(request)?;
        let (mut line, mut length, mut chunked, mut close) = (String::new(), 0, false, false);
        stream.read_line(&mut line)?;
        let status = line
            .split(' ')
            .nth(1)
            .and_then(|status| status.parse().ok())
            .ok_or(std::io::ErrorKind::UnexpectedEof)?;
        while line != "\r\n" {
            line.clear();
            stream.read_line(&mut line)?;
            let lower = line.to_lowercase();
            if let Some(value) = lower.strip_prefix("content-length: ") {
                length = value.trim().parse().unwrap();
            }
            chunked |= lower.starts_with("transfer-encoding: chunked");
            close |= lower.starts_with("connection: close");
        }
        let mut body = vec![0; length];
        if chunked {
            loop {
                line.clear();
                stream.read_line(&mut line)?;
                let size = usize::from_str_radix(line.trim(), 16).unwrap();
                let mut chunk = vec![0; size + 2];
                stream.read_exact(&mut chunk)?;
                if size == 0 {
                    break;
                }
                body.extend_from_slice(&chunk[..size]);
            }
        } else {
            stream.read_exact(&mut body)?;
        }
        if !close {
            self.stream = Some(stream);
        }
        Ok((status, body))
    }
}

/// Whether a long part of a request came back.
fn echoes(request: &[u8], answer: &[u8]) -> bool {
    let chunks = request.chunks_exact(ECHO / 2).collect::<Vec<_>>();
    // Any kilobyte of the request holds two neighbouring halves.
    answer.len() > ECHO
        && chunks.windows(2).any(|pair| {
            let wanted = pair.concat();
            answer.windows(ECHO).any(|part| part == wanted)
        })
}

#[test]
fn mutated_requests_are_answered_without_a_fault_of_the_service() {
    let bodies = if full() { 1_000_000 } else { 10_000 };
    let dir = tempfile::tempdir().unwrap();
    let service = Process::start(&dir.path().join("fuzz.db"));
    service.client.room("1", 1);
    service.client.ended(&service.client.estimate("room/1", serde_json::json!({})));
    let good = good();
    assert!(good.iter().filter(|good| !good.media_type.is_empty()).count() >= 15, "there are examples");
    let begun = Instant::now();
    let part = |first: u64, count: u64| -> Vec<(Duration, u16)> {
        std::thread::scope(|scope| {
            let clients: Vec<_> = (0..CLIENTS)
                .map(|client| {
                    let (good, address) = (&good, service.base().strip_prefix("http://").unwrap().to_owned());
                    scope.spawn(move || {
                        let mut random = Random::seed_from_u64(1000 * client + first);
                        let mut line = Line { address, stream: None };
                        let mut answers = Vec::new();
                        for _ in 0..count / CLIENTS {
                            if begun.elapsed() > LONGEST {
                                break;
                            }
                            let request = mutated(&good[random.random_range(0..good.len())], &mut random);
                            let asked = Instant::now();
                            let (status, body) = line.ask(&request).unwrap_or_else(|error| {
                                panic!("{error}: {}", String::from_utf8_lossy(&request))
                            });
                            answers.push((asked.elapsed(), status));
                            let shown = || {
                                format!(
                                    "{}\n{}",
                                    String::from_utf8_lossy(&request),
                                    String::from_utf8_lossy(&body)
                                )
                            };
                            assert!(status < 500, "{status}: {}", shown());
                            assert!(!echoes(&request, &body), "{}", shown());
                            let said = String::from_utf8_lossy(&body);
                            assert!(
                                !["SELECT ", "src/", "panicked", "sqlite"].iter().any(|leak| status >= 400
                                    && said.contains(leak)
                                    && !String::from_utf8_lossy(&request).contains(leak)),
                                "{}",
                                shown()
                            );
                        }
                        answers
                    })
                })
                .collect();
            clients.into_iter().flat_map(|client| client.join().unwrap()).collect()
        })
    };
    let mut answers = part(1, bodies / 10);
    let before = service.status("VmRSS");
    answers.extend(part(2, bodies - bodies / 10));
    let after = service.status("VmRSS");
    let count = |wanted: fn(u16) -> bool| answers.iter().filter(|(_, status)| wanted(*status)).count();
    let (fine, malformed, refused) =
        (count(|status| status < 400), count(|status| status == 400), count(|status| status == 422));
    let mut took: Vec<Duration> = answers.iter().map(|(took, _)| *took).collect();
    took.sort();
    let (p99, longest) = (took[took.len() * 99 / 100], took[took.len() - 1]);
    println!(
        "FUZZ-1: {} bodies for {} good requests: {fine} fine, {malformed} malformed, {refused} refused, no \
        fault of the service; \
         p99 {p99:?} (target 5 ms), longest {longest:?}, resident {before} to {after} KiB",
        answers.len(),
        good.len()
    );
    assert!(
        refused > answers.len() / 10 && malformed > answers.len() / 50,
        "the mutations reach the documents"
    );
    assert!(after < before + GROWTH, "resident memory grew from {before} to {after} KiB");
    service.client.get("/readyz").expect(200);
}
