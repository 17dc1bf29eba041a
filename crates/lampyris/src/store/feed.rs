//! What has changed in a database that several services share, in an order in which nothing is missed.
//!
//! A transaction notes what it changes, and commits overtake one another: a number that is given inside of a
//! transaction may show after a larger one. So whoever looks gives the committed notes their places first,
//! one after another under a lock: whoever has seen a place has seen all smaller ones.

use super::database::Store;
use super::error::StoreError;
use super::statement::{query, query_as, query_scalar};
use super::value::parse;
use super::words::words;
use lampyris_core::data::SystemId;
use std::collections::BTreeSet;

/// Notes that are given places, or read, at once.
const AT_ONCE: i64 = 2000;
/// Places that are kept for a service that was cut off; one that comes later reads everything anew.
const KEPT: i64 = 200_000;

words! {
    /// What a note is about.
    Topic {
        /// What is served of a system, or said of it.
        System = "system",
        /// What was measured of a system.
        Measured = "measured",
        /// Models and effects of users.
        Catalogue = "catalogue",
        /// Schedules.
        Schedule = "schedule",
        /// Jobs that came back to the queue.
        Queue = "queue",
    }
}

/// What has changed.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct News {
    /// The place of the last note.
    pub position: i64,
    /// Systems of which something else is served or said.
    pub systems: BTreeSet<SystemId>,
    /// Systems that were measured.
    pub measured: BTreeSet<SystemId>,
    /// Whether there are other documents of models or effects.
    pub catalogue: bool,
    /// Whether there are other schedules.
    pub schedules: bool,
    /// Whether jobs came back to the queue.
    pub queue: bool,
    /// Whether notes before these are gone: everything has to be read anew.
    pub missed: bool,
}

/// The newest place.
///
/// # Errors
/// Where the database fails.
pub async fn newest(store: &Store) -> Result<i64, StoreError> {
    Ok(query_scalar("SELECT value FROM counters WHERE name = 'change'").fetch_one(&store.reader).await?)
}

/// Gives committed notes their places, unless somebody else does it now.
async fn give_places(store: &Store) -> Result<(), StoreError> {
    let sql = "SELECT EXISTS (SELECT 1 FROM changes WHERE position IS NULL)";
    if !query_scalar::<bool>(sql).fetch_one(&store.reader).await? {
        return Ok(());
    }
    let mut tx = store.write_beside().await?;
    let sql = "SELECT value FROM counters WHERE name = 'change' FOR UPDATE SKIP LOCKED";
    let Some(last) = query_scalar::<i64>(sql).fetch_optional(&mut *tx).await? else {
        return tx.take_back().await;
    };
    let sql = "SELECT MIN(id), MAX(id) FROM (SELECT id FROM changes WHERE position IS NULL ORDER BY id \
        LIMIT $1) notes";
    let (first, end): (Option<i64>, Option<i64>) = query_as(sql).bind(AT_ONCE).fetch_one(&mut *tx).await?;
    let Some((first, end)) = first.zip(end) else { return tx.take_back().await };
    // What is committed meanwhile with a smaller id comes next time, and so behind these.
    let sql = "UPDATE changes SET position = $1 + id - $2 WHERE position IS NULL AND id BETWEEN $2 AND $3";
    query(sql).bind(last + 1).bind(first).bind(end).execute(&mut *tx).await?;
    let newest = last + 1 + end - first;
    query("UPDATE counters SET value = $1 WHERE name = 'change'").bind(newest).execute(&mut *tx).await?;
    if newest / AT_ONCE > last / AT_ONCE {
        query("DELETE FROM changes WHERE position <= $1").bind(newest - KEPT).execute(&mut *tx).await?;
    }
    tx.commit().await
}

/// What has changed after a place.
///
/// # Errors
/// Where the database fails.
pub async fn after(store: &Store, position: i64) -> Result<News, StoreError> {
    give_places(store).await?;
    let newest = newest(store).await?;
    let mut news = News { position, missed: position < newest - KEPT, ..News::default() };
    if newest == position {
        return Ok(news);
    }
    let sql = "SELECT position, topic, name FROM changes WHERE position > $1 ORDER BY position LIMIT $2";
    let rows: Vec<(i64, String, String)> =
        query_as(sql).bind(position).bind(AT_ONCE).fetch_all(&store.reader).await?;
    for (position, topic, name) in rows {
        news.position = position;
        match parse("a topic", &topic)? {
            Topic::System => drop(news.systems.insert(parse("a system", &name)?)),
            Topic::Measured => drop(news.measured.insert(parse("a system", &name)?)),
            Topic::Catalogue => news.catalogue = true,
            Topic::Schedule => news.schedules = true,
            Topic::Queue => news.queue = true,
        }
    }
    Ok(news)
}
