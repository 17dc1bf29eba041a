//! Claims jobs and runs them, each worker on a pool of its own.
//!
//! The pools are separate because a thread of a shared pool that waits for its part of one job may pick up
//! another whole job meanwhile, and then the first one neither goes on nor hears a cancellation until the
//! second has ended. Their threads are nice: the handlers always get the CPU first.

use super::board::Live;
use super::estimate::{self, Stopped, describe};
use super::input::{self, JobInput};
use super::{diagnose, poison, tune};
use crate::service::changes::events::JobChange;
use crate::service::changes::follow;
use crate::service::serving::degradations;
use crate::service::state::Service;
use crate::store::StoreError;
use crate::store::finish::{JobEnd, JudgedFit, Tuned, finish};
use crate::store::jobs::{JobFailure, JobKind, JobRecord, Lease, Origin};
use crate::store::queue;
use lampyris_core::estimate::{Control, Interrupt, Progress};
use rayon::ThreadPool;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// How often an idle worker looks without having been told.
const SLOW_POLL: Duration = Duration::from_secs(5);
/// Pause after the database has failed.
const AFTER_FAILURE: Duration = Duration::from_secs(1);
/// How often a result is offered to a database that is full, before the job fails for want of room.
const TRIES: u32 = 5;
/// Claims and runs jobs until the service stops.
pub async fn run(service: Arc<Service>, pool: ThreadPool) {
    let _alive = Alive::new(&service.workers_alive);
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        // Interest is registered before the queue is asked, so that a job that comes in between is not
        // missed.
        let mut woken = pin!(service.wake.notified());
        woken.as_mut().enable();
        let pause = match queue::claim(&service.store, service.boot, service.now()).await {
            Ok(Some(job)) => {
                // There may be more: the next idle worker looks, and wakes the one after it.
                service.wake.notify_one();
                process(&service, &pool, job).await;
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

/// How a job ended, before the database knows.
enum End {
    Found(Box<JudgedFit>),
    Tuned(Box<Tuned>),
    Failed(JobFailure),
    Cancelled,
    GivenBack,
}

/// Runs one job that was claimed.
async fn process(service: &Arc<Service>, pool: &ThreadPool, job: JobRecord) {
    let Some(lease) = job.lease() else { return };
    let live = service.board.place(&job.id);
    live.start(&job, lease.clone());
    followed(service).await;
    service.metrics.job_started(&job);
    service.events.publish(&job.id, &job.system, JobChange::Started(Box::new(job.clone())));
    tracing::info!(
        job = %job.id,
        system = %job.system,
        attempt = job.attempt,
        "started {} for {}",
        job.kind.as_str(),
        job.system
    );
    if job.kind == JobKind::Estimate && job.origin == Origin::Scheduled {
        degradations::look_first(service, pool, &job.system).await;
    }
    let end = match input::load(service, &job).await {
        Ok(input) => compute(service, pool, &live, &job, input).await,
        Err(error) => End::Failed(describe(error)),
    };
    record(service, &job, &lease, end).await;
}

/// Computes on the pool while this task sleeps.
async fn compute(
    service: &Arc<Service>,
    pool: &ThreadPool,
    live: &Arc<Live>,
    job: &JobRecord,
    input: JobInput,
) -> End {
    let (sender, receiver) = oneshot::channel();
    let (shared, place, job) = (service.clone(), live.clone(), job.clone());
    pool.spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| guarded(&shared, &place, &job, &input)));
        // Nobody listens any more when the service has stopped; then the job was given back already.
        let _ = sender.send(result);
    });
    match receiver.await {
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
    }
}

/// The work with the caller's hands on it: cancellation, shutdown, deadline, progress.
fn guarded(service: &Service, live: &Live, job: &JobRecord, input: &JobInput) -> Result<End, Stopped> {
    let limit = Duration::from_secs(service.settings.limits.job_seconds);
    let asked = input.request.budget.wall.map(|wall| Duration::from_secs(wall.seconds().unsigned_abs()));
    let deadline = Instant::now() + asked.map_or(limit, |asked| asked.min(limit));
    let interrupted = || {
        if live.is_cancelled() || service.is_stopping() {
            Some(Interrupt::Cancelled)
        } else if Instant::now() >= deadline {
            Some(Interrupt::Deadline)
        } else {
            None
        }
    };
    let interrupt = || {
        poison::strike(&job.system, || interrupted().is_some());
        interrupted()
    };
    let progress = |progress: &Progress| {
        if let Some(news) = live.report(progress) {
            service.events.publish(&job.id, &job.system, news);
        }
    };
    let control = Control { interrupt: &interrupt, progress: &progress };
    let found = match job.kind {
        JobKind::Estimate => estimate::run(input, &control),
        JobKind::Diagnose => diagnose::run(input, &control),
        JobKind::Ladder => diagnose::ladder(input, &control),
        JobKind::Tune => return tune::run(input, &control).map(|tuned| End::Tuned(Box::new(tuned))),
    };
    found.map(|finding| End::Found(Box::new(finding)))
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
                if let End::Found(finding) = &end {
                    service.metrics.checks_failed(&finding.judgement.failed());
                }
                match (&end, finished) {
                    (End::Found(finding), Some(finished)) => tracing::info!(
                        job = %job.id, system = %job.system, fit = finished.fit, revision = finished.revision,
                        "{}: {}", finished.outcome.map_or("ended", |outcome| outcome.as_str()),
                        finding.judgement.summary
                    ),
                    (End::Tuned(tuned), Some(finished)) => tracing::info!(
                        job = %job.id, system = %job.system, outcome = ?finished.outcome, "{}",
                        tuned.tuning.summary
                    ),
                    (End::Failed(failure), _) => {
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
                // The next start finds the job running under an old boot and queues it again.
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
