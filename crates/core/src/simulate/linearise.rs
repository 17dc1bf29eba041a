//! The linear discrete model along a trajectory: what a step does to small changes of states and inputs.
//!
//! `x(k+1) = A x(k) + B u(k) + E u(k+1) + offset` and `y(k) = C x(k) + D u(k) + offset`, where inputs that
//! are held have nothing in E. The equations are linearised in the middle of short stretches, each of which
//! is stepped exactly (`transition`); stretches are halved until the extrapolated matrices stay as they
//! are, so that models with constant coefficients are exact at once and others are to some nine digits.

use super::drive::{Drive, Inputs};
use super::kalman::Noise;
use super::registers::Registers;
use super::transition::{Transition, propagate};
use crate::interrupt::Brake;
use crate::model::derivative::derivatives;
use crate::model::entrance::entrances;
use crate::model::expr::NodeId;
use crate::model::tape::{Tape, schedule};
use crate::model::{InputHold, Model};
use std::ops::Range;

/// Where the matrices of two divisions agree, relative to the largest entry.
const AGREED: f64 = 1e-9;
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
    /// Equations, their explicit derivatives by time, and their derivatives by states and by what enters.
    field: Tape,
    /// Each output, with its derivatives by states and by what enters.
    observation: Tape,
    observation_drive: Drive,
}

/// The variances of the process noise, state by state.
fn variances(noise: &Noise) -> Vec<f64> {
    noise.process.iter().map(|sigma| sigma * sigma).collect()
}

impl<'a> Linearisation<'a> {
    /// Differentiates the equations by everything that enters them.
    pub fn new(model: &'a Model, inputs: &'a Inputs, theta: &'a [f64]) -> Self {
        let mut graph = model.graph().clone();
        let outputs: Vec<NodeId> = model.outputs().iter().map(|output| output.node).collect();
        let roots: Vec<NodeId> = model.rhs().iter().chain(&outputs).copied().collect();
        let leaves = entrances(model);
        let entering =
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
        Self { model, inputs, theta, entering, field, observation, observation_drive }
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
        self.chained(samples, states, &variances(noise), FINEST, brake, &mut drives)
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
        let q = variances(noise);
        let mut drives = Vec::new();
        let mut chained = |samples: Range<usize>, start: &[f64], finest: usize| {
            self.chained(samples, start, &q, finest, brake, &mut drives)
        };
        stretches
            .map(|(samples, start)| {
                chained(samples.clone(), start, 2).or_else(|| chained(samples, start, FINEST))
            })
            .collect()
    }

    /// The steps from each of these samples to the next along one trajectory, each in at most so many parts.
    fn chained(
        &self,
        samples: Range<usize>,
        states: &[f64],
        q: &[f64],
        finest: usize,
        brake: &Brake,
        drives: &mut Vec<Drive>,
    ) -> Option<Vec<LinearStep>> {
        let mut steps: Vec<LinearStep> = Vec::new();
        for k in samples {
            let start = steps.last().map_or(states, |step| &step.next).to_vec();
            steps.push(self.step_from(k, start, q, finest, brake, drives)?);
        }
        Some(steps)
    }

    /// The steps from each of these samples to the next, each from states of its own, in two stretches: near
    /// enough to filter by, where many parameters are tried.
    pub fn steps_along<'s>(
        &self,
        samples: impl Iterator<Item = (usize, &'s [f64])>,
        noise: &Noise,
        brake: &Brake,
    ) -> Option<Vec<LinearStep>> {
        let q = variances(noise);
        let mut drives = Vec::new();
        samples.map(|(k, start)| self.step_from(k, start.to_vec(), &q, 2, brake, &mut drives)).collect()
    }

