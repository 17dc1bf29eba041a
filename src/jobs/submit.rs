//! How requests enter the queue: checked against the system and its model first, so that what can be known to
//! fail is refused at once and not at night.

use super::request::{self, BatchRequest};
use super::systems::{self, Mode};
use super::{JobsError, Service, blocking, input, now, params};
use crate::data::SystemId;
use crate::estimate::EstimateRequest;
use crate::fault::{Fault, nearest};
use crate::model::ModelId;
use crate::store;
use crate::store::batches::{NewBatch, Skipped, SubmittedBatch};
use crate::store::idempotency::RequestKey;
use crate::store::jobs::{Cancelled, NewJob, Origin, Priority, Submitted};
use serde_json::{Map, Value};

/// Submits an estimate for one system.
///
/// # Errors
/// Every fault of the request, a full queue, a reused key, or where the database fails.
pub async fn estimate(
    service: &Service,
    system: &SystemId,
    experiment: bool,
    settings: &Map<String, Value>,
    key: Option<&RequestKey>,
) -> Result<Submitted, JobsError> {
    let (request, faults) = judge(service, system, settings).await?;
    let model = request.model.clone().ok_or_else(|| JobsError::Faults(faults.clone()))?;
    if !faults.is_empty() {
        return Err(JobsError::Faults(faults));
    }
    // Whether the measurements are enough is seen now, and not by whoever looks for the result.
    let input = input::collect(service, system, &model, request.clone()).await?;
    match blocking(move || input.problem()).await? {
        Ok(_) => {}
        Err(JobsError::Faults(faults)) => return Err(JobsError::Faults(faults.into_iter().map(at_request).collect())),
        Err(error) => return Err(error),
    }
    let new = new_job(system, model, experiment, &request, Origin::Posted, Priority::Operator)?;
    let submitted = store::jobs::submit(&service.store, &new, key, service.queue_limit(), now()).await?;
    if let Submitted::New(_) = &submitted {
        service.wake.notify_one();
        params::refresh(service, system).await?;
    }
    Ok(submitted)
}

/// What the faults of a request hide: those that only its system and its model can tell.
///
/// # Errors
/// Where the database fails.
pub async fn further_faults(service: &Service, body: &Value, known: &[Fault]) -> Result<Vec<Fault>, JobsError> {
    let (Some(system), Some(mut settings)) = (body.get("system").and_then(Value::as_str).map(str::parse), body.as_object().cloned()) else {
        return Ok(Vec::new());
    };
    let Ok(system) = system else {
        return Ok(Vec::new());
    };
    if settings.get("kind").is_some_and(|kind| kind == "recalibrate") {
        return Ok(Vec::new());
    }
    settings.retain(|field, _| !["kind", "system", "experiment"].contains(&field.as_str()));
    let (_, mut faults) = judge(service, &system, &settings).await?;
    faults.retain(|fault| !known.contains(fault));
    Ok(faults)
}

/// As much of a request as can be read, with every fault that the request, its system and its model show.
async fn judge(service: &Service, system: &SystemId, settings: &Map<String, Value>) -> Result<(EstimateRequest, Vec<Fault>), JobsError> {
    let Some(record) = store::systems::get(&service.store, system).await? else {
        let (request, mut faults) = request::read_settings(settings, None);
        faults.push(unknown_system(service, system).await?);
        return Ok((request, faults));
    };
    let document = systems::document(&record.document)?;
    let (request, mut faults) = request::read_settings(settings, Some(&document));
    let model = request.model.clone().unwrap_or_else(|| document.model.clone());
    let (catalogue, choices) = (service.catalogue.current(), request.choices());
    let more = blocking(move || match document.bindings(&catalogue, &model) {
        Ok(model) => choices.faults(&model),
        Err(faults) => faults.into_iter().map(at_request).collect(),
    });
    // Bounds that are no interval on any scale were found before.
    let is_new = |fault: &Fault, faults: &[Fault]| !faults.iter().any(|known| known.pointer == fault.pointer);
    faults.extend(more.await?.into_iter().filter(|fault| is_new(fault, &faults)).collect::<Vec<_>>());
    if store::windows::extent(&service.store, system).await?.is_none() {
        let fault = Fault::new("/system", "no-data", format!("there are no measurements of {system}"));
        faults.push(fault.suggest(format!("post some to /systems/{system}/windows")));
    }
    Ok((request, faults))
}

