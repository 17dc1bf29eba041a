//! Free runs: one simulation from the start of a window, for many parameter vectors at once.
//!
//! Where inputs are unknown the simulation stands still: no values are invented. Behind such a gap the
//! states that a sensor measures start again from the measurement, the hidden ones from where they were.

use super::drive::{Drive, Inputs};
use super::lanes::LaneFile;
use super::stepper::{output_tape, step_tape};
use crate::interrupt::{Brake, Meter};
use crate::model::tape::Tape;
use crate::model::{Initial, Model, Stepper};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// A state farther from zero than this has left physics: the candidate has diverged.
const RUNAWAY: f64 = 1e6;
/// Samples between two looks at whether a whole block has diverged, or is not wanted any more.
const PATROL: usize = 32;

/// A model on the inputs of a window, ready to simulate any parameter vector. Copies share what is large.
#[derive(Debug, Clone)]
pub struct Simulator {
    pub(super) stepper: Stepper,
    pub(super) step: Arc<Tape>,
    pub(super) output: Arc<Tape>,
    inputs: Inputs,
    /// What steps and outputs read of the inputs, from when it is first wanted.
    drive: Arc<OnceLock<Drive>>,
    output_drive: Arc<OnceLock<Drive>>,
    pub(super) initial: Vec<Initial>,
    /// Measured starts per output: the mean of the first three valid samples from each sample on, unless the
    /// first of them is known better.
    starts: Vec<Vec<Option<f64>>>,
    substeps: usize,
    /// Whether steps that every candidate finds for itself are only as exact as a search needs them.
    is_loose: bool,
    pub(super) warm_up: Option<Arc<WarmUpDrive>>,
    pub(super) brake: Brake,
}

/// What comes before the first sample.
#[derive(Debug)]
pub(super) struct WarmUpDrive {
    /// Its constant inputs.
    pub drive: Drive,
    /// How long it takes.
    pub hours: f64,
}

/// What one candidate did.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// One series per output, a value per sample. Behind a divergence the values are not finite.
    pub outputs: Vec<Vec<f64>>,
    /// One series per state where they were asked for, else empty.
    pub states: Vec<Vec<f64>>,
    /// Whether a state left the numbers or physics, or the simulation was cut short.
    pub diverged: bool,
    /// How often the right-hand side was evaluated.
    pub evaluations: usize,
}

/// Asked in the middle of simulations whether they are to end now.
pub type Halt<'a> = &'a (dyn Fn() -> bool + Sync);

/// A measured output: its values and which of them are valid.
pub type MeasuredOutput<'a> = (&'a [f64], &'a [bool]);

impl Simulator {
    /// Prepares a simulation. `measured` has one series per output of the model, as long as the inputs; it
    /// gives the measured starts.
    pub fn new(
        model: &Model,
        inputs: &Inputs,
        measured: &[MeasuredOutput],
        stepper: Stepper,
        substeps: usize,
    ) -> Self {
        let step = step_tape(model, stepper);
        Self {
            stepper,
            warm_up: warm_up(model, &step, inputs),
            step: step.into(),
            output: output_tape(model).into(),
            inputs: inputs.clone(),
            drive: Arc::default(),
            output_drive: Arc::default(),
            initial: model.states().iter().map(|state| state.initial).collect(),
            starts: starts(measured),
            substeps,
            is_loose: false,
            brake: Brake::NONE,
        }
    }

    /// The same model, as it was made from, on other inputs and measurements.
    #[must_use]
    pub fn over(&self, model: &Model, inputs: &Inputs, measured: &[MeasuredOutput], substeps: usize) -> Self {
        let (warm_up, starts) = (warm_up(model, &self.step, inputs), starts(measured));
        Self { warm_up, starts, substeps, ..self.with_inputs(inputs) }
    }

    /// The same simulation under a brake, which its runs and the filters on it ask on their way: where it is
    /// pulled they unwind to a [`Brake::guard`].
    #[must_use]
    pub fn with_brake(self, brake: &Brake) -> Self {
        Self { brake: brake.clone(), ..self }
    }

