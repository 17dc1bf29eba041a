//! Live samples: kept as they come, each post as one row, until they are laid into the days of their system.
//!
//! A post costs what it brings. It belongs to a window that takes all posts of its system and day, so that
//! fits cite days. Readers (`days`) lay what is open over what is laid in.

use super::database::Store;
use super::days::{self, Days, NewDay};
use super::engine::Session;
use super::error::StoreError;
use super::open_rows;
use super::packed::compress;
use super::row::row;
use super::sequence::{derive_id, next};
use super::shares::{self, PackedShares};
use super::statement::{query, query_as, query_scalar};
use super::value::{millis, parse};
use super::windows::{WindowRecord, WindowRow, unit_in};
use jiff::Timestamp;
use lampyris_core::data::{ChannelKind, DAY, Series, SystemId, Window, WindowReport};

/// A post of one system.
#[derive(Debug)]
pub struct Post {
    /// The system.
    pub system: SystemId,
    /// What it brings.
    pub window: Window,
    /// What was said about it.
    pub report: WindowReport,
}

/// What became of a post.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Appended {
    /// It is kept, in the window of this id.
    Kept(String),
    /// There is no such system.
    NoSystem,
    /// These channels are in another unit in earlier measurements: name, unit here, unit there.
    Conflicts(Vec<(String, String, String)>),
}

/// Posts of one window that are not laid in yet.
#[derive(Debug)]
pub struct Open {
    /// The window, with the number under which it gives samples.
    pub window: WindowRecord,
    /// What it has given so far.
    pub shares: Option<PackedShares>,
    /// The rows of the posts, in their order.
    pub rows: Vec<Series>,
    /// What counts on their days, without the rows themselves.
    pub days: Days,
    /// The number of the newest of them.
    last: i64,
    /// The newest window of the system.
    newest: i64,
}

/// A window whose open posts are laid in.
#[derive(Debug)]
pub struct LaidIn {
    /// What it has given by now.
    pub shares: PackedShares,
    /// What is said about it by now.
    pub report: WindowReport,
    /// The days in which it has given something.
    pub days: Vec<NewDay>,
}

row! {
    /// The posts of one window.
    struct PostRow {
        sequence: i64,
        from_ms: i64,
        to_ms: i64,
        rows: String,
    }
}

/// Keeps posts, in one transaction; says of each what became of it, in their order. `converts` says whether
/// one unit converts to another.
///
/// # Errors
/// Where the database fails; then none of them is kept.
pub(crate) async fn append(
    store: &Store,
    posts: &[Post],
    converts: impl Fn(&str, &str) -> bool,
    now: Timestamp,
) -> Result<Vec<Appended>, StoreError> {
    let written = posts.iter().map(|post| open_rows::written(&post.window)).collect::<Result<Vec<_>, _>>()?;
    let mut tx = store.write().await?;
    store.require_room(&mut tx, written.iter().map(String::len).sum()).await?;
    let mut appended = Vec::with_capacity(posts.len());
    for (post, rows) in posts.iter().zip(&written) {
        appended.push(append_one(&mut tx, post, rows, &converts, now).await?);
    }
    tx.commit().await?;
    Ok(appended)
}

async fn append_one(
    tx: &mut Session,
    post: &Post,
    rows: &str,
    converts: impl Fn(&str, &str) -> bool,
    now: Timestamp,
) -> Result<Appended, StoreError> {
    let system = post.system.to_string();
    let there = query("SELECT 1 FROM systems WHERE system = $1").bind(&system);
    if there.fetch_optional(&mut *tx).await?.is_none() {
        return Ok(Appended::NoSystem);
    }
    let mut conflicts = Vec::new();
    // The others have the unit of their name, whoever measures them.
    for series in post.window.iter().filter(|series| ChannelKind::of_name(series.channel()).is_none()) {
        if let Some(earlier) = unit_in(tx, &system, series.channel()).await?
            && !converts(series.unit(), &earlier)
        {
            conflicts.push((series.channel().to_owned(), series.unit().to_owned(), earlier));
        }
    }
    if !conflicts.is_empty() {
        return Ok(Appended::Conflicts(conflicts));
    }
    let window = window_of_today(tx, &system, post, now).await?;
    let sequence = days::change_version(tx, &system).await?;
    let sql = "INSERT INTO samples (sequence, system, window_id, from_ms, to_ms, rows, came_at) VALUES ($1, $2, $3, \
        $4, $5, $6, $7)";
    query(sql)
        .bind(sequence)
        .bind(&system)
        .bind(&window)
        .bind(post.window.from())
        .bind(post.window.to())
        .bind(rows)
        .bind(millis(now))
        .execute(tx)
        .await?;
    Ok(Appended::Kept(window))
}

