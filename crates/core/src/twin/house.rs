//! The house of the thesis's chapter 7 with a known truth: eleven rooms that warm each other through their
//! walls, valves that follow thermostats, seventeen sensors. Equations written out by hand, steps of three
//! minutes, a fourth-order method, as in `world`.
//!
//! Each room is of the structure of `room3`; what the model does not know is what a house has: set-points
//! that are lowered at night in some rooms, the heat of people and appliances, and a plan that nobody tells.

use super::climate::{Climate, STEP_MINUTES, STEPS_PER_DAY};
use super::dice::Dice;
use crate::data::rfc3339;
use crate::data::{self, DAY, MINUTE};
use crate::fault::Fault;
use serde::Serialize;
use std::fmt::Write;

/// Days before the window in which the masses find their temperatures.
const WARM_UP_DAYS: usize = 8;
/// Monday, 2026-03-02T00:00:00Z.
const START: i64 = 1_772_409_600 * data::SECOND;
/// Deviation of the noise of every sensor in K.
const SENSOR_NOISE: f64 = 0.05;
/// Hours of a step.
const HOURS: f64 = STEP_MINUTES as f64 / 60.0;
/// The rooms, by the number of their first sensor: those that the thesis kept.
const ROOMS: [u32; 11] = [0, 1, 2, 3, 4, 5, 6, 7, 12, 15, 17];
/// Second sensors, and the room in which each hangs.
const SECOND: [(u32, u32); 6] = [(8, 0), (9, 1), (10, 4), (11, 4), (13, 12), (14, 15)];
/// The plan: which rooms share a wall.
const WALLS: [(u32, u32); 15] = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 4),
    (4, 5),
    (6, 7),
    (7, 12),
    (12, 15),
    (15, 17),
    (0, 6),
    (1, 7),
    (2, 12),
    (4, 15),
    (4, 17),
    (5, 17),
];
/// Rooms whose thermostats are turned down at night.
const LOWERED: [u32; 6] = [1, 3, 4, 5, 12, 17];
/// Rooms with large windows to the sun.
const SUNNY: [u32; 3] = [0, 4, 15];

/// What a house is to be like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HouseRequest {
    /// Fixes everything that is drawn.
    pub seed: u64,
    /// Length of the window.
    pub days: usize,
    /// Minutes between samples, a multiple of three.
    pub step_minutes: usize,
    /// Whether people live in it: heat that no meter sees, and thermostats that are turned down at night.
    pub lived_in: bool,
}

/// A house with a known truth.
#[derive(Debug, Clone)]
pub struct HouseTwin {
    /// Weather, forward temperature, every sensor `T_room_<number>` and the valve `valve_<room>` of every
    /// room.
    pub csv: String,
    /// The rooms as they are, by the number of their first sensor.
    pub rooms: Vec<RoomTruth>,
    /// Deviation of the sensors' noise in K.
    pub sensor_noise: f64,
}

/// What nobody knows of a room.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RoomTruth {
    /// Its number, which is that of its first sensor.
    pub room: u32,
    /// Its sensors.
    pub sensors: Vec<u32>,
    /// The rooms behind its walls.
    pub neighbours: Vec<u32>,
    /// Its set-point by day in degC.
    pub t_set: f64,
    /// By how much it is lowered at night, in K.
    pub lowered: f64,
    /// Deviation of the heat that no meter sees, in K/h.
    pub household_heat: f64,
    /// What `room3` calls parameters, without the thermostat and the starts.
    pub parameters: Vec<(String, f64)>,
}

/// Room air, floor, envelope.
type State = [f64; 3];

struct Room {
    h: f64,
    e: f64,
    w: f64,
    a: f64,
    s: f64,
    /// The places of its neighbours, and how well each is felt.
    n: Vec<(usize, f64)>,
    floor: f64,
    envelope: f64,
    k: f64,
    /// The set-point per step of the clock.
    set: Vec<f64>,
    /// Household heat in K/h per step.
    heat: Vec<f64>,
}

