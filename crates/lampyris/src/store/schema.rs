//! Which schema a database has, and whether it is one that this program knows.

use super::error::StoreError;
use rust_embed::RustEmbed;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, SqlSafeStr, SqliteConnection};
use std::collections::HashSet;
use std::path::Path;
use std::sync::LazyLock;

/// The texts of all migrations, by the names of their files: `0016_evidence.sql`.
#[derive(RustEmbed)]
#[folder = "../../migrations/sqlite"]
struct Files;

pub(super) static MIGRATIONS: LazyLock<Migrator> = LazyLock::new(migrator::<Files>);

/// All migrations of a folder.
pub(super) fn migrator<F: RustEmbed>() -> Migrator {
    Migrator::with_migrations(F::iter().filter_map(|name| migration::<F>(&name)).collect())
}

/// The migration in a file. What a database remembers of it, version, description and checksum, follows from
/// name and text as it does where the driver's own macro reads them.
fn migration<F: RustEmbed>(name: &str) -> Option<Migration> {
    let (version, description) = name.strip_suffix(".sql")?.split_once('_')?;
    let text = String::from_utf8(F::get(name)?.data.into_owned()).ok()?;
    let sql = AssertSqlSafe(text).into_sql_str();
    Some(Migration::new(
        version.parse().ok()?,
        description.replace('_', " ").into(),
        MigrationType::Simple,
        sql,
        false,
    ))
}

/// The newest schema that this program knows.
pub(super) fn newest() -> i64 {
    newest_of(&MIGRATIONS)
}

/// The newest of some migrations.
pub(super) fn newest_of(migrations: &Migrator) -> i64 {
    migrations.iter().map(|migration| migration.version).max().unwrap_or_default()
}

/// The schema of a database, which must be one that this program can read; 0 where the database is empty.
pub(super) async fn schema(connection: &mut SqliteConnection, path: &Path) -> Result<i64, StoreError> {
    let tables: Vec<String> = sqlx::query_scalar("SELECT name FROM sqlite_schema WHERE type = 'table'")
        .fetch_all(&mut *connection)
        .await?;
    if tables.is_empty() {
        return Ok(0);
    }
    if !tables.iter().any(|table| table == "_sqlx_migrations") {
        return Err(StoreError::Foreign(path.to_owned()));
    }
    // Casts, because the driver believes the types that a damaged schema declares.
    let sql = "SELECT CAST(version AS INTEGER), CAST(checksum AS BLOB) FROM _sqlx_migrations ORDER BY 1";
    let applied: Vec<(i64, Vec<u8>)> = sqlx::query_as(sql).fetch_all(&mut *connection).await?;
    let found = applied.last().map_or(0, |(version, _)| *version);
    if found > newest() {
        return Err(StoreError::Newer { found, known: newest() });
    }
    let mut migrations = Vec::new();
    for (version, checksum) in applied {
        let known = MIGRATIONS.iter().find(|known| known.version == version && *known.checksum == *checksum);
        migrations.push(known.cloned().ok_or(StoreError::Edited(version))?);
    }
    require_shape(connection, migrations).await?;
    Ok(found)
}

/// Whether a migration that this program knows was not applied yet.
pub(super) async fn is_behind(connection: &mut SqliteConnection) -> Result<bool, StoreError> {
    let applied: i64 =
        sqlx::query_scalar("SELECT COUNT(*) FROM _sqlx_migrations").fetch_one(connection).await?;
    Ok(applied.unsigned_abs() < MIGRATIONS.iter().count() as u64)
}

/// Tables, indexes and triggers must be those that the applied migrations make; what somebody has added is no
/// matter.
async fn require_shape(connection: &mut SqliteConnection, applied: Vec<Migration>) -> Result<(), StoreError> {
    let mut fresh = SqliteConnectOptions::new().in_memory(true).connect().await?;
    Migrator::with_migrations(applied)
        .run_direct(None, &mut fresh, false)
        .await
        .map_err(StoreError::Migration)?;
    let sql = "SELECT CAST(name AS BLOB), CAST(sql AS BLOB) FROM sqlite_schema WHERE sql IS NOT NULL";
    let wanted: Vec<(Vec<u8>, Vec<u8>)> = sqlx::query_as(sql).fetch_all(&mut fresh).await?;
    let found: HashSet<(Vec<u8>, Vec<u8>)> =
        sqlx::query_as(sql).fetch_all(connection).await?.into_iter().collect();
    match wanted.iter().find(|wanted| !found.contains(wanted)) {
        Some((name, _)) => {
            Err(StoreError::Damaged(format!("`{}` is not as it was made", String::from_utf8_lossy(name))))
        }
        None => Ok(()),
    }
}
