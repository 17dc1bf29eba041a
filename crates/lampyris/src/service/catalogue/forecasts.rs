//! Takes in what somebody forecasts of a system's inputs, beside measurements or alone. It is kept apart from
//! them: no fit, comparison or chart ever sees it.

use super::systems;
use super::windows::{self, BodyAsked, Format, TakenWindow};
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::forecast_inputs::{self, IssueWritten, KeptInput};
use crate::store::idempotency::RequestKey;
use jiff::Timestamp;
use lampyris_core::data::{Duration, Series, SystemId, Window, WindowReport, rfc3339};
use lampyris_core::estimate::forecast::LONGEST;
use lampyris_core::fault::Fault;

/// How often an issue is tried that others, outside of this process, come before.
const TRIES: usize = 8;
/// What was forecast is kept for so long behind the newest measurement: forecasts begin there.
const KEPT: Duration = LONGEST;

/// What was taken of a body.
#[derive(Debug)]
pub enum TakenParts {
    /// The window of what was measured, and what was forecast beside it.
    Window(Box<TakenWindow>, Option<TakenIssue>),
    /// Forecasts alone.
    Forecast(TakenIssue),
}

/// An issue of forecasts that was taken.
#[derive(Debug)]
pub struct TakenIssue {
    /// When.
    pub issued_at: Timestamp,
    /// What was found in it.
    pub report: WindowReport,
}

/// Takes measurements and forecasts of a system.
///
/// # Errors
/// Every fault of the body, an unknown system, or where the database fails.
pub(crate) async fn take(
    service: &Service,
    system: &SystemId,
    (format, asked): (Format, BodyAsked),
    body: impl AsRef<[u8]> + Send + 'static,
    key: Option<&RequestKey>,
) -> Result<TakenParts, ServiceError> {
    let document = systems::require(service, system).await?;
    let (bindings, asked) = (document.columns(), asked.for_system(&document));
    let parts = blocking(move || windows::read_parts(format, body.as_ref(), &bindings, &asked)).await??;
    let mut faults = Vec::new();
    if let Some((window, _)) = &parts.measured {
        faults.extend(windows::faults(service, system, window).await?);
    }
    if let Some((window, _)) = &parts.forecast {
        faults.extend(self::faults(service, system, window).await?);
    }
    if !faults.is_empty() {
        return Err(ServiceError::Faults(faults));
    }
    let window = match parts.measured {
        Some(measured) => Some(windows::keep(service, system, measured, key).await?),
        None => None,
    };
    let issue = match parts.forecast {
        Some(forecast) => {
            // Each part is written by itself, so each has to know whether the same request has come before.
            let own = |key: &RequestKey| RequestKey { key: format!("{} (forecast)", key.key), ..key.clone() };
            let key = if window.is_some() { key.map(own) } else { key.cloned() };
            Some(keep(service, system, forecast, key.as_ref()).await?)
        }
        None => None,
    };
    match (window, issue) {
        (Some(window), issue) => Ok(TakenParts::Window(Box::new(window), issue)),
        (None, Some(issue)) => Ok(TakenParts::Forecast(issue)),
        (None, None) => {
            let detail = "there is no column beside the time";
            Err(ServiceError::Faults(vec![Fault::new("header", "no-data-column", detail)]))
        }
    }
}

/// What is wrong with forecasts that were read.
async fn faults(service: &Service, system: &SystemId, window: &Window) -> Result<Vec<Fault>, ServiceError> {
    let mut faults = windows::conflicts(service, system, window).await?;
    let now = service.now();
    let (oldest, latest) =
        (oldest(service, system).await?, now.as_millisecond().saturating_add(LONGEST.millis()));
    for series in window.iter() {
        let (channel, from, to) = (series.channel(), series.from(), series.to());
        let fault = |code, detail| Fault::new(format!("/values/{channel}"), code, detail);
        if to > latest {
            let detail = format!(
                "the forecast of `{channel}` reaches to {}, more than ten days ahead of the clock of this \
                service, {now:.0}",
                rfc3339(to)
            );
            faults.push(fault("future-time", detail).suggest("leave out what is further ahead"));
        }
        if to < oldest {
            let detail = format!(
                "the forecast of `{channel}` from {} to {} lies more than ten days behind the newest \
                measurement, and drives nothing",
                rfc3339(from),
                rfc3339(to)
            );
            faults.push(fault("past-time", detail));
        }
    }
    Ok(faults)
}

/// What was forecast for before this instant drives no forecast any more.
async fn oldest(service: &Service, system: &SystemId) -> Result<i64, ServiceError> {
    let now = service.now().as_millisecond();
    let newest = store::measured::extent(&service.store, system).await?.map_or(now, |(_, newest)| newest);
    Ok(newest.min(now) - KEPT.millis())
}

/// Lays an issue over what older ones have said, and keeps what counts.
async fn keep(
    service: &Service,
    system: &SystemId,
    (window, report): (Window, WindowReport),
    key: Option<&RequestKey>,
) -> Result<TakenIssue, ServiceError> {
    let oldest = oldest(service, system).await?;
    let _turn = service.turns.of(system).await;
    for _ in 0..TRIES {
        let now = service.now();
        // As it is kept.
        let issued_at = Timestamp::from_millisecond(now.as_millisecond()).unwrap_or(now);
        let before = forecast_inputs::of(&service.store, system).await?;
        let version = forecast_inputs::version(&before);
        let known = before.iter().filter(|input| window.series(&input.channel).is_some());
        let earlier = known.map(|input| input.issued_at).max();
        let issue = window.clone();
        let laid = move || -> Result<Vec<KeptInput>, ServiceError> {
            let lay = |series: &Series| {
                let older = before.iter().find(|input| input.channel == series.channel());
                let older = older.map(KeptInput::series).transpose()?;
                let counts = counting(series, older.as_ref(), oldest)?;
                Ok(KeptInput::new(&counts, issued_at))
            };
            issue.iter().map(lay).collect()
        };
        let inputs = blocking(laid).await??;
        match forecast_inputs::write(&service.store, system, (&inputs, version), key, issued_at).await? {
            IssueWritten::Kept => return Ok(TakenIssue { issued_at, report }),
            IssueWritten::Repeated => {
                return Ok(TakenIssue { issued_at: earlier.unwrap_or(issued_at), report });
            }
            IssueWritten::KeyReused => return Err(ServiceError::KeyReused),
            IssueWritten::NoSystem => return Err(ServiceError::NoSystem(system.clone())),
            IssueWritten::Stale => {}
        }
    }
    Err(ServiceError::Busy)
}

/// What counts of a channel: the new issue from its first sample to its last, and what was said before beside
/// it, as far back as it is kept. An older issue in another unit is nothing to go on with.
fn counting(newer: &Series, older: Option<&Series>, oldest: i64) -> Result<Series, ServiceError> {
    let unfit = |faults| ServiceError::Faults(faults);
    let older = older.filter(|older| older.in_unit(newer.unit()).is_some());
    let before = older.and_then(|older| older.slice(i64::MIN, newer.from() - 1));
    let after = older.and_then(|older| older.slice(newer.to() + 1, i64::MAX));
    let parts = before.into_iter().chain(after).chain([newer.clone()]);
    let windows: Result<Vec<Window>, _> = parts.map(|part| Window::from_series(vec![part])).collect();
    let whole = Window::stitch(&windows.map_err(unfit)?).map_err(unfit)?;
    let kept = whole.iter().find_map(|series| series.slice(oldest, i64::MAX));
    Ok(kept.unwrap_or_else(|| newer.clone()))
}
