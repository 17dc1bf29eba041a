//! What flows into a measured state that the model of a fit does not know of, over time.

use super::chart;
use super::diagnostics::checked;
use super::subject::{self, NamedFit};
use crate::service::catalogue::windows::Format;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::interactive::RenderedAnswer;
use crate::store;
use lampyris_core::diagnose::missing_heat::{MissingHeat, missing_heat};
use lampyris_core::estimate::Replay;
use lampyris_core::estimate::assess::replay::{Provenance, window_of};
use lampyris_core::estimate::fit::Estimate;
use lampyris_core::interrupt::Brake;
use serde::Serialize;
use utoipa::ToSchema;

/// The missing heat of a fit over its window.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = MissingHeat)]
pub struct MissingHeatDocument<'a> {
    fit: &'a str,
    system: &'a str,
    model: &'a str,
    provenance: &'a Provenance,
    #[serde(flatten)]
    #[schema(inline)]
    found: MissingHeat,
}

/// What is asked for.
#[derive(Debug, Clone)]
pub struct MissingHeatWanted {
    /// An output of the model; the first one that shows a state where none is named.
    pub output: Option<String>,
    /// How the answer is written.
    pub format: Format,
}

/// The missing heat of a fit.
///
/// # Errors
/// Where there is no such fit or no such output, the output shows no state, the model has no filter, or the
/// fit cannot be run again.
pub(crate) async fn of_fit(
    service: &Service,
    id: &str,
    wanted: MissingHeatWanted,
) -> Result<RenderedAnswer, ServiceError> {
    let record = subject::require(service, id).await?;
    checked(&record.fit, wanted.output.as_deref())?;
    let (_, end) = window_of(&record.fit).map_err(ServiceError::Faults)?;
    let key = subject::key(service, "missing heat", &[&record], &format!("{wanted:?}")).await?;
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let subject = subject::load(service, record, end).await?;
    let work = move |brake: &Brake| {
        let replay = subject.replay(&subject.window()?, None, brake)?;
        let system = subject.record().system.to_string();
        document(&subject.named(&system), &replay, &wanted)
    };
    service.interactive.answer(&key, work).await
}

/// That of the fit which a diagnosis starts from.
///
/// # Errors
/// Where there is no such diagnosis, and as [`of_fit`] does.
pub(crate) async fn of_diagnosis(
    service: &Service,
    id: &str,
    wanted: MissingHeatWanted,
) -> Result<RenderedAnswer, ServiceError> {
    let record = store::diagnoses::get(&service.store, id).await?;
    let record = record.ok_or_else(|| ServiceError::NotFound("diagnosis", id.to_owned()))?;
    of_fit(service, &record.fit, wanted).await
}

/// The missing heat of a fit that was run again. This is work for the CPU pool.
///
/// # Errors
/// Where the output shows no state, the model has no filter, or it leaves the numbers.
pub fn document(
    named: &NamedFit<'_>,
    replay: &Replay,
    wanted: &MissingHeatWanted,
) -> Result<Vec<u8>, ServiceError> {
    let problem = replay.problem();
    let is_sure = |name: &str| named.fit.parameters.get(name).is_some_and(is_determined);
    let found = missing_heat(problem, &named.fit.theta(), wanted.output.as_deref(), &is_sure)
        .map_err(|fault| ServiceError::Faults(vec![fault]))?;
    match wanted.format {
        Format::Csv => csv(&found),
        Format::Json => chart::json(&MissingHeatDocument {
            fit: named.id,
            system: named.system,
            model: &named.fit.model,
            provenance: replay.provenance(),
            found,
        }),
    }
}

/// Whether an estimate is good for turning heat into power: to a factor of about two, with 95 %.
fn is_determined(estimate: &Estimate) -> bool {
    let [low, high] = estimate.ci95.unwrap_or([0.0, f64::INFINITY]);
    !estimate.at_bound && low > 0.5 * estimate.value && high < 2.0 * estimate.value
}

/// A row for each hour that is known, with its bands, as `POST …/windows` reads it.
fn csv(found: &MissingHeat) -> Result<Vec<u8>, ServiceError> {
    let name = |what: &str| format!("missing_{what}{}[{}]", found.state, found.unit);
    let headers = ["", "low_95_", "low_50_", "high_50_", "high_95_"].map(name);
    let failed = |error: csv::Error| ServiceError::Internal(error.to_string());
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(std::iter::once("time").chain(headers.iter().map(String::as_str))).map_err(failed)?;
    for hour in &found.hours {
        if let (Some(rate), Some([low, high]), Some([lowest, highest])) =
            (hour.rate, hour.band_50, hour.band_95)
        {
            let cells = [rate, lowest, low, high, highest].map(|value| value.to_string());
            table.write_record(std::iter::once(&hour.from).chain(&cells)).map_err(failed)?;
        }
    }
    table.into_inner().map_err(|error| ServiceError::Internal(error.to_string()))
}
