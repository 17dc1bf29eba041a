//! The largest likelihood near some known points: a fit without its document, for the comparison of many
//! models.

use super::objective::LikelihoodObjective;
use super::ratio::{LikelihoodRatio, ratio};
use crate::estimate::problem::Problem;
use crate::optimise::scoring::ScoringOptions;
use crate::simulate::kalman::Noise;

/// A local maximum of the likelihood.
#[derive(Debug, Clone, PartialEq)]
pub struct MlEstimate {
    /// The parameters in the model's order.
    pub theta: Vec<f64>,
    /// The diffusions in the order of the states, then the deviations in the order of the outputs.
    pub noise: Vec<f64>,
    /// The log-likelihood of the training part.
    pub log_likelihood: f64,
    /// Innovations that it is made of.
    pub innovations: usize,
    /// How many numbers were estimated.
    pub estimated: usize,
}

impl MlEstimate {
    /// The highest peak that is reached from any of these parameter vectors, with the noise that a search
    /// begins with, or this one. `None` where the likelihood of all of them cannot be computed.
    pub fn near(problem: &Problem, thetas: &[Vec<f64>], noise: Option<&[f64]>) -> Option<Self> {
        let task = LikelihoodObjective::new(problem);
        let all: Vec<usize> = (0..task.space().len()).collect();
        let climbed = thetas
            .iter()
            .filter_map(|theta| task.climb(&task.place(theta, noise), &all, &ScoringOptions::default()));
        let (place, ..) = climbed.min_by(|a, b| a.1.total_cmp(&b.1))?;
        let (theta, noise) = task.values(&place);
        let (log_likelihood, innovations) = task.log_likelihood_at(&place)?;
        Some(Self { theta, noise, log_likelihood, innovations, estimated: all.len() })
    }

    /// Tests it against the peak of a smaller model, whose name comes first; the best of so many was taken.
    pub fn against(&self, smaller: &MlEstimate, tried: usize, names: [&str; 2]) -> Option<LikelihoodRatio> {
        if self.innovations != smaller.innovations {
            return None;
        }
        ratio(
            2.0 * (self.log_likelihood - smaller.log_likelihood),
            self.estimated.checked_sub(smaller.estimated)?,
            tried,
            names,
        )
    }

    /// The noise for a filter.
    pub fn filter_noise(&self, problem: &Problem) -> Noise {
        let (process, sensors) = self.noise.split_at(problem.model().states().len());
        Noise { process: process.to_vec(), measurement: sensors.iter().map(|sd| sd * sd).collect() }
    }
}
