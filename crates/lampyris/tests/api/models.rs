//! Models and effects as documents.

use crate::support::TestApp;
use crate::support::schema::disagreements;
use lampyris_core::model::plant::PlantSpec;
use serde_json::json;

fn leaky() -> serde_json::Value {
    json!({
        "id": "leaky", "title": "Leaky room",
        "states": {"T_r": {"unit": "degC", "initial": "T_room"}},
        "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {"a": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.1}},
        "equations": {"T_r": "a*(T_out - T_r)"},
        "outputs": {"T_room": {"expr": "T_r", "unit": "degC", "noise_sd": 0.05}},
    })
}

#[test]
fn an_effect_makes_a_new_model() {
    let app = TestApp::start();
    let base = app.get("/models/rc2").expect(200).json();
    assert_eq!(base["parameters"].as_array().unwrap().len(), 4);
    let made = app.json("POST", "/models/rc2/effects", &json!({"effect": "wind_infiltration"})).expect(201);
    assert_eq!(made.header("location"), "/models/rc2+wind_infiltration");
    let made = made.json();
    assert_eq!((made["id"].as_str(), made["parent"].as_str()), (Some("rc2+wind_infiltration"), Some("rc2")));
    assert_eq!(made["diff"]["terms"]["T_r"], "c_wind * wind_speed * (T_out - T_r)");
    assert_ne!(made["hash"], base["hash"]);
    assert_eq!(
        app.json("POST", "/models/rc2/effects", &json!({"effect": "wind_infiltration"})).expect(200).json(),
        made
    );
    let model = app.get("/models/rc2+wind_infiltration").expect(200).json();
    assert_eq!(
        (&model["hash"], &model["parent"], &model["effects"]),
        (&made["hash"], &made["parent"], &json!(["wind_infiltration"]))
    );
    let ids = app.get("/models").json()["items"].clone();
    assert!(ids.to_string().contains("rc2+wind_infiltration") && ids.to_string().contains("room3"), "{ids}");

    let slip = app
        .json("POST", "/models/rc2/effects", &json!({"effect": "wind_infiltratoin"}))
        .problem(422, "invalid-request");
    assert_eq!(
        (slip["errors"][0]["pointer"].as_str(), slip["errors"][0]["suggestion"].as_str()),
        (Some("/effect"), Some("did you mean `wind_infiltration`?"))
    );
    app.json("POST", "/models/rc9/effects", &json!({"effect": "wind_infiltration"}))
        .problem(404, "model-not-found");
    app.json("POST", "/models/rc2+wind_infiltration/effects", &json!({"effect": "wind_infiltration"}))
        .problem(422, "invalid-request");
}

#[test]
fn documents_of_users_are_taken_once_and_never_change() {
    let app = TestApp::start();
    let taken = app.json("POST", "/models", &leaky()).expect(201);
    assert_eq!(
        (taken.header("location"), taken.json()["parameters"][0]["name"].as_str()),
        ("/models/leaky", Some("a"))
    );
    app.json("POST", "/models", &leaky()).expect(200);
    let mut other = leaky();
    other["title"] = json!("Another room");
    app.json("POST", "/models", &other).problem(409, "already-exists");
    other["id"] = json!("rc2");
    app.json("POST", "/models", &other).problem(409, "already-exists");

    let effect = json!({
        "id": "lamp", "title": "A lamp", "explain": "A lamp that is always on warms the room.",
        "parameters": {"c_lamp": {"unit": "K/h", "lower": 0, "upper": 1, "scale": "linear", "nominal": 0.1}},
        "terms": {"T_r": "c_lamp"},
    });
    let version = app.json("POST", "/models/leaky/effects", &effect).expect(201).json();
    assert_eq!(version["id"], "leaky+lamp");
    assert_eq!(app.get("/effects/lamp").expect(200).json()["title"], "A lamp");
    app.json("POST", "/effects", &effect).expect(200);
    let mut other = effect;
    other["terms"]["T_r"] = json!("2 * c_lamp");
    app.json("POST", "/effects", &other).problem(409, "already-exists");
    app.json("PUT", "/systems/room/1", &json!({"model": "leaky+lamp"})).expect(201);
}

