//! Fits of earlier programs, whose rows say nothing for lists: what lists read is taken from their documents
//! once, behind the answers. Until then lists read the documents themselves.

use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::fits::UnlistedFit;
use std::sync::Arc;
use std::time::Duration;

/// Fits that one transaction writes.
const AT_ONCE: i64 = 100;
/// Others write between two of them.
const PAUSE: Duration = Duration::from_millis(50);

/// Goes through all of them, or until the service stops.
pub(crate) async fn run(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        match list_some(&service).await {
            Ok(true) => {}
            Ok(false) => return,
            // The next start tries again.
            Err(error) => {
                return tracing::warn!(%error, "fits of an earlier program are not in the lists yet");
            }
        }
        tokio::select! {
            () = tokio::time::sleep(PAUSE) => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Some of them; says whether there were any.
async fn list_some(service: &Service) -> Result<bool, ServiceError> {
    let found = store::fits::unlisted(&service.store, AT_ONCE).await?;
    if found.is_empty() {
        return Ok(false);
    }
    let columns = |UnlistedFit { id, text, in_trend }| Ok((id, text.columns()?, in_trend));
    let listed: Result<Vec<_>, store::StoreError> =
        blocking(move || found.into_iter().map(columns).collect()).await?;
    let listed = listed?;
    store::fits::list(&service.store, &listed).await?;
    Ok(true)
}
