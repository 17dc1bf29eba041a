//! The command line of Lampyris.

use clap::Parser;
use lampyris::cli;
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run(cli::Cli::parse())
}
