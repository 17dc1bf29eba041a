//! `lampyris migrate`, `backup` and `restore`: the database file itself, without a server.

use super::output::{Failure, faults, print};
use super::serve;
use crate::settings::Settings;
use crate::store::{DatabasePlace, StoreError, backup, migrate, moving};
use lampyris_core::fault::Fault;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Which database, and how the answer is printed.
#[derive(Debug, clap::Args)]
pub struct Database {
    /// Settings file (TOML).
    #[arg(long, env = "LAMPYRIS_CONFIG")]
    config: Option<PathBuf>,
    /// The database file.
    #[arg(long)]
    database: Option<DatabasePlace>,
    /// Print a JSON document.
    #[arg(long)]
    json: bool,
}

/// What to do with a database that a server has.
const OF_A_SERVER: &str =
    "the tools of its server make backups (pg_dump), and a start brings its schema up to date";

#[derive(Debug, clap::Args)]
pub struct MigrateArguments {
    #[command(flatten)]
    database: Database,
    /// A file whose data move to a server; no service may have it open.
    #[arg(long, requires = "to", conflicts_with = "database")]
    from: Option<PathBuf>,
    /// The empty database that they move into: `postgres://…`.
    #[arg(long, requires = "from")]
    to: Option<DatabasePlace>,
}

#[derive(Debug, clap::Args)]
pub struct BackupArguments {
    /// Where the copy goes; a file that is there is never replaced.
    file: PathBuf,
    #[command(flatten)]
    database: Database,
}

#[derive(Debug, clap::Args)]
pub struct RestoreArguments {
    /// A file that `lampyris backup` made.
    file: PathBuf,
    #[command(flatten)]
    database: Database,
}

impl Database {
    /// The settings of the service.
    pub fn settings(&self) -> Result<Settings, Vec<Fault>> {
        let mut settings = Settings::load(self.config.as_deref(), std::env::vars())?;
        settings.database = self.database.clone().unwrap_or(settings.database);
        Ok(settings)
    }

    fn path(&self) -> Result<PathBuf, Failure> {
        let place = self.settings().map_err(|found| faults(&found))?.database;
        let path =
            place.file().ok_or_else(|| Failure::Error(format!("{place} is no file: {OF_A_SERVER}")))?;
        Ok(path.to_owned())
    }

    /// Prints the document, or the sentences that say the same.
    pub fn show(&self, document: &serde_json::Value, sentence: &str) {
        if self.json { print(&document.to_string()) } else { print(sentence) }
    }
}

/// Brings the schema up to date, or moves a database to a server.
pub fn migrate(arguments: &MigrateArguments) -> Result<(), Failure> {
    let database = &arguments.database;
    if let (Some(from), Some(to)) = (&arguments.from, &arguments.to) {
        return moved(database, from, to);
    }
    let path = database.path()?;
    let done = serve::runtime()?.block_on(migrate::migrate(&path)).map_err(failure)?;
    let backup = done.backup.as_deref().map(shown);
    let sentence = match &backup {
        Some(backup) => {
            format!("schema {} -> {}; the database as it was is kept as {backup}", done.from, done.to)
        }
        None if done.from == done.to => format!("the schema is up to date: {}", done.to),
        None => format!("schema {} -> {}", done.from, done.to),
    };
    database.show(
        &json!({"database": shown(&path), "from": done.from, "to": done.to, "backup": backup}),
        &sentence,
    );
    Ok(())
}

fn moved(database: &Database, from: &Path, to: &DatabasePlace) -> Result<(), Failure> {
    let DatabasePlace::Server(url) = to else {
        return Err(Failure::Usage(format!("{to} is no server: a file moves by `lampyris backup`")));
    };
    let moved = serve::runtime()?.block_on(moving::move_to(from, url)).map_err(failure)?;
    let rows: i64 = moved.rows.iter().map(|(_, rows)| rows).sum();
    let sentence = format!(
        "{} -> {to}: {rows} rows of {} tables, and {} revisions are what they were",
        shown(from),
        moved.rows.len(),
        moved.revisions
    );
    let tables: serde_json::Map<String, serde_json::Value> =
        moved.rows.iter().map(|(table, rows)| ((*table).to_owned(), json!(rows))).collect();
    let document =
        json!({"from": shown(from), "to": to.to_string(), "rows": tables, "revisions": moved.revisions});
    database.show(&document, &sentence);
    Ok(())
}

/// Copies one moment of the database.
pub fn backup(arguments: &BackupArguments) -> Result<(), Failure> {
    let path = arguments.database.path()?;
    let made = serve::runtime()?.block_on(backup::backup(&path, &arguments.file)).map_err(failure)?;
    let file = shown(&arguments.file);
    let sentence = format!("{file}: {} bytes, schema {}, checked and on the disk", made.bytes, made.schema);
    arguments.database.show(
        &json!({"database": shown(&path), "file": file, "bytes": made.bytes, "schema": made.schema}),
        &sentence,
    );
    Ok(())
}

/// Puts a backup in the place of the database.
pub fn restore(arguments: &RestoreArguments) -> Result<(), Failure> {
    let path = arguments.database.path()?;
    let now = crate::service::now();
    let done = serve::runtime()?.block_on(backup::restore(&path, &arguments.file, now)).map_err(failure)?;
    let replaced = done.replaced.as_deref().map(shown);
    let kept = replaced
        .as_ref()
        .map_or("there was none before".to_owned(), |kept| format!("the one before is kept as {kept}"));
    let sentence =
        format!("{} is {} again, schema {}; {kept}", shown(&path), shown(&arguments.file), done.schema);
    let document = json!({
        "database": shown(&path), "file": shown(&arguments.file), "schema": done.schema, "replaced": replaced
    });
    arguments.database.show(&document, &sentence);
    Ok(())
}

fn failure(error: StoreError) -> Failure {
    match error {
        StoreError::NoFile(_) => Failure::NotFound(error.to_string()),
        error => Failure::Error(error.to_string()),
    }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}
