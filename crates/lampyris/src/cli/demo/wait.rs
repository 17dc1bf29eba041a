//! Waits for what the demo has asked of its service, and says what has been done.

use crate::cli::output::{Failure, print};
use crate::service::{Service, ServiceError};
use crate::store::jobs::{self, JobKind, JobRecord};
use std::time::{Duration, Instant};

/// Longest time that the jobs of the demo may take.
const PATIENCE: Duration = Duration::from_secs(600);

/// What the service refused, as the end of the verb.
pub fn failed(error: ServiceError) -> Failure {
    Failure::Error(error.to_string())
}

/// What was done to a system.
fn done(job: &JobRecord) -> &'static str {
    match job.kind {
        _ if job.state.failure().is_some() => "failed",
        JobKind::Estimate => "is fitted",
        JobKind::Diagnose => "is asked what its model is missing",
        JobKind::Ladder => "is given what unseen data confirm",
        JobKind::Tune => "is tuned",
    }
}

/// Waits until all jobs have ended. `what` they are is said before, and a line of each as it ends.
pub(crate) async fn wait(
    service: &Service,
    ids: &[String],
    hidden: bool,
    what: &str,
) -> Result<Vec<JobRecord>, Failure> {
    let say = |text: &str| {
        if !hidden {
            print(text)
        }
    };
    say(&format!("{what} …"));
    let start = Instant::now();
    let mut told = Vec::new();
    loop {
        let mut records = Vec::new();
        for id in ids {
            let record =
                jobs::get(&service.store, id).await.map_err(|error| Failure::Error(error.to_string()))?;
            records.extend(record);
        }
        for job in records.iter().filter(|job| job.state.is_final()) {
            if told.contains(&job.id) {
                continue;
            }
            told.push(job.id.clone());
            let (at, of, seconds) = (told.len(), ids.len(), start.elapsed().as_secs_f64());
            say(&format!("  {at} of {of}: {} ({}) {}, {seconds:.1} s", job.system, job.model, done(job)));
        }
        if told.len() == ids.len() {
            return Ok(records);
        }
        if start.elapsed() > PATIENCE {
            let left = ids.len() - told.len();
            return Err(Failure::Error(format!("{left} of {} jobs have not ended", ids.len())));
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}
