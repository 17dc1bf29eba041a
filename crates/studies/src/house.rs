//! Chapter 7 of the thesis in public: a twin of its house, seventeen sensors, eleven rooms, one week to fit and one to
//! judge, by every method in every box.

mod page;
mod published;
mod tables;
mod ways;

use super::Row;
use super::options::{First, Html, RoomCount};
use lampyris::cli::{Failure, faults, print};
use lampyris_core::data::{Bindings, Layout, Window, propose_layout};
use lampyris_core::estimate::problem::objective::ShapeDelta;
use lampyris_core::twin::{HouseRequest, RoomTruth, house};
use serde_json::{Value, json};
use std::time::Instant;
use ways::{Asked, DEFAULT, METHODS, Measured, Room, Run, Solution, THESIS, THESIS_MSE, VALVE, Way};

/// The sampling of most of the thesis's sensors (7.2.4).
const STEP_MINUTES: usize = 30;
/// Days of each of the two parts.
const PART_DAYS: usize = 7;
/// Seconds that the whole may take on two quiet cores.
const TARGET_SECONDS: f64 = 900.0;

/// What was measured, proposed and found.
#[derive(Debug, Clone, PartialEq)]
struct House {
    request: HouseRequest,
    asked: Asked,
    truths: Vec<RoomTruth>,
    layout: Layout,
    /// The rooms that were estimated, and what was measured in each.
    rooms: Vec<Room>,
    measured: Vec<Measured>,
    runs: Vec<Run>,
    /// Wall time of each part.
    seconds: Vec<(String, f64)>,
    threads: usize,
    /// Deviation of the sensors' noise in K.
    sensor_noise: f64,
}

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    first: First,
    #[command(flatten)]
    rooms: RoomCount,
    /// What the shape counts in the shape-weighted error (delta of thesis eq. 7.6).
    #[arg(long, default_value_t = 0.5)]
    delta: f64,
    #[command(flatten)]
    html: Html,
}

/// Runs everything; prints the tables unless a document is wanted, and writes the page where a file is named.
pub fn run(asked: &Arguments, as_json: bool) -> Result<(Vec<Row>, Value), Failure> {
    let seed = asked.first.seed;
    let delta = ShapeDelta::try_from(asked.delta).map_err(Failure::Usage)?;
    let request = HouseRequest { seed, days: 2 * PART_DAYS, step_minutes: STEP_MINUTES, lived_in: true };
    let rooms = usize::try_from(asked.rooms.rooms).unwrap_or(usize::MAX);
    let house = House::new(&request, rooms, &ways::all(), &Asked { seed, delta, part_days: PART_DAYS })?;
    let tables = tables::tables(&house);
    if !as_json {
        tables.iter().for_each(|table| print(&format!("{}\n", table.text())));
    }
    if let Some(file) = &asked.html.html {
        std::fs::write(file, page::document(&house, &tables)?).map_err(|error| Failure::Error(format!("{}: {error}", file.display())))?;
        eprintln!("page: {}", file.display());
    }
    Ok((house.rows(), json!({ "layout": house.layout, "truth": house.truths, "runs": house.runs, "tables": tables })))
}

impl House {
    fn new(request: &HouseRequest, rooms: usize, ways: &[Way], asked: &Asked) -> Result<Self, Failure> {
        let mut seconds = Vec::new();
        let start = Instant::now();
        let twin = house(request).map_err(|fault| faults(&[fault]))?;
        seconds.push(("the house".to_owned(), start.elapsed().as_secs_f64()));
        let start = Instant::now();
        let (window, _) = Window::parse_csv(&twin.csv, &Bindings::none()).map_err(|found| faults(&found))?;
        let layout = propose_layout(&window).map_err(|found| faults(&found))?;
        seconds.push(("layout from correlations".to_owned(), start.elapsed().as_secs_f64()));
        let rooms: Vec<Room> = layout
            .rooms
            .iter()
            .take(rooms)
            .map(|room| Room { id: room.id.clone(), sensors: room.sensors.clone(), neighbours: neighbours(&layout, &room.id) })
            .collect();
        let measured = rooms.iter().map(|room| ways::measured(&twin.csv, room, asked)).collect::<Result<_, _>>()?;
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
    fn of(&self, way: &Way) -> impl Iterator<Item = &Run> + use<'_> {
        let name = way.name;
        self.runs.iter().filter(move |run| run.way == name)
    }

