//! A synthetic room that hides effects: equations written out by hand, steps of three minutes, a fourth-order
//! method. Nothing of the engine takes part, so that a diagnosis is not judged by what it judges with.

use super::climate::{Climate, NEIGHBOURS, STEP_MINUTES, STEPS_PER_DAY};
use super::dice::Dice;
use super::hidden::{Hidden, Kind};
use super::measured::{MEASURED, MoreSeries};
use super::rates::{ChangedParameter, Rates};
use crate::data::rfc3339;
use crate::data::{DAY, MINUTE, SECOND};
use crate::fault::Fault;
use serde::Serialize;
use std::fmt::Write;

/// Days before the window in which the masses find their temperatures.
const WARM_UP_DAYS: usize = 6;
/// Monday, 2026-01-12T00:00:00Z; a window starts up to five weeks later.
const START: i64 = 1_768_176_000 * SECOND;
/// Step of the sensor's display in K.
const QUANTUM: f64 = 0.1;
/// Deviation of the sensor's noise in K.
const SENSOR_NOISE: f64 = 0.05;
/// Blinds close over some tenths of a kelvin.
const BLINDS: f64 = 0.1;
/// What is measured beyond has another seed, that differs by this.
const MORE: u64 = 0x6d6f_7265;
/// How far ahead it is asked what the hidden effects do, in hours.
const AHEAD_HOURS: f64 = 12.0;
/// Hours of a step.
const HOURS: f64 = STEP_MINUTES as f64 / 60.0;

/// How far the truth is from the model's structure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// The structure of `room3`, household heat without a meter, the hidden effect.
    Matched,
    /// Two thermal masses more: furniture and a second layer of the wall.
    Rich,
}

/// What a world is to be like.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldRequest {
    /// Fixes everything that is drawn.
    pub seed: u64,
    /// The effects that it hides; none hides nothing.
    pub effects: Vec<String>,
    /// Distance to the model.
    pub level: Level,
    /// Length of the window.
    pub days: usize,
    /// Minutes between samples, a multiple of three.
    pub step_minutes: usize,
    /// Whether air, rain and two more meters are measured as well.
    pub more: bool,
    /// A parameter that is another one from a day on; `None` where nothing changes.
    pub change: Option<ChangedParameter>,
    /// What somebody sets the forward temperature to over a part of it.
    pub driven: Option<DrivenForward>,
}

/// A forward temperature that is set. Nothing else of the world differs from that which is left alone.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenForward {
    /// The sample of the window at which it begins.
    pub from: usize,
    /// degC at each sample from there on, on straight lines between them.
    pub values: Vec<f64>,
}

impl WorldRequest {
    /// Four weeks of quarter hours; more is measured where a hidden effect follows from it.
    pub fn new(seed: u64, effects: &[&str], level: Level) -> Self {
        Self {
            seed,
            effects: effects.iter().map(|effect| (*effect).to_owned()).collect(),
            level,
            days: 28,
            step_minutes: 15,
            more: effects.iter().any(|effect| MEASURED.contains(effect)),
            change: None,
            driven: None,
        }
    }
}

impl DrivenForward {
    /// The forward temperature of a climate, set as it is told.
    fn set(&self, forward: &mut [f64], per_sample: usize) {
        let first = WARM_UP_DAYS * STEPS_PER_DAY + self.from * per_sample;
        for (sample, pair) in self.values.windows(2).enumerate() {
            for step in 0..=per_sample {
                let part = step as f64 / per_sample as f64;
                if let Some(value) = forward.get_mut(first + sample * per_sample + step) {
                    *value = pair[0] + part * (pair[1] - pair[0]);
                }
            }
        }
    }
}

/// A synthetic room with hidden effects.
#[derive(Debug, Clone)]
pub struct World {
    /// The measurements as CSV.
    pub csv: String,
    /// Names of the neighbours, the members of the model's set.
    pub neighbours: Vec<String>,
    /// What the measurements do not say.
    pub truth: Truth,
    /// What the base model would need to know of the room: its parameters, without its starts.
    pub parameters: Vec<(String, f64)>,
    /// The heat of the household that flows into the room air, in K/h: its mean from each sample to the next.
    pub household: Vec<f64>,
    /// That of the hidden effects.
    pub hidden_heat: Vec<f64>,
}

