//! What windows show adds up, is told per effect, and outlives the diagnoses that saw it.

use crate::support::TestApp;
use jiff::SignedDuration;
use lampyris::service::queue::retention;
use lampyris::store::diagnoses::Report;
use lampyris::store::entry::NewJob;
use lampyris::store::finish::{JobEnd, JudgedFit, finish};
use lampyris::store::fits::PackedFit;
use lampyris::store::jobs::{JobKind, Origin, Priority};
use lampyris::store::queue;
use lampyris::store::{Store, fits, workers};
use lampyris_core::diagnose::ledger::{EffectScore, Looked};
use lampyris_core::diagnose::report::Diagnosis;
use lampyris_core::estimate::{Judgement, Verdict};
use serde_json::{Value, json};
use std::time::Duration;

/// Lets jobs of a system end with diagnoses that looked at the fortnights beginning at these days of 2026,
/// each with the size that it saw of a meter and of the wind. The fit and the rest of the document are those
/// of a diagnosis that the service has made.
fn look(app: &mut TestApp, template: &Value, windows: &[(&str, &str, [f64; 2])]) -> Vec<String> {
    app.stop();
    let fit = template["fit"].as_str().unwrap();
    let document: Diagnosis = serde_json::from_value(template.clone()).unwrap();
    let now = app.clock.now();
    let made = app.block_on(async {
        let store = Store::open(&app.place(), None).await.unwrap();
        let boot = workers::enlist(&store, ("test", "worker"), Duration::from_secs(30), now).await.unwrap();
        let fit = fits::get(&store, fit).await.unwrap().unwrap().fit;
        let mut made = Vec::new();
        for (from, to, sizes) in windows {
            let new = NewJob {
                kind: JobKind::Diagnose,
                system: "room/1".parse().unwrap(),
                model: "rc2".parse().unwrap(),
                request: "{}".into(),
                experiment: true,
                origin: Origin::Posted,
                priority: Priority::Operator,
            };
            queue::submit(&store, &new, None, (100, 100), now).await.unwrap();
            let lease = queue::claim(&store, boot, now).await.unwrap().unwrap().lease().unwrap();
            let score = |effect: &str, size: f64| EffectScore {
                effect: effect.to_owned(),
                size,
                deviation: 0.05,
                unit: "K/(h*kW)".to_owned(),
                share: 0.21,
                t: size / 0.05,
                beyond_clock: size / 0.1,
                days: 14,
                shift_p: (effect != "wind_infiltration").then_some(0.05),
            };
            let effects = vec![score("metered_gain:P", sizes[0]), score("wind_infiltration", sizes[1])];
            let looked = Looked {
                from: format!("{from}T00:00:00Z"),
                to: format!("{to}T00:00:00Z"),
                hours: 12.0,
                effects,
            };
            let finding = JudgedFit {
                packed: PackedFit::new(&fit, &[]).unwrap(),
                fit: fit.clone(),
                windows: Vec::new(),
                judgement: Judgement {
                    verdict: Verdict::Rejected,
                    checks: Vec::new(),
                    summary: "no matter".to_owned(),
                },
                automatic: false,
                state: None,
                incumbent_state: None,
                report: Some(Report::Diagnosis(Box::new(Diagnosis {
                    looked: Some(looked),
                    ..document.clone()
                }))),
            };
            made.push(
                finish(&store, &lease, &JobEnd::Fitted(&finding), now).await.unwrap().diagnosis.unwrap(),
            );
        }
        store.close().await;
        made
    });
    app.restart();
    made
}

