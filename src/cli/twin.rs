//! `lampyris twin`: a synthetic room as a CSV, and the truth beside it.

use super::{Failure, print};
use lampyris::twin::{Level, WorldRequest, world};
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
    let request = WorldRequest {
        seed: arguments.seed,
        effects: arguments.effect.clone(),
        level: arguments.level.into(),
        days: arguments.days,
        step_minutes: arguments.step,
    };
    let world = world(&request).map_err(|fault| Failure::Error(fault.to_string()))?;
    let truth = serde_json::to_value(&world.truth).map_err(|error| Failure::Error(error.to_string()))?;
    let write =
        |path: &PathBuf, text: &str| std::fs::write(path, text).map_err(|error| Failure::Error(format!("{}: {error}", path.display())));
    if let Some(path) = &arguments.truth {
        write(path, &format!("{truth:#}\n"))?;
    }
    match &arguments.out {
        Some(path) => write(path, &world.csv)?,
        None if arguments.json => {
            print(&serde_json::json!({ "csv": world.csv, "neighbours": world.neighbours, "truth": truth }).to_string())
        }
        None => print(world.csv.trim_end()),
    }
    Ok(())
}
