//! A record that begins long after the state that a plant's document states.

use lampyris_core::data::{self, Window};
use lampyris_core::estimate::{Control, EstimateRequest, Problem, Site, estimate, prepare};
use lampyris_core::model::Catalogue;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::{RecordMean, WarmUpInputs, WarmUpSpec};
use lampyris_core::twin::{PlantRequest, plant};

const MODEL: &str = "asm1_h";
/// Rows of five minutes in a day.
const PER_DAY: usize = 288;
/// Days that the plant runs before its record, and days of the record.
const BEFORE: usize = 10;
const RECORDED: usize = 4;

/// The catalogue in which the plant goes through so many hours of the record's mean influent.
fn led(hours: f64) -> Catalogue {
    let mut catalogue = Catalogue::builtin().unwrap();
    let Some(ModelDocument::Spec(spec)) = catalogue.model(MODEL).cloned() else {
        panic!("{MODEL} is a plant")
    };
    let warm_up =
        Some(WarmUpSpec { hours, inputs: WarmUpInputs::Record(RecordMean::Mean) }).filter(|_| hours > 0.0);
    catalogue
        .add_model(ModelDocument::Spec(Box::new(lampyris_core::model::spec::ModelSpec { warm_up, ..*spec })));
    catalogue
}

#[test]
fn a_warm_up_by_the_mean_influent_leads_to_a_record_that_begins_late() {
    let builtin = Catalogue::builtin().unwrap();
    let truth = [("mu_A", 0.5), ("Y_H", 0.6)];
    let request = PlantRequest {
        seed: 21,
        model: MODEL,
        values: &truth,
        days: BEFORE + RECORDED,
        noise: 1.0,
        warm_up: false,
    };
    let twin = plant(&builtin, &request).unwrap();
    let lines: Vec<&str> = twin.csv.lines().collect();
    let csv = [&lines[..1], &lines[1 + BEFORE * PER_DAY..]].concat().join("\n");
    let (window, _) = Window::parse_csv(&csv, &data::ColumnBindings::none()).unwrap();
    let fixed: serde_json::Map<String, serde_json::Value> = twin
        .truth
        .iter()
        .filter(|(name, _)| !truth.iter().any(|(free, _)| free == name))
        .map(|(name, v)| (name.clone(), (*v).into()))
        .collect();
    let asked = serde_json::json!({
        "method": {"name": "lm_multistart", "seed": 1},
        "split": {"train": "P3D", "validation": "P1D", "test": "P0D"},
        "budget": {"evaluations": 200}, "fixed": fixed,
    });
    let asked: EstimateRequest = serde_json::from_value(asked).unwrap();
    let problem = |hours: f64| {
        prepare(&led(hours), &MODEL.parse().unwrap(), &asked, &window, &Site::default()).unwrap()
    };
    let theta: Vec<f64> = twin.truth.iter().map(|(_, value)| *value).collect();
    let error = |problem: &Problem| {
        problem.free_run_error(&problem.simulate(&theta), 0..problem.grid().len()).unwrap()
    };
    let bias = |problem: &Problem| {
        let fit = estimate(problem, &asked, None, &Control::NONE).unwrap();
        truth.map(|(name, value)| (fit.parameters[name].value / value - 1.0).abs())
    };
    // As long as the plant has run since that state: it settles in no time that is short beside the age of
    // its sludge.
    let hours = 24.0 * BEFORE as f64;
    let (stated, led) = (problem(0.0), problem(hours));
    let (without, with) = (error(&stated), error(&led));
    let (from_stated, from_mean) = (bias(&stated), bias(&led));
    println!(
        "  the true plant errs by {without:.2} times the noise from the stated state, by {with:.2} after \
        {hours} h of its mean influent"
    );
    println!("  biases of mu_A and Y_H: {from_stated:.4?} and {from_mean:.4?}");
    assert!(with < 0.3 * without, "{with} {without}");
    let worst = |biases: [f64; 2]| biases[0].max(biases[1]);
    assert!(worst(from_mean) < 0.25 * worst(from_stated), "{from_mean:?} {from_stated:?}");
    // The mean is that of the training part alone.
    let all = led.averaged_over(0..RECORDED * PER_DAY);
    assert_ne!(all.simulate(&theta).outputs, led.simulate(&theta).outputs);
}
