//! The treatment plant of the demo: a synthetic one whose blowers give less air than its model believes. It
//! is fitted to its effluent; what it lacks is a question of minutes, so that the demo only says how to ask.

use super::wait::{failed, wait};
use crate::cli::output::{Failure, faults, print};
use crate::service::Service;
use crate::service::access::tokens::LOCAL;
use crate::service::catalogue::systems;
use crate::service::catalogue::windows::{self, Format};
use crate::service::queue::submit;
use crate::store::fits::{self, FitRecord};
use crate::store::jobs::{JobKind, Priority};
use crate::store::queue::Submitted;
use lampyris_core::data::SystemId;
use lampyris_core::twin::{PlantRequest, plant};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::time::Instant;

const SYSTEM: &str = "plant/north";
/// The plant that is fitted, and what is true beside it.
const MODEL: &str = "asm1_h";
const HIDDEN: &str = "asm1_h+aeration_limit";
const MISSING_AIR: f64 = 0.6;
const SEED: u64 = 5;
/// Long enough for a diagnosis, whose training, validation and test parts are taken in their usual
/// proportions.
const DAYS: usize = 8;

/// The fit of the plant.
#[derive(Debug)]
pub struct PlantFit {
    record: FitRecord,
    seconds: f64,
}

impl PlantFit {
    /// For programs.
    pub fn document(&self) -> Value {
        json!({
            "system": SYSTEM, "seconds": self.seconds, "verdict": self.record.verdict,
            "summary": self.record.summary, "fit": self.record.fit
        })
    }
}

/// Makes the plant and fits it. The parameters that four effluent concentrations of a week hardly tell stay
/// at their nominal values.
pub(crate) async fn fit(service: &Service, hidden: bool) -> Result<PlantFit, Failure> {
    let start = Instant::now();
    let system: SystemId = SYSTEM.parse().map_err(|error| Failure::Error(format!("{error}")))?;
    let catalogue = service.catalogue.current();
    let values = [("s_aeration", MISSING_AIR)];
    let made = tokio::task::spawn_blocking(move || {
        let request = PlantRequest {
            seed: SEED,
            model: HIDDEN,
            values: &values,
            days: DAYS,
            noise: 1.0,
            warm_up: false,
        };
        plant(&catalogue, &request)
    });
    let twin =
        made.await.map_err(|error| Failure::Error(error.to_string()))?.map_err(|found| faults(&found))?;
    let fixed = json!({ "Y_H": 0.67, "b_H": 0.62, "K_S": 20, "K_OA": 0.5, "K_NH": 1 });
    let document = json!({ "label": "synthetic treatment plant", "model": MODEL, "fixed": fixed });
    systems::put(service, &system, document, LOCAL, |_| true).await.map_err(failed)?;
    windows::take(service, &system, Format::Csv, twin.csv, None).await.map_err(failed)?;
    let request = json!({ "split": { "train": "P6D", "validation": "P2D" }, "method": { "seed": 1 } });
    let request = request.as_object().cloned().unwrap_or_default();
    let submitted =
        match submit::one(service, JobKind::Estimate, &system, false, Priority::Operator, &request, None)
            .await
            .map_err(failed)?
        {
            Submitted::New(job) | Submitted::Waiting(job) => vec![job.id],
            // Only a repeated request with a key comes earlier, and this has none.
            Submitted::Earlier(_) => Vec::new(),
        };
    let finished = wait(service, &submitted, hidden, "Fitting a treatment plant").await?;
    let fit = finished.iter().find_map(|job| Some(job.state.result()?.found()?.id.clone()));
    let why = || {
        finished
            .iter()
            .find_map(|job| job.state.failure())
            .map_or_else(String::new, |error| error.detail.clone())
    };
    let record = match &fit {
        Some(id) => fits::get(&service.store, id).await.map_err(|error| Failure::Error(error.to_string()))?,
        None => None,
    };
    let record = record.ok_or_else(|| Failure::Error(format!("{SYSTEM}: {}", why())))?;
    Ok(PlantFit { record, seconds: start.elapsed().as_secs_f64() })
}

/// What the fit says, and how to ask what the plant lacks.
pub fn present(fitted: &PlantFit, address: SocketAddr) {
    let PlantFit { record, seconds } = fitted;
    print(&format!(
        "\nA synthetic treatment plant, {SYSTEM} ({MODEL}), fitted in {seconds:.1} s to four concentrations \
        of its effluent. Free-run errors in g/m3:\n"
    ));
    print(&format!("{:<8} {:>6} {:>10} {:>22}", "output", "train", "validation", "times what noise leaves"));
    for (output, metrics) in &record.fit.metrics {
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.3}"));
        let ratio = metrics.rho.map_or_else(String::new, |rho| format!("{rho:.1}"));
        print(&format!(
            "{output:<8} {:>6.3} {:>10} {ratio:>22}",
            metrics.train_rmse,
            number(metrics.validation_rmse)
        ));
    }
    print(&format!(
        "{}\nIt hides one effect. To see what this plant lacks (it takes minutes), press \"Find what is \
        missing\" on\n  \
        http://{address}/ui/systems/{SYSTEM}/missing\nor\n  \
        curl -s -X POST http://{address}/jobs -H 'content-type: application/json' -d \
        '{{\"kind\":\"diagnose\",\"system\":\"{SYSTEM}\"}}'",
        record.summary
    ));
}
