//! What surrounds a synthetic room: weather, sun, neighbours, clock and appliances in steps of three minutes.

use super::dice::Dice;
use crate::data::sun_position;
use crate::data::{DAY, HOUR, MINUTE};
use crate::fault::Fault;

/// Minutes of a step of the truth.
pub const STEP_MINUTES: usize = 3;
/// Steps of a day.
pub const STEPS_PER_DAY: usize = 24 * 60 / STEP_MINUTES;
/// Steps between the nodes of the weather, which moves on straight lines between them.
const NODE: usize = 5;
/// Where the synthetic rooms stand: degrees north and east.
pub const LOCATION: (f64, f64) = (56.5, 10.0);
/// Their clock in winter: hours ahead of UTC.
const ZONE_HOURS: i64 = 1;
/// Neighbours of every room.
pub const NEIGHBOURS: usize = 2;

/// Series in steps of three minutes.
#[derive(Debug)]
pub struct Climate {
    /// Unix milliseconds of the first step.
    pub start: i64,
    pub out: Vec<f64>,
    pub forward: Vec<f64>,
    pub cloud: Vec<f64>,
    pub wind: Vec<f64>,
    pub altitude: Vec<f64>,
    pub azimuth: Vec<f64>,
    pub power: Vec<f64>,
    pub neighbours: Vec<Vec<f64>>,
    /// Local time of day in hours.
    pub hour: Vec<f64>,
    /// Monday is 1, Sunday 7.
    pub weekday: Vec<f64>,
}

impl Climate {
    /// A winter of so many steps.
    pub fn new(dice: &mut Dice, start: i64, steps: usize) -> Result<Self, Fault> {
        let nodes = steps / NODE + 2;
        let day = (STEPS_PER_DAY / NODE) as f64;
        let clock =
            |node: usize| 2.0 * std::f64::consts::PI * ((node * NODE) as f64 / STEPS_PER_DAY as f64 - 0.5);
        let cloud: Vec<f64> =
            dice.wander(nodes, 1.8, day / 2.0).into_iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect();
        let mild = dice.between(-2.0, 6.0);
        let wander = dice.wander(nodes, 3.0, 2.0 * day);
        let out: Vec<f64> =
            wander.into_iter().enumerate().map(|(k, x)| mild + x + 2.5 * (clock(k) - 0.7).cos()).collect();
        let forward: Vec<f64> = dice
            .wander(nodes, 1.5, day / 6.0)
            .into_iter()
            .zip(&out)
            .map(|(x, out)| 36.0 - 0.6 * out + x)
            .collect();
        let gusts = dice.wander(nodes, 0.6, day / 3.0);
        let wind: Vec<f64> = gusts.into_iter().map(|x| 4.5 * x.exp()).collect();
        let neighbours = (0..NEIGHBOURS).map(|_| neighbour(dice, nodes, day, clock)).collect::<Vec<_>>();
        let mut altitude = Vec::with_capacity(nodes);
        let mut azimuth = Vec::with_capacity(nodes);
        for node in 0..nodes {
            let sun =
                sun_position(start + (node * NODE * STEP_MINUTES) as i64 * MINUTE, LOCATION.0, LOCATION.1)?;
            altitude.push(sun.altitude);
            azimuth.push(sun.azimuth);
        }
        let local = |step: usize| start + (step * STEP_MINUTES) as i64 * MINUTE + HOUR * ZONE_HOURS;
        let hour: Vec<f64> =
            (0..steps).map(|step| local(step).rem_euclid(DAY) as f64 / HOUR as f64).collect();
        // The first of January 1970 was a Thursday.
        let weekday =
            (0..steps).map(|step| ((local(step).div_euclid(DAY) + 3).rem_euclid(7) + 1) as f64).collect();
        Ok(Self {
            start,
            out: between(&out, steps),
            forward: between(&forward, steps),
            cloud: between(&cloud, steps),
            wind: between(&wind, steps),
            altitude: between(&altitude, steps),
            azimuth: between(&azimuth, steps),
            power: appliances(dice, &hour),
            neighbours: neighbours.iter().map(|nodes| between(nodes, steps)).collect(),
            hour,
            weekday,
        })
    }

    /// Kasten and Czeplak's sun on the horizontal, as a share of the clear sun at the zenith.
    pub fn sun(&self, step: usize) -> f64 {
        self.altitude[step].to_radians().sin().max(0.0) * self.clearness(step)
    }

    /// The share of the sun that the clouds let through.
    pub fn clearness(&self, step: usize) -> f64 {
        1.0 - 0.75 * self.cloud[step].powf(3.4)
    }
}

/// The temperature of a neighbour, kept by people of its own.
fn neighbour(dice: &mut Dice, nodes: usize, day: f64, clock: impl Fn(usize) -> f64) -> Vec<f64> {
    let (level, phase) = (dice.between(18.5, 23.0), dice.between(0.0, 6.0));
    let wander = dice.wander(nodes, 0.7, day / 3.0);
    wander.into_iter().enumerate().map(|(k, x)| level + x + 0.5 * (clock(k) - phase).cos()).collect()
}

/// Straight lines between the nodes.
fn between(nodes: &[f64], steps: usize) -> Vec<f64> {
    (0..steps)
        .map(|step| {
            let (node, part) = (step / NODE, (step % NODE) as f64 / NODE as f64);
            nodes[node] * (1.0 - part) + nodes[node + 1] * part
        })
        .collect()
}

/// The power of the appliances in kW: a base load, and bouts of an hour or so at breakfast, in the evening
/// and now and then, constant over a quarter of an hour.
fn appliances(dice: &mut Dice, hour: &[f64]) -> Vec<f64> {
    let mut power = vec![0.05; hour.len()];
    for day in 0..hour.len() / STEPS_PER_DAY + 1 {
        for (likely, from, to) in [(0.6, 5.0, 9.0), (0.5, 10.0, 16.0), (0.8, 16.0, 21.0), (0.4, 19.0, 23.0)] {
            if dice.uniform() < likely {
                let at = ((day as f64 + dice.between(from, to) / 24.0) * STEPS_PER_DAY as f64) as usize
                    / NODE
                    * NODE;
                let length = NODE * (1 + (dice.uniform() * 9.0) as usize);
                let size = dice.log_between(0.2, 1.5);
                power.iter_mut().skip(at).take(length).for_each(|kw| *kw += size);
            }
        }
    }
    power
}
