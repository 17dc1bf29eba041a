//! What was measured of the house, what was proposed for it, and what every way found.

use super::super::row::Row;
use super::ways::{
    self, Asked, DEFAULT, METHODS, Measured, Room, Run, Solution, THESIS, THESIS_MSE, VALVE, Way,
};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, Layout, Window, propose_layout};
use lampyris_core::twin::{HouseRequest, RoomTruth, house};
use std::time::Instant;

/// Seconds that the whole may take on two quiet cores.
const TARGET_SECONDS: f64 = 900.0;

/// What was measured, proposed and found.
#[derive(Debug, Clone, PartialEq)]
pub struct House {
    pub request: HouseRequest,
    pub asked: Asked,
    pub truths: Vec<RoomTruth>,
    pub layout: Layout,
    /// The rooms that were estimated, and what was measured in each.
    pub rooms: Vec<Room>,
    pub measured: Vec<Measured>,
    pub runs: Vec<Run>,
    /// Wall time of each part.
    pub seconds: Vec<(String, f64)>,
    pub threads: usize,
    /// Deviation of the sensors' noise in K.
    pub sensor_noise: f64,
}

impl House {
    pub fn new(request: &HouseRequest, rooms: usize, ways: &[Way], asked: &Asked) -> Result<Self, Failure> {
        let mut seconds = Vec::new();
        let start = Instant::now();
        let twin = house(request).map_err(|fault| faults(&[fault]))?;
        seconds.push(("the house".to_owned(), start.elapsed().as_secs_f64()));
        let start = Instant::now();
        let (window, _) =
            Window::parse_csv(&twin.csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
        let layout = propose_layout(&window).map_err(|found| faults(&found))?;
        seconds.push(("layout from correlations".to_owned(), start.elapsed().as_secs_f64()));
        let rooms: Vec<Room> = layout
            .rooms
            .iter()
            .take(rooms)
            .map(|room| Room {
                id: room.id.clone(),
                sensors: room.sensors.clone(),
                neighbours: neighbours(&layout, &room.id),
            })
            .collect();
        let measured =
            rooms.iter().map(|room| ways::measured(&twin.csv, room, asked)).collect::<Result<_, _>>()?;
        let mut runs = Vec::new();
        for way in ways {
            let start = Instant::now();
            for room in &rooms {
                runs.push(ways::run(&twin.csv, room, way, asked)?);
            }
            seconds.push((way.name.to_owned(), start.elapsed().as_secs_f64()));
        }
        let threads = rayon::current_num_threads();
        Ok(Self {
            request: *request,
            asked: *asked,
            truths: twin.rooms,
            layout,
            rooms,
            measured,
            runs,
            seconds,
            threads,
            sensor_noise: twin.sensor_noise,
        })
    }

    /// The runs of a way, in the order of the rooms.
    pub fn of(&self, way: &Way) -> impl Iterator<Item = &Run> + use<'_> {
        let name = way.name;
        self.runs.iter().filter(move |run| run.way == name)
    }

    pub fn run(&self, room: &str, way: &Way) -> Option<&Run> {
        self.of(way).find(|run| run.room == room)
    }

    pub fn solution(&self, room: &str, way: &Way) -> Option<&Solution> {
        self.run(room, way).and_then(|run| run.solution.as_ref())
    }

