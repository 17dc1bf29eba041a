//! The states of systems that live samples come from: the end of each filter is kept in memory, so that a
//! sample costs a step. A look at the whole record (`degradations`) begins it, and begins it anew now and
//! then; after a start of the service it is the same look.

use crate::service::catalogue::systems;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::service::work::input;
use crate::store;
use jiff::SignedDuration;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::assess::live::LiveStates;
use lampyris_core::estimate::assess::metrics::CurrentState;
use std::sync::Arc;

/// How long states go on by samples alone before the whole record is looked at again.
const LOOKED: SignedDuration = SignedDuration::from_hours(1);
/// Goes on over samples that came from an instant on, in milliseconds, and says by which revision and where
/// the states are then; `None` where nothing is served, or its states are not known yet.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn go_on(
    service: &Service,
    system: &SystemId,
    from: i64,
) -> Result<Option<(i64, CurrentState)>, ServiceError> {
    let entry = service.params.entry(&system.to_string());
    let Some(revision) = entry.and_then(|entry| entry.validated()?.revision) else { return Ok(None) };
    let known = service.live.get(system).filter(|live| live.revision == revision);
    let Some(live) = known else {
        service.arrivals.note(system);
        return Ok(None);
    };
    let (next, needs_from, is_behind) = {
        let standing = live.standing();
        let end = standing.end.as_ref();
        (end.map(LiveStates::next), end.map(LiveStates::needs_from), end.is_some_and(|end| from <= end.at()))
    };
    // What came late is seen by a look at the whole.
    let is_old = service.now().duration_since(live.looked_at) > LOOKED;
    if is_old || is_behind {
        service.arrivals.note(system);
    }
    if let (Some(next), Some(needs_from)) = (next, needs_from)
        && store::measured::extent(&service.store, system).await?.is_some_and(|(_, newest)| newest >= next)
    {
        let document = systems::require(service, system).await?;
        let span = (needs_from, service.now().as_millisecond());
        let measured = input::measurements(service, system, &document, span).await?;
        let (catalogue, going) = (service.catalogue.current(), live.clone());
        let advanced = blocking(move || -> Result<Option<CurrentState>, ServiceError> {
            let model = document.require_model().map_err(ServiceError::Faults)?;
            let measured = measured.window(&catalogue, model)?;
            let standing = &mut *going.standing();
            let advanced = standing.end.as_mut().and_then(|end| end.go_on(&measured));
            if advanced.is_some() {
                standing.told.clone_from(&advanced);
            }
            Ok(advanced)
        });
        if let Some(state) = advanced.await?? {
            store::params::keep_newer_state(&service.store, system, revision, &state).await?;
        }
    }
    let told = live.standing().told.clone();
    Ok(told.map(|told| (revision, told)))
}

/// Goes on over samples of several systems, each from an instant on, while nobody waits for it.
pub fn go_on_behind(service: &Arc<Service>, systems: Vec<(SystemId, i64)>) {
    let service = service.clone();
    tokio::spawn(async move {
        for (system, from) in systems {
            if let Err(error) = go_on(&service, &system, from).await {
                tracing::warn!(%error, %system, "the states did not go on over new samples");
            }
        }
    });
}
