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
use crate::estimate::uncertainty::covariance::WIDTH as HALF_WIDTH;
use crate::model::Scale;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::ops::Range;

/// Length of the segments in hours: as far ahead as rooms are controlled, and a whole part of a day.
pub const SEGMENT_HOURS: f64 = 12.0;
/// The unit of widths that are shares of the estimate.
pub(super) const PERCENT: &str = "%";
/// Fewest past days whose noise says anything of the days to come.
pub const FEWEST_DAYS: usize = 5;

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
}

/// The segments of whole days, and the output and sample of each of their rows.
struct DailySegments {
    days: WholeDays,
    segments: Segments,
    rows: Vec<(usize, usize)>,
    outputs: usize,
}

impl DailySegments {
    /// `None` of a model without a filter, and where nothing was measured.
    fn new(problem: &Problem, days: WholeDays) -> Option<Self> {
        let segments = Segments::new(problem, days.samples.clone(), SEGMENT_HOURS)?;
        let rows = segments.rows().collect();
        let outputs = problem.model().outputs().len();
        (!segments.is_empty()).then_some(Self { days, segments, rows, outputs })
    }

    fn linear(&self, problem: &Problem, theta: &[f64], starts: &[Vec<f64>]) -> Option<Linear> {
        self.segments.linearise(problem, problem.simulator(), theta, starts)
    }

    /// The Jacobian of each day: a row for every output and sample, and a column per parameter.
    fn jacobian(&self, linear: &Linear, spans: &[Option<f64>]) -> Vec<DMatrix<f64>> {
        let by_parameter: Vec<DMatrix<f64>> = linear
            .columns
            .iter()
            .zip(spans.iter().zip(&linear.slopes))
            .map(|(column, (span, slope))| self.by_day(column) * span.map_or(1.0, |span| span / slope))
            .collect();
        let of = |day: usize| {
            let column = |parameter: &DMatrix<f64>| parameter.column(day).clone_owned();
            DMatrix::from_columns(&by_parameter.iter().map(column).collect::<Vec<_>>())
        };
        (0..self.days.count()).map(of).collect()
    }

    /// A series of rows by days: a column each, the values of every output from the day's first sample on;
    /// zero where nothing was measured.
    fn by_day(&self, series: &[f64]) -> DMatrix<f64> {
        let per_day = self.days.per_day;
        let mut days = DMatrix::zeros(self.outputs * per_day, self.days.count());
        for ((output, sample), value) in self.rows.iter().zip(series) {
            let since = sample - self.days.samples.start;
            days[(output * per_day + since % per_day, since / per_day)] = *value;
        }
        days
    }
}

/// What is known of the parameters from the days of a record, and the noise of these days.
#[derive(Debug, Clone)]
pub struct Knowledge {
    /// The full parameter vector: the least squares of the segments.
    pub theta: Vec<f64>,
    /// The estimated parameters, by their places in the full vector.
    pub along: Vec<usize>,
    /// What the unit in which each is reckoned here is in its own unit.
    pub units: Vec<f64>,
    /// That unit, of those that are reckoned in their own and not on the scale of the search.
    spans: Vec<Option<f64>>,
    /// Where the segments of the record start.
    starts: Vec<Vec<f64>>,
    /// The variance of the residual, as if it were white.
    variance: f64,
    normal: DMatrix<f64>,
    middle: DMatrix<f64>,
    /// The residual of each past day, had it not been fitted; a column each.
    noise: DMatrix<f64>,
}

impl Knowledge {
    /// What the whole days of a problem teach. Parameters are reckoned on the scale of the search, and those
    /// that `may_be_nothing` in their own unit.
    ///
    /// # Errors
    /// Where there are too few days, the model has no filter or leaves the numbers, or one day is all that
    /// determines a parameter.
    pub fn of(problem: &Problem, theta: &[f64], may_be_nothing: &[usize]) -> Result<Self, Fault> {
        let cannot = |why: &str| Fault::new("/system", "no-experiment", why);
        let days = WholeDays::of(problem, 0)?;
        if days.count() < FEWEST_DAYS {
            let detail = format!("{FEWEST_DAYS} whole days are needed to know the noise; there are fewer");
            return Err(cannot(&detail));
        }
        let record = DailySegments::new(problem, days)
            .ok_or_else(|| cannot("a model without a filter, or a record without measurements, has no segments"))?;
        let numbers = || cannot("the model leaves the numbers");
        let starts = record.segments.starts(problem, theta);
        let settled = settle(problem, &record.segments, theta, &starts, &|| false).ok_or_else(numbers)?;
        // Once more from the starts that belong to these parameters.
        let linear = record.linear(problem, &settled.theta, &settled.linear.starts).ok_or_else(numbers)?;
        let span = |place: &usize| {
            let [lower, upper] = problem.bounds()[*place];
            let is_log = problem.model().parameters()[*place].scale == Scale::Log;
            (is_log && may_be_nothing.contains(place)).then_some(upper - lower)
        };
        let spans: Vec<Option<f64>> = linear.along.iter().map(span).collect();
        let units = spans.iter().zip(&linear.slopes).map(|(span, slope)| span.unwrap_or(*slope)).collect();
        let variance = dot(&linear.residual, &linear.residual) / record.rows.len().max(1) as f64;
        let jacobian = record.jacobian(&linear, &spans);
        let mut found = Self {
            theta: settled.theta,
            along: linear.along,
            units,
            spans,
            starts: linear.starts,
            variance,
            normal: DMatrix::zeros(0, 0),
            middle: DMatrix::zeros(0, 0),
            noise: DMatrix::zeros(0, 0),
        };
        (found.normal, found.middle) = found.within_reach();
        found.add_normal(&jacobian);
        let shown = record.by_day(&vec![1.0; record.rows.len()]);
        found.noise = found
            .unfitted(record.by_day(&linear.residual), &shown, &jacobian)
            .ok_or_else(|| cannot("one day is all that determines a parameter"))?;
        found.add_middle(&jacobian);
        Ok(found)
    }

