//! The segment test: how much of what a model errs by over hours a candidate effect explains.
//!
//! ```text
//! null model --settle, for each length--> Look --score--> SegmentScore      the direction of a candidate beside the residual
//!                                           |
//!                                           +--surrogates--> p       its channels shifted by whole days
//! ```
//!
//! Segments of hours start from states of their own, which are projected out of the residual, of the model's
//! own Jacobian and of the direction that one linearised run gives to a candidate (`estimate/segments`). It
//! is Rao's score test with days as the independent units: minutes are blurred by sensors, and a free run of
//! weeks drowns in what nobody logged. What goes with the clock is told apart by a free profile of the day,
//! and what a logged channel drives by its own shifts (`surrogates`).

use super::library::{CandidateEffect, sign_allows};
use super::screen::difference;
use crate::data::{hour_of_day, is_computed};
use crate::estimate::Problem;
use crate::estimate::segments::shooting::settle;
use crate::estimate::segments::{Explained, Linear, REACH, Segments};
use crate::gram::dot;
use crate::simulate::Simulator;
use crate::simulate::trajectory::Halt;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::ops::Range;

/// Lengths of the segments, in hours: effects differ in pace.
pub const LENGTHS: [f64; 4] = [2.0, 6.0, 12.0, 24.0];
/// The length at which candidates are ranked and told apart, in hours: between the minutes that sensors blur
/// and the days in which all that was not logged adds up.
pub const RANKING_HOURS: f64 = 12.0;
/// The free profile of a day is held to what the hours can do together, as a share of their mean square.
const PROFILE: f64 = 1e-3;
/// What is left of a direction, as a share of its squares, below which the model's own parameters can do the
/// same.
const IMITATED: f64 = 1e-4;

/// A null model along segments of one length.
pub struct Look<'a> {
    base: &'a Problem,
    /// Hours of a segment.
    pub hours: f64,
    segments: Segments,
    theta: Vec<f64>,
    linear: Linear,
    /// The model's own parameters.
    model: Known,
    /// The same and a free profile of the day.
    clock: Known,
    /// The model's own parameters on each of two halves of the samples, of which the other one is unseen.
    halves: [Known; 2],
}

/// What a candidate explains of the residual of one length of segments.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentScore {
    /// Changes of the candidate's own parameters from where it does nothing.
    pub size: Vec<f64>,
    /// The share of the squared residual that it explains.
    pub share: f64,
    /// The size of the whole effect over its deviation, robust by days; negative where physics does not allow
    /// the sign.
    pub t: f64,
    /// The same beyond a free profile of the day.
    pub beyond_clock: f64,
    /// The share of the squared residual of each half that it explains with the size from the other half.
    pub confirmed: f64,
    /// Days with measurements.
    pub days: usize,
    /// What the candidate adds, row by row, without starts and parameters.
    pub direction: Vec<f64>,
}

impl<'a> Look<'a> {
    /// Settles the null model on segments of some samples, from its free run; `None` where it leaves the
    /// numbers, there are too few, or `halt` ends it.
    pub fn new(
        base: &'a Problem,
        theta: &[f64],
        samples: Range<usize>,
        hours: f64,
        halt: Halt,
    ) -> Option<Self> {
        let segments = Segments::new(base, samples.clone(), hours)?;
        if segments.is_empty() || halt() {
            return None;
        }
        let settled = settle(base, &segments, theta, &segments.starts(base, theta), halt)?;
        Self::at(base, samples, hours, &settled.theta, settled.linear.starts)
    }

