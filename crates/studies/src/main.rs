//! `lampyris bench`: what this build does on this machine, every ratio within one run.

mod ablation;
mod borrowing;
mod change;
mod charts;
mod complexity;
mod control;
mod counts;
mod diagnose;
mod engine;
mod experiments;
mod file;
mod fleet;
mod functions;
mod functions_hard;
mod hand;
mod house;
mod judged;
mod likelihood;
mod load;
mod missing_heat;
mod nights;
mod options;
mod page;
mod params;
mod plant;
mod plant_worlds;
mod proposals;
mod quantile;
mod real;
mod record;
mod results;
mod room;
mod row;
mod samples;
mod search;
mod twin_room;
mod verdicts;

use clap::{Parser, Subcommand};
use lampyris::cli::{Failure, exit_code, print};
use options::{First, Seeds, Worlds};
use record::Recording;
use row::Row;
use serde_json::{Value, json};
use std::process::ExitCode;
use std::time::Instant;

/// Measures this build on this machine.
#[derive(Debug, Parser)]
#[command(name = "lampyris bench", version, max_term_width = 100)]
struct Cli {
    /// What to measure; the engine where nothing is said.
    #[command(subcommand)]
    study: Option<Study>,
    /// Print JSON.
    #[arg(long, global = true)]
    json: bool,
    #[command(flatten)]
    recording: Recording,
}

#[derive(Debug, Subcommand)]
enum Study {
    /// Simulation and controller path.
    Engine(First),
    /// Simulations, derivatives and instructions of fixed inputs, which a busy machine does not change; needs
    /// valgrind.
    Counts(counts::Arguments),
    /// The default search beside its rivals on synthetic rooms: one week fitted, one to judge.
    Room(room::Arguments),
    /// What a diagnosis names on synthetic rooms with hidden effects: a third hides nothing, a third one
    /// effect, a fifth two, the others an effect that no catalogue has.
    Diagnose(Worlds),
    /// Whether what is missing hour by hour holds what was hidden, on synthetic rooms of three weeks.
    MissingHeat(Worlds),
    /// Whether the terms that are proposed are what was hidden, on synthetic rooms of four weeks.
    Proposals(Worlds),
    /// How soon and how rightly a parameter that changes is told, night by night, and how often one is told
    /// that has not: of five synthetic rooms one is quiet for a year.
    Change(Worlds),
    /// Whether the rooms of a house learn from each other: the week behind 5 and behind 28 days, alone and
    /// with what the others have, in synthetic houses of eleven rooms.
    Borrowing(Worlds),
    /// Whether planned experiments of two days teach what they promise, on synthetic rooms of four weeks.
    Experiments(Worlds),
    /// The same as `diagnose` on measured rooms with a known driver withheld, and with the channels of other
    /// days.
    Real(real::Arguments),
    /// Whether the terms that are proposed find the channel that drives a measured room, where no channel has
    /// a name that says what it is.
    RealProposals(real::proposals::Arguments),
    /// Whether the log-normal prior helps in measured rooms, with what drives them and without.
    RealPriors(real::priors::Arguments),
    /// How often the bands of forecasts hold what was measured then, in measured rooms.
    Bands(real::bands::Arguments),
    /// What a diagnosis names on synthetic treatment plants: of sixty worlds twenty hide nothing, eight an
    /// effect that no catalogue has.
    DiagnosePlant(Worlds),
    /// Chapter 5 of the thesis: the firefly family and its rivals on three functions.
    Functions(functions::Arguments),
    /// Functions that are shifted, rotated and ill-conditioned, BBOB's among them: expected running times of
    /// the default search and its rivals.
    FunctionsHard(functions_hard::Arguments),
    /// Each modification of the firefly algorithm alone removed from cFA, and alone added to the original.
    Ablation(Seeds),
    /// How the evaluations of a generation grow with the population.
    Complexity(Seeds),
    /// Maximum likelihood on synthetic rooms: whether and how fast it converges, and how often its intervals
    /// hold the truth.
    Likelihood(likelihood::Arguments),
    /// How long a controller waits for its parameters while the service has all hands full.
    Load(load::Arguments),
    /// What a night of very many rooms costs on one machine, by how many there are.
    Fleet(fleet::Arguments),
    /// What nights cost that begin at the served parameters, and what they lose, on synthetic rooms.
    Nights(Worlds),
    /// What fresh parameters are worth to a controller, in money and comfort.
    Loop(control::Arguments),
    /// Chapter 6 of the thesis on a twin plant: what one evaluation takes, seven parameters, eleven unseen
    /// days.
    Plant(plant::Arguments),
    /// Chapter 7 of the thesis on a twin house: layout, methods, two weeks, bounds, valve.
    House(house::Arguments),
    /// The page of the book with all figures, made of the documents that `--record` keeps.
    Results(results::Arguments),
}