    /// The same simulation, whose measured states start at these values of the outputs where there are any.
    #[must_use]
    pub fn with_starts(mut self, starts: &[Option<f64>]) -> Self {
        for (known, start) in self.starts.iter_mut().zip(starts) {
            if let (Some(first), Some(start)) = (known.first_mut(), start) {
                *first = Some(*start);
            }
        }
        self
    }

    /// The same simulation in steps as exact as a search needs them, or as a prediction does: loose steps
    /// that candidates find for themselves have a larger tolerance, others are twice as long, unless they
    /// take a whole interval already.
    #[must_use]
    pub fn with_loose_steps(self, is_loose: bool) -> Self {
        let before = self.steps();
        let changed = Self { is_loose, ..self };
        if changed.steps() == before { changed } else { Self { drive: Arc::default(), ..changed } }
    }

    /// Whether its steps may be loose ones.
    pub fn is_loose(&self) -> bool {
        self.is_loose
    }

    /// Whether its steps are only as exact as a search needs them.
    pub fn has_loose_steps(&self) -> bool {
        self.is_loose && (self.stepper == Stepper::Rkc || self.substeps > 1)
    }

    /// What ends its runs from outside.
    pub fn brake(&self) -> &Brake {
        &self.brake
    }

    /// The same simulation under other inputs of the same grid, but for its warm-up.
    #[must_use]
    pub fn with_inputs(&self, inputs: &Inputs) -> Self {
        let (drive, output_drive) = Default::default();
        Self { inputs: inputs.clone(), drive, output_drive, ..self.clone() }
    }

    /// Its inputs.
    pub fn inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// What a step reads of them.
    pub(super) fn drive(&self) -> &Drive {
        self.drive.get_or_init(|| Drive::new(&self.step, &self.inputs, self.steps()))
    }

    /// What the outputs read of them.
    pub(super) fn output_drive(&self) -> &Drive {
        self.output_drive.get_or_init(|| Drive::new(&self.output, &self.inputs, 1))
    }

    /// Hours of a step; of a whole interval where every candidate finds its own steps.
    pub(super) fn step_hours(&self) -> f64 {
        self.inputs.hours() / self.steps() as f64
    }

    /// How many steps it takes through an interval, or one where each candidate finds its own.
    fn steps(&self) -> usize {
        steps(self.stepper, self.substeps, self.is_loose)
    }

    /// How it steps.
    pub fn stepper(&self) -> Stepper {
        self.stepper
    }

    /// Internal steps per sample, where they are not loose. The stepper rkc finds its own; with so many its
    /// tolerance is a tenth for each doubling.
    pub fn substeps(&self) -> usize {
        self.substeps
    }

    /// How many samples a trajectory has.
    pub fn samples(&self) -> usize {
        self.inputs.samples()
    }

    /// Whether a simulated value at sample `k` is a prediction: some input interval leads to it.
    pub fn predicted(&self, k: usize) -> bool {
        k == 0 || self.inputs.known(k - 1)
    }

    /// The measured start of an output: the mean of its first three valid samples, unless it is known better.
    pub fn measured_start(&self, output: usize) -> Option<f64> {
        self.starts.get(output).and_then(|starts| starts.first().copied().flatten())
    }

    /// The measured start of an output at sample `k`.
    pub(super) fn measured_start_at(&self, output: usize, k: usize) -> Option<f64> {
        self.starts.get(output).and_then(|starts| starts.get(k).copied().flatten())
    }

    /// The tape of the outputs and its inputs at every sample, for the Kalman filter.
    pub(super) fn output_parts(&self) -> (&Tape, &Drive) {
        (&self.output, self.output_drive())
    }

    /// The tape of one step and the sub-steps per sample, for the Kalman filter.
    pub(super) fn step_parts(&self) -> (&Tape, &Drive, usize, f64) {
        (&self.step, self.drive(), self.steps(), self.step_hours())
    }

