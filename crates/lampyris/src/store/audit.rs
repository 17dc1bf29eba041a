//! What operators did, when, and under which name. A row is written in the transaction that does it.

use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::page;
use super::reach::SystemScope;
use super::row::row;
use super::statement::query;
use super::value::{instant, millis, parse};
use super::words::words;
use jiff::Timestamp;
use lampyris_core::data::SystemId;

words! {
    /// What was done.
    Action {
        /// A fit that waited was let out.
        PromoteFit = "promote_fit",
        /// A fit that waited was put aside.
        RejectFit = "reject_fit",
        /// What a system serves was held, or rolled back.
        Pin = "pin",
        /// A pin was taken away.
        Unpin = "unpin",
        /// A system was made, or its document replaced, with the training exclusions in it.
        PutSystem = "put_system",
        /// A system was deleted.
        DeleteSystem = "delete_system",
        /// A window was deleted.
        DeleteWindow = "delete_window",
        /// A schedule was made or replaced.
        PutSchedule = "put_schedule",
        /// A schedule was removed.
        DeleteSchedule = "delete_schedule",
        /// A model was taken, or made by adding an effect.
        PostModel = "post_model",
        /// An effect was taken.
        PostEffect = "post_effect",
        /// A token was made.
        CreateToken = "create_token",
        /// A token was revoked.
        RevokeToken = "revoke_token",
    }
}

/// Something that was done.
#[derive(Debug)]
pub(super) struct AuditEntry<'a> {
    /// Under which name.
    pub who: &'a str,
    /// What.
    pub action: Action,
    /// The system, where it is about one.
    pub system: Option<&'a str>,
    /// To what.
    pub subject: &'a str,
    /// Why, where a reason was asked for.
    pub reason: Option<&'a str>,
}

/// Something that was done, as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct DeedRecord {
    /// Its place in the order.
    pub sequence: i64,
    /// When.
    pub at: Timestamp,
    /// Under which name.
    pub who: String,
    /// What.
    pub action: Action,
    /// The system, where it is about one.
    pub system: Option<SystemId>,
    /// To what.
    pub subject: String,
    /// Why, where a reason was asked for.
    pub reason: Option<String>,
}

row! {
    struct Row {
        sequence: i64,
        at: i64,
        who: String,
        action: String,
        system: Option<String>,
        subject: String,
        reason: Option<String>,
    }
}

impl Row {
    fn record(self) -> Result<DeedRecord, StoreError> {
        Ok(DeedRecord {
            sequence: self.sequence,
            at: instant(self.at)?,
            action: parse("an action", &self.action)?,
            system: self.system.as_deref().map(|system| parse("a system", system)).transpose()?,
            who: self.who,
            subject: self.subject,
            reason: self.reason,
        })
    }
}

/// Notes a deed inside the transaction that does it.
pub(super) async fn note(tx: &mut Session, deed: &AuditEntry<'_>, now: Timestamp) -> Result<(), StoreError> {
    query("INSERT INTO audit (at, who, action, system, subject, reason) VALUES ($1, $2, $3, $4, $5, $6)")
        .bind(millis(now))
        .bind(deed.who)
        .bind(deed.action.as_str())
        .bind(deed.system)
        .bind(deed.subject)
        .bind(deed.reason)
        .execute(tx)
        .await?;
    Ok(())
}

/// What was done before a place in the order, newest first, to one system or to all within a reach: one page
/// of a list. What is about no system is shown to those who may see all of them.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
    store: &Store,
    reach: &SystemScope,
    system: Option<&SystemId>,
    before: i64,
    limit: i64,
) -> Result<Vec<DeedRecord>, StoreError> {
    let sql = "SELECT * FROM audit WHERE ($1 IS NULL OR system = $1)
               AND ($4 IS NULL OR EXISTS (SELECT 1 FROM json_each($4) WHERE glob(value, system)))
               AND sequence < $2 ORDER BY sequence DESC LIMIT $3";
    let rows: Vec<Row> = page::rows(store, sql, reach, system, before, limit).await?;
    rows.into_iter().map(Row::record).collect()
}
