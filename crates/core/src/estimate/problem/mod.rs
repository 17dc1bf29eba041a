//! What is asked: a model, a window on a grid, the parts of it, an objective and a box of free parameters.
//!
//! ```text
//! EstimateRequest, Window, Catalogue --request--> Problem (basis, objective) --> cost of a candidate
//! ```
//!
//! `starts` says where the measured states begin, `predictor` from which states the model predicts, `prior`
//! what is known before any data, `variants` makes the same problem with one thing changed, and `widen`
//! gives its grid whatever else was measured. `method` names the search and `stop` says when it ends early;
//! `bounds` asks whether a parameter sits on one, `whiten` has the autoregressive model of a residual.

pub mod basis;
pub mod bounds;
pub mod choices;
pub mod method;
pub mod objective;
pub mod predictor;
pub mod prior;
pub mod request;
pub mod starts;
pub mod stop;
mod variants;
pub mod whiten;
pub mod widen;

use crate::data::{Grid, Split};
use crate::fault::Fault;
use crate::interrupt::Brake;
use crate::model::{Model, Nominal, Scale};
use crate::optimise::{Candidate, Cost, Dimension, DimensionScale, Evaluation, Space, Theta};
use crate::simulate::kalman::Kalman;
use crate::simulate::trajectory::{Halt, MeasuredOutput};
use crate::simulate::{Inputs, Simulator, Stepper, Trajectory, substeps};
use crate::units::error_unit;
use basis::Basis;
use choices::{Choices, Source};
use indexmap::IndexMap;
use objective::{Objective, ShapeDelta, Share, divisor};
use predictor::Predictor;
use prior::{KnownParameter, Prior};
use std::ops::Range;
use std::sync::Arc;

/// Fewest samples to train on, of every output.
const LEAST_SAMPLES: usize = 10;

/// The values of an output, and which of them are valid.
type MeasuredColumn = (Arc<[f64]>, Arc<[bool]>);

/// An estimation problem. Full parameter vectors follow the model's order; free ones follow the space's.
/// Copies share what is large.
#[derive(Debug, Clone)]
pub struct Problem {
    model: Arc<Model>,
    grid: Grid,
    simulator: Simulator,
    split: Split,
    objective: Objective,
    delta: ShapeDelta,
    prior: Prior,
    /// Variance of the residual of the fit without a prior, as if it were white; the prior's weight.
    prior_variance: Option<f64>,
    measured: Vec<MeasuredColumn>,
    /// Estimated starts of the measured states, by channel.
    starts: IndexMap<String, f64>,
    /// Indices of the free parameters.
    free: Vec<usize>,
    space: Space,
    /// Full vector: nominal values, and the given ones of fixed parameters.
    nominal: Vec<f64>,
    bounds: Vec<[f64; 2]>,
    source: Source,
}

impl Problem {
    /// Puts a problem together.
    ///
    /// # Errors
    /// Every fault: missing channels, units that do not convert, unknown parameters, empty bounds, no
    /// valid measurement to train on.
    pub fn new(
        model: Model,
        grid: Grid,
        split: Split,
        choices: &Choices,
        source: Source,
    ) -> Result<Self, Vec<Fault>> {
        let mut faults = choices.faults(&model);
        if choices.objective == Objective::Likelihood
            && let Some(detail) = Predictor::of(&model).lacks_filter_for("the likelihood")
        {
            faults.push(
                Fault::new("/objective", "stepper", detail).suggest("name another method and objective"),
            );
        }
        let mut measured = Vec::new();
        for output in model.outputs() {
            match grid.column(&output.channel) {
                Some(column) => measured.push(column.shared()),
                None => faults.push(Fault::new(
                    format!("/channels/{}", output.channel),
                    "missing-channel",
                    format!("the measured channel `{}` is not in the window", output.channel),
                )),
            }
        }
        let inputs = match Inputs::new(&model, &grid) {
            // What a warm-up goes over must not know the unseen data.
            Ok(inputs) if faults.is_empty() => inputs.averaged_over(split.train.clone()),
            Ok(_) => return Err(faults),
            Err(more) => {
                faults.extend(more);
                return Err(faults);
            }
        };
        let steps = substeps(model.stepper(), inputs.hours());
        let simulator = Simulator::new(&model, &inputs, &columns(&measured), model.stepper(), steps);
        let mut problem = Self {
            model: model.into(),
            grid,
            simulator,
            split,
            objective: choices.objective,
            delta: choices.delta,
            prior: choices.prior.clone(),
            prior_variance: None,
            measured,
            starts: IndexMap::new(),
            free: Vec::new(),
            space: Space::new(Vec::new()),
            nominal: Vec::new(),
            bounds: Vec::new(),
            source,
        };
        let train = problem.split.train.clone();
        if (0..problem.measured.len())
            .any(|output| problem.usable(output, train.clone()).len() < LEAST_SAMPLES)
        {
            let detail = format!(
                "the training part has fewer than {LEAST_SAMPLES} valid measurements at which all inputs are \
                known"
            );
            return Err(vec![Fault::new("/window", "too-short", detail)]);
        }
        problem.choose(choices);
        Ok(problem)
    }

