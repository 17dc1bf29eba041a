//! Optimisers behind ask and tell: they propose candidates in the unit cube, the caller evaluates.
//!
//! This stage knows no model: Schwefel's function and a room are the same to it. Cancelling, deadlines and
//! progress therefore live once, in the caller's loop, not in every algorithm.

pub mod agreement;
mod budget;
pub mod cfa_options;
pub mod clouds;
pub mod clustered;
pub mod covariance;
pub mod ctsm;
mod descent;
pub mod fa;
mod firefly;
pub mod functions;
pub mod ga;
pub mod grid;
pub mod hybrid;
mod kmeans;
mod lm;
pub mod local;
pub mod local_options;
pub mod lshade;
pub mod method;
pub mod multistart;
pub mod pso;
pub mod scoring;
mod search;
pub mod space;
mod swarm;
pub mod thesis_options;
mod trust_region;

pub use firefly::{Crowd, Edges, stream as random_stream};
pub use method::{Method, Range};
pub use search::Search;
pub use space::{Candidate, Dimension, DimensionScale, Space, Theta};

use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use utoipa::ToSchema;

/// What a candidate costs: a finite number, or nothing that could be computed.
///
/// The order is total and a diverged candidate is worse than any finite one, so no NaN can win.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cost {
    /// A finite cost; lower is better.
    Finite(f64),
    /// The simulation left the numbers.
    Diverged,
}

impl Cost {
    /// Wraps a computed number: anything that is not finite has diverged.
    pub fn new(value: f64) -> Self {
        if value.is_finite() { Cost::Finite(value) } else { Cost::Diverged }
    }

    /// The number, with infinity for a diverged candidate.
    pub fn value(self) -> f64 {
        match self {
            Cost::Finite(value) => value,
            Cost::Diverged => f64::INFINITY,
        }
    }
}

impl Eq for Cost {}

impl PartialOrd for Cost {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cost {
    fn cmp(&self, other: &Self) -> Ordering {
        self.value().total_cmp(&other.value())
    }
}

/// The answer to one asked candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The cost of the candidate.
    pub cost: Cost,
    /// Residuals whose mean square is the cost, where [`Ask::Residuals`] asked for them; otherwise empty.
    pub residuals: Vec<f64>,
    /// Where [`Ask::Slopes`] asked for it, and it could be computed.
    pub slope: Option<Slope>,
}

/// A negative log-likelihood, of which the cost is a rising function, with its slopes in the unit cube.
#[derive(Debug, Clone, PartialEq)]
pub struct Slope {
    /// The negative log-likelihood.
    pub value: f64,
    /// Its gradient.
    pub gradient: Vec<f64>,
    /// The curvature that it is expected to have, by rows; positive semidefinite.
    pub information: Vec<f64>,
}

/// What the optimiser wants to know next.
#[derive(Debug, Clone, PartialEq)]
pub enum Ask {
    /// The costs of these candidates.
    Costs(Vec<Candidate>),
    /// The costs and the residual vectors of these candidates.
    Residuals(Vec<Candidate>),
    /// The costs and the slopes of the likelihood at these candidates.
    Slopes(Vec<Candidate>),
    /// Nothing: the search has ended by itself.
    Done(Termination),
}

/// Why an optimiser ended by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// Successive restarts agree on the optimum.
    Converged,
    /// Restarts bring nothing new although they disagree.
    Stalled,
    /// The evaluations are used up.
    Budget,
}

/// A search over the unit cube.
pub trait Optimiser: Send {
    /// The next batch; the same question again until [`Optimiser::tell`] answers it.
    fn ask(&mut self) -> Ask;
    /// Answers the last question, in its order.
    fn tell(&mut self, answers: &[Evaluation]);
    /// The best candidate so far, with its cost.
    fn best(&self) -> Option<(&Candidate, Cost)>;
    /// Generations, restarts or iterations completed, for progress displays.
    fn generation(&self) -> usize;
    /// The local runs so far, in their order, where the search keeps count of them.
    fn runs(&self) -> Vec<LocalRun>;
}

/// Where a local run came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// A known point: the parameters in use, or the nominal ones.
    Warm,
    /// The best place of a cluster of the swarm.
    Cluster,
    /// A random place.
    Random,
    /// A point of a profile that turned out to be better than the optimum that it was drawn from.
    Profile,
}

/// A local run from its start to its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalRun {
    /// Where it came from.
    pub origin: Origin,
    /// What its start cost.
    pub start: Cost,
    /// What its end costs.
    pub end: Cost,
    /// How many candidates it asked for.
    pub evaluations: usize,
    /// Whether it ended at an optimum, rather than short of it or on the way of a better run.
    pub settled: bool,
}
