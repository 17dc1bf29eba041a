//! PostgreSQL: how it is reached, and how its schema is made.

use super::error::StoreError;
use super::schema;
use rust_embed::RustEmbed;
use sqlx::migrate::Migrator;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions};
use sqlx::{ConnectOptions, PgConnection};
use std::str::FromStr;
use std::sync::LazyLock;
use std::time::Duration;

/// What every transaction that writes begins with. Nothing of it outlives the transaction, so that
/// connections may be shared behind a pooler. Whoever is cut off with a lock in hand holds the others up for
/// the second time and no longer: between two statements of ours there is next to nothing.
macro_rules! begin {
    ($lock:literal) => {
        concat!(
            "BEGIN; SET LOCAL statement_timeout = '60s'; SET LOCAL idle_in_transaction_session_timeout = '3s'; ",
            $lock
        )
    };
}

/// Begins a transaction that writes and is alone in that, as on SQLite. The table is empty and never written.
pub(super) const BEGIN_ALONE: &str = begin!("LOCK TABLE writing IN EXCLUSIVE MODE");

/// Begins a transaction that writes beside others of its kind, of rows that those leave alone.
pub(super) const BEGIN_BESIDE: &str = begin!("LOCK TABLE writing IN ROW SHARE MODE");

/// Begins a transaction that reads, all of it from one moment.
pub(super) const BEGIN_TO_READ: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ, READ ONLY; \
    SET LOCAL statement_timeout = '60s'; SET LOCAL idle_in_transaction_session_timeout = '60s'";

/// Begins the transaction that brings a whole database along: alone, and for as long as it takes.
pub(super) const BEGIN_TO_MOVE: &str =
    "BEGIN; SET CONSTRAINTS ALL DEFERRED; LOCK TABLE writing IN EXCLUSIVE MODE";

/// Connections of one service at most.
const CONNECTIONS: u32 = 12;
/// How long a statement waits for one of them.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long a call waits for the server: longer than any statement may take there.
const LONGEST: Duration = Duration::from_secs(65);

/// The texts of all migrations, by the names of their files.
#[derive(RustEmbed)]
#[folder = "../../migrations/postgres"]
struct Files;

/// The driver's own lock is one of a session, which a pooler may hand to somebody else before it is released.
static MIGRATIONS: LazyLock<Migrator> = LazyLock::new(|| {
    let mut migrations = schema::migrator::<Files>();
    migrations.set_locking(false);
    migrations
});

/// What a transaction that changes the schema locks; any number that nobody else uses.
const SCHEMA_LOCK: i64 = 0x4c61_6d70_7972_6973;

/// Ends a wait for a server that does not answer: the driver itself waits for ever.
pub(super) async fn within<T>(work: impl Future<Output = Result<T, sqlx::Error>>) -> Result<T, sqlx::Error> {
    let silent = |_| sqlx::Error::Io(std::io::ErrorKind::TimedOut.into());
    tokio::time::timeout(LONGEST, work).await.unwrap_or_else(|elapsed| Err(silent(elapsed)))
}

/// How a database is reached.
fn options(url: &str) -> Result<PgConnectOptions, StoreError> {
    Ok(PgConnectOptions::from_str(url)?.application_name("lampyris"))
}

/// Connects to a database and brings its schema up to date; one service at a time does that.
///
/// # Errors
/// Where the server cannot be reached, or the schema is none that this program knows.
pub(super) async fn open(url: &str) -> Result<PgPool, StoreError> {
    let pool = PgPoolOptions::new()
        .max_connections(CONNECTIONS)
        .acquire_timeout(PATIENCE)
        .connect_with(options(url)?)
        .await?;
    let mut tx = pool.begin().await?;
    sqlx::query("SELECT pg_advisory_xact_lock($1)").bind(SCHEMA_LOCK).execute(&mut *tx).await?;
    require_known(&mut tx).await?;
    MIGRATIONS.run_direct(None, &mut *tx, false).await.map_err(StoreError::Migration)?;
    tx.commit().await?;
    Ok(pool)
}

/// One connection to a database as it is.
pub(super) async fn connect(url: &str) -> Result<PgConnection, StoreError> {
    Ok(options(url)?.connect().await?)
}

/// The schema must be one that this program knows, or none at all.
pub(super) async fn require_known(connection: &mut PgConnection) -> Result<(), StoreError> {
    let made: bool = sqlx::query_scalar("SELECT to_regclass('_sqlx_migrations') IS NOT NULL")
        .fetch_one(&mut *connection)
        .await?;
    if !made {
        return Ok(());
    }
    let found: i64 = sqlx::query_scalar("SELECT COALESCE(MAX(version), 0) FROM _sqlx_migrations")
        .fetch_one(connection)
        .await?;
    let known = schema::newest_of(&MIGRATIONS);
    if found > known { Err(StoreError::Newer { found, known }) } else { Ok(()) }
}
