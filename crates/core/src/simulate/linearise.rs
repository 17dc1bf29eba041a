//! The linear discrete model along a trajectory: what a step does to small changes of states and inputs.
//!
//! `x(k+1) = A x(k) + B u(k) + E u(k+1) + offset` and `y(k) = C x(k) + D u(k) + offset`, where inputs that
//! are held have nothing in E. The equations are linearised in the middle of short stretches, each of which
//! is stepped exactly (`transition`); stretches are halved until the extrapolated matrices stay as they
//! are, so that models with constant coefficients are exact at once and others are to some nine digits.

use super::drive::{Drive, Inputs};
use super::flow::{Flow, FlowModel, LaneFlow};
use super::kalman::Noise;
use super::lane::Lane;
use super::lanes::LaneFile;
use crate::interrupt::Brake;
use crate::model::derivative::derivatives;
use crate::model::entrance::{Entrance, entrances};
use crate::model::expr::NodeId;
use crate::model::tape::{Tape, schedule};
use crate::model::{InputHold, Model};
use std::ops::Range;

/// Samples side by side.
const WIDTH: usize = 8;
/// The finest division of a step. What has kinks need not agree at any.
const FINEST: usize = 128;

/// What enters the equations with one parameter vector: an input, now or some time ago.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entering {
    /// The input.
    pub input: usize,
    /// How long ago, in hours.
    pub delay: f64,
}

/// Where a step begins.
#[derive(Debug, Clone, PartialEq)]
pub struct StepStart {
    /// The sample.
    pub sample: usize,
    /// The states there.
    pub states: Vec<f64>,
    /// A steady rate, per hour, on top of each state's own; of none where it is empty.
    pub on_top: Vec<f64>,
}

/// One step of the linear model; matrices by rows.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearStep {
    /// States by states.
    pub a: Vec<f64>,
    /// States by what enters, as it is at the start of the step.
    pub b: Vec<f64>,
    /// States by what enters, as it is at its end; zero for held inputs.
    pub e: Vec<f64>,
    /// States by a steady rate of change, per hour, that comes on top of each state's own.
    pub g: Vec<f64>,
    /// What no state and no input explains of the states at the end.
    pub offset: Vec<f64>,
    /// The covariance that the process noise adds.
    pub q: Vec<f64>,
    /// Outputs by states, at the start.
    pub c: Vec<f64>,
    /// Outputs by what enters, at the start.
    pub d: Vec<f64>,
    /// What no state and no input explains of the outputs.
    pub output_offset: Vec<f64>,
    /// The outputs at the start.
    pub outputs: Vec<f64>,
    /// The states at the start, where the model was linearised.
    pub states: Vec<f64>,
    /// The states at the end.
    pub next: Vec<f64>,
}

/// A model with one parameter vector on the inputs of a window, ready to be linearised.
#[derive(Debug)]
pub struct Linearisation<'a> {
    model: &'a Model,
    inputs: &'a Inputs,
    theta: &'a [f64],
    entering: Vec<Entering>,
    flow: FlowModel,
    /// Each output, with its derivatives by states and by what enters.
    observation: Tape,
    observation_drive: Drive,
}

impl<'a> Linearisation<'a> {
    /// Differentiates the equations by everything that enters them.
    pub fn new(model: &'a Model, inputs: &'a Inputs, theta: &'a [f64]) -> Self {
        Self::by(&entrances(model), model, inputs, theta)
    }

    /// The same by the states alone: what enters is all in the offsets, and how the equations lean on it
    /// neither has to be a number nor to agree between divisions of a step.
    pub fn of_states(model: &'a Model, inputs: &'a Inputs, theta: &'a [f64]) -> Self {
        Self::by(&[], model, inputs, theta)
    }

    fn by(leaves: &[Entrance], model: &'a Model, inputs: &'a Inputs, theta: &'a [f64]) -> Self {
        let mut graph = model.graph().clone();
        let outputs: Vec<NodeId> = model.outputs().iter().map(|output| output.node).collect();
        let roots: Vec<NodeId> = model.rhs().iter().chain(&outputs).copied().collect();
        let entering: Vec<Entering> =
            leaves.iter().map(|one| Entering { input: one.input, delay: one.delay(&graph, theta) }).collect();
        let by_leaf: Vec<Vec<NodeId>> =
            leaves.iter().map(|one| derivatives(&mut graph, &roots, one.leaf)).collect();
        let n = model.states().len();
        let slopes = |root: usize| by_leaf.iter().map(move |column| column[root]);
        let mut nodes: Vec<NodeId> = model.rhs().iter().chain(model.rate()).copied().collect();
        nodes.extend(model.jacobian().iter().flatten());
        nodes.extend((0..n).flat_map(slopes));
        let of_output = |(index, output): (usize, &crate::model::Output)| -> Vec<NodeId> {
            [output.node]
                .into_iter()
                .chain(output.gradient.iter().copied())
                .chain(slopes(n + index))
                .collect()
        };
        let observed: Vec<NodeId> = model.outputs().iter().enumerate().flat_map(of_output).collect();
        let tape = |nodes: &[NodeId]| schedule(&graph, nodes, model.parameters().len(), n);
        let (field, observation) = (tape(&nodes), tape(&observed));
        let observation_drive = Drive::new(&observation, inputs, 1);
        let held = entering.iter().map(|one| model.inputs()[one.input].hold == InputHold::ZeroOrder);
        let flow = FlowModel { field, hours: inputs.hours(), held: held.collect() };
        Self { model, inputs, theta, entering, flow, observation, observation_drive }
    }

