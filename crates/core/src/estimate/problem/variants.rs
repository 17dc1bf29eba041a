//! The same problem, with one thing changed.

use super::Problem;
use super::choices::Choices;
use crate::data::{Grid, Split};
use crate::estimate::problem::prior::Prior;
use crate::fault::Fault;
use crate::interrupt::Brake;
use crate::model::{Model, Stepper};
use crate::optimise::Space;
use crate::simulate::{Inputs, Simulator, Trajectory};
use indexmap::IndexMap;
use std::ops::Range;

impl Problem {
    /// The same problem under a brake. Whatever is computed on it, or on what is derived from it, unwinds to
    /// a [`Brake::guard`] where the brake is pulled.
    #[must_use]
    pub fn with_brake(&self, brake: &Brake) -> Self {
        Self { simulator: self.simulator.clone().with_brake(brake), ..self.clone() }
    }

    /// The same problem with so many internal steps per sample, whose simulation also stands still over the
    /// intervals at which `known` is false.
    #[must_use]
    pub fn aligned(&self, known: &[bool], steps: usize) -> Self {
        let inputs = self.inputs.masked(known);
        Self { simulator: self.simulator_over(&inputs, steps), inputs, ..self.clone() }
    }

    /// The same problem with so many internal steps per sample.
    #[must_use]
    pub fn with_substeps(&self, steps: usize) -> Self {
        Self { simulator: self.simulator_over(&self.inputs, steps), ..self.clone() }
    }

    /// The same problem in steps as exact as a search needs them, or as a prediction does.
    #[must_use]
    pub fn with_loose_steps(&self, is_loose: bool) -> Self {
        Self { simulator: self.simulator.clone().with_loose_steps(is_loose, &self.inputs), ..self.clone() }
    }

    /// The same problem in loose steps of a given length, where they move the free run of these parameters by
    /// no more than this part of its sensors' noise.
    #[must_use]
    pub fn in_long_steps(&self, theta: &[f64], part: f64) -> Self {
        let loose = self.with_loose_steps(true);
        let moves = || self.farthest_apart(&self.simulate(theta), &loose.simulate(theta));
        let may_be = self.model.stepper() != Stepper::Rkc && loose.simulator.has_loose_steps();
        match may_be && moves() <= part * self.scaled_noise() {
            true => loose,
            false => self.clone(),
        }
    }

    /// The largest difference between two runs, in the unit of the output; of several outputs in the noise of
    /// their sensors. One that is not a number is as large as can be.
    pub fn farthest_apart(&self, one: &Trajectory, other: &Trajectory) -> f64 {
        let largest = |worst: f64, d: f64| if d.is_nan() { f64::INFINITY } else { worst.max(d) };
        let of_output = |(output, (one, other)): (usize, (&Vec<f64>, &Vec<f64>))| {
            one.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, largest) / self.scale(output)
        };
        one.outputs.iter().zip(&other.outputs).enumerate().map(of_output).fold(0.0, largest)
    }

    /// The same problem, whose warm-up goes over the mean of the inputs at these samples where it goes over
    /// that of the record.
    #[must_use]
    pub fn averaged_over(&self, samples: Range<usize>) -> Self {
        let inputs = self.inputs.clone().averaged_over(samples);
        Self { simulator: self.simulator_over(&inputs, self.simulator.substeps()), inputs, ..self.clone() }
    }

    /// The same problem, whose measured states start at these values of their channels; those that are not
    /// named start where they did.
    #[must_use]
    pub fn with_starts(&self, starts: IndexMap<String, f64>) -> Self {
        let mut problem = self.clone();
        problem.starts.extend(starts);
        problem.simulator = problem.simulator.clone().with_starts(&problem.starts_by_output());
        problem
    }

    /// The same question of another model, on a grid that has its inputs.
    ///
    /// # Errors
    /// As [`Problem::new`].
    pub fn with_model(&self, model: Model, grid: Grid, choices: &Choices) -> Result<Self, Vec<Fault>> {
        let problem = Self::new(model, grid, self.split.clone(), choices, self.source.clone())?;
        Ok(problem.with_brake(self.brake()).with_starts(self.starts.clone()))
    }

    /// The same question on other measurements, all of which are to train on; measured states start where
    /// these say.
    ///
    /// # Errors
    /// Every channel of the model that the grid does not have.
    pub fn on(&self, grid: Grid) -> Result<Self, Vec<Fault>> {
        let column = |channel: &str| -> Result<_, Vec<Fault>> {
            let column = grid.require(channel).map_err(|fault| vec![fault])?;
            Ok((column.values().to_vec(), column.valid().to_vec()))
        };
        let measured =
            self.model.outputs().iter().map(|output| column(&output.channel)).collect::<Result<_, _>>()?;
        let (inputs, all) = (Inputs::new(&self.model, &grid)?, 0..grid.len());
        let problem = Self {
            split: Split { train: all.clone(), validation: all.end..all.end, test: all.end..all.end },
            inputs: inputs.averaged_over(all),
            measured,
            starts: IndexMap::new(),
            grid,
            ..self.clone()
        };
        let simulator = problem.simulator_over(&problem.inputs, self.simulator.substeps());
        Ok(Self { simulator, ..problem })
    }

    fn simulator_over(&self, inputs: &Inputs, substeps: usize) -> Simulator {
        Simulator::new(&self.model, inputs, &self.measured(), self.model.stepper(), substeps)
            .with_brake(self.brake())
            .with_starts(&self.starts_by_output())
            .with_loose_steps(self.simulator.is_loose(), inputs)
    }

    fn starts_by_output(&self) -> Vec<Option<f64>> {
        self.model.outputs().iter().map(|output| self.starts.get(&output.channel).copied()).collect()
    }

    /// The same problem with some parameters fixed at values.
    #[must_use]
    pub fn with_fixed(&self, parameters: &[(usize, f64)]) -> Self {
        let mut problem = self.clone();
        parameters.iter().for_each(|(index, value)| problem.nominal[*index] = *value);
        let keep: Vec<bool> =
            self.free.iter().map(|index| parameters.iter().all(|(fixed, _)| fixed != index)).collect();
        let kept = || keep.iter().copied();
        problem.free =
            self.free.iter().zip(kept()).filter_map(|(index, keep)| keep.then_some(*index)).collect();
        problem.space = Space::new(
            self.space
                .dimensions()
                .iter()
                .zip(kept())
                .filter(|(_, keep)| *keep)
                .map(|(d, _)| d.clone())
                .collect(),
        );
        problem
    }

    /// The same problem with another prior.
    #[must_use]
    pub fn with_prior(&self, prior: Prior) -> Self {
        Self { prior, prior_variance: None, ..self.clone() }
    }

    /// The same problem with its prior weighted by this residual variance.
    #[must_use]
    pub fn with_prior_variance(&self, variance: f64) -> Self {
        Self { prior_variance: Some(variance), ..self.clone() }
    }

    /// The same problem without its prior.
    #[must_use]
    pub fn without_prior(&self) -> Self {
        self.with_prior(Prior::None)
    }
}
