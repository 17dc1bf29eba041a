//! Which inputs should be driven for a few days, so that what cannot be told apart today can be?
//!
//! ```text
//! record --information--> what is known, noise of days --+
//! weather of the last days --ahead--> days to come ------+--> expected widths and t, comfort --> best of each
//! seed --plans--> steps, random binary, night pulses ----+                                        family
//! the record with the experiment --information--> widths --promise--> learnt as promised?
//! ```
//!
//! Sequences are judged before anybody runs them: by the Fisher information that the model expects of them
//! (optimal input design; Goodwin and Payne 1977, Dynamic System Identification, ch. 6), under the noise of
//! the days that were measured, and over some draws of the parameters as they are known today. Those whose
//! predicted outputs leave the comfort bounds are left out.

mod ahead;
pub mod information;
mod plans;
mod promise;

use crate::data::rfc3339;
use crate::estimate::Problem;
use crate::estimate::forecast::InputsToCome;
use crate::fault::Fault;
use crate::simulate::kalman::Noise;
use crate::simulate::predict::Belief;
use crate::units::error_unit;
use ahead::{Course, DaysToCome};
use indexmap::IndexMap;
use information::Knowledge;
use crate::estimate::uncertainty::covariance::WIDTH as HALF_WIDTH;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};
use utoipa::ToSchema;

pub use plans::{DrivenInput, PlanFamily};
pub use promise::{Learnt, PromisedWidth, learnt};

/// Draws of the parameters, beside the estimates, over which a plan has to hold.
const DRAWS: usize = 4;
/// The most of the time that a plan may be expected to spend outside the comfort bounds.
const OUTSIDE: f64 = 0.005;
/// A sequence that breaks the comfort bounds is tried again at these shares of its way from the usual inputs.
const SHARES: [f64; 4] = [1.0, 0.6, 0.35, 0.2];
/// The longest experiment in days.
pub const LONGEST_DAYS: usize = 14;
/// Correlations above this are told as ties.
const TIED: f64 = 0.7;
/// What is called told apart: a t of three.
const TOLD: f64 = 3.0;

/// What an experiment is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExperimentPurpose {
    /// To tell parameters or effects apart that are tied.
    Separate,
    /// To make the intervals of parameters narrow.
    Determine,
    /// To see whether there is an effect of a typical size.
    Detect,
}

/// Bounds that an output shall keep, in its unit.
#[derive(Debug, Clone, PartialEq)]
pub struct ComfortBounds {
    /// The output.
    pub channel: String,
    /// Its lowest and its highest value.
    pub range: [f64; 2],
}

/// What is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct ExperimentAsked {
    /// How many days.
    pub days: usize,
    /// What may be driven.
    pub inputs: Vec<DrivenInput>,
    /// What shall be kept.
    pub comfort: Vec<ComfortBounds>,
    /// What it is for.
    pub purpose: ExperimentPurpose,
    /// The parameters that it is about, by name.
    pub about: Vec<String>,
    /// Fixes the sequences that are tried.
    pub seed: u64,
}

/// What a plan teaches of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExpectedLesson {
    /// The parameter.
    pub parameter: String,
    /// Its unit.
    pub unit: String,
    /// The estimate by segments of hours.
    pub value: f64,
    /// The unit of the widths: its own, or per cent of the estimate where it is searched on a logarithmic
    /// scale and cannot be nothing.
    pub width_unit: String,
    /// The width of its 95 % interval now.
    pub width_before: f64,
    /// The width that is expected behind the experiment.
    pub width_after: f64,
    /// Of which size `t` speaks: the estimate, or that of an effect of a typical size.
    pub size: f64,
    /// The size over the deviation of the estimate now.
    pub t_before: f64,
    /// The same behind the experiment.
    pub t_after: f64,
}

/// How two estimates err together: 1 and -1 cannot be told apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExpectedTie {
    /// The two parameters.
    pub parameters: [String; 2],
    /// Their correlation now.
    pub correlation_before: f64,
    /// The correlation that is expected behind the experiment.
    pub correlation_after: f64,
}

/// An input or output of a plan, a value at each of its instants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlannedSeries {
    /// The unit of the values.
    pub unit: String,
    /// The values.
    pub values: Vec<f64>,
    /// Standard deviations of what is only expected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sd: Option<Vec<f64>>,
}

/// What a plan is expected to cost in comfort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ComfortCost {
    /// Expected hours outside the bounds.
    pub hours_outside: f64,
    /// How far an output leaves them at the worst instant, with 95 % and for every draw of the parameters, in
    /// its unit; zero where it does not.
    pub largest_excursion: f64,
}

