//! Free runs of many candidates by RKC2: lanes that each go their own way through the window.
//!
//! One evaluation of the right-hand side follows another. Each lane has a time, a step, a number of stages
//! and a spectral radius of its own (`rkc`), and takes an evaluation for whatever it needs next. So no lane
//! waits for another, one that is done takes the next candidate, and a candidate's result depends neither on
//! its neighbours nor on threads. Inputs are held over an interval: between two samples the equations do not
//! know the time.

use super::lanes::LaneFile;
use super::rkc::{FLOOR, LOOSE_TOLERANCE, LaneClock, LaneEvent, TOLERANCE};
use super::trajectory::{Halt, Simulator, Trajectory, diverged};
use super::vectors::{Moves, Vectors};
use crate::interrupt::Meter;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Evaluations of a block between two looks at whether it is still wanted.
const PATROL: usize = 512;

/// Candidates that one worker takes before another helps: eight lanes take a third longer than one, so few
/// candidates on two workers are hardly sooner there and cost nearly twice as much.
const FULL: usize = 8;

/// Simulates every candidate; the workers of the pool take them in turn.
pub(super) fn run(
    simulator: &Simulator,
    thetas: &[&[f64]],
    until: usize,
    keep_states: bool,
    halt: Halt,
) -> Vec<Trajectory> {
    if thetas.is_empty() {
        return Vec::new();
    }
    let next = AtomicUsize::new(0);
    let threads = thetas.len().div_ceil(FULL).min(rayon::current_num_threads());
    let worker = |_| match thetas.len().div_ceil(threads) {
        0 | 1 => Block::<1>::run(simulator, thetas, until, keep_states, halt, &next),
        2..=4 => Block::<4>::run(simulator, thetas, until, keep_states, halt, &next),
        5..=8 => Block::<8>::run(simulator, thetas, until, keep_states, halt, &next),
        _ => Block::<16>::run(simulator, thetas, until, keep_states, halt, &next),
    };
    let mut runs: Vec<Run> = (0..threads).into_par_iter().flat_map_iter(worker).collect();
    runs.sort_by_key(|run| run.candidate);
    runs.into_iter().map(|run| run.into_trajectory(until, keep_states)).collect()
}

/// What a candidate has done so far.
struct Run {
    candidate: usize,
    outputs: Vec<Vec<f64>>,
    states: Vec<Vec<f64>>,
    evaluations: usize,
    diverged: bool,
}

impl Run {
    fn new(candidate: usize, simulator: &Simulator) -> Self {
        let (outputs, states) =
            (vec![Vec::new(); simulator.output.roots.len()], vec![Vec::new(); simulator.initial.len()]);
        Self { candidate, outputs, states, evaluations: 0, diverged: false }
    }

    fn into_trajectory(self, until: usize, keep_states: bool) -> Trajectory {
        let padded = |mut series: Vec<f64>| {
            series.resize(until, f64::NAN);
            series
        };
        Trajectory {
            outputs: self.outputs.into_iter().map(padded).collect(),
            states: if keep_states { self.states.into_iter().map(padded).collect() } else { Vec::new() },
            diverged: self.diverged,
            evaluations: self.evaluations,
        }
    }
}

/// Lanes at work: each with its clock, its outputs and what it has done.
struct Block<'a, const W: usize> {
    simulator: &'a Simulator,
    thetas: &'a [&'a [f64]],
    until: usize,
    keep_states: bool,
    file: LaneFile<'a, W>,
    out: LaneFile<'a, 1>,
    vectors: Vectors<W>,
    theta: [&'a [f64]; W],
    clocks: [LaneClock; W],
    runs: [Option<Run>; W],
    done: Vec<Run>,
}

