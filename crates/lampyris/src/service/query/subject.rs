//! Stored fits that are shown: what is needed to run them again, and what their answers depend on.

use crate::service::catalogue::system::{self, NEIGHBOURS, SystemDocument};
use crate::service::catalogue::systems;
use crate::service::catalogue::windows::Format;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::work::input::{self, Measurements};
use crate::store;
use crate::store::fits::FitRecord;
use lampyris_core::data::{Duration, SystemId, Window, read_time};
use lampyris_core::estimate::assess::replay::basis;
use lampyris_core::estimate::{Fit, Replay};
use lampyris_core::interrupt::Brake;
use lampyris_core::model::{Catalogue, ModelId};
use std::sync::Arc;

/// What is to be shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComparisonAsked {
    /// How far ahead the model forecasts; `None` is the free run.
    pub horizon: Option<Duration>,
    /// From this instant on, in milliseconds; by default from the start of the fit's window.
    pub from: Option<i64>,
    /// To this instant; by default to the end of the fit's window.
    pub to: Option<i64>,
    /// Most points of a line.
    pub max_points: usize,
    /// How the answer is written.
    pub format: Format,
}

/// A fit with the names under which it is shown.
#[derive(Debug, Clone, Copy)]
pub struct NamedFit<'a> {
    /// Its id.
    pub id: &'a str,
    /// The system, or what stands for it where there is none.
    pub system: &'a str,
    /// What was found.
    pub fit: &'a Fit,
}

/// A stored fit with what is needed to run it again.
pub(super) struct Subject {
    record: FitRecord,
    measurements: Measurements,
    catalogue: Arc<Catalogue>,
}

/// The fit that must be there.
pub(super) async fn require(service: &Service, id: &str) -> Result<FitRecord, ServiceError> {
    store::fits::get(&service.store, id).await?.ok_or_else(|| ServiceError::NotFound("fit", id.to_owned()))
}

/// The revision that is served of a system, and the fit behind it.
pub(super) async fn in_force(service: &Service, system: &SystemId) -> Result<(i64, FitRecord), ServiceError> {
    let standing = store::params::standing(&service.store, system)
        .await?
        .ok_or_else(|| ServiceError::NoSystem(system.clone()))?;
    match standing.revision {
        Some(revision) => Ok((revision.revision, require(service, &revision.fit).await?)),
        None => Err(ServiceError::NeverValidated(system.clone(), standing.latest_job)),
    }
}

/// A name for everything that an answer about fits depends on: they and the models do not change, but the
/// measurements and the system do.
pub(super) async fn key(
    service: &Service,
    what: &str,
    records: &[&FitRecord],
    asked: &str,
) -> Result<String, ServiceError> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(what.as_bytes()).update(b"\n").update(asked.as_bytes());
    for record in records {
        hasher.update(b"\n").update(record.id.as_bytes());
        let system = store::systems::get(&service.store, &record.system)
            .await?
            .ok_or_else(|| ServiceError::NoSystem(record.system.clone()))?;
        hasher.update(b"\n").update(system.document.as_bytes());
        let document = system::document(&system.document)?;
        let shared = document.shared().into_iter().map(|channel| channel.system);
        let others = next_door(record, &document).into_iter().chain(shared);
        for system in std::iter::once(record.system.clone()).chain(others) {
            let version = store::measured::version(&service.store, &system).await?;
            hasher.update(format!("\n{system} {version}").as_bytes());
        }
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// Reads what is needed to run a fit again from its start to `until` at least.
pub(super) async fn load(service: &Service, record: FitRecord, until: i64) -> Result<Subject, ServiceError> {
    let document = systems::require(service, &record.system).await?;
    let basis = basis(&record.fit).map_err(ServiceError::Faults)?;
    let instant =
        |text: &str| read_time("/basis", text).map_err(|fault| ServiceError::Internal(fault.to_string()));
    let range = (instant(&basis.from)?, instant(&basis.to)?.max(until));
    let document = SystemDocument { neighbours: next_door(&record, &document), ..document };
    let measurements = input::measurements(service, &record.system, &document, range).await?;
    Ok(Subject { record, measurements, catalogue: service.catalogue.current() })
}

/// The neighbours that a fit was made with, even if the system has others by now.
fn next_door(record: &FitRecord, document: &SystemDocument) -> Vec<SystemId> {
    let members = record.fit.basis.iter().filter_map(|basis| basis.sets.get(NEIGHBOURS)).flatten();
    let named = |member: &String| {
        let known = document.neighbours.iter().find(|neighbour| neighbour.id() == member).cloned();
        known.or_else(|| SystemId::new(record.system.kind(), member).ok())
    };
    members.filter_map(named).collect()
}

impl Subject {
    /// The fit.
    pub(super) fn fit(&self) -> &Fit {
        &self.record.fit
    }

    /// The fit with its name and its system.
    pub(super) fn record(&self) -> &FitRecord {
        &self.record
    }

    /// The fit as it is shown; its system as a text.
    pub(super) fn named<'a>(&'a self, system: &'a str) -> NamedFit<'a> {
        NamedFit { id: &self.record.id, system, fit: &self.record.fit }
    }

    /// The models and effects that there are.
    pub(super) fn catalogue(&self) -> &Catalogue {
        &self.catalogue
    }

    /// All that was measured. This is work for the CPU pool.
    pub(super) fn window(&self) -> Result<Window, ServiceError> {
        let model: ModelId =
            self.fit().model.parse().map_err(|error| ServiceError::Internal(format!("{error}")))?;
        self.measurements.window(&self.catalogue, &model)
    }

    /// Runs the fit again. This is work for the CPU pool.
    pub(super) fn replay(
        &self,
        window: &Window,
        until: Option<i64>,
        brake: &Brake,
    ) -> Result<Replay, ServiceError> {
        Replay::new(&self.catalogue, self.fit(), window, until, brake).map_err(ServiceError::Faults)
    }
}
