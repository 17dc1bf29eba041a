//! Models and effects of users beside the built-in ones. Documents never change, because fits refer to them.

use crate::service::decode::{self, Read};
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store::idempotency::RequestKey;
use crate::store::models::{self, DocumentInsertion, VersionRecord};
use indexmap::IndexMap;
use lampyris_core::fault::{Fault, nearest};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::plant::PlantSpec;
use lampyris_core::model::spec::{
    CompositionSpec, Definition, EffectSpec, InputSpec, ModelSpec, ParameterSpec, clear_quantities,
};
use lampyris_core::model::{Bindings, Catalogue, Model, ModelId, compile};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::cmp::Reverse;
use utoipa::ToSchema;

/// Most bytes of a document in JSON, which is wordier than TOML.
pub const LONGEST_DOCUMENT: usize = 256 << 10;

/// A document that was taken, and whether it is new.
#[derive(Debug, Clone)]
pub struct Taken<T> {
    /// The thing.
    pub thing: T,
    /// Whether it is new.
    pub is_new: bool,
}

/// A model made by adding an effect.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ModelVersion {
    /// Its id.
    pub id: ModelId,
    /// The model that it was made from.
    pub parent: ModelId,
    /// What was added.
    pub diff: ModelDiff,
    /// Hash of its content.
    pub hash: String,
}

/// What an effect added to a model.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ModelDiff {
    /// The effect, with its argument.
    effect: String,
    title: String,
    inputs: IndexMap<String, InputSpec>,
    parameters: IndexMap<String, ParameterSpec>,
    /// Terms by state.
    terms: IndexMap<String, String>,
    /// Terms by output.
    outputs: IndexMap<String, String>,
    // Subexpressions are named inside the terms alone, so the description leaves them out.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    #[schema(ignore)]
    define: IndexMap<String, Definition>,
    /// New meanings of names, where it has any.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    replace: IndexMap<String, String>,
}

/// An effect of the catalogue by name, or a whole effect document.
#[derive(Debug, ToSchema)]
#[serde(untagged)]
pub(crate) enum AddedEffect {
    Named(NamedEffect),
    Document(Box<EffectSpec>),
}

/// An effect of the catalogue, with its argument where it takes one.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct NamedEffect {
    #[schema(pattern = "^[A-Za-z0-9_]{1,64}(:[A-Za-z0-9_]{1,64})?$", example = "wind_infiltration")]
    effect: String,
}

/// Reads and compiles a model document against a catalogue.
///
/// # Errors
/// Every fault of its form, and every fault of its meaning unless something that others may refer to could
/// not be read.
pub fn check_model(catalogue: &Catalogue, body: Value) -> Result<(ModelDocument, Model), Vec<Fault>> {
    require_short(&body)?;
    if body.get("base").is_some() {
        return check_composition(catalogue, body);
    }
    if ModelDocument::is_plant(|name| body.get(name).is_some()) {
        return check_plant(catalogue, body);
    }
    let Read { document: spec, mut faults, .. } = decode::read::<ModelSpec>(body, &Value::Null);
    let Some(mut spec) = spec.filter(|_| is_whole(&faults)) else {
        return Err(faults);
    };
    let id = plain_id(&spec.id, &mut faults);
    spec.id = id.to_string();
    let document = ModelDocument::Spec(Box::new(spec));
    let mut extended = catalogue.clone();
    extended.add_model(document.clone());
    judged(compiled(&extended, &id), faults).map(|model| (document, model))
}

/// Refuses documents that are longer than any model needs, as they stand without spaces.
fn require_short(body: &Value) -> Result<(), Vec<Fault>> {
    let length = body.to_string().len();
    if length > LONGEST_DOCUMENT {
        let detail = format!("the document has {length} bytes, the limit is {LONGEST_DOCUMENT}");
        return Err(vec![Fault::new("", "too-large", detail)]);
    }
    Ok(())
}

fn check_plant(catalogue: &Catalogue, body: Value) -> Result<(ModelDocument, Model), Vec<Fault>> {
    let Read { document: plant, mut faults, .. } = decode::read::<PlantSpec>(body, &Value::Null);
    let Some(mut plant) = plant.filter(|_| is_whole(&faults)) else {
        return Err(faults);
    };
    let id = plain_id(&plant.id, &mut faults);
    plant.id = id.to_string();
    let document = ModelDocument::Plant(Box::new(plant));
    let mut extended = catalogue.clone();
    extended.add_model(document.clone());
    let compiled =
        compiled(&extended, &id).map_err(|found| found.into_iter().map(PlantSpec::place).collect());
    judged(compiled, faults).map(|model| (document, model))
}

