//! Short CPU work that somebody waits for: comparisons, diagnostics, previews.
//!
//! It has threads of its own that are less nice than those of the jobs. A job holds its pool until it ends,
//! so a place at the head of the same pool would still mean waiting for a whole search; this way the work
//! starts at once, and the system gives it the CPU before any job and after any handler. What takes seconds
//! has threads of its own again, which leave the CPU to what takes a moment.
//!
//! Answers are kept by a key that names everything they depend on. Equal requests at the same time are
//! computed once, and more of them than [`MOST_PENDING`] are refused instead of piled up.

use crate::service::error::ServiceError;
use crate::service::threads::nice_pool;
use indexmap::IndexMap;
use lampyris_core::fault::Fault;
use lampyris_core::interrupt::{Brake, Interrupt};
use rayon::{ThreadPool, ThreadPoolBuildError};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Most different answers that are computed or wait for a thread.
pub const MOST_PENDING: usize = 32;
/// Most bytes of answers that are kept.
const KEPT_BYTES: usize = 32 << 20;
/// Between the handlers (0) and the jobs (19): what takes a moment, and what takes seconds.
const NICENESS: i32 = 10;
const NICENESS_OF_SECONDS: i32 = 15;

/// A rendered answer, shared by all who asked for it.
pub type RenderedAnswer = Arc<[u8]>;

/// Threads for work that somebody waits for, and the answers that were given.
#[derive(Debug)]
pub struct Interactive {
    pool: ThreadPool,
    desk: Arc<Mutex<Desk>>,
}

/// What is computed now, and what was computed lately.
#[derive(Debug)]
struct Desk {
    pending: HashMap<String, Arc<watch::Sender<Option<Outcome>>>>,
    kept: CachedAnswers,
    computed: u64,
    /// Questions without a key of their own.
    asked: u64,
}

/// What came of a piece of work, for everybody who waits for it.
type Outcome = Result<RenderedAnswer, Failure>;

/// Why there is no answer: an error that several can be given.
#[derive(Debug, Clone)]
enum Failure {
    Faults(Vec<Fault>),
    /// Nobody waited for it any more when the work was given up.
    Left,
    Internal(String),
}

/// The answers that were used last, oldest first.
#[derive(Debug)]
struct CachedAnswers {
    answers: IndexMap<String, RenderedAnswer>,
    bytes: usize,
    most: usize,
}

/// Where a request finds its answer.
enum Place {
    Kept(RenderedAnswer),
    Joined(watch::Receiver<Option<Outcome>>),
    New(Arc<watch::Sender<Option<Outcome>>>, watch::Receiver<Option<Outcome>>),
    Busy,
}

impl Interactive {
    /// So many threads for what takes a moment.
    ///
    /// # Errors
    /// Where the system gives none.
    pub fn new(threads: usize) -> Result<Self, ThreadPoolBuildError> {
        Self::nice(threads, "interactive", NICENESS)
    }

    /// So many threads for what takes seconds.
    ///
    /// # Errors
    /// Where the system gives none.
    pub fn of_seconds(threads: usize) -> Result<Self, ThreadPoolBuildError> {
        Self::nice(threads, "inquiry", NICENESS_OF_SECONDS)
    }

    fn nice(threads: usize, name: &str, niceness: i32) -> Result<Self, ThreadPoolBuildError> {
        let kept = CachedAnswers { answers: IndexMap::new(), bytes: 0, most: KEPT_BYTES };
        let desk = Desk { pending: HashMap::new(), kept, computed: 0, asked: 0 };
        Ok(Self { pool: nice_pool(threads, name.to_owned(), niceness)?, desk: Arc::new(Mutex::new(desk)) })
    }

    /// The answer to a request that was answered before.
    pub fn known(&self, key: &str) -> Option<RenderedAnswer> {
        self.desk().kept.get(key)
    }

    /// How many answers were computed since the start.
    pub fn computed(&self) -> u64 {
        self.desk().computed
    }

    /// How many answers are computed now or wait for a thread.
    pub fn pending(&self) -> usize {
        self.desk().pending.len()
    }

