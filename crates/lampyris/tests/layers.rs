//! Who may import whom, and what the house looks like: enforced over the sources as text.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod sources;

use sources::{code, is_source, is_test, sources};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The stages of the core, and what each may see beside the leaves.
const CORE: &[(&str, &[&str])] = &[
    ("model", &[]),
    ("data", &[]),
    ("optimise", &[]),
    ("simulate", &["model", "data"]),
    ("estimate", &["model", "data", "simulate", "optimise"]),
    ("diagnose", &["model", "data", "simulate", "optimise", "estimate"]),
    ("twin", &["model", "data", "simulate"]),
    ("cpu", &[]),
    ("fault", &[]),
    ("gram", &[]),
    ("interrupt", &[]),
    ("pace", &[]),
    ("schema", &[]),
    ("units", &[]),
];
/// The stages of the service, and what each may see of it and of the core. `app` and `cli` may see all.
const SERVICE: &[(&str, &[&str])] = &[
    ("store", &["model", "data", "simulate", "optimise", "estimate", "diagnose"]),
    ("service", &["model", "data", "simulate", "optimise", "estimate", "diagnose", "store", "settings"]),
    ("http", &["model", "data", "estimate", "diagnose", "store", "service", "settings"]),
    ("settings", &["store"]),
];
const LEAVES: [&str; 7] = ["cpu", "fault", "gram", "interrupt", "pace", "schema", "units"];
const IN_CORE: &str = "crates/core/src";
const IN_SERVICE: &str = "crates/lampyris/src";
const IN_STORE: &str = "crates/lampyris/src/store";
const IN_HTTP: &str = "crates/lampyris/src/http";
/// The pure core: no async, no IO, no clock.
const IMPURE: [&str; 10] = [
    "tokio::",
    "axum::",
    "sqlx::",
    "tower",
    "std::time",
    "std::fs",
    "std::net",
    "std::env",
    "SystemTime",
    "Timestamp::now",
];
const LONGEST_FILE: usize = 500;
/// `rustfmt.toml` keeps code within it; comments are for their writers to break.
const WIDEST_LINE: usize = 110;
/// `Problem` is what is estimated, and by RFC 9457 also an answer that says what went wrong.
const NAMED_TWICE: [&str; 1] = ["Problem"];
/// What a public name may be of.
const KINDS: [&str; 5] = ["struct", "enum", "trait", "type", "fn"];

/// `crates/lampyris/src/store/jobs.rs` and `crates/lampyris/src/settings.rs` belong to `store` and
/// `settings`.
fn stage(path: &Path) -> String {
    let first = path.components().nth(3).unwrap().as_os_str().to_string_lossy().into_owned();
    first.trim_end_matches(".rs").to_owned()
}

/// Whether the folder's `mod.rs` declares a file of unit tests for tests alone.
fn is_declared_for_tests(path: &Path, sources: &BTreeMap<PathBuf, String>) -> bool {
    let stem = path.file_stem().unwrap().to_string_lossy();
    let parent = path.with_file_name("mod.rs");
    sources.get(&parent).is_some_and(|text| text.contains(&format!("#[cfg(test)]\nmod {stem};")))
}

/// The stages that a text names by `crate::` or `lampyris_core::`, also in grouped imports.
fn named(code: &str) -> Vec<String> {
    let mut names = Vec::new();
    let places = ["crate::", "lampyris_core::"].map(|root| code.match_indices(root));
    for (at, root) in places.into_iter().flatten() {
        // `$crate::` in a macro names its own stage.
        let rest = &code[at + root.len()..];
        let group = rest.strip_prefix('{').map(|inner| inner.split('}').next().unwrap_or_default());
        let parts: Vec<&str> = group.map_or_else(|| vec![rest], |group| group.split(',').collect());
        for part in parts {
            let name: String =
                part.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            if !name.is_empty() {
                names.push(name);
            }
        }
    }
    names
}

