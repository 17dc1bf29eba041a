//! `lampyris jobs`: post, watch and manage jobs of a running server.

use super::document::read_document;
use super::output::Failure;
use super::pages::{self, Page};
use super::server::{Answer, Call, Server, fault_line, query, segment};
use super::table::{self, Column};
use super::watch::{follow, watch};
use serde_json::{Map, Value, json};
use std::path::PathBuf;

const COLUMNS: &[Column] = &[
    ("job", "/id"),
    ("system", "/system"),
    ("kind", "/kind"),
    ("model", "/model"),
    ("state", "/state"),
    ("outcome", "/outcome"),
    ("priority", "/priority"),
    ("created", "/created_at"),
];
const FIELDS: &[Column] = &[
    ("job", "/id"),
    ("batch", "/batch"),
    ("system", "/system"),
    ("kind", "/kind"),
    ("model", "/model"),
    ("state", "/state"),
    ("outcome", "/outcome"),
    ("experiment", "/experiment"),
    ("priority", "/priority"),
    ("origin", "/origin"),
    ("retry of", "/retry_of"),
    ("attempt", "/attempt"),
    ("generation", "/progress/generation"),
    ("evaluations", "/progress/evaluations"),
    ("best train", "/progress/best_train"),
    ("best validation", "/progress/best_validation"),
    ("seconds left", "/progress/eta_s"),
    ("evaluations", "/evaluations"),
    ("stopped by", "/stopped_by"),
    ("seconds", "/wall_s"),
    ("fit", "/fit"),
    ("revision", "/revision"),
    ("failed with", "/error/code"),
    ("because", "/error/detail"),
    ("created", "/created_at"),
    ("started", "/started_at"),
    ("ended", "/ended_at"),
];

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: Server,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// List jobs, newest first. Exit code 3 where there are none.
    List(List),
    /// Show one job.
    Show {
        /// Its id.
        id: String,
    },
    /// Post a job for one system, or a recalibration of several.
    Post(Box<Post>),
    /// Call a job off.
    Cancel {
        /// Its id.
        id: String,
    },
    /// Do a job that has ended once more.
    Retry {
        /// Its id.
        id: String,
        /// Watch the new job to its end; exit code 3 where the gate rejects its fit.
        #[arg(long)]
        wait: bool,
    },
    /// Follow a job to its end, or all jobs until interrupted.
    Watch {
        /// The job; all of them where none is named.
        id: Option<String>,
        /// Only the jobs of this system.
        #[arg(long, conflicts_with = "id")]
        system: Option<String>,
    },
}

#[derive(Debug, clap::Args)]
struct List {
    /// Only those that stand so: queued, running, succeeded, failed or cancelled.
    #[arg(long)]
    state: Option<String>,
    /// Only those of this system.
    #[arg(long)]
    system: Option<String>,
    /// Only those of this kind.
    #[arg(long)]
    kind: Option<String>,
    #[command(flatten)]
    page: Page,
}

