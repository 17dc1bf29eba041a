//! A hook for tests of what a bad job does to the others: jobs of some systems go wrong in the middle of
//! their search.
//!
//! Nothing happens unless the variable `LAMPYRIS_POISON` of the environment was set when the first job
//! started, such as `room/7:panic,room/8:stall,room/9:abort`.
//!
//! | word | what the job does |
//! |---|---|
//! | `panic` | its objective panics |
//! | `stall` | its objective comes to no end before somebody interrupts it |
//! | `deaf` | its objective hears nobody while there is the file that `LAMPYRIS_DEAF_WHILE` names |
//! | `abort` | it takes the process down, as a stack overflow or an allocation that is refused would |

use lampyris_core::data::SystemId;
use std::collections::HashMap;
use std::sync::LazyLock;
use std::time::Duration;

/// How long a job waits before it looks around again.
const PAUSE: Duration = Duration::from_millis(10);

static POISONED: LazyLock<HashMap<String, String>> = LazyLock::new(|| {
    let text = std::env::var("LAMPYRIS_POISON").unwrap_or_default();
    text.split(',')
        .filter_map(|pair| pair.split_once(':'))
        .map(|(system, word)| (system.to_owned(), word.to_owned()))
        .collect()
});

/// Does to a job of this system what the environment says. Outside of tests this is a look into an empty map.
pub fn strike(system: &SystemId, is_interrupted: impl Fn() -> bool) {
    if POISONED.is_empty() {
        return;
    }
    match POISONED.get(&system.to_string()).map(String::as_str) {
        Some("panic") => panic!("the poison of {system}"),
        Some("abort") => std::process::abort(),
        Some("deaf") => {
            let file = std::env::var("LAMPYRIS_DEAF_WHILE").unwrap_or_default();
            while std::path::Path::new(&file).exists() {
                std::thread::sleep(PAUSE);
            }
        }
        Some("stall") => {
            while !is_interrupted() {
                std::thread::sleep(PAUSE);
            }
        }
        _ => {}
    }
}
