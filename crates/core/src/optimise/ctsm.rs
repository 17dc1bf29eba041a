//! The search for the largest likelihood: the hybrid with Fisher scoring as its local stage.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::agreement::AgreementOptions;
use super::cfa_options::CfaOptions;
use super::hybrid::Cfa;
use super::local::LocalWay;
use super::scoring::ScoringOptions;
use super::search::Search;

/// The hyperparameters of maximum likelihood.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CtsmOptions {
    /// Initial number of fireflies of a swarm.
    pub n: usize,
    /// Evaluations of the first swarm.
    pub swarm: usize,
    /// Factor on the evaluations of a swarm per restart.
    pub growth: f64,
    /// Local runs per swarm from the best places of distinct clusters.
    pub starts: usize,
    /// Local runs per swarm from random places.
    pub scouts: usize,
    /// Points of each profile likelihood on either side of the estimate; 0 for no profiles.
    pub profile: usize,
    /// The local runs.
    pub scoring: ScoringOptions,
    /// When restarts have told enough. The cost is the variance of white innovations of the same likelihood,
    /// so its relative difference is twice that of the log-likelihood over the number of innovations.
    pub agreement: AgreementOptions,
}

impl Default for CtsmOptions {
    fn default() -> Self {
        Self {
            n: 40,
            swarm: 400,
            growth: 1.5,
            starts: 3,
            scouts: 1,
            profile: 3,
            scoring: ScoringOptions::default(),
            agreement: AgreementOptions { within: 2e-5, improvement: 2e-5, ..AgreementOptions::default() },
        }
    }
}

/// The search.
pub(super) fn likely(options: &CtsmOptions, search: &Search) -> Cfa {
    let swarms = CfaOptions {
        n: options.n,
        n_min: CfaOptions::default().n_min.min(options.n),
        swarm: options.swarm,
        growth: options.growth,
        starts: options.starts,
        scouts: options.scouts,
        agreement: options.agreement,
        ..CfaOptions::default()
    };
    Cfa::with(swarms, LocalWay::Slopes(options.scoring.clone()), search)
}