    /// A model on segments of some samples with these parameters and the states at the segments' starts that
    /// belong to them. `None` as [`Look::new`].
    pub(super) fn at(
        base: &'a Problem,
        samples: Range<usize>,
        hours: f64,
        theta: &[f64],
        starts: Vec<Vec<f64>>,
    ) -> Option<Self> {
        let segments = Segments::new(base, samples.clone(), hours)?;
        let mut linear = segments.linearise(base, base.simulator(), theta, &starts)?;
        linear.starts = starts;
        let grid = base.grid();
        let profile = segments.by_clock(&linear, grid.step_hours(), |k| hour_of_day(grid, k));
        let pull = dot(&linear.residual, &linear.residual) / linear.residual.len() as f64 / REACH.powi(2);
        let squares = profile.iter().map(|column| dot(column, column)).sum::<f64>() / profile.len() as f64;
        let own: Vec<(Vec<f64>, f64)> = linear.columns.iter().map(|column| (column.clone(), pull)).collect();
        let both = own
            .iter()
            .cloned()
            .chain(profile.into_iter().map(|column| (column, PROFILE * squares)))
            .collect();
        let first = segments.before((samples.start + samples.end) / 2);
        let second = first.iter().map(|first| !first).collect();
        let halves =
            [Known::new(own.clone(), Some(first), &linear)?, Known::new(own.clone(), Some(second), &linear)?];
        let (model, clock) = (Known::new(own, None, &linear)?, Known::new(both, None, &linear)?);
        Some(Self { base, hours, segments, theta: theta.to_vec(), linear, model, clock, halves })
    }

    /// What is left of the change that a candidate makes at these parameters of its own, and of the residual,
    /// when all that the segments' starts and the model's own parameters can do is taken from both: the axes
    /// of an added-variable plot (Cook and Weisberg 1982), by sample of an output. `None` where a segment
    /// leaves the numbers, or the candidate has states of its own.
    pub fn added(
        &self,
        candidate: &CandidateEffect,
        with: &[f64],
        output: usize,
    ) -> Option<Vec<(usize, f64, f64)>> {
        let problem = &candidate.problem;
        if problem.model().states().len() != self.base.model().states().len() {
            return None;
        }
        let off = candidate.lift(self.base, &self.theta);
        let mut on = off.clone();
        candidate.own.iter().for_each(|(index, _)| on[*index] = with[*index]);
        let outputs = self.segments.outputs(problem, problem.simulator(), &[&off, &on], &self.linear.starts);
        let change = outputs[1].iter().zip(&outputs[0]).map(|(on, off)| on - off).collect();
        let change = self.model.rest(&self.segments.without_starts(&self.linear, change));
        let rows = self.segments.rows().zip(change.into_iter().zip(&self.model.residual));
        let points: Vec<(usize, f64, f64)> = rows
            .filter(|((of, _), _)| *of == output)
            .map(|((_, sample), (change, left))| (sample, change, *left))
            .collect();
        points.iter().all(|(_, x, y)| x.is_finite() && y.is_finite()).then_some(points)
    }

    /// Scores a candidate that has no states of its own, with the inputs of its problem or those of another
    /// simulator. `None` where it leaves the numbers, where the model's own parameters imitate it, or where
    /// the days are too few.
    pub fn score(&self, candidate: &CandidateEffect, simulator: &Simulator) -> Option<SegmentScore> {
        let problem = &candidate.problem;
        if problem.model().states().len() != self.base.model().states().len() {
            return None;
        }
        let off = candidate.lift(self.base, &self.theta);
        let steps: Vec<f64> = candidate.own.iter().map(|(index, _)| difference(candidate, *index)).collect();
        let moved: Vec<Vec<f64>> = candidate
            .own
            .iter()
            .zip(&steps)
            .map(|((index, _), step)| {
                let mut moved = off.clone();
                moved[*index] += step;
                moved
            })
            .collect();
        let thetas: Vec<&[f64]> = std::iter::once(&off).chain(&moved).map(Vec::as_slice).collect();
        let outputs = self.segments.outputs(problem, simulator, &thetas, &self.linear.starts);
        let change = |(moved, step): (&Vec<f64>, &f64)| {
            moved.iter().zip(&outputs[0]).map(|(moved, off)| (moved - off) / step).collect()
        };
        let raw: Vec<Vec<f64>> = outputs[1..].iter().zip(&steps).map(change).collect();
        if raw.iter().flatten().any(|value| !value.is_finite()) {
            return None;
        }
        self.score_changes(raw, &|value| sign_allows(candidate.spec.sign, value))
    }

