//! The modeller: a document with faults, a document without, an effect, and two fits to compare.

use crate::support::process::verb;
use crate::{Scene, request, shown, twin_csv};
use serde_json::{Value, json};

/// A room with a heated floor and an envelope, but without the sun: written by hand, with three slips.
const WITH_SLIPS: &str = r#"
id = "sunless"
title = "Heated floor and envelope, no sun"
sets = ["neighbours"]

[states]
T_r = { unit = "degC", initial = "T_room" }
T_h = { unit = "degC", initial = "T_h0" }
T_e = { unit = "degC", initial = "T_e0" }

[inputs]
T_forward = { unit = "degC" }
T_out = { unit = "degC" }
"T_n[n in neighbours]" = { unit = "degC", channel = "T_room_{n}" }

[parameters]
a_h = { unit = "1/h", lower = 1e-3, upper = 15, scale = "log", nominal = 0.2 }
a_e = { unit = "1/h", lower = 1e-3, upper = 15, scale = "log", nominal = 0.2 }
a_w = { unit = "1/h", lower = 15, upper = 1e-3, scale = "log", nominal = 0.2 }
a_a = { unit = "1/h", lower = 1e-3, upper = 15, scale = "log", nominal = 0.2 }
"a_n[n in neighbours]" = { unit = "1/h", lower = 1e-3, upper = 15, scale = "log", nominal = 0.2 }
b_h = { unit = "-", lower = 0.05, upper = 50, scale = "log", nominal = 5 }
b_e = { unit = "-", lower = 0.05, upper = 50, scale = "log", nominal = 5 }
k = { unit = "1/K", lower = 0.1, upper = 10, scale = "linear", nominal = 3 }
T_set = { unit = "degC", lower = 19, upper = 23, scale = "linear", nominal = 21 }
T_h0 = { unit = "degC", lower = 10, upper = 40, scale = "linear", nominal = "T_room" }
T_e0 = { unit = "degC", lower = 10, upper = 40, scale = "linear", nominal = "T_room" }

[equations]
T_r = "a_h*(T_h - T_r) + a_ee*(T_e - T_r)"
T_h = "a_h/b_h*(T_r - T_h) + a_w*T_forward/(1 + exp(k*(T_r - T_set))) - a_w*T_h/(1 + exp(k*(T_r - T_set)))"
T_e = "a_e/b_e*(T_r - T_e) + a_a*(T_out - T_e) + sum(n in neighbours: a_n[n]*(T_n[n] - T_e)"

[outputs]
T_room = { expr = "T_r", unit = "degC", noise_sd = 0.05 }
"#;

fn mended() -> String {
    WITH_SLIPS
        .replace("a_ee*", "a_e*")
        .replace("(T_n[n] - T_e)\"", "(T_n[n] - T_e))\"")
        .replace("lower = 15, upper = 1e-3", "lower = 1e-3, upper = 15")
}

fn error(fit: &Value, part: &str) -> f64 {
    fit["metrics"]["T_room"][part].as_f64().unwrap()
}

#[test]
fn a_document_is_fitted_without_a_server() {
    let folder = tempfile::tempdir().unwrap();
    let written = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        shown(&path)
    };
    let (csv, file) = (written("house.csv", &twin_csv(423)), written("sunless.toml", WITH_SLIPS));
    let verb = |name: &str, more: &str| {
        let line = format!("{name} {csv} --model {file} --neighbours 1,2 {more}");
        verb("http://127.0.0.1:1", &line.split_whitespace().collect::<Vec<_>>())
    };
    // Every verb on measurements names all slips with their places, and the page about the language.
    for name in ["fit", "diagnose", "ladder", "tune"] {
        let faults = verb(name, "").expect(1).err;
        for place in [
            "/parameters/a_w/lower: ",
            "/equations/T_r: line 1, column 19: ",
            "/equations/T_e: line 1, column ",
        ] {
            assert!(faults.contains(place), "{name}: {place} in {faults}");
        }
        assert!(faults.contains("did you mean `a_e`?"), "{faults}");
        assert!(faults.contains("docs/reference/model-language.md"), "{faults}");
    }
    // Mended, it is a model like those of the catalogue, also for the effects that are added to it.
    written("sunless.toml", &mended());
    let search = "--method lm_multistart --evaluations 2000 --json";
    let base: Value = serde_json::from_str(&verb("fit", search).out).unwrap();
    let sunny: Value =
        serde_json::from_str(&verb("fit", &format!("{search} --with solar_gain")).out).unwrap();
    assert_eq!(
        (base["model"].as_str(), sunny["model"].as_str()),
        (Some("sunless"), Some("sunless+solar_gain"))
    );
    assert!(
        sunny["parameters"]["c_solar"].is_object() && base["parameters"]["a_n[2]"].is_object(),
        "{sunny}"
    );
    assert!(error(&sunny, "train_rmse") < error(&base, "train_rmse"));
}

