//! Submits ordinary batches when a row says so. A tick that was missed while the service was down is made up
//! for once, however many there were.

use super::body::BatchSettings;
use super::request::{BatchRequest, read_batch};
use super::{retention, submit};
use crate::service::access::tokens::SERVICE;
use crate::service::decode::{self, Read};
use crate::service::error::{Refusal, ServiceError};
use crate::service::state::Service;
use crate::store;
use crate::store::batches::BatchKind;
use crate::store::jobs::Priority;
use crate::store::schedules::{NewSchedule, ScheduleRecord, TickResult};
use croner::Cron;
use jiff::civil::date;
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};
use lampyris_core::data::SystemPattern;
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::pin::pin;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;
use utoipa::ToSchema;

/// The schedule that every service starts with.
pub const NIGHTLY: &str = "nightly";
/// Every night at half past two.
const NIGHTLY_CRON: &str = "30 2 * * *";
/// Most bytes of a pattern of cron: every minute of an hour by name has fewer.
const LONGEST_CRON: usize = 256;
/// In so many years every day of the year has been every day of the week.
const YEARS: i64 = 28;
/// The longest sleep: after a jump of the clock nothing is later than this.
const LONGEST_SLEEP: Duration = Duration::from_secs(30);

/// A schedule, as its owner describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ScheduleBody)]
pub struct ScheduleDocument {
    /// When: five fields of cron.
    #[schema(example = "30 2 * * *")]
    pub cron: String,
    /// The IANA time zone of the pattern; that of the service by default.
    #[serde(default)]
    #[schema(example = "Europe/Copenhagen")]
    pub zone: Option<String>,
    /// What is done: estimates that are served where they are accepted, or diagnoses.
    #[serde(default = "BatchKind::usual")]
    pub kind: BatchKind,
    /// Whether it runs at all.
    #[serde(default = "yes")]
    pub enabled: bool,
    /// Which systems.
    #[schema(min_items = 1)]
    pub systems: Vec<SystemPattern>,
    /// What is asked of each, as in the body of a job.
    #[serde(default)]
    #[schema(value_type = BatchSettings)]
    pub request: Map<String, Value>,
}

fn yes() -> bool {
    true
}

/// A pattern of ticks in a time zone.
#[derive(Debug, Clone)]
pub struct Ticks {
    cron: Cron,
    zone: TimeZone,
}

impl Ticks {
    /// Reads a pattern.
    ///
    /// # Errors
    /// A fault for the pattern, the zone, or both.
    pub fn read(cron: &str, zone: &str) -> Result<Self, Vec<Fault>> {
        let shown = |text: &str| text.chars().take(60).collect::<String>().escape_debug().to_string();
        let invalid = |why: &str| {
            Fault::new("/cron", "invalid-cron", format!("`{}` is no cron pattern: {why}", shown(cron)))
                .suggest("such as `30 2 * * *`")
        };
        let parsed = if cron.len() > LONGEST_CRON {
            Err(invalid(&format!("it has more than {LONGEST_CRON} bytes")))
        } else if !(5..=6).contains(&cron.split_whitespace().count()) {
            Err(invalid("it has five fields, minute, hour, day, month, weekday, or seconds before them"))
        } else {
            Cron::from_str(cron).map_err(|error| invalid(&error.to_string())).and_then(|parsed| {
                if comes(cron) { Ok(parsed) } else { Err(invalid("no year has such a day")) }
            })
        };
        let zone = TimeZone::get(zone).map_err(|_| {
            Fault::new("/zone", "unknown-zone", format!("`{}` is no IANA time zone", shown(zone)))
                .suggest("such as `Europe/Copenhagen`")
        });
        match (parsed, zone) {
            (Ok(cron), Ok(zone)) => Ok(Self { cron, zone }),
            (cron, zone) => Err([cron.err(), zone.err()].into_iter().flatten().collect()),
        }
    }

    /// The pattern in words, such as `At 02:30.`
    pub fn in_words(&self) -> String {
        self.cron.describe()
    }

