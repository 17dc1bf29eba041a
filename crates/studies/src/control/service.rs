//! A service on loopback whose clock the bench sets, and what the arms ask of it: plain HTTP, as any
//! controller would.

use super::arm::Kind;
use jiff::Timestamp;
use lampyris::app::App;
use lampyris::cli::Failure;
use lampyris::cli::serve::runtime;
use lampyris::cli::server::{Call, Server, segment};
use lampyris::service::Clock;
use lampyris::settings::Settings;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

/// The model of every arm before anything was found.
pub const MODEL: &str = "titeth";
/// Longest that the jobs of a night may take.
const PATIENCE: Duration = Duration::from_secs(300);
/// Between two looks at a job.
const PAUSE: Duration = Duration::from_millis(20);

/// A service inside this process.
pub struct Service {
    app: App,
    runtime: tokio::runtime::Runtime,
    server: Server,
    clock: Clock,
}

fn text(error: impl std::fmt::Display) -> Failure {
    Failure::Error(error.to_string())
}

impl Service {
    /// A service with a fresh database in a folder.
    pub fn start(folder: &Path, now: i64) -> Result<Self, Failure> {
        let settings = Settings {
            bind: SocketAddr::from(([127, 0, 0, 1], 0)),
            database: folder.join("loop.db").into(),
            // Fits of one room gain little from a second core, and many wait every night.
            threads: 1,
            workers: std::thread::available_parallelism().map_or(1, std::num::NonZero::get).min(64),
            ..Settings::default()
        };
        let clock = Clock::default();
        clock.set(Timestamp::from_millisecond(now).map_err(text)?);
        let runtime = runtime()?;
        let app = runtime.block_on(App::start_by(settings, clock.clone())).map_err(text)?;
        let server = Server::at(format!("http://{}", app.addr));
        // The nights are those of the arms, which differ.
        server.call(
            "PUT",
            "/schedules/nightly",
            Call::json(&json!({"cron": "30 2 * * *", "systems": ["room/*"], "enabled": false})),
        )?;
        Ok(Self { app, runtime, server, clock })
    }

    pub fn set_clock(&self, now: i64) -> Result<(), Failure> {
        self.clock.set(Timestamp::from_millisecond(now).map_err(text)?);
        Ok(())
    }

    pub fn stop(self) -> Result<(), Failure> {
        self.runtime.block_on(self.app.shutdown()).map_err(text)
    }
}

/// One system of the service, and the set that its controller has.
pub struct Client {
    /// `room/nightly-2`.
    pub system: String,
    etag: Option<String>,
    /// The body of the last 200.
    pub params: Value,
    /// How each estimate ended.
    pub fits: Vec<String>,
    pub effects: Vec<Added>,
    /// What the last diagnosis named.
    suspect: Option<String>,
    model: String,
}

/// An effect that was named and added.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Added {
    /// Counted from the first day under control.
    pub day: usize,
    pub effect: String,
    /// What the diagnosis said.
    pub summary: String,
}

impl Client {
    /// Tells the service about the system of an arm in a house.
    pub fn register(service: &Service, kind: Kind, house: usize) -> Result<Self, Failure> {
        let system = format!("room/{}-{house}", kind.id());
        let client = Self {
            system,
            etag: None,
            params: Value::Null,
            fits: Vec::new(),
            effects: Vec::new(),
            suspect: None,
            model: MODEL.to_owned(),
        };
        client.put(service)?;
        Ok(client)
    }

    fn put(&self, service: &Service) -> Result<(), Failure> {
        // The arms differ in when they re-estimate, so nothing else may start a job. An emitter holds at
        // least a twentieth of what the room holds: without that, its capacity and its gain can only be told
        // together, and wander off hand in hand.
        let bounds = json!({"beta_h": [0.05, 2.0], "c_heater": [0.2, 20.0]});
        let document =
            json!({"model": self.model, "bounds": bounds, "policy": {"refit_when_degraded": false}});
        service.server.call("PUT", &format!("/systems/{}", self.system), Call::json(&document)).map(drop)
    }

