//! The model's own parameters beside a term: a fit without it may have taken half of it up, and answers to
//! any flow as no room does.

use super::term::TermSeries;
use crate::data::{Column, Grid, Hold};
use crate::diagnose::library::EffectSource;
use crate::diagnose::refit::Refit;
use crate::diagnose::residual::{Whitening, usable};
use crate::diagnose::score_test::Look;
use crate::estimate::{Problem, Site};
use crate::gram::dot;
use crate::model::Catalogue;
use crate::model::spec::{EffectSpec, InputHold, InputSpec, Nominal, ParameterSpec, Scale};
use crate::optimise::multistart::latin_hypercube;
use crate::simulate::trajectory::Halt;
use crate::units::error_unit;
use std::ops::Range;

/// What a term is called while it is tried, its channels and its size.
const TRIED: &str = "tried_term";
const RATE: &str = "tried_rate";
const FROM: &str = "tried_from";
const SIZE: &str = "tried_size";

/// How often the parameters may go as far, and the share of the squares that has to be left.
const ANCHORS: usize = 3;
const GAIN: f64 = 0.95;

/// How many starts are drawn where a model is fitted anew, the seed, the iterations of each, and how many of
/// their ends are settled.
const DRAWN: usize = 6;
const SEED: u64 = 1;
const ITERATIONS: usize = 20;
const ENDS: usize = 2;

/// Where terms are tried.
pub(super) struct Trial<'a> {
    pub catalogue: &'a Catalogue,
    pub problem: &'a Problem,
    pub site: &'a Site,
    pub grid: &'a Grid,
    pub samples: Range<usize>,
    pub hours: f64,
    pub halt: Halt<'a>,
}

/// Flows that are tried together, each with a size of its own.
pub(super) struct TriedFlows<'a> {
    pub series: &'a [TermSeries],
    /// The state into which they flow.
    pub into: usize,
    /// About how large they are.
    pub size: f64,
    /// At which multiple of it each size starts.
    pub start: f64,
}

/// A model that has found its parameters beside a term.
pub(super) struct SettledBeside {
    /// Its own.
    pub theta: Vec<f64>,
    /// The states at the segments' starts.
    pub starts: Vec<Vec<f64>>,
    /// The squares of the error that is left.
    pub squares: f64,
}

