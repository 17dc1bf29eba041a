//! Looks at what is served whenever measurements arrive: where the states are now, and whether the newer
//! measurements contradict the parameters.

use super::kept::KeptFilter;
use super::live;
use crate::service::catalogue::system::Mode;
use crate::service::catalogue::systems;
use crate::service::error::ServiceError;
use crate::service::queue::submit;
use crate::service::state::Service;
use crate::service::work::board::Live;
use crate::service::work::input::{self, JobInput};
use crate::store;
use crate::store::fits::FitRecord;
use lampyris_core::data::{Duration, SplitRequest, SystemId, rfc3339};
use lampyris_core::estimate::EstimateRequest;
use lampyris_core::estimate::assess::degradation::{Newer, as_fitted, goes_on, newer};
use lampyris_core::estimate::assess::live::LiveStates;
use lampyris_core::estimate::assess::metrics::{CurrentState, filter_fit, newest_state};
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::interrupt::{Brake, Interrupt};
use rayon::ThreadPool;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::pin;
use std::sync::Arc;
use std::time::{self, Instant};
use tokio::sync::oneshot;

/// A record is looked at over at most this long, so that a look stays short however old the fit is.
const LONGEST: Duration = Duration::from_days(60);

/// Looks at one system after the other until the service stops. What arrived before the start is looked at
/// first.
pub(crate) async fn run(service: Arc<Service>, pool: ThreadPool) {
    match store::degradations::outdated(&service.store).await {
        Ok(systems) => systems.iter().for_each(|system| service.arrivals.note(system)),
        Err(error) => tracing::error!(%error, "systems with newer measurements could not be listed"),
    }
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        let mut told = pin!(service.arrivals.told.notified());
        told.as_mut().enable();
        let next = service.arrivals.systems().pop_first();
        if let Some(system) = next {
            match look(&service, &pool, &system, || false).await {
                Ok(false) => {}
                Ok(true) => {
                    if let Err(error) = refit(&service, &system).await {
                        tracing::warn!(%error, %system, "what newer measurements contradict could not be \
                            fitted again");
                    }
                }
                Err(error) => not_compared(&system, &error),
            }
            continue;
        }
        tokio::select! {
            () = told => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Looks at one system before a job that nobody has asked for replaces what it serves: measurements that came
/// a moment ago may not have been looked at yet.
pub(in crate::service) async fn look_first(
    service: &Service,
    pool: &ThreadPool,
    system: &SystemId,
    job: &Arc<Live>,
) {
    let job = job.clone();
    if let Err(error) = look(service, pool, system, move || job.is_cancelled()).await {
        not_compared(system, &error);
    }
}

fn not_compared(system: &SystemId, error: &ServiceError) {
    tracing::warn!(%error, %system, "newer measurements could not be compared with what is served");
}

/// Submits a job for a system that has become degraded, where its policy wants one.
async fn refit(service: &Service, system: &SystemId) -> Result<(), ServiceError> {
    let document = systems::require(service, system).await?;
    if document.policy.refit_when_degraded && document.policy.mode != Mode::Observe {
        submit::refit(service, system, &document).await?;
    }
    Ok(())
}

/// Compares what is served with the newest measurements, and keeps what that says. Says whether it has become
/// degraded by that.
async fn look(
    service: &Service,
    pool: &ThreadPool,
    system: &SystemId,
    unwanted: impl Fn() -> bool + Send + Sync + 'static,
) -> Result<bool, ServiceError> {
    let Some(standing) = store::params::standing(&service.store, system).await? else { return Ok(false) };
    let Some((revision, served)) = standing.revision.zip(store::fits::served(&service.store, system).await?)
    else {
        return Ok(false);
    };
    if revision.fit != served.id {
        // Something was published in between, and its job has looked at the newest measurements itself.
        return Ok(false);
    }
    let Some((_, newest)) = store::measured::extent(&service.store, system).await? else { return Ok(false) };
    let Some(model) = served.fit.model.parse().ok() else { return Ok(false) };
    let document = systems::require(service, system).await?;
    let input = input::collect(service, system, document, model, request(&served, newest), 0).await?;
    let stopping = service.stopping.subscribe();
    let deadline = Instant::now() + time::Duration::from_secs(service.settings.limits.job_seconds);
    let brake = Brake::new(move || {
        if unwanted() || *stopping.borrow() {
            Some(Interrupt::Cancelled)
        } else {
            (Instant::now() >= deadline).then_some(Interrupt::Deadline)
        }
    });
    let (sender, receiver) = oneshot::channel();
    pool.spawn(move || {
        let compared = || Brake::guard(|| compare(&input, &served, &brake));
        let _ = sender.send(catch_unwind(AssertUnwindSafe(compared)));
    });
    let Ok(Ok(found)) = receiver.await else {
        return Err(ServiceError::Internal("the comparison ran into a fault of the program".to_owned()));
    };
    let found = match found {
        Ok(found) => found,
        Err(Interrupt::Cancelled) => return Ok(false),
        Err(Interrupt::Deadline) => {
            return Err(ServiceError::Internal("the comparison took longer than a job may".to_owned()));
        }
    };
    let keep = |end, state| KeptFilter::new(revision.revision, service.now(), end, state);
    let Looked { newer, state, end } = match found {
        Ok(Some(looked)) => looked,
        other => {
            // The next samples are not to ask the same again.
            service.live.put(system, keep(None, None));
            return other.map(|_| false);
        }
    };
    service.live.put(system, keep(end, state.clone()));
    if let Some((error, horizon)) = newer.error() {
        service.metrics.forecast(system, horizon, error);
    }
    let turned = match &newer {
        // Too little to tell leaves things as they are; only the states are newer.
        Newer::Silent => {
            let standing = standing.degradation.map(|record| record.degradation);
            store::degradations::keep(
                &service.store,
                system,
                revision.revision,
                standing.as_ref(),
                state.as_ref(),
                service.now(),
            )
            .await?
        }
        Newer::Agree { .. } => {
            store::degradations::keep(
                &service.store,
                system,
                revision.revision,
                None,
                state.as_ref(),
                service.now(),
            )
            .await?
        }
        Newer::Contradict(found) => {
            store::degradations::keep(
                &service.store,
                system,
                revision.revision,
                Some(found),
                state.as_ref(),
                service.now(),
            )
            .await?
        }
    };
    // Samples may have come while the record was looked at.
    if let Err(error) = live::go_on(service, system, i64::MAX).await {
        not_compared(system, &error);
    }
    if let Some(degraded) = turned {
        tracing::warn!(
            %system,
            revision = revision.revision,
            degraded,
            "newer measurements {}",
            if degraded { "contradict what is served" } else { "agree again" }
        );
    }
    Ok(turned == Some(true))
}

/// The whole of the fit's window and what came behind it.
fn request(served: &FitRecord, newest: i64) -> EstimateRequest {
    let oldest = rfc3339(newest - LONGEST.millis());
    let from = served.fit.window().0.to_owned().max(oldest);
    EstimateRequest {
        window: Some(WindowRange { last: None, from: Some(from), to: None }),
        split: SplitRequest { train: LONGEST, validation: Duration::default(), test: None },
        ..EstimateRequest::default()
    }
}

/// What a look has found.
struct Looked {
    /// What newer measurements say of what is served.
    newer: Newer,
    /// The states at the end.
    state: Option<CurrentState>,
    /// The filter, to go on from there.
    end: Option<LiveStates>,
}

/// This is work for a CPU pool.
fn compare(input: &JobInput, served: &FitRecord, brake: &Brake) -> Result<Option<Looked>, ServiceError> {
    let window = input.window()?;
    let problem = input.problem(&window)?.with_brake(brake);
    let names = problem.model().parameters().iter().map(|parameter| &parameter.name);
    if !names.eq(served.fit.parameters.keys()) {
        // Channels have come or gone, so that the model is another one here.
        return Ok(None);
    }
    if !goes_on(&problem, &served.fit) {
        return Ok(None);
    }
    let problem = as_fitted(&problem, &served.fit);
    let run = filter_fit(&problem, &served.fit);
    let said = newer(&problem, &served.fit, &run, input.system.policy.horizon);
    let end = LiveStates::begin(&problem, &served.fit, &run, &window);
    Ok(Some(Looked { newer: said, state: newest_state(&problem, &run), end }))
}