#[test]
fn a_dry_run_lists_every_fault() {
    let app = TestApp::start();
    assert_eq!(
        app.json("POST", "/models/validate", &leaky()).expect(200).json(),
        json!({"valid": true, "errors": []})
    );
    let mut bad = leaky();
    bad["equations"]["T_r"] = json!("aa*(T_out - T_r) + b");
    bad["parameters"]["a"]["upper"] = json!(0.0001);
    let check = app.json("POST", "/models/validate", &bad).expect(200).json();
    assert_eq!(check["valid"], false);
    assert!(check["errors"].as_array().unwrap().len() >= 3, "{check}");
    bad["parameters"]["a"]["scale"] = json!("lgo");
    bad["sttes"] = json!({});
    let check = app.json("POST", "/models/validate", &bad).expect(200).json();
    let pointers: Vec<&str> =
        check["errors"].as_array().unwrap().iter().map(|fault| fault["pointer"].as_str().unwrap()).collect();
    assert_eq!(pointers, ["/parameters/a/scale", "/sttes"], "{check}");
    app.json("POST", "/models", &bad).problem(422, "invalid-request");
    app.get("/models/leaky").problem(404, "model-not-found");
}

/// A plant of the catalogue under another name.
fn works() -> serde_json::Value {
    let spec = PlantSpec::from_toml(include_str!("../../../../config/plants/asm1_h.toml")).unwrap();
    serde_json::to_value(PlantSpec { id: "works".to_owned(), ..spec }).unwrap()
}

#[test]
fn a_plant_is_kept_as_posted_and_expands_where_it_is_compiled() {
    let mut app = TestApp::start();
    let taken = app.json("POST", "/models", &works()).expect(201);
    assert_eq!(taken.header("location"), "/models/works");
    let taken = taken.json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&taken, &schemas["Model"], &schemas, ""), [""; 0]);
    assert_eq!(taken["document"], works());
    // It is the plant of the catalogue, whose document was expanded when the program was started.
    let known = app.get("/models/asm1_h").expect(200).json();
    for same in ["states", "inputs", "parameters", "outputs"] {
        assert_eq!(taken[same], known[same], "{same}");
    }
    for same in ["equations", "define", "states", "outputs", "stepper"] {
        assert_eq!(taken["expanded"][same], known["document"][same], "{same}");
    }
    assert!(
        taken["expanded"]["equations"]["S_NH[aerobic]"].as_str().unwrap().contains("S_NH[anoxic]"),
        "{taken}"
    );
    assert_eq!(
        (known["expanded"].is_null(), app.get("/models/rc2").json()["expanded"].is_null()),
        (true, true)
    );

    app.json("POST", "/models", &works()).expect(200);
    let mut other = works();
    other["tanks"]["aerobic"]["volume"] = json!("6001[m3]");
    app.json("POST", "/models", &other).problem(409, "already-exists");
    let grown =
        app.json("POST", "/models/works/effects", &json!({"effect": "aeration_limit"})).expect(201).json();
    assert_eq!(grown["diff"]["replace"]["kLa_max"], "kLa_max * (1 - s_aeration)");
    app.json("PUT", "/systems/plant/1", &json!({"model": "works+aeration_limit"})).expect(201);
    app.restart();
    assert_eq!(app.get("/models/works").expect(200).json(), taken);
    assert_eq!(app.get("/models/works+aeration_limit").expect(200).json()["hash"], grown["hash"]);
}

#[test]
fn a_posted_plant_is_simulated_before_it_is_kept() {
    let app = TestApp::start();
    let shown =
        app.json("POST", "/models/preview", &json!({"model": works(), "max_points": 50})).expect(200).json();
    assert_eq!(shown["outputs"]["S_NH_e"]["unit"], "g/m3");
    let mut bad = works();
    bad["controller"]["tank"] = json!("arobic");
    bad["tanks"]["anoxic"]["volume"] = json!("2000");
    let problem = app.json("POST", "/models/preview", &json!({"model": bad})).problem(422, "invalid-request");
    let faults: Vec<(&str, &str)> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| (f["pointer"].as_str().unwrap(), f["suggestion"].as_str().unwrap()))
        .collect();
    assert_eq!(
        faults,
        [
            ("/model/tanks/anoxic/volume", "write a number with its unit, such as 2[m3]"),
            ("/model/controller/tank", "did you mean `aerobic`?")
        ]
    );
    app.get("/models/works").problem(404, "model-not-found");
}

