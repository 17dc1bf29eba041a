//! Clients that ask for everything at once until the service is gone, and what was acknowledged to them.

use crate::database::{check_database, random, rows};
use crate::support::rooms::room_csv;
use crate::support::{Answer, Client, quick};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::thread;
use std::time::Duration;

/// Rooms that every round works on; windows go to the last two, so that the jobs of the others stay quick.
const ROOMS: [&str; 4] = ["room/1", "room/2", "room/3", "room/4"];
/// What a controller is sent of a revision, in the order in which the revision is kept.
const SERVED: [&str; 6] = ["model", "parameters", "units", "ci95", "flags", "error"];

/// What the service acknowledged, and what it showed.
#[derive(Default)]
pub struct Oracle {
    windows: Vec<String>,
    systems: BTreeSet<String>,
    /// Bodies by key; with the job, if there was an answer.
    jobs: BTreeMap<String, (Value, Option<String>)>,
    /// Experiments in the order of their answers.
    experiments: Vec<String>,
    /// Jobs that were told to be cancelled.
    cancelled: Vec<String>,
    promoted: Vec<String>,
    /// Fits of revisions that a pin made.
    pinned: BTreeMap<(String, i64), String>,
    /// Hashes of what was served under a system and a revision.
    served: BTreeMap<(String, i64), String>,
    /// The newest revision that anybody saw of a system.
    newest: BTreeMap<String, i64>,
    polls: u64,
}

/// A client that has no answer any more: the service is gone.
struct Gone;

/// Clients with a service of their own.
pub struct Traffic<'a> {
    client: &'a Client,
    oracle: &'a Mutex<Oracle>,
    round: u64,
    stop: AtomicBool,
}

/// Tells clients to stop, also where an assertion has failed: a scope waits for its threads.
pub struct StopOnDrop<'a>(pub &'a AtomicBool);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Makes the rooms that every round works on, with parameters in service for the first two.
pub fn prepare(client: &Client) {
    for room in ["1", "2"] {
        client.room(room, 1);
        let job = client.estimate(&format!("room/{room}"), json!({}));
        assert_eq!(client.ended(&job)["outcome"], "accepted");
    }
    for room in ["3", "4"] {
        client.json("PUT", &format!("/systems/room/{room}"), &json!({"model": "rc2"})).expect(201);
    }
}

impl<'a> Traffic<'a> {
    /// Lets eight writers, four pollers and a canceller go on until `end` returns and the service is gone. A
    /// round has a number of its own, so that whatever it sends is new.
    pub fn run(client: &'a Client, oracle: &'a Mutex<Oracle>, round: u64, end: impl FnOnce()) {
        let traffic = &Self { client, oracle, round, stop: AtomicBool::new(false) };
        thread::scope(|scope| {
            for number in 0..3 {
                scope.spawn(move || traffic.repeat(number, Self::upload));
            }
            for number in 0..2 {
                scope.spawn(move || traffic.repeat(number, Self::experiment));
            }
            for number in 0..2 {
                scope.spawn(move || traffic.repeat(number, Self::commission));
            }
            scope.spawn(move || traffic.repeat(0, Self::pin));
            scope.spawn(move || traffic.repeat(0, Self::cancel));
            for number in 0..4 {
                scope.spawn(move || traffic.repeat(number, Self::poll));
            }
            let _stopping = StopOnDrop(&traffic.stop);
            end();
        });
    }

    fn repeat(&self, number: u64, step: impl Fn(&Self, u64, u64) -> Result<(), Gone>) {
        let mut turn = 0;
        while !self.stop.load(Ordering::Relaxed) && step(self, number, turn).is_ok() {
            turn += 1;
        }
    }

