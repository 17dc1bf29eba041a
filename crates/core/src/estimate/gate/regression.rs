//! The free regression of a room on what was logged of it: which inputs it follows, with which sign and by
//! which clock.
//!
//! A grey-box model searches within bounds, so that a gain of the wrong sign shows as a small one, and a
//! wrong channel bends all other parameters. A linear forecast six hours ahead that knows no physics has no
//! bounds: each input enters by its means over the hours ahead and behind, and whatever is claimed of an
//! input (another clock, another channel in its place) is fitted again at once. Errors are compared in pairs
//! by days.

use crate::data::{CALENDAR, DROPS};
use crate::data::{DAY, HOUR};
use crate::estimate::problem::Problem;
use crate::gram::take_out;
use crate::interrupt::Brake;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Hours ahead.
const AHEAD: i64 = 6;
/// Hours of the past that are looked back at.
const BEHIND: i64 = 24;
/// The hours over whose means an input enters, counted from the origin.
const WINDOWS: [(i64, i64); 4] = [(3, 6), (0, 3), (-6, 0), (-24, -6)];
/// Columns that need no input: a constant, the temperature now and three hours ago, and that of the same hour
/// a day before.
const OWN: usize = 4;
/// Fewest rows for each column.
const ROWS_EACH: usize = 4;
/// Keeps columns that say the same from dividing what they explain by nothing, as a share of their squares.
const RIDGE: f64 = 1e-7;

/// A change of the squared error, compared in pairs by days.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairedComparison {
    /// Mean square error over that of what was logged: below one it is better.
    pub ratio: f64,
    /// How sure that is, as a t over days: positive where it is better.
    pub t: f64,
}

impl PairedComparison {
    /// Sums of squares by days, of what was logged and of a rival.
    pub fn of(logged: &[f64], rival: &[f64]) -> Self {
        let differences: Vec<f64> = logged.iter().zip(rival).map(|(logged, rival)| logged - rival).collect();
        let n = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / n;
        let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        let total = |sums: &[f64]| sums.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        Self { ratio: total(rival) / total(logged), t: mean / (variance / n).sqrt().max(f64::MIN_POSITIVE) }
    }
}

/// A room's temperature six hours ahead, regressed on its own past and on its inputs.
#[derive(Debug, Clone)]
pub struct Regression {
    /// The hour of each row's origin.
    origins: Vec<usize>,
    /// The day of each row's target.
    days: Vec<usize>,
    target: DVector<f64>,
    own: Vec<DVector<f64>>,
    drivers: Vec<Driver>,
    /// Samples of the grid in an hour of the regression.
    per_hour: usize,
    /// Asked before every solution.
    brake: Brake,
}

/// An input as it enters: hourly means over the grid, and its columns.
#[derive(Debug, Clone)]
struct Driver {
    input: usize,
    hourly: Vec<f64>,
    columns: Vec<DVector<f64>>,
}

/// What the regression says of one input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Followed {
    /// What one unit more, for good, does to the room within six hours, over its deviation robust by days.
    pub gain_t: f64,
    /// The regression without the input.
    pub without: PairedComparison,
}

