//! Where the hours to come begin, and what drives them.

use super::inputs::InputsToCome;
use crate::data::HOUR;
use crate::data::{Duration, Grid, Series, Window, rfc3339};
use crate::estimate::assess::metrics::noise_of;
use crate::estimate::assess::replay::Replay;
use crate::estimate::fit::Fit;
use crate::estimate::problem::Problem;
use crate::estimate::problem::request::{Columns, with_computed};
use crate::fault::Fault;
use crate::model::{Input, InputHold, Model};
use crate::simulate::Inputs;
use crate::simulate::drive::samples_back;
use crate::simulate::kalman::{Filtered, Kalman, Noise};
use crate::simulate::predict::Belief;

/// The longest forecast.
pub const LONGEST: Duration = Duration::from_days(10);
/// Most steps of a forecast.
const MOST_STEPS: i64 = 2_880;

/// What is forecast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForecastAsked {
    /// How far ahead.
    pub horizon: Duration,
    /// The step between the instants of the forecast.
    pub step: Duration,
    /// What was measured after this instant, in milliseconds, is not looked at.
    pub until: Option<i64>,
}

/// The newest measurement of a replay, and the inputs from there on.
pub(super) struct Onward<'a> {
    pub problem: &'a Problem,
    filter: Kalman<'a>,
    pub noise: Noise,
    /// The newest sample at which something was measured.
    pub now: usize,
    /// As much of the past as delays look back at, and the instants to come.
    pub grid: Grid,
    /// The sample of it that is now.
    pub past: usize,
    pub inputs: Inputs,
}

impl<'a> Onward<'a> {
    /// What is asked from the newest measurement of a replay on. `measured` holds what was measured.
    pub fn new(
        replay: &'a Replay,
        fit: &Fit,
        measured: &Window,
        to_come: &InputsToCome,
        asked: ForecastAsked,
    ) -> Result<Self, Vec<Fault>> {
        let problem = replay.problem();
        let Some(filter) = problem.filter() else {
            let detail =
                "the states of this model cannot be estimated again, so there is nothing to start from";
            return Err(vec![Fault::new("/model", "no-filter", detail)]);
        };
        let steps = steps(asked)?;
        let now = newest(problem, asked.until)?.min(filter.reached(problem.grid().len()));
        let (at, step) = (problem.grid().time(now), asked.step.millis());
        let grid = grid(problem, measured, to_come, (at, step, steps))?;
        let past = grid.index_at(at).unwrap_or(0);
        let inputs = Inputs::new(problem.model(), &grid)?;
        require_known(problem.model(), &grid, &inputs, past)?;
        Ok(Self { problem, filter, noise: noise_of(problem, fit), now, grid, past, inputs })
    }

    /// What was filtered up to the newest measurement.
    pub fn filtered(&self, theta: &[f64]) -> Filtered {
        self.filter.filter(theta, &self.noise, self.now + 1)
    }

    /// What is believed of the states at the newest measurement.
    pub fn belief(&self, theta: &[f64]) -> Belief {
        Belief::of(self.filtered(theta))
    }
}

/// The newest measurement of a replay up to an instant, in milliseconds.
///
/// # Errors
/// A fault where nothing was measured.
pub(super) fn newest_of(replay: &Replay, until: Option<i64>) -> Result<i64, Vec<Fault>> {
    Ok(replay.problem().grid().time(newest(replay.problem(), until)?))
}

/// The inputs of a model as they were last measured at an instant, standing still from there to another one.
pub(super) fn standing_still(
    replay: &Replay,
    measured: &Window,
    at: i64,
    until: i64,
) -> Result<Window, Vec<Fault>> {
    let last = |input: &Input| {
        let series = measured.series(&input.channel)?.slice(i64::MIN, at)?;
        let value = *series.values().last()?;
        Some(Series::new(series.channel(), series.unit(), series.hold(), vec![at, until], vec![value; 2]))
    };
    let inputs = replay.problem().model().inputs();
    let is_first =
        |(place, input): &(usize, &Input)| inputs[..*place].iter().all(|one| one.channel != input.channel);
    let firsts = inputs.iter().enumerate().filter(is_first).map(|(_, input)| input);
    let series: Result<Vec<Series>, Fault> = firsts.filter_map(last).collect();
    Window::from_series(series.map_err(|fault| vec![fault])?)
}

