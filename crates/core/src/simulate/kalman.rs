//! The Kalman filter: re-estimated states, innovations, and forecasts from any sample on.
//!
//! Extended form: the mean goes through the model's own stepper, the covariance through the linearised model
//! (`transition`), so that the filter is exact for linear models. Behind a gap in the inputs it starts again.

use super::drive::{Drive, Inputs};
use super::lanes::{LANES, LaneFile};
use super::stepper::linear_tape;
use super::trajectory::{MeasuredOutput, Simulator};
use super::transition::{Transition, propagate};
use crate::interrupt::{Brake, Meter};
use crate::model::tape::Tape;
use crate::model::{Initial, Model};
use rayon::prelude::*;

/// Prior variance of a state that no sensor measures, in the square of its unit (models: 4 K2).
pub(super) const HIDDEN_VARIANCE: f64 = 4.0;

/// The noise that a filter assumes.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// Process noise: a standard deviation per square root of an hour for every state.
    pub process: Vec<f64>,
    /// Measurement variance per output.
    pub measurement: Vec<f64>,
}

/// What the filter found.
#[derive(Debug, Clone, PartialEq)]
pub struct Filtered {
    /// Filtered states at every sample.
    pub states: Vec<Vec<f64>>,
    /// Their standard deviations.
    pub deviations: Vec<Vec<f64>>,
    /// One-step innovations of each output, `None` where nothing was measured or the filter just started.
    pub innovations: Vec<Vec<Option<f64>>>,
    /// Log-likelihood of the innovations, constants included.
    pub log_likelihood: f64,
    /// Covariance of the states at the last sample, by rows.
    pub covariance: Vec<f64>,
    /// The last sample that the inputs lead to; behind it the states stay as they are there.
    pub reached: usize,
}

/// A Kalman filter for one model on one window.
#[derive(Debug, Clone)]
pub struct Kalman<'a> {
    simulator: &'a Simulator,
    linear: Tape,
    linear_drive: Drive,
    initial: Vec<Initial>,
    measured: Vec<MeasuredOutput<'a>>,
    pub(super) known: Vec<bool>,
}

/// A filter on its way: mean and covariance by rows, and what it works with.
pub(super) struct Walk<'a> {
    pub(super) x: Vec<f64>,
    pub(super) p: Vec<f64>,
    /// Variances of the process noise per hour.
    q: Vec<f64>,
    jacobian: Vec<f64>,
    /// The last sub-step with its Jacobian, kept while that stays the same.
    step: Option<(Vec<f64>, Transition<f64>)>,
    scratch: Vec<f64>,
    file: LaneFile<'a, 1>,
    linear: LaneFile<'a, 1>,
    meter: Meter<'a>,
}

