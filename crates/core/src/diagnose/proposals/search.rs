//! Every term of the grammar, scored along segments of hours, and as many times on errors that are shifted by
//! whole days: how well the best of a search does where no channel has anything to do with the error.

use super::response::Responses;
use super::stock::{Stock, StockChannel};
use super::term::{Factor, Form, Memory, Schedule, ScheduleDays, Term, TermSeries, TermSubject};
use crate::diagnose::score_test::Look;
use crate::estimate::Problem;
use crate::estimate::segments::Explained;
use crate::gram::dot;
use crate::model::Initial;
use crate::simulate::trajectory::Halt;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Most shifts; more days are thinned evenly.
const SHIFTS: usize = 40;
/// What thresholds are tried: shares of the values of a channel that lie below, and of its range.
const QUANTILES: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];
const LEVELS: [f64; 4] = [0.1, 0.25, 0.5, 0.75];
/// Above how many of a room's own temperatures something is tried to begin.
const WARM: [f64; 6] = [0.5, 0.6, 0.7, 0.8, 0.9, 0.95];
/// Time constants and delays that are tried, in hours.
const LAGS: [f64; 4] = [1.0, 2.0, 4.0, 8.0];
const DELAYS: [f64; 3] = [0.5, 1.0, 2.0];
/// Lengths of schedules that are tried, in hours.
const LENGTHS: [f64; 9] = [1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0];
/// What acts on fewer days may be anything that happened then.
const LEAST_DAYS: usize = 5;
/// A direction of which less than this share is left beside what the model can do itself is none of its own.
const IMITATED: f64 = 1e-3;

/// What is searched, and beside what it is judged.
pub(super) struct TermSearch<'a> {
    pub stock: &'a Stock,
    look: &'a Look<'a>,
    responses: Responses,
    /// The measured state, from the model where it was not measured, and its place in the model.
    warm: Vec<f64>,
    into: usize,
    halt: Halt<'a>,
}

/// How every term of a search does.
pub(super) struct SearchScores {
    pub terms: Vec<TermScore>,
    /// With how many shifts each was compared.
    pub shifts: usize,
}

/// The errors, each shifted by so many whole days, and the squares of each.
struct ShiftedErrors {
    errors: DMatrix<f64>,
    squares: Vec<f64>,
}

/// How a term does.
#[derive(Debug, Clone)]
pub(super) struct TermScore {
    pub term: Term,
    /// The share of the squared error that it explains.
    pub share: f64,
    /// Its size over its deviation, robust by days.
    pub t: f64,
    /// Days on which it does anything.
    pub days: usize,
    /// The share that it explains of the error with each shift.
    pub shifted: Vec<f64>,
}

impl<'a> TermSearch<'a> {
    /// Prepares a search for what flows into a state that an output shows. `None` where the model leaves the
    /// numbers along its segments.
    pub fn new(
        problem: &Problem,
        stock: &'a Stock,
        look: &'a Look<'a>,
        into: usize,
        halt: Halt<'a>,
    ) -> Option<Self> {
        let responses = Responses::new(problem, look)?;
        let mut warm = responses.state(into, problem.grid().len());
        // What switches by its own warmth does so by the warmth that it has; a model without the term has
        // another one.
        if let Initial::Measured(output) = problem.model().states()[into].initial
            && let Some(column) = problem.grid().column(&problem.model().outputs()[output].channel)
        {
            let measured = warm.iter_mut().zip(column.values()).zip(column.valid());
            measured.filter(|(_, valid)| **valid).for_each(|((warm, measured), _)| *warm = *measured);
        }
        Some(Self { stock, look, responses, warm, into, halt })
    }

    /// What a term does to the outputs, row by row.
    pub fn raw(&self, term: &Term) -> Option<Vec<f64>> {
        let raw = self.responses.of(&self.series(term)?, term.into);
        raw.iter().all(|value| value.is_finite()).then_some(raw)
    }

    /// What a flow from each sample to the next into the measured state does to the outputs.
    pub fn raw_of(&self, flow: Vec<f64>) -> Vec<f64> {
        self.responses.of(&TermSeries { rate: flow, from: None }, self.into)
    }

