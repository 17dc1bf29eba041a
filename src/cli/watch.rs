//! Follows events of a running server, line by line.

use super::server::{Event, Server, segment};
use super::{Failure, print, table};
use serde_json::{Value, json};
use std::time::Duration;

/// How often a broken stream is opened again before the server counts as gone.
const ATTEMPTS: usize = 30;
/// The pause before a broken stream is opened again.
const PAUSE: Duration = Duration::from_secs(1);

/// Follows a job to its end.
pub fn watch(server: &Server, id: &str) -> Result<(), Failure> {
    let ended = follow(server, &format!("/jobs/{}/events", segment(id)), |event| (event.name == "finished").then(|| event.data.clone()))?;
    // Where the end was told to an earlier stream, the job itself still knows it.
    let job = match ended {
        Some(job) => job,
        None => server.get(&format!("/jobs/{}", segment(id)))?.document,
    };
    match (job["state"].as_str(), job["outcome"].as_str()) {
        (_, Some("rejected")) => Err(Failure::Rejected),
        (Some("succeeded"), _) => Ok(()),
        (Some("failed"), _) => Err(Failure::Error(format!("the job failed: {}", table::cell(&job, "/error/detail")))),
        (state, _) => Err(Failure::Error(format!("the job is {}", state.unwrap_or("gone")))),
    }
}

/// Prints the events of a stream until one of them gives a result. A stream that breaks off is opened again
/// where it broke; nothing where the server says that all was told.
pub fn follow(server: &Server, path: &str, result: impl Fn(&Event) -> Option<Value>) -> Result<Option<Value>, Failure> {
    let (mut last_id, mut was_there, mut failures) = (String::new(), false, 0);
    loop {
        match server.listen(path, &last_id) {
            Ok(None) => return Ok(None),
            Ok(Some(mut events)) => {
                (was_there, failures) = (true, 0);
                for event in events.by_ref() {
                    print(&if server.json() { json!({"event": event.name, "data": event.data}).to_string() } else { line(&event) });
                    if let Some(result) = result(&event) {
                        return Ok(Some(result));
                    }
                }
                last_id = events.last_id;
            }
            // A server that was there may be starting again.
            Err(Failure::Unreachable(_)) if was_there && failures < ATTEMPTS => failures += 1,
            Err(failure) => return Err(failure),
        }
        std::thread::sleep(PAUSE);
    }
}

/// An event on one line.
fn line(event: &Event) -> String {
    let data = &event.data;
    let job = if data["job"].is_string() { table::cell(data, "/job") } else { table::cell(data, "/id") };
    let said = match event.name.as_str() {
        "progress" => {
            let part = |name: &str, pointer: &str| format!("{name} {}", table::cell(data, pointer));
            [
                part("generation", "/generation"),
                part("evaluations", "/evaluations"),
                part("train", "/best_train"),
                part("validation", "/best_validation"),
                format!("{} s left", table::cell(data, "/eta_s")),
            ]
            .join("  ")
        }
        "incumbent" => {
            let values = data["parameters"].as_object().into_iter().flatten();
            values.map(|(name, value)| format!("{name} {}", table::cell(value, ""))).collect::<Vec<_>>().join("  ")
        }
        "finished" => {
            let why = if data["error"].is_object() { format!(": {}", table::cell(data, "/error/detail")) } else { String::new() };
            let outcome = data["outcome"].as_str().map_or_else(String::new, |outcome| format!(", {outcome}"));
            let revision = data["revision"].as_i64().map_or_else(String::new, |revision| format!(", revision {revision}"));
            format!("{}{outcome}{revision}{why}", table::cell(data, "/state"))
        }
        _ => table::cell(data, "/model"),
    };
    format!("{}  {job}  {:<9}  {said}", table::cell(data, "/system"), event.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_one_line() {
        let event = Event {
            name: "progress".into(),
            data: json!({"job": "job_1", "system": "room/1", "generation": 3, "evaluations": 40, "best_train": 0.5}),
        };
        assert_eq!(line(&event), "room/1  job_1  progress   generation 3  evaluations 40  train 0.5  validation -  - s left");
        let event = Event {
            name: "finished".into(),
            data: json!({"id": "job_1", "system": "room/1", "state": "succeeded", "outcome": "accepted", "revision": 4, "error": null}),
        };
        assert_eq!(line(&event), "room/1  job_1  finished   succeeded, accepted, revision 4");
    }
}
