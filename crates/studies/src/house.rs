//! Chapter 7 of the thesis in public: a twin of its house, seventeen sensors, eleven rooms, one week to fit
//! and one to judge, by every method in every box.

mod found;
mod page;
mod published;
mod tables;
mod ways;

use super::options::{First, Html, RoomCount};
use super::row::Row;
use found::House;
use lampyris::cli::{Failure, print};
use lampyris_core::estimate::problem::objective::ShapeDelta;
use lampyris_core::twin::HouseRequest;
use serde_json::{Value, json};
use ways::Asked;

/// The sampling of most of the thesis's sensors (7.2.4).
const STEP_MINUTES: usize = 30;
/// Days of each of the two parts.
const PART_DAYS: usize = 7;
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    pub first: First,
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
        std::fs::write(file, page::document(&house, &tables)?)
            .map_err(|error| Failure::Error(format!("{}: {error}", file.display())))?;
        eprintln!("page: {}", file.display());
    }
    Ok((
        house.rows(),
        json!({ "layout": house.layout, "truth": house.truths, "runs": house.runs, "tables": tables }),
    ))
}

#[cfg(test)]
mod tests {
    use super::ways::{DEFAULT, THESIS, VALVE, Way};
    use super::*;

    /// Chapter 7 in a few seconds: two rooms of a house in which nobody lives, four days each, a short swarm.
    fn small() -> House {
        let thesis = Way {
            request: r#"{"method": {"name": "cfa_thesis", "n": 12, "generations": 4}, "objective": "swmse"}"#,
            ..THESIS
        };
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
            assert!(
                errors.len() == 2 && errors.iter().all(|error| (0.7 * noise..1.4 * noise).contains(error)),
                "{}: {errors:?}",
                way.name
            );
        }
        for solution in house.solutions(&THESIS) {
            let [mse, swmse] = [solution.errors.mse[0], solution.errors.swmse[0]];
            assert!(
                swmse >= mse && (solution.cost / swmse - 1.0).abs() < 1e-6,
                "{mse} {swmse} {}",
                solution.cost
            );
            assert!(
                solution.errors.mse[0] > house.median(&DEFAULT, 0).unwrap(),
                "52 fireflies in the wide box are no match"
            );
        }
        let tables = tables::tables(&house);
        let ids: Vec<&str> = tables.iter().map(|table| table.id).collect();
        assert_eq!(
            ids,
            [
                "layout",
                "table-7-6",
                "table-7-8",
                "table-7-9",
                "shapes",
                "boxes",
                "figure-7-7",
                "valves",
                "times"
            ]
        );
        for table in &tables {
            assert!(table.rows.iter().all(|row| row.len() == table.head.len()), "{}", table.text());
        }
        let named = |id: &str| tables.iter().find(|table| table.id == id).unwrap();
        let cfa = named("table-7-8").head.iter().position(|head| head == "cfa MSE").unwrap();
        assert!(
            named("table-7-8").rows[..2]
                .iter()
                .all(|row| row[cfa].parse::<f64>().is_ok_and(|error| error < 0.01))
        );
        assert_eq!(named("table-7-8").rows[2][cfa], "2 of 2");

        let page = page::document(&house, &tables).ok().unwrap();
        assert_eq!(page.matches("<figure").count(), page.matches("<summary>Numbers").count());
        for word in ["<script", "://", " src=", " style=", "@import", "NaN"] {
            assert!(
                !page.contains(word),
                "{word}: {:?}",
                page.find(word).map(|at| &page[at.saturating_sub(80)..at + 40])
            );
        }
        assert!(tables.iter().all(|table| page.contains(&format!(r#"<section id="{}">"#, table.id))));
    }
}