    /// Bounds, nominal and fixed values, and the box of what is free.
    fn choose(&mut self, choices: &Choices) {
        let mut dimensions = Vec::new();
        for (index, parameter) in self.model.parameters().iter().enumerate() {
            let asked = choices.bounds.get(&parameter.name).copied();
            let [lower, upper] = asked.unwrap_or([parameter.lower, parameter.upper]);
            let log = parameter.scale == Scale::Log;
            let nominal = match &parameter.nominal {
                Nominal::Value(value) => *value,
                Nominal::Measured(channel) => {
                    let output = self.model.outputs().iter().position(|output| output.channel == *channel);
                    output
                        .and_then(|output| self.simulator.measured_start(output))
                        .unwrap_or(0.5 * (lower + upper))
                }
            };
            self.bounds.push([lower, upper]);
            match choices.fixed.get(&parameter.name) {
                Some(value) => self.nominal.push(*value),
                None => {
                    self.nominal.push(nominal.clamp(lower, upper));
                    self.free.push(index);
                    let scale = if log { DimensionScale::Log } else { DimensionScale::Linear };
                    dimensions.push(Dimension { name: parameter.name.clone(), lower, upper, scale });
                }
            }
        }
        self.space = Space::new(dimensions);
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The window on its grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Where the measurements come from.
    pub fn source(&self) -> &Source {
        &self.source
    }

    /// Hash of the stitched measurements that the grid was made from.
    pub fn input_hash(&self) -> &str {
        &self.source.hash
    }

    /// What is needed to put the problem together again.
    pub fn basis(&self) -> &Basis {
        &self.source.basis
    }

    /// The quantisation step of each output's sensor, where it has one.
    pub fn quanta(&self) -> &[Option<f64>] {
        &self.source.quanta
    }

    /// The model's inputs on the grid.
    pub fn inputs(&self) -> &Inputs {
        self.simulator.inputs()
    }

    /// The simulator with the default stepper.
    pub fn simulator(&self) -> &Simulator {
        &self.simulator
    }

    /// What ends work on the problem from outside.
    pub fn brake(&self) -> &Brake {
        self.simulator.brake()
    }

    /// From which states the model predicts.
    pub fn predictor(&self) -> Predictor {
        Predictor::of(&self.model)
    }

    /// The filter over the window; `None` where the model predicts by its free run.
    pub fn filter(&self) -> Option<Kalman<'_>> {
        match self.predictor() {
            Predictor::Filtered => Some(Kalman::new(&self.model, &self.simulator, &self.measured())),
            Predictor::FreeRun => None,
        }
    }

    /// Training, validation and test parts.
    pub fn split(&self) -> &Split {
        &self.split
    }

    /// What is minimised.
    pub fn objective(&self) -> Objective {
        self.objective
    }

    /// What the shape counts in it.
    pub fn delta(&self) -> ShapeDelta {
        self.delta
    }

    /// The prior.
    pub fn prior(&self) -> &Prior {
        &self.prior
    }

    /// Where the prior takes a parameter to lie; `None` where it knows nothing of it.
    pub fn known_before(&self, index: usize) -> Option<KnownParameter> {
        self.prior.of(self.model.parameters().get(index)?, self.nominal[index])
    }

    /// How many deviations the prior has a parameter lie from its middle, at a full vector.
    pub fn pull(&self, index: usize, theta: &[f64]) -> Option<f64> {
        self.known_before(index)?.pull(self.model.parameters().get(index)?, theta[index])
    }

    /// The pulls of all free parameters that a prior draws.
    pub fn pulls(&self, theta: &[f64]) -> impl Iterator<Item = f64> {
        self.free.iter().filter_map(move |index| self.pull(*index, theta))
    }

