//! What all candidates of a simulation share: the inputs of a window, evaluated once for every step.

use crate::data::Grid;
use crate::fault::Fault;
use crate::model::expr::Point;
use crate::model::spec::AS_IT_COMES;
use crate::model::tape::{DelayedInput, SharedLeaf, SharedStage, Tape};
use crate::model::{Held, InputHold, Model, WarmUp};
use crate::simulate::dual::Scalar;
use crate::simulate::lanes::{LANES, LaneFile};
use crate::simulate::registers::Registers;
use crate::units::Unit;
use std::ops::Range;
use std::sync::Arc;

/// The inputs of a model on a grid, in the units of its equations.
///
/// A delayed input needs its past: an interval is known where the input was known as far back as the longest
/// delay that the model declares. At the start of a window that past is missing, as it is behind a gap.
/// Copies share the values.
#[derive(Debug, Clone)]
pub struct Inputs {
    columns: Vec<(InputHold, Arc<[f64]>)>,
    /// Whether all inputs are known from sample `k` to sample `k + 1`.
    known: Arc<[bool]>,
    hours: f64,
    /// The samples over whose mean a warm-up goes that takes the record's own.
    averaged: Range<usize>,
}

impl Inputs {
    /// Reads the model's inputs from a grid.
    ///
    /// # Errors
    /// Every input whose channel is missing or has a unit that does not convert.
    pub fn new(model: &Model, grid: &Grid) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        let mut columns = Vec::new();
        let intervals = grid.len().saturating_sub(1);
        let mut known = vec![true; intervals];
        for (index, input) in model.inputs().iter().enumerate() {
            let pointer = format!("/channels/{}", input.channel);
            let Some(column) = grid.column(&input.channel) else {
                faults.push(Fault::new(
                    pointer,
                    "missing-channel",
                    format!("the model needs the channel `{}`", input.channel),
                ));
                continue;
            };
            let wanted = if input.unit == AS_IT_COMES { column.unit() } else { &input.unit };
            let converter = Unit::parse(column.unit()).ok().zip(Unit::parse(wanted).ok());
            let convert = |value: f64| converter.and_then(|(from, to)| from.convert(&to, value));
            if convert(0.0).is_none() {
                let detail = format!(
                    "`{}` is in {}, which does not convert to {}",
                    input.channel,
                    column.unit(),
                    input.unit
                );
                faults.push(Fault::new(pointer, "unit", detail));
                continue;
            }
            let reach = samples_back(model.longest_delay(index), grid.step_hours());
            let mut run = 0;
            for (k, known) in known.iter_mut().enumerate() {
                let measured =
                    column.valid()[k] && (input.hold == InputHold::ZeroOrder || column.valid()[k + 1]);
                run = if measured { run + 1 } else { 0 };
                *known &= run > reach;
            }
            let values = match column.unit() == wanted {
                true => column.shared().0,
                false => column.values().iter().map(|value| convert(*value).unwrap_or(*value)).collect(),
            };
            columns.push((input.hold, values));
        }
        if faults.is_empty() {
            Ok(Self { columns, known: known.into(), hours: grid.step_hours(), averaged: 0..grid.len() })
        } else {
            Err(faults)
        }
    }

    /// Inputs that stay at these values for so many hours, with samples `hours` apart: the stress tests of
    /// the validation gate.
    pub fn constant(model: &Model, values: &[f64], intervals: usize, hours: f64) -> Self {
        Self::from_columns(model, values.iter().map(|value| vec![*value; intervals + 1]).collect(), hours)
    }

    /// The constant inputs of a model's warm-up, over one interval of so many hours.
    pub fn of_warm_up(&self, warm_up: &WarmUp, hours: f64) -> Self {
        let samples: Vec<usize> = self.averaged.clone().filter(|k| self.known(*k)).collect();
        let constant = |((hold, values), held): (&(InputHold, Arc<[f64]>), &Held)| {
            let value = match held {
                Held::Value(value) => *value,
                Held::First => values.first().copied().unwrap_or(f64::NAN),
                Held::Mean => samples.iter().map(|k| values[*k]).sum::<f64>() / samples.len() as f64,
            };
            (*hold, [value; 2].into())
        };
        Self {
            columns: self.columns.iter().zip(&warm_up.inputs).map(constant).collect(),
            known: [true].into(),
            hours,
            averaged: 0..2,
        }
    }

    /// The same inputs, of which a warm-up that goes over the record's own mean takes that over these
    /// samples.
    #[must_use]
    pub fn averaged_over(self, samples: Range<usize>) -> Self {
        Self { averaged: samples, ..self }
    }

    /// Inputs from one series per input of the model, all known, in the units of its equations.
    pub fn from_columns(model: &Model, columns: Vec<Vec<f64>>, hours: f64) -> Self {
        let intervals = columns.iter().map(Vec::len).min().unwrap_or(1).saturating_sub(1);
        let columns =
            model.inputs().iter().zip(columns).map(|(input, values)| (input.hold, values.into())).collect();
        Self { columns, known: vec![true; intervals].into(), hours, averaged: 0..intervals }
    }

    /// Inputs of a model that has none, for so many samples.
    #[cfg(test)]
    pub(super) fn from_columns_with_length(model: &Model, samples: usize, hours: f64) -> Self {
        Self { known: vec![true; samples - 1].into(), ..Self::from_columns(model, Vec::new(), hours) }
    }

    /// Makes the inputs unknown over these intervals.
    #[cfg(test)]
    pub(super) fn forget(&mut self, intervals: Range<usize>) {
        Arc::make_mut(&mut self.known)[intervals].fill(false);
    }

    /// The same inputs, unknown as well over the intervals at which `known` is false.
    #[must_use]
    pub fn masked(&self, known: &[bool]) -> Self {
        let both = self
            .known
            .iter()
            .enumerate()
            .map(|(k, own)| *own && known.get(k).copied().unwrap_or(true))
            .collect();
        Self { known: both, ..self.clone() }
    }

    /// Hours between two samples.
    pub fn hours(&self) -> f64 {
        self.hours
    }

    /// Whether all inputs are known from sample `k` to the next.
    pub fn known(&self, k: usize) -> bool {
        self.known.get(k).copied().unwrap_or(false)
    }

    /// How many samples there are.
    pub fn samples(&self) -> usize {
        self.known.len() + 1
    }

    /// Smallest and largest value of an input.
    pub fn range(&self, input: usize) -> (f64, f64) {
        let values = &self.columns[input].1;
        (
            values.iter().copied().fold(f64::INFINITY, f64::min),
            values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        )
    }

    /// The value of an input at a sample.
    pub fn at(&self, input: usize, k: usize) -> f64 {
        self.columns[input].1[k]
    }

    /// The values of an input at all samples, in the unit of the equations.
    pub fn values(&self, input: usize) -> &[f64] {
        &self.columns[input].1
    }

    /// The same inputs with other values of one of them, as many as there are samples.
    #[must_use]
    pub fn with_values(&self, input: usize, values: Vec<f64>) -> Self {
        let mut inputs = self.clone();
        inputs.columns[input].1 = values.into();
        inputs
    }

    /// The mean of an input over the window.
    pub fn mean(&self, input: usize) -> f64 {
        let values = &self.columns[input].1;
        values.iter().sum::<f64>() / values.len().max(1) as f64
    }

    /// The value of an input at a position that is counted in samples, as a delayed one is looked up.
    pub fn past(&self, input: usize, position: f64) -> f64 {
        let (hold, values) = &self.columns[input];
        value_at(*hold, values, position)
    }

    /// What a leaf is in each of these steps: of a sample's interval, and so far into it.
    #[inline]
    fn leaf(&self, leaf: SharedLeaf, at: &[(usize, f64)], of_step: f64, into: &mut [f64]) {
        let (SharedLeaf::Slope(input) | SharedLeaf::Input(input, _)) = leaf;
        let (hold, values) = &self.columns[input];
        let last = values.len().saturating_sub(1);
        // What is linear ends at the last sample.
        let rise = |k: usize| values[(k + 1).min(last)] - values[k];
        let pairs = into.iter_mut().zip(at);
        match (leaf, hold) {
            (SharedLeaf::Slope(_), InputHold::Linear) => {
                pairs.for_each(|(value, (k, _))| *value = rise(*k) / self.hours);
            }
            (SharedLeaf::Slope(_), InputHold::ZeroOrder) => into.fill(0.0),
            (SharedLeaf::Input(_, point), InputHold::Linear) => {
                let offset = offset(point);
                pairs.for_each(|(value, (k, step))| {
                    *value = values[*k] + rise(*k) * ((step + offset) / of_step);
                });
            }
            (SharedLeaf::Input(..), InputHold::ZeroOrder) => {
                pairs.for_each(|(value, (k, _))| *value = values[*k]);
            }
        }
    }
}

