//! `lampyris demo`: two real houses in a fresh folder - fitted, validated, asked what they are missing, and
//! served; and a treatment plant.

mod houses;
mod missing;
mod plant;
mod wait;

use super::output::{Failure, print};
use super::serve::runtime;
use crate::app::App;
use crate::service::access::tokens::LOCAL;
use crate::service::catalogue::systems;
use crate::service::catalogue::windows::{self, Format};
use crate::service::queue::submit;
use crate::settings::Settings;
use crate::store::fits::{self, FitRecord};
use crate::store::jobs::{JobKind, JobRecord, JobResult, Priority};
use crate::store::queue::Submitted;
use houses::{BELGIAN_HOUSE, HOURLY_HOUSE};
use lampyris_core::data::SystemId;
use lampyris_core::estimate::fit::AheadError;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Instant;
use wait::{failed, wait};

/// What a held room is, in plain words.
const HELD: &str = "held back, a good deed: what moves this room was not logged, so the controller keeps its \
    own baseline until an operator decides";
/// Validation errors above this share of persistence's say that the log misses what moves the room.
const HARDLY_BETTER: f64 = 0.9;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Address to serve on; where it is taken, a free port is used instead.
    #[arg(long, default_value = "127.0.0.1:8080")]
    bind: SocketAddr,
    /// Folder for the demo's database; by default a new one in the present folder.
    #[arg(long)]
    folder: Option<PathBuf>,
    /// Stop after the table instead of serving.
    #[arg(long)]
    once: bool,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

/// A room of the demo: its id, its document, its measurements and what is asked beside the defaults.
struct Room {
    system: &'static str,
    document: Value,
    csv: &'static str,
    request: Value,
}

fn rooms() -> Vec<Room> {
    let belgian = |system: &'static str, label: &str, column: &str| Room {
        system,
        document: json!({
            "label": label, "model": "room2",
            "location": { "lat": 50.51, "lon": 3.71, "zone": "Europe/Brussels" },
            "channels": { "T_room": column, "irradiance": "irradiance_clear_sky" },
        }),
        csv: BELGIAN_HOUSE,
        request: json!({ "method": { "seed": 1 } }),
    };
    vec![
        belgian("room/1", "laundry (Belgium)", "T_laundry"),
        belgian("room/2", "living room (Belgium)", "T_living_room"),
        belgian("room/3", "teen room (Belgium)", "T_teen_room"),
        belgian("room/4", "bathroom (Belgium)", "T_bathroom"),
        Room {
            system: "room/10",
            document: json!({
                "label": "laundry with its meter", "model": "rc2+solar_gain+metered_gain:P_appliances",
                "location": { "lat": 50.51, "lon": 3.71, "zone": "Europe/Brussels" },
                "channels": { "T_room": "T_laundry", "irradiance": "irradiance_clear_sky" },
            }),
            csv: BELGIAN_HOUSE,
            request: json!({ "method": { "seed": 1 } }),
        },
        Room {
            system: "room/5",
            document: json!({
                "label": "hourly house", "model": "tite",
                "channels": {
                    "T_room": "T_indoor_degC", "T_out": "T_outdoor_degC", "P_heater": "heat_input_raw"
                },
                // The unit of the heating channel is unknown, so its gain is searched on the channel's own
                // scale.
                "bounds": { "c_P_heater": [0.0, 0.05] },
            }),
            csv: HOURLY_HOUSE,
            request: json!({ "method": { "seed": 1 } }),
        },
    ]
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let folder = match &arguments.folder {
        Some(folder) => folder.clone(),
        None => fresh_folder()?,
    };
    std::fs::create_dir_all(&folder)
        .map_err(|error| Failure::Error(format!("{}: {error}", folder.display())))?;
    runtime()?.block_on(demonstrate(arguments, folder))
}

