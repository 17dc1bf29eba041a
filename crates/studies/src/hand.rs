//! The room of the thesis written out by hand: the yardstick of the tape.

use lampyris_core::cpu::{Cpu, Kernel, dispatch};
use lampyris_core::estimate::Problem;
use lampyris_core::model::math;
use lampyris_core::simulate::LANES;

const GAMMA: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;

/// The measured inputs of a room3 problem with four neighbours.
pub struct HandRoom {
    forward: Vec<f64>,
    out: Vec<f64>,
    sun: Vec<f64>,
    cloud: Vec<f64>,
    neighbours: [Vec<f64>; 4],
    start: f64,
    hours: f64,
}

/// Parameters of a block, by their order in room3.
struct Block {
    p: [[f64; LANES]; 15],
}

/// What all candidates share at one instant: forward, out, solar term, neighbours.
#[derive(Clone, Copy)]
pub struct Weather {
    forward: f64,
    out: f64,
    sun: f64,
    neighbours: [f64; 4],
}

impl HandRoom {
    pub fn new(problem: &Problem) -> Self {
        let column = |name: &str| {
            problem.grid().column(name).map(|column| column.values().to_vec()).unwrap_or_default()
        };
        Self {
            forward: column("T_forward"),
            out: column("T_out"),
            sun: column("sun_altitude"),
            cloud: column("cloud_cover"),
            neighbours: ["T_room_1", "T_room_2", "T_room_3", "T_room_4"].map(column),
            start: problem.simulator().measured_start(0).unwrap_or(20.0),
            hours: problem.grid().step_hours(),
        }
    }

    fn weather(&self, k: usize, fraction: f64) -> Weather {
        let next = (k + 1).min(self.out.len() - 1);
        let at = |values: &[f64]| values[k] + (values[next] - values[k]) * fraction;
        let cloud = at(&self.cloud);
        Weather {
            forward: at(&self.forward),
            out: at(&self.out),
            sun: math::sin(at(&self.sun).to_radians()).max(0.0) * (1.0 - 0.75 * math::pow(cloud, 3.4)),
            neighbours: std::array::from_fn(|n| at(&self.neighbours[n])),
        }
    }

    /// Simulates a block of candidates with ROS2 at one step per sample.
    pub fn run(&self, thetas: &[&[f64]]) -> Vec<Vec<f64>> {
        let p = std::array::from_fn(|parameter| {
            std::array::from_fn(|lane| thetas[lane.min(thetas.len() - 1)][parameter])
        });
        let samples = dispatch(Cpu::detect(), Ros2 { room: self, block: Block { p } });
        (0..thetas.len()).map(|lane| samples.iter().map(|sample| sample[lane]).collect()).collect()
    }
}

/// The order of room3's parameters with four neighbours.
#[derive(Clone, Copy)]
enum P {
    AlphaH,
    AlphaE,
    AlphaW,
    AlphaA,
    AlphaS,
    AlphaN,
    BetaH = 9,
    BetaHe,
    K,
    Set,
    Floor,
    Envelope,
}

struct Ros2<'a> {
    room: &'a HandRoom,
    block: Block,
}

