//! Tells one address what happens: it follows the log of events, and nobody waits for it.
//!
//! Notices wait in a short queue. What cannot be delivered is tried again for some minutes; where the queue
//! is full, newer notices are left out and the log says so. One process of several tells, once.

use super::events::{Event, JobChange, SystemChange};
use crate::service::error::ServiceError;
use crate::service::query::night::{self, Night};
use crate::service::serving::body::Status;
use crate::service::state::Service;
use crate::service::threads::apart;
use crate::service::trust::agent;
use crate::settings::{NoticeFormat, NoticeKind, NotifySettings};
use crate::store;
use crate::store::jobs::{JobRecord, Outcome};
use crate::store::reach::SystemScope;
use hmac::{Hmac, KeyInit, Mac};
use serde::Serialize;
use sha2::Sha256;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{Receiver, Sender, channel, error::TrySendError};
use tokio::time::Instant;

/// Notices that wait to be delivered.
const WAITING: usize = 256;
/// How often a notice is tried.
const TRIES: u32 = 8;
/// The pause behind the first try; each next one is twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(2);
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(20);
/// Nights that are remembered as told.
const REMEMBERED: usize = 64;
/// A night is looked for when its jobs have been quiet for so long.
const QUIET: Duration = Duration::from_secs(1);

/// What is told.
#[derive(Debug, Clone, Serialize)]
struct Notice {
    /// Its own name: whoever gets one twice can tell.
    id: String,
    event: NoticeKind,
    at: jiff::Timestamp,
    title: String,
    message: String,
    /// Where on the page.
    link: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    system: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    job: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    revision: Option<i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    batch: Option<String>,
}

/// What was told before, so that nothing is told twice.
struct Told {
    /// The last known status of each system.
    statuses: HashMap<String, Status>,
    nights: VecDeque<String>,
    /// Jobs that have ended since somebody looked whether a night has.
    ended: Vec<String>,
    /// When to look again.
    look_at: Option<Instant>,
}

/// Tells what happens until the service stops.
pub(crate) async fn run(service: Arc<Service>) {
    if let Some(settings) = service.settings.notify.clone() {
        let (sender, waiting) = channel(WAITING);
        let telling =
            async { tokio::join!(collect(&service, &settings, sender), deliver(&settings, waiting)) };
        let mut stopping = service.stopping.subscribe();
        tokio::select! {
            _ = telling => {}
            _ = stopping.wait_for(|stops| *stops) => {}
        }
    }
}

/// Makes notices of events.
async fn collect(service: &Arc<Service>, settings: &NotifySettings, sender: Sender<Notice>) {
    let mut newest = service.events.watch();
    let (mut position, _) = service.events.snapshot();
    let known = service.params.all().into_iter();
    let statuses = known.filter_map(|(name, entry)| Some((name, entry.validated()?.status))).collect();
    let mut told = Told { statuses, nights: VecDeque::new(), ended: Vec::new(), look_at: None };
    loop {
        newest.borrow_and_update();
        loop {
            let Some(batch) = service.events.after(position, |_| true) else {
                tracing::warn!("more has happened than could be followed: some notices are left out");
                position = service.events.snapshot().0;
                break;
            };
            for event in &batch.events {
                let made = notice(service, settings, &mut told, event).await;
                let made = made.map(|made| made.into_iter().collect());
                hand_over(service, settings, &sender, (made, &event.position.to_string()));
            }
            position = batch.position;
            if batch.is_all {
                break;
            }
        }
        if told.look_at.is_some_and(|at| at <= Instant::now()) {
            told.look_at = None;
            if let Err(error) = nights(service, settings, &sender, &mut told).await {
                tracing::error!(%error, "a night could not be told yet");
                told.look_at = Some(Instant::now() + PATIENCE);
            }
        }
        let quiet = told.look_at.unwrap_or_else(|| Instant::now() + PATIENCE);
        tokio::select! {
            changed = newest.changed() => if changed.is_err() { return },
            () = tokio::time::sleep_until(quiet) => {}
        }
    }
}

/// Whether this process is the one that tells, and somebody wants to hear of this.
fn tells(service: &Service, settings: &NotifySettings, kind: NoticeKind) -> bool {
    settings.wants(kind) && service.membership.leads()
}

