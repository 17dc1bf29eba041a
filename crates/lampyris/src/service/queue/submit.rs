//! How requests enter the queue: checked against the system and its model first, so that what can be known to
//! fail is refused at once and not at night.

use super::request::{self, BatchRequest};
use crate::service::catalogue::system::{self, Mode, SystemDocument};
use crate::service::error::{Refusal, ServiceError};
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::service::work::input;
use crate::store;
use crate::store::batches::{BatchKind, NewBatch, Skipped, SubmittedBatch};
use crate::store::entry::NewJob;
use crate::store::idempotency::RequestKey;
use crate::store::jobs::{JobKind, JobRecord, JobStatus, Origin, Priority};
use crate::store::queue::Submitted;
use crate::store::reach::SystemScope;
use crate::store::retry::Retried;
use crate::store::systems::SystemRecord;
use lampyris_core::data::{SplitRequest, SystemId};
use lampyris_core::estimate::{EstimateRequest, tune};
use lampyris_core::fault::{Fault, nearest};
use lampyris_core::model::ModelId;
use serde_json::{Map, Value};
use std::collections::HashSet;
use std::sync::Arc;

/// Systems whose documents are read at once.
const AT_ONCE: i64 = 1000;

/// Submits a job for one system.
///
/// # Errors
/// Every fault of the request, a full queue, a reused key, or where the database fails.
pub async fn one(
    service: &Service,
    kind: JobKind,
    system: &SystemId,
    experiment: bool,
    priority: Priority,
    settings: &Map<String, Value>,
    key: Option<&RequestKey>,
) -> Result<Submitted, ServiceError> {
    let settings = with_defaults(service, kind, settings);
    let (document, request, mut faults) = judge(service, system, &settings).await?;
    if kind == JobKind::Tune {
        faults.extend(tune::faults(&request));
    }
    let model = request.model.clone().ok_or_else(|| ServiceError::Faults(faults.clone()))?;
    let Some(document) = document.filter(|_| faults.is_empty()) else {
        return Err(ServiceError::Faults(faults));
    };
    // Whether the measurements are enough is seen now, and not by whoever looks for the result.
    let input = input::collect(service, system, document, model.clone(), request.clone(), 0).await?;
    match blocking(move || input.window().and_then(|window| input.problem(&window))).await? {
        Ok(_) => {}
        Err(ServiceError::Faults(faults)) => {
            return Err(ServiceError::Faults(faults.into_iter().map(at_request).collect()));
        }
        Err(error) => return Err(error),
    }
    let new = new_job(kind, system, model, experiment, &request, Origin::Posted, priority)?;
    let submitted =
        store::queue::submit(&service.store, &new, key, service.queue_limits(), service.now()).await?;
    Ok(told(service, submitted))
}

/// What is asked of a job, with what its kind and the settings of the service say to it.
fn with_defaults(service: &Service, kind: JobKind, settings: &Map<String, Value>) -> Map<String, Value> {
    let mut settings = settings.clone();
    if kind == JobKind::Diagnose {
        settings
            .entry("split")
            .or_insert_with(|| serde_json::to_value(SplitRequest::DIAGNOSE).unwrap_or_default());
        settings.entry("accusation_rate").or_insert_with(|| service.settings.diagnose.accusation_rate.into());
    }
    settings
}

/// Submits a job that has ended once more.
///
/// # Errors
/// Where there is no such job or it has not ended, a full queue, a reused key, or where the database fails.
pub(crate) async fn retry(
    service: &Service,
    id: &str,
    key: Option<&RequestKey>,
) -> Result<Submitted, ServiceError> {
    match store::retry::retry(&service.store, id, key, service.queue_limit(), service.now()).await? {
        Retried::Submitted(submitted) => Ok(told(service, *submitted)),
        Retried::NotFinished(state) => Err(ServiceError::NotFinished(id.to_owned(), state)),
        Retried::NoJob => Err(ServiceError::NotFound("job", id.to_owned())),
    }
}

/// What a submission became; of a new job, workers and listeners are told.
fn told(service: &Service, submitted: Submitted) -> Submitted {
    if matches!(submitted, Submitted::New(_)) {
        entered(service);
    }
    submitted
}

/// Submits an ordinary recalibration of one system, because newer measurements contradict what it serves.
///
/// # Errors
/// Where the system's defaults give no request, the queue is full, or the database fails.
pub(crate) async fn refit(
    service: &Service,
    system: &SystemId,
    document: &SystemDocument,
) -> Result<(), ServiceError> {
    let request = request::complete(&Map::new(), Some(document)).map_err(ServiceError::Faults)?;
    let new = new_job(
        JobKind::Estimate,
        system,
        document.require_model().map_err(ServiceError::Faults)?.clone(),
        false,
        &request,
        Origin::Scheduled,
        Priority::Nightly,
    )?;
    store::queue::submit(&service.store, &new, None, service.queue_limits(), service.now()).await?;
    entered(service);
    Ok(())
}

