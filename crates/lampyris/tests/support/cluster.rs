//! Databases of a throwaway PostgreSQL, where `tests/cluster` has started one.

use lampyris::store::DatabasePlace;
use sqlx::{AssertSqlSafe, Connection, PgConnection, SqliteConnection};
use std::sync::atomic::{AtomicUsize, Ordering};

/// The URL of the server, without the name of a database.
fn server() -> Option<String> {
    std::env::var("LAMPYRIS_TEST_POSTGRES").ok()
}

/// Whether services of this run keep their data on PostgreSQL.
pub fn is_on() -> bool {
    server().is_some()
}

/// A database that nobody else has, where there is a server.
pub fn database() -> Option<DatabasePlace> {
    static MADE: AtomicUsize = AtomicUsize::new(0);
    let name = format!("t{}_{}", std::process::id(), MADE.fetch_add(1, Ordering::Relaxed));
    on_server(format!("CREATE DATABASE {name} TEMPLATE template0"));
    Some(DatabasePlace::from(format!("{}/{name}", server()?)))
}

/// Takes a database away, whoever is still connected.
pub fn drop_database(place: &DatabasePlace) {
    if let DatabasePlace::Server(url) = place {
        let name = url.rsplit('/').next().unwrap();
        on_server(format!("DROP DATABASE IF EXISTS {name} WITH (FORCE)"));
    }
}

fn on_server(sql: String) {
    let Some(server) = server() else { return };
    let work = async {
        let mut connection = PgConnection::connect(&format!("{server}/postgres")).await.unwrap();
        sqlx::raw_sql(AssertSqlSafe(sql)).execute(&mut connection).await.unwrap();
    };
    waited(work);
}

/// Waits for a database.
fn waited<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(work)
}

/// The first column of what a statement gives on a database, or how it failed.
pub fn behind(place: &DatabasePlace, sql: &str) -> Result<Vec<String>, String> {
    let sql = AssertSqlSafe(sql.to_owned());
    let work = async {
        match place {
            DatabasePlace::File(path) => {
                let mut connection =
                    SqliteConnection::connect(&format!("sqlite://{}", path.display())).await?;
                let rows = sqlx::query_scalar(sql).fetch_all(&mut connection).await;
                connection.close().await?;
                rows
            }
            DatabasePlace::Server(url) => {
                let mut connection = PgConnection::connect(url).await?;
                let rows = sqlx::query_scalar(sql).fetch_all(&mut connection).await;
                connection.close().await?;
                rows
            }
        }
    };
    waited(work).map_err(|error: sqlx::Error| error.to_string())
}
