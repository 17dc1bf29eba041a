//! Asks a Prometheus for measurements, again and again, and takes what comes as live samples.

use super::live;
use crate::service::catalogue::lines::{self, Sorter};
use crate::service::catalogue::prometheus::{self, PrometheusSource};
use crate::service::error::ServiceError;
use crate::service::observe::pulls::PullOutcome;
use crate::service::state::Service;
use crate::service::threads::{apart, blocking};
use crate::service::trust::agent;
use crate::store::reach::SystemScope;
use jiff::Timestamp;
use lampyris_core::data::{SECOND, TimePrecision};
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;

/// How often is looked for a source where there is none.
const IDLE: Duration = Duration::from_secs(60);
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(30);
/// Largest answer that is read.
const LARGEST: u64 = 1 << 26;
/// Most values of a series in one answer: a Prometheus gives 11,000.
const MOST_VALUES: i64 = 10_000;

/// Asks until the service stops.
pub(crate) async fn run(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    // The source that is asked, and until when it has told everything.
    let mut known: Option<(PrometheusSource, i64)> = None;
    while !*stopping.borrow_and_update() {
        let asked = if service.membership.leads() { prometheus::get(&service).await } else { Ok(None) };
        let source = match asked {
            Ok(source) => source.map(|(source, _)| source).filter(|source| !source.queries.is_empty()),
            Err(error) => {
                tracing::warn!(%error, "the source of measurements could not be read");
                None
            }
        };
        let pause = match source {
            None => IDLE,
            Some(source) => {
                let now = service.now();
                let told = known.take().filter(|(before, _)| *before == source).map(|(_, told)| told);
                let from = told.unwrap_or_else(|| now.as_millisecond() - source.lookback.millis());
                let pulled = tokio::select! {
                    pulled = pull(&service, &source, from, now) => pulled,
                    _ = stopping.wait_for(|stops| *stops) => return,
                };
                let error = pulled.as_ref().err().cloned();
                if let Some(error) = &error {
                    tracing::warn!(%error, url = source.url, "no measurements could be fetched");
                }
                service.pulls.ended(PullOutcome { at: now, error });
                let pause = Duration::from_millis(source.every.millis().unsigned_abs());
                known = Some((source, pulled.unwrap_or(from)));
                pause
            }
        };
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            () = service.pulls.news() => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Asks for what came after an instant, in milliseconds, and keeps it; says until when everything is told.
///
/// # Errors
/// A sentence where nobody answers, the answer has no series, or they cannot be kept.
async fn pull(
    service: &Arc<Service>,
    source: &PrometheusSource,
    from: i64,
    now: Timestamp,
) -> Result<i64, String> {
    let said = |error: ServiceError| error.to_string();
    let step = source.step.millis();
    let (mut next, last) = (from.div_euclid(step) + 1, now.as_millisecond().div_euclid(step));
    while next <= last {
        let end = last.min(next + MOST_VALUES - 1);
        for query in &source.queries {
            let mut sorter =
                Sorter::new(service, &source.rules(), TimePrecision::Milliseconds, &SystemScope::ALL)
                    .map_err(said)?;
            let (asked, query) = (source.clone(), query.clone());
            let answer = apart("pull", move || fetch(&asked, &query, next * step, end * step)).await?;
            let sorted = blocking(move || {
                sorter.sort(prometheus::points(&answer)?.into_iter().map(Ok));
                Ok::<_, String>(sorter.sorted())
            });
            let sorted = sorted.await.map_err(said)??;
            let taken = lines::keep(service, sorted, &service.pulls.lines).await.map_err(said)?;
            if let Some(fault) = taken.faults.listed.first() {
                tracing::warn!(%fault, count = taken.faults.count, "measurements could not be taken");
            }
            live::go_on_behind(service, taken.systems);
        }
        next = end + 1;
    }
    Ok(last * step)
}

/// Asks for a query from one instant to another, both in milliseconds, and reads the answer. It blocks.
fn fetch(source: &PrometheusSource, query: &str, from: i64, to: i64) -> Result<Value, String> {
    let said = |error: ureq::Error| error.to_string();
    let seconds = |millis: i64| format!("{}.{:03}", millis.div_euclid(SECOND), millis.rem_euclid(SECOND));
    let mut answer = agent(&source.url, PATIENCE)?
        .get(format!("{}/api/v1/query_range", source.url.trim_end_matches('/')))
        .query("query", query)
        .query("start", seconds(from))
        .query("end", seconds(to))
        .query("step", seconds(source.step.millis()))
        .call()
        .map_err(said)?;
    let text = answer.body_mut().with_config().limit(LARGEST).read_to_string().map_err(said)?;
    serde_json::from_str(&text).map_err(|_| format!("status {} and no JSON", answer.status().as_u16()))
}
