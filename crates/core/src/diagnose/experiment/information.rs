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
//! 2001, Biometrika 88, 901-906). Each residual is first made as large as it was before its own day was
//! fitted ("CR2", Bell and McCaffrey 2002, Survey Methodology 28, 169-181). Noise that lasts is taken for
//! parameters more easily: all of it is scaled until a fit would leave of it what is left.

use super::whole_days::WholeDays;
use crate::estimate::Problem;
use crate::estimate::decompose::symmetric;
use crate::estimate::segments::shooting::settle;
use crate::estimate::segments::{Linear, REACH, Segments};
use crate::estimate::uncertainty::covariance::WIDTH as HALF_WIDTH;
use crate::fault::Fault;
use crate::gram::dot;
use crate::interrupt::Brake;
use crate::model::Scale;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::{BTreeMap, BTreeSet};

/// Length of the segments in hours: a day, so that its noise meets the same starts on every day, and slow
/// states are held together.
const SEGMENT_HOURS: f64 = 24.0;
/// The unit of widths that are shares of the estimate.
pub(super) const PERCENT: &str = "%";
/// A draw whose squares grow by more than this over the linear model's is taken nearer, so often at most.
const ERRS_MORE: f64 = 2.0;
const HALVINGS: usize = 6;
/// Noise is taken to be so many times as loud at most (as a variance) as its residual says.
const LOUDEST: f64 = 4.0;
/// A direction of a day's residual that the fit has taken up to more than this share tells nothing more.
const MOST_FITTED: f64 = 0.99;
/// Fewest past days whose noise says anything of the days to come.
pub const FEWEST_DAYS: usize = 5;

/// The segments of whole days.
struct DailySegments {
    segments: Segments,
    /// Of each of their rows, where it stands in its day, and which of the measured days that is.
    places: Vec<(usize, usize)>,
    /// Rows of a day: every output and sample.
    per_day: usize,
    /// How many days something was measured on.
    measured: usize,
}

impl DailySegments {
    /// `None` of a model without a filter, and where nothing was measured.
    fn new(problem: &Problem, days: WholeDays) -> Option<Self> {
        let segments = Segments::new(problem, days.samples.clone(), SEGMENT_HOURS)?;
        let since = |sample: usize| sample - days.samples.start;
        let measured: BTreeSet<usize> =
            segments.rows().map(|(_, sample)| since(sample) / days.per_day).collect();
        let columns: BTreeMap<usize, usize> = measured.iter().copied().zip(0..).collect();
        let place = |(output, sample): (usize, usize)| {
            let (day, hour) = (since(sample) / days.per_day, since(sample) % days.per_day);
            (output * days.per_day + hour, columns[&day])
        };
        let places = segments.rows().map(place).collect();
        let per_day = problem.model().outputs().len() * days.per_day;
        (!segments.is_empty()).then_some(Self { segments, places, per_day, measured: columns.len() })
    }

    fn linear(&self, problem: &Problem, theta: &[f64], starts: &[Vec<f64>]) -> Option<Linear> {
        self.segments.linearise(problem, problem.simulator(), theta, starts)
    }

