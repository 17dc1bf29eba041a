//! Copies of a database that can be relied on, and their way back.
//!
//! A database in use is three files: a raw copy of the first lacks what still waits in the write-ahead log,
//! and a copy of all three at different moments may be no database at all. `VACUUM INTO` copies one moment of
//! it as one file.

use super::error::StoreError;
use super::failpoint;
use super::file::{beside, options, options_to_read, real, require_no_log_alone};
use super::lock::{in_use, lock};
use super::schema::schema;
use jiff::Timestamp;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// A backup that was made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backup {
    /// The schema of the database.
    pub schema: i64,
    /// The size of the file in bytes.
    pub bytes: u64,
}

/// A backup that was brought back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Restored {
    /// The schema of the backup; the next start brings it up to date.
    pub schema: i64,
    /// The database that was there before, if there was one.
    pub replaced: Option<PathBuf>,
}

/// Copies one moment of a database, also beside a service that writes to it: everything that was acknowledged
/// before.
///
/// # Errors
/// Where there is no such database, it is damaged or not of this program, or the file is there already.
pub(crate) async fn backup(database: &Path, file: &Path) -> Result<Backup, StoreError> {
    if !database.exists() {
        return Err(StoreError::NoFile(database.to_owned()));
    }
    if file.exists() {
        return Err(StoreError::Taken(file.to_owned()));
    }
    let database = &real(database)?;
    // Under another name of the file the log of its service would be missed.
    in_use(database)?;
    require_own_log(database).await?;
    let mut connection = options(database).connect().await?;
    let schema = schema(&mut connection, database).await?;
    copy(&mut connection, database, file).await?;
    connection.close().await?;
    let bytes = fs::metadata(file).map_err(failed(file))?.len();
    Ok(Backup { schema, bytes })
}

/// Puts a backup in the place of a database that no service has open. The database that was there stays
/// beside it under a name with the time.
///
/// # Errors
/// Where a service has the database open, or the file is no sound backup of a schema that this program knows.
/// Then nothing has changed.
pub(crate) async fn restore(database: &Path, file: &Path, now: Timestamp) -> Result<Restored, StoreError> {
    let database = &real(database)?;
    let _lock = lock(database)?;
    if !file.exists() {
        return Err(StoreError::NoFile(file.to_owned()));
    }
    if fs::metadata(beside(file, "-wal")).is_ok_and(|log| log.len() > 0) {
        return Err(StoreError::RawCopy(file.to_owned()));
    }
    // What is checked is the copy, so that it is also what is served.
    let partial = beside(database, ".partial");
    fs::copy(file, &partial).map_err(failed(file))?;
    let schema = match examine(&partial).await {
        Ok(schema) => schema,
        Err(error) => {
            let _ = fs::remove_file(&partial);
            return Err(error);
        }
    };
    let replaced = if database.exists() { Some(set_aside(database, now).await?) } else { None };
    fs::rename(&partial, database).map_err(failed(database))?;
    sync_folder(database)?;
    Ok(Restored { schema, replaced })
}

/// Keeps a database under another name, and leaves it in its place without a write-ahead log, which would be
/// taken for that of the file that comes there next.
async fn set_aside(database: &Path, now: Timestamp) -> Result<PathBuf, StoreError> {
    let kept = beside(database, &format!(".replaced-{}", now.strftime("%Y%m%dT%H%M%SZ")));
    if kept.exists() {
        return Err(StoreError::Taken(kept));
    }
    let (log, index) = (beside(database, "-wal"), beside(database, "-shm"));
    // A database in order takes its log in. One that is damaged may not; its log then goes along with it.
    if require_no_log_alone(database).is_ok() {
        let _ = fold(database).await;
    }
    if log.exists() {
        fs::rename(&log, beside(&kept, "-wal")).map_err(failed(&log))?;
    }
    if index.exists() {
        fs::remove_file(&index).map_err(failed(&index))?;
    }
    // A second name and not a move: at no moment is there no database, for which a service would make an
    // empty one.
    fs::hard_link(database, &kept).or_else(|_| fs::copy(database, &kept).map(drop)).map_err(failed(&kept))?;
    Ok(kept)
}

