//! Verbs, their arguments and their exit codes: 0 ok, 1 error, 2 usage, 3 rejected or nothing found, 4 not found.

mod bench;
mod bundle;
mod database;
mod demo;
mod diagnose;
mod doctor;
mod fit;
mod fits;
mod jobs;
mod ladder;
mod measured;
mod models;
mod params;
mod report;
pub mod serve;
pub mod server;
mod systems;
pub mod table;
mod tokens;
mod tune;
mod twin;
mod watch;
mod windows;

use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use serde_json::Value;
use server::{Answer, Server};
use std::io::{Read, Write};
use std::path::Path;
use std::process::ExitCode;

/// Estimation service for model predictive control: measurements in, validated parameters out.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Run the service.
    Serve(serve::Arguments),
    /// Fit a model to a CSV of measurements; needs no server.
    Fit(Box<fit::Arguments>),
    /// Say which physical effect a model is missing; needs no server.
    Diagnose(Box<diagnose::Arguments>),
    /// Add effects one after another while the error on unseen data falls; needs no server.
    Ladder(Box<ladder::Arguments>),
    /// Choose settings of the search on older measurements and judge them on newer ones; needs no server.
    Tune(Box<tune::Arguments>),
    /// Make a synthetic room that hides effects: its measurements, and apart from them the truth.
    Twin(twin::Arguments),
    /// Fit two real houses in a fresh folder, then serve them.
    Demo(demo::Arguments),
    /// Measure this build on this machine.
    ///
    /// `lampyris bench help` lists the studies.
    Bench(bench::Arguments),
    /// Jobs of a running server: post, watch, cancel, retry.
    Jobs(Box<jobs::Arguments>),
    /// What a running server serves to controllers.
    Params(params::Arguments),
    /// What a running server has found, and an operator's word on it.
    Fits(fits::Arguments),
    /// Models of a running server.
    Models(models::Arguments),
    /// Rooms and plants of a running server.
    Systems(systems::Arguments),
    /// Measurements on a running server.
    Windows(windows::Arguments),
    /// Who may ask a service: make, list and revoke tokens, in its database, also while it runs.
    Token(tokens::Arguments),
    /// Bring the schema of the database up to date. A backup is made beside it first. `serve` does the same.
    Migrate(database::Database),
    /// Copy the database into one file, also beside a running server.
    ///
    /// The file holds everything that was acknowledged before the verb began; it is checked and on the disk when the verb
    /// ends. A raw copy of the database file is no backup: what was written last is in the write-ahead log beside it,
    /// and a copy without that log lacks writes that were acknowledged.
    Backup(database::BackupArguments),
    /// Put a backup in the place of the database, while no server runs.
    ///
    /// The backup is checked first. The database that was there is kept beside it under a name with the time.
    Restore(database::RestoreArguments),
    /// Look at everything that the service stands on, and say what to do about it.
    ///
    /// Configuration, database, schema, log, clock, disk, folder, open files and CPU, a line each. The exit code is 1
    /// where a check failed; a warning is none.
    Doctor(database::Database),
    /// Print the OpenAPI document.
    Openapi,
    /// Print what a shell needs to complete these verbs.
    Completions {
        /// The shell.
        shell: Shell,
    },
}

/// Which part of a list.
#[derive(Debug, clap::Args)]
struct Page {
    /// Rows, at most 500.
    #[arg(long, default_value_t = 50)]
    limit: u16,
    /// Goes on where a list said that there is more.
    #[arg(long, value_name = "TOKEN")]
    page_token: Option<String>,
}

/// Why a verb ended without its result.
#[derive(Debug)]
pub enum Failure {
    /// Something went wrong; the text says what.
    Error(String),
    /// The arguments make no sense together.
    Usage(String),
    /// Nobody answers.
    Unreachable(String),
    /// The result is there, but the gate rejected it, or nothing was found.
    Rejected,
    /// What was asked for is known, but there is nothing to give.
    Nothing(String),
    /// A file or a name does not exist.
    NotFound(String),
}