    /// What the record would teach, were these the parameters; the noise stays as it is. `None` where the
    /// model leaves the numbers.
    pub(super) fn at(&self, problem: &Problem, theta: &[f64]) -> Option<Self> {
        let record = DailySegments::new(problem, WholeDays::of(problem, 0).ok()?)?;
        // First where the segments start with these parameters.
        let starts = record.linear(problem, theta, &self.starts)?.starts;
        let linear = record.linear(problem, theta, &starts)?;
        let (normal, middle) = self.within_reach();
        let mut found = Self { theta: theta.to_vec(), starts, normal, middle, ..self.clone() };
        let jacobian = record.jacobian(&linear, &self.spans);
        found.add_normal(&jacobian);
        found.add_middle(&jacobian);
        Some(found)
    }

    /// What keeps the estimates within reach, and how far that may hold them back.
    fn within_reach(&self) -> (DMatrix<f64>, DMatrix<f64>) {
        let identity = DMatrix::identity(self.along.len(), self.along.len());
        (&identity * (self.variance / REACH.powi(2)), identity * (self.variance / REACH).powi(2))
    }

    /// The residuals as they would be had their own day not been fitted, on the footing of complete days.
    fn unfitted(
        &self,
        mut residual: DMatrix<f64>,
        shown: &DMatrix<f64>,
        jacobian: &[DMatrix<f64>],
    ) -> Option<DMatrix<f64>> {
        let days = residual.ncols();
        for (day, rows) in jacobian.iter().enumerate() {
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

    fn add_normal(&mut self, jacobian: &[DMatrix<f64>]) {
        jacobian.iter().for_each(|day| self.normal += day.tr_mul(day));
    }

    /// The noise of every past day on each of these days.
    fn add_middle(&mut self, jacobian: &[DMatrix<f64>]) {
        for day in jacobian {
            let scores = day.tr_mul(&self.noise);
            self.middle += &scores * scores.transpose();
        }
    }

    /// What is known when days to come have been added: a problem that has them behind so many samples of
    /// past, and the states there at each sample. `None` where the model leaves the numbers.
    pub(super) fn with(&self, problem: &Problem, past: usize, states: &[Vec<f64>]) -> Option<Self> {
        let to_come = DailySegments::new(problem, WholeDays::of(problem, past).ok()?)?;
        let firsts = to_come.segments.first_samples();
        let starts: Vec<Vec<f64>> = firsts.map(|k| states.get(k - past).cloned()).collect::<Option<_>>()?;
        let linear = to_come.linear(problem, &self.theta, &starts)?;
        let jacobian = to_come.jacobian(&linear, &self.spans);
        let mut found = self.clone();
        found.add_normal(&jacobian);
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

    /// Half the width of a 95 % interval in deviations, which so many days tell no better (Student's t).
    pub fn half_width(&self) -> f64 {
        let freedom = self.noise.ncols() as f64 - 1.0;
        StudentsT::new(0.0, 1.0, freedom).map_or(HALF_WIDTH, |t| t.inverse_cdf(0.975))
    }

    /// The width of an interval of a parameter from the deviation of its estimate in [`Self::units`], and its
    /// unit: the parameter's own, or per cent of the estimate where it is searched on a logarithmic scale.
    pub fn width<'a>(&self, problem: &'a Problem, place: usize, deviation: f64) -> (f64, &'a str) {
        let parameter = &problem.model().parameters()[self.along[place]];
        let width = 2.0 * self.half_width() * deviation * self.units[place];
        match (parameter.scale, self.spans[place]) {
            (Scale::Log, None) => (100.0 * width / self.theta[self.along[place]], PERCENT),
            _ => (width, &parameter.unit),
        }
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
            theta[*parameter] = if self.spans[place].is_some() {
                (value + moved).clamp(lower, upper)
            } else {
                // Along the scale of the search, so that a positive value stays one.
                dimension.value((dimension.unit(value) + moved / dimension.slope(value)).clamp(0.0, 1.0))
            };
        }
        theta
    }
}
