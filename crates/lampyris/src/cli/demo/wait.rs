//! Waits for what the demo has asked of its service.

use crate::cli::output::Failure;
use crate::service::{Service, ServiceError};
use crate::store::jobs::{self, JobRecord};
use indicatif::{ProgressBar, ProgressStyle};
use std::time::{Duration, Instant};

/// Longest time that the jobs of the demo may take.
const PATIENCE: Duration = Duration::from_secs(600);

/// What the service refused, as the end of the verb.
pub fn failed(error: ServiceError) -> Failure {
    Failure::Error(error.to_string())
}

/// Waits until all jobs have ended.
pub async fn wait(
    service: &Service,
    ids: &[String],
    hidden: bool,
    what: &'static str,
) -> Result<Vec<JobRecord>, Failure> {
    let bar = if hidden { ProgressBar::hidden() } else { ProgressBar::new(ids.len() as u64) };
    if let Ok(style) =
        ProgressStyle::with_template(&format!("{{bar:30}} {{pos}} of {{len}} {what}  {{elapsed}}"))
    {
        bar.set_style(style);
    }
    let start = Instant::now();
    loop {
        let mut records = Vec::new();
        for id in ids {
            let record =
                jobs::get(&service.store, id).await.map_err(|error| Failure::Error(error.to_string()))?;
            records.extend(record);
        }
        let done = records.iter().filter(|record| record.state.is_final()).count();
        bar.set_position(done as u64);
        if done == ids.len() {
            bar.finish_and_clear();
            return Ok(records);
        }
        if start.elapsed() > PATIENCE {
            return Err(Failure::Error(format!("{} of {} jobs have not ended", ids.len() - done, ids.len())));
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}
