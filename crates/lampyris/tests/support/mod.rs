//! What the tests of the service share: a service in this process, a plain client, and a small synthetic
//! room.
#![allow(dead_code, reason = "each test binary uses its part")]

pub mod cluster;
pub mod events;
pub mod process;
pub mod rooms;
pub mod schema;
pub mod stubs;

use lampyris::app::App;
use lampyris::service::Clock;
use lampyris::service::access::tokens::{self, LOCAL, NewToken};
use lampyris::settings::Settings;
use lampyris::store::DatabasePlace;
use lampyris::store::tokens::Scope;
use rooms::room_csv;
use serde_json::Value;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

/// Longest that a test waits for what must come. It only ends a wait that has no end: a machine may be many
/// times slower than another, and no test fails because of that.
pub const PATIENCE: Duration = Duration::from_secs(900);

/// When a service starts whose test does not say it: a day behind two weeks of [`rooms::room`], so that what
/// rests on them is fresh.
pub const TODAY: &str = "2026-01-16T00:00:00Z";

/// Whether the full figures are asked for.
pub fn full() -> bool {
    std::env::var("LAMPYRIS_TESTS").is_ok_and(|figures| figures == "full")
}

/// A plain HTTP client for one service.
#[derive(Clone)]
pub struct Client {
    base: String,
    agent: ureq::Agent,
    /// What every request shows, where something is needed.
    token: Option<String>,
}

/// An answer, read to its end.
#[derive(Debug, Clone)]
pub struct Answer {
    pub status: u16,
    pub headers: ureq::http::HeaderMap,
    pub text: String,
}

impl Answer {
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_else(|error| panic!("{error}: {}", self.text))
    }

    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default()
    }

    /// The answer, which must have this status.
    #[track_caller]
    pub fn expect(self, status: u16) -> Self {
        assert_eq!(self.status, status, "{}", self.text);
        self
    }

    /// The problem document, which must have this status and slug.
    #[track_caller]
    pub fn problem(self, status: u16, slug: &str) -> Value {
        assert_eq!(self.header("content-type"), "application/problem+json", "{} {}", self.status, self.text);
        let problem = self.expect(status).json();
        assert_eq!(problem["type"], slug, "{problem}");
        assert_eq!(problem["status"], status, "{problem}");
        assert!(problem["detail"].is_string() && problem["title"].is_string(), "{problem}");
        problem
    }
}

impl Client {
    pub fn new(base: String) -> Self {
        let config =
            ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build();
        Self { base, agent: config.into(), token: None }
    }

    /// The same client on connections of its own.
    pub fn afresh(&self) -> Self {
        Self { token: self.token.clone(), ..Self::new(self.base.clone()) }
    }

    /// The same client with a token.
    pub fn with_token(&self, token: &str) -> Self {
        Self { token: Some(token.to_owned()), ..self.clone() }
    }

    /// The token that it shows.
    pub fn secret(&self) -> &str {
        self.token.as_deref().unwrap_or_default()
    }

