//! The layout of a building, proposed from one window of many sensors.

use super::Shared;
use super::extract::Raw;
use super::problem::{ApiError, Problems};
use super::windows::{WindowBody, format};
use crate::data::{Layout, NEIGHBOUR, SAME_ROOM};
use crate::jobs::layout;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(propose_layout))
}

/// A proposal for an operator to confirm. Nothing is stored or bound.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Layout)]
struct LayoutAnswer {
    #[serde(flatten)]
    #[schema(value_type = LayoutBody)]
    layout: Layout,
    /// From which correlation on sensors are one room, and beyond which rooms are neighbours.
    thresholds: Thresholds,
    /// What the correlations are of, in a sentence.
    signal: &'static str,
    /// What was found while reading the window.
    warnings: Vec<String>,
}

/// The thresholds of the thesis.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = LayoutThresholds)]
struct Thresholds {
    same_room: f64,
    neighbour: f64,
}

/// What was found.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `data::Layout`, which knows nothing of HTTP")]
struct LayoutBody {
    /// Plain sentences.
    summary: String,
    /// The rooms, in the order of their first sensor.
    rooms: Vec<LayoutRoom>,
    /// Pairs of rooms, the most alike first.
    neighbours: Vec<LayoutPair>,
    /// The sensors, in the order of the rows and columns of the matrices.
    sensors: Vec<LayoutSensor>,
    /// What counts: the smaller of `levels` and `daily`; `null` where two sensors have less than three days in common.
    correlation: Vec<Vec<Option<f64>>>,
    /// Correlations of the temperatures.
    levels: Vec<Vec<Option<f64>>>,
    /// Correlations of the temperatures without the mean of the surrounding day.
    daily: Vec<Vec<Option<f64>>>,
    /// The step of the samples that were compared, in seconds.
    step_s: i64,
    /// The first sample.
    #[schema(format = DateTime)]
    from: String,
    /// The last sample.
    #[schema(format = DateTime)]
    to: String,
    /// Channels that are no sensors of rooms, with the reason.
    left_out: Vec<LayoutLeftOut>,
}

/// Sensors that are probably in one room.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `data::Room`")]
struct LayoutRoom {
    /// A name that a system could have.
    id: String,
    sensors: Vec<String>,
    /// The sensor with the most samples: the one to bind.
    representative: String,
    /// The lowest correlation of two of its sensors; `null` for a single one.
    correlation: Option<f64>,
}

/// Two rooms that are probably neighbours.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `data::Pair`")]
struct LayoutPair {
    /// Their ids.
    rooms: [String; 2],
    correlation: f64,
    /// Samples that both representatives have.
    samples: u64,
}

/// A sensor that was compared.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `data::Sensor`")]
struct LayoutSensor {
    channel: String,
    samples: u64,
}

/// A channel that was not compared.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `data::LeftOut`")]
struct LayoutLeftOut {
    channel: String,
    reason: String,
}

const SIGNAL: &str = "Each pair is judged twice, over the samples that both have: by the temperatures, and by the temperatures without the mean of the \
    surrounding day. The smaller of the two Pearson correlations counts, since rooms far apart drift together with the weather.";

/// Proposes which sensors share a room and which rooms are neighbours, from one window of many temperatures.
///
/// The body is a window; the names of its channels are free. At least four days are needed, two weeks are better.
/// Sensors of one room need not correlate, so what is not proposed is not excluded.
#[utoipa::path(
    post,
    path = "/systems/layout",
    tag = "systems",
    request_body(content((WindowBody = "application/json"), (String = "text/csv"))),
    responses((status = 200, description = "A proposal; nothing is stored or bound", body = LayoutAnswer), Problems)
)]
async fn propose_layout(State(_): State<Shared>, raw: Raw) -> Result<axum::Json<LayoutAnswer>, ApiError> {
    let proposal = layout::propose(format(&raw)?, raw.body).await?;
    Ok(axum::Json(LayoutAnswer {
        layout: proposal.layout,
        thresholds: Thresholds { same_room: SAME_ROOM, neighbour: NEIGHBOUR },
        signal: SIGNAL,
        warnings: proposal.warnings,
    }))
}
