//! Owns the CPU pools and the clock, and stands between the surface and the store.
//!
//! A request becomes a row of the queue (`queue`), a worker claims it and runs it on its pool (`work`), the
//! end is one transaction of the store, and `serving` then swaps what `/params` serves: commit first, then
//! swap.
//!
//! | folder | what it does |
//! |---|---|
//! | `catalogue` | documents and measurements: checked here, kept by the store |
//! | `queue` | how requests become jobs, and how jobs are forgotten |
//! | `work` | from the claim to the verdict |
//! | `serving` | what controllers read, and who has a say in it |
//! | `query` | questions about fits, measurements and models that are answered at once |
//! | `changes` | what happens to jobs, for those who listen |
//! | `access` | who may ask |
//! | `observe` | what is counted |
//!
//! Below all of them: `state` is what they share, made of parts that know nothing of the whole; `error` says
//! why something could not be done, `threads` where work is done, `clock` what time it is, and `decode` with
//! `strict` reads JSON with all its faults.

pub mod access;
pub mod catalogue;
pub mod changes;
mod clock;
pub mod decode;
mod error;
pub mod observe;
pub mod query;
pub mod queue;
pub mod serving;
mod state;
mod strict;
mod threads;
pub mod trust;
pub mod work;

pub use clock::{Clock, now};
pub use error::{Refusal, ServiceError};
pub use state::Service;
pub use threads::{blocking, pool};
