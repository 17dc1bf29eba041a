//! Models and effects of users beside the built-in ones. Documents never change, because fits refer to them.

use super::{JobsError, Service, blocking, decode, now};
use crate::fault::Fault;
use crate::model::spec::{CompositionSpec, EffectSpec, ModelDocument, ModelSpec};
use crate::model::{Bindings, Catalogue, Model, ModelId, compile};
use crate::store::idempotency::RequestKey;
use crate::store::models::{self, Kept, VersionRecord};
use crate::store::{Store, StoreError};
use arc_swap::ArcSwap;
use serde_json::{Value, json};
use std::sync::Arc;

/// The catalogue that everybody reads. A new document makes a new catalogue; readers keep the one they have.
#[derive(Debug)]
pub struct SharedCatalogue(ArcSwap<Catalogue>);

impl SharedCatalogue {
    /// The built-in documents and those of the database.
    ///
    /// # Errors
    /// Where the database fails or holds unreadable documents.
    pub async fn load(store: &Store, mut builtin: Catalogue) -> Result<Self, StoreError> {
        models::models(store).await?.into_iter().for_each(|document| builtin.add_model(document));
        models::effects(store).await?.into_iter().for_each(|effect| builtin.add_effect(effect));
        Ok(Self(ArcSwap::from_pointee(builtin)))
    }

    /// The catalogue as it is now.
    pub fn current(&self) -> Arc<Catalogue> {
        self.0.load_full()
    }

    fn change(&self, change: impl Fn(&mut Catalogue)) {
        self.0.rcu(|catalogue| {
            let mut changed = Catalogue::clone(catalogue);
            change(&mut changed);
            changed
        });
    }
}

/// A document that was taken, and whether it is new.
#[derive(Debug, Clone)]
pub struct Taken<T> {
    /// The thing.
    pub thing: T,
    /// Whether it is new.
    pub is_new: bool,
}

/// Reads and compiles a model document against a catalogue.
///
/// # Errors
/// Every fault of its form and its meaning.
pub fn check_model(catalogue: &Catalogue, body: Value) -> Result<(ModelDocument, Model), Vec<Fault>> {
    let (document, id) = read_model(body)?;
    let mut extended = catalogue.clone();
    extended.add_model(document.clone());
    let model = compile(&extended.compose(&id)?, &Bindings::default())?;
    Ok((document, model))
}

/// Reads a model document, which is known as a composition by its `base`.
///
/// # Errors
/// Every fault of its form.
pub(super) fn read_model(body: Value) -> Result<(ModelDocument, ModelId), Vec<Fault>> {
    let document = if body.get("base").is_some() {
        ModelDocument::Composition(decode::decode::<CompositionSpec>(body)?)
    } else {
        ModelDocument::Spec(Box::new(decode::decode::<ModelSpec>(body)?))
    };
    let id = plain_id(document.id())?;
    Ok((document, id))
}

