//! The documents of models: a whole model, a composition, or a plant that becomes one.

use super::plant::PlantSpec;
use super::spec::{CompositionSpec, ModelSpec, from_toml};
use crate::fault::Fault;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A document of `config/models` or of a request: a spec or a composition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum ModelDocument {
    /// A base with effects.
    Composition(CompositionSpec),
    /// A treatment plant, which becomes a whole model where it is put together.
    Plant(Box<PlantSpec>),
    /// A whole model. Boxed, because it is much larger.
    Spec(Box<ModelSpec>),
}

impl ModelDocument {
    /// The name by which jobs ask for it.
    pub fn id(&self) -> &str {
        match self {
            ModelDocument::Composition(composition) => &composition.id,
            ModelDocument::Plant(plant) => &plant.id,
            ModelDocument::Spec(spec) => &spec.id,
        }
    }

    /// The title for people.
    pub fn title(&self) -> &str {
        match self {
            ModelDocument::Composition(composition) => &composition.title,
            ModelDocument::Plant(plant) => &plant.title,
            ModelDocument::Spec(spec) => &spec.title,
        }
    }

    /// Whether a document with these fields is one of a plant.
    pub fn is_plant(has: impl Fn(&str) -> bool) -> bool {
        has("reactions") || has("tanks")
    }

    /// Reads a model document in TOML. A composition is known by its `base`, a plant by its `reactions` or
    /// `tanks`.
    ///
    /// # Errors
    /// One fault with the place where the document stops making sense.
    pub fn from_toml(text: &str) -> Result<Self, Fault> {
        let table: toml::Table = from_toml(text)?;
        if table.contains_key("base") {
            Ok(ModelDocument::Composition(from_toml(text)?))
        } else if Self::is_plant(|name| table.contains_key(name)) {
            Ok(ModelDocument::Plant(Box::new(from_toml(text)?)))
        } else {
            Ok(ModelDocument::Spec(Box::new(from_toml(text)?)))
        }
    }

    /// Reads a model document in JSON. A composition is known by its `base`, a plant by its `reactions` or
    /// `tanks`.
    ///
    /// # Errors
    /// One fault with the place where the document stops making sense.
    pub fn from_json(value: &serde_json::Value) -> Result<Self, Fault> {
        let wrong = |error: serde_json::Error| Fault::new("", "invalid-document", error.to_string());
        if value.get("base").is_some() {
            Ok(ModelDocument::Composition(serde_json::from_value(value.clone()).map_err(wrong)?))
        } else if Self::is_plant(|name| value.get(name).is_some()) {
            Ok(ModelDocument::Plant(Box::new(serde_json::from_value(value.clone()).map_err(wrong)?)))
        } else {
            Ok(ModelDocument::Spec(Box::new(serde_json::from_value(value.clone()).map_err(wrong)?)))
        }
    }
}
