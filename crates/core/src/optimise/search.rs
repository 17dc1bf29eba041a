//! The task of a search.

use super::Candidate;

/// The task of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Search {
    /// How many parameters are free.
    pub dimensions: usize,
    /// Fixes every random number of the search.
    pub seed: u64,
    /// Most evaluations, each candidate of each batch being one.
    pub budget: usize,
    /// Candidates to begin with, such as the parameters in use. Those of another dimension are ignored.
    pub warm: Vec<Candidate>,
    /// Whether the caller can answer [`super::Ask::Residuals`]; otherwise it is asked for costs only.
    pub residuals: bool,
}

impl Search {
    /// The warm starts that fit, inside the cube.
    pub(super) fn warm_starts(&self) -> Vec<Candidate> {
        let fits =
            |start: &&Candidate| start.0.len() == self.dimensions && start.0.iter().all(|x| x.is_finite());
        let inside = |start: &Candidate| Candidate(start.0.iter().map(|x| x.clamp(0.0, 1.0)).collect());
        self.warm.iter().filter(fits).map(inside).collect()
    }
}
