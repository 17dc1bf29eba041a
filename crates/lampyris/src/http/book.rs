//! `/docs/book/`: the book of `docs/`, part of the binary, so that it can be read where there is no other
//! network. Its pages are Markdown in mdBook's layout, and have the addresses that mdBook gives them.

use super::constant::{ConstantBody, constants};
use super::problem::ApiError;
use super::shared::Shared;
use super::web::POLICY;
use axum::Router;
use axum::extract::Path;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;
use pulldown_cmark::{CowStr, Event, Options, Parser, Tag, TagEnd, html};
use rust_embed::RustEmbed;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write;
use std::sync::LazyLock;

const FIRST: &str = "index.html";
const CONTENTS: &str = "SUMMARY.md";

/// The pages by their addresses below `/docs/book/`, and the pictures and texts that they lead to. They are
/// made once, together, because each page shows the list of all.
static PAGES: LazyLock<HashMap<String, ConstantBody>> = LazyLock::new(|| {
    let mut all = constants::<Files>();
    all.extend(pages().into_iter().map(|(path, page)| (path.clone(), ConstantBody::new(&path, page))));
    all
});

#[derive(RustEmbed)]
#[folder = "../../docs"]
struct Files;

/// A page as the list of contents names it.
struct Entry {
    /// Its Markdown file.
    file: String,
    title: String,
}

/// The book. Like the page of the rooms it holds no data, and is no part of the described surface.
pub fn router() -> Router<Shared> {
    Router::new()
        .route("/docs/book", get(async || Redirect::temporary("/docs/book/")))
        .route("/docs/book/", get(async |headers: HeaderMap| answer(FIRST, &headers)))
        .route(
            "/docs/book/{*path}",
            get(async |Path(path): Path<String>, headers: HeaderMap| answer(&path, &headers)),
        )
}

fn answer(path: &str, headers: &HeaderMap) -> Response {
    match PAGES.get(path) {
        Some(page) => page.answer(Some(POLICY), headers),
        None => ApiError::NotFound("file", path.to_owned()).into_response(),
    }
}

/// A text of the book as it is written.
pub fn book_text(file: &str) -> Option<String> {
    Files::get(file).map(|file| String::from_utf8_lossy(&file.data).into_owned())
}

fn pages() -> BTreeMap<String, String> {
    let parts = contents(&markdown(CONTENTS));
    let order: Vec<&Entry> = parts.iter().flat_map(|(_, entries)| entries).collect();
    let page = |(at, entry): (usize, &&Entry)| {
        let neighbours = [at.checked_sub(1).map(|before| order[before]), order.get(at + 1).copied()];
        (address(&entry.file), document(entry, &parts, neighbours))
    };
    order.iter().enumerate().map(page).collect()
}

fn markdown(file: &str) -> String {
    book_text(file).unwrap_or_default()
}

/// The parts of the list of contents: their headings, and the pages below each. Pages before the first part
/// have none.
fn contents(summary: &str) -> Vec<(Option<String>, Vec<Entry>)> {
    let mut parts: Vec<(Option<String>, Vec<Entry>)> = vec![(None, Vec::new())];
    let events: Vec<Event> = Parser::new(summary).collect();
    for (at, event) in events.iter().enumerate() {
        match event {
            // The title of the list itself is the first of all.
            Event::Start(Tag::Heading { .. }) if at > 0 => {
                parts.push((Some(words(&events[at + 1..])), Vec::new()));
            }
            Event::Start(Tag::Link { dest_url, .. }) => {
                let entry = Entry { file: dest_url.to_string(), title: words(&events[at + 1..]) };
                if let Some((_, entries)) = parts.last_mut() {
                    entries.push(entry);
                }
            }
            _ => {}
        }
    }
    parts
}

/// The text up to the end of what encloses it.
fn words(events: &[Event]) -> String {
    let inside =
        events.iter().take_while(|event| !matches!(event, Event::End(TagEnd::Heading(_) | TagEnd::Link)));
    inside
        .filter_map(
            |event| if let Event::Text(text) | Event::Code(text) = event { Some(&**text) } else { None },
        )
        .collect()
}

/// Where a link of the book leads: pages are shown, and everything else is as it is.
fn address(link: &str) -> String {
    let (file, heading) = link.split_once('#').map_or((link, None), |(file, heading)| (file, Some(heading)));
    let shown = file.strip_suffix(".md").map_or_else(|| file.to_owned(), |name| format!("{name}.html"));
    heading.map_or_else(|| shown.clone(), |heading| format!("{shown}#{heading}"))
}

