//! Bad models, effects, systems and schedules.

use super::{Case, Mutation, as_json};
use crate::support::TestApp;
use serde_json::{Value, json};

type Faults = &'static [(&'static str, &'static str)];

fn one(area: &'static str, faults: Faults, apply: fn(&mut Value)) -> Mutation<Value> {
    Mutation { area, hides: &[], faults, apply }
}

/// A fault of form, behind which the meaning is not judged: what could not be read may be what others refer
/// to.
fn form(area: &'static str, faults: Faults, apply: fn(&mut Value)) -> Mutation<Value> {
    Mutation { area, hides: &["means"], faults, apply }
}

fn set(document: &mut Value, pointer: &str, value: Value) {
    let (parent, name) = pointer.rsplit_once('/').unwrap();
    match document.pointer_mut(parent).unwrap() {
        Value::Array(items) => items[name.parse::<usize>().unwrap()] = value,
        fields => fields[name] = value,
    }
}

fn drop_field(document: &mut Value, pointer: &str) {
    let (parent, name) = pointer.rsplit_once('/').unwrap();
    document.pointer_mut(parent).unwrap().as_object_mut().unwrap().shift_remove(name).unwrap();
}

fn good_model() -> Value {
    json!({
        "id": "walls", "title": "Room and walls", "description": "A room and its walls.", "sets": ["doors"],
        "states": {"T_r": {"unit": "degC", "initial": "T_room"}, "T_w": {"unit": "degC", "initial": "T_w0"}},
        "inputs": {"T_out": {"unit": "degC"}, "P_heater": {"unit": "kW", "hold": "zero_order", "min": 0}},
        "parameters": {
            "a": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.1},
            "b": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.1},
            "c": {"unit": "K/h per kW", "lower": 0, "upper": 10, "scale": "linear", "nominal": 1},
            "T_w0": {"unit": "degC", "lower": 0, "upper": 40, "scale": "linear", "nominal": "T_room"},
        },
        "define": {"loss": "b*(T_out - T_w)", "gain": [{"needs": ["P_heater"], "expr": "c*P_heater"}]},
        "equations": {"T_r": "a*(T_w - T_r) + gain", "T_w": "a*(T_r - T_w) + loss"},
        "outputs": {"T_room": {"expr": "T_r", "unit": "degC", "noise_sd": 0.05}},
        "check": [
            {"kind": "stable"},
            {"kind": "steady_gain", "input": "T_out", "state": "T_r", "above": 0, "upto": 1.05}
        ],
    })
}

