//! A model at its optima, and what is measured there.
//!
//! Every model is fitted twice: the plain free run, whose error users see, and its innovations, whose
//! likelihood decides (generalised least squares with one autoregressive model for all models of a round).

use super::effort::Effort;
use super::refit::{Refit, polish_together};
use super::residual::{Autoregression, Whitening, at, residuals, slow_bic, usable};
use crate::estimate::Problem;
use crate::estimate::problem::mean_square;
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;
use std::ops::Range;

/// Another optimum is one whose plain cost is larger by this factor, but not by that: without its missing
/// effect a model may err least where it is no room any more, and from there the effect is never found.
const OTHER: [f64; 2] = [1.02, 16.0];

/// From several starts a search goes this part of its iterations before the best of them goes on alone.
const FIRST_PART: usize = 5;

/// The free run's squared error, over that of the null model, above which a candidate has shown nothing.
const LEAST_PROMISE: f64 = 0.97;

/// Full parameter vectors at the two optima, with their costs.
#[derive(Debug, Clone, PartialEq)]
pub struct Optima {
    /// Least squares of the free run.
    pub plain: Vec<f64>,
    /// Its cost.
    pub plain_cost: f64,
    /// Least squares of the innovations.
    pub white: Vec<f64>,
    /// Its cost.
    pub white_cost: f64,
    /// Simulations that the two have taken.
    pub evaluations: usize,
}

/// What is measured at the two optima.
#[derive(Debug, Clone, PartialEq)]
pub struct OptimaMeasures {
    /// BIC of the AR likelihood of the residual at the innovations' optimum, AR re-estimated; the model's own
    /// parameters are not counted. Whatever is measured is in the unit of the output, or, of several outputs,
    /// in the noise of their sensors.
    pub bic: f64,
    /// Samples of the likelihood.
    pub samples: usize,
    /// The same criterion of the three-hourly means of the residual at the free run's optimum, and their
    /// number.
    pub slow: Option<(f64, usize)>,
    /// Innovation deviation of the free-run residual at its own optimum.
    pub floor: f64,
    /// Mean square of the free run: training, validation, test.
    pub plain: [Option<f64>; 3],
    /// Sum of squares of the free run of every day: training, validation.
    pub days: [Vec<f64>; 2],
    /// Mean square of the innovations over the validation part, at the innovations' optimum.
    pub white_validation: Option<f64>,
}

/// The filters of a round, the same for every model in it.
#[derive(Debug, Clone)]
pub struct Filters {
    /// The training part as it is.
    pub plain: Whitening,
    /// Its innovations.
    pub white: Whitening,
    /// The innovations of the validation part.
    pub validation: Whitening,
    /// Deviation of the plain residual.
    pub plain_deviation: f64,
    /// Deviation of the innovations.
    pub white_deviation: f64,
}

/// A model without the effects that are tried on it.
#[derive(Debug, Clone)]
pub struct NullModel {
    /// The model on its data.
    pub problem: Problem,
    /// Where it ends.
    pub fitted: Optima,
    /// What is measured there.
    pub measured: OptimaMeasures,
    /// The filters that it gives to the round.
    pub filters: Filters,
    /// Another optimum, if the way from the nominal values has ended in one: of the plain residual, of the
    /// innovations.
    pub other: Option<[Vec<f64>; 2]>,
}

impl Filters {
    fn new(problem: &Problem, ar: &Autoregression, plain_deviation: f64) -> Self {
        let (train, validation) =
            (usable(problem, &problem.split().train), usable(problem, &problem.split().validation));
        Self {
            plain: Whitening::none(&train),
            white: Whitening::ar(ar, &train),
            validation: Whitening::ar(ar, &validation),
            plain_deviation,
            white_deviation: ar.deviation_filtered(),
        }
    }

