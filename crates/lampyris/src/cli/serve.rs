//! `lampyris serve`.

use super::output::{Failure, faults, print};
use crate::app;
use crate::settings::Settings;
use crate::store::DatabasePlace;
use crate::store::workers::ProcessRole;
use std::path::PathBuf;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::prelude::*;

/// What `serve` takes.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Settings file (TOML).
    #[arg(long, env = "LAMPYRIS_CONFIG")]
    config: Option<PathBuf>,
    /// Address to listen on; port 0 takes any free one.
    #[arg(long)]
    bind: Option<std::net::SocketAddr>,
    /// What this process does, of `api`, `worker` and `scheduler`; all of it by default.
    #[arg(long, value_name = "ROLE,…")]
    roles: Option<String>,
    /// The database: a file, which is made where it does not exist, or `postgres://…`.
    #[arg(long)]
    database: Option<DatabasePlace>,
}

/// Serves until it is told to stop.
///
/// # Errors
/// Where settings, database or address do not serve.
pub fn run(arguments: Arguments) -> Result<(), Failure> {
    start_logging();
    let mut settings =
        Settings::load(arguments.config.as_deref(), std::env::vars()).map_err(|found| faults(&found))?;
    settings.bind = arguments.bind.unwrap_or(settings.bind);
    settings.database = arguments.database.unwrap_or(settings.database);
    if let Some(text) = &arguments.roles {
        settings.roles = ProcessRole::list(text).map_err(|error| Failure::Usage(error.to_string()))?;
    }
    let runtime = runtime()?;
    runtime
        .block_on(app::serve(settings, |url| print(&format!("listening on {url}"))))
        .map_err(|error| Failure::Error(error.to_string()))
}

/// Models are compiled by recursion in places.
const STACK: usize = 8 << 20;

/// The async runtime of the service: two threads are enough, because no computing happens on them.
pub fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_stack_size(STACK)
        .enable_all()
        .build()
        .map_err(|error| Failure::Error(format!("cannot start the async runtime: {error}")))
}

/// Logs to standard error what `LAMPYRIS_LOG` asks for, such as `debug` or `info,sqlx=warn`.
fn start_logging() {
    let asked = std::env::var("LAMPYRIS_LOG").ok().and_then(|words| words.parse::<Targets>().ok());
    let filter = asked.unwrap_or_else(|| Targets::new().with_default(LevelFilter::INFO));
    let coloured = std::io::IsTerminal::is_terminal(&std::io::stderr());
    let lines = tracing_subscriber::fmt::layer().with_ansi(coloured).with_writer(std::io::stderr);
    tracing_subscriber::registry().with(lines.with_filter(filter)).init();
}
