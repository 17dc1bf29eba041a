//! The heat that is missing: what flows into a measured state that the model does not know of, over time.
//!
//! ```text
//! filter --record--> affine steps --smoother--> hours --events--> habits, week, sentences
//!   ^                                   |
//!   +------------ states ---------------+
//! ```
//!
//! The linear steps along the record get one state more, an Ornstein-Uhlenbeck process that is added to the
//! rate of the state which the output shows. Its size and memory and the noise of the sensors are those under
//! which the record is likeliest; a fixed-interval smoother then gives it for every hour with its deviation.
//! The states are linearised anew where the smoother has led, with what is missing there, until they stay;
//! what the hidden ones take of the one that is shown they take of it where it was seen.
//!
//! All of it is what *this* model with *these* parameters lacks. What a fit has taken up of an effect into
//! its own parameters flows there and is not missing: a steady loss vanishes in a conductance, and of heat
//! that comes and goes a part. Times and signs are surer than sizes (reference: missing-effects 6).

mod events;
mod guesses;
mod hours;
pub(super) mod record;
pub(super) mod smoother;
#[cfg(test)]
mod tests;

use crate::estimate::Problem;
use crate::estimate::assess::metrics::measurement_variance;
use crate::fault::Fault;
use crate::model::expr::Node;
use crate::model::{Initial, Model};
use crate::simulate::kalman::Noise;
use crate::units::{Unit, error_unit};
use guesses::Guess;
use nalgebra::DVector;
use record::{FREE, LinearRecord, MissingHeatAsked};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use events::{HeatEvent, HeatHabit};
pub use hours::{Hour, HourOfWeek};

/// How often the record is linearised at most, and the move of a state, in deviations of the sensor, below
/// which it has settled.
const ROUNDS: usize = 20;
/// In so many of them the likeliest guess is sought anew.
const LIKELIEST_ROUNDS: usize = 5;
const SETTLED: f64 = 0.1;
/// Where the search for the likeliest begins: the size as so many deviations of the sensor per hour, and the
/// memory in hours.
const SIZE: f64 = 5.0;
const MEMORY_HOURS: f64 = 3.0;
/// So much wider than the smoother's own are the deviations that are told. Heat begins and ends at once, and
/// a process that wanders rounds its edges off: on 200 rooms whose every parameter was known, with all kinds
/// of hidden heat, .49 and .93 of the hours lay within the smoother's own bands of 50 and 95 %, and .53 and
/// .95 within these.
const WIDER: f64 = 1.1;
/// How many habits are told in words.
const TOLD: usize = 3;

/// What flows into a state that the model does not know of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MissingHeat {
    /// The output that shows the state.
    pub output: String,
    /// The state that it flows into.
    pub state: String,
    /// The unit of every rate: that of the state per hour, `K/h`.
    pub unit: String,
    /// How many of that unit a kilowatt makes, where a parameter of the model tells; `null` where none does.
    pub per_kilowatt: Option<f64>,
    /// The parameter that tells.
    pub per_kilowatt_of: Option<String>,
    /// Deviation of the sensor that is likeliest, in the unit of the output's error.
    pub sensor_sd: f64,
    /// Deviation of the missing rate over all time that is likeliest.
    pub size: f64,
    /// How long the missing rate remembers, in hours: the likeliest time constant.
    pub memory_hours: f64,
    /// What is missing usually: the middle rate of all hours. Events are told from here.
    pub usual: f64,
    /// What it says, in plain sentences.
    pub sentences: Vec<String>,
    /// Hour by hour.
    pub hours: Vec<Hour>,
    /// Hours in which much more or much less is missing than usual, in the order of time.
    pub events: Vec<HeatEvent>,
    /// Events that are alike, the most frequent first.
    pub habits: Vec<HeatHabit>,
    /// The mean week: 168 hours from Monday 0 h on.
    pub week: Vec<HourOfWeek>,
}

/// The state that an output shows, by its place.
pub(super) fn shown(model: &Model, output: usize) -> Option<usize> {
    model.states().iter().position(|state| state.initial == Initial::Measured(output))
}

