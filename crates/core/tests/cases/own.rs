//! Models that a user writes, of processes that are no rooms, from text to a fit that the gate accepts: their
//! intervals hold the truth, which another solver has made.

use super::{full, normal};
use lampyris_core::data::{ColumnBindings, SplitRequest, Window};
use lampyris_core::estimate::problem::request::SeededMethod;
use lampyris_core::estimate::{
    Control, EstimateRequest, GatePolicy, Past, Site, Verdict, estimate, prepare, validate,
};
use lampyris_core::model::Catalogue;
use lampyris_core::model::document::ModelDocument;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use std::fmt::Write;

/// Rates of change from the parameters, the states and the inputs.
type Rates = fn(&[f64], &[f64], &[f64]) -> Vec<f64>;

/// A process with its model and how it is measured.
struct Process {
    document: &'static str,
    /// What is written otherwise in it.
    edits: &'static [[&'static str; 2]],
    /// Seconds between samples, and steps of the truth between them.
    step: f64,
    parts: usize,
    split: [&'static str; 2],
    horizon: &'static str,
    /// The parameters of the truth, which are drawn around these values.
    parameters: &'static [(&'static str, f64)],
    /// The columns of the inputs, and whether each is held from one sample to the next.
    inputs: &'static [(&'static str, bool)],
    draw: fn(&mut Xoshiro256PlusPlus, usize) -> Vec<Vec<f64>>,
    /// Initial states from the parameters, rates of change per second, and outputs with their noise.
    start: fn(&[f64]) -> Vec<f64>,
    rate: Rates,
    outputs: &'static [(&'static str, f64)],
    measured: fn(&[f64]) -> Vec<f64>,
}

/// A value that holds for some samples and then is another one.
fn switched(dice: &mut Xoshiro256PlusPlus, samples: usize, longest: usize, values: &[f64]) -> Vec<f64> {
    let mut column = Vec::with_capacity(samples);
    while column.len() < samples {
        let value = values[dice.random_range(0..values.len())];
        column.extend(std::iter::repeat_n(value, dice.random_range(1..=longest)));
    }
    column.truncate(samples);
    column
}

/// A level with waves of these periods, in samples.
fn waves(dice: &mut Xoshiro256PlusPlus, samples: usize, level: f64, waves: &[(f64, f64)]) -> Vec<f64> {
    let phases: Vec<f64> = waves.iter().map(|_| dice.random_range(0.0..std::f64::consts::TAU)).collect();
    let wave = |k: usize| {
        waves
            .iter()
            .zip(&phases)
            .map(|((size, period), phase)| size * (std::f64::consts::TAU * k as f64 / period + phase).sin())
            .sum::<f64>()
    };
    (0..samples).map(|k| level + wave(k)).collect()
}

const ZONES: Process = Process {
    document: include_str!("../../../../examples/models/zones.toml"),
    edits: &[],
    step: 900.0,
    parts: 15,
    split: ["P10D", "P4D"],
    horizon: "PT6H",
    parameters: &[
        ("alpha_north", 0.06),
        ("alpha_south", 0.04),
        ("alpha_door", 0.1),
        ("c_north", 0.12),
        ("c_south", 0.08),
        ("lift", 8.0),
        ("T_north0", 19.0),
        ("T_south0", 21.0),
    ],
    inputs: &[("T_out[degC]", false), ("T_forward[degC]", false), ("P_pump[kW]", true)],
    draw: |dice, samples| {
        vec![
            waves(dice, samples, 2.0, &[(4.0, 96.0), (5.0, 400.0)]),
            waves(dice, samples, 36.0, &[(5.0, 130.0), (2.0, 37.0)]),
            switched(dice, samples, 24, &[0.0, 1.0, 1.0, 2.0]),
        ]
    },
    start: |p| vec![p[6], p[7]],
    rate: |p, x, u| {
        let heat = (u[1] + 273.15) / ((u[1] - u[0]).max(0.0) + p[5]) * u[2];
        let north = p[0] * (u[0] - x[0]) + p[2] * (x[1] - x[0]) + p[3] * heat;
        let south = p[1] * (u[0] - x[1]) + p[2] * (x[0] - x[1]) + p[4] * heat;
        vec![north / 3600.0, south / 3600.0]
    },
    outputs: &[("T_room_north[degC]", 0.05), ("T_room_south[degC]", 0.05)],
    measured: |x| x.to_vec(),
};

