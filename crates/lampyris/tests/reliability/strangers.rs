//! Strangers who take places and take nothing from them, and pages of other origins: the controller with its
//! token is served meanwhile.

use crate::support::process::{Process, program};
use crate::support::{Client, PATIENCE, full};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde_json::{Value, json};
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::net::TcpSocket;

/// Most memory that a service may have while strangers are at it, in KiB.
const RESIDENT: u64 = 200 << 10;
/// Where strangers come from.
const STRANGER: Ipv4Addr = Ipv4Addr::new(127, 1, 0, 1);

/// A service with a room that is served, and with a token each for a controller and for somebody else.
struct Guarded {
    service: Process,
    controller: Client,
    other: String,
    _dir: tempfile::TempDir,
}

fn token(database: &Path, name: &str, scope: &str) -> String {
    let made = program()
        .args(["token", "create", "--json", "--name", name, "--scope", scope, "--database"])
        .arg(database)
        .output()
        .unwrap();
    let made: Value = serde_json::from_slice(&made.stdout).unwrap();
    made["token"].as_str().unwrap().to_owned()
}

/// With few places everyday, so that few strangers take all of them; with those of the defaults in the full
/// figures.
fn guarded() -> Guarded {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("strangers.db");
    let environment: &[(&str, &str)] = if full() {
        &[]
    } else {
        &[
            ("LAMPYRIS_LIMITS_CONNECTIONS", "256"),
            ("LAMPYRIS_LIMITS_CONNECTIONS_PER_PEER", "24"),
            ("LAMPYRIS_LIMITS_CONNECTIONS_PER_TOKEN", "32"),
            ("LAMPYRIS_LIMITS_STREAMS_PER_TOKEN", "8"),
            ("LAMPYRIS_LIMITS_WRITE_SECONDS", "2"),
            ("LAMPYRIS_LIMITS_WINDOW_BYTES", "1048576"),
            ("LAMPYRIS_LIMITS_BODIES_BYTES", "2097152"),
        ]
    };
    let operator = token(&database, "operator", "admin");
    let controller = token(&database, "controller", "read");
    let other = token(&database, "other", "read");
    let service = Process::start_with(&database, environment);
    let client = service.client.with_token(&operator);
    client.lasting_room("1", 1);
    let job = client.estimate("room/1", json!({}));
    assert_eq!(client.ended(&job)["outcome"], "accepted");
    // Each end of a connection is a file, and this end is ours.
    let limit = getrlimit(Resource::Nofile);
    let most = limit.maximum.unwrap_or(1 << 20);
    setrlimit(Resource::Nofile, Rlimit { current: Some(most.min(16_384)), ..limit }).unwrap();
    Guarded { controller: service.client.with_token(&controller), service, other, _dir: dir }
}

impl Guarded {
    fn address(&self) -> SocketAddr {
        self.service.base().strip_prefix("http://").unwrap().parse().unwrap()
    }

    /// A connection from an address of this machine on which something was sent, with a small buffer for what
    /// comes; none where the service has closed it meanwhile.
    fn connect(&self, from: Ipv4Addr, head: &str) -> Option<TcpStream> {
        connect(self.address(), from, 4096, head)
    }

    /// Polls on connections that are new each time and on one that stays, while something goes on; gives the
    /// figures and what that has made.
    fn polled<T: Send>(&self, what: &str, meanwhile: impl FnOnce() -> T + Send) -> T {
        let stop = AtomicBool::new(false);
        let answered = AtomicUsize::new(0);
        let (made, mut times) = std::thread::scope(|scope| {
            let poller = scope.spawn(|| {
                let mut times = Vec::new();
                while !stop.load(Ordering::Relaxed) {
                    let client = if times.len() % 2 == 0 { self.newcomer() } else { self.controller.clone() };
                    let asked = Instant::now();
                    client.get("/params/room/1").expect(200);
                    times.push(asked.elapsed());
                    answered.store(times.len(), Ordering::Relaxed);
                    std::thread::sleep(Duration::from_millis(10));
                }
                times
            });
            let made = meanwhile();
            // On a busy machine the poller itself may get little time, so the strangers stay until enough is
            // answered.
            let begun = Instant::now();
            while begun.elapsed() < Duration::from_secs(1)
                || answered.load(Ordering::Relaxed) <= 50 && begun.elapsed() < Duration::from_secs(5)
            {
                std::thread::sleep(Duration::from_millis(50));
            }
            stop.store(true, Ordering::Relaxed);
            (made, poller.join().unwrap())
        });
        times.sort_unstable();
        let (p99, longest) = (times[times.len() * 99 / 100], times[times.len() - 1]);
        let resident = self.service.status("VmHWM");
        println!(
            "{what}: {} polls, p99 {p99:?} (target 50 ms), longest {longest:?}, resident at most {} MiB \
            (limit 200)",
            times.len(),
            resident >> 10
        );
        assert!(times.len() > 50, "the controller was kept waiting: {} polls", times.len());
        assert!(resident <= RESIDENT, "{what}: {resident} KiB");
        made
    }

