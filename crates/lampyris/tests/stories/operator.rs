//! The operator: a command line against a running server, and nothing else.

use crate::{Scene, hanging_csv, room, twin_csv};
use serde_json::json;

#[test]
fn the_operator_keeps_two_rooms_in_order_from_the_command_line() {
    let scene = Scene::open();
    let verb = |line: &str| scene.service.verb(&line.split(' ').collect::<Vec<_>>());
    assert!(verb("systems list").expect(3).err.contains("empty"), "nothing is there yet");

    // Two rooms and their measurements.
    let document = scene.file("room.json", &room("Upstairs").to_string());
    for (system, seed) in [("room/4", 401), ("room/5", 403)] {
        verb(&format!("systems put {system} {document} --label Room_{seed}")).expect(0);
        let csv = scene.file("twin.csv", &twin_csv(seed));
        let told = verb(&format!("windows upload {system} {csv}")).expect(0).out;
        assert!(told.contains("673") && told.contains("T_forward"), "{told}");
    }
    let rooms = verb("systems list").expect(0).out;
    assert!(rooms.contains("room/4") && rooms.contains("Room_403") && rooms.contains("room3"), "{rooms}");
    assert_eq!(verb("windows list room/5 --json").expect(0).json()["items"][0]["rows"], 673);

    // The first fits, watched to their ends.
    let post = "--train P10D --validation P4D --method lm_multistart --seed 1";
    let told = verb(&format!("jobs post room/4 {post} --wait")).expect(0).out;
    for word in ["queued", "started", "finished", "succeeded, accepted, revision 1"] {
        assert!(told.contains(word), "{word} in {told}");
    }
    let events = verb(&format!("jobs post room/5 {post} --priority interactive --wait --json")).expect(0).out;
    let last: serde_json::Value = serde_json::from_str(events.lines().last().unwrap()).unwrap();
    assert_eq!(
        (last["event"].as_str(), last["data"]["outcome"].as_str()),
        (Some("finished"), Some("accepted")),
        "{last}"
    );
    let served = verb("params list").expect(0).out;
    assert_eq!(served.matches("fresh").count(), 2, "{served}");
    let one = verb("params get room/4").expect(0).out;
    assert!(one.contains("alpha_h") && one.contains("1/h") && one.contains("tag"), "{one}");

    // A sensor in room 4 hangs. The verb says so by its exit code, the service by its status.
    let csv = scene.file("hanging.csv", &hanging_csv(401));
    verb(&format!("windows upload room/4 {csv}")).expect(0);
    let told = verb(&format!("jobs post room/4 {post} --wait")).expect(3).out;
    assert!(told.contains("rejected"), "{told}");
    let job = verb("jobs list --system room/4 --json").expect(0).json()["items"][0].clone();
    let fit = verb(&format!("fits show {}", job["fit"].as_str().unwrap())).expect(3).out;
    assert!(fit.contains("FAIL G8") && fit.contains("rejected"), "{fit}");
    let served = verb("params list").expect(0).out;
    assert!(served.contains("fallback") && served.contains("validation_failed"), "{served}");

    // The stretch is left out, and the job done again: the room is served afresh.
    let mut document = room("Upstairs");
    document["exclude"] =
        json!([{"from": "2026-01-19T00:00:00Z", "to": "2026-02-01T00:00:00Z", "reason": "the sensor hangs"}]);
    let file = scene.file("room.json", &document.to_string());
    verb(&format!("systems put room/4 {file}")).expect(0);
    let told = verb(
        "jobs post room/4 --to 2026-01-18T23:59:00Z --train P4D --validation P2D --method lm_multistart \
        --wait",
    );
    let told = told.expect(0).out;
    assert!(told.contains("accepted") || told.contains("unchanged"), "{told}");
    assert_eq!(verb("params get room/4 --json").expect(0).json()["status"], "fresh");

    // A job that would never end is called off, and can be done again later.
    let file = scene
        .file("long.json", r#"{"method": {"name": "cfa_thesis"}, "budget": {"evaluations": 100000000}}"#);
    let long = verb(&format!("jobs post room/5 --file {file} --experiment --json")).expect(0).json()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    scene
        .service
        .client
        .until(&format!("/jobs/{long}"), |job| job["progress"]["evaluations"].as_u64().unwrap_or(0) > 0);
    assert!(verb(&format!("jobs show {long}")).expect(0).out.contains("evaluations"));
    assert!(verb(&format!("jobs retry {long}")).expect(1).err.contains("has not ended"), "it runs");
    verb(&format!("jobs cancel {long}")).expect(0);
    assert!(verb(&format!("jobs watch {long}")).expect(1).err.contains("cancelled"));
    let again = verb(&format!("jobs retry {long} --json")).expect(0).json();
    assert_eq!((again["retry_of"].as_str(), &again["experiment"]), (Some(long.as_str()), &json!(true)));
    verb(&format!("jobs cancel {}", again["id"].as_str().unwrap())).expect(0);

    // Every room of the house, as the night does it.
    let batch = verb(&format!("jobs post room/* --priority nightly {post} --json")).expect(0).json();
    assert_eq!((batch["kind"].as_str(), batch["jobs"].as_array().unwrap().len()), (Some("recalibrate"), 2));
    for job in batch["jobs"].as_array().unwrap() {
        scene.service.client.ended(job["job"].as_str().unwrap());
    }
    // A monitor sees the same from outside.
    let figures = scene.service.client.get("/metrics").expect(200).text;
    assert!(
        figures.contains("lampyris_jobs_ended_total{kind=\"estimate\",outcome=\"rejected\"} 1"),
        "{figures}"
    );
    assert_eq!(scene.service.client.get("/readyz").expect(200).json()["ready"], true);
}
