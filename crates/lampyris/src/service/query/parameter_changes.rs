//! Whether a parameter of a system has changed, by the newest weeks of its record.

use super::subject;
use crate::service::catalogue::systems;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::input;
use crate::service::work::interactive::RenderedAnswer;
use crate::service::work::parameter_changes::{along, newest_weeks};
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::change::ParameterChanges;
use lampyris_core::interrupt::Brake;
use serde::Serialize;
use utoipa::ToSchema;

/// What the newest weeks of a system say of parameters that change.
#[derive(Debug, Serialize, ToSchema)]
pub struct SystemChanges {
    /// The system.
    system: SystemId,
    /// The fit along which was looked; its parameters need not be right.
    fit: String,
    /// Its model.
    model: String,
    #[serde(flatten)]
    #[schema(inline)]
    found: ParameterChanges,
}

/// What the newest weeks of a system say, along the fit that is served.
///
/// # Errors
/// Where nothing is served, the model of the fit has no filter, or the fit no longer fits the channels.
pub(crate) async fn of_system(service: &Service, system: &SystemId) -> Result<RenderedAnswer, ServiceError> {
    let (_, served) = subject::in_force(service, system).await?;
    let key = subject::key(service, "changes", &[&served], "").await?;
    if let Some(answer) = service.interactive.known(&key) {
        return Ok(answer);
    }
    let document = systems::require(service, system).await?;
    let model = served.fit.model.parse().map_err(|error| ServiceError::Internal(format!("{error}")))?;
    let request = newest_weeks(&document);
    let input = input::collect(service, system, document, model, request, 0).await?;
    let system = system.clone();
    let work = move |brake: &Brake| {
        let found = along(&input, &input.window()?, &served.fit, brake)?;
        let answer = SystemChanges { system, fit: served.id, model: served.fit.model, found };
        serde_json::to_vec(&answer).map_err(|error| ServiceError::Internal(error.to_string()))
    };
    service.interactive.answer(&key, work).await
}
