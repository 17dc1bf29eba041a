//! What the database could not do, for somebody who may not know where it is.

use crate::store::StoreError;
use axum::http::StatusCode;

/// Status, slug and title of a problem of the database.
pub fn problem(error: &StoreError) -> (StatusCode, &'static str, &'static str) {
    match error {
        StoreError::Full(_) => (StatusCode::INSUFFICIENT_STORAGE, "storage-full", "The database is full"),
        error if error.is_final() => {
            (StatusCode::SERVICE_UNAVAILABLE, "storage-read-only", "The database is read-only")
        }
        _ => (StatusCode::SERVICE_UNAVAILABLE, "storage-unavailable", "The database is unavailable"),
    }
}

/// Why the database does not do what was asked, for somebody who may not know where it is.
pub fn detail(error: &StoreError) -> String {
    match error {
        StoreError::Full(_) => {
            "the database has no room for this: delete windows or make room on its disk, and \
            send it again; what is served stays served"
                .to_owned()
        }
        StoreError::Broken(_) => "a write has failed, and nothing is written until the service is started \
            again; what is served stays served"
            .to_owned(),
        StoreError::Gone(how) => format!(
            "{how} while the service ran, and nothing is written until it is started again; what is served \
            stays served"
        ),
        StoreError::ReadOnly(why) => format!(
            "the disk of the database took no writes when the service was started ({why}), and nothing is \
            written until it is started again; what is served stays served"
        ),
        _ => "the database cannot do this now; what is served stays served".to_owned(),
    }
}