/// Completes notices, and lets them wait to be delivered.
fn hand_over(
    service: &Service,
    settings: &NotifySettings,
    sender: &Sender<Notice>,
    (made, id): (Result<Vec<Notice>, ServiceError>, &str),
) {
    let made = made.unwrap_or_else(|error| {
        tracing::error!(%error, "a notice could not be written");
        Vec::new()
    });
    for (place, notice) in made.into_iter().enumerate() {
        let link = format!("{}{}", settings.page.trim_end_matches('/'), notice.link);
        let notice = Notice { id: format!("{id}.{place}"), at: service.now(), link, ..notice };
        if let Err(TrySendError::Full(notice)) = sender.try_send(notice) {
            tracing::warn!(title = notice.title, "too many notices wait: this one is left out");
        }
    }
}

/// What is to be told of an event.
async fn notice(
    service: &Service,
    settings: &NotifySettings,
    told: &mut Told,
    event: &Event,
) -> Result<Option<Notice>, ServiceError> {
    match &event.what {
        SystemChange::Job(_, JobChange::Finished(job)) => {
            if settings.wants(NoticeKind::Night) {
                told.ended.push(job.id.clone());
                // Jobs that go on ending put nothing off.
                told.look_at.get_or_insert_with(|| Instant::now() + QUIET);
            }
            match kind_of(job) {
                Some(kind) if tells(service, settings, kind) => of_job(service, job, kind).await,
                _ => Ok(None),
            }
        }
        SystemChange::Params(change) => {
            let system = event.system.to_string();
            let before = told.statuses.insert(system.clone(), change.status);
            let turned = (before != Some(change.status)).then(|| of_status(&system, change.status)).flatten();
            Ok(turned.filter(|notice| tells(service, settings, notice.event)))
        }
        SystemChange::Changed(seen) => {
            let system = event.system.to_string();
            let (title, message) = (format!("{system}: a parameter has changed"), seen.sentence.clone());
            let notice = about(&system, NoticeKind::Changed, title, message, "/parameters");
            Ok(Some(notice).filter(|notice| tells(service, settings, notice.event)))
        }
        SystemChange::Job(..) | SystemChange::State(_) => Ok(None),
    }
}

/// A notice about a system; the rest is filled in where it is known.
fn about(system: &str, event: NoticeKind, title: String, message: String, tab: &str) -> Notice {
    Notice {
        id: String::new(),
        event,
        at: jiff::Timestamp::UNIX_EPOCH,
        title,
        message,
        link: format!("/ui/systems/{system}{tab}"),
        system: Some(system.to_owned()),
        job: None,
        revision: None,
        batch: None,
    }
}

/// What is told of a job that has ended, if anything. An experiment changes nothing for anybody.
fn kind_of(job: &JobRecord) -> Option<NoticeKind> {
    match job.state.outcome() {
        _ if job.experiment => None,
        Some(Outcome::Accepted) => Some(NoticeKind::Published),
        Some(Outcome::Rejected) => Some(NoticeKind::Rejected),
        Some(Outcome::Held | Outcome::Suggested) => Some(NoticeKind::Held),
        Some(Outcome::Unchanged) => None,
        None => job.state.failure().map(|_| NoticeKind::Failed),
    }
}

/// The notice about a job. A fit of another model than the system's changes nothing either: it publishes
/// nothing, and nobody has to decide on it.
async fn of_job(
    service: &Service,
    job: &JobRecord,
    kind: NoticeKind,
) -> Result<Option<Notice>, ServiceError> {
    let system = job.system.to_string();
    let found = job.state.result().and_then(|result| result.found());
    let said = match (kind, found) {
        (NoticeKind::Rejected | NoticeKind::Held, Some(found)) => {
            store::fits::summary(&service.store, &found.id).await?
        }
        _ => None,
    };
    let notice = match kind {
        NoticeKind::Published => {
            let Some(revision) = found.and_then(|found| found.revision) else { return Ok(None) };
            let message = format!("{system} serves new parameters (revision {revision}).");
            let title = format!("{system}: new parameters");
            Notice { revision: Some(revision), ..about(&system, kind, title, message, "/parameters") }
        }
        NoticeKind::Failed => {
            let title = format!("{system}: {} failed", job.kind.as_str());
            let link = format!("/ui/jobs/{}", job.id);
            let message = job.state.failure().map(|failure| failure.detail.clone()).unwrap_or_default();
            Notice { link, ..about(&system, kind, title, message, "") }
        }
        _ => {
            let Some((summary, waits)) = said else { return Ok(None) };
            let what = match kind {
                NoticeKind::Rejected => "fit refused",
                _ if waits => "a fit waits for an operator",
                _ => return Ok(None),
            };
            about(&system, kind, format!("{system}: {what}"), summary, "/parameters")
        }
    };
    Ok(Some(Notice { job: Some(job.id.clone()), ..notice }))
}

