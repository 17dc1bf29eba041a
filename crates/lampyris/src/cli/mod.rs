//! Verbs, their arguments and their exit codes: 0 ok, 1 error, 2 usage, 3 rejected or nothing found, 4 not
//! found.

mod bench;
mod bundle;
mod database;
mod demo;
mod diagnose;
mod doctor;
mod document;
mod fit;
mod fits;
mod jobs;
mod ladder;
mod measured;
mod models;
mod output;
mod pages;
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

pub use output::{Failure, exit_code, faults, print};

use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
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
    Migrate(database::MigrateArguments),
    /// Copy the database into one file, also beside a running server.
    ///
    /// The file holds everything that was acknowledged before the verb began; it is checked and on the disk
    /// when the verb ends. A raw copy of the database file is no backup: what was written last is in the
    /// write-ahead log beside it, and a copy without that log lacks writes that were acknowledged.
    Backup(database::BackupArguments),
    /// Put a backup in the place of the database, while no server runs.
    ///
    /// The backup is checked first. The database that was there is kept beside it under a name with the time.
    Restore(database::RestoreArguments),
    /// Look at everything that the service stands on, and say what to do about it.
    ///
    /// Configuration, database, schema, log, clock, disk, folder, open files and CPU, a line each. The exit
    /// code is 1 where a check failed; a warning is none.
    Doctor(database::Database),
    /// Print the OpenAPI document.
    Openapi,
    /// Print what a shell needs to complete these verbs.
    Completions {
        /// The shell.
        shell: Shell,
    },
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
