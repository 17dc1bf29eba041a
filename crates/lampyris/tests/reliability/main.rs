//! The built service under what may happen to it: kills, failing disks, damaged files, upgrades.
//!
//! Everyday figures are small; `LAMPYRIS_TESTS=full` asks for the full ones.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod backups;
mod consistency;
mod crashes;
mod database;
mod disks;
mod files;
mod gate;
mod hostile;
mod nights;
mod poison;
mod queue;
mod rolling;
mod soak;
mod stamps;
mod stops;
mod strangers;
mod supply;
#[path = "../support/mod.rs"]
mod support;
mod tls;
mod traffic;
mod upgrades;
