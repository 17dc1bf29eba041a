//! What days teach of the parameters: the Fisher information of a model along segments of hours, and how far
//! the estimates really err under the noise of these days.
//!
//! ```text
//! record --settle--> Jacobian and residual, day by day --> normal matrix N, scores of the days M
//! days to come ----------------------------------------> N + N', M + M'      covariance N^-1 M N^-1
//! ```
//!
//! The estimates are least squares over segments that start from states of their own; what their starts can
//! explain is projected out of everything. Their residual is no white noise: what nobody logged lasts for
//! hours. Days hardly lean on each other, so the noise of each past day is laid on the Jacobian of every day,
//! of those to come as well: with `s = J' r`, the middle matrix of a day is the mean of `s s'` over the past
//! days. That is the sandwich of generalised estimating equations with one covariance for all clusters (Pan
//! 2001, Biometrika 88, 901-906), and it knows how loud the noise is and how long it lasts without a model of
//! it. Each residual is first what it would be had its own day not been fitted (the jackknife of clusters;
//! Bell and McCaffrey 2002, Survey Methodology 28, 169-181).

use crate::estimate::Problem;
use crate::estimate::segments::shooting::settle;
use crate::estimate::segments::{Linear, REACH, Segments, dot};
use crate::fault::Fault;
use crate::model::Scale;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Length of the segments in hours: as far ahead as rooms are controlled, and a whole part of a day.
pub const SEGMENT_HOURS: f64 = 12.0;
/// Fewest past days whose noise says anything of the days to come.
pub const FEWEST_DAYS: usize = 5;
/// Half the width of a 95 % interval, in standard deviations.
pub const HALF_WIDTH: f64 = 1.959_963_984_540_054;

/// Whole days of a grid, the last one of which ends with it.
#[derive(Debug, Clone)]
pub(super) struct WholeDays {
    pub samples: Range<usize>,
    pub per_day: usize,
}

impl WholeDays {
    /// Those of a problem from a sample on.
    ///
    /// # Errors
    /// A fault where its step is no part of a day.
    pub fn of(problem: &Problem, from: usize) -> Result<Self, Fault> {
        let grid = problem.grid();
        let per_day = (24.0 / grid.step_hours()).round() as usize;
        if per_day < 2 || (per_day as f64 * grid.step_hours() - 24.0).abs() > 1e-9 {
            let detail = "the step of the fit is no part of a day, so its days cannot be laid on each other";
            return Err(Fault::new("/system", "step", detail));
        }
        let end = grid.len() - 1;
        let start = end - (end - from.min(end)) / per_day * per_day;
        Ok(Self { samples: start..end, per_day })
    }

    fn count(&self) -> usize {
        self.samples.len() / self.per_day
    }

    /// A series of rows by days: a column each, the values of every output from the day's first sample on;
    /// zero where nothing was measured.
    fn by_day(&self, rows: &[(usize, usize)], outputs: usize, series: &[f64]) -> DMatrix<f64> {
        let mut days = DMatrix::zeros(outputs * self.per_day, self.count());
        for ((output, sample), value) in rows.iter().zip(series) {
            let since = sample - self.samples.start;
            days[(output * self.per_day + since % self.per_day, since / self.per_day)] = *value;
        }
        days
    }
}

/// The Jacobian of some days: of each one a row for every output and sample, and a column per parameter.
struct DailyJacobian(Vec<DMatrix<f64>>);

impl DailyJacobian {
    fn new(days: &WholeDays, rows: &[(usize, usize)], outputs: usize, columns: &[Vec<f64>]) -> Self {
        let by_parameter: Vec<DMatrix<f64>> =
            columns.iter().map(|column| days.by_day(rows, outputs, column)).collect();
        let of = |day: usize| {
            DMatrix::from_fn(outputs * days.per_day, columns.len(), |row, i| by_parameter[i][(row, day)])
        };
        Self((0..days.count()).map(of).collect())
    }
}

