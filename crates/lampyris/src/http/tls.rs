//! TLS: the certificate that the listener shows, read again when its files change.

use crate::settings::TlsFiles;
use arc_swap::ArcSwap;
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;

/// How often the files are looked at.
const INTERVAL: Duration = Duration::from_secs(10);

/// The certificate in use.
#[derive(Debug)]
pub struct Tls {
    files: TlsFiles,
    config: ArcSwap<ServerConfig>,
    /// The hash of the files that were looked at last, whether they could be used or not.
    seen: Mutex<blake3::Hash>,
}

impl Tls {
    /// Reads certificate and key.
    ///
    /// # Errors
    /// Where a file cannot be read, or they are no pair.
    pub fn load(files: TlsFiles) -> Result<Arc<Self>, String> {
        let (config, seen) = read(&files)?;
        Ok(Arc::new(Self { config: ArcSwap::new(config?), files, seen: Mutex::new(seen) }))
    }

    /// What the next connection is greeted with.
    pub fn acceptor(&self) -> TlsAcceptor {
        TlsAcceptor::from(self.config.load_full())
    }

    /// Reads the files anew where they have changed. What cannot be used leaves what was used before: a key
    /// may be written a moment after its certificate.
    pub fn renew(&self) {
        let read = read(&self.files);
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        match read {
            Ok((_, hash)) if hash == *seen => {}
            Ok((Ok(config), hash)) => {
                self.config.store(config);
                *seen = hash;
                tracing::info!("the certificate was read anew");
            }
            Ok((Err(error), hash)) => {
                *seen = hash;
                tracing::error!(error, "the new certificate cannot be used; the one before stays");
            }
            Err(error) => tracing::error!(error, "the certificate cannot be read; the one before stays"),
        }
    }

    /// Looks at the files until the service stops.
    pub async fn follow(self: Arc<Self>, mut stopping: watch::Receiver<bool>) {
        loop {
            tokio::select! {
                () = tokio::time::sleep(INTERVAL) => self.renew(),
                _ = stopping.wait_for(|stopping| *stopping) => return,
            }
        }
    }
}

/// Most bytes of a file: a chain of certificates that clients take is far shorter.
const MOST_BYTES: u64 = 64 << 10;

/// What the files make, and their hash.
type Read = (Result<Arc<ServerConfig>, String>, blake3::Hash);

fn read(files: &TlsFiles) -> Result<Read, String> {
    let bytes = |file: &std::path::Path| {
        let said = |error: std::io::Error| format!("{}: {error}", file.display());
        // Whoever opens a pipe waits for its other end.
        let size = std::fs::metadata(file).map_err(said)?;
        if !size.is_file() || size.len() > MOST_BYTES {
            return Err(format!("{}: no file of at most {MOST_BYTES} bytes", file.display()));
        }
        std::fs::read(file).map_err(said)
    };
    let (certificate, key) = (bytes(&files.certificate)?, bytes(&files.key)?);
    let hash = blake3::Hasher::new().update(&certificate).update(b"\0").update(&key).finalize();
    Ok((config(files, &certificate, &key), hash))
}

fn config(files: &TlsFiles, certificate: &[u8], key: &[u8]) -> Result<Arc<ServerConfig>, String> {
    let said = |file: &std::path::Path, error: &dyn std::fmt::Display| format!("{}: {error}", file.display());
    let chain = CertificateDer::pem_slice_iter(certificate)
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| said(&files.certificate, &error))?;
    if chain.is_empty() {
        return Err(said(&files.certificate, &"there is no certificate in it"));
    }
    let key = PrivateKeyDer::from_pem_slice(key).map_err(|error| said(&files.key, &error))?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(|error| said(&files.certificate, &error))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Arc::new(config))
}
