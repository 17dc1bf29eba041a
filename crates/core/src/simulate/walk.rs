//! A filter on its way from sample to sample, in lanes: each has a noise, a mean and a covariance of its own,
//! and parameters of its own where there are several, and all see the same inputs and values.

use super::drive::Drive;
use super::lane::Lane;
use super::lanes::LaneFile;
use super::stepper::{jacobian_tape, observation_tape};
use super::trajectory::{MeasuredOutput, Simulator};
use super::transition::{Transition, propagate_small};
use crate::cpu::{Cpu, Kernel, dispatch};
use crate::interrupt::{Brake, Meter};
use crate::model::tape::Tape;
use crate::model::{Initial, Model};

/// Prior variance of a state that no sensor measures, in the square of its unit (models: 4 K2).
pub(super) const HIDDEN_VARIANCE: f64 = 4.0;

/// The noise that a filter assumes.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// Process noise: a standard deviation per square root of an hour for every state.
    pub process: Vec<f64>,
    /// Measurement variance per output.
    pub measurement: Vec<f64>,
}

/// A Kalman filter for one model on one window.
#[derive(Debug)]
pub struct Kalman<'a> {
    pub(super) simulator: &'a Simulator,
    pub(super) initial: Vec<Initial>,
    pub(super) measured: Vec<MeasuredOutput<'a>>,
    /// The derivatives of the equations by the states, row by row.
    jacobian: Tape,
    jacobian_drive: Drive,
    /// Each output with its gradient.
    observation: Tape,
    observation_drive: Drive,
}

/// A filter on its way. Matrices by rows.
pub(super) struct Walk<'a, const W: usize> {
    of: &'a Kalman<'a>,
    /// The mean of the states.
    pub x: Vec<Lane<W>>,
    /// Their covariance.
    pub p: Vec<Lane<W>>,
    /// The states that start at a parameter or a fixed value, where they do.
    starts: Vec<Lane<W>>,
    /// Variances of the process noise per hour.
    q: Vec<Lane<W>>,
    /// Variances of the sensors.
    r: Vec<Lane<W>>,
    /// Whether the lanes have the slopes of one of them in common.
    in_common: bool,
    /// The last sub-step with its Jacobian, kept while that stays the same.
    jacobian: Vec<Lane<W>>,
    step: Transition<Lane<W>>,
    /// Where all states of a lane have one variance of noise, that, and the step of a variance of 1 that
    /// lanes with one Jacobian have in common.
    even: Option<Lane<W>>,
    common: Transition<f64>,
    scratch: Vec<Lane<W>>,
    file: LaneFile<'a, W>,
    slopes: LaneFile<'a, W>,
    outputs: LaneFile<'a, W>,
    meter: Meter<'a>,
}

impl<'a> Kalman<'a> {
    /// A filter for the model that `simulator` was made from.
    pub fn new(model: &Model, simulator: &'a Simulator, measured: &[MeasuredOutput<'a>]) -> Self {
        let (jacobian, observation) = (jacobian_tape(model), observation_tape(model));
        let (inputs, (_, _, substeps, _)) = (simulator.inputs(), simulator.step_parts());
        Self {
            jacobian_drive: Drive::new(&jacobian, inputs, substeps),
            observation_drive: Drive::new(&observation, inputs, 1),
            jacobian,
            observation,
            simulator,
            initial: model.states().iter().map(|state| state.initial).collect(),
            measured: measured.to_vec(),
        }
    }

    /// A filter that has not begun: a lane for each noise, with the parameters of that place or the last
    /// ones. Lanes more repeat the last one.
    pub(super) fn walk<const W: usize>(&self, thetas: &[&[f64]], noises: &[Noise]) -> Walk<'_, W> {
        let (n, outputs) = (self.initial.len(), self.measured.len());
        let (step_tape, _, _, hours) = self.simulator.step_parts();
        fn loaded<'t, const W: usize>(tape: &'t Tape, thetas: &[&[f64]], hours: f64) -> LaneFile<'t, W> {
            let mut file = LaneFile::<W>::new(tape);
            file.load(thetas, hours);
            file
        }
        let zeros = |count: usize| vec![Lane([0.0; W]); count];
        let of_noise = |value: &dyn Fn(&Noise) -> f64| {
            Lane(std::array::from_fn(|lane| value(&noises[lane.min(noises.len() - 1)])))
        };
        let start = |initial: &Initial| {
            Lane(std::array::from_fn(|lane| match initial {
                Initial::Parameter(parameter) => thetas[lane.min(thetas.len() - 1)][*parameter],
                Initial::Fixed(value) => *value,
                Initial::Measured(_) => 0.0,
            }))
        };
        let q: Vec<Lane<W>> = (0..n).map(|state| of_noise(&|noise| noise.process[state].powi(2))).collect();
        Walk {
            of: self,
            x: zeros(n),
            p: zeros(n * n),
            starts: self.initial.iter().map(start).collect(),
            even: q.first().copied().filter(|first| q.iter().all(|other| other.0 == first.0)),
            common: Transition::empty(n),
            q,
            r: (0..outputs).map(|output| of_noise(&|noise| noise.measurement[output])).collect(),
            in_common: false,
            jacobian: vec![Lane([f64::NAN; W]); n * n],
            step: Transition::empty(n),
            scratch: zeros(n * n),
            file: loaded(step_tape, thetas, hours),
            slopes: loaded(&self.jacobian, thetas, hours),
            outputs: loaded(&self.observation, thetas, 0.0),
            meter: Meter::new(self.simulator.brake()),
        }
    }
}

