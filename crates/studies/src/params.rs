//! How many polls a second the controller's path answers, beside a bare axum route.

use super::row::Row;
use lampyris::app::App;
use lampyris::cli::serve::runtime;
use lampyris::cli::{Failure, faults};
use lampyris::service::ServiceError;
use lampyris::service::access::tokens::LOCAL;
use lampyris::service::catalogue::systems;
use lampyris::service::catalogue::windows::{self, Format};
use lampyris::service::queue::submit;
use lampyris::settings::Settings;
use lampyris::store::jobs::{self, JobKind, Priority};
use lampyris::store::queue::Submitted;
use lampyris_core::data::SystemId;
use lampyris_core::twin;
use serde_json::json;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Connections that poll at once.
const CONNECTIONS: usize = 8;
/// How long each side is polled in a turn.
const TURN: Duration = Duration::from_millis(1500);
const TURNS: usize = 5;

pub fn run() -> Result<Vec<Row>, Failure> {
    runtime()?.block_on(measure())
}

fn text(error: impl std::fmt::Display) -> Failure {
    Failure::Error(error.to_string())
}

async fn measure() -> Result<Vec<Row>, Failure> {
    let folder = std::env::temp_dir().join(format!("lampyris-bench-{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(text)?;
    let settings = Settings {
        bind: SocketAddr::from(([127, 0, 0, 1], 0)),
        database: folder.join("bench.db").into(),
        ..Settings::default()
    };
    let app = App::start(settings).await.map_err(text)?;
    let etag = publish(&app).await?;
    let bare = axum::Router::new()
        .route("/params/{kind}/{id}", axum::routing::get(async || axum::http::StatusCode::NOT_MODIFIED));
    let listener = tokio::net::TcpListener::bind(("127.0.0.1", 0)).await.map_err(text)?;
    let address = listener.local_addr().map_err(text)?;
    let server = tokio::spawn(async move { axum::serve(listener, bare).await });
    let request = format!("GET /params/room/4 HTTP/1.1\r\nhost: localhost\r\nif-none-match: {etag}\r\n\r\n");
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    // In turns, so that whatever else the machine does hits both.
    for _ in 0..TURNS {
        ours.push(poll(app.addr, &request).await?);
        theirs.push(poll(address, &request).await?);
    }
    server.abort();
    app.shutdown().await.map_err(text)?;
    std::fs::remove_dir_all(&folder).map_err(text)?;
    let ratios = ours.iter().zip(&theirs).map(|(ours, theirs)| ours / theirs).collect();
    let median = |mut rates: Vec<f64>| {
        rates.sort_by(f64::total_cmp);
        rates[rates.len() / 2]
    };
    Ok(vec![
        Row::new("/params with a matching ETag (304), polls a second", median(ours), "1/s"),
        Row::new("  a bare axum route that answers 304", median(theirs), "1/s"),
        Row::new("  /params / bare, median of the rounds", median(ratios), "x").at_least(0.8),
    ])
}

/// Fits a synthetic room so that something is served, and returns the tag of the answer.
async fn publish(app: &App) -> Result<String, Failure> {
    let failed = |error: ServiceError| Failure::Error(error.to_string());
    let service = app.service();
    let twin = twin::room(4, 0, 9, 30).map_err(|found| faults(&found))?;
    let system: SystemId = "room/4".parse().map_err(|error| Failure::Error(format!("{error}")))?;
    systems::put(service, &system, json!({ "model": "room3" }), LOCAL, |_| true).await.map_err(failed)?;
    windows::take(service, &system, Format::Csv, twin.csv, None).await.map_err(failed)?;
    let submitted = submit::one(
        service,
        JobKind::Estimate,
        &system,
        false,
        Priority::Operator,
        &serde_json::Map::new(),
        None,
    )
    .await
    .map_err(failed)?;
    let (Submitted::New(job) | Submitted::Waiting(job)) = submitted else {
        return Err(Failure::Error("the job was refused".to_owned()));
    };
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(60) {
        // What a job has found is served a moment after the database knows that it has ended.
        let entry = service.params.entry("room/4");
        if let Some(rendered) = entry.as_ref().and_then(|entry| entry.validated()) {
            return Ok(rendered.etag.to_string());
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let ended = jobs::get(&service.store, &job.id).await.map_err(text)?.map(|record| record.state);
    Err(Failure::Error(format!("the synthetic room was not served in a minute; its job: {ended:?}")))
}

/// Requests a second over a few connections that each wait for their answer.
async fn poll(address: SocketAddr, request: &str) -> Result<f64, Failure> {
    let start = Instant::now();
    let clients: Vec<_> =
        (0..CONNECTIONS).map(|_| tokio::spawn(client(address, request.to_owned()))).collect();
    let mut answers = 0;
    for client in clients {
        answers += client.await.map_err(text)?.map_err(text)?;
    }
    Ok(answers as f64 / start.elapsed().as_secs_f64())
}

async fn client(address: SocketAddr, request: String) -> std::io::Result<u64> {
    let mut stream = TcpStream::connect(address).await?;
    stream.set_nodelay(true)?;
    let start = Instant::now();
    let mut buffer = [0; 4096];
    let mut answers = 0;
    while start.elapsed() < TURN {
        stream.write_all(request.as_bytes()).await?;
        let mut length = 0;
        // A 304 has no body: it ends with the empty line.
        while !buffer[..length].ends_with(b"\r\n\r\n") {
            let read = stream.read(&mut buffer[length..]).await?;
            if read == 0 {
                return Err(std::io::ErrorKind::UnexpectedEof.into());
            }
            length += read;
        }
        if !buffer.starts_with(b"HTTP/1.1 304") {
            return Err(std::io::Error::other("the answer was not 304"));
        }
        answers += 1;
    }
    Ok(answers)
}
