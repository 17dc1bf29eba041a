//! The coefficients of a synthetic room, one of which may be another one from a day on.

use super::climate::NEIGHBOURS;
use super::dice::Dice;
use crate::fault::Fault;

/// A parameter of a world that changes once.
#[derive(Debug, Clone, PartialEq)]
pub struct ChangedParameter {
    /// Its name in the base model.
    pub parameter: String,
    /// The day of the window with whose beginning it changes.
    pub day: usize,
    /// What it is multiplied by.
    pub factor: f64,
}

/// In 1/h, capacities as ratios to that of the room air.
#[derive(Clone)]
pub(super) struct Rates {
    pub h: f64,
    pub e: f64,
    pub w: f64,
    pub a: f64,
    pub s: f64,
    pub n: [f64; NEIGHBOURS],
    pub floor: f64,
    pub envelope: f64,
    pub k: f64,
    pub t_set: f64,
    pub furniture: (f64, f64),
    pub wall: (f64, f64),
}

impl Rates {
    /// Draws those of a room.
    pub fn new(dice: &mut Dice) -> Self {
        Self {
            h: dice.log_between(0.1, 1.0),
            e: dice.log_between(0.1, 1.5),
            w: dice.log_between(0.3, 2.0),
            a: dice.log_between(0.01, 0.2),
            s: dice.log_between(0.1, 1.5),
            n: std::array::from_fn(|_| dice.log_between(0.01, 0.2)),
            floor: dice.log_between(2.0, 15.0),
            envelope: dice.log_between(3.0, 20.0),
            k: dice.between(1.0, 6.0),
            t_set: dice.between(20.0, 22.5),
            furniture: (dice.log_between(0.2, 1.0), dice.log_between(0.5, 3.0)),
            wall: (dice.log_between(0.02, 0.2), dice.log_between(0.5, 3.0)),
        }
    }

    /// What they are when one has changed.
    ///
    /// # Errors
    /// A fault of a parameter that no twin can change.
    pub fn changed(&self, change: &ChangedParameter) -> Result<Self, Fault> {
        let mut later = self.clone();
        let value = match change.parameter.as_str() {
            "alpha_h" => &mut later.h,
            "alpha_e" => &mut later.e,
            "alpha_w" => &mut later.w,
            "alpha_a" => &mut later.a,
            "alpha_s" => &mut later.s,
            other => {
                let detail = format!("no twin can change `{other}` on a day");
                return Err(Fault::new("/change", "unknown-parameter", detail));
            }
        };
        *value *= change.factor;
        Ok(later)
    }

    /// By the names of the base model.
    pub fn parameters(&self) -> Vec<(String, f64)> {
        let named = [
            ("alpha_h", self.h),
            ("alpha_e", self.e),
            ("alpha_w", self.w),
            ("alpha_a", self.a),
            ("alpha_s", self.s),
            ("beta_h", self.floor),
            ("beta_he", self.envelope),
            ("k", self.k),
            ("T_set", self.t_set),
        ];
        let neighbours = self.n.iter().zip(1..).map(|(n, number)| (format!("alpha_n[{number}]"), *n));
        named.into_iter().map(|(name, value)| (name.to_owned(), value)).chain(neighbours).collect()
    }
}