    /// The answer to a request: kept, being computed for somebody else, or computed now while this task
    /// sleeps. The key must name everything that the answer depends on. The brake is pulled when nobody waits
    /// for it any more.
    ///
    /// # Errors
    /// Those of the work, and where too much is asked at once.
    pub async fn answer(
        &self,
        key: &str,
        work: impl FnOnce(&Brake) -> Result<Vec<u8>, ServiceError> + Send + 'static,
    ) -> Result<RenderedAnswer, ServiceError> {
        let place = self.desk().place(key);
        let mut outcome = match place {
            Place::Kept(answer) => return Ok(answer),
            Place::Joined(outcome) => outcome,
            Place::New(sender, outcome) => {
                let (desk, key) = (self.desk.clone(), key.to_owned());
                self.pool.spawn_fifo(move || compute(&desk, &key, &sender, work));
                outcome
            }
            Place::Busy => return Err(ServiceError::Busy),
        };
        let told = outcome.wait_for(Option::is_some).await.map(|outcome| outcome.clone());
        match told {
            Ok(Some(Ok(answer))) => Ok(answer),
            Ok(Some(Err(Failure::Faults(faults)))) => Err(ServiceError::Faults(faults)),
            Ok(Some(Err(Failure::Left))) => Err(ServiceError::Busy),
            Ok(Some(Err(Failure::Internal(detail)))) => Err(ServiceError::Internal(detail)),
            Ok(None) | Err(_) => Err(ServiceError::Internal("the thread of a short task is gone".into())),
        }
    }

    /// The answer to a question that nobody asks twice, so that it is not kept.
    ///
    /// # Errors
    /// As [`Interactive::answer`].
    pub async fn once(
        &self,
        work: impl FnOnce(&Brake) -> Result<Vec<u8>, ServiceError> + Send + 'static,
    ) -> Result<RenderedAnswer, ServiceError> {
        let key = self.desk().unique();
        let answer = self.answer(&key, work).await;
        self.desk().kept.forget(&key);
        answer
    }

    fn desk(&self) -> MutexGuard<'_, Desk> {
        lock(&self.desk)
    }
}

fn lock(desk: &Mutex<Desk>) -> MutexGuard<'_, Desk> {
    // Nothing that can panic happens while the desk is held.
    desk.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Does the work on a thread of the pool and tells everybody who waits.
fn compute(
    desk: &Mutex<Desk>,
    key: &str,
    sender: &Arc<watch::Sender<Option<Outcome>>>,
    work: impl FnOnce(&Brake) -> Result<Vec<u8>, ServiceError>,
) {
    {
        let mut desk = lock(desk);
        // Who asked may have gone while the work waited for its thread; joining needs the desk, so nobody
        // comes now.
        if sender.receiver_count() == 0 {
            desk.pending.remove(key);
            return;
        }
        desk.computed += 1;
    }
    let asked = sender.clone();
    let brake = Brake::new(move || (asked.receiver_count() == 0).then_some(Interrupt::Cancelled));
    let outcome = match catch_unwind(AssertUnwindSafe(|| Brake::guard(|| work(&brake)))) {
        Ok(Err(_)) => Err(Failure::Left),
        Ok(Ok(Ok(bytes))) => Ok(RenderedAnswer::from(bytes)),
        Ok(Ok(Err(ServiceError::Faults(faults)))) => Err(Failure::Faults(faults)),
        Ok(Ok(Err(error))) => Err(Failure::Internal(error.to_string())),
        Err(_) => Err(Failure::Internal("a short task panicked".into())),
    };
    let mut desk = lock(desk);
    desk.pending.remove(key);
    if let Ok(answer) = &outcome {
        desk.kept.put(key, answer.clone());
    }
    drop(desk);
    sender.send_replace(Some(outcome));
}

impl Desk {
    /// A key that no other question has.
    fn unique(&mut self) -> String {
        self.asked += 1;
        format!("once {}", self.asked)
    }

    fn place(&mut self, key: &str) -> Place {
        if let Some(answer) = self.kept.get(key) {
            return Place::Kept(answer);
        }
        if let Some(sender) = self.pending.get(key) {
            return Place::Joined(sender.subscribe());
        }
        if self.pending.len() >= MOST_PENDING {
            return Place::Busy;
        }
        let (sender, outcome) = watch::channel(None);
        let sender = Arc::new(sender);
        self.pending.insert(key.to_owned(), sender.clone());
        Place::New(sender, outcome)
    }
}

impl CachedAnswers {
    /// An answer, which then is the newest.
    fn get(&mut self, key: &str) -> Option<RenderedAnswer> {
        let place = self.answers.get_index_of(key)?;
        self.answers.move_index(place, self.answers.len() - 1);
        self.answers.get(key).cloned()
    }

    fn forget(&mut self, key: &str) {
        self.bytes -= self.answers.shift_remove(key).map_or(0, |answer| answer.len());
    }

