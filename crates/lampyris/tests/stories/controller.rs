//! The controller: one address, one tag, and an answer for everything that goes wrong.

use crate::{Scene, hanging_csv, request, room, twin_csv};
use std::thread;
use std::time::Duration;

#[test]
fn the_controller_polls_and_is_never_without_an_answer() {
    let scene = Scene::open();
    let service = &scene.service.client;
    // Before anything is known the controller uses its own baseline, or the model's nominal values.
    service.get("/params/room/4").problem(404, "system-not-found");
    service.json("PUT", "/systems/room/4", &room("Living room")).expect(201);
    service.get("/params/room/4").problem(404, "no-validated-parameters");
    let nominal = service.get("/params/room/4?accept=nominal").expect(200);
    assert_eq!((nominal.header("params-status"), nominal.json()["revision"].is_null()), ("nominal", true));

    // It waits; as soon as a fit of unseen quality is there, it has it.
    let poll = {
        let service = service.clone();
        thread::spawn(move || service.get_with("/params/room/4", &[("prefer", "wait=60")]))
    };
    service.csv("/systems/room/4/windows", &twin_csv(401)).expect(201);
    let job = service.post_job(&request("room/4"));
    let first = poll.join().unwrap().expect(200);
    let (etag, set) = (first.header("etag").to_owned(), first.json());
    assert_eq!(
        (set["status"].as_str(), set["revision"].as_i64(), set["job"].as_str()),
        (Some("fresh"), Some(1), Some(job.as_str()))
    );
    assert!(set["parameters"]["alpha_n[1]"].is_f64() && set["units"]["alpha_h"] == "1/h", "{set}");
    // The twin's noise is 0.05 K; a day ahead the served set is not far above it.
    assert!(set["error"]["T_room"]["ahead"]["PT24H"].as_f64().unwrap() < 0.15, "{set}");

    // The same set costs no body, and a long poll without news ends by itself.
    service.get_with("/params/room/4", &[("if-none-match", &etag)]).expect(304);
    service.get_with("/params/room/4", &[("if-none-match", &etag), ("prefer", "wait=1")]).expect(304);
    // A model predictive controller starts from the states behind the newest sample.
    let state = service.get("/systems/room/4/state").expect(200).json();
    for name in ["T_r", "T_h", "T_e"] {
        assert!(
            (5.0..50.0).contains(&state["states"][name].as_f64().unwrap())
                && state["sd"][name].as_f64().unwrap() >= 0.0,
            "{state}"
        );
    }

    // A sensor hangs: the fit is refused, the old set stays, and the poll that waits is told why.
    let poll = {
        let (service, etag) = (service.clone(), etag.clone());
        thread::spawn(move || {
            service.get_with("/params/room/4", &[("if-none-match", &etag), ("prefer", "wait=60")])
        })
    };
    thread::sleep(Duration::from_millis(100));
    service.csv("/systems/room/4/windows", &hanging_csv(401)).expect(201);
    let refused = service.ended(&service.post_job(&request("room/4")));
    assert_eq!(refused["outcome"], "rejected", "{refused}");
    let told = poll.join().unwrap().expect(200);
    assert_eq!(told.header("params-status"), "fallback");
    let told = told.json();
    assert_eq!(
        (&told["parameters"], &told["revision"], &told["fit"]),
        (&set["parameters"], &set["revision"], &set["fit"])
    );
    assert_eq!(
        (told["fallback"]["reason"].as_str(), &told["fallback"]["fit"]),
        (Some("validation_failed"), &refused["fit"])
    );

    // All systems in one poll, for a controller that has many.
    let all = service.get("/params").expect(200);
    assert_eq!(all.json()["items"], serde_json::json!([told]));
    service.get_with("/params", &[("if-none-match", all.header("etag"))]).expect(304);
}
