//! Warm water that arrives late: an effect document with `delay`, withheld from a twin and given back.

use super::{fit, request};
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::{EstimateRequest, Problem, Site, prepare};
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::model::{Catalogue, ModelId};
use lampyris_core::twin;

const LATE_WATER: &str = r#"
    id = "late_water"
    title = "Late water"
    explain = "Warm water arrives later than assumed."
    sign = "positive"
    [inputs]
    T_forward = { unit = "degC" }
    [parameters]
    tau_late = { unit = "h", lower = 0, upper = 6, scale = "linear", nominal = 1, title = "time in the pipes" }
    [terms]
    T_h = "alpha_w * M * (delay(T_forward, tau_late) - T_forward)"
"#;

fn built(csv: &str, model: &str, site: &Site, asked: &EstimateRequest) -> Problem {
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_effect(EffectSpec::from_toml(LATE_WATER).unwrap());
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::none()).unwrap();
    prepare(&catalogue, &model.parse::<ModelId>().unwrap(), asked, &window, site).unwrap()
}

/// The rows of a CSV with steps of the forward temperature, and a room that answers to them `late` hours
/// later.
fn late_room(seed: u64, late: f64) -> (String, Site) {
    let twin = twin::room(seed, 1, 14, 30).unwrap();
    let site = Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
    let mut lines = twin.csv.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let (room, forward) = (
        header.iter().position(|name| *name == "T_room"),
        header.iter().position(|name| *name == "T_forward"),
    );
    let (room, forward) = (room.unwrap(), forward.unwrap());
    let mut rows: Vec<Vec<String>> = lines.map(|line| line.split(',').map(str::to_owned).collect()).collect();
    for (k, row) in rows.iter_mut().enumerate() {
        // The supply is lowered at night: an edge by which a delay can be seen.
        let lowered = if (k / 2) % 24 < 6 { 12.0 } else { 0.0 };
        row[forward] = format!("{:.3}", row[forward].parse::<f64>().unwrap() - lowered);
    }
    let text = |rows: &[Vec<String>]| {
        let body: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
        format!("{}\n{}\n", header.join(","), body.join("\n"))
    };
    let problem = built(&text(&rows), "room3+late_water", &site, &request("P14D", "P0D", "P0D", 1));
    let theta: Vec<f64> = problem
        .model()
        .parameters()
        .iter()
        .map(|parameter| match parameter.name.as_str() {
            "tau_late" => late,
            // A thermostat that hardly closes lets the water speak.
            "k" => 0.3,
            name => twin_value(&twin, name),
        })
        .collect();
    let true_room = problem.simulate(&theta).outputs[0].clone();
    let mut state = seed;
    for (row, value) in rows.iter_mut().zip(&true_room) {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let noise = 0.06 * ((state >> 33) as f64 / (1u64 << 31) as f64 - 0.5);
        row[room] = format!("{:.4}", value + noise);
    }
    (text(&rows), site)
}

/// The twin's own value of a parameter of room3, by the order in which the model without the effect has them.
fn twin_value(twin: &twin::RoomTwin, name: &str) -> f64 {
    let site = Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
    let plain = built(&twin.csv, "room3", &site, &request("P14D", "P0D", "P0D", 1));
    let place = plain.model().parameters().iter().position(|parameter| parameter.name == name).unwrap();
    twin.theta[place]
}

#[test]
fn a_delay_that_is_given_back_is_found_and_the_error_falls() {
    let asked = request("P9D", "P4D", "P0D", 31);
    for (seed, late) in [(511, 2.3), (512, 4.0)] {
        let (csv, site) = late_room(seed, late);
        let without = fit(&built(&csv, "room3", &site, &asked), &asked);
        let with = fit(&built(&csv, "room3+late_water", &site, &asked), &asked);
        let error =
            |fit: &lampyris_core::estimate::Fit| fit.first_metrics().unwrap().validation_rmse.unwrap();
        let found = with.parameters["tau_late"].value;
        println!(
            "late by {late} h: found {found:.2} h; validation {:.3} K without, {:.3} K with",
            error(&without),
            error(&with)
        );
        assert!((found - late).abs() < 0.25, "{found}");
        assert!(
            error(&with) < 0.5 * error(&without) && error(&with) < 0.04,
            "{} {}",
            error(&with),
            error(&without)
        );
    }
}

/// A record that is longer than what is asked for brings the past along; a record that is not loses its first
/// hours.
#[test]
fn the_past_comes_from_before_the_training_part_where_there_is_any() {
    let (csv, site) = late_room(513, 2.0);
    let short = built(&csv, "room3+late_water", &site, &request("P9D", "P4D", "P0D", 1));
    assert_eq!(short.split().train.start, 12, "six hours at half-hour steps");
    assert_eq!(
        short.usable(0, short.split().train.clone()).len(),
        9 * 48 - 1,
        "only the restart itself is no prediction"
    );
    let whole = built(&csv, "room3+late_water", &site, &request("P14D", "P0D", "P0D", 1));
    assert_eq!(
        (whole.split().train.start, whole.usable(0, 0..20).len()),
        (1, 8),
        "a start, and what follows six hours"
    );
    let mut asked = request("P9D", "P4D", "P0D", 1);
    asked.bounds.insert("tau_late".into(), [0.0, 12.0]);
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_effect(EffectSpec::from_toml(LATE_WATER).unwrap());
    let (window, _) = Window::parse_csv(&csv, &ColumnBindings::none()).unwrap();
    let faults =
        prepare(&catalogue, &"room3+late_water".parse().unwrap(), &asked, &window, &site).unwrap_err();
    assert_eq!((faults[0].pointer.as_str(), faults[0].code.as_str()), ("/bounds/tau_late", "bounds"));
}
