//! The likelihood of a stochastic grey-box model, `dx = f dt + diag(sigma) dw`, `y = h(x) + e`, and its
//! slopes.
//!
//! The (extended) Kalman filter gives one-step innovations and their variances, whose normal densities
//! multiply to the likelihood (Kristensen, Madsen and Jorgensen, Automatica 40, 2004: the method of CTSM).
//! Where the equations are linear in the states the step between samples is exact; otherwise the mean takes
//! the model's own steps and the covariance the exact step of the linearised model, as in [`super::kalman`].
//! Derivatives go forward through all of it.
//!
//! A state that starts at its measurement takes its first sample as it is, with the variance of the sensor: a
//! flat prior after one look, so that this sample is no innovation. A hidden state starts at its parameter,
//! exactly if that parameter is estimated. Behind a gap in the inputs the filter starts again; a missing
//! measurement is passed over.

use super::drive::Drive;
use super::dual::{Dual, MatrixEntry, Scalar};
use super::registers::Registers;
use super::stepper::{field_tape, observation_tape};
use super::trajectory::{MeasuredOutput, Simulator, diverged};
use super::transition::{Transition, propagate};
use super::walk::HIDDEN_VARIANCE;
use crate::interrupt::Meter;
use crate::model::expr::{Node, NodeId};
use crate::model::tape::Tape;
use crate::model::{Initial, InputHold, Model};

/// Steps of a linear model that are kept: as many settings as its switches may have.
const KEPT: usize = 8;

/// The likelihood of one model on one window. A point of it is a vector of parameters, then a diffusion per
/// state, per square root of an hour, then a standard deviation per output.
#[derive(Debug)]
pub struct Likelihood<'a> {
    simulator: &'a Simulator,
    field: Tape,
    field_drive: Drive,
    observation: Tape,
    observation_drive: Drive,
    initial: Vec<Initial>,
    measured: Vec<MeasuredOutput<'a>>,
    /// Which parameters are estimated.
    estimated: Vec<bool>,
    linear: bool,
    /// Steps per sample, and their length.
    steps: usize,
    hours: f64,
}

/// The negative logarithm of the likelihood with its slopes.
#[derive(Debug, Clone, PartialEq)]
pub struct Slopes {
    /// The value.
    pub value: f64,
    /// Its gradient.
    pub gradient: Vec<f64>,
    /// The information of the innovations by rows: what the curvature is expected to be (Fisher).
    pub information: Vec<f64>,
}

/// An innovation and its variance.
type Innovation<T> = (T, T);

