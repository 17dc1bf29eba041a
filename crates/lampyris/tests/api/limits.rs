//! Clients that are slow, or never stop sending.

use crate::support::TestApp;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Longest that a closed connection may be waited for.
const PATIENCE: Duration = Duration::from_secs(60);

fn connect(app: &TestApp, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(app.addr()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(text.as_bytes()).unwrap();
    stream
}

/// Everything until the service closes the connection.
fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        // What was sent after the end is answered with a reset.
        Ok(_) => {}
        Err(error) if error.kind() == ErrorKind::ConnectionReset => {}
        Err(error) => panic!("the connection stays open: {error}"),
    }
    String::from_utf8(bytes).unwrap()
}

fn impatient() -> TestApp {
    TestApp::with(|settings| {
        settings.limits.header_seconds = 1;
        settings.limits.body_seconds = 1;
        settings.limits.body_bytes = 4096;
        settings.limits.connections = 128;
    })
}

#[test]
fn slow_clients_are_closed_while_others_are_served() {
    let app = impatient();
    let half_a_head = "GET /healthz HTTP/1.1\r\nhost: localhost\r\nx-slow: ";
    let half_a_body = "POST /jobs HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: \
        100\r\n\r\n{\"kind\":";
    let mut slow: Vec<TcpStream> =
        (0..50).map(|index| connect(&app, if index % 2 == 0 { half_a_head } else { half_a_body })).collect();
    // One that says a byte now and then gains nothing by it.
    let dripping = slow[0].try_clone().unwrap();
    let drip = std::thread::spawn(move || {
        (0..20).all(|_| {
            (&dripping).write_all(b"x").map(|()| std::thread::sleep(Duration::from_millis(80))).is_ok()
        })
    });
    for _ in 0..20 {
        app.get("/healthz").expect(200);
    }
    for (index, stream) in slow.iter_mut().enumerate() {
        let said = rest(stream);
        if index % 2 == 1 {
            assert!(said.starts_with("HTTP/1.1 408 ") && said.contains("body-too-slow"), "{said}");
        } else {
            assert!(!said.contains(" 200 "), "{said}");
        }
    }
    drip.join().unwrap();
    app.get("/healthz").expect(200);
}

#[test]
fn a_body_that_no_handler_reads_holds_no_connection() {
    let app = impatient();
    for head in ["GET /healthz HTTP/1.1", "POST /nothing HTTP/1.1", "DELETE /jobs HTTP/1.1"] {
        let mut stream =
            connect(&app, &format!("{head}\r\nhost: localhost\r\ncontent-length: 1000\r\n\r\nx"));
        assert!(rest(&mut stream).starts_with("HTTP/1.1 "), "{head}");
    }
}

#[test]
fn a_refusal_before_the_body_has_come_leaves_the_connection_open() {
    let app = TestApp::start();
    let mut stream = connect(&app, "");
    let mut answer = |parts: [&str; 2]| {
        for part in parts {
            stream.write_all(part.as_bytes()).unwrap();
            // The service refuses the head while the body is under way.
            std::thread::sleep(Duration::from_millis(100));
        }
        let mut bytes = [0; 1 << 14];
        let length = stream.read(&mut bytes).unwrap();
        String::from_utf8(bytes[..length].to_vec()).unwrap()
    };
    for (head, status) in
        [("POST /nothing", 404), ("DELETE /jobs", 405), ("PUT /schedules/x?y=1", 422), ("POST /jobs", 415)]
    {
        let said =
            answer([&format!("{head} HTTP/1.1\r\nhost: localhost\r\ncontent-length: 2\r\n\r\n"), "{}"]);
        assert!(
            said.starts_with(&format!("HTTP/1.1 {status} ")) && !said.contains("connection: close"),
            "{head}: {said}"
        );
    }
    let said = answer(["GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n", ""]);
    assert!(said.starts_with("HTTP/1.1 200 "), "{said}");
}

#[test]
fn whoever_comes_when_all_places_are_taken_gets_that_of_the_quietest() {
    let app = TestApp::with(|settings| settings.limits.connections = 16);
    let mut idle: Vec<TcpStream> = (0..16).map(|_| connect(&app, "")).collect();
    app.get("/healthz").expect(200);
    // The first of them is closed long before its own time has passed.
    let begun = Instant::now();
    assert_eq!(rest(&mut idle[0]), "");
    assert!(begun.elapsed() < Duration::from_secs(9), "{:?}", begun.elapsed());
}

#[test]
fn a_body_without_an_end_is_refused_once_it_is_too_large() {
    let app = impatient();
    let head = "POST /jobs HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ntransfer-encoding: \
        chunked\r\n\r\n";
    let mut stream = connect(&app, head);
    let chunk = format!("1000\r\n{}\r\n", "1".repeat(0x1000));
    let start = Instant::now();
    let mut sent = 0_usize;
    // The service stops reading; what fits into the buffers of the system may still go out.
    while start.elapsed() < PATIENCE && stream.write_all(chunk.as_bytes()).is_ok() {
        sent += chunk.len();
        assert!(sent < 64 << 20, "the service reads on and on");
    }
    let said = rest(&mut stream);
    // Where the reset overtakes the answer, the client has seen its connection end.
    assert!(
        said.is_empty() || (said.starts_with("HTTP/1.1 413 ") && said.contains("\"limit\":4096")),
        "{said}"
    );
    // One chunk more than the limit, and an end: this client hears why.
    let mut stream = connect(&app, &format!("{head}{chunk}{chunk}0\r\n\r\n"));
    let mut answer = [0; 4096];
    let length = stream.read(&mut answer).unwrap();
    let said = String::from_utf8_lossy(&answer[..length]).into_owned();
    assert!(said.starts_with("HTTP/1.1 413 ") && said.contains("body-too-large"), "{said}");
}

#[test]
fn compressed_bodies_are_refused_unread() {
    let app = impatient();
    for (path, kind) in [
        ("/jobs", "application/json"),
        ("/systems/room/1/windows", "text/csv"),
        ("/schedules/nightly/run", "application/json"),
    ] {
        for encoding in ["gzip", "br", "gzip, identity"] {
            let headers = [("content-type", kind), ("content-encoding", encoding)];
            app.send("POST", path, &headers, Some(b"\x1f\x8b"))
                .unwrap()
                .problem(415, "unsupported-content-encoding");
        }
        let plain = app
            .send("POST", path, &[("content-type", kind), ("content-encoding", "identity")], Some(b""))
            .unwrap();
        assert_ne!(plain.status, 415, "{}", plain.text);
    }
}
