//! Who may import whom, and what the house looks like: enforced over the sources as text.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The stages, and what each may see beside the leaves `fault` and `units`. `app`, `cli` and `main` may see all.
const MAY_SEE: &[(&str, &[&str])] = &[
    ("model", &[]),
    ("data", &[]),
    ("optimise", &[]),
    ("simulate", &["model", "data"]),
    ("estimate", &["model", "data", "simulate", "optimise"]),
    ("diagnose", &["model", "data", "simulate", "optimise", "estimate"]),
    ("twin", &["model", "data", "simulate"]),
    ("store", &["model", "data", "simulate", "optimise", "estimate", "diagnose"]),
    ("jobs", &["model", "data", "simulate", "optimise", "estimate", "diagnose", "store", "settings"]),
    ("http", &["model", "data", "estimate", "diagnose", "store", "jobs", "settings"]),
    ("settings", &[]),
    ("fault", &[]),
    ("schema", &[]),
    ("units", &[]),
];
const LEAVES: [&str; 3] = ["fault", "schema", "units"];
/// The pure core: no async, no IO, no clock.
const CORE: [&str; 10] = ["model", "data", "optimise", "simulate", "estimate", "diagnose", "twin", "fault", "schema", "units"];
const IMPURE: [&str; 10] =
    ["tokio::", "axum::", "sqlx::", "tower", "std::time", "std::fs", "std::net", "std::env", "SystemTime", "Timestamp::now"];
const LONGEST_FILE: usize = 500;

/// All Rust files under a folder of the project, with their texts.
fn sources(folder: &str) -> BTreeMap<PathBuf, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = BTreeMap::new();
    let mut folders = vec![root.join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().map(Result::unwrap) {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.insert(path.strip_prefix(root).unwrap().to_owned(), fs::read_to_string(&path).unwrap());
            }
        }
    }
    files
}

/// `src/store/jobs.rs` and `src/settings.rs` belong to `store` and `settings`.
fn stage(path: &Path) -> String {
    let first = path.components().nth(1).unwrap().as_os_str().to_string_lossy().into_owned();
    first.trim_end_matches(".rs").to_owned()
}

/// Whether a file under `src` holds nothing but unit tests: `tests.rs` and `…_tests.rs`.
fn is_test(path: &Path) -> bool {
    path.file_stem().is_some_and(|stem| stem == "tests" || stem.to_string_lossy().ends_with("_tests"))
}

/// Whether the folder's `mod.rs` declares a file of unit tests for tests alone.
fn is_declared_for_tests(path: &Path, sources: &BTreeMap<PathBuf, String>) -> bool {
    let stem = path.file_stem().unwrap().to_string_lossy();
    let parent = path.with_file_name("mod.rs");
    sources.get(&parent).is_some_and(|text| text.contains(&format!("#[cfg(test)]\nmod {stem};")))
}

/// The code without comments and without its unit tests, which may use more.
fn code(text: &str) -> String {
    let body = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    body.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// The stages that a text names by `crate::`, also in grouped imports.
fn named(code: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        // `$crate::` in a macro names its own stage.
        let rest = &code[at + "crate::".len()..];
        let group = rest.strip_prefix('{').map(|inner| inner.split('}').next().unwrap_or_default());
        let parts: Vec<&str> = group.map_or_else(|| vec![rest], |group| group.split(',').collect());
        for part in parts {
            let name: String = part.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
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
    for (path, text) in sources("src").into_iter().filter(|(path, _)| !is_test(path)) {
        let stage = stage(&path);
        if ["main", "lib", "app", "cli"].contains(&stage.as_str()) {
            continue;
        }
        let Some((_, allowed)) = MAY_SEE.iter().find(|(name, _)| *name == stage) else {
            wrong.push(format!("{}: the stage `{stage}` has no place in the house", path.display()));
            continue;
        };
        for name in named(&code(&text)) {
            if name != stage && !LEAVES.contains(&name.as_str()) && !allowed.contains(&name.as_str()) {
                wrong.push(format!("{} sees `{name}`", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_core_is_pure() {
    let mut wrong = Vec::new();
    let core = |path: &Path| CORE.contains(&stage(path).as_str()) && !is_test(path);
    for (path, text) in sources("src").into_iter().filter(|(path, _)| core(path)) {
        let code = code(&text);
        wrong.extend(IMPURE.iter().filter(|word| code.contains(**word)).map(|word| format!("{} uses {word}", path.display())));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn each_outer_library_has_one_home() {
    let mut wrong = Vec::new();
    for (path, text) in sources("src") {
        let (stage, code) = (stage(&path), code(&text));
        for (library, homes) in
            [("sqlx::", &["store"][..]), ("axum::", &["http", "app", "cli"][..]), ("Timestamp::now", &["jobs", "cli"][..])]
        {
            if code.contains(library) && !homes.contains(&stage.as_str()) {
                wrong.push(format!("{} uses {library}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_house_is_tidy() {
    let ours = sources("src");
    let mut wrong: Vec<String> = ours
        .keys()
        .filter(|path| is_test(path) && !is_declared_for_tests(path, &ours))
        .map(|path| format!("{} is named as a test and is none", path.display()))
        .collect();
    for (path, text) in ours.into_iter().chain(sources("tests")) {
        let at = path.display();
        let lines = text.lines().count();
        if lines > LONGEST_FILE {
            wrong.push(format!("{at} has {lines} lines"));
        }
        let is_this = path.ends_with("layers.rs");
        if ["home", "work", "root", "Users"].iter().any(|place| text.contains(&format!("/{place}/"))) && !is_this {
            wrong.push(format!("{at} names a place of one machine"));
        }
        if path.starts_with("src") {
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
