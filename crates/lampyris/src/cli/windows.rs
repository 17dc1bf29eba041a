//! `lampyris windows`: measurements on a running server.

use super::output::Failure;
use super::pages::{self, Page};
use super::server::{Call, Server, query};
use super::table::{self, Column};
use lampyris_core::data::SystemId;
use serde_json::Value;
use std::path::PathBuf;

const COLUMNS: &[Column] =
    &[("window", "/id"), ("rows", "/rows"), ("from", "/from"), ("to", "/to"), ("uploaded", "/uploaded_at")];
/// What was forecast, of which there is no window.
const ISSUE: &[Column] =
    &[("forecast of", "/issued_at"), ("rows", "/rows"), ("from", "/from"), ("to", "/to")];
const CHANNELS: [&str; 8] =
    ["unit", "missing", "min", "max", "median_step_s", "longest_gap_s", "stuck_s", "samples"];

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: Server,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// Send measurements, and forecasts in columns such as `T_out[degC](forecast)`. The same file again is
    /// the same window.
    Upload {
        /// The system, such as room/4.
        system: SystemId,
        /// CSV (`time,T_room[degC],…`, or as other programs write it), or JSON where the name says so.
        file: PathBuf,
        /// The IANA zone of times without offset in a CSV; that of the system by default.
        #[arg(long)]
        zone: Option<String>,
        /// The mark before decimals, where it cannot be recognised: point or comma.
        #[arg(long)]
        decimal: Option<String>,
        /// The form of the dates, where days and months could change places: day_first, month_first.
        #[arg(long)]
        dates: Option<String>,
    },
    /// List the windows of a system, newest first. Exit code 3 where there are none.
    List {
        /// The system, such as room/4.
        system: SystemId,
        #[command(flatten)]
        page: Page,
    },
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let server = &arguments.server;
    match &arguments.verb {
        Verb::Upload { system, file, zone, decimal, dates } => {
            let bytes = std::fs::read(file)
                .map_err(|error| Failure::NotFound(format!("{}: {error}", file.display())))?;
            let kind = if file.extension().is_some_and(|kind| kind == "json") {
                "application/json"
            } else {
                "text/csv"
            };
            let call = Call { body: Some((kind, bytes)), ..Call::default() };
            let said = query(&[("zone", zone), ("decimal", decimal), ("dates", dates)]);
            let path = format!("/systems/{system}/windows{said}");
            server.show(&server.call("POST", &path, call)?, describe);
            Ok(())
        }
        Verb::List { system, page } => {
            pages::list(server, &format!("/systems/{system}/windows"), page, &[], COLUMNS)
        }
    }
}

fn describe(window: &Value) -> String {
    let mut text = table::fields(window, if window["issued_at"].is_null() { COLUMNS } else { ISSUE });
    let head: Vec<String> = std::iter::once("channel").chain(CHANNELS).map(str::to_owned).collect();
    let row = |(name, channel): (&String, &Value)| {
        let cells = CHANNELS.iter().map(|field| table::cell(channel, &format!("/{field}")));
        std::iter::once(name.clone()).chain(cells).collect()
    };
    let rows: Vec<Vec<String>> =
        std::iter::once(head).chain(window["channels"].as_object().into_iter().flatten().map(row)).collect();
    text.push_str(&format!("\n\n{}", table::aligned(&rows)));
    for warning in window["warnings"].as_array().into_iter().flatten() {
        text.push_str(&format!("\nwarning: {}", table::cell(warning, "")));
    }
    for rejected in window["rejected_rows"].as_array().into_iter().flatten() {
        text.push_str(&format!(
            "\nline {} rejected: {}",
            table::cell(rejected, "/line"),
            table::cell(rejected, "/reason")
        ));
    }
    if window["forecast"].is_object() {
        text.push_str(&format!("\n\n{}", describe(&window["forecast"])));
    }
    text
}
