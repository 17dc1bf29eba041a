//! Bodies without an end, clients without haste, and equations without bottom: the controller is served
//! meanwhile.

use crate::support::process::Process;
use crate::support::rooms::{csv_of, room};
use crate::support::{Client, PATIENCE, full};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde_json::{Value, json};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

fn connect(service: &Process, head: &str) -> TcpStream {
    let mut stream = TcpStream::connect(service.base().strip_prefix("http://").unwrap()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(head.as_bytes()).unwrap();
    stream
}

/// What comes until the service closes the connection.
fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        Ok(_) => {}
        Err(error) if matches!(error.kind(), ErrorKind::ConnectionReset | ErrorKind::BrokenPipe) => {}
        Err(error) => panic!("the connection stays open: {error}"),
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// A service with a room that is served.
fn serving(dir: &tempfile::TempDir) -> Process {
    let service = Process::start(&dir.path().join("flood.db"));
    service.client.room("1", 1);
    let job = service.client.estimate("room/1", json!({}));
    assert_eq!(service.client.ended(&job)["outcome"], "accepted");
    service
}

/// Polls until it is told to stop; gives the longest time that an answer took.
fn poll(client: &Client, stop: &AtomicBool) -> (usize, Duration) {
    let (mut polls, mut longest) = (0, Duration::ZERO);
    while !stop.load(Ordering::Relaxed) {
        let asked = Instant::now();
        client.get("/params/room/1").expect(200);
        longest = longest.max(asked.elapsed());
        polls += 1;
        std::thread::sleep(Duration::from_millis(20));
    }
    (polls, longest)
}

#[test]
fn bodies_that_lie_about_their_length_cost_no_memory() {
    let dir = tempfile::tempdir().unwrap();
    let service = serving(&dir);
    let post = "POST /jobs HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n";
    // A length that is too large is refused before a byte of the body has come.
    let mut stream = connect(&service, &format!("{post}content-length: 33554432\r\n\r\n"));
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 413");
    // A length that is too small leaves a rest that is no request.
    let said =
        rest(&mut connect(&service, &format!("{post}content-length: 2\r\n\r\n{{}}{}", "x".repeat(100))));
    assert!(
        said.starts_with("HTTP/1.1 422") && said.matches("HTTP/1.1 ").count() <= 2 && !said.contains(" 200 "),
        "{said}"
    );
    for lie in [
        "content-length: -1",
        "content-length: 1e3",
        "content-length: 2\r\ncontent-length: 3",
        "content-length: 99999999999999999999999",
    ] {
        let said = rest(&mut connect(&service, &format!("{post}{lie}\r\n\r\n{{}}")));
        assert!(said.starts_with("HTTP/1.1 4"), "{lie}: {said}");
    }
    // A body without an end, from many at once: what is kept of each is its limit at most.
    let before = service.status("VmRSS");
    let chunk = format!("10000\r\n{}\r\n", "1".repeat(0x10000));
    let clients = 16;
    let sent: usize = std::thread::scope(|scope| {
        let endless = || {
            let mut stream = connect(&service, &format!("{post}transfer-encoding: chunked\r\n\r\n"));
            let mut sent = 0;
            while stream.write_all(chunk.as_bytes()).is_ok() {
                sent += chunk.len();
                assert!(sent < 64 << 20, "the service reads on and on");
            }
            sent
        };
        let clients: Vec<_> = (0..clients).map(|_| scope.spawn(endless)).collect();
        clients.into_iter().map(|client| client.join().unwrap()).sum()
    });
    let after = service.status("VmHWM");
    println!(
        "DOS-1: {clients} endless bodies, {} KiB of each went out, resident {before} to at most {after} KiB",
        sent / clients / 1024
    );
    assert!(after < before + (32 << 10) + clients as u64 * 2048, "{before} {after}");
    // A bomb is refused unread.
    let headers = [("content-type", "application/json"), ("content-encoding", "gzip")];
    service
        .client
        .send("POST", "/jobs", &headers, Some(&[0; 100_000]))
        .unwrap()
        .problem(415, "unsupported-content-encoding");
}

#[test]
fn thousands_of_slow_clients_are_closed_while_the_controller_is_served() {
    let count = if full() { 2000 } else { 100 };
    // Each end of a connection is a file, and this end is ours.
    let limit = getrlimit(Resource::Nofile);
    let most = limit.maximum.unwrap_or(1 << 20);
    setrlimit(Resource::Nofile, Rlimit { current: Some(most.min(8192)), ..limit }).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let service = serving(&dir);
    let open = service.open_files();
    let stop = AtomicBool::new(false);
    let (closed, (polls, longest)) = std::thread::scope(|scope| {
        let poller = scope.spawn(|| poll(&service.client, &stop));
        let begun = Instant::now();
        let mut slow: Vec<TcpStream> = (0..count)
            .map(|_| connect(&service, "GET /params/room/1 HTTP/1.1\r\nhost: localhost\r\nx-slow: "))
            .collect();
        // A byte now and then gains nothing.
        while begun.elapsed() < Duration::from_secs(9) {
            slow.iter_mut().for_each(|stream| drop(stream.write_all(b"x")));
            std::thread::sleep(Duration::from_secs(3));
        }
        let said: Vec<String> = slow.iter_mut().map(rest).collect();
        assert!(said.iter().all(|said| !said.contains(" 200 ")), "{said:?}");
        let closed = begun.elapsed();
        stop.store(true, Ordering::Relaxed);
        (closed, poller.join().unwrap())
    });
    println!(
        "DOS-2: {count} slow clients closed after {closed:?} (target 10 s), {polls} polls meanwhile, longest \
        {longest:?} (target 10 ms)"
    );
    assert!(polls > 100, "the controller was kept waiting: {polls} polls");
    let begun = Instant::now();
    while service.open_files() > open + 2 {
        assert!(begun.elapsed() < PATIENCE, "{} files are open, {open} were", service.open_files());
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A model with this equation for the room and `k` and `tau` as parameters.
fn model(id: &str, equation: &str) -> Value {
    json!({
        "id": id, "title": "A trap", "states": {"T_room": {"unit": "degC", "initial": "T_room"}},
        "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {
            "k": {"unit": "1/h", "lower": 0.001, "upper": 1.0, "nominal": 0.1, "scale": "log"},
            "tau": {"unit": "K", "lower": 0.001, "upper": 10.0, "nominal": 1.0, "scale": "log"},
        },
        "equations": {"T_room": equation},
        "outputs": {"T_room": {"expr": "T_room", "unit": "degC", "noise_sd": 0.05}},
    })
}

#[test]
fn equations_without_bottom_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let service = serving(&dir);
    let pure = "k*(T_out - T_room)";
    let deep = |open: &str, close: &str, depth: usize| {
        format!("{pure} + k*{}tau{}", open.repeat(depth), close.repeat(depth))
    };
    let mut traps = vec![
        ("parentheses", model("trap", &deep("(", ")", 100_000))),
        ("signs", model("trap", &deep("-", "", 7000))),
        ("calls", model("trap", &deep("abs(", ")", 3000))),
        ("a chain of sums", model("trap", &format!("{pure}{}", " + k*tau".repeat(2000)))),
        ("a short chain on one line", model("trap", &"1+".repeat(8000))),
        ("a tower of powers", model("trap", &format!("{pure} + k*tau*2^{}2", "2^".repeat(5000)))),
        ("a long name", model("trap", &"a".repeat(900_000))),
        ("a long number", model("trap", &"9".repeat(16_000))),
        ("a division by zero", model("trap", "k*(T_out - T_room)/(3 - 3)")),
        ("the root of a negative number", model("trap", "k*tau*sqrt(0 - 1)")),
        ("a name that means itself", {
            let mut document = model("trap", "k*tau*x");
            document["define"] = json!({"x": "y + 1", "y": "x + 1"});
            document
        }),
        ("names that double", {
            let mut document = model("trap", "k*tau*x40");
            document["define"] = (1..=40)
                .map(|n| (format!("x{n}"), json!(format!("sin(x{0} + {n}) * cos(x{0} * {n})", n - 1))))
                .chain([("x0".to_owned(), json!("k / 1[1/h]"))])
                .collect::<serde_json::Map<_, _>>()
                .into();
            document
        }),
        ("many long equations", {
            let mut document = model("trap", pure);
            for n in 0..60 {
                document["define"][format!("x{n}")] = json!(format!("{}1", "1+".repeat(8000)));
            }
            document
        }),
        ("many states", {
            let mut document = model("trap", pure);
            for n in 0..5000 {
                document["states"][format!("x{n}")] = json!({"unit": "-", "initial": "1"});
                document["equations"][format!("x{n}")] = json!("0[1/h]");
            }
            document
        }),
    ];
    let many =
        |count: usize| (0..count).map(|n| format!("sin({n} * k * 1[h])")).collect::<Vec<_>>().join("+");
    traps.push(("many nodes", {
        let mut document = model("trap", pure);
        for n in 0..40 {
            document["define"][format!("x{n}")] = json!(many(300));
        }
        document
    }));
    let mut longest = (Duration::ZERO, "");
    for (index, (what, document)) in traps.iter_mut().enumerate() {
        document["id"] = json!(format!("trap{index}"));
        let asked = Instant::now();
        let answer = service.client.json("POST", "/models", document);
        let took = asked.elapsed();
        if took > longest.0 {
            longest = (took, what);
        }
        // What is no fault, such as names that double and share what they mean, is a model.
        assert!(
            [201, 413, 422].contains(&answer.status),
            "{what}: {} {}",
            answer.status,
            answer.text.chars().take(500).collect::<String>()
        );
        let harmless = ["names that double", "many nodes"].contains(&*what);
        assert!(harmless || answer.status != 201, "{what} was taken");
        assert!(
            answer.status == 201 || answer.text.len() < 64 << 10,
            "{what}: {} bytes come back",
            answer.text.len()
        );
    }
    println!("DOS-4: {} traps, the longest took {:?}: {} (target 100 ms)", traps.len(), longest.0, longest.1);
}

/// Equations that are well formed, and whose numbers are not: each ends by itself, and nothing of it is
/// served.
#[test]
fn equations_that_explode_end_as_failed_or_refused_jobs() {
    let dir = tempfile::tempdir().unwrap();
    let service = serving(&dir);
    let before = service.client.get("/params/room/1").expect(200).text;
    let traps = [
        ("a double exponential", "k*tau*exp(exp(T_room / 1[K]))"),
        ("a division by what becomes zero", "k*tau*1[K]/(T_room - T_room*1.0000000001)"),
        ("the logarithm of a negative number", "k*tau*log(0 - abs(T_room / 1[K]) - 1)"),
        ("a stiff loss", "1000000000000*k*(T_out - T_room)"),
        ("a loss that is faster than numbers", "1e300*k*(T_out - T_room)*exp(700)"),
        ("a room that runs away", "k*(T_room - T_out)*exp(abs(T_room) / 1[K])"),
    ];
    let mut ends = Vec::new();
    for (index, (what, equation)) in traps.iter().enumerate() {
        let id = format!("trap{index}");
        let taken = service.client.json("POST", "/models", &model(&id, equation));
        if taken.status == 422 {
            ends.push(format!("{what}: 422"));
            continue;
        }
        taken.expect(201);
        let mut body = crate::support::quick("room/1");
        body["model"] = json!(id);
        body["budget"] = json!({"evaluations": 2000, "wall": "PT5S"});
        let begun = Instant::now();
        let ended = service.client.ended(&service.client.post_job(&body));
        let end =
            ended["error"]["code"].as_str().or(ended["outcome"].as_str()).unwrap_or_default().to_owned();
        assert!(["diverged", "deadline", "rejected", "held"].contains(&end.as_str()), "{what}: {ended}");
        ends.push(format!("{what}: {end} after {:.1?}", begun.elapsed()));
    }
    println!("DOS-4: {} (deadline 5 s, target 1 s more)", ends.join("; "));
    // A room that is fine is fitted as before.
    let other: String = csv_of(&room(2, 14));
    service.client.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    service.client.csv("/systems/room/2/windows", &other).expect(201);
    assert_eq!(service.client.ended(&service.client.estimate("room/2", json!({})))["outcome"], "accepted");
    assert_eq!(
        service.client.get("/params/room/1").expect(200).text,
        before,
        "jobs on other models than the system's say nothing of it"
    );
}

/// Definitions that stand in each other, and documents of names that nobody knows: each is read or refused
/// soon, and takes nothing down.
#[test]
fn documents_that_are_long_or_deep_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let service = serving(&dir);
    let chained = |count: usize, definition: &dyn Fn(usize) -> String| {
        let mut document = model("deep", &format!("k*tau*d{}", count - 1));
        let define: serde_json::Map<String, Value> =
            (0..count).map(|index| (format!("d{index}"), json!(definition(index)))).collect();
        document["define"] = json!(define);
        document
    };
    let before = |index: usize| match index {
        0 => "(T_out - T_room)/tau".to_owned(),
        _ => format!("d{}", index - 1),
    };
    let minus = |index: usize| format!("{}{}{}", "-(".repeat(10), before(index), ")".repeat(10));
    let nested = |index: usize| format!("{}{}{}", "min(".repeat(8), before(index), ",d0)".repeat(8));
    let unknown = |index: usize| format!("abcdefghik{index}*zzzzzzz{index}");
    let validate = |document: &Value| {
        let begun = Instant::now();
        let check = service.client.json("POST", "/models/validate", document).expect(200).json();
        (check, begun.elapsed())
    };
    let (short, _) = validate(&chained(20, &minus));
    assert!(!short.to_string().contains("too-deep"), "{short}");
    for (what, document, code) in [
        ("many signs", chained(500, &minus), "too-deep"),
        ("many choices", chained(700, &nested), "too-deep"),
        ("long", chained(8_000, &unknown), "too-large"),
        ("unknown names", chained(1_000, &unknown), "unknown-name"),
    ] {
        let (check, took) = validate(&document);
        let codes = |check: &Value| check["errors"].to_string().contains(&format!("\"{code}\""));
        assert!(check["valid"] == false && codes(&check), "{what}: {}", &check.to_string()[..300]);
        println!("DOS-5: {what}: {took:?} (target 500 ms)");
    }
}

