//! The likelihood against filters that are written out plainly, and its slopes against differences.

use super::drive::Inputs;
use super::likelihood::Likelihood;
use super::trajectory::{MeasuredOutput, Simulator};
use crate::model::Stepper;
use crate::model::document::ModelDocument;
use crate::model::{Bindings, Catalogue, Model, compile};
use nalgebra::{Matrix2, Vector2};

fn model(text: &str) -> Model {
    let mut catalogue = Catalogue::default();
    let document = ModelDocument::from_toml(text).unwrap();
    let id = document.id().parse().unwrap();
    catalogue.add_model(document);
    compile(&catalogue.compose(&id).unwrap(), &Bindings::default()).unwrap()
}

/// A deterministic wobble.
fn wobble(k: usize, seed: f64) -> f64 {
    (k as f64 * 1.7 + seed).sin() + 0.5 * (k as f64 * 0.37 + 2.0 * seed).cos()
}

/// x' = -a x, y = x: an Ornstein-Uhlenbeck process behind a sensor.
const OU: &str = r#"
    id = "ou"
    title = "ou"
    states.x = { unit = "degC", initial = "y" }
    parameters.a = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    equations.x = "-a*x"
    outputs.y = { expr = "x", unit = "degC", noise_sd = 0.05 }
"#;

#[test]
fn an_ornstein_uhlenbeck_process_has_its_closed_form() {
    let model = model(OU);
    let (samples, hours) = (60, 0.25);
    let inputs = Inputs::from_columns_with_length(&model, samples, hours);
    let values: Vec<f64> = (0..samples).map(|k| wobble(k, 0.3)).collect();
    let valid: Vec<bool> = (0..samples).map(|k| k % 7 != 3 && !(20..25).contains(&k)).collect();
    let measured: [MeasuredOutput; 1] = [(&values, &valid)];
    let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Ros2, 2);
    let likelihood = Likelihood::new(&model, &simulator, &measured, &[0]);
    let (a, sigma, sd): (f64, f64, f64) = (0.8, 0.6, 0.2);
    let (mut x, mut p, mut expected, mut count) = (values[0], sd * sd, 0.0, 0);
    for k in 1..samples {
        let decay = (-a * hours).exp();
        (x, p) = (x * decay, p * decay * decay + sigma * sigma * (1.0 - decay * decay) / (2.0 * a));
        if valid[k] {
            let (error, variance) = (values[k] - x, p + sd * sd);
            expected += 0.5 * (error * error / variance + (std::f64::consts::TAU * variance).ln());
            let gain = p / variance;
            (x, p) = (x + gain * error, (1.0 - gain) * p);
            count += 1;
        }
    }
    let (value, innovations) = likelihood.value(&[a, sigma, sd], samples).unwrap();
    assert_eq!(innovations, count);
    assert!((value - expected).abs() < 1e-10 * expected.abs(), "{value} {expected}");
}

