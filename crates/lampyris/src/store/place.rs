//! Where a database is: a file on this machine, or a server that several machines share.

use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Where a database is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum Place {
    /// A file of SQLite, of one service. It is made if it is not there.
    File(PathBuf),
    /// A database of PostgreSQL, by its URL: `postgres://user:password@host/name`.
    Server(String),
}

impl Place {
    /// The file, if it is one.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Place::File(path) => Some(path),
            Place::Server(_) => None,
        }
    }
}

impl From<String> for Place {
    fn from(text: String) -> Self {
        if text.starts_with("postgres://") || text.starts_with("postgresql://") {
            return Place::Server(text);
        }
        Place::File(text.strip_prefix("sqlite:").unwrap_or(&text).into())
    }
}

impl FromStr for Place {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(text.to_owned().into())
    }
}

impl From<PathBuf> for Place {
    fn from(path: PathBuf) -> Self {
        Place::File(path)
    }
}

impl From<&Path> for Place {
    fn from(path: &Path) -> Self {
        Place::File(path.to_owned())
    }
}

impl From<Place> for String {
    fn from(place: Place) -> Self {
        match place {
            Place::File(path) => path.display().to_string(),
            Place::Server(url) => url,
        }
    }
}

/// For people: without the password.
impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Place::File(path) => path.display().fmt(f),
            Place::Server(url) => match (url.split_once("://"), url.rsplit_once('@')) {
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
        let place = |text: &str| Place::from(text.to_owned());
        assert_eq!(place("sqlite:a/b.db"), place("a/b.db"));
        assert_eq!(place("a/b.db").file(), Some(Path::new("a/b.db")));
        let server = place("postgres://lampyris:secret@db.local:5432/rooms");
        assert_eq!(server.file(), None);
        assert_eq!(server.to_string(), "postgres://…@db.local:5432/rooms");
        assert_eq!(String::from(server.clone()), "postgres://lampyris:secret@db.local:5432/rooms");
    }
}
