//! Disturbances that were put in are seen with their size, and where none was put in none is told.

use super::disturbance::{Record, SeenRate};
use crate::interrupt::Brake;
use crate::model::document::ModelDocument;
use crate::model::{Bindings, Catalogue, compile};
use crate::simulate::Inputs;
use crate::simulate::kalman::Noise;
use crate::simulate::linearise::Linearisation;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// A room that loses heat: x' = a (u - x).
const ROOM: &str = r#"
    id = "room"
    title = "room"
    [states]
    x = { unit = "degC", initial = "y" }
    [inputs]
    u = { unit = "degC" }
    [parameters]
    a = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    [equations]
    x = "a*(u - x)"
    [outputs]
    y = { expr = "x", unit = "degC", noise_sd = 0.05 }
"#;

/// What is seen at the end of three days of quarters of an hour, over the last of which `flow` has warmed the
/// room, in K/h.
fn seen(flow: f64, seed: u64) -> Option<SeenRate> {
    let mut catalogue = Catalogue::default();
    catalogue.add_model(ModelDocument::from_toml(ROOM).unwrap());
    let model = compile(&catalogue.compose(&"room".parse().unwrap()).unwrap(), &Bindings::default()).unwrap();
    let (samples, hours, a) = (3 * 96 + 1, 0.25, 0.15);
    let outdoors: Vec<f64> =
        (0..samples).map(|k| 5.0 + 4.0 * (k as f64 / 96.0 * std::f64::consts::TAU).sin()).collect();
    let inputs = Inputs::from_columns(&model, vec![outdoors.clone()], hours);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut noise = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    let mut x = 15.0;
    let mut shown = Vec::new();
    for k in 0..samples {
        shown.push(Some(x + 0.05 * noise()));
        // The exact step under an input that is steady enough over a quarter of an hour.
        let middle = if k + 1 < samples { 0.5 * (outdoors[k] + outdoors[k + 1]) } else { outdoors[k] };
        let added = if k >= samples - 97 { flow } else { 0.0 };
        let rest = middle + added / a;
        x = rest + (x - rest) * (-a * hours).exp();
    }
    let noise = Noise { process: vec![0.02], measurement: vec![0.0025] };
    let theta = [a];
    let linear = Linearisation::of_states(&model, &inputs, &theta);
    let steps = linear.steps(0..samples - 1, &[15.0], &noise, &Brake::NONE).unwrap();
    let measured = [shown];
    let record = Record { steps: &steps, measured: &measured, variances: &noise.measurement, hours };
    record.seen(&[15.0], &[0.05])
}

#[test]
fn a_flow_that_nobody_logged_is_seen_with_its_size() {
    for (seed, flow) in [(1, 0.6), (2, -0.4), (3, 0.3)] {
        let found = seen(flow, seed).unwrap();
        assert!((found.value - flow).abs() < 3.0 * found.sd, "{flow}: {found:?}");
        assert!(found.sd < 0.15 && found.state == 0, "{flow}: {found:?}");
    }
}

#[test]
fn a_room_that_does_what_it_should_has_none() {
    let told: Vec<SeenRate> = (10..40).filter_map(|seed| seen(0.0, seed)).collect();
    assert!(told.len() <= 2, "{told:?}");
}
