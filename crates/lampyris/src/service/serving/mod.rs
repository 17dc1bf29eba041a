//! What controllers read, and who has a say in it.
//!
//! `params` follows the commits that change what is served: it makes an entry of `snapshot` from the
//! database, rendered once by `body`, and turns it stale when its time has come. Measurements that came
//! (`arrivals`) are compared with what is served by `degradations`; an operator's word comes by `decisions`.
//! `health` reads off the finished body how a system fares.

pub mod arrivals;
pub mod body;
pub mod decisions;
pub mod degradations;
pub mod health;
pub mod params;
pub mod snapshot;
