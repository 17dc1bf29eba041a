//! The residual of a fit over segments of hours with states of their own.
//!
//! Minutes are blurred by sensors, and a free run of weeks is drowned by heat that nobody logged. In between,
//! over segments of hours that each start from unknown states, a model is asked what a controller asks it:
//! where does the room go from here? Each segment's start enters the residual linearly along the fit, so its
//! columns (the response of the outputs to each initial state) are projected out of the residual, of the
//! model's own Jacobian and of every direction that is compared with it; no filter, no order of an
//! autoregression and no model of the noise takes part. This is the multi-step prediction error of
//! identification for control (Shook, Mohtadi and Shah 1991, IEE Proc. D 138, 75-84), by multiple shooting
//! (Bock 1983).
//!
//! Samples of a day lean on each other, days hardly do: statistics are robust by days.

pub mod shooting;

use super::problem::Problem;
use super::problem::predictor::Predictor;
use crate::data::DAY;
use crate::gram::{dot, gram};
use crate::model::Initial;
use crate::simulate::Simulator;
use crate::simulate::segment::Stretch;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::ops::Range;

/// How far the states at a segment's start are moved to see what that does, in the unit of the states.
const START_STEP: f64 = 0.1;
/// A start whose response is this small beside the largest of its segment is none that the outputs could
/// tell.
const UNSEEN_START: f64 = 1e-6;
/// How far a start is believed to lie from where it was expected when it is estimated, in the unit of the
/// states: a slow state is not determined by a few hours.
const START_REACH: f64 = 3.0;
/// How far a start is moved at most, in the same unit. One that is forgotten before its segment has its first
/// measurement is asked for whatever the model errs by, and could lie where no model has numbers.
const START_FARTHEST: f64 = 30.0;
/// How far a parameter is believed to lie from the fit when the linear problem is solved, as a share of what
/// is searched. It keeps what the data do not determine from leaving the reach of the linearisation.
pub const REACH: f64 = 0.3;

/// A record cut into segments: ranges of samples within which all inputs are known.
#[derive(Debug, Clone)]
pub struct Segments {
    pieces: Vec<Range<usize>>,
    /// Output, sample and day of every row.
    rows: Vec<(usize, usize, usize)>,
    /// The rows of each piece.
    of_piece: Vec<Range<usize>>,
    days: usize,
}

impl Segments {
    /// Cuts these samples of a problem into segments of so many hours, each with at least half of them.
    /// Segments with fewer measurements than twice the states are left out. `None` of a large model, whose
    /// states at their starts nobody knows.
    pub fn new(problem: &Problem, samples: Range<usize>, hours: f64) -> Option<Self> {
        match problem.predictor() {
            Predictor::Filtered => Some(Self::cut(problem, samples, hours)),
            Predictor::FreeRun => None,
        }
    }

    fn cut(problem: &Problem, samples: Range<usize>, hours: f64) -> Self {
        let grid = problem.grid();
        let length = ((hours / grid.step_hours()).round() as usize).max(2);
        let mut pieces = Vec::new();
        let mut start = samples.start;
        for k in samples.clone() {
            // A segment ends where it is full, where the inputs are lost and at the end of the samples.
            let last = k + 1 == samples.end || !problem.inputs().known(k);
            if last || k + 1 - start == length {
                if k + 1 - start > length / 2 {
                    pieces.push(start..k + 1);
                }
                start = k + 1;
            }
        }
        let (mut rows, mut of_piece, mut kept) = (Vec::new(), Vec::new(), Vec::new());
        let states = problem.model().states().len();
        for piece in pieces {
            let first = rows.len();
            for (output, (_, valid)) in problem.measured().iter().enumerate() {
                let day = |k: usize| ((grid.time(k) - grid.start()) / DAY) as usize;
                rows.extend(piece.clone().filter(|k| valid[*k]).map(|k| (output, k, day(k))));
            }
            if rows.len() - first < 2 * states {
                rows.truncate(first);
                continue;
            }
            of_piece.push(first..rows.len());
            kept.push(piece);
        }
        let days = rows.iter().map(|(_, _, day)| day + 1).max().unwrap_or(0);
        Self { pieces: kept, rows, of_piece, days }
    }

    /// Whether there is nothing to look at.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The output and the sample of every row.
    pub fn rows(&self) -> impl Iterator<Item = (usize, usize)> {
        self.rows.iter().map(|(output, sample, _)| (*output, *sample))
    }

    /// Sums of a product of two series by the days of the record, for the days that have rows.
    pub fn by_day(&self, product: impl Fn(usize) -> f64) -> Vec<f64> {
        let (mut sums, mut seen) = (vec![0.0; self.days], vec![false; self.days]);
        for (row, (_, _, day)) in self.rows.iter().enumerate() {
            sums[*day] += product(row);
            seen[*day] = true;
        }
        sums.into_iter().zip(seen).filter_map(|(sum, seen)| seen.then_some(sum)).collect()
    }

