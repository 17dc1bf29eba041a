//! What a job is asked to do: the body of `POST /jobs`, with the defaults of the system filled in.

use crate::service::catalogue::system::SystemDocument;
use crate::service::decode::{self, Read};
use crate::store::batches::BatchKind;
use crate::store::jobs::{JobKind, Priority};
use lampyris_core::data::{SplitRequest, SystemId, SystemPattern, read_time};
use lampyris_core::estimate::problem::method::{MethodFields, SeededMethod};
use lampyris_core::estimate::problem::objective::Objective;
use lampyris_core::estimate::problem::request::agreed;
use lampyris_core::estimate::{EarlyStopping, EstimateRequest, tune};
use lampyris_core::fault::{Fault, nearest};
use lampyris_core::optimise::Method;
use lampyris_core::schema::word;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;
use utoipa::openapi::{RefOr, Schema};

/// The kinds that a request may name.
const KINDS: [&str; 5] = ["estimate", "diagnose", "ladder", "recalibrate", "tune"];
/// Most systems or patterns that a batch names.
const MOST_PATTERNS: usize = 10_000;
/// Most evaluations that a request may spend.
const MOST_EVALUATIONS: usize = 100_000_000;

/// A request for a job or a batch.
#[derive(Debug, Clone, PartialEq)]
pub enum JobRequest {
    /// One system.
    One(SystemJob),
    /// Several.
    Several(BatchJob),
}

/// A job for one system: an estimate, a diagnosis of what its model is missing, a ladder of effects, or a
/// tuning: settings of the search that suit it, chosen on the older windows of its record (`split.train`
/// long) and judged on the newer ones. Everything but `kind` and `system` has a default that serves.
#[derive(Debug, Clone, PartialEq, ToSchema)]
pub struct SystemJob {
    /// What is to be done.
    #[schema(schema_with = kinds)]
    pub kind: JobKind,
    /// The system.
    pub system: SystemId,
    /// Never alters what is served.
    #[schema(required = false)]
    pub experiment: bool,
    /// Who goes first.
    #[schema(required = false)]
    pub priority: Priority,
    /// What is asked, apart from what the system will fill in; `body` describes it as it is completed.
    #[schema(ignore)]
    pub settings: Map<String, Value>,
}

fn kinds() -> RefOr<Schema> {
    word(JobKind::ALL.iter().map(|kind| kind.as_str()), "The kind of a job for one system.")
}

/// The same for several systems.
#[derive(Debug, Clone, PartialEq, ToSchema)]
pub struct BatchJob {
    /// Who goes first.
    #[schema(required = false)]
    pub priority: Priority,
    /// Which systems, and what is asked of them.
    #[serde(flatten)]
    #[schema(inline)]
    pub batch: BatchRequest,
}

/// A request to recalibrate or to diagnose several systems; also what a schedule submits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BatchRequest {
    /// What is done; each kind has a description of its own.
    #[serde(default = "BatchKind::usual", skip_serializing_if = "BatchKind::is_usual")]
    #[schema(ignore)]
    pub kind: BatchKind,
    /// Which systems.
    #[schema(min_items = 1)]
    pub systems: Vec<SystemPattern>,
    /// What is asked of each, apart from what the system will fill in; `body` describes it as it is
    /// completed.
    #[serde(flatten)]
    #[schema(ignore)]
    pub settings: Map<String, Value>,
}

