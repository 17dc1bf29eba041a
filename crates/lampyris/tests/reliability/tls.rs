//! The service under TLS: the certificate that it shows, and another one while it runs.

use crate::support::process::{Process, Said, program};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// How a verb ends that was told of an empty list.
const NOTHING: i32 = 3;

/// Makes a certificate that rests on nothing but itself, good for the loopback address.
fn certificate(folder: &Path, name: &str) -> (PathBuf, PathBuf) {
    let (certificate, key) = (folder.join(format!("{name}.pem")), folder.join(format!("{name}.key")));
    let made = Command::new("openssl")
        .args(["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"])
        .args([
            "-days",
            "2",
            "-subj",
            "/CN=localhost",
            "-addext",
            "subjectAltName=DNS:localhost,IP:127.0.0.1",
        ])
        .args(["-addext", "basicConstraints=critical,CA:FALSE"])
        .arg("-keyout")
        .arg(&key)
        .arg("-out")
        .arg(&certificate)
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    (certificate, key)
}

/// Asks for the list of systems, trusting a certificate.
fn ask(service: &Process, trusted: &Path) -> Said {
    service.verb(&["systems", "list", "--ca", trusted.to_str().unwrap()])
}

#[test]
fn tokens_travel_under_a_certificate_that_is_renewed_while_the_service_runs() {
    let dir = tempfile::tempdir().unwrap();
    let (first, first_key) = certificate(dir.path(), "first");
    let (second, second_key) = certificate(dir.path(), "second");
    let (shown, key) = (dir.path().join("shown.pem"), dir.path().join("shown.key"));
    std::fs::copy(&first, &shown).unwrap();
    std::fs::copy(&first_key, &key).unwrap();
    let environment =
        [("LAMPYRIS_TLS_CERTIFICATE", shown.to_str().unwrap()), ("LAMPYRIS_TLS_KEY", key.to_str().unwrap())];
    let service = Process::start_with(&dir.path().join("tls.db"), &environment);
    assert!(service.base().starts_with("https://127.0.0.1:"), "{}", service.base());
    ask(&service, &first).expect(NOTHING);
    assert!(ask(&service, &second).err.contains("no answer"), "a certificate of somebody else was trusted");
    // Whoever speaks in clear text is told nothing.
    let mut clear = TcpStream::connect(service.base().strip_prefix("https://").unwrap()).unwrap();
    clear.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    let mut said = Vec::new();
    let _ = clear.read_to_end(&mut said);
    assert!(!said.windows(4).any(|bytes| bytes == b"HTTP"), "{said:?}");

    // A key that does not belong to its certificate changes nothing; the pair does.
    std::fs::copy(&second, &shown).unwrap();
    service.signal("HUP");
    ask(&service, &first).expect(NOTHING);
    std::fs::copy(&second_key, &key).unwrap();
    service.signal("HUP");
    let begun = Instant::now();
    while ask(&service, &second).code != Some(NOTHING) {
        assert!(begun.elapsed() < Duration::from_secs(60), "the new certificate is not shown");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(ask(&service, &first).code != Some(NOTHING), "the old certificate is still shown");
    // Whoever opened a pipe would wait for ever.
    std::fs::remove_file(&shown).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(&shown).status().unwrap().success());
    for _ in 0..3 {
        service.signal("HUP");
        std::thread::sleep(Duration::from_millis(50));
        ask(&service, &second).expect(NOTHING);
    }
    assert_eq!(service.terminate().0, Some(0));
}

#[test]
fn a_certificate_that_cannot_be_used_keeps_the_service_from_starting() {
    let dir = tempfile::tempdir().unwrap();
    let ((first, _), (_, other_key)) = (certificate(dir.path(), "first"), certificate(dir.path(), "other"));
    let start = |certificate: &Path, key: &Path| {
        let output = program()
            .args(["serve", "--bind", "127.0.0.1:0", "--database"])
            .arg(dir.path().join("never.db"))
            .env("LAMPYRIS_TLS_CERTIFICATE", certificate)
            .env("LAMPYRIS_TLS_KEY", key)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    let empty = dir.path().join("empty.pem");
    std::fs::write(&empty, "").unwrap();
    for (certificate, key, named) in
        [(&first, &other_key, "first.pem"), (&empty, &other_key, "empty.pem"), (&first, &empty, "empty.pem")]
    {
        let said = start(certificate, key);
        assert!(said.contains("certificate cannot be used") && said.contains(named), "{said}");
    }
    assert!(!dir.path().join("never.db").exists());
}

#[test]
fn a_hangup_without_a_certificate_ends_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let mut service = Process::start(&dir.path().join("hangup.db"));
    service.signal("HUP");
    std::thread::sleep(Duration::from_millis(200));
    service.client.get("/healthz").expect(200);
    assert!(!service.has_ended());
}
