//! The chances of a synthetic world, all from one seed.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// A seeded stream of numbers.
pub(super) struct Dice(Xoshiro256PlusPlus);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    pub fn uniform(&mut self) -> f64 {
        self.0.random::<f64>()
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (2.0 * std::f64::consts::PI * self.uniform()).cos()
    }

    /// A stationary first-order process with the given deviation and memory.
    pub fn wander(&mut self, n: usize, deviation: f64, memory_steps: f64) -> Vec<f64> {
        let keep = (-1.0 / memory_steps).exp();
        let mut value = deviation * self.normal();
        (0..n)
            .map(|_| {
                value = keep * value + deviation * (1.0 - keep * keep).sqrt() * self.normal();
                value
            })
            .collect()
    }
}
