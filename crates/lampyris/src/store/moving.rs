//! A database moves from the file of one service to a server that several share, with everything that it ever
//! served.

use super::error::StoreError;
use super::file::{options, real};
use super::lock::lock;
use super::migrate::bring_up_to_date;
use super::months;
use super::postgres;
use sqlx::postgres::PgConnection;
use sqlx::sqlite::SqliteRow;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Row, SqliteConnection};
use std::path::Path;
use tokio_stream::StreamExt;

/// Rows that one statement writes.
const AT_ONCE: usize = 200;

/// What moves, in an order that the keys allow. Who works, and what services tell each other, is another
/// matter there.
const TABLES: [&str; 34] = [
    "systems",
    "windows",
    "window_aliases",
    "models",
    "effects",
    "model_versions",
    "jobs",
    "batches",
    "batch_jobs",
    "fits",
    "offers",
    "decisions",
    "revisions",
    "retired",
    "fallbacks",
    "states",
    "schedules",
    "idempotency",
    "pins",
    "degradations",
    "fit_windows",
    "diagnoses",
    "ladders",
    "tokens",
    "audit",
    "evidence",
    "days",
    "shares",
    "measured",
    "samples",
    "forecast_inputs",
    "said_forecasts",
    "sources",
    "tenants",
];

/// What has moved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MoveReport {
    /// How many rows of each table.
    pub rows: Vec<(&'static str, i64)>,
    /// How many revisions were compared, each by the hash of what it serves.
    pub revisions: usize,
}

/// Moves the database in a file to an empty one on a server, all of it or nothing, and compares the two.
///
/// # Errors
/// Where a service has the file open, the server's database has systems already, or what is there is not what
/// was here.
pub async fn move_to(path: &Path, url: &str) -> Result<MoveReport, StoreError> {
    if !path.exists() {
        return Err(StoreError::NoFile(path.to_owned()));
    }
    let path = &real(path)?;
    let _lock = lock(path)?;
    bring_up_to_date(path).await?;
    let mut from = options(path).read_only(true).connect().await?;
    let pool = postgres::open(url).await?;
    let mut tx = pool.begin_with(postgres::BEGIN_TO_MOVE).await?;
    let known: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM systems").fetch_one(&mut *tx).await?;
    if known > 0 {
        return Err(StoreError::NotEmpty(known));
    }
    let mut rows = Vec::new();
    for table in months::TABLES {
        let sql = format!("SELECT DISTINCT day FROM {table}");
        let days: Vec<i64> = sqlx::query_scalar(AssertSqlSafe(sql)).fetch_all(&mut from).await?;
        for (name, first, next) in months::needed(table, days.into_iter())? {
            let made = sqlx::query(months::KEEP).bind(table).bind(name).bind(first).bind(next);
            made.execute(&mut *tx).await?;
        }
    }
    for table in TABLES {
        rows.push((table, copy(&mut from, &mut tx, table).await?));
    }
    for (counter, value) in
        sqlx::query_as::<_, (String, i64)>("SELECT name, value FROM counters").fetch_all(&mut from).await?
    {
        // Processes have entered there before; their numbers stay theirs.
        let sql = "UPDATE counters SET value = greatest(value, $2) WHERE name = $1";
        sqlx::query(sql).bind(counter).bind(value).execute(&mut *tx).await?;
    }
    for (table, column) in [("fits", "rowid"), ("audit", "sequence")] {
        let sql = format!(
            "SELECT setval(pg_get_serial_sequence('{table}', '{column}'), COALESCE(MAX({column}), 1)) FROM {table}"
        );
        sqlx::query(AssertSqlSafe(sql)).execute(&mut *tx).await?;
    }
    // Nobody has followed what was noted on the way: whoever starts there reads everything.
    sqlx::query("DELETE FROM changes").execute(&mut *tx).await?;
    let revisions = compare(&mut from, &mut tx, &rows).await?;
    sqlx::query("ANALYZE").execute(&mut *tx).await?;
    tx.commit().await?;
    pool.close().await;
    from.close().await?;
    Ok(MoveReport { rows, revisions })
}

/// Copies a table, and says how many rows it has.
async fn copy(from: &mut SqliteConnection, to: &mut PgConnection, table: &str) -> Result<i64, StoreError> {
    let sql = "SELECT column_name::TEXT, data_type::TEXT FROM information_schema.columns WHERE table_name = $1 AND \
        table_schema = current_schema() ORDER BY ordinal_position";
    let columns: Vec<(String, String)> = sqlx::query_as(sql).bind(table).fetch_all(&mut *to).await?;
    let names: Vec<&str> = columns.iter().map(|(name, _)| name.as_str()).collect();
    let names = names.join(", ");
    let sql = format!("SELECT {names} FROM {table} ORDER BY 1, 2");
    let mut rows = sqlx::query(AssertSqlSafe(sql)).fetch(from);
    let (mut copied, mut some) = (0, Vec::with_capacity(AT_ONCE));
    loop {
        let row = rows.next().await.transpose()?;
        let is_last = row.is_none();
        some.extend(row);
        if !some.is_empty() && (is_last || some.len() == AT_ONCE) {
            write(to, table, &names, &columns, &some).await?;
            copied += some.len() as i64;
            some.clear();
        }
        if is_last {
            return Ok(copied);
        }
    }
}

async fn write(
    to: &mut PgConnection,
    table: &str,
    names: &str,
    columns: &[(String, String)],
    rows: &[SqliteRow],
) -> Result<(), StoreError> {
    let marks = |row: usize| {
        let marks: Vec<String> =
            (0..columns.len()).map(|column| format!("${}", row * columns.len() + column + 1)).collect();
        format!("({})", marks.join(", "))
    };
    let marks: Vec<String> = (0..rows.len()).map(marks).collect();
    let sql = format!("INSERT INTO {table} ({names}) OVERRIDING SYSTEM VALUE VALUES {}", marks.join(", "));
    let mut query = sqlx::query(AssertSqlSafe(sql)).persistent(false);
    for row in rows {
        for (column, kind) in columns {
            let column = column.as_str();
            query = match kind.as_str() {
                "bigint" => query.bind(row.try_get::<Option<i64>, _>(column)?),
                "double precision" => query.bind(row.try_get::<Option<f64>, _>(column)?),
                "boolean" => query.bind(row.try_get::<Option<bool>, _>(column)?),
                "bytea" => query.bind(row.try_get::<Option<Vec<u8>>, _>(column)?),
                _ => query.bind(row.try_get::<Option<String>, _>(column)?),
            };
        }
    }
    query.execute(to).await?;
    Ok(())
}

/// Compares what is there with what was here: how many rows, and everything that was ever served.
async fn compare(
    from: &mut SqliteConnection,
    to: &mut PgConnection,
    rows: &[(&'static str, i64)],
) -> Result<usize, StoreError> {
    for (table, wanted) in rows {
        let sql = format!("SELECT COUNT(*) FROM {table}");
        let found: i64 = sqlx::query_scalar(AssertSqlSafe(sql)).fetch_one(&mut *to).await?;
        if found != *wanted {
            return Err(StoreError::Damaged(format!("{found} of {wanted} rows of {table} have arrived")));
        }
    }
    let sql = "SELECT system, revision, served, current FROM revisions ORDER BY system, revision";
    let here: Vec<(String, i64, String, bool)> = sqlx::query_as(sql).fetch_all(from).await?;
    let there: Vec<(String, i64, String, bool)> = sqlx::query_as(sql).fetch_all(to).await?;
    if here != there {
        return Err(StoreError::Damaged("what was served has arrived as something else".to_owned()));
    }
    Ok(here.len())
}