/// What the faults of a request hide: those that only its system and its model can tell.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn further_faults(
    service: &Service,
    body: &Value,
    known: &[Fault],
) -> Result<Vec<Fault>, ServiceError> {
    let (Some(system), Some(mut settings)) =
        (body.get("system").and_then(Value::as_str).map(str::parse), body.as_object().cloned())
    else {
        return Ok(Vec::new());
    };
    let Ok(system) = system else {
        return Ok(Vec::new());
    };
    if settings.get("kind").is_some_and(|kind| kind == "recalibrate") {
        return Ok(Vec::new());
    }
    settings.retain(|field, _| !["kind", "system", "experiment", "priority"].contains(&field.as_str()));
    let (_, _, mut faults) = judge(service, &system, &settings).await?;
    faults.retain(|fault| !known.contains(fault));
    Ok(faults)
}

/// The system, if there is one, and as much of a request as can be read, with every fault that the request,
/// its system and its model show.
async fn judge(
    service: &Service,
    system: &SystemId,
    settings: &Map<String, Value>,
) -> Result<(Option<SystemDocument>, EstimateRequest, Vec<Fault>), ServiceError> {
    let Some(record) = store::systems::get(&service.store, system).await? else {
        let (request, mut faults) = request::read_settings(settings, None);
        faults.push(unknown_system(service, system).await?);
        return Ok((None, request, faults));
    };
    let document = system::document(&record.document)?;
    let (request, mut faults) = request::read_settings(settings, Some(&document));
    let model = match request.model.as_ref().ok_or(()).or_else(|()| document.require_model()) {
        Ok(model) => model.clone(),
        Err(more) => {
            faults.extend(more);
            return Ok((Some(document), request, faults));
        }
    };
    let (catalogue, choices) = (service.catalogue.current(), request.choices());
    let binding = document.clone();
    let more = blocking(move || match binding.bindings(&catalogue, &model) {
        Ok(model) => choices.faults(&model),
        Err(faults) => faults.into_iter().map(at_request).collect(),
    });
    // Bounds that are no interval on any scale were found before.
    let is_new = |fault: &Fault, faults: &[Fault]| !faults.iter().any(|known| known.pointer == fault.pointer);
    faults.extend(more.await?.into_iter().filter(|fault| is_new(fault, &faults)).collect::<Vec<_>>());
    if store::measured::extent(&service.store, system).await?.is_none() {
        let fault = Fault::new("/system", "no-data", format!("there are no measurements of {system}"));
        faults.push(fault.suggest(format!("post some to /systems/{system}/windows")));
    }
    Ok((Some(document), request, faults))
}

/// A fault of the model or the measurements, as a fault of the request that names the model.
fn at_request(fault: Fault) -> Fault {
    let is_of_request = ["/model", "/window", "/split", "/bounds", "/fixed"]
        .iter()
        .any(|field| fault.pointer.starts_with(field));
    if is_of_request { fault } else { system::at("/model", fault) }
}

/// Submits a batch.
///
/// # Errors
/// A full queue, a reused key, or where the database fails.
pub(crate) async fn several(
    service: &Service,
    request: &BatchRequest,
    schedule: Option<&str>,
    priority: Priority,
    key: Option<&RequestKey>,
) -> Result<SubmittedBatch, ServiceError> {
    let batch = batch(service, request, schedule, priority).await?;
    let submitted =
        store::batches::submit(&service.store, &batch, key, service.queue_limit(), service.now()).await?;
    if let (SubmittedBatch::New(id), Some(schedule)) = (&submitted, schedule) {
        store::schedules::note_run(&service.store, schedule, id, service.now()).await?;
    }
    entered(service);
    Ok(submitted)
}

/// The jobs of a batch: one for every selected system that has measurements and, where what is served may
/// change, wants that.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn batch(
    service: &Service,
    request: &BatchRequest,
    schedule: Option<&str>,
    priority: Priority,
) -> Result<NewBatch, ServiceError> {
    let origin = if schedule.is_some() { Origin::Scheduled } else { Origin::Posted };
    let kind = match request.kind {
        BatchKind::Recalibrate => JobKind::Estimate,
        BatchKind::Diagnose => JobKind::Diagnose,
    };
    let settings = with_defaults(service, kind, &request.settings);
    let measured = store::measured::systems(&service.store).await?;
    let mut batch = NewBatch {
        kind: request.kind,
        schedule: schedule.map(str::to_owned),
        request: serde_json::to_string(request).map_err(|error| ServiceError::Internal(error.to_string()))?,
        jobs: Vec::new(),
        skipped: Vec::new(),
    };
    let mut draft = Draft { kind, settings, origin, priority, measured, requests: HashSet::new() };
    let mut after = String::new();
    loop {
        let page = store::systems::page(&service.store, &SystemScope::ALL, &after, AT_ONCE).await?;
        let Some(last) = page.last() else { break };
        after = last.system.to_string();
        let chosen = |record: &SystemRecord| request.systems.iter().any(|one| one.matches(&record.system));
        let records: Vec<SystemRecord> = page.into_iter().filter(chosen).collect();
        // A night of a hundred thousand documents is read on no thread that answers.
        let (back, drafted) = blocking(move || {
            let drafted = records.iter().map(|record| draft.job(record)).collect::<Result<Vec<_>, _>>();
            (draft, drafted)
        })
        .await?;
        draft = back;
        for drafted in drafted?.into_iter().flatten() {
            match drafted {
                Ok(job) => batch.jobs.push(job),
                Err(skipped) => batch.skipped.push(skipped),
            }
        }
    }
    Ok(batch)
}