#[test]
fn the_modeller_mends_a_document_adds_the_sun_and_sees_the_error_fall() {
    let scene = Scene::open();
    let service = &scene.service.client;
    let verb = |line: &str| scene.service.verb(&line.split(' ').collect::<Vec<_>>());

    // All slips at once, each with its place and what was probably meant. Nothing is taken.
    let file = scene.file("sunless.toml", WITH_SLIPS);
    let faults = verb(&format!("models validate {file}")).expect(3).out;
    for place in ["/parameters/a_w", "/equations/T_r", "/equations/T_e"] {
        assert!(faults.contains(place), "{place} in {faults}");
    }
    assert!(faults.contains("did you mean `a_e`?"), "{faults}");
    let refused = verb(&format!("models post {file}")).expect(1).err;
    assert_eq!(
        faults.lines().count(),
        refused.lines().count() - 1,
        "a refusal lists the same faults under its title: {refused}"
    );
    verb("models show sunless").expect(4);

    // Mended, it is taken; documents never change.
    let file = scene.file("sunless.toml", &mended());
    assert_eq!(verb(&format!("models validate {file}")).expect(0).out.trim(), "valid");
    assert!(verb(&format!("models post {file}")).expect(0).out.contains("a_h"));
    assert!(verb(&format!("models post {file}")).expect(0).out.contains("there already"));
    let other = scene.file("other.toml", &mended().replace("no sun", "a moon"));
    verb(&format!("models post {other}")).expect(1);

    // The room is fitted with it. The sun that shines on the twin is in no term.
    service
        .json("PUT", "/systems/room/4", &json!({"model": "sunless", "neighbours": ["room/1", "room/2"]}))
        .expect(201);
    service.csv("/systems/room/4/windows", &twin_csv(423)).expect(201);
    let base = service.ended(&service.post_job(&request("room/4")));
    assert_eq!(base["state"], "succeeded", "{base}");

    // An effect of the catalogue makes a new model, with a parent and a difference.
    let made = verb("models add-effect sunless solar_gain --json").expect(0).json();
    assert_eq!((made["id"].as_str(), made["parent"].as_str()), (Some("sunless+solar_gain"), Some("sunless")));
    assert_eq!(made["diff"]["terms"]["T_r"], "c_solar * S");
    assert!(
        verb("models add-effect sunless solar_gian").expect(1).err.contains("did you mean `solar_gain`?")
    );
    let with_sun = verb("models show sunless+solar_gain").expect(0).out;
    assert!(with_sun.contains("c_solar") && with_sun.contains("irradiance"), "{with_sun}");

    // Both fits side by side: the error falls on what the search has seen and on what it has not.
    let mut body = request("room/4");
    body["model"] = json!("sunless+solar_gain");
    let sunny = service.ended(&service.post_job(&body));
    assert_eq!(sunny["state"], "succeeded", "{sunny}");
    let fit =
        |job: &Value| service.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json();
    let (before, after) = (fit(&base), fit(&sunny));
    assert_eq!(
        (before["model"].as_str(), after["model"].as_str()),
        (Some("sunless"), Some("sunless+solar_gain"))
    );
    assert_eq!(before["input_hash"], after["input_hash"], "both have seen the same measurements");
    for part in ["train_rmse", "validation_rmse"] {
        assert!(
            error(&after, part) < 0.7 * error(&before, part),
            "{part}: {} to {}",
            error(&before, part),
            error(&after, part)
        );
    }
    assert!(
        error(&after, "train_rmse") < 0.06,
        "the twin's noise is 0.05 K: {}",
        error(&after, "train_rmse")
    );
    assert_eq!(after["parameters"]["c_solar"]["at_bound"], false);
    // A fit of another model than the system's own serves nobody, until the system says so.
    assert_ne!(service.get("/params/room/4?accept=nominal").expect(200).json()["fit"], after["id"]);
}
