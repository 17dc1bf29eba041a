//! What a fit is judged beside: what was trusted before, what others measure, and what a system demands.

use crate::data::{Duration, Window};
use crate::estimate::fit::Fit;
use crate::estimate::fit::incumbent::Incumbent;
use crate::estimate::problem::Problem;
use crate::model::waivers::Waivers;

/// Parameters of the same system that were trusted at another time.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// What they are to an operator: `the parameters served 30 days ago`.
    pub name: String,
    /// The fit that found them.
    pub fit: Fit,
}

/// The outdoor temperature of another system in the same place.
#[derive(Debug, Clone, PartialEq)]
pub struct NextDoor {
    /// Whose it is: `room/3`.
    pub name: String,
    /// A window with the channel `T_out`.
    pub weather: Window,
}

/// What a fit is judged beside: what is served, what was, and what others measure.
#[derive(Debug, Clone, Default)]
pub struct Past {
    /// The parameters that are served now.
    pub incumbent: Option<Incumbent>,
    /// Older parameters, so that many small steps away from them are seen.
    pub references: Vec<Reference>,
    /// Since when newer measurements contradict the incumbent, in milliseconds, where they do.
    pub degraded: Option<i64>,
    /// The same model on the days right before those that the fit has seen, where there are any
    /// ([`crate::estimate::problem::request::days_before`]).
    pub days_before: Option<Problem>,
    /// The weather of the neighbours that measure it themselves.
    pub next_door: Vec<NextDoor>,
}

impl Past {
    /// A past of which only the incumbent is known.
    pub fn of(incumbent: Option<Incumbent>) -> Self {
        Self { incumbent, ..Self::default() }
    }
}

/// What a system demands of its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct GatePolicy {
    /// The forecast horizon that the controller lives on.
    pub horizon: Duration,
    /// Stretches of time, both ends included, that an operator has taken out: they are not missing.
    pub excluded: Vec<(i64, i64)>,
    /// Rules that do not hold for it, beside those of its model.
    pub waived: Waivers,
}

impl Default for GatePolicy {
    fn default() -> Self {
        Self { horizon: Duration::from_hours(6), excluded: Vec::new(), waived: Waivers::new() }
    }
}