impl Trial<'_> {
    /// The model beside a term, without it.
    pub fn at(&self, settled: &SettledBeside) -> Option<Look<'_>> {
        Look::at(self.problem, self.samples.clone(), self.hours, &settled.theta, settled.starts.clone())
    }

    /// Brings the model to the least squares of its segments with flows beside it. A flow that has passed
    /// through a mass is a channel here: a state of its own would start anew with every segment. `anew` asks
    /// for fits from other starts as well.
    pub fn beside(&self, theta: &[f64], flows: &TriedFlows<'_>, anew: bool) -> Option<SettledBeside> {
        let column = |unit: &str, values: Vec<f64>| Column::complete(unit, Hold::ZeroOrder, values).ok();
        let mut grid = self.grid.clone();
        for (at, series) in flows.series.iter().enumerate() {
            let rate = series.rate.iter().map(|rate| flows.size * rate).collect();
            grid = grid.with_column(&numbered(RATE, at), column("-", rate)?).ok()?;
            if let Some(from) = &series.from {
                grid = grid.with_column(&numbered(FROM, at), column("degC", from.clone())?).ok()?;
            }
        }
        let mut catalogue = self.catalogue.clone();
        catalogue.add_effect(self.effect(flows));
        let source = EffectSource { catalogue: &catalogue, site: self.site, grid, holes: Vec::new() };
        let candidate = source.candidate(self.problem, TRIED).ok()?;
        let with = |theta: &[f64]| {
            let mut there = candidate.lift(self.problem, theta);
            candidate.own.iter().for_each(|(index, _)| there[*index] = flows.start);
            there
        };
        let others = if anew { self.others().iter().map(|theta| with(theta)).collect() } else { Vec::new() };
        let settled = self.settled(&candidate.problem, with(theta), others)?;
        Some(SettledBeside { theta: candidate.lower(self.problem, &settled.theta), ..settled })
    }

    /// Brings the model without any term to the least squares of its segments, as hard.
    pub fn alone(&self, theta: &[f64]) -> Option<SettledBeside> {
        self.settled(self.problem, theta.to_vec(), self.others())
    }

    /// The nominal parameters, and others that are drawn.
    fn others(&self) -> Vec<Vec<f64>> {
        let drawn = latin_hypercube(DRAWN, self.problem.free().len(), SEED);
        let drawn = drawn.iter().map(|candidate| self.problem.theta(candidate));
        std::iter::once(self.problem.nominal().to_vec()).chain(drawn).collect()
    }

    /// The least squares along the segments from a start, and from what free runs come to from there and from
    /// others, where those are given; the best of these goes on.
    fn settled(&self, problem: &Problem, start: Vec<f64>, others: Vec<Vec<f64>>) -> Option<SettledBeside> {
        let from = |theta: &[f64]| {
            let look = Look::new(problem, theta, self.samples.clone(), self.hours, self.halt)?;
            let squares = dot(look.left(), look.left());
            Some(SettledBeside { theta: look.theta().to_vec(), starts: look.starts().to_vec(), squares })
        };
        let mut starts = vec![start.clone()];
        if !others.is_empty() {
            let all: Vec<Vec<f64>> = std::iter::once(start).chain(others).collect();
            starts.extend(anew_from(problem, &all, self.halt));
        }
        let ends = starts.iter().filter_map(|start| from(start));
        let mut best = ends.min_by(|a, b| a.squares.total_cmp(&b.squares))?;
        for _ in 1..ANCHORS {
            let Some(next) = from(&best.theta) else { break };
            let gains = next.squares < GAIN * best.squares;
            best = next;
            if !gains {
                break;
            }
        }
        Some(best)
    }

    /// The flows as an effect: given ones, or along the difference of a given one from the state.
    fn effect(&self, flows: &TriedFlows<'_>) -> EffectSpec {
        let state = &self.problem.model().states()[flows.into];
        let input = |unit: &str| InputSpec {
            unit: unit.to_owned(),
            hold: InputHold::ZeroOrder,
            channel: None,
            min: None,
            may_be_constant: true,
        };
        let size = |unit: String| ParameterSpec {
            unit,
            lower: -10.0,
            upper: 10.0,
            scale: Scale::Linear,
            nominal: Nominal::Value(1.0),
            quantity: String::new(),
            title: String::new(),
            excite: None,
        };
        let mut effect = EffectSpec { id: TRIED.to_owned(), ..EffectSpec::default() };
        let mut terms = Vec::new();
        for (at, series) in flows.series.iter().enumerate() {
            let (rate, from, how_much) = (numbered(RATE, at), numbered(FROM, at), numbered(SIZE, at));
            effect.inputs.insert(rate.clone(), input("-"));
            if series.from.is_some() {
                terms.push(format!("{how_much} * {rate} * ({from} - {})", state.name));
                effect.inputs.insert(from, input("degC"));
                effect.parameters.insert(how_much, size("1/h".to_owned()));
            } else {
                terms.push(format!("{how_much} * {rate}"));
                effect.parameters.insert(how_much, size(format!("{}/h", error_unit(&state.unit))));
            }
        }
        effect.terms.insert(state.name.clone(), terms.join(" + "));
        effect
    }
}

fn numbered(name: &str, at: usize) -> String {
    format!("{name}_{at}")
}

/// The best ends of the free run from some starts.
fn anew_from(problem: &Problem, starts: &[Vec<f64>], halt: Halt<'_>) -> Vec<Vec<f64>> {
    let whitening = Whitening::none(&usable(problem, &problem.split().train));
    let task = Refit { problem, whitening: &whitening, deviation: problem.scaled_noise(), halt };
    let (mut ends, _) = task.ends(starts, ITERATIONS);
    ends.retain(|(_, cost)| cost.is_finite());
    ends.sort_by(|a, b| a.1.total_cmp(&b.1));
    ends.truncate(ENDS);
    ends.into_iter().map(|(theta, _)| theta).collect()
}
