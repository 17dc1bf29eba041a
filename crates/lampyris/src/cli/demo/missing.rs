//! What the models of the demo are missing: the Belgian laundry whose meter its model does not use, a
//! synthetic house that hides two effects, and a synthetic room that hides none. The service names the
//! effects, adds them, and the error falls step by step.

use super::houses::BELGIAN_HOUSE;
use super::wait::{failed, wait};
use crate::cli::ladder;
use crate::cli::output::{Failure, print};
use crate::service::Service;
use crate::service::access::tokens::LOCAL;
use crate::service::catalogue::windows::{self, Format};
use crate::service::catalogue::{models, systems};
use crate::service::queue::submit;
use crate::store::diagnoses;
use crate::store::jobs::{JobKind, Priority};
use crate::store::queue::Submitted;
use crate::store::reach::SystemScope;
use lampyris_core::data::SystemId;
use lampyris_core::model::ModelId;
use lampyris_core::twin::{Level, WorldRequest, world};
use serde_json::{Value, json};

/// The seeds of the synthetic house and of the room that hides nothing.
const SEEDS: [u64; 2] = [2, 1];

/// A room that is diagnosed.
struct Room {
    system: &'static str,
    label: &'static str,
    document: Value,
    csv: String,
    /// Which part of the record is asked about; nothing for the defaults.
    request: Value,
    /// Whether effects are added where some are missing.
    climbs: bool,
}

/// What was found in a room.
#[derive(Debug, serde::Serialize)]
pub struct DiagnosedRoom {
    system: String,
    label: &'static str,
    diagnosis: Value,
    /// The errors after each effect that was added.
    ladder: Option<Value>,
}

fn rooms() -> Result<Vec<Room>, Failure> {
    let twin = |seed: u64, effects: &[&str]| {
        world(&WorldRequest::new(seed, effects, Level::Matched))
            .map(|made| made.csv)
            .map_err(|fault| Failure::Error(fault.to_string()))
    };
    // The columns of the neighbours of a twin stand for rooms that are no systems of the demo.
    let house = json!({
        "model": "room3", "neighbours": ["room/81", "room/82"],
        "channels": { "T_room_81": "T_room_1", "T_room_82": "T_room_2" },
    });
    let with_test =
        json!({ "split": { "train": "P14D", "validation": "P7D", "test": "P7D" }, "method": { "seed": 1 } });
    Ok(vec![
        Room {
            system: "room/6",
            label: "laundry (Belgium), its appliances left out",
            document: json!({
                "model": "room2", "location": { "lat": 50.51, "lon": 3.71, "zone": "Europe/Brussels" },
                "channels": { "T_room": "T_laundry", "irradiance": "irradiance_clear_sky" },
            }),
            csv: BELGIAN_HOUSE.to_owned(),
            request: json!({
                "window": { "from": "2016-02-23T00:00:00Z", "to": "2016-03-06T23:50:00Z" },
                "split": { "train": "P7D", "validation": "P6D", "test": "P0D" },
                "method": { "seed": 1 },
            }),
            climbs: true,
        },
        Room {
            system: "room/7",
            label: "synthetic house with two hidden effects",
            document: house.clone(),
            csv: twin(SEEDS[0], &["wind_infiltration", "metered_gain"])?,
            request: with_test.clone(),
            climbs: true,
        },
        Room {
            system: "room/8",
            label: "synthetic room that hides nothing",
            document: house,
            csv: twin(SEEDS[1], &[])?,
            request: with_test,
            climbs: false,
        },
    ])
}

/// Diagnoses the rooms, and adds what they are missing to their models.
pub(crate) async fn find(service: &Service, hidden: bool) -> Result<Vec<DiagnosedRoom>, Failure> {
    let rooms = rooms()?;
    let mut submitted = Vec::new();
    for room in &rooms {
        let system = id(room)?;
        let mut document = room.document.clone();
        document["label"] = json!(room.label);
        systems::put(service, &system, document, LOCAL, |_| true).await.map_err(failed)?;
        windows::take(service, &system, Format::Csv, room.csv.clone(), None).await.map_err(failed)?;
        let request = room.request.as_object().cloned().unwrap_or_default();
        for kind in [JobKind::Diagnose, JobKind::Ladder].into_iter().take(1 + usize::from(room.climbs)) {
            match submit::one(service, kind, &system, false, Priority::Operator, &request, None)
                .await
                .map_err(failed)?
            {
                Submitted::New(job) | Submitted::Waiting(job) => submitted.push(job.id),
                // Only a repeated request with a key comes earlier, and these have none.
                Submitted::Earlier(_) => {}
            }
        }
    }
    for job in wait(service, &submitted, hidden, "Asking three rooms what their models are missing").await? {
        if let Some(error) = job.state.failure() {
            return Err(Failure::Error(format!("{}: {}", job.system, error.detail)));
        }
    }
    let mut found = Vec::new();
    for room in &rooms {
        let system = id(room)?;
        let newest = diagnoses::page(&service.store, &SystemScope::ALL, Some(&system), i64::MAX, 1)
            .await
            .map_err(|error| Failure::Error(error.to_string()))?;
        let ladder = diagnoses::newest_ladder(&service.store, &system)
            .await
            .map_err(|error| Failure::Error(error.to_string()))?;
        let ladder = ladder.map(|record| record.document);
        if let Some(ladder) = &ladder {
            add(service, ladder).await?;
        }
        let diagnosis = newest.into_iter().next().map_or(Value::Null, |record| record.document);
        found.push(DiagnosedRoom { system: system.to_string(), label: room.label, diagnosis, ladder });
    }
    Ok(found)
}

fn id(room: &Room) -> Result<SystemId, Failure> {
    room.system.parse().map_err(|error| Failure::Error(format!("{error}")))
}

/// Makes a version of the model for each effect that a ladder kept, as `POST /models/{id}/effects` does.
async fn add(service: &Service, ladder: &Value) -> Result<(), Failure> {
    let steps = ladder["steps"].as_array().map_or(&[][..], Vec::as_slice);
    for pair in steps.windows(2).filter(|pair| pair[1]["kept"] == json!(true)) {
        let parent: ModelId = pair[0]["model"]
            .as_str()
            .unwrap_or_default()
            .parse()
            .map_err(|error| Failure::Error(format!("{error}")))?;
        models::add_effect(service, &parent, json!({ "effect": pair[1]["added"] }), LOCAL, None)
            .await
            .map_err(failed)?;
    }
    Ok(())
}

/// What was found, for people.
pub fn present(found: &[DiagnosedRoom]) -> Result<(), Failure> {
    print(
        "\nWhat is missing? Each model was asked against every effect of the catalogue. Free-run errors in \
        K; `test` is data that no decision saw.",
    );
    for room in found {
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        print(&format!("\n{} {}\n  {}", room.system, room.label, text(&room.diagnosis["summary"])));
        for finding in room.diagnosis["findings"].as_array().map_or(&[][..], Vec::as_slice) {
            print(&format!(
                "  {} ({}): {}",
                text(&finding["title"]),
                text(&finding["effect"]),
                text(&finding["explain"])
            ));
        }
        if let Some(document) = &room.ladder {
            let ladder = serde_json::from_value(document.clone())
                .map_err(|error| Failure::Error(error.to_string()))?;
            ladder::text(&ladder).lines().for_each(|line| print(&format!("  {line}")));
        }
    }
    Ok(())
}
