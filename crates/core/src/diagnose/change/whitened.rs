//! The record as innovations: what every value says that those before it did not, and what a parameter that
//! changes would have it say.
//!
//! A Kalman filter is linear, so a parameter that is another one from a sample on adds to the innovations
//! behind it a series of its own: the deviation of the states from where the filter believes them, which the
//! change feeds and every value corrects (Willsky and Jones 1976, "A generalized likelihood ratio approach to
//! the detection and estimation of jumps in linear systems", IEEE Transactions on Automatic Control 21).

use crate::cpu::{Cpu, Kernel, dispatch};
use crate::data::DAY;
use crate::diagnose::missing_heat::record::{LinearRecord, MissingHeatAsked};
use crate::diagnose::missing_heat::smoother::{likeliest, passed};
use crate::estimate::assess::metrics::{ProcessNoise, filter};
use crate::estimate::segments::is_start;
use crate::model::{Model, Scale};
use crate::simulate::lane::Lane;
use crate::simulate::segment::StepAlong;
use std::ops::Range;

/// The length of a difference: a share of a parameter that is searched by its logarithm, and else of its
/// bounds.
const DIFFERENCE: f64 = 1e-4;
/// Parameters side by side.
const WIDTH: usize = 8;

/// A value of the record, as the filter takes it.
struct Value {
    /// What the states show.
    row: Vec<f64>,
    /// What it moves in them.
    gain: Vec<f64>,
    /// Its deviation.
    deviation: f64,
    output: usize,
}

/// A sample: its values, and the step to the next one by rows.
struct Taken {
    values: Vec<Value>,
    step: Vec<f64>,
}

/// The innovations of a record, and what parameters do to them.
pub(super) struct Whitened {
    samples: Vec<Taken>,
    width: usize,
    states: usize,
    outputs: usize,
    /// By eight parameters, sample by sample.
    pushes: Vec<Vec<Lane<WIDTH>>>,
    /// The parameters that may change, by their places in the full vector.
    pub parameters: Vec<usize>,
    /// How far each of them is believed to lie from where it is, as a deviation in what its change is counted
    /// in: a factor of e, or a quarter of its bounds.
    pub reaches: Vec<f64>,
    /// Innovations in units of their deviations.
    pub innovations: Vec<f64>,
    /// The samples of each day (UTC).
    days: Vec<Range<usize>>,
    /// The first row of each sample, and the number of all rows.
    first_row: Vec<usize>,
    /// The day since 1970 of the first sample.
    pub first_day: i64,
    /// The logarithm of the likelihood of the record, without its constant.
    pub likelihood: f64,
}

/// What the change of a parameter is counted in, in its own unit: by its logarithm, one is a factor of e.
fn unit(model: &Model, parameter: usize, value: f64) -> f64 {
    match model.parameters()[parameter].scale {
        Scale::Log => value,
        Scale::Linear => 1.0,
    }
}

impl Whitened {
    /// Filters a record at these parameters, linearised along a filter of this noise. `None` where the
    /// numbers are left.
    pub fn new(asked: &MissingHeatAsked<'_>, noise: ProcessNoise) -> Option<Self> {
        let MissingHeatAsked { problem, theta, .. } = *asked;
        let model = problem.model();
        let along = filter(problem, theta, noise).filtered.states;
        let record = LinearRecord::new(asked, &along, &[])?;
        let begin = asked.begin();
        let guess = likeliest(&record, begin, begin, problem.brake());
        let (passed, likelihood) = passed(&record, guess);
        // What is summed up over an hour for the missing heat plays no part.
        let width = record.width() - 1;
        let mut innovations = Vec::new();
        let mut first_row = vec![0];
        let mut samples = Vec::new();
        for sample in passed {
            let values = sample.updates.iter().map(|update| {
                innovations.push(update.innovation / update.variance.sqrt());
                Value {
                    row: update.row.as_slice()[..width].to_vec(),
                    gain: update.gain.as_slice()[..width].to_vec(),
                    deviation: update.variance.sqrt(),
                    output: update.output,
                }
            });
            let values: Vec<Value> = values.collect();
            first_row.push(innovations.len());
            let step = sample.step.map_or_else(Vec::new, |step| {
                (0..width * width).map(|place| step[(place / width, place % width)]).collect()
            });
            samples.push(Taken { values, step });
        }
        if innovations.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let parameters: Vec<usize> =
            problem.free().iter().copied().filter(|index| !is_start(problem, *index)).collect();
        let length = |index: usize| {
            let [lower, upper] = problem.bounds()[index];
            match model.parameters()[index].scale {
                Scale::Log => DIFFERENCE * theta[index],
                Scale::Linear => DIFFERENCE * (upper - lower),
            }
        };
        let moved = |index: &usize| {
            let mut moved = theta.to_vec();
            moved[*index] += length(*index);
            moved
        };
        let thetas: Vec<Vec<f64>> =
            std::iter::once(theta.to_vec()).chain(parameters.iter().map(moved)).collect();
        let thetas: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let steps = problem.simulator().steps_along(&along, &thetas);
        // By eight parameters and sample: what a unit of each does to the states until the next one, and to
        // the outputs.
        let (states, outputs) = (model.states().len(), model.outputs().len());
        let by: Vec<f64> =
            parameters.iter().map(|index| unit(model, *index, theta[*index]) / length(*index)).collect();
        let pushes = (0..parameters.len()).step_by(WIDTH).map(|first| -> Vec<Lane<WIDTH>> {
            let places = WIDTH.min(parameters.len() - first);
            let slope = |of: &dyn Fn(&StepAlong) -> f64, step: &[StepAlong]| {
                let mut lanes = [0.0; WIDTH];
                for (lane, place) in (first..first + places).enumerate() {
                    lanes[lane] = (of(&step[1 + place]) - of(&step[0])) * by[place];
                }
                Lane(lanes)
            };
            let of_sample = |step: &Vec<StepAlong>| -> Vec<Lane<WIDTH>> {
                let to_states = (0..states).map(|i| slope(&|along| along.states[i], step));
                to_states.chain((0..outputs).map(|i| slope(&|along| along.outputs[i], step))).collect()
            };
            steps.iter().flat_map(of_sample).collect()
        });
        let pushes = pushes.collect();
        let reach = |index: &usize| match model.parameters()[*index].scale {
            Scale::Log => 1.0,
            Scale::Linear => (problem.bounds()[*index][1] - problem.bounds()[*index][0]) / 4.0,
        };
        let reaches = parameters.iter().map(reach).collect();
        let grid = problem.grid();
        let day = |k: usize| grid.time(k).div_euclid(DAY);
        let first_day = day(0);
        let mut days: Vec<Range<usize>> = Vec::new();
        for k in 0..grid.len() {
            let at = (day(k) - first_day) as usize;
            while days.len() <= at {
                days.push(k..k);
            }
            days[at].end = k + 1;
        }
        Some(Self {
            samples,
            width,
            states,
            outputs,
            pushes,
            parameters,
            reaches,
            innovations,
            days,
            first_row,
            first_day,
            likelihood,
        })
    }