impl<const W: usize> Walk<'_, W> {
    /// State and covariance where the filter starts: measured states at their measurement, hidden ones at
    /// their parameter or, behind a gap, where they were.
    pub fn start(&mut self, k: usize) {
        let Self { of, x, p, starts, r, .. } = self;
        let n = x.len();
        p.fill(Lane([0.0; W]));
        for (state, initial) in of.initial.iter().enumerate() {
            match initial {
                Initial::Measured(output) => {
                    if let Some(start) = of.simulator.measured_start_at(*output, k) {
                        x[state] = Lane([start; W]);
                    }
                    p[state * n + state] = r[*output];
                }
                Initial::Parameter(_) => {
                    if k == 0 {
                        x[state] = starts[state];
                    }
                    p[state * n + state] = Lane([HIDDEN_VARIANCE; W]);
                }
                // What starts at a known value is known; behind a gap it goes on from where it was.
                Initial::Fixed(_) => {
                    if k == 0 {
                        x[state] = starts[state];
                    }
                }
            }
        }
    }

    /// Lets all lanes, which differ in their noises alone, take the slopes where the middle one is.
    pub fn with_common_slopes(self) -> Self {
        Self { in_common: true, ..self }
    }

    /// Takes mean and covariance from sample `k` to the next one, as long as nothing is measured.
    pub fn advance(&mut self, k: usize) {
        let n = self.x.len();
        let (step_tape, drive, substeps, hours) = self.of.simulator.step_parts();
        // The covariance takes two products of matrices in a sub-step.
        let work = W * (2 * n.pow(3) + self.of.jacobian.step.len() + step_tape.step.len());
        for step in 0..substeps {
            self.meter.add(work);
            for (state, value) in self.x.iter().enumerate() {
                *self.slopes.state(state) = value.0;
                *self.file.state(state) = value.0;
            }
            self.of.jacobian_drive.load(&mut self.slopes, k, step);
            self.slopes.step();
            drive.load(&mut self.file, k, step);
            self.file.step();
            for (state, value) in self.x.iter_mut().enumerate() {
                *value = Lane(*self.file.root(state));
            }
            self.spread(hours);
        }
    }

    /// Takes the covariance over a sub-step of so many hours; there is none in lanes that no step can follow.
    fn spread(&mut self, hours: f64) {
        let Self { of, in_common, jacobian, step, even, common, slopes, q, p, scratch, .. } = self;
        let now = |place: usize| match *in_common {
            true => [slopes.root(place)[W / 2]; W],
            false => *slopes.root(place),
        };
        let is_same = jacobian.iter().enumerate().all(|(place, entry)| entry.0 == now(place));
        let anew = (!is_same).then(|| {
            jacobian.iter_mut().enumerate().for_each(|(place, entry)| *entry = Lane(now(place)));
            (jacobian.as_slice(), hours, of.simulator.brake())
        });
        dispatch(Cpu::for_lanes(W), Spread { anew, step, even: *even, common, q, p, scratch });
    }

    /// Each output at sample `k` by the states as they are, and its variance by theirs.
    pub fn output(&mut self, output: usize, k: usize) -> (Lane<W>, Lane<W>) {
        let first = self.observe(output, k);
        let n = self.x.len();
        let slope = |i: usize| self.outputs.root(first + 1 + i);
        let mut variance = [0.0; W];
        for (place, p) in self.p.iter().enumerate() {
            let (row, column) = (slope(place / n), slope(place % n));
            (0..W).for_each(|lane| variance[lane] += row[lane] * p.0[lane] * column[lane]);
        }
        (Lane(*self.outputs.root(first)), Lane(variance))
    }

    /// Evaluates the outputs; gives the root of one of them, behind which its gradient stands.
    fn observe(&mut self, output: usize, k: usize) -> usize {
        for (state, value) in self.x.iter().enumerate() {
            *self.outputs.state(state) = value.0;
        }
        self.of.observation_drive.load(&mut self.outputs, k, 0);
        self.outputs.step();
        output * (self.x.len() + 1)
    }

    /// Updates state and covariance with what was measured of an output; gives the innovation and its
    /// variance, and nothing where nothing was measured.
    pub fn update(&mut self, output: usize, k: usize) -> Option<(Lane<W>, Lane<W>)> {
        let (values, valid) = self.of.measured[output];
        if !valid[k] {
            return None;
        }
        let first = self.observe(output, k);
        let Self { x, p, r, scratch, outputs, .. } = self;
        let update = Update { x, p, scratch, outputs, first, value: values[k], sensor: r[output] };
        Some(dispatch(Cpu::for_lanes(W), update))
    }
}