const STORE: Process = Process {
    document: include_str!("../../../../examples/models/store.toml"),
    edits: &[],
    step: 300.0,
    parts: 10,
    split: ["P3D", "P2D"],
    horizon: "PT1H",
    parameters: &[
        ("V", 0.1),
        ("mixing", 0.15),
        ("loss", 0.015),
        ("T_10", 55.0),
        ("T_20", 45.0),
        ("T_30", 30.0),
    ],
    inputs: &[
        ("T_charge[degC]", false),
        ("T_cold[degC]", false),
        ("T_cellar[degC]", false),
        ("Q_charge[m3/h]", true),
        ("Q_draw[m3/h]", true),
    ],
    draw: |dice, samples| {
        vec![
            waves(dice, samples, 58.0, &[(4.0, 150.0)]),
            waves(dice, samples, 10.0, &[(1.0, 288.0)]),
            waves(dice, samples, 14.0, &[(1.0, 288.0)]),
            switched(dice, samples, 20, &[0.0, 0.0, 0.05, 0.1]),
            switched(dice, samples, 6, &[0.0, 0.0, 0.0, 0.03, 0.12]),
        ]
    },
    start: |p| p[3..6].to_vec(),
    rate: |p, x, u| {
        let (charge, draw) = (u[3] / p[0], u[4] / p[0]);
        let loss = |x: f64| p[2] * (u[2] - x);
        [
            charge * (u[0] - x[0]) + (draw + p[1]) * (x[1] - x[0]) + loss(x[0]),
            (charge + p[1]) * (x[0] - x[1]) + (draw + p[1]) * (x[2] - x[1]) + loss(x[1]),
            (charge + p[1]) * (x[1] - x[2]) + draw * (u[1] - x[2]) + loss(x[2]),
        ]
        .map(|rate| rate / 3600.0)
        .to_vec()
    },
    outputs: &[("T_top[degC]", 0.2), ("T_middle[degC]", 0.2), ("T_bottom[degC]", 0.2)],
    measured: |x| x.to_vec(),
};

const TANKS: Process = Process {
    document: include_str!("../../../../examples/models/tanks.toml"),
    edits: &[],
    step: 4.0,
    parts: 8,
    split: ["PT2800S", "PT1296S"],
    horizon: "PT60S",
    parameters: &[
        ("k_pump", 180.0),
        ("k_upper", 250.0),
        ("k_lower", 220.0),
        ("upper0", 6.0),
        ("lower0", 8.0),
    ],
    inputs: &[("u[V]", true)],
    draw: |dice, samples| vec![switched(dice, samples, 40, &[1.5, 2.5, 3.5, 4.5, 5.0])],
    start: |p| p[3..5].to_vec(),
    rate: |p, x, u| {
        let out = p[1] * x[0].max(0.0).sqrt();
        vec![(p[0] * u[0] - out) / 3600.0, (out - p[2] * x[1].max(0.0).sqrt()) / 3600.0]
    },
    outputs: &[("level_upper[cm]", 0.05), ("level_lower[cm]", 0.05)],
    measured: |x| x.to_vec(),
};

const MOTOR: Process = Process {
    document: include_str!("../../../../examples/models/motor.toml"),
    edits: &[],
    step: 0.01,
    parts: 4,
    split: ["PT12S", "PT18S"],
    horizon: "PT0.5S",
    parameters: &[("R", 1.2), ("L", 0.08), ("K", 0.12), ("J", 0.01), ("b", 0.002)],
    inputs: &[("u[V]", true)],
    draw: |dice, samples| vec![switched(dice, samples, 60, &[-12.0, -6.0, 0.0, 6.0, 12.0])],
    start: |_| vec![0.0, 0.0],
    rate: |p, x, u| vec![(u[0] - p[0] * x[0] - p[2] * x[1]) / p[1], (p[2] * x[0] - p[4] * x[1]) / p[3]],
    outputs: &[("current[A]", 0.05), ("speed[rad/s]", 0.2)],
    measured: |x| x.to_vec(),
};

/// The motor, met while it runs: its states start from what is measured, and move between two samples by more
/// than the sensors err.
const RUNNING_MOTOR: Process = Process {
    edits: &[
        ["unit = \"A\"\ninitial = \"0\"", "unit = \"A\"\ninitial = \"current\""],
        ["unit = \"rad/s\"\ninitial = \"0\"", "unit = \"rad/s\"\ninitial = \"speed\""],
    ],
    start: |_| vec![8.0, 40.0],
    ..MOTOR
};

