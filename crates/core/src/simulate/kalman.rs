//! The Kalman filter: re-estimated states, innovations, and forecasts from any sample on.
//!
//! Extended form: the mean goes through the model's own stepper, the covariance through the linearised model
//! (`transition`), so that the filter is exact for linear models. Behind a gap in the inputs it starts again.

use super::lane::Lane;
use super::lanes::{LANES, LaneFile};
use super::walk::Walk;
pub use super::walk::{Kalman, Noise};
use crate::interrupt::Meter;
use rayon::prelude::*;

/// Noises that are tried side by side.
const TRIED: usize = 8;
/// Logarithms of noises that are as good as the same.
const ENDS: f64 = 1e-9;
/// Where the likeliest process noise is sought, in the unit of a state per square root of an hour.
const PROCESS_NOISE: [f64; 2] = [1e-3, 3.0];

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

impl Kalman<'_> {
    /// The last of samples `0..until` that the inputs lead to. An output may be ahead of an input, such as
    /// the weather, and what is hidden is not thrown away for that.
    pub fn reached(&self, until: usize) -> usize {
        let inputs = self.simulator.inputs();
        (1..until.min(inputs.samples())).rev().find(|k| inputs.known(k - 1)).unwrap_or(0)
    }

    /// Filters samples `0..until`.
    pub fn filter(&self, theta: &[f64], noise: &Noise, until: usize) -> Filtered {
        let outputs = self.measured.len();
        let mut found = Filtered {
            states: Vec::with_capacity(until),
            deviations: Vec::with_capacity(until),
            innovations: vec![Vec::with_capacity(until); outputs],
            log_likelihood: 0.0,
            covariance: Vec::new(),
            reached: self.reached(until),
        };
        let mut walk = self.walk::<1>(&[theta], std::slice::from_ref(noise));
        let mut likelihood = [0.0];
        self.pass(until, &mut walk, &mut likelihood, |walk, innovations| {
            let n = walk.x.len();
            for (series, innovation) in found.innovations.iter_mut().zip(innovations) {
                series.push(innovation.map(|innovation| innovation.0[0]));
            }
            found.states.push(walk.x.iter().map(|lanes| lanes.0[0]).collect());
            found.deviations.push((0..n).map(|i| walk.p[i * n + i].0[0].max(0.0).sqrt()).collect());
        });
        found.log_likelihood = likelihood[0];
        found.covariance = walk.p.iter().map(|lanes| lanes.0[0]).collect();
        found
    }

    /// Takes a filter through samples `0..until`, sums up the log-likelihoods of its lanes and tells `keep`
    /// where it is at each sample, with the innovations there by output.
    fn pass<const W: usize>(
        &self,
        until: usize,
        walk: &mut Walk<'_, W>,
        likelihood: &mut [f64; W],
        mut keep: impl FnMut(&Walk<'_, W>, &[Option<Lane<W>>]),
    ) {
        let (inputs, reached) = (self.simulator.inputs(), self.reached(until));
        let mut innovations = vec![None; self.measured.len()];
        for k in 0..until.min(inputs.samples()) {
            let started = k == 0 || !inputs.known(k - 1);
            if started && k <= reached {
                walk.start(k);
            } else if !started {
                walk.advance(k - 1);
            }
            for (output, kept) in innovations.iter_mut().enumerate() {
                // An innovation counts unless the filter just started from this very measurement.
                let update = if started { None } else { walk.update(output, k) };
                *kept = update.map(|(innovation, variance)| {
                    for (lane, likelihood) in likelihood.iter_mut().enumerate() {
                        let (innovation, variance) = (innovation.0[lane], variance.0[lane]);
                        *likelihood -= 0.5
                            * (innovation * innovation / variance
                                + variance.ln()
                                + (2.0 * std::f64::consts::PI).ln());
                    }
                    innovation
                });
            }
            keep(walk, &innovations);
        }
    }

    /// The process noise that makes the innovations of samples `0..until` most likely, between 1e-3 and 3
    /// units per square root of an hour: eight side by side, eight more from one neighbour of the best one to
    /// the other, then the peak of a parabola through the best three of those. Where one is `near`, the first
    /// eight are spared if there is a peak within a factor of three of that one; it is the one next to it.
    /// All have the slopes where the middle one is: noises move the states by little.
    pub fn likely_process_noise(
        &self,
        theta: &[f64],
        measurement: &[f64],
        until: usize,
        near: Option<f64>,
    ) -> f64 {
        let tried = |from: f64, to: f64| -> Vec<(f64, f64)> {
            let step = (to - from) / (TRIED - 1) as f64;
            let logarithms: [f64; TRIED] = std::array::from_fn(|place| from + place as f64 * step);
            let noise = |logarithm: &f64| Noise {
                process: vec![logarithm.exp(); self.initial.len()],
                measurement: measurement.to_vec(),
            };
            let noises: Vec<Noise> = logarithms.iter().map(noise).collect();
            let mut walk = self.walk::<TRIED>(&[theta], &noises).with_common_slopes();
            let mut found = [0.0; TRIED];
            self.pass(until, &mut walk, &mut found, |_, _| ());
            let finite =
                |likelihood: f64| if likelihood.is_finite() { likelihood } else { f64::NEG_INFINITY };
            logarithms.into_iter().zip(found.map(finite)).collect()
        };
        let [low, high] = PROCESS_NOISE.map(f64::ln);
        let wide = (high - low) / (TRIED - 1) as f64;
        let about = |middle: f64| tried((middle - wide).max(low), (middle + wide).min(high));
        let likeliest = near.and_then(|near| {
            let [lowest, highest] = PROCESS_NOISE;
            let tried = about(near.clamp(lowest, highest).ln());
            let best = peak(&tried);
            // What is likeliest at an end may be likelier still behind it, unless nothing is there.
            let [first, last] = [tried[0].0, tried[TRIED - 1].0];
            let is_end = best == first && best > low + ENDS || best == last && best < high - ENDS;
            (!is_end).then(|| vertex(&tried, best))
        });
        let anew = || {
            let tried = about(peak(&tried(low, high)));
            vertex(&tried, peak(&tried))
        };
        likeliest.unwrap_or_else(anew).exp()
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
        self.forecasts_from(theta, filtered, origins, &leads, 1)
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
        let by_origin = self.forecasts_from(theta, filtered, origins, leads, outputs);
        let series = |place: usize| by_origin.iter().map(|forecasts| forecasts[place]).collect();
        (0..outputs)
            .map(|output| (0..leads.len()).map(|lead| series(output * leads.len() + lead)).collect())
            .collect()
    }

    /// The same by origins: of each, the forecasts of the first outputs at all leads, one output after the
    /// other.
    fn forecasts_from(
        &self,
        theta: &[f64],
        filtered: &Filtered,
        origins: &[usize],
        leads: &[usize],
        outputs: usize,
    ) -> Vec<Vec<Option<f64>>> {
        let block = |origins: &[usize]| match origins.len() {
            ..=8 => self.forecast_block::<8>(theta, filtered, origins, leads, outputs),
            _ => self.forecast_block::<LANES>(theta, filtered, origins, leads, outputs),
        };
        origins.par_chunks(LANES).flat_map_iter(block).collect()
    }

    /// The forecasts from at most so many origins. Lanes share the clock, so each origin joins when its time
    /// comes.
    fn forecast_block<const W: usize>(
        &self,
        theta: &[f64],
        filtered: &Filtered,
        origins: &[usize],
        leads: &[usize],
        outputs: usize,
    ) -> Vec<Vec<Option<f64>>> {
        let mut forecasts = vec![vec![None; outputs * leads.len()]; origins.len()];
        let (step_tape, drive, substeps, hours) = self.simulator.step_parts();
        let (output_tape, output_drive) = self.simulator.output_parts();
        let mut file = LaneFile::<W>::new(step_tape);
        file.load(&[theta], hours);
        let mut out = LaneFile::<W>::new(output_tape);
        out.load(&[theta], hours);
        let bounds = origins.iter().min().zip(origins.iter().max()).zip(leads.iter().max());
        let Some(((first, last), longest)) = bounds else { return forecasts };
        // Who joins next, and what is due at each sample, by lane and lead.
        let mut joining: Vec<usize> = (0..origins.len()).collect();
        joining.sort_by_key(|lane| origins[*lane]);
        let mut joining = joining.into_iter().peekable();
        let mut due: Vec<Vec<(usize, usize)>> = vec![Vec::new(); last + longest + 1 - first];
        for (lane, origin) in origins.iter().enumerate() {
            for (place, lead) in leads.iter().enumerate() {
                due[origin + lead - first].push((lane, place));
            }
        }
        let mut alive = vec![false; origins.len()];
        let mut meter = Meter::new(&self.simulator.brake);
        let work = W * (substeps * step_tape.step.len() + output_tape.step.len());
        let inputs = self.simulator.inputs();
        for (k, due) in (*first..inputs.samples()).zip(&due) {
            meter.add(work);
            if k > *first {
                if inputs.known(k - 1) {
                    for step in 0..substeps {
                        drive.load(&mut file, k - 1, step);
                        file.step();
                        file.advance();
                    }
                } else {
                    alive.fill(false);
                }
            }
            while let Some(lane) = joining.next_if(|lane| origins[*lane] == k) {
                alive[lane] = true;
                for (state, value) in filtered.states[k].iter().enumerate() {
                    file.state(state)[lane] = *value;
                }
            }
            if due.is_empty() {
                continue;
            }
            for state in 0..self.initial.len() {
                *out.state(state) = *file.state(state);
            }
            output_drive.load(&mut out, k, 0);
            out.step();
            for (lane, place) in due.iter().filter(|(lane, _)| alive[*lane]) {
                for output in 0..outputs {
                    let value = out.root(output)[*lane];
                    forecasts[*lane][output * leads.len() + place] = value.is_finite().then_some(value);
                }
            }
        }
        forecasts
    }
}

