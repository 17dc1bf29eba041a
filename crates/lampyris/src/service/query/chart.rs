//! Comparisons as documents: JSON for the page, CSV for a spreadsheet. Both hold the same numbers, with all
//! their digits.

use super::subject::{ComparisonAsked, NamedFit, Subject};
use crate::service::error::ServiceError;
use indexmap::IndexMap;
use lampyris_core::data::{Duration, Envelope, Seconds, Thinning, rfc3339};
use lampyris_core::estimate::Replay;
use lampyris_core::estimate::assess::compare::{Compared, ErrorRow};
use lampyris_core::estimate::assess::comparison::{Comparison, OutputErrors, PartSpan};
use lampyris_core::estimate::assess::replay::Provenance;
use serde::Serialize;
use utoipa::ToSchema;

/// A line: `values`, or `min` and `max` where it is thinned. `null` is a gap.
#[derive(Debug, Default, Serialize, ToSchema)]
struct Line {
    #[serde(skip_serializing_if = "Option::is_none")]
    values: Option<Vec<Option<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<Vec<Option<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<Vec<Option<f64>>>,
}

/// How lines were thinned.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Thinning)]
struct ThinningNote {
    /// `min_max`: the lowest and the highest value of each stretch.
    method: &'static str,
    /// Samples to a point.
    #[schema(value_type = u64)]
    samples_per_point: usize,
    /// The same in a sentence.
    comment: String,
}

/// A fit beside the measurements.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Comparison)]
pub struct ComparisonDocument<'a> {
    fit: &'a str,
    system: &'a str,
    model: &'a str,
    /// `free_run` or `ahead`.
    mode: &'static str,
    /// How far ahead; `null` for a free run.
    #[schema(value_type = Option<String>)]
    horizon: Option<Duration>,
    /// The first sample that is shown.
    #[schema(format = DateTime)]
    from: String,
    /// The last one.
    #[schema(format = DateTime)]
    to: String,
    /// Seconds between samples.
    step_s: Seconds,
    /// Samples in the range.
    #[schema(value_type = u64)]
    samples: usize,
    /// How lines were thinned; `null` where every sample is there.
    thinning: Option<ThinningNote>,
    provenance: &'a Provenance,
    /// Which part of the fit's window each stretch belongs to: `train`, `validation`, `test`, or `after` it.
    parts: &'a [PartSpan],
    /// Errors by output: `unit`, over the whole `range`, and over its `parts`. Forecasts count in a part
    /// where origin and target lie in it.
    errors: &'a IndexMap<String, OutputErrors>,
    /// The times of the points.
    time: Vec<String>,
    /// By channel.
    outputs: IndexMap<&'a str, OutputBody<'a>>,
    /// The model's inputs by channel: a unit beside a line.
    inputs: IndexMap<&'a str, InputBody<'a>>,
}

/// One output.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = OutputLines)]
struct OutputBody<'a> {
    /// Unit of `measured` and `simulated`.
    unit: &'a str,
    /// Unit of `residual`.
    error_unit: &'a str,
    measured: Line,
    simulated: Line,
    /// Measured minus simulated: positive where the model is too low.
    residual: Line,
}

/// One input.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = InputLine)]
struct InputBody<'a> {
    unit: &'a str,
    #[serde(flatten)]
    #[schema(inline)]
    line: Line,
}

/// Several fits beside the measurements.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Compare)]
pub struct ComparedDocument<'a> {
    system: String,
    /// `free_run` or `ahead`.
    mode: &'static str,
    /// How far ahead; `null` for free runs.
    #[schema(value_type = Option<String>)]
    horizon: Option<Duration>,
    /// The first sample that is shown.
    #[schema(format = DateTime)]
    from: String,
    /// The last one.
    #[schema(format = DateTime)]
    to: String,
    /// Seconds between samples: the longest step of a fit.
    step_s: Seconds,
    /// Samples in the range.
    #[schema(value_type = u64)]
    samples: usize,
    /// How lines were thinned; `null` where every sample is there.
    thinning: Option<ThinningNote>,
    /// The fits, with what each stretch was to them.
    fits: Vec<ComparedFit<'a>>,
    /// Errors by fit, output and horizon, on the samples that all fits have.
    errors: &'a [ErrorRow],
    /// The times of the points.
    time: Vec<String>,
    /// By channel.
    outputs: IndexMap<&'a str, ComparedBody<'a>>,
}

/// One fit of several.
#[derive(Debug, Serialize, ToSchema)]
struct ComparedFit<'a> {
    fit: &'a str,
    model: &'a str,
    provenance: &'a Provenance,
    parts: &'a [PartSpan],
}

/// One output of several fits.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ComparedOutput)]
struct ComparedBody<'a> {
    unit: &'a str,
    measured: Line,
    /// By fit.
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

    fn from(&self) -> String {
        rfc3339(self.start)
    }

    fn to(&self) -> String {
        rfc3339(self.start + self.step * self.samples.saturating_sub(1) as i64)
    }

    /// That lines were thinned, and how.
    fn note(&self) -> Option<ThinningNote> {
        let per_point = self.thinning.per_point();
        (per_point > 1).then(|| ThinningNote {
            method: "min_max",
            samples_per_point: per_point,
            comment: format!(
                "each point stands for up to {per_point} samples from its time on, with their lowest and \
                highest value; a shorter gap does not show"
            ),
        })
    }

    fn times(&self) -> Vec<String> {
        self.thinning.starts().map(|k| rfc3339(self.start + self.step * k as i64)).collect()
    }

    fn line(&self, values: &[Option<f64>]) -> Line {
        if self.thinning.per_point() == 1 {
            Line { values: Some(values.to_vec()), ..Line::default() }
        } else {
            let Envelope { min, max } = self.thinning.envelope(values);
            Line { min: Some(min), max: Some(max), ..Line::default() }
        }
    }
}

/// Which series are shown, in a word.
fn mode(asked: &ComparisonAsked) -> &'static str {
    if asked.horizon.is_some() { "ahead" } else { "free_run" }
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
        mode: mode(asked),
        horizon: asked.horizon,
        from: points.from(),
        to: points.to(),
        step_s: Seconds::of_millis(points.step),
        samples: points.samples,
        thinning: points.note(),
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
        mode: mode(asked),
        horizon: asked.horizon,
        from: points.from(),
        to: points.to(),
        step_s: Seconds::of_millis(points.step),
        samples: points.samples,
        thinning: points.note(),
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
        for (edge, values) in [("", &line.values), ("min_", &line.min), ("max_", &line.max)] {
            if let Some(values) = values {
                headers.push(format!("{edge}{name}[{unit}]"));
                series.push(values);
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
