//! The work of a `diagnose` and of a `ladder` job: a fit of the base model first, then what it is missing. It
//! runs on the CPU pool.

use super::estimate::{FirstFit, Stopped, fitted, invalid, stopped};
use super::input::JobInput;
use crate::store::diagnoses::Report;
use crate::store::finish::JudgedFit;
use lampyris_core::diagnose::{self, DiagnoseError};
use lampyris_core::estimate::Control;
use lampyris_core::estimate::problem::request::Criterion;
use lampyris_core::interrupt::Brake;

/// Most effects that a ladder adds.
const STEPS: usize = 3;

/// Fits the base model and says which effect it is missing.
///
/// # Errors
/// Where there is no fit to start from, the window does not serve, or somebody stopped it.
pub fn run(input: &JobInput, control: &Control<'_>, brake: &Brake) -> Result<JudgedFit, Stopped> {
    let FirstFit { window, problem, finding } = fitted(input, control, brake)?;
    let site = input.system.site();
    let rate = input.request.accusation_rate;
    let (theta, earlier) = (finding.fit.theta(), &input.evidence);
    let diagnosis =
        diagnose::diagnose(&input.tried, &problem, &theta, &window, &site, rate, earlier, control)
            .map_err(halted)?;
    Ok(JudgedFit { report: Some(Report::Diagnosis(Box::new(diagnosis))), ..finding })
}

/// Fits the base model and adds effects while the criterion keeps them.
///
/// # Errors
/// Where there is no fit to start from, the window does not serve, or somebody stopped it.
pub fn ladder(input: &JobInput, control: &Control<'_>, brake: &Brake) -> Result<JudgedFit, Stopped> {
    let FirstFit { window, problem, finding } = fitted(input, control, brake)?;
    let site = input.system.site();
    let ladder = match input.request.criterion {
        Criterion::HeldOut => diagnose::ladder::ladder,
        Criterion::Lrt => diagnose::nested::ladder_by_likelihood,
    };
    let ladder = ladder(&input.tried, &problem, &finding.fit.theta(), &window, &site, STEPS, control)
        .map_err(halted)?;
    Ok(JudgedFit { report: Some(Report::Ladder(Box::new(ladder))), ..finding })
}

fn halted(error: DiagnoseError) -> Stopped {
    match error {
        DiagnoseError::Faults(faults) => Stopped::Failed(invalid(faults)),
        DiagnoseError::Estimate(error) => stopped(&error),
    }
}
