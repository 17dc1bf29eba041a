//! Maximum likelihood on the data of the CTSM literature, beside ctsmTMB under the same conventions.

use lampyris::data::{Bindings, Window};
use lampyris::estimate::likelihood::likelihood_ratio;
use lampyris::estimate::{Control, EstimateRequest, Fit, Site, estimate, prepare};
use lampyris::model::Catalogue;
use lampyris::model::spec::{EffectSpec, ModelDocument};
use serde_json::json;

/// Log-likelihoods of ctsmTMB 1.1.1 on all 1,691 samples: zero-order hold, initial states fixed.
const REFERENCE: [(&str, f64); 4] = [("ti", 2476.3), ("tite", 3516.2), ("tith", 3903.2), ("titeth", 5430.1)];

/// The built-in models with every input held between samples.
fn held() -> Catalogue {
    let mut catalogue = Catalogue::builtin().unwrap();
    let outdoors = r#"T_out = { unit = "degC" }"#;
    let sun = r#"irradiance = { unit = "W/m2", min = 0 }"#;
    let held = |text: &str, input: &str| {
        assert!(text.contains(input));
        text.replace(input, &input.replace(" }", r#", hold = "zero_order" }"#))
    };
    for text in [
        include_str!("../../config/models/rc1.toml"),
        include_str!("../../config/models/rc2.toml"),
        include_str!("../../config/models/rc1_heater.toml"),
        include_str!("../../config/models/rc2_heater.toml"),
    ] {
        catalogue.add_model(ModelDocument::from_toml(&held(text, outdoors)).unwrap());
    }
    catalogue.add_effect(EffectSpec::from_toml(&held(include_str!("../../config/effects/solar_gain.toml"), sun)).unwrap());
    catalogue
}

#[test]
fn flexhouse_is_as_likely_as_by_ctsm() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data/rooms/dtu_flexhouse_prbs/flexhouse_5min.csv");
    let Ok(csv) = std::fs::read_to_string(path) else {
        println!("SKIPPED: the FlexHouse data may not be copied into the project and are not beside it");
        return;
    };
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=P_heater_W", "irradiance=ghi_W_m2"];
    let (window, _) = Window::parse_csv(&csv, &Bindings::parse(binds).unwrap()).unwrap();
    let request: EstimateRequest = serde_json::from_value(json!({
        "method": {"name": "ctsm", "seed": 1}, "objective": "likelihood",
        "split": {"train": "P6D", "validation": "P0D", "test": "P0D"},
    }))
    .unwrap();
    let fitted = |catalogue: &Catalogue, model: &str| -> Fit {
        let problem = prepare(catalogue, &model.parse().unwrap(), &request, &window, &Site::default()).unwrap();
        assert_eq!(problem.split().train, 0..1691);
        estimate(&problem, &request, None, &Control::NONE).unwrap()
    };
    let (held, builtin) = (held(), Catalogue::builtin().unwrap());
    let fits = REFERENCE.map(|(model, reference)| {
        let fit = fitted(&held, model);
        let found = fit.likelihood.as_ref().unwrap();
        let own = fitted(&builtin, model).likelihood.unwrap().log_likelihood;
        println!(
            "{model}: log-likelihood {:.1} (ctsmTMB {reference}), {} evaluations; with the declared holds {own:.1}; {}",
            found.log_likelihood, fit.evaluations, found.reason
        );
        // Of tith, ctsmTMB reports 1.2 more than there is with an initial state that is estimated and a first sample that
        // is no innovation: a filter written by hand and a simplex from many starts also end at 3902.0.
        let allowed = if model == "tith" { 1.3 } else { 1.0 };
        assert!(found.exact && found.log_likelihood >= reference - allowed, "{model}: {} < {reference}", found.log_likelihood);
        assert!(own >= reference - 1.0, "{model}: {own} < {reference}");
        fit
    });
    // The forward selection of the literature: each larger model explains more.
    for (smaller, larger) in [(0, 1), (0, 2), (2, 3), (1, 3)] {
        let test = likelihood_ratio(&fits[smaller], &fits[larger]).unwrap();
        println!("{}", test.sentence);
        assert!(test.p < 1e-6, "{test:?}");
    }
}