impl Regression {
    /// The regression of the first output of a problem. `None` where the record is too short for its inputs,
    /// or sampled more rarely than every hour.
    pub fn new(problem: &Problem) -> Option<Self> {
        let grid = problem.grid();
        let per_hour = (HOUR / grid.step()) as usize;
        if per_hour == 0 || HOUR % grid.step() != 0 {
            return None;
        }
        let hours = grid.len() / per_hour;
        let (values, valid) = problem.measured()[0];
        let room: Vec<Option<f64>> = (0..hours)
            .map(|hour| {
                let known: Vec<f64> =
                    samples(hour, per_hour).filter(|k| valid[*k]).map(|k| values[k]).collect();
                (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
            })
            .collect();
        // How many hours up to one lack an input.
        let mut lost = vec![0; hours + 1];
        for hour in 0..hours {
            let known = samples(hour, per_hour).all(|k| problem.inputs().known(k) || k + 1 == grid.len());
            lost[hour + 1] = lost[hour] + usize::from(!known);
        }
        let (ahead, behind) = (AHEAD as usize, BEHIND as usize);
        let origins: Vec<usize> = (behind..hours.saturating_sub(ahead))
            .filter(|k| {
                lost[k + ahead + 1] == lost[k + 1 - behind]
                    && [*k, k - 3, k + ahead].iter().all(|hour| room[*hour].is_some())
            })
            .collect();
        let at = |hour: usize| room[hour].unwrap_or(f64::NAN);
        let row = |value: &dyn Fn(usize) -> f64| {
            DVector::from_iterator(origins.len(), origins.iter().map(|k| value(*k)))
        };
        let own = vec![
            row(&|_| 1.0),
            row(&at),
            row(&|k| at(k - 3)),
            row(&|k| room[k + ahead - behind].unwrap_or(at(k))),
        ];
        let day = |k: &usize| ((*k + ahead) as i64 * HOUR / DAY) as usize;
        let mut regression = Self {
            days: origins.iter().map(day).collect(),
            target: row(&|k| at(k + ahead) - at(k)),
            own,
            origins,
            drivers: Vec::new(),
            per_hour,
            brake: problem.brake().clone(),
        };
        let driver = |input: usize| {
            let hourly = regression.hourly(&driving(problem, input, problem.inputs().values(input))?);
            let moves = hourly.iter().any(|value| *value != hourly[0]);
            moves.then(|| Driver { input, columns: regression.columns(&hourly), hourly })
        };
        regression.drivers = (0..problem.model().inputs().len()).filter_map(driver).collect();
        let columns = OWN + WINDOWS.len() * regression.drivers.len();
        (regression.origins.len() >= ROWS_EACH * columns).then_some(regression)
    }

    /// The inputs that the regression has.
    pub fn inputs(&self) -> impl Iterator<Item = usize> {
        self.drivers.iter().map(|driver| driver.input)
    }

    /// An input beside all others.
    pub fn beside(&self, input: usize) -> Option<Beside<'_>> {
        let place = self.drivers.iter().position(|driver| driver.input == input)?;
        let others = self.own.iter().chain(
            self.drivers.iter().enumerate().filter(|(i, _)| *i != place).flat_map(|(_, d)| &d.columns),
        );
        let others = Basis::of(others.cloned().collect());
        let rest = others.without(self.target.clone());
        let logged = self.own_part(&others, &rest, &self.drivers[place].columns)?;
        Some(Beside {
            regression: self,
            driver: &self.drivers[place],
            logged_by_day: self.squares(&logged.rest),
            others,
            rest,
            logged,
        })
    }

