//! Verbs, their arguments and their exit codes: 0 ok, 1 error, 2 usage, 3 rejected or nothing found, 4 not found.

mod bench;
mod demo;
mod diagnose;
mod fit;
mod ladder;
mod measured;
mod serve;
mod twin;

use clap::{Parser, Subcommand};
use std::io::Write;
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
    /// Make a synthetic room that hides effects: its measurements, and apart from them the truth.
    Twin(twin::Arguments),
    /// Fit two real houses in a fresh folder, then serve them.
    Demo(demo::Arguments),
    /// Measure this build on this machine.
    Bench(bench::Arguments),
    /// Print the OpenAPI document.
    Openapi,
}

/// Why a verb ended without its result.
#[derive(Debug)]
pub enum Failure {
    /// Something went wrong; the text says what.
    Error(String),
    /// The result is there, but the gate rejected it, or nothing was found.
    Rejected,
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
        Verb::Twin(arguments) => twin::run(&arguments),
        Verb::Demo(arguments) => demo::run(&arguments),
        Verb::Bench(arguments) => bench::run(&arguments),
        Verb::Openapi => {
            print(&lampyris::http::openapi_yaml());
            Ok(())
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Rejected) => ExitCode::from(3),
        Err(Failure::Error(message)) => {
            eprintln!("error: {message}");
            ExitCode::from(1)
        }
        Err(Failure::NotFound(message)) => {
            eprintln!("not found: {message}");
            ExitCode::from(4)
        }
    }
}

/// Prints to standard output; a reader that has gone away is no error.
fn print(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// All faults as one message, a line each.
fn faults(faults: &[lampyris::fault::Fault]) -> Failure {
    let lines: Vec<String> = faults.iter().map(ToString::to_string).collect();
    Failure::Error(lines.join("\n       "))
}
