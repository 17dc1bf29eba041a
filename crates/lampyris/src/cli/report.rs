//! `--report`: what a verb found as one HTML file. It holds the page's own modules and the answers that they
//! would ask the service for, so that it opens from the disk, without a network.

use super::bundle;
use super::output::{Failure, faults};
use crate::http::{book_text, model_document, page_part};
use crate::service::ServiceError;
use crate::service::catalogue::windows::Format;
use crate::service::query::missing_heat::{self, MissingHeatWanted};
use crate::service::query::subject::{ComparisonAsked, NamedFit};
use crate::service::query::{comparison, diagnostics};
use jiff::Timestamp;
use lampyris_core::data::{Duration, Window};
use lampyris_core::diagnose::Diagnosis;
use lampyris_core::diagnose::ladder::Ladder;
use lampyris_core::estimate::{Fit, Judgement, Replay};
use lampyris_core::interrupt::Brake;
use lampyris_core::model::Catalogue;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::path::Path;

/// The name of the one fit, diagnosis and system of a run without a service.
pub const ID: &str = "report";
/// Most points of a line of the free run; of the forecasts, of which there are several.
const POINTS: [usize; 2] = [20_000, 2_000];
const HORIZONS: [&str; 3] = ["PT1H", "PT6H", "PT24H"];
const STYLES: [&str; 5] = ["vendor/uPlot.min.css", "style.css", "parts.css", "charts.css", "narrow.css"];
/// What the words of the page mean.
const GLOSSARY: &str = "reference/glossary.md";
const LICENCES: [&str; 3] =
    ["vendor/LICENSE-preact.txt", "vendor/LICENSE-htm.txt", "vendor/LICENSE-uplot.txt"];

/// What a report shows.
#[derive(Clone, Copy)]
pub struct ReportSubject<'a> {
    pub catalogue: &'a Catalogue,
    /// All that was measured.
    pub window: &'a Window,
    pub fit: &'a Fit,
    pub judgement: &'a Judgement,
    pub diagnosis: Option<&'a Diagnosis>,
    pub ladder: Option<&'a Ladder>,
}

/// Writes the report.
///
/// # Errors
/// Where the fit cannot be run again, or the file cannot be written.
pub fn write(file: &Path, found: &ReportSubject<'_>) -> Result<(), Failure> {
    let document = document(&data(found)?)?;
    std::fs::write(file, document).map_err(|error| Failure::Error(format!("{}: {error}", file.display())))?;
    eprintln!("report: {}", file.display());
    Ok(())
}

/// All answers, by the paths at which the service would give them.
fn data(found: &ReportSubject<'_>) -> Result<Value, Failure> {
    let fit = found.fit;
    let replay = Replay::new(found.catalogue, fit, found.window, None, &Brake::NONE)
        .map_err(|found| faults(&found))?;
    let named = NamedFit { id: ID, system: ID, fit };
    let made_at = Timestamp::now().to_string();
    let mut answers = Map::new();
    answers.insert(format!("/fits/{ID}"), fit_document(ID, fit, found.judgement, &made_at)?);
    let asked = |horizon, max_points| ComparisonAsked {
        horizon,
        from: None,
        to: None,
        max_points,
        format: Format::Json,
    };
    answers.insert(
        format!("/fits/{ID}/comparison?mode=free_run"),
        read(comparison::document(&named, &replay, &asked(None, POINTS[0])))?,
    );
    for name in HORIZONS {
        let horizon: Duration = name.parse().map_err(|error| Failure::Error(format!("{error}")))?;
        if horizon.millis() % fit.sample_s.millis() == 0 {
            let forecast = comparison::document(&named, &replay, &asked(Some(horizon), POINTS[1]));
            answers.insert(format!("/fits/{ID}/comparison?mode=ahead&horizon={name}"), read(forecast)?);
        }
    }
    // The page asks by name where there is more than one output.
    let several = (fit.metrics.len() > 1).then(|| fit.metrics.keys().map(|name| Some(name.as_str())));
    for output in std::iter::once(None).chain(several.into_iter().flatten()) {
        let path = output.map_or_else(String::new, |name| format!("?output={name}"));
        let document = diagnostics::document(&named, &replay, found.window, output);
        answers.insert(format!("/fits/{ID}/diagnostics{path}"), read(document)?);
    }
    let model = replay.problem().model();
    let base = found.catalogue.model(model.id().base()).cloned();
    answers.insert(
        format!("/models/{}", fit.model),
        model_document(model.id().clone(), model, base).map_err(|error| unwritten(&error))?,
    );
    if let Some(diagnosis) = found.diagnosis {
        let own = json!({"id": ID, "job": null, "system": ID, "fit": ID, "created_at": made_at});
        answers.insert(format!("/diagnoses/{ID}"), joined(own, diagnosis)?);
        let wanted = MissingHeatWanted { output: None, format: Format::Json };
        // A model without a filter has none, and its page says so.
        if let Ok(document) = missing_heat::document(&named, &replay, &wanted) {
            answers.insert(format!("/diagnoses/{ID}/missing-heat"), read(Ok(document))?);
        }
    }
    if let Some(ladder) = found.ladder {
        let own = json!({"job": null, "system": ID, "fit": ID, "created_at": made_at});
        answers.insert(format!("/systems/{ID}/ladder"), joined(own, ladder)?);
    }
    for effect in found.catalogue.effects() {
        answers.insert(format!("/effects/{}", effect.id), value(effect)?);
    }
    let glossary = book_text(GLOSSARY).unwrap_or_default();
    answers.insert(format!("/docs/book/{GLOSSARY}"), Value::String(glossary));
    Ok(json!({
        "kind": if found.diagnosis.is_some() { "diagnose" } else if found.ladder.is_some() { "ladder" } else { "fit" },
        "id": ID,
        "command": std::env::args().skip(1).collect::<Vec<_>>(),
        "version": env!("CARGO_PKG_VERSION"),
        "made_at": made_at,
        "zone": fit.basis.as_ref().and_then(|basis| basis.zone.clone()),
        "answers": answers,
    }))
}

