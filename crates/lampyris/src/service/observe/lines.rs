//! What came by the line protocol: how many values were taken, and what no rule takes, the latest by name.

use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::LinePoint;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use utoipa::ToSchema;

/// Names that are remembered at a time.
const MOST_NAMES: usize = 200;
/// Longest part of a name that is remembered, in characters.
const LONGEST: usize = 120;

/// Why a value is no measurement of any system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Untaken {
    /// No rule takes it.
    NoRule,
    /// A rule names a system that is not there.
    NoSystem,
    /// A rule puts together what is no channel, or its unit does not convert.
    BadChannel,
    /// No working sensor gives the value.
    Implausible,
}

/// What a field is called where it comes from.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, ToSchema)]
pub struct LineName {
    /// The measurement.
    pub measurement: String,
    /// Its tags.
    pub tags: BTreeMap<String, String>,
    /// The field.
    pub field: String,
}

impl LineName {
    /// The name of a field of a point, of which long parts are cut.
    pub fn of(point: &LinePoint<'_>, field: &str) -> Self {
        let short = |text: &str| text.chars().take(LONGEST).collect::<String>();
        Self {
            measurement: short(&point.measurement),
            tags: point.tags.iter().take(20).map(|(tag, value)| (short(tag), short(value))).collect(),
            field: short(field),
        }
    }
}

/// Values of one name that were not taken.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct UntakenLine {
    /// The name.
    #[serde(flatten)]
    #[schema(inline)]
    pub name: LineName,
    /// Why the latest of them was not taken.
    pub why: Untaken,
    /// How many.
    pub count: u64,
    /// When the latest came.
    #[schema(value_type = String, format = DateTime)]
    pub last_at: Timestamp,
}

/// What came by the line protocol since the start.
#[derive(Debug, Default)]
pub struct LineTally {
    taken: AtomicU64,
    untaken: AtomicU64,
    latest: Mutex<IndexMap<LineName, (Untaken, u64, Timestamp)>>,
}

impl LineTally {
    fn latest(&self) -> MutexGuard<'_, IndexMap<LineName, (Untaken, u64, Timestamp)>> {
        // A panic while the lock was held can at most have lost a count.
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts values that were taken.
    pub fn took(&self, values: usize) {
        self.taken.fetch_add(values as u64, Ordering::Relaxed);
    }

    /// Counts values of a name that were not taken.
    pub fn left(&self, name: LineName, why: Untaken, values: u64, now: Timestamp) {
        self.untaken.fetch_add(values, Ordering::Relaxed);
        let mut latest = self.latest();
        let before = latest.get(&name).map(|(_, count, _)| *count);
        if before.is_none() && latest.len() >= MOST_NAMES {
            let quietest = (0..latest.len()).min_by_key(|place| latest[*place].2);
            quietest.map(|place| latest.swap_remove_index(place));
        }
        latest.insert(name, (why, before.unwrap_or(0) + values, now));
    }

    /// Counts all that another tally has counted.
    pub fn add(&self, other: &LineTally) {
        let (taken, mut untaken) = other.counts();
        self.taken.fetch_add(taken, Ordering::Relaxed);
        for line in other.untaken() {
            untaken -= line.count;
            self.left(line.name, line.why, line.count, line.last_at);
        }
        // Those whose names were forgotten already.
        self.untaken.fetch_add(untaken, Ordering::Relaxed);
    }

    /// Values that were taken, and that were not.
    pub fn counts(&self) -> (u64, u64) {
        (self.taken.load(Ordering::Relaxed), self.untaken.load(Ordering::Relaxed))
    }

    /// What was not taken, the latest first.
    pub fn untaken(&self) -> Vec<UntakenLine> {
        let latest = self.latest();
        let line = |(name, (why, count, last_at)): (&LineName, &(Untaken, u64, Timestamp))| UntakenLine {
            name: name.clone(),
            why: *why,
            count: *count,
            last_at: *last_at,
        };
        let mut lines: Vec<UntakenLine> = latest.iter().map(line).collect();
        lines.sort_by_key(|line| std::cmp::Reverse(line.last_at));
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_names_are_remembered_and_all_values_are_counted() {
        let tally = LineTally::default();
        let name = |field: usize| LineName {
            measurement: "m".into(),
            tags: BTreeMap::new(),
            field: field.to_string(),
        };
        let at = |second| Timestamp::from_millisecond(second).unwrap();
        for field in 0..=MOST_NAMES {
            tally.left(name(field), Untaken::NoRule, 1, at(field as i64));
        }
        tally.left(name(5), Untaken::NoSystem, 2, at(1000));
        tally.took(3);
        let whole = LineTally::default();
        whole.add(&tally);
        whole.add(&tally);
        let latest = whole.untaken();
        assert_eq!((latest.len(), whole.counts()), (MOST_NAMES, (6, 2 * (MOST_NAMES as u64 + 3))));
        assert_eq!((&latest[0].name, latest[0].why, latest[0].count), (&name(5), Untaken::NoSystem, 6));
        assert!(latest.iter().all(|line| line.name != name(0)));
    }
}
