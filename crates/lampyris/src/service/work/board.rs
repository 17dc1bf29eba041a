//! Who runs now: how far a job has come, and the switch that calls it off.
//!
//! Progress lives here and never in the database: a watcher wants the newest value, not all of them.

use super::progress::ProgressReport;
use crate::service::changes::events::JobChange;
use crate::store::jobs::{JobKind, JobRecord, Lease};
use indexmap::IndexMap;
use lampyris_core::estimate::{Progress, Trials};
use lampyris_core::pace::Pace;
use serde_json::Value;
use std::collections::HashMap;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// The shortest pause between two events of one search: a watcher is told at most four times a second.
const PAUSE: Duration = Duration::from_millis(250);

/// After so long without news a watcher is told anyway, because the time that is left has changed.
const SILENCE: Duration = Duration::from_secs(5);

/// The longest that the news of an end is held back.
const LONGEST_SETTLING: Duration = Duration::from_secs(1);

/// The jobs that run.
#[derive(Debug, Default)]
pub struct ProgressBoard {
    live: Mutex<HashMap<String, Arc<Live>>>,
    ended: Notify,
}

/// One job that runs, or is about to.
#[derive(Debug, Default)]
pub struct Live {
    cancelled: AtomicBool,
    running: Mutex<Option<Running>>,
}

/// A job in the hands of a worker.
#[derive(Debug)]
struct Running {
    /// The right to end it.
    lease: Lease,
    /// When this attempt started.
    since: Instant,
    /// The evaluations that it may spend.
    budget: Option<u64>,
    /// Evaluations of the searches before the present one.
    earlier: usize,
    /// The newest news of the present search.
    progress: Option<Progress>,
    /// What the stages of its diagnosis have taken so far.
    pace: Pace,
    /// When watchers were last told something.
    told_at: Instant,
    /// The best parameters that watchers know.
    told: Option<Arc<IndexMap<String, f64>>>,
    /// Whether that was the last thing that they were told.
    told_incumbent_last: bool,
}

/// A panic while a lock was held cannot have left what it guards half-changed: every use is one assignment or
/// call.
fn held<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ProgressBoard {
    /// The place of a job, made if need be.
    pub fn place(&self, job: &str) -> Arc<Live> {
        held(&self.live).entry(job.to_owned()).or_default().clone()
    }

    /// How far a running job has come, as far as this process knows.
    pub fn report(&self, job: &str) -> Option<ProgressReport> {
        let live = held(&self.live).get(job).cloned()?;
        let running = held(&live.running);
        running.as_ref()?.report()
    }

    /// Tells a running job to stop. The place is made if need be: the worker that has just claimed the job
    /// finds it there.
    pub fn cancel(&self, job: &str) {
        self.place(job).call_off();
    }

    /// Forgets a job that runs no more.
    pub fn end(&self, job: &str) {
        held(&self.live).remove(job);
        self.ended.notify_waiters();
    }

    /// Waits until a job whose end is in the database has left its worker's hands. By then what it led to is
    /// served, so that nobody hears of an end and reads the parameters of before.
    pub async fn settled(&self, job: &str) {
        let settled = async {
            loop {
                let mut ended = pin!(self.ended.notified());
                ended.as_mut().enable();
                if !held(&self.live).contains_key(job) {
                    return;
                }
                ended.await;
            }
        };
        // Behind a database that fails the end is still true, and told late rather than never.
        let _ = tokio::time::timeout(LONGEST_SETTLING, settled).await;
    }

    /// The leases of all jobs that run.
    pub fn leases(&self) -> Vec<Lease> {
        let lease = |live: &Arc<Live>| held(&live.running).as_ref().map(|running| running.lease.clone());
        held(&self.live).values().filter_map(lease).collect()
    }
}

impl Live {
    /// Notes that a worker has the job.
    pub fn start(&self, job: &JobRecord, lease: Lease) {
        let now = Instant::now();
        *held(&self.running) = Some(Running {
            lease,
            since: now,
            // The budget of a tuning is that of each of its searches.
            // Nor does the budget of its fit say when a diagnosis ends.
            budget: job
                .request
                .pointer("/budget/evaluations")
                .and_then(Value::as_u64)
                .filter(|_| job.kind == JobKind::Estimate),
            earlier: 0,
            progress: None,
            pace: Pace::default(),
            told_at: now,
            told: None,
            told_incumbent_last: true,
        });
    }

    /// Notes how far the search has come, and says what watchers are to be told of it now, if anything.
    pub fn report(&self, news: &Progress) -> Option<JobChange> {
        let mut running = held(&self.running);
        let running = running.as_mut()?;
        // A job may search several times, each time counting from nought.
        let begins = |last: &&Progress| {
            news.evaluations < last.evaluations || news.trials.is_some() != last.trials.is_some()
        };
        if let Some(last) = running.progress.as_ref().filter(begins) {
            running.earlier += last.evaluations;
        }
        if let Some(trials) = &news.trials {
            running.pace.note(running.since.elapsed().as_secs_f64(), &trials.plan);
        }
        running.progress = Some(news.clone());
        if running.told_at.elapsed() < PAUSE {
            return None;
        }
        running.told_at = Instant::now();
        running.news()
    }

    /// What watchers are to be told of a job of whose trials they have heard nothing for long.
    pub fn silence(&self) -> Option<JobChange> {
        let mut running = held(&self.running);
        let running = running.as_mut().filter(|running| running.told_at.elapsed() >= SILENCE)?;
        running.progress.as_ref()?.trials.as_ref()?;
        running.told_at = Instant::now();
        running.report().map(|report| JobChange::Progress(Box::new(report)))
    }

