//! The likelihood of a problem as what a search minimises: its parameters and its noise together, each on its
//! scale.

use crate::estimate::problem::Problem;
use crate::optimise::scoring::{Scoring, ScoringOptions};
use crate::optimise::{Ask, Candidate, Cost, Dimension, DimensionScale, Evaluation, Slope, Space};
use crate::simulate::likelihood::Likelihood;
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;

/// A problem with its noise: the coordinates are the free parameters, a diffusion per state, a deviation per
/// output.
pub struct LikelihoodObjective<'a> {
    pub(in crate::estimate) problem: &'a Problem,
    pub(in crate::estimate) likelihood: Likelihood<'a>,
    pub(in crate::estimate) space: Space,
    /// The place of each coordinate in the point of the likelihood.
    pub(in crate::estimate) places: Vec<usize>,
    /// How many innovations the training part gives.
    innovations: usize,
}

impl<'a> LikelihoodObjective<'a> {
    /// The task of a problem.
    pub fn new(problem: &'a Problem) -> Self {
        let model = problem.model();
        let parameters = model.parameters().len();
        let sensor = model.outputs()[0].noise_sd;
        let mut dimensions = problem.space().dimensions().to_vec();
        let mut noise = |name: String, [lower, upper, _]: [f64; 3], unit: f64| {
            dimensions.push(Dimension {
                name,
                lower: lower * unit,
                upper: upper * unit,
                scale: DimensionScale::Log,
            });
        };
        model.states().iter().for_each(|state| noise(format!("sigma({})", state.name), DIFFUSION, sensor));
        model
            .outputs()
            .iter()
            .for_each(|output| noise(format!("sd({})", output.channel), MEASUREMENT, output.noise_sd));
        let noises = model.states().len() + model.outputs().len();
        let measured = problem.measured();
        let likelihood = Likelihood::new(model, problem.simulator(), &measured, problem.free());
        let mut task = Self {
            problem,
            likelihood,
            space: Space::new(dimensions),
            places: problem.free().iter().copied().chain(parameters..parameters + noises).collect(),
            innovations: 0,
        };
        task.innovations = task.count();
        task
    }

    /// The number of innovations does not depend on where the filter is, as long as it stays in the numbers.
    fn count(&self) -> usize {
        let split = self.problem.split();
        let known = self.problem.known();
        let starts: Vec<bool> = self
            .problem
            .model()
            .outputs()
            .iter()
            .enumerate()
            .map(|(output, _)| self.begins(output))
            .collect();
        let began = |k: usize| k == 0 || !known[k - 1];
        let counted = |k: usize, output: usize, valid: &[bool]| valid[k] && !(began(k) && starts[output]);
        self.problem
            .measured()
            .iter()
            .enumerate()
            .map(|(output, (_, valid))| (0..split.train.end).filter(|k| counted(*k, output, valid)).count())
            .sum()
    }

    fn begins(&self, output: usize) -> bool {
        self.problem
            .model()
            .states()
            .iter()
            .any(|state| state.initial == crate::model::Initial::Measured(output))
    }

    /// How many coordinates are parameters of the model; they come first.
    pub fn parameters(&self) -> usize {
        self.problem.space().len()
    }

    /// The coordinates with their bounds.
    pub fn space(&self) -> &Space {
        &self.space
    }

    /// The place of a full parameter vector, with the noise that a search begins with, or this one.
    pub fn place(&self, theta: &[f64], noise: Option<&[f64]>) -> Vec<f64> {
        let mut place = self.start(&self.problem.candidate(theta)).0;
        let own = self.problem.space().len();
        for ((unit, dimension), value) in
            place[own..].iter_mut().zip(&self.space.dimensions()[own..]).zip(noise.unwrap_or_default())
        {
            *unit = dimension.unit(*value);
        }
        place
    }

