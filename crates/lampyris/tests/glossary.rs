//! Every word that the page explains stands in the glossary of the book, which is where the page reads it.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
/// What the gate flags; a channel or a parameter may follow.
const FLAGS: [&str; 8] = [
    "at bound",
    "non identifiable",
    "undetermined",
    "unseen",
    "waived",
    "barely better than persistence",
    "low confidence",
    "promoted by operator",
];
/// Statuses that the page shows and never explains: what a check did stands beside its limit.
const PLAIN: [&str; 2] = ["pass", "fail"];

fn text(path: &str) -> String {
    fs::read_to_string(Path::new(ROOT).join(path)).unwrap()
}

/// The terms of the glossary, and what the first paragraph below each says.
fn glossary() -> Vec<(String, String)> {
    let text = text("docs/reference/glossary.md");
    let entry = |entry: &str| {
        let (term, rest) = entry.split_once("\n\n").unwrap();
        (term.to_owned(), rest.split("\n\n").next().unwrap().trim().to_owned())
    };
    text.split("\n### ").skip(1).map(entry).collect()
}

/// Every module of the page.
fn modules() -> Vec<PathBuf> {
    let folders = ["", "pages", "parts", "charts"].map(|folder| Path::new(ROOT).join("web/ui").join(folder));
    let files =
        folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap()).map(|entry| entry.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|extension| extension == "js")).collect()
}

/// What stands between two texts, as often as it does.
fn between<'t>(text: &'t str, before: &'t str, after: &'t str) -> impl Iterator<Item = &'t str> {
    text.split(before).skip(1).filter_map(move |rest| rest.split(after).next())
}

/// The terms that the page names by themselves, those of its table of other words, its statuses, and the
/// rules of the gate.
fn used() -> BTreeSet<String> {
    let mut used: BTreeSet<String> = FLAGS.map(str::to_owned).into();
    for module in modules() {
        let source = fs::read_to_string(&module).unwrap();
        for element in between(&source, "<${Term}", "</${Term}>") {
            used.extend(between(element, "of=\"", "\"").take(1).map(str::to_owned));
        }
    }
    let terms = text("web/ui/parts/term.js");
    let table = between(&terms, "const TERMS = {", "};").next().unwrap();
    used.extend(
        table.lines().filter_map(|line| line.rsplit_once(": '")?.1.strip_suffix("',")).map(str::to_owned),
    );
    used.extend(["hours ahead", "unseen data"].map(str::to_owned));
    let statuses = text("web/ui/parts/status.js");
    let looks = between(&statuses, "const LOOKS = {", "};").next().unwrap();
    let names = looks.lines().filter_map(|line| Some(line.trim().split_once(": [")?.0.replace('_', " ")));
    used.extend(names.filter(|name| !PLAIN.contains(&name.as_str())));
    used.extend((1..=12).map(|rule| format!("G{rule}")));
    used
}

#[test]
fn every_word_that_the_page_explains_stands_in_the_glossary() {
    let known: BTreeSet<String> = glossary().into_iter().map(|(term, _)| term).collect();
    let used = used();
    assert!(used.len() > 90, "the page has lost its words, or this test does not find them: {used:?}");
    let missing: Vec<&String> = used.iter().filter(|term| !known.contains(*term)).collect();
    assert!(missing.is_empty(), "not in docs/reference/glossary.md: {missing:?}");
}

#[test]
fn every_term_is_explained_once_and_briefly() {
    let mut seen = BTreeSet::new();
    for (term, meaning) in glossary() {
        assert!(meaning.len() > 20 && meaning.ends_with(['.', '?']), "{term}: {meaning}");
        assert!(meaning.matches(". ").count() < 3, "{term} has more than three sentences: {meaning}");
        assert!(seen.insert(term.to_lowercase()), "{term} stands there twice");
    }
}
