//! A hook for tests of crashes and of races: the process ends at a named point of the code, as if it had been
//! killed there, or stays there for a while.
//!
//! Nothing happens unless the variable `LAMPYRIS_ABORT_AT` of the environment was set when the process
//! started: `after_commit` ends it the first time that the point is passed, `after_commit:3` the third time.
//! The variable `LAMPYRIS_PAUSE_AT`, such as `before_commit:200`, holds everybody up there for so many
//! milliseconds.
//!
//! | point | where |
//! |---|---|
//! | `before_finish` | a job has come to its end, and the transaction that writes it has not begun |
//! | `before_commit`, `after_commit` | the transaction that ends a job |
//! | `before_swap` | what is served is durable, and not yet in memory |
//! | `in_entering` | some jobs of a batch of very many are in the queue, uncommitted |
//! | `in_recovery` | a start has given the jobs of a dead process back, uncommitted |
//! | `in_migration` | a transaction of an upgrade, uncommitted: the migration, then the note of how long it
//! took |
//! | `in_backup` | a backup is written, and neither checked nor under its name |

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// The point at which the process ends, and how often it must still be passed.
struct Armed {
    point: String,
    passes: AtomicU64,
}

impl Armed {
    fn from_text(text: &str) -> Self {
        let (point, passes) = text.split_once(':').unwrap_or((text, "1"));
        Self { point: point.to_owned(), passes: AtomicU64::new(passes.parse().unwrap_or(1)) }
    }
}

/// Passes a point. Outside of tests this is two comparisons.
pub fn reached(point: &str) {
    static ARMED: OnceLock<Option<Armed>> = OnceLock::new();
    let armed =
        ARMED.get_or_init(|| std::env::var("LAMPYRIS_ABORT_AT").ok().as_deref().map(Armed::from_text));
    if let Some(armed) = armed
        && armed.point == point
        && armed.passes.fetch_sub(1, Ordering::Relaxed) == 1
    {
        std::process::abort();
    }
    static PAUSE: OnceLock<Option<(String, Duration)>> = OnceLock::new();
    let pause = PAUSE.get_or_init(|| {
        let text = std::env::var("LAMPYRIS_PAUSE_AT").ok()?;
        let (point, milliseconds) = text.split_once(':')?;
        Some((point.to_owned(), Duration::from_millis(milliseconds.parse().ok()?)))
    });
    if let Some((_, length)) = pause.as_ref().filter(|(at, _)| at == point) {
        std::thread::sleep(*length);
    }
}
