//! Questions about fits, measurements and models that are answered at once, on the interactive threads.
//!
//! `subject` is a stored fit with what is needed to run it again. `comparison` lays such fits beside the
//! measurements and `chart` writes that as lines; `diagnostics` says the same in numbers and sentences.
//! `series` is the stitched view of all windows of a system, and `preview` one simulation for whoever edits a
//! model.

pub mod chart;
pub mod comparison;
pub mod diagnostics;
pub mod preview;
pub mod series;
pub mod subject;