    /// The parameters and the noise at a place.
    pub fn values(&self, place: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut theta = self.point(place);
        let noise = theta.split_off(self.problem.nominal().len());
        (theta, noise)
    }

    /// The log-likelihood at a place, without any prior, and the number of innovations.
    pub fn log_likelihood_at(&self, place: &[f64]) -> Option<(f64, usize)> {
        let (value, innovations) =
            self.likelihood.value(&self.point(place), self.problem.split().train.end)?;
        Some((-value, innovations))
    }

    /// A candidate of the problem's own space, with the noise that a search begins with.
    pub(in crate::estimate) fn start(&self, warm: &Candidate) -> Candidate {
        let model = self.problem.model();
        let sensor = model.outputs()[0].noise_sd;
        let noise = model
            .states()
            .iter()
            .map(|_| DIFFUSION[2] * sensor)
            .chain(model.outputs().iter().map(|o| MEASUREMENT[2] * o.noise_sd));
        let own = self.problem.space().len();
        let units =
            self.space.dimensions()[own..].iter().zip(noise).map(|(dimension, value)| dimension.unit(value));
        Candidate(warm.0.iter().copied().chain(units).collect())
    }

    /// The point of the likelihood at a candidate.
    pub(in crate::estimate) fn point(&self, candidate: &[f64]) -> Vec<f64> {
        let mut point = self.problem.nominal().to_vec();
        point.resize(point.len() + self.space.len() - self.problem.space().len(), 0.0);
        for ((place, dimension), unit) in self.places.iter().zip(self.space.dimensions()).zip(candidate) {
            point[*place] = dimension.value(*unit);
        }
        point
    }

    /// The pull of the prior at a coordinate.
    fn pull(&self, point: &[f64], coordinate: usize) -> Option<f64> {
        self.problem.pull(self.places[coordinate], point)
    }

    /// Minus the log-likelihood, and minus the logarithm of the prior where there is one.
    pub fn value(&self, candidate: &[f64]) -> Option<f64> {
        let point = self.point(candidate);
        let (value, _) = self.likelihood.value(&point, self.problem.split().train.end)?;
        let prior: f64 =
            (0..self.space.len()).filter_map(|i| self.pull(&point, i)).map(|pull| 0.5 * pull * pull).sum();
        Some(value + prior)
    }

    /// The same with its slopes by the coordinates that `moving` names.
    pub fn slope(&self, candidate: &[f64], moving: &[usize]) -> Option<Slope> {
        let point = self.point(candidate);
        let active: Vec<usize> = moving.iter().map(|coordinate| self.places[*coordinate]).collect();
        let slopes = self.likelihood.slopes(&point, &active, self.problem.split().train.end)?;
        // From physical units to the cube.
        let stretch: Vec<f64> = moving
            .iter()
            .map(|coordinate| self.space.dimensions()[*coordinate].slope(point[self.places[*coordinate]]))
            .collect();
        let d = moving.len();
        let mut slope = Slope {
            value: slopes.value,
            gradient: slopes.gradient.iter().zip(&stretch).map(|(slope, by)| slope * by).collect(),
            information: (0..d * d)
                .map(|place| slopes.information[place] * stretch[place / d] * stretch[place % d])
                .collect(),
        };
        for (index, coordinate) in moving.iter().enumerate() {
            if let (Some(pull), Some(known)) =
                (self.pull(&point, *coordinate), self.problem.known_before(self.places[*coordinate]))
            {
                let by = self.space.dimensions()[*coordinate].length() / known.deviation;
                slope.value += 0.5 * pull * pull;
                slope.gradient[index] += pull * by;
                slope.information[index * d + index] += by * by;
            }
        }
        // What does not move is pulled all the same.
        let still = (0..self.space.len()).filter(|coordinate| !moving.contains(coordinate));
        slope.value += still
            .filter_map(|coordinate| self.pull(&point, coordinate))
            .map(|pull| 0.5 * pull * pull)
            .sum::<f64>();
        Some(slope)
    }