    pub fn solutions(&self, way: &Way) -> impl Iterator<Item = &Solution> + use<'_> {
        self.of(way).filter_map(|run| run.solution.as_ref())
    }

    /// The median over the rooms of the mean square error of a part.
    pub fn median(&self, way: &Way, part: usize) -> Option<f64> {
        median(self.solutions(way).map(|solution| solution.errors.mse[part]).collect())
    }

    pub fn truth(&self, room: &str) -> Option<&RoomTruth> {
        self.truths.iter().find(|truth| truth.room.to_string() == room)
    }

    /// The rooms behind the walls of a room.
    pub fn walls(&self, room: &str) -> Vec<String> {
        self.truth(room)
            .map(|truth| truth.neighbours.iter().map(u32::to_string).collect())
            .unwrap_or_default()
    }

    /// The rooms that the layout proposes as its neighbours.
    pub fn proposed(&self, room: &str) -> Vec<String> {
        neighbours(&self.layout, room)
    }

    /// The rooms whose sensors, and no others, were put together.
    pub fn right_rooms(&self) -> usize {
        let named = |truth: &RoomTruth| -> Vec<String> {
            truth.sensors.iter().map(|sensor| format!("T_room_{sensor}")).collect()
        };
        let same = |truth: &&RoomTruth| {
            let mut wanted = named(truth);
            wanted.sort();
            self.layout.rooms.iter().any(|room| {
                let mut sensors = room.sensors.clone();
                sensors.sort();
                sensors == wanted
            })
        };
        self.truths.iter().filter(same).count()
    }

    /// The room whose error grows most from the first week to the second after a search in the thesis's box,
    /// and that way.
    pub fn overfit(&self) -> Option<(&str, &'static Way)> {
        let wide: [&'static Way; 2] = [&THESIS, &THESIS_MSE];
        let error =
            |run: &Run| run.solution.as_ref().map(|solution| solution.errors.mse[1] / solution.errors.mse[0]);
        let all = wide
            .into_iter()
            .flat_map(|way| self.of(way).filter_map(move |run| Some((run.room.as_str(), way, error(run)?))));
        all.max_by(|a, b| a.2.total_cmp(&b.2)).map(|(room, way, _)| (room, way))
    }

    /// The figures that count.
    pub fn rows(&self) -> Vec<Row> {
        let rooms = self.rooms.len() as f64;
        let mut rows = vec![
            Row::new("sensors", self.layout.sensors.len() as f64, ""),
            Row::new("rooms that the layout proposes", self.layout.rooms.len() as f64, ""),
            Row::new(
                format!("  with exactly their own sensors, of {}", self.truths.len()),
                self.right_rooms() as f64,
                "",
            ),
        ];
        for way in METHODS {
            rows.push(
                Row::new(
                    format!("{}: rooms with a solution", way.name),
                    self.solutions(way).count() as f64,
                    "",
                )
                .at_least(rooms),
            );
            rows.push(Row::new("  wall time of all rooms", self.of(way).map(|run| run.seconds).sum(), "s"));
            for (part, week) in ["week 1", "week 2"].into_iter().enumerate() {
                rows.push(Row::new(
                    format!("  median MSE, {week}"),
                    self.median(way, part).unwrap_or(f64::NAN),
                    "K2",
                ));
            }
            let rejected = self.solutions(way).filter(|solution| solution.gate.verdict == "rejected").count();
            rows.push(Row::new("  refused by the gate", rejected as f64, ""));
        }
        let better = |part: usize| {
            let pairs = self.rooms.iter().filter_map(|room| {
                let error = |way: &Way| Some(self.solution(&room.id, way)?.errors.mse[part]);
                Some((error(&DEFAULT)?, error(&THESIS_MSE)?))
            });
            pairs.filter(|(ours, thesis)| ours <= thesis).count() as f64
        };
        rows.push(
            Row::new("rooms in which cfa is no worse than cfa_thesis, week 1", better(0), "").at_least(rooms),
        );
        rows.push(Row::new("rooms in which cfa is no worse than cfa_thesis, week 2", better(1), ""));
        if let Some((room, way)) = self.overfit()
            && let (Some(wide), Some(cured)) = (self.solution(room, way), self.solution(room, &DEFAULT))
        {
            rows.push(Row::new(
                format!("overfit in the wide box, room {room}: MSE, week 1"),
                wide.errors.mse[0],
                "K2",
            ));
            rows.push(Row::new("  week 2", wide.errors.mse[1], "K2"));
            rows.push(
                Row::new("  refused by the gate", f64::from(wide.gate.verdict == "rejected"), "")
                    .at_least(1.0),
            );
            rows.push(
                Row::new("  cfa in physical bounds, week 2", cured.errors.mse[1], "K2")
                    .at_most(wide.errors.mse[1]),
            );
        }
        let lowered: Vec<&Room> = self
            .rooms
            .iter()
            .filter(|room| self.truth(&room.id).is_some_and(|truth| truth.lowered > 0.0))
            .collect();
        let by_valve = |rooms: &mut dyn Iterator<Item = &Room>| {
            let better = |room: &&Room| {
                let error = |way: &Way| Some(self.solution(&room.id, way)?.errors.mse[1]);
                matches!((error(&VALVE), error(&DEFAULT)), (Some(valve), Some(sigmoid)) if valve < sigmoid)
            };
            rooms.filter(better).count() as f64
        };
        let what =
            format!("rooms in which the measured valve beats the sigmoid, week 2, of {}", self.rooms.len());
        rows.push(Row::new(what, by_valve(&mut self.rooms.iter()), ""));
        rows.push(Row::new(
            format!("  of the {} lowered at night", lowered.len()),
            by_valve(&mut lowered.into_iter()),
            "",
        ));
        let seconds: f64 = self.seconds.iter().map(|(_, took)| took).sum();
        rows.push(Row::new(
            format!("wall time of everything (target {TARGET_SECONDS} s on two quiet cores)"),
            seconds,
            "s",
        ));
        rows
    }
}

/// The rooms that a layout proposes beside one.
fn neighbours(layout: &Layout, room: &str) -> Vec<String> {
    let other = |pair: &[String; 2]| match pair {
        [a, b] if a == room => Some(b.clone()),
        [a, b] if b == room => Some(a.clone()),
        _ => None,
    };
    let mut found: Vec<String> = layout.neighbours.iter().filter_map(|pair| other(&pair.rooms)).collect();
    found.sort_by_key(|name| (name.len(), name.clone()));
    found
}

/// The middle of some numbers; the upper one of two.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