    pub(super) fn block<const W: usize>(
        &self,
        thetas: &[&[f64]],
        until: usize,
        keep_states: bool,
        halt: Halt,
    ) -> Vec<Trajectory> {
        let states = self.initial.len();
        let (step_tape, drive, substeps, hours) = self.step_parts();
        let (output_tape, output_drive) = self.output_parts();
        let outputs = output_tape.roots.len();
        let mut file = LaneFile::<W>::new(step_tape);
        file.load(thetas, hours);
        let mut out = LaneFile::<W>::new(output_tape);
        out.load(thetas, 0.0);
        let mut values: Vec<Vec<[f64; W]>> = vec![Vec::with_capacity(until); outputs];
        let mut kept: Vec<Vec<[f64; W]>> = vec![Vec::new(); states];
        let mut farthest = [0.0; W];
        let mut halted = false;
        for (state, initial) in self.initial.iter().enumerate() {
            for lane in 0..W {
                file.state(state)[lane] = self.start(*initial, thetas[lane.min(thetas.len() - 1)]);
            }
        }
        let mut meter = Meter::new(&self.brake);
        let mut steps = self.warm_up(&mut file, thetas, &mut meter);
        for k in 0..until {
            meter.add(W * (substeps * step_tape.step.len() + output_tape.step.len()));
            if k > 0 && self.inputs.known(k - 1) {
                for step in 0..substeps {
                    drive.load(&mut file, k - 1, step);
                    file.step();
                    file.advance();
                }
                steps += substeps;
            } else if k > 0 && self.inputs.known(k) {
                self.restarts(k).for_each(|(state, start)| *file.state(state) = [start; W]);
            }
            for state in 0..states {
                let lane_values = *file.state(state);
                // What is not a number stays so, and is not below any distance.
                for (farthest, value) in farthest.iter_mut().zip(lane_values) {
                    *farthest = if value.abs() <= *farthest { *farthest } else { value.abs() };
                }
                *out.state(state) = lane_values;
                if keep_states {
                    kept[state].push(lane_values);
                }
            }
            output_drive.load(&mut out, k, 0);
            out.step();
            for (output, values) in values.iter_mut().enumerate() {
                values.push(*out.root(output));
            }
            if k % PATROL == 0 {
                halted = halt();
                if halted || farthest.iter().all(|farthest| diverged(*farthest)) {
                    break;
                }
            }
        }
        let series = |values: &[Vec<[f64; W]>], lane: usize| -> Vec<Vec<f64>> {
            let padded = |values: &Vec<[f64; W]>| {
                let mut series: Vec<f64> = values.iter().map(|value| value[lane]).collect();
                series.resize(until, f64::NAN);
                series
            };
            values.iter().map(padded).collect()
        };
        (0..thetas.len())
            .map(|lane| Trajectory {
                outputs: series(&values, lane),
                states: if keep_states { series(&kept, lane) } else { Vec::new() },
                diverged: halted || diverged(farthest[lane]),
                evaluations: steps * if self.stepper == Stepper::Rk4 { 4 } else { 2 },
            })
            .collect()
    }

    /// Takes the states through the warm-up in steps that are no longer than those of the window. Says how
    /// many.
    fn warm_up<const W: usize>(&self, file: &mut LaneFile<W>, thetas: &[&[f64]], meter: &mut Meter) -> usize {
        let Some(warm_up) = &self.warm_up else { return 0 };
        let steps = (warm_up.hours / self.step_hours() - 1e-9).ceil().max(1.0) as usize;
        file.load(thetas, warm_up.hours / steps as f64);
        warm_up.drive.load(file, 0, 0);
        for _ in 0..steps {
            meter.add(W * self.step.step.len());
            file.step();
            file.advance();
        }
        file.load(thetas, self.step_hours());
        steps
    }

    /// Where a state begins.
    pub(super) fn start(&self, initial: Initial, theta: &[f64]) -> f64 {
        match initial {
            Initial::Measured(output) => self.measured_start(output).unwrap_or(f64::NAN),
            Initial::Parameter(parameter) => theta[parameter],
            Initial::Fixed(value) => value,
        }
    }

    /// The measured states behind a gap in the inputs, and their measurements.
    pub(super) fn restarts(&self, k: usize) -> impl Iterator<Item = (usize, f64)> {
        self.initial.iter().enumerate().filter_map(move |(state, initial)| match initial {
            Initial::Measured(output) => self.starts[*output][k].map(|start| (state, start)),
            Initial::Parameter(_) | Initial::Fixed(_) => None,
        })
    }
}

