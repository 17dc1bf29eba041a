//! Claims jobs and runs them, each worker on a pool of its own.
//!
//! The pools are separate because a thread of a shared pool that waits for its part of one job may pick up
//! another whole job meanwhile, and then the first one neither goes on nor hears a cancellation until the
//! second has ended. Their threads are nice: the handlers always get the CPU first.

use super::board::Live;
use super::estimate::{self, Stopped, describe};
use super::input::{self, JobInput};
use super::{diagnose, poison, tune};
use crate::service::changes::events::{JobChange, SystemChange};
use crate::service::changes::follow;
use crate::service::serving::degradations;
use crate::service::state::Service;
use crate::service::threads;
use crate::store::StoreError;
use crate::store::finish::{JobEnd, JudgedFit, Tuned, finish};
use crate::store::jobs::{JobFailure, JobKind, JobRecord, Lease, Origin};
use crate::store::queue;
use lampyris_core::estimate::{Control, Progress};
use lampyris_core::interrupt::{Brake, Interrupt};
use rayon::ThreadPool;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// How often an idle worker looks without having been told.
const SLOW_POLL: Duration = Duration::from_secs(5);
/// Pause after the database has failed.
const AFTER_FAILURE: Duration = Duration::from_secs(1);
/// How often it is asked whether watchers of a job have heard nothing for long.
const LISTENING: Duration = Duration::from_secs(1);
/// How often a result is offered to a database that is full, before the job fails for want of room.
const TRIES: u32 = 5;
/// What is left behind a search for judging what it found: a quarter of the job's time, and at least this.
const LEAST_GRACE: Duration = Duration::from_millis(1500);

