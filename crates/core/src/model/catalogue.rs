//! The built-in models and effects, and the composition of a [`ModelId`] from them.

use super::document::ModelDocument;
use super::id::{ModelId, family_and_argument};
use super::plant::PlantSpec;
use super::process::ReactionsSpec;
use super::spec::{Definition, EffectSpec, ModelSpec, StateSpec, Variant};
use crate::fault::{Fault, nearest};
use std::collections::BTreeMap;

#[derive(rust_embed::RustEmbed)]
#[folder = "../../config/models"]
struct ModelFiles;

#[derive(rust_embed::RustEmbed)]
#[folder = "../../config/plants"]
struct PlantFiles;

#[derive(rust_embed::RustEmbed)]
#[folder = "../../config/effects"]
struct EffectFiles;

/// Known models and effects, by name.
#[derive(Debug, Clone, Default)]
pub struct Catalogue {
    models: BTreeMap<String, ModelDocument>,
    effects: BTreeMap<String, EffectSpec>,
    reactions: BTreeMap<String, ReactionsSpec>,
}

/// An effect as part of a composition, with its argument filled in.
#[derive(Debug, Clone)]
pub struct AppliedEffect {
    /// The id with its argument, `metered_gain:P_heater`.
    pub id: String,
    /// The document, with `{channel}` replaced.
    pub spec: EffectSpec,
    /// Whether it is dropped where its inputs are absent (a part of a composition) or a fault (asked for).
    pub optional: bool,
}

/// A whole model and its effects, ready to compile.
#[derive(Debug, Clone)]
pub struct Composition {
    /// The id that was asked for.
    pub id: ModelId,
    /// The base.
    pub spec: ModelSpec,
    /// The effects, sorted by id.
    pub effects: Vec<AppliedEffect>,
}

impl Catalogue {
    /// The models, plants and effects that come with the program.
    ///
    /// # Errors
    /// Every built-in document that cannot be read; a test keeps this from happening.
    pub fn builtin() -> Result<Self, Vec<Fault>> {
        let mut catalogue = Self::default();
        let mut reactions = BTreeMap::new();
        let mut faults = Vec::new();
        let text = |file: rust_embed::EmbeddedFile| String::from_utf8_lossy(&file.data).into_owned();
        for (name, file) in
            ModelFiles::iter().filter_map(|name| ModelFiles::get(&name).map(|file| (name, file)))
        {
            let text = text(file);
            let read = if ReactionsSpec::is_one(&text) {
                ReactionsSpec::from_toml(&text).map(|found| drop(reactions.insert(found.id.clone(), found)))
            } else {
                ModelDocument::from_toml(&text).map(|document| catalogue.add_model(document))
            };
            faults.extend(
                read.err()
                    .map(|fault| Fault { pointer: format!("models/{name} {}", fault.pointer), ..fault }),
            );
        }
        for (name, file) in
            PlantFiles::iter().filter_map(|name| PlantFiles::get(&name).map(|file| (name, file)))
        {
            let plant = PlantSpec::from_toml(&text(file)).map_err(|fault| vec![fault]);
            match plant.and_then(|plant| plant.expand(&reactions)) {
                Ok(spec) => catalogue.add_model(ModelDocument::Spec(Box::new(spec))),
                Err(more) => faults.extend(
                    more.into_iter()
                        .map(|fault| Fault { pointer: format!("plants/{name} {}", fault.pointer), ..fault }),
                ),
            }
        }
        for (name, file) in
            EffectFiles::iter().filter_map(|name| EffectFiles::get(&name).map(|file| (name, file)))
        {
            match EffectSpec::from_toml(&text(file)) {
                Ok(effect) => catalogue.add_effect(effect),
                Err(fault) => {
                    faults.push(Fault { pointer: format!("effects/{name} {}", fault.pointer), ..fault })
                }
            }
        }
        catalogue.reactions = reactions;
        if faults.is_empty() { Ok(catalogue) } else { Err(faults) }
    }