/// The first of `lampyris-demo`, `lampyris-demo-2`, … that does not exist: nothing is overwritten.
fn fresh_folder() -> Result<PathBuf, Failure> {
    (1..1000)
        .map(|n| {
            PathBuf::from(if n == 1 { "lampyris-demo".to_owned() } else { format!("lampyris-demo-{n}") })
        })
        .find(|folder| !folder.exists())
        .ok_or_else(|| Failure::Error("there are a thousand demo folders here; remove some".to_owned()))
}

async fn demonstrate(arguments: &Arguments, folder: PathBuf) -> Result<(), Failure> {
    let settings = Settings {
        bind: free_address(arguments.bind).await,
        database: folder.join("lampyris.db").into(),
        ..Settings::default()
    };
    let app = App::start(settings).await.map_err(|error| Failure::Error(error.to_string()))?;
    let service = app.service();
    let page = format!("http://{}/ui/", app.addr);
    if !arguments.json {
        print(&format!(
            "The page is {page}, and shows what follows as it happens. It takes about a minute.\n"
        ));
    }
    let start = Instant::now();
    let mut submitted = Vec::new();
    for room in rooms() {
        let system: SystemId = room.system.parse().map_err(|error| Failure::Error(format!("{error}")))?;
        systems::put(service, &system, room.document, LOCAL, |_| true).await.map_err(failed)?;
        windows::take(service, &system, Format::Csv, room.csv, None).await.map_err(failed)?;
        let request = room.request.as_object().cloned().unwrap_or_default();
        match submit::one(service, JobKind::Estimate, &system, false, Priority::Operator, &request, None)
            .await
            .map_err(failed)?
        {
            Submitted::New(job) | Submitted::Waiting(job) => submitted.push(job.id),
            // Only a repeated request with a key comes earlier, and these have none.
            Submitted::Earlier(_) => {}
        }
    }
    let finished = wait(service, &submitted, arguments.json, "Fitting the rooms of two real houses").await?;
    let seconds = start.elapsed().as_secs_f64();
    let plant = plant::fit(service, arguments.json).await?;
    let found = missing::find(service, arguments.json).await?;
    let mut lines = Vec::new();
    for job in &finished {
        let fit = match job.state.result().and_then(JobResult::found) {
            Some(found) => fits::get(&service.store, &found.id)
                .await
                .map_err(|error| Failure::Error(error.to_string()))?,
            None => None,
        };
        lines.push((job, fit));
    }
    if arguments.json {
        let rooms: Vec<Value> = lines.iter().map(|(job, fit)| document(job, fit.as_ref())).collect();
        print(
            &json!({
                "seconds": seconds, "folder": folder, "url": format!("http://{}", app.addr), "rooms": rooms,
                "plant": plant.document(), "missing": found
            })
            .to_string(),
        );
    } else {
        print("");
        present(&folder, seconds, &lines);
        plant::present(&plant, app.addr);
        missing::present(&found)?;
        invite(&app, &lines);
        if !arguments.once {
            print(&format!("\nThe page: {page}"));
        }
    }
    if !arguments.once {
        stop_signal().await;
    }
    app.shutdown().await.map_err(|error| Failure::Error(error.to_string()))
}

/// The wanted address, or any free port beside it.
async fn free_address(wanted: SocketAddr) -> SocketAddr {
    match tokio::net::TcpListener::bind(wanted).await {
        Ok(_) => wanted,
        Err(_) => SocketAddr::new(wanted.ip(), 0),
    }
}

async fn stop_signal() {
    // A terminal that gives no signals leaves the service running, which is what it is for.
    if tokio::signal::ctrl_c().await.is_err() {
        std::future::pending::<()>().await;
    }
}

fn document(job: &JobRecord, fit: Option<&FitRecord>) -> Value {
    json!({
        "system": job.system.to_string(), "model": job.model.to_string(),
        "state": job.state.status().as_str(), "verdict": fit.map(|fit| &fit.verdict),
        "summary": fit.map(|fit| &fit.summary), "fit": fit.map(|fit| &fit.fit),
    })
}

