//! The snapshot behind `/params`: finished bodies with their tags, swapped in after the commit.
//!
//! A handler takes the body that is there: no SQL, no lock, no encoding. One function, [`refresh`], makes an
//! entry from the database, whatever the reason; bodies therefore change at events only, and the turn to
//! `stale` is an event that [`keep_fresh`] makes.

use super::systems::{SystemDocument, document};
use super::{JobsError, Service, blocking, now};
use crate::data::SystemId;
use crate::estimate::served::ServedError;
use crate::model::{Catalogue, ModelId, Nominal};
use crate::store::jobs::JobState;
use crate::store::params::{FallbackRecord, RevisionRecord, Standing, standing, standings};
use arc_swap::ArcSwap;
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use serde_json::Value;
use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, Notify, watch};
use utoipa::ToSchema;

/// The longest sleep of the timer: after a jump of the clock nothing is later than this.
const LONGEST_SLEEP: Duration = Duration::from_secs(30);

/// What `/params` serves, by the name of the system (`room/4`).
#[derive(Debug, Default)]
pub struct Snapshot {
    slots: ArcSwap<HashMap<String, Arc<Slot>>>,
    /// Entries are read from the database and swapped in by one at a time, so that an older one never comes last.
    refreshing: Mutex<()>,
    /// Told when an entry may turn stale earlier than the timer expects.
    retime: Notify,
}

/// The place of one system. It stays; its entry is swapped.
#[derive(Debug)]
pub struct Slot {
    entry: ArcSwap<Entry>,
    changed: watch::Sender<()>,
}

/// What is served for one system.
#[derive(Debug)]
pub struct Entry {
    /// The parameters, or why there are none.
    pub answer: Answer,
    /// When the status turns to `stale`.
    turns_stale: Option<Timestamp>,
}

/// The parameters, or why there are none.
#[derive(Debug)]
pub enum Answer {
    /// A revision.
    Validated(Rendered),
    /// No fit was ever accepted.
    NeverValidated {
        /// The newest job.
        latest_job: Option<(String, JobState)>,
        /// The nominal values of the model, for those who accept them.
        nominal: Option<Rendered>,
    },
}

/// A finished body.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// JSON.
    pub body: Arc<[u8]>,
    /// A strong tag: the quoted hash of the body.
    pub etag: Arc<str>,
    /// The status that the body tells.
    pub status: Status,
    /// The revision, if it is one.
    pub revision: Option<i64>,
}

/// How much a controller may trust what is served.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = ParamsStatus)]
pub enum Status {
    /// Validated, and not long ago.
    Fresh,
    /// Validated, but longer ago than the policy wants.
    Stale,
    /// Validated; a newer attempt failed.
    Fallback,
    /// Never validated: the nominal values of the model.
    Nominal,
}

impl Status {
    /// The word in the body and in the header `Params-Status`.
    pub const fn word(self) -> &'static str {
        match self {
            Status::Fresh => "fresh",
            Status::Stale => "stale",
            Status::Fallback => "fallback",
            Status::Nominal => "nominal",
        }
    }
}

/// The parameters of a system, as a controller reads them.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Params)]
pub struct Body {
    /// The system.
    system: SystemId,
    /// Counts up by one with every set that is published.
    revision: Option<i64>,
    /// The fit behind it.
    fit: Option<String>,
    /// How much to trust it.
    status: Status,
    /// The model.
    #[schema(value_type = ModelId)]
    model: Value,
    /// Values by name.
    #[schema(value_type = HashMap<String, Option<f64>>)]
    parameters: Value,
    /// Units by name.
    #[schema(value_type = HashMap<String, String>)]
    units: Value,
    /// 95 % confidence intervals by name; `null` where the data do not determine one.
    #[schema(value_type = HashMap<String, Option<[f64; 2]>>)]
    ci95: Value,
    /// What the gate wants said.
    #[schema(value_type = Vec<String>)]
    flags: Value,
    /// Errors by output channel.
    #[schema(value_type = HashMap<String, ServedError>)]
    error: Value,
    /// When it was found.
    #[schema(value_type = Option<String>, format = DateTime)]
    fitted_at: Option<Timestamp>,
    /// When the gate last found it fit to be served.
    #[schema(value_type = Option<String>, format = DateTime)]
    validated_at: Option<Timestamp>,
    /// The measurements behind it.
    window: Option<Span>,
    /// The job that found it.
    job: Option<String>,
    /// When the status turns to `stale`.
    #[schema(value_type = Option<String>, format = DateTime)]
    stale_after: Option<Timestamp>,
    /// Why it is not newer.
    fallback: Option<Fallback>,
}