impl<'a, const W: usize> Block<'a, W> {
    fn run(
        simulator: &'a Simulator,
        thetas: &'a [&'a [f64]],
        until: usize,
        keep_states: bool,
        halt: Halt,
        next: &AtomicUsize,
    ) -> Vec<Run> {
        let mut block = Self {
            simulator,
            thetas,
            until,
            keep_states,
            file: LaneFile::new(&simulator.step),
            out: LaneFile::new(&simulator.output),
            vectors: Vectors::new(simulator.initial.len()),
            theta: [thetas[0]; W],
            clocks: [LaneClock::IDLE; W],
            runs: std::array::from_fn(|_| None),
            done: Vec::new(),
        };
        block.work(halt, next);
        block.done
    }

    fn work(&mut self, halt: Halt, next: &AtomicUsize) {
        let states = self.simulator.initial.len();
        // Each refinement by two divides the tolerance by ten.
        let tolerance = if self.simulator.has_loose_steps() { LOOSE_TOLERANCE } else { TOLERANCE };
        let tolerance = tolerance / 10f64.powi(self.simulator.substeps().ilog2() as i32);
        self.board(next);
        let mut evaluations = 0;
        let mut meter = Meter::new(&self.simulator.brake);
        while self.runs.iter().any(Option::is_some) {
            if evaluations % PATROL == 0 && halt() {
                return self.give_up(next);
            }
            evaluations += 1;
            meter.add(W * self.simulator.step.step.len());
            self.file.step();
            let sums = self.vectors.measure(&self.file, &self.clocks.map(|clock| clock.step), FLOOR);
            let mut moves = Moves::to_start();
            let mut events = [LaneEvent::Nothing; W];
            for (lane, (clock, event)) in self.clocks.iter_mut().zip(&mut events).enumerate() {
                *event = clock.turn(lane, &sums, states, tolerance, &mut moves);
            }
            self.runs.iter_mut().flatten().for_each(|run| run.evaluations += 1);
            self.vectors.update(&mut self.file, &moves);
            if events.iter().all(|event| *event == LaneEvent::Nothing) {
                continue;
            }
            for (lane, event) in events.into_iter().enumerate() {
                match event {
                    LaneEvent::Nothing => {}
                    LaneEvent::Arrived => {
                        self.arrive(lane, self.clocks[lane].sample.map_or(0, |sample| sample + 1))
                    }
                    LaneEvent::Lost => self.leave(lane, true),
                }
            }
            self.board(next);
        }
    }

    /// Gives every empty lane a candidate, as long as there are any.
    fn board(&mut self, next: &AtomicUsize) {
        for lane in 0..W {
            while self.runs[lane].is_none() {
                let candidate = next.fetch_add(1, Ordering::Relaxed);
                let Some(theta) = self.thetas.get(candidate) else { break };
                self.theta[lane] = theta;
                self.file.load(&self.theta, 0.0);
                self.runs[lane] = Some(Run::new(candidate, self.simulator));
                for (state, initial) in self.simulator.initial.iter().enumerate() {
                    self.vectors.place(lane, state, self.simulator.start(*initial, theta));
                }
                self.clocks[lane] = LaneClock::IDLE;
                match &self.simulator.warm_up {
                    Some(warm_up) => {
                        warm_up.drive.load_lane(&mut self.file, lane, 0, 0);
                        self.clocks[lane].begin(None, warm_up.hours, true);
                    }
                    None => self.arrive(lane, 0),
                }
            }
        }
        self.vectors.load(&mut self.file);
    }

    /// Notes a sample and goes on into the next interval of known inputs.
    fn arrive(&mut self, lane: usize, sample: usize) {
        let simulator = self.simulator;
        for k in sample..self.until {
            if k > 0 && !simulator.inputs().known(k - 1) && simulator.inputs().known(k) {
                for (state, start) in simulator.restarts(k) {
                    self.vectors.place(lane, state, start);
                }
            }
            if self.note(lane, k) {
                return self.leave(lane, true);
            }
            if k + 1 < self.until && simulator.inputs().known(k) {
                let drive = simulator.drive();
                drive.load_lane(&mut self.file, lane, k, 0);
                let before = self.clocks[lane].sample;
                let same = before.is_some_and(|before| before + 1 == k && drive.same(before, k));
                return self.clocks[lane].begin(Some(k), simulator.step_hours(), !same);
            }
        }
        self.leave(lane, false);
    }

    /// Notes outputs and states at a sample. Says whether a state has left the numbers or physics.
    fn note(&mut self, lane: usize, k: usize) -> bool {
        let Some(run) = &mut self.runs[lane] else { return false };
        let mut farthest = 0.0;
        self.out.load(&[self.theta[lane]], 0.0);
        for (state, values) in self.vectors.start.iter().enumerate() {
            let value = values.0[lane];
            farthest = if value.abs() <= farthest { farthest } else { value.abs() };
            self.out.state(state)[0] = value;
            if self.keep_states {
                run.states[state].push(value);
            }
        }
        self.simulator.output_drive().load(&mut self.out, k, 0);
        self.out.step();
        for (output, series) in run.outputs.iter_mut().enumerate() {
            series.push(self.out.root(output)[0]);
        }
        diverged(farthest)
    }

    fn leave(&mut self, lane: usize, diverged: bool) {
        self.clocks[lane] = LaneClock::IDLE;
        self.done.extend(self.runs[lane].take().map(|run| Run { diverged, ..run }));
    }

    /// Nothing is wanted any more: what is under way, and what has not begun, ends here.
    fn give_up(&mut self, next: &AtomicUsize) {
        (0..W).for_each(|lane| self.leave(lane, true));
        loop {
            let candidate = next.fetch_add(1, Ordering::Relaxed);
            if candidate >= self.thetas.len() {
                return;
            }
            self.done.push(Run { diverged: true, ..Run::new(candidate, self.simulator) });
        }
    }
}