    fn run(&self, room: &str, way: &Way) -> Option<&Run> {
        self.of(way).find(|run| run.room == room)
    }

    fn solution(&self, room: &str, way: &Way) -> Option<&Solution> {
        self.run(room, way).and_then(|run| run.solution.as_ref())
    }

    fn solutions(&self, way: &Way) -> impl Iterator<Item = &Solution> + use<'_> {
        self.of(way).filter_map(|run| run.solution.as_ref())
    }

    /// The median over the rooms of the mean square error of a part.
    fn median(&self, way: &Way, part: usize) -> Option<f64> {
        tables::median(self.solutions(way).map(|solution| solution.errors.mse[part]).collect())
    }

    fn truth(&self, room: &str) -> Option<&RoomTruth> {
        self.truths.iter().find(|truth| truth.room.to_string() == room)
    }

    /// The rooms behind the walls of a room.
    fn walls(&self, room: &str) -> Vec<String> {
        self.truth(room).map(|truth| truth.neighbours.iter().map(u32::to_string).collect()).unwrap_or_default()
    }

    /// The rooms that the layout proposes as its neighbours.
    fn proposed(&self, room: &str) -> Vec<String> {
        neighbours(&self.layout, room)
    }

    /// The rooms whose sensors, and no others, were put together.
    fn right_rooms(&self) -> usize {
        let named = |truth: &RoomTruth| -> Vec<String> { truth.sensors.iter().map(|sensor| format!("T_room_{sensor}")).collect() };
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

    /// The room whose error grows most from the first week to the second after a search in the thesis's box, and that way.
    fn overfit(&self) -> Option<(&str, &'static Way)> {
        let wide: [&'static Way; 2] = [&THESIS, &THESIS_MSE];
        let error = |run: &Run| run.solution.as_ref().map(|solution| solution.errors.mse[1] / solution.errors.mse[0]);
        let all = wide.into_iter().flat_map(|way| self.of(way).filter_map(move |run| Some((run.room.as_str(), way, error(run)?))));
        all.max_by(|a, b| a.2.total_cmp(&b.2)).map(|(room, way, _)| (room, way))
    }

    /// The figures that count.
    fn rows(&self) -> Vec<Row> {
        let rooms = self.rooms.len() as f64;
        let mut rows = vec![
            Row::new("sensors", self.layout.sensors.len() as f64, ""),
            Row::new("rooms that the layout proposes", self.layout.rooms.len() as f64, ""),
            Row::new(format!("  with exactly their own sensors, of {}", self.truths.len()), self.right_rooms() as f64, ""),
        ];
        for way in METHODS {
            rows.push(Row::new(format!("{}: rooms with a solution", way.name), self.solutions(way).count() as f64, "").at_least(rooms));
            rows.push(Row::new("  wall time of all rooms", self.of(way).map(|run| run.seconds).sum(), "s"));
            for (part, week) in ["week 1", "week 2"].into_iter().enumerate() {
                rows.push(Row::new(format!("  median MSE, {week}"), self.median(way, part).unwrap_or(f64::NAN), "K2"));
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
        rows.push(Row::new("rooms in which cfa is no worse than cfa_thesis, week 1", better(0), "").at_least(rooms));
        rows.push(Row::new("rooms in which cfa is no worse than cfa_thesis, week 2", better(1), ""));
        if let Some((room, way)) = self.overfit()
            && let (Some(wide), Some(cured)) = (self.solution(room, way), self.solution(room, &DEFAULT))
        {
            rows.push(Row::new(format!("overfit in the wide box, room {room}: MSE, week 1"), wide.errors.mse[0], "K2"));
            rows.push(Row::new("  week 2", wide.errors.mse[1], "K2"));
            rows.push(Row::new("  refused by the gate", f64::from(wide.gate.verdict == "rejected"), "").at_least(1.0));
            rows.push(Row::new("  cfa in physical bounds, week 2", cured.errors.mse[1], "K2").at_most(wide.errors.mse[1]));
        }
        let lowered: Vec<&Room> = self.rooms.iter().filter(|room| self.truth(&room.id).is_some_and(|truth| truth.lowered > 0.0)).collect();
        let by_valve = |rooms: &mut dyn Iterator<Item = &Room>| {
            let better = |room: &&Room| {
                let error = |way: &Way| Some(self.solution(&room.id, way)?.errors.mse[1]);
                matches!((error(&VALVE), error(&DEFAULT)), (Some(valve), Some(sigmoid)) if valve < sigmoid)
            };
            rooms.filter(better).count() as f64
        };
        let what = format!("rooms in which the measured valve beats the sigmoid, week 2, of {}", self.rooms.len());
        rows.push(Row::new(what, by_valve(&mut self.rooms.iter()), ""));
        rows.push(Row::new(format!("  of the {} lowered at night", lowered.len()), by_valve(&mut lowered.into_iter()), ""));
        let seconds: f64 = self.seconds.iter().map(|(_, took)| took).sum();
        rows.push(Row::new(format!("wall time of everything (target {TARGET_SECONDS} s on two quiet cores)"), seconds, "s"));
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Chapter 7 in a few seconds: two rooms of a house in which nobody lives, four days each, a short swarm.
    fn small() -> House {
        let thesis = Way { request: r#"{"method": {"name": "cfa_thesis", "n": 12, "generations": 4}, "objective": "swmse"}"#, ..THESIS };
        let request = HouseRequest { seed: 1, days: 8, step_minutes: STEP_MINUTES, lived_in: false };
        let asked = Asked { seed: 1, delta: ShapeDelta::default(), part_days: 4 };
        House::new(&request, 2, &[thesis, DEFAULT, VALVE], &asked).ok().unwrap()
    }

    #[test]
    fn a_small_house_fills_every_table_and_the_page() {
        let house = small();
        // Nobody lives here, so a good search is left with the noise of the sensor.
        let noise = house.sensor_noise.powi(2);
        for way in [&DEFAULT, &VALVE] {
            let errors: Vec<f64> = house.solutions(way).map(|solution| solution.errors.mse[0]).collect();
            assert!(errors.len() == 2 && errors.iter().all(|error| (0.7 * noise..1.4 * noise).contains(error)), "{}: {errors:?}", way.name);
        }
        for solution in house.solutions(&THESIS) {
            let [mse, swmse] = [solution.errors.mse[0], solution.errors.swmse[0]];
            assert!(swmse >= mse && (solution.cost / swmse - 1.0).abs() < 1e-6, "{mse} {swmse} {}", solution.cost);
            assert!(solution.errors.mse[0] > house.median(&DEFAULT, 0).unwrap(), "52 fireflies in the wide box are no match");
        }
        let tables = tables::tables(&house);
        let ids: Vec<&str> = tables.iter().map(|table| table.id).collect();
        assert_eq!(ids, ["layout", "table-7-6", "table-7-8", "table-7-9", "shapes", "boxes", "figure-7-7", "valves", "times"]);
        for table in &tables {
            assert!(table.rows.iter().all(|row| row.len() == table.head.len()), "{}", table.text());
        }
        let named = |id: &str| tables.iter().find(|table| table.id == id).unwrap();
        let cfa = named("table-7-8").head.iter().position(|head| head == "cfa MSE").unwrap();
        assert!(named("table-7-8").rows[..2].iter().all(|row| row[cfa].parse::<f64>().is_ok_and(|error| error < 0.01)));
        assert_eq!(named("table-7-8").rows[2][cfa], "2 of 2");

        let page = page::document(&house, &tables).ok().unwrap();
        assert_eq!(page.matches("<figure").count(), page.matches("<summary>Numbers").count());
        for word in ["<script", "://", " src=", " style=", "@import", "NaN"] {
            assert!(!page.contains(word), "{word}: {:?}", page.find(word).map(|at| &page[at.saturating_sub(80)..at + 40]));
        }
        assert!(tables.iter().all(|table| page.contains(&format!(r#"<section id="{}">"#, table.id))));
    }
}