/// A fault of the model or the measurements, as a fault of the request that names the model.
fn at_request(fault: Fault) -> Fault {
    let is_of_request = ["/model", "/window", "/split", "/bounds", "/fixed"].iter().any(|field| fault.pointer.starts_with(field));
    if is_of_request { fault } else { systems::at("/model", fault) }
}

/// Submits a batch.
///
/// # Errors
/// A full queue, a reused key, or where the database fails.
pub async fn recalibrate(
    service: &Service,
    request: &BatchRequest,
    schedule: Option<&str>,
    key: Option<&RequestKey>,
) -> Result<SubmittedBatch, JobsError> {
    let batch = batch(service, request, schedule, Priority::Operator).await?;
    let submitted = store::batches::submit(&service.store, &batch, key, service.queue_limit(), now()).await?;
    if let (SubmittedBatch::New(id), Some(schedule)) = (&submitted, schedule) {
        store::schedules::note_run(&service.store, schedule, id, now()).await?;
    }
    entered(service, &batch).await?;
    Ok(submitted)
}

/// The jobs of a batch: one for every selected system that has measurements and wants to be recalibrated.
///
/// # Errors
/// Where the database fails.
pub async fn batch(service: &Service, request: &BatchRequest, schedule: Option<&str>, priority: Priority) -> Result<NewBatch, JobsError> {
    let origin = if schedule.is_some() { Origin::Scheduled } else { Origin::Posted };
    let mut batch = NewBatch {
        schedule: schedule.map(str::to_owned),
        request: serde_json::to_string(request).map_err(|error| JobsError::Internal(error.to_string()))?,
        jobs: Vec::new(),
        skipped: Vec::new(),
    };
    for record in store::systems::all(&service.store).await? {
        let system = &record.system;
        if !request.systems.iter().any(|pattern| pattern.matches(system)) {
            continue;
        }
        let document = systems::document(&record.document)?;
        let mut skip = |why: String| batch.skipped.push(Skipped { system: system.clone(), why });
        if document.policy.mode == Mode::Observe {
            skip("its policy is to observe only".to_owned());
        } else if store::windows::extent(&service.store, system).await?.is_none() {
            skip("there are no measurements".to_owned());
        } else {
            match request::complete(&request.settings, Some(&document)) {
                Ok(request) => batch.jobs.push(new_job(system, document.model, false, &request, origin, priority)?),
                Err(faults) => skip(faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")),
            }
        }
    }
    Ok(batch)
}

/// Wakes the workers after a batch has entered the queue, and tells those who wait for parameters.
///
/// # Errors
/// Where the database fails.
pub async fn entered(service: &Service, batch: &NewBatch) -> Result<(), JobsError> {
    service.wake.notify_one();
    for job in &batch.jobs {
        params::refresh(service, &job.system).await?;
    }
    Ok(())
}

/// Calls a job off.
///
/// # Errors
/// Where the database fails.
pub async fn cancel(service: &Service, id: &str) -> Result<Option<Cancelled>, JobsError> {
    let Some(cancelled) = store::jobs::cancel(&service.store, id, now()).await? else {
        return Ok(None);
    };
    if cancelled.running {
        service.board.cancel(id);
        // The worker may have ended the job in between and forgotten its place; then nobody else will.
        if store::jobs::get(&service.store, id).await?.is_some_and(|job| job.state.is_final()) {
            service.board.end(id);
        }
    } else {
        service.board.end(id);
        params::refresh(service, &cancelled.job.system).await?;
    }
    Ok(Some(cancelled))
}

fn new_job(
    system: &SystemId,
    model: ModelId,
    experiment: bool,
    request: &EstimateRequest,
    origin: Origin,
    priority: Priority,
) -> Result<NewJob, JobsError> {
    let request = serde_json::to_string(request).map_err(|error| JobsError::Internal(error.to_string()))?;
    Ok(NewJob { kind: request::ESTIMATE, system: system.clone(), model, request, experiment, origin, priority })
}

async fn unknown_system(service: &Service, system: &SystemId) -> Result<Fault, JobsError> {
    let known: Vec<String> = store::systems::all(&service.store).await?.into_iter().map(|record| record.system.to_string()).collect();
    let fault = Fault::new("/system", "system-not-found", format!("there is no system `{system}`"));
    Ok(match nearest(&system.to_string(), known.iter().map(String::as_str)) {
        Some(near) => fault.suggest(format!("did you mean `{near}`?")),
        None => fault.suggest(format!("make it with PUT /systems/{system}")),
    })
}