    /// A likelihood as a cost: the variance of white innovations that would be as likely.
    pub(in crate::estimate) fn cost(&self, value: f64) -> Cost {
        let logarithm = 2.0 * value / self.innovations.max(1) as f64 - 1.0 - std::f64::consts::TAU.ln();
        let beyond = (logarithm - STEEPEST).max(0.0);
        Cost::new(logarithm.min(STEEPEST).exp() * (1.0 + beyond))
    }

    /// The log-likelihood behind a cost.
    pub(in crate::estimate) fn log_likelihood(&self, cost: Cost) -> Option<f64> {
        let Cost::Finite(cost) = cost else { return None };
        let top = STEEPEST.exp();
        let logarithm = if cost > top { STEEPEST + cost / top - 1.0 } else { cost.ln() };
        Some(-0.5 * self.innovations as f64 * (logarithm + 1.0 + std::f64::consts::TAU.ln()))
    }

    /// The answers to a question; each candidate by itself, so that their order and number change no bit.
    pub(in crate::estimate) fn answer(&self, ask: &Ask, halt: Halt) -> Vec<Evaluation> {
        let all: Vec<usize> = (0..self.space.len()).collect();
        let nothing = || Evaluation { cost: Cost::Diverged, residuals: Vec::new(), slope: None };
        let one = |candidate: &Candidate| {
            if halt() {
                return nothing();
            }
            match ask {
                Ask::Slopes(_) => {
                    let slope = self.slope(&candidate.0, &all);
                    let cost = slope.as_ref().map_or(Cost::Diverged, |slope| self.cost(slope.value));
                    Evaluation { cost, slope, ..nothing() }
                }
                _ => Evaluation {
                    cost: self.value(&candidate.0).map_or(Cost::Diverged, |value| self.cost(value)),
                    ..nothing()
                },
            }
        };
        match ask {
            Ask::Costs(batch) | Ask::Residuals(batch) | Ask::Slopes(batch) => {
                batch.par_iter().map(one).collect()
            }
            Ask::Done(_) => Vec::new(),
        }
    }

    /// Climbs from a candidate while the other coordinates than `moving` stay: the place, its value, and
    /// filter passes.
    pub fn climb(
        &self,
        start: &[f64],
        moving: &[usize],
        options: &ScoringOptions,
    ) -> Option<(Vec<f64>, f64, usize)> {
        let whole = |part: &[f64]| {
            let mut whole = start.to_vec();
            moving.iter().zip(part).for_each(|(coordinate, unit)| whole[*coordinate] = *unit);
            whole
        };
        let first = Candidate(moving.iter().map(|coordinate| start[*coordinate]).collect());
        let mut run = Scoring::new(options, &first);
        let mut best = None;
        let mut passes = 0;
        while let Some(trial) = run.propose() {
            passes += 1;
            let place = whole(&trial.0);
            let slope = self.slope(&place, moving);
            let cost = slope.as_ref().map_or(Cost::Diverged, |slope| self.cost(slope.value));
            if let Some(value) = slope.as_ref().map(|slope| slope.value)
                && best.as_ref().is_none_or(|(_, known)| value < *known)
            {
                best = Some((place, value));
            }
            run.digest(&Evaluation { cost, residuals: Vec::new(), slope });
        }
        best.map(|(place, value)| (place, value, passes))
    }
}

/// Bounds and start of a diffusion per square root of an hour, in multiples of the sensor's noise.
const DIFFUSION: [f64; 3] = [1e-3, 1e3, 6.0];

/// Bounds and start of a measurement deviation, in multiples of the sensor's declared noise.
const MEASUREMENT: [f64; 3] = [1e-4, 100.0, 1.0];

/// The logarithm of a cost beyond which it grows along a straight line: an exponential would leave the
/// numbers.
const STEEPEST: f64 = 300.0;
