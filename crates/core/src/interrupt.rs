//! How work is ended from outside, however deep it is in a filter or a simulation.
//!
//! A search asks its caller between batches and keeps what it has found. Whatever is computed once has
//! nothing to keep: where its [`Brake`] is pulled, it unwinds to the [`Brake::guard`] around it, so that
//! nothing which was cut short can be taken for a result.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

/// Why somebody outside stops a search, or any other work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interrupt {
    /// An operator or a shutdown.
    Cancelled,
    /// The wall time is used up.
    Deadline,
}

/// Operations between two questions: some 50 us of work, a thousand times as much as a question costs.
const BETWEEN: usize = 100_000;

/// What a brake asks.
type Asked = dyn Fn() -> Option<Interrupt> + Send + Sync;

/// The caller's brake on work that has no result before its end. Clones are the same brake.
#[derive(Clone, Default)]
pub struct Brake(Option<Arc<Asked>>);

impl std::fmt::Debug for Brake {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.0.is_some() { "Brake" } else { "Brake::NONE" })
    }
}

impl Brake {
    /// Is never pulled.
    pub const NONE: Brake = Brake(None);

    /// A brake that is pulled as soon as `asked` says why. It is asked from all threads that work.
    pub fn new(asked: impl Fn() -> Option<Interrupt> + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(asked)))
    }

    /// Does nothing, or leaves the work for the [`Brake::guard`] around it where the brake is pulled.
    pub fn check(&self) {
        if let Some(interrupt) = self.0.as_ref().and_then(|asked| asked()) {
            // No panic: the hook for panics has nothing to tell.
            resume_unwind(Box::new(interrupt));
        }
    }

    /// Does work on whatever has a brake.
    ///
    /// # Errors
    /// The [`Interrupt`] that has ended it.
    pub fn guard<T>(work: impl FnOnce() -> T) -> Result<T, Interrupt> {
        // What the work was building is gone with it.
        catch_unwind(AssertUnwindSafe(work)).map_err(|payload| match payload.downcast::<Interrupt>() {
            Ok(interrupt) => *interrupt,
            Err(panic) => resume_unwind(panic),
        })
    }
}

/// Asks a brake once per so much work, so that a step of any size is heard in time and asking costs nothing.
pub(crate) struct Meter<'a> {
    brake: &'a Brake,
    done: usize,
}

impl<'a> Meter<'a> {
    pub(crate) fn new(brake: &'a Brake) -> Self {
        Self { brake, done: 0 }
    }

    /// Notes so many operations, and asks where it is time to.
    #[inline]
    pub(crate) fn add(&mut self, operations: usize) {
        self.done += operations;
        if self.done >= BETWEEN {
            self.done = 0;
            self.brake.check();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn what_was_interrupted_has_no_result() {
        assert_eq!(Brake::guard(|| Brake::NONE.check()), Ok(()));
        let brake = Brake::new(|| Some(Interrupt::Deadline));
        assert_eq!(Brake::guard(|| brake.check()), Err(Interrupt::Deadline));
        // From the threads of a pool as well.
        let sum = || (0..100).into_par_iter().map(|_| brake.check()).count();
        assert_eq!(Brake::guard(sum), Err(Interrupt::Deadline));
        let panic = catch_unwind(|| Brake::guard(|| resume_unwind(Box::new("another"))));
        assert_eq!(panic.unwrap_err().downcast_ref(), Some(&"another"), "a panic stays one");
    }

    #[test]
    fn a_meter_asks_by_work_and_not_by_steps() {
        let asked = Arc::new(AtomicUsize::new(0));
        let counted = asked.clone();
        let brake = Brake::new(move || {
            counted.fetch_add(1, Ordering::Relaxed);
            None
        });
        let mut small = Meter::new(&brake);
        (0..1000).for_each(|_| small.add(BETWEEN / 100));
        assert_eq!(asked.swap(0, Ordering::Relaxed), 10);
        let mut large = Meter::new(&brake);
        (0..1000).for_each(|_| large.add(3 * BETWEEN));
        assert_eq!(asked.load(Ordering::Relaxed), 1000);
    }
}