    /// The model along the segments: one run of each with a lane for the parameters, one for each initial
    /// state and one for each free parameter. `starts` has the states at each segment's first sample. `None`
    /// where a lane leaves the numbers.
    pub fn linearise(
        &self,
        problem: &Problem,
        simulator: &Simulator,
        theta: &[f64],
        starts: &[Vec<f64>],
    ) -> Option<Linear> {
        let states = problem.model().states().len();
        let Moved { along, steps, slopes, thetas: moved } = moved(problem, theta);
        let measured_state =
            problem.model().states().iter().position(|state| state.initial == Initial::Measured(0));
        let n = self.rows.len();
        let measured = problem.measured();
        let (mut simulated, mut residual) = (vec![0.0; n], vec![0.0; n]);
        let mut columns = vec![vec![0.0; n]; steps.len()];
        let (mut bases, mut pulses, mut nearer) =
            (Vec::with_capacity(self.pieces.len()), Vec::new(), Vec::new());
        for ((piece, rows), start) in self.pieces.iter().zip(&self.of_piece).zip(starts) {
            let bumped: Vec<Vec<f64>> = (0..states)
                .map(|state| {
                    let mut bumped = start.clone();
                    bumped[state] += START_STEP;
                    bumped
                })
                .collect();
            let run = |theta, start| Stretch { samples: piece.clone(), theta, start };
            let mut stretches = vec![run(theta, start.as_slice())];
            stretches.extend(bumped.iter().map(|bumped| run(theta, bumped)));
            stretches.extend(moved.iter().map(|moved| run(moved, start)));
            let runs = simulator.run_stretches(&stretches);
            let at = |run: usize, row: usize| {
                let (output, k, _) = self.rows[row];
                runs[run][output][k - piece.start] / problem.scale(output)
            };
            let responses = DMatrix::from_fn(rows.len(), states, |i, state| {
                (at(1 + state, rows.start + i) - at(0, rows.start + i)) / START_STEP
            });
            for row in rows.clone() {
                let (output, k, _) = self.rows[row];
                simulated[row] = at(0, row);
                residual[row] = measured[output].0[k] / problem.scale(output) - simulated[row];
                for (column, step) in steps.iter().enumerate() {
                    columns[column][row] = (at(1 + states + column, row) - at(0, row)) / step;
                }
            }
            let pulse = |state: usize| {
                runs[1 + state][0]
                    .iter()
                    .zip(&runs[0][0])
                    .map(|(bumped, kept)| (bumped - kept) / START_STEP)
                    .collect()
            };
            pulses.push(measured_state.map_or_else(Vec::new, pulse));
            nearer.push(self.nearer(problem, start, &responses, &residual[rows.clone()]));
            bases.push(basis(responses)?);
        }
        if residual.iter().chain(columns.iter().flatten()).any(|value| !value.is_finite()) {
            return None;
        }
        let mut linear = Linear {
            bases,
            simulated,
            residual: Vec::new(),
            columns: Vec::new(),
            along,
            slopes,
            pulses,
            starts: nearer,
            factor: None,
        };
        linear.residual = self.without_starts(&linear, residual);
        linear.columns = columns.into_iter().map(|column| self.without_starts(&linear, column)).collect();
        linear.factor = linear.normal();
        Some(linear)
    }

    /// A start of a segment, moved to where the outputs ask for it.
    fn nearer(
        &self,
        problem: &Problem,
        start: &[f64],
        responses: &DMatrix<f64>,
        residual: &[f64],
    ) -> Vec<f64> {
        let mut normal = responses.tr_mul(responses);
        (0..start.len()).for_each(|i| normal[(i, i)] += (problem.scaled_noise() / START_REACH).powi(2));
        let right = responses.tr_mul(&DVector::from_column_slice(residual));
        let Some(factor) = normal.cholesky() else { return start.to_vec() };
        let step = factor.solve(&right);
        let share = (START_FARTHEST / step.amax()).min(1.0);
        start.iter().zip(step.iter()).map(|(start, step)| start + share * step).collect()
    }

