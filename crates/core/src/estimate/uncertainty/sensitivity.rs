//! What the outputs answer to parameters and starts, around a fit.

use crate::estimate::problem::Problem;
use crate::estimate::problem::starts::MeasuredStart;
use crate::estimate::problem::whiten::{Ar, stride};
use crate::optimise::Candidate;
use crate::simulate::Trajectory;
use nalgebra::DMatrix;

/// How far a start is moved for a difference, in its deviations by the first measurements.
const NUDGE: f64 = 0.1;

/// What the training part answers to the free parameters, in the coordinates of the search.
pub struct Sensitivity {
    /// Weighted outputs by parameters.
    pub(super) jacobian: DMatrix<f64>,
    /// Weighted outputs by the starts of measured states, each counted in its deviation.
    pub(super) to_starts: DMatrix<f64>,
    pub(super) starts: Vec<MeasuredStart>,
    pub(super) blocks: Vec<Block>,
    /// The free run itself.
    pub(super) run: Trajectory,
}

impl Sensitivity {
    /// `None` where nothing is free, a run diverges, or the errors say too little.
    pub fn new(problem: &Problem, theta: &[f64]) -> Option<Self> {
        let space = problem.space();
        if space.is_empty() {
            return None;
        }
        let centre = problem.candidate(theta);
        let mut points = vec![centre.clone()];
        let difference = problem.difference();
        let mut steps = Vec::new();
        for i in 0..space.len() {
            let mut moved = centre.0.clone();
            let step = if moved[i] + difference > 1.0 { -difference } else { difference };
            moved[i] += step;
            steps.push(step);
            points.push(Candidate(moved));
        }
        let thetas: Vec<Vec<f64>> = points.iter().map(|point| problem.theta(point)).collect();
        let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let mut runs = problem.simulator().run(&slices, problem.split().train.end);
        if runs.iter().any(|run| run.diverged) {
            return None;
        }
        let starts = problem.measured_starts();
        let nudged = starts.iter().map(|start| nudge(problem, theta, start)).collect::<Option<Vec<_>>>()?;
        let blocks = blocks(problem, &runs[0])?;
        let rows: usize = blocks.iter().map(|block| block.samples.len()).sum();
        if rows <= space.len() + 1 {
            return None;
        }
        let mut jacobian = DMatrix::zeros(rows, space.len());
        let mut to_starts = DMatrix::zeros(rows, starts.len());
        for (row, (output, k, weight)) in places(&blocks).enumerate() {
            for (i, step) in steps.iter().enumerate() {
                jacobian[(row, i)] =
                    (runs[i + 1].outputs[output][k] - runs[0].outputs[output][k]) / step * weight;
            }
            for (i, run) in nudged.iter().enumerate() {
                to_starts[(row, i)] = (run.outputs[output][k] - runs[0].outputs[output][k]) / NUDGE * weight;
            }
        }
        Some(Self { jacobian, to_starts, starts, blocks, run: runs.swap_remove(0) })
    }
}

/// The run from a start that is moved a little; `None` where it diverges.
fn nudge(problem: &Problem, theta: &[f64], start: &MeasuredStart) -> Option<Trajectory> {
    let now = problem.simulator().measured_start(start.output)?;
    let mut starts = vec![None; problem.model().outputs().len()];
    starts[start.output] = Some(now + NUDGE * start.deviation);
    let simulator = problem.simulator().clone().with_starts(&starts);
    simulator.run(&[theta], problem.split().train.end).pop().filter(|run| !run.diverged)
}

/// The output, the sample and the weight of every row.
pub(super) fn places(blocks: &[Block]) -> impl Iterator<Item = (usize, usize, f64)> {
    blocks
        .iter()
        .enumerate()
        .flat_map(|(output, block)| block.samples.iter().map(move |k| (output, *k, block.weight)))
}

/// The rows of one output: its usable samples, whose gaps interrupt the correlation of its errors, its weight
/// in the cost and the autoregressive model of its weighted errors.
pub(super) struct Block {
    pub samples: Vec<usize>,
    /// The step from one sample to the next where none is missing.
    pub stride: usize,
    pub weight: f64,
    pub ar: Ar,
}

/// The rows of every output; `None` where the errors of one have no autoregressive model.
fn blocks(problem: &Problem, run: &Trajectory) -> Option<Vec<Block>> {
    let measured = problem.measured();
    let weights = if measured.len() == 1 { vec![1.0] } else { problem.weights(run) };
    let block = |(output, weight): (usize, f64)| {
        let samples = problem.usable(output, problem.split().train.clone());
        let stride = stride(&samples);
        let ar = Ar::fit_samples(&samples, |k| (run.outputs[output][k] - measured[output].0[k]) * weight)?;
        Some(Block { ar, samples, stride, weight })
    };
    weights.into_iter().enumerate().map(block).collect()
}

impl Block {
    /// The same rows with white errors of this deviation, in the unit of the output.
    pub fn as_noisy_as(&self, deviation: f64) -> Self {
        let ar = Ar { coefficients: Vec::new(), deviation: deviation * self.weight, ..self.ar };
        Self { samples: self.samples.clone(), ar, ..*self }
    }

    /// The errors of the run in its rows, weighted.
    pub fn errors(&self, problem: &Problem, output: usize, run: &Trajectory) -> Vec<f64> {
        let (values, _) = problem.measured()[output];
        self.samples.iter().map(|k| (run.outputs[output][*k] - values[*k]) * self.weight).collect()
    }

    /// The rows before this one, by their lag, with the coefficients of the model; fewer than its order
    /// behind a gap.
    pub fn past(&self, row: usize) -> impl Iterator<Item = (usize, f64)> {
        (1..).zip(&self.ar.coefficients).map_while(move |(lag, coefficient)| {
            let past = row.checked_sub(lag)?;
            (self.samples[past] + lag * self.stride == self.samples[row]).then_some((past, *coefficient))
        })
    }
}
