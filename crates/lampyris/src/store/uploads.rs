//! How an upload is taken: looked at beside what counts, then written if nothing has changed meanwhile.

use super::database::Store;
use super::days::{self, Days};
use super::engine::Session;
use super::error::StoreError;
use super::idempotency::{KeyState, RequestKey, look_up, remember};
use super::packed::compress;
use super::sequence::next;
use super::shares::{self, PackedShares};
use super::statement::{query, query_as, query_scalar};
use super::value::millis;
use super::windows::{self, Rebuilt, WindowRecord, WindowRow};
use jiff::Timestamp;
use lampyris_core::data::{SystemId, WindowReport};

/// What an upload finds.
#[derive(Debug)]
pub struct Found {
    /// The version of the measurements.
    pub version: i64,
    /// What the key of the request says.
    pub key: KeyState,
    /// The window that has its id, or that it went on with.
    pub known: Option<WindowRecord>,
    /// The newest window of the system, if the upload may go on with it, with what it gave.
    pub newest: Option<(WindowRecord, PackedShares)>,
    /// What counts since its first sample or that of the newest window.
    pub days: Days,
}

/// An upload to be written.
#[derive(Debug)]
pub struct Upload {
    /// Its id.
    pub id: String,
    /// The version of the measurements beside which it was looked at.
    pub version: i64,
    /// Where it belongs.
    pub place: UploadPlace,
    /// What its window gives.
    pub shares: PackedShares,
    /// What follows for others.
    pub rebuilt: Rebuilt,
}

/// Where an upload belongs.
#[derive(Debug)]
pub enum UploadPlace {
    /// It is a window.
    New {
        /// The first sample, in milliseconds.
        from_ms: i64,
        /// The last sample.
        to_ms: i64,
        /// The report.
        report: WindowReport,
    },
    /// It goes on with a window, and is one with it from now on.
    GoesOn {
        /// The window.
        window: WindowRecord,
        /// The last sample of both.
        to_ms: i64,
        /// The report on both.
        report: WindowReport,
    },
    /// It is a window that something newer covers: this one becomes the newest again.
    Raised(WindowRecord),
}

/// What became of an upload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Written {
    /// It is kept, as the window of this id.
    Kept(String),
    /// The measurements or the key have changed since it was looked at.
    Stale,
    /// The system was deleted meanwhile.
    NoSystem,
}

/// Looks at what an upload over a stretch of time finds. `may_go_on` says whether it may belong to a window
/// that is the newest.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn find(
    store: &Store,
    system: &SystemId,
    (id, span): (&str, (i64, i64)),
    key: Option<&RequestKey>,
    may_go_on: impl Fn(&WindowRecord) -> bool,
) -> Result<Found, StoreError> {
    let mut tx = store.reader.begin().await?;
    let name = system.to_string();
    let sql = "SELECT * FROM windows WHERE system = $1 ORDER BY sequence DESC LIMIT 1";
    let newest: Option<WindowRow> = query_as(sql).bind(&name).fetch_optional(&mut tx).await?;
    let newest = match newest.map(WindowRow::record).transpose()? {
        // Where its samples are not laid in, somebody else has posted some this moment.
        Some(newest) if may_go_on(&newest) => {
            shares::of(&mut tx, &newest.id).await?.map(|shares| (newest, shares))
        }
        _ => None,
    };
    let from = newest.as_ref().map_or(span.0, |(newest, _)| newest.from_ms.min(span.0));
    Ok(Found {
        version: days::version_in(&mut tx, &name).await?,
        key: look_up(&mut tx, key).await?,
        known: windows::get_in(&mut tx, id).await?,
        newest,
        days: days::read_in(&mut tx, &name, (from, span.1), None).await?,
    })
}

/// Remembers the key of an upload that changed nothing.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn acknowledge(
    store: &Store,
    key: Option<&RequestKey>,
    window: &str,
    now: Timestamp,
) -> Result<(), StoreError> {
    let Some(key) = key else { return Ok(()) };
    let mut tx = store.write().await?;
    if look_up(&mut tx, Some(key)).await? == KeyState::Fresh {
        remember(&mut tx, Some(key), window, 200, now).await?;
        tx.commit().await?;
    }
    Ok(())
}

/// Whether a newer window of its system overlaps a window.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn is_below(store: &Store, window: &WindowRecord) -> Result<bool, StoreError> {
    let sql = "SELECT EXISTS (SELECT 1 FROM windows WHERE system = $1 AND sequence > $2 AND from_ms <= $4 AND \
        to_ms >= $3)";
    let query = query_scalar(sql).bind(window.system.to_string()).bind(window.sequence);
    Ok(query.bind(window.from_ms).bind(window.to_ms).fetch_one(&store.reader).await?)
}

