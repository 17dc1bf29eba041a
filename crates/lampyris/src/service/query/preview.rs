//! A short simulation of a model that somebody edits: over the window of a system, or on standard days.

use crate::service::catalogue::models::{check_effect, check_model};
use crate::service::catalogue::system::{self, SystemDocument};
use crate::service::decode;
use crate::service::error::ServiceError;
use crate::service::queue::submit;
use crate::service::state::Service;
use crate::service::work::input;
use crate::service::work::interactive::RenderedAnswer;
use crate::store;
use indexmap::IndexMap;
use lampyris_core::data::{Duration, SplitRequest, SystemId, read_time, rfc3339};
use lampyris_core::estimate::assess::preview::{preview, standard_days};
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::estimate::{EstimateRequest, prepare};
use lampyris_core::fault::Fault;
use lampyris_core::interrupt::Brake;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::model::{Bindings, Catalogue, ModelId, compile};
use serde::Deserialize;
use serde_json::Value;
use utoipa::ToSchema;

/// Longest window of a preview.
const LONGEST: Duration = Duration::from_days(28);
/// The window of a preview that asks for none.
const USUAL: Duration = Duration::from_days(7);
/// Most samples that are shown.
const MOST_POINTS: usize = 2000;

/// What is simulated. Every field has a default, but a model or a system must be named.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PreviewBody)]
pub struct Request {
    /// The id of a model, or a whole model document; the system's own model by default.
    model: Option<PreviewModel>,
    /// Effects to add: ids, or whole effect documents.
    #[serde(default)]
    effects: Vec<PreviewEffect>,
    /// Values of parameters in their units; the nominal ones for the others.
    #[serde(default)]
    #[schema(example = json!({"alpha_h": 0.4}))]
    parameters: IndexMap<String, f64>,
    /// The system whose measurements drive the model. Without one the inputs are those of two standard days:
    /// a cool March with sun, heating by day, and people in the evening; channels that nobody knows step from
    /// 0 to 1 at noon.
    system: Option<SystemId>,
    /// Which of its measurements, at most 28 days: `last`, or `from` and `to`; the last seven by default.
    window: Option<WindowRange>,
    /// Most points of a curve, from 2 to 2000; 2000 by default. A longer one shows every so many samples.
    #[schema(minimum = 2, maximum = 2000)]
    max_points: Option<usize>,
}

/// A model by its id, or a whole model document.
// The document is read on its own, so that all of its faults are listed.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(untagged)]
enum PreviewModel {
    #[schema(value_type = ModelId)]
    Named(String),
    #[schema(value_type = ModelDocument)]
    Document(Value),
}

/// An effect by its id, with its argument where it takes one, or a whole effect document.
// The document is read on its own, so that all of its faults are listed.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(untagged)]
enum PreviewEffect {
    Named(String),
    #[schema(value_type = EffectSpec)]
    Document(Value),
}

/// Simulates a model with nominal or given values.
///
/// # Errors
/// Every fault of the model, the values and the window, or where the database fails.
pub(crate) async fn run(service: &Service, body: Value) -> Result<RenderedAnswer, ServiceError> {
    let request: Request = decode::decode(body).map_err(ServiceError::Faults)?;
    let faults = faults(&request);
    if !faults.is_empty() {
        return Err(ServiceError::Faults(faults));
    }
    let record = match &request.system {
        None => None,
        Some(system) => match store::systems::get(&service.store, system).await? {
            Some(record) => Some(system::document(&record.document)?),
            None => return Err(ServiceError::Faults(vec![submit::unknown_system(service, system).await?])),
        },
    };
    let catalogue = service.catalogue.current();
    let input = match (&request.system, &record) {
        (Some(system), Some(document)) => {
            let asked = asked(&request);
            let model = document.require_model().map_err(ServiceError::Faults)?.clone();
            Some(input::collect(service, system, document.clone(), model, asked, 0).await?)
        }
        _ => None,
    };
    // Everything that takes time happens here: compiling, stitching, simulating.
    let work = move |brake: &Brake| {
        let (catalogue, model) =
            assemble(&catalogue, &request, record.as_ref()).map_err(ServiceError::Faults)?;
        let (window, site) = match &input {
            Some(input) => (input.window()?, input.system.site()),
            None => standard_days(&catalogue, &model).map_err(ServiceError::Faults)?,
        };
        let problem = prepare(&catalogue, &model, &asked(&request), &window, &site)
            .map_err(|faults| ServiceError::Faults(named(faults)))?
            .with_brake(brake);
        let most = request.max_points.unwrap_or(MOST_POINTS);
        let preview =
            preview(&problem, most, input.is_none()).map_err(|fault| ServiceError::Faults(vec![fault]))?;
        serde_json::to_vec(&preview).map_err(|error| ServiceError::Internal(error.to_string()))
    };
    service.interactive.once(work).await
}