    /// The two tasks of a problem.
    pub fn tasks<'a>(&'a self, problem: &'a Problem, halt: Halt<'a>) -> [Refit<'a>; 2] {
        [
            Refit { problem, whitening: &self.plain, deviation: self.plain_deviation, halt },
            Refit { problem, whitening: &self.white, deviation: self.white_deviation, halt },
        ]
    }

    /// Both optima, each the best from its starts: all of them go a part of the way, and the best goes on.
    pub fn fit(&self, problem: &Problem, starts: [&[Vec<f64>]; 2], iterations: usize, halt: Halt) -> Optima {
        self.go_on(problem, self.begin(problem, starts, iterations, halt), iterations, halt)
    }

    /// The first part of the way, from all starts.
    pub fn begin(
        &self,
        problem: &Problem,
        [plain, white]: [&[Vec<f64>]; 2],
        iterations: usize,
        halt: Halt,
    ) -> Optima {
        let [plain_task, white_task] = self.tasks(problem, halt);
        let first = iterations.div_ceil(FIRST_PART);
        let [(white, white_cost, of_white), (plain, plain_cost, of_plain)] =
            polish_together([(&white_task, white), (&plain_task, plain)], first);
        Optima { plain, plain_cost, white, white_cost, evaluations: of_white + of_plain }
    }

    /// The rest of it, from the best.
    pub fn go_on(&self, problem: &Problem, begun: Optima, iterations: usize, halt: Halt) -> Optima {
        let [plain_task, white_task] = self.tasks(problem, halt);
        let rest = iterations - iterations.div_ceil(FIRST_PART);
        let Optima { plain, plain_cost, white, evaluations, .. } = begun;
        let starts = match Effort::of(problem).two_ways {
            true => vec![plain, white.clone()],
            false if plain_task.cost(&white) < plain_cost => vec![white.clone()],
            false => vec![plain],
        };
        let [(white, white_cost, of_white), (plain, plain_cost, of_plain)] =
            polish_together([(&white_task, &[white]), (&plain_task, &starts)], rest);
        Optima { plain, plain_cost, white, white_cost, evaluations: evaluations + of_white + of_plain }
    }

    /// What is measured at the optima; `None` where a simulation diverges, or is cut short.
    pub fn measure(&self, problem: &Problem, fitted: &Optima, halt: Halt) -> Option<OptimaMeasures> {
        let split = problem.split();
        let train = usable(problem, &split.train);
        let mut runs =
            problem.simulator().run_unless(&[&fitted.plain, &fitted.white], problem.grid().len(), halt);
        let (white, plain) = (runs.pop()?, runs.pop()?);
        if white.diverged || plain.diverged {
            return None;
        }
        let at_white = residuals(problem, &white);
        let (bic, samples) = Autoregression::fit(&at_white, &train)?.bic();
        let validation = self.validation.apply(&at_white);
        let at_plain = residuals(problem, &plain);
        let part = |range: &Range<usize>| mean_square_of(problem, &at_plain, range);
        let days = |range: &Range<usize>| squares_by_day(problem, &at_plain, range);
        Some(OptimaMeasures {
            bic,
            samples,
            slow: slow_bic(problem, &at_plain, &train),
            floor: Autoregression::fit(&at_plain, &train)?.deviation(),
            days: [days(&split.train), days(&split.validation)],
            plain: [part(&split.train), part(&split.validation), part(&split.test)],
            white_validation: (!validation.is_empty()).then(|| mean_square(&validation)),
        })
    }
}

/// The mean square of the residuals over a part; `None` where nothing is comparable.
fn mean_square_of(problem: &Problem, residuals: &[Vec<f64>], range: &Range<usize>) -> Option<f64> {
    let errors = at(residuals, &usable(problem, range));
    (!errors.is_empty()).then(|| mean_square(&errors)).filter(|value| value.is_finite())
}

/// The innovations' filter of the training part at a parameter vector; `None` where the model diverges there.
pub fn whitening_at(problem: &Problem, theta: &[f64]) -> Option<Whitening> {
    let train = usable(problem, &problem.split().train);
    let run =
        problem.simulator().run(&[theta], problem.split().train.end).pop().filter(|run| !run.diverged)?;
    let ar = Autoregression::fit(&residuals(problem, &run), &train)?;
    Some(Whitening::ar(&ar, &train))
}

/// The squared error of every whole day of a part, counted from its start.
fn squares_by_day(problem: &Problem, residuals: &[Vec<f64>], range: &Range<usize>) -> Vec<f64> {
    let per_day = ((24.0 / problem.grid().step_hours()) as usize).max(1);
    let mut days = vec![0.0; range.len() / per_day];
    for (error, usable) in residuals.iter().zip(usable(problem, range)) {
        for k in usable {
            if let Some(day) = days.get_mut((k - range.start) / per_day) {
                *day += error[k] * error[k];
            }
        }
    }
    days
}

