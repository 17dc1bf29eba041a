//! How a verb ends: what it prints, and what a shell hears.

use lampyris_core::fault::Fault;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

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
pub fn faults(faults: &[Fault]) -> Failure {
    Failure::Error(lines(faults))
}

/// All faults of a document of a model, and where its language is documented.
pub fn document_faults(file: &Path, faults: &[Fault]) -> Failure {
    let shown = file.display();
    let page =
        "see docs/reference/model-language.md, or /docs/book/reference/model-language.html of a server";
    Failure::Error(format!("{shown} is no model:\n       {}\n       {page}", lines(faults)))
}

fn lines(faults: &[Fault]) -> String {
    faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n       ")
}