/// Tells of the nights that have ended with the jobs that were seen to end. What the database keeps from
/// being told is not taken as told.
async fn nights(
    service: &Service,
    settings: &NotifySettings,
    sender: &Sender<Notice>,
    told: &mut Told,
) -> Result<(), ServiceError> {
    if !tells(service, settings, NoticeKind::Night) {
        told.ended.clear();
        return Ok(());
    }
    for id in store::batches::ended_with(&service.store, &told.ended).await? {
        if told.nights.contains(&id) {
            continue;
        }
        let batches = store::batches::get(&service.store, &id).await?.into_iter().collect();
        let night = Night { name: id.clone(), batches };
        let Some(report) = night::report(service, &SystemScope::ALL, night).await? else { continue };
        told.nights.push_back(id.clone());
        if told.nights.len() > REMEMBERED {
            told.nights.pop_front();
        }
        let title = format!("Lampyris: night of {}", night::day_of(report.at, &service.settings.zone));
        let link = format!("/ui/mornings/{id}");
        let notice = about("", NoticeKind::Night, title, report.summary, "");
        let notice = Notice { system: None, link, batch: Some(id.clone()), ..notice };
        hand_over(service, settings, sender, (Ok(vec![notice]), &format!("{id}.night")));
    }
    told.ended.clear();
    Ok(())
}

/// What is told of a status that has turned.
fn of_status(system: &str, status: Status) -> Option<Notice> {
    let (kind, tab, message) = match status {
        Status::Degraded => (NoticeKind::Degraded, "/fails", Status::CONTRADICTED),
        Status::Stale => (
            NoticeKind::Stale,
            "/data",
            "The parameters, or the measurements behind them, are older than the policy wants.",
        ),
        _ => return None,
    };
    Some(about(system, kind, format!("{system}: {}", status.as_str()), message.to_owned(), tab))
}

/// Delivers notices in their order.
async fn deliver(settings: &NotifySettings, mut waiting: Receiver<Notice>) {
    while let Some(notice) = waiting.recv().await {
        for attempt in 1..=TRIES {
            let (asked, told) = (settings.clone(), notice.clone());
            let Err(error) = apart("notify", move || post(&asked, &told)).await else {
                break;
            };
            tracing::warn!(%error, attempt, title = notice.title, "a notice could not be delivered");
            if attempt == TRIES {
                tracing::error!(title = notice.title, "a notice was given up");
            } else {
                tokio::time::sleep(FIRST_PAUSE * 2_u32.pow(attempt - 1)).await;
            }
        }
    }
}

/// Posts a notice. It blocks.
fn post(settings: &NotifySettings, notice: &Notice) -> Result<(), String> {
    let body = match settings.format {
        NoticeFormat::Json => serde_json::to_string(notice).map_err(|error| error.to_string())?,
        NoticeFormat::Ntfy => notice.message.clone(),
    };
    let mut request = agent(&settings.url, PATIENCE)?
        .post(&settings.url)
        .header("x-lampyris-event", notice.event.as_str())
        .header("x-lampyris-delivery", &notice.id);
    request = match settings.format {
        NoticeFormat::Json => request.header("content-type", "application/json"),
        NoticeFormat::Ntfy => {
            let titled =
                request.header("content-type", "text/plain; charset=utf-8").header("title", &notice.title);
            let bad = matches!(notice.event, NoticeKind::Degraded | NoticeKind::Failed);
            let titled = titled.header("tags", if bad { "warning" } else { "thermometer" });
            // A link that names no host leads nowhere from another program.
            if settings.page.is_empty() { titled } else { titled.header("click", &notice.link) }
        }
    };
    if let Some(signature) = signature(&settings.secret.0, body.as_bytes()) {
        request = request.header("x-lampyris-signature", format!("sha256={signature}"));
    }
    let status = request.send(body.as_str()).map_err(|error| error.to_string())?.status().as_u16();
    if (200..300).contains(&status) { Ok(()) } else { Err(format!("status {status}")) }
}

/// The HMAC-SHA256 of a body in hexadecimal digits, where there is a key.
fn signature(key: &str, body: &[u8]) -> Option<String> {
    if key.is_empty() {
        return None;
    }
    let mut mac = Hmac::<Sha256>::new_from_slice(key.as_bytes()).ok()?;
    mac.update(body);
    Some(mac.finalize().into_bytes().iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_is_signed_as_rfc_4231_says() {
        let signed = signature("Jefe", b"what do ya want for nothing?").unwrap();
        assert_eq!(signed, "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843");
        assert_eq!(signature("", b"x"), None);
    }
}
