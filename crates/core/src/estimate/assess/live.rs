//! States that go on with every sample: the end of a filter is kept, so that a sample costs one step however
//! long the record is.

use super::metrics::{CurrentState, FilterRun, noise_of};
use crate::data::{Grid, Window};
use crate::estimate::fit::Fit;
use crate::estimate::problem::Problem;
use crate::estimate::problem::basis::Basis;
use crate::estimate::problem::predictor::Predictor;
use crate::estimate::problem::request::{Columns, with_computed};
use crate::model::{InputHold, Model};
use crate::simulate::drive::samples_back;
use crate::simulate::kalman::{Kalman, Noise};
use crate::simulate::predict::Belief;
use crate::simulate::trajectory::MeasuredOutput;
use crate::simulate::{Inputs, Simulator};

/// So many steps of a channel tell how far apart its samples are.
const STEPS_TOLD: i64 = 12;
/// Most steps that are made up for at once; what stood still for longer is filtered anew.
const MOST_STEPS: i64 = 2_000;

/// A filter at the newest sample that it has seen, with what it needs to go on.
#[derive(Debug)]
pub struct LiveStates {
    model: Model,
    theta: Vec<f64>,
    noise: Noise,
    basis: Basis,
    /// Seconds between two samples of the filter.
    step: i64,
    substeps: usize,
    /// How many samples back delayed inputs are looked at.
    past: usize,
    /// How many milliseconds of measurements it reads before `at`.
    reach: i64,
    at: i64,
    belief: Belief,
}

impl LiveStates {
    /// The end of a filter run with the parameters of a fit; `None` for a model that is not filtered, whose
    /// states are those of a free run.
    pub fn begin(problem: &Problem, fit: &Fit, run: &FilterRun, measured: &Window) -> Option<Self> {
        let (model, grid) = (problem.model(), problem.grid());
        if problem.predictor() == Predictor::FreeRun {
            return None;
        }
        let reached = run.filtered.reached;
        let past = (0..model.inputs().len())
            .map(|input| samples_back(model.longest_delay(input), grid.step_hours()))
            .max()
            .unwrap_or(0);
        let inputs = model.inputs().iter().map(|input| &input.channel);
        let channels = model.outputs().iter().map(|output| &output.channel).chain(inputs);
        let longest = channels.filter_map(|channel| measured.series(channel)?.median_step()).max();
        let told = STEPS_TOLD * longest.unwrap_or(0).max(grid.step());
        Some(Self {
            theta: fit.theta(),
            noise: noise_of(problem, fit),
            basis: problem.basis().clone(),
            step: grid.step(),
            substeps: problem.simulator().substeps(),
            past,
            reach: told.max(past as i64 * grid.step()),
            at: grid.time(reached),
            belief: Belief {
                states: run.filtered.states.get(reached)?.clone(),
                covariance: run.filtered.covariance.clone(),
            },
            model: model.clone(),
        })
    }

    /// The instant of the states, in milliseconds.
    pub fn at(&self) -> i64 {
        self.at
    }

    /// The next instant at which there can be states, in milliseconds.
    pub fn next(&self) -> i64 {
        self.at + self.step
    }

    /// The first instant of the measurements that it reads to go on, in milliseconds.
    pub fn needs_from(&self) -> i64 {
        self.at - self.reach
    }

    /// Goes on as far as all inputs are measured, over what was measured since
    /// [`LiveStates::needs_from`]; `None` where that is not a step.
    pub fn go_on(&mut self, measured: &Window) -> Option<CurrentState> {
        let steps = ((self.settled(measured)? - self.at) / self.step).min(MOST_STEPS);
        let steps = usize::try_from(steps).ok().filter(|steps| *steps > 0)?;
        let start = self.at - self.past as i64 * self.step;
        let frame = Grid::new(start, self.step, self.past + steps + 1).ok()?;
        let grid = measured.grid_on(frame, &Columns::of(&self.model, measured).request()).ok()?;
        let grid = with_computed(grid, &self.model, &self.basis).ok()?;
        let inputs = Inputs::new(&self.model, &grid).ok()?;
        let known = (self.past..self.past + steps).take_while(|k| inputs.known(*k)).count();
        if known == 0 {
            return None;
        }
        let columns: Option<Vec<MeasuredOutput>> = self
            .model
            .outputs()
            .iter()
            .map(|output| grid.column(&output.channel).map(|column| (column.values(), column.valid())))
            .collect();
        let columns = columns?;
        let simulator = Simulator::new(&self.model, &inputs, &columns, self.model.stepper(), self.substeps);
        let kalman = Kalman::new(&self.model, &simulator, &columns);
        let last = self.past + known;
        let advanced = kalman.go_on(&self.theta, &self.noise, &self.belief, (self.past, last));
        let Belief { states, covariance } = &advanced.belief;
        let n = states.len();
        let deviations: Vec<f64> = (0..n).map(|i| covariance[i * n + i].max(0.0).sqrt()).collect();
        let at = grid.time(last);
        let state =
            CurrentState::of(&self.model, at, (states, &deviations, covariance), &advanced.innovations)?;
        (self.at, self.belief) = (at, advanced.belief);
        Some(state)
    }

    /// The instant up to which the first output and all inputs will stay as they are, whatever comes later.
    fn settled(&self, measured: &Window) -> Option<i64> {
        let first = measured.series(&self.model.outputs().first()?.channel)?.to();
        let inputs = self.model.inputs().iter().filter_map(|input| {
            let series = measured.series(&input.channel)?;
            Some(match input.hold {
                InputHold::Linear => series.to(),
                // Its last value holds for a step.
                InputHold::ZeroOrder => series.to() + series.median_step().unwrap_or(0),
            })
        });
        Some(inputs.fold(first, i64::min))
    }
}
