//! What controllers read, and who has a say in it.
//!
//! `params` follows the commits that change what is served: it makes an entry of `snapshot` from the
//! database, rendered once by `body` and `states`, and turns it stale when its time has come (`ageing`).
//! Measurements that came (`arrivals`) are compared with what is served by `degradations`, from where the
//! states go on sample by sample (`live`, by the filters that are `kept`); an operator's word comes by
//! `decisions`. What forecasts said (`said`) is written down by `keeping`, to be compared with what comes.
//! `pull` asks others for measurements. `health`
//! says how a system fares, and what to do about it.

pub mod ageing;
pub mod arrivals;
pub mod body;
pub mod decisions;
pub mod degradations;
pub mod health;
#[cfg(test)]
mod health_tests;
pub mod keeping;
pub mod kept;
pub mod live;
pub mod params;
pub mod pull;
pub mod said;
pub mod snapshot;
pub mod states;
