//! The work of a `tune` job: settings of the search, chosen on the system's own past. It runs on the CPU
//! pool.

use super::estimate::{Stopped, describe, invalid, stopped};
use super::input::JobInput;
use crate::service::catalogue::system::Mode;
use crate::store::finish::Tuned;
use lampyris_core::estimate::Control;
use lampyris_core::estimate::tune::{TuneError, tune};

/// Chooses settings and judges them on windows that the choice did not see.
///
/// # Errors
/// Where the record does not serve, nothing finite is found, or somebody stopped it.
pub fn run(input: &JobInput, control: &Control<'_>) -> Result<Tuned, Stopped> {
    let window = input.window().map_err(|error| Stopped::Failed(describe(error)))?;
    let tuning = tune(&input.catalogue, &input.model, &input.request, &window, &input.system.site(), control);
    match tuning {
        Ok(tuning) => Ok(Tuned { tuning, automatic: input.system.policy.mode == Mode::Auto }),
        Err(TuneError::Faults(faults)) => Err(Stopped::Failed(invalid(faults))),
        Err(TuneError::Estimate(error)) => Err(stopped(&error)),
    }
}