/// A plan: the inputs, and what they would teach and cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExperimentPlan {
    /// How its sequences were made.
    pub family: PlanFamily,
    /// What it teaches and costs, in a sentence.
    pub sentence: String,
    /// What it teaches of every parameter, those that it is about first.
    pub lessons: Vec<ExpectedLesson>,
    /// Parameters that are tied now or behind it, those that it is about always.
    pub ties: Vec<ExpectedTie>,
    /// What it costs.
    pub comfort: ComfortCost,
    /// The driven inputs by channel.
    pub inputs: IndexMap<String, PlannedSeries>,
    /// The outputs that are expected, by channel.
    pub outputs: IndexMap<String, PlannedSeries>,
}

/// The best plans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Experiment {
    /// What it is for.
    pub purpose: ExperimentPurpose,
    /// The parameters that it is about.
    pub about: Vec<String>,
    /// What it says, in plain sentences.
    pub sentences: Vec<String>,
    /// The best of each family, the best first.
    pub plans: Vec<ExperimentPlan>,
    /// How many sequences were tried, and how many of them broke the comfort bounds.
    pub tried: usize,
    /// Those that were left out because they would leave the comfort bounds.
    pub uncomfortable: usize,
    /// What comfort is expected to cost if nobody drives anything; `null` where the model leaves the numbers.
    pub undriven: Option<ComfortCost>,
    /// The instants of every plan.
    #[schema(value_type = Vec<String>)]
    pub time: Vec<String>,
}

/// Everything that plans are judged by.
struct Judges<'a> {
    asked: &'a ExperimentAsked,
    problem: &'a Problem,
    known: &'a Knowledge,
    before: DMatrix<f64>,
    days: &'a DaysToCome<'a>,
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
    course: Course,
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
    let days = DaysToCome::new(problem, noise, asked.days, forecast)?;
    // What is told apart or looked for may as well be nothing.
    let may_be_nothing = if asked.purpose == ExperimentPurpose::Determine { &[] } else { about.as_slice() };
    let known = Knowledge::of(problem, theta, may_be_nothing).map_err(one)?;
    let judges = Judges::new(problem, &known, &days, asked, &about).map_err(one)?;
    let usual = days.usual(&asked.inputs).map_err(one)?;
    let of_families = PlanFamily::ALL.into_iter().flat_map(|family| (0..plans::DRAWN).map(move |n| (family, n)));
    let candidates: Vec<(PlanFamily, u64)> = of_families.collect();
    let judge = |(family, number): &(PlanFamily, u64)| {
        let seed = asked.seed.wrapping_mul(1_000_003).wrapping_add(100 * *family as u64 + number);
        let plan = plans::drawn(*family, seed, &asked.inputs, &usual, &days.grid, days.past);
        SHARES.iter().find_map(|share| judges.judge(*family, plans::nearer(&plan, &usual, *share)))
    };
    let judged: Vec<Judged> = candidates.par_iter().filter_map(judge).collect();
    let uncomfortable = candidates.len() - judged.len();
    let undriven = judges.comfort(&days.driven(&asked.inputs, &usual)?).map(|(_, comfort)| comfort);
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
        plans,
        tried: candidates.len(),
        uncomfortable,
        undriven,
        time: (days.past..days.grid.len()).map(|k| rfc3339(days.grid.time(k))).collect(),
    };
    found.sentences = sentences(&found, asked);
    Ok(found)
}