/// The covariance over a step, which is made anew where its Jacobian is another one.
struct Spread<'a, const W: usize> {
    /// The Jacobian, the hours, and who may end it.
    anew: Option<(&'a [Lane<W>], f64, &'a Brake)>,
    step: &'a mut Transition<Lane<W>>,
    even: Option<Lane<W>>,
    common: &'a mut Transition<f64>,
    q: &'a [Lane<W>],
    p: &'a mut [Lane<W>],
    scratch: &'a mut [Lane<W>],
}

impl<const W: usize> Kernel for Spread<'_, W> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { anew, step, even, common, q, p, scratch } = self;
        let n = q.len();
        if let Some((jacobian, hours, brake)) = anew {
            match even {
                Some(variance) if is_common(jacobian) => {
                    step.set_common(common, jacobian, variance, hours, brake);
                }
                _ => step.set_each(jacobian, q, hours, false, brake),
            }
        }
        propagate_small(p, &step.phi, &step.noise, scratch, n);
    }
}

/// Whether all lanes have the same Jacobian.
#[inline(always)]
fn is_common<const W: usize>(jacobian: &[Lane<W>]) -> bool {
    for entry in jacobian {
        for lane in 1..W {
            if entry.0[lane] != entry.0[0] {
                return false;
            }
        }
    }
    true
}

/// A value that is taken in.
struct Update<'a, 't, const W: usize> {
    x: &'a mut [Lane<W>],
    p: &'a mut [Lane<W>],
    scratch: &'a mut [Lane<W>],
    outputs: &'a LaneFile<'t, W>,
    /// The root of the output, before those of its gradient.
    first: usize,
    value: f64,
    sensor: Lane<W>,
}

impl<const W: usize> Kernel for Update<'_, '_, W> {
    /// The innovation and its variance.
    type Output = (Lane<W>, Lane<W>);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { x, p, scratch, outputs, first, value, sensor } = self;
        let n = x.len();
        let shown = outputs.root(first);
        let (mut innovation, mut variance) = ([0.0; W], sensor.0);
        for lane in 0..W {
            innovation[lane] = value - shown[lane];
        }
        for i in 0..n {
            let mut sum = [0.0; W];
            for j in 0..n {
                let slope = outputs.root(first + 1 + j);
                for lane in 0..W {
                    sum[lane] += p[i * n + j].0[lane] * slope[lane];
                }
            }
            scratch[i] = Lane(sum);
            let slope = outputs.root(first + 1 + i);
            for lane in 0..W {
                variance[lane] += slope[lane] * sum[lane];
            }
        }
        for i in 0..n {
            let mut gain = [0.0; W];
            for lane in 0..W {
                gain[lane] = scratch[i].0[lane] / variance[lane];
                x[i].0[lane] += gain[lane] * innovation[lane];
            }
            for j in 0..=i {
                let mut less = p[i * n + j];
                for lane in 0..W {
                    less.0[lane] -= gain[lane] * scratch[j].0[lane];
                }
                (p[i * n + j], p[j * n + i]) = (less, less);
            }
        }
        (Lane(innovation), Lane(variance))
    }
}