/// What is hidden.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Truth {
    /// The seed.
    pub seed: u64,
    /// The level.
    pub level: Level,
    /// The effects.
    pub effects: Vec<HiddenEffect>,
    /// What forecasts over the next 12 h lose without all of them: root mean square over the window in K,
    /// every stretch of 12 h from the room's own state.
    pub ahead: f64,
    /// Deviation of the household heat that no meter sees, in K/h.
    pub household_heat: f64,
    /// Deviation of the sensor's noise in K.
    pub sensor_noise: f64,
}

/// One hidden effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HiddenEffect {
    /// The catalogue's name for it, or that of an effect that no catalogue has.
    pub effect: String,
    /// Whether the catalogue has it.
    pub in_catalogue: bool,
    /// In the unit of the catalogue's coefficient.
    pub strength: f64,
    /// Deviation of the room temperature with it from that without it, in K.
    pub moves: f64,
}

/// Room air, floor, envelope, furniture, outer wall, sensor.
type State = [f64; 6];

struct Room {
    rates: Rates,
    /// From a step on they are others.
    later: Option<(usize, Rates)>,
    level: Level,
    climate: Climate,
    more: Option<MoreSeries>,
    /// Household heat in K/h per step.
    heat: Vec<f64>,
}

/// Makes a world.
///
/// # Errors
/// A fault for an effect that no twin can hide, and for a sampling that is no multiple of three minutes.
pub fn world(request: &WorldRequest) -> Result<World, Fault> {
    if request.step_minutes == 0 || !request.step_minutes.is_multiple_of(STEP_MINUTES) || request.days == 0 {
        return Err(Fault::new(
            "/step",
            "bad-step",
            format!("a twin is sampled every {STEP_MINUTES}, 6, … minutes, for a day or more"),
        ));
    }
    let mut dice = Dice::new(request.seed);
    let start = START + DAY * ((dice.uniform() * 35.0) as i64 - WARM_UP_DAYS as i64);
    let steps = (request.days + WARM_UP_DAYS) * STEPS_PER_DAY + 1;
    let climate = Climate::new(&mut dice, start, steps)?;
    let household_heat = dice.between(0.02, 0.10);
    let memory = dice.between(0.5, 3.0) / HOURS;
    let heat = dice.wander(steps, household_heat, memory);
    // What is drawn beyond has dice of its own, so that all else is the same with it and without.
    let mut others = Dice::new(request.seed ^ MORE);
    let more = request.more.then(|| MoreSeries::new(&mut others, &climate));
    let mut rates = Rates::new(&mut dice);
    if request.effects.iter().any(|effect| effect == "blinds") {
        // Blinds are where the sun is too much.
        rates.s = others.log_between(7.0, 14.0);
    }
    let first_day = WARM_UP_DAYS * STEPS_PER_DAY;
    let later = |change: &ChangedParameter| {
        Ok::<_, Fault>((first_day + change.day * STEPS_PER_DAY, rates.changed(change)?))
    };
    let later = request.change.as_ref().map(later).transpose()?;
    let mut room = Room { rates, later, level: request.level, climate, more, heat };
    let bare = shown(&room.states(&[]), &[]);
    let mut hidden = Vec::new();
    let mut effects = Vec::new();
    for name in &request.effects {
        let kind = Kind::named(name, &mut dice)?.fitting(&room.climate, &bare, first_day, &mut others);
        let shape = kind.shape(&mut dice, &room.climate, room.more.as_ref());
        let sign = if kind.two_sided() && dice.uniform() < 0.5 { -1.0 } else { 1.0 };
        let (effect, moves) = room.sized(
            Hidden { kind, strength: sign * kind.strongest(), shape },
            &bare,
            dice.between(0.2, 0.8),
        );
        effects.push(HiddenEffect {
            effect: kind.id(),
            in_catalogue: kind.in_catalogue(),
            strength: effect.strength,
            moves,
        });
        hidden.push(effect);
    }
    let per_sample = request.step_minutes / STEP_MINUTES;
    if let Some(driven) = &request.driven {
        driven.set(&mut room.climate.forward, per_sample);
    }
    let states = room.states(&hidden);
    let measured = shown(&states, &hidden);
    let contact =
        hidden.iter().find(|effect| effect.kind == Kind::Window).filter(|_| dice.uniform() < 0.5).cloned();
    let csv = write(&room, &measured, request, contact.as_ref(), &mut dice);
    let neighbours = (1..=NEIGHBOURS).map(|n| n.to_string()).collect();
    let ahead = room.ahead(&states, &hidden, per_sample);
    let truth = Truth {
        seed: request.seed,
        level: request.level,
        effects,
        ahead,
        household_heat,
        sensor_noise: SENSOR_NOISE,
    };
    let first = WARM_UP_DAYS * STEPS_PER_DAY;
    let by_sample = |heat: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let heat: Vec<f64> = (first..states.len() - 1).map(heat).collect();
        heat.chunks(per_sample).map(|steps| steps.iter().sum::<f64>() / steps.len() as f64).collect()
    };
    let household = by_sample(&|k| room.heat[k]);
    let air = |k: usize, hidden: &[Hidden]| room.slope(&states[k], k, 0.5, hidden)[0];
    let hidden_heat = by_sample(&|k| air(k, &hidden) - air(k, &[]));
    let parameters = room.rates.parameters();
    Ok(World { csv, neighbours, truth, parameters, household, hidden_heat })
}

