//! The model's own parameters beside a term: a fit without it may have taken half of it up, and answers to
//! any flow as no room does.

use super::term::TermSeries;
use crate::data::{Column, Grid, Hold};
use crate::diagnose::library::EffectSource;
use crate::diagnose::refit::Refit;
use crate::diagnose::residual::{Whitening, usable};
use crate::diagnose::score_test::Look;
use crate::estimate::{Problem, Site};
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

/// How often the parameters may go as far again, and the share of the squares that has to be left.
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

    /// Brings the model to the least squares of its segments with a flow of about this size. A flow that has
    /// passed through a mass is a channel here: a state of its own would start anew with every segment.
    /// `anew` asks for fits from other starts as well.
    pub fn beside(
        &self,
        theta: &[f64],
        series: &TermSeries,
        into: usize,
        size: f64,
        anew: bool,
    ) -> Option<SettledBeside> {
        let column = |unit: &str, values: Vec<f64>| Column::complete(unit, Hold::ZeroOrder, values).ok();
        let rate = series.rate.iter().map(|rate| size * rate).collect();
        let mut grid = self.grid.clone().with_column(RATE, column("-", rate)?).ok()?;
        if let Some(from) = &series.from {
            grid = grid.with_column(FROM, column("degC", from.clone())?).ok()?;
        }
        let mut catalogue = self.catalogue.clone();
        catalogue.add_effect(self.effect(into, series.from.is_some()));
        let source = EffectSource { catalogue: &catalogue, site: self.site, grid, holes: Vec::new() };
        let candidate = source.candidate(self.problem, TRIED).ok()?;
        let with = |theta: &[f64]| {
            let mut there = candidate.lift(self.problem, theta);
            candidate.own.iter().for_each(|(index, _)| there[*index] = 1.0);
            there
        };
        let nominal = anew.then(|| with(self.problem.nominal()));
        let settled = self.settled(&candidate.problem, with(theta), nominal)?;
        Some(SettledBeside { theta: candidate.lower(self.problem, &settled.theta), ..settled })
    }

    /// Brings the model without any term to the least squares of its segments, as hard.
    pub fn alone(&self, theta: &[f64]) -> Option<SettledBeside> {
        self.settled(self.problem, theta.to_vec(), Some(self.problem.nominal().to_vec()))
    }

    /// The least squares along the segments from a start, and from what free runs come to from there, from
    /// the nominal values and from starts that are drawn, where those are given.
    fn settled(
        &self,
        problem: &Problem,
        start: Vec<f64>,
        nominal: Option<Vec<f64>>,
    ) -> Option<SettledBeside> {
        let from = |start: &Vec<f64>| {
            let mut best: Option<SettledBeside> = None;
            let mut here = start.clone();
            for _ in 0..ANCHORS {
                let look = Look::new(problem, &here, self.samples.clone(), self.hours, self.halt)?;
                let squares = look.left().iter().map(|left| left * left).sum();
                let gains = best.as_ref().is_none_or(|best| squares < GAIN * best.squares);
                here = look.theta().to_vec();
                best = Some(SettledBeside { theta: here.clone(), starts: look.starts().to_vec(), squares });
                if !gains {
                    break;
                }
            }
            best
        };
        let mut starts = vec![start.clone()];
        if let Some(nominal) = nominal {
            starts.extend(anew_from(problem, vec![start, nominal], self.halt));
        }
        let ends: Vec<SettledBeside> = starts.iter().filter_map(from).collect();
        ends.into_iter().min_by(|a, b| a.squares.total_cmp(&b.squares))
    }

    /// The flow as an effect: one that is given, or along the difference of a given one from the state.
    fn effect(&self, into: usize, is_difference: bool) -> EffectSpec {
        let state = &self.problem.model().states()[into];
        let input = |unit: &str| InputSpec {
            unit: unit.to_owned(),
            hold: InputHold::ZeroOrder,
            channel: None,
            min: None,
            may_be_constant: true,
        };
        let (unit, text) = if is_difference {
            ("1/h".to_owned(), format!("{SIZE} * {RATE} * ({FROM} - {})", state.name))
        } else {
            (format!("{}/h", error_unit(&state.unit)), format!("{SIZE} * {RATE}"))
        };
        let names = std::iter::once((RATE, "-")).chain(is_difference.then_some((FROM, "degC")));
        let size = ParameterSpec {
            unit,
            lower: -10.0,
            upper: 10.0,
            scale: Scale::Linear,
            nominal: Nominal::Value(1.0),
            quantity: String::new(),
            title: String::new(),
            excite: None,
        };
        EffectSpec {
            id: TRIED.to_owned(),
            inputs: names.map(|(name, unit)| (name.to_owned(), input(unit))).collect(),
            parameters: [(SIZE.to_owned(), size)].into(),
            terms: [(state.name.clone(), text)].into(),
            ..EffectSpec::default()
        }
    }
}

/// The best ends of the free run from some starts and from others that are drawn.
fn anew_from(problem: &Problem, mut starts: Vec<Vec<f64>>, halt: Halt<'_>) -> Vec<Vec<f64>> {
    let drawn = latin_hypercube(DRAWN, problem.free().len(), SEED);
    starts.extend(drawn.iter().map(|candidate| problem.theta(candidate)));
    let whitening = Whitening::none(&usable(problem, &problem.split().train));
    let task = Refit { problem, whitening: &whitening, deviation: problem.scaled_noise(), halt };
    let (mut ends, _) = task.ends(&starts, ITERATIONS);
    ends.retain(|(_, cost)| cost.is_finite());
    ends.sort_by(|a, b| a.1.total_cmp(&b.1));
    ends.truncate(ENDS);
    ends.into_iter().map(|(theta, _)| theta).collect()
}