/// A stretch of time.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ParamsWindow)]
pub struct Span {
    /// First instant.
    #[schema(format = DateTime)]
    from: String,
    /// Last instant.
    #[schema(format = DateTime)]
    to: String,
}

/// Why a newer attempt is not served.
#[derive(Debug, Serialize, ToSchema)]
pub struct Fallback {
    /// `validation_failed` or `job_failed`.
    reason: &'static str,
    /// The job behind it.
    job: String,
    /// The fit that was refused.
    fit: Option<String>,
    /// What it failed.
    failed_checks: Vec<String>,
    /// Since when no attempt has succeeded.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
}

impl Snapshot {
    /// The slot of a system, if there is such a system.
    pub fn slot(&self, system: &str) -> Option<Arc<Slot>> {
        self.slots.load().get(system).cloned()
    }

    /// The entry of a system, if there is such a system.
    pub fn entry(&self, system: &str) -> Option<Arc<Entry>> {
        self.slots.load().get(system).map(|slot| slot.entry.load_full())
    }

    /// All systems with their entries, by name.
    pub fn all(&self) -> Vec<(String, Arc<Entry>)> {
        let mut all: Vec<_> = self.slots.load().iter().map(|(system, slot)| (system.clone(), slot.entry.load_full())).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0));
        all
    }

    /// Swaps an entry in, and wakes those who wait for it if it is another one.
    fn swap(&self, system: &SystemId, entry: Entry) {
        let name = system.to_string();
        self.retime.notify_one();
        match self.slot(&name) {
            Some(slot) => {
                let is_news = !slot.entry.load().says_the_same(&entry);
                slot.entry.store(Arc::new(entry));
                if is_news {
                    slot.changed.send_replace(());
                }
            }
            None => {
                let slot = Arc::new(Slot { entry: ArcSwap::from_pointee(entry), changed: watch::Sender::new(()) });
                self.slots.rcu(|slots| {
                    let mut more = HashMap::clone(slots);
                    more.insert(name.clone(), slot.clone());
                    more
                });
            }
        }
    }
}

impl Slot {
    /// What is served now.
    pub fn entry(&self) -> Arc<Entry> {
        self.entry.load_full()
    }

    /// Changes from now on.
    pub fn watch(&self) -> watch::Receiver<()> {
        self.changed.subscribe()
    }
}

impl Entry {
    fn says_the_same(&self, other: &Entry) -> bool {
        match (&self.answer, &other.answer) {
            (Answer::Validated(mine), Answer::Validated(theirs)) => mine.etag == theirs.etag,
            (Answer::NeverValidated { latest_job: mine, .. }, Answer::NeverValidated { latest_job: theirs, .. }) => mine == theirs,
            _ => false,
        }
    }

    /// The revision that is served, if there is one.
    pub fn validated(&self) -> Option<&Rendered> {
        match &self.answer {
            Answer::Validated(rendered) => Some(rendered),
            Answer::NeverValidated { .. } => None,
        }
    }
}

/// Makes the entry of a system anew. To be called after every commit that may change it.
///
/// # Errors
/// Where the database fails.
pub async fn refresh(service: &Service, system: &SystemId) -> Result<(), JobsError> {
    let _one_at_a_time = service.params.refreshing.lock().await;
    if let Some(standing) = standing(&service.store, system).await? {
        let entry = entry(service, standing).await?;
        service.params.swap(system, entry);
    }
    Ok(())
}

/// Makes all entries: at start, before anybody can ask.
///
/// # Errors
/// Where the database fails.
pub async fn load_all(service: &Service) -> Result<(), JobsError> {
    let _one_at_a_time = service.params.refreshing.lock().await;
    for standing in standings(&service.store).await? {
        let system = standing.system.clone();
        let entry = entry(service, standing).await?;
        service.params.swap(&system, entry);
    }
    Ok(())
}