    /// A figure without labels.
    fn metric(&self, name: &str) -> f64 {
        let text = self.controller.get("/metrics").expect(200).text;
        let value = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok());
        value.unwrap_or_else(|| panic!("no {name} in {text}"))
    }

    /// The controller without the connection that it had.
    fn newcomer(&self) -> Client {
        self.controller.afresh()
    }
}

fn connect(to: SocketAddr, from: Ipv4Addr, buffer: u32, head: &str) -> Option<TcpStream> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let connected = async {
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(buffer).unwrap();
        socket.bind((from, 0).into()).unwrap();
        socket.connect(to).await?.into_std()
    };
    let mut stream = runtime.block_on(connected).ok()?;
    stream.set_nonblocking(false).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(head.as_bytes()).ok()?;
    Some(stream)
}

/// What a connection is answered with; none where it is closed instead.
fn status(mut stream: &TcpStream) -> Option<u16> {
    let mut line = [0; 12];
    stream.read_exact(&mut line).ok()?;
    std::str::from_utf8(&line[9..]).ok()?.parse().ok()
}

/// Whether the service has closed a connection, or closes it in time.
fn is_closed(mut stream: &TcpStream, within: Duration) -> bool {
    stream.set_read_timeout(Some(within)).unwrap();
    let mut bytes = [0; 1 << 16];
    loop {
        match stream.read(&mut bytes) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
        }
    }
}

#[test]
fn whoever_asks_for_much_and_takes_nothing_starves_nobody() {
    let guarded = guarded();
    let count = if full() { 4096 } else { 200 };
    let requests = "GET /openapi.yaml HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(30);
    let greedy: Vec<TcpStream> = guarded.polled("STRANGERS-1: nothing is taken", || {
        let streams = (0..count).filter_map(|_| guarded.connect(STRANGER, &requests)).collect();
        std::thread::sleep(Duration::from_secs(if full() { 15 } else { 4 }));
        streams
    });
    // What is not taken is not kept for ever.
    let begun = Instant::now();
    while guarded.service.open_files() > 60 {
        assert!(begun.elapsed() < PATIENCE, "{} files are open", guarded.service.open_files());
        std::thread::sleep(Duration::from_millis(50));
    }
    // Nor does the system keep it in the service's stead.
    let begun = Instant::now();
    while untaken(guarded.address().port()) > 0 {
        assert!(begun.elapsed() < Duration::from_secs(5), "the system keeps what nobody takes");
        std::thread::sleep(Duration::from_millis(50));
    }
    drop(greedy);
}

/// Connections of a port that have no owner any more and still wait for their last bytes to be taken.
fn untaken(port: u16) -> usize {
    let text = std::fs::read_to_string("/proc/net/tcp").unwrap();
    let place = format!(":{port:04X}");
    let waits = |line: &&str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        // FIN_WAIT1 and CLOSING.
        fields[1].ends_with(&place) && ["04", "0B"].contains(&fields[3])
    };
    text.lines().skip(1).filter(waits).count()
}

#[test]
fn questions_of_one_reader_take_turns() {
    let guarded = guarded();
    let count = 60;
    let name = |state: usize| format!("x{state}");
    let states: serde_json::Map<String, Value> =
        (0..100).map(|state| (name(state), json!({"unit": "degC", "initial": "20"}))).collect();
    let equation = |state: usize| match state {
        0 => "k * (T_out - x0)".to_owned(),
        _ => format!("k * (x{} - x{state})", state - 1),
    };
    let equations: serde_json::Map<String, Value> =
        (0..100).map(|state| (name(state), json!(equation(state)))).collect();
    let document = json!({"model": {
        "id": "long", "title": "A long chain", "states": states, "inputs": {"T_out": {"unit": "degC"}},
        "equations": equations,
        "parameters": {"k": {"unit": "1/h", "lower": 0.1, "upper": 10, "nominal": 1, "scale": "log"}},
        "outputs": {"T_room": {"expr": "x99", "unit": "degC", "noise_sd": 0.05}},
    }});
    let body = document.to_string();
    let request = format!(
        "POST /models/preview HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {}\r\ncontent-type: \
        application/json\r\ncontent-length: {}\r\n\r\n{body}",
        guarded.other,
        body.len()
    );
    let statuses: Vec<u16> = guarded.polled("STRANGERS-6: previews of one reader", || {
        std::thread::scope(|scope| {
            // Everyday a token has fewer connections than that, and some of them make room for others.
            let ask = || guarded.connect(STRANGER, &request).and_then(|stream| status(&stream)).unwrap_or(0);
            let asked: Vec<_> = (0..count).map(|_| scope.spawn(ask)).collect();
            asked.into_iter().map(|one| one.join().unwrap()).collect()
        })
    });
    let answered = |wanted: u16| statuses.iter().filter(|status| **status == wanted).count();
    println!("STRANGERS-6: {} answered, {} told to come again", answered(200), answered(503));
    assert_eq!(answered(200) + answered(503) + answered(0), count, "{statuses:?}");
    assert!(answered(200) > 0 && (!full() || answered(503) > 0), "{statuses:?}");
}