/// What the jobs of a batch have in common.
struct Draft {
    kind: JobKind,
    settings: Map<String, Value>,
    origin: Origin,
    priority: Priority,
    /// The systems of which something was measured.
    measured: HashSet<String>,
    /// Requests so far: a text that a thousand jobs share is kept once.
    requests: HashSet<Arc<str>>,
}

impl Draft {
    /// The job of a system, or why it has none; nothing for a system that has no model.
    fn job(&mut self, record: &SystemRecord) -> Result<Option<Result<NewJob, Skipped>>, ServiceError> {
        let (kind, system) = (self.kind, &record.system);
        let document = system::document(&record.document)?;
        let Some(model) = document.model.clone() else { return Ok(None) };
        let skipped = |why: String| Ok(Some(Err(Skipped { system: system.clone(), why })));
        if kind == JobKind::Estimate && document.policy.mode == Mode::Observe {
            return skipped("its policy is to observe only".to_owned());
        }
        if !self.measured.contains(&system.to_string()) {
            return skipped("there are no measurements".to_owned());
        }
        match request::complete(&self.settings, Some(&document)) {
            // Only an estimate alters what is served.
            Ok(request) => {
                let experiment = kind != JobKind::Estimate;
                let mut job = new_job(kind, system, model, experiment, &request, self.origin, self.priority)?;
                match self.requests.get(&job.request) {
                    Some(known) => job.request = known.clone(),
                    None => drop(self.requests.insert(job.request.clone())),
                }
                Ok(Some(Ok(job)))
            }
            Err(faults) => skipped(faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")),
        }
    }
}

/// Leaves out the systems of which nothing has been measured since the same question was answered: the same
/// numbers would confirm what is served, night after night, and it would never turn stale.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn leave_out_answered(service: &Service, batch: &mut NewBatch) -> Result<(), ServiceError> {
    let answered = store::batches::answered(&service.store, &batch.jobs).await?;
    for (place, job) in std::mem::take(&mut batch.jobs).into_iter().enumerate() {
        if answered.contains(&place) {
            let what = if job.kind == JobKind::Diagnose { "diagnosis" } else { "estimate" };
            batch.skipped.push(Skipped {
                system: job.system,
                why: format!("no measurements have arrived since its last {what}"),
            });
        } else {
            batch.jobs.push(job);
        }
    }
    Ok(())
}

/// Wakes a worker after jobs have entered the queue, and tells those who listen.
pub fn entered(service: &Service) {
    service.wake.notify_one();
    service.events.hint();
}

/// Calls a job off: what runs or waits now will publish nothing.
///
/// # Errors
/// Where the job has come to a result already, or the database fails.
pub(crate) async fn cancel(service: &Service, id: &str) -> Result<Option<JobRecord>, ServiceError> {
    let Some(job) = store::queue::cancel(&service.store, id, service.now()).await? else {
        return Ok(None);
    };
    if job.state.status() == JobStatus::Succeeded {
        let detail =
            format!("the job `{id}` has come to its result already: it cannot be called off any more");
        return Err(Refusal::new("already-deciding", detail).into());
    }
    // A job in other hands is called off by its row.
    let worker = job.lease().map(|lease| lease.boot);
    if worker == Some(service.membership.worker()) {
        service.board.cancel(id);
        // The worker may have ended the job in between and forgotten its place; then nobody else will.
        if store::jobs::get(&service.store, id).await?.is_some_and(|job| job.state.is_final()) {
            service.board.end(id);
        }
    } else {
        service.events.hint();
    }
    Ok(Some(job))
}

fn new_job(
    kind: JobKind,
    system: &SystemId,
    model: ModelId,
    experiment: bool,
    request: &EstimateRequest,
    origin: Origin,
    priority: Priority,
) -> Result<NewJob, ServiceError> {
    let request =
        serde_json::to_string(request).map_err(|error| ServiceError::Internal(error.to_string()))?;
    Ok(NewJob { kind, system: system.clone(), model, request: request.into(), experiment, origin, priority })
}

pub(in crate::service) async fn unknown_system(
    service: &Service,
    system: &SystemId,
) -> Result<Fault, ServiceError> {
    let known: Vec<String> = store::systems::all(&service.store)
        .await?
        .into_iter()
        .map(|record| record.system.to_string())
        .collect();
    let fault = Fault::new("/system", "system-not-found", format!("there is no system `{system}`"));
    Ok(match nearest(&system.to_string(), known.iter().map(String::as_str)) {
        Some(near) => fault.suggest(format!("did you mean `{near}`?")),
        None => fault.suggest(format!("make it with PUT /systems/{system}")),
    })
}