/// What is known of the parameters from the days of a record, and the noise of these days.
#[derive(Debug, Clone)]
pub struct Knowledge {
    /// The full parameter vector: the least squares of the segments.
    pub theta: Vec<f64>,
    /// The estimated parameters, by their places in the full vector.
    pub along: Vec<usize>,
    /// The unit in which each is reckoned here, in its own unit.
    pub units: Vec<f64>,
    /// Whether that is a fixed share of its own unit, whatever the scale of the search.
    own_unit: Vec<bool>,
    normal: DMatrix<f64>,
    middle: DMatrix<f64>,
    /// The residual of each past day, had it not been fitted; a column each.
    noise: DMatrix<f64>,
}

impl Knowledge {
    /// What the whole days of a problem teach. Parameters are reckoned on the scale of the search, and those
    /// that are `asked` about in their own unit, so that one of an effect may as well be nothing.
    ///
    /// # Errors
    /// Where there are too few days, the model has no filter or leaves the numbers, or one day is all that
    /// determines a parameter.
    pub fn of(problem: &Problem, theta: &[f64], asked: &[usize]) -> Result<Self, Fault> {
        let cannot = |why: &str| Fault::new("/system", "no-experiment", why);
        let days = WholeDays::of(problem, 0)?;
        if days.count() < FEWEST_DAYS {
            let detail = format!("{FEWEST_DAYS} whole days are needed to know the noise; there are fewer");
            return Err(cannot(&detail));
        }
        let segments = Segments::new(problem, days.samples.clone(), SEGMENT_HOURS)
            .ok_or_else(|| cannot("a model without a filter has no segments"))?;
        let numbers = || cannot("the model leaves the numbers");
        let starts = segments.starts(problem, theta);
        let settled = settle(problem, &segments, theta, &starts, &|| false).ok_or_else(numbers)?;
        // Once more from the starts that belong to these parameters.
        let linear = segments
            .linearise(problem, problem.simulator(), &settled.theta, &settled.linear.starts)
            .ok_or_else(numbers)?;
        let is_log = |place: &usize| problem.model().parameters()[*place].scale == Scale::Log;
        let own_unit: Vec<bool> =
            linear.along.iter().map(|place| is_log(place) && asked.contains(place)).collect();
        let unit = |((place, slope), own): ((&usize, &f64), &bool)| {
            let [lower, upper] = problem.bounds()[*place];
            if *own { upper - lower } else { *slope }
        };
        let units: Vec<f64> = linear.along.iter().zip(&linear.slopes).zip(&own_unit).map(unit).collect();
        let rows: Vec<(usize, usize)> = segments.rows().collect();
        let outputs = problem.model().outputs().len();
        let residual = days.by_day(&rows, outputs, &linear.residual);
        let shown = days.by_day(&rows, outputs, &vec![1.0; rows.len()]);
        let jacobian = DailyJacobian::new(&days, &rows, outputs, &in_units(&linear, &units));
        let variance = dot(&linear.residual, &linear.residual) / rows.len().max(1) as f64;
        let mut found = Self {
            theta: settled.theta,
            normal: DMatrix::identity(units.len(), units.len()) * (variance / REACH.powi(2)),
            // How far the estimates may be held back by what keeps them within reach.
            middle: DMatrix::identity(units.len(), units.len()) * (variance / REACH).powi(2),
            along: linear.along,
            units,
            own_unit,
            noise: DMatrix::zeros(0, 0),
        };
        jacobian.0.iter().for_each(|day| found.normal += day.tr_mul(day));
        found.noise = found
            .unfitted(residual, &shown, &jacobian)
            .ok_or_else(|| cannot("one day is all that determines a parameter"))?;
        found.add_middle(&jacobian);
        Ok(found)
    }

    /// The residuals as they would be had their own day not been fitted, on the footing of complete days.
    fn unfitted(
        &self,
        mut residual: DMatrix<f64>,
        shown: &DMatrix<f64>,
        jacobian: &DailyJacobian,
    ) -> Option<DMatrix<f64>> {
        let days = residual.ncols();
        for (day, rows) in jacobian.0.iter().enumerate() {
            let others = (&self.normal - rows.tr_mul(rows)).cholesky()?;
            let step = others.solve(&rows.tr_mul(&residual.column(day)));
            let moved = rows * step;
            residual.column_mut(day).axpy(1.0, &moved, 1.0);
        }
        for row in 0..residual.nrows() {
            let seen = shown.row(row).sum().max(1.0);
            residual.row_mut(row).scale_mut(((days as f64 - 1.0) / seen).sqrt());
        }
        Some(residual / (days as f64).sqrt())
    }

