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

impl Simulator {
    /// Runs the samples of a stretch for every pair of a parameter vector and its states at the first sample;
    /// as many of the one as of the other. Gives `[pair][output][sample of the stretch]`; the inputs must be
    /// known between its samples. Only models that step with their samples have such runs.
    pub fn run_from(
        &self,
        samples: Range<usize>,
        thetas: &[&[f64]],
        starts: &[&[f64]],
    ) -> Vec<Vec<Vec<f64>>> {
        if let ([theta], [start]) = (thetas, starts) {
            return self.stretch::<1>(samples, &[*theta], &[*start]);
        }
        let block = |(thetas, starts): (&[&[f64]], &[&[f64]])| match thetas.len() {
            1..=4 => self.stretch::<4>(samples.clone(), thetas, starts),
            5..=8 => self.stretch::<8>(samples.clone(), thetas, starts),
            9..=16 => self.stretch::<16>(samples.clone(), thetas, starts),
            _ => self.stretch::<LANES>(samples.clone(), thetas, starts),
        };
        thetas.chunks(LANES).zip(starts.chunks(LANES)).flat_map(block).collect()
    }

    /// The states a sample later and the outputs now of every parameter vector, from the same states at each
    /// sample of `along`: `[sample][vector]`. The last sample has no later one, nor has one behind which the
    /// inputs are unknown; their states stay as they are. Only models that step with their samples have such
    /// runs.
    pub fn steps_along(&self, along: &[Vec<f64>], thetas: &[&[f64]]) -> Vec<Vec<StepAlong>> {
        let mut steps: Vec<Vec<StepAlong>> = vec![Vec::with_capacity(thetas.len()); along.len()];
        for thetas in thetas.chunks(LANES) {
            self.block_along(along, thetas, &mut steps);
        }
        steps
    }

    fn block_along(&self, along: &[Vec<f64>], thetas: &[&[f64]], steps: &mut [Vec<StepAlong>]) {
        let (step_tape, drive, substeps, hours) = self.step_parts();
        let (output_tape, output_drive) = self.output_parts();
        let mut file = LaneFile::<LANES>::new(step_tape);
        file.load(thetas, hours);
        let mut out = LaneFile::<LANES>::new(output_tape);
        out.load(thetas, 0.0);
        let (states, outputs) = (self.initial.len(), output_tape.roots.len());
        let mut meter = Meter::new(&self.brake);
        for (k, (start, steps)) in along.iter().zip(steps).enumerate() {
            meter.add(LANES * (substeps * step_tape.step.len() + output_tape.step.len()));
            for (state, value) in start.iter().enumerate() {
                *file.state(state) = [*value; LANES];
                *out.state(state) = [*value; LANES];
            }
            output_drive.load(&mut out, k, 0);
            out.step();
            if k + 1 < along.len() && self.known[k] {
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

    fn stretch<const W: usize>(
        &self,
        samples: Range<usize>,
        thetas: &[&[f64]],
        starts: &[&[f64]],
    ) -> Vec<Vec<Vec<f64>>> {
        let (step_tape, drive, substeps, hours) = self.step_parts();
        let (output_tape, output_drive) = self.output_parts();
        let mut file = LaneFile::<W>::new(step_tape);
        file.load(thetas, hours);
        let mut out = LaneFile::<W>::new(output_tape);
        out.load(thetas, 0.0);
        let states = self.initial.len();
        for state in 0..states {
            *file.state(state) = std::array::from_fn(|lane| starts[lane.min(starts.len() - 1)][state]);
        }
        let mut values: Vec<Vec<Vec<f64>>> =
            vec![vec![Vec::with_capacity(samples.len()); output_tape.roots.len()]; thetas.len()];
        let mut meter = Meter::new(&self.brake);
        for k in samples.clone() {
            meter.add(W * (substeps * step_tape.step.len() + output_tape.step.len()));
            if k > samples.start {
                for step in 0..substeps {
                    drive.load(&mut file, k - 1, step);
                    file.step();
                    file.advance();
                }
            }
            for state in 0..states {
                *out.state(state) = *file.state(state);
            }
            output_drive.load(&mut out, k, 0);
            out.step();
            for (lane, series) in values.iter_mut().enumerate() {
                series
                    .iter_mut()
                    .enumerate()
                    .for_each(|(output, series)| series.push(out.root(output)[lane]));
            }
        }
        values
    }
}
