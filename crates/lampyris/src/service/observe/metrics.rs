//! What has been counted since the service started. `/metrics` prints it; nothing else reads it.

use crate::store::jobs::{JobRecord, JobResult, Outcome};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Upper bounds of the times of answers, in seconds.
const ANSWER_BOUNDS: &[f64] = &[0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0];
/// Upper bounds of the times of jobs, in seconds.
const JOB_BOUNDS: &[f64] = &[0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0, 900.0, 3600.0];
/// The statuses that a poll of `/params` may have; any other counts as the last one.
const POLL_CODES: [u16; 5] = [200, 304, 404, 422, 500];

/// Counters and histograms of one start of the service.
#[derive(Debug)]
pub struct Metrics {
    /// When the service started.
    pub started_at: Timestamp,
    /// Answers of `/params/{kind}/{id}`, which no layer measures.
    pub polls: Polls,
    /// Answers of `/params`.
    pub all_polls: Polls,
    tallies: Mutex<Tallies>,
}

/// What is counted behind one lock: all of it is short.
#[derive(Debug, Clone)]
pub struct Tallies {
    /// Jobs that ended, by kind and by outcome or state.
    pub jobs_ended: BTreeMap<[&'static str; 2], u64>,
    /// Jobs that failed, by the slug of the reason.
    pub jobs_failed: BTreeMap<String, u64>,
    /// Seconds from start to end.
    pub job_seconds: Histogram,
    /// Seconds from submission to start.
    pub wait_seconds: Histogram,
    /// Simulations of the jobs that ended.
    pub evaluations: u64,
    /// Checks that a fit has failed, by name.
    pub checks_failed: BTreeMap<String, u64>,
    /// How often the parameters of a system turned to be those of before a failure.
    pub fallbacks: u64,
    /// The error of the newest comparison with newer measurements, by system, with the horizon of the
    /// forecasts, or `free_run`.
    pub live_rmse: BTreeMap<String, (String, f64)>,
    /// Requests, by method, path template and status.
    pub requests: BTreeMap<(&'static str, String, u16), u64>,
    /// Seconds until an answer began, by path template and status.
    pub answer_seconds: BTreeMap<(String, u16), Histogram>,
}

/// Counts of values up to each of some bounds.
#[derive(Debug, Clone)]
pub struct Histogram {
    /// The upper bounds.
    pub bounds: &'static [f64],
    /// How many values lie above the bound before and not above this one; the last ones lie above all bounds.
    counts: Vec<u64>,
    /// The sum of all values.
    pub sum: f64,
}

/// Counts of polls by status, without a lock.
#[derive(Debug, Default)]
pub struct Polls([AtomicU64; POLL_CODES.len()]);

impl Histogram {
    fn new(bounds: &'static [f64]) -> Self {
        Self { bounds, counts: vec![0; bounds.len() + 1], sum: 0.0 }
    }

    fn add(&mut self, value: f64) {
        self.counts[self.bounds.partition_point(|bound| *bound < value)] += 1;
        self.sum += value;
    }

    /// How many values are not above each bound, and how many there are in all.
    pub fn cumulative(&self) -> Vec<u64> {
        let running = self.counts.iter().scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        });
        running.collect()
    }
}

impl Polls {
    /// Counts an answer.
    pub fn count(&self, status: u16) {
        let place = POLL_CODES.iter().position(|code| *code == status).unwrap_or(POLL_CODES.len() - 1);
        self.0[place].fetch_add(1, Ordering::Relaxed);
    }

    /// Statuses with their counts.
    pub fn counts(&self) -> impl Iterator<Item = (u16, u64)> {
        POLL_CODES.into_iter().zip(self.0.iter().map(|count| count.load(Ordering::Relaxed)))
    }
}

