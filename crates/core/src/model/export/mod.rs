//! A compiled model with its parameter values, written for other programs.
//!
//! ```text
//! Model + parameter values --names, listing (definitions and equations in one dialect)--> one document
//! ```
//!
//! Variants are chosen, sets are written out and effects are merged already, so that a reader needs neither
//! the language of the documents nor what was measured. Time is counted in hours; Modelica counts seconds.

mod casadi;
mod dialect;
#[cfg(test)]
mod export_tests;
mod json;
mod latex;
mod listing;
mod mathml;
mod modelica;
mod names;
mod python;
mod source;
mod typeset;

pub use json::{ExportedInput, ExportedModel, ExportedOutput, ExportedParameter, ExportedState};
pub use source::ExportSource;

use super::Model;
use serde::Deserialize;
use utoipa::ToSchema;

/// What a model is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum ExportFormat {
    /// A document with the equations as texts.
    #[default]
    Json,
    /// A Python module on numpy, with the stepper of the service.
    Python,
    /// A Python module that builds CasADi functions.
    Casadi,
    /// A Modelica class.
    Modelica,
    /// Equations for people.
    Latex,
    /// The same for a page.
    Mathml,
}

/// What equations are typeset with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum EquationFormat {
    /// LaTeX.
    #[default]
    Latex,
    /// MathML, which a browser shows by itself.
    Mathml,
}

impl ExportFormat {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Json, Self::Python, Self::Casadi, Self::Modelica, Self::Latex, Self::Mathml];

    /// Its name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Python => "python",
            Self::Casadi => "casadi",
            Self::Modelica => "modelica",
            Self::Latex => "latex",
            Self::Mathml => "mathml",
        }
    }
}

/// The model with a parameter vector, as a document.
pub fn document(model: &Model, theta: &[f64]) -> ExportedModel {
    json::document(model, theta)
}

/// The equations of a model without values, typeset.
pub fn equations(model: &Model, format: EquationFormat) -> String {
    match format {
        EquationFormat::Latex => latex::text(model),
        EquationFormat::Mathml => mathml::text(model),
    }
}

/// The model with a parameter vector, as the text of a program; as JSON where that is wanted.
pub fn text(model: &Model, theta: &[f64], source: &ExportSource, format: ExportFormat) -> String {
    match format {
        ExportFormat::Json => serde_json::to_string_pretty(&json::document(model, theta)).unwrap_or_default(),
        ExportFormat::Python => python::text(model, theta, source),
        ExportFormat::Casadi => casadi::text(model, theta, source),
        ExportFormat::Modelica => modelica::text(model, theta, source),
        ExportFormat::Latex => latex::text(model),
        ExportFormat::Mathml => mathml::text(model),
    }
}
