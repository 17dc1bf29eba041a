//! What the controller gets: only an accepted verdict can make it, or a held one with an operator's word.

use super::validate::{Acceptance, Holding};
use crate::estimate::fit::{AheadError, Fit};
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
        Self::with_flags(acceptance.flags().to_vec(), fit)
    }

    fn with_flags(flags: Vec<String>, fit: &Fit) -> Self {
        let ahead = |errors: &IndexMap<String, AheadError>| {
            errors.iter().map(|(horizon, error)| (horizon.clone(), error.rmse)).collect()
        };
        Self {
            model: fit.model.clone(),
            parameters: fit
                .parameters
                .iter()
                .map(|(name, estimate)| (name.clone(), estimate.value))
                .collect(),
            units: fit
                .parameters
                .iter()
                .map(|(name, estimate)| (name.clone(), estimate.unit.clone()))
                .collect(),
            ci95: fit.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.ci95)).collect(),
            flags,
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

/// The flag of a held fit that an operator has let out.
const PROMOTED: &str = "promoted_by_operator";

/// A parameter set that waits for an operator: it cannot be served as it is.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Offer(ServedParameters);

impl Offer {
    /// The parameters of a fit that the gate has accepted and the policy of its system has not published.
    pub fn of_accepted(acceptance: &Acceptance, fit: &Fit) -> Self {
        Self(ServedParameters::new(acceptance, fit))
    }

    /// The parameters of a fit that the gate holds. The controller is told that the gate had a doubt.
    pub fn of_held(holding: &Holding, fit: &Fit) -> Self {
        let flags = holding.flags().iter().cloned().chain([PROMOTED.to_owned()]).collect();
        Self(ServedParameters::with_flags(flags, fit))
    }
}
