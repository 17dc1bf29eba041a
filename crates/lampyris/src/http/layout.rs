//! The layout of a building, proposed from one window of many sensors.

use super::description::With;
use super::extract::Raw;
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use super::windows::format;
use crate::service::catalogue::layout;
use axum::extract::State;
use lampyris_core::data::{Layout, NEIGHBOUR, SAME_ROOM, WindowDocument};
use lampyris_core::schema::Csv;
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
struct LayoutNotes {
    /// From which correlation on sensors are one room, and beyond which rooms are neighbours.
    thresholds: Thresholds,
    /// What the correlations are of, in a sentence.
    signal: &'static str,
    /// What was found while reading the window.
    warnings: Vec<String>,
}

type LayoutAnswer = With<LayoutNotes, Layout>;

/// The thresholds of the thesis.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = LayoutThresholds)]
struct Thresholds {
    same_room: f64,
    neighbour: f64,
}

const SIGNAL: &str = "Each pair is judged twice, over the samples that both have: by the temperatures, and \
    by the temperatures without the mean of the \
    surrounding day. The smaller of the two Pearson correlations counts, since rooms far apart drift \
    together with the weather.";

/// Proposes which sensors share a room and which rooms are neighbours, from one window of many temperatures.
///
/// The body is a window; the names of its channels are free. At least four days are needed, two weeks are
/// better. Sensors of one room need not correlate, so what is not proposed is not excluded.
#[utoipa::path(
    post,
    path = "/systems/layout",
    tag = "systems",
    request_body(content((WindowDocument = "application/json"), (Csv = "text/csv"))),
    responses(
        (status = 200, description = "A proposal; nothing is stored or bound", body = LayoutAnswer),
        Problems
    )
)]
async fn propose_layout(State(_): State<Shared>, raw: Raw) -> Result<axum::Json<LayoutAnswer>, ApiError> {
    let proposal = layout::propose(format(&raw)?, raw.body).await?;
    let thresholds = Thresholds { same_room: SAME_ROOM, neighbour: NEIGHBOUR };
    let own = LayoutNotes { thresholds, signal: SIGNAL, warnings: proposal.warnings };
    Ok(axum::Json(With { own, document: proposal.layout }))
}
