//! What the parameters in force say of the hours to come: the forecast, and the linear model along it.

use super::chart;
use super::subject::{self, Subject};
use crate::service::decode::decode;
use crate::service::error::ServiceError;
use crate::service::serving::said::SaidForecast;
use crate::service::state::Service;
use crate::service::work::interactive::{Interactive, RenderedAnswer};
use crate::store::forecast_inputs::{self, KeptInput};
use lampyris_core::data::{
    ColumnBindings, ColumnRole, Duration, SystemId, Window, WindowDocument, WindowParts,
};
use lampyris_core::estimate::Replay;
use lampyris_core::estimate::forecast::matrices::{self, Matrices};
use lampyris_core::estimate::forecast::score::Said;
use lampyris_core::estimate::forecast::{Forecast, ForecastAsked, InputsToCome, LONGEST, forecast};
use lampyris_core::fault::Fault;
use lampyris_core::interrupt::Brake;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

/// A forecast of a day, every quarter of an hour, unless something else is asked.
const HORIZON: Duration = Duration::from_hours(24);
/// The step unless something else is asked.
pub const STEP: Duration = Duration::from_seconds(900);

/// The hours to come. Every field has a default.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
#[schema(as = ForecastRequest)]
pub struct HoursToCome {
    /// How far ahead, a day by default, ten at most.
    #[schema(value_type = Option<lampyris_core::data::Length>, example = "PT24H")]
    horizon: Option<Duration>,
    /// The step between instants, a quarter of an hour by default.
    #[schema(value_type = Option<lampyris_core::data::Length>, example = "PT15M")]
    step: Option<Duration>,
    /// The inputs of the hours to come, as a window; what was measured ahead need not be given, nor what was
    /// uploaded as a forecast, the sun and the clock. What is given here counts before both.
    #[schema(value_type = Option<WindowDocument>)]
    inputs: Option<Value>,
}

/// By what an answer about the hours to come was made.
#[derive(Debug, Serialize, ToSchema)]
pub struct InForce {
    /// The system.
    pub(super) system: SystemId,
    /// The revision whose parameters it uses.
    pub(super) revision: i64,
    /// The fit behind it.
    pub(super) fit: String,
}

/// A forecast.
#[derive(Debug, Serialize, ToSchema)]
pub struct SystemForecast {
    #[serde(flatten)]
    #[schema(inline)]
    in_force: InForce,
    #[serde(flatten)]
    #[schema(inline)]
    forecast: Forecast,
}

/// A linear discrete model.
#[derive(Debug, Serialize, ToSchema)]
pub struct SystemLinearisation {
    #[serde(flatten)]
    #[schema(inline)]
    in_force: InForce,
    #[serde(flatten)]
    #[schema(inline)]
    matrices: Matrices,
}

/// A forecast by the parameters that are served, from the states at the newest measurement.
///
/// # Errors
/// Every fault of the request; where nothing is served, or the fit cannot be run again.
pub(crate) async fn ahead(
    service: &Service,
    system: &SystemId,
    body: Value,
) -> Result<RenderedAnswer, ServiceError> {
    let (text, question) = (format!("forecast {body}"), Question::read(service, system, body).await?);
    let (named, made_at, said) = (system.clone(), service.now(), service.said.clone());
    let text = format!("{text} {}", question.version());
    answer(service, system, &text, None, move |in_force, subject, window, replay| {
        let asked = question.asked;
        let to_come = question.to_come(window)?;
        let forecast =
            forecast(replay, subject.fit(), window, &to_come, asked).map_err(ServiceError::Faults)?;
        match Said::of(&forecast, asked.step) {
            Ok(outputs) => {
                said.note(&named, SaidForecast { made_at, revision: in_force.revision, outputs });
            }
            Err(fault) => tracing::warn!(%fault, system = %named, "what a forecast said cannot be kept"),
        }
        Ok(SystemForecast { in_force, forecast })
    })
    .await
}

/// The linear model along the forecast that the same request would get.
///
/// # Errors
/// Those of [`ahead`].
pub(crate) async fn along(
    service: &Service,
    system: &SystemId,
    body: Value,
) -> Result<RenderedAnswer, ServiceError> {
    let (text, question) = (format!("along {body}"), Question::read(service, system, body).await?);
    let text = format!("{text} {}", question.version());
    answer(service, system, &text, None, move |in_force, subject, window, replay| {
        let to_come = question.to_come(window)?;
        let matrices = matrices::along(replay, subject.fit(), window, &to_come, question.asked)
            .map_err(ServiceError::Faults)?;
        Ok(SystemLinearisation { in_force, matrices })
    })
    .await
}

