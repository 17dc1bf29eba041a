//! The generalised likelihood ratio of a change: every parameter on every day, by sums over days.
//!
//! What all parameters do from the beginning on is a nuisance, and is projected out: a fit that is wrong
//! throughout is no change. The sums that this takes are kept by days, so that any stretch of a record, such
//! as the window of a night, costs no more than adding them up.

use super::whitened::Whitened;
use crate::gram::{dot, gram};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;
use std::ops::Range;

/// So many days lie before a change at least, and behind it.
const BEFORE_DAYS: usize = 10;
const BEHIND_DAYS: usize = 2;
/// What the nuisances leave of a direction, at least, as a share of its squares.
const LEFT: f64 = 1e-4;

/// A parameter that changes on a day, and what the record says of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ScannedStep {
    /// The parameter, by its place among those that may change.
    pub place: usize,
    /// The day of the record with whose beginning it changes.
    pub day: usize,
    /// How much by, in what it is counted in, and the deviation of that.
    pub size: f64,
    pub deviation: f64,
    /// How far it was from where the model was linearised before.
    pub before: f64,
}

impl ScannedStep {
    /// The size in its deviations.
    pub fn z(&self) -> f64 {
        self.size / self.deviation
    }
}

/// Inner products over a day of what parameters do throughout, with each other and with the innovations.
struct Throughout {
    gram: DMatrix<f64>,
    with: DVector<f64>,
}

/// The same over a day of one that changes.
struct Changing {
    beside: DVector<f64>,
    with: f64,
    square: f64,
}

/// The sums of a record.
pub(super) struct Scan {
    reaches: Vec<f64>,
    throughout: Vec<Throughout>,
    /// For every day and place, the days from that one on.
    changing: Vec<Vec<Vec<Changing>>>,
}

impl Scan {
    /// Sums up a record of which no stretch of more than `longest` days will be looked at.
    pub fn new(record: &Whitened, longest: usize) -> Self {
        let (days, places) = (record.days(), record.parameters.len());
        let whole = record.directions(0..days);
        let rows = |day: usize| record.rows(day..day + 1);
        let throughout = |day: usize| {
            let rows = rows(day);
            let mut series: Vec<&[f64]> = whole.iter().map(|series| &series[rows.clone()]).collect();
            series.push(&record.innovations[rows]);
            let products = gram(&series);
            let product = |i: usize, j: usize| products[i * series.len() + j];
            Throughout {
                gram: DMatrix::from_fn(places, places, product),
                with: DVector::from_fn(places, |i, _| product(i, places)),
            }
        };
        let changing = |stretch: Range<usize>, series: &[f64]| -> Vec<Changing> {
            let first = record.rows(stretch.clone()).start;
            let of_day = |day: usize| {
                let rows = rows(day);
                let own = &series[rows.start - first..rows.end - first];
                Changing {
                    beside: DVector::from_fn(places, |i, _| dot(&whole[i][rows.clone()], own)),
                    with: dot(&record.innovations[rows.clone()], own),
                    square: dot(own, own),
                }
            };
            stretch.map(of_day).collect()
        };
        Self {
            reaches: record.reaches.clone(),
            throughout: (0..days).map(throughout).collect(),
            changing: (0..days)
                .into_par_iter()
                .map(|day| {
                    let stretch = day..(day + longest).min(days);
                    let series = record.directions(stretch.clone());
                    series.iter().map(|series| changing(stretch.clone(), series)).collect()
                })
                .collect(),
        }
    }

    /// How far each parameter is from where the model was linearised, by all days: beside the step that is
    /// told best, if any is of `threshold` deviations.
    pub fn apart(&self, threshold: f64) -> Option<DVector<f64>> {
        let known = Known::of(self, 0..self.throughout.len())?;
        let steps = self.steps(0..self.throughout.len(), threshold);
        let best = steps.iter().max_by(|one, other| one.z().abs().total_cmp(&other.z().abs()));
        match best.filter(|step| step.z().abs() >= threshold) {
            Some(step) => known.beside(self, step.place, step.day).map(|beside| beside.apart),
            None => Some(known.apart),
        }
    }

