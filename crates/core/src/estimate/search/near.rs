//! From the parameters that are served to the optimum next to them, which is enough on most nights: a room
//! changes little from one to the next, and a search everywhere finds the same place again.
//!
//! Where that optimum errs by more than the served parameters did over their own days, it may be the wrong
//! one, and everywhere is searched.

use super::control::{Control, EstimateError};
use super::drive::{POLISH_EVALUATIONS, SearchResult, polish};
use crate::estimate::fit::incumbent::Incumbent;
use crate::estimate::fit::{Searched, Stop};
use crate::estimate::problem::Problem;

/// The error of a free run may be this much larger than that of the served parameters over their own days:
/// one day in four weeks is another one.
const AS_THEY_DID: f64 = 1.05;

/// Why the optimum next to the served parameters is not taken.
pub(in crate::estimate) enum Unconvincing {
    /// Why in a sentence, and the evaluations spent.
    Because(String, usize),
    /// Somebody stopped the search.
    Error(EstimateError),
}

impl From<EstimateError> for Unconvincing {
    fn from(error: EstimateError) -> Self {
        Self::Error(error)
    }
}

/// The optimum next to the served parameters.
///
/// # Errors
/// That there is none, or [`EstimateError::Interrupted`].
pub(in crate::estimate) fn near(
    problem: &Problem,
    incumbent: &Incumbent,
    control: &Control,
) -> Result<SearchResult, Unconvincing> {
    let Some(found) = polish(problem, &incumbent.on(problem), POLISH_EVALUATIONS, control)? else {
        let why = "the served parameters lead nowhere on these days";
        return Err(Unconvincing::Because(why.to_owned(), POLISH_EVALUATIONS));
    };
    let stop = if found.stop == Stop::Budget { Stop::Budget } else { Stop::Converged };
    Ok(SearchResult { stop, searched: Searched::Local, ..found })
}

/// Whether what was found next to the served parameters errs by no more than those have promised.
///
/// # Errors
/// By how much more, or that nothing is promised.
pub(in crate::estimate) fn as_promised(
    problem: &Problem,
    found: &SearchResult,
    incumbent: &Incumbent,
) -> Result<(), Unconvincing> {
    let run = problem.simulate(&found.theta);
    for (output, document) in problem.model().outputs().iter().enumerate() {
        let channel = &document.channel;
        let error = problem.mean_square_error(&run, output, problem.split().train.clone()).map(f64::sqrt);
        let (Some(error), Some(promised)) = (error, incumbent.errors.get(channel)) else {
            let why = format!("what the served parameters err by in {channel} is not known");
            return Err(Unconvincing::Because(why, found.evaluations));
        };
        if error > AS_THEY_DID * promised {
            let more = 100.0 * (error / promised - 1.0);
            let why = format!(
                "next to the served parameters the error of {channel} is {more:.0} % above what it was over \
                 their own days"
            );
            return Err(Unconvincing::Because(why, found.evaluations));
        }
    }
    Ok(())
}
