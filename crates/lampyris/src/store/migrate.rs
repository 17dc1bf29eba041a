//! How the schema of a database becomes the one of this program.
//!
//! Every migration is one transaction, and so is every window of an earlier program that is taken in behind
//! them. Before the first of them touches a database that holds something, a backup is made beside it.

use super::backup::{copy, require_own_log, require_sound};
use super::engine::Session;
use super::error::StoreError;
use super::failpoint;
use super::file::{beside, options, real};
use super::lock::lock;
use super::schema::{MIGRATIONS, is_behind, newest, schema};
use super::taking_in::take_in;
use sqlx::migrate::Migrator;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use std::path::{Path, PathBuf};

/// What it took to bring a database up to date.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Migrated {
    /// The schema before; 0 where the database was empty.
    pub from: i64,
    /// The schema now.
    pub to: i64,
    /// The backup of the database as it was, where there was anything to lose.
    pub backup: Option<PathBuf>,
}

/// Brings the schema of a database up to date while no service has it open.
///
/// # Errors
/// Where there is no such file, a service has it open, or its schema is none that this program knows.
pub(crate) async fn migrate(path: &Path) -> Result<Migrated, StoreError> {
    if !path.exists() {
        return Err(StoreError::NoFile(path.to_owned()));
    }
    let path = &real(path)?;
    let _lock = lock(path)?;
    bring_up_to_date(path).await
}

/// Looks at a database that cannot be written: its schema must be the newest, since nobody can bring it up to
/// date.
pub(super) async fn require_up_to_date(
    connection: &mut SqliteConnection,
    path: &Path,
    unwritable: &StoreError,
) -> Result<(), StoreError> {
    let found = schema(connection, path).await?;
    if found == 0 || is_behind(connection).await? {
        return Err(StoreError::Outdated { found, known: newest(), why: unwritable.cause() });
    }
    require_sound(connection, "PRAGMA quick_check(3)").await
}

/// Looks at a database, makes it if it is not there, and applies what is missing. The caller holds the lock.
///
/// Nothing is written before the look: a damaged, foreign or newer database stays as it is.
pub(super) async fn bring_up_to_date(path: &Path) -> Result<Migrated, StoreError> {
    require_own_log(path).await?;
    let mut connection = options(path).create_if_missing(true).connect().await?;
    let migrated = bring(&mut connection, path).await;
    connection.close().await?;
    migrated
}

/// Lets tests kill the process before any of its commits.
async fn watch(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    connection.lock_handle().await?.set_commit_hook(|| {
        failpoint::reached("in_migration");
        true
    });
    Ok(())
}

/// The schema in which measurements by channel stand beside those by day, where they are taken from the one
/// to the other.
const TAKING_IN: i64 = 28;

async fn bring(connection: &mut SqliteConnection, path: &Path) -> Result<Migrated, StoreError> {
    let from = schema(connection, path).await?;
    let mut backup = None;
    if from > 0 && is_behind(connection).await? {
        // One file per schema: a start that fails again and again must not fill the disk with backups.
        let file = beside(path, &format!(".schema-{from}.backup"));
        copy(connection, path, &file).await?;
        backup = Some(file);
    }
    sqlx::query("PRAGMA journal_mode = WAL").execute(&mut *connection).await?;
    watch(connection).await?;
    if from <= TAKING_IN {
        let first = MIGRATIONS.iter().filter(|migration| migration.version <= TAKING_IN).cloned().collect();
        let first = Migrator::with_migrations(first);
        first.run_direct(None, connection, false).await.map_err(StoreError::Migration)?;
        let mut beside = options(path).connect().await?;
        watch(&mut beside).await?;
        let mut beside = Session::Alone(Box::new(beside));
        let taken_in = take_in(&mut beside).await;
        beside.close().await?;
        taken_in?;
    }
    MIGRATIONS.run_direct(None, connection, false).await.map_err(StoreError::Migration)?;
    Ok(Migrated { from, to: newest(), backup })
}
