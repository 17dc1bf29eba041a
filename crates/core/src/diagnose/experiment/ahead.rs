//! The days to come: the weather of the last such days, the inputs of a plan, and where the model goes.

use super::information::Knowledge;
use super::plans::DrivenInput;
use super::whole_days::WholeDays;
use crate::data::{Column, Grid};
use crate::estimate::Problem;
use crate::estimate::forecast::InputsToCome;
use crate::fault::Fault;
use crate::simulate::drive::samples_back;
use crate::simulate::kalman::Noise;
use crate::simulate::predict::Belief;

/// The days to come as they would be if nobody drove anything.
pub(super) struct DaysToCome<'a> {
    problem: &'a Problem,
    noise: &'a Noise,
    /// As much of the record as delays look back at, and the days to come.
    pub grid: Grid,
    /// The sample of it that is now.
    pub past: usize,
}

/// Where the model goes in the days to come, from now on.
pub(super) struct DrivenCourse {
    pub states: Vec<Vec<f64>>,
    pub outputs: Vec<Vec<f64>>,
    pub output_deviations: Vec<Vec<f64>>,
}

impl<'a> DaysToCome<'a> {
    /// So many days behind the record of a problem. Every channel repeats the last such days, or where these
    /// are to be passed over so often earlier ones, but for those that are forecast.
    ///
    /// # Errors
    /// Where the record is shorter than these days, or its step no part of a day.
    pub fn new(
        problem: &'a Problem,
        noise: &'a Noise,
        (days, back): (usize, usize),
        forecast: &InputsToCome,
    ) -> Result<Self, Vec<Fault>> {
        let record = problem.grid();
        let per_day = WholeDays::of(problem, 0).map_err(|fault| vec![fault])?.per_day;
        let (samples, last) = (days * per_day, record.len() - 1);
        if samples * (back + 1) > last {
            let detail = format!("the record of the fit is shorter than {days} days");
            return Err(vec![Fault::new("/days", "too-long", detail)]);
        }
        let model = problem.model();
        let reach = |input| samples_back(model.longest_delay(input), record.step_hours());
        let past = (0..model.inputs().len()).map(reach).max().unwrap_or(0).min(last);
        let start = record.time(last - past);
        let mut grid = Grid::new(start, record.step(), past + samples + 1).map_err(|fault| vec![fault])?;
        for (channel, column) in record.columns() {
            // Up to now as it was, then the days once more.
            let end = last - back * samples;
            let order = (last - past..last).chain(end - samples..=end);
            let values: Vec<f64> = order.map(|k| column.values()[k]).collect();
            let complete = Column::complete(column.unit(), column.hold(), values);
            grid =
                complete.and_then(|column| grid.with_column(channel, column)).map_err(|fault| vec![fault])?;
        }
        let grid = forecast.laid_on(grid).map_err(|fault| vec![fault])?;
        Ok(Self { problem, noise, grid, past })
    }

    /// What the driven inputs are if nobody drives them, from where they are now, within their ranges.
    pub fn usual(&self, inputs: &[DrivenInput]) -> Result<Vec<Vec<f64>>, Fault> {
        let record = self.problem.grid();
        let one = |input: &DrivenInput| {
            let mut values = self.grid.require(&input.channel)?.values()[self.past..].to_vec();
            let now = record.require(&input.channel)?.values().last();
            values.iter_mut().zip(now).for_each(|(value, now)| *value = *now);
            let [low, high] = input.range;
            values.iter_mut().for_each(|value| *value = value.clamp(low, high));
            Ok(values)
        };
        inputs.iter().map(one).collect()
    }

    /// The problem of the days to come under these inputs.
    pub fn driven(&self, inputs: &[DrivenInput], plan: &[Vec<f64>]) -> Result<Problem, Vec<Fault>> {
        let mut grid = self.grid.clone();
        for (input, values) in inputs.iter().zip(plan) {
            let fault = |fault| vec![fault];
            let column = grid.require(&input.channel).map_err(fault)?;
            let known = column.values()[..self.past].iter().chain(values).copied().collect();
            let column = Column::complete(column.unit(), column.hold(), known).map_err(fault)?;
            grid = grid.with_column(&input.channel, column).map_err(fault)?;
        }
        self.problem.on(grid)
    }

    /// What is believed of the states now. `None` of a model without a filter.
    pub fn belief(&self, theta: &[f64]) -> Option<Belief> {
        let filter = self.problem.filter()?;
        Some(Belief::of(filter.filter(theta, self.noise, self.problem.grid().len())))
    }

    /// Where the model goes under inputs, from what is believed now; `None` where it leaves the numbers.
    pub fn course(&self, driven: &Problem, theta: &[f64], belief: &Belief) -> Option<DrivenCourse> {
        let found = driven.filter()?.predict(theta, self.noise, self.past, belief);
        let whole = found.states.len() == self.grid.len() - self.past;
        let is_finite = found.outputs.iter().flatten().all(|value| value.is_finite());
        (whole && is_finite).then_some(DrivenCourse {
            states: found.states,
            outputs: found.outputs,
            output_deviations: found.output_deviations,
        })
    }

    /// What is known behind such days.
    pub fn learnt(&self, known: &Knowledge, driven: &Problem, course: &DrivenCourse) -> Option<Knowledge> {
        known.with(driven, self.past, &course.states)
    }
}