    /// What enters the equations, in the order of the columns.
    pub fn entering(&self) -> &[Entering] {
        &self.entering
    }

    /// The steps from each of these samples to the next, along the trajectory that starts at the first of
    /// them at `states`; `None` where it leaves the numbers. `noise` says how unsure each step is.
    pub fn steps(
        &self,
        samples: Range<usize>,
        states: &[f64],
        noise: &Noise,
        brake: &Brake,
    ) -> Option<Vec<LinearStep>> {
        let mut drives = Vec::new();
        self.chained::<1>(&[(samples, states)], noise, FINEST, brake, &mut drives).pop().flatten()
    }

    /// The steps of several stretches of samples, each along the trajectory that starts at its first one,
    /// and each step in two parts: near enough for small changes. A stretch that leaves the numbers so is
    /// taken in as many as it needs.
    pub fn stretches<'s>(
        &self,
        stretches: impl Iterator<Item = (Range<usize>, &'s [f64])>,
        noise: &Noise,
        brake: &Brake,
    ) -> Option<Vec<Vec<LinearStep>>> {
        let mut drives = Vec::new();
        let stretches: Vec<(Range<usize>, &[f64])> = stretches.collect();
        let mut found = Vec::with_capacity(stretches.len());
        for some in stretches.chunks(WIDTH) {
            let steps = self.chained::<WIDTH>(some, noise, 2, brake, &mut drives);
            for (steps, stretch) in steps.into_iter().zip(some) {
                let alone = std::slice::from_ref(stretch);
                let mut finely =
                    || self.chained::<1>(alone, noise, FINEST, brake, &mut drives).pop().flatten();
                found.push(steps.or_else(&mut finely)?);
            }
        }
        Some(found)
    }

    /// The steps of at most so many stretches side by side, each along its trajectory and each step in at
    /// most so many parts.
    fn chained<const W: usize>(
        &self,
        stretches: &[(Range<usize>, &[f64])],
        noise: &Noise,
        finest: usize,
        brake: &Brake,
        drives: &mut Vec<Drive>,
    ) -> Vec<Option<Vec<LinearStep>>> {
        let longest = stretches.iter().map(|(samples, _)| samples.len()).max().unwrap_or(0);
        let mut chains: Vec<Option<Vec<LinearStep>>> = stretches.iter().map(|_| Some(Vec::new())).collect();
        for passed in 0..longest {
            // Those that have ended, or left the numbers, take part no more.
            let goes_on = |place: &usize| chains[*place].is_some() && passed < stretches[*place].0.len();
            let going: Vec<usize> = (0..stretches.len()).filter(goes_on).collect();
            let starts: Vec<StepStart> = going
                .iter()
                .map(|place| {
                    let (samples, start) = &stretches[*place];
                    let last = chains[*place].as_ref().and_then(|chain| chain.last());
                    let states = last.map_or_else(|| start.to_vec(), |step| step.next.clone());
                    StepStart { sample: samples.start + passed, states, on_top: Vec::new() }
                })
                .collect();
            let steps = self.steps_from::<W>(&starts, noise, finest, brake, drives);
            for (place, step) in going.into_iter().zip(steps) {
                match (&mut chains[place], step) {
                    (Some(chain), Some(step)) => chain.push(step),
                    (chain, _) => *chain = None,
                }
            }
        }
        chains
    }

    /// The steps from each of these samples to the next, each from states of its own, in two stretches: near
    /// enough to filter by, where many parameters are tried.
    pub fn steps_along(&self, starts: &[StepStart], noise: &Noise, brake: &Brake) -> Option<Vec<LinearStep>> {
        let mut drives = Vec::new();
        let mut steps = Vec::with_capacity(starts.len());
        for some in starts.chunks(WIDTH) {
            for step in self.steps_from::<WIDTH>(some, noise, 2, brake, &mut drives) {
                steps.push(step?);
            }
        }
        Some(steps)
    }

