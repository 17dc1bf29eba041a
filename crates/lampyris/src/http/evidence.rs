//! What the windows of a system show of every effect, each for itself and together.

use super::extract::{Asked, Named};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::systems;
use crate::store;
use axum::extract::State;
use lampyris_core::data::{SystemId, rfc3339};
use lampyris_core::diagnose::ledger::{Apart, EffectScore, Ledger, LedgerWindow, Pooled, ledgers};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_evidence))
}

/// Which evidence is told.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct EvidenceQuery {
    /// Only that of this effect.
    effect: Option<String>,
    /// Only that beside this base model.
    model: Option<String>,
}

/// What the diagnoses of a system have seen of every effect, named or not.
#[derive(Debug, Serialize, ToSchema)]
struct Evidence {
    system: SystemId,
    /// By effect and base model, the most telling first; none before the first diagnosis.
    effects: Vec<EffectEvidence>,
}

/// What windows show of one effect beside one base model.
#[derive(Debug, Serialize, ToSchema)]
struct EffectEvidence {
    /// The effect's id.
    effect: String,
    /// The model that lacks it.
    model: String,
    /// Every window that was looked at, newest first.
    windows: Vec<EvidenceWindow>,
    /// What those that do not overlap show together; `null` where none has a size with a deviation.
    pooled: Option<Pooled>,
}

/// What one window shows of one effect.
#[derive(Debug, Serialize, ToSchema)]
struct EvidenceWindow {
    /// The diagnosis that looked; it may be forgotten by now.
    diagnosis: String,
    /// The first sample.
    #[schema(format = DateTime)]
    from: String,
    /// The end of the last one.
    #[schema(format = DateTime)]
    to: String,
    /// Hours of a segment.
    hours: f64,
    /// The effect's size, as a change of its first parameter from where it does nothing.
    size: f64,
    /// The deviation of that size, robust by days.
    deviation: f64,
    /// The unit of both.
    unit: String,
    /// The share of the squared error over these hours that it explains.
    share: f64,
    /// The size of the whole effect over its deviation; negative where physics does not allow the sign.
    t: f64,
    /// The same beyond whatever happens at the same hours every day.
    beyond_clock: f64,
    /// Days that were looked at.
    days: usize,
    /// The share of shifts of its channels by whole days with which it does as well; `null` where nobody
    /// asked.
    shift_p: Option<f64>,
    /// Whether it is added up with the others.
    pooled: bool,
    /// Why it is not.
    apart: Option<Apart>,
}

impl EffectEvidence {
    fn of(Ledger { effect, model, windows, pooled }: Ledger) -> Self {
        Self { effect, model, windows: windows.into_iter().map(EvidenceWindow::of).collect(), pooled }
    }
}

impl EvidenceWindow {
    fn of(LedgerWindow { entry, apart }: LedgerWindow) -> Self {
        let EffectScore { size, deviation, unit, share, t, beyond_clock, days, shift_p, .. } = entry.score;
        Self {
            diagnosis: entry.diagnosis,
            from: rfc3339(entry.span.from),
            to: rfc3339(entry.span.to),
            hours: entry.span.hours,
            size,
            deviation,
            unit,
            share,
            t,
            beyond_clock,
            days,
            shift_p,
            pooled: apart.is_none(),
            apart,
        }
    }
}

/// What the windows of a system show of every effect, each for itself and together.
///
/// Every diagnosis adds its window. Windows that do not overlap add up, beside the same base model: the
/// newest come first, older ones that share samples with them are listed and not added.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/evidence",
    tag = "diagnoses",
    params(("kind" = String, Path), ("id" = String, Path), EvidenceQuery),
    responses((status = 200, body = Evidence), Problems)
)]
async fn get_evidence(
    State(service): State<Shared>,
    Named(system): Named,
    Asked(query): Asked<EvidenceQuery>,
) -> Result<axum::Json<Evidence>, ApiError> {
    systems::require(&service, &system).await?;
    let entries =
        store::evidence::of(&service.store, &system, query.effect.as_deref(), query.model.as_deref()).await?;
    Ok(axum::Json(Evidence {
        system,
        effects: ledgers(&entries).into_iter().map(EffectEvidence::of).collect(),
    }))
}
