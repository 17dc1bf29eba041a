//! Threads for what must not hold up the handlers.

use super::error::ServiceError;
use lampyris_core::interrupt::{Brake, Interrupt};
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::Arc;

/// The least urgent the system knows.
const NICENESS: i32 = 19;
/// Deep expressions are evaluated by recursion in places; the depth limit of the parser fits into this.
const STACK: usize = 8 << 20;

/// The threads of one worker.
///
/// # Errors
/// Where the system gives none.
pub fn pool(threads: usize, worker: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    nice_pool(threads, format!("job-{worker}"), NICENESS)
}

/// Threads that leave the CPU to the handlers; the nicer they are, the more so.
///
/// # Errors
/// Where the system gives none.
pub(super) fn nice_pool(
    threads: usize,
    name: String,
    niceness: i32,
) -> Result<ThreadPool, ThreadPoolBuildError> {
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK)
        .thread_name(move |thread| format!("{name}-{thread}"))
        .start_handler(move |_| {
            // On Linux this is the niceness of the calling thread alone. Without the right to set it work
            // still runs.
            let _ = rustix::process::nice(niceness);
        })
        .build()
}

/// Runs something short for somebody who may leave: the brake is pulled when nobody waits any more.
///
/// # Errors
/// Where it panicked.
pub async fn blocking_while_wanted<T: Send + 'static>(
    work: impl FnOnce(&Brake) -> T + Send + 'static,
) -> Result<T, ServiceError> {
    let waits = Arc::new(());
    let waiting = Arc::downgrade(&waits);
    let brake = Brake::new(move || (waiting.strong_count() == 0).then_some(Interrupt::Cancelled));
    let done = blocking(move || Brake::guard(|| work(&brake))).await?;
    drop(waits);
    done.map_err(|_| ServiceError::Internal("a short task that somebody waits for was given up".into()))
}

/// Runs something short that must not hold an async thread, such as unpacking a window. Jobs have pools of
/// their own.
///
/// # Errors
/// Where it panicked.
pub async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, ServiceError> {
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| ServiceError::Internal(format!("a short task failed: {error}")))
}
