//! From which states a model predicts, and what that makes of its errors.

use crate::model::{Model, Stepper};

/// From which states a model predicts. Everything that depends on it asks here, or matches both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Predictor {
    /// From states that a Kalman filter re-estimates with every measurement: forecasts begin at any sample,
    /// innovations have a likelihood, and a record can be cut into segments.
    Filtered,
    /// From those to which the model has come by itself since the first sample: the free run of a large model
    /// that is stepped explicitly. A covariance of a hundred states costs more than a thousand simulations.
    FreeRun,
}

impl Predictor {
    /// That of a model.
    pub fn of(model: &Model) -> Self {
        match model.stepper() {
            Stepper::Ros2 | Stepper::Rk4 => Self::Filtered,
            Stepper::Rkc => Self::FreeRun,
        }
    }

    /// What is wrong with asking for something that needs a filter; `None` where there is one.
    pub fn lacks_filter_for(self, what: &str) -> Option<String> {
        match self {
            Self::Filtered => None,
            Self::FreeRun => {
                Some(format!("{what} needs a filter, and a model that is stepped by rkc has none"))
            }
        }
    }

    /// What it predicts by, with the verb that a sentence goes on from.
    pub fn subject(self) -> &'static str {
        match self {
            Self::Filtered => "the forecasts are",
            Self::FreeRun => "the free run is",
        }
    }

    /// What the errors are called that are compared at a horizon.
    pub fn error_at(self, horizon: &str) -> String {
        match self {
            Self::Filtered => format!("the error {horizon} ahead"),
            Self::FreeRun => "the error of the free run".to_owned(),
        }
    }

    /// What a reader of a fit has to know of its errors.
    pub fn remark(self) -> Option<String> {
        match self {
            Self::Filtered => None,
            Self::FreeRun => Some(
                "the model is stepped explicitly and has no filter: errors are those of free runs, none is \
                of a forecast"
                    .to_owned(),
            ),
        }
    }
}