fn model_mutations() -> Vec<Mutation<Value>> {
    vec![
        // What nobody knows hides nothing.
        one("field", &[("/sttes", "unknown-field")], |m| set(m, "/sttes", json!({}))),
        one("parameter field", &[("/parameters/c/uper", "unknown-field")], |m| {
            set(m, "/parameters/c/uper", json!(1))
        }),
        one("input field", &[("/inputs/T_out/holds", "unknown-field")], |m| {
            set(m, "/inputs/T_out/holds", json!("linear"))
        }),
        form("form title", &[("/title", "missing-field")], |m| drop_field(m, "/title")),
        form("form title", &[("/title", "wrong-type")], |m| set(m, "/title", json!(7))),
        form("form scale", &[("/parameters/a/scale", "unknown-value")], |m| {
            set(m, "/parameters/a/scale", json!("lgo"))
        }),
        form("form lower", &[("/parameters/b/lower", "wrong-type")], |m| {
            set(m, "/parameters/b/lower", json!("low"))
        }),
        form("form nominal", &[("/parameters/c/nominal", "wrong-type")], |m| {
            set(m, "/parameters/c/nominal", json!([1]))
        }),
        form("form hold", &[("/inputs/P_heater/hold", "unknown-value")], |m| {
            set(m, "/inputs/P_heater/hold", json!("zero"))
        }),
        form("form states", &[("/states", "wrong-type")], |m| set(m, "/states", json!(["T_r"]))),
        form("form state", &[("/states/T_w", "wrong-type")], |m| {
            set(m, "/states/T_w", json!(["degC", "T_w0"]))
        }),
        form("form equation", &[("/equations/T_w", "wrong-type")], |m| set(m, "/equations/T_w", json!(null))),
        form(
            "form variant",
            &[("/define/gain/0/expression", "unknown-field"), ("/define/gain/0/expr", "missing-field")],
            |m| {
                set(m, "/define/gain/0", json!({"expression": "c"}));
            },
        ),
        form("form noise", &[("/outputs/T_room/noise_sd", "wrong-type")], |m| {
            set(m, "/outputs/T_room/noise_sd", json!("small"))
        }),
        form("form check", &[("/check/0/kind", "unknown-value")], |m| {
            set(m, "/check/0/kind", json!("stabel"))
        }),
        form("form check", &[("/check/0/uper", "unknown-field")], |m| set(m, "/check/0/uper", json!(1))),
        form("form check", &[("/check/0", "invalid-value")], |m| {
            set(m, "/check/0", json!({"kind": "state_range", "lower": 1}))
        }),
        one("means id", &[("/id", "invalid-id")], |m| set(m, "/id", json!("walls+roof"))),
        one("means id", &[("/id", "invalid-id")], |m| set(m, "/id", json!("../walls"))),
        one("means input", &[("/inputs/P_heater/unit", "unit")], |m| {
            set(m, "/inputs/P_heater/unit", json!("horse"))
        }),
        one("means bounds", &[("/parameters/b/lower", "bounds")], |m| {
            set(m, "/parameters/b/lower", json!(0))
        }),
        one("means bounds", &[("/parameters/b/nominal", "bounds")], |m| {
            set(m, "/parameters/b/nominal", json!(99))
        }),
        one("means start", &[("/parameters/T_w0/nominal", "unknown-name")], |m| {
            set(m, "/parameters/T_w0/nominal", json!("T_rom"))
        }),
        one("means initial", &[("/states/T_r/initial", "unknown-name")], |m| {
            set(m, "/states/T_r/initial", json!("T_rom"))
        }),
        one("means family", &[("/inputs/T_n[n in rooms]", "unknown-set")], |m| {
            set(m, "/inputs/T_n[n in rooms]", json!({"unit": "degC"}))
        }),
        one("means twice", &[("/define/a", "name-taken")], |m| set(m, "/define/a", json!("1"))),
        one("means room", &[("/equations/T_r", "unknown-name")], |m| {
            set(m, "/equations/T_r", json!("aa*(T_w - T_r)"))
        }),
        one("means room", &[("/equations/T_r", "syntax")], |m| {
            set(m, "/equations/T_r", json!("a*(T_w - T_r"))
        }),
        one("means room", &[("/equations/T_r", "unit")], |m| set(m, "/equations/T_r", json!("a*T_w*T_r"))),
        one("means room", &[("/equations/T_r", "division-by-zero")], |m| {
            set(m, "/equations/T_r", json!("a*(T_w - T_r)/(2 - 2)"))
        }),
        one("means room", &[("/equations/T_r", "unknown-function")], |m| {
            set(m, "/equations/T_r", json!("system(1)"))
        }),
        one("means room", &[("/equations/T_r", "equation-missing")], |m| drop_field(m, "/equations/T_r")),
        one("means room", &[("/equations/T_r", "syntax")], |m| {
            set(m, "/equations/T_r", json!(format!("{}1{}", "(".repeat(500), ")".repeat(500))));
        }),
        one("means room", &[("/equations/T_r", "syntax")], |m| {
            set(m, "/equations/T_r", json!("1+".repeat(20_000) + "1"))
        }),
        one("means wall", &[("/equations/T_w", "negative-base")], |m| {
            set(m, "/equations/T_w", json!("a*(T_r - T_w) + b*((T_w/T_r - 1)^0.5)*T_r"))
        }),
        one("means wall", &[("/equations/T_w", "arguments")], |m| set(m, "/equations/T_w", json!("max(1)"))),
        one("means wall", &[("/equations/T_w", "unknown-set")], |m| {
            set(m, "/equations/T_w", json!("sum(n in rooms: a)*T_w"))
        }),
        one("means more", &[("/equations/T_x", "unknown-state")], |m| set(m, "/equations/T_x", json!("1"))),
        one("means cycle", &[("/define/y", "cycle")], |m| {
            set(m, "/define/x", json!("y"));
            set(m, "/define/y", json!("x"));
        }),
        one("means unused", &[("/define/z", "syntax")], |m| set(m, "/define/z", json!("1 +* 2"))),
        // Every text is short enough, but together they are more than a model may have.
        one("means size", &[("/define/w33", "too-large")], |m| {
            set(m, "/define/w", json!("a/b"));
            for step in 0..34 {
                let factors: Vec<String> = (0..500).map(|factor| format!("(w+{step}.{factor:03})")).collect();
                set(m, &format!("/define/w{step}"), json!(factors.join("*")));
            }
        }),
        one("means output", &[("/outputs/T_room/noise_sd", "noise")], |m| {
            set(m, "/outputs/T_room/noise_sd", json!(0))
        }),
        one("means output", &[("/outputs/T_room/expr", "unit")], |m| {
            set(m, "/outputs/T_room/unit", json!("kW"))
        }),
        one("means gate", &[("/check/1/input", "unknown-name")], |m| {
            set(m, "/check/1/input", json!("T_owt"))
        }),
        one("means gate", &[("/check/1/state", "unknown-state"), ("/check/1/upto", "bounds")], |m| {
            set(m, "/check/1/state", json!("T_q"));
            set(m, "/check/1/upto", json!(-1));
        }),
    ]
}