#[test]
fn thousands_of_idle_strangers_keep_no_newcomer_waiting() {
    let guarded = guarded();
    let count = if full() { 5000 } else { 300 };
    // Every other one comes from an address of its own.
    let from = |number: usize| match number % 2 {
        0 => STRANGER,
        _ => Ipv4Addr::new(127, 2, (number / 250) as u8, (number % 250 + 1) as u8),
    };
    let idle: Vec<TcpStream> = guarded.polled("STRANGERS-2: idle connections", || {
        (0..count).filter_map(|number| guarded.connect(from(number), "")).collect()
    });
    // Those that came first have lost their places to those that came later.
    let first = idle.into_iter().take(count / 2);
    let gone = first.filter(|stream| is_closed(stream, Duration::from_millis(1))).count();
    let displaced = guarded.metric("lampyris_connections_displaced_total");
    assert!(displaced >= gone as f64 / 2.0 && gone > 64, "{gone} are closed, {displaced} for others");
}

#[test]
fn one_token_holds_neither_all_streams_nor_all_places() {
    let guarded = guarded();
    let count = if full() { 4096 } else { 100 };
    let head =
        format!("GET /events HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {}\r\n\r\n", guarded.other);
    let streams: Vec<TcpStream> = guarded.polled("STRANGERS-3: streams of events", || {
        let streams = (0..count).filter_map(|_| guarded.connect(STRANGER, &head)).collect();
        let most = if full() { 64.0 } else { 8.0 };
        let listeners = guarded.metric("lampyris_event_listeners");
        assert!((1.0..=most).contains(&listeners), "{listeners} streams are open");
        streams
    });
    let mut statuses = std::collections::BTreeMap::<Option<u16>, usize>::new();
    for stream in streams {
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        *statuses.entry(status(&stream)).or_default() += 1;
    }
    println!("STRANGERS-3: {statuses:?}");
    assert!(statuses.get(&Some(429)).is_some_and(|told| *told >= 1), "{statuses:?}");
    // Others have streams of their own, and whoever had too many may come again.
    guarded.controller.headers("/events", &[]);
    let begun = Instant::now();
    while guarded.service.client.with_token(&guarded.other).get("/events").status != 200 {
        assert!(begun.elapsed() < PATIENCE, "no stream was given back");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn bodies_of_one_token_leave_room_for_those_of_others() {
    let guarded = guarded();
    let largest = if full() { 64 << 20 } else { 1 << 20 };
    let head = format!(
        "POST /systems/layout HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {}\r\ncontent-type: \
        text/csv\r\ncontent-length: {largest}\r\n\r\n",
        guarded.other
    );
    let refused = guarded.polled("STRANGERS-5: bodies that do not end", || {
        let part = vec![b'1'; largest * 9 / 10];
        let open: Vec<TcpStream> = (0..8)
            .filter_map(|_| {
                let mut stream = guarded.connect(STRANGER, &head)?;
                // The answer may come before all of it is sent.
                let _ = stream.write_all(&part);
                Some(stream)
            })
            .collect();
        let answer =
            guarded.controller.send("POST", "/systems/layout", &[("content-type", "text/csv")], Some(b"x"));
        assert_ne!(answer.unwrap().status, 503, "another token has no room");
        let said = open.iter().skip(1).map(|stream| {
            stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
            status(stream)
        });
        said.filter(|status| *status == Some(503)).count()
    });
    assert!(refused >= 5, "{refused} of 8 bodies were refused");
}

#[test]
fn a_slow_answer_is_sent_to_its_end_as_long_as_it_is_taken() {
    let guarded = guarded();
    let head = "GET /openapi.json HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    let whole = guarded.service.client.get("/openapi.json").expect(200).text;
    let stream = connect(guarded.address(), STRANGER, 16 << 10, head).unwrap();
    let (mut taken, mut part) = (Vec::new(), vec![0; whole.len() / 12]);
    let begun = Instant::now();
    loop {
        let length = (&stream).read(&mut part).unwrap();
        taken.extend_from_slice(&part[..length]);
        if length == 0 {
            break;
        }
        // Longer in all than an answer may lie untaken.
        std::thread::sleep(Duration::from_millis(150));
    }
    assert!(String::from_utf8(taken).unwrap().ends_with(&whole[whole.len() - 100..]));
    println!("STRANGERS-4: an answer was taken within {:?}", begun.elapsed());
}