impl<'a> Kalman<'a> {
    /// A filter for the model that `simulator` was made from.
    pub fn new(
        model: &Model,
        simulator: &'a Simulator,
        inputs: &Inputs,
        measured: &[MeasuredOutput<'a>],
    ) -> Self {
        let linear = linear_tape(model);
        let (_, _, substeps, _) = simulator.step_parts();
        Self {
            linear_drive: Drive::new(&linear, inputs, substeps),
            linear,
            simulator,
            initial: model.states().iter().map(|state| state.initial).collect(),
            measured: measured.to_vec(),
            known: (0..inputs.samples()).map(|k| inputs.known(k)).collect(),
        }
    }

    /// The last of samples `0..until` that the inputs lead to. An output may be ahead of an input, such as
    /// the weather, and what is hidden is not thrown away for that.
    pub fn reached(&self, until: usize) -> usize {
        (1..until.min(self.known.len())).rev().find(|k| self.known[k - 1]).unwrap_or(0)
    }

    /// Filters samples `0..until`.
    pub fn filter(&self, theta: &[f64], noise: &Noise, until: usize) -> Filtered {
        let n = self.initial.len();
        let reached = self.reached(until);
        let mut found = Filtered {
            states: Vec::with_capacity(until),
            deviations: Vec::with_capacity(until),
            innovations: vec![Vec::with_capacity(until); self.measured.len()],
            log_likelihood: 0.0,
            covariance: Vec::new(),
            reached,
        };
        let mut walk = self.walk(theta, noise);
        for k in 0..until.min(self.known.len()) {
            let started = k == 0 || !self.known[k - 1];
            if started && k <= reached {
                self.start(k, theta, noise, &mut walk);
            } else if !started {
                self.advance(k - 1, &mut walk);
            }
            for output in 0..self.measured.len() {
                let innovation = self.update(output, k, started, noise, &mut walk, &mut found.log_likelihood);
                found.innovations[output].push(innovation);
            }
            found.states.push(walk.x.clone());
            found.deviations.push((0..n).map(|i| walk.p[i * n + i].max(0.0).sqrt()).collect());
        }
        found.covariance = walk.p;
        found
    }

    /// A filter that has not begun.
    pub(super) fn walk<'b>(&'b self, theta: &[f64], noise: &Noise) -> Walk<'b> {
        let n = self.initial.len();
        let (step_tape, _, _, hours) = self.simulator.step_parts();
        let mut file = LaneFile::<1>::new(step_tape);
        file.load(&[theta], hours);
        let mut linear = LaneFile::<1>::new(&self.linear);
        linear.load(&[theta], hours);
        Walk {
            x: vec![0.0; n],
            p: vec![0.0; n * n],
            q: noise.process.iter().map(|sigma| sigma * sigma).collect(),
            jacobian: vec![0.0; n * n],
            step: None,
            scratch: vec![0.0; n * n],
            file,
            linear,
            meter: Meter::new(&self.simulator.brake),
        }
    }

    /// Takes mean and covariance from sample `k` to the next one, as long as nothing is measured.
    pub(super) fn advance(&self, k: usize, walk: &mut Walk<'_>) {
        let n = self.initial.len();
        let (step_tape, drive, substeps, hours) = self.simulator.step_parts();
        // The covariance takes two products of matrices in a sub-step.
        let work = 2 * n.pow(3) + self.linear.step.len() + step_tape.step.len();
        for step in 0..substeps {
            walk.meter.add(work);
            self.linearise(walk, k, step);
            (0..n * n).for_each(|place| walk.jacobian[place] = walk.linear.root(place)[0]);
            for state in 0..n {
                walk.file.state(state)[0] = walk.x[state];
            }
            drive.load(&mut walk.file, k, step);
            walk.file.step();
            for state in 0..n {
                walk.x[state] = walk.file.root(state)[0];
            }
            walk.spread(hours, &self.simulator.brake);
        }
    }

    /// An output at sample `k` by the states as they are, and its variance by theirs.
    pub(super) fn output(&self, output: usize, k: usize, walk: &mut Walk<'_>) -> (f64, f64) {
        self.linearise(walk, k, 0);
        let n = self.initial.len();
        let first = n * n + output * (n + 1);
        let slope = |i: usize| walk.linear.root(first + 1 + i)[0];
        let variance: f64 = (0..n * n).map(|place| slope(place / n) * walk.p[place] * slope(place % n)).sum();
        (walk.linear.root(first)[0], variance)
    }

    /// State and covariance where the filter starts: measured states at their measurement, hidden ones at
    /// their parameter or, behind a gap, where they were.
    fn start(&self, k: usize, theta: &[f64], noise: &Noise, walk: &mut Walk<'_>) {
        let Walk { x, p, .. } = walk;
        let n = x.len();
        p.fill(0.0);
        for (state, initial) in self.initial.iter().enumerate() {
            match initial {
                Initial::Measured(output) => {
                    x[state] = self.simulator.measured_start_at(*output, k).unwrap_or(x[state]);
                    p[state * n + state] = noise.measurement[*output];
                }
                Initial::Parameter(parameter) => {
                    if k == 0 {
                        x[state] = theta[*parameter];
                    }
                    p[state * n + state] = HIDDEN_VARIANCE;
                }
                // What starts at a known value is known; behind a gap it goes on from where it was.
                Initial::Fixed(value) => {
                    if k == 0 {
                        x[state] = *value;
                    }
                }
            }
        }
    }

    fn linearise(&self, walk: &mut Walk<'_>, k: usize, step: usize) {
        for (state, value) in walk.x.iter().enumerate() {
            walk.linear.state(state)[0] = *value;
        }
        self.linear_drive.load(&mut walk.linear, k, step);
        walk.linear.step();
    }

    /// Updates state and covariance with one output; the innovation counts unless the filter just started
    /// from this very measurement.
    pub(super) fn update(
        &self,
        output: usize,
        k: usize,
        started: bool,
        noise: &Noise,
        walk: &mut Walk<'_>,
        log_likelihood: &mut f64,
    ) -> Option<f64> {
        let (values, valid) = self.measured[output];
        if started || !valid[k] {
            return None;
        }
        self.linearise(walk, k, 0);
        let Walk { x, p, scratch, linear, .. } = walk;
        let n = x.len();
        let first = n * n + output * (n + 1);
        let innovation = values[k] - linear.root(first)[0];
        let slope = |i: usize| linear.root(first + 1 + i)[0];
        let mut variance = noise.measurement[output];
        for i in 0..n {
            scratch[i] = (0..n).map(|j| p[i * n + j] * slope(j)).sum();
            variance += slope(i) * scratch[i];
        }
        for i in 0..n {
            let gain = scratch[i] / variance;
            x[i] += gain * innovation;
            for j in 0..=i {
                let less = p[i * n + j] - gain * scratch[j];
                (p[i * n + j], p[j * n + i]) = (less, less);
            }
        }
        *log_likelihood -=
            0.5 * (innovation * innovation / variance + variance.ln() + (2.0 * std::f64::consts::PI).ln());
        Some(innovation)
    }

    /// The process noise that makes the innovations of samples `0..until` most likely: a golden-section
    /// search over 1e-3 to 3 units per square root of an hour.
    pub fn likely_process_noise(&self, theta: &[f64], measurement: &[f64], until: usize) -> f64 {
        let cost = |log_q: f64| {
            let noise =
                Noise { process: vec![log_q.exp(); self.initial.len()], measurement: measurement.to_vec() };
            let likelihood = self.filter(theta, &noise, until).log_likelihood;
            if likelihood.is_finite() { -likelihood } else { f64::INFINITY }
        };
        let ratio = (5f64.sqrt() - 1.0) / 2.0;
        let (mut low, mut high) = (1e-3f64.ln(), 3f64.ln());
        let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
        let (mut cost_a, mut cost_b) = (cost(a), cost(b));
        // Twelve halvings by the golden ratio leave an interval of three per cent.
        for _ in 0..12 {
            if cost_a < cost_b {
                (high, b, cost_b) = (b, a, cost_a);
                a = high - ratio * (high - low);
                cost_a = cost(a);
            } else {
                (low, a, cost_a) = (a, b, cost_b);
                b = low + ratio * (high - low);
                cost_b = cost(b);
            }
        }
        (0.5 * (low + high)).exp()
    }

    /// Forecasts with measured inputs from the filtered state at each origin: the first output at leads
    /// `0..=horizon` samples, `None` behind a gap in the inputs or the end of the window.
    pub fn forecasts(
        &self,
        theta: &[f64],
        filtered: &Filtered,
        origins: &[usize],
        horizon: usize,
    ) -> Vec<Vec<Option<f64>>> {
        let leads: Vec<usize> = (0..=horizon).collect();
        let block = |block: &[usize]| {
            let mut forecasts = vec![vec![None; horizon + 1]; block.len()];
            self.forecast_block(theta, filtered, block, &leads, |lane, lead, output, value| {
                if output == 0 {
                    forecasts[lane][lead] = value;
                }
            });
            forecasts
        };
        origins.par_chunks(LANES).flat_map_iter(block).collect()
    }

    /// Forecasts of every output at some leads only, in samples and strictly increasing:
    /// `[output][lead][origin]`. As [`Kalman::forecasts`], without keeping what lies between the leads.
    pub fn forecasts_at(
        &self,
        theta: &[f64],
        filtered: &Filtered,
        origins: &[usize],
        leads: &[usize],
    ) -> Vec<Vec<Vec<Option<f64>>>> {
        let outputs = self.measured.len();
        let block = |block: &[usize]| {
            let mut forecasts = vec![vec![None; outputs * leads.len()]; block.len()];
            self.forecast_block(theta, filtered, block, leads, |lane, lead, output, value| {
                forecasts[lane][output * leads.len() + lead] = value;
            });
            forecasts
        };
        let by_origin: Vec<Vec<Option<f64>>> = origins.par_chunks(LANES).flat_map_iter(block).collect();
        let series = |place: usize| by_origin.iter().map(|forecasts| forecasts[place]).collect();
        (0..outputs)
            .map(|output| (0..leads.len()).map(|lead| series(output * leads.len() + lead)).collect())
            .collect()
    }

    /// Tells `keep` the lane, the index of the lead, the output and the value of every forecast of a block.
    /// Lanes share the clock, so each origin joins when its time comes.
    fn forecast_block(
        &self,
        theta: &[f64],
        filtered: &Filtered,
        origins: &[usize],
        leads: &[usize],
        mut keep: impl FnMut(usize, usize, usize, Option<f64>),
    ) {
        let (step_tape, drive, substeps, hours) = self.simulator.step_parts();
        let (output_tape, output_drive) = self.simulator.output_parts();
        let mut file = LaneFile::<LANES>::new(step_tape);
        file.load(&[theta], hours);
        let mut out = LaneFile::<LANES>::new(output_tape);
        out.load(&[theta], hours);
        let (Some(first), Some(last)) = (origins.iter().min(), origins.iter().max()) else { return };
        let Some(longest) = leads.iter().max() else { return };
        let mut alive = vec![false; origins.len()];
        let mut meter = Meter::new(&self.simulator.brake);
        let work = LANES * (substeps * step_tape.step.len() + output_tape.step.len());
        for k in *first..=(last + longest).min(self.known.len() - 1) {
            meter.add(work);
            if k > *first {
                if self.known[k - 1] {
                    for step in 0..substeps {
                        drive.load(&mut file, k - 1, step);
                        file.step();
                        file.advance();
                    }
                } else {
                    alive.fill(false);
                }
            }
            for (lane, origin) in origins.iter().enumerate() {
                if *origin == k {
                    alive[lane] = true;
                    for (state, value) in filtered.states[k].iter().enumerate() {
                        file.state(state)[lane] = *value;
                    }
                }
            }
            for state in 0..self.initial.len() {
                *out.state(state) = *file.state(state);
            }
            output_drive.load(&mut out, k, 0);
            out.step();
            for (lane, origin) in
                origins.iter().enumerate().filter(|(lane, origin)| alive[*lane] && k >= **origin)
            {
                if let Ok(lead) = leads.binary_search(&(k - origin)) {
                    for output in 0..self.measured.len() {
                        let value = out.root(output)[lane];
                        keep(lane, lead, output, value.is_finite().then_some(value));
                    }
                }
            }
        }
    }
}