    /// The regression with all inputs so many hours later (negative) or earlier, beside that of what was
    /// logged: the clock of the room itself.
    pub fn with_all_shifted<'a>(
        &'a self,
        hours: &'a [i64],
    ) -> impl Iterator<Item = (i64, PairedComparison)> + 'a {
        let error = |shift: i64| {
            self.brake.check();
            let columns = self.drivers.iter().flat_map(|driver| self.columns(&rolled(&driver.hourly, shift)));
            self.squares(
                &Basis::of(self.own.iter().cloned().chain(columns).collect()).without(self.target.clone()),
            )
        };
        let logged = error(0);
        hours.iter().map(move |hours| (*hours, PairedComparison::of(&logged, &error(*hours))))
    }

    /// Forecasts of the first output by a regression on the rows whose target lies in `train`, for the rows
    /// whose origin and target lie in `range`: the samples of the target's hour, with the forecast of their
    /// mean.
    pub fn forecasts(&self, train: &Range<usize>, range: &Range<usize>) -> Vec<(Range<usize>, f64)> {
        let target = |k: usize| samples(k + AHEAD as usize, self.per_hour);
        let learnt: Vec<usize> =
            (0..self.origins.len()).filter(|row| target(self.origins[*row]).end <= train.end).collect();
        let columns: Vec<&DVector<f64>> =
            self.own.iter().chain(self.drivers.iter().flat_map(|driver| &driver.columns)).collect();
        if learnt.len() < ROWS_EACH * columns.len() {
            return Vec::new();
        }
        let x = DMatrix::from_fn(learnt.len(), columns.len(), |i, j| columns[j][learnt[i]]);
        let y = DVector::from_iterator(learnt.len(), learnt.iter().map(|row| self.target[*row]));
        let Some(coefficients) = solve(&x, &y) else { return Vec::new() };
        let judged = (0..self.origins.len()).filter(|row| {
            let origin = self.origins[*row];
            samples(origin, self.per_hour).start >= range.start && target(origin).end <= range.end
        });
        judged
            .map(|row| {
                let forecast: f64 =
                    columns.iter().zip(coefficients.iter()).map(|(column, c)| c * column[row]).sum();
                (target(self.origins[row]), self.own[1][row] + forecast)
            })
            .collect()
    }

    fn own_part(&self, others: &Basis, rest: &DVector<f64>, columns: &[DVector<f64>]) -> Option<Part> {
        self.brake.check();
        let columns: Vec<DVector<f64>> =
            columns.iter().map(|column| others.without(column.clone())).collect();
        let x = DMatrix::from_columns(&columns);
        let coefficients = solve(&x, rest)?;
        Some(Part { rest: rest - &x * &coefficients, coefficients, x })
    }

    fn squares(&self, rest: &DVector<f64>) -> Vec<f64> {
        self.by_day(|row| rest[row] * rest[row])
    }

    fn by_day(&self, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut sums: Vec<(usize, f64)> = Vec::new();
        for (row, day) in self.days.iter().enumerate() {
            match sums.last_mut() {
                Some((known, sum)) if known == day => *sum += value(row),
                _ => sums.push((*day, value(row))),
            }
        }
        sums.into_iter().map(|(_, sum)| sum).collect()
    }

    fn hourly(&self, values: &[f64]) -> Vec<f64> {
        values.chunks_exact(self.per_hour).map(|hour| hour.iter().sum::<f64>() / hour.len() as f64).collect()
    }

    /// The means of a series over the windows of every row. The window that ends at the origin holds its
    /// hour.
    fn columns(&self, hourly: &[f64]) -> Vec<DVector<f64>> {
        let mut sums = vec![0.0; hourly.len() + 1];
        hourly.iter().enumerate().for_each(|(hour, value)| sums[hour + 1] = sums[hour] + value);
        let mean = |k: usize, (from, to): (i64, i64)| {
            let (from, to) =
                ((k as i64 + from + 1) as usize, ((k as i64 + to + 1) as usize).min(hourly.len()));
            (sums[to] - sums[from]) / (to - from) as f64
        };
        WINDOWS
            .iter()
            .map(|window| {
                DVector::from_iterator(self.origins.len(), self.origins.iter().map(|k| mean(*k, *window)))
            })
            .collect()
    }
}

/// One input of a regression beside all others, which have explained what they can.
#[derive(Debug, Clone)]
pub struct Beside<'a> {
    regression: &'a Regression,
    driver: &'a Driver,
    others: Basis,
    rest: DVector<f64>,
    logged: Part,
    logged_by_day: Vec<f64>,
}

impl Beside<'_> {
    /// Whether the room follows the input as it was logged.
    pub fn followed(&self) -> Followed {
        let Part { x, coefficients, rest } = &self.logged;
        // The gain is a sum of coefficients; its influence by rows gives a deviation that is robust by days.
        let ones = DVector::from_element(coefficients.len(), 1.0);
        let direction = ridged(x).cholesky().map(|factor| factor.solve(&ones));
        let influence = direction.map(|direction| x * direction);
        let scores = influence
            .map(|influence| self.regression.by_day(|row| influence[row] * rest[row]))
            .unwrap_or_default();
        let deviation = scores.iter().map(|score| score * score).sum::<f64>().sqrt();
        let gain_t = coefficients.sum() / deviation.max(f64::MIN_POSITIVE);
        let without = PairedComparison::of(&self.logged_by_day, &self.regression.squares(&self.rest));
        Followed { gain_t, without }
    }

    /// The regression with the input so many hours earlier: its value `hours` later takes the place of each.
    /// Circular, so that its distribution stays.
    pub fn shifted(&self, hours: i64) -> Option<PairedComparison> {
        self.with(&rolled(&self.driver.hourly, hours))
    }

    /// The regression with another input of it in the place of this one, which is left out.
    pub fn exchanged(&self, other: usize) -> Option<PairedComparison> {
        self.with(&self.regression.drivers.iter().find(|driver| driver.input == other)?.hourly)
    }

    /// The share of shifts by whole days, over the whole record, with which the input explains as much as it
    /// was logged: (1 + those) / (1 + all). Its daily rhythm stays, and what is claimed is broken.
    pub fn shift_p(&self) -> f64 {
        let days = self.driver.hourly.len() as i64 * HOUR / DAY;
        let as_good = (1..days)
            .filter(|day| self.shifted(day * DAY / HOUR).is_some_and(|compared| compared.ratio <= 1.0))
            .count();
        (1 + as_good) as f64 / days.max(1) as f64
    }

    fn with(&self, hourly: &[f64]) -> Option<PairedComparison> {
        let part = self.regression.own_part(&self.others, &self.rest, &self.regression.columns(hourly))?;
        Some(PairedComparison::of(&self.logged_by_day, &self.regression.squares(&part.rest)))
    }
}

