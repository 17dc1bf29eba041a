//! Effects that were proposed for one system: how many have them by now, and from when on all others are
//! tried with them.

use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::reach::SystemScope;
use lampyris_core::diagnose::proposals::PROPOSED;
use lampyris_core::model::id::family;
use lampyris_core::model::{Catalogue, ModelId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// What was proposed for one system is tried in all others as soon as so many have it in their models: each
/// term more that is tried may be found by chance, and one room's habit is nobody else's.
const ENOUGH_SYSTEMS: usize = 3;

/// How many systems of a scope have an effect in their model, by the effect's id without its argument.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn systems_by_effect(
    service: &Service,
    scope: &SystemScope,
) -> Result<BTreeMap<String, usize>, ServiceError> {
    let catalogue = service.catalogue.current();
    let mut found = BTreeMap::new();
    for (model, count) in store::systems::by_model(&service.store, scope).await? {
        let parts = catalogue.compose(&model).map(|composition| composition.effects).unwrap_or_default();
        let effects: BTreeSet<String> =
            parts.into_iter().map(|effect| family(&effect.id).to_owned()).collect();
        for effect in effects {
            *found.entry(effect).or_insert(0) += usize::try_from(count).unwrap_or_default();
        }
    }
    Ok(found)
}

/// Whether diagnoses of every system try an effect, where so many have it.
pub fn is_tried(effect: &str, systems: &BTreeMap<String, usize>) -> bool {
    !effect.starts_with(PROPOSED) || systems.get(effect).is_some_and(|systems| *systems >= ENOUGH_SYSTEMS)
}

/// What a diagnosis of a model tries: all effects but those that were proposed for too few systems. Those
/// of the model itself stay.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn tried(service: &Service, model: &ModelId) -> Result<Arc<Catalogue>, ServiceError> {
    let catalogue = service.catalogue.current();
    let proposed = catalogue.effects().map(|effect| effect.id.clone());
    let proposed: Vec<String> =
        proposed.filter(|id| id.starts_with(PROPOSED) && !model.with().contains(id)).collect();
    if proposed.is_empty() {
        return Ok(catalogue);
    }
    let systems = systems_by_effect(service, &SystemScope::ALL).await?;
    let seldom: Vec<String> = proposed.into_iter().filter(|id| !is_tried(id, &systems)).collect();
    Ok(if seldom.is_empty() { catalogue } else { Arc::new(catalogue.without(&seldom)) })
}
