//! Which inputs should be driven for a few days, so that parameters can be told apart.

use super::chart;
use super::forecast::{InForce, given, rendered};
use crate::service::catalogue::windows::Format;
use crate::service::decode::decode;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::interactive::RenderedAnswer;
use indexmap::IndexMap;
use lampyris_core::data::{SystemId, Window, WindowDocument};
use lampyris_core::diagnose::experiment::{
    ComfortBounds, DrivenInput, Experiment, ExperimentAsked, ExperimentPlan, ExperimentPurpose,
    ExperimentSubject, Learnt, PlanFamily, PromisedWidth, experiment, learnt,
};
use lampyris_core::estimate::assess::metrics::noise_of;
use lampyris_core::estimate::forecast::InputsToCome;
use lampyris_core::estimate::{Fit, Replay, Site};
use lampyris_core::fault::Fault;
use lampyris_core::model::Catalogue;
use lampyris_core::schema::Interval;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

/// Hours in which an input may go through its whole range unless something else is asked.
const WHOLE_RANGE_HOURS: f64 = 1.0;
/// Days of an experiment unless something else is asked.
const DAYS: u64 = 2;

/// What an experiment is asked for.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ExperimentRequest {
    /// How many days it takes, two by default.
    #[serde(default)]
    #[schema(minimum = 1, maximum = 14)]
    days: Option<u64>,
    /// The inputs that may be driven, each with its lowest and highest value in the unit of its channel.
    #[schema(value_type = IndexMap<String, Interval>)]
    inputs: IndexMap<String, [f64; 2]>,
    /// The most that an input may change in an hour; all of its range by default.
    #[serde(default)]
    slew: IndexMap<String, f64>,
    /// The bounds that outputs shall keep.
    #[serde(default)]
    #[schema(value_type = IndexMap<String, Interval>)]
    comfort: IndexMap<String, [f64; 2]>,
    /// What it is for.
    to: ExperimentPurpose,
    /// The parameters that it is about, and effects, which stand for their parameters.
    about: Vec<String>,
    /// Inputs of the days to come that are forecast, as a window; the others repeat the last such days.
    #[serde(default)]
    #[schema(value_type = Option<WindowDocument>)]
    forecast: Option<Value>,
    /// Fixes the sequences that are tried; 1 by default.
    #[serde(default)]
    seed: Option<u64>,
    /// Which plan is written as CSV; the best one by default.
    #[serde(default)]
    plan: Option<PlanFamily>,
    /// Widths that an earlier plan has promised: the answer compares them with what is known now.
    #[serde(default)]
    promised: Vec<PromisedWidth>,
}

/// Plans of an experiment.
#[derive(Debug, Serialize, ToSchema)]
pub struct SystemExperiment {
    #[serde(flatten)]
    #[schema(inline)]
    in_force: InForce,
    /// The model, with the effects that the experiment is about.
    model: String,
    #[serde(flatten)]
    #[schema(inline)]
    experiment: Experiment,
    /// What became of the widths that were promised.
    learnt: Vec<Learnt>,
}

/// The best plans for a system, from the parameters that are served and the record as it is now.
///
/// # Errors
/// Every fault of the request; where nothing is served, or the fit cannot be run again; as CSV where no plan
/// keeps the comfort bounds.
pub(crate) async fn plans(
    service: &Service,
    system: &SystemId,
    body: Value,
    format: Format,
) -> Result<RenderedAnswer, ServiceError> {
    let asked = format!("experiments {format:?} {body}");
    let request: ExperimentRequest = decode(body).map_err(ServiceError::Faults)?;
    let forecast = request.forecast.clone().map(|window| given(window, "/forecast")).transpose()?;
    let forecast = forecast.as_ref().map(InputsToCome::given).unwrap_or_default();
    rendered(service, &service.inquiries, system, &asked, None, move |in_force, subject, window, replay| {
        let (fit, catalogue) = (subject.fit(), subject.catalogue());
        let (model, found, learnt) =
            found(&request, &forecast, (fit, catalogue), window, replay).map_err(ServiceError::Faults)?;
        match format {
            Format::Json => chart::json(&SystemExperiment { in_force, model, experiment: found, learnt }),
            Format::Csv => csv(&found, request.plan),
        }
    })
    .await
}

/// The model, the plans, and what became of what was promised.
fn found(
    request: &ExperimentRequest,
    forecast: &InputsToCome,
    (fit, catalogue): (&Fit, &Catalogue),
    window: &Window,
    replay: &Replay,
) -> Result<(String, Experiment, Vec<Learnt>), Vec<Fault>> {
    let site = Site::of(replay.problem().basis());
    let subject =
        ExperimentSubject::new(catalogue, replay.problem(), &fit.theta(), window, &site, &request.about)?;
    let slew = |channel: &String, range: &[f64; 2]| {
        // A range that is none is a fault of its own.
        let whole = ((range[1] - range[0]).abs() / WHOLE_RANGE_HOURS).max(f64::MIN_POSITIVE);
        request.slew.get(channel).copied().unwrap_or(whole)
    };
    let driven = |(channel, range): (&String, &[f64; 2])| DrivenInput {
        channel: channel.clone(),
        range: *range,
        slew: slew(channel, range),
    };
    let kept =
        |(channel, range): (&String, &[f64; 2])| ComfortBounds { channel: channel.clone(), range: *range };
    let asked = ExperimentAsked {
        days: usize::try_from(request.days.unwrap_or(DAYS)).unwrap_or(usize::MAX),
        inputs: request.inputs.iter().map(driven).collect(),
        comfort: request.comfort.iter().map(kept).collect(),
        purpose: request.to,
        about: subject.about.clone(),
        seed: request.seed.unwrap_or(1),
    };
    let noise = noise_of(&subject.problem, fit);
    let plans = experiment(&subject.problem, &subject.theta, &noise, &asked, forecast)?;
    let learnt = match request.promised.as_slice() {
        [] => Vec::new(),
        promised => learnt(&subject.problem, &subject.theta, promised)?,
    };
    Ok((subject.problem.model().id().to_string(), plans, learnt))
}

/// The driven inputs of a plan, a row per instant, for whoever drives them.
fn csv(found: &Experiment, wanted: Option<PlanFamily>) -> Result<Vec<u8>, ServiceError> {
    let is_wanted = |plan: &&ExperimentPlan| wanted.is_none_or(|wanted| plan.family == wanted);
    let plan = found.plans.iter().find(is_wanted).ok_or_else(|| {
        let detail = found.sentences.first().cloned().unwrap_or_default();
        ServiceError::Faults(vec![Fault::new("/plan", "no-plan", detail)])
    })?;
    let failed = |error: csv::Error| ServiceError::Internal(error.to_string());
    let mut table = csv::Writer::from_writer(Vec::new());
    let headers = plan.inputs.iter().map(|(channel, series)| format!("{channel}[{}]", series.unit));
    table.write_record(std::iter::once("time".to_owned()).chain(headers)).map_err(failed)?;
    for (k, time) in found.time.iter().enumerate() {
        let cells = plan.inputs.values().map(|series| format!("{:.2}", series.values[k]));
        table.write_record(std::iter::once(time.clone()).chain(cells)).map_err(failed)?;
    }
    table.into_inner().map_err(|error| ServiceError::Internal(error.to_string()))
}
