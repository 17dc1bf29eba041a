//! Does the room notice its inputs? What the measurements say of each, beside what a fit claims.
//!
//! Two witnesses are heard. Along the fit, segments of hours with states of their own say whether an input
//! moves the room as the fit says (`segments`), over lengths up to a quarter of the record, because a wall
//! answers over days. The free regression (`regression`) knows no fit: it says whether the room follows the
//! input at all, with which sign, and whether another clock or another channel in its place would do better.
//! An input that is shown to be wrong is another matter than one that is merely not seen: behind a thermostat
//! the weather of a winter hardly is.

use super::opponents::{Match, with_regression};
use super::regression::{Followed, PairedComparison, Regression};
use crate::estimate::assess::metrics::{FilterRun, measurement_variance};
use crate::estimate::problem::Problem;
use crate::estimate::segments::{Explained, Segments};
use crate::simulate::Simulator;
use rayon::prelude::*;

/// A t from which on something is believed.
pub const BELIEVED: f64 = 3.0;
/// A t of the wrong sign from which on an input is called mirrored.
const MIRRORED: f64 = -3.5;
/// What is left of the squared error where the clock of a channel is late by some hours and is put right.
/// Nothing in a room comes before its cause.
const LATE: f64 = 0.88;
/// The same where the channel would have to be early: walls delay as well, up to half a day, so it takes
/// more.
const EARLY: f64 = 0.75;
/// What is left where two channels look exchanged.
const EXCHANGED: f64 = 0.75;
/// A channel that the regression needs this much, its squared error without it over that with it, cannot be
/// silent in a good fit.
const NEEDED: f64 = 1.25;
/// The t from which on a regression without a channel misses it.
const MISSED: f64 = -2.0;
/// A channel that daily shifts imitate this seldom is seen by the regression.
const IMITATED: f64 = 0.1;
/// How many times as much as the fit claims may be there before it is another thing.
const SIZES: std::ops::Range<f64> = 0.2..5.0;
/// Segments of a day and of four.
const LENGTHS: [f64; 2] = [24.0, 96.0];

/// What an input does in a model, by its channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Heat that the building makes or brings: water, power, valves.
    Heat,
    /// What the weather brings.
    Weather,
    /// A room next door.
    Neighbour,
}

impl Role {
    /// What the input of a channel does.
    pub fn of(channel: &str) -> Self {
        let weather = ["T_out", "sun_", "irradiance", "cloud_cover", "wind_"];
        match channel {
            channel if weather.iter().any(|start| channel.starts_with(start)) => Role::Weather,
            channel if channel.starts_with("T_room") => Role::Neighbour,
            _ => Role::Heat,
        }
    }
}

/// What may stand in the place of an input as it was logged.
#[derive(Debug, Clone, PartialEq)]
pub enum Rival {
    /// The channel is late by so many hours.
    Late(i64),
    /// It is early.
    Early(i64),
    /// Another channel of the model, by name.
    Exchanged(String),
}

/// What the measurements say of one input.
#[derive(Debug, Clone, PartialEq)]
pub struct InputEvidence {
    /// Its channel.
    pub channel: String,
    /// What it does.
    pub role: Role,
    /// How much of what the fit claims is there, over the length of segments that shows it best, and that
    /// length in hours.
    pub claimed: Option<(Explained, f64)>,
    /// Whether the fit lets the room rise with it.
    pub rises: bool,
    /// What the free regression says.
    pub followed: Option<Followed>,
    /// The share of shifts by whole days that do as well in the regression.
    pub shift_p: Option<f64>,
    /// The best of what may stand in its place.
    pub rival: Option<(Rival, PairedComparison)>,
}

/// What the measurements say of all inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// One for each driving input of the model.
    pub inputs: Vec<InputEvidence>,
    /// The best of other clocks for the room itself, where all inputs are shifted together: late by so many
    /// hours.
    pub clock: Option<(i64, PairedComparison)>,
    /// The fit beside the regression on unseen data.
    pub beside_regression: Option<Match>,
    /// What moves the room within a day beside what the fit can explain, on a usual day, in deviations of the
    /// sensor's noise.
    pub unexplained: Option<f64>,
}

