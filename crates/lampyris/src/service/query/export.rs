//! The model behind a fit, written for other programs.

use super::subject;
use crate::service::catalogue::models::compiled;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::interactive::RenderedAnswer;
use crate::store::fits::FitRecord;
use lampyris_core::data::{HOUR, SystemId};
use lampyris_core::estimate::assess::replay::model_of;
use lampyris_core::fault::Fault;
use lampyris_core::model::ModelId;
use lampyris_core::model::export::{self, EquationFormat, ExportFormat, ExportSource, ExportedModel};
use lampyris_core::simulate::LONGEST_STEP_HOURS;
use serde::Serialize;
use utoipa::ToSchema;

/// A model with the parameters of a fit.
#[derive(Debug, Serialize, ToSchema)]
pub struct FittedModel {
    /// The system.
    system: SystemId,
    /// The fit.
    fit: String,
    /// The revision, where it was asked for what is served.
    revision: Option<i64>,
    #[serde(flatten)]
    #[schema(inline)]
    exported: ExportedModel,
}

/// The model of a fit.
///
/// # Errors
/// Where there is no such fit, or its model has changed since.
pub(crate) async fn of_fit(
    service: &Service,
    id: &str,
    format: ExportFormat,
) -> Result<RenderedAnswer, ServiceError> {
    answer(service, subject::require(service, id).await?, None, format).await
}

/// The equations of a model of the catalogue, without values.
///
/// # Errors
/// Where its documents do not agree.
pub(crate) async fn of_model(
    service: &Service,
    id: ModelId,
    format: EquationFormat,
) -> Result<RenderedAnswer, ServiceError> {
    let catalogue = service.catalogue.current();
    let work = move || Ok(export::equations(&compiled(&catalogue, &id)?, format).into_bytes());
    service.interactive.once(move |_| work().map_err(ServiceError::Faults)).await
}

/// The model of the parameters that are served.
///
/// # Errors
/// Where there is no such system, nothing is served, or the model has changed since.
pub(crate) async fn in_force(
    service: &Service,
    system: &SystemId,
    format: ExportFormat,
) -> Result<RenderedAnswer, ServiceError> {
    let (revision, record) = subject::in_force(service, system).await?;
    answer(service, record, Some(revision), format).await
}

async fn answer(
    service: &Service,
    record: FitRecord,
    revision: Option<i64>,
    format: ExportFormat,
) -> Result<RenderedAnswer, ServiceError> {
    let catalogue = service.catalogue.current();
    let work = move || {
        let fit = &record.fit;
        let model = model_of(&catalogue, fit)?;
        if model.hash() != fit.model_hash {
            let detail =
                format!("the documents of `{}` have changed since this fit: fit it again", fit.model);
            return Err(vec![Fault::new("/model", "model-changed", detail)]);
        }
        let theta = fit.theta();
        if format == ExportFormat::Json {
            let exported = export::document(&model, &theta);
            let (system, fit) = (record.system.clone(), record.id.clone());
            let document = FittedModel { system, fit, revision, exported };
            return Ok(serde_json::to_vec(&document).unwrap_or_default());
        }
        let revision = revision.map(|revision| format!(", revision {revision}")).unwrap_or_default();
        let parts = &fit.parts;
        let line = format!(
            "{} as Lampyris fitted it ({}{revision}) to what was measured from {} to {}",
            record.system, record.id, parts.train.from, parts.train.to
        );
        let longest_step_h =
            LONGEST_STEP_HOURS.min(fit.sample_s.millis() as f64 / HOUR as f64 / fit.substeps.max(1) as f64);
        let source = ExportSource { line, longest_step_h };
        Ok(export::text(&model, &theta, &source, format).into_bytes())
    };
    service.interactive.once(move |_| work().map_err(ServiceError::Faults)).await
}
