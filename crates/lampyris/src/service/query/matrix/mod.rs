//! Which rooms lack which effects: every system beside every effect, from its newest diagnosis and from what
//! its windows show together.
//!
//! `cells` is what is said of one system, `effects` what comes of it over all of them.

pub mod cells;
pub mod effects;

use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::diagnoses::DiagnosedSystem;
use crate::store::reach::SystemScope;
use cells::{MatrixRow, row};
use effects::{MatrixEffect, Tally, title};
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::ledger::LedgerEntry;
use lampyris_core::model::Catalogue;
use std::collections::HashMap;
use std::sync::Arc;

/// Systems that are read at a time where all are asked for.
const AT_ONCE: i64 = 200;

/// One page of the rows of some systems: those that come after a name, with one more than fit.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn rows(
    service: &Service,
    scopes: (&SystemScope, &SystemScope),
    after: &str,
    limit: i64,
) -> Result<Vec<MatrixRow>, ServiceError> {
    let systems = store::diagnoses::newest(&service.store, scopes, after, limit).await?;
    let names: Vec<String> = systems.iter().map(|one| one.system.to_string()).collect();
    let evidence = store::evidence::of_many(&service.store, &names).await?;
    let catalogue = service.catalogue.current();
    blocking(move || all_rows(&catalogue, systems, &evidence)).await
}

fn all_rows(
    catalogue: &Catalogue,
    systems: Vec<DiagnosedSystem>,
    evidence: &HashMap<String, Vec<LedgerEntry>>,
) -> Vec<MatrixRow> {
    let way_of = |id: &str| catalogue.effect(id).ok()?.way_of;
    let named = |id: &str| way_of(id).unwrap_or_else(|| id.to_owned());
    let known = |system: &SystemId| evidence.get(&system.to_string()).map_or(&[][..], Vec::as_slice);
    systems
        .into_iter()
        .map(|system| {
            let entries = known(&system.system);
            row(system, entries, &named)
        })
        .collect()
}

/// What is known of each effect over all systems of a selection, what saves most first.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn summary(
    service: &Service,
    scopes: (&SystemScope, &SystemScope),
) -> Result<Vec<MatrixEffect>, ServiceError> {
    let (mut tally, mut after) = (Tally::default(), String::new());
    let catalogue = service.catalogue.current();
    loop {
        let systems = store::diagnoses::newest(&service.store, scopes, &after, AT_ONCE).await?;
        let Some(last) = systems.last().map(|one| one.system.to_string()) else { break };
        // What windows show together decides nothing that is counted here.
        let known = Arc::clone(&catalogue);
        let rows = blocking(move || all_rows(&known, systems, &HashMap::new())).await?;
        rows.iter().for_each(|row| tally.add(row));
        after = last;
    }
    Ok(tally.effects(|effect| title(&catalogue, effect)))
}
