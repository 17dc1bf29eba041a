//! Comparisons as documents: JSON for the page, CSV for a spreadsheet. Both hold the same numbers, with all
//! their digits.

use super::subject::{ComparisonAsked, NamedFit, Subject};
use crate::service::error::ServiceError;
use indexmap::IndexMap;
use lampyris_core::data::{Duration, Envelope, Thinning, rfc3339};
use lampyris_core::estimate::Replay;
use lampyris_core::estimate::assess::compare::{Compared, ErrorRow};
use lampyris_core::estimate::assess::comparison::{Comparison, OutputErrors, PartSpan};
use lampyris_core::estimate::assess::replay::Provenance;
use serde::Serialize;

/// A line of a chart: every sample, or the extremes of stretches of them.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Line {
    All { values: Vec<Option<f64>> },
    Thinned(Envelope),
}

/// Says that lines were thinned, and how.
#[derive(Debug, Serialize)]
struct ThinningNote {
    method: &'static str,
    samples_per_point: usize,
    comment: String,
}

/// What every comparison says about itself.
#[derive(Debug, Serialize)]
struct Frame {
    mode: &'static str,
    horizon: Option<Duration>,
    from: String,
    to: String,
    step_s: i64,
    samples: usize,
    thinning: Option<ThinningNote>,
}

#[derive(Debug, Serialize)]
struct ComparisonDocument<'a> {
    fit: &'a str,
    system: &'a str,
    model: &'a str,
    #[serde(flatten)]
    frame: Frame,
    provenance: &'a Provenance,
    parts: &'a [PartSpan],
    errors: &'a IndexMap<String, OutputErrors>,
    time: Vec<String>,
    outputs: IndexMap<&'a str, OutputBody<'a>>,
    inputs: IndexMap<&'a str, InputBody<'a>>,
}

#[derive(Debug, Serialize)]
struct OutputBody<'a> {
    unit: &'a str,
    error_unit: &'a str,
    measured: Line,
    simulated: Line,
    residual: Line,
}

#[derive(Debug, Serialize)]
struct InputBody<'a> {
    unit: &'a str,
    #[serde(flatten)]
    line: Line,
}

#[derive(Debug, Serialize)]
struct ComparedDocument<'a> {
    system: String,
    #[serde(flatten)]
    frame: Frame,
    fits: Vec<ComparedFit<'a>>,
    errors: &'a [ErrorRow],
    time: Vec<String>,
    outputs: IndexMap<&'a str, ComparedBody<'a>>,
}

#[derive(Debug, Serialize)]
struct ComparedFit<'a> {
    fit: &'a str,
    model: &'a str,
    provenance: &'a Provenance,
    parts: &'a [PartSpan],
}

#[derive(Debug, Serialize)]
struct ComparedBody<'a> {
    unit: &'a str,
    measured: Line,
    simulated: IndexMap<&'a str, Line>,
}

/// The points of an answer.
struct Points {
    start: i64,
    step: i64,
    samples: usize,
    thinning: Thinning,
}

impl Points {
    fn new(start: i64, step: i64, samples: usize, asked: &ComparisonAsked) -> Self {
        Self { start, step, samples, thinning: Thinning::new(samples, asked.max_points) }
    }

    fn frame(&self, asked: &ComparisonAsked) -> Frame {
        let per_point = self.thinning.per_point();
        let comment = || {
            format!(
                "each point stands for up to {per_point} samples from its time on, with their lowest and \
                highest value; a shorter gap does not show"
            )
        };
        Frame {
            mode: if asked.horizon.is_some() { "ahead" } else { "free_run" },
            horizon: asked.horizon,
            from: rfc3339(self.start),
            to: rfc3339(self.start + self.step * self.samples.saturating_sub(1) as i64),
            step_s: self.step,
            samples: self.samples,
            thinning: (per_point > 1).then(|| ThinningNote {
                method: "min_max",
                samples_per_point: per_point,
                comment: comment(),
            }),
        }
    }

    fn times(&self) -> Vec<String> {
        self.thinning.starts().map(|k| rfc3339(self.start + self.step * k as i64)).collect()
    }

    fn line(&self, values: &[Option<f64>]) -> Line {
        if self.thinning.per_point() == 1 {
            Line::All { values: values.to_vec() }
        } else {
            Line::Thinned(self.thinning.envelope(values))
        }
    }
}

/// One fit beside the measurements.
pub(super) fn comparison_json(
    named: &NamedFit<'_>,
    asked: &ComparisonAsked,
    replay: &Replay,
    comparison: &Comparison,
) -> Result<Vec<u8>, ServiceError> {
    let points = points_of(asked, comparison);
    let outputs = comparison.outputs.iter().map(|(channel, lines)| {
        let body = OutputBody {
            unit: &lines.unit,
            error_unit: &lines.error_unit,
            measured: points.line(&lines.measured),
            simulated: points.line(&lines.simulated),
            residual: points.line(&lines.residual()),
        };
        (channel.as_str(), body)
    });
    let inputs = comparison.inputs.iter().map(|(channel, input)| {
        let body = InputBody { unit: &input.unit, line: points.line(&input.values) };
        (channel.as_str(), body)
    });
    json(&ComparisonDocument {
        fit: named.id,
        system: named.system,
        model: &named.fit.model,
        frame: points.frame(asked),
        provenance: replay.provenance(),
        parts: &comparison.parts,
        errors: &comparison.errors,
        time: points.times(),
        outputs: outputs.collect(),
        inputs: inputs.collect(),
    })
}