    /// The steps from at most so many samples to the next side by side, each in at most so many stretches;
    /// `None` of those that leave the numbers. `drives` are what divisions of a step are driven by, as far as
    /// they were needed.
    fn steps_from<const W: usize>(
        &self,
        starts: &[StepStart],
        noise: &Noise,
        finest: usize,
        brake: &Brake,
        drives: &mut Vec<Drive>,
    ) -> Vec<Option<LinearStep>> {
        let Some(last) = starts.len().checked_sub(1) else { return Vec::new() };
        // Lanes more repeat the last sample.
        let of_lane = |lane: usize| &starts[lane.min(last)];
        let at: [usize; W] = std::array::from_fn(|lane| of_lane(lane).sample);
        let n = self.model.states().len();
        let lanes = |value: &dyn Fn(&StepStart, usize) -> f64| -> Vec<Lane<W>> {
            (0..n).map(|state| Lane(std::array::from_fn(|lane| value(of_lane(lane), state)))).collect()
        };
        let states = lanes(&|start, state| start.states[state]);
        let on_top = lanes(&|start, state| start.on_top.get(state).copied().unwrap_or(0.0));
        let divided = |level: usize, drives: &mut Vec<Drive>| {
            if drives.len() == level {
                drives.push(Drive::new(&self.flow.field, self.inputs, 2 << level));
            }
            self.flow.divided(self.theta, noise, (&drives[level], at), 1 << level, (&states, &on_top), brake)
        };
        let mut coarse = divided(0, drives);
        let mut best: Option<Flow<W>> = None;
        let mut found: [Option<LaneFlow>; W] = std::array::from_fn(|_| None);
        let mut done: [bool; W] = coarse.is_finite().map(|finite| !finite);
        for level in 1.. {
            let fine = divided(level, drives);
            let next = fine.extrapolated(&coarse);
            let agree = best.as_ref().unwrap_or(&coarse).is_near(&next);
            let finite = fine.is_finite();
            for lane in 0..W {
                let ends = !finite[lane] || agree[lane] || 1 << level >= finest;
                if ends && !done[lane] {
                    found[lane] = finite[lane].then(|| next.lane(lane));
                    done[lane] = true;
                }
            }
            if done.iter().all(|done| *done) {
                break;
            }
            (coarse, best) = (fine, Some(next));
        }
        let mut file = LaneFile::<W>::new(&self.observation);
        file.load(&[self.theta], 0.0);
        for (state, value) in states.iter().enumerate() {
            *file.state(state) = value.0;
        }
        for (lane, k) in at.iter().enumerate() {
            self.observation_drive.load_lane(&mut file, lane, *k, 0);
        }
        file.step();
        let roots = self.observation.roots.len();
        let observed = |lane: usize| -> Vec<f64> { (0..roots).map(|root| file.root(root)[lane]).collect() };
        let lanes = starts.iter().zip(found).enumerate();
        lanes.map(|(lane, (start, flow))| Some(self.step(start, flow?, &observed(lane)))).collect()
    }

    /// The step from a start; `observed` are the outputs there with their derivatives.
    fn step(&self, start: &StepStart, flow: LaneFlow, observed: &[f64]) -> LinearStep {
        let StepStart { sample: k, states, on_top } = start;
        let (n, m) = (states.len(), self.entering.len());
        let width = 1 + n + m;
        let rows = 0..self.model.outputs().len();
        let part = |from: usize, to: usize| -> Vec<f64> {
            rows.clone().flat_map(|row| observed[row * width + from..row * width + to].to_vec()).collect()
        };
        let (c, d) = (part(1, 1 + n), part(1 + n, width));
        let now: Vec<f64> = self.entering.iter().map(|one| self.value(*one, *k as f64)).collect();
        let then: Vec<f64> = self.entering.iter().map(|one| self.value(*one, *k as f64 + 1.0)).collect();
        let of = |matrix: &[f64], row: usize, by: &[f64]| -> f64 {
            by.iter().enumerate().map(|(column, value)| matrix[row * by.len() + column] * value).sum()
        };
        let LaneFlow { x, a, b, e, g, q } = flow;
        let on_top = |i: usize| on_top.iter().enumerate().map(|(j, rate)| g[i * n + j] * rate).sum::<f64>();
        let offset = (0..n)
            .map(|i| x[i] - of(&a, i, states) - of(&b, i, &now) - of(&e, i, &then) - on_top(i))
            .collect();
        let outputs: Vec<f64> = rows.clone().map(|row| observed[row * width]).collect();
        let output_offset = rows.map(|row| outputs[row] - of(&c, row, states) - of(&d, row, &now)).collect();
        LinearStep { a, b, e, g, offset, q, c, d, output_offset, outputs, states: states.to_vec(), next: x }
    }

    /// What enters at a position that is counted in samples.
    pub fn value(&self, entering: Entering, position: f64) -> f64 {
        self.inputs.past(entering.input, position - entering.delay / self.inputs.hours())
    }
}