/// The name of a heading, as mdBook makes it; the second of the same name gets a number.
fn anchor(title: &str, taken: &mut BTreeSet<String>) -> String {
    let letter = |c: char| match c {
        c if c.is_alphanumeric() || c == '_' || c == '-' => Some(c),
        c if c.is_whitespace() => Some('-'),
        _ => None,
    };
    let name: String = title.trim().to_lowercase().chars().filter_map(letter).collect();
    let numbered = (1..).map(|number| format!("{name}-{number}"));
    let free = std::iter::once(name.clone()).chain(numbered).find(|name| !taken.contains(name));
    let free = free.unwrap_or(name);
    taken.insert(free.clone());
    free
}

/// The text of a page as HTML.
fn body(markdown: &str) -> String {
    let mut events: Vec<Event> = Parser::new_ext(markdown, Options::ENABLE_TABLES).collect();
    let mut taken = BTreeSet::new();
    for at in 0..events.len() {
        let title = words(&events[at + 1..]);
        match &mut events[at] {
            Event::Start(Tag::Heading { id, .. }) => *id = Some(anchor(&title, &mut taken).into()),
            Event::Start(Tag::Link { dest_url, .. }) => *dest_url = address(dest_url).into(),
            // The book is text: what looks like a tag is shown as it was written.
            Event::Html(text) | Event::InlineHtml(text) => {
                events[at] = Event::Text(std::mem::replace(text, CowStr::Borrowed("")));
            }
            _ => {}
        }
    }
    let mut page = String::new();
    html::push_html(&mut page, events.into_iter());
    // What is wider than the window scrolls by itself, also by keys. No text can look like a tag here.
    page.replace("<pre>", "<pre tabindex=\"0\">")
        .replace("<table>", "<div class=\"scroll\" tabindex=\"0\"><table>")
        .replace("</table>", "</table></div>")
}

fn escaped(text: &str) -> String {
    let mut safe = String::new();
    // Writing to a text cannot fail, here and below.
    let _ = pulldown_cmark_escape::escape_html(&mut safe, text);
    safe
}

/// A page with the way to all others.
fn document(
    entry: &Entry,
    parts: &[(Option<String>, Vec<Entry>)],
    [before, after]: [Option<&Entry>; 2],
) -> String {
    let mut list = String::new();
    for (heading, entries) in parts {
        if let Some(heading) = heading {
            let _ = write!(list, "<h2>{}</h2>", escaped(heading));
        }
        list.push_str("<ul>");
        for one in entries {
            let here = if one.file == entry.file { " aria-current=\"page\"" } else { "" };
            let _ = write!(list, "<li>{}</li>", link(one, here, ""));
        }
        list.push_str("</ul>");
    }
    let before = before.map(|one| link(one, " rel=\"prev\"", "← ")).unwrap_or_default();
    let after = after.map(|one| link(one, " rel=\"next\"", "→ ")).unwrap_or_default();
    format!(
        r##"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title} · Lampyris</title>
<link rel="icon" href="/ui/icon.svg" type="image/svg+xml">
<link rel="stylesheet" href="/ui/style.css">
<link rel="stylesheet" href="/docs/book.css">
<script src="/ui/early.js"></script>
</head>
<body>
<a class="skip" href="#main">Skip to the content</a>
<header>
<a class="brand" href="/ui/"><span class="glow" aria-hidden="true"></span>Lampyris</a>
<nav aria-label="Pages"><a href="/ui/">Overview</a><a href="/docs">API</a><a href="/docs/book/" aria-current="true">Book</a></nav>
<a class="to-contents" href="#contents">Contents</a>
</header>
<div class="book">
<main id="main" tabindex="-1">
{text}
<nav class="row apart" aria-label="Before and after"><span>{before}</span><span>{after}</span></nav>
</main>
<nav id="contents" class="contents" tabindex="-1" aria-label="Contents">{list}</nav>
</div>
</body>
</html>
"##,
        title = escaped(&entry.title),
        text = body(&markdown(&entry.file)),
    )
}

fn link(entry: &Entry, attribute: &str, sign: &str) -> String {
    format!("<a href=\"/docs/book/{}\"{attribute}>{sign}{}</a>", address(&entry.file), escaped(&entry.title))
}
