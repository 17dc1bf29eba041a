//! An operator's word: promote or reject a fit that waits, pin what is served or roll it back. Each is noted
//! as an arrival, so that the states of the revision in service are read off.

use crate::service::catalogue::systems;
use crate::service::decode;
use crate::service::error::{Refusal, ServiceError};
use crate::service::state::Service;
use crate::store;
use crate::store::decisions::{Decided, Decision};
use crate::store::idempotency::RequestKey;
use crate::store::pins::Pinned;
use lampyris_core::data::SystemId;
use lampyris_core::fault::Fault;
use serde::Deserialize;
use serde_json::Value;
use utoipa::ToSchema;

/// The longest reason, in characters.
const LONGEST_REASON: usize = 1000;

/// Why an operator decides.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Reason {
    /// A sentence for those who come after.
    #[schema(min_length = 1, max_length = 1000, example = "the new window frames explain the jump")]
    reason: String,
}

/// What an operator pins.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PinBody {
    /// An earlier fit of this system to roll back to; what is served now by default.
    fit: Option<String>,
    /// A sentence for those who come after.
    #[schema(min_length = 1, max_length = 1000, example = "sensor swap this week")]
    reason: String,
}

/// Promotes or rejects a fit that waits.
///
/// # Errors
/// Where the body has faults, there is no such fit, or it does not wait for this word.
pub(crate) async fn decide(
    service: &Service,
    fit: &str,
    decision: Decision,
    body: Value,
    key: Option<&RequestKey>,
    who: &str,
) -> Result<(), ServiceError> {
    let Reason { reason } = decode::decode(body).map_err(ServiceError::Faults)?;
    check_reason(&reason)?;
    let by = (who, service.now());
    match store::decisions::decide(&service.store, fit, decision, &reason, key, by).await? {
        Decided::Done(system, revision) => {
            tracing::info!(fit, system, revision, reason, who, "{} by an operator", decision.as_str());
            let system = system.parse().map_err(|error: lampyris_core::data::BadSystemId| {
                ServiceError::Internal(error.to_string())
            })?;
            service.arrivals.note(&system);
            Ok(())
        }
        Decided::Already => Ok(()),
        Decided::KeyReused => Err(ServiceError::KeyReused),
        Decided::NoFit => Err(ServiceError::NotFound("fit", fit.to_owned())),
        Decided::NotOffered(verdict) => {
            let detail = match verdict.as_str() {
                "rejected" => "the gate has rejected this fit, and nobody can promote it".to_owned(),
                "accepted" => "this fit was accepted and does not wait for an operator".to_owned(),
                _ => format!("this fit is `{verdict}` and does not wait for an operator"),
            };
            Err(Refusal::new("not-offered", detail).into())
        }
        Decided::Final(earlier) => Err(Refusal::new(
            "already-decided",
            format!("an operator has {} this fit, which is final", earlier.as_str()),
        )
        .into()),
        Decided::Pinned => {
            Err(Refusal::new("pinned", "the system is pinned: take the pin away first".to_owned()).into())
        }
        Decided::OtherModel(model) => Err(Refusal::new(
            "other-model",
            format!("the system has the model `{model}` by now: the fit is of another one"),
        )
        .into()),
    }
}

/// Pins what is served, or an earlier fit.
///
/// # Errors
/// Where the body has faults, there is no such system, or nothing to pin.
pub(crate) async fn pin(
    service: &Service,
    system: &SystemId,
    body: Value,
    who: &str,
) -> Result<(), ServiceError> {
    let PinBody { fit, reason } = decode::decode(body).map_err(ServiceError::Faults)?;
    check_reason(&reason)?;
    systems::require(service, system).await?;
    match store::pins::put(&service.store, system, fit.as_deref(), &reason, who, service.now()).await? {
        Pinned::Set(revision) => {
            tracing::info!(%system, revision, reason, who, "pinned by an operator");
            service.arrivals.note(system);
            Ok(())
        }
        Pinned::NeverServed => {
            let detail = match fit {
                Some(fit) => {
                    format!(
                        "no revision of {system} came from the fit `{}`",
                        fit.chars().take(80).collect::<String>().escape_debug()
                    )
                }
                None => format!("no parameters of {system} were ever served"),
            };
            Err(Refusal::new("never-served", detail).into())
        }
    }
}

/// Takes a pin away.
///
/// # Errors
/// Where there is no such system.
pub(crate) async fn unpin(service: &Service, system: &SystemId, who: &str) -> Result<(), ServiceError> {
    systems::require(service, system).await?;
    store::pins::delete(&service.store, system, who, service.now()).await?;
    tracing::info!(%system, who, "unpinned by an operator");
    service.arrivals.note(system);
    Ok(())
}

fn check_reason(reason: &str) -> Result<(), ServiceError> {
    if reason.trim().is_empty() || reason.chars().count() > LONGEST_REASON {
        let detail = format!("a reason has 1 to {LONGEST_REASON} characters");
        return Err(ServiceError::Faults(vec![Fault::new("/reason", "invalid-reason", detail)]));
    }
    Ok(())
}