/// The linear model of one step at the newest measurement, or at the newest until `at` (in milliseconds).
///
/// # Errors
/// Those of [`ahead`].
pub(crate) async fn now(
    service: &Service,
    system: &SystemId,
    step: Duration,
    at: Option<i64>,
) -> Result<RenderedAnswer, ServiceError> {
    let text = format!("now {step} {at:?}");
    answer(service, system, &text, at, move |in_force, subject, window, replay| {
        let matrices =
            matrices::now(replay, subject.fit(), window, step, at).map_err(ServiceError::Faults)?;
        Ok(SystemLinearisation { in_force, matrices })
    })
    .await
}

/// What is asked of the hours to come, the inputs that are given for them, and those that were forecast.
struct Question {
    asked: ForecastAsked,
    given: Option<Window>,
    kept: Vec<KeptInput>,
}

impl Question {
    async fn read(service: &Service, system: &SystemId, body: Value) -> Result<Self, ServiceError> {
        let request: HoursToCome = decode(body).map_err(ServiceError::Faults)?;
        let given = request.inputs.map(|inputs| given(inputs, "/inputs")).transpose()?;
        let asked = ForecastAsked {
            horizon: request.horizon.unwrap_or(HORIZON),
            step: request.step.unwrap_or(STEP),
            until: None,
        };
        Ok(Self { asked, given, kept: forecast_inputs::of(&service.store, system).await? })
    }

    /// What the answer depends on beside the body and the measurements.
    fn version(&self) -> i64 {
        forecast_inputs::version(&self.kept)
    }

    /// The inputs beside what was measured. This is work for the CPU pool.
    fn to_come(&self, measured: &Window) -> Result<InputsToCome, ServiceError> {
        let given = self.given.as_ref().map(InputsToCome::given).unwrap_or_default();
        if self.kept.is_empty() {
            return Ok(given);
        }
        let kept: Vec<_> = self.kept.iter().map(KeptInput::series).collect::<Result<_, _>>()?;
        Ok(given.or(&Window::from_series(kept).map_err(ServiceError::Faults)?, measured))
    }
}

/// Runs the fit behind the revision that is served, and what is wanted of it as JSON.
async fn answer<T: Serialize>(
    service: &Service,
    system: &SystemId,
    asked: &str,
    until: Option<i64>,
    wanted: impl FnOnce(InForce, &Subject, &Window, &Replay) -> Result<T, ServiceError> + Send + 'static,
) -> Result<RenderedAnswer, ServiceError> {
    rendered(service, &service.interactive, system, asked, until, move |in_force, subject, window, replay| {
        chart::json(&wanted(in_force, subject, window, replay)?)
    })
    .await
}

/// Runs the fit behind the revision that is served, and what is wanted of it, on these threads. `asked`
/// names the question; `until` ends what is looked at.
pub(super) async fn rendered<W>(
    service: &Service,
    threads: &Interactive,
    system: &SystemId,
    asked: &str,
    until: Option<i64>,
    wanted: W,
) -> Result<RenderedAnswer, ServiceError>
where
    W: FnOnce(InForce, &Subject, &Window, &Replay) -> Result<Vec<u8>, ServiceError> + Send + 'static,
{
    let (number, record) = subject::in_force(service, system).await?;
    let key = subject::key(service, "ahead", &[&record], &format!("{number} {asked}")).await?;
    if let Some(answer) = threads.known(&key) {
        return Ok(answer);
    }
    let newest = service.now().as_millisecond().saturating_add(LONGEST.millis());
    let until = until.unwrap_or(newest);
    let subject = subject::load(service, record, until).await?;
    let in_force = InForce { system: system.clone(), revision: number, fit: subject.record().id.clone() };
    let work = move |brake: &Brake| {
        let window = subject.window()?;
        let replay = subject.replay(&window, Some(until), brake)?;
        wanted(in_force, &subject, &window, &replay)
    };
    threads.answer(&key, work).await
}

/// The inputs that a request gives at a place of its body, read as a window is; all of them are forecasts.
pub(super) fn given(inputs: Value, place: &str) -> Result<Window, ServiceError> {
    let within = |fault: Fault| Fault { pointer: format!("{place}{}", fault.pointer), ..fault };
    let none = || vec![Fault::new("/values", "no-data-column", "there are no inputs")];
    let role = Some(ColumnRole::Forecast);
    WindowParts::parse_json(inputs.to_string().as_bytes(), &ColumnBindings::none(), role)
        .and_then(|parts| parts.forecast.map(|(window, _)| window).ok_or_else(none))
        .map_err(|faults| ServiceError::Faults(faults.into_iter().map(within).collect()))
}
