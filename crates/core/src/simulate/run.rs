//! Which way the free runs of many candidates go: in blocks of lanes that step together, or in lanes that
//! find their own steps.

use super::block;
use super::lanes::LANES;
use super::trajectory::{Halt, Simulator, Trajectory};
use crate::model::Stepper;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Candidates of the smallest block.
const FEWEST: usize = 4;
/// Blocks under way, in whatever pool: it says whether there is somebody idle, and no result depends on it.
static BLOCKS: AtomicUsize = AtomicUsize::new(0);

/// A block under way.
struct Busy;

impl Busy {
    fn begin() -> Self {
        BLOCKS.fetch_add(1, Ordering::Relaxed);
        Self
    }

    /// Candidates of a block: as many as there are lanes, or fewer so that workers without one have some. A
    /// short block is as good as a long one, lane by lane, but costs more, which nobody gains by where all
    /// are busy.
    fn width(candidates: usize) -> usize {
        let idle = rayon::current_num_threads().saturating_sub(BLOCKS.load(Ordering::Relaxed)).max(1);
        candidates.div_ceil(idle).next_power_of_two().clamp(FEWEST, LANES)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        BLOCKS.fetch_sub(1, Ordering::Relaxed);
    }
}

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
        // Half-empty lanes would be paid for.
        let block = |block: &[&[f64]]| {
            let _busy = Busy::begin();
            match block.len() {
                1..=4 => self.block::<4>(block, until, false, halt),
                5..=8 => self.block::<8>(block, until, false, halt),
                9..=16 => self.block::<16>(block, until, false, halt),
                17..=24 => self.block::<24>(block, until, false, halt),
                _ => self.block::<LANES>(block, until, false, halt),
            }
        };
        thetas.par_chunks(Busy::width(thetas.len())).flat_map_iter(block).collect()
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