fn faults(request: &Request) -> Vec<Fault> {
    let mut faults = Vec::new();
    if request.model.is_none() && request.system.is_none() {
        faults.push(Fault::new(
            "/model",
            "nothing-to-simulate",
            "name a model, post one as a document, or name a system that has one",
        ));
    }
    if request.window.is_some() && request.system.is_none() {
        faults.push(Fault::new(
            "/window",
            "contradiction",
            "a window is that of a system, and none is named",
        ));
    }
    if request.max_points.is_some_and(|points| !(2..=MOST_POINTS).contains(&points)) {
        faults.push(Fault::new(
            "/max_points",
            "out-of-range",
            format!("between 2 and {MOST_POINTS} points are shown"),
        ));
    }
    let Some(window) = &request.window else { return faults };
    if window.last.is_some_and(|last| last > LONGEST || last.is_zero()) {
        faults.push(Fault::new(
            "/window/last",
            "invalid-range",
            format!("a preview spans more than nothing and at most {LONGEST}"),
        ));
    }
    let mut instant = |field: &str, text: &Option<String>| {
        text.as_ref().and_then(|text| {
            read_time(&format!("/window/{field}"), text).map_err(|fault| faults.push(fault)).ok()
        })
    };
    if let (Some(from), Some(to)) = (instant("from", &window.from), instant("to", &window.to))
        && !(0..=LONGEST.millis()).contains(&to.saturating_sub(from))
    {
        faults.push(Fault::new(
            "/window",
            "invalid-range",
            format!("a preview spans more than nothing and at most {LONGEST}"),
        ));
    }
    faults
}

/// The preview in the words of an estimate: everything is one part, and the given values are fixed.
fn asked(request: &Request) -> EstimateRequest {
    let whole = SplitRequest { train: LONGEST, validation: Duration::ZERO, test: None };
    let window = match &request.window {
        Some(window @ WindowRange { last: None, from: Some(from), to: None }) => {
            let until = read_time("", from).ok().map(|from| rfc3339(from.saturating_add(LONGEST.millis())));
            WindowRange { to: until, ..window.clone() }
        }
        Some(window) if window.last.is_none() && window.from.is_none() => {
            WindowRange { last: Some(USUAL), ..window.clone() }
        }
        Some(window) => window.clone(),
        None => WindowRange { last: Some(USUAL), ..WindowRange::default() },
    };
    EstimateRequest {
        window: request.system.is_some().then_some(window),
        split: whole,
        fixed: request.parameters.clone(),
        ..EstimateRequest::default()
    }
}

/// The model with its effects, and the catalogue that knows the posted documents beside its own.
fn assemble(
    catalogue: &Catalogue,
    request: &Request,
    system: Option<&SystemDocument>,
) -> Result<(Catalogue, ModelId), Vec<Fault>> {
    let mut catalogue = catalogue.clone();
    let mut model = match &request.model {
        None => system.ok_or_else(Vec::new)?.require_model()?.clone(),
        Some(PreviewModel::Named(id)) => {
            id.parse().map_err(|error| vec![Fault::new("/model", "invalid-id", format!("{error}"))])?
        }
        Some(PreviewModel::Document(document)) => {
            let at = |fault: Fault| Fault { pointer: format!("/model{}", fault.pointer), ..fault };
            let (document, model) = check_model(&catalogue, document.clone())
                .map_err(|faults| faults.into_iter().map(at).collect::<Vec<_>>())?;
            catalogue.add_model(document);
            model.id().clone()
        }
    };
    let mut faults = Vec::new();
    let mut own = Vec::new();
    for (index, effect) in request.effects.iter().enumerate() {
        let name = match effect {
            PreviewEffect::Named(name) => match catalogue.effect(name) {
                Ok(_) => name.clone(),
                Err(fault) => {
                    faults.push(Fault { pointer: format!("/effects/{index}"), ..fault });
                    continue;
                }
            },
            PreviewEffect::Document(document) => {
                match check_effect(&catalogue, Some(&model), document.clone()) {
                    Ok(effect) => {
                        let id = effect.id.clone();
                        own.push((id.clone(), index));
                        catalogue.add_effect(effect);
                        id
                    }
                    Err(more) => {
                        faults.extend(more.into_iter().map(|fault| Fault {
                            pointer: format!("/effects/{index}{}", fault.pointer),
                            ..fault
                        }));
                        continue;
                    }
                }
            }
        };
        model = model.plus(&name);
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    // The faults of a posted effect name their places inside it as well.
    let composition = catalogue.compose(&model)?;
    let numbered = |fault: Fault| {
        let inside = own.iter().find_map(|(id, index)| {
            Some((index, fault.pointer.strip_prefix(&format!("/effects/{id}"))?.to_owned()))
        });
        match inside {
            Some((index, rest)) => Fault { pointer: format!("/effects/{index}{rest}"), ..fault },
            None => fault,
        }
    };
    compile(&composition, &Bindings::default())
        .map_err(|faults| faults.into_iter().map(numbered).collect::<Vec<_>>())?;
    Ok((catalogue, model))
}

/// The faults in the words of a preview, which calls fixed values parameters.
fn named(faults: Vec<Fault>) -> Vec<Fault> {
    let renamed = |fault: Fault| match fault.pointer.strip_prefix("/fixed") {
        Some(rest) => Fault { pointer: format!("/parameters{rest}"), ..fault },
        None => fault,
    };
    faults.into_iter().map(renamed).collect()
}
