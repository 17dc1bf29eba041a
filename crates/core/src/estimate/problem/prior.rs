//! What is known of the parameters before any data: their logarithms are normal about the nominal values.

use crate::model::{Parameter, Scale};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What is known about the parameters before any data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// Nothing but the bounds.
    #[default]
    None,
    /// ln(theta) is normal about the nominal value with deviation 1: the regularisation that the thesis asks
    /// for in 7.6.2.
    LogNormal,
}

impl Prior {
    /// The deviation of a logarithm, where one is known.
    pub fn deviation(self) -> Option<f64> {
        match self {
            Prior::None => None,
            Prior::LogNormal => Some(1.0),
        }
    }
}

/// How many deviations the logarithm of a parameter lies from that of its nominal value; `None` of a
/// parameter on a linear scale, of which no prior is known.
pub fn pull(parameter: &Parameter, value: f64, nominal: f64, deviation: f64) -> Option<f64> {
    let pulled = parameter.scale == Scale::Log && value > 0.0 && nominal > 0.0;
    pulled.then(|| (value / nominal).ln() / deviation)
}
