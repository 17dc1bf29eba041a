//! Follows what other services do on a database that they share, by asking it: nothing is missed, and nothing
//! depends on being told.

use super::follow;
use crate::service::catalogue::shared::SharedCatalogue;
use crate::service::error::ServiceError;
use crate::service::serving::params;
use crate::service::state::Service;
use crate::store::{self, feed, queue};
use lampyris_core::model::Catalogue;
use std::sync::Arc;
use std::time::Duration;

/// How often the database is asked.
const POLL: Duration = Duration::from_millis(100);
/// How long one look may take.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause after the database has failed.
const AFTER_FAILURE: Duration = Duration::from_millis(500);

/// Follows what is committed after a place until the service stops.
pub(crate) async fn follow(service: Arc<Service>, mut position: i64) {
    let mut stopping = service.stopping.subscribe();
    let mut newest = 0;
    while !*stopping.borrow_and_update() {
        let looked = tokio::time::timeout(PATIENCE, look(&service, &mut position, &mut newest)).await;
        let pause = match looked {
            Ok(Ok(())) => POLL,
            Ok(Err(error)) => {
                tracing::error!(%error, "what other services have done could not be read");
                AFTER_FAILURE
            }
            Err(_) => {
                tracing::error!("the database does not answer");
                AFTER_FAILURE
            }
        };
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            _ = stopping.changed() => {}
        }
    }
}

async fn look(service: &Arc<Service>, position: &mut i64, newest: &mut i64) -> Result<(), ServiceError> {
    let store = &service.store;
    for job in queue::cancelling(store, service.membership.worker()).await? {
        service.board.cancel(&job);
    }
    let now = store::events::newest(store).await?;
    if now > *newest {
        *newest = now;
        follow::catch_up(service).await?;
        service.wake.notify_one();
    }
    let news = feed::after(store, *position).await?;
    if news.catalogue || news.missed {
        reload(service).await?;
    }
    if news.queue {
        service.wake.notify_one();
    }
    if news.schedules || news.missed {
        service.wake_schedule.notify_one();
    }
    if news.missed {
        params::read_all_anew(service).await?;
    }
    if service.membership.leads() {
        news.measured.iter().for_each(|system| service.arrivals.note(system));
        service.kept_posts.add(news.measured.len());
    }
    store.read_anew(news.systems).await;
    *position = news.position;
    Ok(())
}

/// Reads the documents of users anew, which another service may have added.
async fn reload(service: &Service) -> Result<(), ServiceError> {
    loop {
        let before = service.catalogue.current();
        let builtin = Catalogue::builtin().map_err(|faults| ServiceError::Internal(format!("{faults:?}")))?;
        let read = SharedCatalogue::load(&service.store, builtin).await?;
        if service.catalogue.replace(&before, read) {
            return Ok(());
        }
    }
}