    /// The step from a sample to the next, in at most so many stretches. `drives` are what divisions of a
    /// step are driven by, as far as they were needed.
    fn step_from(
        &self,
        k: usize,
        start: Vec<f64>,
        q: &[f64],
        finest: usize,
        brake: &Brake,
        drives: &mut Vec<Drive>,
    ) -> Option<LinearStep> {
        let mut divided = |level: usize| {
            if drives.len() == level {
                drives.push(Drive::new(&self.field, self.inputs, 2 << level));
            }
            self.divided(&drives[level], k, 1 << level, &start, q, brake)
        };
        let mut coarse = divided(0)?;
        let mut best: Option<Flow> = None;
        for level in 1.. {
            let fine = divided(level)?;
            let next = fine.extrapolated(&coarse);
            let agree = best.as_ref().unwrap_or(&coarse).is_near(&next);
            (coarse, best) = (fine, Some(next));
            if agree || 1 << level >= finest {
                break;
            }
        }
        Some(self.step(k, start, best?))
    }

    /// What becomes of states and small changes over an interval that is divided into so many stretches.
    fn divided(
        &self,
        drive: &Drive,
        k: usize,
        parts: usize,
        start: &[f64],
        q: &[f64],
        brake: &Brake,
    ) -> Option<Flow> {
        let (n, m) = (start.len(), self.entering.len());
        let whole = self.inputs.hours();
        let hours = whole / parts as f64;
        let mut registers = Registers::new(&self.field, self.theta, hours / 2.0);
        let mut flow = Flow {
            x: start.to_vec(),
            a: (0..n * n).map(|place| f64::from(place / n == place % n)).collect(),
            b: vec![0.0; n * m],
            e: vec![0.0; n * m],
            g: vec![0.0; n * n],
            q: vec![0.0; n * n],
        };
        let mut scratch = vec![0.0; n * n];
        let jacobian = |registers: &Registers<f64>| -> Vec<f64> {
            (0..n * n).map(|place| registers.root(2 * n + place)).collect()
        };
        for part in 0..parts {
            drive.feed(&mut registers, k, 2 * part);
            registers.step(&flow.x);
            let half = Transition::new(&jacobian(&registers), q, hours / 2.0, true, brake)?;
            let moved = |i: usize, j: usize| {
                half.psi[i * n + j] * registers.root(j) + half.ramp[i * n + j] * registers.root(n + j)
            };
            let middle: Vec<f64> =
                (0..n).map(|i| flow.x[i] + (0..n).map(|j| moved(i, j)).sum::<f64>()).collect();
            drive.feed(&mut registers, k, 2 * part + 1);
            registers.step(&middle);
            let slope = jacobian(&registers);
            let step = Transition::new(&slope, q, hours, true, brake)?;
            // The rate at the start of the stretch, by what is linearised in its middle.
            let rate: Vec<f64> = (0..n)
                .map(|i| {
                    let back = (0..n).map(|j| slope[i * n + j] * (flow.x[j] - middle[j])).sum::<f64>();
                    registers.root(i) + back - registers.root(n + i) * hours / 2.0
                })
                .collect();
            let change = |i: usize, j: usize| {
                step.psi[i * n + j] * rate[j] + step.ramp[i * n + j] * registers.root(n + j)
            };
            flow.x = (0..n).map(|i| flow.x[i] + (0..n).map(|j| change(i, j)).sum::<f64>()).collect();
            let passed = part as f64 / parts as f64;
            let through = |of: &[f64], i: usize, entrance: usize| -> f64 {
                (0..n).map(|j| of[i * n + j] * registers.root(2 * n + n * n + j * m + entrance)).sum()
            };
            let (mut b, mut e) = (product(&step.phi, &flow.b, n, m), product(&step.phi, &flow.e, n, m));
            for i in 0..n {
                for (entrance, Entering { input, .. }) in self.entering.iter().enumerate() {
                    let place = i * m + entrance;
                    let held = through(&step.psi, i, entrance);
                    match self.model.inputs()[*input].hold {
                        InputHold::ZeroOrder => b[place] += held,
                        InputHold::Linear => {
                            let growing = through(&step.ramp, i, entrance) / whole;
                            b[place] += held * (1.0 - passed) - growing;
                            e[place] += held * passed + growing;
                        }
                    }
                }
            }
            (flow.b, flow.e) = (b, e);
            flow.a = product(&step.phi, &flow.a, n, n);
            flow.g = product(&step.phi, &flow.g, n, n);
            flow.g.iter_mut().zip(&step.psi).for_each(|(g, psi)| *g += psi);
            propagate(&mut flow.q, &step.phi, &step.noise, &mut scratch, n);
        }
        flow.is_finite().then_some(flow)
    }

