//! What is run, what came of it, and where the time went.

use super::arm::{Kind, Measures};
use super::service::Added;
use serde::Serialize;
use std::time::Duration;

/// Days under a thermostat before the first day under control.
pub const BEFORE_DAYS: usize = 21;

/// What is run.
#[derive(Debug, Clone)]
pub struct Plan {
    pub seed: u64,
    pub houses: usize,
    pub weeks: usize,
    pub arms: Vec<Kind>,
}

impl Plan {
    /// All arms in so many houses.
    pub fn new(seed: u64, houses: usize, weeks: usize) -> Self {
        Self { seed, houses, weeks, arms: Kind::ALL.to_vec() }
    }

    pub fn days(&self) -> usize {
        7 * self.weeks
    }

    /// The first day under control with wind in the house.
    pub fn leaks_from(&self) -> usize {
        self.days() / 2
    }
}

/// What an arm came to in one house.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    pub kind: Kind,
    /// One for every day under control.
    pub days: Vec<Measures>,
    pub effects: Vec<Added>,
    /// How its estimates ended.
    pub fits: Vec<String>,
}

/// What every arm came to in every house, and how long it took.
#[derive(Debug)]
pub struct Measured {
    pub plan: Plan,
    /// By house, in the order of the plan's arms.
    pub houses: Vec<Vec<Outcome>>,
    pub spent: Spent,
}

/// Where the time went.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Spent {
    pub seconds: f64,
    /// In the rooms and their controllers.
    pub control_seconds: f64,
    /// Waiting for estimates, and for diagnoses and the estimates that they ask for.
    pub estimate_seconds: f64,
    pub diagnosis_seconds: f64,
    pub estimates: usize,
    pub diagnoses: usize,
}

/// Seconds for people.
pub fn shown(seconds: f64) -> String {
    let whole = Duration::from_secs_f64(seconds.max(0.0)).as_secs();
    if whole < 120 { format!("{seconds:.0} s") } else { format!("{} min {} s", whole / 60, whole % 60) }
}
