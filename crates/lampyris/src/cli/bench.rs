//! `lampyris bench`: hands over to `lampyris-studies`, a program of its own so that nobody builds the studies
//! who does not run them.

use super::output::Failure;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;

#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub struct Arguments {
    /// Which study, and its options.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    rest: Vec<OsString>,
}

/// Becomes the studies; returns only where that does not work.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let this = std::env::current_exe().map_err(|error| Failure::Error(error.to_string()))?;
    let studies = this.with_file_name("lampyris-studies");
    let error = Command::new(&studies).args(&arguments.rest).exec();
    Err(Failure::NotFound(format!(
        "{}: {error}; `cargo build --release --workspace` builds it",
        studies.display()
    )))
}