    /// The first tick after an instant. A local time that a clock change leaves out comes with the change;
    /// one that it repeats comes once.
    pub fn after(&self, instant: Timestamp) -> Option<Timestamp> {
        let local: Zoned = instant.to_zoned(self.zone.clone());
        self.cron.find_next_occurrence(&local, false).ok().map(|tick| tick.timestamp())
    }

    /// The next ticks after an instant.
    pub fn next(&self, instant: Timestamp, count: usize) -> Vec<Timestamp> {
        std::iter::successors(self.after(instant), |tick| self.after(*tick)).take(count).collect()
    }

    /// The newest tick in `(after, now]`.
    fn newest_due(&self, after: Timestamp, now: Timestamp) -> Option<Timestamp> {
        let local: Zoned = now.to_zoned(self.zone.clone());
        // The search backwards is inclusive, so a downtime of years costs one step and not thousands.
        let newest = self.cron.find_previous_occurrence(&local, true).ok().map(|tick| tick.timestamp())?;
        (newest > after).then_some(newest)
    }
}

/// Whether a pattern ever comes. The search for the next time of one that never does goes on for thousands of
/// years.
fn comes(cron: &str) -> bool {
    let fields: Vec<&str> = cron.split_whitespace().collect();
    let days = fields[fields.len().saturating_sub(3)..].join(" ");
    let Ok(midnights) = Cron::from_str(&format!("0 0 {days}")) else { return false };
    let mut day = date(2000, 1, 1);
    (0..YEARS * 366).any(|_| {
        let midnight = day.to_zoned(TimeZone::UTC);
        day = day.tomorrow().unwrap_or(day);
        midnight.is_ok_and(|midnight| midnights.is_time_matching(&midnight).unwrap_or(false))
    })
}

/// Reads a schedule and its request.
///
/// # Errors
/// Every fault of the name, the document and the request.
fn read(service: &Service, name: &str, body: Value) -> Result<(ScheduleDocument, BatchRequest), Vec<Fault>> {
    let Read { document, mut faults, .. } =
        decode::read::<ScheduleDocument>(body, &json!({ "cron": NIGHTLY_CRON, "systems": ["room/*"] }));
    if name.is_empty()
        || name.len() > 64
        || !name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-')
    {
        faults.push(Fault::new(
            "path",
            "invalid-name",
            "the name of a schedule is 1 to 64 letters, digits, `_` and `-`",
        ));
    }
    let Some(document) = document else {
        return Err(faults);
    };
    faults.extend(
        Ticks::read(&document.cron, document.zone.as_deref().unwrap_or(&service.settings.zone))
            .err()
            .into_iter()
            .flatten(),
    );
    let mut fields = document.request.clone();
    if fields.contains_key("systems") {
        faults.push(Fault::new("/request/systems", "unknown-field", "the systems stand beside the request"));
    }
    if fields.shift_remove("kind").is_some() {
        faults.push(Fault::new("/request/kind", "unknown-field", "the kind stands beside the request"));
    }
    fields.insert("systems".to_owned(), json!(document.systems));
    let within = |fault: Fault| {
        if fault.pointer.starts_with("/systems") {
            fault
        } else {
            Fault { pointer: format!("/request{}", fault.pointer), ..fault }
        }
    };
    match read_batch(document.kind, fields) {
        Ok(request) if faults.is_empty() => Ok((document, request)),
        other => {
            // A list of which every pattern was wrong is empty by now.
            let is_known = |fault: &Fault| {
                fault.pointer == "/systems"
                    && faults.iter().any(|known| known.pointer.starts_with("/systems"))
            };
            let more: Vec<Fault> =
                other.err().into_iter().flatten().filter(|fault| !is_known(fault)).map(within).collect();
            faults.extend(more);
            Err(faults)
        }
    }
}

