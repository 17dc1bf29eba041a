//! The documents that `query::chart` writes, as the description of the surface knows them.

use std::collections::HashMap;
use utoipa::ToSchema;

/// A fit beside the measurements.
#[derive(Debug, ToSchema)]
#[schema(as = Comparison)]
#[expect(dead_code, reason = "describes what `query::chart` writes; a test keeps the two alike")]
pub struct ComparisonBody {
    fit: String,
    system: String,
    model: String,
    /// `free_run` or `ahead`.
    mode: String,
    /// How far ahead; `null` for a free run.
    horizon: Option<String>,
    /// The first sample that is shown.
    #[schema(format = DateTime)]
    from: String,
    /// The last one.
    #[schema(format = DateTime)]
    to: String,
    /// Seconds between samples.
    step_s: i64,
    /// Samples in the range.
    samples: u64,
    /// How lines were thinned; `null` where every sample is there.
    thinning: Option<ThinningBody>,
    provenance: ProvenanceBody,
    /// Which part of the fit's window each stretch belongs to: `train`, `validation`, `test`, or `after` it.
    parts: Vec<PartBody>,
    /// Errors by output: `unit`, over the whole `range`, and over its `parts`. Forecasts count in a part
    /// where origin and target lie in it.
    errors: HashMap<String, OutputErrorsBody>,
    /// The times of the points.
    time: Vec<String>,
    /// By channel.
    outputs: HashMap<String, OutputBody>,
    /// The model's inputs by channel: a unit beside a line.
    inputs: HashMap<String, InputBody>,
}

/// How lines were thinned.
#[derive(Debug, ToSchema)]
#[schema(as = Thinning)]
#[expect(dead_code, reason = "describes what `query::chart` writes")]
pub struct ThinningBody {
    /// `min_max`: the lowest and the highest value of each stretch.
    method: String,
    /// Samples to a point.
    samples_per_point: u64,
    /// The same in a sentence.
    comment: String,
}

/// Whether a stored fit and what is shown of it belong together.
#[derive(Debug, ToSchema)]
#[schema(as = Provenance)]
#[expect(dead_code, reason = "describes `estimate::replay::Provenance`")]
pub struct ProvenanceBody {
    /// Hash of the measurements of the fit's window as they are now.
    input_hash: String,
    /// Hash of those that the fit was made from.
    fit_input_hash: String,
    /// Whether newer uploads or exclusions have changed them.
    measurements_changed: bool,
    /// Whether the documents of the model say something else by now.
    model_changed: bool,
    /// Whether the stored error on the training part comes out again.
    reproduced: bool,
    /// All of this in a sentence.
    comment: String,
}

/// A stretch of a fit's window.
#[derive(Debug, ToSchema)]
#[schema(as = PartSpan)]
#[expect(dead_code, reason = "describes `estimate::comparison::PartSpan`")]
pub struct PartBody {
    part: String,
    #[schema(format = DateTime)]
    from: String,
    #[schema(format = DateTime)]
    to: String,
}

/// The skill of a series y beside measurements m, with the error e = y - m.
#[derive(Debug, ToSchema)]
#[schema(as = Skill)]
#[expect(dead_code, reason = "describes `estimate::skill::Skill`")]
pub struct SkillBody {
    /// Pairs that were compared.
    n: u64,
    /// Mean of e: positive where the model is too high.
    bias: f64,
    /// Root of the mean of e2.
    rmse: f64,
    /// The same of e without its mean.
    urmse: f64,
    /// Mean of |e|.
    mae: f64,
    /// 1 - sum e2 / sum (m - mean m)2; `null` where the measurements do not change.
    r2: Option<f64>,
}

/// Errors of one output.
#[derive(Debug, ToSchema)]
#[schema(as = OutputErrors)]
#[expect(dead_code, reason = "describes `estimate::comparison::OutputErrors`")]
pub struct OutputErrorsBody {
    unit: String,
    range: Option<SkillBody>,
    parts: HashMap<String, SkillBody>,
}

/// A line: `values`, or `min` and `max` where it is thinned. `null` is a gap.
#[derive(Debug, ToSchema)]
#[schema(as = Line)]
#[expect(dead_code, reason = "describes what `query::chart` writes")]
pub struct LineBody {
    values: Option<Vec<Option<f64>>>,
    min: Option<Vec<Option<f64>>>,
    max: Option<Vec<Option<f64>>>,
}

/// One output.
#[derive(Debug, ToSchema)]
#[schema(as = OutputLines)]
#[expect(dead_code, reason = "describes what `query::chart` writes")]
pub struct OutputBody {
    /// Unit of `measured` and `simulated`.
    unit: String,
    /// Unit of `residual`.
    error_unit: String,
    measured: LineBody,
    simulated: LineBody,
    /// Measured minus simulated: positive where the model is too low.
    residual: LineBody,
}

/// One input.
#[derive(Debug, ToSchema)]
#[schema(as = InputLine)]
#[expect(dead_code, reason = "describes what `query::chart` writes")]
pub struct InputBody {
    unit: String,
    values: Option<Vec<Option<f64>>>,
    min: Option<Vec<Option<f64>>>,
    max: Option<Vec<Option<f64>>>,
}

/// Several fits beside the measurements.
#[derive(Debug, ToSchema)]
#[schema(as = Compare)]
#[expect(dead_code, reason = "describes what `query::chart` writes; a test keeps the two alike")]
pub struct CompareBody {
    system: String,
    /// `free_run` or `ahead`.
    mode: String,
    /// How far ahead; `null` for free runs.
    horizon: Option<String>,
    /// The first sample that is shown.
    #[schema(format = DateTime)]
    from: String,
    /// The last one.
    #[schema(format = DateTime)]
    to: String,
    /// Seconds between samples: the longest step of a fit.
    step_s: i64,
    /// Samples in the range.
    samples: u64,
    /// How lines were thinned; `null` where every sample is there.
    thinning: Option<ThinningBody>,
    /// The fits, with what each stretch was to them.
    fits: Vec<ComparedFitBody>,
    /// Errors by fit, output and horizon, on the samples that all fits have.
    errors: Vec<ErrorRowBody>,
    /// The times of the points.
    time: Vec<String>,
    /// By channel.
    outputs: HashMap<String, ComparedOutputBody>,
}

/// One fit of several.
#[derive(Debug, ToSchema)]
#[schema(as = ComparedFit)]
#[expect(dead_code, reason = "describes what `query::chart` writes")]
pub struct ComparedFitBody {
    fit: String,
    model: String,
    provenance: ProvenanceBody,
    parts: Vec<PartBody>,
}

/// The errors of one fit in one output at one horizon, beside those of a skill.
#[derive(Debug, ToSchema)]
#[schema(as = ErrorRow)]
#[expect(dead_code, reason = "describes `estimate::compare::ErrorRow`")]
pub struct ErrorRowBody {
    fit: String,
    output: String,
    unit: String,
    /// `free_run`, or how far ahead.
    horizon: String,
    /// `range`: all samples that all fits have; `unseen`: those of them in no fit's training part.
    over: String,
    n: u64,
    bias: f64,
    rmse: f64,
    urmse: f64,
    mae: f64,
    r2: Option<f64>,
}

/// One output of several fits.
#[derive(Debug, ToSchema)]
#[schema(as = ComparedOutput)]
#[expect(dead_code, reason = "describes what `query::chart` writes")]
pub struct ComparedOutputBody {
    unit: String,
    measured: LineBody,
    /// By fit.
    simulated: HashMap<String, LineBody>,
}
