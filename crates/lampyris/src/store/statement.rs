//! Statements: one text with its values, for either engine.
//!
//! SQL that both engines read alike is written once. Where SQLite has a function that PostgreSQL has not, as
//! `json_each`, `glob` or the larger of two numbers, the schema of PostgreSQL defines one of that name.

use super::engine::{EngineFuture, Via};
use super::postgres::within;
use sqlx::postgres::PgRow;
use sqlx::sqlite::SqliteRow;
use sqlx::{FromRow, SqlSafeStr, SqlStr};
use std::borrow::Cow;
use std::marker::PhantomData;

/// A value of a statement.
#[derive(Debug)]
pub(super) enum SqlValue<'q> {
    Whole(Option<i64>),
    Real(Option<f64>),
    Flag(bool),
    Text(Option<Cow<'q, str>>),
    Bytes(Option<Cow<'q, [u8]>>),
}

/// A row that either engine gives.
pub(super) trait FromEither: FromSqlite + FromPostgres + Send + Unpin {}

impl<T: FromSqlite + FromPostgres + Send + Unpin> FromEither for T {}

/// A row that SQLite gives.
pub(super) trait FromSqlite: for<'r> FromRow<'r, SqliteRow> {}

impl<T: for<'r> FromRow<'r, SqliteRow>> FromSqlite for T {}

/// A row that PostgreSQL gives.
pub(super) trait FromPostgres: for<'r> FromRow<'r, PgRow> {}

impl<T: for<'r> FromRow<'r, PgRow>> FromPostgres for T {}

/// A statement with its values, whose rows are read as `T`.
#[derive(Debug)]
#[must_use]
pub(super) struct Statement<'q, T> {
    sql: SqlStr,
    values: Vec<SqlValue<'q>>,
    /// Whether it will be asked again, so that the engine keeps what it has made of the text.
    lasts: bool,
    rows: PhantomData<fn() -> T>,
}

/// A statement whose rows have one column each.
#[derive(Debug)]
#[must_use]
pub(super) struct Scalars<'q, T>(Statement<'q, (T,)>);

/// A statement whose rows nobody reads; but whether there are any may be asked.
pub(super) fn query<'q>(sql: impl SqlSafeStr) -> Statement<'q, Nothing> {
    query_as(sql)
}

/// A statement with rows.
pub(super) fn query_as<'q, T>(sql: impl SqlSafeStr) -> Statement<'q, T> {
    Statement { sql: sql.into_sql_str(), values: Vec::new(), lasts: true, rows: PhantomData }
}

/// A statement with rows of one column.
pub(super) fn query_scalar<'q, T>(sql: impl SqlSafeStr) -> Scalars<'q, T> {
    Scalars(query_as(sql))
}

/// A row of which nothing is read.
#[derive(Debug)]
pub(super) struct Nothing;

impl<R: sqlx::Row> FromRow<'_, R> for Nothing {
    fn from_row(_: &R) -> Result<Self, sqlx::Error> {
        Ok(Self)
    }
}

/// Binds all values, each with the type that both engines have for it.
macro_rules! bound {
    ($statement:expr, $values:expr) => {{
        let mut statement = $statement;
        for value in $values {
            statement = match value {
                SqlValue::Whole(value) => statement.bind(value),
                SqlValue::Real(value) => statement.bind(value),
                SqlValue::Flag(value) => statement.bind(value),
                SqlValue::Text(value) => statement.bind(value.map(Cow::into_owned)),
                SqlValue::Bytes(value) => statement.bind(value.map(Cow::into_owned)),
            };
        }
        statement
    }};
}

impl<'q, T> Statement<'q, T> {
    /// Gives the next value.
    pub(super) fn bind(mut self, value: impl Into<SqlValue<'q>>) -> Self {
        self.values.push(value.into());
        self
    }

    /// A text that comes once.
    pub(super) fn once(self) -> Self {
        Self { lasts: false, ..self }
    }

    /// Runs it, and counts the rows that it has changed.
    pub(super) async fn execute(self, via: impl Into<Via<'_>>) -> Result<u64, sqlx::Error> {
        execute(self.sql, self.values, self.lasts, via.into()).await
    }
}

impl<T: FromEither> Statement<'_, T> {
    /// All its rows.
    pub(super) async fn fetch_all(self, via: impl Into<Via<'_>>) -> Result<Vec<T>, sqlx::Error> {
        match fetch_all(self.sql, self.values, self.lasts, via.into()).await? {
            Rows::Sqlite(rows) => rows.iter().map(T::from_row).collect(),
            Rows::Postgres(rows) => rows.iter().map(T::from_row).collect(),
        }
    }

    /// Its first row, if it has one.
    pub(super) async fn fetch_optional(self, via: impl Into<Via<'_>>) -> Result<Option<T>, sqlx::Error> {
        Ok(self.fetch_all(via).await?.into_iter().next())
    }

    /// Its first row.
    pub(super) async fn fetch_one(self, via: impl Into<Via<'_>>) -> Result<T, sqlx::Error> {
        self.fetch_optional(via).await?.ok_or(sqlx::Error::RowNotFound)
    }
}