/// How many whole samples a look-up so many hours back can reach.
pub fn samples_back(delay_hours: f64, sample_hours: f64) -> usize {
    // The allowance keeps a delay of exactly some samples at that number.
    (delay_hours / sample_hours - 1e-9).ceil().max(0.0) as usize
}

/// The shared columns of a tape for every step of a window, and the past of the inputs that it delays.
#[derive(Debug)]
pub struct Drive {
    rows: Vec<f64>,
    width: usize,
    steps: usize,
    delayed: Vec<Past>,
    sample_hours: f64,
}

/// A delayed input of a tape.
#[derive(Debug)]
struct Past {
    hold: InputHold,
    values: Arc<[f64]>,
    /// How far into the step the delay is counted back from.
    offset: f64,
}

impl Past {
    /// The value at a position counted in samples.
    #[inline(always)]
    fn at(&self, position: f64) -> f64 {
        value_at(self.hold, &self.values, position)
    }

    /// How the value changes with the position; a held one does not.
    fn slope(&self, position: f64) -> f64 {
        let last = self.values.len().saturating_sub(1);
        if self.hold == InputHold::ZeroOrder || last == 0 || !(0.0..=last as f64).contains(&position) {
            return 0.0;
        }
        let k = (position as usize).min(last - 1);
        self.values[k + 1] - self.values[k]
    }
}