impl Kernel for Ros2<'_> {
    type Output = Vec<[f64; LANES]>;

    #[inline(always)]
    fn run(self) -> Vec<[f64; LANES]> {
        let room = self.room;
        let p = |which: P| &self.block.p[which as usize];
        let n = room.out.len();
        let (h, gh) = (room.hours, GAMMA * room.hours);
        let mut r = [room.start; LANES];
        let mut f = *p(P::Floor);
        let mut e = *p(P::Envelope);
        let mut series = Vec::with_capacity(n);
        series.push(r);
        // What does not change from step to step.
        let mut constant = [[0.0; LANES]; 7];
        for i in 0..LANES {
            let floor = p(P::AlphaH)[i] / p(P::BetaH)[i];
            let envelope = p(P::AlphaE)[i] / p(P::BetaHe)[i];
            let neighbours: f64 = (0..4).map(|n| self.block.p[P::AlphaN as usize + n][i]).sum();
            constant[0][i] = floor;
            constant[1][i] = envelope;
            constant[2][i] = neighbours;
            constant[3][i] = 1.0 + gh * (p(P::AlphaH)[i] + p(P::AlphaE)[i]);
            constant[4][i] = 1.0 / (1.0 + gh * (envelope + p(P::AlphaA)[i] + neighbours));
            constant[5][i] = gh * p(P::AlphaH)[i];
            constant[6][i] = gh * p(P::AlphaE)[i];
        }
        for k in 0..n - 1 {
            let (a, b) = (room.weather(k, 0.0), room.weather(k, 1.0));
            // The solar term's derivative as the tape has it, by the inputs' slopes.
            let slope = |x: f64, y: f64| (y - x) / h;
            let sun_rate = self.sun_rate(k);
            for i in 0..LANES {
                let alpha = |which: P| p(which)[i];
                let flow = |r: f64| 1.0 / (1.0 + math::exp(alpha(P::K) * (r - alpha(P::Set))));
                let (af, ae) = (constant[0][i], constant[1][i]);
                let rates = |r: f64, f: f64, e: f64, w: &Weather, m: f64| {
                    let mut gain = alpha(P::AlphaA) * (w.out - e);
                    for n in 0..4 {
                        gain += self.block.p[P::AlphaN as usize + n][i] * (w.neighbours[n] - e);
                    }
                    (
                        alpha(P::AlphaH) * (f - r) + alpha(P::AlphaE) * (e - r) + alpha(P::AlphaS) * w.sun,
                        af * (r - f) + alpha(P::AlphaW) * m * (w.forward - f),
                        ae * (r - e) + gain,
                    )
                };
                let m = flow(r[i]);
                let heat = alpha(P::AlphaW) * (a.forward - f[i]);
                let by_room = -alpha(P::K) * m * (1.0 - m) * heat;
                let (f1, f2, f3) = rates(r[i], f[i], e[i], &a, m);
                let mut moved = alpha(P::AlphaA) * slope(a.out, b.out);
                for n in 0..4 {
                    moved +=
                        self.block.p[P::AlphaN as usize + n][i] * slope(a.neighbours[n], b.neighbours[n]);
                }
                let (d1, d2, d3) = (
                    gh * alpha(P::AlphaS) * sun_rate,
                    gh * alpha(P::AlphaW) * m * slope(a.forward, b.forward),
                    gh * moved,
                );
                // (I - gh J) x = y by elimination of floor and envelope.
                let floor_pivot = 1.0 / (1.0 + gh * (af + alpha(P::AlphaW) * m));
                let floor_room = -gh * (af + by_room);
                let envelope_room = -gh * ae;
                let (floor_factor, envelope_factor) =
                    (constant[5][i] * floor_pivot, constant[6][i] * constant[4][i]);
                let room_pivot =
                    1.0 / (constant[3][i] + floor_factor * floor_room + envelope_factor * envelope_room);
                let solve = |y1: f64, y2: f64, y3: f64| {
                    let x1 = (y1 + floor_factor * y2 + envelope_factor * y3) * room_pivot;
                    (x1, (y2 - floor_room * x1) * floor_pivot, (y3 - envelope_room * x1) * constant[4][i])
                };
                let (k1, k2, k3) = solve(f1 + d1, f2 + d2, f3 + d3);
                let (r1, t1, e1) = (r[i] + h * k1, f[i] + h * k2, e[i] + h * k3);
                let (g1, g2, g3) = rates(r1, t1, e1, &b, flow(r1));
                let (l1, l2, l3) = solve(g1 - 2.0 * k1 - d1, g2 - 2.0 * k2 - d2, g3 - 2.0 * k3 - d3);
                r[i] = r1 + 0.5 * h * (k1 + l1);
                f[i] = t1 + 0.5 * h * (k2 + l2);
                e[i] = e1 + 0.5 * h * (k3 + l3);
            }
            series.push(r);
        }
        series
    }
}

impl Ros2<'_> {
    /// d/dt of the solar term over sample interval `k`.
    fn sun_rate(&self, k: usize) -> f64 {
        let room = self.room;
        let (altitude, cloud) = (room.sun[k].to_radians(), room.cloud[k]);
        if altitude <= 0.0 {
            return 0.0;
        }
        let altitude_slope = (room.sun[k + 1] - room.sun[k]).to_radians() / room.hours;
        let cloud_slope = (room.cloud[k + 1] - room.cloud[k]) / room.hours;
        math::cos(altitude) * altitude_slope * (1.0 - 0.75 * math::pow(cloud, 3.4))
            - math::sin(altitude) * 0.75 * 3.4 * math::pow(cloud, 2.4) * cloud_slope
    }
}

/// The inputs at the start and the middle of every sub-step, computed once as any careful program would.
pub fn half_steps(room: &HandRoom, substeps: usize) -> Vec<Weather> {
    let halves = 2 * substeps;
    let last = room.out.len() - 1;
    (0..last * halves)
        .map(|i| room.weather(i / halves, (i % halves) as f64 / halves as f64))
        .chain([room.weather(last, 0.0)])
        .collect()
}

/// One candidate with the classical Runge-Kutta method, as a scalar program would do it.
pub fn scalar_rk4(room: &HandRoom, weather: &[Weather], theta: &[f64], substeps: usize) -> Vec<f64> {
    let p = |which: P| theta[which as usize];
    let h = room.hours / substeps as f64;
    let rates = |x: [f64; 3], w: &Weather| {
        let [r, f, e] = x;
        let m = 1.0 / (1.0 + (p(P::K) * (r - p(P::Set))).exp());
        let neighbours: f64 = (0..4).map(|n| theta[P::AlphaN as usize + n] * (w.neighbours[n] - e)).sum();
        [
            p(P::AlphaH) * (f - r) + p(P::AlphaE) * (e - r) + p(P::AlphaS) * w.sun,
            p(P::AlphaH) / p(P::BetaH) * (r - f) + p(P::AlphaW) * m * (w.forward - f),
            p(P::AlphaE) / p(P::BetaHe) * (r - e) + p(P::AlphaA) * (w.out - e) + neighbours,
        ]
    };
    let moved = |x: [f64; 3], k: [f64; 3], step: f64| std::array::from_fn(|i| x[i] + step * k[i]);
    let mut x = [room.start, p(P::Floor), p(P::Envelope)];
    let mut series = vec![x[0]];
    for k in 0..room.out.len() - 1 {
        for step in 0..substeps {
            let now = 2 * (k * substeps + step);
            let k1 = rates(x, &weather[now]);
            let k2 = rates(moved(x, k1, h / 2.0), &weather[now + 1]);
            let k3 = rates(moved(x, k2, h / 2.0), &weather[now + 1]);
            let k4 = rates(moved(x, k3, h), &weather[now + 2]);
            x = std::array::from_fn(|i| x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
        }
        series.push(x[0]);
    }
    series
}
