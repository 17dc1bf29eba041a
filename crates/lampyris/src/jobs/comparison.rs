//! Fits beside the measurements: what is asked, what it depends on, and what is read for it. The work is done on the
//! interactive threads.

use super::chart;
use super::input::{self, Measurements};
use super::interactive::Answer;
use super::systems::{self, NEIGHBOURS, SystemDocument};
use super::windows::Format;
use super::{JobsError, Service};
use crate::store;
use crate::store::fits::FitRecord;
use crate::store::reach::Reach;
use lampyris_core::data::{Duration, SystemId, Window, read_time, rfc3339};
use lampyris_core::estimate::assess::compare::{Contender, compare};
use lampyris_core::estimate::assess::comparison::{Mode, comparison};
use lampyris_core::estimate::assess::metrics::lead;
use lampyris_core::estimate::assess::replay::{basis, window_of};
use lampyris_core::estimate::{Fit, Replay};
use lampyris_core::fault::Fault;
use lampyris_core::model::{Catalogue, ModelId};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Most fits beside each other.
pub const MOST_FITS: usize = 8;

/// What is to be shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked {
    /// How far ahead the model forecasts; `None` is the free run.
    pub horizon: Option<Duration>,
    /// From this instant on, in seconds; by default from the start of the fit's window.
    pub from: Option<i64>,
    /// To this instant; by default to the end of the fit's window.
    pub to: Option<i64>,
    /// Most points of a line.
    pub max_points: usize,
    /// How the answer is written.
    pub format: Format,
}

/// A fit with the names under which it is shown.
#[derive(Debug, Clone, Copy)]
pub struct Named<'a> {
    /// Its id.
    pub id: &'a str,
    /// The system, or what stands for it where there is none.
    pub system: &'a str,
    /// What was found.
    pub fit: &'a Fit,
}

/// A stored fit with what is needed to run it again.
pub(super) struct Subject {
    record: FitRecord,
    measurements: Measurements,
    catalogue: Arc<Catalogue>,
}

/// A fit beside the measurements.
///
/// # Errors
/// Where there is no such fit, it cannot be run again, or there is nothing in the range.
pub async fn one(service: &Service, id: &str, asked: &Asked) -> Result<Answer, JobsError> {
    let record = require(service, id).await?;
    let (from, to) = range(asked, &[&record.fit])?;
    checked(asked, &[&record.fit])?;
    let key = key(service, "comparison", &[&record], &format!("{asked:?}")).await?;
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let asked = *asked;
    let subject = subject(service, record, to).await?;
    let work = move || {
        let replay = subject.replay(&subject.window()?, Some(to))?;
        let system = subject.record.system.to_string();
        document(&subject.named(&system), &replay, &Asked { from: Some(from), to: Some(to), ..asked })
    };
    service.interactive.answer(&key, work).await
}

/// A fit that was run again beside the measurements, over all of the run where no range is asked for. This is work for the CPU pool.
///
/// # Errors
/// Where there is nothing in the range.
pub fn document(named: &Named<'_>, replay: &Replay, asked: &Asked) -> Result<Vec<u8>, JobsError> {
    let (start, end) = window_of(named.fit).map_err(JobsError::Faults)?;
    let mode = match asked.horizon.and_then(|horizon| lead(horizon.seconds(), named.fit.sample_s)) {
        Some(lead) => Mode::Ahead(lead),
        None => Mode::FreeRun,
    };
    let comparison = comparison(replay, mode, asked.from.unwrap_or(start), asked.to.unwrap_or(end)).map_err(JobsError::Faults)?;
    match asked.format {
        Format::Json => chart::comparison_json(named, asked, replay, &comparison),
        Format::Csv => chart::comparison_csv(asked, &comparison),
    }
}

/// Several fits of one system beside each other and the measurements.
///
/// # Errors
/// All unknown fits at once, fits of different systems, and as [`one`].
pub async fn several(service: &Service, reach: &Reach, ids: &[String], asked: &Asked) -> Result<Answer, JobsError> {
    let mut records = Vec::new();
    let mut faults = Vec::new();
    for id in ids {
        match store::fits::get(&service.store, id).await? {
            Some(record) if reach.covers(&record.system) => records.push(record),
            _ => faults.push(Fault::new("query fits", "fit-not-found", format!("there is no fit `{}`", short(id)))),
        }
    }
    if let Some((first, others)) = records.split_first() {
        for other in others.iter().filter(|other| other.system != first.system) {
            let detail = format!("{} is a fit of {}, but {} is one of {}", other.id, other.system, first.id, first.system);
            faults.push(Fault::new("query fits", "different-systems", detail).suggest("compare fits of one system"));
        }
    }
    if !faults.is_empty() {
        return Err(JobsError::Faults(faults));
    }
    let fits: Vec<&Fit> = records.iter().map(|record| &record.fit).collect();
    let (from, to) = range(asked, &fits)?;
    checked(asked, &fits)?;
    let key = key(service, "compare", &records.iter().collect::<Vec<_>>(), &format!("{asked:?}")).await?;
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let asked = *asked;
    let mut subjects = Vec::new();
    for record in records {
        subjects.push(subject(service, record, to).await?);
    }
    let work = move || {
        let replays = subjects.iter().map(|subject| subject.replay(&subject.window()?, Some(to))).collect::<Result<Vec<_>, _>>()?;
        let contenders: Vec<Contender<'_>> =
            subjects.iter().zip(&replays).map(|(subject, replay)| Contender { id: &subject.record.id, replay }).collect();
        let compared = compare(&contenders, asked.horizon, from, to).map_err(JobsError::Faults)?;
        match asked.format {
            Format::Json => chart::compared_json(&subjects, &asked, &replays, &compared),
            Format::Csv => chart::compared_csv(&asked, &compared),
        }
    };
    service.interactive.answer(&key, work).await
}