    /// What is left of what a term does. `None` where it does nothing that the model cannot do itself.
    fn direction(&self, term: &Term) -> Option<(Vec<f64>, f64)> {
        let raw = self.raw(term)?;
        let before = dot(&raw, &raw);
        let direction = self.look.rest(raw);
        let own = dot(&direction, &direction);
        (own > IMITATED * before && own > 0.0).then_some((direction, own))
    }

    /// The share of the squared error that a term explains. `None` where it does nothing that the model
    /// cannot do itself.
    pub fn share(&self, term: &Term) -> Option<f64> {
        let (direction, _) = self.direction(term)?;
        Some(self.look.explained(&direction)?.share)
    }

    /// The days on which a direction does anything.
    pub fn days(&self, direction: &[f64]) -> usize {
        let squares = self.look.by_day(|row| direction[row] * direction[row]);
        let usual = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
        squares.iter().filter(|square| **square > ACTS * usual).count()
    }

    /// Scores a term. `None` as [`TermSearch::share`], and where it acts on too few days.
    fn score(&self, term: &Term, shifted: &ShiftedErrors) -> Option<TermScore> {
        if (self.halt)() {
            return None;
        }
        let (direction, own) = self.direction(term)?;
        let days = self.days(&direction);
        if days < LEAST_DAYS {
            return None;
        }
        let Explained { share, t, .. } = self.look.explained(&direction)?;
        let shifted = if term.is_by_clock() {
            Vec::new()
        } else {
            let projected = shifted.errors.tr_mul(&DVector::from_column_slice(&direction));
            let share = |(projected, squares): (&f64, &f64)| {
                projected * projected / own / squares.max(f64::MIN_POSITIVE)
            };
            projected.iter().zip(&shifted.squares).map(share).collect()
        };
        Some(TermScore { term: *term, share, t, days, shifted })
    }

    /// Scores every term of the grammar.
    pub fn scores(&self) -> SearchScores {
        let shifted = ShiftedErrors::new(self.look, self.stock.per_day);
        let score = |term: &Term| self.score(term, &shifted);
        SearchScores {
            terms: self.terms().par_iter().filter_map(score).collect(),
            shifts: shifted.squares.len(),
        }
    }

    /// Every term of the grammar. What is delayed, lagged or multiplied is so only where it flows into the
    /// measured state.
    pub fn terms(&self) -> Vec<Term> {
        let mut terms = Vec::new();
        let now = |subject, factor| Term { subject, factor, memory: Memory::None, into: self.into };
        let factors: Vec<Factor> = [
            Some(Factor::One),
            self.stock.outdoors.map(|_| Factor::Outdoors),
            self.stock.sun.as_ref().map(|_| Factor::Sun),
        ]
        .into_iter()
        .flatten()
        .collect();
        for (place, channel) in self.stock.channels.iter().enumerate() {
            let of = |form| TermSubject::Channel(place, form);
            let thresholds = thresholds(channel);
            let forms: Vec<Form> = thresholds
                .iter()
                .flat_map(|at| [Form::Above(*at), Form::Below(*at), Form::On(*at)])
                .collect();
            terms.push(now(of(Form::Plain), Factor::One));
            for factor in &factors {
                if !channel.is_warmth && *factor != Factor::One {
                    terms.push(now(of(Form::Plain), *factor));
                }
                terms.extend(forms.iter().map(|form| now(of(*form), *factor)));
            }
            let begins = forms.iter().filter(|form| !matches!(form, Form::Below(_)));
            for form in std::iter::once(&Form::Plain).chain(begins) {
                let memories = LAGS.map(Memory::Lag).into_iter().chain(DELAYS.map(Memory::Delay));
                terms.extend(memories.map(|memory| Term { memory, ..now(of(*form), Factor::One) }));
            }
        }
        if self.stock.sun.is_some() {
            terms.push(now(TermSubject::Sun(Form::Plain), Factor::One));
            let lags = LAGS.map(Memory::Lag).into_iter();
            terms.extend(
                lags.map(|memory| Term { memory, ..now(TermSubject::Sun(Form::Plain), Factor::One) }),
            );
        }
        let known: Vec<f64> = self.warm.iter().copied().filter(|value| value.is_finite()).collect();
        for at in quantiles(&known, &WARM) {
            let driven = factors.iter().filter(|factor| **factor != Factor::One);
            terms.extend(driven.map(|factor| now(TermSubject::Warm(at), *factor)));
        }
        if self.stock.clock.is_some() {
            for days in [ScheduleDays::All, ScheduleDays::Working, ScheduleDays::Weekend] {
                for from in 0..24 {
                    for length in LENGTHS {
                        let to = (f64::from(from) + length) % 24.0;
                        let hours = TermSubject::Hours(Schedule { from: f64::from(from), to, days });
                        terms.extend(self.air().map(|factor| now(hours, factor)));
                    }
                }
            }
        }
        terms
    }