    /// How many days the record has.
    pub fn days(&self) -> usize {
        self.days.len()
    }

    /// The rows of some days.
    pub fn rows(&self, days: Range<usize>) -> Range<usize> {
        let sample = |day: usize| self.days.get(day).map_or(self.samples.len(), |samples| samples.start);
        self.first_row[sample(days.start)]..self.first_row[sample(days.end)]
    }

    /// What a unit more of each parameter that may change does to the innovations of some days where it comes
    /// with the first of them.
    pub fn directions(&self, days: Range<usize>) -> Vec<Vec<f64>> {
        let (Some(first), Some(last)) = (self.days.get(days.start), self.days.get(days.end.wrapping_sub(1)))
        else {
            return vec![Vec::new(); self.parameters.len()];
        };
        let samples = first.start..last.end;
        let mut directions = Vec::with_capacity(self.parameters.len());
        for pushes in &self.pushes {
            let rows = dispatch(Cpu::detect(), Directions { of: self, pushes, samples: samples.clone() });
            let places = WIDTH.min(self.parameters.len() - directions.len());
            directions
                .extend((0..places).map(|lane| rows.iter().map(|row| row.0[lane]).collect::<Vec<f64>>()));
        }
        directions
    }
}

/// What eight parameters do to the innovations of some samples.
struct Directions<'a> {
    of: &'a Whitened,
    pushes: &'a [Lane<WIDTH>],
    samples: Range<usize>,
}

impl Kernel for Directions<'_> {
    /// A row for each value of the samples.
    type Output = Vec<Lane<WIDTH>>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Whitened { samples, width, states, outputs, .. } = self.of;
        let (width, states, stride) = (*width, *states, states + outputs);
        let zero = Lane([0.0; WIDTH]);
        let (mut apart, mut next) = (vec![zero; width], vec![zero; width]);
        let mut rows = Vec::with_capacity(self.samples.len());
        for k in self.samples {
            let push = &self.pushes[k * stride..(k + 1) * stride];
            for value in &samples[k].values {
                let mut shown = push[states + value.output].0;
                for i in 0..width {
                    for lane in 0..WIDTH {
                        shown[lane] += value.row[i] * apart[i].0[lane];
                    }
                }
                let mut row = shown;
                for lane in 0..WIDTH {
                    row[lane] /= value.deviation;
                }
                rows.push(Lane(row));
                for i in 0..width {
                    for lane in 0..WIDTH {
                        apart[i].0[lane] -= value.gain[i] * shown[lane];
                    }
                }
            }
            let step = &samples[k].step;
            if step.is_empty() {
                break;
            }
            for i in 0..width {
                let mut sum = if i < states { push[i].0 } else { [0.0; WIDTH] };
                for j in 0..width {
                    for lane in 0..WIDTH {
                        sum[lane] += step[i * width + j] * apart[j].0[lane];
                    }
                }
                next[i] = Lane(sum);
            }
            apart.copy_from_slice(&next);
        }
        rows
    }
}