/// Writes an upload, unless the measurements have another version than the one that it was looked at beside.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn write(
    store: &Store,
    system: &SystemId,
    upload: &Upload,
    (key, seen): (Option<&RequestKey>, &KeyState),
    now: Timestamp,
) -> Result<Written, StoreError> {
    let report = upload.place.report().map(|report| compress("a report", report)).transpose()?;
    let mut tx = store.write().await?;
    let name = system.to_string();
    // Between the first look at the system and this moment a large body was parsed.
    let there = query("SELECT 1 FROM systems WHERE system = $1").bind(&name);
    if there.fetch_optional(&mut *tx).await?.is_none() {
        return Ok(Written::NoSystem);
    }
    let is_stale = days::version_in(&mut tx, &name).await? != upload.version;
    if is_stale || look_up(&mut tx, key).await? != *seen {
        tx.take_back().await?;
        return Ok(Written::Stale);
    }
    let bytes = upload.shares.bytes() + upload.rebuilt.bytes() + report.as_ref().map_or(0, Vec::len);
    store.require_room(&mut tx, bytes).await?;
    let (window, sequence) = place(&mut tx, &name, upload, report.as_deref(), now).await?;
    shares::write(&mut tx, &window, &upload.shares, now).await?;
    upload.rebuilt.write(&mut tx, &name, sequence, now).await?;
    if *seen == KeyState::Fresh {
        remember(&mut tx, key, &window, upload.place.status(), now).await?;
    }
    tx.commit().await?;
    Ok(Written::Kept(window))
}

/// Writes the row of an upload's window; gives its id and its number.
async fn place(
    tx: &mut Session,
    system: &str,
    upload: &Upload,
    report: Option<&[u8]>,
    now: Timestamp,
) -> Result<(String, i64), StoreError> {
    match &upload.place {
        UploadPlace::New { from_ms, to_ms, .. } => {
            let sequence = next(tx, "sequence").await?;
            // What went on with another window, and is a window of its own now.
            query("DELETE FROM window_aliases WHERE id = $1").bind(&upload.id).execute(&mut *tx).await?;
            let sql = "INSERT INTO windows (id, system, sequence, from_ms, to_ms, report, uploaded_at) VALUES \
                ($1, $2, $3, $4, $5, $6, $7)";
            query(sql)
                .bind(&upload.id)
                .bind(system)
                .bind(sequence)
                .bind(from_ms)
                .bind(to_ms)
                .bind(report)
                .bind(millis(now))
                .execute(tx)
                .await?;
            Ok((upload.id.clone(), sequence))
        }
        UploadPlace::GoesOn { window, to_ms, .. } => {
            let sql = "UPDATE windows SET to_ms = $2, report = $3, uploaded_at = $4, uploads = uploads + 1 \
                WHERE id = $1";
            query(sql).bind(&window.id).bind(to_ms).bind(report).bind(millis(now)).execute(&mut *tx).await?;
            let sql = "INSERT INTO window_aliases (id, sequence) VALUES ($1, $2) ON CONFLICT (id) DO UPDATE \
                SET sequence = excluded.sequence";
            query(sql).bind(&upload.id).bind(window.sequence).execute(tx).await?;
            Ok((window.id.clone(), window.sequence))
        }
        UploadPlace::Raised(window) => {
            let sequence = next(tx, "sequence").await?;
            query("UPDATE windows SET sequence = $2, uploaded_at = $3 WHERE id = $1")
                .bind(&window.id)
                .bind(sequence)
                .bind(millis(now))
                .execute(tx)
                .await?;
            Ok((window.id.clone(), sequence))
        }
    }
}

impl UploadPlace {
    /// The status that a request with a key gets again.
    fn status(&self) -> u16 {
        if matches!(self, UploadPlace::Raised(_)) { 200 } else { 201 }
    }

    /// What is said about it, where that is new.
    fn report(&self) -> Option<&WindowReport> {
        match self {
            UploadPlace::New { report, .. } | UploadPlace::GoesOn { report, .. } => Some(report),
            UploadPlace::Raised(_) => None,
        }
    }
}

/// Forgets ids of uploads that went on with windows of before an instant: they are too old to come again.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn forget_aliases(store: &Store, before: Timestamp) -> Result<(), StoreError> {
    let sql = "DELETE FROM window_aliases WHERE sequence IN (SELECT sequence FROM windows WHERE uploaded_at < \
        $1 AND uploads > 1)";
    let mut tx = store.write().await?;
    query(sql).bind(millis(before)).execute(&mut *tx).await?;
    tx.commit().await
}