fn good_composition() -> Value {
    json!({
        "id": "windy", "title": "A windy room", "base": "rc2",
        "effects": ["wind_infiltration", "metered_gain:P_lights"]
    })
}

fn composition_mutations() -> Vec<Mutation<Value>> {
    vec![
        one("field", &[("/effect", "unknown-field")], |m| set(m, "/effect", json!("x"))),
        form("form effects", &[("/effects", "wrong-type")], |m| {
            set(m, "/effects", json!("wind_infiltration"))
        }),
        form("form effects", &[("/effects/1", "wrong-type")], |m| set(m, "/effects/1", json!(7))),
        one("means id", &[("/id", "invalid-id")], |m| set(m, "/id", json!("a room"))),
        one("means base", &[("/base", "unknown-model")], |m| set(m, "/base", json!("rc3"))),
        one("means base", &[("/base", "unknown-model")], |m| set(m, "/base", json!("windy"))),
        one("means first", &[("/effects/0", "unknown-effect")], |m| set(m, "/effects/0", json!("wind"))),
        one("means first", &[("/effects/0", "argument-unexpected")], |m| {
            set(m, "/effects/0", json!("wind_infiltration:T_room"))
        }),
        one("means second", &[("/effects/1", "argument-missing")], |m| {
            set(m, "/effects/1", json!("metered_gain"))
        }),
    ]
}

fn good_effect() -> Value {
    json!({
        "id": "lamp", "title": "A lamp", "explain": "A lamp warms the room.", "sign": "positive",
        "inputs": {"lux": {"unit": "-", "min": 0}},
        "parameters": {"c_lamp": {"unit": "K/h", "lower": 0, "upper": 1, "scale": "linear", "nominal": 0.1}},
        "terms": {"T_r": "c_lamp*lux"},
    })
}

fn effect_mutations() -> Vec<Mutation<Value>> {
    vec![
        one("field", &[("/explains", "unknown-field")], |m| set(m, "/explains", json!("x"))),
        form("form explain", &[("/explain", "missing-field")], |m| drop_field(m, "/explain")),
        form("form sign", &[("/sign", "unknown-value")], |m| set(m, "/sign", json!("plus"))),
        form("form terms", &[("/terms", "wrong-type")], |m| set(m, "/terms", json!("c_lamp"))),
        form("form upper", &[("/parameters/c_lamp/upper", "missing-field")], |m| {
            drop_field(m, "/parameters/c_lamp/upper")
        }),
        one("means id", &[("/id", "invalid-id")], |m| set(m, "/id", json!("a:b"))),
        one("means input", &[("/inputs/lux/unit", "unit")], |m| set(m, "/inputs/lux/unit", json!("lx"))),
        one("means bounds", &[("/parameters/c_lamp/nominal", "bounds")], |m| {
            set(m, "/parameters/c_lamp/nominal", json!(2))
        }),
        one("means term", &[("/terms/T_r", "unknown-name")], |m| set(m, "/terms/T_r", json!("c_lamp*lumen"))),
        one("means term", &[("/terms/T_r", "unit")], |m| set(m, "/terms/T_r", json!("c_lamp*c_lamp"))),
        one("means term", &[("/terms/T_r", "division-by-zero")], |m| set(m, "/terms/T_r", json!("c_lamp/0"))),
        one("means more", &[("/terms/T_zz", "unknown-state")], |m| set(m, "/terms/T_zz", json!("c_lamp"))),
        one("means output", &[("/outputs/T_nope", "unknown-output")], |m| {
            set(m, "/outputs", json!({"T_nope": "1"}))
        }),
        Mutation {
            area: "means",
            hides: &["*"],
            faults: &[("/terms", "no-terms")],
            apply: |m| set(m, "/terms", json!({})),
        },
    ]
}