#[test]
fn windows_add_up_and_outlive_their_diagnoses() {
    let mut app = TestApp::with(|settings| {
        (settings.retention.jobs_days, settings.retention.diagnoses_days) = (30, 30)
    });
    app.room("1", 1);
    app.get("/systems/room/2/evidence").problem(404, "system-not-found");
    app.get("/systems/room/1/evidence?channel=P").problem(422, "invalid-request");
    assert_eq!(
        app.get("/systems/room/1/evidence").expect(200).json(),
        json!({"system": "room/1", "effects": []})
    );
    let short = json!({
        "kind": "diagnose", "system": "room/1", "window": {"last": "P2D"}, "method": {"name": "lm_multistart"}
    });
    let job = app.ended(&app.post_job(&short));
    let template = app.get(job["links"]["diagnosis"].as_str().unwrap()).expect(200).json();

    let windows = [
        ("2026-01-01", "2026-01-15", [0.30, 0.05]),
        ("2026-01-08", "2026-01-22", [0.90, 0.90]),
        ("2026-01-15", "2026-01-29", [0.20, -0.05]),
    ];
    let made = look(&mut app, &template, &windows);
    let evidence = app.get("/systems/room/1/evidence").expect(200).json();
    let effects = evidence["effects"].as_array().unwrap();
    let names: Vec<&str> = effects.iter().map(|effect| effect["effect"].as_str().unwrap()).collect();
    assert_eq!(names, ["metered_gain:P", "wind_infiltration"], "the most telling first");
    let told = |effect: &Value, field: &str| {
        effect["windows"].as_array().unwrap().iter().map(|window| window[field].clone()).collect::<Vec<_>>()
    };
    assert_eq!(told(&effects[0], "diagnosis"), [json!(made[2]), json!(made[1]), json!(made[0])]);
    assert_eq!(
        told(&effects[0], "from"),
        ["2026-01-15T00:00:00Z", "2026-01-08T00:00:00Z", "2026-01-01T00:00:00Z"]
    );
    assert_eq!(told(&effects[0], "pooled"), [true, false, true]);
    assert_eq!(told(&effects[0], "apart"), [Value::Null, json!("overlaps"), Value::Null]);
    let pooled = &effects[0]["pooled"];
    assert_eq!((pooled["windows"].as_u64(), effects[0]["model"].as_str()), (Some(2), Some("rc2")));
    assert!(
        (pooled["size"].as_f64().unwrap() - 0.25).abs() < 1e-12
            && (pooled["t"].as_f64().unwrap() - 10.0 / 2f64.sqrt()).abs() < 1e-12
    );
    let sentence = pooled["sentence"].as_str().unwrap();
    assert!(
        sentence.starts_with("In 2 windows since 1 January 2026 it explains 21 % of the error 12 h ahead"),
        "{sentence}"
    );
    assert!(effects[1]["pooled"]["shift_p"].is_null() && pooled["shift_p"].as_f64().unwrap() < 0.05);
    let wind = app.get("/systems/room/1/evidence?effect=wind_infiltration").expect(200).json();
    assert_eq!((wind["effects"].as_array().unwrap().len(), &wind["effects"][0]), (1, &effects[1]));
    assert_eq!(app.get("/systems/room/1/evidence?model=room3").expect(200).json()["effects"], json!([]));

    // The newest window says nothing of the meter any more.
    let last = look(&mut app, &template, &[("2026-02-01", "2026-02-15", [0.0, 0.0])]);
    let meter =
        app.get("/systems/room/1/evidence?effect=metered_gain:P").expect(200).json()["effects"][0].clone();
    assert!(meter["pooled"]["taken_back"]["z"].as_f64().unwrap() < -2.58, "{meter}");

    // Only the newest diagnosis is kept; what the others have seen stays.
    app.clock.set(app.clock.now() + SignedDuration::from_hours(24 * 40));
    app.within(async |service| retention::forget(service, service.now()).await.unwrap());
    app.get(&format!("/diagnoses/{}", made[0])).problem(404, "diagnosis-not-found");
    app.get(&format!("/diagnoses/{}", last[0])).expect(200);
    assert_eq!(
        app.get("/systems/room/1/evidence?effect=metered_gain:P").expect(200).json()["effects"][0],
        meter
    );

    // What newer measurements have contradicted may be fitted anew just now.
    app.until("/jobs?state=queued", |waiting| waiting["items"] == json!([]));
    app.until("/jobs?state=running", |running| running["items"] == json!([]));
    app.send("DELETE", "/systems/room/1?force=true", &[], None).unwrap().expect(204);
    app.room("1", 1);
    assert_eq!(app.get("/systems/room/1/evidence").expect(200).json()["effects"], json!([]));
}