fn present(folder: &std::path::Path, seconds: f64, lines: &[(&JobRecord, Option<FitRecord>)]) {
    print(&format!(
        "Two real houses, fitted in {seconds:.1} s. Errors in K, on data that the search has not seen, \
        beside holding the last measurement.\n\
        Belgian house: Candanedo, Feldheim, Deramaix 2017 (UCI 374, CC BY 4.0). Hourly house: DarkGreyBox \
        demo data (MIT).\n"
    ));
    print(&format!(
        "{:<8} {:<24} {:<7} {:>6} {:>10}  {:>17} {:>17}  {}",
        "room", "what", "model", "train", "validation", "6 h ahead", "24 h ahead", "status"
    ));
    let labels: Vec<String> =
        rooms().iter().map(|room| room.document["label"].as_str().unwrap_or_default().to_owned()).collect();
    for ((job, fit), label) in lines.iter().zip(labels) {
        let Some(record) = fit else {
            let why = job
                .state
                .failure()
                .map_or_else(|| job.state.status().as_str().to_owned(), |error| error.detail.clone());
            print(&format!(
                "{:<8} {label:<24} {:<7} failed: {why}",
                job.system.to_string(),
                job.model.to_string()
            ));
            continue;
        };
        let Some(metrics) = record.fit.first_metrics() else {
            continue;
        };
        let ahead = |horizon: &str| {
            metrics
                .ahead
                .get(horizon)
                .map_or_else(String::new, |e| format!("{:.2} beside {:.2}", e.rmse, e.persistence))
        };
        let validation = metrics.validation_rmse.map_or_else(String::new, |value| format!("{value:.2}"));
        print(&format!(
            "{:<8} {label:<24} {:<7} {:>6.2} {validation:>10}  {:>17} {:>17}  {}",
            job.system.to_string(),
            record.fit.model,
            metrics.train_rmse,
            ahead("PT6H"),
            ahead("PT24H"),
            record.summary
        ));
        if record.verdict == "held" {
            print(&format!("{:<8} {HELD}", ""));
        } else if let Some(plain) = metrics.ahead.get("PT6H").and_then(hardly_better) {
            print(&format!("{:<8} {plain}", ""));
        }
    }
    print(&format!("\nThe database is in {}. Nothing leaves this machine.", folder.display()));
}

/// What to try next, on the room that the log explains best: it shows most clearly what a bad fit would lose.
fn invite(app: &App, lines: &[(&JobRecord, Option<FitRecord>)]) {
    let ratio = |fit: &FitRecord| {
        fit.fit
            .first_metrics()
            .and_then(|metrics| metrics.ahead.get("PT6H"))
            .map(|error| error.rmse / error.persistence)
    };
    let accepted = lines.iter().filter_map(|(job, fit)| {
        let fit = fit.as_ref().filter(|fit| fit.verdict == "accepted")?;
        Some((ratio(fit).unwrap_or(f64::INFINITY), job.system.to_string()))
    });
    if let Some((_, system)) = accepted.min_by(|a, b| a.0.total_cmp(&b.0)) {
        print(&format!(
            "\nWhat a controller gets:\n  curl -s http://{address}/params/{system}\n\nTry a fit that is \
            worse; the old parameters stay served, and the answer says why:\n  \
            curl -s -X POST http://{address}/jobs -H 'content-type: application/json' -d \
            '{{\"kind\":\"estimate\",\"system\":\"{system}\",\"fixed\":{{\"alpha_a\":5}}}}'\n  \
            curl -s http://{address}/params/{system}",
            address = app.addr
        ));
    }
}

/// A plain sentence where the log does not hold what moves the room.
fn hardly_better(ahead: &AheadError) -> Option<String> {
    (ahead.rmse > HARDLY_BETTER * ahead.persistence).then(|| {
        "hardly better than holding the last measurement: heating, windows and doors of this room were not \
        logged, and without them no model can do much"
            .to_owned()
    })
}