/// A fit with its verdict, as `GET /fits/{id}` shows one of which no service knows.
///
/// # Errors
/// Where it cannot be written.
pub fn fit_document(id: &str, fit: &Fit, judgement: &Judgement, made_at: &str) -> Result<Value, Failure> {
    let mut judged = json!({
        "id": id, "system": id, "verdict": judgement.verdict.as_str(), "summary": judgement.summary,
        "checks": judgement.checks, "waits_for_operator": false, "decision": null, "created_at": made_at,
    });
    if fit.parts.validation.is_none() {
        judged["verdict"] = Value::Null;
        judged["checks"] = json!([]);
        judged["summary"] = json!(
            "without unseen data there is nothing to judge: this is a study and no candidate for a controller"
        );
    }
    joined(judged, fit)
}

/// A document with what the service would add to it in front.
fn joined(mut own: Value, document: &impl Serialize) -> Result<Value, Failure> {
    if let (Value::Object(own), Value::Object(document)) = (&mut own, value(document)?) {
        for (name, entry) in document {
            own.entry(name).or_insert(entry);
        }
    }
    Ok(own)
}

fn value(document: &impl Serialize) -> Result<Value, Failure> {
    serde_json::to_value(document).map_err(|error| unwritten(&error))
}

fn read(document: Result<Vec<u8>, ServiceError>) -> Result<Value, Failure> {
    let bytes = document.map_err(|error| match error {
        ServiceError::Faults(found) => faults(&found),
        other => Failure::Error(other.to_string()),
    })?;
    serde_json::from_slice(&bytes).map_err(|error| unwritten(&error))
}

fn unwritten(error: &serde_json::Error) -> Failure {
    Failure::Error(format!("the report cannot be written: {error}"))
}

/// The file: styles, modules and data in one document that may ask nobody for anything.
fn document(data: &Value) -> Result<String, Failure> {
    let part =
        |path: &str| page_part(path).ok_or_else(|| Failure::Error(format!("the page has no part `{path}`")));
    let parts = |paths: &[&str]| {
        paths.iter().map(|path| part(path)).collect::<Result<Vec<_>, _>>().map(|parts| parts.join("\n"))
    };
    // No text of the data may end the element that holds it, whatever a column of the measurements is called.
    let data = data.to_string().replace('<', "\\u003c");
    let (styles, early, plot, script) =
        (parts(&STYLES)?, part("early.js")?, part("vendor/uPlot.iife.min.js")?, bundle::script("report.js")?);
    let licences = parts(&LICENCES)?;
    // Only what is written here may run: nobody can know the number before the data are there.
    let nonce = blake3::hash(data.as_bytes()).to_hex();
    Ok(format!(
        r#"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src data: blob:; base-uri 'none'; form-action 'none'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="referrer" content="no-referrer">
<title>Lampyris report</title>
<link rel="icon" href="data:,">
<style nonce="{nonce}">{styles}</style>
<script nonce="{nonce}">{early}</script>
</head>
<body>
<noscript>This report needs JavaScript.</noscript>
<div id="page"></div>
<div id="said" class="unseen" role="status" aria-live="polite"></div>
<script type="application/json" id="report">{data}</script>
<script type="text/plain" id="licences">{licences}</script>
<script nonce="{nonce}">{plot}</script>
<script nonce="{nonce}">{script}</script>
</body>
</html>
"#
    ))
}