    /// The box of the free parameters.
    pub fn space(&self) -> &Space {
        &self.space
    }

    /// Indices of the free parameters in the full vector.
    pub fn free(&self) -> &[usize] {
        &self.free
    }

    /// The full vector of nominal values.
    pub fn nominal(&self) -> &[f64] {
        &self.nominal
    }

    /// Bounds of every parameter.
    pub fn bounds(&self) -> &[[f64; 2]] {
        &self.bounds
    }

    /// The measured outputs with their validity.
    pub fn measured(&self) -> Vec<MeasuredOutput<'_>> {
        columns(&self.measured)
    }

    /// Over which intervals from one sample to the next all inputs are known.
    pub fn known(&self) -> Vec<bool> {
        let inputs = self.inputs();
        (0..inputs.samples().saturating_sub(1)).map(|k| inputs.known(k)).collect()
    }

    /// The full vector of a candidate.
    pub fn theta(&self, candidate: &Candidate) -> Vec<f64> {
        let mut theta = self.nominal.clone();
        for (index, value) in self.free.iter().zip(self.space.theta(candidate).0) {
            theta[*index] = value;
        }
        theta
    }

    /// The candidate of a full vector; values outside the box move to its edge.
    pub fn candidate(&self, theta: &[f64]) -> Candidate {
        self.space.candidate(&Theta(self.free.iter().map(|index| theta[*index]).collect()))
    }

    /// Costs, and residuals where wanted, of candidates on the training part. Their mean square is the cost.
    pub fn evaluate(&self, candidates: &[Candidate], with_residuals: bool) -> Vec<Evaluation> {
        self.evaluate_unless(candidates, with_residuals, &|| false)
    }

    /// The same, cut short as soon as `halt` says so; the answers then mean nothing.
    pub fn evaluate_unless(
        &self,
        candidates: &[Candidate],
        with_residuals: bool,
        halt: Halt,
    ) -> Vec<Evaluation> {
        let thetas: Vec<Vec<f64>> = candidates.iter().map(|candidate| self.theta(candidate)).collect();
        let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let used = self.used();
        self.simulator
            .run_unless(&slices, self.split.train.end, halt)
            .iter()
            .zip(&thetas)
            .map(|(trajectory, theta)| {
                let residuals =
                    if trajectory.diverged { Vec::new() } else { self.residuals(trajectory, theta, &used) };
                let cost =
                    if residuals.is_empty() { Cost::Diverged } else { Cost::new(mean_square(&residuals)) };
                Evaluation {
                    cost,
                    residuals: if with_residuals && cost != Cost::Diverged { residuals } else { Vec::new() },
                    slope: None,
                }
            })
            .collect()
    }

    /// Residuals whose mean square is the objective. The mean square errors of several outputs are each
    /// weighed by their noise, except where the objective normalises them.
    fn residuals(&self, trajectory: &Trajectory, theta: &[f64], used: &[Vec<usize>]) -> Vec<f64> {
        let mut residuals = Vec::with_capacity(used.iter().map(Vec::len).sum());
        for (output, (weight, used)) in self.weigh(trajectory, used).into_iter().zip(used).enumerate() {
            let (simulated, (values, _)) = (&trajectory.outputs[output], &self.measured[output]);
            residuals.extend(used.iter().map(|k| (simulated[*k] - values[*k]) * weight));
        }
        if let Some(variance) = self.prior_variance {
            self.add_prior(&mut residuals, theta, variance);
        }
        residuals
    }

    /// The samples of the training part at which each output is compared.
    fn used(&self) -> Vec<Vec<usize>> {
        (0..self.measured.len()).map(|output| self.usable(output, self.split.train.clone())).collect()
    }

    /// What the residuals of each output are multiplied by, so that their mean square is the objective.
    pub fn weights(&self, trajectory: &Trajectory) -> Vec<f64> {
        self.weigh(trajectory, &self.used())
    }

    fn weigh(&self, trajectory: &Trajectory, used: &[Vec<usize>]) -> Vec<f64> {
        let total: usize = used.iter().map(Vec::len).sum();
        let weight = |(output, (simulated, used)): (usize, (&Vec<f64>, &Vec<usize>))| {
            let (values, _) = &self.measured[output];
            let share = Share {
                noise: self.model.outputs()[output].noise_sd.powi(2),
                outputs: self.measured.len(),
                total,
            };
            let divisor =
                divisor(self.objective, self.delta, used.iter().map(|k| (simulated[*k], values[*k])), &share);
            // Dividing each residual by the root of the divisor makes the mean square the objective, so that
            // least squares applies to all of them.
            1.0 / divisor.sqrt()
        };
        trajectory.outputs.iter().zip(used).enumerate().map(weight).collect()
    }

    /// What the errors of an output are counted in: its own unit where it is alone, and beside others the
    /// noise of its sensor.
    pub fn scale(&self, output: usize) -> f64 {
        match self.model.outputs() {
            [_] => 1.0,
            several => several[output].noise_sd,
        }
    }

    /// The noise of the sensors, so counted.
    pub fn scaled_noise(&self) -> f64 {
        self.model.outputs().first().map_or(1.0, |first| first.noise_sd / self.scale(0))
    }

    /// Length of a forward difference in the unit cube. Where a stepper finds its own steps, two neighbours
    /// differ by as much as its tolerance allows, and a short difference would say nothing else.
    pub fn difference(&self) -> f64 {
        if self.model.stepper() == Stepper::Rkc { 1e-3 } else { 1e-5 }
    }

    /// The shortest difference that a search may take slopes from.
    pub fn least_step(&self) -> f64 {
        if self.model.stepper() == Stepper::Rkc { self.difference() } else { 0.0 }
    }

    /// Appends the pulls of the prior, so that the cost becomes MSE + s2/n sum z2.
    fn add_prior(&self, residuals: &mut Vec<f64>, theta: &[f64], variance: f64) {
        let n = residuals.len();
        residuals.extend(self.pulls(theta).map(|pull| variance.sqrt() * pull));
        let stretch = (residuals.len() as f64 / n.max(1) as f64).sqrt();
        residuals.iter_mut().for_each(|residual| *residual *= stretch);
    }

    /// The samples of a range where an output is measured and predicted.
    pub fn usable(&self, output: usize, range: Range<usize>) -> Vec<usize> {
        let (_, valid) = &self.measured[output];
        range.filter(|k| valid[*k] && self.simulator.predicted(*k)).collect()
    }

    /// Measured minus simulated of an output at every sample, in its unit; only the usable samples mean
    /// anything.
    pub fn residual(&self, output: usize, simulated: &[f64]) -> Vec<f64> {
        self.measured
            .get(output)
            .map_or_else(Vec::new, |(values, _)| values.iter().zip(simulated).map(|(y, x)| y - x).collect())
    }

    /// Simulates one full vector over the whole window.
    pub fn simulate(&self, theta: &[f64]) -> Trajectory {
        self.simulator.run_with_states(theta)
    }

    /// Mean square of the free-run error of an output over a range, `None` where nothing is comparable.
    pub fn mean_square_error(
        &self,
        trajectory: &Trajectory,
        output: usize,
        range: Range<usize>,
    ) -> Option<f64> {
        let used = self.usable(output, range);
        let (values, _) = &self.measured[output];
        let simulated = trajectory.outputs.get(output)?;
        let errors: Vec<f64> = used.iter().map(|k| simulated[*k] - values[*k]).collect();
        (!errors.is_empty()).then(|| mean_square(&errors)).filter(|value| value.is_finite())
    }

    /// Root mean square of the free-run errors of all outputs over a range, counted in their
    /// [`Problem::scale`]; `None` where nothing is comparable.
    pub fn free_run_error(&self, trajectory: &Trajectory, range: Range<usize>) -> Option<f64> {
        let mut errors = Vec::new();
        for (output, (simulated, (values, _))) in trajectory.outputs.iter().zip(&self.measured).enumerate() {
            let scale = self.scale(output);
            errors.extend(
                self.usable(output, range.clone()).into_iter().map(|k| (simulated[k] - values[k]) / scale),
            );
        }
        (!errors.is_empty()).then(|| mean_square(&errors).sqrt()).filter(|value| value.is_finite())
    }

    /// The unit of errors that are counted in [`Problem::scale`], in words.
    pub fn scale_in_words(&self) -> &str {
        match self.model.outputs() {
            [only] => error_unit(&only.unit),
            _ => "times the noise of the sensors",
        }
    }
}

fn columns(measured: &[MeasuredColumn]) -> Vec<MeasuredOutput<'_>> {
    measured.iter().map(|(values, valid)| (&**values, &**valid)).collect()
}

/// Mean of the squares; NaN for nothing.
pub fn mean_square(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64
}