/// Makes a house.
///
/// # Errors
/// A fault for a sampling that is no multiple of three minutes.
pub fn house(request: &HouseRequest) -> Result<HouseTwin, Fault> {
    if request.step_minutes == 0 || !request.step_minutes.is_multiple_of(STEP_MINUTES) || request.days == 0 {
        return Err(Fault::new(
            "/step",
            "bad-step",
            format!("a house is sampled every {STEP_MINUTES}, 6, … minutes, for a day or more"),
        ));
    }
    let mut dice = Dice::new(request.seed);
    let start = START - DAY * WARM_UP_DAYS as i64;
    let steps = (request.days + WARM_UP_DAYS) * STEPS_PER_DAY + 1;
    let climate = Climate::new(&mut dice, start, steps)?;
    let mut truths = Vec::new();
    let rooms: Vec<Room> = ROOMS
        .iter()
        .map(|number| {
            let (room, truth) = draw(&mut dice, *number, &climate, request.lived_in);
            truths.push(truth);
            room
        })
        .collect();
    let (air, valves) = run(&rooms, &climate);
    let csv = write(&climate, &air, &valves, &truths, request, &mut dice);
    Ok(HouseTwin { csv, rooms: truths, sensor_noise: SENSOR_NOISE })
}

fn draw(dice: &mut Dice, number: u32, climate: &Climate, lived_in: bool) -> (Room, RoomTruth) {
    let steps = climate.hour.len();
    let neighbours: Vec<u32> = ROOMS
        .into_iter()
        .filter(|other| WALLS.contains(&(number, *other)) || WALLS.contains(&(*other, number)))
        .collect();
    let place = |wanted: &u32| ROOMS.iter().position(|room| room == wanted).unwrap_or(0);
    let t_set = dice.between(20.5, 22.5);
    let depth = dice.between(1.5, 3.0);
    let (from, to) = (dice.between(21.5, 23.0), dice.between(5.0, 6.5));
    let deviation = dice.between(0.05, 0.20);
    let memory = dice.between(0.5, 3.0) / HOURS;
    let heat = dice.wander(steps, deviation, memory);
    let lowered = if lived_in && LOWERED.contains(&number) { depth } else { 0.0 };
    let is_night = |hour: f64| hour >= from || hour < to;
    let room = Room {
        h: dice.log_between(0.3, 1.2),
        e: dice.log_between(0.1, 0.6),
        w: dice.log_between(0.5, 2.0),
        a: dice.log_between(0.02, 0.1),
        s: if SUNNY.contains(&number) { dice.log_between(2.0, 5.0) } else { dice.log_between(0.4, 1.5) },
        n: neighbours.iter().map(|other| (place(other), dice.log_between(0.01, 0.1))).collect(),
        floor: dice.log_between(1.5, 6.0),
        envelope: dice.log_between(3.0, 20.0),
        k: dice.between(2.0, 6.0),
        set: climate.hour.iter().map(|hour| t_set - if is_night(*hour) { lowered } else { 0.0 }).collect(),
        heat: if lived_in { heat } else { vec![0.0; steps] },
    };
    let second = SECOND.iter().filter(|(_, of)| *of == number).map(|(sensor, _)| *sensor);
    let sensors = std::iter::once(number).chain(second).collect();
    let household_heat = if lived_in { deviation } else { 0.0 };
    let named = [
        ("alpha_h", room.h),
        ("alpha_e", room.e),
        ("alpha_w", room.w),
        ("alpha_a", room.a),
        ("alpha_s", room.s),
        ("beta_h", room.floor),
        ("beta_he", room.envelope),
    ];
    let named = named.into_iter().map(|(name, value)| (name.to_owned(), value));
    let walls = room.n.iter().zip(&neighbours).map(|((_, rate), other)| (format!("alpha_n[{other}]"), *rate));
    let parameters = named.chain(walls).collect();
    (room, RoomTruth { room: number, sensors, neighbours, t_set, lowered, household_heat, parameters })
}

