//! Effects that a synthetic room hides: their true shapes, which differ from those of the catalogue.

use super::climate::{Climate, NEIGHBOURS, STEPS_PER_DAY};
use super::dice::Dice;
use super::measured::{MEASURED, MoreSeries, lagged};
use crate::fault::{Fault, nearest};
use crate::model::id::family_and_argument;

/// So large a share of the hours with this sun, in clear suns at the zenith, a room with blinds is too cool
/// for them to close.
const BELOW_BLINDS: (f64, f64) = (0.3, 0.7);
const BRIGHT: f64 = 0.1;

/// An effect of the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    Wind,
    Window,
    People,
    /// The bearing of the windows in degrees.
    Facade(f64),
    Door(usize),
    Outdoor,
    Exponent,
    Delay,
    Drift,
    Lag,
    Setback,
    Sky,
    Metered,
    Wall,
    Constant,
    /// Not in the catalogue: a wood stove, lit on some evenings.
    Stove,
    /// Not in the catalogue: laundry that is hung up piece by piece on some days, dries, and takes heat.
    Laundry,
    /// Not in the catalogue, as all that follow: air that is exchanged where people have breathed much of it.
    Ventilation,
    /// Blinds that close in the sun above this temperature of the room.
    Blinds(f64),
    /// A fan that runs at the same hours of every working day.
    Fan,
    /// Rain that cools the roof, felt later.
    Rain,
    /// Heat of the flat next door, felt later.
    NextDoor,
    /// A heater whose meter counts a stand-by that warms nothing here.
    Heater,
}

/// The effects of the catalogue that a twin can hide, families without their argument.
pub const CATALOGUED: [&str; 15] = [
    "wind_infiltration",
    "window_opening",
    "occupancy_gain",
    "oriented_solar_gain",
    "open_door",
    "direct_outdoor_loss",
    "emitter_exponent",
    "pipe_delay",
    "sensor_drift",
    "sensor_lag",
    "night_setback",
    "sky_radiation",
    "metered_gain",
    "envelope_solar_gain",
    "constant_gain",
];
/// What it can hide and no catalogue has.
pub const STRANGE: [&str; 2] = ["stove", "laundry"];

/// All names that a twin can hide.
pub fn names() -> impl Iterator<Item = &'static str> {
    CATALOGUED.into_iter().chain(STRANGE).chain(MEASURED)
}

/// A hidden effect at work.
#[derive(Debug, Clone)]
pub struct Hidden {
    pub kind: Kind,
    /// In the unit of the catalogue's coefficient.
    pub strength: f64,
    /// When it works, and how much: per step of the truth.
    pub shape: Vec<f64>,
}

