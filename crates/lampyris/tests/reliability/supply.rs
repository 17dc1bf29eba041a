//! What the binary is made of: published packages alone, under licences that may be passed on; what runs
//! while it is built is listed, and unsafe code has one place.

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// Licences of which each package offers one, or needs no more than several.
const LICENCES: [&str; 8] = [
    "MIT",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-3-Clause",
    "ISC",
    "Unicode-3.0",
    "Zlib",
    "CDLA-Permissive-2.0",
];
/// The project's own packages.
const OWN: [&str; 3] = ["lampyris", "lampyris-core", "lampyris-studies"];
/// Packages that run code of their own while the project is built. Whoever adds one has looked at it.
const AT_BUILD_TIME: &str = include_str!("supply.txt");

fn project(file: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(file)).unwrap()
}

/// Whether an expression such as `(MIT OR Apache-2.0) AND Unicode-3.0` can be met.
fn is_allowed(expression: &str) -> bool {
    let plain = expression.replace(['(', ')'], "").replace(" / ", " OR ").replace('/', " OR ");
    plain.split(" AND ").all(|part| part.split(" OR ").any(|licence| LICENCES.contains(&licence.trim())))
}

#[test]
fn every_package_is_a_published_one_with_its_checksum() {
    let lock: toml::Table = toml::from_str(&project("Cargo.lock")).unwrap();
    let packages = lock["package"].as_array().unwrap();
    let text = |package: &toml::Value, field: &str| {
        package.get(field).and_then(toml::Value::as_str).unwrap_or_default().to_owned()
    };
    let mut sources = BTreeSet::new();
    // Our own come from nowhere.
    let (own, foreign): (Vec<&toml::Value>, Vec<&toml::Value>) =
        packages.iter().partition(|package| OWN.contains(&text(package, "name").as_str()));
    assert_eq!(own.len(), OWN.len());
    for package in &foreign {
        let name = text(package, "name");
        assert_eq!(text(package, "checksum").len(), 64, "{name}");
        sources.insert(text(package, "source"));
    }
    assert_eq!(sources.len(), 1, "{sources:?}");
    assert!(sources.iter().all(|source| source.starts_with("registry+")), "{sources:?}");
    println!("SUP-1: {} packages, all from one registry and with a checksum", foreign.len());
}

#[test]
fn licences_can_be_met_and_what_runs_at_build_time_is_known() {
    let run = |program: &str, arguments: &[&str]| {
        let output =
            Command::new(program).args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let version = run("rustc", &["-vV"]);
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
    // Packages of other platforms were never fetched.
    let metadata = run(
        env!("CARGO"),
        &["metadata", "--locked", "--offline", "--format-version", "1", "--filter-platform", host],
    );
    let metadata: Value = serde_json::from_str(&metadata).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let text = |package: &Value, field: &str| package[field].as_str().unwrap_or_default().to_owned();
    let wrong: Vec<String> = packages
        .iter()
        .filter(|package| !is_allowed(&text(package, "license")))
        .map(|package| format!("{}: {}", text(package, "name"), package["license"]))
        .collect();
    assert!(wrong.is_empty(), "{wrong:?}");
    assert!(is_allowed("(MIT OR GPL-3.0) AND Zlib") && !is_allowed("MIT AND GPL-3.0") && !is_allowed(""));
    let runs = |package: &Value| {
        let kinds = package["targets"]
            .as_array()
            .into_iter()
            .flatten()
            .flat_map(|target| target["kind"].as_array().into_iter().flatten());
        kinds.into_iter().any(|kind| kind == "custom-build" || kind == "proc-macro")
    };
    let running: BTreeSet<String> =
        packages.iter().filter(|package| runs(package)).map(|package| text(package, "name")).collect();
    let known: BTreeSet<String> = AT_BUILD_TIME.lines().map(str::to_owned).collect();
    let new: Vec<&String> = running.difference(&known).collect();
    assert!(new.is_empty(), "these run code at build time and are not listed: {new:?}");
    println!(
        "SUP-1: {} packages have licences that can be met, {} run code at build time, all listed",
        packages.len(),
        running.len()
    );
}

#[test]
fn unsafe_code_has_one_place() {
    let mut folders = ["core", "lampyris", "studies"]
        .map(|name| Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name).join("src"))
        .to_vec();
    let mut places = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if std::fs::read_to_string(&path).is_ok_and(|text| text.contains("allow(unsafe_code)")) {
                places.push(path.file_name().unwrap().to_string_lossy().into_owned());
            }
        }
    }
    assert_eq!(places, ["cpu.rs"], "the choice between instruction sets is the only reason");
    assert!(project("Cargo.toml").contains("unsafe_code = \"deny\""));
}
