//! The stabilised stepper on closed forms and on chains of tanks, beside fine steps of RK4.

use super::Inputs;
use super::trajectory::{Simulator, Trajectory};
use crate::model::document::ModelDocument;
use crate::model::{Bindings, Catalogue, Model, Stepper, compile};

/// Hours between samples.
const SAMPLE: f64 = 0.25;

fn build(text: &str) -> Model {
    let mut catalogue = Catalogue::default();
    catalogue.add_model(ModelDocument::from_toml(text).unwrap());
    compile(&catalogue.compose(&"chain".parse().unwrap()).unwrap(), &Bindings::default()).unwrap()
}

/// A chain of cells that exchange and settle, each with a Monod reaction; the fluxes of the settling have
/// kinks. With d = 100 1/h the spectral radius is about 1e4 1/d.
fn chain(cells: usize, extra: &str) -> Model {
    let states: String =
        (0..cells).map(|i| format!("c{i} = {{ unit = \"g/m3\", initial = \"{}\" }}\n", 3 + i % 4)).collect();
    let equations: String = (0..cells)
        .map(|i| {
            let (above, below) = (i.saturating_sub(1), (i + 1).min(cells - 1));
            let settled = |from: usize, to: usize| format!("w*min(c{from}, max(c{to}, 2[g/m3]))");
            let mut text = format!("d*(c{above} - c{i}) + d*(c{below} - c{i}) - r*c{i}/(k + c{i})");
            if i == 0 {
                text += " + q*(u - c0)";
            } else {
                text += &format!(" + {}", settled(i - 1, i));
            }
            if i + 1 < cells {
                text += &format!(" - {}", settled(i, i + 1));
            }
            format!("c{i} = \"{text}\"\n")
        })
        .collect();
    build(&format!(
        r#"
        id = "chain"
        title = "a chain of cells"
        stepper = "rkc"
        {extra}
        [states]
        {states}
        [inputs]
        u = {{ unit = "g/m3", hold = "zero_order" }}
        [parameters]
        d = {{ unit = "1/h", lower = 1, upper = 1000, scale = "log", nominal = 100 }}
        r = {{ unit = "g/m3/h", lower = 0.1, upper = 100, scale = "log", nominal = 3 }}
        k = {{ unit = "g/m3", lower = 0.01, upper = 10, scale = "log", nominal = 0.5 }}
        w = {{ unit = "1/h", lower = 0.01, upper = 10, scale = "log", nominal = 0.8 }}
        q = {{ unit = "1/h", lower = 0.01, upper = 1000, scale = "log", nominal = 20 }}
        [equations]
        {equations}
        [outputs]
        first = {{ expr = "c0", unit = "g/m3", noise_sd = 0.1 }}
        last = {{ expr = "c{}", unit = "g/m3", noise_sd = 0.1 }}
        "#,
        cells - 1
    ))
}

/// A day with a shower of load every third hour.
fn column(samples: usize) -> Vec<f64> {
    (0..samples).map(|k| 20.0 + 10.0 * (k as f64 * 0.4).sin() + if k % 12 < 2 { 30.0 } else { 0.0 }).collect()
}

fn simulator(model: &Model, column: Vec<f64>, stepper: Stepper, substeps: usize) -> Simulator {
    Simulator::new(model, &Inputs::from_columns(model, vec![column], SAMPLE), &[], stepper, substeps)
}

/// Candidates from one corner of the box to another.
fn candidates(count: usize) -> Vec<Vec<f64>> {
    let part = |i: usize, stride: usize| ((i * stride) % count) as f64 / count as f64;
    (0..count)
        .map(|i| {
            vec![
                5.0 * 40f64.powf(part(i, 1)),
                0.5 * 20f64.powf(part(i, 3)),
                0.05 * 40f64.powf(part(i, 5)),
                0.1 * 20f64.powf(part(i, 7)),
                2.0 * 20f64.powf(part(i, 11)),
            ]
        })
        .collect()
}

fn slices(thetas: &[Vec<f64>]) -> Vec<&[f64]> {
    thetas.iter().map(Vec::as_slice).collect()
}