    /// The noise of every past day on each of these days.
    fn add_middle(&mut self, jacobian: &DailyJacobian) {
        for day in &jacobian.0 {
            let scores = day.tr_mul(&self.noise);
            self.middle += &scores * scores.transpose();
        }
    }

    /// What is known when days to come have been added: a problem that has them behind so many samples of
    /// past, a parameter vector, and the states there at each sample. `None` where the model leaves the
    /// numbers.
    pub(super) fn with(
        &self,
        problem: &Problem,
        theta: &[f64],
        past: usize,
        states: &[Vec<f64>],
    ) -> Option<Self> {
        let days = WholeDays::of(problem, past).ok()?;
        let segments = Segments::new(problem, days.samples.clone(), SEGMENT_HOURS)?;
        let starts: Vec<Vec<f64>> = segments
            .first_samples()
            .map(|k| states.get(k - past).cloned())
            .collect::<Option<_>>()?;
        let linear = segments.linearise(problem, problem.simulator(), theta, &starts)?;
        let rows: Vec<(usize, usize)> = segments.rows().collect();
        let outputs = problem.model().outputs().len();
        let jacobian = DailyJacobian::new(&days, &rows, outputs, &in_units(&linear, &self.units));
        let mut found = self.clone();
        jacobian.0.iter().for_each(|day| found.normal += day.tr_mul(day));
        found.add_middle(&jacobian);
        Some(found)
    }

    /// How the estimates err together, in [`Self::units`]: `N^-1 M N^-1`.
    ///
    /// # Errors
    /// A fault where nothing determines a parameter.
    pub fn covariance(&self) -> Result<DMatrix<f64>, Fault> {
        let inverse = self.inverse()?;
        Ok(&inverse * &self.middle * inverse.transpose())
    }

    fn inverse(&self) -> Result<DMatrix<f64>, Fault> {
        self.normal.clone().cholesky().map(|factor| factor.inverse()).ok_or_else(|| {
            Fault::new("/system", "no-experiment", "the data do not determine the parameters")
        })
    }

    /// The place of a parameter among the estimated ones.
    pub(super) fn place(&self, parameter: usize) -> Option<usize> {
        self.along.iter().position(|along| *along == parameter)
    }

    /// The size of an estimate in its own unit, were the other one nothing: what the data ask for if this one
    /// alone is there.
    ///
    /// # Errors
    /// As [`Self::covariance`].
    pub(super) fn alone(&self, place: usize, other: usize) -> Result<f64, Fault> {
        let inverse = self.inverse()?;
        let moved = inverse[(place, other)] / inverse[(other, other)] * self.theta[self.along[other]]
            / self.units[other];
        Ok(self.theta[self.along[place]] - moved * self.units[place])
    }

    /// A parameter vector so many deviations away along each axis of the covariance, within the bounds.
    pub(super) fn drawn(&self, problem: &Problem, root: &DMatrix<f64>, normal: &DVector<f64>) -> Vec<f64> {
        let moved = root * normal;
        let mut theta = self.theta.clone();
        let dimensions = problem.space().dimensions();
        for (place, parameter) in self.along.iter().enumerate() {
            let [lower, upper] = problem.bounds()[*parameter];
            let free = problem.free().iter().position(|free| free == parameter);
            let Some(dimension) = free.and_then(|free| dimensions.get(free)) else { continue };
            let value = theta[*parameter];
            let moved = moved[place] * self.units[place];
            theta[*parameter] = if self.own_unit[place] {
                (value + moved).clamp(lower, upper)
            } else {
                // Along the scale of the search, so that a positive value stays one.
                dimension.value((dimension.unit(value) + moved / dimension.slope(value)).clamp(0.0, 1.0))
            };
        }
        theta
    }
}

/// The Jacobian, a column per parameter in these units.
fn in_units(linear: &Linear, units: &[f64]) -> Vec<Vec<f64>> {
    let columns = linear.columns.iter().zip(&linear.slopes).zip(units);
    columns
        .map(|((column, slope), unit)| column.iter().map(|value| value * unit / slope).collect())
        .collect()
}
