//! What is known of the parameters before any data: their logarithms are normal about the nominal values.

use super::Problem;
use crate::model::Scale;
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

impl Problem {
    /// How many of its deviations the logarithm of a parameter lies from that of the nominal value; `None` of
    /// a parameter on a linear scale, of which no prior is known.
    pub fn pull(&self, index: usize, theta: &[f64], deviation: f64) -> Option<f64> {
        let parameter = self.model.parameters().get(index)?;
        let (value, nominal) = (theta[index], self.nominal[index]);
        let pulled = parameter.scale == Scale::Log && value > 0.0 && nominal > 0.0;
        pulled.then(|| (value / nominal).ln() / deviation)
    }

    /// The pulls of all free parameters.
    pub fn pulls(&self, theta: &[f64], deviation: f64) -> impl Iterator<Item = f64> {
        self.free.iter().filter_map(move |index| self.pull(*index, theta, deviation))
    }
}
