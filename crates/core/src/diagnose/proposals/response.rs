//! What a flow into a state does to the outputs within each segment: the model's affine steps, taken once.

use super::term::TermSeries;
use crate::diagnose::score_test::Look;
use crate::estimate::Problem;
use crate::simulate::kalman::Noise;
use crate::simulate::linearise::{LinearStep, Linearisation};
use std::ops::Range;

/// A step of small changes.
struct StepResponse {
    /// States by states.
    a: Vec<f64>,
    /// States by a steady rate of change of each.
    g: Vec<f64>,
    /// Outputs by states, at its start, in units of the residual.
    c: Vec<f64>,
    /// The states at its start.
    states: Vec<f64>,
}

/// A row of a matrix times the states.
#[inline]
fn product(row: &[f64], states: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (place, state) in states.iter().enumerate() {
        sum += row[place] * state;
    }
    sum
}

/// A model along its segments, ready to be asked what flows do.
pub(super) struct Responses {
    states: usize,
    /// Each segment's samples, its rows, and its steps; the last step only shows.
    segments: Vec<(Range<usize>, Range<usize>, Vec<StepResponse>)>,
    /// The output and the sample of every row.
    rows: Vec<(usize, usize)>,
}

impl Responses {
    /// Linearises the settled model along its segments. `None` where it leaves the numbers.
    pub fn new(problem: &Problem, look: &Look<'_>) -> Option<Self> {
        let model = problem.model();
        let states = model.states().len();
        let linearisation = Linearisation::of_states(model, problem.inputs(), look.theta());
        let noise = Noise { process: vec![0.0; states], measurement: vec![0.0; model.outputs().len()] };
        // Behind the last sample of the record no input is known.
        let last = problem.grid().len() - 1;
        let stretches = look.pieces().map(|(piece, _, start)| (piece.start..piece.end.min(last), start));
        let steps = linearisation.stretches(stretches, &noise, problem.brake())?;
        let step = |step: LinearStep| StepResponse {
            c: (0..step.c.len()).map(|at| step.c[at] / problem.scale(at / states)).collect(),
            a: step.a,
            g: step.g,
            states: step.states,
        };
        let steps = steps.into_iter().map(|steps| steps.into_iter().map(step).collect());
        let segments =
            look.pieces().zip(steps).map(|((piece, rows, _), steps)| (piece, rows, steps)).collect();
        Some(Self { states, segments, rows: look.rows().collect() })
    }

    /// The state of this place at every sample; where no segment is, nothing.
    pub fn state(&self, place: usize, samples: usize) -> Vec<f64> {
        let mut values = vec![f64::NAN; samples];
        for (piece, _, steps) in &self.segments {
            piece.clone().zip(steps).for_each(|(k, step)| values[k] = step.states[place]);
        }
        values
    }

    /// What a flow into a state does to the outputs, row by row, from the start of each segment on.
    pub fn of(&self, series: &TermSeries, into: usize) -> Vec<f64> {
        let n = self.states;
        let mut direction = vec![0.0; self.rows.len()];
        let mut moved = vec![0.0; n];
        let mut next = vec![0.0; n];
        for (piece, rows, steps) in &self.segments {
            moved.fill(0.0);
            // Rows of a segment are sorted by output, then by sample.
            let outputs = steps.first().map_or(0, |step| step.c.len() / n);
            let mut places: Vec<usize> = (0..outputs)
                .map(|output| rows.start + self.rows[rows.clone()].partition_point(|(of, _)| *of < output))
                .collect();
            for (k, step) in piece.clone().zip(steps) {
                for (output, place) in places.iter_mut().enumerate() {
                    if *place < rows.end && self.rows[*place] == (output, k) {
                        let shows = &step.c[output * n..][..n];
                        direction[*place] = product(shows, &moved);
                        *place += 1;
                    }
                }
                let flow = match &series.from {
                    None => series.rate[k],
                    Some(from) => series.rate[k] * (from[k] - step.states[into]),
                };
                for (i, next) in next.iter_mut().enumerate() {
                    *next = product(&step.a[i * n..][..n], &moved) + step.g[i * n + into] * flow;
                }
                moved.copy_from_slice(&next);
            }
        }
        direction
    }
}