    /// Scores what the outputs change by, row by row, for each unit of some parameters whose values are
    /// allowed or not. `None` where the model's own parameters imitate it, or where the days are too few.
    pub(super) fn score_changes(
        &self,
        raw: Vec<Vec<f64>>,
        allows: &dyn Fn(f64) -> bool,
    ) -> Option<SegmentScore> {
        let own: Vec<Vec<f64>> =
            raw.into_iter().map(|column| self.segments.without_starts(&self.linear, column)).collect();
        let signed = |size: &[f64], t: f64| {
            if size.iter().any(|value| *value != 0.0 && allows(*value)) { t } else { -t }
        };

        let directions = self.model.all(&own);
        if !directions
            .iter()
            .zip(&own)
            .any(|(direction, raw)| dot(direction, direction) > IMITATED * dot(raw, raw))
        {
            return None;
        }
        let (size, direction) = regress(&self.model.residual, &directions, allows, None)?;
        let explained = self.segments.explained(&self.model.residual, &direction)?;
        let beyond = regress(&self.clock.residual, &self.clock.all(&own), allows, None).and_then(
            |(size, direction)| {
                Some(signed(&size, self.segments.explained(&self.clock.residual, &direction)?.t))
            },
        );
        let (mut without, mut with) = (0.0, 0.0);
        for half in &self.halves {
            let (_, direction) = regress(&half.residual, &half.all(&own), allows, half.rows.as_deref())?;
            let unseen = half.rows.iter().flatten().enumerate().filter(|(_, learnt)| !**learnt);
            for (row, _) in unseen {
                without += half.residual[row].powi(2);
                with += (half.residual[row] - direction[row]).powi(2);
            }
        }
        Some(SegmentScore {
            share: explained.share,
            t: signed(&size, explained.t),
            beyond_clock: beyond.unwrap_or(0.0),
            confirmed: 1.0 - with / without.max(f64::MIN_POSITIVE),
            days: self.segments.by_day(|_| 0.0).len(),
            size,
            direction,
        })
    }
}

/// What the search for terms that no catalogue has asks of it.
impl Look<'_> {
    /// The parameters of the settled model.
    pub(super) fn theta(&self) -> &[f64] {
        &self.theta
    }

    /// Samples, rows and the states at the start of every segment.
    pub(super) fn pieces(&self) -> impl Iterator<Item = (Range<usize>, Range<usize>, &[f64])> {
        let starts = self.linear.starts.iter().map(Vec::as_slice);
        self.segments.pieces().zip(starts).map(|((piece, rows), start)| (piece, rows, start))
    }

    /// The output and the sample of every row.
    pub(super) fn rows(&self) -> impl Iterator<Item = (usize, usize)> {
        self.segments.rows()
    }

    /// What starts and the model's own parameters leave of the error.
    pub(super) fn residual(&self) -> &[f64] {
        &self.model.residual
    }

    /// The error along the segments, without what starts make of it.
    pub(super) fn left(&self) -> &[f64] {
        &self.linear.residual
    }

    /// The states at the segments' starts.
    pub(super) fn starts(&self) -> &[Vec<f64>] {
        &self.linear.starts
    }

    /// What a direction explains of that.
    pub(super) fn explained(&self, direction: &[f64]) -> Option<Explained> {
        self.segments.explained(&self.model.residual, direction)
    }

    /// What they leave of a series.
    pub(super) fn rest(&self, series: Vec<f64>) -> Vec<f64> {
        self.model.rest(&self.segments.without_starts(&self.linear, series))
    }

    /// The share of the squared error that a free profile of the day explains.
    pub(super) fn share_of_clock(&self) -> f64 {
        let squares = |series: &[f64]| dot(series, series);
        1.0 - squares(&self.clock.residual) / squares(&self.model.residual).max(f64::MIN_POSITIVE)
    }

    /// Sums by the days that have rows.
    pub(super) fn by_day(&self, product: impl Fn(usize) -> f64) -> Vec<f64> {
        self.segments.by_day(product)
    }
}

/// Columns that are known to be there, each pulled towards nothing, learnt on all rows or on some.
struct Known {
    columns: Vec<Vec<f64>>,
    factor: Option<Cholesky<f64, Dyn>>,
    rows: Option<Vec<bool>>,
    /// What they leave of the residual.
    residual: Vec<f64>,
}