impl Evidence {
    /// Hears all inputs of a fit whose filter has run.
    pub fn of(problem: &Problem, theta: &[f64], run: &FilterRun) -> Self {
        let regression = Regression::new(problem);
        // What takes hours is seen at every half hour as well.
        let coarser = problem.coarser();
        let along = coarser.as_ref().unwrap_or(problem);
        let longest = 0.25 * along.grid().len() as f64 * along.grid().step_hours();
        let lengths: Vec<f64> =
            LENGTHS.iter().copied().filter(|hours| *hours <= longest.max(LENGTHS[0])).collect();
        let points = (along.grid().step() / problem.grid().step()) as usize;
        let states: Vec<&[f64]> = run.filtered.states.iter().step_by(points).map(Vec::as_slice).collect();
        let looks: Vec<Look> =
            lengths.iter().filter_map(|hours| Look::new(along, theta, &states, *hours)).collect();
        let inputs = (0..problem.model().inputs().len())
            .into_par_iter()
            .filter_map(|input| hear(along, &looks, regression.as_ref(), input));
        let mut inputs: Vec<InputEvidence> = inputs.collect();
        let beside_regression =
            regression.as_ref().and_then(|regression| with_regression(problem, theta, run, regression));
        // A rival shows something only where the regression with it forecasts better than the fit does
        // without.
        let better = |compared: &PairedComparison| {
            beside_regression.is_none_or(|met| compared.ratio.sqrt() < met.ratio())
        };
        inputs
            .iter_mut()
            .for_each(|input| input.rival = input.rival.take().filter(|(_, compared)| better(compared)));
        let clock = regression.as_ref().and_then(clock).filter(|(_, compared)| better(compared));
        let noise = measurement_variance(problem)[0].sqrt() / problem.scale(0);
        Self {
            inputs,
            clock,
            beside_regression,
            unexplained: looks.first().map(|look| look.unexplained() / noise),
        }
    }

    /// The channels of some inputs, as a list.
    pub fn names(&self, which: impl Fn(&InputEvidence) -> bool) -> String {
        let names: Vec<&str> =
            self.inputs.iter().filter(|input| which(input)).map(|input| input.channel.as_str()).collect();
        names.join(", ")
    }

    /// The input of which the fit claims what is there least: the one to look at first.
    pub fn least_heard(&self) -> Option<&str> {
        let strange = |input: &InputEvidence| match input.claimed {
            Some((explained, _)) if explained.t >= BELIEVED => explained.size.max(1e-3).ln().abs(),
            _ => f64::INFINITY,
        };
        let worth =
            |input: &&InputEvidence| input.followed.is_some_and(|followed| followed.without.t <= MISSED);
        let followed =
            self.inputs.iter().filter(worth).max_by(|one, other| strange(one).total_cmp(&strange(other)));
        followed.map(|input| input.channel.as_str())
    }

    /// Whether anything that was logged is seen to move the room.
    pub fn anything_seen(&self) -> bool {
        self.inputs.iter().any(InputEvidence::is_seen)
    }
}

impl InputEvidence {
    /// Whether what the fit claims of the input is there.
    fn is_as_claimed(&self) -> bool {
        self.claimed.is_some_and(|(explained, _)| explained.t >= BELIEVED && SIZES.contains(&explained.size))
    }

    /// Whether the room is seen to follow the input.
    pub fn is_seen(&self) -> bool {
        let claimed = self.is_as_claimed();
        let followed = self
            .followed
            .is_some_and(|followed| followed.gain_t.abs() >= BELIEVED && followed.without.t <= MISSED);
        claimed || followed && self.shift_p.is_some_and(|p| p <= IMITATED)
    }

    /// Whether the room rises where the fit lets it fall, or the other way round, and the fit's own witness
    /// does not contradict.
    pub fn is_mirrored(&self) -> bool {
        let sign = if self.rises { 1.0 } else { -1.0 };
        !self.is_as_claimed()
            && self
                .followed
                .is_some_and(|followed| sign * followed.gain_t <= MIRRORED && followed.without.t <= MISSED)
    }

    /// Whether the room plainly follows the channel and the fit does not.
    pub fn is_unheard(&self) -> bool {
        let followed = |followed: Followed| {
            followed.gain_t >= BELIEVED + 1.0
                && followed.without.ratio >= NEEDED
                && followed.without.t <= -BELIEVED
        };
        self.followed.is_some_and(followed)
            && self.claimed.is_some_and(|(explained, _)| explained.t < BELIEVED)
    }

    /// What would stand in its place clearly better.
    pub fn better(&self) -> Option<&(Rival, PairedComparison)> {
        self.rival.as_ref().filter(|(rival, compared)| {
            let limit = match rival {
                Rival::Late(_) if self.role == Role::Heat || self.channel == "T_out" => LATE,
                // A facade sees its sun hours before or after noon, so only much is a clock, and neighbours
                // lead each other.
                Rival::Late(_) | Rival::Early(_) => EARLY,
                Rival::Exchanged(_) => EXCHANGED,
            };
            compared.ratio <= limit && compared.t >= BELIEVED
        })
    }
}

/// A fit along segments of one length.
struct Look<'a> {
    hours: f64,
    problem: &'a Problem,
    theta: &'a [f64],
    segments: Segments,
    starts: Vec<Vec<f64>>,
    /// What the fit simulates.
    outputs: Vec<f64>,
}

impl<'a> Look<'a> {
    /// Over segments of so many hours, each of which starts from the state that a filter has at its sample.
    fn new(problem: &'a Problem, theta: &'a [f64], states: &[&[f64]], hours: f64) -> Option<Self> {
        let segments = Segments::new(problem, 0..problem.grid().len(), hours)?;
        if segments.is_empty() {
            return None;
        }
        let starts: Vec<Vec<f64>> = segments.first_samples().map(|k| states[k].to_vec()).collect();
        let outputs = segments.outputs(problem, problem.simulator(), &[theta], &starts).remove(0);
        Some(Self { hours, problem, theta, segments, starts, outputs })
    }

