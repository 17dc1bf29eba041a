//! Where measurements of other programs belong, as operators say it: one document per source.

use super::database::Store;
use super::error::StoreError;
use super::row::row;
use super::statement::{query, query_as};
use super::value::{from_json, instant, millis};
use jiff::Timestamp;
use serde_json::Value;

/// The document of a source as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceRecord {
    /// The document.
    pub document: Value,
    /// Under which name it was changed last.
    pub changed_by: String,
    /// When.
    pub changed_at: Timestamp,
}

row! {
    struct Row {
        document: String,
        changed_by: String,
        changed_at: i64,
    }
}

/// The document of a source; nothing where nobody has written one.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn get(store: &Store, name: &str) -> Result<Option<SourceRecord>, StoreError> {
    let sql = "SELECT document, changed_by, changed_at FROM sources WHERE name = $1";
    let row: Option<Row> = query_as(sql).bind(name).fetch_optional(&store.reader).await?;
    let record = |row: Row| {
        Ok(SourceRecord {
            document: from_json("a source", &row.document)?,
            changed_by: row.changed_by,
            changed_at: instant(row.changed_at)?,
        })
    };
    row.map(record).transpose()
}

/// Writes the document of a source, JSON.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn put(
    store: &Store,
    name: &str,
    document: &str,
    who: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    let mut tx = store.write().await?;
    let sql = "INSERT INTO sources (name, document, changed_by, changed_at) VALUES ($1, $2, $3, $4) \
        ON CONFLICT (name) DO UPDATE SET document = excluded.document, changed_by = excluded.changed_by, \
        changed_at = excluded.changed_at";
    query(sql).bind(name).bind(document).bind(who).bind(millis(now)).execute(&mut *tx).await?;
    tx.commit().await?;
    Ok(())
}
