//! The record as the smoother takes it: an affine step of everything that is sought from each sample to the
//! next.

use crate::data::HOUR;
use crate::estimate::Problem;
use crate::simulate::kalman::Noise;
use crate::simulate::linearise::{Linearisation, StepStart};
use nalgebra::{DMatrix, DVector};

/// How far a state may lie from where it is expected behind a gap, and how much may always be missing per
/// hour: 3 K of a room.
pub(super) const FREE: f64 = 60.0;
/// How far it may lie from there at the start: the floor of a heated room is 20 K above the air.
const START: f64 = 400.0;
/// What the equations leave open of every state, per square root of an hour: enough for rounding, and too
/// little to explain what flows.
const PROCESS_SD: f64 = 0.2;

// All are in deviations of the sensor.

/// Of what the missing heat is asked.
#[derive(Clone, Copy)]
pub(in crate::diagnose) struct MissingHeatAsked<'a> {
    pub problem: &'a Problem,
    pub theta: &'a [f64],
    /// By its place.
    pub output: usize,
    pub state: usize,
}

/// A value that was measured: `row . z + constant`, and noise.
pub(in crate::diagnose) struct Reading {
    pub row: DVector<f64>,
    pub constant: f64,
    pub value: f64,
    /// The unit of its noise.
    pub scale: f64,
    /// The output that it is of.
    pub output: usize,
}

/// From a sample to the next: `matrix . z + constant` with this covariance on top. How the rate fades and
/// what comes on top of it are the smoother's.
pub(in crate::diagnose) struct AffineStep {
    pub matrix: DMatrix<f64>,
    pub constant: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

/// A record, ready to be filtered. What is sought at each sample is in this order: the states, what comes and
/// goes of the missing rate, what is always there of it, and what both have come to since the hour began.
pub(in crate::diagnose) struct LinearRecord {
    /// Hours between samples.
    pub hours: f64,
    /// What was measured at each sample.
    pub readings: Vec<Vec<Reading>>,
    /// From each sample to the next one.
    pub steps: Vec<AffineStep>,
    /// The states at the first sample.
    start: Vec<f64>,
    /// How free they are: a variance.
    start_free: f64,
    /// How free what is always missing is: a variance.
    free: f64,
    /// Where an hour of the clock begins.
    pub begins: Vec<bool>,
}

impl LinearRecord {
    /// Linearises a record along these states and what is missing there, sample by sample; nothing is where
    /// no rates are given. `None` where a step leaves the numbers.
    pub fn new(asked: &MissingHeatAsked<'_>, along: &[Vec<f64>], missing: &[f64]) -> Option<Self> {
        let MissingHeatAsked { problem, theta, state, .. } = *asked;
        let (model, inputs, grid) = (problem.model(), problem.inputs(), problem.grid());
        let (n, outputs, samples) = (model.states().len(), model.outputs().len(), grid.len());
        let (rate, steady, sum) = (n, n + 1, n + 2);
        let sensor = model.outputs().get(asked.output).map_or(0.0, |output| output.noise_sd);
        let free = (FREE * sensor).powi(2);
        let noise = Noise { process: vec![PROCESS_SD * sensor; n], measurement: vec![0.0; outputs] };
        let hour = |k: usize| grid.time(k).div_euclid(HOUR);
        let begins: Vec<bool> = (0..samples).map(|k| k == 0 || hour(k) != hour(k - 1)).collect();
        let known: Vec<usize> =
            (0..samples.saturating_sub(1)).filter(|k| inputs.known(*k) && inputs.known(k + 1)).collect();
        let on_top = |k: usize| missing.get(k).copied().unwrap_or(0.0);
        let starts: Vec<StepStart> = known
            .iter()
            .map(|k| {
                let on_top = (0..n).map(|i| if i == state { on_top(*k) } else { 0.0 }).collect();
                StepStart { sample: *k, states: along[*k].clone(), on_top }
            })
            .collect();
        let linear =
            Linearisation::of_states(model, inputs, theta).steps_along(&starts, &noise, problem.brake())?;
        let measured = problem.measured();
        let mut readings: Vec<Vec<Reading>> = (0..samples).map(|_| Vec::new()).collect();
        let mut steps: Vec<AffineStep> = (1..samples).map(|next| Self::gap(&along[next], free)).collect();
        for (k, step) in known.iter().zip(&linear) {
            let mut matrix = DMatrix::zeros(n + 3, n + 3);
            matrix.view_mut((0, 0), (n, n)).copy_from(&DMatrix::from_row_slice(n, n, &step.a));
            for part in [rate, steady] {
                (0..n).for_each(|i| matrix[(i, part)] = step.g[i * n + state]);
            }
            let mut constant = DVector::zeros(n + 3);
            constant.rows_mut(0, n).copy_from_slice(&step.offset);
            let mut covariance = DMatrix::zeros(n + 3, n + 3);
            covariance.view_mut((0, 0), (n, n)).copy_from(&DMatrix::from_row_slice(n, n, &step.q));
            steps[*k] = AffineStep { matrix, constant, covariance };
            for (output, (values, _)) in measured.iter().enumerate().filter(|(_, (_, valid))| valid[*k]) {
                let mut row = DVector::zeros(n + 3);
                row.rows_mut(0, n).copy_from_slice(&step.c[output * n..][..n]);
                readings[*k].push(Reading {
                    row,
                    constant: step.output_offset[output],
                    value: values[*k],
                    scale: problem.scale(output),
                    output,
                });
            }
        }
        for (step, begins) in steps.iter_mut().zip(&begins) {
            step.matrix[(sum, sum)] = f64::from(u8::from(!begins));
            step.matrix[(sum, rate)] = inputs.hours();
            step.matrix[(sum, steady)] = inputs.hours();
            step.matrix[(steady, steady)] = 1.0;
        }
        let (start, start_free) = (along.first()?.clone(), (START * sensor).powi(2));
        Some(Self { hours: inputs.hours(), readings, steps, start, start_free, free, begins })
    }