#[derive(Debug, clap::Args)]
struct Post {
    /// The system, such as room/4; several, or a pattern such as 'room/*', make a batch: a recalibration, or
    /// diagnoses.
    systems: Vec<String>,
    /// A request to start from: a JSON document, `-` for standard input. The flags win over it.
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
    /// What is done; estimate for one system and recalibrate for several by default.
    #[arg(long)]
    kind: Option<String>,
    /// The model; the system's own by default.
    #[arg(long)]
    model: Option<String>,
    /// Use the newest measurements of this length, such as P28D.
    #[arg(long, conflicts_with = "from")]
    last: Option<String>,
    /// Use measurements from this instant on.
    #[arg(long)]
    from: Option<String>,
    /// Use measurements up to this instant.
    #[arg(long)]
    to: Option<String>,
    /// Step of the fit, such as PT15M or PT0.01S.
    #[arg(long)]
    step: Option<String>,
    /// Length of the training part, such as P21D.
    #[arg(long)]
    train: Option<String>,
    /// Length of the validation part.
    #[arg(long)]
    validation: Option<String>,
    /// The optimiser.
    #[arg(long)]
    method: Option<String>,
    /// The seed: the same seed gives the same bits.
    #[arg(long)]
    seed: Option<u64>,
    /// Most simulations.
    #[arg(long)]
    evaluations: Option<u64>,
    /// Longest run, such as PT10M.
    #[arg(long)]
    wall: Option<String>,
    /// Never alter what is served.
    #[arg(long)]
    experiment: bool,
    /// interactive, operator or nightly.
    #[arg(long)]
    priority: Option<String>,
    /// Any other field: bounds={"alpha_h":[0.001,15]}. What is no JSON is taken as a text.
    #[arg(long, value_name = "FIELD=JSON")]
    set: Vec<String>,
    /// The same key again gets the same job.
    #[arg(long)]
    key: Option<String>,
    /// Watch the job to its end; exit code 3 where the gate rejects its fit.
    #[arg(long)]
    wait: bool,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let server = &arguments.server;
    match &arguments.verb {
        Verb::List(list) => {
            let query = [("state", &list.state), ("system", &list.system), ("kind", &list.kind)];
            pages::list(server, "/jobs", &list.page, &query, COLUMNS)
        }
        Verb::Show { id } => {
            server.show(&server.get(&format!("/jobs/{}", segment(id)))?, describe);
            Ok(())
        }
        Verb::Post(post) => submit(server, post),
        Verb::Cancel { id } => {
            server.show(
                &server.call("POST", &format!("/jobs/{}/cancel", segment(id)), Call::default())?,
                describe,
            );
            Ok(())
        }
        Verb::Retry { id, wait } => {
            let answer = server.call("POST", &format!("/jobs/{}/retry", segment(id)), Call::default())?;
            entered(server, &answer, *wait)
        }
        Verb::Watch { id: Some(id), .. } => watch(server, id),
        Verb::Watch { id: None, system } => {
            let query = query(&[("system", system)]);
            follow(server, &format!("/events{query}"), |_| None).map(|_| ())
        }
    }
}

/// The request that the flags describe.
fn body(post: &Post) -> Result<Value, Failure> {
    let mut body = match &post.file {
        Some(file) => read_document(file)?,
        None => Value::Object(Map::new()),
    };
    let several = post.systems.len() > 1 || post.systems.iter().any(|system| system.contains('*'));
    match post.systems.as_slice() {
        [] => {}
        [one] if !several => put(&mut body, &["system"], json!(one)),
        all => put(&mut body, &["systems"], json!(all)),
    }
    if let Some(kind) = &post.kind {
        put(&mut body, &["kind"], json!(kind));
    } else if body.get("kind").is_none() {
        put(&mut body, &["kind"], json!(if several { "recalibrate" } else { "estimate" }));
    }
    let texts: [(&[&str], &Option<String>); 10] = [
        (&["model"], &post.model),
        (&["window", "last"], &post.last),
        (&["window", "from"], &post.from),
        (&["window", "to"], &post.to),
        (&["step"], &post.step),
        (&["split", "train"], &post.train),
        (&["split", "validation"], &post.validation),
        (&["method", "name"], &post.method),
        (&["budget", "wall"], &post.wall),
        (&["priority"], &post.priority),
    ];
    for (path, text) in texts {
        if let Some(text) = text {
            put(&mut body, path, json!(text));
        }
    }
    for (path, number) in [(["method", "seed"], post.seed), (["budget", "evaluations"], post.evaluations)] {
        if let Some(number) = number {
            put(&mut body, &path, json!(number));
        }
    }
    if post.experiment {
        put(&mut body, &["experiment"], json!(true));
    }
    for setting in &post.set {
        let Some((field, text)) = setting.split_once('=') else {
            return Err(Failure::Usage(format!("--set {setting}: write FIELD=JSON")));
        };
        put(&mut body, &[field], serde_json::from_str(text).unwrap_or_else(|_| json!(text)));
    }
    Ok(body)
}