/// Reads the body of `POST /jobs`, field by field, so that every fault is listed at once.
///
/// # Errors
/// Every fault.
pub fn read(body: Value) -> Result<JobRequest, Vec<Fault>> {
    let Value::Object(mut fields) = body else {
        return Err(vec![Fault::new("", "wrong-type", "the body must be an object")]);
    };
    let named = fields.shift_remove("kind");
    let mut faults = Vec::new();
    let kind = match named.as_ref().map(Value::as_str) {
        Some(Some(kind)) if KINDS.contains(&kind) => kind,
        // What else is wrong can be said all the same: several systems are recalibrated where nothing else is
        // said.
        other => {
            faults.push(match other {
                None => {
                    Fault::new("/kind", "missing-field", format!("`kind` is missing: {}", KINDS.join(" or ")))
                }
                Some(None) => Fault::new("/kind", "wrong-type", "the kind is a word"),
                Some(Some(kind)) => {
                    let shown: String = kind.chars().take(40).collect();
                    let fault = Fault::new(
                        "/kind",
                        "unknown-value",
                        format!("`{}` is none of {}", shown.escape_debug(), KINDS.join(", ")),
                    );
                    match nearest(kind, KINDS) {
                        Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                        None => fault,
                    }
                }
            });
            if fields.contains_key("systems") && !fields.contains_key("system") {
                "recalibrate"
            } else {
                "estimate"
            }
        }
    };
    let asked = match kind {
        "recalibrate" => read_several(BatchKind::Recalibrate, fields),
        "diagnose" if fields.contains_key("systems") && !fields.contains_key("system") => {
            read_several(BatchKind::Diagnose, fields)
        }
        "diagnose" => read_one(JobKind::Diagnose, fields),
        "ladder" => read_one(JobKind::Ladder, fields),
        "tune" => read_one(JobKind::Tune, fields),
        _ => read_one(JobKind::Estimate, fields),
    };
    match asked {
        Ok(asked) if faults.is_empty() => Ok(asked),
        asked => {
            faults.extend(asked.err().into_iter().flatten());
            Err(faults)
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
    if kind != JobKind::Ladder && fields.contains_key("criterion") {
        faults.push(Fault::new("/criterion", "contradiction", "only a ladder has a criterion"));
    }
    if kind != JobKind::Diagnose && fields.contains_key("accusation_rate") {
        faults.push(Fault::new(
            "/accusation_rate",
            "contradiction",
            "only a diagnosis has an accusation rate",
        ));
    }
    // Only an estimate alters what is served. A diagnosis needs a part that no decision sees, a tuning
    // windows of equal length.
    let experiment = experiment || kind != JobKind::Estimate;
    let split = match kind {
        JobKind::Estimate => None,
        JobKind::Diagnose | JobKind::Ladder => Some(SplitRequest::DIAGNOSE),
        JobKind::Tune => Some(tune::SPLIT),
    };
    if let Some(split) = split.filter(|_| !fields.contains_key("split")) {
        fields.insert("split".to_owned(), serde_json::to_value(split).unwrap_or_default());
    }
    match system {
        Some(system) if faults.is_empty() => {
            Ok(JobRequest::One(SystemJob { kind, system, experiment, priority, settings: fields }))
        }
        _ => Err(faults),
    }
}

fn read_several(kind: BatchKind, mut fields: Map<String, Value>) -> Result<JobRequest, Vec<Fault>> {
    let mut faults = Vec::new();
    let priority = take_or(&mut fields, "priority", Priority::Operator, &mut faults);
    match read_batch(kind, fields) {
        Ok(batch) if faults.is_empty() => Ok(JobRequest::Several(BatchJob { priority, batch })),
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
pub fn read_batch(kind: BatchKind, mut fields: Map<String, Value>) -> Result<BatchRequest, Vec<Fault>> {
    let mut faults = Vec::new();
    let systems = take::<Vec<SystemPattern>>(&mut fields, "systems", &mut faults);
    match systems.as_ref().map_or(1, Vec::len) {
        0 => {
            faults.push(Fault::new("/systems", "empty", "no system is named").suggest("such as [\"room/*\"]"))
        }
        1..=MOST_PATTERNS => {}
        count => {
            let detail = format!("{count} patterns are named, {MOST_PATTERNS} are the most");
            faults.push(Fault::new("/systems", "too-many", detail).suggest("such as [\"room/*\"]"));
        }
    }
    if fields.contains_key("criterion") {
        faults.push(Fault::new("/criterion", "unknown-field", "only a ladder has a criterion"));
    }
    if kind != BatchKind::Diagnose && fields.contains_key("accusation_rate") {
        faults.push(Fault::new(
            "/accusation_rate",
            "contradiction",
            "only a diagnosis has an accusation rate",
        ));
    }
    if fields.contains_key("model") {
        faults.push(Fault::new("/model", "unknown-field", "a batch takes the model of each system"));
        fields.shift_remove("model");
    }
    if let Err(more) = complete(&fields, None) {
        faults.extend(more);
    }
    match systems {
        Some(systems) if faults.is_empty() => Ok(BatchRequest { kind, systems, settings: fields }),
        _ => Err(faults),
    }
}

/// Takes a field that may be there out of an object.
fn take_or<T: serde::de::DeserializeOwned>(
    fields: &mut Map<String, Value>,
    name: &str,
    default: T,
    faults: &mut Vec<Fault>,
) -> T {
    if fields.contains_key(name) { take(fields, name, faults).unwrap_or(default) } else { default }
}

/// Takes a field that must be there out of an object.
fn take<T: serde::de::DeserializeOwned>(
    fields: &mut Map<String, Value>,
    name: &str,
    faults: &mut Vec<Fault>,
) -> Option<T> {
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
pub fn complete(
    settings: &Map<String, Value>,
    system: Option<&SystemDocument>,
) -> Result<EstimateRequest, Vec<Fault>> {
    match read_settings(settings, system) {
        (request, faults) if faults.is_empty() => Ok(request),
        (_, faults) => Err(faults),
    }
}

/// As much of a request as can be read, with every fault of the rest.
pub fn read_settings(
    settings: &Map<String, Value>,
    system: Option<&SystemDocument>,
) -> (EstimateRequest, Vec<Fault>) {
    let mut fields = settings.clone();
    let method = fields.shift_remove("method").map(read_method);
    let Read { document: request, mut faults, .. } =
        decode::read::<EstimateRequest>(Value::Object(fields), &Value::Null);
    let mut request = request.unwrap_or_default();
    if let Some((method, more)) = method {
        request.method = method.unwrap_or_default();
        faults.extend(more);
    }
    let named = settings.get("method").is_some_and(|method| method.get("name").is_some());
    let objective = settings.contains_key("objective").then_some(request.objective);
    match agreed(objective, named.then(|| request.method.method.clone())) {
        Ok((objective, method)) => {
            request.objective = objective;
            // Hyperparameters without a name are those of the default method.
            if named || objective == Objective::Likelihood {
                request.method.method = method;
            }
        }
        Err(fault) => faults.push(fault),
    }
    if let Some(system) = system {
        if !settings.contains_key("prior") {
            request.prior.clone_from(&system.prior);
        }
        // A seed alone is no method.
        let asked = settings
            .get("method")
            .and_then(Value::as_object)
            .is_some_and(|method| method.keys().any(|field| field != "seed"));
        if let Some(method) =
            system.method.as_ref().filter(|_| !asked && request.objective != Objective::Likelihood)
        {
            let seed = if settings.contains_key("method") { request.method.seed } else { method.seed };
            request.method = SeededMethod { seed, method: method.method.clone() };
        }
        // Bounds and fixed values of the system name parameters of its own model.
        if request.model.is_none() {
            request.model.clone_from(&system.model);
        }
        if request.model == system.model {
            if !settings.contains_key("bounds") {
                request.bounds.clone_from(&system.bounds);
            }
            if !settings.contains_key("fixed") {
                request.fixed.clone_from(&system.fixed);
            }
        }
    }
    faults.extend(senseless(&request));
    (request, faults)
}

/// Reads a method with every fault of its hyperparameters.
fn read_method(value: Value) -> (Option<SeededMethod>, Vec<Fault>) {
    let fields = match decode::decode::<Map<String, Value>>(value) {
        Ok(fields) => MethodFields::from(fields),
        Err(faults) => return (None, inside("/method", faults)),
    };
    let seed = decode::read::<u64>(fields.seed.clone(), &Value::Null);
    let mut faults = inside("/method/seed", seed.faults);
    let Some(document) = fields.method() else {
        faults.push(Fault::new("/method/name", "wrong-type", "the name of a method is a text"));
        return (None, faults);
    };
    let method = decode::read::<Method>(document, &Value::Null);
    // What is wrong with the whole is that no method has this name.
    let place = |fault: &Fault| if fault.pointer.is_empty() { "/method/name" } else { "/method" };
    faults.extend(method.faults.into_iter().flat_map(|fault| inside(place(&fault), vec![fault])));
    faults.extend(method.document.iter().flat_map(Method::faults).map(|range| {
        let field = range.field.split(' ').next().unwrap_or_default().replace('.', "/");
        Fault::new(format!("/method/{field}"), "out-of-range", format!("`{}` {range}", range.field))
    }));
    (seed.document.zip(method.document).map(|(seed, method)| SeededMethod { seed, method }), faults)
}

/// Faults that were found inside something that the pointer names.
fn inside(pointer: &str, faults: Vec<Fault>) -> Vec<Fault> {
    faults
        .into_iter()
        .map(|fault| Fault { pointer: format!("{pointer}{}", fault.pointer), ..fault })
        .collect()
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
        let instant = |text: &Option<String>| text.as_ref().and_then(|text| read_time("", text).ok());
        if instant(&window.from).zip(instant(&window.to)).is_some_and(|(from, to)| from > to) {
            faults.push(Fault::new("/window/to", "out-of-order", "it ends before it starts"));
        }
        if window.last.is_some_and(|last| last.is_zero()) {
            faults.push(Fault::new("/window/last", "out-of-range", "it must be longer than nothing"));
        }
        if window.last.is_some() && window.from.is_some() {
            faults.push(Fault::new("/window", "contradiction", "`last` and `from` exclude each other"));
        }
    }
    if request.split.train.is_zero() {
        faults.push(Fault::new("/split/train", "out-of-range", "it must be longer than nothing"));
    }
    if !(1..=MOST_EVALUATIONS).contains(&request.budget.evaluations) {
        faults.push(Fault::new(
            "/budget/evaluations",
            "out-of-range",
            format!("there are between 1 and {MOST_EVALUATIONS} evaluations"),
        ));
    }
    if request.budget.wall.is_some_and(|wall| wall.is_zero()) {
        faults.push(Fault::new("/budget/wall", "out-of-range", "it must be longer than nothing"));
    }
    faults.extend(request.early_stopping.iter().flat_map(EarlyStopping::faults));
    for (name, [lower, upper]) in &request.bounds {
        if lower >= upper {
            faults.push(Fault::new(
                format!("/bounds/{name}"),
                "out-of-order",
                format!("[{lower}, {upper}] is no interval"),
            ));
        }
    }
    faults
}
