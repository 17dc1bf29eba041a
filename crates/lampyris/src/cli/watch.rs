//! Follows events of a running server, line by line.

use super::output::{Failure, print};
use super::server::{Event, Server, segment};
use super::table;
use serde_json::{Value, json};
use std::time::Duration;

/// How often a broken stream is opened again before the server counts as gone.
const ATTEMPTS: usize = 30;
/// The pause before a broken stream is opened again.
const PAUSE: Duration = Duration::from_secs(1);

/// Follows a job to its end.
pub fn watch(server: &Server, id: &str) -> Result<(), Failure> {
    let ended = follow(server, &format!("/jobs/{}/events", segment(id)), |event| {
        (event.name == "finished").then(|| event.data.clone())
    })?;
    // Where the end was told to an earlier stream, the job itself still knows it.
    let job = match ended {
        Some(job) => job,
        None => server.get(&format!("/jobs/{}", segment(id)))?.document,
    };
    match (job["state"].as_str(), job["outcome"].as_str()) {
        (_, Some("rejected")) => Err(Failure::Rejected),
        (Some("succeeded"), _) => Ok(()),
        (Some("failed"), _) => {
            Err(Failure::Error(format!("the job failed: {}", table::cell(&job, "/error/detail"))))
        }
        (state, _) => Err(Failure::Error(format!("the job is {}", state.unwrap_or("gone")))),
    }
}

/// Prints the events of a stream until one of them gives a result. A stream that breaks off is opened again
/// where it broke; nothing where the server says that all was told.
pub fn follow(
    server: &Server,
    path: &str,
    result: impl Fn(&Event) -> Option<Value>,
) -> Result<Option<Value>, Failure> {
    let (mut last_id, mut was_there, mut failures) = (String::new(), false, 0);
    loop {
        match server.listen(path, &last_id) {
            Ok(None) => return Ok(None),
            Ok(Some(mut events)) => {
                (was_there, failures) = (true, 0);
                for event in events.by_ref() {
                    print(&if server.json() {
                        json!({"event": event.name, "data": event.data}).to_string()
                    } else {
                        line(&event)
                    });
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
            values
                .map(|(name, value)| format!("{name} {}", table::cell(value, "")))
                .collect::<Vec<_>>()
                .join("  ")
        }
        "finished" => {
            let why = if data["error"].is_object() {
                format!(": {}", table::cell(data, "/error/detail"))
            } else {
                String::new()
            };
            let outcome = data["outcome"].as_str().map_or_else(String::new, |outcome| format!(", {outcome}"));
            let revision = data["revision"]
                .as_i64()
                .map_or_else(String::new, |revision| format!(", revision {revision}"));
            format!("{}{outcome}{revision}{why}", table::cell(data, "/state"))
        }
        _ => table::cell(data, "/model"),
    };
    format!("{}  {job}  {:<9}  {said}", table::cell(data, "/system"), event.name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use std::io::{BufRead, BufReader, Write};

    #[test]
    fn an_event_is_one_line() {
        let event = Event {
            name: "progress".into(),
            data: json!({
                "job": "job_1", "system": "room/1", "generation": 3, "evaluations": 40, "best_train": 0.5
            }),
        };
        assert_eq!(
            line(&event),
            "room/1  job_1  progress   generation 3  evaluations 40  train 0.5  validation -  - s left"
        );
        let event = Event {
            name: "finished".into(),
            data: json!({
                "id": "job_1", "system": "room/1", "state": "succeeded", "outcome": "accepted", "revision": 4,
                "error": null
            }),
        };
        assert_eq!(line(&event), "room/1  job_1  finished   succeeded, accepted, revision 4");
    }

    #[derive(Debug, clap::Parser)]
    struct Line {
        #[command(flatten)]
        server: Server,
    }

    /// Answers each connection with one text, closes it, and gives what was asked.
    fn answering(answers: [String; 2]) -> (String, std::thread::JoinHandle<Vec<String>>) {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let serve = move || {
            let connections = answers.into_iter().map(|answer| {
                let (stream, _) = listener.accept().unwrap();
                let mut asked = String::new();
                for line in
                    BufReader::new(&stream).lines().map(Result::unwrap).take_while(|line| !line.is_empty())
                {
                    asked.push_str(&format!("{}\n", line.to_ascii_lowercase()));
                }
                (&stream).write_all(answer.as_bytes()).unwrap();
                asked
            });
            connections.collect()
        };
        (url, std::thread::spawn(serve))
    }

    #[test]
    fn a_stream_that_breaks_off_is_opened_again_where_it_broke() {
        let head = "HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\n\r\n";
        let first = format!(
            "{head}event: queued\ndata: {{}}\nid: 1.1.5\n\nevent: progress\ndata: {{}}\nid: 1.2.5\n\nevent: \
            cut"
        );
        let second = format!("{head}event: finished\ndata: {{\"state\":\"succeeded\"}}\nid: 1.3.6\n\n");
        let (url, asked) = answering([first, second]);
        let server = Line::parse_from(["test", "--url", &url]).server;
        assert!(watch(&server, "job_1").is_ok());
        let asked = asked.join().unwrap();
        assert!(
            asked[0].starts_with("get /jobs/job_1/events ") && !asked[0].contains("last-event-id"),
            "{asked:?}"
        );
        assert!(asked[1].contains("last-event-id: 1.2.5\n"), "{asked:?}");
    }

    #[test]
    fn a_job_whose_end_was_told_before_is_asked_how_it_ended() {
        let job = "{\"state\":\"succeeded\",\"outcome\":\"rejected\"}";
        let nothing_more = "HTTP/1.1 204 No Content\r\nconnection: close\r\n\r\n".to_owned();
        let (url, asked) = answering([
            nothing_more,
            format!("HTTP/1.1 200 OK\r\ncontent-length: {}\r\n\r\n{job}", job.len()),
        ]);
        let server = Line::parse_from(["test", "--url", &url]).server;
        assert!(matches!(watch(&server, "job_1"), Err(Failure::Rejected)));
        assert!(asked.join().unwrap()[1].starts_with("get /jobs/job_1 "));
    }
}