/// Patterns of cron for which a search would not end, and lists without end, are refused at once.
#[test]
fn schedules_that_never_come_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let service = serving(&dir);
    let long = format!("{} * * * *", vec!["0"; 200].join(","));
    let preview = |cron: &str, systems: usize| {
        let document = json!({"cron": cron, "systems": vec!["room/1"; systems], "zone": "America/New_York"});
        service.client.json("POST", "/schedules/p/preview", &document)
    };
    for cron in ["0 0 31 2,4,6,9,11 *", "* * 30 2 *", "0 0 0 30 2 *", "0 0 2 * * * *", "@daily", "", &long] {
        let faults = preview(cron, 1).problem(422, "invalid-request")["errors"].to_string();
        assert!(faults.contains("invalid-cron"), "{cron}: {faults}");
    }
    for cron in ["0 3 29 2 1#5", "*/5 * * * *", "30 */5 * * * *", "0 0 31 1,2 *", "30 2 29 2 *", "0 0 L 2 *"]
    {
        let answer = preview(cron, 1).expect(200).json();
        assert_eq!(answer["next_runs"].as_array().unwrap().len(), 5, "{cron}: {answer}");
    }
    preview("30 2 * * *", 10_000).expect(200);
    let faults = preview("30 2 * * *", 10_001).problem(422, "invalid-request")["errors"].to_string();
    assert!(faults.contains("too-many"), "{faults}");
}