/// The zone and the ticks that a schedule would have.
///
/// # Errors
/// Every fault of the name and the document.
pub fn preview(service: &Service, name: &str, body: Value) -> Result<(String, Ticks), ServiceError> {
    let (document, _) = read(service, name, body).map_err(ServiceError::Faults)?;
    let zone = document.zone.unwrap_or_else(|| service.settings.zone.clone());
    let ticks = Ticks::read(&document.cron, &zone).map_err(ServiceError::Faults)?;
    Ok((zone, ticks))
}

/// The systems that the document of a schedule selects, as far as it can be read.
pub fn selected(body: &Value) -> Vec<SystemPattern> {
    let texts = body["systems"].as_array().into_iter().flatten().filter_map(Value::as_str);
    texts.filter_map(|text| text.parse().ok()).collect()
}

/// Makes or replaces a schedule; says whether it is new.
///
/// # Errors
/// Every fault of the document, or where the database fails.
pub(crate) async fn put(service: &Service, name: &str, body: Value, who: &str) -> Result<bool, ServiceError> {
    let (document, request) = read(service, name, body).map_err(ServiceError::Faults)?;
    let zone = document.zone.as_deref().unwrap_or(&service.settings.zone);
    let request =
        serde_json::to_string(&request).map_err(|error| ServiceError::Internal(error.to_string()))?;
    let new = NewSchedule { name, cron: &document.cron, zone, request: &request, enabled: document.enabled };
    let is_new = store::schedules::put(&service.store, &new, who, service.now()).await?;
    service.wake_schedule.notify_one();
    Ok(is_new)
}

/// Deletes a schedule.
///
/// # Errors
/// Where it is part of the service, there is none, or the database fails.
pub(crate) async fn delete(service: &Service, name: &str, who: &str) -> Result<(), ServiceError> {
    if name == NIGHTLY {
        let detail = "the nightly schedule is part of the service: put it with `\"enabled\": false` instead";
        return Err(Refusal::new("schedule-not-removable", detail).into());
    }
    if !store::schedules::delete(&service.store, name, who, service.now()).await? {
        return Err(ServiceError::NotFound("schedule", name.to_owned()));
    }
    service.wake_schedule.notify_one();
    Ok(())
}

/// Makes the nightly schedule where there is none. One that an operator has changed stays as it is.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn ensure_nightly(service: &Service) -> Result<(), ServiceError> {
    if store::schedules::get(&service.store, NIGHTLY).await?.is_none() {
        put(service, NIGHTLY, json!({ "cron": NIGHTLY_CRON, "systems": ["room/*"] }), SERVICE).await?;
    }
    Ok(())
}

/// What a schedule submits.
///
/// # Errors
/// Where the row holds something else.
pub fn request(schedule: &ScheduleRecord) -> Result<BatchRequest, ServiceError> {
    serde_json::from_value(schedule.request.clone())
        .map_err(|error| ServiceError::Internal(format!("schedule {}: {error}", schedule.name)))
}

/// Deals with ticks until the service stops.
pub(crate) async fn run(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    while !*stopping.borrow_and_update() {
        let mut woken = pin!(service.wake_schedule.notified());
        woken.as_mut().enable();
        let pause = match due_here(&service).await {
            Ok(pause) => pause,
            Err(error) => {
                tracing::error!(%error, "the schedules could not be run");
                LONGEST_SLEEP
            }
        };
        tokio::select! {
            () = woken => {}
            () = tokio::time::sleep(pause) => {}
            _ = stopping.changed() => {}
        }
    }
}

async fn due_here(service: &Service) -> Result<Duration, ServiceError> {
    if service.membership.leads() { due(service, service.now()).await } else { Ok(LONGEST_SLEEP) }
}

