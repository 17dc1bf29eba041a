//! The same problem, with one thing changed.

use super::choices::Choices;
use super::{MeasuredColumn, Problem};
use crate::data::{Grid, Split};
use crate::estimate::problem::prior::Prior;
use crate::fault::Fault;
use crate::interrupt::Brake;
use crate::model::{Model, Stepper};
use crate::optimise::Space;
use crate::simulate::{Inputs, Simulator, Trajectory, substeps};
use indexmap::IndexMap;
use std::ops::Range;

/// The distance of the points of a coarser grid: rooms answer over hours.
const COARSE_HOURS: f64 = 0.5;
/// How many measurements of each output a coarser grid leaves for every free parameter.
const LEAST_FOR_EACH: usize = 10;
/// The share of what was measured and predicted that it still stands for.
const COARSE_SHARE: f64 = 0.8;
/// Steps may be longer where that moves the free run by no more than this part of its sensors' noise.
const UNNOTICED: f64 = 0.1;

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
        Self { simulator: self.simulator_over(&self.inputs().masked(known), steps), ..self.clone() }
    }

    /// The same problem with so many internal steps per sample.
    #[must_use]
    pub fn with_substeps(&self, steps: usize) -> Self {
        Self { simulator: self.simulator_over(self.inputs(), steps), ..self.clone() }
    }

    /// The same problem in steps as exact as a search needs them, or as a prediction does.
    #[must_use]
    pub fn with_loose_steps(&self, is_loose: bool) -> Self {
        Self { simulator: self.simulator.clone().with_loose_steps(is_loose), ..self.clone() }
    }

    /// The same problem in loose steps of a given length, where they move the free run of these parameters by
    /// less than its sensors would notice.
    #[must_use]
    pub fn in_long_steps(&self, theta: &[f64]) -> Self {
        let loose = self.with_loose_steps(true);
        let moves = || self.farthest_apart(&self.simulate(theta), &loose.simulate(theta));
        let may_be = self.model.stepper() != Stepper::Rkc && loose.simulator.has_loose_steps();
        match may_be && moves() <= UNNOTICED * self.scaled_noise() {
            true => loose,
            false => self.clone(),
        }
    }

    /// The same problem on every n-th point of its grid, in one step from each to the next; of points closer
    /// than half an hour that is one every half hour. `None` where points lie as far apart already, where too
    /// few measurements are left, and where steps were found to be too long or find themselves.
    #[must_use]
    pub fn coarser(&self) -> Option<Self> {
        let n = (COARSE_HOURS / self.grid.step_hours() + 1e-9) as usize;
        let stepper = self.model.stepper();
        let is_refined = self.simulator.substeps() > substeps(stepper, self.inputs().hours());
        if n < 2 || is_refined || stepper == Stepper::Rkc {
            return None;
        }
        let grid = self.grid.every(n);
        let part = |range: &Range<usize>| range.start.div_ceil(n)..range.end.div_ceil(n);
        let train = part(&self.split.train);
        let split = Split { train, validation: part(&self.split.validation), test: part(&self.split.test) };
        let known: Vec<bool> = self.known().chunks(n).map(|known| known.iter().all(|known| *known)).collect();
        let inputs = Inputs::new(&self.model, &grid).ok()?.masked(&known).averaged_over(split.train.clone());
        let every = |(values, valid): &MeasuredColumn| {
            (values.iter().step_by(n).copied().collect(), valid.iter().step_by(n).copied().collect())
        };
        let measured: Vec<MeasuredColumn> = self.measured.iter().map(every).collect();
        // A term of the prior weighs as much beside fewer measurements.
        let prior_variance = self.prior_variance.map(|variance| variance / n as f64);
        let coarse = Self { grid, split, measured, prior_variance, ..self.clone() };
        let simulator = coarse.simulator_over(&inputs, 1);
        let coarse = Self { simulator, ..coarse };
        let counts = |problem: &Self| -> Vec<usize> { problem.used().iter().map(Vec::len).collect() };
        let enough = |(fine, coarse): (usize, usize)| {
            coarse >= LEAST_FOR_EACH * self.free.len() && COARSE_SHARE * fine as f64 <= (n * coarse) as f64
        };
        counts(self).into_iter().zip(counts(&coarse)).all(enough).then_some(coarse)
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
        let inputs = self.inputs().clone().averaged_over(samples);
        Self { simulator: self.simulator_over(&inputs, self.simulator.substeps()), ..self.clone() }
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
        let column = |channel: &str| -> Result<MeasuredColumn, Vec<Fault>> {
            Ok(grid.require(channel).map_err(|fault| vec![fault])?.shared())
        };
        let measured =
            self.model.outputs().iter().map(|output| column(&output.channel)).collect::<Result<_, _>>()?;
        let all = 0..grid.len();
        let inputs = Inputs::new(&self.model, &grid)?.averaged_over(all.clone());
        let problem = Self {
            split: Split { validation: all.end..all.end, test: all.end..all.end, train: all },
            measured,
            starts: IndexMap::new(),
            grid,
            ..self.clone()
        };
        let simulator = problem.simulator_over(&inputs, self.simulator.substeps());
        Ok(Self { simulator, ..problem })
    }

    fn simulator_over(&self, inputs: &Inputs, substeps: usize) -> Simulator {
        self.simulator
            .over(&self.model, inputs, &self.measured(), substeps)
            .with_starts(&self.starts_by_output())
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