/// The parameters that an experiment is about, by their places.
fn checked(problem: &Problem, asked: &ExperimentAsked) -> Result<Vec<usize>, Vec<Fault>> {
    let model = problem.model();
    let mut faults = Vec::new();
    if asked.days == 0 || asked.days > LONGEST_DAYS {
        let detail = format!("an experiment takes 1 to {LONGEST_DAYS} days");
        faults.push(Fault::new("/days", "out-of-range", detail));
    }
    let least = if asked.purpose == ExperimentPurpose::Separate { 2 } else { 1 };
    if asked.about.len() < least {
        let detail = format!("name {least} or more parameters or effects that it is about");
        faults.push(Fault::new("/about", "too-few", detail));
    }
    if asked.inputs.is_empty() {
        faults.push(Fault::new("/inputs", "too-few", "name an input that may be driven, with its range"));
    }
    for input in &asked.inputs {
        let pointer = format!("/inputs/{}", input.channel);
        if model.inputs().iter().all(|known| known.channel != input.channel) {
            let detail = format!("`{}` is no input of the model", input.channel);
            faults.push(Fault::new(&pointer, "unknown-input", detail));
        }
        if !(input.range.iter().all(|value| value.is_finite()) && input.range[0] < input.range[1]) {
            faults.push(Fault::new(&pointer, "out-of-range", "a range is a lower and a higher value"));
        }
        if !(input.slew.is_finite() && input.slew > 0.0) {
            faults.push(Fault::new(format!("/slew/{}", input.channel), "out-of-range", "more than nothing"));
        }
    }
    for bounds in &asked.comfort {
        let pointer = format!("/comfort/{}", bounds.channel);
        if model.outputs().iter().all(|output| output.channel != bounds.channel) {
            let detail = format!("`{}` is no output of the model", bounds.channel);
            faults.push(Fault::new(&pointer, "unknown-output", detail));
        }
        if bounds.range[0].partial_cmp(&bounds.range[1]) != Some(std::cmp::Ordering::Less) {
            faults.push(Fault::new(&pointer, "out-of-range", "comfort is a lower and a higher value"));
        }
    }
    let mut about = Vec::new();
    for name in &asked.about {
        let place = model.parameters().iter().position(|parameter| parameter.name == *name);
        match place.filter(|place| problem.free().contains(place)) {
            Some(place) => about.push(place),
            None => {
                let detail = format!("`{name}` is no estimated parameter of the model");
                faults.push(Fault::new("/about", "unknown-parameter", detail));
            }
        }
    }
    if faults.is_empty() { Ok(about) } else { Err(faults) }
}

impl<'a> Judges<'a> {
    fn new(
        problem: &'a Problem,
        known: &'a Knowledge,
        days: &'a DaysToCome<'a>,
        asked: &'a ExperimentAsked,
        about: &[usize],
    ) -> Result<Self, Fault> {
        let before = known.covariance()?;
        let lost = || Fault::new("/system", "no-experiment", "the model leaves the numbers");
        let root = root(&before).ok_or_else(lost)?;
        let mut dice = Xoshiro256PlusPlus::seed_from_u64(asked.seed);
        let mut draws = vec![known.theta.clone()];
        for _ in 0..DRAWS {
            let normal = DVector::from_fn(root.ncols(), |_, _| normal(&mut dice));
            draws.push(known.drawn(problem, &root, &normal));
        }
        let believed = |theta: Vec<f64>| {
            let belief = days.belief(&theta)?;
            Some((known.at(problem, &theta)?, belief))
        };
        let draws: Vec<(Knowledge, Belief)> = draws.into_par_iter().filter_map(believed).collect();
        if draws.is_empty() {
            return Err(lost());
        }
        let starts = || Fault::new("/about", "unknown-parameter", "a start of the record is no parameter here");
        let places: Vec<usize> =
            about.iter().map(|index| known.place(*index).ok_or_else(starts)).collect::<Result<_, _>>()?;
        let size = |place: &usize| match (asked.purpose, places.as_slice()) {
            (ExperimentPurpose::Detect, _) => Ok(typical(problem, known.along[*place])),
            (ExperimentPurpose::Separate, [a, b]) => known.alone(*place, if place == a { *b } else { *a }),
            _ => Ok(known.theta[known.along[*place]]),
        };
        let sizes: Vec<f64> = places.iter().map(size).collect::<Result<_, _>>()?;
        Ok(Self { asked, problem, known, before, days, draws, about: places.into_iter().zip(sizes).collect() })
    }

    /// Where every draw goes under a plan, and what that costs. `None` where one leaves the numbers.
    fn comfort(&self, driven: &Problem) -> Option<(Vec<Course>, ComfortCost)> {
        let course = |(known, belief): &(Knowledge, Belief)| self.days.course(driven, &known.theta, belief);
        let courses: Vec<Course> = self.draws.iter().map(course).collect::<Option<_>>()?;
        let mut cost = ComfortCost { hours_outside: 0.0, largest_excursion: 0.0 };
        for course in &courses {
            let (hours, farthest) = self.discomfort(course);
            cost.hours_outside += hours / courses.len() as f64;
            cost.largest_excursion = cost.largest_excursion.max(farthest);
        }
        Some((courses, cost))
    }

