//! What a job is asked to do: the body of `POST /jobs`, with the defaults of the system filled in.

use super::decode;
use super::systems::SystemDocument;
use crate::data::{SystemId, SystemPattern, read_time};
use crate::estimate::{EarlyStopping, EstimateRequest};
use crate::fault::{Fault, nearest};
use crate::store::jobs::JobKind;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// The kinds that a request may name.
const KINDS: [&str; 2] = ["estimate", "recalibrate"];
/// Most evaluations that a request may spend.
const MOST_EVALUATIONS: usize = 100_000_000;

/// A request for a job or a batch.
#[derive(Debug, Clone, PartialEq)]
pub enum JobRequest {
    /// One system.
    Estimate {
        /// The system.
        system: SystemId,
        /// Whether it never alters what is served.
        experiment: bool,
        /// What is asked, apart from what the system will fill in.
        settings: Map<String, Value>,
    },
    /// Several.
    Recalibrate(BatchRequest),
}

/// A request to recalibrate several systems; also what a schedule submits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BatchRequest {
    /// Which systems.
    pub systems: Vec<SystemPattern>,
    /// What is asked of each, apart from what the system will fill in.
    #[serde(flatten)]
    pub settings: Map<String, Value>,
}

/// Reads the body of `POST /jobs`.
///
/// # Errors
/// Every fault.
pub fn read(body: Value) -> Result<JobRequest, Vec<Fault>> {
    let Value::Object(mut fields) = body else {
        return Err(vec![Fault::new("", "wrong-type", "the body must be an object")]);
    };
    let kind = match fields.shift_remove("kind") {
        Some(Value::String(kind)) => kind,
        Some(_) => {
            return Err(vec![Fault::new("/kind", "wrong-type", "the kind is a word")]);
        }
        None => {
            return Err(vec![Fault::new("/kind", "missing-field", format!("`kind` is missing: {}", KINDS.join(" or ")))]);
        }
    };
    match kind.as_str() {
        "estimate" => read_estimate(fields),
        "recalibrate" => read_batch(fields).map(JobRequest::Recalibrate),
        _ => {
            let shown: String = kind.chars().take(40).collect();
            let fault = Fault::new("/kind", "unknown-value", format!("`{}` is none of {}", shown.escape_debug(), KINDS.join(", ")));
            Err(vec![match nearest(&kind, KINDS) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault,
            }])
        }
    }
}

fn read_estimate(mut fields: Map<String, Value>) -> Result<JobRequest, Vec<Fault>> {
    let mut faults = Vec::new();
    let system = take::<SystemId>(&mut fields, "system", &mut faults);
    let experiment = if fields.contains_key("experiment") { take::<bool>(&mut fields, "experiment", &mut faults) } else { Some(false) };
    if let Err(more) = complete(&fields, None) {
        faults.extend(more);
    }
    match (system, experiment) {
        (Some(system), Some(experiment)) if faults.is_empty() => Ok(JobRequest::Estimate { system, experiment, settings: fields }),
        _ => Err(faults),
    }
}

/// Reads a batch, without its `kind`.
///
/// # Errors
/// Every fault.
pub fn read_batch(mut fields: Map<String, Value>) -> Result<BatchRequest, Vec<Fault>> {
    let mut faults = Vec::new();
    let systems = take::<Vec<SystemPattern>>(&mut fields, "systems", &mut faults);
    if systems.as_ref().is_some_and(Vec::is_empty) {
        faults.push(Fault::new("/systems", "empty", "no system is named").suggest("such as [\"room/*\"]"));
    }
    if fields.contains_key("model") {
        faults.push(Fault::new("/model", "unknown-field", "a batch takes the model of each system"));
        fields.shift_remove("model");
    }
    if let Err(more) = complete(&fields, None) {
        faults.extend(more);
    }
    match systems {
        Some(systems) if faults.is_empty() => Ok(BatchRequest { systems, settings: fields }),
        _ => Err(faults),
    }
}

/// Takes a field that must be there out of an object.
fn take<T: serde::de::DeserializeOwned>(fields: &mut Map<String, Value>, name: &str, faults: &mut Vec<Fault>) -> Option<T> {
    let Some(value) = fields.shift_remove(name) else {
        faults.push(Fault::new(format!("/{name}"), "missing-field", format!("`{name}` is missing")));
        return None;
    };
    match decode::decode(value) {
        Ok(value) => Some(value),
        Err(more) => {
            faults.extend(more.into_iter().map(|fault| Fault { pointer: format!("/{name}{}", fault.pointer), ..fault }));
            None
        }
    }
}

/// The whole request: what was asked, then what the system says, then what always serves.
///
/// # Errors
/// Every fault of the fields.
pub fn complete(settings: &Map<String, Value>, system: Option<&SystemDocument>) -> Result<EstimateRequest, Vec<Fault>> {
    let mut request: EstimateRequest = decode::decode(Value::Object(settings.clone()))?;
    if let Some(system) = system {
        if !settings.contains_key("prior") {
            request.prior = system.prior;
        }
        request.model.get_or_insert_with(|| system.model.clone());
    }
    let faults = faults(&request);
    if faults.is_empty() { Ok(request) } else { Err(faults) }
}

/// Values that make no sense, as far as they can be judged without a model.
fn faults(request: &EstimateRequest) -> Vec<Fault> {
    let mut faults = Vec::new();
    if let Some(window) = &request.window {
        for (field, text) in [("from", &window.from), ("to", &window.to)] {
            if let Some(Err(fault)) = text.as_ref().map(|text| read_time(&format!("/window/{field}"), text)) {
                faults.push(fault);
            }
        }
        if window.last.is_some() && window.from.is_some() {
            faults.push(Fault::new("/window", "contradiction", "`last` and `from` exclude each other"));
        }
    }
    if !(1..=MOST_EVALUATIONS).contains(&request.budget.evaluations) {
        faults.push(Fault::new("/budget/evaluations", "out-of-range", format!("there are between 1 and {MOST_EVALUATIONS} evaluations")));
    }
    if request.budget.wall.is_some_and(|wall| wall.is_zero()) {
        faults.push(Fault::new("/budget/wall", "out-of-range", "it must be longer than nothing"));
    }
    faults.extend(request.early_stopping.iter().flat_map(EarlyStopping::faults));
    for (name, [lower, upper]) in &request.bounds {
        if lower >= upper {
            faults.push(Fault::new(format!("/bounds/{name}"), "out-of-order", format!("[{lower}, {upper}] is no interval")));
        }
    }
    faults
}

/// The kind of job that a request of one system becomes.
pub const ESTIMATE: JobKind = JobKind::Estimate;
