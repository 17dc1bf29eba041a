//! Whatever a controller reads is one whole revision, the newest that it has seen or a newer one, under a tag
//! of its own.

use crate::database::rows;
use crate::support::process::Process;
use crate::support::{full, quick};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

const READERS: usize = 4;
/// The service is started anew between them.
const LEGS: usize = 4;

/// A connection that asks for one path again and again.
pub struct Reader {
    stream: BufReader<TcpStream>,
    request: String,
    body: Vec<u8>,
    etag: String,
}

impl Reader {
    pub fn new(base: &str) -> Self {
        let address = base.strip_prefix("http://").unwrap();
        let stream = TcpStream::connect(address).unwrap();
        stream.set_nodelay(true).unwrap();
        let request = format!("GET /params/room/1 HTTP/1.1\r\nhost: {address}\r\n\r\n");
        Self { stream: BufReader::new(stream), request, body: Vec::new(), etag: String::new() }
    }

    /// Reads once; what came is in `body` and `etag`.
    fn read(&mut self) {
        self.stream.get_mut().write_all(self.request.as_bytes()).unwrap();
        let (mut line, mut length) = (String::new(), 0);
        self.stream.read_line(&mut line).unwrap();
        assert!(line.starts_with("HTTP/1.1 200"), "{line}");
        loop {
            line.clear();
            self.stream.read_line(&mut line).unwrap();
            let Some((name, value)) = line.trim_end().split_once(": ") else { break };
            match name {
                "content-length" => length = value.parse().unwrap(),
                "etag" => self.etag = value.to_owned(),
                _ => {}
            }
        }
        self.body.resize(length, 0);
        self.stream.read_exact(&mut self.body).unwrap();
    }
}

/// The bodies that were read by their tags, and how many answers there were.
#[derive(Default)]
pub struct Seen {
    bodies: HashMap<String, Vec<u8>>,
    reads: usize,
    revision: i64,
}

impl Seen {
    /// Reads until it is told to stop, and has read at least so often.
    pub fn watch(&mut self, reader: &mut Reader, least: usize, stop: &AtomicBool, reads: &AtomicUsize) {
        let mut mine = 0;
        let (mut etag, mut body) = (String::new(), Vec::new());
        while mine < least || !stop.load(Ordering::Relaxed) {
            reader.read();
            mine += 1;
            reads.fetch_add(1, Ordering::Relaxed);
            assert_eq!(
                reader.etag == etag,
                reader.body == body,
                "the tag changes if and only if the body does: {etag} {}",
                reader.etag
            );
            if reader.etag != etag {
                (etag, body) = (reader.etag.clone(), reader.body.clone());
                assert_eq!(
                    etag,
                    format!("\"{}\"", &blake3::hash(&body).to_hex()[..etag.len() - 2]),
                    "the tag is the hash of the body"
                );
                let document: Value = serde_json::from_slice(&body).unwrap();
                let revision = document["revision"].as_i64().unwrap();
                assert!(revision >= self.revision, "from revision {} back to {revision}", self.revision);
                self.revision = revision;
                let known = self.bodies.entry(etag.clone()).or_insert_with(|| body.clone());
                assert_eq!(known, &body, "one tag for two bodies");
            }
        }
        self.reads += mine;
    }
}

/// A body beside the row of its revision.
fn check_against(rows: &BTreeMap<i64, (String, String, String)>, body: &Value) {
    let (fit, served, hash) = &rows[&body["revision"].as_i64().unwrap()];
    assert_eq!(
        *hash,
        blake3::hash(served.as_bytes()).to_hex().to_string(),
        "the row of {}",
        body["revision"]
    );
    assert_eq!(body["fit"], *fit, "{body}");
    let served: Value = serde_json::from_str(served).unwrap();
    for (field, value) in served.as_object().unwrap() {
        assert_eq!(body[field], *value, "{field} of revision {}", body["revision"]);
    }
}

#[test]
fn every_body_that_is_read_is_one_whole_revision_and_none_goes_back() {
    let (publishes, reads) = if full() { (2000, 1_000_000) } else { (100, 50_000) };
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("consistency.db");
    let mut service = Process::start(&database);
    service.client.room("1", 1);
    // Two sets that differ in every parameter; rolling back and forth publishes them in turns.
    let fits = [json!({}), json!({"alpha_a": 0.16})].map(|fixed| {
        service.client.json("PUT", "/systems/room/1", &json!({"model": "rc2", "fixed": fixed})).expect(200);
        let ended = service.client.ended(&service.client.post_job(&quick("room/1")));
        let fit = ended["fit"].as_str().unwrap_or_else(|| panic!("{ended}")).to_owned();
        if ended["outcome"] != "accepted" {
            panic!("{ended}");
        }
        fit
    });
    let mut seen: Vec<Seen> = (0..READERS).map(|_| Seen::default()).collect();
    let mut published = 0;
    let total = AtomicUsize::new(0);
    for leg in 0..LEGS {
        let stop = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for seen in &mut seen {
                let (base, stop, total) = (service.base(), &stop, &total);
                scope.spawn(move || seen.watch(&mut Reader::new(base), reads / READERS / LEGS, stop, total));
            }
            let before = total.load(Ordering::Relaxed);
            for publish in 0..publishes / LEGS {
                // Publishing keeps in step with reading, so that all the reads see changes.
                while total.load(Ordering::Relaxed) - before < publish * (reads / publishes) {
                    std::thread::sleep(std::time::Duration::from_micros(200));
                }
                let pin = json!({"fit": fits[published % 2], "reason": format!("turn {published}")});
                assert_eq!(
                    service.client.json("PUT", "/params/room/1/pin", &pin).expect(200).json()["fit"],
                    fits[published % 2]
                );
                published += 1;
            }
            stop.store(true, Ordering::Relaxed);
        });
        let served = service.client.get("/params/room/1").expect(200).text;
        // One death in two is a sudden one.
        if leg % 2 == 0 {
            service.kill()
        } else {
            assert_eq!(service.terminate().0, Some(0))
        }
        service = Process::start(&database);
        assert_eq!(service.client.get("/params/room/1").expect(200).text, served, "leg {leg}");
    }
    service.kill();
    let rows: BTreeMap<i64, (String, String, String)> = rows(
        &database,
        "SELECT json_array(revision, fit, served, served_hash) FROM revisions WHERE system = 'room/1'",
    )
    .iter()
    .map(|row| serde_json::from_str::<(i64, String, String, String)>(row).unwrap())
    .map(|(revision, fit, served, hash)| (revision, (fit, served, hash)))
    .collect();
    assert_eq!(rows.len(), published + 2, "{:?}", rows.keys());
    let mut tags: HashMap<&str, &[u8]> = HashMap::new();
    for (etag, body) in seen.iter().flat_map(|seen| &seen.bodies) {
        assert_eq!(tags.entry(etag).or_insert(body), body, "one tag for two bodies");
    }
    for body in tags.values() {
        check_against(&rows, &serde_json::from_slice(body).unwrap());
    }
    let counted: usize = seen.iter().map(|seen| seen.reads).sum();
    println!(
        "CONS-1: {counted} reads of {} bodies during {published} publishes and {LEGS} restarts, 0 violations",
        tags.len()
    );
    assert!(counted >= reads && tags.len() > published / 2, "{counted} {}", tags.len());
}