/// The air of every room and the opening of its valve, at every step.
fn run(rooms: &[Room], climate: &Climate) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let steps = climate.hour.len();
    let mut x: Vec<State> =
        rooms.iter().map(|room| [room.set[0], room.set[0] + 4.0, room.set[0] - 3.0]).collect();
    let (mut air, mut valves) =
        (vec![Vec::with_capacity(steps); rooms.len()], vec![Vec::with_capacity(steps); rooms.len()]);
    for k in 0..steps {
        for (index, (room, state)) in rooms.iter().zip(&x).enumerate() {
            air[index].push(state[0]);
            valves[index].push(room.flow(state[0], k));
        }
        if k + 1 == steps {
            break;
        }
        let slopes = |x: &[State], part: f64| -> Vec<State> {
            rooms.iter().zip(x).map(|(room, own)| room.slope(own, x, climate, k, part)).collect()
        };
        let moved = |slope: &[State], part: f64| -> Vec<State> {
            x.iter()
                .zip(slope)
                .map(|(x, slope)| std::array::from_fn(|i| x[i] + part * HOURS * slope[i]))
                .collect()
        };
        let k1 = slopes(&x, 0.0);
        let k2 = slopes(&moved(&k1, 0.5), 0.5);
        let k3 = slopes(&moved(&k2, 0.5), 0.5);
        let k4 = slopes(&moved(&k3, 1.0), 1.0);
        for (room, state) in x.iter_mut().enumerate() {
            *state = std::array::from_fn(|i| {
                state[i] + HOURS / 6.0 * (k1[room][i] + 2.0 * k2[room][i] + 2.0 * k3[room][i] + k4[room][i])
            });
        }
    }
    (air, valves)
}

impl Room {
    /// How far the thermostat opens the valve (thesis eq. 7.4).
    fn flow(&self, air: f64, step: usize) -> f64 {
        1.0 / (1.0 + (self.k * (air - self.set[step])).exp())
    }

    /// The derivative per hour (thesis eq. 7.1 to 7.3), `part` of the way from step `k` to the next.
    fn slope(&self, own: &State, all: &[State], climate: &Climate, k: usize, part: f64) -> State {
        let line = |series: &[f64]| series[k] + part * (series[k + 1] - series[k]);
        let [room, floor, envelope] = *own;
        let sun = climate.sun(k) + part * (climate.sun(k + 1) - climate.sun(k));
        let heating = self.w * self.flow(room, k) * (line(&climate.forward) - floor);
        let walls: f64 = self.n.iter().map(|(other, rate)| rate * (all[*other][0] - envelope)).sum();
        [
            self.h * (floor - room) + self.e * (envelope - room) + self.s * sun + self.heat[k],
            self.h / self.floor * (room - floor) + heating,
            self.e / self.envelope * (room - envelope) + self.a * (line(&climate.out) - envelope) + walls,
        ]
    }
}