impl Walk<'_> {
    /// Takes the covariance over a sub-step of so many hours; none that no step can follow.
    fn spread(&mut self, hours: f64, brake: &Brake) {
        if self.step.as_ref().is_none_or(|(jacobian, _)| *jacobian != self.jacobian) {
            self.step = Transition::new(&self.jacobian, &self.q, hours, false, brake)
                .map(|step| (self.jacobian.clone(), step));
        }
        match &self.step {
            Some((_, step)) => {
                propagate(&mut self.p, &step.phi, &step.noise, &mut self.scratch, self.x.len())
            }
            None => self.p.fill(f64::NAN),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Stepper;
    use crate::model::document::ModelDocument;
    use crate::model::{Bindings, Catalogue, compile};

    const A: f64 = 0.6;

    /// x' = -a x, y = x.
    fn decay() -> Model {
        let text = r#"
            id = "decay"
            title = "decay"
            [states]
            x = { unit = "degC", initial = "y" }
            [parameters]
            a = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
            [equations]
            x = "-a*x"
            [outputs]
            y = { expr = "x", unit = "degC", noise_sd = 0.05 }
        "#;
        let mut catalogue = Catalogue::default();
        catalogue.add_model(ModelDocument::from_toml(text).unwrap());
        compile(&catalogue.compose(&"decay".parse().unwrap()).unwrap(), &Bindings::default()).unwrap()
    }

    #[test]
    fn the_variance_follows_the_riccati_recursion_in_closed_form() {
        let model = decay();
        let inputs = Inputs::from_columns_with_length(&model, 40, 0.5);
        let values: Vec<f64> = (0..40).map(|k| 10.0 * (-A * 0.5 * f64::from(k)).exp()).collect();
        let valid = vec![true; 40];
        let measured: [MeasuredOutput; 1] = [(&values, &valid)];
        // The mean goes through the stepper, whose error vanishes with the step; the variance does not.
        let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Rk4, 30);
        let kalman = Kalman::new(&model, &simulator, &inputs, &measured);
        let (q, r) = (0.3, 0.04);
        let found = kalman.filter(&[A], &Noise { process: vec![q], measurement: vec![r] }, 40);
        let mut x = (values[0] + values[1] + values[2]) / 3.0;
        let mut p = r;
        let decay = (-A * 0.5).exp();
        for k in 1..40 {
            let predicted = p * decay * decay + q * q * (1.0 - decay * decay) / (2.0 * A);
            let gain = predicted / (predicted + r);
            let innovation = values[k] - x * decay;
            x = x * decay + gain * innovation;
            p = (1.0 - gain) * predicted;
            assert!((found.deviations[k][0] - p.sqrt()).abs() < 1e-9, "variance at {k}");
            assert!((found.states[k][0] - x).abs() < 1e-9, "mean at {k}: {} {x}", found.states[k][0]);
            assert!((found.innovations[0][k].unwrap() - innovation).abs() < 1e-9);
        }
    }

    #[test]
    fn a_forecast_is_the_free_run_from_the_filtered_state() {
        let model = decay();
        let inputs = Inputs::from_columns_with_length(&model, 60, 0.5);
        let values: Vec<f64> =
            (0..60).map(|k| 10.0 * (-A * 0.5 * f64::from(k)).exp() + 0.1 * f64::from(k % 3)).collect();
        let valid = vec![true; 60];
        let measured: [MeasuredOutput; 1] = [(&values, &valid)];
        let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Ros2, 3);
        let kalman = Kalman::new(&model, &simulator, &inputs, &measured);
        let found = kalman.filter(&[A], &Noise { process: vec![0.1], measurement: vec![0.01] }, 60);
        let origins: Vec<usize> = (5..40).collect();
        for (origin, forecast) in origins.iter().zip(kalman.forecasts(&[A], &found, &origins, 24)) {
            for (lead, value) in forecast.iter().enumerate().filter(|(lead, _)| origin + lead < 60) {
                let exact = found.states[*origin][0] * (-A * 0.5 * lead as f64).exp();
                assert!((value.unwrap() - exact).abs() < 2e-3, "{origin} {lead}");
            }
        }
        // Asking for some leads only gives the same bits.
        let all = kalman.forecasts(&[A], &found, &origins, 24);
        let some = kalman.forecasts_at(&[A], &found, &origins, &[1, 7, 24]);
        for (index, lead) in [1, 7, 24].into_iter().enumerate() {
            let expected: Vec<Option<f64>> = all.iter().map(|forecast| forecast[lead]).collect();
            assert_eq!(some[0][index], expected);
        }
    }
}