fn points_of(asked: &ComparisonAsked, comparison: &Comparison) -> Points {
    let samples = comparison.outputs.values().next().map_or(0, |lines| lines.measured.len());
    Points::new(comparison.start, comparison.step, samples, asked)
}

/// The same as a table.
pub(super) fn comparison_csv(
    asked: &ComparisonAsked,
    comparison: &Comparison,
) -> Result<Vec<u8>, ServiceError> {
    let points = points_of(asked, comparison);
    let mut columns = Vec::new();
    for (channel, lines) in &comparison.outputs {
        columns.push((channel.clone(), lines.unit.as_str(), points.line(&lines.measured)));
        columns.push((format!("simulated_{channel}"), &lines.unit, points.line(&lines.simulated)));
        columns.push((format!("residual_{channel}"), &lines.error_unit, points.line(&lines.residual())));
    }
    // An output that is an input as well has its column already.
    let inputs = comparison.inputs.iter().filter(|(channel, _)| !comparison.outputs.contains_key(*channel));
    columns.extend(
        inputs.map(|(channel, input)| (channel.clone(), input.unit.as_str(), points.line(&input.values))),
    );
    csv(&points, &columns)
}

/// Several fits beside each other.
pub(super) fn compared_json(
    subjects: &[Subject],
    asked: &ComparisonAsked,
    replays: &[Replay],
    compared: &Compared,
) -> Result<Vec<u8>, ServiceError> {
    let points = points_of_compared(asked, compared);
    let fits = subjects.iter().zip(replays).map(|(subject, replay)| ComparedFit {
        fit: &subject.record().id,
        model: &subject.fit().model,
        provenance: replay.provenance(),
        parts: &compared.parts[&subject.record().id],
    });
    let outputs = compared.outputs.iter().map(|(channel, output)| {
        let simulated =
            output.simulated.iter().map(|(fit, values)| (fit.as_str(), points.line(values))).collect();
        (
            channel.as_str(),
            ComparedBody { unit: &output.unit, measured: points.line(&output.measured), simulated },
        )
    });
    json(&ComparedDocument {
        system: subjects.first().map(|subject| subject.record().system.to_string()).unwrap_or_default(),
        frame: points.frame(asked),
        fits: fits.collect(),
        errors: &compared.errors,
        time: points.times(),
        outputs: outputs.collect(),
    })
}

fn points_of_compared(asked: &ComparisonAsked, compared: &Compared) -> Points {
    let samples = compared.outputs.values().next().map_or(0, |output| output.measured.len());
    Points::new(compared.start, compared.step, samples, asked)
}

/// The same as a table.
pub(super) fn compared_csv(asked: &ComparisonAsked, compared: &Compared) -> Result<Vec<u8>, ServiceError> {
    let points = points_of_compared(asked, compared);
    let mut columns = Vec::new();
    for (channel, output) in &compared.outputs {
        columns.push((channel.clone(), output.unit.as_str(), points.line(&output.measured)));
        let simulated = output.simulated.iter();
        columns.extend(simulated.map(|(fit, values)| {
            (format!("simulated_{channel}_{fit}"), output.unit.as_str(), points.line(values))
        }));
    }
    csv(&points, &columns)
}

/// Writes a document.
pub(super) fn json<T: Serialize>(document: &T) -> Result<Vec<u8>, ServiceError> {
    serde_json::to_vec(document).map_err(|error| ServiceError::Internal(error.to_string()))
}

/// Writes columns with their units as `POST …/windows` reads them; of thinned lines both edges. What a name
/// is comes first, because `T_room_<something>` is the room next door.
fn csv(points: &Points, columns: &[(String, &str, Line)]) -> Result<Vec<u8>, ServiceError> {
    let mut headers = vec!["time".to_owned()];
    let mut series: Vec<&[Option<f64>]> = Vec::new();
    for (name, unit, line) in columns {
        match line {
            Line::All { values } => {
                headers.push(format!("{name}[{unit}]"));
                series.push(values);
            }
            Line::Thinned(envelope) => {
                headers.extend([format!("min_{name}[{unit}]"), format!("max_{name}[{unit}]")]);
                series.extend([envelope.min.as_slice(), envelope.max.as_slice()]);
            }
        }
    }
    let failed = |error: csv::Error| ServiceError::Internal(error.to_string());
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(&headers).map_err(failed)?;
    for (row, time) in points.times().into_iter().enumerate() {
        let cells =
            series.iter().map(|values| values[row].map_or_else(String::new, |value| value.to_string()));
        table.write_record(std::iter::once(time).chain(cells)).map_err(failed)?;
    }
    table.into_inner().map_err(|error| ServiceError::Internal(error.to_string()))
}