impl Room {
    /// The states at every step.
    fn states(&self, hidden: &[Hidden]) -> Vec<State> {
        let t_set = self.rates.t_set;
        let mut states = vec![[t_set, t_set + 4.0, t_set - 3.0, t_set, t_set - 6.0, t_set]];
        for k in 1..self.heat.len() {
            states.push(self.next(&states[k - 1], k - 1, hidden));
        }
        states
    }

    /// The states a step after step `k`.
    fn next(&self, x: &State, k: usize, hidden: &[Hidden]) -> State {
        let at = |x: &State, part: f64| self.slope(x, k, part, hidden);
        let moved = |slope: &State, part: f64| std::array::from_fn(|i| x[i] + part * HOURS * slope[i]);
        let k1 = at(x, 0.0);
        let k2 = at(&moved(&k1, 0.5), 0.5);
        let k3 = at(&moved(&k2, 0.5), 0.5);
        let k4 = at(&moved(&k3, 1.0), 1.0);
        std::array::from_fn(|i| x[i] + HOURS / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]))
    }

    /// What forecasts over [`AHEAD_HOURS`] lose without the hidden effects, at every so many steps of the
    /// window.
    fn ahead(&self, states: &[State], hidden: &[Hidden], stride: usize) -> f64 {
        let first = WARM_UP_DAYS * STEPS_PER_DAY;
        let measured = shown(states, hidden);
        let (mut squares, mut count) = (0.0, 0usize);
        for from in (first..states.len()).step_by((AHEAD_HOURS / HOURS) as usize) {
            let to = (from + (AHEAD_HOURS / HOURS) as usize).min(states.len());
            let mut x = states[from];
            // What a drift has come to by then stays.
            let error = drift(hidden) * days(from);
            for k in from..to {
                if (k - from).is_multiple_of(stride) {
                    squares += (measured[k] - x[0] - error).powi(2);
                    count += 1;
                }
                if k + 1 < to {
                    x = self.next(&x, k, &[]);
                }
            }
        }
        (squares / count.max(1) as f64).sqrt()
    }

    /// The derivative per hour, `part` of the way from step `k` to the next.
    fn slope(&self, x: &State, k: usize, part: f64, hidden: &[Hidden]) -> State {
        let climate = &self.climate;
        let rates = match &self.later {
            Some((from, later)) if k >= *from => later,
            _ => &self.rates,
        };
        let line = |series: &[f64]| series[k] + part * (series[k + 1] - series[k]);
        let [room, floor, envelope, furniture, wall, sensor] = *x;
        let (out, mut forward) = (line(&climate.out), line(&climate.forward));
        let mut flow = 1.0 / (1.0 + (rates.k * (room - rates.t_set)).exp());
        let sun = climate.sun(k) + part * (climate.sun(k + 1) - climate.sun(k));
        let (mut gain, mut wall_gain, mut emitted, mut lag) = (self.heat[k], 0.0, 1.0, 1.0);
        for Hidden { kind, strength, shape } in hidden {
            let (c, shape) = (*strength, shape[k]);
            match kind {
                Kind::Wind => gain += c * line(&climate.wind) * (out - room),
                Kind::Window | Kind::Ventilation | Kind::Fan => gain += c * shape * (out - room),
                Kind::Blinds(above) => gain -= c * rates.s * shape / (1.0 + (-(room - above) / BLINDS).exp()),
                Kind::Door(n) => gain += c * shape * (line(&climate.neighbours[*n]) - room),
                Kind::Outdoor => gain += c * (out - room),
                Kind::People
                | Kind::Facade(_)
                | Kind::Constant
                | Kind::Stove
                | Kind::Laundry
                | Kind::Rain
                | Kind::NextDoor
                | Kind::Heater => gain += c * shape,
                Kind::Metered => gain += c * climate.power[k],
                Kind::Sky => wall_gain -= c * shape,
                Kind::Wall => wall_gain += c * shape,
                Kind::Exponent => emitted = (((floor - room).powi(2) + 0.0625) / 16.0).powf(c / 2.0),
                Kind::Setback => flow *= 1.0 - c * shape,
                Kind::Delay => forward = climate.forward[k.saturating_sub((c / HOURS) as usize)],
                Kind::Lag => lag = 1.0 / c.max(0.05),
                Kind::Drift => {}
            }
        }
        let emitted = rates.h * (floor - room) * emitted;
        let mut slope = [0.0; 6];
        slope[0] = emitted + rates.e * (envelope - room) + rates.s * sun + gain;
        slope[1] = -emitted / rates.floor + rates.w * flow * (forward - floor);
        slope[2] = rates.e / rates.envelope * (room - envelope) + wall_gain;
        for (rate, neighbour) in rates.n.iter().zip(&climate.neighbours) {
            slope[2] += rate * (line(neighbour) - envelope);
        }
        match self.level {
            Level::Matched => slope[2] += rates.a * (out - envelope),
            Level::Rich => {
                let ((touch, mass), (through, layer)) = (rates.furniture, rates.wall);
                slope[0] += touch * (furniture - room);
                slope[3] = touch / mass * (room - furniture);
                slope[2] += through * (wall - envelope);
                slope[4] = through / layer * (envelope - wall) + rates.a * (out - wall);
            }
        }
        slope[5] = lag * (room - sensor);
        slope
    }

    /// The effect with the strength that moves the room by `wanted` K (standard deviation), or the strongest
    /// that physics allows; and by how much it does.
    fn sized(&self, mut effect: Hidden, bare: &[f64], wanted: f64) -> (Hidden, f64) {
        let strongest = effect.strength;
        let mut moves = |strength: f64| {
            effect.strength = strength;
            let difference: Vec<f64> =
                shown(&self.states(std::slice::from_ref(&effect)), std::slice::from_ref(&effect))
                    .iter()
                    .zip(bare)
                    .map(|(with, bare)| with - bare)
                    .collect();
            deviation(&difference[WARM_UP_DAYS * STEPS_PER_DAY..])
        };
        let mut moved = moves(strongest);
        if moved > wanted {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..12 {
                let middle = 0.5 * (low + high);
                moved = moves(strongest * middle);
                *(if moved > wanted { &mut high } else { &mut low }) = middle;
            }
        }
        (effect, moved)
    }
}