#[test]
fn every_stage_sees_only_what_lies_before_it() {
    let mut wrong = Vec::new();
    for (folder, stages) in [(IN_CORE, CORE), (IN_SERVICE, SERVICE)] {
        for (path, text) in sources(folder).into_iter().filter(|(path, _)| !is_test(path)) {
            let stage = stage(&path);
            if ["main", "lib", "app", "cli"].contains(&stage.as_str()) {
                continue;
            }
            let Some((_, allowed)) = stages.iter().find(|(name, _)| *name == stage) else {
                wrong.push(format!("{}: the stage `{stage}` has no place in the house", path.display()));
                continue;
            };
            for name in named(&code(&text)) {
                if name != stage && !LEAVES.contains(&name.as_str()) && !allowed.contains(&name.as_str()) {
                    wrong.push(format!("{} sees `{name}`", path.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_core_is_pure() {
    let mut wrong = Vec::new();
    for (path, text) in sources(IN_CORE).into_iter().filter(|(path, _)| !is_test(path)) {
        let code = code(&text);
        wrong.extend(
            IMPURE
                .iter()
                .filter(|word| code.contains(**word))
                .map(|word| format!("{} uses {word}", path.display())),
        );
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn each_outer_library_has_one_home() {
    let mut wrong = Vec::new();
    for (path, text) in sources(IN_SERVICE) {
        let (stage, code) = (stage(&path), code(&text));
        for (library, homes) in [
            ("sqlx::", &["store"][..]),
            ("axum::", &["http", "app", "cli"][..]),
            ("Timestamp::now", &["service", "cli"][..]),
        ] {
            if code.contains(library) && !homes.contains(&stage.as_str()) {
                wrong.push(format!("{} uses {library}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The functions of the store that begin a transaction, as `systems::put`; only these write.
fn writers() -> BTreeSet<String> {
    let mut writers = BTreeSet::new();
    for (path, text) in sources(IN_STORE) {
        let noun = path.file_stem().unwrap().to_string_lossy();
        for function in code(&text).split("pub async fn ").skip(1) {
            let body = function.split("\n}").next().unwrap_or_default();
            if body.contains(".write()") {
                let name: String =
                    function.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                writers.insert(format!("{noun}::{name}"));
            }
        }
    }
    writers
}

#[test]
fn the_surface_writes_nothing_by_itself() {
    let writers = writers();
    assert!(writers.contains("systems::put") && !writers.contains("systems::get"), "{writers:?}");
    let mut wrong = Vec::new();
    for (path, text) in sources(IN_HTTP) {
        let code = code(&text);
        for (at, _) in code.match_indices("store::") {
            let called: String =
                code[at + 7..].chars().take_while(|c| c.is_alphanumeric() || "_:".contains(*c)).collect();
            if writers.contains(&called) {
                wrong.push(format!("{} calls store::{called}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn one_follower_shows_what_was_committed() {
    let mut callers = Vec::new();
    for (path, text) in sources(IN_SERVICE) {
        let code = code(&text);
        for call in [".store.follow()", "params::follow(", "params.swap(", "params.forget(", "read_some("] {
            let calls = code.matches(call).count() - code.matches(&format!("fn {call}")).count();
            callers.extend((0..calls).map(|_| (call, path.file_name().unwrap().to_owned())));
        }
    }
    callers.sort();
    let expected = [
        (".store.follow()", "app.rs"),
        ("params.forget(", "params.rs"),
        ("params.swap(", "params.rs"),
        ("params::follow(", "app.rs"),
        ("read_some(", "params.rs"),
        ("read_some(", "params.rs"),
    ];
    assert_eq!(callers, expected.map(|(call, file)| (call, file.into())));
}

/// Whether a line is a comment, and no row of a table, grammar or drawing.
fn is_prose(line: &str) -> bool {
    let line = line.trim_start();
    line.starts_with("//") && !line.contains('|') && !line.contains("-->")
}

#[test]
fn the_house_is_tidy() {
    let ours = sources("crates");
    let mut wrong: Vec<String> = ours
        .keys()
        .filter(|path| is_source(path) && is_test(path) && !is_declared_for_tests(path, &ours))
        .map(|path| format!("{} is named as a test and is none", path.display()))
        .collect();
    for (path, text) in ours {
        let at = path.display();
        let lines = text.lines().count();
        if lines > LONGEST_FILE {
            wrong.push(format!("{at} has {lines} lines"));
        }
        let is_this = path.ends_with("layers.rs");
        if ["home", "work", "root", "Users"].iter().any(|place| text.contains(&format!("/{place}/")))
            && !is_this
        {
            wrong.push(format!("{at} names a place of one machine"));
        }
        if is_source(&path) && !is_test(&path) {
            for line in code(&text).lines().chain(text.lines().filter(|line| is_prose(line))) {
                // A string of data or markup is not broken.
                if line.chars().count() > WIDEST_LINE && !line.contains('"') {
                    wrong.push(format!("{at} has a line of more than {WIDEST_LINE} columns: {line}"));
                }
            }
        }
        if is_source(&path) {
            let code = code(&text);
            for word in [".unwrap()", "todo!", "unimplemented!", "dbg!("] {
                if code.contains(word) && !is_test(&path) {
                    wrong.push(format!("{at} has {word}"));
                }
            }
            if !text.starts_with("//!") {
                wrong.push(format!("{at} does not say what it is for"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The names of the last table of the vocabulary.
fn refused_names() -> BTreeSet<String> {
    let page = std::fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../docs/contributing/vocabulary.md"
    ))
    .unwrap();
    let table = page.split("## Names that the code does not use").nth(1).unwrap();
    let row =
        |line: &str| line.strip_prefix("| `").and_then(|rest| rest.split('`').next()).map(str::to_owned);
    table.lines().filter_map(row).collect()
}

/// The public names of a text, each with what it is of.
fn public_names(code: &str) -> Vec<(&str, &str)> {
    let name = |line| {
        let mut words = str::split(line, |c: char| !c.is_alphanumeric() && c != '_')
            .skip_while(|word| !KINDS.contains(word));
        words.next().zip(words.next())
    };
    code.lines().map(str::trim_start).filter(|line| line.starts_with("pub")).filter_map(name).collect()
}

#[test]
fn public_names_are_words_of_the_field() {
    let refused = refused_names();
    assert!(refused.len() > 10, "the table was found: {refused:?}");
    let mut wrong = Vec::new();
    for (path, text) in sources(IN_CORE).into_iter().chain(sources(IN_SERVICE)) {
        for (_, name) in public_names(&code(&text)) {
            if refused.contains(name) {
                wrong.push(format!("{}: {name}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_name_stands_for_one_public_type() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    // Each verb of the command line is a program of its own: all of them have `Arguments`.
    let verbs = Path::new(IN_SERVICE).join("cli");
    for (path, text) in sources(IN_CORE).into_iter().chain(sources(IN_SERVICE)) {
        if path.starts_with(&verbs) {
            continue;
        }
        for (_, name) in public_names(&code(&text)).into_iter().filter(|(kind, _)| *kind != "fn") {
            places.entry(name.to_owned()).or_default().push(path.display().to_string());
        }
    }
    places.retain(|name, places| places.len() > 1 && !NAMED_TWICE.contains(&name.as_str()));
    assert!(places.is_empty(), "{places:#?}");
}

/// The compiler puts every free `pub async fn` into every program of its crate, and with it all that it calls:
/// `pub(crate)` keeps the service out of the program of its unit tests.
#[test]
fn an_asynchronous_function_is_public_where_another_crate_calls_it() {
    let outside: String = ["crates/lampyris/tests", "crates/studies/src"]
        .iter()
        .flat_map(|folder| sources(folder).into_values())
        .collect();
    let mut called_by_nobody = Vec::new();
    for (path, text) in sources(IN_SERVICE) {
        let module = match path.file_stem().unwrap().to_str().unwrap() {
            "mod" => path.parent().unwrap().file_name().unwrap().to_str().unwrap(),
            stem => stem,
        };
        for line in code(&text).lines().filter_map(|line| line.strip_prefix("pub async fn ")) {
            let name = line.split(['(', '<']).next().unwrap();
            // A generic one is compiled where it is called.
            let is_generic = line[name.len()..].starts_with('<') || line.contains("impl ");
            if !is_generic && !outside.contains(&format!("{module}::{name}(")) {
                called_by_nobody.push(format!("{module}::{name}"));
            }
        }
    }
    assert!(called_by_nobody.is_empty(), "nothing outside the crate calls {called_by_nobody:?}: pub(crate)");
}