impl Known {
    /// `None` where the columns are no numbers.
    fn new(columns: Vec<(Vec<f64>, f64)>, rows: Option<Vec<bool>>, linear: &Linear) -> Option<Self> {
        let n = columns.len();
        let (columns, pulls): (Vec<Vec<f64>>, Vec<f64>) = columns.into_iter().unzip();
        let mut known = Self { columns, factor: None, rows, residual: Vec::new() };
        if n > 0 {
            let rows = known.rows.as_deref();
            let mut normal = DMatrix::from_fn(n, n, |i, j| {
                if j <= i { over(rows, &known.columns[i], &known.columns[j]) } else { 0.0 }
            });
            normal.fill_upper_triangle_with_lower_triangle();
            (0..n).for_each(|i| normal[(i, i)] += pulls[i] + 1e-12 * (1.0 + normal[(i, i)]));
            known.factor = Some(normal.cholesky()?);
        }
        known.residual = known.rest(&linear.residual);
        Some(known)
    }

    /// What the columns leave of a series.
    fn rest(&self, series: &[f64]) -> Vec<f64> {
        let mut rest = series.to_vec();
        if let Some(factor) = &self.factor {
            let rows = self.rows.as_deref();
            let right = DVector::from_iterator(
                self.columns.len(),
                self.columns.iter().map(|column| over(rows, column, series)),
            );
            for (column, size) in self.columns.iter().zip(factor.solve(&right).iter()) {
                rest.iter_mut().zip(column).for_each(|(rest, value)| *rest -= size * value);
            }
        }
        rest
    }

    /// What they leave of several.
    fn all(&self, series: &[Vec<f64>]) -> Vec<Vec<f64>> {
        series.iter().map(|series| self.rest(series)).collect()
    }
}

/// The inner product of two series over some rows.
fn over(rows: Option<&[bool]>, a: &[f64], b: &[f64]) -> f64 {
    match rows {
        None => dot(a, b),
        Some(rows) => a.iter().zip(b).zip(rows).filter(|(_, row)| **row).map(|((a, b), _)| a * b).sum(),
    }
}

/// The sizes of some directions in a residual, and what they add up to. Of several those whose sign physics
/// does not allow are left out, the largest first; the last one stays whatever its sign, but not where unseen
/// rows are to be explained with it.
fn regress(
    residual: &[f64],
    directions: &[Vec<f64>],
    allows: &dyn Fn(f64) -> bool,
    rows: Option<&[bool]>,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let mut active: Vec<usize> =
        (0..directions.len()).filter(|i| over(rows, &directions[*i], &directions[*i]) > 0.0).collect();
    loop {
        let n = active.len();
        if n == 0 {
            return None;
        }
        let mut normal =
            DMatrix::from_fn(n, n, |i, j| over(rows, &directions[active[i]], &directions[active[j]]));
        let ridge = 1e-9 * normal.trace();
        (0..n).for_each(|i| normal[(i, i)] += ridge);
        let squares = normal.diagonal();
        let size = normal
            .cholesky()?
            .solve(&DVector::from_fn(n, |i, _| over(rows, &directions[active[i]], residual)));
        let refused = (0..n).filter(|i| !allows(size[*i]));
        let worst = refused
            .max_by(|i, j| (size[*i].powi(2) * squares[*i]).total_cmp(&(size[*j].powi(2) * squares[*j])));
        let (mut sizes, mut sum) = (vec![0.0; directions.len()], vec![0.0; residual.len()]);
        match worst {
            Some(worst) if n > 1 => {
                active.remove(worst);
            }
            Some(_) if rows.is_some() => return Some((sizes, sum)),
            _ => {
                for (i, place) in active.iter().enumerate() {
                    sizes[*place] = size[i];
                    sum.iter_mut().zip(&directions[*place]).for_each(|(sum, value)| *sum += size[i] * value);
                }
                return Some((sizes, sum));
            }
        }
    }
}

/// The inputs of a candidate that were logged, that the model does not use, and that do not follow from the
/// room or the clock.
pub fn logged(candidate: &CandidateEffect, base: &Problem) -> Vec<usize> {
    let known = |channel: &str| base.model().inputs().iter().any(|input| input.channel == channel);
    let inputs = candidate.problem.model().inputs().iter().enumerate();
    inputs
        .filter(|(_, input)| !known(&input.channel) && !is_computed(&input.channel))
        .map(|(place, _)| place)
        .collect()
}