/// What flows into the state that an output shows, at these parameters; of the first output that shows one
/// where none is named. A parameter tells what a kilowatt makes only where it `is_sure`.
///
/// # Errors
/// A fault of an unknown output, of one that shows no state, of a model that has no filter, and where the
/// numbers are left.
pub fn missing_heat(
    problem: &Problem,
    theta: &[f64],
    output: Option<&str>,
    is_sure: &dyn Fn(&str) -> bool,
) -> Result<MissingHeat, Fault> {
    let model = problem.model();
    let outputs = model.outputs();
    let output = match output {
        Some(wanted) => outputs.iter().position(|output| output.channel == wanted),
        None => (0..outputs.len()).find(|output| shown(model, *output).is_some()).or(Some(0)),
    };
    let (output, channel) =
        output
            .and_then(|output| Some((output, outputs.get(output)?.channel.as_str())))
            .ok_or_else(|| Fault::new("query output", "unknown-output", "the model has no such output"))?;
    let cannot = |why: &str| Fault::new("query output", "no-missing-heat", format!("`{channel}`: {why}"));
    if let Some(why) = problem.predictor().lacks_filter_for("the missing heat") {
        return Err(cannot(&why));
    }
    let state = shown(model, output).ok_or_else(|| cannot("no state is what this output shows"))?;
    let asked = MissingHeatAsked { problem, theta, output, state };
    let (guess, record, smoothed) = asked.settled().ok_or_else(|| cannot("the model leaves the numbers"))?;

    let firsts: Vec<usize> = (0..record.begins.len()).filter(|k| record.begins[*k]).collect();
    // What an hour has come to is known where the next one begins; the last hour is not over.
    let of_hour = |pair: &[usize]| {
        let (mean, covariance) = &smoothed[pair[1]];
        let length = (pair[1] - pair[0]) as f64 * record.hours;
        let is_known = (pair[0]..=pair[1]).all(|k| problem.inputs().known(k));
        let sd = covariance[(record.sum(), record.sum())].max(0.0).sqrt();
        is_known.then(|| (mean[record.sum()] / length, WIDER * sd / length))
    };
    let known: Vec<Option<(f64, f64)>> = firsts.windows(2).map(of_hour).collect();
    let hours = hours::hours(problem, &firsts, &known)?;
    let length = record.hours.max(1.0);
    let events = events::events(&hours, length);
    let habits = events::habits(&hours, length, &events);
    let (per_kilowatt, per_kilowatt_of) = kilowatt(model, theta, state, is_sure).unzip();
    let mut found = MissingHeat {
        output: channel.to_owned(),
        state: model.states()[state].name.clone(),
        unit: format!("{}/h", error_unit(&model.states()[state].unit)),
        per_kilowatt,
        per_kilowatt_of,
        sensor_sd: guess.sensor * problem.scale(asked.output),
        size: guess.size,
        memory_hours: guess.memory,
        usual: events::usual(&hours),
        sentences: Vec::new(),
        week: hours::week(&hours),
        hours,
        events,
        habits,
    };
    found.sentences = sentences(&found);
    Ok(found)
}

impl MissingHeatAsked<'_> {
    /// Where the search for the likeliest begins.
    pub(super) fn begin(&self) -> Guess {
        let sensor = self.problem.scaled_noise();
        Guess { sensor, size: SIZE * sensor * self.problem.scale(self.output), memory: MEMORY_HOURS }
    }

    /// The likeliest guess, and everything that is sought at each sample; `None` where the numbers are left.
    fn settled(&self) -> Option<(Guess, LinearRecord, Vec<smoother::Smoothed>)> {
        let problem = self.problem;
        let begin = self.begin();
        let sensor = begin.sensor;
        // A free run without the missing heat may lie far off, and states that nothing shows with it. Where
        // the one that is shown goes wherever it was measured, the others go along.
        let led = FREE * sensor * problem.scale(self.output);
        let process =
            (0..problem.model().states().len()).map(|state| if state == self.state { led } else { 0.0 });
        let noise = Noise { process: process.collect(), measurement: measurement_variance(problem) };
        let mut along = problem.filter()?.filter(self.theta, &noise, problem.grid().len()).states;
        if along.iter().flatten().any(|value| !value.is_finite()) {
            return None;
        }
        let start = along.first()?.clone();
        let mut missing = vec![0.0; along.len()];
        let mut guess = begin;
        let mut settled = None;
        for round in 0..ROUNDS {
            // Where one more round leaves the numbers, the one before has to do.
            let Some(record) = LinearRecord::new(self, &along, &missing) else { break };
            let record = record.shown_along(self.state, &along, &missing, &start);
            if round < LIKELIEST_ROUNDS {
                guess = smoother::likeliest(&record, guess, begin, problem.brake());
            }
            let smoothed = smoother::smooth(&record, guess);
            let states = |mean: &DVector<f64>| mean.as_slice()[..record.rate()].to_vec();
            let next: Vec<Vec<f64>> = smoothed.iter().map(|(mean, _)| states(mean)).collect();
            if next.iter().flatten().any(|value| !value.is_finite()) {
                break;
            }
            let both = along.iter().flatten().zip(next.iter().flatten());
            let moved = both.map(|(from, to)| (to - from).abs()).fold(0.0, f64::max);
            along = next;
            missing =
                smoothed.iter().map(|(mean, _)| mean[record.rate()] + mean[record.rate() + 1]).collect();
            settled = Some((guess, record, smoothed));
            if moved < SETTLED * sensor * problem.scale(self.output) {
                break;
            }
        }
        settled
    }
}

