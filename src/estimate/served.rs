//! What the controller gets: only an accepted verdict can make it.

use super::fit::{AheadError, Fit};
use super::validate::Acceptance;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A validated parameter set, without the names and times that a store adds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServedParameters {
    model: String,
    parameters: IndexMap<String, f64>,
    units: IndexMap<String, String>,
    ci95: IndexMap<String, Option<[f64; 2]>>,
    flags: Vec<String>,
    error: IndexMap<String, ServedError>,
}

/// The errors of one output, as served.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ServedError {
    /// Unit of the errors.
    pub unit: String,
    /// Free run over the training part.
    pub train_rmse: f64,
    /// Free run over the validation part.
    pub validation_rmse: Option<f64>,
    /// Forecast errors by horizon.
    pub ahead: IndexMap<String, f64>,
}

impl ServedParameters {
    /// The parameters of a fit that the gate has accepted. There is no other way to make them.
    pub fn new(acceptance: &Acceptance, fit: &Fit) -> Self {
        let ahead = |errors: &IndexMap<String, AheadError>| errors.iter().map(|(horizon, error)| (horizon.clone(), error.rmse)).collect();
        Self {
            model: fit.model.clone(),
            parameters: fit.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.value)).collect(),
            units: fit.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.unit.clone())).collect(),
            ci95: fit.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.ci95)).collect(),
            flags: acceptance.flags().to_vec(),
            error: fit
                .metrics
                .iter()
                .map(|(channel, metrics)| {
                    let error = ServedError {
                        unit: metrics.unit.clone(),
                        train_rmse: metrics.train_rmse,
                        validation_rmse: metrics.validation_rmse,
                        ahead: ahead(&metrics.ahead),
                    };
                    (channel.clone(), error)
                })
                .collect(),
        }
    }

    /// The model's readable identity.
    pub fn model(&self) -> &str {
        &self.model
    }

    /// Values by name.
    pub fn parameters(&self) -> &IndexMap<String, f64> {
        &self.parameters
    }
}
