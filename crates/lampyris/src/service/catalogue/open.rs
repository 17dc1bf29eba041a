//! Lays live samples, which are kept as they came, into the days of their system: before anything else comes
//! over them, and now and then.

use super::lay;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::samples::{LaidIn, Open};
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::SystemId;
use std::sync::Arc;
use std::time::Duration;

/// Open posts of a system are laid in when they are so many,
const MOST_OPEN: i64 = 60;
/// or when the oldest has waited for so long.
const LONGEST_OPEN: SignedDuration = SignedDuration::from_hours(1);
/// How often that is looked at, and sooner where many have come.
const TICK: Duration = Duration::from_secs(60);
/// How often it is tried where windows come in between.
const TRIES: usize = 8;

/// Lays open posts into the days until the service stops.
pub(crate) async fn run(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        service.kept_posts.look();
        if service.membership.leads() {
            lay_due(&service).await;
        }
        tokio::select! {
            () = tokio::time::sleep(TICK) => {}
            () = service.kept_posts.many() => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Lays in the open posts of all systems of which they are many, or old.
async fn lay_due(service: &Service) {
    let before = service.now().saturating_sub(LONGEST_OPEN).unwrap_or(Timestamp::MIN);
    let systems = match store::samples::due(&service.store, MOST_OPEN, before).await {
        Ok(systems) => systems,
        Err(error) => return tracing::warn!(%error, "systems with open samples could not be listed"),
    };
    for system in systems {
        let _turn = service.turns.of(&system).await;
        if let Err(error) = lay_in(service, &system).await {
            tracing::warn!(%error, %system, "samples could not be laid into the days");
        }
    }
}

/// Lays the open posts of a system into its days, within its turn: what comes then lies over them.
///
/// # Errors
/// Where something that was kept is not what was written, or the database fails.
pub(super) async fn lay_in(service: &Service, system: &SystemId) -> Result<(), ServiceError> {
    for _ in 0..TRIES {
        let Some(open) = store::samples::open(&service.store, system).await? else { return Ok(()) };
        let (open, laid) = blocking(move || {
            let laid = lay::lay_open(&open)?;
            Ok::<(Open, LaidIn), ServiceError>((open, laid))
        })
        .await??;
        store::samples::lay_in(&service.store, &open, &laid, service.now()).await?;
    }
    Err(ServiceError::Busy)
}