/// Two states, two sensors of which one sees both, an input along straight lines and one that is held.
const PAIR: &str = r#"
    id = "pair"
    title = "pair"
    states.x = { unit = "degC", initial = "y" }
    states.z = { unit = "degC", initial = "z0" }
    inputs.u = { unit = "degC" }
    inputs.P = { unit = "kW", hold = "zero_order" }
    parameters.a = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    parameters.b = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    parameters.c = { unit = "K/h per kW", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    parameters.z0 = { unit = "degC", lower = -40, upper = 40, scale = "linear", nominal = 1 }
    equations.x = "a*(z - x) + c*P"
    equations.z = "a/3*(x - z) + b*(u - z)"
    outputs.y = { expr = "x", unit = "degC", noise_sd = 0.05 }
    outputs.w = { expr = "0.3*x + 0.7*z", unit = "degC", noise_sd = 0.05 }
"#;

/// Minus the log-likelihood of the pair by a dense filter with many small Runge-Kutta steps, both outputs at
/// once.
fn dense(point: &[f64; 8], u: &[f64], power: &[f64], y: &[f64], w: &[f64], hours: f64) -> f64 {
    let [a, b, c, z0, sx, sz, ry, rw] = *point;
    let matrix = Matrix2::new(-a, a, a / 3.0, -a / 3.0 - b);
    let noise = Matrix2::new(sx * sx, 0.0, 0.0, sz * sz);
    let sensors = Matrix2::new(1.0, 0.0, 0.3, 0.7);
    let floor = Matrix2::new(ry * ry, 0.0, 0.0, rw * rw);
    let mut x = Vector2::new(y[0], z0);
    let mut p = Matrix2::new(ry * ry, 0.0, 0.0, 0.0);
    // At the start only the second sensor brings news.
    let h = Vector2::new(0.3, 0.7);
    let (error, variance) = (w[0] - h.dot(&x), (h.transpose() * p * h)[0] + rw * rw);
    let mut total = 0.5 * (error * error / variance + (std::f64::consts::TAU * variance).ln());
    let gain = p * h / variance;
    x += gain * error;
    p -= gain * h.transpose() * p;
    let parts = 400;
    let d = hours / f64::from(parts);
    for k in 1..y.len() {
        for part in 0..parts {
            let drive =
                |t: f64| Vector2::new(c * power[k - 1], b * (u[k - 1] + (u[k] - u[k - 1]) * t / hours));
            let rate = |x: Vector2<f64>, t: f64| matrix * x + drive(t);
            let spread = |p: Matrix2<f64>| matrix * p + p * matrix.transpose() + noise;
            let t = f64::from(part) * d;
            let k1 = rate(x, t);
            let k2 = rate(x + k1 * (d / 2.0), t + d / 2.0);
            let k3 = rate(x + k2 * (d / 2.0), t + d / 2.0);
            let k4 = rate(x + k3 * d, t + d);
            x += (k1 + (k2 + k3) * 2.0 + k4) * (d / 6.0);
            let k1 = spread(p);
            let k2 = spread(p + k1 * (d / 2.0));
            let k3 = spread(p + k2 * (d / 2.0));
            let k4 = spread(p + k3 * d);
            p += (k1 + (k2 + k3) * 2.0 + k4) * (d / 6.0);
        }
        let error = Vector2::new(y[k], w[k]) - sensors * x;
        let variance = sensors * p * sensors.transpose() + floor;
        let inverse = variance.try_inverse().unwrap();
        total += 0.5
            * ((error.transpose() * inverse * error)[0]
                + variance.determinant().ln()
                + 2.0 * std::f64::consts::TAU.ln());
        let gain = p * sensors.transpose() * inverse;
        x += gain * error;
        p -= gain * sensors * p;
    }
    total
}

#[test]
fn two_states_and_two_sensors_agree_with_a_dense_filter_of_small_steps() {
    let model = model(PAIR);
    let (samples, hours) = (50, 0.5);
    let series = |seed: f64, scale: f64| (0..samples).map(|k| scale * wobble(k, seed)).collect::<Vec<f64>>();
    let (u, power, y, w) = (series(0.1, 5.0), series(1.1, 2.0), series(2.1, 1.0), series(3.1, 1.0));
    let inputs = Inputs::from_columns(&model, vec![u.clone(), power.clone()], hours);
    let valid = vec![true; samples];
    let measured: [MeasuredOutput; 2] = [(&y, &valid), (&w, &valid)];
    let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Ros2, 3);
    let likelihood = Likelihood::new(&model, &simulator, &measured, &[0, 1, 2, 3]);
    assert!(likelihood.is_linear());
    for point in [[0.7, 0.2, 1.3, 0.5, 0.4, 0.9, 0.1, 0.3], [9.0, 3.0, 0.1, -2.0, 1.4, 0.2, 0.5, 0.05]] {
        let expected = dense(&point, &u, &power, &y, &w, hours);
        let (value, innovations) = likelihood.value(&point, samples).unwrap();
        assert_eq!(innovations, 2 * samples - 1);
        assert!((value - expected).abs() < 1e-7 * expected.abs(), "{value} {expected}");
    }
}