/// Whether a state that came this far has left the numbers or physics.
pub(super) fn diverged(farthest: f64) -> bool {
    farthest.is_nan() || farthest > RUNAWAY
}

/// How many steps go through an interval: loose ones are half as many.
fn steps(stepper: Stepper, substeps: usize, is_loose: bool) -> usize {
    match stepper {
        Stepper::Rkc => 1,
        Stepper::Ros2 | Stepper::Rk4 if is_loose => substeps.div_ceil(2),
        Stepper::Ros2 | Stepper::Rk4 => substeps,
    }
}

/// What comes before the first sample of a model that warms up, whose step has this tape.
fn warm_up(model: &Model, step: &Tape, inputs: &Inputs) -> Option<Arc<WarmUpDrive>> {
    let warm_up = model.warm_up()?;
    let inputs = inputs.of_warm_up(warm_up, warm_up.hours);
    Some(Arc::new(WarmUpDrive { drive: Drive::new(step, &inputs, 1), hours: warm_up.hours }))
}

/// For every output and sample the mean of the first three valid samples from it on, within its next twelve.
fn starts(measured: &[MeasuredOutput]) -> Vec<Vec<Option<f64>>> {
    let of_output = |(values, valid): &MeasuredOutput| {
        let from = |k: usize| {
            // A record may begin in a gap of its sensor; then its first value, however late, is the best that
            // is known.
            let until = if k == 0 { values.len() } else { values.len().min(k + 12) };
            let first = || first_values(values, valid, k..until);
            let count = first().count();
            (count > 0).then(|| first().sum::<f64>() / count as f64)
        };
        (0..values.len()).map(from).collect()
    };
    measured.iter().map(of_output).collect()
}