    pub fn upload(&self, service: &Service, csv: String) -> Result<(), Failure> {
        let body = Some(("text/csv", csv.into_bytes()));
        service
            .server
            .call("POST", &format!("/systems/{}/windows", self.system), Call { body, ..Call::default() })
            .map(drop)
    }

    /// Submits a job over the last days; gives its id.
    pub fn submit(
        &self,
        service: &Service,
        kind: &str,
        train: usize,
        validation: usize,
    ) -> Result<String, Failure> {
        let body = json!({
            "kind": kind, "system": self.system, "window": {"last": format!("P{}D", train + validation)},
            "split": {"train": format!("P{train}D"), "validation": format!("P{validation}D"), "test": "P0D"},
            "method": {"name": "cfa", "seed": 1},
        });
        let job = service.server.call("POST", "/jobs", Call::json(&body))?;
        Ok(job.document["id"].as_str().unwrap_or_default().to_owned())
    }

    /// Waits for the end of a job and gives it.
    pub fn ended(service: &Service, job: &str) -> Result<Value, Failure> {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            let answer = service.server.get(&format!("/jobs/{job}"))?.document;
            if matches!(answer["state"].as_str(), Some("succeeded" | "failed" | "cancelled")) {
                return Ok(answer);
            }
            std::thread::sleep(PAUSE);
        }
        Err(Failure::Error(format!("the job {job} did not end in {} s", PATIENCE.as_secs())))
    }

    /// Notes how an estimate ended.
    pub fn note(&mut self, job: &Value) {
        let outcome = job["outcome"].as_str().or(job["state"].as_str()).unwrap_or_default();
        self.fits.push(outcome.to_owned());
    }

    /// Polls as a controller does: true where there is another set. Without a validated one the nominal
    /// values serve.
    pub fn poll(&mut self, service: &Service) -> Result<bool, Failure> {
        let headers = self.etag.iter().map(|etag| ("if-none-match", etag.clone())).collect();
        let path = format!("/params/{}?accept=nominal", self.system);
        let answer = service.server.call("GET", &path, Call { headers, ..Call::default() })?;
        if answer.status == 304 {
            return Ok(false);
        }
        let is_new =
            ["model", "parameters"].iter().any(|field| self.params[*field] != answer.document[*field]);
        self.etag = answer.etag;
        self.params = answer.document;
        Ok(is_new)
    }

    /// The first cause that a diagnosis names, where the one before has named it too: a window into which an
    /// effect falls half-way looks like many things.
    pub fn named(&mut self, service: &Service, job: &Value) -> Result<Option<(String, String)>, Failure> {
        let Some(id) = job["diagnosis"].as_str() else { return Ok(None) };
        let diagnosis = service.server.get(&format!("/diagnoses/{id}"))?.document;
        let findings = diagnosis["findings"].as_array().map_or(&[][..], Vec::as_slice);
        let cause = findings.iter().find(|finding| finding["kind"] == "cause");
        let summary = diagnosis["summary"].as_str().unwrap_or_default().to_owned();
        let named = cause.and_then(|finding| finding["effect"].as_str()).map(str::to_owned);
        let before = std::mem::replace(&mut self.suspect, named.clone());
        Ok(named.filter(|effect| before.as_ref() == Some(effect)).map(|effect| (effect, summary)))
    }

    /// Adds an effect to the model of the system.
    pub fn add(&mut self, service: &Service, added: Added) -> Result<(), Failure> {
        let path = format!("/models/{}/effects", segment(&self.model));
        let version = service.server.call("POST", &path, Call::json(&json!({"effect": added.effect})))?;
        version.document["id"].as_str().unwrap_or_default().clone_into(&mut self.model);
        self.effects.push(added);
        self.put(service)
    }

    /// The model that its system would have with an effect.
    pub fn model_with(&self, effect: &str) -> String {
        format!("{}+{effect}", self.model)
    }
}