/// The same room by three equations: nonlinear in a state, with a delayed input.
const BENT: &str = r#"
    id = "bent"
    title = "bent"
    states.x = { unit = "degC", initial = "y" }
    states.z = { unit = "degC", initial = "z0" }
    inputs.u = { unit = "degC" }
    parameters.a = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    parameters.b = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    parameters.k = { unit = "1/K", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    parameters.tau = { unit = "h", lower = 0, upper = 3, scale = "linear", nominal = 1 }
    parameters.z0 = { unit = "degC", lower = -40, upper = 40, scale = "linear", nominal = 1 }
    equations.x = "a*(z - x) / (1 + exp(k*x))"
    equations.z = "a/3*(x - z) + b*(delay(u, tau) - z)"
    outputs.y = { expr = "x", unit = "degC", noise_sd = 0.05 }
"#;

/// Every slope against the eighth-order central difference of the value.
fn slopes_hold(likelihood: &Likelihood, point: &[f64], samples: usize) {
    let active: Vec<usize> = (0..point.len()).collect();
    let slopes = likelihood.slopes(point, &active, samples).unwrap();
    let largest = slopes.gradient.iter().fold(0.0f64, |largest, slope| largest.max(slope.abs()));
    for i in active {
        let h = 2e-3 * point[i].abs().max(0.1);
        let at = |by: f64| {
            let mut moved = point.to_vec();
            moved[i] += by * h;
            likelihood.value(&moved, samples).unwrap().0
        };
        let d = |k: f64| at(k) - at(-k);
        let difference = (d(1.0) * 672.0 - d(2.0) * 168.0 + d(3.0) * 32.0 - d(4.0) * 3.0) / (840.0 * h);
        let scale = slopes.gradient[i].abs().max(1e-3 * largest);
        assert!(
            (slopes.gradient[i] - difference).abs() < 1e-6 * scale,
            "{i}: {} {difference}",
            slopes.gradient[i]
        );
    }
    // A part of the slopes is the same part.
    let some = likelihood.slopes(point, &[2, 0], samples).unwrap();
    assert_eq!(some.gradient, [slopes.gradient[2], slopes.gradient[0]]);
    assert_eq!(some.information[1], slopes.information[2]);
}

#[test]
fn slopes_equal_high_order_differences() {
    let samples = 80;
    let series = |seed: f64, scale: f64| (0..samples).map(|k| scale * wobble(k, seed)).collect::<Vec<f64>>();
    let (u, power, y, w) = (series(0.1, 5.0), series(1.1, 2.0), series(2.1, 1.0), series(3.1, 1.0));
    let valid: Vec<bool> = (0..samples).map(|k| k % 11 != 5).collect();
    let pair = model(PAIR);
    let mut inputs = Inputs::from_columns(&pair, vec![u.clone(), power], 0.5);
    inputs.forget(30..33);
    let measured: [MeasuredOutput; 2] = [(&y, &valid), (&w, &valid)];
    let simulator = Simulator::new(&pair, &inputs, &measured, Stepper::Ros2, 3);
    let likelihood = Likelihood::new(&pair, &simulator, &measured, &[0, 1, 2, 3]);
    for point in [[0.7, 0.2, 1.3, 0.5, 0.4, 0.9, 0.1, 0.3], [9.0, 3.0, 0.1, -2.0, 1.4, 0.2, 0.5, 0.05]] {
        slopes_hold(&likelihood, &point, samples);
    }
    let bent = model(BENT);
    let inputs = Inputs::from_columns(&bent, vec![u], 0.5);
    let measured: [MeasuredOutput; 1] = [(&y, &valid)];
    let simulator = Simulator::new(&bent, &inputs, &measured, Stepper::Ros2, 3);
    let likelihood = Likelihood::new(&bent, &simulator, &measured, &[0, 1, 2, 3, 4]);
    assert!(!likelihood.is_linear());
    // A delay of whole sub-steps would sit on a corner of the delayed input.
    for point in [[0.7, 0.2, 0.9, 0.71, 0.5, 0.4, 0.9, 0.1], [4.0, 1.0, 2.0, 1.29, -1.0, 0.2, 0.3, 0.3]] {
        slopes_hold(&likelihood, &point, samples);
    }
}
