//! Documents of rooms and plants. What is in a document is for `jobs` to know; here it is a text.

use super::{Store, StoreError, instant, millis, parse};
use crate::data::SystemId;
use crate::model::ModelId;
use jiff::Timestamp;
use sqlx::FromRow;

/// A system as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct SystemRecord {
    /// Its name.
    pub system: SystemId,
    /// The model whose fits count.
    pub model: ModelId,
    /// The document, JSON.
    pub document: String,
    /// When it was made.
    pub created_at: Timestamp,
    /// When it was last changed.
    pub updated_at: Timestamp,
}

#[derive(FromRow)]
struct Row {
    system: String,
    model: String,
    document: String,
    created_at: i64,
    updated_at: i64,
}

impl Row {
    fn record(self) -> Result<SystemRecord, StoreError> {
        Ok(SystemRecord {
            system: parse("a system", &self.system)?,
            model: parse("a model", &self.model)?,
            document: self.document,
            created_at: instant(self.created_at)?,
            updated_at: instant(self.updated_at)?,
        })
    }
}

/// Makes a system or replaces its document; says whether it is new.
///
/// # Errors
/// Where the database fails.
pub async fn put(store: &Store, system: &SystemId, model: &ModelId, document: &str, now: Timestamp) -> Result<bool, StoreError> {
    let mut tx = store.write().await?;
    let known: Option<i64> =
        sqlx::query_scalar("SELECT 1 FROM systems WHERE system = $1").bind(system.to_string()).fetch_optional(&mut *tx).await?;
    let sql = "INSERT INTO systems (system, model, document, created_at, updated_at) VALUES ($1, $2, $3, $4, $4)
               ON CONFLICT (system) DO UPDATE SET model = excluded.model, document = excluded.document, updated_at = excluded.updated_at";
    sqlx::query(sql).bind(system.to_string()).bind(model.to_string()).bind(document).bind(millis(now)).execute(&mut *tx).await?;
    tx.commit().await?;
    Ok(known.is_none())
}

/// One system.
///
/// # Errors
/// Where the database fails.
pub async fn get(store: &Store, system: &SystemId) -> Result<Option<SystemRecord>, StoreError> {
    let sql = "SELECT system, model, document, created_at, updated_at FROM systems WHERE system = $1";
    let row: Option<Row> = sqlx::query_as(sql).bind(system.to_string()).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// All systems, by name.
///
/// # Errors
/// Where the database fails.
pub async fn all(store: &Store) -> Result<Vec<SystemRecord>, StoreError> {
    let sql = "SELECT system, model, document, created_at, updated_at FROM systems ORDER BY system";
    let rows: Vec<Row> = sqlx::query_as(sql).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// Systems that come after a name, in order: one page of a list.
///
/// # Errors
/// Where the database fails.
pub async fn page(store: &Store, after: &str, limit: i64) -> Result<Vec<SystemRecord>, StoreError> {
    let sql = "SELECT system, model, document, created_at, updated_at FROM systems WHERE system > $1 ORDER BY system LIMIT $2";
    let rows: Vec<Row> = sqlx::query_as(sql).bind(after).bind(limit).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}