/// A room between zones: one conductance per member of a set that the system names.
fn zoned() -> serde_json::Value {
    json!({
        "id": "zoned", "title": "Room between zones", "sets": ["zones"],
        "states": {"T_r": {"unit": "degC", "initial": "T_room"}},
        "inputs": {"T_out": {"unit": "degC"}, "T_z[z in zones]": {"unit": "degC", "channel": "T_zone_{z}"}},
        "parameters": {
            "a": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.1},
            "g[z in zones]": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.1},
        },
        "equations": {"T_r": "a*(T_out - T_r) + sum(z in zones: g[z]*(T_z[z] - T_r))"},
        "outputs": {"T_room": {"expr": "T_r", "unit": "degC", "noise_sd": 0.05}},
        "check": [{"kind": "stable"}],
    })
}

/// Hourly measurements of such a room, with a = 0.05, g[north] = 0.2 and g[south] = 0.6 per hour.
fn zoned_csv() -> String {
    let mut text = "time,T_room[degC],T_out[degC],T_zone_north[degC],T_zone_south[degC]\n".to_owned();
    let start: jiff::Timestamp = "2026-02-01T00:00:00Z".parse().unwrap();
    let at = |hour: f64| {
        [3.0 + 5.0 * (hour * 0.26).sin(), 18.0 + 2.0 * (hour * 0.11).sin(), 21.0 + 3.0 * (hour * 0.19).cos()]
    };
    let mut room = 18.0;
    for k in 0..15 * 24 {
        let [out, north, south] = at(f64::from(k));
        let next = at(f64::from(k) + 1.0);
        text.push_str(&format!(
            "{},{room:.4},{out:.4},{north:.4},{south:.4}\n",
            start + jiff::SignedDuration::from_hours(i64::from(k))
        ));
        for part in 0..600 {
            let share = (f64::from(part) + 0.5) / 600.0;
            let line = |from: f64, to: f64| from + (to - from) * share;
            let rate = 0.05 * (line(out, next[0]) - room)
                + 0.2 * (line(north, next[1]) - room)
                + 0.6 * (line(south, next[2]) - room);
            room += rate / 600.0;
        }
    }
    text
}

#[test]
fn a_model_with_a_set_and_a_family_is_posted_bound_and_fitted() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    let taken = app.json("POST", "/models", &zoned()).expect(201).json();
    assert_eq!(
        (&taken["sets"], taken["parameters"].as_array().unwrap().len()),
        (&json!(["zones"]), 1),
        "an unbound set is empty"
    );
    app.json("PUT", "/systems/room/1", &json!({"model": "zoned", "sets": {"zones": ["north", "south"]}}))
        .expect(201);
    assert_eq!(app.get("/systems/room/1").json()["sets"], json!({"zones": ["north", "south"]}));
    app.csv("/systems/room/1/windows", &zoned_csv()).expect(201);
    let job = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(job["state"], "succeeded", "{job}");
    let fit = app.get(job["links"]["fit"].as_str().unwrap()).expect(200).json();
    for (name, truth) in [("a", 0.05), ("g[north]", 0.2), ("g[south]", 0.6)] {
        let value =
            fit["parameters"][name]["value"].as_f64().unwrap_or_else(|| panic!("{name} is not in {fit}"));
        assert!((value / truth - 1.0).abs() < 0.02, "{name}: {value}");
    }
    let shown = app
        .json("POST", "/models/preview", &json!({"system": "room/1", "parameters": {"g[south]": 0.6}}))
        .expect(200)
        .json();
    assert_eq!(
        shown["parameters"].as_object().unwrap().keys().collect::<Vec<_>>(),
        ["a", "g[north]", "g[south]"]
    );

    let bad =
        json!({"model": "zoned", "sets": {"zone": ["a"], "zones": ["a b", "c", "c"], "neighbours": []}});
    let problem = app.json("PUT", "/systems/room/2", &bad).problem(422, "invalid-request");
    let found: Vec<(&str, &str)> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| (f["pointer"].as_str().unwrap(), f["code"].as_str().unwrap()))
        .collect();
    let expected = [
        ("/sets/neighbours", "contradiction"),
        ("/sets/zone", "unknown-set"),
        ("/sets/zones/0", "invalid-member"),
        ("/sets/zones/2", "named-twice"),
    ];
    assert!(expected.iter().all(|fault| found.contains(fault)), "{problem}");
    assert!(problem.to_string().contains("did you mean `zones`?"), "{problem}");
}

