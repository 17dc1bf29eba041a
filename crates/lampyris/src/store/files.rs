//! Whether the files of an open database are still those that were opened.
//!
//! Whoever has a file open writes to it also when its name is gone, so a write into a database that was
//! removed or replaced succeeds, and is lost. Names are therefore compared with what was opened, and what
//! the files hold with what they must hold at least.

use super::error::StoreError;
use super::file::beside;
use super::lock::{Lock, identity};
use rustix::fs::fstatvfs;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// What a database file begins with.
const MAGIC: &[u8] = b"SQLite format 3\0";
/// Bytes of the header of a write-ahead log, and of the header of each of its frames.
const LOG_HEADER: u64 = 32;
const FRAME_HEADER: u64 = 24;
/// What a log begins with; the last bit tells the order of the bytes in its sums.
const LOG_MAGIC: u32 = 0x377f_0682;
/// How often the log and its index are read until no write was between the readings.
const TRIES: u32 = 10;

/// The files of an open database.
#[derive(Debug)]
pub(super) struct Files {
    database: Opened,
    log: Opened,
    index: Opened,
    /// The newest counts of changes and of commits (`write`), and the largest size in bytes, that were seen
    /// of the database file.
    counter: u32,
    commits: u32,
    bytes: u64,
    /// What the index of the log said last.
    standing: Option<Standing>,
}

/// How far a log has come: its index counts every commit, also from one log to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Standing {
    commits: u32,
    frames: u32,
    salt: [u8; 8],
}

impl Standing {
    /// Whether this lies behind another. Where an index was lost with its process, SQLite counts anew over
    /// the same log, which then holds no less.
    fn is_behind(&self, other: &Standing) -> bool {
        let fewer = self.commits.wrapping_sub(other.commits).cast_signed() < 0;
        fewer && !(self.salt == other.salt && self.frames >= other.frames)
    }
}

/// What a database file says of itself: whether it is one, its counts of changes and of commits, how many
/// bytes its pages take, and how many there are.
struct Header {
    is_one: bool,
    counter: u32,
    commits: u32,
    needed: u64,
    bytes: u64,
}

/// A file that is open under a name.
#[derive(Debug)]
struct Opened {
    what: &'static str,
    path: PathBuf,
    file: File,
    identity: (u64, u64),
}

/// The 48 bytes that head the index of a log: <https://sqlite.org/walformat.html>.
#[derive(PartialEq, Eq)]
struct Index([u8; 48]);

impl Files {
    /// The files of a database that SQLite has just opened. Like that of the lock, their descriptors are
    /// closed after SQLite's own: the index is locked by fcntl(2) too.
    pub(super) fn of(path: &Path, lock: &Lock) -> Result<Option<Self>, StoreError> {
        let Some(database) = &lock.database else { return Ok(None) };
        let failed = |error| StoreError::Open(path.to_owned(), error);
        let file = database.try_clone().map_err(failed)?;
        let mut files = Self {
            database: Opened::new("database", path.to_owned(), Ok(file)).map_err(failed)?,
            log: Opened::named("write-ahead log", beside(path, "-wal")).map_err(failed)?,
            index: Opened::named("index of the write-ahead log", beside(path, "-shm")).map_err(failed)?,
            counter: 0,
            commits: 0,
            bytes: 0,
            standing: None,
        };
        files.commits = files.header().map_err(StoreError::Gone)?.commits;
        files.check().map_err(StoreError::Gone)?;
        Ok(Some(files))
    }

    /// Says what is wrong with the files, if anything is: with the database first, because SQLite itself
    /// removes the log of one that is empty.
    pub(super) fn check(&mut self) -> Result<(), String> {
        self.database.require_name()?;
        self.require_header()?;
        for opened in [&self.log, &self.index] {
            opened.require_name()?;
        }
        self.require_log()
    }

    /// Whether all that was lost is a name of the log or its index: then the log, which is still open, can be
    /// folded into a database that is in its place.
    pub(super) fn can_fold(&mut self) -> bool {
        self.database.require_name().is_ok() && self.require_header().is_ok() && self.require_log().is_ok()
    }

    /// Bytes that are free on the disk, where the system knows.
    pub(super) fn free(&self) -> Option<u64> {
        let disk = fstatvfs(&self.database.file).ok()?;
        Some(disk.f_bavail.saturating_mul(disk.f_frsize))
    }

