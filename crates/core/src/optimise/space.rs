//! The only bridge between the unit cube of the search and the physical parameters of a model.

use serde::{Deserialize, Serialize};

/// A point of the unit cube, as the optimisers see it.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate(pub Vec<f64>);

/// A point in physical units, as the model sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Theta(pub Vec<f64>);

/// How a coordinate of the cube spreads over its interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DimensionScale {
    /// Evenly.
    Linear,
    /// Evenly in the logarithm: each decade gets the same share.
    Log,
}

/// One free parameter: its interval and scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Dimension {
    /// The parameter's name, for reports.
    pub name: String,
    /// Lower bound, in the parameter's unit; positive on a log scale.
    pub lower: f64,
    /// Upper bound, above the lower one.
    pub upper: f64,
    /// Linear or logarithmic.
    pub scale: DimensionScale,
}

impl Dimension {
    /// The physical value at `unit` in \[0, 1\].
    pub fn value(&self, unit: f64) -> f64 {
        let value = match self.scale {
            DimensionScale::Linear => self.lower + unit * (self.upper - self.lower),
            DimensionScale::Log => (self.lower.ln() + unit * (self.upper.ln() - self.lower.ln())).exp(),
        };
        // The exponential may round past the bound by one bit; a bound is a promise.
        value.clamp(self.lower, self.upper)
    }

    /// The length of the interval on its scale: in the parameter's unit, or in logarithms.
    pub fn length(&self) -> f64 {
        match self.scale {
            DimensionScale::Linear => self.upper - self.lower,
            DimensionScale::Log => (self.upper / self.lower).ln(),
        }
    }

    /// By how much the physical value grows with the coordinate, where it is `value`.
    pub fn slope(&self, value: f64) -> f64 {
        match self.scale {
            DimensionScale::Linear => self.length(),
            DimensionScale::Log => value * self.length(),
        }
    }

    /// The coordinate of a physical value, clamped into the cube.
    pub fn unit(&self, value: f64) -> f64 {
        let value = value.clamp(self.lower, self.upper);
        let unit = match self.scale {
            DimensionScale::Linear => (value - self.lower) / (self.upper - self.lower),
            DimensionScale::Log => (value.ln() - self.lower.ln()) / (self.upper.ln() - self.lower.ln()),
        };
        unit.clamp(0.0, 1.0)
    }
}

/// The box of the free parameters, in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct Space {
    dimensions: Vec<Dimension>,
}

impl Space {
    /// A box from its dimensions.
    pub fn new(dimensions: Vec<Dimension>) -> Self {
        Self { dimensions }
    }

    /// The free parameters, in order.
    pub fn dimensions(&self) -> &[Dimension] {
        &self.dimensions
    }

    /// How many parameters are free.
    pub fn len(&self) -> usize {
        self.dimensions.len()
    }

    /// Whether nothing is free.
    pub fn is_empty(&self) -> bool {
        self.dimensions.is_empty()
    }

    /// The physical point of a candidate.
    pub fn theta(&self, candidate: &Candidate) -> Theta {
        Theta(
            self.dimensions
                .iter()
                .zip(&candidate.0)
                .map(|(dimension, unit)| dimension.value(*unit))
                .collect(),
        )
    }

    /// The candidate of a physical point; values outside the box are moved to its edge.
    pub fn candidate(&self, theta: &Theta) -> Candidate {
        Candidate(
            self.dimensions.iter().zip(&theta.0).map(|(dimension, value)| dimension.unit(*value)).collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bridge_goes_both_ways_and_keeps_to_the_bounds() {
        let space = Space::new(vec![
            Dimension { name: "a".into(), lower: 1e-3, upper: 15.0, scale: DimensionScale::Log },
            Dimension { name: "t".into(), lower: 10.0, upper: 40.0, scale: DimensionScale::Linear },
        ]);
        for unit in [0.0, 0.1, 0.5, 0.999, 1.0] {
            let theta = space.theta(&Candidate(vec![unit, unit]));
            assert!((1e-3..=15.0).contains(&theta.0[0]) && (10.0..=40.0).contains(&theta.0[1]));
            for back in space.candidate(&theta).0 {
                assert!((back - unit).abs() < 1e-12);
            }
        }
        assert_eq!(space.candidate(&Theta(vec![99.0, -5.0])).0, vec![1.0, 0.0]);
    }
}
