//! Whether a parameter has changed within the newest weeks of a record. It runs on a CPU pool.

use super::input::JobInput;
use crate::service::catalogue::system::SystemDocument;
use crate::service::error::ServiceError;
use lampyris_core::data::{Duration, SplitRequest, Window};
use lampyris_core::diagnose::change::{ParameterChanges, WINDOW_DAYS, changes, step};
use lampyris_core::estimate::assess::metrics::ProcessNoise;
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::estimate::{EstimateRequest, Fit, prepare};
use lampyris_core::fault::Fault;
use lampyris_core::interrupt::Brake;

/// The stretch that is looked at: all of it estimation data, because nothing is fitted. What the system fixes
/// does not change.
pub fn newest_weeks(system: &SystemDocument) -> EstimateRequest {
    let whole = Duration::from_days(WINDOW_DAYS as i64);
    EstimateRequest {
        window: Some(WindowRange { last: Some(whole), from: None, to: None }),
        bounds: system.bounds.clone(),
        fixed: system.fixed.clone(),
        split: SplitRequest { train: whole, validation: Duration::default(), test: None },
        ..EstimateRequest::default()
    }
}

/// What the newest weeks of what was measured say along a fit, whose parameters need not be right.
///
/// # Errors
/// Where the model of the fit is another one on these channels, has no filter, or leaves the numbers.
pub fn along(
    input: &JobInput,
    window: &Window,
    fit: &Fit,
    brake: &Brake,
) -> Result<ParameterChanges, ServiceError> {
    let output = fit.metrics.keys().next();
    let step = output.and_then(|output| step(window, output));
    let weeks = EstimateRequest { step, ..newest_weeks(&input.system) };
    let problem = prepare(&input.catalogue, &input.model, &weeks, window, &input.system.site())
        .map_err(ServiceError::Faults)?
        .with_brake(brake);
    let names = problem.model().parameters().iter().map(|parameter| &parameter.name);
    if !names.eq(fit.parameters.keys()) {
        let detail = "channels have come or gone since the fit, so that its model is another one here";
        return Err(ServiceError::Faults(vec![
            Fault::new("/model", "model-changed", detail).suggest("post an estimate job"),
        ]));
    }
    changes(&fit.simulated(&problem), &fit.theta(), ProcessNoise::of(fit))
        .map_err(|fault| ServiceError::Faults(vec![fault]))
}
