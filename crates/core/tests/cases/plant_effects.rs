//! What a plant may be missing: effects that replace names of its model, and what a diagnosis says of a plant
//! that hides one.

use super::plants::{full, nominal};
use lampyris_core::data::{self, Window};
use lampyris_core::diagnose::diagnose;
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Control, Site, prepare};
use lampyris_core::model::expr::Node;
use lampyris_core::model::{Bindings, Catalogue, compile};
use lampyris_core::twin::plant_world::{PLANT, PlantWorldRequest, plant_world};
use std::collections::HashMap;

#[test]
fn two_effects_of_a_plant_may_replace_the_same_name() {
    let catalogue = Catalogue::builtin().unwrap();
    for id in [
        "asm1_h+water_temperature+toxic_inflow",
        "asm1_h+rain_infiltration+carbon_load",
        "asm1_h+aeration_limit+bulking+recycle_loss+wasting_error",
        "asm1_h+alpha_fouling+analyser_lag+oxygen_sensor_bias",
        "asm1_l+analyser_drift+alpha_fouling",
    ] {
        let model = compile(&catalogue.compose(&id.parse().unwrap()).unwrap(), &Bindings::default());
        assert!(model.is_ok(), "{id}: {model:?}");
    }
    // Both act on the growth of nitrifiers.
    let model = compile(
        &catalogue.compose(&"asm1_h+water_temperature+toxic_inflow".parse().unwrap()).unwrap(),
        &Bindings::default(),
    )
    .unwrap();
    let growth = |toxic: f64, temperature: f64| {
        let theta: HashMap<&str, f64> =
            model.parameters().iter().map(|p| p.name.as_str()).zip(nominal(&model)).collect();
        let leaf = |node: Node| match node {
            Node::State(i) if model.states()[usize::from(i)].name.starts_with("S_ALK") => 5.0,
            Node::State(_) => 2.0,
            Node::Param(i) => theta[model.parameters()[usize::from(i)].name.as_str()],
            Node::Input(i, _) => match model.inputs()[usize::from(i)].name.as_str() {
                "toxic" => toxic,
                "temperature" => temperature,
                "Q" => 18_446.0,
                _ => 1.0,
            },
            _ => f64::NAN,
        };
        let place = model.states().iter().position(|state| state.name == "X_BA[aerobic]").unwrap();
        model.graph().evaluate(&model.rhs()[place..=place], leaf)[0]
    };
    let (free, poisoned) = (growth(0.0, 15.0), growth(1.0, 15.0));
    assert!(poisoned < free, "{free} {poisoned}");
    assert_ne!(growth(1.0, 8.0), poisoned);
    assert_ne!(growth(1.0, 8.0), growth(0.0, 8.0));
}

/// Plants that hide an effect, from the numbers of their document on: what is missing is named first. Minutes
/// of simulations each, so all but one with the full figures alone.
#[test]
fn what_a_plant_hides_is_named() {
    let catalogue = Catalogue::builtin().unwrap();
    let hidden = ["aeration_limit", "rain_infiltration", "toxic_inflow"];
    for effect in if full() { &hidden[..] } else { &hidden[..1] } {
        let request = PlantWorldRequest { seed: 5, effect: Some(effect), days: 6 };
        let (window, _) =
            Window::parse_csv(&plant_world(&catalogue, &request).unwrap().csv, &data::ColumnBindings::none())
                .unwrap();
        let asked = serde_json::json!({"split": {"train": "P4D", "validation": "P2D", "test": "P0D"}});
        let problem = prepare(
            &catalogue,
            &PLANT.parse().unwrap(),
            &serde_json::from_value(asked).unwrap(),
            &window,
            &Site::default(),
        )
        .unwrap();
        let found = diagnose(
            &catalogue,
            &problem,
            problem.nominal(),
            &window,
            &Site::default(),
            AccusationRate::USUAL,
            &[],
            &Control::NONE,
        )
        .unwrap();
        println!("{}", found.summary);
        assert_eq!(
            found.findings.first().map(|finding| finding.effect.as_str()),
            Some(*effect),
            "{}",
            found.summary
        );
        assert!(found.rho.unwrap() < 1.5, "{:?}", found.rho);
        // What a person sees says the same: the line of the errors by what the effect would add rises by
        // about one.
        let added = found.findings[0].shape.as_ref().and_then(|shape| shape.added.as_ref()).unwrap();
        println!("slope {:.2}", added.slope);
        assert!((0.5..1.5).contains(&added.slope), "{}", added.slope);
    }
}
