//! What the document of a plant says would tell two parameters apart does so: on twins of the plant, by the curvature at the truth.

use lampyris::data::{self, Window};
use lampyris::estimate::uncertainty::{Uncertainty, ridge, uncertainty};
use lampyris::estimate::{EstimateRequest, Problem, Site, prepare};
use lampyris::model::Catalogue;
use lampyris::model::spec::EffectSpec;
use lampyris::twin::plant::{PlantRequest, plant};

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
    let twin = plant(&catalogue, &PlantRequest { seed: 3, model: &id, values: &[], days: 3, noise: 1.0, warm_up: false }).unwrap();
    let (window, _) = Window::parse_csv(&twin.csv, &data::Bindings::none()).unwrap();
    let asked = serde_json::json!({"objective": "nmse", "split": {"train": "P3D", "validation": "P0D", "test": "P0D"}});
    let asked: EstimateRequest = serde_json::from_value(asked).unwrap();
    let problem = prepare(&catalogue, &id.parse().unwrap(), &asked, &window, &Site::default()).unwrap();
    let truth: Vec<f64> = twin.truth.iter().map(|(_, value)| *value).collect();
    let known = uncertainty(&problem, &truth);
    (problem, known)
}

#[test]
fn the_experiment_that_a_document_names_tells_two_parameters_apart() {
    let names = ["mu_A", "K_OA"];
    let ((problem, plain), (_, stepped)) = (told(""), told(STEPS));
    let width = |known: &Uncertainty| {
        let place = problem.space().dimensions().iter().position(|dimension| dimension.name == "K_OA").unwrap();
        known.ci95[place].map_or(f64::INFINITY, |[low, high]| high - low)
    };
    let pair = |known: &Uncertainty| {
        known.correlated.iter().find(|pair| names.iter().all(|name| pair.parameters.iter().any(|one| one == name))).cloned()
    };
    let before = pair(&plain).unwrap();
    let said = ridge(&before, problem.model());
    println!("{said}; interval of K_OA {:.4} to {:.4} wide", width(&plain), width(&stepped));
    assert!(said.ends_with("a step in the oxygen set-point would separate them"), "{said}");
    assert!(pair(&stepped).is_none() && width(&stepped) < 0.3 * width(&plain), "{:?}", stepped.correlated);
}