fn named_effect_mutations() -> Vec<Mutation<Value>> {
    vec![
        one("field", &[("/model", "unknown-field")], |m| set(m, "/model", json!("rc2"))),
        one("name", &[("/effect", "unknown-effect")], |m| set(m, "/effect", json!("wind_infiltratoin"))),
        one("name", &[("/effect", "argument-missing")], |m| set(m, "/effect", json!("metered_gain"))),
        one("name", &[("/effect", "wrong-type")], |m| set(m, "/effect", json!(["wind_infiltration"]))),
        one("name", &[("/effect", "unknown-effect")], |m| set(m, "/effect", json!("../../etc"))),
    ]
}

fn good_system() -> Value {
    json!({
        "label": "Room 9", "model": "rc2",
        "location": {"lat": 56.5, "lon": 10.0, "zone": "Europe/Copenhagen"},
        "channels": {"T_room": "T_indoor"}, "neighbours": ["room/1", "room/2"], "prior": "none",
        "policy": {"mode": "auto", "stale_after": "P3D", "horizon": "PT6H"},
        "exclude": [{"from": "2026-01-01T00:00:00Z", "to": "2026-01-02T00:00:00Z", "reason": "sensor moved"}],
    })
}

fn system_mutations() -> Vec<Mutation<Value>> {
    vec![
        one("field", &[("/modle", "unknown-field")], |m| set(m, "/modle", json!("rc2"))),
        one("place field", &[("/location/latitude", "unknown-field")], |m| {
            set(m, "/location/latitude", json!(1))
        }),
        one("policy field", &[("/policy/mood", "unknown-field")], |m| set(m, "/policy/mood", json!("auto"))),
        one("model", &[("/model", "unknown-model")], |m| set(m, "/model", json!("rc9"))),
        one("model", &[("/model", "unknown-effect")], |m| set(m, "/model", json!("rc2+wind"))),
        one("model", &[("/model", "invalid-value")], |m| set(m, "/model", json!("rc2++"))),
        one("model", &[("/model", "no-model")], |m| drop_field(m, "/model")),
        one("model", &[("/model", "no-model")], |m| set(m, "/model", json!(null))),
        one("label", &[("/label", "wrong-type")], |m| set(m, "/label", json!(9))),
        one("lat", &[("/location/lat", "out-of-range")], |m| set(m, "/location/lat", json!(91))),
        one("lon", &[("/location/lon", "out-of-range")], |m| set(m, "/location/lon", json!(-181))),
        one("zone", &[("/location/zone", "unknown-zone")], |m| {
            set(m, "/location/zone", json!("Mars/Olympus"))
        }),
        one("channels", &[("/channels/T_room", "wrong-type")], |m| {
            set(m, "/channels/T_room", json!(["T_indoor"]))
        }),
        one("neighbour 0", &[("/neighbours/0", "own-neighbour")], |m| {
            set(m, "/neighbours/0", json!("room/9"))
        }),
        one("neighbour 0", &[("/neighbours/0", "invalid-value")], |m| {
            set(m, "/neighbours/0", json!("room 1"))
        }),
        one("neighbour 2", &[("/neighbours/2", "named-twice")], |m| {
            m["neighbours"].as_array_mut().unwrap().push(json!("room/2"))
        }),
        one("prior", &[("/prior", "unknown-value")], |m| set(m, "/prior", json!("lognormal"))),
        one("mode", &[("/policy/mode", "unknown-value")], |m| set(m, "/policy/mode", json!("automatic"))),
        one("stale", &[("/policy/stale_after", "invalid-value")], |m| {
            set(m, "/policy/stale_after", json!("3 days"))
        }),
        one("stale", &[("/policy/stale_after", "out-of-range")], |m| {
            set(m, "/policy/stale_after", json!("P0D"))
        }),
        one("horizon", &[("/policy/horizon", "wrong-type")], |m| set(m, "/policy/horizon", json!(6))),
        one("exclude", &[("/exclude/0", "out-of-order")], |m| {
            set(m, "/exclude/0/to", json!("2025-01-01T00:00:00Z"))
        }),
        one("exclude", &[("/exclude/0/from", "bad-time")], |m| {
            set(m, "/exclude/0/from", json!("2026-03-29T02:30:00"))
        }),
        one("exclude", &[("/exclude/0/to", "missing-field")], |m| drop_field(m, "/exclude/0/to")),
        one("exclude", &[("/exclude/0/why", "unknown-field")], |m| set(m, "/exclude/0/why", json!("x"))),
    ]
}

