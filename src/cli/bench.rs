//! `lampyris bench`: what this build does on this machine, every ratio within one run.

mod diagnose;
mod engine;
mod hand;
mod likelihood;
mod load;
mod params;
mod search;
mod verdicts;

use super::{Failure, print};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// What to measure.
    #[arg(value_enum, default_value_t = Subject::Engine)]
    subject: Subject,
    /// First seed of the synthetic rooms.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many synthetic rooms are fitted.
    #[arg(long, default_value_t = 20)]
    rooms: u64,
    /// How many worlds of each level are diagnosed: a third hides nothing, a third one effect, a fifth two, the others
    /// an effect that no catalogue has.
    #[arg(long, default_value_t = 30)]
    worlds: u64,
    /// Diagnose only kinds whose name holds this, such as `matched wind`.
    #[arg(long)]
    only: Option<String>,
    /// How long the controller's path is polled beside fits; half as long beside fits and uploads.
    #[arg(long, default_value_t = 30)]
    seconds: u64,
    /// Print a line per world as it is done.
    #[arg(long)]
    each: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Subject {
    /// Simulation, search and controller path.
    Engine,
    /// What a diagnosis names on synthetic rooms with hidden effects.
    Diagnose,
    /// Maximum likelihood on synthetic rooms: whether and how fast it converges, and how often its intervals hold the truth.
    Likelihood,
    /// How long a controller waits for its parameters while the service has all hands full.
    Load,
}

/// One line of the table.
#[derive(Debug, serde::Serialize)]
struct Row {
    what: String,
    value: f64,
    unit: &'static str,
    /// The limit of a ratio or count that binds.
    #[serde(skip_serializing_if = "Option::is_none")]
    limit: Option<Limit>,
}

/// A limit on a ratio, a share or a count.
#[derive(Debug, Clone, Copy, serde::Serialize)]
#[serde(rename_all = "snake_case")]
enum Limit {
    AtMost(f64),
    AtLeast(f64),
}

impl Row {
    fn new(what: impl Into<String>, value: f64, unit: &'static str) -> Self {
        Self { what: what.into(), value, unit, limit: None }
    }

    fn at_most(self, limit: f64) -> Self {
        Self { limit: Some(Limit::AtMost(limit)), ..self }
    }

    fn at_least(self, limit: f64) -> Self {
        Self { limit: Some(Limit::AtLeast(limit)), ..self }
    }

    fn holds(&self) -> bool {
        match self.limit {
            None => true,
            Some(Limit::AtMost(limit)) => self.value <= limit,
            Some(Limit::AtLeast(limit)) => self.value >= limit,
        }
    }

    fn line(&self) -> String {
        let limit = match self.limit {
            None => String::new(),
            Some(Limit::AtMost(limit)) => format!("<= {limit}"),
            Some(Limit::AtLeast(limit)) => format!(">= {limit}"),
        };
        let mark = match (self.limit.is_some(), self.holds()) {
            (false, _) => "",
            (true, true) => "holds",
            (true, false) => "FAILS",
        };
        format!("{:<66} {:>12.4} {:<8} {limit:<9} {mark}", self.what, self.value, self.unit)
    }
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let rows = match arguments.subject {
        Subject::Engine => {
            let mut rows = engine::run(arguments.seed)?;
            rows.extend(search::run(arguments.seed, arguments.rooms)?);
            rows.extend(params::run()?);
            rows
        }
        Subject::Likelihood => likelihood::run(arguments.seed, arguments.rooms, arguments.worlds, arguments.each)?,
        Subject::Load => load::run(arguments.seconds)?,
        Subject::Diagnose => diagnose::run(arguments.seed, arguments.worlds, arguments.only.as_deref(), arguments.each)?,
    };
    if arguments.json {
        print(&serde_json::json!({ "rows": rows }).to_string());
    } else {
        rows.iter().for_each(|row| print(&row.line()));
    }
    let broken = rows.iter().filter(|row| !row.holds()).count();
    if broken == 0 { Ok(()) } else { Err(Failure::Error(format!("{broken} limits do not hold"))) }
}