    /// What a schedule drives: a flow of its own, and air that is exchanged.
    pub fn air(&self) -> impl Iterator<Item = Factor> {
        std::iter::once(Factor::One).chain(self.stock.outdoors.map(|_| Factor::Outdoors))
    }

    /// Each two hours of working days; empty where the clock is not known.
    pub fn working_day(&self) -> Vec<TermSeries> {
        let hours = |from: u32| {
            let to = f64::from((from + 2) % 24);
            let schedule = Schedule { from: f64::from(from), to, days: ScheduleDays::Working };
            let subject = TermSubject::Hours(schedule);
            self.series(&Term { subject, factor: Factor::One, memory: Memory::None, into: self.into })
        };
        (0..24).step_by(2).filter_map(hours).collect()
    }

    /// The state into which it looks.
    pub fn into(&self) -> usize {
        self.into
    }

    /// What a term is over time.
    pub fn series(&self, term: &Term) -> Option<TermSeries> {
        term.series(self.stock, &self.warm)
    }
}

/// A day on which a direction has less than this share of its usual squares is one on which it does nothing.
const ACTS: f64 = 0.05;

impl ShiftedErrors {
    /// None where a day is no whole number of samples.
    fn new(look: &Look<'_>, per_day: Option<usize>) -> Self {
        let shifted = per_day.map_or_else(Vec::new, |per_day| shifted(look, per_day));
        let rows = look.residual().len();
        let errors = DMatrix::from_iterator(rows, shifted.len(), shifted.into_iter().flatten());
        Self { squares: errors.column_iter().map(|column| column.norm_squared()).collect(), errors }
    }
}

/// The error with each shift by whole days, without what starts and the model's own parameters make of it.
fn shifted(look: &Look<'_>, per_day: usize) -> Vec<Vec<f64>> {
    let rows: Vec<(usize, usize)> = look.rows().collect();
    let Some(first) = rows.iter().map(|(_, sample)| *sample).min() else { return Vec::new() };
    let last = rows.iter().map(|(_, sample)| *sample).max().unwrap_or(first);
    let days = (last - first + 1).div_ceil(per_day);
    let span = days * per_day;
    let outputs = rows.iter().map(|(output, _)| output + 1).max().unwrap_or(0);
    let mut places = vec![None; outputs * span];
    for (row, (output, sample)) in rows.iter().enumerate() {
        places[output * span + sample - first] = Some(row);
    }
    let residual = look.residual();
    let stride = days.div_ceil(SHIFTS).max(1);
    (1..days)
        .step_by(stride)
        .map(|shift| {
            let moved = |(output, sample): &(usize, usize)| {
                let from = (sample - first + shift * per_day) % span;
                places[output * span + from].map_or(0.0, |row: usize| residual[row])
            };
            look.rest(rows.iter().map(moved).collect())
        })
        .collect()
}

/// Thresholds of a channel that are worth trying.
fn thresholds(channel: &StockChannel) -> Vec<f64> {
    let (low, high) = range(&channel.values);
    let mut at = quantiles(&channel.values, &QUANTILES);
    at.extend(LEVELS.map(|level| low + level * (high - low)));
    at.retain(|at| *at > low + 0.01 * (high - low) && *at < high - 0.01 * (high - low));
    at.sort_by(f64::total_cmp);
    at.dedup_by(|a, b| (*a - *b).abs() < 0.03 * (high - low));
    at
}

/// The lowest and the highest value.
pub(super) fn range(values: &[f64]) -> (f64, f64) {
    let first = (f64::INFINITY, f64::NEG_INFINITY);
    values.iter().fold(first, |(low, high), value| (low.min(*value), high.max(*value)))
}

fn quantiles(values: &[f64], shares: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: &f64| sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).copied();
    shares.iter().filter_map(at).collect()
}