/// Days since the window began.
fn days(k: usize) -> f64 {
    (k as f64 - (WARM_UP_DAYS * STEPS_PER_DAY) as f64) / STEPS_PER_DAY as f64
}

/// How fast the sensor drifts, in K a day.
fn drift(hidden: &[Hidden]) -> f64 {
    hidden.iter().filter(|effect| effect.kind == Kind::Drift).map(|effect| effect.strength).sum()
}

/// What a perfect sensor of this kind shows at every step.
fn shown(states: &[State], hidden: &[Hidden]) -> Vec<f64> {
    let sensor = if hidden.iter().any(|effect| effect.kind == Kind::Lag) { 5 } else { 0 };
    let drift = drift(hidden);
    states.iter().enumerate().map(|(k, state)| state[sensor] + drift * days(k)).collect()
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// The measurements as a logger writes them: noise, rounding, gaps.
fn write(
    room: &Room,
    shown: &[f64],
    request: &WorldRequest,
    contact: Option<&Hidden>,
    dice: &mut Dice,
) -> String {
    let (climate, more) = (&room.climate, room.more.as_ref());
    let first = WARM_UP_DAYS * STEPS_PER_DAY;
    let per_sample = request.step_minutes / STEP_MINUTES;
    let samples = (shown.len() - 1 - first) / per_sample + 1;
    let mut lost = vec![false; samples];
    for _ in 0..1 + (dice.uniform() * 3.0) as usize {
        let from = (dice.uniform() * samples as f64) as usize;
        let count = (dice.between(1.0, 8.0) * 60.0 / request.step_minutes as f64) as usize;
        lost.iter_mut().skip(from.max(8)).take(count).for_each(|lost| *lost = true);
    }
    let mut csv = String::from(
        "time,T_room,T_out,T_forward,sun_altitude,sun_azimuth,cloud_cover,wind_speed,P_appliances",
    );
    for n in 1..=NEIGHBOURS {
        let _ = write!(csv, ",T_room_{n}");
    }
    csv.push_str(",hour_of_day[h],weekday");
    if more.is_some() {
        csv.push_str(",CO2[ppm],rain[mm/h],P_next_door,P_heater");
    }
    csv.push_str(if contact.is_some() { ",window_open\n" } else { "\n" });
    for sample in 0..samples {
        let k = first + sample * per_sample;
        let temperature = ((shown[k] + SENSOR_NOISE * dice.normal()) / QUANTUM).round() * QUANTUM;
        let held = |series: &[f64]| {
            series[k..(k + per_sample).min(series.len())].iter().sum::<f64>() / per_sample as f64
        };
        let _ = write!(csv, "{},", rfc3339(climate.start + (k * STEP_MINUTES) as i64 * MINUTE));
        if !lost[sample] {
            let _ = write!(csv, "{temperature:.1}");
        }
        let weather = [climate.out[k], climate.forward[k], climate.altitude[k], climate.azimuth[k]];
        for value in weather {
            let _ = write!(csv, ",{value:.2}");
        }
        let _ = write!(csv, ",{:.3},{:.2},{:.3}", climate.cloud[k], climate.wind[k], held(&climate.power));
        for neighbour in &climate.neighbours {
            let _ = write!(csv, ",{:.2}", neighbour[k] + SENSOR_NOISE * dice.normal());
        }
        let _ = write!(csv, ",{:.4},{}", climate.hour[k], climate.weekday[k]);
        if let Some(MoreSeries { co2, rain, next_door, heater }) = more {
            let _ = write!(csv, ",{:.0},{:.2}", co2[k], held(rain));
            let _ = write!(csv, ",{:.3},{:.3}", held(next_door), held(heater));
        }
        if let Some(contact) = contact {
            let _ = write!(csv, ",{:.2}", held(&contact.shape));
        }
        csv.push('\n');
    }
    csv
}

#[cfg(test)]
mod tests {
    use super::super::hidden::names;
    use super::*;

    #[test]
    fn every_effect_moves_the_room_and_is_the_same_for_the_same_seed() {
        for (index, name) in names().enumerate() {
            let request =
                WorldRequest { days: 7, ..WorldRequest::new(700 + index as u64, &[name], Level::Matched) };
            let hiding = world(&request).unwrap();
            assert_eq!(hiding.csv, world(&request).unwrap().csv);
            let moves = hiding.truth.effects[0].moves;
            assert!(moves > 0.001 && moves < 1.0, "{name} moves the room by {moves} K");
            assert!(!hiding.csv.contains("NaN"), "{name}");
        }
    }

    #[test]
    fn both_levels_stay_warm_and_a_window_holds_no_truth() {
        for level in [Level::Matched, Level::Rich] {
            let world = world(&WorldRequest { days: 7, ..WorldRequest::new(5, &["stove"], level) }).unwrap();
            let shown =
                world.csv.lines().skip(1).filter_map(|line| line.split(',').nth(1)?.parse::<f64>().ok());
            assert!(shown.clone().count() > 500 && shown.clone().all(|t| (10.0..30.0).contains(&t)));
            assert!(!world.csv.contains("stove"));
        }
        assert!(world(&WorldRequest::new(5, &["ghost"], Level::Matched)).is_err());
    }
}
