//! Where a database is: a file on this machine, or a server that several machines share.

use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Where a database is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum DatabasePlace {
    /// A file of SQLite, of one service. It is made if it is not there.
    File(PathBuf),
    /// A database of PostgreSQL, by its URL: `postgres://user:password@host/name`.
    Server(String),
}

impl DatabasePlace {
    /// The file, if it is one.
    pub fn file(&self) -> Option<&Path> {
        match self {
            DatabasePlace::File(path) => Some(path),
            DatabasePlace::Server(_) => None,
        }
    }
}

impl From<String> for DatabasePlace {
    fn from(text: String) -> Self {
        if text.starts_with("postgres://") || text.starts_with("postgresql://") {
            return DatabasePlace::Server(text);
        }
        DatabasePlace::File(text.strip_prefix("sqlite:").unwrap_or(&text).into())
    }
}

impl FromStr for DatabasePlace {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(text.to_owned().into())
    }
}

impl From<PathBuf> for DatabasePlace {
    fn from(path: PathBuf) -> Self {
        DatabasePlace::File(path)
    }
}

impl From<&Path> for DatabasePlace {
    fn from(path: &Path) -> Self {
        DatabasePlace::File(path.to_owned())
    }
}

impl From<DatabasePlace> for String {
    fn from(place: DatabasePlace) -> Self {
        match place {
            DatabasePlace::File(path) => path.display().to_string(),
            DatabasePlace::Server(url) => url,
        }
    }
}

/// For people: without the password.
impl std::fmt::Display for DatabasePlace {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            DatabasePlace::File(path) => path.display().fmt(f),
            DatabasePlace::Server(url) => match (url.split_once("://"), url.rsplit_once('@')) {
                (Some((scheme, _)), Some((_, host))) => write!(f, "{scheme}://…@{host}"),
                _ => f.write_str(url),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_a_file_or_a_server_and_tells_no_password() {
        let place = |text: &str| DatabasePlace::from(text.to_owned());
        assert_eq!(place("sqlite:a/b.db"), place("a/b.db"));
        assert_eq!(place("a/b.db").file(), Some(Path::new("a/b.db")));
        let server = place("postgres://lampyris:secret@db.local:5432/rooms");
        assert_eq!(server.file(), None);
        assert_eq!(server.to_string(), "postgres://…@db.local:5432/rooms");
        assert_eq!(String::from(server.clone()), "postgres://lampyris:secret@db.local:5432/rooms");
    }
}
