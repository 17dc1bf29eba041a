//! Which inputs should be driven for a few days, so that what cannot be told apart today can be?
//!
//! ```text
//! record --information--> what is known, noise of days --+
//! weather of the last days --ahead--> days to come ------+--> expected widths and t, comfort --> best of
//! seed --plans--> steps, random binary, night pulses ----+                                  each family
//! the record with the experiment --information--> widths --promise--> learnt as promised?
//! ```
//!
//! Sequences are judged before anybody runs them: by the Fisher information that the model expects of them
//! (optimal input design; Goodwin and Payne 1977, Dynamic System Identification, ch. 6), under the noise of
//! the days that were measured, and over some draws of the parameters as they are known today. Those whose
//! predicted outputs leave the comfort bounds are left out.

mod about;
mod ahead;
mod asked;
pub mod information;
mod plans;
mod promise;
mod report;
#[cfg(test)]
mod tests;
mod whole_days;

use crate::data::rfc3339;
use crate::estimate::Problem;
use crate::estimate::forecast::InputsToCome;
use crate::estimate::uncertainty::covariance::WIDTH as HALF_WIDTH;
use crate::fault::Fault;
use crate::optimise::lshade::normal;
use crate::simulate::kalman::Noise;
use crate::simulate::predict::Belief;
use crate::units::error_unit;
use ahead::{DaysToCome, DrivenCourse};
use asked::checked;
use information::Knowledge;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use report::{sentence, sentences};
use statrs::distribution::{ContinuousCDF, Normal};

pub use about::ExperimentSubject;
pub use asked::{ComfortBounds, ExperimentAsked, ExperimentPurpose, LONGEST_DAYS};
pub use plans::{DrivenInput, PlanFamily};
pub use promise::{Learnt, PromisedWidth, learnt};
pub use report::{
    ComfortCost, ExpectedLesson, ExpectedTie, Experiment, ExperimentPlan, ExperimentWeather, PlannedSeries,
};

/// Draws of the parameters, beside the estimates, over which a plan has to hold.
const DRAWS: usize = 6;
/// Weathers over which a plan has to keep the comfort bounds, the record willing: a front that comes once in
/// two weeks has to be among them.
const WEATHERS: usize = 14;
/// The most of the time that a plan may be expected to spend outside the comfort bounds, for the worst draw.
const OUTSIDE: f64 = 0.0025;
/// Which quantile of the draws is promised: the best of many plans is one that the expected weather flatters.
const PROMISED: f64 = 0.75;
/// A sequence that breaks the comfort bounds is tried again at these shares of its way from the usual inputs.
const SHARES: [f64; 4] = [1.0, 0.6, 0.35, 0.2];
/// Correlations above this are told as ties.
const TIED: f64 = 0.7;

/// Everything that plans are judged by.
struct Judges<'a> {
    asked: &'a ExperimentAsked,
    problem: &'a Problem,
    known: &'a Knowledge,
    before: DMatrix<f64>,
    /// The days to come with the weather of the last days, and with that of earlier ones.
    days: &'a [DaysToCome<'a>],
    /// What the record teaches with each draw of the parameters, the estimates first, and what is believed of
    /// the states then.
    draws: Vec<(Knowledge, Belief)>,
    /// The places of what it is about, and of which size each is.
    about: Vec<(usize, f64)>,
}

/// A plan that was judged.
struct Judged {
    family: PlanFamily,
    values: Vec<Vec<f64>>,
    comfort: ComfortCost,
    /// The least t of what it is about.
    score: f64,
    deviations: Vec<f64>,
    correlations: DMatrix<f64>,
    course: DrivenCourse,
}

