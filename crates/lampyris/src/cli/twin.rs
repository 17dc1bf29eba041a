//! `lampyris twin`: a synthetic room or plant as a CSV, and the truth beside it.

use super::output::{Failure, faults, print};
use lampyris_core::model::Catalogue;
use lampyris_core::twin::{Level, PlantRequest, WorldRequest, plant, world};
use serde_json::Value;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// An effect to hide, such as wind_infiltration or stove; may be given several times. None hides nothing.
    #[arg(long, value_name = "EFFECT")]
    effect: Vec<String>,
    /// The seed: the same seed gives the same room.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How far the truth is from the model's structure.
    #[arg(long, value_enum, default_value_t = Distance::Matched)]
    level: Distance,
    /// Length of the window in days.
    #[arg(long, default_value_t = 28)]
    days: usize,
    /// Minutes between samples, a multiple of three.
    #[arg(long, default_value_t = 15)]
    step: usize,
    /// A treatment plant instead of a room, such as asm1_h; level and step are its own.
    #[arg(long, value_name = "MODEL")]
    plant: Option<String>,
    /// A true value of the plant that is not the usual one, such as s_aeration=0.6; may be given several
    /// times.
    #[arg(long, value_name = "NAME=VALUE", requires = "plant")]
    value: Vec<String>,
    /// Where the measurements go; standard output without it.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Where the truth goes, as JSON; nowhere without it.
    #[arg(long)]
    truth: Option<PathBuf>,
    /// Print measurements and truth as one JSON document.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Distance {
    /// The structure of room3.
    Matched,
    /// Two thermal masses more.
    Rich,
}

impl From<Distance> for Level {
    fn from(distance: Distance) -> Level {
        match distance {
            Distance::Matched => Level::Matched,
            Distance::Rich => Level::Rich,
        }
    }
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (csv, truth, neighbours) = match &arguments.plant {
        Some(plant) => treatment_plant(arguments, plant)?,
        None => room(arguments)?,
    };
    let write = |path: &PathBuf, text: &str| {
        std::fs::write(path, text).map_err(|error| Failure::Error(format!("{}: {error}", path.display())))
    };
    if let Some(path) = &arguments.truth {
        write(path, &format!("{truth:#}\n"))?;
    }
    match &arguments.out {
        Some(path) => write(path, &csv)?,
        None if arguments.json => {
            print(&serde_json::json!({ "csv": csv, "neighbours": neighbours, "truth": truth }).to_string())
        }
        None => print(csv.trim_end()),
    }
    Ok(())
}

/// A room: its measurements, the truth and its neighbours.
fn room(arguments: &Arguments) -> Result<(String, Value, Vec<String>), Failure> {
    let request = WorldRequest {
        seed: arguments.seed,
        effects: arguments.effect.clone(),
        level: arguments.level.into(),
        days: arguments.days,
        step_minutes: arguments.step,
        driven: None,
    };
    let world = world(&request).map_err(|fault| Failure::Error(fault.to_string()))?;
    let truth = serde_json::to_value(&world.truth).map_err(|error| Failure::Error(error.to_string()))?;
    Ok((world.csv, truth, world.neighbours))
}

/// A plant that starts where its document says, with what is hidden in it.
fn treatment_plant(arguments: &Arguments, id: &str) -> Result<(String, Value, Vec<String>), Failure> {
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let values: Vec<(&str, f64)> =
        arguments.value.iter().map(|text| value(text)).collect::<Result<_, _>>()?;
    let model =
        std::iter::once(id).chain(arguments.effect.iter().map(String::as_str)).collect::<Vec<_>>().join("+");
    let request = PlantRequest {
        seed: arguments.seed,
        model: &model,
        values: &values,
        days: arguments.days,
        noise: 1.0,
        warm_up: false,
    };
    let twin = plant(&catalogue, &request).map_err(|found| faults(&found))?;
    let parameters: serde_json::Map<String, Value> =
        twin.truth.into_iter().map(|(name, value)| (name, value.into())).collect();
    Ok((twin.csv, serde_json::json!({ "model": model, "parameters": parameters }), Vec::new()))
}

fn value(text: &str) -> Result<(&str, f64), Failure> {
    let wrong = || Failure::Error(format!("`{text}` is not NAME=VALUE with a number"));
    let (name, value) = text.split_once('=').ok_or_else(wrong)?;
    Ok((name, value.parse().map_err(|_| wrong())?))
}
