//! Who has a database: one service at a time.
//!
//! There are two locks of flock(2), which the system frees when the process ends, however it ends. The lock
//! file beside the database keeps the name, also before there is a database and while a backup takes its
//! place. The lock on the database itself is one of the inode, so neither a link of either kind nor the
//! removal of the lock file lets a second service in.
//!
//! SQLite locks the same inode by fcntl(2). On a local file system, and shared memory needs one, the two
//! know nothing of each other. But locks of fcntl(2) belong to the process, and closing any descriptor of the
//! file frees all of them: the descriptor of this lock is opened before SQLite opens the database and closed
//! after SQLite has closed it. That is also why the lock file comes first: who is refused by it has not
//! touched the database.

use super::error::{StoreError, is_unwritable};
use super::file::beside;
use std::fs::{self, File, Metadata, TryLockError};
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// The right to a database, for as long as this lives.
#[derive(Debug)]
pub(super) struct Lock {
    /// The lock file; none on a disk that takes no new file, where the other lock has to do.
    _name: Option<File>,
    /// The database itself; none where there is none yet.
    pub(super) database: Option<File>,
}

/// Which file of the system this is, whatever its name.
pub(super) fn identity(file: &Metadata) -> (u64, u64) {
    (file.dev(), file.ino())
}

/// Takes both locks of the database at a real path.
pub(super) fn lock(path: &Path) -> Result<Lock, StoreError> {
    let beside = beside(path, ".lock");
    let name = match File::options().create(true).truncate(false).write(true).open(&beside) {
        Err(error) if is_unwritable(&error) => File::open(&beside).ok(),
        opened => Some(opened.map_err(|error| StoreError::Open(beside.clone(), error))?),
    };
    if let Some(file) = &name
        && !take(file, &beside)?
    {
        return Err(StoreError::InUse(path.to_owned()));
    }
    let failed = |error: io::Error| StoreError::Open(path.to_owned(), error);
    let database = match File::open(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Lock { _name: name, database: None }),
        opened => opened.map_err(failed)?,
    };
    let found = database.metadata().map_err(failed)?;
    if !take(&database, path)? {
        // Under another name SQLite would look for another log.
        return Err(match found.nlink() {
            1 => StoreError::InUse(path.to_owned()),
            _ => StoreError::OtherName(path.to_owned()),
        });
    }
    // Somebody may have put another file in its place between the two calls.
    match fs::metadata(path) {
        Ok(now) if identity(&now) == identity(&found) => Ok(Lock { _name: name, database: Some(database) }),
        Ok(_) => Err(StoreError::InUse(path.to_owned())),
        Err(error) => Err(failed(error)),
    }
}

/// Whether a service has the database at a real path open, which others may then visit. This is asked
/// before SQLite opens it.
pub(super) fn in_use(path: &Path) -> Result<bool, StoreError> {
    match lock(path) {
        Ok(_) => Ok(false),
        Err(StoreError::InUse(_)) => Ok(true),
        Err(error) => Err(error),
    }
}

/// Takes a lock, if nobody has it.
fn take(file: &File, path: &Path) -> Result<bool, StoreError> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(StoreError::Open(path.to_owned(), error)),
    }
}
