//! `lampyris bench`: what this build does on this machine, every ratio within one run.

mod ablation;
mod charts;
mod complexity;
mod control;
mod diagnose;
mod engine;
mod functions;
mod hand;
mod house;
mod likelihood;
mod load;
mod page;
mod params;
mod plant;
mod plant_worlds;
mod real;
mod room;
mod search;
mod verdicts;

use super::{Failure, print};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// What to measure.
    #[arg(value_enum, default_value_t = Subject::Engine)]
    subject: Subject,
    /// First seed of the synthetic rooms.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many synthetic rooms are fitted; of the house, at most its eleven.
    #[arg(long, default_value_t = 20)]
    rooms: u64,
    /// How many worlds of each level are diagnosed: a third hides nothing, a third one effect, a fifth two, the others
    /// an effect that no catalogue has.
    #[arg(long, default_value_t = 30)]
    worlds: u64,
    /// Diagnose only kinds whose name holds this, such as `matched wind`; estimate only plants whose name does.
    #[arg(long)]
    only: Option<String>,
    /// How long the controller's path is polled beside fits; half as long beside fits and uploads.
    #[arg(long, default_value_t = 30)]
    seconds: u64,
    /// How many seeds each method runs with on each function.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Write tables and charts as one HTML file that needs no network.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write every run of `functions` or `room` as a line of a CSV file.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// How many weeks each house is controlled.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..=26))]
    weeks: u16,
    /// How many houses are controlled.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=100))]
    houses: u16,
    /// What the shape counts in the shape-weighted error of the house (delta of thesis eq. 7.6).
    #[arg(long, default_value_t = 0.5)]
    delta: f64,
    /// Estimate plants by the thesis's own algorithm and settings instead: one firefly at a time, ten minutes each.
    #[arg(long)]
    thesis: bool,
    /// Estimate a plant from records with noise, outages, few samples, a drift and wrong fixed numbers instead.
    #[arg(long)]
    realism: bool,
    /// Drive a plant with the measured influent of Jena instead, from the folder that holds `jena_influent_15min.csv`.
    #[arg(long, value_name = "FOLDER")]
    jena: Option<PathBuf>,
    /// The folder of measured rooms for `real`.
    #[arg(long, value_name = "FOLDER", default_value = "../shared/data/rooms")]
    data: PathBuf,
    /// Print a line per world, or per search, as it is done.
    #[arg(long)]
    each: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Subject {
    /// Simulation and controller path.
    Engine,
    /// The default search beside its rivals on synthetic rooms: one week fitted, one to judge.
    Room,
    /// What a diagnosis names on synthetic rooms with hidden effects.
    Diagnose,
    /// The same on measured rooms with a known driver withheld, and with the channels of other days.
    Real,
    /// The same on synthetic treatment plants: of sixty worlds twenty hide nothing, eight an effect that no catalogue has.
    DiagnosePlant,
    /// Chapter 5 of the thesis: the firefly family and its rivals on three functions.
    Functions,
    /// Each modification of the firefly algorithm alone removed from cFA, and alone added to the original.
    Ablation,
    /// How the evaluations of a generation grow with the population.
    Complexity,
    /// Maximum likelihood on synthetic rooms: whether and how fast it converges, and how often its intervals hold the truth.
    Likelihood,
    /// How long a controller waits for its parameters while the service has all hands full.
    Load,
    /// What fresh parameters are worth to a controller, in money and comfort.
    Loop,
    /// Chapter 6 of the thesis on a twin plant: what one evaluation takes, seven parameters, eleven unseen days.
    Plant,
    /// Chapter 7 of the thesis on a twin house: layout, methods, two weeks, bounds, valve.
    House,
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
        let [what, number, unit, limit, mark] = self.cells();
        format!("{what:<66} {number:>12} {unit:<8} {limit:<9} {mark}")
    }

    /// What, how much, in which unit, the limit, and whether it holds.
    fn cells(&self) -> [String; 5] {
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
        [self.what.clone(), self.number(), self.unit.to_owned(), limit, mark.to_owned()]
    }

    fn number(&self) -> String {
        if self.value != 0.0 && self.value.abs() < 1e-3 { format!("{:.2e}", self.value) } else { format!("{:.4}", self.value) }
    }
}

fn write(file: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(file, text).map_err(|error| Failure::Error(format!("{}: {error}", file.display())))?;
    eprintln!("written: {}", file.display());
    Ok(())
}

/// Seeds that are enough to fit an exponent.
const MOST_COMPLEX: u64 = 20;

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut more = Value::Null;
    let rows = match arguments.subject {
        Subject::Engine => {
            let mut rows = engine::run(arguments.seed)?;
            rows.extend(params::run()?);
            rows
        }
        Subject::Room => {
            let plan = room::Plan {
                first: arguments.seed,
                rooms: arguments.rooms,
                each: arguments.each,
                json: arguments.json,
                html: arguments.html.as_deref(),
                csv: arguments.csv.as_deref(),
            };
            let (rows, document) = room::run(&plan)?;
            more = document;
            rows
        }
        Subject::Functions => {
            functions::run(arguments.seed, arguments.seeds, arguments.html.as_deref(), arguments.csv.as_deref(), arguments.json)?
        }
        Subject::Ablation => ablation::run(arguments.seed, arguments.seeds),
        Subject::Complexity => complexity::run(arguments.seed, arguments.seeds.min(MOST_COMPLEX)),
        Subject::Likelihood => likelihood::run(arguments.seed, arguments.rooms, arguments.worlds, arguments.each)?,
        Subject::Load => load::run(arguments.seconds)?,
        Subject::Loop => {
            let plan = control::Plan::new(arguments.seed, arguments.houses.into(), arguments.weeks.into());
            return control::run(&plan, arguments.html.as_deref(), arguments.json);
        }
        Subject::House => {
            let (rows, document) = house::run(arguments.seed, arguments.rooms, arguments.delta, arguments.html.as_deref(), arguments.json)?;
            more = document;
            rows
        }
        Subject::Plant => {
            let plan = plant::Plan {
                first: arguments.seed,
                only: arguments.only.as_deref(),
                each: arguments.each,
                html: arguments.html.as_deref(),
                thesis: arguments.thesis,
                realism: arguments.realism,
                jena: arguments.jena.as_deref(),
            };
            let (rows, tables) = plant::run(&plan)?;
            if !arguments.json {
                tables.iter().for_each(|table| print(&format!("{}\n", table.text())));
            }
            more = json!({ "tables": tables });
            rows
        }
        Subject::DiagnosePlant => plant_worlds::run(arguments.seed, arguments.worlds, arguments.only.as_deref(), arguments.each)?,
        Subject::Real => {
            let (rows, windows) = real::run(&arguments.data, arguments.only.as_deref(), arguments.each, arguments.html.as_deref())?;
            if !arguments.json {
                print(&format!("{}\n", windows.text()));
            }
            more = json!({ "windows": windows });
            rows
        }
        Subject::Diagnose => diagnose::run(arguments.seed, arguments.worlds, arguments.only.as_deref(), arguments.each)?,
    };
    if arguments.json {
        let mut document = json!({ "rows": rows });
        if let (Value::Object(document), Value::Object(more)) = (&mut document, more) {
            document.extend(more);
        }
        print(&document.to_string());
    } else {
        rows.iter().for_each(|row| print(&row.line()));
    }
    let broken = rows.iter().filter(|row| !row.holds()).count();
    if broken == 0 { Ok(()) } else { Err(Failure::Error(format!("{broken} limits do not hold"))) }
}