/// Runs a verb and turns its end into an exit code.
pub fn run(cli: Cli) -> ExitCode {
    let result = match cli.verb {
        Verb::Serve(arguments) => serve::run(arguments),
        Verb::Fit(arguments) => fit::run(&arguments),
        Verb::Diagnose(arguments) => diagnose::run(&arguments),
        Verb::Ladder(arguments) => ladder::run(&arguments),
        Verb::Tune(arguments) => tune::run(&arguments),
        Verb::Twin(arguments) => twin::run(&arguments),
        Verb::Demo(arguments) => demo::run(&arguments),
        Verb::Bench(arguments) => bench::run(&arguments),
        Verb::Jobs(arguments) => jobs::run(&arguments),
        Verb::Params(arguments) => params::run(&arguments),
        Verb::Fits(arguments) => fits::run(&arguments),
        Verb::Models(arguments) => models::run(&arguments),
        Verb::Systems(arguments) => systems::run(&arguments),
        Verb::Windows(arguments) => windows::run(&arguments),
        Verb::Token(arguments) => tokens::run(arguments),
        Verb::Migrate(arguments) => database::migrate(&arguments),
        Verb::Backup(arguments) => database::backup(&arguments),
        Verb::Restore(arguments) => database::restore(&arguments),
        Verb::Doctor(arguments) => doctor::run(&arguments),
        Verb::Openapi => {
            print(&crate::http::openapi_yaml());
            Ok(())
        }
        Verb::Completions { shell } => {
            clap_complete::generate(shell, &mut Cli::command(), "lampyris", &mut std::io::stdout().lock());
            Ok(())
        }
    };
    exit_code(result)
}

/// How a verb ended, as a shell hears it; says on standard error what went wrong.
pub fn exit_code(result: Result<(), Failure>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Rejected) => ExitCode::from(3),
        Err(Failure::Nothing(message)) => {
            eprintln!("nothing found: {message}");
            ExitCode::from(3)
        }
        Err(Failure::Error(message) | Failure::Unreachable(message)) => {
            eprintln!("error: {message}");
            ExitCode::from(1)
        }
        Err(Failure::Usage(message)) => {
            eprintln!("error: {message}");
            ExitCode::from(2)
        }
        Err(Failure::NotFound(message)) => {
            eprintln!("not found: {message}");
            ExitCode::from(4)
        }
    }
}

/// Prints to standard output; a reader that has gone away is no error.
pub fn print(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// All faults as one message, a line each.
pub fn faults(faults: &[lampyris_core::fault::Fault]) -> Failure {
    let lines: Vec<String> = faults.iter().map(ToString::to_string).collect();
    Failure::Error(lines.join("\n       "))
}

/// Asks for a page of a list and shows it.
fn list(server: &Server, path: &str, page: &Page, query: &[(&str, &Option<String>)], columns: &[table::Column]) -> Result<(), Failure> {
    let mut asked = format!("{path}?page_size={}", page.limit);
    for (name, value) in query.iter().chain([&("page_token", &page.page_token)]) {
        if let Some(value) = value {
            asked.push_str(&format!("&{name}={}", server::segment(value)));
        }
    }
    shown_list(server, &server.get(&asked)?, columns)
}

/// Shows a list; an empty one is nothing found.
fn shown_list(server: &Server, answer: &Answer, columns: &[table::Column]) -> Result<(), Failure> {
    let is_empty = answer.document["items"].as_array().is_none_or(Vec::is_empty);
    if !is_empty || server.json() {
        server.show(answer, |list| table::items(list, columns));
    }
    if is_empty { Err(Failure::Nothing("the list is empty".to_owned())) } else { Ok(()) }
}

/// Reads a document: TOML where the name says so, otherwise JSON; `-` is standard input.
fn read_document(file: &Path) -> Result<Value, Failure> {
    let shown = file.display();
    let mut text = String::new();
    if file == Path::new("-") {
        std::io::stdin().read_to_string(&mut text).map_err(|error| Failure::Error(format!("standard input: {error}")))?;
    } else {
        text = std::fs::read_to_string(file).map_err(|error| Failure::NotFound(format!("{shown}: {error}")))?;
    }
    if file.extension().is_some_and(|kind| kind == "toml") {
        toml::from_str(&text).map_err(|error| Failure::Error(format!("{shown}: {error}")))
    } else {
        serde_json::from_str(&text).map_err(|error| Failure::Error(format!("{shown}: {error}")))
    }
}