    /// What heat into the first measured state does to the first output, for every `hour` of the day, 0 to
    /// 23: a column each, without starts. All that follows the clock is made of them, in a model that is
    /// nearly linear.
    pub fn by_clock(&self, linear: &Linear, step_hours: f64, hour: impl Fn(usize) -> usize) -> Vec<Vec<f64>> {
        let mut columns = vec![vec![0.0; self.rows.len()]; 24];
        for ((piece, rows), pulse) in self.pieces.iter().zip(&self.of_piece).zip(&linear.pulses) {
            let length = pulse.len();
            let mut answers = vec![vec![0.0; length]; 24];
            for k in 0..length {
                let answer = &mut answers[hour(piece.start + k)];
                // Heat over a step is a pulse somewhere within it: the mean of one at its start and one at
                // its end.
                let means = pulse.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
                answer[k + 1..].iter_mut().zip(means).for_each(|(answer, mean)| *answer += step_hours * mean);
            }
            for row in rows.clone().filter(|row| length > 0 && self.rows[*row].0 == 0) {
                columns
                    .iter_mut()
                    .zip(&answers)
                    .for_each(|(column, answer)| column[row] = answer[self.rows[row].1 - piece.start]);
            }
        }
        columns.into_iter().map(|column| self.without_starts(linear, column)).collect()
    }

    /// Which rows lie before a sample.
    pub fn before(&self, sample: usize) -> Vec<bool> {
        self.rows.iter().map(|(_, k, _)| *k < sample).collect()
    }

    /// The outputs along the segments for some parameter vectors, row by row, from the same starts.
    pub fn outputs(
        &self,
        problem: &Problem,
        simulator: &Simulator,
        thetas: &[&[f64]],
        starts: &[Vec<f64>],
    ) -> Vec<Vec<f64>> {
        let pieces = self.pieces.iter().zip(starts);
        let stretches: Vec<Stretch> = pieces
            .flat_map(|(piece, start)| {
                thetas.iter().map(|theta| Stretch { samples: piece.clone(), theta, start })
            })
            .collect();
        let runs = simulator.run_stretches(&stretches);
        let mut values = vec![vec![0.0; self.rows.len()]; thetas.len()];
        for ((piece, rows), runs) in self.pieces.iter().zip(&self.of_piece).zip(runs.chunks(thetas.len())) {
            for (values, run) in values.iter_mut().zip(runs) {
                for row in rows.clone() {
                    let (output, k, _) = self.rows[row];
                    values[row] = run[output][k - piece.start] / problem.scale(output);
                }
            }
        }
        values
    }

    /// What is left of a series when each segment's start has explained what it can.
    pub fn without_starts(&self, linear: &Linear, mut series: Vec<f64>) -> Vec<f64> {
        for (rows, basis) in self.of_piece.iter().zip(&linear.bases) {
            let part = DVector::from_column_slice(&series[rows.clone()]);
            let rest = &part - basis * basis.tr_mul(&part);
            series[rows.clone()].copy_from_slice(rest.as_slice());
        }
        series
    }

    /// Where the segments start in the free run of a parameter vector: near enough for starts that are
    /// estimated.
    pub fn starts(&self, problem: &Problem, theta: &[f64]) -> Vec<Vec<f64>> {
        let states = problem.simulate(theta).states;
        self.first_samples().map(|k| states.iter().map(|series| series[k]).collect()).collect()
    }

    /// The samples and the rows of every segment.
    pub fn pieces(&self) -> impl Iterator<Item = (Range<usize>, Range<usize>)> {
        self.pieces.iter().cloned().zip(self.of_piece.iter().cloned())
    }

    /// The first sample of every segment.
    pub fn first_samples(&self) -> impl Iterator<Item = usize> {
        self.pieces.iter().map(|piece| piece.start)
    }
}

/// A model along its segments, with the starts projected out of everything.
#[derive(Debug, Clone)]
pub struct Linear {
    /// An orthonormal basis of what each segment's start can explain.
    bases: Vec<DMatrix<f64>>,
    /// What the model simulates along the segments from their starts, as [`Segments::outputs`] gives it.
    pub simulated: Vec<f64>,
    /// Measured less simulated.
    pub residual: Vec<f64>,
    /// The model's own Jacobian, a column for each free parameter, in the unit cube of the search.
    pub columns: Vec<Vec<f64>>,
    /// The parameter of each column, by its place in the full vector.
    pub along: Vec<usize>,
    /// What a unit of the cube is in the parameter's own unit, here.
    pub slopes: Vec<f64>,
    /// What a unit more of the first measured state at a segment's start does to the first output, sample by
    /// sample.
    pulses: Vec<Vec<f64>>,
    /// The states at the segments' starts, moved to where the outputs ask for them.
    pub starts: Vec<Vec<f64>>,
    factor: Option<Cholesky<f64, Dyn>>,
}

impl Linear {
    /// What is left of a series when the model's own parameters have explained what they can, each within its
    /// reach.
    pub fn without_parameters(&self, series: &[f64]) -> Vec<f64> {
        let Some(factor) = &self.factor else { return series.to_vec() };
        let right =
            DVector::from_iterator(self.columns.len(), self.columns.iter().map(|column| dot(column, series)));
        let step = factor.solve(&right);
        let mut rest = series.to_vec();
        for (column, size) in self.columns.iter().zip(step.iter()) {
            rest.iter_mut().zip(column).for_each(|(rest, value)| *rest -= size * value);
        }
        rest
    }

