//! How the estimates of a fit err together.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The covariance of the estimates, and what the data leave open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = FitCovariance)]
pub struct Covariance {
    /// The parameters of rows and columns: all estimated ones that are no limits of the search.
    pub parameters: Vec<String>,
    /// By rows, each entry in the product of the units of its two parameters: the covariance on the scale of
    /// the search, carried to the estimates by its slope there (the delta method). The bounds of the search
    /// count as knowledge, so that it is finite also where the data say nothing.
    pub matrix: Vec<Vec<f64>>,
    /// How many combinations of them the data determine within the bounds of the search.
    #[schema(value_type = u64)]
    pub rank: usize,
    /// The combinations that they do not, each by the parameters that make it up.
    pub undetermined: Vec<Vec<String>>,
}

impl Covariance {
    /// What the data leave open, in a sentence; `None` where they determine everything.
    pub fn sentence(&self) -> Option<String> {
        let Self { parameters, rank, undetermined, .. } = self;
        let estimated = parameters.len();
        let groups: Vec<String> = undetermined
            .iter()
            .map(|names| match names.as_slice() {
                [name] => format!("fix {name}"),
                names => format!("fix one of {}", names.join(", ")),
            })
            .collect();
        (*rank < estimated)
            .then(|| format!("the data have rank {rank} of {estimated}: {}", groups.join("; ")))
    }
}