    /// Sends a request and leaves the body of the answer unread.
    fn open(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: Option<&[u8]>,
    ) -> Result<ureq::http::Response<ureq::Body>, ureq::Error> {
        let mut request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.base));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        match body {
            Some(body) => self.agent.run(request.body(body).unwrap()),
            None => self.agent.run(request.body(()).unwrap()),
        }
    }

    /// Sends a request; `Err` where the connection fails.
    pub fn send(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: Option<&[u8]>,
    ) -> Result<Answer, ureq::Error> {
        let (parts, mut body) = self.open(method, path, headers, body)?.into_parts();
        // A stream of events does not end by itself; `listen` reads those.
        let is_stream = parts.headers.get("content-type").is_some_and(|kind| kind == "text/event-stream");
        let text =
            if is_stream { String::new() } else { body.with_config().limit(1 << 28).read_to_string()? };
        Ok(Answer { status: parts.status.as_u16(), headers: parts.headers, text })
    }

    #[track_caller]
    pub fn get(&self, path: &str) -> Answer {
        self.send("GET", path, &[], None).unwrap()
    }

    #[track_caller]
    pub fn get_with(&self, path: &str, headers: &[(&str, &str)]) -> Answer {
        self.send("GET", path, headers, None).unwrap()
    }

    /// The headers of an answer whose body stays unread.
    #[track_caller]
    pub fn headers(&self, path: &str, headers: &[(&str, &str)]) -> ureq::http::HeaderMap {
        let (parts, _) = self.open("GET", path, headers, None).unwrap().into_parts();
        assert_eq!(parts.status, 200, "{path}");
        parts.headers
    }

    #[track_caller]
    pub fn json(&self, method: &str, path: &str, body: &Value) -> Answer {
        self.json_with(method, path, &[], body)
    }

    #[track_caller]
    pub fn json_with(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &Value) -> Answer {
        let headers: Vec<(&str, &str)> =
            [("content-type", "application/json")].iter().chain(headers).copied().collect();
        self.send(method, path, &headers, Some(body.to_string().as_bytes())).unwrap()
    }

    #[track_caller]
    pub fn csv(&self, path: &str, body: &str) -> Answer {
        self.send("POST", path, &[("content-type", "text/csv")], Some(body.as_bytes())).unwrap()
    }

    #[track_caller]
    pub fn post(&self, path: &str) -> Answer {
        self.send("POST", path, &[], Some(b"")).unwrap()
    }

    /// Makes a room of this model with two weeks of measurements.
    #[track_caller]
    pub fn room(&self, id: &str, seed: u64) {
        self.json(
            "PUT",
            &format!("/systems/room/{id}"),
            &serde_json::json!({"label": format!("Room {id}"), "model": "rc2"}),
        )
        .expect(201);
        self.csv(&format!("/systems/room/{id}/windows"), &room_csv(seed, 14)).expect(201);
    }

    /// A room whose measurements are not old before their time has come, for services whose clock no test
    /// sets.
    #[track_caller]
    pub fn lasting_room(&self, id: &str, seed: u64) {
        self.room(id, seed);
        self.json(
            "PUT",
            &format!("/systems/room/{id}"),
            &serde_json::json!({"model": "rc2", "policy": lasting()}),
        )
        .expect(200);
    }

    /// Posts a quick estimate and gives its id.
    #[track_caller]
    pub fn estimate(&self, system: &str, more: Value) -> String {
        let mut body = quick(system);
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        let answer = self.json("POST", "/jobs", &body).expect(202);
        let id = answer.json()["id"].as_str().unwrap().to_owned();
        assert_eq!(answer.header("location"), format!("/jobs/{id}"));
        id
    }

    /// Gives a system a model of which no estimate succeeds, posts one and gives its id.
    #[track_caller]
    pub fn failing(&self, system: &str, more: Value) -> String {
        let known = self.json("POST", "/models", &exploding());
        assert!([200, 201].contains(&known.status), "{}", known.text);
        let policy = self.get(&format!("/systems/{system}")).expect(200).json()["policy"].clone();
        self.json(
            "PUT",
            &format!("/systems/{system}"),
            &serde_json::json!({"model": "explosion", "policy": policy}),
        )
        .expect(200);
        self.estimate(system, more)
    }

    /// Posts a job and gives its id.
    #[track_caller]
    pub fn post_job(&self, body: &Value) -> String {
        self.json("POST", "/jobs", body).expect(202).json()["id"].as_str().unwrap().to_owned()
    }

    /// Waits until a job has ended.
    #[track_caller]
    pub fn ended(&self, job: &str) -> Value {
        self.until(&format!("/jobs/{job}"), |job| {
            ["succeeded", "failed", "cancelled"].contains(&job["state"].as_str().unwrap())
        })
    }

    /// Waits until a document says something.
    #[track_caller]
    pub fn until(&self, path: &str, holds: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            let document = self.get(path).json();
            if holds(&document) {
                return document;
            }
            assert!(start.elapsed() < PATIENCE, "{path} still says {document}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// A policy by which nothing turns stale.
pub fn lasting() -> Value {
    serde_json::json!({"stale_after": "P36500D"})
}

/// A quick request for an estimate: least squares from a few points.
pub fn quick(system: &str) -> Value {
    serde_json::json!({
        "kind": "estimate", "system": system,
        "split": {"train": "P9D", "validation": "P5D"},
        "method": {"name": "lm_multistart", "seed": 1}, "budget": {"evaluations": 2000},
    })
}

/// A request whose search has another seed, so that it is no other's equal.
pub fn seeded(mut request: Value, seed: impl Into<Value>) -> Value {
    request["method"]["seed"] = seed.into();
    request
}

/// A request that does not end by itself within the time of a test.
pub fn endless(system: &str) -> Value {
    let method = serde_json::json!({"name": "cfa_thesis", "generations": 100_000});
    serde_json::json!({
        "kind": "estimate", "system": system, "method": method, "budget": {"evaluations": 100_000_000}
    })
}

/// A model whose every simulation explodes, so that each of its jobs fails.
fn exploding() -> Value {
    serde_json::json!({
        "id": "explosion", "title": "A room that explodes",
        "states": {"T_room": {"unit": "degC", "initial": "T_room"}},
        "equations": {"T_room": "k * 1[K] * exp(exp(T_room / 1[K]))"},
        "parameters": {"k": {"unit": "1/h", "lower": 1.0, "upper": 2.0, "nominal": 1.5, "scale": "log"}},
        "outputs": {"T_room": {"expr": "T_room", "unit": "degC", "noise_sd": 0.05}},
    })
}

/// A service in this process, with a database of its own.
pub struct TestApp {
    pub client: Client,
    app: Option<App>,
    runtime: Runtime,
    dir: tempfile::TempDir,
    settings: Settings,
    /// The clock of the service, over all its starts.
    pub clock: Clock,
}

impl TestApp {
    pub fn start() -> Self {
        Self::with(|_| {})
    }

    pub fn with(change: impl FnOnce(&mut Settings)) -> Self {
        Self::at(TODAY, change)
    }

    /// A service that goes by the clock of the system.
    pub fn by_the_clock() -> Self {
        Self::by(Clock::default(), |_| {})
    }

    /// A service whose clock was set.
    pub fn at(time: &str, change: impl FnOnce(&mut Settings)) -> Self {
        let clock = Clock::default();
        clock.set(time.parse().unwrap());
        Self::by(clock, change)
    }

    fn by(clock: Clock, change: impl FnOnce(&mut Settings)) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut settings = Settings {
            bind: "127.0.0.1:0".parse().unwrap(),
            database: cluster::database().unwrap_or_else(|| dir.path().join("test.db").into()),
            threads: 1,
            ..Settings::default()
        };
        change(&mut settings);
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let app = runtime
            .block_on(App::start_by(settings.clone(), clock.clone()))
            .unwrap_or_else(|error| panic!("{error}"));
        Self {
            client: Client::new(format!("http://{}", app.addr)),
            app: Some(app),
            runtime,
            dir,
            settings,
            clock,
        }
    }

    /// Stops the service and starts it again on the same database.
    pub fn restart(&mut self) {
        self.stop();
        let app = self
            .runtime
            .block_on(App::start_by(self.settings.clone(), self.clock.clone()))
            .unwrap_or_else(|error| panic!("{error}"));
        self.client = Client::new(format!("http://{}", app.addr));
        self.app = Some(app);
    }

    pub fn stop(&mut self) {
        if let Some(app) = self.app.take() {
            self.runtime.block_on(app.shutdown()).unwrap();
        }
    }

    pub fn database(&self) -> PathBuf {
        self.settings.database.file().expect("a file").to_owned()
    }

    /// Where its data are.
    pub fn place(&self) -> DatabasePlace {
        self.settings.database.clone()
    }

    /// The first column of what a statement gives on the database, behind the surface, or how it failed.
    pub fn behind(&self, sql: &str) -> Result<Vec<String>, String> {
        cluster::behind(&self.settings.database, sql)
    }

    /// What handlers and workers share, for tests that look behind the surface.
    pub fn service(&self) -> &lampyris::service::Service {
        self.app.as_ref().unwrap().service()
    }

    /// Runs something asynchronous beside the service.
    pub fn block_on<T>(&self, future: impl Future<Output = T>) -> T {
        self.runtime.block_on(future)
    }

    /// Runs something in the service's own runtime, with what its handlers share.
    pub fn within<T>(&self, work: impl AsyncFnOnce(&lampyris::service::Service) -> T) -> T {
        self.runtime.block_on(work(self.app.as_ref().unwrap().service()))
    }

    /// Makes a token and gives a client that shows it; the service knows it by then.
    #[track_caller]
    pub fn token(&self, name: &str, scope: Scope, systems: &[&str]) -> Client {
        let systems = systems.iter().map(|pattern| pattern.parse().unwrap()).collect();
        let new = NewToken { name: name.to_owned(), scope, systems, expires: None };
        let made = self.within(async |service| tokens::create(&service.store, new, LOCAL).await.unwrap());
        let client = self.client.with_token(&made.secret);
        let start = Instant::now();
        while client.get("/systems").status != 200 || self.client.get("/systems").status != 401 {
            assert!(start.elapsed() < PATIENCE, "the service does not know the token");
            std::thread::sleep(Duration::from_millis(20));
        }
        client
    }

    pub fn addr(&self) -> std::net::SocketAddr {
        self.app.as_ref().unwrap().addr
    }
}

impl Drop for TestApp {
    fn drop(&mut self) {
        self.stop();
        cluster::drop_database(&self.settings.database);
    }
}

impl std::ops::Deref for TestApp {
    type Target = Client;

    fn deref(&self) -> &Client {
        &self.client
    }
}