    /// What neither starts nor parameters explain, root mean square on the middle one of the days: a spike is
    /// no day.
    fn unexplained(&self) -> f64 {
        let linear =
            self.segments.linearise(self.problem, self.problem.simulator(), self.theta, &self.starts);
        linear.map_or(f64::INFINITY, |linear| {
            let rest = linear.without_parameters(&linear.residual);
            let (squares, counts) =
                (self.segments.by_day(|row| rest[row] * rest[row]), self.segments.by_day(|_| 1.0));
            let mut days: Vec<f64> =
                squares.iter().zip(counts).map(|(sum, count)| (sum / count).sqrt()).collect();
            days.sort_by(f64::total_cmp);
            days[days.len() / 2]
        })
    }

    /// How much of what the fit lets an input's changes do is there, beside the same model in which the input
    /// stands `still`.
    fn claimed(&self, still: &Simulator) -> Option<Explained> {
        let linear = self.segments.linearise(self.problem, still, self.theta, &self.starts)?;
        let moves =
            self.outputs.iter().zip(&linear.simulated).map(|(with, without)| with - without).collect();
        let direction = linear.without_parameters(&self.segments.without_starts(&linear, moves));
        self.segments.explained(&linear.without_parameters(&linear.residual), &direction)
    }

    /// Whether the fit lets the room rise with an input.
    fn rises(&self, input: usize) -> bool {
        let (inputs, simulator) = (self.problem.inputs(), self.problem.simulator());
        let (low, high) = inputs.range(input);
        let higher: Vec<f64> = inputs.values(input).iter().map(|value| value + 0.1 * (high - low)).collect();
        let outputs = self
            .segments
            .outputs(
                self.problem,
                &simulator.with_inputs(&inputs.with_values(input, higher)),
                &[self.theta],
                &self.starts,
            )
            .remove(0);
        outputs.iter().zip(&self.outputs).map(|(higher, as_logged)| higher - as_logged).sum::<f64>() >= 0.0
    }
}

fn hear(
    problem: &Problem,
    looks: &[Look],
    regression: Option<&Regression>,
    input: usize,
) -> Option<InputEvidence> {
    let channel = problem.model().inputs()[input].channel.clone();
    // What follows the clock or the room itself was not logged, and proves nothing.
    if !super::regression::drives(problem, input) {
        return None;
    }
    let (inputs, simulator) = (problem.inputs(), problem.simulator());
    let still = simulator.with_inputs(&inputs.with_values(input, vec![inputs.mean(input); inputs.samples()]));
    let claims = looks.iter().filter_map(|look| Some((look.claimed(&still)?, look.hours)));
    let claimed = claims.max_by(|(one, _), (other, _)| one.t.total_cmp(&other.t));
    let beside = regression.and_then(|regression| regression.beside(input));
    let role = Role::of(&channel);
    let rivals = beside.as_ref().map(|beside| {
        let shifts = match role {
            Role::Heat => vec![3, 6, 12, -6, -12],
            _ if channel == "T_out" => vec![3, 6, 12, -12],
            _ => vec![6, 12, -6, -12],
        };
        let clock = |hours: i64| if hours > 0 { Rival::Late(hours) } else { Rival::Early(-hours) };
        let unit = |input: usize| &problem.model().inputs()[input].unit;
        let others = regression
            .into_iter()
            .flat_map(Regression::inputs)
            .filter(|other| *other != input && unit(*other) == unit(input));
        let others = others.filter(|_| unit(input) != "-");
        let exchanged = others.filter_map(|other| {
            Some((
                Rival::Exchanged(problem.model().inputs()[other].channel.clone()),
                beside.exchanged(other)?,
            ))
        });
        let shifted = shifts.into_iter().filter_map(|hours| Some((clock(hours), beside.shifted(hours)?)));
        shifted.chain(exchanged).collect::<Vec<(Rival, PairedComparison)>>()
    });
    let rival = rivals.into_iter().flatten().min_by(|(_, one), (_, other)| one.ratio.total_cmp(&other.ratio));
    // The sine of the sun's height takes part, and clouds with the sign of what they take away.
    let rises = channel == "cloud_cover" || looks.first().is_none_or(|look| look.rises(input));
    let followed = beside.as_ref().map(|beside| beside.followed());
    let shift_p = beside
        .as_ref()
        .filter(|_| role != Role::Weather || channel == "T_out")
        .map(|beside| beside.shift_p());
    Some(InputEvidence { channel, role, claimed, rises, followed, shift_p, rival })
}

/// The best other clock of the room itself.
fn clock(regression: &Regression) -> Option<(i64, PairedComparison)> {
    let clocks =
        regression.with_all_shifted(&[-3, -6, -12, 3, 6, 12]).map(|(hours, compared)| (-hours, compared));
    clocks.min_by(|(_, one), (_, other)| one.ratio.total_cmp(&other.ratio))
}