impl Kind {
    /// An effect by name; an argument that is left open is drawn.
    pub fn named(name: &str, dice: &mut Dice) -> Result<Self, Fault> {
        let (family, argument) = family_and_argument(name);
        let unknown = || {
            let fault = Fault::new("/effect", "unknown-effect", format!("no twin can hide `{name}`"));
            match nearest(family, names()) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault.suggest(format!("one of {}", names().collect::<Vec<_>>().join(", "))),
            }
        };
        Ok(match family {
            "wind_infiltration" => Kind::Wind,
            "window_opening" => Kind::Window,
            "occupancy_gain" => Kind::People,
            "oriented_solar_gain" => {
                let facade = match argument {
                    Some("east") => 90.0,
                    Some("south") => 180.0,
                    Some("west") => 270.0,
                    Some(_) => return Err(unknown()),
                    None => [90.0, 270.0][usize::from(dice.uniform() < 0.5)],
                };
                // No house stands exactly by the compass.
                Kind::Facade(facade + dice.between(-15.0, 15.0))
            }
            "open_door" => match argument
                .map(|argument| argument.strip_prefix("T_room_").and_then(|n| n.parse::<usize>().ok()))
            {
                Some(Some(n)) if (1..=NEIGHBOURS).contains(&n) => Kind::Door(n - 1),
                Some(_) => return Err(unknown()),
                None => Kind::Door(usize::from(dice.uniform() < 0.5)),
            },
            "direct_outdoor_loss" => Kind::Outdoor,
            "emitter_exponent" => Kind::Exponent,
            "pipe_delay" => Kind::Delay,
            "sensor_drift" => Kind::Drift,
            "sensor_lag" => Kind::Lag,
            "night_setback" => Kind::Setback,
            "sky_radiation" => Kind::Sky,
            "metered_gain" => Kind::Metered,
            "envelope_solar_gain" => Kind::Wall,
            "constant_gain" => Kind::Constant,
            "stove" => Kind::Stove,
            "laundry" => Kind::Laundry,
            "co2_ventilation" => Kind::Ventilation,
            "blinds" => Kind::Blinds(dice.between(23.0, 24.5)),
            "fan" => Kind::Fan,
            "rain" => Kind::Rain,
            "next_door" => Kind::NextDoor,
            "heater" => Kind::Heater,
            _ => return Err(unknown()),
        })
    }

    /// An effect as somebody has installed it in a room, of which is known what it shows without, from its
    /// first step on. Blinds that never close hide nothing, and those that always do are a smaller window.
    pub fn fitting(self, climate: &Climate, bare: &[f64], first: usize, dice: &mut Dice) -> Self {
        let Kind::Blinds(_) = self else { return self };
        let sunny = bare.iter().enumerate().skip(first).filter(|(step, _)| climate.sun(*step) > BRIGHT);
        let mut warm: Vec<f64> = sunny.map(|(_, warm)| *warm).collect();
        warm.sort_by(f64::total_cmp);
        let (low, high) = BELOW_BLINDS;
        let place = (dice.between(low, high) * warm.len() as f64) as usize;
        warm.get(place).map_or(self, |above| Kind::Blinds(*above))
    }

    /// The name of the catalogue's effect that comes closest, or its own where it is in no catalogue.
    pub fn id(self) -> String {
        match self {
            Kind::Wind => "wind_infiltration",
            Kind::Window => "window_opening",
            Kind::People => "occupancy_gain",
            Kind::Facade(bearing) if bearing < 135.0 => "oriented_solar_gain:east",
            Kind::Facade(bearing) if bearing < 225.0 => "oriented_solar_gain:south",
            Kind::Facade(_) => "oriented_solar_gain:west",
            Kind::Door(n) => return format!("open_door:T_room_{}", n + 1),
            Kind::Outdoor => "direct_outdoor_loss",
            Kind::Exponent => "emitter_exponent",
            Kind::Delay => "pipe_delay",
            Kind::Drift => "sensor_drift",
            Kind::Lag => "sensor_lag",
            Kind::Setback => "night_setback",
            Kind::Sky => "sky_radiation",
            Kind::Metered => "metered_gain:P_appliances",
            Kind::Wall => "envelope_solar_gain",
            Kind::Constant => "constant_gain",
            Kind::Stove => "stove",
            Kind::Laundry => "laundry",
            Kind::Ventilation => "co2_ventilation",
            Kind::Blinds(_) => "blinds",
            Kind::Fan => "fan",
            Kind::Rain => "rain",
            Kind::NextDoor => "next_door",
            Kind::Heater => "heater",
        }
        .to_owned()
    }

    /// Whether the catalogue has it.
    pub fn in_catalogue(self) -> bool {
        let id = self.id();
        !STRANGE.iter().chain(&MEASURED).any(|strange| *strange == id)
    }

    /// The largest strength that physics allows.
    pub fn strongest(self) -> f64 {
        match self {
            Kind::Wind => 0.2,
            Kind::Window => 5.0,
            Kind::People | Kind::Wall => 4.0,
            Kind::Facade(_) | Kind::Metered => 8.0,
            Kind::Door(_) | Kind::Lag | Kind::Constant => 3.0,
            Kind::Outdoor => 0.5,
            Kind::Exponent => 0.6,
            Kind::Delay => 6.0,
            Kind::Drift => 0.3,
            Kind::Setback => 1.0,
            Kind::Sky => 2.0,
            Kind::Stove | Kind::Laundry | Kind::Heater => 6.0,
            Kind::Ventilation => 0.5,
            Kind::Blinds(_) => 1.0,
            Kind::Fan => 2.0,
            Kind::Rain => 3.0,
            Kind::NextDoor => 4.0,
        }
    }

    /// Whether either sign makes sense; it is drawn then.
    pub fn two_sided(self) -> bool {
        matches!(self, Kind::Exponent | Kind::Drift | Kind::Constant)
    }

    /// When it works, and how much.
    pub fn shape(self, dice: &mut Dice, climate: &Climate, more: Option<&MoreSeries>) -> Vec<f64> {
        let steps = climate.hour.len();
        let mut shape = vec![0.0; steps];
        let days = steps / STEPS_PER_DAY + 1;
        // Adds `size` from an hour of a day on for so many hours, by the local clock.
        let mut add = |day: usize, hour: f64, hours: f64, size: &dyn Fn(f64) -> f64| {
            let midnight = day as f64 * STEPS_PER_DAY as f64 - climate.hour[0] / 24.0 * STEPS_PER_DAY as f64;
            let from = (midnight + hour / 24.0 * STEPS_PER_DAY as f64).max(0.0) as usize;
            let count = (hours / 24.0 * STEPS_PER_DAY as f64) as usize;
            for (since, value) in shape.iter_mut().skip(from).take(count).enumerate() {
                *value += size(since as f64 * 24.0 / STEPS_PER_DAY as f64);
            }
        };
        match self {
            Kind::Window => {
                for day in 0..days {
                    for _ in 0..1 + (dice.uniform() * 2.5) as usize {
                        add(day, dice.between(7.0, 22.0), dice.between(0.15, 0.7), &|_| 1.0);
                    }
                }
                shape.iter_mut().for_each(|open| *open = open.min(1.0));
            }
            Kind::People => {
                for day in 0..days {
                    let weekend = climate.weekday[(day * STEPS_PER_DAY).min(steps - 1)] >= 6.0;
                    let many = dice.between(0.6, 1.6);
                    if weekend && dice.uniform() < 0.7 {
                        add(day, dice.between(8.0, 10.5), dice.between(3.0, 7.0), &|_| many);
                    } else if !weekend && dice.uniform() < 0.85 {
                        add(day, dice.between(5.8, 7.0), dice.between(1.0, 2.5), &|_| many);
                    }
                    if dice.uniform() < 0.9 {
                        add(day, dice.between(16.0, 18.5), dice.between(4.0, 6.5), &|_| many);
                    }
                }
            }
            Kind::Stove => {
                for day in 0..days {
                    if dice.uniform() < 0.45 {
                        let (from, length) = (dice.between(17.0, 20.0), dice.between(3.0, 5.0));
                        add(day, from, length + 4.0, &|h| {
                            (1.0 - (-h / 0.5).exp())
                                * if h > length { (-(h - length) / 1.0).exp() } else { 1.0 }
                        });
                    }
                }
            }
            Kind::Laundry => {
                for day in 0..days {
                    if dice.uniform() < 0.4 {
                        add(day, dice.between(8.0, 19.0), 30.0, &|h| {
                            -(1.0 - (-h / 0.5).exp()) * (-h / 6.0).exp()
                        });
                    }
                }
            }
            Kind::Facade(bearing) => {
                let depth = dice.between(0.15, 0.3);
                for (step, value) in shape.iter_mut().enumerate() {
                    let (altitude, azimuth) =
                        (climate.altitude[step].to_radians(), climate.azimuth[step].to_radians());
                    if altitude > 0.0 {
                        let direct = altitude.cos() * (azimuth - bearing.to_radians()).cos().max(0.0);
                        let beam = (-depth / altitude.sin().max(0.02)).exp() * climate.clearness(step);
                        // A tenth of what reaches the pane is diffuse.
                        *value = direct * beam + 0.1 * climate.sun(step);
                    }
                }
            }
            Kind::Setback => {
                let (from, to) = (dice.between(22.25, 22.75), dice.between(5.25, 5.75));
                shape = climate.hour.iter().map(|hour| f64::from(*hour >= from || *hour < to)).collect();
            }
            Kind::Door(_) => {
                // Usually open: shut for some hours now and then.
                shape.fill(1.0);
                for day in 0..days {
                    if dice.uniform() < 0.3 {
                        let (from, length) = (dice.between(0.0, 20.0), dice.between(1.0, 4.0));
                        let from = ((day as f64 + from / 24.0) * STEPS_PER_DAY as f64) as usize;
                        let count = (length / 24.0 * STEPS_PER_DAY as f64) as usize;
                        shape.iter_mut().skip(from).take(count).for_each(|open| *open = 0.0);
                    }
                }
            }
            Kind::Sky => shape = climate.cloud.iter().map(|cloud| (1.0 - cloud).powf(1.2)).collect(),
            Kind::Fan => {
                let (from, to) = (dice.between(6.0, 10.0), dice.between(14.0, 19.0));
                for (step, value) in shape.iter_mut().enumerate() {
                    let runs = climate.weekday[step] < 5.5 && (from..to).contains(&climate.hour[step]);
                    *value = f64::from(runs);
                }
            }
            Kind::Ventilation | Kind::Rain | Kind::NextDoor | Kind::Heater => {
                let Some(more) = more else { return shape };
                let above = |series: &[f64], least: f64, unit: f64| -> Vec<f64> {
                    series.iter().map(|value| (value - least).max(0.0) / unit).collect()
                };
                shape = match self {
                    Kind::Ventilation => above(&more.co2, dice.between(550.0, 750.0), 100.0),
                    Kind::Heater => above(&more.heater, dice.between(0.2, 0.5), 1.0),
                    Kind::NextDoor => lagged(&more.next_door, dice.between(1.0, 4.0)),
                    _ => lagged(&more.rain, dice.between(1.0, 3.0)).iter().map(|wet| -wet).collect(),
                };
            }
            Kind::Wall | Kind::Blinds(_) => {
                for (step, value) in shape.iter_mut().enumerate() {
                    *value = climate.sun(step);
                }
            }
            _ => shape.fill(1.0),
        }
        shape
    }
}
