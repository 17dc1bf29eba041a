//! How well a fit follows its measurements, as numbers and in plain sentences.

use super::chart;
use super::subject::{self, NamedFit};
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::interactive::RenderedAnswer;
use indexmap::IndexMap;
use lampyris_core::data::Window;
use lampyris_core::diagnose::failures::{Failures, failures, sentences};
use lampyris_core::estimate::assess::replay::{Part, Provenance, window_of};
use lampyris_core::estimate::assess::skill::{HorizonSkill, PartSkill, by_horizon, by_part};
use lampyris_core::estimate::assess::summary::summary;
use lampyris_core::estimate::{Fit, Replay};
use lampyris_core::fault::{Fault, nearest};
use lampyris_core::interrupt::Brake;
use serde::Serialize;
use utoipa::ToSchema;

/// How well a fit follows its measurements.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Diagnostics)]
pub struct DiagnosticsDocument<'a> {
    fit: &'a str,
    system: &'a str,
    model: &'a str,
    /// What the numbers say, in plain sentences.
    summary: String,
    provenance: &'a Provenance,
    /// The free run of each output in the parts of the fit's window.
    skill: IndexMap<String, PartSkill>,
    /// The part that `by_horizon` was judged on: `validation`, or `train` where nothing else is there.
    #[schema(value_type = String)]
    judged_on: Part,
    /// The skill of each output 1, 6 and 24 hours ahead and of its free run, beside persistence.
    by_horizon: IndexMap<String, Vec<HorizonSkill>>,
    /// The output that the summary and all that follows is about, as asked for; the first one where none was.
    output: &'a str,
    /// Free-run error over the deviation of the noise that is left in it, by output; above 1.6 something
    /// physical is probably missing.
    rho: IndexMap<&'a str, Option<f64>>,
    /// Root mean square of the one-step innovations, by output.
    noise_floor: IndexMap<&'a str, Option<f64>>,
    #[serde(flatten)]
    #[schema(inline)]
    failures: Failures,
}

/// The diagnostics of a fit, JSON: where and when is told of one output, of the first one where none is
/// named.
///
/// # Errors
/// Where there is no such fit or no such output, or the fit cannot be run again.
pub(crate) async fn diagnostics(
    service: &Service,
    id: &str,
    output: Option<String>,
) -> Result<RenderedAnswer, ServiceError> {
    let record = subject::require(service, id).await?;
    checked(&record.fit, output.as_deref())?;
    let (_, end) = window_of(&record.fit).map_err(ServiceError::Faults)?;
    let key = subject::key(service, "diagnostics", &[&record], output.as_deref().unwrap_or("")).await?;
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let subject = subject::load(service, record, end).await?;
    let work = move |brake: &Brake| {
        let window = subject.window()?;
        let system = subject.record().system.to_string();
        document(&subject.named(&system), &subject.replay(&window, None, brake)?, &window, output.as_deref())
    };
    service.interactive.answer(&key, work).await
}

/// That a fit has the output that is asked for, if one is.
///
/// # Errors
/// What it has instead.
pub(super) fn checked(fit: &Fit, output: Option<&str>) -> Result<(), ServiceError> {
    let Some(wanted) = output.filter(|wanted| !fit.metrics.contains_key(*wanted)) else { return Ok(()) };
    let known: Vec<&str> = fit.metrics.keys().map(String::as_str).collect();
    let fault = Fault::new(
        "query output",
        "unknown-output",
        format!("`{wanted}` is none of the outputs {}", known.join(", ")),
    );
    Err(ServiceError::Faults(vec![match nearest(wanted, known) {
        Some(near) => fault.suggest(format!("did you mean `{near}`?")),
        None => fault,
    }]))
}

/// The diagnostics of a fit that was run again, in the light of all that was measured: the skill of every
/// output, and where and when `output` fails, or the first one. This is work for the CPU pool.
///
/// # Errors
/// Where the measurements do not serve.
pub fn document(
    named: &NamedFit<'_>,
    replay: &Replay,
    window: &Window,
    output: Option<&str>,
) -> Result<Vec<u8>, ServiceError> {
    let (fit, problem) = (named.fit, replay.problem());
    let outputs = problem.model().outputs();
    let at =
        output.and_then(|wanted| outputs.iter().position(|output| output.channel == wanted)).unwrap_or(0);
    let output = outputs.get(at).map_or("", |output| output.channel.as_str());
    // Without unseen data the horizons are judged on what there is, and the answer says so.
    let judged_on = if replay.range(Part::Validation).is_empty() { Part::Train } else { Part::Validation };
    let (skill, by_horizon) = (by_part(replay), by_horizon(replay, judged_on));
    let of_output = skill.get(output).zip(by_horizon.get(output));
    let told = of_output.map(|(parts, horizons)| {
        summary(judged_on, parts, horizons, fit.metrics.get(output), replay.provenance())
    });
    let failures = failures(problem, fit, at, replay.filtered(), window)
        .map_err(|fault| ServiceError::Faults(vec![fault]))?;
    let mut told: Vec<String> = told.into_iter().collect();
    told.extend(sentences(problem, at, &failures));
    chart::json(&DiagnosticsDocument {
        fit: named.id,
        system: named.system,
        model: &fit.model,
        summary: told.join(" "),
        provenance: replay.provenance(),
        skill,
        judged_on,
        by_horizon,
        output,
        rho: fit.metrics.iter().map(|(output, metrics)| (output.as_str(), metrics.rho)).collect(),
        noise_floor: fit
            .metrics
            .iter()
            .map(|(output, metrics)| (output.as_str(), metrics.noise_floor))
            .collect(),
        failures,
    })
}