    /// The Jacobian of each measured day: a row for every output and sample, and a column per parameter.
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
        (0..self.measured).map(of).collect()
    }

    /// A series of rows by measured days: a column each, the values of every output from the day's first
    /// sample on; zero where nothing was measured.
    fn by_day(&self, series: &[f64]) -> DMatrix<f64> {
        let mut days = DMatrix::zeros(self.per_day, self.measured);
        for (place, value) in self.places.iter().zip(series) {
            days[*place] = *value;
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
    /// The variance of the residual, as if it were white, and the sum of its squares.
    variance: f64,
    squares: f64,
    normal: DMatrix<f64>,
    middle: DMatrix<f64>,
    /// The noise of each past day over the root of their number; a column each.
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
        let record = DailySegments::new(problem, WholeDays::of(problem, 0)?).ok_or_else(|| {
            cannot("a model without a filter, or a record without measurements, has no segments")
        })?;
        if record.measured < FEWEST_DAYS {
            let detail = format!("{FEWEST_DAYS} measured days are needed to know the noise; there are fewer");
            return Err(cannot(&detail));
        }
        let brake = problem.brake();
        let halt = || {
            brake.check();
            false
        };
        let numbers = || cannot("the model leaves the numbers");
        let starts = record.segments.starts(problem, theta);
        let settled = settle(problem, &record.segments, theta, &starts, &halt).ok_or_else(numbers)?;
        // Once more from the starts that belong to these parameters.
        let linear = record.linear(problem, &settled.theta, &settled.linear.starts).ok_or_else(numbers)?;
        let span = |place: &usize| {
            let [lower, upper] = problem.bounds()[*place];
            let is_log = problem.model().parameters()[*place].scale == Scale::Log;
            (is_log && may_be_nothing.contains(place)).then_some(upper - lower)
        };
        let spans: Vec<Option<f64>> = linear.along.iter().map(span).collect();
        let units = spans.iter().zip(&linear.slopes).map(|(span, slope)| span.unwrap_or(*slope)).collect();
        let squares = dot(&linear.residual, &linear.residual);
        let jacobian = record.jacobian(&linear, &spans);
        let mut found = Self {
            theta: settled.theta,
            along: linear.along,
            units,
            spans,
            starts: linear.starts,
            variance: squares / record.places.len().max(1) as f64,
            squares,
            normal: DMatrix::zeros(0, 0),
            middle: DMatrix::zeros(0, 0),
            noise: DMatrix::zeros(0, 0),
        };
        (found.normal, found.middle) = found.within_reach();
        found.add_normal(&jacobian);
        let shown = record.by_day(&vec![1.0; record.places.len()]);
        found.noise = found
            .noise_behind(record.by_day(&linear.residual), &shown, &jacobian, brake)
            .ok_or_else(|| cannot("the data do not determine the parameters"))?;
        found.add_middle(&jacobian);
        Ok(found)
    }

    /// What the record would teach, were these the parameters; the noise stays as it is. `None` where the
    /// model leaves the numbers.
    pub fn at(&self, problem: &Problem, theta: &[f64]) -> Option<Self> {
        let record = DailySegments::new(problem, WholeDays::of(problem, 0).ok()?)?;
        // First where the segments start with these parameters.
        let starts = record.linear(problem, theta, &self.starts)?.starts;
        let linear = record.linear(problem, theta, &starts)?;
        let (normal, middle) = self.within_reach();
        let squares = dot(&linear.residual, &linear.residual);
        let mut found = Self { theta: theta.to_vec(), starts, squares, normal, middle, ..self.clone() };
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

    /// The noise of which a fit leaves these residuals, on the footing of complete days.
    fn noise_behind(
        &self,
        mut residual: DMatrix<f64>,
        shown: &DMatrix<f64>,
        jacobian: &[DMatrix<f64>],
        brake: &Brake,
    ) -> Option<DMatrix<f64>> {
        let inverse = self.inverse().ok()?;
        let mut unfitted = self.unfitted(residual.clone(), jacobian)?;
        for row in 0..residual.nrows() {
            let share = shown.row(row).sum().max(1.0).sqrt().recip();
            residual.row_mut(row).scale_mut(share);
            unfitted.row_mut(row).scale_mut(share);
        }
        let scores: Vec<DMatrix<f64>> = jacobian.iter().map(|day| day.tr_mul(&unfitted)).collect();
        let n = inverse.nrows();
        let mut middle = DMatrix::<f64>::zeros(n, n);
        scores.iter().for_each(|scores| middle += scores * scores.transpose());
        // What a fit to such noise would leave in the residuals of each day, on every day's Jacobian: that of
        // e_d - J_d N^-1 sum of J' e, and that of the residuals there are.
        let (mut expected, mut seen) = (DMatrix::<f64>::zeros(n, n), DMatrix::<f64>::zeros(n, n));
        let around = &inverse * &middle * &inverse;
        for (rows, on) in jacobian.iter().zip(&scores) {
            brake.check();
            let here = rows.tr_mul(&residual);
            seen += &here * here.transpose();
            expected += on * on.transpose();
            for (fitted, own) in jacobian.iter().zip(&scores) {
                let both = rows.tr_mul(fitted);
                let taken = &both * &inverse * own * on.transpose();
                let changed = &both * &around * both.transpose() - &taken - taken.transpose();
                expected += changed / jacobian.len() as f64;
            }
        }
        let apparent = |middle: DMatrix<f64>| (&inverse * middle * &inverse).diagonal();
        let (expected, seen) = (apparent(expected), apparent(seen));
        let ratios =
            seen.iter().zip(&expected).map(|(seen, expected)| seen / expected.max(f64::MIN_POSITIVE));
        let louder = (ratios.sum::<f64>() / n as f64).clamp(1.0, LOUDEST);
        Some(unfitted * louder.sqrt())
    }

    /// The residuals as large as they were before their own days were fitted: `(I - H)^(-1/2) r` with the hat
    /// matrix `H = J N^-1 J'` of a day.
    fn unfitted(&self, mut residual: DMatrix<f64>, jacobian: &[DMatrix<f64>]) -> Option<DMatrix<f64>> {
        let factor = self.normal.clone().cholesky()?;
        for (day, rows) in jacobian.iter().enumerate() {
            // H = A A', and its eigenvalues are those of A' A, which is small.
            let a = factor.l().solve_lower_triangular(&rows.transpose())?.transpose();
            let found = symmetric(a.tr_mul(&a))?;
            let grown = found.eigenvalues.map(|value| match value.clamp(0.0, MOST_FITTED) {
                value if value > 1e-12 => ((1.0 - value).sqrt().recip() - 1.0) / value,
                _ => 0.5,
            });
            let along = found.eigenvectors.tr_mul(&a.tr_mul(&residual.column(day)));
            let moved = a * (found.eigenvectors * along.component_mul(&grown));
            residual.column_mut(day).axpy(1.0, &moved, 1.0);
        }
        Some(residual)
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
        self.normal
            .clone()
            .cholesky()
            .map(|factor| factor.inverse())
            .ok_or_else(|| Fault::new("/system", "no-experiment", "the data do not determine the parameters"))
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

    /// What the record would teach at a draw of the parameters: so many deviations away along each column of
    /// a root of the covariance. Where the model errs much more there than the linear one says, the draw is
    /// taken half as far away. `None` where the model leaves the numbers all the way.
    pub(super) fn drawn(
        &self,
        problem: &Problem,
        root: &DMatrix<f64>,
        normal: &DVector<f64>,
    ) -> Option<Self> {
        let mut moved = root * normal;
        for _ in 0..HALVINGS {
            let expected = (&self.normal * &moved).dot(&moved);
            let there = self.at(problem, &self.moved(problem, &moved));
            if let Some(there) = there.filter(|there| there.squares - self.squares <= ERRS_MORE * expected) {
                return Some(there);
            }
            moved *= 0.5;
        }
        None
    }

    /// The parameter vector that lies this far away, within the bounds.
    fn moved(&self, problem: &Problem, moved: &DVector<f64>) -> Vec<f64> {
        let mut theta = self.theta.clone();
        let dimensions = problem.space().dimensions();
        for (place, parameter) in self.along.iter().enumerate() {
            let [lower, upper] = problem.bounds()[*parameter];
            let free = problem.free().iter().position(|free| free == parameter);
            let Some(dimension) = free.and_then(|free| dimensions.get(free)) else { continue };
            let (value, moved) = (theta[*parameter], moved[place] * self.units[place]);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::lshade::normal;
    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    const DAYS: usize = 14;
    const ROWS: usize = 24;
    const PARAMETERS: usize = 4;

    /// Slow shapes, so that noise that lasts matters.
    fn jacobian(dice: &mut Xoshiro256PlusPlus, days: usize) -> Vec<DMatrix<f64>> {
        let day = |_| {
            let shapes: Vec<(f64, f64)> = (0..PARAMETERS).map(|_| (normal(dice), normal(dice))).collect();
            DMatrix::from_fn(ROWS, PARAMETERS, |row, i| {
                let (level, swing) = shapes[i];
                level + swing * (row as f64 / ROWS as f64 * std::f64::consts::TAU * (i + 1) as f64).sin()
            })
        };
        (0..days).map(day).collect()
    }

    fn noise(dice: &mut Xoshiro256PlusPlus, days: usize) -> DMatrix<f64> {
        let mut noise = DMatrix::zeros(ROWS, days);
        for day in 0..days {
            let mut value = normal(dice) / (1.0f64 - 0.81).sqrt();
            for row in 0..ROWS {
                noise[(row, day)] = value;
                value = 0.9 * value + normal(dice);
            }
        }
        noise
    }

    /// Least squares on days of noise, whose truth is nothing: the estimate and what is known.
    fn fitted(jacobian: &[DMatrix<f64>], noise: &DMatrix<f64>) -> (DVector<f64>, Knowledge) {
        let n = PARAMETERS;
        let mut known = Knowledge {
            theta: vec![0.0; n],
            along: (0..n).collect(),
            units: vec![1.0; n],
            spans: vec![None; n],
            starts: Vec::new(),
            variance: 0.0,
            squares: 0.0,
            normal: DMatrix::zeros(n, n),
            middle: DMatrix::zeros(n, n),
            noise: DMatrix::zeros(0, 0),
        };
        known.add_normal(jacobian);
        let mut right = DVector::zeros(n);
        jacobian.iter().enumerate().for_each(|(day, rows)| right += rows.tr_mul(&noise.column(day)));
        let estimate = known.normal.clone().cholesky().unwrap().solve(&right);
        let mut residual = noise.clone();
        for (day, rows) in jacobian.iter().enumerate() {
            let fit = rows * &estimate;
            residual.column_mut(day).axpy(-1.0, &fit, 1.0);
        }
        let shown = DMatrix::from_element(ROWS, noise.ncols(), 1.0);
        known.noise = known.noise_behind(residual, &shown, jacobian, &Brake::NONE).unwrap();
        known.add_middle(jacobian);
        (estimate, known)
    }

    #[test]
    fn intervals_hold_the_truth_and_promises_come_true_under_noise_that_lasts() {
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(11);
        let all = jacobian(&mut dice, DAYS + 2);
        let (mut held, mut promised, mut found) = (0, 0.0, 0.0);
        let runs = 300;
        for _ in 0..runs {
            let noise = noise(&mut dice, DAYS + 2);
            let (estimate, known) = fitted(&all[..DAYS], &noise.columns(0, DAYS).clone_owned());
            let half = known.half_width() * known.covariance().unwrap().map_diagonal(|v| v.sqrt());
            held += (0..PARAMETERS).filter(|i| estimate[*i].abs() <= half[*i]).count();
            // What is expected of two more days, and how far the estimates with them really err.
            let mut after = known;
            after.add_normal(&all[DAYS..]);
            after.add_middle(&all[DAYS..]);
            promised += after.covariance().unwrap().trace();
            found += fitted(&all, &noise).0.norm_squared();
        }
        let share = held as f64 / (runs * PARAMETERS) as f64;
        assert!((0.91..=0.98).contains(&share), "{share}");
        assert!((0.8..1.25).contains(&(promised / found)), "{}", promised / found);
    }

    #[test]
    fn a_day_that_alone_determines_a_parameter_does_not_make_the_noise_loud() {
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(4);
        let mut all = jacobian(&mut dice, DAYS);
        // Only the first day moves the last parameter, and strongly.
        all.iter_mut().skip(1).for_each(|day| day.column_mut(PARAMETERS - 1).fill(0.0));
        let noise = noise(&mut dice, DAYS);
        let (_, known) = fitted(&all, &noise);
        let loudness = known.noise.norm_squared() / noise.norm_squared() * DAYS as f64;
        assert!((0.7..1.3).contains(&loudness), "{loudness}");
    }
}