/// One twin of a process: the parameters that made it, and what was measured.
fn twin(process: &Process, seed: u64) -> (Vec<f64>, String) {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed);
    let split: Vec<f64> = process
        .split
        .iter()
        .map(|part| part.parse::<lampyris_core::data::Duration>().unwrap().seconds())
        .collect();
    let samples = (split.iter().sum::<f64>() / process.step).round() as usize;
    let truth: Vec<f64> =
        process.parameters.iter().map(|(_, value)| value * dice.random_range(0.75..1.3)).collect();
    let columns = (process.draw)(&mut dice, samples + 1);
    let mut csv = "time".to_owned();
    for name in
        process.inputs.iter().map(|(name, _)| name).chain(process.outputs.iter().map(|(name, _)| name))
    {
        let _ = write!(csv, ",{name}");
    }
    let mut x = (process.start)(&truth);
    let h = process.step / process.parts as f64;
    for k in 0..samples {
        let start: jiff::Timestamp = "2026-02-02T00:00:00Z".parse().unwrap();
        let time = start + jiff::SignedDuration::from_secs_f64(process.step * k as f64);
        let _ = write!(csv, "\n{time:.3}");
        columns.iter().for_each(|column| {
            let _ = write!(csv, ",{}", column[k]);
        });
        for (value, (_, noise)) in (process.measured)(&x).into_iter().zip(process.outputs) {
            let _ = write!(csv, ",{}", value + noise * normal(&mut dice));
        }
        // The classical Runge-Kutta method over parts of a sample.
        for part in 0..process.parts {
            let inputs = |share: f64| -> Vec<f64> {
                let way = (part as f64 + share) / process.parts as f64;
                let at = |(column, (_, held)): (&Vec<f64>, &(&str, bool))| match held {
                    true => column[k],
                    false => column[k] + (column[k + 1] - column[k]) * way,
                };
                columns.iter().zip(process.inputs).map(at).collect()
            };
            let moved = |slope: &[f64], step: f64| -> Vec<f64> {
                x.iter().zip(slope).map(|(x, slope)| x + step * slope).collect()
            };
            let a = (process.rate)(&truth, &x, &inputs(0.0));
            let b = (process.rate)(&truth, &moved(&a, h / 2.0), &inputs(0.5));
            let c = (process.rate)(&truth, &moved(&b, h / 2.0), &inputs(0.5));
            let d = (process.rate)(&truth, &moved(&c, h), &inputs(1.0));
            for (i, x) in x.iter_mut().enumerate() {
                *x += h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]);
            }
        }
    }
    (truth, csv)
}

/// What became of a twin: the gate's sentence, whether it accepts, and how many intervals hold the truth.
fn fitted(process: &Process, seed: u64) -> (String, bool, usize) {
    let (truth, csv) = twin(process, seed);
    let (window, report) = Window::parse_csv(&csv, &ColumnBindings::none()).unwrap();
    assert!(report.rejected_rows.is_empty() && report.warnings.is_empty(), "{report:?}");
    let mut catalogue = Catalogue::builtin().unwrap();
    let text = process.edits.iter().fold(process.document.to_owned(), |text, [from, to]| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    });
    let document = ModelDocument::from_toml(&text).unwrap();
    let model = document.id().parse().unwrap();
    catalogue.add_model(document);
    let [train, validation] = process.split.map(|part| part.parse().unwrap());
    let asked = EstimateRequest {
        step: Some(format!("PT{}S", process.step).parse().unwrap()),
        split: SplitRequest { train, validation, test: None },
        method: SeededMethod { seed, ..SeededMethod::default() },
        ..EstimateRequest::default()
    };
    let problem = prepare(&catalogue, &model, &asked, &window, &Site::default()).unwrap();
    let fit = estimate(&problem, &asked, None, &Control::NONE).unwrap();
    let policy = GatePolicy { horizon: process.horizon.parse().unwrap(), ..GatePolicy::default() };
    let judgement = validate(&problem, &fit, &Past::default(), &policy);
    let holds = |((name, _), truth): (&(&str, f64), &f64)| {
        fit.parameters[*name].ci95.is_some_and(|[low, high]| (low..=high).contains(truth))
    };
    let held = process.parameters.iter().zip(&truth).filter(|pair| holds(*pair)).count();
    (judgement.summary, matches!(judgement.verdict, Verdict::Accepted(_)), held)
}

fn holds_the_truth(name: &str, process: &Process) {
    let twins: u64 = if full() { 100 } else { 5 };
    let found: Vec<(String, bool, usize)> =
        (0..twins).into_par_iter().map(|seed| fitted(process, 61_000 + seed)).collect();
    let accepted = found.iter().filter(|(_, accepted, _)| *accepted).count();
    let held: usize = found.iter().map(|(.., held)| held).sum();
    let share = held as f64 / (process.parameters.len() * found.len()) as f64;
    println!(
        "own model {name}: {accepted} of {twins} accepted, {:.1} % of intervals hold the truth",
        100.0 * share
    );
    let others: Vec<&str> =
        found.iter().filter(|(_, accepted, _)| !accepted).map(|(summary, ..)| summary.as_str()).collect();
    assert!(20 * accepted >= 19 * found.len(), "{others:#?}");
    let least = if full() { 0.92 } else { 0.85 };
    assert!(share >= least && (share <= 0.98 || !full()), "{share}");
}

#[test]
fn two_zones_behind_a_heat_pump() {
    holds_the_truth("zones", &ZONES);
}

#[test]
fn a_stratified_store() {
    holds_the_truth("store", &STORE);
}

#[test]
fn cascaded_tanks_at_four_seconds() {
    holds_the_truth("tanks", &TANKS);
}

#[test]
fn a_motor_at_ten_milliseconds() {
    holds_the_truth("motor", &MOTOR);
}

#[test]
fn a_motor_that_runs_already() {
    holds_the_truth("running motor", &RUNNING_MOTOR);
}