impl<'a> Likelihood<'a> {
    /// The likelihood of the model that `simulator` was made from; `estimated` are the parameters that are
    /// searched.
    pub fn new(
        model: &Model,
        simulator: &'a Simulator,
        measured: &[MeasuredOutput<'a>],
        estimated: &[usize],
    ) -> Self {
        let flat: Vec<NodeId> = model.jacobian().iter().flatten().copied().collect();
        let moves = |input: &u16| model.inputs()[usize::from(*input)].hold == InputHold::Linear;
        let depends = |nodes: &[NodeId], on: &dyn Fn(&Node) -> bool| {
            let used = model.graph().reachable(nodes);
            model.graph().nodes().iter().zip(used).any(|(node, used)| used && on(node))
        };
        let varies =
            |node: &Node| matches!(node, Node::Input(input, _) | Node::Delayed(input, ..) if moves(input));
        let linear = !depends(&flat, &|node| matches!(node, Node::State(_)) || varies(node));
        // Between two samples a linear input is a straight line, but what an equation makes of it need not be
        // one.
        let straight = linear && !depends(model.rate(), &varies);
        let delayed =
            model.delays().iter().any(|delay| model.inputs()[delay.input].hold == InputHold::Linear);
        let (inputs, (_, _, substeps, _)) = (simulator.inputs(), simulator.step_parts());
        let steps = if straight && !delayed { 1 } else { substeps };
        let (field, observation) = (field_tape(model), observation_tape(model));
        Self {
            simulator,
            field_drive: Drive::new(&field, inputs, steps),
            field,
            observation_drive: Drive::new(&observation, inputs, 1),
            observation,
            initial: model.states().iter().map(|state| state.initial).collect(),
            measured: measured.to_vec(),
            estimated: (0..model.parameters().len()).map(|index| estimated.contains(&index)).collect(),
            linear,
            steps,
            hours: inputs.hours() / steps as f64,
        }
    }

    /// Whether the steps are exact.
    pub fn is_linear(&self) -> bool {
        self.linear
    }

    /// Minus the logarithm of the likelihood of samples `0..until`, constants included, and how many
    /// innovations there were. `None` where the filter leaves the numbers.
    pub fn value(&self, point: &[f64], until: usize) -> Option<(f64, usize)> {
        let innovations = self.pass(point, until)?;
        let value: f64 = innovations.iter().map(|(error, variance)| term(*error, *variance)).sum();
        value.is_finite().then_some((value, innovations.len()))
    }

    /// The one-step innovations of samples `0..until` and their variances, output by output within a sample.
    pub fn innovations(&self, point: &[f64], until: usize) -> Option<Vec<(f64, f64)>> {
        self.pass(point, until)
    }

    /// The same with the slopes by the coordinates that `active` names.
    pub fn slopes(&self, point: &[f64], active: &[usize], until: usize) -> Option<Slopes> {
        let d = active.len();
        let (value, innovations) = self.value(point, until)?;
        let mut slopes = Slopes { value, gradient: vec![0.0; d], information: vec![0.0; d * d] };
        // Rows whose squares sum to the information: the innovation's slope over its deviation, and that of
        // its variance.
        let mut rows = vec![0.0; 2 * innovations * d];
        for (chunk, part) in active.chunks(24).enumerate() {
            let first = 24 * chunk;
            match part.len() {
                0..=8 => self.directions::<8>(point, part, until, first, &mut slopes.gradient, &mut rows)?,
                9..=12 => {
                    self.directions::<12>(point, part, until, first, &mut slopes.gradient, &mut rows)?
                }
                13..=16 => {
                    self.directions::<16>(point, part, until, first, &mut slopes.gradient, &mut rows)?
                }
                _ => self.directions::<24>(point, part, until, first, &mut slopes.gradient, &mut rows)?,
            }
        }
        for row in rows.chunks(d.max(1)) {
            for i in 0..d {
                for j in 0..=i {
                    slopes.information[i * d + j] += row[i] * row[j];
                }
            }
        }
        for i in 0..d {
            for j in 0..i {
                slopes.information[j * d + i] = slopes.information[i * d + j];
            }
        }
        let finite = slopes.gradient.iter().chain(&slopes.information).all(|value| value.is_finite());
        finite.then_some(slopes)
    }

    /// The slopes in up to `W` directions.
    fn directions<const W: usize>(
        &self,
        point: &[f64],
        active: &[usize],
        until: usize,
        first: usize,
        gradient: &mut [f64],
        rows: &mut [f64],
    ) -> Option<()> {
        let mut dual: Vec<Dual<W>> = point.iter().map(|value| Dual::constant(*value)).collect();
        for (direction, coordinate) in active.iter().enumerate() {
            dual[*coordinate] = Dual::variable(point[*coordinate], direction);
        }
        let width = gradient.len();
        for (index, (error, variance)) in self.pass(&dual, until)?.iter().enumerate() {
            let (e, s) = (error.value(), variance.value());
            let deviation = s.sqrt();
            for lane in 0..active.len() {
                let (by_error, by_variance) = (error.slopes()[lane], variance.slopes()[lane]);
                gradient[first + lane] += e / s * by_error + 0.5 * (1.0 / s - (e / s).powi(2)) * by_variance;
                rows[2 * index * width + first + lane] = by_error / deviation;
                rows[(2 * index + 1) * width + first + lane] =
                    by_variance * std::f64::consts::FRAC_1_SQRT_2 / s;
            }
        }
        Some(())
    }

    /// The filter. `None` where it leaves the numbers.
    fn pass<T: Scalar>(&self, point: &[T], until: usize) -> Option<Vec<Innovation<T>>> {
        let n = self.initial.len();
        let (theta, noise) = point.split_at(self.estimated.len());
        let (process, sensor) = noise.split_at(n);
        let mut walk = Walk {
            x: vec![T::constant(0.0); n],
            p: vec![T::constant(0.0); n * n],
            q: process.iter().map(|sigma| *sigma * *sigma).collect(),
            r: sensor.iter().map(|sigma| *sigma * *sigma).collect(),
            scratch: vec![T::constant(0.0); n * n],
            jacobian: vec![T::constant(0.0); n * n],
            kept: Vec::new(),
            next: 0,
            moved: false,
        };
        let (step_tape, ..) = self.simulator.step_parts();
        let mut field = Registers::new(&self.field, theta, self.hours);
        let mut step = (!self.linear).then(|| Registers::new(step_tape, theta, self.hours));
        let mut observation = Registers::new(&self.observation, theta, 0.0);
        let mut innovations = Vec::new();
        let mut meter = Meter::new(self.simulator.brake());
        let tapes = self.field.step.len() + step.as_ref().map_or(0, |_| step_tape.step.len());
        let work = self.steps * (2 * n.pow(3) + tapes) * (size_of::<T>() / size_of::<f64>());
        let inputs = self.simulator.inputs();
        for k in 0..until.min(inputs.samples()) {
            let started = k == 0 || !inputs.known(k - 1);
            meter.add(work);
            if started {
                self.start(k, theta, &mut walk);
            } else {
                walk.moved = true;
                for part in 0..self.steps {
                    match &mut step {
                        None => self.exact_step(k - 1, part, &mut field, &mut walk)?,
                        Some(step) => self.extended_step(k - 1, part, &mut field, step, &mut walk)?,
                    }
                }
                if walk.x.iter().any(|x| diverged(x.value().abs())) {
                    return None;
                }
            }
            for (output, (values, valid)) in self.measured.iter().enumerate() {
                let began = started && self.initial.contains(&Initial::Measured(output));
                if valid[k] && !began {
                    self.observation_drive.feed(&mut observation, k, 0);
                    observation.step(&walk.x);
                    innovations.push(walk.update(output, values[k], &observation)?);
                }
            }
        }
        Some(innovations)
    }

    /// State and covariance where the filter starts.
    fn start<T: Scalar>(&self, k: usize, theta: &[T], walk: &mut Walk<T>) {
        let n = self.initial.len();
        walk.p.fill(T::constant(0.0));
        for (state, initial) in self.initial.iter().enumerate() {
            let place = state * n + state;
            match initial {
                Initial::Measured(output) => {
                    let (values, valid) = self.measured[*output];
                    walk.p[place] = walk.r[*output];
                    if valid[k] {
                        walk.x[state] = T::constant(values[k]);
                    } else {
                        // The next measurements say where it is, but they are yet to come.
                        let later = self.simulator.measured_start_at(*output, k).map(T::constant);
                        walk.x[state] = later.unwrap_or(walk.x[state]);
                        walk.p[place] = walk.p[place] + T::constant(HIDDEN_VARIANCE);
                    }
                }
                Initial::Parameter(parameter) => {
                    if k == 0 {
                        walk.x[state] = theta[*parameter];
                    }
                    let exact = !walk.moved && self.estimated[*parameter];
                    walk.p[place] = T::constant(if exact { 0.0 } else { HIDDEN_VARIANCE });
                }
                // What starts at a known value is known; behind a gap it goes on from where it was.
                Initial::Fixed(value) => {
                    if k == 0 {
                        walk.x[state] = T::constant(*value);
                    }
                }
            }
        }
    }

    /// A step of a linear model: exact for inputs that are held or move along a straight line.
    fn exact_step<T: Scalar>(
        &self,
        k: usize,
        part: usize,
        field: &mut Registers<T>,
        walk: &mut Walk<T>,
    ) -> Option<()> {
        let n = walk.x.len();
        self.field_drive.feed(field, k, part);
        field.step(&walk.x);
        walk.linearise(field);
        let place = match walk.kept.iter().position(|(jacobian, _)| *jacobian == walk.jacobian) {
            Some(place) => place,
            None => {
                let brake = self.simulator.brake();
                let step = (
                    walk.jacobian.clone(),
                    Transition::new(&walk.jacobian, &walk.q, self.hours, true, brake)?,
                );
                if walk.kept.len() < KEPT {
                    walk.kept.push(step);
                } else {
                    walk.kept[walk.next % KEPT] = step;
                }
                let place = walk.next % KEPT;
                walk.next += 1;
                place
            }
        };
        let step = &walk.kept[place].1;
        for i in 0..n {
            let mut moved = walk.x[i];
            for j in 0..n {
                moved =
                    moved + step.psi[i * n + j] * field.root(j) + step.ramp[i * n + j] * field.root(n + j);
            }
            walk.x[i] = moved;
        }
        propagate(&mut walk.p, &step.phi, &step.noise, &mut walk.scratch, n);
        Some(())
    }

    /// A step of any other model.
    fn extended_step<T: Scalar>(
        &self,
        k: usize,
        part: usize,
        field: &mut Registers<T>,
        step: &mut Registers<T>,
        walk: &mut Walk<T>,
    ) -> Option<()> {
        let n = walk.x.len();
        self.field_drive.feed(field, k, part);
        field.step(&walk.x);
        walk.linearise(field);
        let transition = Transition::new(&walk.jacobian, &walk.q, self.hours, false, self.simulator.brake())?;
        let (_, drive, ..) = self.simulator.step_parts();
        drive.feed(step, k, part);
        step.step(&walk.x);
        (0..n).for_each(|state| walk.x[state] = step.root(state));
        propagate(&mut walk.p, &transition.phi, &transition.noise, &mut walk.scratch, n);
        Some(())
    }
}

/// A filter on its way.
struct Walk<T> {
    /// Mean and covariance of the states.
    x: Vec<T>,
    p: Vec<T>,
    /// Variances of the diffusion per hour, and of the sensors.
    q: Vec<T>,
    r: Vec<T>,
    scratch: Vec<T>,
    jacobian: Vec<T>,
    /// Steps by their Jacobian, and how many there were.
    kept: Vec<(Vec<T>, Transition<T>)>,
    next: usize,
    /// Whether it has made a step yet: the past that a delay looks back at is no part of the way.
    moved: bool,
}

impl<T: Scalar> Walk<T> {
    fn linearise(&mut self, field: &Registers<T>) {
        let n = self.x.len();
        self.jacobian.iter_mut().enumerate().for_each(|(place, slope)| *slope = field.root(2 * n + place));
    }