/// The measurements as loggers write them: noise, an offset between two sensors of a room, lost samples.
fn write(
    climate: &Climate,
    air: &[Vec<f64>],
    valves: &[Vec<f64>],
    rooms: &[RoomTruth],
    request: &HouseRequest,
    dice: &mut Dice,
) -> String {
    let first = WARM_UP_DAYS * STEPS_PER_DAY;
    let per_sample = request.step_minutes / STEP_MINUTES;
    let samples = request.days * STEPS_PER_DAY / per_sample;
    let mut csv = String::from("time,T_out,T_forward,sun_altitude,cloud_cover");
    let mut columns: Vec<Vec<String>> = Vec::new();
    for (room, truth) in rooms.iter().enumerate() {
        for (place, sensor) in truth.sensors.iter().enumerate() {
            let _ = write!(csv, ",T_room_{sensor}");
            let offset = if place == 0 { 0.0 } else { dice.between(-0.5, 0.5) };
            let mut column: Vec<String> = (0..samples)
                .map(|sample| {
                    format!(
                        "{:.3}",
                        air[room][first + sample * per_sample] + offset + SENSOR_NOISE * dice.normal()
                    )
                })
                .collect();
            // A first sensor misses single samples, a second one hours.
            let (stretches, longest) = if place == 0 { (2.0, 1.0) } else { (4.0, 6.0) };
            for _ in 0..1 + (dice.uniform() * stretches) as usize {
                let from = 8 + (dice.uniform() * samples as f64) as usize;
                let count = (dice.between(0.5, longest) * 60.0 / request.step_minutes as f64).ceil() as usize;
                column.iter_mut().skip(from).take(count).for_each(String::clear);
            }
            columns.push(column);
        }
        let _ = write!(csv, ",valve_{}[pct]", truth.room);
        let opened = |sample: usize| {
            let from = first + sample * per_sample;
            valves[room][from..from + per_sample].iter().sum::<f64>() / per_sample as f64
        };
        columns.push((0..samples).map(|sample| format!("{:.1}", 100.0 * opened(sample))).collect());
    }
    csv.push('\n');
    for sample in 0..samples {
        let k = first + sample * per_sample;
        let _ = write!(
            csv,
            "{},{:.2},{:.2}",
            rfc3339(climate.start + (k * STEP_MINUTES) as i64 * MINUTE),
            climate.out[k],
            climate.forward[k]
        );
        let _ = write!(csv, ",{:.2},{:.3}", climate.altitude[k], climate.cloud[k]);
        for column in &columns {
            let _ = write!(csv, ",{}", column[sample]);
        }
        csv.push('\n');
    }
    csv
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{ColumnBindings, Window, propose_layout};

    #[test]
    fn a_house_is_warm_and_the_same_for_the_same_seed() {
        let request = HouseRequest { seed: 3, days: 2, step_minutes: 30, lived_in: true };
        let twin = house(&request).unwrap();
        assert_eq!(twin.csv, house(&request).unwrap().csv);
        assert_ne!(twin.csv, house(&HouseRequest { seed: 4, ..request }).unwrap().csv);
        let (window, report) = Window::parse_csv(&twin.csv, &ColumnBindings::none()).unwrap();
        assert!(report.rejected_rows.is_empty() && report.warnings.is_empty(), "{:?}", report.warnings);
        assert_eq!(window.channels().filter(|channel| channel.starts_with("T_room_")).count(), 17);
        for truth in &twin.rooms {
            let air = window.series(&format!("T_room_{}", truth.room)).unwrap();
            assert!(
                air.values().iter().all(|t| (14.0..30.0).contains(t)),
                "room {}: {:?}",
                truth.room,
                air.values()
            );
            let valve = window.series(&format!("valve_{}", truth.room)).unwrap();
            assert!(valve.values().iter().all(|open| (0.0..=100.0).contains(open)));
            // Walls have two sides.
            let back = |other: &u32| {
                twin.rooms.iter().any(|one| one.room == *other && one.neighbours.contains(&truth.room))
            };
            assert!(!truth.neighbours.is_empty() && truth.neighbours.iter().all(back));
        }
        assert!(house(&HouseRequest { step_minutes: 10, ..request }).is_err());
    }

    #[test]
    fn the_layout_puts_seventeen_sensors_into_eleven_rooms() {
        let twin = house(&HouseRequest { seed: 1, days: 14, step_minutes: 30, lived_in: true }).unwrap();
        let (window, _) = Window::parse_csv(&twin.csv, &ColumnBindings::none()).unwrap();
        let found = propose_layout(&window).unwrap();
        let mut rooms: Vec<Vec<String>> = found.rooms.iter().map(|room| room.sensors.clone()).collect();
        let mut wanted: Vec<Vec<String>> = twin
            .rooms
            .iter()
            .map(|room| room.sensors.iter().map(|sensor| format!("T_room_{sensor}")).collect())
            .collect();
        rooms.iter_mut().chain(&mut wanted).for_each(|sensors| sensors.sort());
        rooms.sort();
        wanted.sort();
        assert_eq!(rooms, wanted);
        // The first sensor of a room misses least, so that rooms have the thesis's numbers.
        assert!(
            found.rooms.iter().all(|room| twin.rooms.iter().any(|truth| truth.room.to_string() == room.id))
        );
    }
}
