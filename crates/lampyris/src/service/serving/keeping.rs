//! Keeps what forecasts said, behind the answers: nobody waits for it, and where it fails that is a line in
//! the log.

use super::said::SaidForecast;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::said::PackedSaid;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::forecast::score::Said;
use std::collections::BTreeMap;
use std::pin::pin;
use std::sync::Arc;

/// Keeps what is said until the service stops.
pub(crate) async fn run(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        let mut told = pin!(service.said.told.notified());
        told.as_mut().enable();
        let said = service.said.take();
        if said.is_empty() {
            tokio::select! {
                () = told => {}
                _ = stopping.changed() => {}
            }
            continue;
        }
        if let Err(error) = keep(&service, said).await {
            tracing::warn!(%error, "what forecasts said could not be kept");
        }
    }
}

async fn keep(service: &Service, said: BTreeMap<SystemId, SaidForecast>) -> Result<(), ServiceError> {
    let packed = blocking(move || said.into_iter().map(packed).collect::<Vec<_>>()).await?;
    Ok(store::said::keep(&service.store, &packed).await?)
}

fn packed((system, one): (SystemId, SaidForecast)) -> (SystemId, Vec<PackedSaid>) {
    let pack = |said: &Said| PackedSaid::new(said, one.revision, one.made_at);
    (system, one.outputs.iter().map(pack).collect())
}