/// The largest difference of any output over that output's range in the reference.
fn error(ours: &Trajectory, reference: &Trajectory) -> f64 {
    let of = |(ours, reference): (&Vec<f64>, &Vec<f64>)| {
        let low = reference.iter().copied().fold(f64::INFINITY, f64::min);
        let high = reference.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let far = |(a, b): (&f64, &f64)| if (a - b).is_finite() { (a - b).abs() } else { f64::INFINITY };
        ours.iter().zip(reference).map(far).fold(0.0, f64::max) / (high - low)
    };
    ours.outputs.iter().zip(&reference.outputs).map(of).fold(0.0, f64::max)
}

#[test]
fn a_linear_case_agrees_with_its_closed_form_the_better_the_smaller_the_tolerance() {
    let model = build(
        r#"
        id = "chain"
        title = "first order"
        stepper = "rkc"
        [states]
        x = { unit = "g/m3", initial = "20" }
        [inputs]
        u = { unit = "g/m3", hold = "zero_order" }
        [parameters]
        a = { unit = "1/h", lower = 0.01, upper = 1000, scale = "log", nominal = 1 }
        [equations]
        x = "a*(u - x)"
        [outputs]
        y = { expr = "x", unit = "g/m3", noise_sd = 0.1 }
        "#,
    );
    let worst = |substeps: usize, a: f64| {
        let run = &simulator(&model, vec![5.0; 41], Stepper::Rkc, substeps).run(&[&[a]], 41)[0];
        let closed = |k: usize| 5.0 + 15.0 * (-a * SAMPLE * k as f64).exp();
        (
            run.outputs[0].iter().enumerate().map(|(k, y)| (y - closed(k)).abs()).fold(0.0, f64::max),
            run.evaluations,
        )
    };
    for a in [0.3, 2.0, 30.0, 900.0] {
        let found: Vec<(f64, usize)> = [1, 2, 4, 8].map(|substeps| worst(substeps, a)).to_vec();
        assert!(found[0].0 < 3e-4, "{a}: {found:?}");
        // A thousandth of the tolerance is a tenth of the step and a hundredth of the error, less where the
        // samples cut the steps.
        assert!(found[3].0 < found[0].0 / 15.0 || found[3].0 < 1e-9, "{a}: {found:?}");
    }
}

#[test]
fn a_stiff_chain_agrees_with_fine_steps_of_rk4_at_half_the_evaluations() {
    let model = chain(40, "");
    let thetas = candidates(12);
    let coarse = simulator(&model, column(96), Stepper::Rkc, 1).run(&slices(&thetas), 96);
    let fine = simulator(&model, column(96), Stepper::Rk4, 256).run(&slices(&thetas), 96);
    for ((theta, ours), reference) in thetas.iter().zip(&coarse).zip(&fine) {
        assert!(!reference.diverged);
        assert!(error(ours, reference) < 1e-4, "{theta:?}: {}", error(ours, reference));
        assert!(ours.evaluations < reference.evaluations / 2, "{theta:?}: {} evaluations", ours.evaluations);
    }
}

#[test]
fn a_candidate_is_the_same_alone_and_in_any_block() {
    let model = chain(12, "warm_up = { hours = 30, inputs = { u = 12 } }");
    let simulator = simulator(&model, column(40), Stepper::Rkc, 1);
    let thetas = candidates(23);
    let all = slices(&thetas);
    let together = simulator.run(&all, 40);
    for (theta, run) in all.iter().zip(&together) {
        assert_eq!(simulator.run(&[*theta], 40)[0], *run);
    }
    assert_eq!(simulator.run(&all[3..8], 40), together[3..8]);
    let kept = simulator.run_with_states(all[5]);
    assert_eq!((&kept.outputs, kept.states.len(), kept.states[0].len()), (&together[5].outputs, 12, 40));
}

