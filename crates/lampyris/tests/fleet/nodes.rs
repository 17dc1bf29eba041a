//! What one node does is seen by the others.

use super::Fleet;
use super::cut::Way;
use super::support::events::Stream;
use super::support::{Client, full, quick, seeded};
use serde_json::json;
use std::collections::BTreeSet;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// How soon every node shows what one was told.
const SOON: Duration = Duration::from_secs(2);

/// Asks until an answer is as it should be; says how long that took.
fn seen(client: &Client, path: &str, wanted: impl Fn(u16, &str) -> bool) -> Duration {
    let asked = Instant::now();
    loop {
        let answer = client.get(path);
        if wanted(answer.status, &answer.text) {
            return asked.elapsed();
        }
        assert!(asked.elapsed() < 60 * SOON, "{path}: {}", answer.text);
        sleep(Duration::from_millis(10));
    }
}

#[test]
fn what_one_node_is_told_the_other_one_serves() {
    let Some(fleet) = Fleet::new() else { return };
    let (one, two) = (fleet.node("api", &[]), fleet.node("api", &[]));
    let worker = fleet.node("worker,scheduler", &[]);
    one.client.lasting_room("1", 1);
    // A system that it has not heard of yet is looked for.
    two.client.get("/params/room/1").problem(404, "no-validated-parameters");
    let mut slowest = Duration::ZERO;
    for seed in 0..if full() { 20 } else { 4 } {
        let body = seeded(quick("room/1"), seed);
        let ended = one.client.ended(&one.client.post_job(&body));
        if ended["outcome"] != "accepted" {
            continue;
        }
        let revision = format!("\"revision\":{}", ended["revision"]);
        slowest = slowest.max(seen(&two.client, "/params/room/1", |_, text| text.contains(&revision)));
    }
    println!("FLEET: a revision is served by another node within {slowest:?} (target 2 s)");
    assert!(slowest < 10 * SOON, "{slowest:?}");
    let model = json!({
        "id": "own", "title": "A room of its own", "states": {"T_room": {"unit": "degC", "initial": "T_room"}},
        "equations": {"T_room": "-k * (T_room - T_out)"}, "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {"k": {"unit": "1/h", "lower": 0.001, "upper": 1.0, "nominal": 0.1, "scale": "log"}},
        "outputs": {"T_room": {"expr": "T_room", "unit": "degC", "noise_sd": 0.05}},
    });
    let posted = two.client.json("POST", "/models", &model);
    assert!(matches!(posted.status, 200 | 201), "{}", posted.text);
    seen(&one.client, "/models/own", |status, _| status == 200);
    drop(worker);
}

/// Polls two nodes in turns, each with the tag that the other gave.
#[test]
fn a_controller_that_changes_its_node_never_goes_back() {
    let Some(fleet) = Fleet::new() else { return };
    let (one, two) = (fleet.node("api", &[]), fleet.node("api", &[]));
    let worker = fleet.node("worker,scheduler", &[]);
    one.client.lasting_room("1", 1);
    one.client.ended(&one.client.post_job(&quick("room/1")));
    let (mut newest, mut tag, mut polls) = (0, String::new(), 0);
    let mut job = String::new();
    let most = if full() { 100_000 } else { 3_000 };
    while polls < most {
        if polls % 500 == 0 {
            let body = seeded(quick("room/1"), polls);
            job = one.client.post_job(&body);
        }
        let node = if polls % 2 == 0 { &one } else { &two };
        let answer = node.client.get_with("/params/room/1", &[("if-none-match", &tag)]);
        polls += 1;
        if answer.status == 304 {
            continue;
        }
        let revision = answer.expect(200).json()["revision"].as_i64().unwrap();
        assert!(revision >= newest, "{revision} behind {newest}");
        newest = revision;
        tag = node.client.get("/params/room/1").header("etag").to_owned();
    }
    one.client.ended(&job);
    println!("FLEET: {polls} polls in turns, up to revision {newest}, none went back");
    drop(worker);
}

#[test]
fn a_listener_goes_on_at_another_node_without_a_gap() {
    let Some(fleet) = Fleet::new() else { return };
    let (mut one, mut two) = (fleet.node("api", &[]), fleet.node("api", &[]));
    let worker = fleet.node("worker,scheduler", &[]);
    one.client.lasting_room("1", 1);
    let mut seeds = 0..;
    let mut post = |client: &Client| client.post_job(&seeded(quick("room/1"), seeds.next().unwrap()));
    let (mut posted, mut heard) = (BTreeSet::new(), BTreeSet::new());
    let mut listen = |stream: &mut Stream, ends: usize| {
        for _ in 0..ends {
            let told = stream.until(|told| told.event == "finished").pop().unwrap();
            let job = told.data["job"].as_str().or(told.data["id"].as_str()).unwrap().to_owned();
            assert!(heard.insert(job), "{told:?}");
        }
    };
    let mut stream = one.client.listen("/events", "");
    let kills = if full() { 50 } else { 2 };
    for _ in 0..kills {
        posted.extend([&two.client, &one.client, &two.client].map(&mut post));
        listen(&mut stream, 2);
        let last = stream.last_id.clone();
        drop(stream);
        // The one that is killed has acknowledged a job this moment.
        posted.insert(post(&one.client));
        one.kill();
        posted.insert(post(&two.client));
        stream = two.client.listen("/events", &last);
        listen(&mut stream, 3);
        (one, two) = (two, fleet.node("api", &[]));
    }
    assert_eq!(heard, posted);
    println!("FLEET: {kills} nodes killed, {} ends heard once each", heard.len());
    drop((worker, one, two));
}

#[test]
fn a_node_that_is_cut_off_says_so_serves_what_it_knows_and_catches_up() {
    let Some(fleet) = Fleet::new() else { return };
    let way = Way::to(&fleet.server());
    let (one, cut) = (fleet.node("api", &[]), fleet.node_by(&way, "api", &[]));
    let worker = fleet.node("worker,scheduler", &[]);
    one.client.lasting_room("1", 1);
    one.client.ended(&one.client.post_job(&quick("room/1")));
    seen(&cut.client, "/params/room/1", |status, _| status == 200);
    way.cut(true);
    let told = seen(&cut.client, "/readyz", |status, _| status == 503);
    let mut revision = 1;
    for seed in 1..20 {
        cut.client.get("/params/room/1").expect(200);
        let body = seeded(quick("room/1"), seed);
        let ended = one.client.ended(&one.client.post_job(&body));
        if let Some(published) = ended["revision"].as_i64() {
            revision = published;
            break;
        }
    }
    way.cut(false);
    let wanted = format!("\"revision\":{revision}");
    let caught_up = seen(&cut.client, "/params/room/1", |_, text| text.contains(&wanted));
    seen(&cut.client, "/readyz", |status, _| status == 200);
    println!(
        "FLEET: a node that was cut off says so within {told:?} (target 10 s), catches up within {caught_up:?} \
        (target 2 s)"
    );
    assert!(told < Duration::from_secs(60) && caught_up < 10 * SOON);
    drop(worker);
}