/// The value at a position counted in samples. Before the first sample it is the first value; a zero-order
/// input has the value of the interval that holds the position.
#[inline(always)]
fn value_at(hold: InputHold, values: &[f64], position: f64) -> f64 {
    let last = values.len().saturating_sub(1);
    match hold {
        InputHold::Linear => {
            let position = position.clamp(0.0, last as f64);
            let k = (position as usize).min(last.saturating_sub(1));
            let next = values[(k + 1).min(last)];
            values[k] + (next - values[k]) * (position - k as f64)
        }
        // A delay of whole samples must not fall into the interval before by a rounding error. The cast
        // ends at zero for whatever lies before the window.
        InputHold::ZeroOrder => values[((position + 1e-9) as usize).min(last)],
    }
}

impl Drive {
    /// Evaluates the shared stage of `tape` at `steps` sub-steps per sample interval; with one step also at
    /// the last sample, where only the start of the step is meaningful.
    pub fn new(tape: &Tape, inputs: &Inputs, steps: usize) -> Self {
        let stage = &tape.shared;
        let width = stage.columns.len();
        let all = inputs.samples() * steps;
        let mut rows = Vec::with_capacity(all * width);
        let evaluator = shared_tape(stage);
        let mut file = LaneFile::<LANES>::new(&evaluator);
        // A lane for every step: they depend on nothing but their inputs.
        for first in (0..all).step_by(LANES) {
            let lanes = LANES.min(all - first);
            let at: [(usize, f64); LANES] =
                std::array::from_fn(|lane| ((first + lane) / steps, ((first + lane) % steps) as f64));
            for (index, leaf) in stage.sources.iter().enumerate() {
                inputs.leaf(*leaf, &at[..lanes], steps as f64, &mut file.state(index)[..lanes]);
            }
            file.step();
            let columns: Vec<&[f64; LANES]> = (0..width).map(|column| file.root(column)).collect();
            for lane in 0..lanes {
                rows.extend(columns.iter().map(|values| values[lane]));
            }
        }
        let past = |delayed: &DelayedInput| {
            let (hold, values) = inputs.columns[delayed.input].clone();
            Past { hold, values, offset: offset(delayed.point) }
        };
        Self {
            rows,
            width,
            steps,
            delayed: tape.delayed.iter().map(past).collect(),
            sample_hours: inputs.hours,
        }
    }

