//! Answers that wait for news of a system, by `Prefer: wait=N`.

use super::shared::Shared;
use crate::service::serving::snapshot::{Entry, Slot};
use axum::http::{HeaderMap, HeaderValue};
use std::sync::Arc;
use std::time::Duration;

/// The longest that a client may wait for news, in seconds.
const LONGEST_WAIT: u64 = 60;

/// The entry of a system: at once where it is news to the client, or where that does not want to wait; else
/// as soon as it is, or when the client's patience ends. `None` where the system has gone meanwhile.
pub(crate) async fn newest(
    service: &Shared,
    system: &str,
    slot: Arc<Slot>,
    headers: &HeaderMap,
    is_old: impl Fn(&Entry) -> bool,
) -> Option<Arc<Entry>> {
    match headers.get("prefer").and_then(wait) {
        Some(seconds) => Box::pin(news(service, system, slot, Duration::from_secs(seconds), is_old)).await,
        None => Some(slot.entry()),
    }
}

async fn news(
    service: &Shared,
    system: &str,
    slot: Arc<Slot>,
    patience: Duration,
    is_old: impl Fn(&Entry) -> bool,
) -> Option<Arc<Entry>> {
    // Interest is registered before the entry is read, so that news that comes in between is not missed.
    let mut news = slot.watch();
    let entry = slot.entry();
    if !is_old(&entry) {
        return Some(entry);
    }
    let mut stopping = service.stopping.subscribe();
    let told = async {
        // An event may leave this client's answer as it was, such as one job following another. A system that
        // was deleted has its place no more, also where another one of its name has come.
        let stands = || service.params.slot(system).is_some_and(|now| Arc::ptr_eq(&now, &slot));
        while news.changed().await.is_ok() && stands() && is_old(&slot.entry()) {}
    };
    tokio::select! {
        () = told => {}
        () = tokio::time::sleep(patience) => {}
        _ = stopping.wait_for(|stopping| *stopping) => {}
    }
    service.params.entry(system)
}

/// How long a client is ready to wait, in seconds, by its `Prefer` (RFC 7240): names are written as one
/// likes, and values may be quoted.
fn wait(prefer: &HeaderValue) -> Option<u64> {
    let pairs = prefer.to_str().ok()?.split([',', ';']).filter_map(|part| part.split_once('='));
    let (_, seconds) = pairs.into_iter().find(|(name, _)| name.trim().eq_ignore_ascii_case("wait"))?;
    seconds.trim().trim_matches('"').parse::<u64>().ok().map(|seconds| seconds.min(LONGEST_WAIT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preferences_are_read_as_the_standard_says() {
        let wait_of = |text: &'static str| wait(&HeaderValue::from_static(text));
        assert_eq!(
            (wait_of("wait=30"), wait_of("respond-async, wait=5"), wait_of("wait=9999")),
            (Some(30), Some(5), Some(60))
        );
        assert_eq!(
            (wait_of("Wait=30"), wait_of("WAIT = \"5\""), wait_of("handling=strict; x=y, wait=7")),
            (Some(30), Some(5), Some(7))
        );
        assert_eq!((wait_of("wait=soon"), wait_of("respond-async")), (None, None));
    }
}
