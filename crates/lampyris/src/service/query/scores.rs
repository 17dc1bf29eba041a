//! How far off the forecasts of a system were: what they said beside what came.

use crate::service::catalogue::systems;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::interactive::RenderedAnswer;
use crate::store;
use crate::store::days::Days;
use crate::store::said::PackedSaid;
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::{Series, SystemId, rfc3339};
use lampyris_core::estimate::forecast::LONGEST;
use lampyris_core::estimate::forecast::score::{LeadScore, Said, scores};
use serde::Serialize;
use std::collections::BTreeSet;
use utoipa::ToSchema;

/// What forecasts said, beside what came.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ForecastScores)]
pub struct SystemScores {
    /// The system.
    system: SystemId,
    /// Forecasts that were kept: at most one in a quarter of an hour, for thirty days.
    forecasts: usize,
    /// When the first of them was made; `null` where there is none.
    #[schema(value_type = Option<String>, format = DateTime)]
    from: Option<String>,
    /// When the last of them was made.
    #[schema(value_type = Option<String>, format = DateTime)]
    to: Option<String>,
    /// The revisions that made them.
    revisions: BTreeSet<i64>,
    /// How far off they were, by output.
    outputs: IndexMap<String, OutputScores>,
}

/// How far off forecasts of an output were.
#[derive(Debug, Serialize, ToSchema)]
struct OutputScores {
    /// The unit of the errors.
    unit: String,
    /// A row for every lead that a forecast reaches, shortest first.
    leads: Vec<LeadScore>,
}

/// How far off the forecasts of a system were, as far as the truth has come.
///
/// # Errors
/// An unknown system, or where the database fails.
pub(crate) async fn answer(service: &Service, system: &SystemId) -> Result<RenderedAnswer, ServiceError> {
    let document = systems::require(service, system).await?;
    let measured = store::measured::version(&service.store, system).await?;
    let (count, newest) = store::said::version(&service.store, system).await?;
    let exclude = &document.exclude;
    let key = format!("scores {system} {measured} {count} {newest} {exclude:?}");
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let from = service.now().saturating_sub(store::said::KEPT).unwrap_or(Timestamp::MIN);
    let said = store::said::since(&service.store, system, from).await?;
    let outputs: BTreeSet<&str> = said.iter().map(|one| one.output.as_str()).collect();
    let outputs: Vec<String> = outputs.into_iter().map(str::to_owned).collect();
    let span = span(&said);
    let days = store::measured::read(&service.store, system, span, Some(&outputs)).await?;
    let excluded = document.excluded();
    let system = system.clone();
    let work = move |_: &_| {
        let scores = compare(system, &said, &days, &excluded)?;
        serde_json::to_vec(&scores).map_err(|error| ServiceError::Internal(error.to_string()))
    };
    service.interactive.answer(&key, work).await
}

/// The stretch of time over which forecasts are compared with what came.
fn span(said: &[PackedSaid]) -> (i64, i64) {
    let starts = || said.iter().map(PackedSaid::at);
    let (from, to) = (starts().min().unwrap_or_default(), starts().max().unwrap_or_default());
    (from, to.saturating_add(LONGEST.millis()))
}

/// This is work for the CPU pool.
fn compare(
    system: SystemId,
    said: &[PackedSaid],
    days: &Days,
    excluded: &[(i64, i64)],
) -> Result<SystemScores, ServiceError> {
    let mut outputs = IndexMap::new();
    for of_output in said.chunk_by(|one, next| one.output == next.output) {
        let output = &of_output[0].output;
        let forecasts: Vec<Said> = of_output.iter().map(PackedSaid::decode).collect::<Result<_, _>>()?;
        let Some(measured) = days.series(output)?.and_then(|series| trusted(&series, excluded)) else {
            continue;
        };
        let unit = forecasts.last().map(|said| said.values.unit().to_owned()).unwrap_or_default();
        outputs.insert(output.clone(), OutputScores { unit, leads: scores(&forecasts, &measured) });
    }
    let made = || said.iter().map(|one| one.made_at);
    let instants: BTreeSet<Timestamp> = made().collect();
    let shown = |instant: Option<&Timestamp>| instant.map(|instant| rfc3339(instant.as_millisecond()));
    Ok(SystemScores {
        system,
        forecasts: instants.len(),
        from: shown(instants.first()),
        to: shown(instants.last()),
        revisions: said.iter().map(|one| one.revision).collect(),
        outputs,
    })
}

/// The samples outside of the stretches that are not to be trusted.
fn trusted(series: &Series, excluded: &[(i64, i64)]) -> Option<Series> {
    let is_excluded = |time: i64| excluded.iter().any(|(from, to)| (*from..=*to).contains(&time));
    let (times, values) = series.samples().filter(|(time, _)| !is_excluded(*time)).unzip();
    Series::new(series.channel(), series.unit(), series.hold(), times, values).ok()
}