    /// Judges a plan over all draws. `None` where it does not keep the comfort bounds, or the model leaves
    /// the numbers.
    fn judge(&self, family: PlanFamily, values: Vec<Vec<f64>>) -> Option<Judged> {
        let driven = self.days.driven(&self.asked.inputs, &values).ok()?;
        let (courses, comfort) = self.comfort(&driven)?;
        if comfort.hours_outside > OUTSIDE * 24.0 * self.asked.days as f64 {
            return None;
        }
        let n = self.known.along.len();
        let (mut deviations, mut correlations) = (vec![0.0; n], DMatrix::zeros(n, n));
        for ((known, _), course) in self.draws.iter().zip(&courses) {
            let covariance = self.days.learnt(known, &driven, course)?.covariance().ok()?;
            let deviation = |i: usize| covariance[(i, i)].max(f64::MIN_POSITIVE).sqrt();
            let share = 1.0 / courses.len() as f64;
            deviations.iter_mut().enumerate().for_each(|(i, sum)| *sum += share * deviation(i));
            correlations +=
                DMatrix::from_fn(n, n, |i, j| share * covariance[(i, j)] / (deviation(i) * deviation(j)));
        }
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
    fn discomfort(&self, course: &Course) -> (f64, f64) {
        let step = self.problem.grid().step_hours();
        let (mut hours, mut farthest) = (0.0, 0.0f64);
        let Ok(standard) = Normal::new(0.0, 1.0) else { return (hours, farthest) };
        for bounds in &self.asked.comfort {
            let outputs = self.problem.model().outputs();
            let Some(one) = outputs.iter().position(|output| output.channel == bounds.channel) else { continue };
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
            let unit = self.days.grid.column(&input.channel).map_or("", |column| column.unit());
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

/// Normally distributed, by Box and Muller.
fn normal(dice: &mut Xoshiro256PlusPlus) -> f64 {
    let (u, v): (f64, f64) = (dice.random(), dice.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
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

/// What a plan teaches and costs.
fn sentence(plan: &ExperimentPlan, asked: &ExperimentAsked, unit: &str) -> String {
    let about = &plan.lessons[..asked.about.len().min(plan.lessons.len())];
    let lesson = |one: &ExpectedLesson| {
        format!(
            "the interval of {} narrows from {:.2} to {:.2} {} (t {:.1} to {:.1})",
            one.parameter, one.width_before, one.width_after, one.width_unit, one.t_before, one.t_after
        )
    };
    let comfort = if asked.comfort.is_empty() {
        "no comfort bounds were given".to_owned()
    } else if plan.comfort.largest_excursion > 0.0 {
        format!(
            "{:.1} h outside the comfort bounds are expected, {:.1} {unit} at the worst",
            plan.comfort.hours_outside, plan.comfort.largest_excursion
        )
    } else {
        "the comfort bounds are kept".to_owned()
    };
    let lessons: Vec<String> = about.iter().map(lesson).collect();
    format!("With {}, {}; {comfort}.", plan.family.words(), lessons.join(", "))
}

/// What all of it says.
fn sentences(found: &Experiment, asked: &ExperimentAsked) -> Vec<String> {
    let Some(best) = found.plans.first() else {
        let mut said = vec![format!(
            "None of {} sequences keeps the comfort bounds: widen them, or narrow the range of the inputs.",
            found.tried
        )];
        said.extend(found.undriven.iter().filter(|cost| cost.hours_outside >= 0.1).map(|cost| {
            format!("Without an experiment {:.1} h outside them are expected as well.", cost.hours_outside)
        }));
        return said;
    };
    let about = best.lessons.iter().take(asked.about.len());
    let least = |t: fn(&ExpectedLesson) -> f64| about.clone().map(t).fold(f64::INFINITY, f64::min);
    let (before, after) = (least(|one| one.t_before), least(|one| one.t_after));
    let what = asked.about.join(" and ");
    let first = match asked.purpose {
        ExperimentPurpose::Separate if after >= TOLD => format!(
            "{what} can be told apart in {} days: the lesser t is expected to rise from {before:.1} to \
            {after:.1}.",
            asked.days
        ),
        ExperimentPurpose::Separate => format!(
            "{what} will hardly be told apart in {} days by these inputs: the lesser t is expected to go from \
            {before:.1} to {after:.1}, and 3 is wanted.",
            asked.days
        ),
        ExperimentPurpose::Determine => {
            format!("Of {what} the least certain is expected at t {after:.1}, {before:.1} now.")
        }
        ExperimentPurpose::Detect if after >= TOLD => {
            format!("An effect of a typical size would be seen: t {after:.1} is expected, {before:.1} now.")
        }
        ExperimentPurpose::Detect => format!(
            "An effect of a typical size would hardly be seen: t {after:.1} is expected, {before:.1} now."
        ),
    };
    vec![first, best.sentence.clone()]
}
