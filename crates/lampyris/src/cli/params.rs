//! `lampyris params`: what a running server serves to controllers.

use super::output::{Failure, print};
use super::pages::{self, Page};
use super::server::{Answer, Call, Server, segment};
use super::table::{self, Column};
use lampyris_core::data::SystemId;
use serde_json::{Value, json};
use std::time::Duration;

const COLUMNS: &[Column] = &[
    ("system", "/system"),
    ("status", "/status"),
    ("revision", "/revision"),
    ("model", "/model"),
    ("fit", "/fit"),
    ("validated", "/validated_at"),
    ("fallback", "/fallback/reason"),
];
const FIELDS: &[Column] = &[
    ("system", "/system"),
    ("status", "/status"),
    ("revision", "/revision"),
    ("model", "/model"),
    ("fit", "/fit"),
    ("flags", "/flags"),
    ("fitted", "/fitted_at"),
    ("validated", "/validated_at"),
    ("stale after", "/stale_after"),
    ("from", "/window/from"),
    ("to", "/window/to"),
    ("fallback", "/fallback/reason"),
    ("failed checks", "/fallback/failed_checks"),
    ("since", "/fallback/since"),
    ("pinned because", "/pin/reason"),
];
const HISTORY: &[Column] = &[
    ("revision", "/revision"),
    ("current", "/current"),
    ("fit", "/fit"),
    ("model", "/model"),
    ("verdict", "/verdict"),
    ("status", "/status"),
    ("fitted", "/fitted_at"),
    ("validated", "/validated_at"),
    ("published", "/published_at"),
    ("reason", "/reason"),
    ("summary", "/summary"),
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
    /// The parameters of a system. Exit code 3 where nothing was ever validated.
    Get {
        /// The system, such as room/4.
        system: SystemId,
        /// nominal: the model's nominal values where nothing was ever validated; fresh: nothing rather than a
        /// stale set.
        #[arg(long)]
        accept: Option<String>,
        /// The tag of the set that is known; the same set is not printed again.
        #[arg(long)]
        etag: Option<String>,
        /// Wait up to so many seconds for another set than the known one.
        #[arg(long, value_name = "SECONDS")]
        wait: Option<u64>,
    },
    /// The parameters of all systems, one row each. Exit code 3 where there are none.
    List,
    /// The revisions of a system with their verdicts.
    History {
        /// The system, such as room/4.
        system: SystemId,
        #[command(flatten)]
        page: Page,
    },
    /// Serve an earlier fit, as a new revision, until it is let go.
    Pin {
        /// The system, such as room/4.
        system: SystemId,
        /// The fit to serve.
        #[arg(long)]
        fit: String,
        /// Why.
        #[arg(long)]
        reason: String,
    },
    /// Let go of a pinned fit.
    Unpin {
        /// The system, such as room/4.
        system: SystemId,
    },
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let server = &arguments.server;
    match &arguments.verb {
        Verb::Get { system, accept, etag, wait } => {
            get(server, system, accept.as_deref(), etag.as_deref(), *wait)
        }
        Verb::List => pages::shown_list(server, &server.get("/params")?, COLUMNS),
        Verb::History { system, page } => {
            pages::list(server, &format!("/params/{system}/history"), page, &[], HISTORY)
        }
        Verb::Pin { system, fit, reason } => {
            let call = Call::json(&json!({"fit": fit, "reason": reason}));
            server.show(&server.call("PUT", &format!("/params/{system}/pin"), call)?, describe);
            Ok(())
        }
        Verb::Unpin { system } => {
            let answer = server.call("DELETE", &format!("/params/{system}/pin"), Call::default())?;
            if !answer.text.is_empty() {
                server.show(&answer, describe);
            }
            Ok(())
        }
    }
}

fn get(
    server: &Server,
    system: &SystemId,
    accept: Option<&str>,
    etag: Option<&str>,
    wait: Option<u64>,
) -> Result<(), Failure> {
    let mut call = Call::default();
    call.headers.extend(etag.map(|etag| ("if-none-match", etag.to_owned())));
    if let Some(seconds) = wait {
        call.headers.push(("prefer", format!("wait={seconds}")));
        call.extra = Duration::from_secs(seconds);
    }
    let query = accept.map_or_else(String::new, |accept| format!("?accept={}", segment(accept)));
    let answer: Answer = server.call("GET", &format!("/params/{system}{query}"), call)?;
    if answer.status == 304 {
        eprintln!("unchanged");
        return Ok(());
    }
    server.show(&answer, describe);
    if let Some(etag) = answer.etag.filter(|_| !server.json()) {
        print(&format!("tag     {etag}"));
    }
    Ok(())
}

fn describe(served: &Value) -> String {
    let mut text = table::fields(served, FIELDS);
    let mut rows = vec![["parameter", "value", "unit", "95 % interval"].map(str::to_owned).to_vec()];
    for (name, value) in served["parameters"].as_object().into_iter().flatten() {
        rows.push(vec![
            name.clone(),
            table::cell(value, ""),
            table::cell(&served["units"][name], ""),
            table::cell(&served["ci95"][name], ""),
        ]);
    }
    if rows.len() > 1 {
        text.push_str(&format!("\n\n{}", table::aligned(&rows)));
    }
    let mut rows = vec![
        ["free run", "unit", "train", "validation", "1 h ahead", "6 h", "24 h"].map(str::to_owned).to_vec(),
    ];
    for (output, error) in served["error"].as_object().into_iter().flatten() {
        let cells =
            ["/unit", "/train_rmse", "/validation_rmse", "/ahead/PT1H", "/ahead/PT6H", "/ahead/PT24H"];
        rows.push(
            std::iter::once(output.clone())
                .chain(cells.iter().map(|pointer| table::cell(error, pointer)))
                .collect(),
        );
    }
    if rows.len() > 1 {
        text.push_str(&format!("\n\n{}\n", table::aligned(&rows)));
    }
    text
}
