//! Fits beside the measurements: what is asked, what it depends on, and what is read for it. The work is done
//! on the interactive threads.

use super::chart;
use super::subject::{ComparisonAsked, NamedFit, key, load, require};
use crate::service::catalogue::windows::Format;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::interactive::RenderedAnswer;
use crate::store;
use crate::store::reach::SystemScope;
use lampyris_core::data::{Seconds, rfc3339};
use lampyris_core::estimate::assess::compare::{Contender, compare};
use lampyris_core::estimate::assess::comparison::{ComparisonMode, comparison};
use lampyris_core::estimate::assess::metrics::lead;
use lampyris_core::estimate::assess::replay::window_of;
use lampyris_core::estimate::{Fit, Replay};
use lampyris_core::fault::Fault;
use lampyris_core::interrupt::Brake;
use std::collections::BTreeSet;

/// Most fits beside each other.
pub const MOST_FITS: usize = 8;

/// A fit beside the measurements.
///
/// # Errors
/// Where there is no such fit, it cannot be run again, or there is nothing in the range.
pub(crate) async fn one(
    service: &Service,
    id: &str,
    asked: &ComparisonAsked,
) -> Result<RenderedAnswer, ServiceError> {
    let record = require(service, id).await?;
    let (from, to) = range(asked, &[&record.fit])?;
    checked(asked, &[&record.fit])?;
    let key = key(service, "comparison", &[&record], &format!("{asked:?}")).await?;
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let asked = *asked;
    let subject = load(service, record, to).await?;
    let work = move |brake: &Brake| {
        let replay = subject.replay(&subject.window()?, Some(to), brake)?;
        let system = subject.record().system.to_string();
        document(
            &subject.named(&system),
            &replay,
            &ComparisonAsked { from: Some(from), to: Some(to), ..asked },
        )
    };
    service.interactive.answer(&key, work).await
}

/// A fit that was run again beside the measurements, over all of the run where no range is asked for. This is
/// work for the CPU pool.
///
/// # Errors
/// Where there is nothing in the range.
pub fn document(
    named: &NamedFit<'_>,
    replay: &Replay,
    asked: &ComparisonAsked,
) -> Result<Vec<u8>, ServiceError> {
    let (start, end) = window_of(named.fit).map_err(ServiceError::Faults)?;
    let mode = match asked.horizon.and_then(|horizon| lead(horizon.millis(), named.fit.sample_s.millis())) {
        Some(lead) => ComparisonMode::Ahead(lead),
        None => ComparisonMode::FreeRun,
    };
    let comparison = comparison(replay, mode, asked.from.unwrap_or(start), asked.to.unwrap_or(end))
        .map_err(ServiceError::Faults)?;
    match asked.format {
        Format::Json => chart::comparison_json(named, asked, replay, &comparison),
        Format::Csv => chart::comparison_csv(asked, &comparison),
    }
}

/// Several fits of one system beside each other and the measurements.
///
/// # Errors
/// All unknown fits at once, fits of different systems, and as [`one`].
pub(crate) async fn several(
    service: &Service,
    reach: &SystemScope,
    ids: &[String],
    asked: &ComparisonAsked,
) -> Result<RenderedAnswer, ServiceError> {
    let mut records = Vec::new();
    let mut faults = Vec::new();
    for id in ids {
        match store::fits::get(&service.store, id).await? {
            Some(record) if reach.covers(&record.system) => records.push(record),
            _ => faults.push(Fault::new(
                "query fits",
                "fit-not-found",
                format!("there is no fit `{}`", short(id)),
            )),
        }
    }
    if let Some((first, others)) = records.split_first() {
        for other in others.iter().filter(|other| other.system != first.system) {
            let detail = format!(
                "{} is a fit of {}, but {} is one of {}",
                other.id, other.system, first.id, first.system
            );
            faults.push(
                Fault::new("query fits", "different-systems", detail).suggest("compare fits of one system"),
            );
        }
    }
    if !faults.is_empty() {
        return Err(ServiceError::Faults(faults));
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
        subjects.push(load(service, record, to).await?);
    }
    let work = move |brake: &Brake| {
        let replays = subjects
            .iter()
            .map(|subject| subject.replay(&subject.window()?, Some(to), brake))
            .collect::<Result<Vec<_>, _>>()?;
        let contenders: Vec<Contender<'_>> = subjects
            .iter()
            .zip(&replays)
            .map(|(subject, replay)| Contender { id: &subject.record().id, replay })
            .collect();
        let compared = compare(&contenders, asked.horizon, from, to).map_err(ServiceError::Faults)?;
        match asked.format {
            Format::Json => chart::compared_json(&subjects, &asked, &replays, &compared),
            Format::Csv => chart::compared_csv(&asked, &compared),
        }
    };
    service.interactive.answer(&key, work).await
}

/// The range that is shown: by default from the latest start of a fit's window to the latest end of one, so
/// that all fits have something to say about all of it.
fn range(asked: &ComparisonAsked, fits: &[&Fit]) -> Result<(i64, i64), ServiceError> {
    let (mut start, mut end) = (i64::MIN, i64::MIN);
    for fit in fits {
        let (first, last) = window_of(fit).map_err(ServiceError::Faults)?;
        (start, end) = (start.max(first), end.max(last));
    }
    // A range may begin where no fit has begun yet; what is shown begins with the last of them.
    Ok((asked.from.unwrap_or(start).max(start), asked.to.unwrap_or(end)))
}

/// What only the fits can say about a question.
fn checked(asked: &ComparisonAsked, fits: &[&Fit]) -> Result<(), ServiceError> {
    let mut faults = Vec::new();
    let (start, _) = range(asked, fits)?;
    if let Some(to) = asked.to.filter(|to| *to < start) {
        let detail = format!("the runs begin at {}, after {}", rfc3339(start), rfc3339(to));
        faults.push(
            Fault::new("query to", "before-the-fit", detail)
                .suggest("a fit says nothing about the time before its window"),
        );
    }
    if let Some(horizon) = asked.horizon {
        let steps: BTreeSet<Seconds> = fits.iter().map(|fit| fit.sample_s).collect();
        for step in steps.into_iter().filter(|step| horizon.millis() % step.millis() != 0) {
            let detail = format!("{horizon} is no multiple of the {step} between the samples of the fit");
            faults.push(Fault::new("query horizon", "no-multiple", detail));
        }
    }
    if faults.is_empty() { Ok(()) } else { Err(ServiceError::Faults(faults)) }
}

fn short(text: &str) -> String {
    text.chars().take(40).collect::<String>().escape_debug().to_string()
}