fn good_schedule() -> Value {
    json!({"cron": "0 3 * * *", "zone": "Europe/Copenhagen", "enabled": false, "systems": ["room/*"],
           "request": {"split": {"train": "P14D"}, "method": {"name": "cfa", "n": 40}}})
}

fn schedule_mutations() -> Vec<Mutation<Value>> {
    vec![
        one("field", &[("/crn", "unknown-field")], |m| set(m, "/crn", json!("x"))),
        one("cron", &[("/cron", "invalid-cron")], |m| set(m, "/cron", json!("61 * * * *"))),
        one("cron", &[("/cron", "missing-field")], |m| drop_field(m, "/cron")),
        one("cron", &[("/cron", "wrong-type")], |m| set(m, "/cron", json!(3))),
        one("zone", &[("/zone", "unknown-zone")], |m| set(m, "/zone", json!("Europe/Atlantis"))),
        one("enabled", &[("/enabled", "wrong-type")], |m| set(m, "/enabled", json!("yes"))),
        one("systems", &[("/systems", "empty")], |m| set(m, "/systems", json!([]))),
        one("systems", &[("/systems/0", "invalid-value")], |m| set(m, "/systems/0", json!("room"))),
        one("systems", &[("/systems", "missing-field")], |m| drop_field(m, "/systems")),
        one("request field", &[("/request/sede", "unknown-field")], |m| set(m, "/request/sede", json!(1))),
        one("request model", &[("/request/model", "unknown-field")], |m| {
            set(m, "/request/model", json!("rc2"))
        }),
        one("request systems", &[("/request/systems", "unknown-field")], |m| {
            set(m, "/request/systems", json!(["room/1"]))
        }),
        one("request split", &[("/request/split/train", "invalid-value")], |m| {
            set(m, "/request/split/train", json!("14 days"))
        }),
        one("request method", &[("/request/method/n", "out-of-range")], |m| {
            set(m, "/request/method/n", json!(1))
        }),
        one("request method", &[("/request/method/fireflies", "unknown-field")], |m| {
            set(m, "/request/method/fireflies", json!(1))
        }),
    ]
}

pub fn cases() -> Vec<Case> {
    let mut cases = super::cases(&good_model(), &model_mutations(), 60, 11, as_json("POST", "/models"));
    cases.extend(super::cases(
        &good_model(),
        &model_mutations(),
        30,
        12,
        as_json("POST", "/models/validate"),
    ));
    cases.extend(super::cases(
        &good_composition(),
        &composition_mutations(),
        12,
        13,
        as_json("POST", "/models"),
    ));
    cases.extend(super::cases(&good_effect(), &effect_mutations(), 25, 14, as_json("POST", "/effects")));
    cases.extend(super::cases(
        &good_effect(),
        &effect_mutations(),
        25,
        15,
        as_json("POST", "/models/rc2/effects"),
    ));
    cases.extend(super::cases(
        &json!({"effect": "wind_infiltration"}),
        &named_effect_mutations(),
        6,
        16,
        as_json("POST", "/models/rc2/effects"),
    ));
    cases.extend(super::cases(
        &good_system(),
        &system_mutations(),
        60,
        17,
        as_json("PUT", "/systems/room/9"),
    ));
    cases.extend(super::cases(
        &good_schedule(),
        &schedule_mutations(),
        40,
        18,
        as_json("PUT", "/schedules/odd"),
    ));
    let path = |_: &Value| {
        ("PUT", "/systems/Room/9".to_owned(), "application/json", good_system().to_string().into_bytes())
    };
    cases.extend(super::cases(
        &json!({}),
        &[one("path", &[("path", "invalid-system")], |_| {})],
        0,
        19,
        path,
    ));
    let path = |_: &Value| {
        ("PUT", "/schedules/a%20b".to_owned(), "application/json", good_schedule().to_string().into_bytes())
    };
    cases.extend(super::cases(&json!({}), &[one("path", &[("path", "invalid-name")], |_| {})], 0, 20, path));
    cases
}

pub fn check_good(app: &TestApp) {
    assert_eq!(app.json("POST", "/models/validate", &good_model()).expect(200).json()["errors"], json!([]));
    app.json("POST", "/models", &good_model()).expect(201);
    app.json("POST", "/models", &good_composition()).expect(201);
    app.json("POST", "/effects", &good_effect()).expect(201);
    app.json("POST", "/models/rc2/effects", &json!({"effect": "wind_infiltration"})).expect(201);
    app.json("PUT", "/systems/room/9", &good_system()).expect(201);
    app.json("PUT", "/schedules/odd", &good_schedule()).expect(201);
}
