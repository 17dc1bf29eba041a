//! What a doctor wants to know of a database on a server: what slows it down, and what a failover would lose.

use super::error::StoreError;
use super::postgres;
use sqlx::PgConnection;

/// Whether nobody has counted what a table holds.
const UNKNOWN: &str = "n_live_tup > 1000 AND last_analyze IS NULL AND last_autoanalyze IS NULL";

/// What was found of a database on a server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerState {
    /// The release of the server.
    pub release: String,
    /// Processes with a lease, and those whose lease has ended.
    pub processes: (i64, i64),
    /// Transactions that have done nothing for a minute: they keep what is old from being cleared away.
    pub idle: i64,
    /// Tables most of whose rows are dead.
    pub bloated: Vec<String>,
    /// Tables whose statistics are missing although they hold something.
    pub unknown: Vec<String>,
    /// Standbys, and how many of them every commit waits for.
    pub standbys: (i64, i64),
    /// Bytes of the database.
    pub bytes: i64,
}

/// Looks at a database on a server, which services may have open.
///
/// # Errors
/// Where it cannot be reached, or its schema is none that this program knows.
pub(crate) async fn look(url: &str) -> Result<ServerState, StoreError> {
    let mut connection = postgres::connect(url).await?;
    postgres::require_known(&mut connection).await?;
    let one = &mut connection;
    let leases =
        "SELECT COUNT(*) FILTER (WHERE until >= ms), COUNT(*) FILTER (WHERE until < ms) FROM workers, clock";
    Ok(ServerState {
        release: sqlx::query_scalar("SHOW server_version").fetch_one(&mut *one).await?,
        processes: sqlx::query_as(leases).fetch_one(&mut *one).await?,
        idle: sqlx::query_scalar(
            "SELECT COUNT(*) FROM pg_stat_activity WHERE datname = current_database() AND state LIKE \
            'idle in transaction%' AND state_change < now() - interval '1 minute'",
        )
        .fetch_one(&mut *one)
        .await?,
        bloated: tables(one, "n_dead_tup > 10000 AND n_dead_tup > n_live_tup").await?,
        unknown: tables(one, UNKNOWN).await?,
        standbys: sqlx::query_as(
            "SELECT COUNT(*), COUNT(*) FILTER (WHERE sync_state IN ('sync', 'quorum')) FROM \
            pg_stat_replication",
        )
        .fetch_one(&mut *one)
        .await?,
        bytes: sqlx::query_scalar("SELECT pg_database_size(current_database())").fetch_one(&mut *one).await?,
    })
}

/// The tables of which a condition on their statistics holds.
async fn tables(connection: &mut PgConnection, condition: &'static str) -> Result<Vec<String>, StoreError> {
    let sql = format!("SELECT relname::TEXT FROM pg_stat_user_tables WHERE {condition} ORDER BY 1");
    Ok(sqlx::query_scalar(sqlx::AssertSqlSafe(sql)).fetch_all(connection).await?)
}
