//! The book: all of its pages, with all that they lead to, from this service alone.

use crate::support::TestApp;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const BOOK: &str = "/docs/book/";

/// What a page leads to and shows.
fn links(page: &str) -> Vec<String> {
    let behind = |word: &str| {
        page.split(word).skip(1).map(|rest| rest.split('"').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    [behind("href=\""), behind("src=\"")].concat()
}

/// The path and the heading that a link of a page means.
fn resolved(page: &str, link: &str) -> (String, String) {
    let (path, heading) = link.split_once('#').unwrap_or((link, ""));
    if path.is_empty() || path.starts_with('/') {
        return (if path.is_empty() { page } else { path }.to_owned(), heading.to_owned());
    }
    let mut parts: Vec<&str> = page.split('/').collect();
    parts.pop();
    for part in path.split('/') {
        if part == ".." {
            parts.pop();
        } else {
            parts.push(part);
        }
    }
    (parts.join("/"), heading.to_owned())
}

/// The addresses of the Markdown files below a folder of the book.
fn addresses(folder: &Path) -> BTreeSet<String> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs"));
    let mut found = BTreeSet::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            found.extend(addresses(&entry));
        } else if entry.extension().is_some_and(|kind| kind == "md") && !entry.ends_with("SUMMARY.md") {
            let page = entry.strip_prefix(root).unwrap().with_extension("html");
            found.insert(format!("{BOOK}{}", page.display()));
        }
    }
    found
}

#[test]
fn every_link_of_every_page_leads_somewhere() {
    let app = TestApp::start();
    let mut pages: BTreeMap<String, String> = BTreeMap::new();
    let mut meant = BTreeSet::new();
    let mut others: BTreeMap<String, String> = BTreeMap::new();
    let mut waiting = vec![BOOK.to_owned()];
    while let Some(path) = waiting.pop() {
        if pages.contains_key(&path) || others.contains_key(&path) {
            continue;
        }
        // A picture is no text.
        let method = if path.ends_with(".png") { "HEAD" } else { "GET" };
        let answer = app.send(method, &path, &[], None).unwrap().expect(200);
        let kind = answer.header("content-type").to_owned();
        if !path.starts_with(BOOK) || !kind.starts_with("text/html") {
            others.insert(path, kind);
            continue;
        }
        for link in links(&answer.text) {
            let (target, heading) = resolved(&path, &link);
            assert!(!link.contains("://") && !target.ends_with(".md"), "{path} leads to {link}");
            waiting.push(target.clone());
            meant.insert((path.clone(), target, heading));
        }
        pages.insert(path, answer.text);
    }
    for (page, target, heading) in meant.iter().filter(|(.., heading)| !heading.is_empty()) {
        let text = &pages[target];
        assert!(text.contains(&format!(" id=\"{heading}\"")), "{page} leads to {target}#{heading}");
    }
    let shown: BTreeSet<String> = pages.keys().filter(|path| *path != BOOK).cloned().collect();
    assert_eq!(shown, addresses(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs"))));
    for (path, kind) in &others {
        let expected = match path.rsplit('.').next().unwrap() {
            "png" => "image/png",
            "css" => "text/css",
            "js" => "text/javascript",
            "svg" => "image/svg+xml",
            "json" => "application/json",
            _ => "text/html",
        };
        assert!(kind.starts_with(expected), "{path}: {kind}");
    }
    assert!(others.keys().any(|path| path.ends_with(".png")) && others.contains_key("/docs"), "{others:?}");
}

#[test]
fn a_page_is_its_markdown_with_names_for_its_headings() {
    let app = TestApp::start();
    let page = app.get("/docs/book/tutorial/first-room.html").expect(200).text;
    let here = "<a href=\"/docs/book/tutorial/first-room.html\" aria-current=\"page\">";
    assert!(page.contains(here) && page.matches("<h1").count() == 1, "{page}");
    assert!(page.contains("<pre tabindex=\"0\"><code class=\"language-sh\">") && !page.contains("```"));
    assert!(page.contains("rel=\"prev\"") && page.contains("rel=\"next\""));
    let table = app.get("/docs/book/reference/statuses.html").expect(200).text;
    assert!(table.contains("<div class=\"scroll\" tabindex=\"0\"><table>"), "{table}");
    // What looks like a tag is text.
    assert!(!table.contains("<id>"));
}

#[test]
fn the_book_runs_nothing_from_elsewhere_and_is_sent_once() {
    let app = TestApp::start();
    let first = app.get("/docs/book/index.html").expect(200);
    assert_eq!(first.text, app.get("/docs/book").expect(200).text, "the short address leads there");
    let policy = first.header("content-security-policy");
    assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe") && !policy.contains("http"));
    assert!(!first.text.contains(" style=") && !first.text.contains("<style"), "{}", first.text);
    let tag = first.header("etag").to_owned();
    app.get_with("/docs/book/index.html", &[("if-none-match", &tag)]).expect(304);
    app.get("/docs/book/other.html").problem(404, "file-not-found");
    app.get("/docs/book/..%2Fdocs.js").problem(404, "file-not-found");
    assert!(app.get("/docs").expect(200).text.contains("href=\"docs/book/\""));
}