/// The id of a document: a base without effects.
fn plain_id(text: &str) -> Result<ModelId, Vec<Fault>> {
    match text.parse::<ModelId>() {
        Ok(id) if id.with().is_empty() && id.without().is_empty() => Ok(id),
        Ok(_) => Err(vec![Fault::new(
            "/id",
            "invalid-id",
            "the id of a document has no `+` or `-`: effects are added with POST /models/{id}/effects",
        )]),
        Err(error) => Err(vec![Fault::new("/id", "invalid-id", error.to_string())]),
    }
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
pub async fn create(service: &Service, body: Value, key: Option<&RequestKey>) -> Result<Taken<ModelDocument>, JobsError> {
    let catalogue = service.catalogue.current();
    let reading = catalogue.clone();
    let (document, _) = blocking(move || check_model(&reading, body)).await?.map_err(JobsError::Faults)?;
    let stored = models::models(&service.store).await?.iter().any(|known| known.id() == document.id());
    if let Some(builtin) = catalogue.model(document.id()).filter(|_| !stored) {
        return same_or_conflict(builtin == &document, "model", document.id()).map(|()| Taken { thing: document, is_new: false });
    }
    let is_new = settled(models::insert_model(&service.store, &document, key, now()).await?, "model", document.id())?;
    service.catalogue.change(|catalogue| catalogue.add_model(document.clone()));
    Ok(Taken { thing: document, is_new })
}

/// Reads an effect document and tries it on a model that it can be added to.
///
/// # Errors
/// Every fault of its form and, against `parent`, of its meaning.
fn check_effect(catalogue: &Catalogue, parent: Option<&ModelId>, body: Value) -> Result<EffectSpec, Vec<Fault>> {
    let effect: EffectSpec = decode::decode(body)?;
    plain_id(&effect.id)?;
    let mut extended = catalogue.clone();
    extended.add_effect(effect.clone());
    let name = if effect.argument.is_some() { format!("{}:P_example", effect.id) } else { effect.id.clone() };
    match parent {
        Some(parent) => drop(compiled(&extended, &parent.plus(&name))?),
        None => try_on_any(&extended, &effect, &name)?,
    }
    Ok(effect)
}

/// An effect is at home in any model that has the states it names; without one it cannot be checked.
fn try_on_any(catalogue: &Catalogue, effect: &EffectSpec, name: &str) -> Result<(), Vec<Fault>> {
    let mut first = None;
    for document in catalogue.models() {
        let ModelDocument::Spec(spec) = document else {
            continue;
        };
        if !effect.terms.keys().all(|state| spec.states.contains_key(state)) {
            continue;
        }
        let Ok(id) = spec.id.parse::<ModelId>() else {
            continue;
        };
        match compiled(catalogue, &id.plus(name)) {
            Ok(_) => return Ok(()),
            Err(faults) => first = first.or(Some(faults)),
        }
    }
    Err(first.unwrap_or_else(|| {
        let states: Vec<&str> = effect.terms.keys().map(String::as_str).collect();
        vec![Fault::new("/terms", "unknown-state", format!("no model has the states {}", states.join(", ")))]
    }))
}

/// Takes an effect document of a user.
///
/// # Errors
/// Its faults, another document with the same id, or where the database fails.
pub async fn create_effect(service: &Service, body: Value, key: Option<&RequestKey>) -> Result<Taken<EffectSpec>, JobsError> {
    let catalogue = service.catalogue.current();
    let reading = catalogue.clone();
    let effect = blocking(move || check_effect(&reading, None, body)).await?.map_err(JobsError::Faults)?;
    let stored = models::effects(&service.store).await?.iter().any(|known| known.id == effect.id);
    if let Some(builtin) = catalogue.effects().find(|known| known.id == effect.id).filter(|_| !stored) {
        return same_or_conflict(builtin == &effect, "effect", &effect.id).map(|()| Taken { thing: effect, is_new: false });
    }
    let is_new = settled(models::insert_effect(&service.store, &effect, key, now()).await?, "effect", &effect.id)?;
    service.catalogue.change(|catalogue| catalogue.add_effect(effect.clone()));
    Ok(Taken { thing: effect, is_new })
}

/// Makes a model from another one by adding an effect, by name (`{"effect": "wind_infiltration"}`) or as a whole document.
///
/// # Errors
/// Its faults, another document with the same id, or where the database fails.
pub async fn add_effect(service: &Service, parent: &ModelId, body: Value, key: Option<&RequestKey>) -> Result<Taken<Value>, JobsError> {
    let catalogue = service.catalogue.current();
    if let Err(faults) = catalogue.compose(parent) {
        return Err(if faults.iter().all(|fault| fault.code == "unknown-model") {
            JobsError::NotFound("model", parent.to_string())
        } else {
            JobsError::Faults(faults)
        });
    }
    let base = parent.clone();
    let made = blocking(move || make_version(&catalogue, &base, body)).await?.map_err(JobsError::Faults)?;
    let (version, effect) = made;
    if let Some(effect) = &effect
        && let Some(known) = service.catalogue.current().effects().find(|known| known.id == effect.id)
    {
        same_or_conflict(known == effect, "effect", &effect.id)?;
    }
    let kept = models::insert_version(&service.store, &version, effect.as_ref(), key).await?;
    let is_new = settled(kept, "model", &version.id.to_string())?;
    if let Some(effect) = effect {
        service.catalogue.change(|catalogue| catalogue.add_effect(effect.clone()));
    }
    Ok(Taken { thing: version.document, is_new })
}

/// The new version, and its effect where that came as a document.
fn make_version(catalogue: &Catalogue, parent: &ModelId, body: Value) -> Result<(VersionRecord, Option<EffectSpec>), Vec<Fault>> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct ByName {
        effect: String,
    }
    let (name, own) = if body.get("effect").is_some() {
        (decode::decode::<ByName>(body)?.effect, None)
    } else {
        let effect = check_effect(catalogue, Some(parent), body)?;
        if let Some(word) = &effect.argument {
            let detail = format!("`{}` needs a {word}: post it to /effects, then add it here by name", effect.id);
            return Err(vec![Fault::new("/argument", "argument-missing", detail)]);
        }
        (effect.id.clone(), Some(effect))
    };
    let mut extended = catalogue.clone();
    own.iter().for_each(|effect| extended.add_effect(effect.clone()));
    let at_effect = |fault: Fault| {
        if own.is_none() && fault.pointer == "/model" { Fault { pointer: "/effect".into(), ..fault } } else { fault }
    };
    let spec = extended.effect(&name).map_err(|fault| vec![at_effect(fault)])?;
    let id = parent.plus(&name);
    if id == *parent {
        return Err(vec![Fault::new("/effect", "already-there", format!("`{parent}` has the effect `{name}` already"))]);
    }
    let model = compiled(&extended, &id).map_err(|faults| faults.into_iter().map(at_effect).collect::<Vec<_>>())?;
    let mut document = json!({
        "id": id,
        "parent": parent,
        "diff": {
            "effect": name,
            "title": spec.title,
            "inputs": spec.inputs,
            "parameters": spec.parameters,
            "terms": spec.terms,
            "outputs": spec.outputs,
        },
        "hash": model.hash(),
    });
    if !spec.define.is_empty() {
        document["diff"]["define"] = json!(spec.define);
    }
    Ok((VersionRecord { id, parent: parent.clone(), effect: name, document, created_at: now() }, own))
}

fn same_or_conflict(same: bool, what: &'static str, id: &str) -> Result<(), JobsError> {
    if same { Ok(()) } else { Err(JobsError::Conflict(what, id.to_owned())) }
}

/// Whether a document that was kept is new.
fn settled(kept: Kept, what: &'static str, id: &str) -> Result<bool, JobsError> {
    match kept {
        Kept::New => Ok(true),
        Kept::Known => Ok(false),
        Kept::Conflict => Err(JobsError::Conflict(what, id.to_owned())),
        Kept::KeyReused => Err(JobsError::KeyReused),
    }
}
