//! Where the measured states start: at the mean of their first measurements, until an estimate says better.

use super::Problem;
use crate::model::Initial;
use crate::simulate::trajectory::first_values;

/// The start of the states that one sensor measures, as the first measurements tell it.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredStart {
    /// The output of the model that measures it.
    pub output: usize,
    /// The mean of the first three measurements, in the unit of the output.
    pub mean: f64,
    /// How far from there the start may be, as a standard deviation: the noise of the sensor, its resolution,
    /// and how far those measurements lie apart, since the state moves meanwhile.
    pub deviation: f64,
}

impl Problem {
    /// What the first measurements tell of the starts that the training part begins at; nothing of a model
    /// that comes to its start through a warm-up.
    pub fn measured_starts(&self) -> Vec<MeasuredStart> {
        if self.model.warm_up().is_some() {
            return Vec::new();
        }
        let starts = |output: usize| {
            self.model.states().iter().any(|state| state.initial == Initial::Measured(output))
        };
        let start = |output: usize| {
            let (values, valid) = &self.measured[output];
            let first: Vec<f64> = first_values(values, valid, 0..values.len()).collect();
            let n = first.len() as f64;
            let mean = first.iter().sum::<f64>() / n;
            let spread = first.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
            let resolution = self.quanta().get(output).copied().flatten().unwrap_or(0.0);
            let noise = self.model.outputs()[output].noise_sd;
            let deviation = (noise.powi(2) + resolution.powi(2) / 12.0 + spread).sqrt();
            (deviation > 0.0 && mean.is_finite()).then_some(MeasuredStart { output, mean, deviation })
        };
        (0..self.measured.len()).filter(|output| starts(*output)).filter_map(start).collect()
    }
}
