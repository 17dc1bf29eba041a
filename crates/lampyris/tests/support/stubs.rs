//! Jobs without work, claimed and ended as fast as the database allows.

use jiff::Timestamp;
use lampyris::store::batches::{BatchKind, NewBatch};
use lampyris::store::entry::NewJob;
use lampyris::store::finish::JobEnd;
use lampyris::store::jobs::{JobFailure, JobKind, Origin, Priority};
use lampyris::store::systems::SystemColumns;
use lampyris::store::{self, Store};
use lampyris_core::data::SystemId;
use std::time::Duration;

/// A job for each of these rooms; what it asks for is its number, so that no two are equal.
pub fn batch(rooms: impl IntoIterator<Item = SystemId>, priority: Priority) -> NewBatch {
    let job = |(number, system): (usize, SystemId)| NewJob {
        kind: JobKind::Estimate,
        system,
        model: "rc1".parse().unwrap(),
        request: format!("{{\"seed\":{number}}}").into(),
        experiment: false,
        origin: Origin::Scheduled,
        priority,
    };
    NewBatch {
        kind: BatchKind::Recalibrate,
        schedule: None,
        request: "{}".into(),
        jobs: rooms.into_iter().enumerate().map(job).collect(),
        skipped: Vec::new(),
    }
}

/// Submits a batch, however many jobs it has.
pub async fn submit(store: &Store, batch: &NewBatch) {
    store::batches::submit(store, batch, None, i64::MAX, Timestamp::now()).await.unwrap();
}

/// Registers a room.
pub async fn put_room(store: &Store, room: &SystemId, tenant: &str) {
    let (model, by) = ("rc1".parse().unwrap(), ("test", None, Timestamp::now()));
    let columns = SystemColumns { model: Some(&model), tenant, building: "" };
    store::systems::put(store, room, columns, "{}", by, |_| true).await.unwrap();
}

/// A worker whose lease outlives its test.
pub async fn enlist(store: &Store, name: &str) -> i64 {
    let lease = Duration::from_secs(600);
    store::workers::enlist(store, (name, "worker"), lease, Timestamp::now()).await.unwrap()
}

/// Claims a job, where one waits that may run, and ends it; gives its system and how long the claim took.
pub async fn claim_and_end(store: &Store, worker: i64) -> Option<(SystemId, Duration)> {
    let failure = JobFailure { code: "stub".into(), detail: "no work".into(), errors: Vec::new() };
    let begun = std::time::Instant::now();
    let job = store::queue::claim(store, worker, Timestamp::now()).await.unwrap()?;
    let took = begun.elapsed();
    let lease = job.lease().unwrap();
    store::finish::finish(store, &lease, &JobEnd::Failed(&failure), Timestamp::now()).await.unwrap();
    Some((job.system, took))
}