/// The first three valid samples of a range, or as many as there are.
pub fn first_values(values: &[f64], valid: &[bool], range: Range<usize>) -> impl Iterator<Item = f64> {
    range.filter(|k| valid[*k]).take(3).map(|k| values[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::document::ModelDocument;
    use crate::model::{Bindings, Catalogue, compile};

    /// x' = a (u - x) with a linear input: the closed form of a ramp is u(t) - s/a + (x0 - u0 + s/a) e^(-a
    /// t).
    fn first_order() -> Model {
        let text = r#"
            id = "first"
            title = "first order"
            [states]
            x = { unit = "degC", initial = "y" }
            [inputs]
            u = { unit = "degC" }
            [parameters]
            a = { unit = "1/h", lower = 1e-3, upper = 1e3, scale = "log", nominal = 1 }
            [equations]
            x = "a*(u - x)"
            [outputs]
            y = { expr = "x", unit = "degC", noise_sd = 0.05 }
        "#;
        let mut catalogue = Catalogue::default();
        catalogue.add_model(ModelDocument::from_toml(text).unwrap());
        compile(&catalogue.compose(&"first".parse().unwrap()).unwrap(), &Bindings::default()).unwrap()
    }

    /// The simulated end of a ramp from 0 to 10 degC in ten hours, started at 20 degC.
    fn ramp_error(stepper: Stepper, substeps: usize, a: f64) -> f64 {
        let model = first_order();
        let inputs = Inputs::from_columns(&model, vec![(0..=10).map(f64::from).collect()], 1.0);
        let (values, valid) = (vec![20.0; 11], vec![true; 11]);
        let simulator = Simulator::new(&model, &inputs, &[(&values, &valid)], stepper, substeps);
        let y = simulator.run(&[&[a]], 11)[0].outputs[0][10];
        let exact = 10.0 - 1.0 / a + (20.0 + 1.0 / a) * (-10.0 * a).exp();
        (y - exact).abs()
    }

    #[test]
    fn a_linear_case_agrees_with_its_closed_form() {
        assert!(ramp_error(Stepper::Rk4, 60, 0.7) < 1e-9);
        assert!(ramp_error(Stepper::Ros2, 100_000, 0.7) < 1e-9);
    }

    #[test]
    fn ros2_has_order_two_and_rk4_order_four() {
        for (stepper, order) in [(Stepper::Ros2, 2.0), (Stepper::Rk4, 4.0)] {
            let observed = (ramp_error(stepper, 4, 0.7) / ramp_error(stepper, 8, 0.7)).log2();
            assert!((observed - order).abs() < 0.15, "{stepper:?}: {observed}");
        }
    }

    #[test]
    fn loose_steps_are_twice_as_long_and_forgotten_again() {
        let model = first_order();
        let inputs = Inputs::from_columns(&model, vec![(0..=10).map(f64::from).collect()], 1.0);
        let (values, valid) = (vec![20.0; 11], vec![true; 11]);
        let of = |substeps| Simulator::new(&model, &inputs, &[(&values, &valid)], Stepper::Ros2, substeps);
        let run = |simulator: &Simulator| simulator.run(&[&[0.7]], 11).swap_remove(0).outputs;
        let (usual, loose) = (of(6), of(6).with_loose_steps(true));
        assert_eq!(run(&loose), run(&of(3)));
        assert_eq!(run(&loose.with_inputs(&inputs)), run(&of(3)));
        assert_eq!(loose.substeps(), 6);
        assert_eq!(run(&loose.with_loose_steps(false)), run(&usual));
        assert!(!of(1).with_loose_steps(true).has_loose_steps());
    }

    #[test]
    fn ros2_damps_what_rk4_cannot_hold() {
        assert!(ramp_error(Stepper::Ros2, 1, 500.0) < 0.1);
        assert!(ramp_error(Stepper::Rk4, 1, 500.0).is_nan() || ramp_error(Stepper::Rk4, 1, 500.0) > 1e3);
    }

    #[test]
    fn a_candidate_is_the_same_alone_and_in_any_block() {
        let model = first_order();
        let inputs =
            Inputs::from_columns(&model, vec![(0..50).map(|k| (f64::from(k) * 0.3).sin()).collect()], 0.5);
        let (values, valid) = (vec![20.0; 50], vec![true; 50]);
        let simulator = Simulator::new(&model, &inputs, &[(&values, &valid)], Stepper::Ros2, 3);
        let thetas: Vec<Vec<f64>> = (0..37).map(|i| vec![0.01 * 1.3f64.powi(i)]).collect();
        let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let together = simulator.run(&slices, 50);
        for (theta, run) in slices.iter().zip(&together) {
            assert_eq!(simulator.run(&[*theta], 50)[0], *run);
        }
    }

    #[test]
    fn what_is_not_wanted_any_more_ends_in_the_middle() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        let model = first_order();
        let inputs = Inputs::from_columns(&model, vec![vec![0.0; 1000]], 1.0);
        let simulator = Simulator::new(&model, &inputs, &[(&[20.0; 1000], &[true; 1000])], Stepper::Ros2, 1);
        let asked = AtomicUsize::new(0);
        let run = simulator.run_unless(&[&[0.5]], 1000, &|| asked.fetch_add(1, Ordering::Relaxed) == 3);
        assert_eq!((run[0].diverged, asked.into_inner(), run[0].outputs[0].len()), (true, 4, 1000));
        let (done, left) = run[0].outputs[0].split_at(3 * PATROL + 1);
        assert!(done.iter().all(|value| value.is_finite()) && left.iter().all(|value| value.is_nan()));
    }

    #[test]
    fn behind_a_gap_the_measured_state_starts_again() {
        let model = first_order();
        let mut inputs = Inputs::from_columns(&model, vec![vec![0.0; 20]], 1.0);
        inputs.forget(8..12);
        let mut values = vec![20.0; 20];
        values[12..].fill(5.0);
        let simulator = Simulator::new(&model, &inputs, &[(&values, &[true; 20])], Stepper::Ros2, 6);
        let y = simulator.run(&[&[0.5]], 20)[0].outputs[0].clone();
        assert_eq!(y[8], y[11], "the simulation stands still in the gap");
        assert_eq!(y[12], 5.0);
        assert!(!simulator.predicted(12) && simulator.predicted(13));
    }
}