fn check_composition(catalogue: &Catalogue, body: Value) -> Result<(ModelDocument, Model), Vec<Fault>> {
    let Read { document: composition, mut faults, .. } = decode::read::<CompositionSpec>(body, &Value::Null);
    let Some(mut composition) = composition.filter(|_| is_whole(&faults)) else {
        return Err(faults);
    };
    let id = plain_id(&composition.id, &mut faults);
    composition.id = id.to_string();
    if catalogue.model(&composition.base).is_none() || composition.base == composition.id {
        let fault = Fault::new(
            "/base",
            "unknown-model",
            format!("there is no model `{}` to start from", composition.base),
        );
        let known = catalogue.models().map(ModelDocument::id);
        faults.push(match nearest(&composition.base, known) {
            Some(near) => fault.suggest(format!("did you mean `{near}`?")),
            None => fault,
        });
    }
    for (index, effect) in composition.effects.iter().enumerate() {
        faults.extend(
            catalogue
                .effect(effect)
                .err()
                .map(|fault| Fault { pointer: format!("/effects/{index}"), ..fault }),
        );
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    let place = |fault: Fault| {
        let index = composition
            .effects
            .iter()
            .position(|effect| fault.pointer.starts_with(&format!("/effects/{effect}/")));
        match index {
            Some(index) => Fault {
                detail: format!("{}: {}", fault.pointer, fault.detail),
                pointer: format!("/effects/{index}"),
                ..fault
            },
            None => fault,
        }
    };
    let document = ModelDocument::Composition(composition.clone());
    let mut extended = catalogue.clone();
    extended.add_model(document.clone());
    let model =
        compiled(&extended, &id).map_err(|faults| faults.into_iter().map(place).collect::<Vec<_>>())?;
    Ok((document, model))
}

/// Whether a document was read with all that others may refer to: only what nobody knows was left out.
fn is_whole(faults: &[Fault]) -> bool {
    faults.iter().all(|fault| fault.code == "unknown-field")
}

/// What was compiled, if there is no fault at all.
fn judged<T>(compiled: Result<T, Vec<Fault>>, mut faults: Vec<Fault>) -> Result<T, Vec<Fault>> {
    match compiled {
        Ok(compiled) if faults.is_empty() => Ok(compiled),
        compiled => {
            faults.extend(compiled.err().into_iter().flatten());
            Err(faults)
        }
    }
}

/// The id of a document: a base without effects. Where it is none, another one stands for it.
fn plain_id(text: &str, faults: &mut Vec<Fault>) -> ModelId {
    match text.parse::<ModelId>() {
        Ok(id) if id.with().is_empty() && id.without().is_empty() => return id,
        Ok(_) => faults.push(Fault::new(
            "/id",
            "invalid-id",
            "the id of a document has no `+` or `-`: effects are added with POST /models/{id}/effects",
        )),
        Err(error) => faults.push(Fault::new("/id", "invalid-id", error.to_string())),
    }
    ModelId::unnamed()
}

/// Compiles the model of an id with everything that its documents name.
///
/// # Errors
/// Every fault, also where a part of the id does not exist.
pub fn compiled(catalogue: &Catalogue, id: &ModelId) -> Result<Model, Vec<Fault>> {
    compile(&catalogue.compose(id)?, &Bindings::default())
}

/// Takes a model document of a user.
///
/// # Errors
/// Its faults, another document with the same id, or where the database fails.
pub(crate) async fn create(
    service: &Service,
    body: Value,
    who: &str,
    key: Option<&RequestKey>,
) -> Result<Taken<ModelDocument>, ServiceError> {
    let catalogue = service.catalogue.current();
    let reading = catalogue.clone();
    let (document, _) = blocking(move || check_model(&reading, body)).await?.map_err(ServiceError::Faults)?;
    let stored = models::models(&service.store).await?.iter().any(|known| known.id() == document.id());
    if let Some(builtin) = catalogue.model(document.id()).filter(|_| !stored) {
        return same_or_conflict(builtin == &document, "model", document.id())
            .map(|()| Taken { thing: document, is_new: false });
    }
    let is_new = settled(
        models::insert_model(&service.store, &document, who, key, service.now()).await?,
        "model",
        document.id(),
    )?;
    service.catalogue.change(|catalogue| catalogue.add_model(document.clone()));
    Ok(Taken { thing: document, is_new })
}

/// Reads an effect document and tries it on a model that it can be added to.
///
/// # Errors
/// Every fault of its form and, against `parent`, of its meaning.
pub(in crate::service) fn check_effect(
    catalogue: &Catalogue,
    parent: Option<&ModelId>,
    body: Value,
) -> Result<EffectSpec, Vec<Fault>> {
    require_short(&body)?;
    let Read { document: effect, mut faults, .. } = decode::read::<EffectSpec>(body, &Value::Null);
    let Some(mut effect) = effect.filter(|_| is_whole(&faults)) else {
        return Err(faults);
    };
    effect.id = plain_id(&effect.id, &mut faults).to_string();
    if effect.terms.is_empty() && effect.outputs.is_empty() && effect.replace.is_empty() {
        faults.push(Fault::new(
            "/terms",
            "no-terms",
            "an effect adds a term to an equation or to an output, or replaces a name",
        ));
    }
    let is_head = |known: &EffectSpec, of: &str| {
        known.id == of && known.argument == effect.argument && known.way_of.is_none()
    };
    if let Some(of) =
        effect.way_of.as_deref().filter(|of| !catalogue.effects().any(|known| is_head(known, of)))
    {
        let detail =
            format!("there is no effect `{of}` with the same argument that is no way of another itself");
        faults.push(Fault::new("/way_of", "unknown-effect", detail));
    }
    let mut extended = catalogue.clone();
    extended.add_effect(effect.clone());
    // Any channel, and the first choice, stand for all others.
    let member = effect.choices.keys().next().map_or("P_example", String::as_str);
    let name = if effect.argument.is_some() { format!("{}:{member}", effect.id) } else { effect.id.clone() };
    let tried = match parent {
        Some(parent) => compiled(&extended, &parent.plus(&name)).map(drop),
        None => try_on_any(&extended, &effect, &name),
    };
    // The compiler knows where the effect is in the model; the sender knows the document.
    let own = format!("/effects/{name}");
    let place = |fault: Fault| Fault {
        pointer: fault.pointer.strip_prefix(&own).unwrap_or(&fault.pointer).to_owned(),
        ..fault
    };
    judged(tried.map_err(|faults| faults.into_iter().map(place).collect()), faults).map(|()| effect)
}

/// An effect is at home in any model that has the states and the other names that it acts on. Where none has
/// them all, the model that has most of them tells what is wrong.
fn try_on_any(catalogue: &Catalogue, effect: &EffectSpec, name: &str) -> Result<(), Vec<Fault>> {
    let specs = catalogue.models().filter_map(|document| match document {
        ModelDocument::Spec(spec) => Some(Cow::Borrowed(&**spec)),
        ModelDocument::Plant(_) => catalogue.expanded(document).map(Cow::Owned),
        ModelDocument::Composition(_) => None,
    });
    let known = |spec: &ModelSpec| {
        let named = |name: &&String| {
            spec.define.contains_key(*name)
                || spec.parameters.contains_key(*name)
                || spec.inputs.contains_key(*name)
        };
        effect.terms.keys().filter(|state| spec.states.contains_key(*state)).count()
            + effect.replace.keys().filter(named).count()
    };
    let mut by_names: Vec<_> = specs.map(|spec: Cow<ModelSpec>| (known(&spec), spec)).collect();
    by_names.sort_by_key(|(count, _)| Reverse(*count));
    let most = by_names.first().map_or(0, |(count, _)| *count);
    let mut first = None;
    for (_, spec) in by_names.into_iter().take_while(|(count, _)| *count == most) {
        match spec.id.parse::<ModelId>().map(|id| compiled(catalogue, &id.plus(name))) {
            Ok(Ok(_)) => return Ok(()),
            Ok(Err(faults)) => first = first.or(Some(faults)),
            Err(_) => {}
        }
    }
    Err(first.unwrap_or_default())
}

/// Takes an effect document of a user.
///
/// # Errors
/// Its faults, another document with the same id, or where the database fails.
pub(crate) async fn create_effect(
    service: &Service,
    body: Value,
    who: &str,
    key: Option<&RequestKey>,
) -> Result<Taken<EffectSpec>, ServiceError> {
    let catalogue = service.catalogue.current();
    let reading = catalogue.clone();
    let effect = blocking(move || check_effect(&reading, None, body)).await?.map_err(ServiceError::Faults)?;
    let stored = models::effects(&service.store).await?.iter().any(|known| known.id == effect.id);
    if let Some(builtin) = catalogue.effect_document(&effect.id).filter(|_| !stored) {
        return same_or_conflict(builtin == &effect, "effect", &effect.id)
            .map(|()| Taken { thing: effect, is_new: false });
    }
    let is_new = settled(
        models::insert_effect(&service.store, &effect, who, key, service.now()).await?,
        "effect",
        &effect.id,
    )?;
    service.catalogue.change(|catalogue| catalogue.add_effect(effect.clone()));
    Ok(Taken { thing: effect, is_new })
}

/// Makes a model from another one by adding an effect, by name (`{"effect": "wind_infiltration"}`) or as a
/// whole document.
///
/// # Errors
/// Its faults, another document with the same id, or where the database fails.
pub(crate) async fn add_effect(
    service: &Service,
    parent: &ModelId,
    body: Value,
    who: &str,
    key: Option<&RequestKey>,
) -> Result<Taken<ModelVersion>, ServiceError> {
    let catalogue = service.catalogue.current();
    if let Err(faults) = catalogue.compose(parent) {
        return Err(if faults.iter().all(|fault| fault.code == "unknown-model") {
            ServiceError::NotFound("model", parent.to_string())
        } else {
            ServiceError::Faults(faults)
        });
    }
    let base = parent.clone();
    let made =
        blocking(move || make_version(&catalogue, &base, body)).await?.map_err(ServiceError::Faults)?;
    let (version, effect) = made;
    if let Some(effect) = &effect
        && let Some(known) = service.catalogue.current().effect_document(&effect.id)
    {
        same_or_conflict(known == effect, "effect", &effect.id)?;
    }
    let record = VersionRecord {
        id: version.id.clone(),
        parent: version.parent.clone(),
        effect: version.diff.effect.clone(),
        document: json!(version),
        created_at: service.now(),
    };
    let kept = models::insert_version(&service.store, &record, effect.as_ref(), who, key).await?;
    let is_new = settled(kept, "model", &version.id.to_string())?;
    if let Some(effect) = effect {
        service.catalogue.change(|catalogue| catalogue.add_effect(effect.clone()));
    }
    Ok(Taken { thing: version, is_new })
}

/// The catalogue knows the effect as a part of a model's id; the sender knows it by its own field.
fn at_effect(fault: Fault) -> Fault {
    if fault.pointer == "/model" { Fault { pointer: "/effect".into(), ..fault } } else { fault }
}

/// Reads the effect that is to be added. Which of the two forms is meant shows before it is read, so that
/// every fault of that form is listed.
fn read_added(catalogue: &Catalogue, parent: &ModelId, body: Value) -> Result<AddedEffect, Vec<Fault>> {
    if body.get("effect").is_some() {
        let mut named = decode::read::<NamedEffect>(body, &Value::Null);
        let unknown = named.document.as_ref().and_then(|named| catalogue.effect(&named.effect).err());
        named.add(unknown.map(at_effect));
        return named.finish().map(AddedEffect::Named);
    }
    let effect = check_effect(catalogue, Some(parent), body)?;
    if let Some(word) = &effect.argument {
        let detail = format!("`{}` needs a {word}: post it to /effects, then add it here by name", effect.id);
        return Err(vec![Fault::new("/argument", "argument-missing", detail)]);
    }
    Ok(AddedEffect::Document(Box::new(effect)))
}

/// The new version, and its effect where that came as a document.
fn make_version(
    catalogue: &Catalogue,
    parent: &ModelId,
    body: Value,
) -> Result<(ModelVersion, Option<EffectSpec>), Vec<Fault>> {
    let (name, own) = match read_added(catalogue, parent, body)? {
        AddedEffect::Named(named) => (named.effect, None),
        AddedEffect::Document(effect) => (effect.id.clone(), Some(*effect)),
    };
    let mut extended = catalogue.clone();
    own.iter().for_each(|effect| extended.add_effect(effect.clone()));
    let spec = extended.effect(&name).map_err(|fault| vec![at_effect(fault)])?;
    let id = parent.plus(&name);
    if id == *parent {
        return Err(vec![Fault::new(
            "/effect",
            "already-there",
            format!("`{parent}` has the effect `{name}` already"),
        )]);
    }
    let model =
        compiled(&extended, &id).map_err(|faults| faults.into_iter().map(at_effect).collect::<Vec<_>>())?;
    // A version that is kept is compared with what is posted again.
    let mut parameters = spec.parameters;
    clear_quantities(&mut parameters);
    let diff = ModelDiff {
        effect: name,
        title: spec.title,
        inputs: spec.inputs,
        parameters,
        terms: spec.terms,
        outputs: spec.outputs,
        define: spec.define,
        replace: spec.replace,
    };
    Ok((ModelVersion { id, parent: parent.clone(), diff, hash: model.hash().to_owned() }, own))
}

fn same_or_conflict(same: bool, what: &'static str, id: &str) -> Result<(), ServiceError> {
    if same { Ok(()) } else { Err(ServiceError::Conflict(what, id.to_owned())) }
}

/// Whether a document that was kept is new.
fn settled(kept: DocumentInsertion, what: &'static str, id: &str) -> Result<bool, ServiceError> {
    match kept {
        DocumentInsertion::New => Ok(true),
        DocumentInsertion::Known => Ok(false),
        DocumentInsertion::Conflict => Err(ServiceError::Conflict(what, id.to_owned())),
        DocumentInsertion::KeyReused => Err(ServiceError::KeyReused),
    }
}
