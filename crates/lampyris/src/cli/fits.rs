//! `lampyris fits`: what a running server has found, and an operator's word on it.

use super::fit;
use super::output::Failure;
use super::server::{Answer, Call, Server, segment};
use super::table::{self, Column};
use lampyris_core::estimate::Fit;
use lampyris_core::estimate::gate::check::CheckResult;
use serde::Deserialize;
use serde_json::{Value, json};

const FIELDS: &[Column] = &[
    ("fit", "/id"),
    ("system", "/system"),
    ("job", "/job"),
    ("verdict", "/verdict"),
    ("summary", "/summary"),
    ("decision", "/decision"),
    ("revision", "/revision"),
    ("created", "/created_at"),
];

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: Server,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// Show a fit: parameters, errors, checks. Exit code 3 where the gate rejected it.
    Show {
        /// Its id.
        id: String,
    },
    /// Serve a fit that was held or suggested.
    Promote(Decision),
    /// Refuse a fit that was held or suggested.
    Reject(Decision),
}

#[derive(Debug, clap::Args)]
struct Decision {
    /// The fit.
    id: String,
    /// Why.
    #[arg(long)]
    reason: String,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let server = &arguments.server;
    match &arguments.verb {
        Verb::Show { id } => {
            let answer = server.get(&format!("/fits/{}", segment(id)))?;
            server.show(&answer, describe);
            if answer.document["verdict"] == "rejected" { Err(Failure::Rejected) } else { Ok(()) }
        }
        Verb::Promote(decision) => decide(server, decision, "promote"),
        Verb::Reject(decision) => decide(server, decision, "reject"),
    }
}

fn decide(server: &Server, decision: &Decision, word: &str) -> Result<(), Failure> {
    let path = format!("/fits/{}/{word}", segment(&decision.id));
    let answer: Answer = server.call("POST", &path, Call::json(&json!({"reason": decision.reason})))?;
    server.show(&answer, |document| table::fields(document, FIELDS));
    Ok(())
}

/// The same report as that of `lampyris fit`. A server of another version may say more or less than this one
/// knows.
fn describe(document: &Value) -> String {
    let head = table::fields(document, FIELDS);
    let report = Fit::deserialize(document).map(|found| fit::table(&found));
    let checks = Vec::<CheckResult>::deserialize(&document["checks"]).map(|checks| fit::checks(&checks));
    match (report, checks) {
        (Ok(report), Ok(checks)) => format!("{head}\n\n{report}\n\n{checks}"),
        _ => format!("{head}\n\nthis server describes its fits in other words: ask with --json"),
    }
}