impl Study {
    /// What the study is called on the command line, and its first seed; nothing where nothing is measured.
    fn name_and_seed(&self) -> Option<(&'static str, Option<u64>)> {
        let found = match self {
            Self::Engine(asked) => ("engine", Some(asked.seed)),
            Self::Counts(_) => ("counts", None),
            Self::Room(asked) => ("room", Some(asked.first.seed)),
            Self::Diagnose(asked) => ("diagnose", Some(asked.first.seed)),
            Self::MissingHeat(asked) => ("missing-heat", Some(asked.first.seed)),
            Self::Proposals(asked) => ("proposals", Some(asked.first.seed)),
            Self::Change(asked) => ("change", Some(asked.first.seed)),
            Self::Borrowing(asked) => ("borrowing", Some(asked.first.seed)),
            Self::Experiments(asked) => ("experiments", Some(asked.first.seed)),
            Self::Real(_) => ("real", None),
            Self::RealProposals(_) => ("real-proposals", None),
            Self::RealPriors(_) => ("real-priors", None),
            Self::Bands(_) => ("bands", None),
            Self::DiagnosePlant(asked) => ("diagnose-plant", Some(asked.first.seed)),
            Self::Functions(asked) => ("functions", Some(asked.seeds.first.seed)),
            Self::FunctionsHard(asked) => ("functions-hard", Some(asked.seeds.first.seed)),
            Self::Ablation(asked) => ("ablation", Some(asked.first.seed)),
            Self::Complexity(asked) => ("complexity", Some(asked.first.seed)),
            Self::Likelihood(asked) => ("likelihood", Some(asked.first.seed)),
            Self::Load(_) => ("load", None),
            Self::Fleet(asked) if asked.server.is_some() => ("fleet-server", None),
            Self::Fleet(_) => ("fleet", None),
            Self::Nights(asked) => ("nights", Some(asked.first.seed)),
            Self::Loop(asked) => ("loop", Some(asked.first.seed)),
            Self::Plant(asked) => ("plant", Some(asked.first.seed)),
            Self::House(asked) => ("house", Some(asked.first.seed)),
            Self::Results(_) => return None,
        };
        Some(found)
    }
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let study = cli.study.unwrap_or(Study::Engine(First { seed: 1 }));
    exit_code(run(&study, cli.json, &cli.recording))
}

fn run(study: &Study, as_json: bool, recording: &Recording) -> Result<(), Failure> {
    let begun = Instant::now();
    let rows = measured(study, as_json)?;
    let broken = rows.iter().filter(|row| !row.holds()).count();
    if let Some((name, seed)) = study.name_and_seed() {
        record::keep(recording, name, seed, begun.elapsed(), rows)?;
    }
    if broken == 0 { Ok(()) } else { Err(Failure::Error(format!("{broken} limits do not hold"))) }
}

/// Runs a study and prints what it says.
fn measured(study: &Study, as_json: bool) -> Result<Vec<Row>, Failure> {
    let mut more = Value::Null;
    let rows = match study {
        Study::Engine(asked) => {
            let mut rows = engine::run(asked.seed)?;
            rows.extend(params::run()?);
            rows
        }
        Study::Counts(asked) => counts::run(asked)?,
        Study::Room(asked) => {
            let (rows, document) = room::run(asked, as_json)?;
            more = document;
            rows
        }
        Study::Functions(asked) => functions::run(asked, as_json)?,
        Study::FunctionsHard(asked) => {
            let (rows, document) = functions_hard::run(asked, as_json);
            more = document;
            rows
        }
        Study::Ablation(asked) => ablation::run(asked),
        Study::Complexity(asked) => complexity::run(asked),
        Study::Likelihood(asked) => likelihood::run(asked)?,
        Study::Load(asked) if asked.samples => samples::run(asked.seconds)?,
        Study::Load(asked) => load::run(asked)?,
        Study::Fleet(asked) => fleet::run(asked)?,
        Study::Nights(asked) => nights::run(asked)?,
        Study::Loop(asked) => return control::run(asked, as_json),
        Study::House(asked) => {
            let (rows, document) = house::run(asked, as_json)?;
            more = document;
            rows
        }
        Study::Plant(asked) => {
            let (rows, tables) = plant::run(asked)?;
            if !as_json {
                tables.iter().for_each(|table| print(&format!("{}\n", table.text())));
            }
            more = json!({ "tables": tables });
            rows
        }
        Study::DiagnosePlant(asked) => plant_worlds::run(asked)?,
        Study::Real(asked) => {
            let (rows, windows) = real::run(asked)?;
            if !as_json {
                print(&format!("{}\n", windows.text()));
            }
            more = json!({ "windows": windows });
            rows
        }
        Study::RealProposals(asked) => real::proposals::run(asked)?,
        Study::RealPriors(asked) => real::priors::run(asked)?,
        Study::Bands(asked) => real::bands::run(asked)?,
        Study::Diagnose(asked) => diagnose::run(asked)?,
        Study::MissingHeat(asked) => missing_heat::run(asked)?,
        Study::Proposals(asked) => proposals::run(asked)?,
        Study::Change(asked) => change::run(asked)?,
        Study::Borrowing(asked) => borrowing::run(asked)?,
        Study::Experiments(asked) => experiments::run(asked)?,
        Study::Results(asked) => return results::run(asked).map(|()| Vec::new()),
    };
    if as_json {
        let mut document = json!({ "rows": rows });
        if let (Value::Object(document), Value::Object(more)) = (&mut document, more) {
            document.extend(more);
        }
        print(&document.to_string());
    } else {
        rows.iter().for_each(|row| print(&row.line()));
    }
    Ok(rows)
}
