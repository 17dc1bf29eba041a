//! Threads for what must not hold up the handlers.

use super::error::ServiceError;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;
use std::thread;
use tokio::sync::oneshot;

/// The least urgent the system knows.
const NICENESS: i32 = 19;
/// That of the threads for short tasks: after the handlers, and before whatever takes longer.
const NICENESS_OF_SHORT_TASKS: i32 = 5;
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

/// Runs something short that must not hold an async thread, such as unpacking a window. There are as many
/// threads for it as processors, so that a crowd of requests takes turns and leaves the CPU to the handlers.
/// Jobs, and what answers a question by a simulation (`work::interactive`), have pools of their own.
///
/// # Errors
/// Where it panicked, or the system gives no threads.
pub async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, ServiceError> {
    static POOL: OnceLock<Result<ThreadPool, ThreadPoolBuildError>> = OnceLock::new();
    let pool = POOL.get_or_init(|| {
        let threads = std::thread::available_parallelism().map_or(2, usize::from);
        nice_pool(threads, "short".to_owned(), NICENESS_OF_SHORT_TASKS)
    });
    let pool = pool.as_ref().map_err(|error| ServiceError::Internal(format!("no threads: {error}")))?;
    let (sender, done) = oneshot::channel();
    pool.spawn_fifo(move || {
        // Whoever has left waits for nothing.
        if !sender.is_closed() {
            let _ = sender.send(catch_unwind(AssertUnwindSafe(work)));
        }
    });
    match done.await {
        Ok(Ok(done)) => Ok(done),
        _ => Err(ServiceError::Internal("a short task panicked".into())),
    }
}

/// Waits for somebody else on a thread of its own: those for short work are few, and everybody needs them.
///
/// # Errors
/// What went wrong, or that there is no thread.
pub(super) async fn apart<T: Send + 'static>(
    name: &str,
    wait: impl FnOnce() -> Result<T, String> + Send + 'static,
) -> Result<T, String> {
    let (sender, done) = oneshot::channel();
    let thread = thread::Builder::new().name(name.to_owned());
    thread.spawn(move || sender.send(wait())).map_err(|error| format!("no thread: {error}"))?;
    done.await.unwrap_or_else(|_| Err("the question broke off".to_owned()))
}
