//! Which way the free runs of many candidates go: in blocks of lanes that step together, or in lanes that
//! find their own steps.

use super::block;
use super::lanes::LANES;
use super::trajectory::{Halt, Simulator, Trajectory};
use crate::model::Stepper;
use rayon::prelude::*;

impl Simulator {
    /// Simulates samples `0..until` for every parameter vector; blocks run in parallel, and the result does
    /// not depend on how many threads there are.
    pub fn run(&self, thetas: &[&[f64]], until: usize) -> Vec<Trajectory> {
        self.run_unless(thetas, until, &|| false)
    }

    /// The same, cut short as soon as `halt` says so: long records of large models take minutes.
    pub fn run_unless(&self, thetas: &[&[f64]], until: usize, halt: Halt) -> Vec<Trajectory> {
        let until = until.min(self.samples());
        if self.stepper == Stepper::Rkc {
            return block::run(self, thetas, until, false, halt);
        }
        // A lonely candidate does not need a whole block.
        if let [single] = thetas {
            return self.block::<1>(&[*single], until, false, halt);
        }
        // A short block is as good as a long one, lane by lane; half-empty lanes would be paid for.
        let block = |block: &[&[f64]]| match block.len() {
            1..=4 => self.block::<4>(block, until, false, halt),
            5..=8 => self.block::<8>(block, until, false, halt),
            9..=16 => self.block::<16>(block, until, false, halt),
            _ => self.block::<LANES>(block, until, false, halt),
        };
        thetas.par_chunks(LANES).flat_map_iter(block).collect()
    }

    /// Simulates one parameter vector over the whole window and keeps its states.
    pub fn run_with_states(&self, theta: &[f64]) -> Trajectory {
        // One vector in, one trajectory out.
        let mut trajectories = match self.stepper {
            Stepper::Rkc => block::run(self, &[theta], self.samples(), true, &|| false),
            Stepper::Ros2 | Stepper::Rk4 => self.block::<1>(&[theta], self.samples(), true, &|| false),
        };
        trajectories.pop().unwrap_or(Trajectory {
            outputs: Vec::new(),
            states: Vec::new(),
            diverged: true,
            evaluations: 0,
        })
    }
}
