//! What settings of a search are worth on windows that did not choose them.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The tuned settings have to need at most this share of the evaluations of those in use, by the geometric
/// mean of the pairs.
const BETTER: f64 = 0.95;
/// They have to need fewer in more pairs than chance would give in one comparison of forty (the sign test, by
/// the normal distribution).
const BY_CHANCE: f64 = 1.96;
/// They may spend so much more in all, until the search ends by itself.
const MAY_SPEND: f64 = 1.05;

/// Both settings on the unseen windows, in pairs with the same window and seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TuningJudgement {
    /// Searches of each.
    pub searches: usize,
    /// What the system had.
    pub before: Performance,
    /// What came out.
    pub tuned: Performance,
    /// Evaluations to come within 1 %, tuned over before: the geometric mean of the pairs.
    pub ratio: f64,
    /// Pairs in which the tuned settings need fewer.
    pub fewer: usize,
    /// Pairs in which they need more.
    pub more: usize,
}

impl TuningJudgement {
    /// Whether the tuned settings take the place of those in use: they come to the best known cost as often,
    /// need clearly fewer evaluations for it and not by chance, and their searches do not take longer to end.
    pub(super) fn is_better(&self) -> bool {
        let (fewer, more) = (self.fewer as f64, self.more as f64);
        self.ratio <= BETTER
            && fewer - more > BY_CHANCE * (fewer + more).sqrt()
            && self.tuned.within >= self.before.within
            && self.tuned.evaluations <= MAY_SPEND * self.before.evaluations
    }
}

/// What some settings did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = TuningPerformance)]
pub struct Performance {
    /// Share of the searches that came within 1 % of the best known cost.
    pub within: f64,
    /// Median evaluations until then, among those that did.
    pub to_reach: Option<f64>,
    /// Mean evaluations until a search ended.
    pub evaluations: f64,
}
