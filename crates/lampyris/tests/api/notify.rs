//! An address is told what happens, signed, and again where it did not answer.

use crate::support::TestApp;
use lampyris::service::queue::schedules;
use lampyris::settings::{NoticeFormat, NoticeKind, NoticeSecret, NotifySettings};
use serde_json::Value;
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::sync::mpsc::{Receiver, channel};

/// What came: the fields of its head by name, and its body.
type Heard = (HashMap<String, String>, String);

/// Answers the first `refused` notices with 503, every other one with 200, and tells them all.
fn listener(refused: usize) -> (String, Receiver<Heard>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/hook", listener.local_addr().unwrap());
    let (sender, heard) = channel();
    std::thread::spawn(move || {
        for (count, stream) in listener.incoming().enumerate() {
            let mut stream = stream.unwrap();
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            let mut head = HashMap::new();
            loop {
                let mut line = String::new();
                reader.read_line(&mut line).unwrap();
                if line.trim().is_empty() {
                    break;
                }
                if let Some((name, value)) = line.split_once(':') {
                    head.insert(name.to_lowercase(), value.trim().to_owned());
                }
            }
            let mut body = vec![0; head["content-length"].parse().unwrap()];
            reader.read_exact(&mut body).unwrap();
            let status = if count < refused { "503 Service Unavailable" } else { "200 OK" };
            let _ = write!(stream, "HTTP/1.1 {status}\r\ncontent-length: 0\r\nconnection: close\r\n\r\n");
            if sender.send((head, String::from_utf8(body).unwrap())).is_err() {
                return;
            }
        }
    });
    (address, heard)
}

#[test]
fn notices_are_signed_tried_again_and_told_once() {
    let (url, heard) = listener(1);
    let app = TestApp::with(|settings| {
        settings.notify = Some(NotifySettings {
            url,
            events: vec![NoticeKind::Published, NoticeKind::Night],
            secret: NoticeSecret("a key".to_owned()),
            page: "https://lampyris.example.org/".to_owned(),
            ..NotifySettings::default()
        });
    });
    app.room("1", 1);
    app.clock.set("2026-01-17T02:30:30Z".parse().unwrap());
    app.within(async |service| schedules::due(service, service.now()).await.unwrap());
    let (refused, told) = (heard.recv().unwrap(), heard.recv().unwrap());
    // The second try is the same notice, to the byte.
    assert_eq!((&refused.1, &refused.0["x-lampyris-delivery"]), (&told.1, &told.0["x-lampyris-delivery"]));
    let notice: Value = serde_json::from_str(&told.1).unwrap();
    assert_eq!((notice["event"].as_str(), notice["system"].as_str()), (Some("published"), Some("room/1")));
    assert_eq!(notice["revision"], 1);
    assert_eq!(notice["link"], "https://lampyris.example.org/ui/systems/room/1/parameters");
    let signature = told.0["x-lampyris-signature"].strip_prefix("sha256=").unwrap();
    assert_eq!(signature, hmac_sha256(b"a key", told.1.as_bytes()));
    let (head, body) = heard.recv().unwrap();
    let night: Value = serde_json::from_str(&body).unwrap();
    assert_eq!((head["x-lampyris-event"].as_str(), night["event"].as_str()), ("night", Some("night")));
    assert!(night["message"].as_str().unwrap().starts_with("1 job: 1 new parameters."), "{night}");
    assert!(night["title"].as_str().unwrap().ends_with("2026-01-17"), "{night}");
    drop(app);
    assert!(heard.try_recv().is_err(), "something was told twice");
}

#[test]
fn ntfy_gets_a_sentence() {
    let (url, heard) = listener(0);
    let app = TestApp::with(|settings| {
        settings.notify =
            Some(NotifySettings { url, format: NoticeFormat::Ntfy, ..NotifySettings::default() });
    });
    app.room("1", 1);
    app.ended(&app.post_job(&serde_json::json!({"kind": "estimate", "system": "room/1"})));
    let (head, body) = heard.recv().unwrap();
    assert_eq!((head["title"].as_str(), head["tags"].as_str()), ("room/1: new parameters", "thermometer"));
    assert_eq!(body, "room/1 serves new parameters (revision 1).");
    assert!(!head.contains_key("x-lampyris-signature") && !head.contains_key("click"));
}

/// HMAC by its definition (RFC 2104), beside the library that the service uses.
fn hmac_sha256(key: &[u8], body: &[u8]) -> String {
    use sha2::{Digest, Sha256};
    let mut block = [0_u8; 64];
    block[..key.len()].copy_from_slice(key);
    let inner = Sha256::new().chain_update(block.map(|byte| byte ^ 0x36)).chain_update(body).finalize();
    let outer = Sha256::new().chain_update(block.map(|byte| byte ^ 0x5c)).chain_update(inner).finalize();
    outer.iter().map(|byte| format!("{byte:02x}")).collect()
}
