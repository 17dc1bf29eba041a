//! The default search beside its rivals on synthetic rooms of 15 parameters: one week fitted, the next one to
//! judge.

mod methods;
mod page;
mod rooms;

use super::file::write;
use super::options::{Csv, Each, First, Html, RoomCount};
use super::row::Row;
use lampyris::cli::{Failure, print};
use methods::entries;
use rooms::{BUDGET, Figures, Rooms};
use serde_json::{Value, json};
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    pub first: First,
    #[command(flatten)]
    rooms: RoomCount,
    #[command(flatten)]
    each: Each,
    #[command(flatten)]
    html: Html,
    #[command(flatten)]
    csv: Csv,
}

/// Runs every method on every room; prints the table, and writes the page and the runs where files are named.
pub fn run(asked: &Arguments, as_json: bool) -> Result<(Vec<Row>, Value), Failure> {
    if asked.rooms.rooms == 0 {
        return Err(Failure::Usage("at least one room".to_owned()));
    }
    let start = Instant::now();
    let rooms = Rooms::measure(asked.first.seed, asked.rooms.rooms, BUDGET, entries(), asked.each.each)?;
    let seconds = start.elapsed().as_secs_f64();
    if !as_json {
        print(&format!("{}\n", rooms.text()));
    }
    if let Some(file) = &asked.csv.csv {
        write(file, &rooms.listed())?;
    }
    if let Some(file) = &asked.html.html {
        write(file, &page::document(&rooms)?)?;
    }
    let mut rows = rooms.rows();
    rows.push(Row::new("wall time of everything", seconds, "s"));
    let figures: Vec<Figures> = rooms.outcomes.iter().map(|outcome| rooms.figures(outcome)).collect();
    Ok((rows, json!({ "budget": BUDGET, "methods": figures })))
}

#[cfg(test)]
mod tests {
    use super::methods::{DEFAULT, Entry, LINEAR};
    use super::rooms::on_every_core;
    use super::*;

    /// Two rooms, the default and a swarm, few evaluations.
    fn small() -> Rooms {
        let named = entries().into_iter().filter(|entry| [DEFAULT, LINEAR, "pso"].contains(&entry.name));
        Rooms::measure(40_901, 2, 1500, named.map(|entry| Entry { seeds: 2, ..entry }).collect(), false)
            .ok()
            .unwrap()
    }

    #[test]
    fn a_small_comparison_has_every_figure_and_a_page_that_needs_nothing() {
        let rooms = small();
        assert!(
            rooms.known.iter().all(|known| (0.04f64.powi(2)..0.06f64.powi(2)).contains(&known.cost)),
            "{:?}",
            rooms.known
        );
        for outcome in &rooms.outcomes {
            let figures = rooms.figures(outcome);
            assert_eq!(figures.runs, 4);
            assert!(figures.cost[0] >= 1.0 && figures.cost[2] >= figures.cost[0], "{figures:?}");
            assert!(figures.evaluations[2] <= 1500.0);
            assert!((figures.within > 0.0) == outcome.runs.iter().any(|run| rooms.reach(run).is_some()));
        }
        let [default, pso] = [DEFAULT, "pso"].map(|name| rooms.of(name).unwrap());
        assert!(default.cost[1] < pso.cost[1], "{default:?} {pso:?}");
        assert_eq!(rooms.listed().lines().count(), 1 + 3 * 4);
        let page = page::document(&rooms).ok().unwrap();
        for word in ["<script", "://", " src=", " style=", "@import", "NaN"] {
            assert!(!page.contains(word), "{word}");
        }
        assert!(rooms.outcomes.iter().all(|outcome| page.contains(outcome.entry.name)));
    }

    #[test]
    fn pieces_come_back_in_their_order() {
        let list: Vec<usize> = (0..50).collect();
        assert_eq!(
            on_every_core(&list, |n| n * n).ok().unwrap(),
            list.iter().map(|n| n * n).collect::<Vec<_>>()
        );
    }
}