#[test]
fn a_candidate_that_diverges_ends_alone() {
    let model = build(
        r#"
        id = "chain"
        title = "growth without bound, and a switch that chatters"
        stepper = "rkc"
        [states]
        x = { unit = "g/m3", initial = "1" }
        z = { unit = "g/m3", initial = "1" }
        [parameters]
        a = { unit = "m3/g/h", lower = 0.01, upper = 1000, scale = "log", nominal = 1 }
        b = { unit = "1/h", lower = 0, upper = 1e9, scale = "linear", nominal = 1 }
        [equations]
        x = "a*x*x - 1[1/h]*x"
        z = "if(z < 0.5[g/m3], b, -b)*1[g/m3]"
        [outputs]
        y = { expr = "x", unit = "g/m3", noise_sd = 0.1 }
        "#,
    );
    let inputs = Inputs::from_columns_with_length(&model, 30, 1.0);
    let simulator = Simulator::new(&model, &inputs, &[], Stepper::Rkc, 1);
    let thetas: Vec<Vec<f64>> = [[0.5, 0.0], [3.0, 0.0], [0.2, 1e8], [0.9, 0.0], [f64::NAN, 0.0], [0.1, 0.0]]
        .iter()
        .map(|theta| theta.to_vec())
        .collect();
    let runs = simulator.run(&slices(&thetas), 30);
    let finite: Vec<bool> = runs.iter().map(|run| run.outputs[0].iter().all(|y| y.is_finite())).collect();
    assert_eq!(finite, [true, false, false, true, false, true]);
    for (run, finite) in runs.iter().zip(finite) {
        assert_eq!((run.diverged, run.outputs[0].len()), (!finite, 30));
        assert!(run.evaluations < 100_000, "no endless loop: {}", run.evaluations);
    }
    // Bernoulli's equation has a closed form.
    for (theta, run) in [(0.5, &runs[0]), (0.9, &runs[3]), (0.1, &runs[5])] {
        let closed = |t: f64| 1.0 / (theta + (1.0 - theta) * t.exp());
        run.outputs[0]
            .iter()
            .enumerate()
            .for_each(|(k, y)| assert!((y - closed(k as f64)).abs() < 2e-3, "{theta} {k}: {y}"));
    }
}

#[test]
fn a_warm_up_is_a_long_constant_window_before_the_first() {
    let warm = chain(12, "warm_up = { hours = 24, inputs = { u = 12 } }");
    let thetas = candidates(6);
    let ours = simulator(&warm, column(30), Stepper::Rkc, 1).run(&slices(&thetas), 30);
    let mut long = vec![12.0; 96];
    long.extend(column(30));
    let reference = simulator(&chain(12, ""), long, Stepper::Rk4, 256).run(&slices(&thetas), 126);
    let fixed = simulator(&warm, column(30), Stepper::Rk4, 256).run(&slices(&thetas), 30);
    for ((ours, fixed), reference) in ours.iter().zip(&fixed).zip(&reference) {
        let tail = Trajectory {
            outputs: reference.outputs.iter().map(|series| series[96..].to_vec()).collect(),
            ..reference.clone()
        };
        assert!(error(fixed, &tail) < 1e-9, "{}", error(fixed, &tail));
        assert!(error(ours, &tail) < 1e-4, "{}", error(ours, &tail));
    }
}

#[test]
fn behind_a_gap_the_chain_goes_on_from_where_it_was() {
    let model = chain(12, "");
    let mut inputs = Inputs::from_columns(&model, vec![vec![15.0; 40]], SAMPLE);
    inputs.forget(8..12);
    let theta = [100.0, 3.0, 0.5, 0.8, 20.0];
    let gappy = Simulator::new(&model, &inputs, &[], Stepper::Rkc, 1).run(&[&theta], 40);
    let whole = simulator(&model, vec![15.0; 36], Stepper::Rkc, 1).run(&[&theta], 36);
    let (gappy, whole) = (&gappy[0].outputs[1], &whole[0].outputs[1]);
    assert_eq!(gappy[..9], whole[..9]);
    assert!(gappy[8..13].iter().all(|y| *y == gappy[8]), "it stands still in the gap");
    // Behind the gap the first step is found anew.
    assert!(gappy[13..].iter().zip(&whole[9..]).all(|(a, b)| (a - b).abs() < 1e-6));
}

#[test]
fn what_is_not_wanted_any_more_ends_in_the_middle() {
    let model = chain(12, "");
    let thetas = candidates(20);
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let halt = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= 2;
    let runs = simulator(&model, column(400), Stepper::Rkc, 1).run_unless(&slices(&thetas), 400, &halt);
    assert_eq!(runs.len(), 20);
    assert!(
        runs.iter().all(|run| run.diverged && run.outputs[0].len() == 400 && run.outputs[0][399].is_nan())
    );
}
