//! When what is served turns stale, the earliest first.

use jiff::Timestamp;
use lampyris_core::data::SystemId;
use std::collections::{BTreeSet, HashMap};

/// The turns of the systems that have one to come.
#[derive(Debug, Default)]
pub struct Ageing {
    of: HashMap<SystemId, Timestamp>,
    order: BTreeSet<(Timestamp, SystemId)>,
}

impl Ageing {
    /// Notes when a system turns stale, in the place of what was noted before.
    pub(super) fn note(&mut self, system: &SystemId, turn: Option<Timestamp>) {
        let before = match turn {
            Some(turn) => self.of.insert(system.clone(), turn),
            None => self.of.remove(system),
        };
        if let Some(before) = before {
            self.order.remove(&(before, system.clone()));
        }
        if let Some(turn) = turn {
            self.order.insert((turn, system.clone()));
        }
    }

    /// The systems whose turn has come.
    pub(super) fn due(&self, now: Timestamp) -> impl Iterator<Item = SystemId> {
        self.order.iter().take_while(move |(turn, _)| *turn <= now).map(|(_, system)| system.clone())
    }

    /// The first turn that is still to come.
    pub(super) fn next(&self, now: Timestamp) -> Option<Timestamp> {
        self.order.iter().map(|(turn, _)| *turn).find(|turn| *turn > now)
    }
}
