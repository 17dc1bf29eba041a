//! The certificate, where the service speaks TLS itself.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The files of a certificate, PEM each. They are read again when they change.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsFiles {
    /// The certificate, and behind it those that it rests on.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}