/// Refuses a database that is damaged with the log beside it, which may be that of another one. The look
/// changes nothing: the last connection that can write would fold the log into the database, and remove it.
pub(super) async fn require_own_log(database: &Path) -> Result<(), StoreError> {
    require_no_log_alone(database)?;
    if !fs::metadata(database).is_ok_and(|file| file.len() > 0) {
        return Ok(());
    }
    let mut connection = options_to_read(database).await?.connect().await?;
    let sound = match schema(&mut connection, database).await {
        Ok(_) => require_sound(&mut connection, "PRAGMA quick_check(3)").await,
        Err(error) => Err(error),
    };
    connection.close().await?;
    sound
}

/// Folds the write-ahead log into its database; the last connection that closes removes it.
async fn fold(database: &Path) -> Result<(), StoreError> {
    let mut connection = options(database).connect().await?;
    sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut connection).await?;
    Ok(connection.close().await?)
}

/// Copies what a connection sees into a file, which appears under its name only when it is whole, sound and
/// on the disk.
pub(super) async fn copy(
    connection: &mut SqliteConnection,
    database: &Path,
    file: &Path,
) -> Result<(), StoreError> {
    let partial = beside(file, ".partial");
    // What is left of a copy that was killed.
    match fs::remove_file(&partial) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(StoreError::Open(partial, error));
        }
        _ => {}
    }
    let name = partial.to_str().ok_or_else(|| failed(file)(io::Error::other("the name is not UTF-8")))?;
    let copied = async {
        sqlx::query("VACUUM INTO $1").bind(name).execute(connection).await?;
        failpoint::reached("in_backup");
        // Whoever may not read the database may not read its backup.
        fs::metadata(database)
            .and_then(|source| fs::set_permissions(&partial, source.permissions()))
            .map_err(failed(&partial))?;
        examine(&partial).await
    };
    if let Err(error) = copied.await {
        let _ = fs::remove_file(&partial);
        return Err(error);
    }
    fs::rename(&partial, file).map_err(failed(file))?;
    sync_folder(file)
}

/// Puts a copy on the disk and gives its schema, if it is sound in every page, every index and every
/// reference.
async fn examine(file: &Path) -> Result<i64, StoreError> {
    File::open(file).and_then(|file| file.sync_all()).map_err(failed(file))?;
    // Immutable: no log and no index are made beside it.
    let mut connection = options(file).read_only(true).immutable(true).connect().await?;
    require_whole(&mut connection).await?;
    let schema = schema(&mut connection, file).await?;
    connection.close().await?;
    if schema == 0 { Err(StoreError::Foreign(file.to_owned())) } else { Ok(schema) }
}

/// Asks SQLite for every page, index and reference.
pub(super) async fn require_whole(connection: &mut SqliteConnection) -> Result<(), StoreError> {
    require_sound(connection, "PRAGMA integrity_check(3)").await?;
    let orphans: Vec<String> = sqlx::query_scalar(r#"SELECT DISTINCT "table" FROM pragma_foreign_key_check"#)
        .fetch_all(connection)
        .await?;
    if orphans.is_empty() {
        return Ok(());
    }
    Err(StoreError::Damaged(format!("rows of {} refer to rows that are not there", orphans.join(", "))))
}

/// Runs a check of SQLite, which answers `ok` or what it found.
pub(super) async fn require_sound(
    connection: &mut SqliteConnection,
    check: &'static str,
) -> Result<(), StoreError> {
    let found: Vec<String> = sqlx::query_scalar(check).fetch_all(connection).await?;
    if found == ["ok"] { Ok(()) } else { Err(StoreError::Damaged(found.join("; "))) }
}

/// A name is on the disk when its folder is.
fn sync_folder(file: &Path) -> Result<(), StoreError> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed(folder))
}

fn failed(path: &Path) -> impl Fn(io::Error) -> StoreError {
    let path = path.to_owned();
    move |error| StoreError::Open(path.clone(), error)
}
