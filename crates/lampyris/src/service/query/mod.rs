//! Questions about fits, measurements and models that are answered at once, on the interactive threads.
//!
//! `subject` is a stored fit with what is needed to run it again. `comparison` lays such fits beside the
//! measurements and `chart` writes that as lines; `diagnostics` says the same in numbers and sentences,
//! `missing_heat` what flows that the model does not know of, `proposals` which term would explain it,
//! `parameter_changes` since when a parameter is another one, `experiments` what to drive to know it better.
//! `forecast` goes on from the newest measurement with the parameters in force, `scores` says how far off
//! such forecasts were, and `export` writes their model for other programs. `series` is the stitched view of
//! all windows of a system, and `preview` one simulation for whoever edits a model. `matrix` says which
//! systems lack which effects, and `night` what schedules have done.

pub mod chart;
pub mod comparison;
pub mod diagnostics;
pub mod experiments;
pub mod export;
pub mod forecast;
pub mod matrix;
pub mod missing_heat;
pub mod night;
pub mod parameter_changes;
pub mod preview;
pub mod proposals;
pub mod scores;
pub mod series;
pub mod subject;