/// Publishes the turn to `stale` when its time has come, until the service stops.
pub async fn keep_fresh(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        let mut retimed = pin!(service.params.retime.notified());
        retimed.as_mut().enable();
        let now = now();
        let mut next = LONGEST_SLEEP;
        for (system, entry) in service.params.all() {
            match entry.turns_stale.map(|turn| turn.duration_since(now)) {
                Some(left) if left <= SignedDuration::ZERO => {
                    let turned = match system.parse() {
                        Ok(system) => refresh(&service, &system).await.map_err(|error| error.to_string()),
                        Err(error) => Err(error.to_string()),
                    };
                    if let Err(error) = turned {
                        tracing::error!(error, system, "the turn to stale could not be published");
                    }
                }
                Some(left) => next = next.min(left.unsigned_abs().max(Duration::from_millis(10))),
                None => {}
            }
        }
        tokio::select! {
            () = retimed => {}
            () = tokio::time::sleep(next) => {}
            _ = stopping.changed() => {}
        }
    }
}

async fn entry(service: &Service, standing: Standing) -> Result<Entry, JobsError> {
    let document = document(&standing.document)?;
    match standing.revision {
        Some(revision) => validated(standing.system, revision, standing.fallback, &document, now()),
        None => {
            let catalogue = service.catalogue.current();
            let system = standing.system;
            let nominal = blocking(move || nominal(system, &document, &catalogue)).await??;
            Ok(Entry { answer: Answer::NeverValidated { latest_job: standing.latest_job, nominal }, turns_stale: None })
        }
    }
}

fn validated(
    system: SystemId,
    revision: RevisionRecord,
    fallback: Option<FallbackRecord>,
    document: &SystemDocument,
    now: Timestamp,
) -> Result<Entry, JobsError> {
    let fresh_for = SignedDuration::from_secs(document.policy.stale_after.seconds());
    // A sum beyond the end of time never comes.
    let stale_after = revision.validated_at.checked_add(fresh_for).unwrap_or(Timestamp::MAX);
    // A stale set stays stale however the newest attempt went; the fallback object still tells of that.
    let status = if now >= stale_after {
        Status::Stale
    } else if fallback.is_some() {
        Status::Fallback
    } else {
        Status::Fresh
    };
    let mut served = revision.served;
    let mut take = |field: &str| served.get_mut(field).map(Value::take).unwrap_or_default();
    let body = Body {
        system,
        revision: Some(revision.revision),
        fit: Some(revision.fit),
        status,
        model: take("model"),
        parameters: take("parameters"),
        units: take("units"),
        ci95: take("ci95"),
        flags: take("flags"),
        error: take("error"),
        fitted_at: Some(revision.fitted_at),
        validated_at: Some(revision.validated_at),
        window: Some(Span { from: revision.window_from, to: revision.window_to }),
        job: Some(revision.job),
        stale_after: Some(stale_after),
        fallback: fallback.map(|fallback| Fallback {
            reason: fallback.reason.word(),
            job: fallback.job,
            fit: fallback.fit,
            failed_checks: fallback.failed_checks,
            since: fallback.since,
        }),
    };
    let turns_stale = (status != Status::Stale).then_some(stale_after);
    Ok(Entry { answer: Answer::Validated(render(&body)?), turns_stale })
}

/// The nominal values of the system's model, with `null` where only measurements give one; nothing where the
/// model no longer compiles.
fn nominal(system: SystemId, document: &SystemDocument, catalogue: &Catalogue) -> Result<Option<Rendered>, JobsError> {
    let Ok(model) = document.bindings(catalogue, &document.model) else {
        return Ok(None);
    };
    let value = |nominal: &Nominal| match nominal {
        Nominal::Value(value) => Value::from(*value),
        Nominal::Measured(_) => Value::Null,
    };
    let named = |of: &dyn Fn(&crate::model::Parameter) -> Value| -> Value {
        Value::Object(model.parameters().iter().map(|parameter| (parameter.name.clone(), of(parameter))).collect())
    };
    let body = Body {
        system,
        revision: None,
        fit: None,
        status: Status::Nominal,
        model: Value::from(document.model.to_string()),
        parameters: named(&|parameter| value(&parameter.nominal)),
        units: named(&|parameter| Value::from(parameter.unit.clone())),
        ci95: named(&|_| Value::Null),
        flags: Value::Array(Vec::new()),
        error: Value::Object(serde_json::Map::new()),
        fitted_at: None,
        validated_at: None,
        window: None,
        job: None,
        stale_after: None,
        fallback: None,
    };
    render(&body).map(Some)
}

fn render(body: &Body) -> Result<Rendered, JobsError> {
    let text = serde_json::to_vec(body).map_err(|error| JobsError::Internal(error.to_string()))?;
    let etag = format!("\"{}\"", &blake3::hash(&text).to_hex()[..32]);
    Ok(Rendered { body: text.into(), etag: etag.into(), status: body.status, revision: body.revision })
}
