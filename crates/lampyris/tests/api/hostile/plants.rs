//! Bad documents of treatment plants.

use super::{Case, Mutation, as_json};
use crate::support::TestApp;
use lampyris_core::model::plant::PlantSpec;
use serde_json::{Value, json};

/// Behind a fault of form nothing is judged, and behind one of these the equations are not.
fn means(
    area: &'static str,
    faults: &'static [(&'static str, &'static str)],
    apply: fn(&mut Value),
) -> Mutation<Value> {
    Mutation { area, hides: &["late"], faults, apply }
}

fn form(
    area: &'static str,
    faults: &'static [(&'static str, &'static str)],
    apply: fn(&mut Value),
) -> Mutation<Value> {
    Mutation { area, hides: &["means", "late"], faults, apply }
}

fn late(
    area: &'static str,
    faults: &'static [(&'static str, &'static str)],
    apply: fn(&mut Value),
) -> Mutation<Value> {
    Mutation { area, hides: &[], faults, apply }
}

fn set(plant: &mut Value, pointer: &str, value: Value) {
    *plant.pointer_mut(pointer).unwrap() = value;
}

/// A plant of the catalogue under another name.
pub fn good_plant() -> Value {
    let spec = PlantSpec::from_toml(include_str!("../../../../../config/plants/asm1_h.toml")).unwrap();
    serde_json::to_value(PlantSpec { id: "works".to_owned(), ..spec }).unwrap()
}

const LENGTHS: [(&str, &str); 8] = [
    ("/settler/initial/S_I", "length"),
    ("/settler/initial/S_S", "length"),
    ("/settler/initial/S_O", "length"),
    ("/settler/initial/S_NO", "length"),
    ("/settler/initial/S_NH", "length"),
    ("/settler/initial/S_ND", "length"),
    ("/settler/initial/S_ALK", "length"),
    ("/settler/initial/TSS", "length"),
];

fn mutations() -> Vec<Mutation<Value>> {
    vec![
        Mutation {
            area: "field",
            hides: &[],
            faults: &[("/valves", "unknown-field")],
            apply: |p| p["valves"] = json!(2),
        },
        Mutation {
            area: "tank field",
            hides: &[],
            faults: &[("/tanks/anoxic/depth", "unknown-field")],
            apply: |p| {
                p["tanks"]["anoxic"]["depth"] = json!("4[m]");
            },
        },
        form("form volume", &[("/tanks/aerobic/volume", "missing-field")], |p| {
            p["tanks"]["aerobic"].as_object_mut().unwrap().shift_remove("volume").unwrap();
        }),
        form("form volume", &[("/tanks/aerobic/volume", "wrong-type")], |p| {
            set(p, "/tanks/aerobic/volume", json!(6000))
        }),
        form("form layers", &[("/settler/layers", "wrong-type")], |p| {
            set(p, "/settler/layers", json!("ten"))
        }),
        form("form flows", &[("/flows/Q_w", "missing-field")], |p| {
            p["flows"].as_object_mut().unwrap().shift_remove("Q_w").unwrap();
        }),
        form("form reactions", &[("/reactions", "missing-field")], |p| {
            p.as_object_mut().unwrap().shift_remove("reactions").unwrap();
        }),
        Mutation {
            area: "means id",
            hides: &[],
            faults: &[("/id", "invalid-id")],
            apply: |p| p["id"] = json!("a+b"),
        },
        Mutation {
            area: "means reactions",
            hides: &["means of", "late"],
            faults: &[("/reactions", "unknown-name")],
            apply: |p| {
                p["reactions"] = json!("asm2d");
            },
        },
        means("means volume", &[("/tanks/aerobic/volume", "bounds")], |p| {
            set(p, "/tanks/aerobic/volume", json!("0[m3]"))
        }),
        means("means volume", &[("/tanks/aerobic/volume", "unit")], |p| {
            set(p, "/tanks/aerobic/volume", json!("6000[m2]"))
        }),
        means("means volume", &[("/tanks/aerobic/volume", "unit")], |p| {
            set(p, "/tanks/aerobic/volume", json!("6000"))
        }),
        means("means volume", &[("/tanks/aerobic/volume", "syntax")], |p| {
            set(p, "/tanks/aerobic/volume", json!("6000[m3"))
        }),
        means("means flow", &[("/flows/Q_r", "bounds")], |p| set(p, "/flows/Q_r", json!("-1[m3/d]"))),
        means("means flow", &[("/flows/Q_r", "unknown-name")], |p| set(p, "/flows/Q_r", json!("Q"))),
        means("means of tank", &[("/controller/tank", "unknown-name")], |p| {
            set(p, "/controller/tank", json!("arobic"))
        }),
        means("means gain", &[("/controller/gain", "bounds")], |p| {
            set(p, "/controller/gain", json!("0[m3/g/d]"))
        }),
        means("means area", &[("/settler/area", "bounds")], |p| set(p, "/settler/area", json!("1500[m2]*0"))),
        means("means of layers", &LENGTHS, |p| set(p, "/settler/layers", json!(9))),
        means("means of feed", &[("/settler/feed", "limit")], |p| set(p, "/settler/feed", json!(0))),
        means("means of held", &[("/settler/initial/X_BH", "unknown-name")], |p| {
            p["settler"]["initial"]["X_BH"] = json!([1, 2])
        }),
        means("means of initial", &[("/tanks/anoxic/initial", "length")], |p| {
            p["tanks"]["anoxic"]["initial"].as_array_mut().unwrap().push(json!(1));
        }),
        means("means start", &[("/tanks/aerobic/initial/2", "bounds")], |p| {
            set(p, "/tanks/aerobic/initial/2", json!(-1))
        }),
        means("means of free", &[("/free/0", "unknown-name")], |p| set(p, "/free/0", json!("Y_HH"))),
        means("means of free", &[("/free/0", "bounds")], |p| set(p, "/free/0", json!("K_OH"))),
        means("means of number", &[("/parameters/mu_AA", "unknown-name")], |p| {
            p["parameters"]["mu_AA"] = json!({"value": 0.5})
        }),
        means("means of name", &[("/tanks/s3", "name"), ("/tanks/s3/initial", "length")], |p| {
            p["tanks"]["s3"] = json!({"volume": "10[m3]", "initial": []});
        }),
        late("late output", &[("/outputs/S_S_e/expr", "unknown-name")], |p| {
            set(p, "/outputs/S_S_e/expr", json!("S_S_x"))
        }),
        late("late noise", &[("/outputs/S_NH_e/noise_sd", "noise")], |p| {
            set(p, "/outputs/S_NH_e/noise_sd", json!(0))
        }),
        late("late number", &[("/parameters/K_OA/nominal", "bounds")], |p| {
            set(p, "/parameters/K_OA/value", json!(3))
        }),
    ]
}

pub fn cases() -> Vec<Case> {
    let all = mutations();
    let mut cases = super::cases(&good_plant(), &all, 40, 21, as_json("POST", "/models"));
    cases.extend(super::cases(&good_plant(), &all, 10, 22, as_json("POST", "/models/validate")));
    cases
}

pub fn check_good(app: &TestApp) {
    assert_eq!(app.json("POST", "/models/validate", &good_plant()).expect(200).json()["errors"], json!([]));
    app.json("POST", "/models", &good_plant()).expect(201);
}
