//! The settings of the clustered firefly algorithm with a local stage.

use super::agreement::AgreementOptions;
use super::firefly::Crowd;
use super::local_options::LocalOptions;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The hyperparameters of the hybrid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CfaOptions {
    /// Initial number of fireflies of a swarm.
    pub n: usize,
    /// Smallest number of fireflies (eq 4.3).
    pub n_min: usize,
    /// Target number of fireflies per cluster at the start (eq 4.8).
    pub target: f64,
    /// Smallest target number of fireflies per cluster (eq 4.11).
    pub target_min: f64,
    /// Randomness weight at the start of a swarm (eq 4.2), as a share of each parameter's range.
    pub alpha: f64,
    /// Randomness weight at its end, where the local stage takes over.
    pub alpha_end: f64,
    /// Attractiveness at distance zero (eq 4.1).
    pub beta0: f64,
    /// Light absorption (eq 4.1), constant.
    pub gamma: f64,
    /// Probability that a coordinate stays as it is in a move.
    pub crossover: f64,
    /// What the size of a cluster does in eq 4.10.
    pub crowd: Crowd,
    /// Evaluations of the first swarm where there are residuals. Least squares need little guidance.
    pub swarm: usize,
    /// What is different where there are only costs, and the swarm has to find the basin by itself.
    pub on_costs: OnCostsOptions,
    /// Factor on the evaluations of a swarm per restart.
    pub growth: f64,
    /// A swarm hands over early after this many generations without a noticeably lower cost; 0 for never.
    pub stall: usize,
    /// Local runs per swarm from what the swarm has found.
    pub starts: usize,
    /// Where these runs start.
    pub local_from: LocalFrom,
    /// Local runs per swarm from random places. They keep a swarm that is drawn to the wrong basin, as
    /// another one may be, from confirming itself.
    pub scouts: usize,
    /// The local runs.
    pub local: LocalOptions,
    /// When restarts have told enough.
    pub agreement: AgreementOptions,
}

impl Default for CfaOptions {
    fn default() -> Self {
        Self {
            n: 40,
            n_min: 12,
            target: 7.0,
            target_min: 1.0,
            alpha: 0.5,
            alpha_end: 1e-2,
            beta0: 1.0,
            gamma: 1.0,
            crossover: 0.3,
            crowd: Crowd::Distance,
            swarm: 200,
            on_costs: OnCostsOptions::default(),
            growth: 1.5,
            stall: 10,
            starts: 2,
            local_from: LocalFrom::ClusterBests,
            scouts: 1,
            local: LocalOptions::default(),
            agreement: AgreementOptions::default(),
        }
    }
}

/// Where the local runs of a swarm start (thesis section 8.1 names the last two).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LocalFrom {
    /// The best places of distinct clusters.
    #[default]
    ClusterBests,
    /// The centroids of the clusters.
    Centroids,
    /// The best fireflies, wherever they are.
    Fireflies,
}

/// The swarm where there are only costs. Its moves are greedy: a firefly returns from a place that is worse.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OnCostsOptions {
    /// Evaluations of the first swarm per free parameter.
    pub swarm: usize,
    /// Light absorption (eq 4.1). In the unit cube of many dimensions all distances are large.
    pub gamma: f64,
    /// Probability that a coordinate stays as it is in a move.
    pub crossover: f64,
    /// Probability that a coordinate that moves is drawn anew: the way out of a place that all others share.
    pub leap: f64,
    /// Standard deviation of the first steps of the clouds that take turns with swarms; 0 for no clouds.
    pub cloud: f64,
}

impl Default for OnCostsOptions {
    fn default() -> Self {
        Self { swarm: 300, gamma: 0.1, crossover: 0.8, leap: 0.2, cloud: 0.2 }
    }
}