/// The best plan of each family for what is asked, from the parameters `theta` of a fit and its noise on. The
/// weather is that of the last such days but for what is `forecast`.
///
/// # Errors
/// Every fault of what is asked; where there are too few days, or the model has no filter or leaves the
/// numbers.
pub fn experiment(
    problem: &Problem,
    theta: &[f64],
    noise: &Noise,
    asked: &ExperimentAsked,
    forecast: &InputsToCome,
) -> Result<Experiment, Vec<Fault>> {
    let about = checked(problem, asked)?;
    let one = |fault| vec![fault];
    let days: Vec<DaysToCome> = (0..WEATHERS)
        .map_while(|back| match DaysToCome::new(problem, noise, (asked.days, back), forecast) {
            // The record need not have so many stretches of days.
            Err(_) if back > 0 => None,
            days => Some(days),
        })
        .collect::<Result<_, _>>()?;
    let last = &days[0];
    // What is told apart or looked for may as well be nothing.
    let may_be_nothing = if asked.purpose == ExperimentPurpose::Determine { &[] } else { about.as_slice() };
    let known = Knowledge::of(problem, theta, may_be_nothing).map_err(one)?;
    let judges = Judges::new(problem, &known, &days, asked, &about).map_err(one)?;
    let usual = last.usual(&asked.inputs).map_err(one)?;
    let of_families =
        PlanFamily::ALL.into_iter().flat_map(|family| (0..plans::DRAWN).map(move |n| (family, n)));
    let candidates: Vec<(PlanFamily, u64)> = of_families.collect();
    let judge = |(family, number): &(PlanFamily, u64)| {
        problem.brake().check();
        let seed = asked.seed.wrapping_mul(1_000_003).wrapping_add(100 * *family as u64 + number);
        let plan = plans::drawn(*family, seed, &asked.inputs, &usual, &last.grid, last.past);
        SHARES.iter().find_map(|share| judges.judge(*family, plans::nearer(&plan, &usual, *share)))
    };
    let judged: Vec<Judged> = candidates.par_iter().filter_map(judge).collect();
    let uncomfortable = candidates.len() - judged.len();
    let undriven = judges.driven(&usual).and_then(|driven| judges.comfort(&driven)).map(|(_, cost)| cost);
    let best = |family: PlanFamily| {
        let of_family = judged.iter().filter(|one| one.family == family);
        of_family.max_by(|a, b| a.score.total_cmp(&b.score))
    };
    let mut best: Vec<&Judged> = PlanFamily::ALL.into_iter().filter_map(best).collect();
    best.sort_by(|a, b| b.score.total_cmp(&a.score));
    let plans: Vec<ExperimentPlan> = best.into_iter().map(|one| judges.plan(one)).collect();
    let mut found = Experiment {
        purpose: asked.purpose,
        about: asked.about.clone(),
        sentences: Vec::new(),
        weather: weather(problem, last, forecast),
        plans,
        tried: candidates.len(),
        uncomfortable,
        undriven,
        time: (last.past..last.grid.len()).map(|k| rfc3339(last.grid.time(k))).collect(),
    };
    found.sentences = sentences(&found, asked);
    Ok(found)
}

/// What the inputs that nobody drives are taken to be.
fn weather(problem: &Problem, days: &DaysToCome, forecast: &InputsToCome) -> ExperimentWeather {
    let (record, samples) = (problem.grid(), days.grid.len() - 1 - days.past);
    let newest = record.len() - 1;
    let inputs = problem.model().inputs().iter().map(|input| input.channel.clone());
    ExperimentWeather {
        measured_from: rfc3339(record.time(newest - samples)),
        measured_to: rfc3339(record.time(newest)),
        forecast: inputs.filter(|channel| forecast.has(channel)).collect(),
    }
}