#[test]
fn a_family_of_effects_is_applied_by_its_argument() {
    let app = TestApp::start();
    let made =
        app.json("POST", "/models/rc2/effects", &json!({"effect": "metered_gain:P_lamp"})).expect(201).json();
    assert_eq!(
        (made["id"].as_str(), made["diff"]["terms"]["T_r"].as_str()),
        (Some("rc2+metered_gain:P_lamp"), Some("c_P_lamp * P_lamp"))
    );
    let model = app.get("/models/rc2+metered_gain:P_lamp").expect(200).json();
    assert_eq!((model["parent"].as_str(), &model["diff"]), (Some("rc2"), &made["diff"]));
    assert!(model["inputs"].as_array().unwrap().iter().any(|input| input["channel"] == "P_lamp"));
    let problem = app
        .json("POST", "/models/rc2/effects", &json!({"effect": "metered_gain"}))
        .problem(422, "invalid-request");
    assert_eq!(
        (problem["errors"][0]["pointer"].as_str(), problem["errors"][0]["code"].as_str()),
        (Some("/effect"), Some("argument-missing"))
    );

    // One more on top: its parent is the version, not the base.
    let sunny = app
        .json("POST", "/models/rc2+metered_gain:P_lamp/effects", &json!({"effect": "solar_gain"}))
        .expect(201)
        .json();
    assert_eq!(
        (sunny["id"].as_str(), sunny["parent"].as_str()),
        (Some("rc2+metered_gain:P_lamp+solar_gain"), Some("rc2+metered_gain:P_lamp"))
    );
    assert!(sunny["diff"]["define"]["S"].is_array(), "{sunny}");
    // A composition without one of its effects is a model as well.
    let less = app.get("/models/tite-solar_gain").expect(200).json();
    assert_eq!(less["effects"], json!(["metered_gain:P_heater"]));
    app.get("/models/rc2+solar_gian").problem(404, "model-not-found");

    // A posted effect is at home in every model that has its states, and a family of one's own works as well.
    let own = json!({
        "id": "draught", "title": "Draught to {channel}", "explain": "Air comes from {channel}.",
        "argument": "channel",
        "inputs": {"{channel}": {"unit": "degC"}},
        "parameters": {"c_{channel}": {
            "unit": "1/h", "lower": 0, "upper": 2, "scale": "linear", "nominal": 0.1
        }},
        "terms": {"T_r": "c_{channel} * ({channel} - T_r)"},
    });
    app.json("POST", "/models/rc2/effects", &own).problem(422, "invalid-request");
    app.json("POST", "/effects", &own).expect(201);
    let made =
        app.json("POST", "/models/room3/effects", &json!({"effect": "draught:T_attic"})).expect(201).json();
    assert_eq!(made["diff"]["terms"]["T_r"], "c_T_attic * (T_attic - T_r)");
}

#[test]
fn a_dry_run_says_line_column_and_what_was_meant() {
    let app = TestApp::start();
    let mut bad = leaky();
    bad["equations"]["T_r"] = json!("a*(T_out - T_r)\n  + sine(T_uot)");
    let check = app.json("POST", "/models/validate", &bad).expect(200).json();
    let faults = check["errors"].as_array().unwrap();
    let of = |code: &str| {
        faults
            .iter()
            .find(|fault| fault["code"] == code)
            .unwrap_or_else(|| panic!("{code} is not in {check}"))
    };
    assert_eq!(
        (of("unknown-name")["pointer"].as_str(), of("unknown-name")["suggestion"].as_str()),
        (Some("/equations/T_r"), Some("did you mean `T_out`?"))
    );
    assert!(of("unknown-name")["detail"].as_str().unwrap().starts_with("line 2, column 10: "), "{check}");
    assert_eq!(of("unknown-function")["suggestion"], "did you mean `sin`?");
    assert!(of("unknown-function")["detail"].as_str().unwrap().starts_with("line 2, column 5: "), "{check}");
    // A composition is checked as well.
    let ring =
        json!({"id": "mine", "title": "Mine", "base": "rc2", "effects": ["solar_gian", "constant_gain"]});
    let check = app.json("POST", "/models/validate", &ring).expect(200).json();
    assert_eq!(
        (check["valid"].as_bool(), check["errors"][0]["suggestion"].as_str()),
        (Some(false), Some("did you mean `solar_gain`?"))
    );
}
