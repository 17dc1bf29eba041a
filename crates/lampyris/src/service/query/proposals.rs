//! Terms that no catalogue has and that the model of a fit may be missing.

use super::subject::{self, NamedFit};
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::interactive::RenderedAnswer;
use lampyris_core::data::Window;
use lampyris_core::diagnose::proposals::{PROPOSED, Proposals, ProposalsAsked, propose};
use lampyris_core::estimate::assess::replay::{Provenance, basis, window_of};
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Replay, Site};
use lampyris_core::interrupt::Brake;
use lampyris_core::model::Catalogue;
use serde::Serialize;
use utoipa::ToSchema;

/// The terms that the model of a fit may be missing.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Proposals)]
pub struct ProposalsDocument<'a> {
    fit: &'a str,
    system: &'a str,
    model: &'a str,
    provenance: &'a Provenance,
    #[serde(flatten)]
    #[schema(inline)]
    found: Proposals,
}

/// The terms that the model of a fit may be missing, by what was measured over its window.
///
/// # Errors
/// Where there is no such fit, its model has no filter or no measured state, or it cannot be run again.
pub(crate) async fn of_fit(service: &Service, id: &str) -> Result<RenderedAnswer, ServiceError> {
    let record = subject::require(service, id).await?;
    let (_, end) = window_of(&record.fit).map_err(ServiceError::Faults)?;
    let rate = service.settings.diagnose.accusation_rate;
    // What is known already goes under its own name.
    let catalogue = service.catalogue.current();
    let known = catalogue.effects().map(|effect| effect.id.as_str()).filter(|id| id.starts_with(PROPOSED));
    let asked = format!("{rate} {}", known.collect::<Vec<&str>>().join(" "));
    let key = subject::key(service, "proposals", &[&record], &asked).await?;
    if let Some(answer) = service.inquiries.known(&key) {
        return Ok(answer);
    }
    let rate = AccusationRate::try_from(rate).map_err(ServiceError::Internal)?;
    let subject = subject::load(service, record, end).await?;
    let work = move |brake: &Brake| {
        let window = subject.window()?;
        let replay = subject.replay(&window, None, brake)?;
        let system = subject.record().system.to_string();
        document(subject.catalogue(), &subject.named(&system), &replay, &window, rate)
    };
    service.inquiries.answer(&key, work).await
}

/// The terms that a fit may be missing that was run again. This is work for the CPU pool.
fn document(
    catalogue: &Catalogue,
    named: &NamedFit<'_>,
    replay: &Replay,
    window: &Window,
    rate: AccusationRate,
) -> Result<Vec<u8>, ServiceError> {
    let basis = basis(named.fit).map_err(ServiceError::Faults)?;
    let site = Site {
        location: basis.location,
        zone: basis.zone.clone(),
        sets: basis.sets.clone().into_iter().collect(),
    };
    let theta = named.fit.theta();
    let asked =
        ProposalsAsked { catalogue, problem: replay.problem(), theta: &theta, window, site: &site, rate };
    let found = propose(&asked).map_err(|fault| ServiceError::Faults(vec![fault]))?;
    let document = ProposalsDocument {
        fit: named.id,
        system: named.system,
        model: &named.fit.model,
        provenance: replay.provenance(),
        found,
    };
    serde_json::to_vec(&document).map_err(|error| ServiceError::Internal(error.to_string()))
}