/// How much a kilowatt changes the state per hour, and the parameter that says so: one that enters the
/// state's own equation as a rate per power. The power of a meter of which a part stays outside makes it too
/// small.
fn kilowatt(
    model: &Model,
    theta: &[f64],
    state: usize,
    is_sure: &dyn Fn(&str) -> bool,
) -> Option<(f64, String)> {
    let rate = Unit::parse(&format!("{}/h per kW", error_unit(&model.states()[state].unit))).ok()?;
    let graph = model.graph();
    let used = graph.reachable(&[model.rhs()[state]]);
    let enters = |index: usize| {
        graph.nodes().iter().zip(&used).any(|(node, used)| {
            *used && matches!(*node, Node::Param(parameter) if usize::from(parameter) == index)
        })
    };
    model.parameters().iter().enumerate().find_map(|(index, parameter)| {
        let factor = Unit::parse(&parameter.unit).ok()?.factor_to(&rate)?;
        let value = theta[index] * factor;
        (value > 0.0 && is_sure(&parameter.name) && enters(index)).then(|| (value, parameter.name.clone()))
    })
}

/// What it says, in plain sentences.
fn sentences(found: &MissingHeat) -> Vec<String> {
    let size = |rate: f64| match found.per_kilowatt {
        Some(per_kilowatt) => format!("{:.1} kW", rate.abs() / per_kilowatt),
        None => format!("{:.2} {}", rate.abs(), found.unit),
    };
    let what = |rate: f64| if rate > 0.0 { "more" } else { "less" };
    let known = found.hours.iter().filter(|hour| hour.rate.is_some()).count();
    if known == 0 {
        return vec!["Nothing can be said: the inputs are known nowhere for an hour.".to_owned()];
    }
    if found.events.is_empty() {
        return vec![format!(
            "No hour stands out: what is missing of {} comes and goes by little.",
            found.output
        )];
    }
    let days = |habit: &HeatHabit| match habit.on_working_days {
        share if share >= 0.9 => " on working days",
        share if share <= 0.1 => " at weekends",
        _ => "",
    };
    let one = |habit: &HeatHabit| {
        format!(
            "{} events, mostly {} to {} h{}: about {} {} than the model knows for {} h, every {:.1} days.",
            habit.events,
            habit.begins,
            habit.ends,
            days(habit),
            size(habit.rate),
            what(habit.rate),
            habit.hours,
            habit.every_days,
        )
    };
    let mut said: Vec<String> = found.habits.iter().take(TOLD).map(one).collect();
    let alone = found.events.len() - found.habits.iter().map(|habit| habit.events).sum::<usize>();
    if let Some(largest) = found.events.iter().max_by(|a, b| a.sum.abs().total_cmp(&b.sum.abs())) {
        let singles = match alone {
            0 => String::new(),
            1 => "One event is like no other. ".to_owned(),
            several => format!("{several} events are like no others. "),
        };
        said.push(format!(
            "{singles}The largest begins at {} and lasts {} h: {} {} than the model knows.",
            largest.from,
            largest.hours,
            size(largest.rate),
            what(largest.rate)
        ));
    }
    said
}