    /// Keeps an answer and lets the oldest go until all fit.
    fn put(&mut self, key: &str, answer: RenderedAnswer) {
        self.bytes += answer.len();
        let replaced = self.answers.insert(key.to_owned(), answer);
        self.bytes -= replaced.map_or(0, |answer| answer.len());
        while self.bytes > self.most
            && let Some((_, oldest)) = self.answers.shift_remove_index(0)
        {
            self.bytes -= oldest.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    fn bytes(text: &str) -> Result<Vec<u8>, ServiceError> {
        Ok(text.as_bytes().to_vec())
    }

    #[tokio::test]
    async fn an_answer_is_computed_once() {
        let interactive = Arc::new(Interactive::new(1).unwrap());
        let (release, held) = mpsc::channel::<()>();
        let first = tokio::spawn({
            let interactive = interactive.clone();
            async move {
                let work = move |_: &Brake| {
                    held.recv().unwrap();
                    bytes("one")
                };
                interactive.answer("a", work).await.unwrap()
            }
        });
        while interactive.computed() == 0 {
            tokio::task::yield_now().await;
        }
        // The work is under way: equal requests wait for it instead of doing their own.
        let joined: Vec<_> = (0..5)
            .map(|_| {
                let interactive = interactive.clone();
                tokio::spawn(async move { interactive.answer("a", |_| bytes("never")).await.unwrap() })
            })
            .collect();
        tokio::task::yield_now().await;
        release.send(()).unwrap();
        assert_eq!(&*first.await.unwrap(), b"one");
        for one in joined {
            assert_eq!(&*one.await.unwrap(), b"one");
        }
        assert_eq!(&*interactive.answer("a", |_| bytes("never")).await.unwrap(), b"one");
        assert_eq!(
            (interactive.computed(), interactive.known("a").is_some(), interactive.known("b").is_some()),
            (1, true, false)
        );
    }

    #[tokio::test]
    async fn too_much_at_once_is_refused_and_what_nobody_waits_for_is_not_done() {
        let interactive = Arc::new(Interactive::new(1).unwrap());
        let (release, held) = mpsc::channel::<()>();
        let mut asked = Vec::new();
        let mut held = Some(held);
        for index in 0..MOST_PENDING {
            let (interactive, held) = (interactive.clone(), held.take());
            asked.push(tokio::spawn(async move {
                let work = move |_: &Brake| {
                    held.iter().for_each(|held| held.recv().unwrap());
                    bytes("x")
                };
                interactive.answer(&index.to_string(), work).await
            }));
            tokio::task::yield_now().await;
        }
        while interactive.computed() == 0 {
            tokio::task::yield_now().await;
        }
        assert!(matches!(interactive.answer("more", |_| bytes("x")).await, Err(ServiceError::Busy)));
        // All but the one that runs give up.
        let first = asked.remove(0);
        asked.iter().for_each(tokio::task::JoinHandle::abort);
        for one in asked {
            assert!(one.await.unwrap_err().is_cancelled());
        }
        release.send(()).unwrap();
        first.await.unwrap().unwrap();
        interactive.answer("more", |_| bytes("x")).await.unwrap();
        assert_eq!(interactive.computed(), 2, "what nobody waited for was done");
    }

    #[tokio::test]
    async fn work_that_is_under_way_ends_when_nobody_waits_for_it_any_more() {
        let interactive = Arc::new(Interactive::new(1).unwrap());
        let asked = tokio::spawn({
            let interactive = interactive.clone();
            // It comes to no end by itself.
            let work = |brake: &Brake| {
                loop {
                    brake.check();
                    std::thread::yield_now();
                }
            };
            async move { interactive.answer("a", work).await }
        });
        while interactive.computed() == 0 {
            tokio::task::yield_now().await;
        }
        asked.abort();
        assert!(asked.await.unwrap_err().is_cancelled());
        // There is one thread, and it is free again.
        assert_eq!(&*interactive.answer("b", |_| bytes("next")).await.unwrap(), b"next");
        assert_eq!((interactive.pending(), interactive.known("a")), (0, None));
    }

    #[tokio::test]
    async fn failures_are_told_and_not_kept() {
        let interactive = Interactive::new(1).unwrap();
        let fault = |_: &Brake| Err(ServiceError::Faults(vec![Fault::new("/x", "x", "x")]));
        assert!(matches!(
            interactive.answer("a", fault).await,
            Err(ServiceError::Faults(faults)) if faults.len() == 1
        ));
        assert!(matches!(
            interactive.answer("a", |_| std::panic::resume_unwind(Box::new("expected by this test"))).await,
            Err(ServiceError::Internal(_))
        ));
        assert_eq!(&*interactive.answer("a", |_| bytes("at last")).await.unwrap(), b"at last");
    }

    #[test]
    fn the_answers_that_were_used_last_are_kept() {
        let mut kept = CachedAnswers { answers: IndexMap::new(), bytes: 0, most: 10 };
        let put = |kept: &mut CachedAnswers, key: &str, length: usize| {
            kept.put(key, RenderedAnswer::from(vec![0; length]))
        };
        put(&mut kept, "a", 4);
        put(&mut kept, "b", 4);
        assert!(kept.get("a").is_some());
        put(&mut kept, "c", 4);
        assert!(kept.get("b").is_none() && kept.get("a").is_some() && kept.get("c").is_some());
        assert_eq!(kept.bytes, 8);
        put(&mut kept, "too large", 11);
        assert!(kept.answers.is_empty() && kept.bytes == 0);
    }
}
