//! The page: served whole, from this service alone.

use crate::support::TestApp;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::collections::BTreeSet;
use std::io::Write;

/// What a text imports or links to, as paths of this service.
fn parts_of(path: &str, text: &str) -> Vec<String> {
    let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
    let mut found = Vec::new();
    for quoted in
        text.split(['"', '\'']).filter(|quoted| quoted.len() < 100 && !quoted.contains(char::is_whitespace))
    {
        let last = quoted.rsplit('/').next().unwrap_or_default();
        if ![".js", ".mjs", ".css", ".svg"].iter().any(|end| last.ends_with(end)) {
            continue;
        }
        if quoted.starts_with("/ui/") {
            found.push(quoted.to_owned());
        } else if let Some(rest) = quoted.strip_prefix("../") {
            found.push(format!("{}/{rest}", folder.rsplit_once('/').unwrap().0));
        } else if let Some(rest) = quoted.strip_prefix("./") {
            found.push(format!("{folder}/{rest}"));
        }
    }
    found
}

/// How many bytes a text has as it is sent.
fn packed(text: &str) -> usize {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(text.as_bytes()).unwrap();
    encoder.finish().unwrap().len()
}

#[test]
fn the_page_and_all_its_parts_come_from_this_service() {
    let app = TestApp::start();
    let page = app.get("/ui/").expect(200);
    assert!(page.header("content-type").starts_with("text/html"));
    let mut asked: BTreeSet<String> = BTreeSet::new();
    let mut waiting = parts_of("/ui/index.html", &page.text);
    let mut bytes = packed(&page.text);
    while let Some(path) = waiting.pop() {
        if !asked.insert(path.clone()) {
            continue;
        }
        let part = app.get(&path).expect(200);
        let kind = match path.rsplit('.').next().unwrap() {
            "css" => "text/css",
            "svg" => "image/svg+xml",
            _ => "text/javascript",
        };
        assert!(part.header("content-type").starts_with(kind), "{path}: {}", part.header("content-type"));
        assert_eq!(part.header("x-content-type-options"), "nosniff");
        bytes += packed(&part.text);
        waiting.extend(parts_of(&path, &part.text));
    }
    assert!(asked.len() > 30, "only {asked:?}");
    assert!(asked.contains("/ui/vendor/preact.mjs") && asked.contains("/ui/pages/adding.js"));
    // All pages, of which some are read when somebody goes there; the first view is measured in a browser.
    assert!(bytes < 240_000, "{bytes} bytes as they are sent");
}

#[test]
fn every_answer_is_what_it_says_and_no_part_of_foreign_pages() {
    let app = TestApp::start();
    for path in ["/ui/", "/healthz", "/systems", "/params/room/1", "/openapi.json", "/nothing"] {
        let answer = app.get(path);
        assert_eq!(answer.header("x-content-type-options"), "nosniff", "{path}");
        assert_eq!(answer.header("cross-origin-resource-policy"), "same-origin", "{path}");
    }
}

#[test]
fn nothing_but_files_of_this_service_may_run() {
    let app = TestApp::start();
    for path in ["/ui/", "/ui/main.js"] {
        let policy = app.get(path).expect(200).header("content-security-policy").to_owned();
        assert!(
            policy.contains("default-src 'none'")
                && policy.contains("script-src 'self'")
                && policy.contains("frame-ancestors 'none'")
        );
        assert!(!policy.contains("unsafe") && !policy.contains("http") && !policy.contains('*'), "{policy}");
    }
    // What the policy forbids is not there either.
    let page = app.get("/ui/").expect(200).text;
    assert!(
        !page.contains("<style")
            && !page.contains(" style=")
            && !page.contains(" onload=")
            && !page.contains("://"),
        "{page}"
    );
    let scripts = page.matches("<script").count();
    assert!(
        scripts > 0
            && scripts
                == page.matches("<script src=").count()
                    + page.matches("<script type=\"module\" src=").count()
    );
}

#[test]
fn every_address_of_the_page_answers_with_it() {
    let app = TestApp::start();
    let page = app.get("/ui/").expect(200).text;
    for address in [
        "/ui/systems/room/4/missing",
        "/ui/systems/room/4?from=2020-01-01T00%3A00%3A00Z&mode=PT6H",
        "/ui/models/tite%2Bsensor_lag",
        "/ui/jobs",
    ] {
        assert_eq!(app.get(address).expect(200).text, page, "{address}");
    }
    assert_eq!(app.get("/").expect(200).text, page, "the root leads there");
    app.get("/ui/other.js").problem(404, "file-not-found");
    app.get("/ui/..%2Fdocs%2Fdocs.js").problem(404, "file-not-found");
    app.get("/ui/pages/").expect(200);
}

#[test]
fn a_part_that_has_not_changed_is_not_sent_again() {
    let app = TestApp::start();
    let first = app.get("/ui/main.js").expect(200);
    let tag = first.header("etag").to_owned();
    assert!(tag.starts_with("W/\"") && tag != app.get("/ui/api.js").expect(200).header("etag"));
    let again = app.get_with("/ui/main.js", &[("if-none-match", &tag)]).expect(304);
    assert!(again.text.is_empty() && again.header("etag") == tag);
    app.get_with("/ui/main.js", &[("if-none-match", "W/\"other\"")]).expect(200);
}