impl NullModel {
    /// Brings a model to its optima from a known point; `None` where it diverges or its residual has no
    /// autoregressive model, or where `halt` ends it.
    pub fn settle(problem: Problem, plain: &[f64], white: Option<&[f64]>, halt: Halt) -> Option<Self> {
        let usable = usable(&problem, &problem.split().train);
        let series = |theta: &[f64]| {
            let run = problem.simulator().run_unless(&[theta], problem.split().train.end, halt).pop()?;
            (!run.diverged).then(|| residuals(&problem, &run))
        };
        let deviation = |series: &[Vec<f64>]| mean_square(&at(series, &usable)).sqrt();
        let effort = Effort::of(&problem);
        let first = series(plain)?;
        let ar = Autoregression::fit(&first, &usable)?;
        let filters = Filters::new(&problem, &ar, deviation(&first));
        let [task, _] = filters.tasks(&problem, halt);
        let (restarted, restarting) =
            task.ends(&[plain.to_vec(), problem.nominal().to_vec()], effort.restart);
        let starts: Vec<Vec<f64>> = restarted.iter().map(|(theta, _)| theta.clone()).collect();
        let mut whites: Vec<Vec<f64>> = white.map(<[f64]>::to_vec).into_iter().collect();
        whites.extend(starts.iter().cloned());
        let mut fitted = filters.fit(&problem, [&starts, &whites], effort.settle, halt);
        // The innovations' optimum changes the residual, and with it the filter: once more with the right
        // one.
        let ar = Autoregression::fit(&series(&fitted.white)?, &usable)?;
        let filters = Filters::new(&problem, &ar, deviation(&series(&fitted.plain)?));
        let [_, task] = filters.tasks(&problem, halt);
        let polished;
        (fitted.white, fitted.white_cost, polished) = task.polish(&[fitted.white], effort.settle);
        fitted.evaluations += restarting + polished;
        let measured = filters.measure(&problem, &fitted, halt)?;
        let [least, most] = OTHER.map(|factor| factor * fitted.plain_cost);
        let other = restarted.into_iter().find(|(_, cost)| (least..most).contains(cost)).map(|(plain, _)| {
            let (white, _, evaluations) = task.polish(std::slice::from_ref(&plain), effort.restart);
            fitted.evaluations += evaluations;
            [plain, white]
        });
        Some(Self { fitted, measured, filters, other, problem })
    }

    /// Goes on from other places, each a start for the free run and one for the innovations: keeps what is
    /// better there, and measures again.
    pub fn restart(&mut self, places: &[[Vec<f64>; 2]], halt: Halt) {
        let iterations = Effort::of(&self.problem).settle / 2;
        let again = |[plain, white]: &[Vec<f64>; 2]| {
            let starts: [&[Vec<f64>]; 2] = [std::slice::from_ref(plain), std::slice::from_ref(white)];
            self.filters.fit(&self.problem, starts, iterations, halt)
        };
        let found: Vec<Optima> = places.par_iter().map(again).collect();
        self.fitted.evaluations += found.iter().map(|again| again.evaluations).sum::<usize>();
        let mut better = self.fitted.clone();
        for again in found {
            if again.plain_cost < better.plain_cost {
                (better.plain, better.plain_cost) = (again.plain, again.plain_cost);
            }
            if again.white_cost < better.white_cost {
                (better.white, better.white_cost) = (again.white, again.white_cost);
            }
        }
        if let Some(measured) =
            self.filters.measure(&self.problem, &better, halt).filter(|_| better != self.fitted)
        {
            (self.fitted, self.measured) = (better, measured);
        }
    }

    /// Whether a candidate that has gone a part of its way promises something: three in twice the logarithm
    /// of the likelihood, less than half of what one parameter costs, or a thirtieth of the free run's
    /// squared error.
    pub fn is_promising(&self, begun: &Optima) -> bool {
        let n = self.measured.samples as f64;
        begun.plain_cost < LEAST_PROMISE * self.fitted.plain_cost
            || begun.white_cost < (-3.0 / n).exp() * self.fitted.white_cost
    }

    /// Free-run error over the innovation deviation, on the training part.
    pub fn rho(&self) -> Option<f64> {
        self.measured.plain[0].map(|mse| mse.sqrt() / self.measured.floor)
    }

    /// The same of the part, seen or unseen, on which the free run errs more: what imitates a missing effect
    /// on the days that it was fitted to fails on others.
    pub fn worst_rho(&self) -> Option<f64> {
        let [train, validation, _] = self.measured.plain;
        Some(train?.max(validation.unwrap_or(0.0)).sqrt() / self.measured.floor)
    }
}
