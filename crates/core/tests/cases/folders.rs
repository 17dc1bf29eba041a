//! Cases as folders of data: a `case.toml` in each, and a test for each that bears its name.

use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// The folder of a case.
pub fn folder(kind: &str, name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/cases").join(kind).join(name)
}

/// What the `case.toml` of a case says.
pub fn case<T: DeserializeOwned>(kind: &str, name: &str) -> T {
    let path = folder(kind, name).join("case.toml");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The names of all folders of a kind, in order.
pub fn names(kind: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder(kind, "")).unwrap().map(|entry| entry.unwrap());
    let mut names: Vec<String> = entries
        .filter(|entry| entry.file_type().unwrap().is_dir())
        .map(|entry| entry.file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Makes a test of every folder of a kind that is named here, which calls `run` with its name, and one that
/// compares the names with the folders. Those behind `full` are run with the full figures alone.
macro_rules! cases {
    ($kind:literal, $run:path, { $($name:ident)* }, full { $($left:ident)* }) => {
        $(#[test] fn $name() { $run(stringify!($name)) })*
        $(#[test] #[ignore = "left to the full figures"] fn $left() { $run(stringify!($left)) })*

        #[test]
        fn every_folder_is_a_test() {
            let mut named = vec![$(stringify!($name),)* $(stringify!($left),)*];
            named.sort_unstable();
            assert_eq!(named, crate::folders::names($kind));
        }
    };
}
pub(crate) use cases;