/// The fit that must be there.
pub(super) async fn require(service: &Service, id: &str) -> Result<FitRecord, JobsError> {
    store::fits::get(&service.store, id).await?.ok_or_else(|| JobsError::NotFound("fit", id.to_owned()))
}

/// A name for everything that an answer about fits depends on: they and the models do not change, but the
/// measurements and the system do.
pub(super) async fn key(service: &Service, what: &str, records: &[&FitRecord], asked: &str) -> Result<String, JobsError> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(what.as_bytes()).update(b"\n").update(asked.as_bytes());
    for record in records {
        hasher.update(b"\n").update(record.id.as_bytes());
        let system =
            store::systems::get(&service.store, &record.system).await?.ok_or_else(|| JobsError::NoSystem(record.system.clone()))?;
        hasher.update(b"\n").update(system.document.as_bytes());
        let document = systems::document(&system.document)?;
        for system in std::iter::once(record.system.clone()).chain(next_door(record, &document)) {
            let (windows, newest) = store::windows::version(&service.store, &system).await?;
            hasher.update(format!("\n{system} {windows} {newest}").as_bytes());
        }
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// Reads what is needed to run a fit again from its start to `until` at least.
pub(super) async fn subject(service: &Service, record: FitRecord, until: i64) -> Result<Subject, JobsError> {
    let document = systems::require(service, &record.system).await?;
    let basis = basis(&record.fit).map_err(JobsError::Faults)?;
    let instant = |text: &str| read_time("/basis", text).map_err(|fault| JobsError::Internal(fault.to_string()));
    let range = (instant(&basis.from)?, instant(&basis.to)?.max(until));
    let next_door = next_door(&record, &document);
    let measurements = input::measurements(service, &record.system, &next_door, &document.exclude, range).await?;
    Ok(Subject { record, measurements, catalogue: service.catalogue.current() })
}

/// The neighbours that a fit was made with, even if the system has others by now.
fn next_door(record: &FitRecord, document: &SystemDocument) -> Vec<SystemId> {
    let members = record.fit.basis.iter().filter_map(|basis| basis.sets.get(NEIGHBOURS)).flatten();
    let named = |member: &String| {
        let known = document.neighbours.iter().find(|neighbour| neighbour.id() == member).cloned();
        known.or_else(|| SystemId::new(record.system.kind(), member).ok())
    };
    members.filter_map(named).collect()
}

impl Subject {
    /// The fit.
    pub(super) fn fit(&self) -> &Fit {
        &self.record.fit
    }

    /// The fit with its name and its system.
    pub(super) fn record(&self) -> &FitRecord {
        &self.record
    }

    /// The fit as it is shown; its system as a text.
    pub(super) fn named<'a>(&'a self, system: &'a str) -> Named<'a> {
        Named { id: &self.record.id, system, fit: &self.record.fit }
    }

    /// All that was measured. This is work for the CPU pool.
    pub(super) fn window(&self) -> Result<Window, JobsError> {
        let model: ModelId = self.fit().model.parse().map_err(|error| JobsError::Internal(format!("{error}")))?;
        self.measurements.window(&self.catalogue, &model)
    }

    /// Runs the fit again. This is work for the CPU pool.
    pub(super) fn replay(&self, window: &Window, until: Option<i64>) -> Result<Replay, JobsError> {
        Replay::new(&self.catalogue, self.fit(), window, until).map_err(JobsError::Faults)
    }
}

/// The range that is shown: by default from the latest start of a fit's window to the latest end of one, so that
/// all fits have something to say about all of it.
fn range(asked: &Asked, fits: &[&Fit]) -> Result<(i64, i64), JobsError> {
    let (mut start, mut end) = (i64::MIN, i64::MIN);
    for fit in fits {
        let (first, last) = window_of(fit).map_err(JobsError::Faults)?;
        (start, end) = (start.max(first), end.max(last));
    }
    // A range may begin where no fit has begun yet; what is shown begins with the last of them.
    Ok((asked.from.unwrap_or(start).max(start), asked.to.unwrap_or(end)))
}

/// What only the fits can say about a question.
fn checked(asked: &Asked, fits: &[&Fit]) -> Result<(), JobsError> {
    let mut faults = Vec::new();
    let (start, _) = range(asked, fits)?;
    if let Some(to) = asked.to.filter(|to| *to < start) {
        let detail = format!("the runs begin at {}, after {}", rfc3339(start), rfc3339(to));
        faults.push(Fault::new("query to", "before-the-fit", detail).suggest("a fit says nothing about the time before its window"));
    }
    if let Some(horizon) = asked.horizon {
        let steps: BTreeSet<i64> = fits.iter().map(|fit| fit.sample_s).collect();
        for step in steps.into_iter().filter(|step| horizon.seconds() % step != 0) {
            let detail = format!("{horizon} is no multiple of the {step} s between the samples of the fit");
            faults.push(Fault::new("query horizon", "no-multiple", detail));
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(JobsError::Faults(faults)) }
}

fn short(text: &str) -> String {
    text.chars().take(40).collect::<String>().escape_debug().to_string()
}