/// How many steps a forecast has.
fn steps(asked: ForecastAsked) -> Result<usize, Vec<Fault>> {
    let (horizon, step) = (asked.horizon.millis(), asked.step.millis());
    let mut faults = Vec::new();
    if horizon <= 0 || horizon > LONGEST.millis() {
        let detail = format!("a forecast looks ahead by up to {LONGEST}, and by more than nothing");
        faults.push(Fault::new("/horizon", "out-of-range", detail));
    }
    if step <= 0 || step > horizon || horizon / step.max(1) > MOST_STEPS {
        let detail = format!("a step is at most the horizon, and {MOST_STEPS} are the most");
        faults.push(Fault::new("/step", "out-of-range", detail));
    }
    if faults.is_empty() { Ok((horizon / step) as usize) } else { Err(faults) }
}

/// The newest sample up to an instant at which something was measured.
fn newest(problem: &Problem, until: Option<i64>) -> Result<usize, Vec<Fault>> {
    let (measured, grid) = (problem.measured(), problem.grid());
    let is_measured = |k: &usize| {
        until.is_none_or(|until| grid.time(*k) <= until) && measured.iter().any(|(_, valid)| valid[*k])
    };
    (0..grid.len()).rev().find(is_measured).ok_or_else(|| {
        let detail = format!(
            "nothing is measured from which a forecast could start: the fit's window begins at {}",
            rfc3339(grid.start())
        );
        vec![Fault::new("/at", "no-data", detail)]
    })
}

/// The grid of a forecast: as much of the past as delays look back at, and the instants to come.
fn grid(
    problem: &Problem,
    measured: &Window,
    to_come: &InputsToCome,
    (at, step, steps): (i64, i64, usize),
) -> Result<Grid, Vec<Fault>> {
    let model = problem.model();
    let hours = step as f64 / HOUR as f64;
    let past = (0..model.inputs().len())
        .map(|input| samples_back(model.longest_delay(input), hours))
        .max()
        .unwrap_or(0);
    let frame = Grid::new(at - past as i64 * step, step, past + steps + 1).map_err(|fault| vec![fault])?;
    let known = measured
        .iter()
        .filter(|series| problem.basis().channels.iter().any(|channel| channel == series.channel()));
    // What was measured of a channel that is given anew counts up to there.
    let before = |series: &Series| match to_come.of(series.channel()) {
        Some(input) => series.slice(series.from(), input.since - 1),
        None => Some(series.clone()),
    };
    let window = to_come.behind(Window::from_series(known.filter_map(before).collect())?)?;
    let columns = Columns::of(model, &window);
    let grid = window.grid_on(frame, &columns.request())?;
    let grid = to_come.laid_on(grid).map_err(|fault| vec![fault])?;
    with_computed(grid, model, problem.basis())
}

/// Refuses inputs that end before the forecast does, each by name.
fn require_known(model: &Model, grid: &Grid, inputs: &Inputs, past: usize) -> Result<(), Vec<Fault>> {
    let last = grid.len() - 1;
    if (past..last).all(|k| inputs.known(k)) {
        return Ok(());
    }
    let fault = |input: &Input| {
        let valid = grid.column(&input.channel)?.valid();
        // What goes in a straight line has to be known where it ends.
        let needed = last + usize::from(input.hold == InputHold::Linear);
        let end = (past..needed).find(|k| !valid[*k])?;
        let detail = format!(
            "`{}` is not known at {}: give it to the end of the forecast, {}",
            input.channel,
            rfc3339(grid.time(end)),
            rfc3339(grid.time(last))
        );
        Some(Fault::new(format!("/inputs/values/{}", input.channel), "input-ends", detail))
    };
    let faults: Vec<Fault> = model.inputs().iter().filter_map(fault).collect();
    if faults.is_empty() {
        let detail = "the inputs are not known to the end of the forecast";
        return Err(vec![Fault::new("/inputs", "input-ends", detail)]);
    }
    Err(faults)
}