    fn normal(&self) -> Option<Cholesky<f64, Dyn>> {
        let n = self.columns.len();
        if n == 0 {
            return None;
        }
        let mut normal = DMatrix::from_vec(n, n, gram(&slices(&self.columns)));
        let variance = dot(&self.residual, &self.residual) / self.residual.len().max(1) as f64;
        (0..n).for_each(|i| normal[(i, i)] += (variance / REACH.powi(2)).max(1e-12));
        normal.cholesky()
    }
}

/// The columns of a matrix as slices.
pub fn slices(columns: &[Vec<f64>]) -> Vec<&[f64]> {
    columns.iter().map(Vec::as_slice).collect()
}

/// What a direction explains of a residual: both without starts and parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Explained {
    /// How much of the direction is in the residual: 1 is all that was claimed.
    pub size: f64,
    /// The share of the residual that it explains.
    pub share: f64,
    /// The size over its deviation, robust by days.
    pub t: f64,
}

impl Segments {
    /// Regresses a residual on a direction: `c = g.r / g.g`, `R2 = (g.r)^2 / (g.g r.r)`, and with `s_d` the
    /// sum of `g (r - c g)` over the day d, `t = c g.g / sqrt(D/(D-1) sum s_d^2)`. `None` where the direction
    /// is nothing or there are fewer than three days.
    pub fn explained(&self, residual: &[f64], direction: &[f64]) -> Option<Explained> {
        let (gg, gr, rr) = (dot(direction, direction), dot(direction, residual), dot(residual, residual));
        if !(gg > 0.0 && rr > 0.0) {
            return None;
        }
        let size = gr / gg;
        let scores = self.by_day(|row| direction[row] * (residual[row] - size * direction[row]));
        let days = scores.len() as f64;
        if days < 3.0 {
            return None;
        }
        let deviation = (days / (days - 1.0) * scores.iter().map(|score| score * score).sum::<f64>()).sqrt();
        Some(Explained { size, share: gr * gr / (gg * rr), t: gr / deviation.max(f64::MIN_POSITIVE) })
    }
}

/// Forward differences along the free parameters. Those that are a start of the record and nothing else are
/// left out: segments have starts of their own.
pub struct Moved {
    /// The parameter of each, by its place in the full vector.
    pub along: Vec<usize>,
    /// How far it is moved in the unit cube of the search.
    pub steps: Vec<f64>,
    /// What a unit of the cube is in its own unit, here.
    pub slopes: Vec<f64>,
    /// The full vectors.
    pub thetas: Vec<Vec<f64>>,
}

/// Whether a parameter is a start of the record and nothing else.
pub fn is_start(problem: &Problem, index: usize) -> bool {
    problem.model().states().iter().any(|state| state.initial == Initial::Parameter(index))
}

/// Moves every free parameter but the starts a little.
pub fn moved(problem: &Problem, theta: &[f64]) -> Moved {
    let centre = problem.candidate(theta);
    let difference = problem.difference();
    let mut moved = Moved { along: Vec::new(), steps: Vec::new(), slopes: Vec::new(), thetas: Vec::new() };
    for (i, index) in problem.free().iter().enumerate().filter(|(_, index)| !is_start(problem, **index)) {
        let mut there = centre.clone();
        let step = if there.0[i] + difference > 1.0 { -difference } else { difference };
        there.0[i] += step;
        let there = problem.theta(&there);
        moved.along.push(*index);
        moved.steps.push(step);
        moved.slopes.push((there[*index] - theta[*index]) / step);
        moved.thetas.push(there);
    }
    moved
}

/// An orthonormal basis of what the columns span, without those that are too small to be seen.
fn basis(columns: DMatrix<f64>) -> Option<DMatrix<f64>> {
    if columns.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let mut kept: Vec<DVector<f64>> = Vec::new();
    let largest = columns.column_iter().map(|column| column.norm()).fold(0.0, f64::max);
    for column in columns.column_iter() {
        let mut rest = column.clone_owned();
        // Twice is enough for orthogonality to the last digit.
        for _ in 0..2 {
            for known in &kept {
                let part = known.dot(&rest);
                rest.axpy(-part, known, 1.0);
            }
        }
        let size = rest.norm();
        if size > UNSEEN_START * largest && size > 0.0 {
            kept.push(rest / size);
        }
    }
    Some(if kept.is_empty() { DMatrix::zeros(columns.nrows(), 0) } else { DMatrix::from_columns(&kept) })
}

/// How much two directions are the same thing: the cosine between them.
pub fn likeness(a: &[f64], b: &[f64]) -> f64 {
    let norm = |direction: &[f64]| dot(direction, direction).sqrt().max(f64::MIN_POSITIVE);
    dot(a, b) / norm(a) / norm(b)
}