    fn oracle(&self) -> MutexGuard<'_, Oracle> {
        self.oracle.lock().unwrap()
    }

    fn send(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> Result<Answer, Gone> {
        self.client.send(method, path, headers, Some(body.as_bytes())).map_err(|_| Gone)
    }

    fn json(&self, method: &str, path: &str, body: &Value) -> Result<Answer, Gone> {
        self.send(method, path, &[("content-type", "application/json")], &body.to_string())
    }

    fn window(&self, system: &str, key: &str, body: &str) -> Result<(), Gone> {
        let path = format!("/systems/{system}/windows");
        let answer = self
            .send("POST", &path, &[("content-type", "text/csv"), ("idempotency-key", key)], body)?
            .expect(201);
        self.oracle().windows.push(text(&answer.json()["id"]));
        Ok(())
    }

    /// A day of measurements that nobody has sent before.
    fn upload(&self, number: u64, turn: u64) -> Result<(), Gone> {
        let day = format!("{}-{:02}-{:02}", 1990 + turn / 336 % 35, 1 + turn / 28 % 12, 1 + turn % 28);
        let body = room_csv(10 * self.round + number, 1).replace("2026-01-01", &day);
        self.window(ROOMS[2 + number as usize % 2], &format!("window {} {number} {turn}", self.round), &body)
    }

    /// Submits a job under a key that is known before it is sent, as a client that means to try again does.
    fn submit(&self, key: String, body: Value) -> Result<String, Gone> {
        self.oracle().jobs.insert(key.clone(), (body.clone(), None));
        let headers = [("content-type", "application/json"), ("idempotency-key", key.as_str())];
        let job = text(&self.send("POST", "/jobs", &headers, &body.to_string())?.expect(202).json()["id"]);
        self.oracle().jobs.insert(key, (body, Some(job.clone())));
        Ok(job)
    }

    /// Waits for the end of a job.
    fn ended(&self, job: &str) -> Result<Value, Gone> {
        while !self.stop.load(Ordering::Relaxed) {
            let document = self.send("GET", &format!("/jobs/{job}"), &[], "")?.expect(200).json();
            if ["succeeded", "failed", "cancelled"].contains(&document["state"].as_str().unwrap()) {
                return Ok(document);
            }
            thread::sleep(Duration::from_millis(10));
        }
        Err(Gone)
    }

    /// A job that alters nothing that is served; every other one is waited for, so that the queue stays
    /// short.
    fn experiment(&self, number: u64, turn: u64) -> Result<(), Gone> {
        let mut body = quick(ROOMS[number as usize]);
        body["experiment"] = json!(true);
        body["method"]["seed"] = json!(1_000_000 * (self.round + 1) + turn);
        let job = self.submit(format!("experiment {} {number} {turn}", self.round), body)?;
        self.oracle().experiments.push(job.clone());
        if turn % 2 == 1 {
            self.ended(&job)?;
        }
        Ok(())
    }

    /// A new room up to parameters in service, by the gate alone or by an operator's word.
    fn commission(&self, number: u64, turn: u64) -> Result<(), Gone> {
        let system = format!("room/{}-{number}-{turn}", self.round);
        let mode = ["auto", "suggest"][number as usize];
        self.json("PUT", &format!("/systems/{system}"), &json!({"model": "rc2", "policy": {"mode": mode}}))?
            .expect(201);
        self.oracle().systems.insert(system.clone());
        self.window(&system, &format!("window {system}"), &room_csv(1, 14))?;
        let job = self.submit(format!("job {system}"), quick(&system))?;
        let ended = self.ended(&job)?;
        assert_eq!(ended["outcome"], ["accepted", "suggested"][number as usize], "{ended}");
        if mode == "suggest" {
            let fit = text(&ended["fit"]);
            self.json("POST", &format!("/fits/{fit}/promote"), &json!({"reason": "looks right"}))?
                .expect(200);
            self.oracle().promoted.push(fit);
        }
        self.look(&system)
    }

    /// Pins what is served, and takes the pin away again; each pin is a revision.
    fn pin(&self, _: u64, _: u64) -> Result<(), Gone> {
        let pin = "/params/room/2/pin";
        let body = self.json("PUT", pin, &json!({"reason": "sensor swap"}))?.expect(200).json();
        let (revision, fit) = (body["revision"].as_i64().unwrap(), text(&body["fit"]));
        self.oracle().pinned.insert(("room/2".into(), revision), fit);
        self.send("DELETE", pin, &[], "")?.expect(204);
        thread::sleep(Duration::from_millis(20));
        Ok(())
    }

    /// Calls one of the newest experiments off.
    fn cancel(&self, _: u64, turn: u64) -> Result<(), Gone> {
        thread::sleep(Duration::from_millis(15));
        let mut seed = self.round + turn;
        let job = self.oracle().experiments.iter().rev().nth(random(&mut seed) as usize % 20).cloned();
        let Some(job) = job else { return Ok(()) };
        let told = self.send("POST", &format!("/jobs/{job}/cancel"), &[], "")?;
        if told.status == 409 {
            told.problem(409, "already-deciding");
        } else if told.expect(200).json()["state"] == "cancelled" {
            self.oracle().cancelled.push(job);
        }
        Ok(())
    }

    /// A controller.
    fn poll(&self, number: u64, _: u64) -> Result<(), Gone> {
        thread::sleep(Duration::from_millis(3));
        self.look(ROOMS[number as usize % 2])
    }

    /// Looks at what is served, and whether it goes with what was served before.
    fn look(&self, system: &str) -> Result<(), Gone> {
        // Whatever anybody had seen before this request was sent may not be undone by its answer.
        let before = self.oracle().newest.get(system).copied();
        let answer = self.send("GET", &format!("/params/{system}"), &[], "")?.expect(200);
        self.oracle().saw(system, &answer, before);
        Ok(())
    }
}

