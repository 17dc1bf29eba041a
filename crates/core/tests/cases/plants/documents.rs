//! Documents of plants and of effects on them: what is replaced, what is refused and how that is said.

use super::{nominal, spec};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::expr::Node;
use lampyris_core::model::plant::PlantSpec;
use lampyris_core::model::process::ReactionsSpec;
use lampyris_core::model::spec::{EffectSpec, ModelSpec, OutputSpec};
use lampyris_core::model::{Bindings, Catalogue, Check, Model, compile};
use std::collections::HashMap;

/// The value of an output of the model where all states, inputs and parameters are one.
fn at_one(model: &Model, channel: &str) -> f64 {
    let output = model.outputs().iter().find(|output| output.channel == channel).unwrap();
    model.graph().evaluate(&[output.node], |_| 1.0)[0]
}

#[test]
fn what_is_replaced_means_in_its_own_text_what_it_meant_before() {
    let effect = |id: &str, replace: &str| {
        format!("id = \"{id}\"\ntitle = \"{id}\"\nexplain = \"test\"\n[replace]\n{replace}\n")
    };
    let rate = |effects: &[String]| {
        let mut catalogue = Catalogue::builtin().unwrap();
        let mut spec = spec("asm1_h");
        spec.outputs.clear();
        for (channel, expr, unit) in [
            ("decay", "decay_A[aerobic]", "g/m3/h"),
            ("flow", "Q_through", "m3/d"),
            ("growth", "growth_A[aerobic]", "g/m3/h"),
        ] {
            spec.outputs.insert(
                channel.to_owned(),
                OutputSpec { expr: expr.to_owned(), unit: unit.to_owned(), noise_sd: 1.0 },
            );
        }
        catalogue.add_model(ModelDocument::Spec(Box::new(spec)));
        let mut id = "asm1_h".to_owned();
        for effect in effects {
            let effect = EffectSpec::from_toml(effect).unwrap();
            id.push_str(&format!("+{}", effect.id));
            catalogue.add_effect(effect);
        }
        compile(&catalogue.compose(&id.parse().unwrap()).unwrap(), &Bindings::default())
    };
    let plain = rate(&[]).unwrap();
    // A fixed number, by two effects one after the other; an input; a free parameter.
    let twice = rate(&[
        effect("a", "b_A = \"2*b_A\""),
        effect("b", "b_A = \"b_A + 1[1/d]\"\nQ = \"3*Q\"\nmu_A = \"mu_A/2\""),
    ])
    .unwrap();
    let close = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-14, "{a} {b}");
    close(at_one(&plain, "decay"), 0.15 / 24.0);
    close(at_one(&twice, "decay"), 1.3 / 24.0);
    close(at_one(&twice, "flow") - at_one(&plain, "flow"), 2.0);
    close(at_one(&twice, "growth"), at_one(&plain, "growth") / 2.0);
    assert_ne!(plain.hash(), twice.hash());
    for (replace, code) in [
        ("b_A = \"2\"", "unit"),
        ("b_a = \"b_A\"", "unknown-name"),
        ("\"S_NH[aerobic]\" = \"0\"", "unknown-name"),
        ("b_A = \"b_B\"", "unknown-name"),
    ] {
        let faults = rate(&[effect("c", replace)]).unwrap_err();
        assert_eq!((faults.len(), faults[0].code.as_ref()), (1, code), "{replace}: {faults:?}");
        assert!(faults[0].pointer.starts_with("/effects/c/replace/"), "{faults:?}");
    }
    let ring = rate(&[effect("d", "b_A = \"b_A*Q_e/Q_e\"\nQ_e = \"Q_e*b_A/b_A\"")]).unwrap_err();
    assert!(ring.iter().any(|fault| fault.code == "cycle"), "{ring:?}");
}

