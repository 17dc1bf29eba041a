//! Whom this program trusts where it asks others by TLS.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};

/// Where systems keep the certificates that they trust: Debian, Fedora, Alpine and BSD.
const SYSTEM_CERTIFICATES: [&str; 3] =
    ["/etc/ssl/certs/ca-certificates.crt", "/etc/pki/tls/certs/ca-bundle.crt", "/etc/ssl/cert.pem"];

/// TLS for asking others, who are known by the certificates of a file, or by those that this system trusts.
///
/// # Errors
/// A sentence where there are none, or the file cannot be read.
pub fn trust(file: Option<&Path>) -> Result<TlsConfig, String> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    Ok(TlsConfig::builder().root_certs(roots(file)?).unversioned_rustls_crypto_provider(provider).build())
}

/// A client for one address, that follows no redirects and takes any status for an answer.
///
/// # Errors
/// As [`trust`], where the address asks for TLS.
pub(super) fn agent(url: &str, patience: Duration) -> Result<ureq::Agent, String> {
    let mut config = ureq::Agent::config_builder()
        .http_status_as_error(false)
        .max_redirects(0)
        .timeout_global(Some(patience));
    if url.starts_with("https://") {
        config = config.tls_config(trust(None)?);
    }
    Ok(ureq::Agent::new_with_config(config.build()))
}

/// The certificates of a file, or those that this system trusts.
fn roots(file: Option<&Path>) -> Result<RootCerts, String> {
    let known = || SYSTEM_CERTIFICATES.into_iter().map(Path::new).find(|file| file.exists());
    let file = file.or_else(known).ok_or("this system has no list of certificates: name one with --ca")?;
    let said = |error: &dyn std::fmt::Display| format!("{}: {error}", file.display());
    let text = std::fs::read(file).map_err(|error| said(&error))?;
    let certificates = parse_pem(&text).filter_map(|item| match item {
        Ok(PemItem::Certificate(certificate)) => Some(Ok(certificate)),
        Ok(_) => None,
        Err(error) => Some(Err(error)),
    });
    let certificates = certificates.collect::<Result<Vec<_>, _>>().map_err(|error| said(&error))?;
    if certificates.is_empty() {
        Err(said(&"there is no certificate in it"))
    } else {
        Ok(certificates.into())
    }
}