    /// Every parameter that may have changed on every day of a stretch of days, and could be told within it:
    /// a change as large as its reach would be of `threshold` deviations.
    pub fn steps(&self, days: Range<usize>, threshold: f64) -> Vec<ScannedStep> {
        let Some(known) = Known::of(self, days.clone()) else { return Vec::new() };
        let last = days.end.saturating_sub(BEHIND_DAYS);
        (days.start + BEFORE_DAYS..=last)
            .filter(|day| *day < days.end)
            .flat_map(|day| (0..self.reaches.len()).map(move |place| (day, place)))
            .filter_map(|(day, place)| known.step(self, place, day))
            .filter(|step| step.deviation * threshold <= self.reaches[step.place])
            .collect()
    }
}

/// What is known of a stretch of days whatever changes.
struct Known {
    days: Range<usize>,
    normal: Cholesky<f64, Dyn>,
    /// How far the parameters are from where the model was linearised, where none changes.
    apart: DVector<f64>,
    /// For each parameter, what takes all others from what it does throughout.
    alone: Vec<DVector<f64>>,
}

/// A change by its size, what is left of its squares, and how far the parameters are apart beside it.
struct Beside {
    size: f64,
    left: f64,
    apart: DVector<f64>,
}

impl Known {
    fn of(scan: &Scan, days: Range<usize>) -> Option<Self> {
        let places = scan.reaches.len();
        let mut normal = DMatrix::from_diagonal(&DVector::from_fn(places, |i, _| scan.reaches[i].powi(-2)));
        let mut with = DVector::zeros(places);
        for day in scan.throughout.get(days.clone())? {
            normal += &day.gram;
            with += &day.with;
        }
        let normal = normal.cholesky()?;
        let inverse = normal.inverse();
        let alone = (0..places).map(|i| inverse.column(i) / inverse[(i, i)]).collect();
        Some(Self { days, apart: normal.solve(&with), normal, alone })
    }

    /// What the stretch says of the size of a parameter's change on a day, and of all parameters beside it.
    fn beside(&self, scan: &Scan, place: usize, day: usize) -> Option<Beside> {
        let changing = &scan.changing[day][place][..self.days.end - day];
        let mut beside = DVector::zeros(scan.reaches.len());
        let (mut with, mut square) = (0.0, 0.0);
        for of_day in changing {
            beside += &of_day.beside;
            with += of_day.with;
            square += of_day.square;
        }
        let taken = self.normal.solve(&beside);
        let left = square - beside.dot(&taken);
        if left <= LEFT * square || left <= f64::MIN_POSITIVE {
            return None;
        }
        let size = (with - beside.dot(&self.apart)) / left;
        Some(Beside { size, left, apart: &self.apart - size * &taken })
    }

    /// A step with its deviation.
    fn step(&self, scan: &Scan, place: usize, day: usize) -> Option<ScannedStep> {
        let Beside { size, left, apart } = self.beside(scan, place, day)?;
        let changing = &scan.changing[day][place];
        // Innovations should be of deviation one, and no two lean on each other. How far they are from that,
        // in the direction of this parameter, its scores by days say, of all days and without the change.
        let alone = &self.alone[place];
        let (mut squares, mut expected) = (0.0, 0.0);
        for (at, throughout) in self.days.clone().zip(&scan.throughout[self.days.clone()]) {
            let mut score = alone.dot(&(&throughout.with - &throughout.gram * &apart));
            if at >= day {
                score -= size * alone.dot(&changing[at - day].beside);
            }
            squares += score * score;
            expected += alone.dot(&(&throughout.gram * alone));
        }
        let wider = (squares / expected).max(1.0);
        let deviation = (wider / left).sqrt();
        (size.is_finite() && deviation.is_finite()).then_some(ScannedStep {
            place,
            day,
            size,
            deviation,
            before: apart[place],
        })
    }
}