/// Puts a value into a document, and makes the objects around it.
fn put(document: &mut Value, path: &[&str], value: Value) {
    let [first, rest @ ..] = path else {
        *document = value;
        return;
    };
    if !document.is_object() {
        *document = Value::Object(Map::new());
    }
    if let Some(fields) = document.as_object_mut() {
        put(fields.entry(*first).or_insert(Value::Null), rest, value);
    }
}

fn submit(server: &Server, post: &Post) -> Result<(), Failure> {
    if post.systems.is_empty() && post.file.is_none() {
        return Err(Failure::Usage("name a system, such as room/4, or a --file".to_owned()));
    }
    let mut call = Call::json(&body(post)?);
    call.headers.extend(post.key.iter().map(|key| ("idempotency-key", key.clone())));
    let answer = server.call("POST", "/jobs", call)?;
    entered(server, &answer, post.wait)
}

/// Shows what was submitted, or watches it.
fn entered(server: &Server, answer: &Answer, wait: bool) -> Result<(), Failure> {
    let id = answer.document["id"].as_str().unwrap_or_default();
    if !wait {
        server.show(
            answer,
            |document| if document["jobs"].is_array() { batch(document) } else { describe(document) },
        );
        return Ok(());
    }
    match answer.document["jobs"].as_array() {
        Some(jobs) => {
            // One after another: each stream tells from the beginning, so nothing is missed.
            let ends: Vec<Result<(), Failure>> =
                jobs.iter().filter_map(|job| job["job"].as_str()).map(|job| watch(server, job)).collect();
            ends.into_iter().collect()
        }
        None => watch(server, id),
    }
}

fn describe(job: &Value) -> String {
    let mut text = table::fields(job, FIELDS);
    for fault in job["error"]["errors"].as_array().into_iter().flatten() {
        text.push_str(&format!("\n  {}", fault_line(fault)));
    }
    text
}

fn batch(batch: &Value) -> String {
    let rows = |field: &str, columns: &[Column]| {
        let rows: Vec<&Value> = batch[field].as_array().into_iter().flatten().collect();
        if rows.is_empty() { String::new() } else { format!("\n{}", table::rows_of(&rows, columns)) }
    };
    let result = if batch["kind"] == "diagnose" { ("verdict", "/verdict") } else { ("outcome", "/outcome") };
    let jobs =
        rows("jobs", &[("system", "/system"), ("job", "/job"), ("state", "/state"), result, ("why", "/why")]);
    let skipped = rows("skipped", &[("left out", "/system"), ("why", "/why")]);
    format!("batch {}{jobs}{skipped}", table::cell(batch, "/id"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        post: Post,
    }

    fn written(words: &[&str]) -> Value {
        body(&Line::try_parse_from(std::iter::once("post").chain(words.iter().copied())).unwrap().post)
            .unwrap()
    }

    #[test]
    fn the_flags_make_the_request() {
        assert_eq!(written(&["room/4"]), json!({"system": "room/4", "kind": "estimate"}));
        assert_eq!(written(&["room/*"]), json!({"systems": ["room/*"], "kind": "recalibrate"}));
        assert_eq!(
            written(&["room/*", "--kind", "diagnose"]),
            json!({"systems": ["room/*"], "kind": "diagnose"})
        );
        let all = written(&[
            "room/4",
            "--kind",
            "diagnose",
            "--last",
            "P28D",
            "--seed",
            "7",
            "--method",
            "cfa",
            "--evaluations",
            "100",
            "--experiment",
            "--set",
            "bounds={\"a\":[1,2]}",
            "--set",
            "objective=swmse",
        ]);
        let expected = json!({
            "system": "room/4", "kind": "diagnose", "window": {"last": "P28D"},
            "method": {"name": "cfa", "seed": 7},
            "budget": {"evaluations": 100}, "experiment": true, "bounds": {"a": [1, 2]}, "objective": "swmse",
        });
        assert_eq!(all, expected);
    }
}
