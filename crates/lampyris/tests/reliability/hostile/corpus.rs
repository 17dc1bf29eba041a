//! The cases of the fuzzers, on their seeds and on all documents of the project.

#[path = "../../../../../fuzz/cases.rs"]
mod cases;

use std::path::Path;

/// Runs a case on every file of some folders of the repository, and on parts of each.
fn replay(folders: &[&str], case: fn(&[u8])) {
    let mut count = 0;
    for folder in folders {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(folder);
        for file in path.read_dir().unwrap_or_else(|error| panic!("{folder}: {error}")) {
            let data = std::fs::read(file.unwrap().path()).unwrap();
            case(&data);
            (1..8).for_each(|eighth| case(&data[..data.len() * eighth / 8]));
            count += 1;
        }
    }
    assert!(count > 0, "{folders:?} are empty");
}

#[test]
fn what_fuzzers_start_from_and_have_found_passes() {
    replay(&["fuzz/seeds/expression"], cases::expression);
    replay(&["fuzz/seeds/window_csv"], cases::window_csv);
    replay(&["fuzz/seeds/window_json"], cases::window_json);
    replay(&["fuzz/seeds/lines"], cases::lines);
    replay(&["config/models", "config/plants", "config/effects"], cases::model);
    replay(&["fuzz/seeds/words"], cases::words);
}