/// The window that takes the posts of a system today: its newest one, or else a new one, so that a post is
/// newer than all that came before it.
async fn window_of_today(
    tx: &mut Session,
    system: &str,
    post: &Post,
    now: Timestamp,
) -> Result<String, StoreError> {
    let today = now.as_millisecond().div_euclid(DAY);
    let (from, to) = (post.window.from(), post.window.to());
    let sql = "UPDATE windows SET from_ms = MIN(from_ms, $3), to_ms = MAX(to_ms, $4), uploaded_at = $5, uploads = \
        uploads + 1 WHERE sequence = (SELECT MAX(sequence) FROM windows WHERE system = $1) AND day = $2 \
        RETURNING id";
    let goes_on: Option<String> = query_scalar(sql)
        .bind(system)
        .bind(today)
        .bind(from)
        .bind(to)
        .bind(millis(now))
        .fetch_optional(&mut *tx)
        .await?;
    if let Some(id) = goes_on {
        return Ok(id);
    }
    let sequence = next(tx, "sequence").await?;
    let id = derive_id("win", sequence, now);
    let sql = "INSERT INTO windows (id, system, sequence, from_ms, to_ms, report, uploaded_at, day) VALUES ($1, \
        $2, $3, $4, $5, $6, $7, $8)";
    query(sql)
        .bind(&id)
        .bind(system)
        .bind(sequence)
        .bind(from)
        .bind(to)
        .bind(compress("a report", &post.report)?)
        .bind(millis(now))
        .bind(today)
        .execute(tx)
        .await?;
    Ok(id)
}

/// The posts of a system that are not laid in yet, of the oldest window that has any; `None` without any.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn open(store: &Store, system: &SystemId) -> Result<Option<Open>, StoreError> {
    let mut tx = store.reader.begin().await?;
    let name = system.to_string();
    let sql = "SELECT w.* FROM windows w WHERE w.system = $1 AND EXISTS (SELECT 1 FROM samples s WHERE s.window_id \
        = w.id) ORDER BY w.sequence LIMIT 1";
    let window: Option<WindowRow> = query_as(sql).bind(&name).fetch_optional(&mut tx).await?;
    let Some(window) = window.map(WindowRow::record).transpose()? else { return Ok(None) };
    let sql = "SELECT sequence, from_ms, to_ms, rows FROM samples WHERE window_id = $1 ORDER BY sequence";
    let posts: Vec<PostRow> = query_as(sql).bind(&window.id).fetch_all(&mut tx).await?;
    let span = posts
        .iter()
        .fold((i64::MAX, i64::MIN), |(from, to), post| (from.min(post.from_ms), to.max(post.to_ms)));
    let mut rows = Vec::new();
    for post in &posts {
        rows.extend(open_rows::read(&post.rows)?);
    }
    let sql = "SELECT MAX(sequence) FROM windows WHERE system = $1";
    Ok(Some(Open {
        shares: shares::of(&mut tx, &window.id).await?,
        days: days::laid_in(&mut tx, &name, span).await?,
        last: posts.last().map_or(0, |post| post.sequence),
        newest: query_scalar(sql).bind(&name).fetch_one(&mut tx).await?,
        window,
        rows,
    }))
}

/// Writes what open posts have become; `false` where a window has come or gone meanwhile.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn lay_in(
    store: &Store,
    open: &Open,
    laid: &LaidIn,
    now: Timestamp,
) -> Result<bool, StoreError> {
    let report = compress("a report", &laid.report)?;
    let mut tx = store.write().await?;
    let system = open.window.system.to_string();
    let sql = "SELECT MAX(sequence) FROM windows WHERE system = $1";
    let newest: Option<i64> = query_scalar(sql).bind(&system).fetch_one(&mut *tx).await?;
    if newest != Some(open.newest) {
        tx.take_back().await?;
        return Ok(false);
    }
    shares::write(&mut tx, &open.window.id, &laid.shares, now).await?;
    days::write(&mut tx, &system, &laid.days, open.window.sequence).await?;
    query("UPDATE windows SET report = $2 WHERE id = $1")
        .bind(&open.window.id)
        .bind(&report)
        .execute(&mut *tx)
        .await?;
    query("DELETE FROM samples WHERE window_id = $1 AND sequence <= $2")
        .bind(&open.window.id)
        .bind(open.last)
        .execute(&mut *tx)
        .await?;
    tx.commit().await?;
    Ok(true)
}

/// Systems of which so many posts are open, or one that came before an instant.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn due(store: &Store, posts: i64, before: Timestamp) -> Result<Vec<SystemId>, StoreError> {
    let sql = "SELECT system FROM samples GROUP BY system HAVING COUNT(*) >= $1 OR MIN(came_at) < $2";
    let names: Vec<String> =
        query_scalar(sql).bind(posts).bind(millis(before)).fetch_all(&store.reader).await?;
    names.iter().map(|name| parse("a system", name)).collect()
}