impl Oracle {
    #[track_caller]
    fn saw(&mut self, system: &str, answer: &Answer, before: Option<i64>) {
        assert_eq!(
            answer.header("etag"),
            format!("\"{}\"", &blake3::hash(answer.text.as_bytes()).to_hex()[..32])
        );
        let body = answer.json();
        let revision = body["revision"].as_i64().unwrap();
        assert!(Some(revision) >= before, "{system}: revision {revision} after {before:?}");
        let served: serde_json::Map<String, Value> =
            SERVED.iter().map(|field| ((*field).to_owned(), body[field].clone())).collect();
        let hash = blake3::hash(Value::Object(served).to_string().as_bytes()).to_hex().to_string();
        let known = self.served.entry((system.to_owned(), revision)).or_insert_with(|| hash.clone());
        assert_eq!(*known, hash, "{system}: two sets under revision {revision}");
        let newest = self.newest.entry(system.to_owned()).or_default();
        *newest = revision.max(*newest);
        self.polls += 1;
    }

    /// Looks for everything that was acknowledged in a database that nobody has open.
    #[track_caller]
    pub fn check_database(&self, path: &Path) {
        check_database(path);
        let all = |sql| rows(path, sql).into_iter().collect::<HashSet<String>>();
        let require = |what: &str, there: &HashSet<String>, wanted: &mut dyn Iterator<Item = String>| {
            let lost: Vec<String> = wanted.filter(|wanted| !there.contains(wanted)).collect();
            assert!(lost.is_empty(), "{what} lost: {lost:?}");
        };
        require("windows", &all("SELECT id FROM windows"), &mut self.windows.iter().cloned());
        require("systems", &all("SELECT system FROM systems"), &mut self.systems.iter().cloned());
        let keys = all("SELECT key || ' = ' || resource FROM idempotency JOIN jobs ON jobs.id = resource");
        require("jobs", &keys, &mut self.acknowledged().map(|(key, _, job)| format!("{key} = {job}")));
        let cancelled = all("SELECT id FROM jobs WHERE state = 'cancelled'");
        require("cancellations", &cancelled, &mut self.cancelled.iter().cloned());
        let promoted = all(
            "SELECT fit FROM decisions JOIN revisions USING (fit) WHERE decision = 'promoted' AND cause = \
            'promoted'",
        );
        require("promotions", &promoted, &mut self.promoted.iter().cloned());
        let pins =
            all("SELECT system || ' ' || revision || ' ' || fit FROM revisions WHERE cause = 'pinned'");
        require(
            "pins",
            &pins,
            &mut self.pinned.iter().map(|((system, revision), fit)| format!("{system} {revision} {fit}")),
        );
        let served = all("SELECT system || ' ' || revision || ' ' || served_hash FROM revisions");
        require(
            "what was served",
            &served,
            &mut self.served.iter().map(|((system, revision), hash)| format!("{system} {revision} {hash}")),
        );
        // Every request for a job has a seed or a room of its own, also those that were never answered.
        let twice = rows(
            path,
            "SELECT MIN(id) FROM jobs WHERE origin = 'posted' GROUP BY system, request HAVING COUNT(*) > 1",
        );
        assert!(twice.is_empty(), "jobs that were made twice: {twice:?}");
    }

    /// Looks at a service that has started again on the database, and sends again what was never answered.
    #[track_caller]
    pub fn check_service(&mut self, client: &Client, path: &Path) {
        let dead = "SELECT id FROM jobs WHERE state = 'running' AND boot <> (SELECT value FROM counters \
            WHERE name = 'boot')";
        assert_eq!(rows(path, dead), Vec::<String>::new(), "jobs of a dead process still run");
        for (system, newest) in self.newest.clone() {
            let answer = client.get(&format!("/params/{system}")).expect(200);
            self.saw(&system, &answer, Some(newest));
        }
        let recent =
            self.acknowledged().map(|(key, body, job)| (key.clone(), body.clone(), Some(job.clone()))).last();
        let unanswered = self
            .jobs
            .iter()
            .filter(|(_, (_, job))| job.is_none())
            .map(|(key, (body, _))| (key.clone(), body.clone(), None));
        for (key, body, job) in unanswered.chain(recent).collect::<Vec<_>>() {
            let again = text(
                &client.json_with("POST", "/jobs", &[("idempotency-key", &key)], &body).expect(202).json()["id"],
            );
            assert!(job.is_none_or(|job| job == again), "the key `{key}` made a second job");
            self.jobs.insert(key, (body, Some(again)));
        }
    }

    fn acknowledged(&self) -> impl Iterator<Item = (&String, &Value, &String)> {
        self.jobs.iter().filter_map(|(key, (body, job))| job.as_ref().map(|job| (key, body, job)))
    }

    /// What was acknowledged, in numbers.
    pub fn told(&self) -> String {
        let Self { windows, systems, cancelled, promoted, pinned, polls, .. } = self;
        format!(
            "{} windows, {} rooms, {} jobs, {} cancellations, {} promotions, {} pins, {polls} polls",
            windows.len(),
            systems.len(),
            self.acknowledged().count(),
            cancelled.len(),
            promoted.len(),
            pinned.len(),
        )
    }
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_else(|| panic!("{value} is no text")).to_owned()
}
