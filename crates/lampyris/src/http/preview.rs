//! What a model does: a short simulation for whoever edits it.

use super::access::Caller;
use super::extract::Json;
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::query::preview;
use axum::extract::State;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::assess::preview::Preview;
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::model::ModelId;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::EffectSpec;
use serde_json::Value;
use std::collections::HashMap;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(preview_model))
}

/// What is simulated. Every field has a default, but a model or a system must be named.
#[derive(Debug, ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "describes what `query::preview` reads")]
struct PreviewBody {
    /// The id of a model, or a whole model document; the system's own model by default.
    #[schema(value_type = Option<PreviewModel>)]
    model: Option<Value>,
    /// Effects to add: ids, or whole effect documents.
    #[serde(default)]
    #[schema(value_type = Vec<PreviewEffect>)]
    effects: Vec<Value>,
    /// Values of parameters in their units; the nominal ones for the others.
    #[serde(default)]
    #[schema(example = json!({"alpha_h": 0.4}))]
    parameters: HashMap<String, f64>,
    /// The system whose measurements drive the model. Without one the inputs are those of two standard days:
    /// a cool March with sun, heating by day, and people in the evening; channels that nobody knows step from
    /// 0 to 1 at noon.
    system: Option<SystemId>,
    /// Which of its measurements, at most 28 days: `last`, or `from` and `to`; the last seven by default.
    window: Option<WindowRange>,
    /// Most points of a curve, from 2 to 2000; 2000 by default. A longer one shows every so many samples.
    #[schema(minimum = 2, maximum = 2000)]
    max_points: Option<usize>,
}

/// A model by its id, or a whole model document.
#[derive(Debug, ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes what `query::preview` reads")]
enum PreviewModel {
    Named(ModelId),
    Document(Box<ModelDocument>),
}

/// An effect by its id, with its argument where it takes one, or a whole effect document.
#[derive(Debug, ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes what `query::preview` reads")]
enum PreviewEffect {
    Named(String),
    Document(Box<EffectSpec>),
}

/// A value with its unit.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `Quantity` of the core")]
struct PreviewQuantity {
    value: f64,
    unit: String,
}

/// A curve with its unit.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `Curve` of the core")]
struct PreviewCurve {
    unit: String,
    /// One per time; `null` where there is none.
    values: Vec<Option<f64>>,
}

/// An output, measured and simulated.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `OutputCurves` of the core")]
struct PreviewOutput {
    unit: String,
    measured: Vec<Option<f64>>,
    /// The free run; `null` where an input is unknown.
    simulated: Vec<Option<f64>>,
    /// Root mean square of their difference over the whole window.
    rmse: Option<f64>,
}

/// What the model does.
#[derive(Debug, ToSchema)]
#[schema(as = Preview)]
#[expect(dead_code, reason = "describes `Preview` of the core")]
struct PreviewAnswer {
    /// The model with its effects.
    #[schema(example = "room3+wind_infiltration")]
    model: String,
    /// Hash of its content with these channels.
    hash: String,
    /// Whether the inputs are those of the standard days.
    synthetic: bool,
    /// The values that were used.
    parameters: HashMap<String, PreviewQuantity>,
    /// What was left out because its channels are not there.
    dropped: Vec<String>,
    /// Whether the simulation left the numbers or physics.
    diverged: bool,
    /// Every how many samples one is shown.
    every: usize,
    /// The instants.
    time: Vec<String>,
    /// By channel.
    outputs: HashMap<String, PreviewOutput>,
    /// By name.
    states: HashMap<String, PreviewCurve>,
    /// By channel.
    inputs: HashMap<String, PreviewCurve>,
}

/// Simulates a model once with nominal or given values. Nothing is kept.
///
/// Faults of a posted model name their places inside it (`/model/equations/T_r`), with line and column; so do
/// those of posted effects (`/effects/0/terms/T_r`). A model too large for its window is refused
/// (`too-expensive`).
#[utoipa::path(
    post,
    path = "/models/preview",
    tag = "models",
    request_body = PreviewBody,
    responses((status = 200, description = "What it does", body = PreviewAnswer), Problems)
)]
async fn preview_model(
    State(service): State<Shared>,
    caller: Caller,
    body: Json,
) -> Result<axum::Json<Preview>, ApiError> {
    caller.may_name(&service, &body.value)?;
    Ok(axum::Json(preview::run(&service, body.value).await?))
}
