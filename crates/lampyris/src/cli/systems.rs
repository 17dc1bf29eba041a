//! `lampyris systems`: rooms and plants of a running server.

use super::document::read_document;
use super::output::Failure;
use super::pages::{self, Page};
use super::server::{Call, Server};
use super::table::{self, Column};
use lampyris_core::data::SystemId;
use serde_json::{Value, json};
use std::path::PathBuf;

const COLUMNS: &[Column] = &[
    ("system", "/system"),
    ("label", "/label"),
    ("model", "/model"),
    ("status", "/status"),
    ("revision", "/revision"),
    ("newest job", "/latest_job"),
];
const FIELDS: &[Column] = &[
    ("system", "/system"),
    ("label", "/label"),
    ("model", "/model"),
    ("latitude", "/location/lat"),
    ("longitude", "/location/lon"),
    ("zone", "/location/zone"),
    ("channels", "/channels"),
    ("neighbours", "/neighbours"),
    ("policy", "/policy/mode"),
    ("stale after", "/policy/stale_after"),
    ("horizon", "/policy/horizon"),
    ("prior", "/prior"),
    ("excluded", "/exclude"),
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
    /// List systems, one row each. Exit code 3 where there are none.
    List(Page),
    /// Show one system.
    Show {
        /// The system, such as room/4.
        system: SystemId,
    },
    /// Make a system, or replace its document.
    Put {
        /// The system, such as room/4.
        system: SystemId,
        /// A TOML or JSON document; `-` for JSON on standard input.
        #[arg(required_unless_present = "model")]
        file: Option<PathBuf>,
        /// The model whose fits are served, in place of the document's.
        #[arg(long)]
        model: Option<String>,
        /// A name for people, in place of the document's.
        #[arg(long)]
        label: Option<String>,
    },
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let server = &arguments.server;
    match &arguments.verb {
        Verb::List(page) => pages::list(server, "/systems", page, &[], COLUMNS),
        Verb::Show { system } => {
            server.show(&server.get(&format!("/systems/{system}"))?, describe);
            Ok(())
        }
        Verb::Put { system, file, model, label } => {
            let mut document = file.as_ref().map_or_else(|| Ok(json!({})), |file| read_document(file))?;
            for (field, value) in [("model", model), ("label", label)] {
                if let (Some(fields), Some(value)) = (document.as_object_mut(), value) {
                    fields.insert(field.to_owned(), json!(value));
                }
            }
            server.show(&server.call("PUT", &format!("/systems/{system}"), Call::json(&document))?, describe);
            Ok(())
        }
    }
}

fn describe(system: &Value) -> String {
    table::fields(system, FIELDS)
}