    /// Loads the inputs of a step into the lanes of the tape that the drive was made for.
    #[inline]
    pub fn load<const W: usize>(&self, file: &mut LaneFile<W>, k: usize, step: usize) {
        let start = (k * self.steps + step) * self.width;
        file.share(&self.rows[start..start + self.width]);
        file.delay(|index, hours| self.past(index, hours, k, step));
    }
}

impl Drive {
    /// Whether the inputs of two intervals are the same.
    pub fn same(&self, a: usize, b: usize) -> bool {
        let row = |k: usize| &self.rows[k * self.steps * self.width..][..self.width];
        row(a) == row(b)
    }

    /// Loads the inputs of a step into one lane.
    pub fn load_lane<const W: usize>(&self, file: &mut LaneFile<W>, lane: usize, k: usize, step: usize) {
        let start = (k * self.steps + step) * self.width;
        file.share_lane(lane, &self.rows[start..start + self.width]);
        file.delay_lane(lane, |index, hours| self.past(index, hours, k, step));
    }

    /// Loads the inputs of a step into all lanes, each at an interval of its own.
    pub fn load_lanes<const W: usize>(&self, file: &mut LaneFile<W>, k: &[usize; W], step: usize) {
        file.share_lanes(k.map(|k| &self.rows[(k * self.steps + step) * self.width..][..self.width]));
        if !self.delayed.is_empty() {
            for (lane, k) in k.iter().enumerate() {
                file.delay_lane(lane, |index, hours| self.past(index, hours, *k, step));
            }
        }
    }

    /// What a delayed input of a step was so many hours ago.
    #[inline(always)]
    fn past(&self, index: usize, hours: f64, k: usize, step: usize) -> f64 {
        let past = &self.delayed[index];
        let now = k as f64 + (step as f64 + past.offset) / self.steps as f64;
        past.at(now - hours / self.sample_hours)
    }

    /// Loads the inputs of a step into the registers of the tape that the drive was made for.
    pub fn feed<T: Scalar>(&self, registers: &mut Registers<T>, k: usize, step: usize) {
        let start = (k * self.steps + step) * self.width;
        registers.share(&self.rows[start..start + self.width]);
        registers.delay(|index, hours| {
            let past = &self.delayed[index];
            let position =
                k as f64 + (step as f64 + past.offset) / self.steps as f64 - hours / self.sample_hours;
            (past.at(position), -past.slope(position) / self.sample_hours)
        });
    }
}

/// How far into the step a point lies.
fn offset(point: Point) -> f64 {
    match point {
        Point::Start => 0.0,
        Point::Middle => 0.5,
        Point::End => 1.0,
    }
}

/// The shared stage as a tape of its own, whose states are the leaves.
fn shared_tape(stage: &SharedStage) -> Tape {
    let leaves = stage.sources.len() as u32;
    let constants = stage.constants.len() as u32;
    // In the stage the leaves come first; in a tape the step length and the constants do.
    let moved = |register: u32| {
        if register < leaves {
            register + 1 + constants
        } else if register < leaves + constants {
            register - leaves + 1
        } else {
            register + 1
        }
    };
    let code = stage.code.iter().map(|instruction| instruction.with_operands(moved)).collect();
    Tape {
        parameters: 0,
        constants: stage.constants.clone(),
        candidate: Vec::new(),
        shared: SharedStage::default(),
        delayed: Vec::new(),
        states: stage.sources.len(),
        step: code,
        roots: stage.columns.iter().map(|column| moved(*column)).collect(),
    }
}
