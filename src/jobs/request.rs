//! What a job is asked to do: the body of `POST /jobs`, with the defaults of the system filled in.

use super::decode;
use super::systems::SystemDocument;
use crate::data::{SplitRequest, SystemId, SystemPattern, read_time};
use crate::estimate::method::{MethodFields, SeededMethod};
use crate::estimate::{EarlyStopping, EstimateRequest};
use crate::fault::{Fault, nearest};
use crate::optimise::Method;
use crate::store::jobs::{JobKind, Priority};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// The kinds that a request may name.
const KINDS: [&str; 4] = ["estimate", "diagnose", "ladder", "recalibrate"];
/// Most evaluations that a request may spend.
const MOST_EVALUATIONS: usize = 100_000_000;

/// A request for a job or a batch.
#[derive(Debug, Clone, PartialEq)]
pub enum JobRequest {
    /// One system.
    One {
        /// What is to be done.
        kind: JobKind,
        /// The system.
        system: SystemId,
        /// Whether it never alters what is served.
        experiment: bool,
        /// Who goes first.
        priority: Priority,
        /// What is asked, apart from what the system will fill in.
        settings: Map<String, Value>,
    },
    /// Several.
    Recalibrate {
        /// Who goes first.
        priority: Priority,
        /// Which systems, and what is asked of them.
        batch: BatchRequest,
    },
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
        "estimate" => read_one(JobKind::Estimate, fields),
        "diagnose" => read_one(JobKind::Diagnose, fields),
        "ladder" => read_one(JobKind::Ladder, fields),
        "recalibrate" => read_recalibration(fields),
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

fn read_one(kind: JobKind, mut fields: Map<String, Value>) -> Result<JobRequest, Vec<Fault>> {
    let mut faults = Vec::new();
    let system = take::<SystemId>(&mut fields, "system", &mut faults);
    let experiment = take_or(&mut fields, "experiment", false, &mut faults);
    let priority = take_or(&mut fields, "priority", Priority::Operator, &mut faults);
    if let Err(more) = complete(&fields, None) {
        faults.extend(more);
    }
    // A diagnosis asks about the model and never alters what is served. It needs a part that no decision sees.
    let experiment = experiment || kind != JobKind::Estimate;
    if kind != JobKind::Estimate && !fields.contains_key("split") {
        fields.insert("split".to_owned(), serde_json::to_value(SplitRequest::DIAGNOSE).unwrap_or_default());
    }
    match system {
        Some(system) if faults.is_empty() => Ok(JobRequest::One { kind, system, experiment, priority, settings: fields }),
        _ => Err(faults),
    }
}

fn read_recalibration(mut fields: Map<String, Value>) -> Result<JobRequest, Vec<Fault>> {
    let mut faults = Vec::new();
    let priority = take_or(&mut fields, "priority", Priority::Operator, &mut faults);
    match read_batch(fields) {
        Ok(batch) if faults.is_empty() => Ok(JobRequest::Recalibrate { priority, batch }),
        other => {
            faults.extend(other.err().into_iter().flatten());
            Err(faults)
        }
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

/// Takes a field that may be there out of an object.
fn take_or<T: serde::de::DeserializeOwned>(fields: &mut Map<String, Value>, name: &str, default: T, faults: &mut Vec<Fault>) -> T {
    if fields.contains_key(name) { take(fields, name, faults).unwrap_or(default) } else { default }
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
            faults.extend(inside(&format!("/{name}"), more));
            None
        }
    }
}

/// The whole request: what was asked, then what the system says, then what always serves.
///
/// # Errors
/// Every fault of the fields.
pub fn complete(settings: &Map<String, Value>, system: Option<&SystemDocument>) -> Result<EstimateRequest, Vec<Fault>> {
    let mut faults = Vec::new();
    let mut fields = settings.clone();
    let method = fields.shift_remove("method").and_then(|method| read_method(method).map_err(|more| faults.extend(more)).ok());
    let mut request: EstimateRequest = match decode::decode(Value::Object(fields)) {
        Ok(request) => request,
        Err(mut more) => {
            more.extend(faults);
            return Err(more);
        }
    };
    request.method = method.unwrap_or_default();
    if let Some(system) = system {
        if !settings.contains_key("prior") {
            request.prior = system.prior;
        }
        request.model.get_or_insert_with(|| system.model.clone());
    }
    faults.extend(senseless(&request));
    if faults.is_empty() { Ok(request) } else { Err(faults) }
}

/// Reads a method with every fault of its hyperparameters.
fn read_method(value: Value) -> Result<SeededMethod, Vec<Fault>> {
    let fields = MethodFields::from(decode::decode::<Map<String, Value>>(value).map_err(|faults| inside("/method", faults))?);
    let mut faults = Vec::new();
    let seed = decode::decode::<u64>(fields.seed.clone()).map_err(|more| faults.extend(inside("/method/seed", more)));
    let method = match fields.method() {
        None => Err(inside("/method/name", vec![Fault::new("", "wrong-type", "the name of a method is a text")])),
        // What is wrong with the whole is that no method has this name.
        Some(method) => decode::decode::<Method>(method).map_err(|faults| {
            faults
                .into_iter()
                .flat_map(|fault| inside(if fault.pointer.is_empty() { "/method/name" } else { "/method" }, vec![fault]))
                .collect()
        }),
    };
    let method = method.map_err(|more| faults.extend(more));
    if let Ok(method) = &method {
        faults.extend(method.faults().iter().map(|range| {
            let field = range.field.split(' ').next().unwrap_or_default().replace('.', "/");
            Fault::new(format!("/method/{field}"), "out-of-range", format!("`{}` {range}", range.field))
        }));
    }
    match (seed, method) {
        (Ok(seed), Ok(method)) if faults.is_empty() => Ok(SeededMethod { seed, method }),
        _ => Err(faults),
    }
}

/// Faults that were found inside something that the pointer names.
fn inside(pointer: &str, faults: Vec<Fault>) -> Vec<Fault> {
    faults.into_iter().map(|fault| Fault { pointer: format!("{pointer}{}", fault.pointer), ..fault }).collect()
}

/// Values that make no sense, as far as they can be judged without a model.
fn senseless(request: &EstimateRequest) -> Vec<Fault> {
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
