//! Rooms and plants: their documents are checked here and kept by the store.

use super::system::{SystemDocument, document};
use crate::service::decode;
use crate::service::error::{Refusal, ServiceError};
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::systems::{Needs, SystemColumns, SystemDeletion, SystemPut};
use lampyris_core::data::SystemId;
use lampyris_core::fault::Fault;
use serde_json::json;

/// The kind of systems that may have no model: their measurements are shared.
const SITE: &str = "site";

/// Makes a system or replaces its document, where what is there (`None` without any) allows it; says whether
/// it is new.
///
/// # Errors
/// Every fault of the document, where what is there does not allow it, or where the database fails.
pub async fn put(
    service: &Service,
    system: &SystemId,
    body: serde_json::Value,
    who: &str,
    allows: impl FnOnce(Option<&SystemDocument>) -> bool,
) -> Result<(SystemDocument, bool), ServiceError> {
    let catalogue = service.catalogue.current();
    let name = system.clone();
    let names_no_model = body.get("model").is_none_or(serde_json::Value::is_null);
    // Compiling a model of the largest size takes longer than an async thread may be held.
    let checked = blocking(move || {
        // The stand-in is a built-in model, of which no fault is found.
        let mut read = decode::read::<SystemDocument>(body, &json!({ "model": "rc2" }));
        let faults = read.document.as_ref().map(|document| document.faults(&name, &catalogue));
        read.add(faults.unwrap_or_default());
        if names_no_model {
            read.add(without_model(&name));
        }
        read.finish()
    });
    let document = checked.await?.map_err(ServiceError::Faults)?;
    let text = serde_json::to_string(&document).map_err(|error| ServiceError::Internal(error.to_string()))?;
    let waived: Vec<String> =
        document.policy.checks.iter().map(|(rule, reason)| format!("{rule} waived: {reason}")).collect();
    let why = (!waived.is_empty()).then(|| waived.join("; "));
    let by = (who, why.as_deref(), service.now());
    let columns = SystemColumns {
        model: document.model.as_ref(),
        tenant: &document.tenant,
        building: document.building(),
    };
    let put = store::systems::put(&service.store, system, columns, &text, by, |known| {
        match known.map(self::document).transpose() {
            Ok(known) => allows(known.as_ref()),
            // What nobody can read any more may be replaced.
            Err(_) => true,
        }
    });
    match put.await? {
        SystemPut::Made => Ok((document, true)),
        SystemPut::Replaced => Ok((document, false)),
        SystemPut::Refused { is_there: true } => Err(ServiceError::NotAsExpected(format!(
            "`{system}` is there, and not as this request expects it"
        ))),
        SystemPut::Refused { is_there: false } => {
            Err(ServiceError::NotAsExpected(format!("there is no system `{system}` to be replaced")))
        }
    }
}

/// That a system has a model, unless it only holds measurements that others share.
fn without_model(system: &SystemId) -> Vec<Fault> {
    if system.kind() == SITE {
        return Vec::new();
    }
    let fault = Fault::new("/model", "no-model", "a system has a model");
    vec![fault.suggest(format!("only one of the kind `{SITE}` may have none"))]
}

/// Deletes a system with its measurements, jobs, fits and revisions; `/params` then does not know it any
/// more.
///
/// # Errors
/// Where there is none, a job needs it, it has a history or dependents and nobody forces it, or the database
/// fails.
pub(crate) async fn delete(
    service: &Service,
    system: &SystemId,
    force: bool,
    who: &str,
) -> Result<(), ServiceError> {
    let refused =
        |slug, detail, because| Err(ServiceError::Refused(Refusal { slug, detail, because: Some(because) }));
    match store::systems::delete(&service.store, system, force, who, service.now()).await? {
        SystemDeletion::Busy(jobs) => {
            let detail = format!(
                "{} jobs of {system} or of its neighbours wait or run: wait for their end, or cancel them",
                jobs.len()
            );
            refused("system-busy", detail, ("jobs", jobs))
        }
        SystemDeletion::Needed(Needs { fits, revisions, dependents }) => {
            let detail = format!(
                "{system} has {fits} fits, {revisions} revisions and {} dependents: `?force=true` deletes \
                its history",
                dependents.len()
            );
            refused("system-needed", detail, ("dependents", dependents))
        }
        SystemDeletion::NotThere => Err(ServiceError::NoSystem(system.clone())),
        SystemDeletion::Gone => Ok(()),
    }
}

/// The document of a system that must be there.
///
/// # Errors
/// Where there is no such system, or the database fails.
pub(crate) async fn require(service: &Service, system: &SystemId) -> Result<SystemDocument, ServiceError> {
    let record = store::systems::get(&service.store, system)
        .await?
        .ok_or_else(|| ServiceError::NoSystem(system.clone()))?;
    document(&record.document)
}