    /// Adds or replaces a model.
    pub fn add_model(&mut self, document: ModelDocument) {
        self.models.insert(document.id().to_owned(), document);
    }

    /// Adds or replaces an effect.
    pub fn add_effect(&mut self, effect: EffectSpec) {
        self.effects.insert(effect.id.clone(), effect);
    }

    /// The same without some effects.
    #[must_use]
    pub fn without(&self, effects: &[String]) -> Self {
        let mut fewer = self.clone();
        fewer.effects.retain(|id, _| !effects.contains(id));
        fewer
    }

    /// All models, by name.
    pub fn models(&self) -> impl Iterator<Item = &ModelDocument> {
        self.models.values()
    }

    /// All effects, by name.
    pub fn effects(&self) -> impl Iterator<Item = &EffectSpec> {
        self.effects.values()
    }

    /// The document of an effect by its id, as it stands.
    pub fn effect_document(&self, id: &str) -> Option<&EffectSpec> {
        self.effects.get(id)
    }

    /// A model document by name.
    pub fn model(&self, name: &str) -> Option<&ModelDocument> {
        self.models.get(name)
    }

    /// The whole model that a plant's document stands for; nothing for other documents.
    pub fn expanded(&self, document: &ModelDocument) -> Option<ModelSpec> {
        match document {
            ModelDocument::Plant(plant) => plant.expand(&self.reactions).ok(),
            ModelDocument::Spec(_) | ModelDocument::Composition(_) => None,
        }
    }

    /// Puts the model of an id together.
    ///
    /// # Errors
    /// Every model, effect or argument in the id that does not exist.
    pub fn compose(&self, id: &ModelId) -> Result<Composition, Vec<Fault>> {
        let mut faults = Vec::new();
        let mut names: Vec<(String, bool)> = Vec::new();
        let mut base = id.base().to_owned();
        // A composition may stand on another one; a ring of them ends at the limit.
        let mut spec = None;
        for _ in 0..8 {
            match self.models.get(&base) {
                Some(ModelDocument::Composition(composition)) => {
                    names.extend(composition.effects.iter().map(|effect| (effect.clone(), true)));
                    base.clone_from(&composition.base);
                }
                Some(ModelDocument::Spec(found)) => {
                    spec = Some((**found).clone());
                    break;
                }
                Some(ModelDocument::Plant(plant)) => {
                    spec = Some(plant.expand(&self.reactions)?);
                    break;
                }
                None => break,
            }
        }
        let Some(spec) = spec else {
            let fault = Fault::new("/model", "unknown-model", format!("there is no model `{base}`"));
            return Err(vec![match nearest(&base, self.models.keys().map(String::as_str)) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault,
            }]);
        };
        for effect in id.without() {
            if names.iter().any(|(name, _)| name == effect) {
                names.retain(|(name, _)| name != effect);
            } else {
                faults.push(Fault::new(
                    "/model",
                    "not-part-of-model",
                    format!("`{}` has no effect `{effect}` to leave out", id.base()),
                ));
            }
        }
        for effect in id.with() {
            names.retain(|(name, _)| name != effect);
            names.push((effect.clone(), false));
        }
        names.sort();
        names.dedup();
        let mut effects = Vec::new();
        for (name, optional) in names {
            match self.effect(&name) {
                Ok(spec) => effects.push(AppliedEffect { id: name, spec, optional }),
                Err(fault) => faults.push(fault),
            }
        }
        if faults.is_empty() { Ok(Composition { id: id.clone(), spec, effects }) } else { Err(faults) }
    }

    /// The document of an effect with its argument filled in.
    ///
    /// # Errors
    /// A fault where the effect does not exist, or its argument is missing or superfluous.
    pub fn effect(&self, name: &str) -> Result<EffectSpec, Fault> {
        let (id, argument) = family_and_argument(name);
        let Some(spec) = self.effects.get(id) else {
            let fault = Fault::new("/model", "unknown-effect", format!("there is no effect `{id}`"));
            return Err(match nearest(id, self.effects.keys().map(String::as_str)) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault,
            });
        };
        match (&spec.argument, argument) {
            (None, None) => Ok(spec.clone()),
            (Some(word), Some(value)) if spec.choices.is_empty() => {
                Ok(fill(spec, &[(word.clone(), value.to_owned())]))
            }
            (Some(word), Some(value)) => match spec.choices.get(value) {
                Some(constants) => {
                    let constants =
                        constants.iter().map(|(name, constant)| (name.clone(), constant.to_string()));
                    Ok(fill(
                        spec,
                        &std::iter::once((word.clone(), value.to_owned()))
                            .chain(constants)
                            .collect::<Vec<_>>(),
                    ))
                }
                None => {
                    Err(Fault::new("/model", "unknown-choice", format!("`{id}` has no {word} `{value}`"))
                        .suggest(choices(spec)))
                }
            },
            (Some(word), None) => {
                let hint =
                    if spec.choices.is_empty() { format!("write `{id}:<{word}>`") } else { choices(spec) };
                Err(Fault::new("/model", "argument-missing", format!("`{id}` needs a {word}")).suggest(hint))
            }
            (None, Some(_)) => {
                Err(Fault::new("/model", "argument-unexpected", format!("`{id}` takes no argument")))
            }
        }
    }
}

