//! What is known of the parameters before any data: where they lie, and how far from there they may be.

use crate::model::{Parameter, Scale};
use indexmap::IndexMap;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

/// What is known about the parameters before any data.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// Nothing but the bounds.
    #[default]
    None,
    /// ln(theta) is normal about the nominal value with deviation 1: the regularisation that the thesis asks
    /// for in 7.6.2.
    LogNormal,
    /// What the other systems of the building have, those of the same kind and model; nothing where they are
    /// too few.
    Siblings,
    /// What is written down, or was learnt from others.
    Known(KnownPrior),
}

/// What is known of some parameters.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KnownPrior {
    /// The systems that it was learnt from.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub from: Vec<String>,
    /// The parameters by name; nothing is known of the others.
    pub parameters: IndexMap<String, KnownParameter>,
}

/// Where a parameter is taken to lie: normally distributed, or its logarithm where it is searched on a
/// logarithmic scale.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KnownParameter {
    /// The middle, in its unit.
    pub value: f64,
    /// The standard deviation: in its unit, or of the logarithm on a logarithmic scale (0.3 is about 30 %).
    #[serde(deserialize_with = "deviation")]
    #[schema(exclusive_minimum = 0)]
    pub deviation: f64,
}

/// A deviation, which is more than nothing.
fn deviation<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(deserializer)?;
    let serves = value.is_finite() && value > 0.0;
    serves.then_some(value).ok_or_else(|| D::Error::custom(format!("a deviation is above 0, not {value}")))
}

impl Prior {
    /// Where a parameter with this nominal value is taken to lie; `None` where nothing is known of it.
    pub fn of(&self, parameter: &Parameter, nominal: f64) -> Option<KnownParameter> {
        match self {
            Prior::None | Prior::Siblings => None,
            Prior::LogNormal => {
                let is_log = parameter.scale == Scale::Log && nominal > 0.0;
                is_log.then_some(KnownParameter { value: nominal, deviation: 1.0 })
            }
            Prior::Known(known) => known.parameters.get(&parameter.name).copied(),
        }
    }

    /// Whom a fit has learnt from, in a sentence.
    pub fn remark(&self) -> Option<String> {
        let Prior::Known(KnownPrior { from, parameters }) = self else { return None };
        (!from.is_empty()).then(|| {
            format!(
                "{} parameters are drawn to what {} other systems of the building have, as far as these data \
                 leave them open",
                parameters.len(),
                from.len()
            )
        })
    }

    /// The parameters that are written down, or were learnt from others.
    pub fn parameters(&self) -> impl Iterator<Item = (&String, &KnownParameter)> {
        let known = if let Prior::Known(known) = self { Some(&known.parameters) } else { None };
        known.into_iter().flatten()
    }
}

impl KnownParameter {
    /// How many deviations a value of a parameter lies from the middle. `None` of a value that has no
    /// logarithm where one is needed.
    pub fn pull(&self, parameter: &Parameter, value: f64) -> Option<f64> {
        match parameter.scale {
            Scale::Log => (value > 0.0).then(|| (value / self.value).ln() / self.deviation),
            Scale::Linear => Some((value - self.value) / self.deviation),
        }
    }
}
