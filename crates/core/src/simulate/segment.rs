//! Stretches of a window that each start from states of their own.
//!
//! A lane is a parameter vector with its start, so the response of a stretch to every parameter and to every
//! initial state is one run of a block.

use super::lanes::{LANES, LaneFile};
use super::trajectory::Simulator;
use crate::interrupt::Meter;
use std::ops::Range;

/// A sample of one parameter vector, from states that were given.
#[derive(Debug, Clone, PartialEq)]
pub struct StepAlong {
    /// The states at the next sample.
    pub states: Vec<f64>,
    /// The outputs at this one.
    pub outputs: Vec<f64>,
}

/// A stretch of one parameter vector, from its states at the first sample. The inputs must be known between
/// its samples.
#[derive(Debug, Clone)]
pub struct Stretch<'a> {
    /// The samples.
    pub samples: Range<usize>,
    /// The parameters.
    pub theta: &'a [f64],
    /// The states at the first sample.
    pub start: &'a [f64],
}

impl Simulator {
    /// Runs several stretches, side by side wherever they lie: `[stretch][output][sample of the stretch]`.
    /// Few parameter vectors along many short stretches so fill the lanes all the same. Only models that step
    /// with their samples have such runs.
    pub fn run_stretches(&self, stretches: &[Stretch]) -> Vec<Vec<Vec<f64>>> {
        let block = |stretches: &[Stretch]| match stretches.len() {
            1 => self.abreast::<1>(stretches),
            2..=4 => self.abreast::<4>(stretches),
            5..=8 => self.abreast::<8>(stretches),
            9..=16 => self.abreast::<16>(stretches),
            17..=24 => self.abreast::<24>(stretches),
            _ => self.abreast::<LANES>(stretches),
        };
        stretches.chunks(LANES).flat_map(block).collect()
    }

    /// The states a sample later and the outputs now of every parameter vector, from the same states at each
    /// sample of `along`: `[sample][vector]`. The last sample has no later one, nor has one behind which the
    /// inputs are unknown; their states stay as they are. Only models that step with their samples have such
    /// runs.
    pub fn steps_along(&self, along: &[Vec<f64>], thetas: &[&[f64]]) -> Vec<Vec<StepAlong>> {
        let mut steps: Vec<Vec<StepAlong>> = along.iter().map(|_| Vec::with_capacity(thetas.len())).collect();
        for thetas in thetas.chunks(LANES) {
            match thetas.len() {
                ..=8 => self.block_along::<8>(along, thetas, &mut steps),
                9..=16 => self.block_along::<16>(along, thetas, &mut steps),
                17..=24 => self.block_along::<24>(along, thetas, &mut steps),
                _ => self.block_along::<LANES>(along, thetas, &mut steps),
            }
        }
        steps
    }

    fn block_along<const W: usize>(
        &self,
        along: &[Vec<f64>],
        thetas: &[&[f64]],
        steps: &mut [Vec<StepAlong>],
    ) {
        let (step_tape, drive, substeps, hours) = self.step_parts();
        let (output_tape, output_drive) = self.output_parts();
        let mut file = LaneFile::<W>::new(step_tape);
        file.load(thetas, hours);
        let mut out = LaneFile::<W>::new(output_tape);
        out.load(thetas, 0.0);
        let (states, outputs) = (self.initial.len(), output_tape.roots.len());
        let mut meter = Meter::new(&self.brake);
        for (k, (start, steps)) in along.iter().zip(steps).enumerate() {
            meter.add(W * (substeps * step_tape.step.len() + output_tape.step.len()));
            for (state, value) in start.iter().enumerate() {
                *file.state(state) = [*value; W];
                *out.state(state) = [*value; W];
            }
            output_drive.load(&mut out, k, 0);
            out.step();
            if k + 1 < along.len() && self.inputs().known(k) {
                for step in 0..substeps {
                    drive.load(&mut file, k, step);
                    file.step();
                    file.advance();
                }
            }
            steps.extend((0..thetas.len()).map(|lane| StepAlong {
                states: (0..states).map(|state| file.state(state)[lane]).collect(),
                outputs: (0..outputs).map(|output| out.root(output)[lane]).collect(),
            }));
        }
    }

    fn abreast<const W: usize>(&self, stretches: &[Stretch]) -> Vec<Vec<Vec<f64>>> {
        let (step_tape, drive, substeps, hours) = self.step_parts();
        let (output_tape, output_drive) = self.output_parts();
        let thetas: Vec<&[f64]> = stretches.iter().map(|stretch| stretch.theta).collect();
        let mut file = LaneFile::<W>::new(step_tape);
        file.load(&thetas, hours);
        let mut out = LaneFile::<W>::new(output_tape);
        out.load(&thetas, 0.0);
        let lanes: [&Stretch; W] = std::array::from_fn(|lane| &stretches[lane.min(stretches.len() - 1)]);
        let together = stretches.iter().all(|stretch| stretch.samples == stretches[0].samples);
        let states = self.initial.len();
        for state in 0..states {
            *file.state(state) = lanes.map(|stretch| stretch.start[state]);
        }
        let longest = stretches.iter().map(|stretch| stretch.samples.len()).max().unwrap_or(0);
        let series =
            |stretch: &Stretch| vec![Vec::with_capacity(stretch.samples.len()); output_tape.roots.len()];
        let mut values: Vec<Vec<Vec<f64>>> = stretches.iter().map(series).collect();
        let mut meter = Meter::new(&self.brake);
        for along in 0..longest {
            meter.add(W * (substeps * step_tape.step.len() + output_tape.step.len()));
            // A lane whose stretch is over goes on at its end, and nobody looks.
            let now = lanes.map(|stretch| (stretch.samples.start + along).min(stretch.samples.end - 1));
            if along > 0 {
                let before = now.map(|k| k.saturating_sub(1));
                for step in 0..substeps {
                    match together {
                        true => drive.load(&mut file, before[0], step),
                        false => drive.load_lanes(&mut file, &before, step),
                    }
                    file.step();
                    file.advance();
                }
            }
            for state in 0..states {
                *out.state(state) = *file.state(state);
            }
            match together {
                true => output_drive.load(&mut out, now[0], 0),
                false => output_drive.load_lanes(&mut out, &now, 0),
            }
            out.step();
            for (lane, (stretch, series)) in stretches.iter().zip(&mut values).enumerate() {
                if along < stretch.samples.len() {
                    let outputs = series.iter_mut().enumerate();
                    outputs.for_each(|(output, series)| series.push(out.root(output)[lane]));
                }
            }
        }
        values
    }
}
