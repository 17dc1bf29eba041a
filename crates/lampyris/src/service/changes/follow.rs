//! Keeps the log of events up to date with the database.

use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::events::Missed;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

/// How often the database is asked for news without a hint.
const SLOW_POLL: Duration = Duration::from_secs(1);
/// Numbers that are read at once: a night of many systems is told in turns.
const AT_ONCE: i64 = 1000;

/// Tells the submissions and ends that the database has and the log has not.
///
/// # Errors
/// Where the database fails; then the next call makes up for it.
pub async fn catch_up(service: &Service) -> Result<(), ServiceError> {
    let _one_at_a_time = service.events.reading.lock().await;
    let newest = store::events::newest(&service.store).await?;
    let mut after = service.events.sequence();
    while after < newest {
        let missed = Missed { after, up_to: newest.min(after + AT_ONCE) };
        let news = store::events::news(&service.store, missed).await?;
        for job in news.iter().filter(|job| job.state.is_final()) {
            service.board.settled(&job.id).await;
        }
        news.iter()
            .filter(|job| job.state.end_sequence().is_some_and(|end| missed.has(end)))
            .for_each(|job| service.metrics.job_ended(job));
        service.events.publish_news(news, missed);
        after = missed.up_to;
    }
    Ok(())
}

/// Keeps the log up to date until the service stops.
pub async fn follow(service: Arc<Service>) {
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
