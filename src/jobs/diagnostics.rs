//! How well a fit follows its measurements, as numbers and in plain sentences.

use super::comparison::Named;
use super::interactive::Answer;
use super::{JobsError, Service, chart, comparison};
use crate::data::Window;
use crate::diagnose::failures::{Failures, failures, sentences};
use crate::estimate::Replay;
use crate::estimate::replay::{Part, Provenance, window_of};
use crate::estimate::skill::{HorizonSkill, PartSkill, by_horizon, by_part};
use crate::estimate::summary::summary;
use indexmap::IndexMap;
use serde::Serialize;

#[derive(Debug, Serialize)]
struct Document<'a> {
    fit: &'a str,
    system: &'a str,
    model: &'a str,
    summary: String,
    provenance: &'a Provenance,
    skill: IndexMap<String, PartSkill>,
    judged_on: Part,
    by_horizon: IndexMap<String, Vec<HorizonSkill>>,
    rho: IndexMap<&'a str, Option<f64>>,
    noise_floor: IndexMap<&'a str, Option<f64>>,
    #[serde(flatten)]
    failures: Failures,
}

/// The diagnostics of a fit, JSON.
///
/// # Errors
/// Where there is no such fit, or it cannot be run again.
pub async fn diagnostics(service: &Service, id: &str) -> Result<Answer, JobsError> {
    let record = comparison::require(service, id).await?;
    let (_, end) = window_of(&record.fit).map_err(JobsError::Faults)?;
    let key = comparison::key(service, "diagnostics", &[&record], "").await?;
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let subject = comparison::subject(service, record, end).await?;
    let work = move || {
        let window = subject.window()?;
        let system = subject.record().system.to_string();
        document(&subject.named(&system), &subject.replay(&window, None)?, &window)
    };
    service.interactive.answer(&key, work).await
}

/// The diagnostics of a fit that was run again, in the light of all that was measured. This is work for the CPU pool.
///
/// # Errors
/// Where the measurements do not serve.
pub fn document(named: &Named<'_>, replay: &Replay, window: &Window) -> Result<Vec<u8>, JobsError> {
    let fit = named.fit;
    // Without unseen data the horizons are judged on what there is, and the answer says so.
    let judged_on = if replay.range(Part::Validation).is_empty() { Part::Train } else { Part::Validation };
    let (skill, by_horizon) = (by_part(replay), by_horizon(replay, judged_on));
    let first = skill.first().zip(by_horizon.first());
    let told = first.map(|((_, parts), (_, horizons))| summary(judged_on, parts, horizons, fit.first_metrics(), replay.provenance()));
    let failures = failures(replay.problem(), fit, replay.filtered(), window, fit.seed).map_err(|fault| JobsError::Faults(vec![fault]))?;
    let mut told: Vec<String> = told.into_iter().collect();
    told.extend(sentences(replay.problem(), &failures));
    chart::json(&Document {
        fit: named.id,
        system: named.system,
        model: &fit.model,
        summary: told.join(" "),
        provenance: replay.provenance(),
        skill,
        judged_on,
        by_horizon,
        rho: fit.metrics.iter().map(|(output, metrics)| (output.as_str(), metrics.rho)).collect(),
        noise_floor: fit.metrics.iter().map(|(output, metrics)| (output.as_str(), metrics.noise_floor)).collect(),
        failures,
    })
}
