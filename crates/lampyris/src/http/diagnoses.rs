//! Which effect a model is missing, and the error ladder.

use super::access::Caller;
use super::description::{Stored, With};
use super::extract::{Asked, Named};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::systems;
use crate::store;
use crate::store::diagnoses::DiagnosisRecord;
use axum::extract::{Path, State};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::ladder::Ladder;
use lampyris_core::diagnose::{Adequacy, Diagnosis};
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(list_diagnoses))
        .routes(routes!(get_diagnosis))
        .routes(routes!(get_ladder))
}

/// A diagnosis: verdict, findings with evidence, what was considered, what these data cannot show, what is
/// left.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Diagnosis)]
struct DiagnosisName {
    id: String,
    /// The job that made it.
    job: String,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

type DiagnosisAnswer = With<DiagnosisName, Stored<Diagnosis>>;

/// One diagnosis in a list.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DiagnosisSummary)]
struct DiagnosisRow {
    id: String,
    /// The job that made it.
    job: String,
    /// The system.
    system: String,
    /// The model that was diagnosed.
    #[schema(value_type = String)]
    model: Value,
    /// The fit that it starts from.
    fit: String,
    /// What it comes to.
    #[schema(value_type = Adequacy)]
    verdict: String,
    /// In a sentence.
    #[schema(value_type = String)]
    summary: Value,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

/// The error ladder of a system: the base model, then effects one after another.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Ladder)]
struct LadderName {
    /// The job that made it.
    job: String,
    /// The fit of its base.
    fit: String,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

type LadderAnswer = With<LadderName, Stored<Ladder>>;

/// Which diagnoses are listed.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct DiagnosisQuery {
    /// Only those of this system.
    #[param(value_type = Option<SystemId>)]
    system: Option<String>,
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

impl DiagnosisRow {
    fn of(mut record: DiagnosisRecord) -> Self {
        let mut take = |field: &str| record.document.get_mut(field).map(Value::take).unwrap_or_default();
        Self {
            model: take("model"),
            summary: take("summary"),
            id: record.id,
            job: record.job,
            system: record.system.to_string(),
            fit: record.fit,
            verdict: record.verdict,
            created_at: record.created_at,
        }
    }
}

/// Diagnoses, newest first.
#[utoipa::path(
    get,
    path = "/diagnoses",
    tag = "diagnoses",
    params(DiagnosisQuery),
    responses((status = 200, body = Page<DiagnosisRow>), Problems)
)]
async fn list_diagnoses(
    State(service): State<Shared>,
    caller: Caller,
    Asked(query): Asked<DiagnosisQuery>,
) -> Result<axum::Json<Page<DiagnosisRow>>, ApiError> {
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let system = query.system.as_deref().map(str::parse::<SystemId>).transpose();
    let system = system.map_err(|error| {
        ApiError::Invalid(vec![Fault::new("query system", "invalid-system", error.to_string())])
    })?;
    let size = page.size()?;
    let records =
        store::diagnoses::page(&service.store, caller.reach(), system.as_ref(), page.before()?, size + 1)
            .await?;
    Ok(axum::Json(Page::of(records, size, |record| record.sequence.to_string(), DiagnosisRow::of)))
}

/// One diagnosis.
#[utoipa::path(
    get,
    path = "/diagnoses/{id}",
    tag = "diagnoses",
    params(("id" = String, Path)),
    responses((status = 200, body = DiagnosisAnswer), Problems)
)]
async fn get_diagnosis(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<DiagnosisAnswer>, ApiError> {
    let record =
        store::diagnoses::get(&service.store, &id).await?.ok_or(ApiError::NotFound("diagnosis", id))?;
    Ok(axum::Json(With {
        own: DiagnosisName { id: record.id, job: record.job, created_at: record.created_at },
        document: Stored::of(record.document),
    }))
}

/// The newest error ladder of a system.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/ladder",
    tag = "diagnoses",
    params(("kind" = String, Path), ("id" = String, Path)),
    responses((status = 200, body = LadderAnswer), Problems)
)]
async fn get_ladder(
    State(service): State<Shared>,
    Named(system): Named,
) -> Result<axum::Json<LadderAnswer>, ApiError> {
    systems::require(&service, &system).await?;
    let record = store::diagnoses::newest_ladder(&service.store, &system).await?;
    let record = record.ok_or_else(|| ApiError::NotFound("ladder", system.to_string()))?;
    Ok(axum::Json(With {
        own: LadderName { job: record.job, fit: record.fit, created_at: record.created_at },
        document: Stored::of(record.document),
    }))
}