impl<'a> Judges<'a> {
    fn new(
        problem: &'a Problem,
        known: &'a Knowledge,
        days: &'a [DaysToCome<'a>],
        asked: &'a ExperimentAsked,
        about: &[usize],
    ) -> Result<Self, Fault> {
        let before = known.covariance()?;
        let lost = || Fault::new("/system", "no-experiment", "the model leaves the numbers");
        let root = root(&before).ok_or_else(lost)?;
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(asked.seed);
        let deviates: Vec<DVector<f64>> =
            (0..DRAWS).map(|_| DVector::from_fn(root.ncols(), |_, _| normal(&mut dice))).collect();
        let mut draws = vec![known.clone()];
        let drawn = |deviate: &DVector<f64>| known.drawn(problem, &root, deviate);
        draws.extend(deviates.par_iter().filter_map(drawn).collect::<Vec<Knowledge>>());
        let believed = |known: Knowledge| {
            let belief = days[0].belief(&known.theta)?;
            Some((known, belief))
        };
        let draws: Vec<(Knowledge, Belief)> = draws.into_par_iter().filter_map(believed).collect();
        if draws.is_empty() {
            return Err(lost());
        }
        let starts =
            || Fault::new("/about", "unknown-parameter", "a start of the record is no parameter here");
        let places: Vec<usize> =
            about.iter().map(|index| known.place(*index).ok_or_else(starts)).collect::<Result<_, _>>()?;
        let size = |place: &usize| match (asked.purpose, places.as_slice()) {
            (ExperimentPurpose::Detect, _) => Ok(typical(problem, known.along[*place])),
            (ExperimentPurpose::Separate, [a, b]) => known.alone(*place, if place == a { *b } else { *a }),
            _ => Ok(known.theta[known.along[*place]]),
        };
        let sizes: Vec<f64> = places.iter().map(size).collect::<Result<_, _>>()?;
        Ok(Self {
            asked,
            problem,
            known,
            before,
            days,
            draws,
            about: places.into_iter().zip(sizes).collect(),
        })
    }

    /// Where each draw goes under a plan, with weather of its own, and what that costs; the weather of the
    /// last days counts for each in the cost as well, and so do weathers more than there are draws. `None`
    /// where the model leaves the numbers.
    fn comfort(&self, driven: &[Problem]) -> Option<(Vec<DrivenCourse>, ComfortCost)> {
        let mut cost = ComfortCost { hours_outside: 0.0, worst_hours: 0.0, largest_excursion: 0.0 };
        let (mut courses, mut count) = (Vec::new(), 0.0);
        for one in 0..self.draws.len().max(self.days.len()) {
            let (known, belief) = &self.draws[one % self.draws.len()];
            let (own, is_first) = (one % self.days.len(), one < self.draws.len());
            let mut places = if is_first { vec![own, 0] } else { vec![own] };
            places.dedup();
            for place in places {
                let course = self.days[place].course(&driven[place], &known.theta, belief)?;
                let (hours, farthest) = self.discomfort(&course);
                cost.hours_outside += hours;
                cost.worst_hours = cost.worst_hours.max(hours);
                cost.largest_excursion = cost.largest_excursion.max(farthest);
                count += 1.0;
                if is_first && place == own {
                    courses.push(course);
                }
            }
        }
        cost.hours_outside /= count;
        Some((courses, cost))
    }

    /// The problems of a plan, one with the weather of each of the days.
    fn driven(&self, plan: &[Vec<f64>]) -> Option<Vec<Problem>> {
        self.days.iter().map(|days| days.driven(&self.asked.inputs, plan).ok()).collect()
    }

    /// Judges a plan over all draws. `None` where it does not keep the comfort bounds, or the model leaves
    /// the numbers.
    fn judge(&self, family: PlanFamily, values: Vec<Vec<f64>>) -> Option<Judged> {
        let driven = self.driven(&values)?;
        let (courses, comfort) = self.comfort(&driven)?;
        if comfort.worst_hours > OUTSIDE * 24.0 * self.asked.days as f64 {
            return None;
        }
        let n = self.known.along.len();
        let (mut deviations, mut correlations) = (vec![Vec::new(); n], DMatrix::zeros(n, n));
        for (one, ((known, _), course)) in self.draws.iter().zip(&courses).enumerate() {
            let place = one % self.days.len();
            let covariance = self.days[place].learnt(known, &driven[place], course)?.covariance().ok()?;
            let deviation = |i: usize| covariance[(i, i)].max(f64::MIN_POSITIVE).sqrt();
            deviations.iter_mut().enumerate().for_each(|(i, drawn)| drawn.push(deviation(i)));
            let share = 1.0 / courses.len() as f64;
            correlations +=
                DMatrix::from_fn(n, n, |i, j| share * covariance[(i, j)] / (deviation(i) * deviation(j)));
        }
        // Days more take nothing away from what is known now, wherever a draw may lie.
        let promised = |(place, mut drawn): (usize, Vec<f64>)| {
            drawn.sort_by(f64::total_cmp);
            let now = self.before[(place, place)].max(0.0).sqrt();
            drawn[((drawn.len() - 1) as f64 * PROMISED).round() as usize].min(now)
        };
        let deviations: Vec<f64> = deviations.into_iter().enumerate().map(promised).collect();
        let t = |(place, size): &(usize, f64)| size.abs() / (deviations[*place] * self.known.units[*place]);
        Some(Judged {
            family,
            values,
            comfort,
            score: self.about.iter().map(t).fold(f64::INFINITY, f64::min),
            correlations,
            course: courses.into_iter().next()?,
            deviations,
        })
    }

    /// Expected hours outside the comfort bounds, and how far outside the 95 % band comes.
    fn discomfort(&self, course: &DrivenCourse) -> (f64, f64) {
        let step = self.problem.grid().step_hours();
        let (mut hours, mut farthest) = (0.0, 0.0f64);
        let Ok(standard) = Normal::new(0.0, 1.0) else { return (hours, farthest) };
        for bounds in &self.asked.comfort {
            let outputs = self.problem.model().outputs();
            let Some(one) = outputs.iter().position(|output| output.channel == bounds.channel) else {
                continue;
            };
            let [low, high] = bounds.range;
            for (value, sd) in course.outputs.iter().zip(&course.output_deviations).skip(1) {
                let (value, sd) = (value[one], sd[one].max(1e-9));
                hours += step * (standard.cdf((low - value) / sd) + standard.cdf((value - high) / sd));
                let band = HALF_WIDTH * sd;
                farthest = farthest.max(low - value + band).max(value + band - high);
            }
        }
        (hours, farthest)
    }

    /// A judged plan as it is answered.
    fn plan(&self, judged: &Judged) -> ExperimentPlan {
        let model = self.problem.model();
        let parameter = |place: usize| &model.parameters()[self.known.along[place]];
        let size_of = |place: usize| self.about.iter().find(|(one, _)| *one == place).map(|(_, size)| *size);
        let lesson = |place: usize| {
            let value = self.known.theta[self.known.along[place]];
            let size = size_of(place).unwrap_or(value);
            let (now, then) = (self.before[(place, place)].max(0.0).sqrt(), judged.deviations[place]);
            let width = |deviation| self.known.width(self.problem, place, deviation);
            let unit = self.known.units[place];
            ExpectedLesson {
                parameter: parameter(place).name.clone(),
                unit: parameter(place).unit.clone(),
                value,
                width_unit: width(now).1.to_owned(),
                width_before: width(now).0,
                width_after: width(then).0,
                size,
                t_before: size.abs() / (now * unit),
                t_after: size.abs() / (then * unit),
            }
        };
        let asked: Vec<usize> = self.about.iter().map(|(place, _)| *place).collect();
        let others = (0..self.known.along.len()).filter(|place| !asked.contains(place));
        let lessons: Vec<ExpectedLesson> = asked.iter().copied().chain(others).map(lesson).collect();
        let mut ties = Vec::new();
        for i in 0..self.known.along.len() {
            for j in 0..i {
                let both = |matrix: &DMatrix<f64>| {
                    matrix[(i, j)] / (matrix[(i, i)] * matrix[(j, j)]).max(f64::MIN_POSITIVE).sqrt()
                };
                let (before, after) = (both(&self.before), judged.correlations[(i, j)]);
                let is_asked = asked.contains(&i) && asked.contains(&j);
                if is_asked || before.abs() > TIED || after.abs() > TIED {
                    ties.push(ExpectedTie {
                        parameters: [parameter(j).name.clone(), parameter(i).name.clone()],
                        correlation_before: before,
                        correlation_after: after,
                    });
                }
            }
        }
        let series = |unit: &str, values, sd| PlannedSeries { unit: unit.to_owned(), values, sd };
        let input = |(input, values): (&DrivenInput, &Vec<f64>)| {
            let unit = self.days[0].grid.column(&input.channel).map_or("", |column| column.unit());
            (input.channel.clone(), series(unit, values.clone(), None))
        };
        let output = |(one, output): (usize, &crate::model::Output)| {
            let of = |rows: &[Vec<f64>]| rows.iter().map(|row| row[one]).collect::<Vec<f64>>();
            let sd = Some(of(&judged.course.output_deviations));
            (output.channel.clone(), series(&output.unit, of(&judged.course.outputs), sd))
        };
        let mut plan = ExperimentPlan {
            family: judged.family,
            sentence: String::new(),
            lessons,
            ties,
            comfort: judged.comfort.clone(),
            inputs: self.asked.inputs.iter().zip(&judged.values).map(input).collect(),
            outputs: model.outputs().iter().enumerate().map(output).collect(),
        };
        plan.sentence = sentence(&plan, self.asked, self.comfort_unit());
        plan
    }

    fn comfort_unit(&self) -> &str {
        self.problem.model().outputs().first().map_or("", |output| error_unit(&output.unit))
    }
}

/// A square root of a covariance, which rounding may have made a little less than one.
fn root(covariance: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = covariance.nrows();
    let rounding = 1e-12 * covariance.trace();
    let covariance = 0.5 * (covariance + covariance.transpose()) + DMatrix::identity(n, n) * rounding;
    Some(covariance.cholesky()?.l())
}

/// The size of an effect of which nothing is known but its parameter: the nominal one, or where that is
/// nothing half of the farther bound.
fn typical(problem: &Problem, index: usize) -> f64 {
    let [lower, upper] = problem.bounds()[index];
    match problem.nominal()[index] {
        nominal if nominal != 0.0 => nominal,
        _ => 0.5 * lower.abs().max(upper.abs()),
    }
}
