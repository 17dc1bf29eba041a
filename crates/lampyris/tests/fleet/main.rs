//! Several services on one PostgreSQL, under what may happen to each of them and to the database.
//!
//! `tests/cluster` starts the server; without one there is nothing to test. Everyday figures are small;
//! `LAMPYRIS_TESTS=full` asks for the full ones.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod clocks;
mod crowd;
mod cut;
mod database;
mod feed;
mod leases;
mod nodes;
mod standby;
#[path = "../support/mod.rs"]
mod support;

use cut::Way;
use lampyris::store::DatabasePlace;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use support::cluster;
use support::process::Process;

/// Seconds of a lease in these tests.
const LEASE: u64 = 6;

/// A database for the services of one test, which has the server to itself, since some stop it; none where
/// there is no server.
struct Fleet {
    place: DatabasePlace,
    _alone: MutexGuard<'static, ()>,
}

impl Fleet {
    fn new() -> Option<Self> {
        static ALONE: Mutex<()> = Mutex::new(());
        let alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        cluster::database().map(|place| Self { place, _alone: alone })
    }

    /// A service with these roles, and more variables in its environment.
    fn node(&self, roles: &str, environment: &[(&str, &str)]) -> Process {
        Self::node_on(&self.place, roles, environment)
    }

    fn node_on(place: &DatabasePlace, roles: &str, environment: &[(&str, &str)]) -> Process {
        let lease = LEASE.to_string();
        let mut all = vec![("LAMPYRIS_ROLES", roles), ("LAMPYRIS_LEASE_SECONDS", lease.as_str())];
        all.push(("LAMPYRIS_WORKERS", "1"));
        all.extend(environment);
        Process::start_with(&PathBuf::from(String::from(place.clone())), &all)
    }

    /// A service that reaches the database by a way that can be cut.
    fn node_by(&self, way: &Way, roles: &str, environment: &[(&str, &str)]) -> Process {
        let url = String::from(self.place.clone());
        let (before, host) = url.split_once('@').unwrap();
        let (_, name) = host.split_once('/').unwrap();
        let place = DatabasePlace::from(format!("{before}@127.0.0.1:{}/{name}", way.port));
        Self::node_on(&place, roles, environment)
    }

    /// The server, as `host:port`.
    fn server(&self) -> String {
        let url = String::from(self.place.clone());
        url.split_once('@').unwrap().1.split_once('/').unwrap().0.to_owned()
    }

    /// The first column of what a statement gives.
    fn rows(&self, sql: &str) -> Vec<String> {
        cluster::behind(&self.place, sql).unwrap()
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        cluster::drop_database(&self.place);
    }
}