/// Runs what is due, and says how long nothing will be.
///
/// # Errors
/// Where the database fails.
pub async fn due(service: &Service, now: Timestamp) -> Result<Duration, ServiceError> {
    let mut pause = LONGEST_SLEEP;
    match store::entering::go_on_with_all(&service.store, now).await {
        Ok(0) => {}
        Ok(_) => submit::entered(service),
        // No schedule waits for a batch on whose way somebody has died.
        Err(error) => {
            let error = ServiceError::from(error);
            tracing::error!(%error, "batches that were begun could not be gone on with");
        }
    }
    for schedule in
        store::schedules::all(&service.store).await?.into_iter().filter(|schedule| schedule.enabled)
    {
        let Ok(ticks) = Ticks::read(&schedule.cron, &schedule.zone) else {
            tracing::error!(
                schedule = schedule.name,
                "the pattern or the zone of a stored schedule cannot be read"
            );
            continue;
        };
        if let Some(tick) = ticks.newest_due(schedule.last_tick_at, now)
            && let Err(error) = run_tick(service, &schedule, tick, now).await
        {
            // The tick is still due, and the other schedules do not wait for it.
            tracing::error!(%error, schedule = schedule.name, "a tick could not be dealt with");
        }
        if let Some(next) = ticks.after(now) {
            pause = pause.min(next.duration_since(now).unsigned_abs());
        }
    }
    Ok(pause.max(Duration::from_millis(10)))
}

async fn run_tick(
    service: &Service,
    schedule: &ScheduleRecord,
    tick: Timestamp,
    now: Timestamp,
) -> Result<(), ServiceError> {
    let request = request(schedule)?;
    let mut batch = submit::batch(service, &request, Some(&schedule.name), Priority::Nightly).await?;
    submit::leave_out_answered(service, &mut batch).await?;
    let limit = service.queue_limit();
    let Some(result) =
        store::schedules::tick(&service.store, &schedule.name, tick, &batch, limit, now).await?
    else {
        return Ok(());
    };
    tracing::info!(
        schedule = schedule.name,
        %tick,
        jobs = batch.jobs.len(),
        skipped = batch.skipped.len(),
        "tick: {}",
        result.as_str()
    );
    if result == TickResult::Submitted {
        submit::entered(service);
    }
    if schedule.name == NIGHTLY {
        retention::forget(service, now).await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instant(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    #[test]
    fn half_past_two_happens_once_on_both_days_of_the_clock_change() {
        let ticks = Ticks::read(NIGHTLY_CRON, "Europe/Copenhagen").unwrap();
        // 2026-03-29 02:30 does not exist, 2026-10-25 02:30 exists twice.
        let spring = ticks.next(instant("2026-03-28T12:00:00Z"), 2);
        assert_eq!(spring, [instant("2026-03-29T01:00:00Z"), instant("2026-03-30T00:30:00Z")]);
        let autumn = ticks.next(instant("2026-10-24T12:00:00Z"), 2);
        assert_eq!(autumn, [instant("2026-10-25T00:30:00Z"), instant("2026-10-26T01:30:00Z")]);
    }

    #[test]
    fn many_missed_ticks_are_one() {
        let ticks = Ticks::read("*/5 * * * *", "UTC").unwrap();
        let (before, now) = (instant("2026-01-01T00:00:00Z"), instant("2026-01-03T12:02:00Z"));
        assert_eq!(ticks.newest_due(before, now), Some(instant("2026-01-03T12:00:00Z")));
        assert_eq!(ticks.newest_due(instant("2026-01-03T12:00:00Z"), now), None);
        assert_eq!(
            ticks.newest_due(before, instant("2026-01-01T00:05:00Z")),
            Some(instant("2026-01-01T00:05:00Z"))
        );
    }

    #[test]
    fn patterns_are_said_in_words() {
        let words = |cron: &str| Ticks::read(cron, "UTC").unwrap().in_words();
        let said = ["30 2 * * *", "0 5 * * 1", "*/15 6-20 * * *", "0 4 1 * *"].map(words);
        assert_eq!(
            said,
            [
                "At 02:30.",
                "At 05:00, on Monday.",
                "At every 15 minutes, of hour 6-20.",
                "At 04:00, on day 1."
            ]
        );
    }

    #[test]
    fn all_faults_of_a_pattern_are_listed() {
        let faults = Ticks::read("61 * * * *", "Mars/Olympus").unwrap_err();
        assert_eq!(faults.iter().map(|fault| fault.pointer.as_str()).collect::<Vec<_>>(), ["/cron", "/zone"]);
    }
}