/// The members of an effect with choices, as a hint.
fn choices(spec: &EffectSpec) -> String {
    let all: Vec<String> = spec.choices.keys().map(|choice| format!("`{}:{choice}`", spec.id)).collect();
    format!("write one of {}", all.join(", "))
}

/// The document with every mark `{word}` replaced in its keys and texts.
fn fill(spec: &EffectSpec, words: &[(String, String)]) -> EffectSpec {
    let fill = |text: &str| {
        words.iter().fold(text.to_owned(), |text, (word, value)| text.replace(&format!("{{{word}}}"), value))
    };
    let definition = |definition: &Definition| match definition {
        Definition::Text(text) => Definition::Text(fill(text)),
        Definition::Variants(variants) => {
            let filled = |variant: &Variant| Variant {
                needs: variant.needs.iter().map(|need| fill(need)).collect(),
                expr: fill(&variant.expr),
                drops: variant.drops.as_deref().map(fill),
            };
            Definition::Variants(variants.iter().map(filled).collect())
        }
    };
    let mut filled = spec.clone();
    for text in [&mut filled.title, &mut filled.explain, &mut filled.signature, &mut filled.measure] {
        *text = fill(text);
    }
    let member = words.first().map_or("", |(_, value)| value);
    filled.way_of = spec.way_of.as_ref().map(|of| format!("{of}:{member}"));
    filled.states = spec
        .states
        .iter()
        .map(|(key, state)| (fill(key), StateSpec { title: fill(&state.title), ..state.clone() }))
        .collect();
    filled.inputs = spec.inputs.iter().map(|(key, input)| (fill(key), input.clone())).collect();
    filled.parameters =
        spec.parameters.iter().map(|(key, parameter)| (fill(key), parameter.clone())).collect();
    for parameter in filled.parameters.values_mut() {
        parameter.title = fill(&parameter.title);
    }
    filled.define = spec.define.iter().map(|(key, text)| (fill(key), definition(text))).collect();
    filled.replace = spec.replace.iter().map(|(key, text)| (key.clone(), fill(text))).collect();
    filled.terms = spec.terms.iter().map(|(key, term)| (fill(key), fill(term))).collect();
    filled.outputs = spec.outputs.iter().map(|(key, term)| (key.clone(), fill(term))).collect();
    for input in filled.inputs.values_mut() {
        input.channel = input.channel.as_deref().map(fill);
    }
    filled
}