/// Where the second of the pairs is largest, of equals at the first.
fn peak(tried: &[(f64, f64)]) -> f64 {
    tried.iter().rev().max_by(|one, other| one.1.total_cmp(&other.1)).map_or(f64::NAN, |best| best.0)
}

/// Where the parabola through the best of some pairs and its neighbours is largest, if it has such a place
/// between those; else where the best is.
fn vertex(tried: &[(f64, f64)], best: f64) -> f64 {
    let at = tried.iter().position(|one| one.0 == best);
    let around = at.and_then(|at| Some((tried.get(at.wrapping_sub(1))?, tried[at], tried.get(at + 1)?)));
    let Some((before, at, behind)) = around else { return best };
    let [left, right] = [before, behind].map(|other| ((other.1 - at.1) / (other.0 - at.0), other.0 - at.0));
    let bend = (right.0 - left.0) / (right.1 - left.1);
    let to = at.0 - 0.5 * (left.0 - bend * left.1) / bend;
    if bend < 0.0 && to > before.0 && to < behind.0 { to } else { best }
}

#[cfg(test)]
mod tests {
    use super::super::drive::Inputs;
    use super::super::trajectory::{MeasuredOutput, Simulator};
    use super::*;
    use crate::model::document::ModelDocument;
    use crate::model::{Bindings, Catalogue, Model, Stepper, compile};

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
        let kalman = Kalman::new(&model, &simulator, &measured);
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
    fn the_likeliest_noise_is_the_same_wherever_it_is_sought_from() {
        let model = decay();
        let inputs = Inputs::from_columns_with_length(&model, 400, 0.5);
        // A state that is pushed now and then, by a sequence that repeats late.
        let mut state = 10.0;
        let values: Vec<f64> = (0..400_u64)
            .map(|k| {
                let push = (k * k * 7919 % 1009) as f64 / 1009.0 - 0.5;
                state = state * (-A * 0.5).exp() + push;
                state + 0.05 * (k as f64 * 2.4).sin()
            })
            .collect();
        let valid = vec![true; 400];
        let measured: [MeasuredOutput; 1] = [(&values, &valid)];
        let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Ros2, 3);
        let kalman = Kalman::new(&model, &simulator, &measured);
        let sought = |near| kalman.likely_process_noise(&[A], &[0.0025], 400, near);
        let likelihood = |noise: f64| {
            kalman
                .filter(&[A], &Noise { process: vec![noise], measurement: vec![0.0025] }, 400)
                .log_likelihood
        };
        let likeliest = sought(None);
        assert!(likelihood(likeliest) > likelihood(0.9 * likeliest).max(likelihood(1.1 * likeliest)));
        // From nearby, from the far ends, and from beyond them.
        for near in [0.7 * likeliest, 2.0 * likeliest, 1e-3, 3.0, 0.0, 1e9] {
            let found = sought(Some(near));
            assert!((found / likeliest - 1.0).abs() < 0.02, "from {near}: {found}, and {likeliest}");
        }
        // What does not move has the least noise that there is, from wherever.
        let still = vec![0.0; 400];
        let measured: [MeasuredOutput; 1] = [(&still, &valid)];
        let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Rk4, 30);
        let kalman = Kalman::new(&model, &simulator, &measured);
        for near in [None, Some(1e-3), Some(0.3)] {
            let found = kalman.likely_process_noise(&[A], &[0.0025], 400, near);
            assert!((found / 1e-3 - 1.0).abs() < 1e-6, "from {near:?}: {found}");
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
        let kalman = Kalman::new(&model, &simulator, &measured);
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
        // So do origins in any order, twice, few of them, and at the end of the record.
        let few = [38, 5, 38, 59];
        let found = kalman.forecasts(&[A], &found, &few, 24);
        for (origin, forecast) in few.iter().zip(&found).take(3) {
            assert_eq!(forecast, &all[origin - 5]);
        }
        assert!(found[3][0].is_some() && found[3][1..].iter().all(Option::is_none));
    }
}
