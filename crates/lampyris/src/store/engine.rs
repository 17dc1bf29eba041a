//! The two engines: SQLite in a file, which is the default, and PostgreSQL, which several machines share.
//!
//! Everything else in this folder speaks to a [`Pool`] or a [`Session`] and does not know which one it is,
//! but for the files of SQLite (`file`, `files`, `lock`, `backup`, `migrate`) and `postgres`.

use super::postgres::{self, within};
use sqlx::postgres::{PgConnection, PgPool};
use sqlx::sqlite::SqlitePool;
use sqlx::{Connection as _, Postgres, Sqlite, SqliteConnection, Transaction};
use std::pin::Pin;

/// Connections that are lent for a statement or for a transaction.
#[derive(Debug, Clone)]
pub(super) enum Pool {
    /// Of the file of one service.
    Sqlite(SqlitePool),
    /// Of a database that services share.
    Postgres(PgPool),
}

/// One transaction, or one connection without any.
#[derive(Debug)]
pub(super) enum Session {
    /// A transaction on SQLite.
    Sqlite(Transaction<'static, Sqlite>),
    /// A transaction on PostgreSQL.
    Postgres(Transaction<'static, Postgres>),
    /// A connection to SQLite that is nobody else's, as an upgrade has it.
    Alone(Box<SqliteConnection>),
}

/// By which way a statement goes.
#[derive(Debug)]
pub(super) enum Via<'a> {
    /// By any connection to SQLite.
    SqlitePool(&'a SqlitePool),
    /// By this one.
    Sqlite(&'a mut SqliteConnection),
    /// By any connection to PostgreSQL.
    PostgresPool(&'a PgPool),
    /// By this one.
    Postgres(&'a mut PgConnection),
}

/// What an engine comes to. In a box its driver's own futures are compiled once, and not in everything that
/// waits for a statement.
pub(super) type EngineFuture<'a, T> = Pin<Box<dyn Future<Output = Result<T, sqlx::Error>> + Send + 'a>>;

impl Pool {
    /// A transaction that reads, all of it from one moment.
    pub(super) fn begin(&self) -> EngineFuture<'_, Session> {
        Box::pin(async move {
            Ok(match self {
                Pool::Sqlite(pool) => Session::Sqlite(pool.begin().await?),
                Pool::Postgres(pool) => {
                    Session::Postgres(within(pool.begin_with(postgres::BEGIN_TO_READ)).await?)
                }
            })
        })
    }

    /// A transaction that writes; on a server it begins with this text.
    pub(super) fn begin_to_write(&self, on_postgres: &'static str) -> EngineFuture<'_, Session> {
        Box::pin(async move {
            match self {
                Pool::Sqlite(pool) => pool.begin_with("BEGIN IMMEDIATE").await.map(Session::Sqlite),
                Pool::Postgres(pool) => within(pool.begin_with(on_postgres)).await.map(Session::Postgres),
            }
        })
    }

    /// Ends all connections.
    pub(super) async fn close(&self) {
        match self {
            Pool::Sqlite(pool) => pool.close().await,
            Pool::Postgres(pool) => pool.close().await,
        }
    }
}

impl Session {
    /// Whether it is one to a server.
    pub(super) fn is_postgres(&self) -> bool {
        matches!(self, Session::Postgres(_))
    }

    /// Of a text for either engine, the one for this.
    pub(super) fn text(&self, texts: Texts) -> &'static str {
        match self {
            Session::Sqlite(_) | Session::Alone(_) => texts.sqlite,
            Session::Postgres(_) => texts.postgres,
        }
    }

    /// Ends a connection that is nobody else's.
    pub(super) fn close(self) -> EngineFuture<'static, ()> {
        Box::pin(async move {
            match self {
                Session::Alone(connection) => connection.close().await,
                transaction => transaction.rollback().await,
            }
        })
    }

    /// Ends the transaction so that it counts.
    pub(super) fn commit(self) -> EngineFuture<'static, ()> {
        Box::pin(async move {
            match self {
                Session::Sqlite(tx) => tx.commit().await,
                Session::Postgres(tx) => within(tx.commit()).await,
                Session::Alone(_) => Ok(()),
            }
        })
    }

    /// Ends the transaction without a trace.
    pub(super) fn rollback(self) -> EngineFuture<'static, ()> {
        Box::pin(async move {
            match self {
                Session::Sqlite(tx) => tx.rollback().await,
                Session::Postgres(tx) => within(tx.rollback()).await,
                Session::Alone(_) => Ok(()),
            }
        })
    }
}

/// A statement that the engines spell differently.
#[derive(Debug, Clone, Copy)]
pub(super) struct Texts {
    pub(super) sqlite: &'static str,
    pub(super) postgres: &'static str,
}

impl<'a> From<&'a Pool> for Via<'a> {
    fn from(pool: &'a Pool) -> Self {
        match pool {
            Pool::Sqlite(pool) => Via::SqlitePool(pool),
            Pool::Postgres(pool) => Via::PostgresPool(pool),
        }
    }
}

impl<'a> From<&'a mut Session> for Via<'a> {
    fn from(connection: &'a mut Session) -> Self {
        match connection {
            Session::Sqlite(tx) => Via::Sqlite(tx),
            Session::Postgres(tx) => Via::Postgres(tx),
            Session::Alone(connection) => Via::Sqlite(connection),
        }
    }
}
