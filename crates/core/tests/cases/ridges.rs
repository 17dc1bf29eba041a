//! Parameters that can hardly be told apart: what the document of a plant says would separate them does so,
//! on twins of the plant, and what lies along a ridge is what the equations say.

use lampyris_core::data::{self, Window};
use lampyris_core::estimate::uncertainty::ridge::sentence;
use lampyris_core::estimate::uncertainty::sensitivity::Sensitivity;
use lampyris_core::estimate::uncertainty::{Uncertainty, uncertainty};
use lampyris_core::estimate::{Control, EstimateRequest, Problem, Site, estimate, prepare};
use lampyris_core::model::Catalogue;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::twin::plant::{PlantRequest, plant};

/// An experiment of some hours, at the times of the log that twins keep beside the influent.
const STEPS: &str = r#"
    id = "set_point_steps"
    title = "Steps of the oxygen set-point"
    explain = "For some hours the oxygen is kept lower."
    inputs.toxic = { unit = "-", hold = "zero_order" }
    replace.S_O_set = "S_O_set * (1 - 0.6*toxic)"
"#;

/// The uncertainty of three days of the healthy plant at its truth, with an experiment or without.
fn told(experiment: &str) -> (Problem, Uncertainty) {
    let mut catalogue = Catalogue::builtin().unwrap();
    let mut id = "asm1_h".to_owned();
    if !experiment.is_empty() {
        let effect = EffectSpec::from_toml(experiment).unwrap();
        id = format!("asm1_h+{}", effect.id);
        catalogue.add_effect(effect);
    }
    let twin = plant(
        &catalogue,
        &PlantRequest { seed: 3, model: &id, values: &[], days: 3, noise: 1.0, warm_up: false },
    )
    .unwrap();
    let (window, _) = Window::parse_csv(&twin.csv, &data::ColumnBindings::none()).unwrap();
    let asked = serde_json::json!({
        "objective": "nmse", "split": {"train": "P3D", "validation": "P0D", "test": "P0D"}
    });
    let asked: EstimateRequest = serde_json::from_value(asked).unwrap();
    let problem = prepare(&catalogue, &id.parse().unwrap(), &asked, &window, &Site::default()).unwrap();
    let truth: Vec<f64> = twin.truth.iter().map(|(_, value)| *value).collect();
    let known = uncertainty(&problem, &truth, None);
    // What the outputs answer may have been simulated before.
    let evaluations = known.evaluations;
    let again = uncertainty(&problem, &truth, Sensitivity::new(&problem, &truth));
    assert_eq!((Uncertainty { evaluations, ..again.clone() }, again.evaluations), (known.clone(), 0));
    (problem, known)
}

#[test]
fn the_experiment_that_a_document_names_tells_two_parameters_apart() {
    let names = ["mu_A", "K_OA"];
    let ((problem, plain), (_, stepped)) = (told(""), told(STEPS));
    let width = |known: &Uncertainty| {
        let place =
            problem.space().dimensions().iter().position(|dimension| dimension.name == "K_OA").unwrap();
        known.ci95[place].map_or(f64::INFINITY, |[low, high]| high - low)
    };
    let pair = |known: &Uncertainty| {
        known
            .correlated
            .iter()
            .find(|pair| names.iter().all(|name| pair.parameters.iter().any(|one| one == name)))
            .cloned()
    };
    let before = pair(&plain).unwrap();
    let said = sentence(&before, problem.model());
    println!("{said}; interval of K_OA {:.4} to {:.4} wide", width(&plain), width(&stepped));
    assert!(said.ends_with("a step in the oxygen set-point would separate them"), "{said}");
    assert!(pair(&stepped).is_none() && width(&stepped) < 0.3 * width(&plain), "{:?}", stepped.correlated);
}

/// A basin in which the product of two parameters counts, and one of them alone hardly.
const BASIN: &str = r#"
    id = "basin"
    title = "A basin"
    stepper = "rkc"
    [states]
    c = { unit = "g/m3", initial = "2" }
    [inputs]
    S_S = { unit = "g/m3", hold = "zero_order" }
    [parameters]
    a = { unit = "1/h", lower = 0.1, upper = 10, scale = "log", nominal = 1 }
    s = { unit = "-", lower = 0.01, upper = 10, scale = "log", nominal = 1 }
    [equations]
    c = "a*s*(S_S - c) + 0.01[g/m3/h]*s"
    [outputs]
    S_S_e = { expr = "c", unit = "g/m3", noise_sd = 0.05 }
"#;

#[test]
fn along_a_ridge_the_product_stays_where_only_the_product_counts() {
    // Between two samples the inflow is constant, and the way to what it leads to is exponential.
    let (a, s, step) = (0.6f64, 0.5f64, 1.0 / 6.0);
    let (mut csv, mut c) = ("time,S_S,S_S_e\n".to_owned(), 2.0f64);
    for k in 0..432 {
        let inflow = if (k / 36) % 2 == 0 { 10.0 } else { 4.0 };
        // An error that no parameter takes up.
        let error = 0.05 * ((k * k) as f64).sin();
        let (day, minutes) = (1 + k / 144, 10 * (k % 144));
        csv +=
            &format!("2026-03-{day:02}T{:02}:{:02}:00Z,{inflow},{}\n", minutes / 60, minutes % 60, c + error);
        let end = inflow + 0.01 / a;
        c = end + (c - end) * (-a * s * step).exp();
    }
    let (window, _) = Window::parse_csv(&csv, &data::ColumnBindings::none()).unwrap();
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_model(ModelDocument::from_toml(BASIN).unwrap());
    let asked = serde_json::json!({
        "method": {"name": "lm_multistart", "seed": 4},
        "split": {"train": "P2D", "validation": "P1D", "test": "P0D"}
    });
    let asked: EstimateRequest = serde_json::from_value(asked).unwrap();
    let problem = prepare(&catalogue, &"basin".parse().unwrap(), &asked, &window, &Site::default()).unwrap();
    let fit = estimate(&problem, &asked, None, &Control::NONE).unwrap();
    let [pair] = fit.correlated.as_slice() else { panic!("{:?}", fit.correlated) };
    assert_eq!(pair.parameters, ["a", "s"]);
    let products: Vec<f64> = pair.ridge.iter().map(|point| point.values[0] * point.values[1]).collect();
    println!("{:?}; products {products:.4?}; {:?}", pair.ridge, fit.remarks);
    assert_eq!(pair.ridge.len(), 5, "{:?}", pair.ridge);
    assert!(pair.ridge.windows(2).all(|two| two[1].values[0] > 1.1 * two[0].values[0]), "{:?}", pair.ridge);
    assert!(products.iter().all(|product| (product / (a * s) - 1.0).abs() < 0.02), "{products:?}");
    // The estimate lies at the bottom, and the error rises with the distance from it.
    let costs: Vec<f64> = pair.ridge.iter().map(|point| point.cost).collect();
    assert!(
        costs[0] > costs[1] && costs[1] > costs[2] && costs[2] < costs[3] && costs[3] < costs[4],
        "{costs:?}"
    );
    assert!(costs[2] == fit.cost && costs[4] < 1.1 * fit.cost, "{costs:?}");
    assert!(
        fit.remarks.iter().any(|remark| remark.contains("; with a from ") && remark.contains(" and s from ")),
        "{:?}",
        fit.remarks
    );
}