    /// Tells the job to stop.
    pub fn call_off(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether somebody called the job off.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

impl Running {
    fn report(&self) -> Option<ProgressReport> {
        let progress = self.progress.as_ref()?;
        let evaluations = self.earlier + progress.evaluations;
        let left = self.budget.map(|budget| budget.saturating_sub(evaluations as u64));
        let now = self.since.elapsed().as_secs_f64();
        let of_budget = left.map(|left| left as f64 * now / (evaluations.max(1) as f64));
        let trials = progress.trials.clone();
        let eta = if trials.is_some() { self.pace.left(now) } else { of_budget };
        let with_share = |trials| Trials { share: self.pace.share(now), ..trials };
        Some(ProgressReport {
            generation: progress.generation,
            evaluations,
            best_train: progress.best_train.filter(|value| value.is_finite()),
            best_validation: progress.best_validation.filter(|value| value.is_finite()),
            eta_s: eta.map(f64::round),
            trials: trials.map(with_share),
        })
    }

    /// Progress and new best parameters take turns, so that neither keeps the other from being told.
    fn news(&mut self) -> Option<JobChange> {
        let incumbent = self.progress.as_ref().and_then(|progress| progress.incumbent.clone());
        let is_new =
            incumbent.as_ref().is_some_and(|new| self.told.as_ref().is_none_or(|old| !Arc::ptr_eq(old, new)));
        self.told_incumbent_last = is_new && !self.told_incumbent_last;
        if self.told_incumbent_last {
            self.told.clone_from(&incumbent);
            return incumbent.map(JobChange::Incumbent);
        }
        self.report().map(|report| JobChange::Progress(Box::new(report)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lampyris_core::pace::{Plan, WorkStage};

    fn running(told_before: Duration) -> Live {
        let lease = Lease { job: "job_1".into(), boot: 1, attempt: 1 };
        let told_at = Instant::now().checked_sub(told_before).unwrap();
        let running = Running {
            lease,
            since: told_at,
            budget: Some(1000),
            earlier: 0,
            progress: None,
            pace: Pace::default(),
            told_at,
            told: None,
            told_incumbent_last: true,
        };
        Live { cancelled: AtomicBool::new(false), running: Mutex::new(Some(running)) }
    }

    fn later(live: &Live) {
        let mut running = held(&live.running);
        let running = running.as_mut().unwrap();
        running.told_at = running.told_at.checked_sub(PAUSE).unwrap();
    }

    fn news(evaluations: usize, incumbent: &Arc<IndexMap<String, f64>>) -> Progress {
        Progress {
            evaluations,
            best_train: Some(1.0),
            incumbent: Some(incumbent.clone()),
            ..Progress::default()
        }
    }

    #[test]
    fn watchers_are_told_once_per_pause_and_of_each_improvement_once() {
        let best = Arc::new(IndexMap::from([("a".to_owned(), 1.0)]));
        let live = running(PAUSE);
        assert!(matches!(live.report(&news(10, &best)), Some(JobChange::Progress(_))));
        assert_eq!(live.report(&news(20, &best)), None, "the pause has not passed");
        later(&live);
        assert_eq!(live.report(&news(30, &best)), Some(JobChange::Incumbent(best.clone())));
        later(&live);
        assert!(matches!(live.report(&news(40, &best)), Some(JobChange::Progress(_))));
        later(&live);
        assert!(
            matches!(live.report(&news(50, &best)), Some(JobChange::Progress(_))),
            "the same parameters are no news"
        );
        let better = Arc::new(IndexMap::from([("a".to_owned(), 2.0)]));
        later(&live);
        assert_eq!(live.report(&news(60, &better)), Some(JobChange::Incumbent(better)));
    }

    #[test]
    fn a_diagnosis_behind_a_search_says_how_long_its_trials_will_take() {
        let best = Arc::new(IndexMap::new());
        let live = running(Duration::ZERO);
        held(&live.running).as_mut().unwrap().budget = None;
        let report = || held(&live.running).as_ref().unwrap().report().unwrap();
        live.report(&news(100, &best));
        assert_eq!((report().eta_s, report().trials), (None, None), "nobody knows yet");
        let began = Instant::now().checked_sub(Duration::from_secs(30)).unwrap();
        held(&live.running).as_mut().unwrap().since = began;
        let mut plan = Plan::default();
        plan.expect(WorkStage::Fit, 1.0);
        plan.enter(WorkStage::Settle, 1.0);
        let trials = Trials { round: 1, tried: 3, of: 12, plan, ..Trials::default() };
        live.report(&Progress { evaluations: 400, trials: Some(trials), ..Progress::default() });
        let report = report();
        let eta = report.eta_s.unwrap();
        assert!(
            (9.0..11.0).contains(&eta),
            "settling usually takes a third of the fit, which took 30 s: {eta}"
        );
        let share = report.trials.as_ref().and_then(|trials| trials.share).unwrap();
        assert!((0.7..0.8).contains(&share), "{share}");
        assert_eq!((report.evaluations, report.trials.map(|trials| trials.tried)), (500, Some(3)));
    }

    #[test]
    fn the_evaluations_of_several_searches_add_up() {
        let best = Arc::new(IndexMap::new());
        let live = running(Duration::ZERO);
        for evaluations in [100, 400, 50, 90, 20] {
            live.report(&news(evaluations, &best));
        }
        let report = held(&live.running).as_ref().unwrap().report().unwrap();
        assert_eq!(report.evaluations, 400 + 90 + 20);
    }
}