    /// The same, with the state that is shown where it is in `along`, and with what is `missing` there, for
    /// all that the other states take of it, and with `start` for what is expected at the start. What is
    /// measured is known well enough for that, and a thermostat that is linear in it would be open wider than
    /// it can, or less than not at all.
    pub fn shown_along(mut self, state: usize, along: &[Vec<f64>], missing: &[f64], start: &[f64]) -> Self {
        let (rate, steady) = (self.rate(), self.rate() + 1);
        for ((step, at), missing) in self.steps.iter_mut().zip(along).zip(missing) {
            for i in (0..start.len()).filter(|i| *i != state) {
                step.constant[i] += step.matrix[(i, state)] * at[state] + step.matrix[(i, rate)] * missing;
                [state, rate, steady].into_iter().for_each(|of| step.matrix[(i, of)] = 0.0);
            }
        }
        self.start.copy_from_slice(start);
        self
    }

    /// Behind samples whose inputs are unknown the states are taken up anew.
    fn gap(next: &[f64], free: f64) -> AffineStep {
        let (n, width) = (next.len(), next.len() + 3);
        let mut constant = DVector::zeros(width);
        constant.rows_mut(0, n).copy_from_slice(next);
        AffineStep { matrix: DMatrix::zeros(width, width), constant, covariance: Self::spread(n, n, free) }
    }

    /// Of so many states, the first things are as free as may be.
    fn spread(n: usize, things: usize, free: f64) -> DMatrix<f64> {
        DMatrix::from_fn(n + 3, n + 3, |i, j| if i == j && i < things { free } else { 0.0 })
    }

    /// How many things are sought.
    pub fn width(&self) -> usize {
        self.sum() + 1
    }

    /// What is known of them before the first value, with a rate of this variance.
    pub fn begin(&self, size: f64) -> (DVector<f64>, DMatrix<f64>) {
        let n = self.start.len();
        let mut mean = DVector::zeros(n + 3);
        mean.rows_mut(0, n).copy_from_slice(&self.start);
        let mut covariance = Self::spread(n, n, self.start_free);
        covariance[(n, n)] = size;
        covariance[(n + 1, n + 1)] = self.free;
        (mean, covariance)
    }

    /// The place of what comes and goes.
    pub fn rate(&self) -> usize {
        self.start.len()
    }

    /// The place of what both have come to.
    pub fn sum(&self) -> usize {
        self.start.len() + 2
    }
}
