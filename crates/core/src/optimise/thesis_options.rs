//! The settings of the clustered firefly algorithm as the thesis publishes it, and of its hierarchy.

use super::firefly::{Crowd, Edges};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The hyperparameters of Algorithm 2; the default is Table 7.4.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CfaThesisOptions {
    /// Initial number of fireflies.
    pub n: usize,
    /// Number of generations; a smaller evaluation budget truncates the schedule.
    pub generations: usize,
    /// Smallest number of fireflies (eq 4.3).
    pub n_min: usize,
    /// Target number of fireflies per cluster at the start (eq 4.8).
    pub target: f64,
    /// Smallest target number of fireflies per cluster (eq 4.11).
    pub target_min: f64,
    /// Randomness weight at the start (eq 4.2), as a share of each parameter's range.
    pub alpha: f64,
    /// Factor on the randomness weight per generation (eq 4.4).
    pub decay: f64,
    /// Attractiveness at distance zero (eq 4.1).
    pub beta0: f64,
    /// Light absorption in the first generations (eq 4.5).
    pub gamma_min: f64,
    /// Light absorption in the last generation (eq 4.5).
    pub gamma_max: f64,
    /// What the size of a cluster does in eq 4.10.
    pub crowd: Crowd,
    /// What happens at the edge of the box.
    pub edges: Edges,
}

impl Default for CfaThesisOptions {
    fn default() -> Self {
        Self {
            n: 70,
            generations: 70,
            n_min: 12,
            target: 7.0,
            target_min: 1.0,
            alpha: 0.5,
            decay: 0.97,
            beta0: 1.0,
            gamma_min: 0.01,
            gamma_max: 10.0,
            crowd: Crowd::Distance,
            edges: Edges::Bounce,
        }
    }
}

/// The hierarchical algorithm that thesis section 8.1 proposes: clusters are clustered again. A firefly
/// follows the centroids of its own supercluster, then superclusters in the one above, and so on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CfaHierarchicalOptions {
    /// Levels of clusters; with one it is Algorithm 2.
    pub levels: usize,
    /// Everything else. The target number of a cluster's members holds on every level.
    pub cfa_thesis: CfaThesisOptions,
}

impl Default for CfaHierarchicalOptions {
    fn default() -> Self {
        Self { levels: 2, cfa_thesis: CfaThesisOptions::default() }
    }
}