impl Metrics {
    /// Nothing has happened yet.
    pub fn new(started_at: Timestamp) -> Self {
        let tallies = Tallies {
            jobs_ended: BTreeMap::new(),
            jobs_failed: BTreeMap::new(),
            job_seconds: Histogram::new(JOB_BOUNDS),
            wait_seconds: Histogram::new(JOB_BOUNDS),
            evaluations: 0,
            checks_failed: BTreeMap::new(),
            fallbacks: 0,
            live_rmse: BTreeMap::new(),
            requests: BTreeMap::new(),
            answer_seconds: BTreeMap::new(),
        };
        Self {
            started_at,
            polls: Polls::default(),
            all_polls: Polls::default(),
            tallies: Mutex::new(tallies),
        }
    }

    fn tallies(&self) -> MutexGuard<'_, Tallies> {
        // A panic while the lock was held can at most have lost a count.
        self.tallies.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Everything, as it is now.
    pub fn read(&self) -> Tallies {
        self.tallies().clone()
    }

    /// Counts a job that a worker has taken.
    pub fn job_started(&self, job: &JobRecord) {
        if let Some(started_at) = job.state.started_at() {
            self.tallies().wait_seconds.add(seconds(job.created_at, started_at));
        }
    }

    /// Counts a job that has ended.
    pub fn job_ended(&self, job: &JobRecord) {
        let mut tallies = self.tallies();
        let word = job.state.outcome().map_or(job.state.status().as_str(), Outcome::as_str);
        *tallies.jobs_ended.entry([job.kind.as_str(), word]).or_default() += 1;
        if let Some(failure) = job.state.failure() {
            *tallies.jobs_failed.entry(failure.code.clone()).or_default() += 1;
        }
        if let Some((started_at, ended)) = job.state.started_at().zip(job.state.ended()) {
            tallies.job_seconds.add(seconds(started_at, ended.at));
        }
        let evaluations = job.state.result().map_or(0, JobResult::evaluations);
        tallies.evaluations += u64::try_from(evaluations).unwrap_or(0);
    }

    /// Counts the checks that a fit has failed.
    pub fn checks_failed(&self, names: &[&str]) {
        let mut tallies = self.tallies();
        for name in names {
            *tallies.checks_failed.entry((*name).to_owned()).or_default() += 1;
        }
    }

    /// Counts a turn to parameters of before a failure.
    pub fn fell_back(&self) {
        self.tallies().fallbacks += 1;
    }

    /// Notes how well newer measurements of a system are forecast with what it serves.
    pub fn forecast(&self, system: &SystemId, horizon: &str, rmse: f64) {
        self.tallies().live_rmse.insert(system.to_string(), (horizon.to_owned(), rmse));
    }

    /// Counts a request that was answered.
    pub fn answered(&self, method: &'static str, route: &str, status: u16, took: Duration) {
        let mut tallies = self.tallies();
        *tallies.requests.entry((method, route.to_owned(), status)).or_default() += 1;
        tallies
            .answer_seconds
            .entry((route.to_owned(), status))
            .or_insert_with(|| Histogram::new(ANSWER_BOUNDS))
            .add(took.as_secs_f64());
    }
}

/// Seconds between two instants; a clock that was set back makes none negative.
fn seconds(from: Timestamp, to: Timestamp) -> f64 {
    to.duration_since(from).as_secs_f64().max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_on_a_bound_is_not_above_it() {
        let mut histogram = Histogram::new(&[1.0, 2.0]);
        [0.5, 1.0, 1.5, 2.0, 9.0].into_iter().for_each(|value| histogram.add(value));
        assert_eq!((histogram.cumulative(), histogram.sum), (vec![2, 4, 5], 14.0));
    }

    #[test]
    fn a_status_that_no_poll_has_is_still_counted() {
        let polls = Polls::default();
        [200, 304, 304, 418].into_iter().for_each(|status| polls.count(status));
        assert_eq!(polls.counts().collect::<Vec<_>>(), [(200, 1), (304, 2), (404, 0), (422, 0), (500, 1)]);
    }
}