/// What an input's own columns explain of what the others have left.
#[derive(Debug, Clone)]
struct Part {
    x: DMatrix<f64>,
    coefficients: DVector<f64>,
    rest: DVector<f64>,
}

/// An orthonormal basis of some columns.
#[derive(Debug, Clone)]
struct Basis(Vec<Vec<f64>>);

impl Basis {
    fn of(columns: Vec<DVector<f64>>) -> Self {
        let scaled: Vec<DVector<f64>> = columns
            .into_iter()
            .filter_map(|column| {
                let norm = column.norm();
                (norm > 0.0).then(|| column / norm)
            })
            .collect();
        let basis = DMatrix::from_columns(&scaled).qr().q();
        Self(basis.column_iter().map(|column| column.iter().copied().collect()).collect())
    }

    fn without(&self, mut series: DVector<f64>) -> DVector<f64> {
        take_out(&self.0, series.as_mut_slice());
        series
    }
}

/// The squares of some columns, with a ridge.
fn ridged(x: &DMatrix<f64>) -> DMatrix<f64> {
    let mut normal = x.tr_mul(x);
    for i in 0..normal.nrows() {
        normal[(i, i)] += RIDGE * normal[(i, i)] + f64::MIN_POSITIVE;
    }
    normal
}

fn solve(x: &DMatrix<f64>, y: &DVector<f64>) -> Option<DVector<f64>> {
    let solution = ridged(x).cholesky()?.solve(&x.tr_mul(y));
    solution.iter().all(|value| value.is_finite()).then_some(solution)
}

fn samples(hour: usize, per_hour: usize) -> Range<usize> {
    hour * per_hour..(hour + 1) * per_hour
}

/// A series whose value at each hour is that of `hours` later, circularly.
fn rolled(series: &[f64], hours: i64) -> Vec<f64> {
    let n = series.len() as i64;
    (0..n).map(|hour| series[(hour + hours).rem_euclid(n) as usize]).collect()
}

/// Whether an input says something that the clock and the room itself do not.
pub fn drives(problem: &Problem, input: usize) -> bool {
    driving(problem, input, problem.inputs().values(input)).is_some()
}

/// What drives a room where an input is `values`: itself, but for the sun, which warms with the sine of its
/// height, and clouds, which take that away (Kasten and Czeplak). `None` for what follows the clock or the
/// room itself.
fn driving(problem: &Problem, input: usize, values: &[f64]) -> Option<Vec<f64>> {
    let inputs = problem.model().inputs();
    let channel = inputs[input].channel.as_str();
    if CALENDAR.contains(&channel)
        || channel == DROPS
        || channel == "sun_azimuth"
        || channel == "wind_direction"
    {
        return None;
    }
    let height = |degrees: f64| degrees.to_radians().sin().max(0.0);
    match channel {
        "sun_altitude" => Some(values.iter().map(|degrees| height(*degrees)).collect()),
        "cloud_cover" => {
            let sun =
                problem.inputs().values(inputs.iter().position(|input| input.channel == "sun_altitude")?);
            Some(
                values
                    .iter()
                    .zip(sun)
                    .map(|(cloud, sun)| -height(*sun) * cloud.clamp(0.0, 1.0).powf(3.4))
                    .collect(),
            )
        }
        _ => Some(values.to_vec()),
    }
}