/// Claims and runs jobs on the threads of the numbered worker until the service stops.
pub(crate) async fn run(service: Arc<Service>, mut pool: ThreadPool, worker: usize) {
    let _alive = Alive::new(&service.workers_alive);
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        // Interest is registered before the queue is asked, so that a job that comes in between is not
        // missed.
        let mut woken = Box::pin(service.wake.notified());
        woken.as_mut().enable();
        let claimed = if service.membership.is_in_doubt() {
            Ok(None)
        } else {
            queue::claim(&service.store, service.membership.worker(), service.now()).await
        };
        let pause = match claimed {
            Ok(Some(job)) => {
                // Whoever works must not be told of what comes meanwhile: an idle worker has to hear it.
                drop(woken);
                // There may be more: the next idle worker looks, and wakes the one after it.
                service.wake.notify_one();
                if let Some(deaf) = process(&service, &pool, job).await {
                    pool = replaced(&service, pool, worker, deaf).await;
                }
                continue;
            }
            Ok(None) => SLOW_POLL,
            Err(error) => {
                tracing::error!(%error, "no job could be claimed");
                if error.is_final() { SLOW_POLL } else { AFTER_FAILURE }
            }
        };
        tokio::select! {
            () = woken => {}
            () = tokio::time::sleep(pause) => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Counts a worker for as long as its loop lives, however that ends.
struct Alive<'a>(&'a AtomicUsize);

impl<'a> Alive<'a> {
    fn new(workers: &'a AtomicUsize) -> Self {
        workers.fetch_add(1, Ordering::Relaxed);
        Self(workers)
    }
}

impl Drop for Alive<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// How long a job may take, by the clock of this process.
#[derive(Debug, Clone, Copy)]
struct Times {
    /// Then its search ends, and keeps what it has found.
    search: Instant,
    /// Then all of it ends, without a result.
    end: Instant,
    /// Then nobody waits for it any longer.
    given_up: Instant,
}

impl Times {
    fn of(input: &JobInput, most: Duration) -> Self {
        let asked = input.request.budget.wall.map(|wall| Duration::from_millis(wall.millis().unsigned_abs()));
        let limit = asked.map_or(most, |asked| asked.min(most));
        let grace = (limit / 4).max(LEAST_GRACE);
        let search = Instant::now() + limit;
        Self { search, end: search + grace, given_up: search + limit.max(2 * grace) }
    }
}

/// What the threads of a job say when it has ended.
type Ending = Result<Result<End, Stopped>, Box<dyn Any + Send>>;

/// A job that was given up, for its threads.
type Deaf = oneshot::Receiver<Ending>;

/// Gives a worker other threads in the place of those that a job does not give back, as soon as no more such
/// jobs than workers are left.
async fn replaced(service: &Arc<Service>, lost: ThreadPool, worker: usize, deaf: Deaf) -> ThreadPool {
    service.abandoned.send_modify(|abandoned| *abandoned += 1);
    let counting = service.clone();
    tokio::spawn(async move {
        // What it says is nobody's news any more: its job has ended.
        let _ = deaf.await;
        counting.abandoned.send_modify(|abandoned| *abandoned -= 1);
    });
    if service.is_stuck() {
        tracing::error!("a worker waits for threads that jobs which were given up still hold");
    }
    let (mut abandoned, mut stopping) = (service.abandoned.subscribe(), service.stopping.subscribe());
    tokio::select! {
        _ = abandoned.wait_for(|abandoned| *abandoned <= service.settings.workers) => {}
        _ = stopping.wait_for(|stops| *stops) => return lost,
    }
    loop {
        match threads::pool(lost.current_num_threads(), worker) {
            Ok(others) => return others,
            Err(error) => tracing::error!(%error, "no threads in the place of those of a job, trying again"),
        }
        tokio::time::sleep(AFTER_FAILURE).await;
    }
}

/// How a job ended, before the database knows.
enum End {
    Found(Box<JudgedFit>),
    Tuned(Box<Tuned>),
    Failed(JobFailure),
    Cancelled,
    GivenBack,
}

/// Runs one job that was claimed. Where it had to be given up, it still holds the threads.
async fn process(service: &Arc<Service>, pool: &ThreadPool, job: JobRecord) -> Option<Deaf> {
    let lease = job.lease()?;
    let live = service.board.place(&job.id);
    live.start(&job, lease.clone());
    followed(service).await;
    service.metrics.job_started(&job);
    let started = SystemChange::Job(job.id.clone(), JobChange::Started(Box::new(job.clone())));
    service.events.publish(&job.system, started);
    tracing::info!(
        job = %job.id,
        system = %job.system,
        attempt = job.attempt,
        "started {} for {}",
        job.kind.as_str(),
        job.system
    );
    if job.kind == JobKind::Estimate && job.origin == Origin::Scheduled {
        degradations::look_first(service, pool, &job.system, &live).await;
    }
    let (end, deaf) = match input::load(service, &job).await {
        Ok(input) => compute(service, pool, &live, &job, input).await,
        Err(error) => (End::Failed(describe(error)), None),
    };
    record(service, &job, &lease, end).await;
    deaf
}

/// Computes on the threads while this task sleeps, and gives up what does not end.
async fn compute(
    service: &Arc<Service>,
    pool: &ThreadPool,
    live: &Arc<Live>,
    job: &JobRecord,
    input: JobInput,
) -> (End, Option<Deaf>) {
    let times = Times::of(&input, Duration::from_secs(service.settings.limits.job_seconds));
    let (sender, mut receiver) = oneshot::channel();
    let (shared, place, named, job) = (service.clone(), live.clone(), job, job.clone());
    pool.spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| guarded(&shared, &place, &job, &input, times)));
        // Nobody listens any more when the service has stopped; then the job was given back already.
        let _ = sender.send(result);
    });
    let ending = loop {
        tokio::select! {
            ending = &mut receiver => break ending,
            () = tokio::time::sleep_until(times.given_up.into()) => {
                // It may hear this one day, and tells nobody how far it has come until then.
                live.call_off();
                return (End::Failed(given_up()), Some(receiver));
            }
            () = tokio::time::sleep(LISTENING) => tell(service, live, named, live.silence()),
        }
    };
    let end = match ending {
        Ok(Ok(Ok(end))) => end,
        Ok(Ok(Err(Stopped::Failed(failure)))) => End::Failed(failure),
        Ok(Ok(Err(Stopped::Interrupted))) if live.is_cancelled() => End::Cancelled,
        Ok(Ok(Err(Stopped::Interrupted))) => End::GivenBack,
        Ok(Err(panic)) => End::Failed(panicked(&*panic)),
        Err(_) => End::Failed(JobFailure {
            code: "panic".into(),
            detail: "the job's thread is gone".into(),
            errors: Vec::new(),
        }),
    };
    (end, None)
}

/// The work with the caller's hands on it: cancellation, shutdown, deadline, progress.
fn guarded(
    service: &Arc<Service>,
    live: &Arc<Live>,
    job: &JobRecord,
    input: &JobInput,
    times: Times,
) -> Result<End, Stopped> {
    let worker = job.lease().map(|lease| lease.boot).unwrap_or_default();
    let until = |deadline: Instant| {
        let (service, live) = (service.clone(), live.clone());
        move || {
            if live.is_cancelled() || service.is_stopping() || service.membership.has_lost(worker) {
                Some(Interrupt::Cancelled)
            } else {
                (Instant::now() >= deadline).then_some(Interrupt::Deadline)
            }
        }
    };
    let (interrupted, brake) = (until(times.search), Brake::new(until(times.end)));
    let interrupt = || {
        poison::strike(&job.system, || interrupted().is_some());
        interrupted()
    };
    let progress = |progress: &Progress| {
        tell(service, live, job, live.report(progress));
    };
    let control = Control { interrupt: &interrupt, progress: &progress };
    let found = |finding| End::Found(Box::new(finding));
    let work = || match job.kind {
        JobKind::Estimate => estimate::run(input, &control, &brake).map(found),
        JobKind::Diagnose => diagnose::run(input, &control, &brake).map(found),
        JobKind::Ladder => diagnose::ladder(input, &control, &brake).map(found),
        JobKind::Tune => tune::run(input, &control).map(|tuned| End::Tuned(Box::new(tuned))),
    };
    Brake::guard(work).unwrap_or_else(|interrupt| Err(unfinished(interrupt)))
}