    /// Takes one measurement in; the innovation and its variance.
    fn update(&mut self, output: usize, value: f64, observation: &Registers<T>) -> Option<Innovation<T>> {
        let n = self.x.len();
        let first = output * (n + 1);
        let slope = |i: usize| observation.root(first + 1 + i);
        let error = T::constant(value) - observation.root(first);
        let mut variance = self.r[output];
        for i in 0..n {
            let mut spread = self.p[i * n] * slope(0);
            for j in 1..n {
                spread = spread + self.p[i * n + j] * slope(j);
            }
            self.scratch[i] = spread;
            variance = variance + slope(i) * spread;
        }
        let usable = variance.value() > 0.0 && variance.value().is_finite() && error.value().is_finite();
        let gain = T::constant(1.0) / variance;
        for i in 0..n {
            let weighted = self.scratch[i] * gain;
            self.x[i] = self.x[i] + weighted * error;
            for j in 0..=i {
                let less = self.p[i * n + j] - weighted * self.scratch[j];
                (self.p[i * n + j], self.p[j * n + i]) = (less, less);
            }
        }
        usable.then_some((error, variance))
    }
}

/// Minus the logarithm of a normal density.
fn term(error: f64, variance: f64) -> f64 {
    0.5 * (error * error / variance + variance.ln() + std::f64::consts::TAU.ln())
}