    /// The step that starts at sample `k`.
    fn step(&self, k: usize, states: Vec<f64>, flow: Flow) -> LinearStep {
        let (n, m) = (states.len(), self.entering.len());
        let mut registers = Registers::new(&self.observation, self.theta, 0.0);
        self.observation_drive.feed(&mut registers, k, 0);
        registers.step(&states);
        let width = 1 + n + m;
        let rows = 0..self.model.outputs().len();
        let part = |from: usize, to: usize| -> Vec<f64> {
            rows.clone()
                .flat_map(|row| (from..to).map(move |place| row * width + place))
                .map(|root| registers.root(root))
                .collect()
        };
        let (c, d) = (part(1, 1 + n), part(1 + n, width));
        let now: Vec<f64> = self.entering.iter().map(|one| self.value(*one, k as f64)).collect();
        let then: Vec<f64> = self.entering.iter().map(|one| self.value(*one, k as f64 + 1.0)).collect();
        let of = |matrix: &[f64], row: usize, by: &[f64]| -> f64 {
            by.iter().enumerate().map(|(column, value)| matrix[row * by.len() + column] * value).sum()
        };
        let offset = (0..n)
            .map(|i| flow.x[i] - of(&flow.a, i, &states) - of(&flow.b, i, &now) - of(&flow.e, i, &then))
            .collect();
        let outputs: Vec<f64> = rows.clone().map(|row| registers.root(row * width)).collect();
        let output_offset =
            rows.clone().map(|row| outputs[row] - of(&c, row, &states) - of(&d, row, &now)).collect();
        let Flow { x, a, b, e, g, q } = flow;
        LinearStep { a, b, e, g, offset, q, c, d, output_offset, outputs, states, next: x }
    }

    /// What enters at a position that is counted in samples.
    pub fn value(&self, entering: Entering, position: f64) -> f64 {
        self.inputs.past(entering.input, position - entering.delay / self.inputs.hours())
    }
}

/// What an interval does to states and small changes.
struct Flow {
    x: Vec<f64>,
    a: Vec<f64>,
    b: Vec<f64>,
    e: Vec<f64>,
    g: Vec<f64>,
    q: Vec<f64>,
}

impl Flow {
    fn parts(&self) -> [&Vec<f64>; 6] {
        [&self.x, &self.a, &self.b, &self.e, &self.g, &self.q]
    }

    fn is_finite(&self) -> bool {
        self.parts().into_iter().flatten().all(|value| value.is_finite())
    }

    /// Richardson's extrapolation of a method of order two, from half as many stretches to endlessly many.
    fn extrapolated(&self, coarse: &Self) -> Self {
        let both = |fine: &[f64], coarse: &[f64]| -> Vec<f64> {
            fine.iter().zip(coarse).map(|(fine, coarse)| fine + (fine - coarse) / 3.0).collect()
        };
        Self {
            x: both(&self.x, &coarse.x),
            a: both(&self.a, &coarse.a),
            b: both(&self.b, &coarse.b),
            e: both(&self.e, &coarse.e),
            g: both(&self.g, &coarse.g),
            q: both(&self.q, &coarse.q),
        }
    }

    fn is_near(&self, other: &Self) -> bool {
        self.parts().into_iter().zip(other.parts()).all(|(ours, theirs)| {
            let largest = theirs.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
            ours.iter().zip(theirs).all(|(a, b)| (a - b).abs() <= AGREED * largest)
        })
    }
}

/// The product of a square matrix with one of `m` columns.
fn product(a: &[f64], b: &[f64], n: usize, m: usize) -> Vec<f64> {
    (0..n * m).map(|place| (0..n).map(|k| a[place / m * n + k] * b[k * m + place % m]).sum()).collect()
}