/// Tells watchers how far a job has come, unless it was called off.
fn tell(service: &Service, live: &Live, job: &JobRecord, news: Option<JobChange>) {
    if let Some(news) = news.filter(|_| !live.is_cancelled()) {
        service.events.publish(&job.system, SystemChange::Job(job.id.clone(), news));
    }
}

/// What it means for a job that its work was cut short behind its search.
fn unfinished(interrupt: Interrupt) -> Stopped {
    match interrupt {
        Interrupt::Cancelled => Stopped::Interrupted,
        Interrupt::Deadline => {
            let detail = "the wall time was used up before what was found could be judged".to_owned();
            Stopped::Failed(JobFailure { code: "deadline".to_owned(), detail, errors: Vec::new() })
        }
    }
}

/// The failure of a job that does not end.
fn given_up() -> JobFailure {
    let detail = "the job did not end by twice its wall time, and was given up".to_owned();
    JobFailure { code: "out_of_time".to_owned(), detail, errors: Vec::new() }
}

/// Writes the end of a job, and only then shows it. While the database fails the job keeps its lease.
async fn record(service: &Arc<Service>, job: &JobRecord, lease: &Lease, mut end: End) {
    let mut tries = 0;
    loop {
        let written = match &end {
            End::GivenBack => queue::requeue(&service.store, lease, service.now()).await.map(|()| None),
            End::Found(finding) => {
                finish(&service.store, lease, &JobEnd::Fitted(finding), service.now()).await.map(Some)
            }
            End::Tuned(tuned) => {
                finish(&service.store, lease, &JobEnd::Tuned(tuned), service.now()).await.map(Some)
            }
            End::Failed(failure) => {
                finish(&service.store, lease, &JobEnd::Failed(failure), service.now()).await.map(Some)
            }
            End::Cancelled => {
                finish(&service.store, lease, &JobEnd::Cancelled, service.now()).await.map(Some)
            }
        };
        match written {
            Ok(finished) => {
                let called_off = finished.as_ref().is_some_and(|finished| finished.cancelled);
                if let (End::Found(finding), false) = (&end, called_off) {
                    service.metrics.checks_failed(&finding.judgement.failed());
                }
                match (&end, finished.filter(|finished| !finished.cancelled)) {
                    (End::Found(finding), Some(finished)) => tracing::info!(
                        job = %job.id, system = %job.system, fit = finished.fit, revision = finished.revision,
                        "{}: {}", finished.outcome.map_or("ended", |outcome| outcome.as_str()),
                        finding.judgement.summary
                    ),
                    (End::Tuned(tuned), Some(finished)) => tracing::info!(
                        job = %job.id, system = %job.system, outcome = ?finished.outcome, "{}",
                        tuned.tuning.summary
                    ),
                    (End::Failed(failure), Some(_)) => {
                        tracing::warn!(
                            job = %job.id,
                            system = %job.system,
                            code = failure.code,
                            "failed: {}",
                            failure.detail
                        )
                    }
                    (End::GivenBack, _) => tracing::info!(job = %job.id, "given back to the queue"),
                    _ => tracing::info!(job = %job.id, "cancelled"),
                }
                break;
            }
            Err(StoreError::LeaseLost) => {
                tracing::warn!(job = %job.id, "ended by somebody else meanwhile");
                break;
            }
            // A disk that has failed is not written to again by this process.
            Err(error) if service.is_stopping() || error.is_final() => {
                // Whoever finds this process gone queues the job again.
                tracing::error!(%error, job = %job.id, "the end of a job could not be written");
                return;
            }
            Err(error) => {
                tracing::error!(%error, job = %job.id, "the end of a job could not be written, trying again");
                tries += 1;
                if tries == TRIES
                    && matches!((&end, &error), (End::Found(_) | End::Tuned(_), StoreError::Full(_)))
                {
                    // A running job keeps its windows from being deleted, which may be the only way to make
                    // room. A failure takes less of it than a result.
                    let detail =
                        "the database had no room for the result: make room, and do the job again".to_owned();
                    end = End::Failed(JobFailure { code: "storage".into(), detail, errors: Vec::new() });
                }
                tokio::time::sleep(AFTER_FAILURE).await;
            }
        }
    }
    service.board.end(&job.id);
    followed(service).await;
    // The system is free again, so a job of it that waited may be claimed by anybody.
    service.wake.notify_one();
}

/// Brings the log of events up to date, so that what comes next stands behind what came before.
async fn followed(service: &Service) {
    if let Err(error) = follow::catch_up(service).await {
        tracing::error!(%error, "listeners could not be told what happened");
    }
}

fn panicked(panic: &(dyn Any + Send)) -> JobFailure {
    let said = panic
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| panic.downcast_ref::<String>().cloned());
    tracing::error!("a job panicked: {}", said.as_deref().unwrap_or("without a message"));
    JobFailure {
        code: "panic".into(),
        detail: "the job ran into a fault of the program".into(),
        errors: Vec::new(),
    }
}