#[test]
fn a_process_that_makes_something_out_of_nothing_is_refused() {
    let asm1 = include_str!("../../../../../config/models/asm1.toml");
    let plant = PlantSpec::from_toml(include_str!("../../../../../config/plants/asm1_h.toml")).unwrap();
    let faults = |asm1: &str| {
        let reactions = ReactionsSpec::from_toml(asm1).unwrap();
        plant.expand(&[(reactions.id.clone(), reactions)].into()).map(drop)
    };
    assert_eq!(faults(asm1), Ok(()));
    for (from, to, process, quantity, residual) in [
        // Yield and oxygen demand: 1 - Y_H is 0.33 at the plant's own value, and most at the least yield.
        ("S_O = \"-(1 - Y_H)/Y_H\"", "S_O = \"-1/Y_H\"", "growth_H_aerobic", "COD", 1.0),
        ("S_N2 = \"(1 - Y_H)/(2.86*Y_H)\"", "S_N2 = \"0\"", "growth_H_anoxic", "COD", f64::NAN),
        (
            "X_ND = \"i_XB - f_P*i_XP\"\n\n[[process]]\nname = \"decay_A\"",
            "\n[[process]]\nname = \"decay_A\"",
            "decay_H",
            "N",
            -0.086 + 0.08 * 0.06,
        ),
        (
            "S_ALK = \"1/14[g/mol]\"",
            "S_ALK = \"1/15[g/mol]\"",
            "ammonification",
            "charge",
            1.0 / 14.0 - 1.0 / 15.0,
        ),
    ] {
        assert!(asm1.contains(from), "{from}");
        let found = faults(&asm1.replacen(from, to, 1)).unwrap_err();
        assert_eq!(
            (found[0].code.as_ref(), found[0].pointer.as_str()),
            ("continuity", format!("/process/{process}").as_str()),
            "{found:?}"
        );
        assert!(found[0].detail.contains(quantity), "{found:?}");
        if residual.is_finite() {
            assert!(found[0].detail.contains(&format!("{residual:.3e}")), "{residual:.3e}: {found:?}");
        }
    }
    let unit = faults(&asm1.replacen("S_ALK = \"1/14[g/mol]\"", "S_ALK = \"1/14\"", 1)).unwrap_err();
    assert_eq!(unit[0].code, "unit", "{unit:?}");
    let slip = faults(&asm1.replacen("S_ND = \"-1\"", "S_MD = \"-1\"", 1)).unwrap_err();
    assert_eq!(slip[0].suggestion.as_deref(), Some("did you mean `S_ND`?"), "{slip:?}");
}

#[test]
fn a_plant_with_a_slip_says_all_that_is_wrong() {
    let good = include_str!("../../../../../config/plants/asm1_h.toml");
    let asm1 = ReactionsSpec::from_toml(include_str!("../../../../../config/models/asm1.toml")).unwrap();
    let bad = good
        .replacen("tank = \"aerobic\"", "tank = \"oxic\"", 1)
        .replacen("free = [", "free = [\"b_A\", \"mu_X\", ", 1)
        .replacen("mu_A = {", "mu_B = {", 1)
        .replacen("layers = 10", "layers = 9", 1);
    let faults = PlantSpec::from_toml(&bad).unwrap().expand(&[("asm1".to_owned(), asm1)].into()).unwrap_err();
    let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
    let layers = ["S_I", "S_S", "S_O", "S_NO", "S_NH", "S_ND", "S_ALK", "TSS"]
        .map(|name| format!("/settler/initial/{name}"));
    let mut expected = vec!["/parameters/mu_B", "/free/0", "/free/1"];
    expected.extend(layers.iter().map(String::as_str));
    expected.push("/controller/tank");
    assert_eq!(pointers, expected);
}

#[test]
fn a_check_of_a_plant_is_an_expression_in_its_names_and_units() {
    let codes = |expr: &str, unit: &str, lower: f64, upper: f64| {
        let range = |limit: f64| Some(limit).filter(|limit| limit.is_finite());
        let (name, expr, unit) = ("a check".to_owned(), expr.to_owned(), unit.to_owned());
        let checks = vec![Check::Range { name, expr, unit, lower: range(lower), upper: range(upper) }];
        let mut catalogue = Catalogue::builtin().unwrap();
        catalogue.add_model(ModelDocument::Spec(Box::new(ModelSpec { checks, ..spec("asm1_h") })));
        let faults = compile(&catalogue.compose(&"asm1_h".parse().unwrap()).unwrap(), &Bindings::default())
            .err()
            .unwrap_or_default();
        faults.into_iter().map(|fault| (fault.pointer, fault.code.to_string())).collect::<Vec<_>>()
    };
    let fault = |pointer: &str, code: &str| vec![(pointer.to_owned(), code.to_owned())];
    assert_eq!(codes("mu_H - b_H", "1/d", 0.0, f64::INFINITY), []);
    assert_eq!(codes("S_NH[aerobic] + S_NH", "g/m3", f64::NEG_INFINITY, 100.0), []);
    assert_eq!(codes("mu_H - b_X", "1/d", 0.0, 1.0), fault("/check/0/expr", "unknown-name"));
    assert_eq!(codes("mu_H", "g/m3", 0.0, 1.0), fault("/check/0/expr", "unit"));
    assert_eq!(codes("mu_H", "1/d", 1.0, 0.0), fault("/check/0/upper", "bounds"));
    assert_eq!(
        codes("mu_H", "1/d", f64::NEG_INFINITY, f64::INFINITY),
        fault("/check/0/lower", "missing-value")
    );
    for text in
        ["kind = \"range\"\nname = \"a\"\nexpr = \"mu_H\"\nlower = 0", "kind = \"stable\"\nexpr = \"mu_H\""]
    {
        let bad =
            include_str!("../../../../../config/plants/asm1_h.toml").to_owned() + "\n[[check]]\n" + text;
        assert_eq!(PlantSpec::from_toml(&bad).unwrap_err().code, "invalid-document", "{text}");
    }
}

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
