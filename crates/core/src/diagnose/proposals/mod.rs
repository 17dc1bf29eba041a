//! Terms that no catalogue has: what the error of a model goes with, as a sentence, an equation and a
//! document that makes it an effect.
//!
//! ```text
//! channels, sun, clock --stock, term--> terms --search--> scores --choose--> leaders
//!                                         ^                              |
//!                    refined beside them  +---- settled: parameters -----+--document--> ProposedTerm
//! ```
//!
//! Every term of a grammar is scored along segments of hours, as candidates of the catalogue are
//! (`score_test`). How well the best of so many does by chance the room itself says: the same search is
//! judged on its errors shifted by whole days. A model that lacks an effect has wrong parameters and answers
//! to any flow as no room does; so the best are tried beside parameters of their own, and sought again there.
//!
//! A state that the record does not show starts anew in every segment, and what has passed a mass of its own
//! enters as a given flow. Drifts of weeks do not show along segments of hours.

mod choose;
mod document;
mod response;
mod search;
mod settled;
mod stock;
mod term;
#[cfg(test)]
mod tests;

use super::score_test::RANKING_HOURS;
use crate::data::Window;
use crate::estimate::problem::request::AccusationRate;
use crate::estimate::problem::widen::widen;
use crate::estimate::segments::likeness;
use crate::estimate::{Problem, Site};
use crate::fault::Fault;
use crate::model::spec::EffectSpec;
use crate::model::{Catalogue, Initial};
use choose::TriedTerm;
pub use document::PROPOSED;
use document::TermWriting;
use search::TermSearch;
use serde::{Deserialize, Serialize};
use settled::Trial;
use stock::Stock;
use utoipa::ToSchema;

/// What terms are sought for.
#[derive(Debug, Clone, Copy)]
pub struct ProposalsAsked<'a> {
    /// Where the definition of the sun stands.
    pub catalogue: &'a Catalogue,
    /// The model and its data.
    pub problem: &'a Problem,
    /// Its parameters.
    pub theta: &'a [f64],
    /// All that was measured.
    pub window: &'a Window,
    /// Where it stands, and its clock.
    pub site: &'a Site,
    /// In how many rooms in which nothing is missing a term may be proposed.
    pub rate: AccusationRate,
}

/// Terms that may be missing, best first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Proposals {
    /// What it says, in plain sentences.
    pub sentences: Vec<String>,
    /// How many terms were tried.
    pub tried: usize,
    /// With how many shifts by whole days each was compared.
    pub shifts: usize,
    /// The share of the squared error over the next 12 h that the best of so many terms explains by chance in
    /// as many rooms as the accusation rate says; `null` where the days are too few to tell.
    pub by_chance: Option<f64>,
    /// At most three.
    pub proposals: Vec<ProposedTerm>,
}

/// A term that may be missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ProposedTerm {
    /// The id of the effect that adds it.
    pub effect: String,
    /// Whether the service has that effect already: another room was found to lack the same, or it was taken
    /// before. Its document has the numbers of then.
    pub known: bool,
    /// What it does, for an operator.
    pub sentence: String,
    /// The state that it flows into, and the term.
    pub equation: String,
    /// Its size, in `unit`.
    pub size: f64,
    /// The unit of the size.
    pub unit: String,
    /// The share of the squared error over the next 12 h that it explains, beside parameters of its own.
    pub share: f64,
    /// Its size over its deviation, robust by days.
    pub t: f64,
    /// The share of each half of the days that it explains with the size from the other half.
    pub confirmed: f64,
    /// The squared error over the next 12 h that is left when it is added and all parameters are found anew,
    /// as a share of what was left without it.
    pub left: f64,
    /// What cannot be told from it with these data.
    pub or: Vec<String>,
    /// The document, as `POST /effects` takes it.
    pub document: EffectSpec,
    /// The same as TOML.
    pub toml: String,
}

/// Terms that may be missing in a model.
///
/// # Errors
/// A fault of a model without a filter or without a measured state, of one that leaves the numbers, and of a
/// time zone that is unknown.
pub fn propose(asked: &ProposalsAsked<'_>) -> Result<Proposals, Fault> {
    Ok(propose_knowing(asked, None)?.0)
}

