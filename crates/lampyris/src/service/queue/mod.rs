//! How requests become jobs, and how jobs are forgotten.
//!
//! `request` reads what is asked and fills the defaults of the system in, `body` describes that, `submit`
//! checks it against the system and its model and lets it in. `schedules` submits ordinary batches when a row
//! says so, and `retention` then forgets what is old. `listing` brings fits of earlier programs into the
//! lists.

pub mod body;
pub mod listing;
pub mod request;
pub mod retention;
pub mod schedules;
pub mod submit;