/// Rows as the engines give them. What does the asking knows nothing of types, so that it is built once.
enum Rows {
    Sqlite(Vec<SqliteRow>),
    Postgres(Vec<PgRow>),
}

fn execute<'a>(sql: SqlStr, values: Vec<SqlValue<'a>>, lasts: bool, via: Via<'a>) -> EngineFuture<'a, u64> {
    Box::pin(async move {
        Ok(match via {
            Via::SqlitePool(pool) => {
                bound!(sqlx::query(sql).persistent(lasts), values).execute(pool).await?.rows_affected()
            }
            Via::Sqlite(one) => {
                bound!(sqlx::query(sql).persistent(lasts), values).execute(one).await?.rows_affected()
            }
            Via::PostgresPool(pool) => {
                let statement = bound!(sqlx::query(sql).persistent(lasts), values);
                within(statement.execute(pool)).await?.rows_affected()
            }
            Via::Postgres(one) => {
                let statement = bound!(sqlx::query(sql).persistent(lasts), values);
                within(statement.execute(one)).await?.rows_affected()
            }
        })
    })
}

fn fetch_all<'a>(
    sql: SqlStr,
    values: Vec<SqlValue<'a>>,
    lasts: bool,
    via: Via<'a>,
) -> EngineFuture<'a, Rows> {
    Box::pin(async move {
        Ok(match via {
            Via::SqlitePool(pool) => {
                Rows::Sqlite(bound!(sqlx::query(sql).persistent(lasts), values).fetch_all(pool).await?)
            }
            Via::Sqlite(one) => {
                Rows::Sqlite(bound!(sqlx::query(sql).persistent(lasts), values).fetch_all(one).await?)
            }
            Via::PostgresPool(pool) => {
                let statement = bound!(sqlx::query(sql).persistent(lasts), values);
                Rows::Postgres(within(statement.fetch_all(pool)).await?)
            }
            Via::Postgres(one) => {
                let statement = bound!(sqlx::query(sql).persistent(lasts), values);
                Rows::Postgres(within(statement.fetch_all(one)).await?)
            }
        })
    })
}

impl<'q, T> Scalars<'q, T>
where
    (T,): FromEither,
{
    /// Gives the next value.
    pub(super) fn bind(self, value: impl Into<SqlValue<'q>>) -> Self {
        Self(self.0.bind(value))
    }

    /// The column of all its rows.
    pub(super) async fn fetch_all(self, via: impl Into<Via<'_>>) -> Result<Vec<T>, sqlx::Error> {
        Ok(self.0.fetch_all(via).await?.into_iter().map(|(value,)| value).collect())
    }

    /// The column of its first row, if it has one.
    pub(super) async fn fetch_optional(self, via: impl Into<Via<'_>>) -> Result<Option<T>, sqlx::Error> {
        Ok(self.0.fetch_optional(via).await?.map(|(value,)| value))
    }

    /// The column of its first row.
    pub(super) async fn fetch_one(self, via: impl Into<Via<'_>>) -> Result<T, sqlx::Error> {
        Ok(self.0.fetch_one(via).await?.0)
    }
}

/// Which types are which values.
macro_rules! values {
    ($($type:ty => |$from:ident| $value:expr;)*) => {
        $(impl<'q> From<$type> for SqlValue<'q> {
            fn from($from: $type) -> Self {
                $value
            }
        })*
    };
}

values! {
    i64 => |whole| SqlValue::Whole(Some(whole));
    &'q i64 => |whole| SqlValue::Whole(Some(*whole));
    Option<i64> => |whole| SqlValue::Whole(whole);
    f64 => |real| SqlValue::Real(Some(real));
    Option<f64> => |real| SqlValue::Real(real);
    bool => |flag| SqlValue::Flag(flag);
    &'q str => |text| SqlValue::Text(Some(Cow::Borrowed(text)));
    &'q &'q str => |text| SqlValue::Text(Some(Cow::Borrowed(text)));
    &'q String => |text| SqlValue::Text(Some(Cow::Borrowed(text)));
    String => |text| SqlValue::Text(Some(Cow::Owned(text)));
    Option<&'q str> => |text| SqlValue::Text(text.map(Cow::Borrowed));
    Option<&'q String> => |text| SqlValue::Text(text.map(|text| Cow::Borrowed(text.as_str())));
    &'q Option<String> => |text| SqlValue::Text(text.as_deref().map(Cow::Borrowed));
    Option<String> => |text| SqlValue::Text(text.map(Cow::Owned));
    &'q [u8] => |bytes| SqlValue::Bytes(Some(Cow::Borrowed(bytes)));
    &'q Vec<u8> => |bytes| SqlValue::Bytes(Some(Cow::Borrowed(bytes)));
    Vec<u8> => |bytes| SqlValue::Bytes(Some(Cow::Owned(bytes)));
    Option<&'q [u8]> => |bytes| SqlValue::Bytes(bytes.map(Cow::Borrowed));
}
