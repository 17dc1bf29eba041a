//! `lampyris token`: who may ask a service. It works on the database file, so that whoever has the file needs
//! no token.

use super::output::{Failure, faults, print};
use super::serve;
use super::table::{self, Column};
use crate::service::access::tokens::{self, LOCAL, Made, NewToken};
use crate::service::{ServiceError, now};
use crate::settings::Settings;
use crate::store::tokens::{Scope, TokenRecord};
use crate::store::{DatabasePlace, Store};
use jiff::Timestamp;
use lampyris_core::data::{Duration, SystemPattern};
use serde_json::{Value, json};
use std::path::PathBuf;

const COLUMNS: &[Column] = &[
    ("token", "/name"),
    ("scope", "/scope"),
    ("systems", "/systems"),
    ("state", "/state"),
    ("made", "/created_at"),
    ("expires", "/expires_at"),
    ("revoked", "/revoked_at"),
];

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Settings file (TOML) of the service.
    #[arg(long, global = true, env = "LAMPYRIS_CONFIG")]
    config: Option<PathBuf>,
    /// The database file of the service.
    #[arg(long, global = true)]
    database: Option<DatabasePlace>,
    /// Print a document.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// Make a token. It is printed once; only its hash is kept. From the first one on nobody is answered
    /// without.
    Create {
        /// Under which name it acts: letters, digits, `_`, `-` and `.`.
        #[arg(long)]
        name: String,
        /// `read`; `operate`: also measurements, jobs, decisions, pins and schedules; `admin`: everything.
        #[arg(long, value_parser = scope)]
        scope: Scope,
        /// The systems that it is good for, such as room/4 or room/*; all by default. Administrators are not
        /// limited.
        #[arg(long, value_name = "PATTERN")]
        system: Vec<SystemPattern>,
        /// How long it is good, such as P90D; until it is revoked by default.
        #[arg(long)]
        expires: Option<Duration>,
    },
    /// List all tokens, also those that have ended. Exit code 3 where there are none.
    List,
    /// Revoke a token for good. A running service knows it within a second.
    Revoke {
        /// Its name.
        name: String,
    },
}

fn scope(text: &str) -> Result<Scope, String> {
    text.parse().map_err(|error: crate::store::UnknownWord| error.to_string())
}

pub fn run(arguments: Arguments) -> Result<(), Failure> {
    let settings =
        Settings::load(arguments.config.as_deref(), std::env::vars()).map_err(|found| faults(&found))?;
    let database = arguments.database.unwrap_or(settings.database);
    if !matches!(arguments.verb, Verb::Create { .. }) && database.file().is_some_and(|file| !file.exists()) {
        return Err(Failure::NotFound(format!("there is no database {database}")));
    }
    serve::runtime()?.block_on(async {
        let store = Store::visit(&database).await.map_err(|error| Failure::Error(error.to_string()))?;
        let done = done(&store, arguments.verb, arguments.json).await;
        store.close().await;
        done
    })
}

async fn done(store: &Store, verb: Verb, json: bool) -> Result<(), Failure> {
    match verb {
        Verb::Create { name, scope, system, expires } => {
            let made = tokens::create(store, NewToken { name, scope, systems: system, expires }, LOCAL)
                .await
                .map_err(failed)?;
            print(&if json { with_secret(&made).to_string() } else { told(&made) });
            Ok(())
        }
        Verb::List => {
            let now = now();
            let tokens =
                crate::store::tokens::all(store).await.map_err(|error| Failure::Error(error.to_string()))?;
            let list = json!({
                "items": tokens.iter().map(|token| document(token, now)).collect::<Vec<_>>(),
                "next_page_token": null
            });
            if json || !tokens.is_empty() {
                print(&if json { list.to_string() } else { table::items(&list, COLUMNS) });
            }
            if tokens.is_empty() { Err(Failure::Nothing("there are no tokens".to_owned())) } else { Ok(()) }
        }
        Verb::Revoke { name } => {
            tokens::revoke(store, &name, LOCAL).await.map_err(failed)?;
            print(&if json {
                json!({"name": name, "revoked": true}).to_string()
            } else {
                format!("`{name}` is revoked")
            });
            Ok(())
        }
    }
}

fn failed(error: ServiceError) -> Failure {
    match error {
        ServiceError::Faults(found) => faults(&found),
        ServiceError::NotFound(..) => Failure::NotFound(error.to_string()),
        other => Failure::Error(other.to_string()),
    }
}

fn document(token: &TokenRecord, now: Timestamp) -> Value {
    json!({
        "name": token.name,
        "scope": token.scope,
        "systems": token.reach.patterns(),
        "state": tokens::ended(token, now).unwrap_or("good"),
        "created_at": token.created_at,
        "expires_at": token.expires_at,
        "revoked_at": token.revoked_at,
    })
}

fn with_secret(made: &Made) -> Value {
    let mut document = document(&made.record, made.record.created_at);
    document["token"] = made.secret.clone().into();
    document
}

fn told(made: &Made) -> String {
    format!(
        "{}\n\nThis is shown once. Send it as `Authorization: Bearer …`; the verbs read it from \
        LAMPYRIS_TOKEN.",
        made.secret
    )
}