/// The same, and how much each has in common with a flow that is known: what flows into the measured state
/// from each sample to the next, in its unit per hour. It is the correlation of what both do to the outputs,
/// beside the parameters of the proposal.
///
/// # Errors
/// As [`propose`].
pub fn propose_knowing(
    asked: &ProposalsAsked<'_>,
    flow: Option<&[f64]>,
) -> Result<(Proposals, Vec<f64>), Fault> {
    let ProposalsAsked { catalogue, problem, theta, window, site, rate } = *asked;
    let cannot = |why: &str| Fault::new("query", "no-proposals", why.to_owned());
    if let Some(why) = problem.predictor().lacks_filter_for("a search for terms") {
        return Err(cannot(&why));
    }
    let states = problem.model().states();
    let into = states.iter().position(|state| matches!(state.initial, Initial::Measured(_)));
    let into = into.ok_or_else(|| cannot("no state is what an output shows"))?;
    let (grid, _) = widen(problem, window, site)?;
    let stock = Stock::new(problem, &grid);
    let samples = problem.split().train.start..problem.split().validation.end;
    let halt = || {
        problem.brake().check();
        false
    };
    let trial = Trial { catalogue, problem, site, grid: &grid, samples, hours: RANKING_HOURS, halt: &halt };
    let left = || cannot("the model leaves the numbers along the record, or has too few measurements");
    let null = trial.alone(theta).ok_or_else(left)?;
    let null = trial.at(&null).ok_or_else(left)?;
    let search = TermSearch::new(problem, &stock, &null, into, &halt).ok_or_else(left)?;
    let found = choose::choose(&trial, &search, &null, rate.into());

    let common = |tried: &TriedTerm| {
        let flow = flow?.to_vec();
        let look = trial.at(&tried.settled)?;
        let search = TermSearch::new(problem, &stock, &look, into, &halt)?;
        let direction = look.rest(search.raw_of(flow));
        let own = look.rest(search.raw(&tried.term)?);
        Some(likeness(&direction, &own).abs())
    };
    let common = found.best.iter().map(|tried| common(tried).unwrap_or_default()).collect();
    let composition = catalogue.compose(problem.model().id()).ok();
    let name = states[into].name.as_str();
    let place = composition
        .as_ref()
        .and_then(|composition| composition.spec.states.get(name))
        .map_or(name, |state| if state.title.is_empty() { name } else { state.title.as_str() });
    let of = |term, size| TermWriting { stock: &stock, catalogue, model: problem.model(), place, term, size };
    let mut proposals: Vec<ProposedTerm> = Vec::new();
    for tried in &found.best {
        let writing = of(tried.term, tried.size);
        let (document, known) = writing.effect(|id| proposals.iter().any(|given| given.effect == id));
        proposals.push(ProposedTerm {
            effect: document.id.clone(),
            known,
            sentence: writing.sentence(),
            equation: format!("{name}: {}", document.terms.get(name).cloned().unwrap_or_default()),
            size: tried.size,
            unit: writing.size_unit(),
            share: tried.share,
            t: tried.t.abs(),
            confirmed: tried.confirmed,
            left: tried.settled.squares / found.left.max(f64::MIN_POSITIVE),
            or: tried.alike.iter().map(|term| of(*term, tried.size).subject()).collect(),
            toml: toml::to_string(&document).unwrap_or_default(),
            document,
        });
    }
    let (tried, shifts) = (found.tried, found.shifts);
    let sentences = sentences(&proposals, tried, shifts);
    Ok((Proposals { sentences, tried, shifts, by_chance: found.by_chance, proposals }, common))
}

/// What it says, in plain sentences.
fn sentences(proposals: &[ProposedTerm], tried: usize, shifts: usize) -> Vec<String> {
    let Some(best) = proposals.first() else {
        let days =
            if shifts < choose::LEAST_SHIFTS { " The days are too few to tell chance apart." } else { "" };
        return vec![format!(
            "None of {tried} terms of what was measured and the clock explains the error better than chance \
             does.{days}"
        )];
    };
    let mut said = vec![format!(
        "{} With it and all parameters found anew, {:.0} % of the squared error over the next 12 h is left.",
        best.sentence,
        100.0 * best.left
    )];
    if proposals.len() > 1 {
        let others = proposals.len() - 1;
        said.push(format!(
            "{others} {} follow, in the order of what they leave; they exclude each other.",
            if others == 1 { "other" } else { "others" }
        ));
    }
    said.push(
        "What it goes with need not be what causes it. Add it, fit anew, and watch the error on days that it \
         has not seen."
            .to_owned(),
    );
    said
}