    /// The database file grows, its counts go forward. Only `VACUUM`, which says so in the header, makes it
    /// smaller.
    fn require_header(&mut self) -> Result<(), String> {
        let header = self.header()?;
        if !header.is_one || (header.bytes < self.bytes && header.bytes < header.needed) {
            return Err("the database was truncated or overwritten".to_owned());
        }
        let fewer = header.commits.wrapping_sub(self.commits).cast_signed() < 0;
        if header.counter < self.counter || fewer {
            return Err("the database was overwritten by an older one".to_owned());
        }
        (self.counter, self.commits, self.bytes) = (header.counter, header.commits, header.bytes);
        Ok(())
    }

    /// What the database file says of itself: <https://sqlite.org/fileformat2.html#the_database_header>.
    fn header(&self) -> Result<Header, String> {
        let mut header = [0; 100];
        let bytes = self.database.read(&mut header)?;
        let page = match u64::from(number(&header, 16) >> 16) {
            1 => 65_536,
            page => page,
        };
        Ok(Header {
            is_one: header.starts_with(MAGIC),
            counter: number(&header, 24),
            commits: number(&header, 60),
            needed: u64::from(number(&header, 28)) * page,
            bytes,
        })
    }

    /// The log holds the frames that its index counts. Another process may write meanwhile, so a
    /// contradiction counts only where the index stays the same around it.
    fn require_log(&mut self) -> Result<(), String> {
        for _ in 0..TRIES {
            let Some(index) = self.index()? else { continue };
            let standing = index.standing();
            if self.standing.is_some_and(|before| standing.is_behind(&before)) {
                return Err("the write-ahead log was overwritten by an older one".to_owned());
            }
            self.standing = Some(standing);
            let frames = u64::from(index.number(16));
            let mut header = [0; LOG_HEADER as usize];
            let bytes = match frames {
                0 => return Ok(()),
                _ => self.log.read(&mut header)?,
            };
            let wanted = LOG_HEADER + frames * (FRAME_HEADER + index.page());
            let is_whole =
                number(&header, 0) & !1 == LOG_MAGIC && header[16..24] == index.0[32..40] && bytes >= wanted;
            if is_whole {
                return Ok(());
            }
            if self.index()?.is_some_and(|now| now == index) {
                return Err("the write-ahead log was truncated or overwritten".to_owned());
            }
        }
        Ok(())
    }

    /// The header of the index; nothing while somebody writes it, which is when its two copies differ.
    fn index(&self) -> Result<Option<Index>, String> {
        let mut copies = [0; 96];
        self.index.read(&mut copies)?;
        let mut index = Index([0; 48]);
        index.0.copy_from_slice(&copies[..48]);
        Ok((copies[48..] == index.0).then_some(index))
    }
}

impl Index {
    /// A number in the order of bytes of this machine.
    fn number(&self, at: usize) -> u32 {
        u32::from_ne_bytes([self.0[at], self.0[at + 1], self.0[at + 2], self.0[at + 3]])
    }

    fn standing(&self) -> Standing {
        let mut salt = [0; 8];
        salt.copy_from_slice(&self.0[32..40]);
        Standing { commits: self.number(8), frames: self.number(16), salt }
    }

    /// Bytes of a page.
    fn page(&self) -> u64 {
        match u16::from_ne_bytes([self.0[14], self.0[15]]) {
            1 => 65_536,
            page => u64::from(page),
        }
    }
}

impl Opened {
    fn named(what: &'static str, path: PathBuf) -> io::Result<Self> {
        let file = File::open(&path);
        Self::new(what, path, file)
    }

    fn new(what: &'static str, path: PathBuf, file: io::Result<File>) -> io::Result<Self> {
        let file = file?;
        let identity = identity(&file.metadata()?);
        Ok(Self { what, path, file, identity })
    }

    /// The name leads to what was opened.
    fn require_name(&self) -> Result<(), String> {
        match fs::metadata(&self.path) {
            Ok(now) if identity(&now) == self.identity => Ok(()),
            Ok(_) => Err(format!("the {} was replaced", self.what)),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                Err(format!("the {} was removed", self.what))
            }
            Err(error) => Err(format!("the {} cannot be found: {error}", self.what)),
        }
    }

    /// Reads the first bytes, zeros where there are none, and says how many the file has.
    fn read(&self, first: &mut [u8]) -> Result<u64, String> {
        let failed = |error| format!("the {} cannot be read: {error}", self.what);
        match self.file.read_exact_at(first, 0) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => first.fill(0),
            read => read.map_err(failed)?,
        }
        Ok(self.file.metadata().map_err(failed)?.len())
    }
}

/// A number with its highest byte first, as files have it.
fn number(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}
