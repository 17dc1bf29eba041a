//! Keeps the log of events up to date with the database.

use super::events::{ChangeSeen, SystemChange};
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::events::Missed;
use crate::store::jobs::{JobRecord, Origin};
use lampyris_core::data::{DAY, SystemId, read_time};
use lampyris_core::estimate::fit::parameter_change::ParameterChange;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

/// How often the database is asked for news without a hint.
const SLOW_POLL: Duration = Duration::from_secs(1);
/// Numbers that are read at once: a night of many systems is told in turns.
const AT_ONCE: i64 = 1000;
/// Changes that began within so many days of each other are one.
const SAME_DAYS: i64 = 14;

/// Tells the submissions and ends that the database has and the log has not.
///
/// # Errors
/// Where the database fails; then the next call makes up for it.
pub(crate) async fn catch_up(service: &Service) -> Result<(), ServiceError> {
    let _one_at_a_time = service.events.reading.lock().await;
    let newest = store::events::newest(&service.store).await?;
    let mut after = service.events.sequence();
    while after < newest {
        let missed = Missed { after, up_to: newest.min(after + AT_ONCE) };
        let news = store::events::news(&service.store, missed).await?;
        for job in news.iter().filter(|job| job.state.is_final()) {
            service.board.settled(&job.id).await;
        }
        let ended = || news.iter().filter(|job| job.state.end_sequence().is_some_and(|end| missed.has(end)));
        // What somebody has posted was not looked at.
        let looked = ended().filter(|job| job.origin != Origin::Posted && !job.experiment);
        let found = |job: &JobRecord| Some((job.system.clone(), job.state.result()?.found()?.id.clone()));
        let fits: Vec<(SystemId, String)> = looked.filter_map(found).collect();
        // All is read before anything is told, or what fails in between would be left out.
        let mut seen = Vec::new();
        for (system, fit) in fits {
            seen.extend(first_seen(service, fit).await?.map(|change| (system, Box::new(change))));
        }
        ended().for_each(|job| service.metrics.job_ended(job));
        service.events.publish_news(news, missed);
        for (system, change) in seen {
            service.events.publish(&system, SystemChange::Changed(change));
        }
        after = missed.up_to;
    }
    Ok(())
}

/// The change that a fit has seen, unless one before it has: the same within two weeks, whatever parameter it
/// was laid to.
async fn first_seen(service: &Service, fit: String) -> Result<Option<ChangeSeen>, ServiceError> {
    let mut changes = store::fits::changes_up_to(&service.store, &fit).await?.into_iter();
    let Some(change) = changes.next() else { return Ok(None) };
    let day = |change: &ParameterChange| read_time("since", &change.since).map_or(0, |at| at / DAY);
    let since = day(&change);
    let is_known = changes.any(|before| (day(&before) - since).abs() <= SAME_DAYS);
    Ok((!is_known).then(|| ChangeSeen { fit, sentence: change.sentence(), change }))
}

/// Keeps the log up to date until the service stops.
pub(crate) async fn follow(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        // Interest is registered before the database is asked, so that a job that comes in between is not
        // missed.
        let mut hinted = pin!(service.events.hint.notified());
        hinted.as_mut().enable();
        if let Err(error) = catch_up(&service).await {
            tracing::error!(%error, "listeners could not be told what happened");
        }
        tokio::select! {
            () = hinted => {}
            () = tokio::time::sleep(SLOW_POLL) => {}
            _ = stopping.changed() => {}
        }
    }
}
