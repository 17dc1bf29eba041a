//! Functions that are honestly hard: shifted, rotated and ill-conditioned. The default search beside its
//! rivals, by the expected running time to a target.

mod bbob;
mod bipop;
#[cfg(test)]
mod oracle;
mod rivals;
mod table;
mod task;
mod watch;

use super::options::{Only, Seeds};
use super::row::Row;
use lampyris::cli::print;
use rayon::prelude::*;
use rivals::{Rival, one, rivals};
use serde_json::{Value, json};
use table::{Outcome, rows, text};
use task::tasks;

/// Evaluations per dimension on an ordinary day, and with time.
const BUDGETS: [usize; 2] = [10_000, 100_000];

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    pub seeds: Seeds,
    #[command(flatten)]
    only: Only,
    /// Allow 100,000 evaluations per dimension instead of 10,000.
    #[arg(long)]
    long: bool,
}

/// Runs every search on every function, each seed on an instance of its own.
pub fn run(asked: &Arguments, as_json: bool) -> (Vec<Row>, Value) {
    let (first, seeds) = (asked.seeds.first.seed, asked.seeds.seeds);
    let budget = BUDGETS[usize::from(asked.long)];
    let only = asked.only.only.as_deref().unwrap_or_default();
    let mut outcomes = Vec::new();
    for task in tasks().into_iter().filter(|task| task.name().contains(only)) {
        let search = |rival: &Rival| {
            let runs = (first..first + seeds).into_par_iter().map(|seed| one(&task, rival, budget, seed));
            Outcome { task, rival: rival.name, runs: runs.collect() }
        };
        let own: Vec<Outcome> = rivals().iter().map(search).collect();
        if !as_json {
            print(&text(&task, &own));
        }
        outcomes.extend(own);
    }
    let tables: Vec<Value> = outcomes.iter().map(Outcome::document).collect();
    (rows(&outcomes), json!({ "evaluations_per_dimension": budget, "searches": tables }))
}

#[cfg(test)]
mod tests {
    use super::bbob::Shape;
    use super::rivals::{BIPOP, DEFAULT};
    use super::task::{Kind, Task};
    use super::*;

    fn outcome(kind: Kind, name: &str) -> Outcome {
        let task = Task { kind, dimensions: 5 };
        let known = rivals();
        let rival = known.iter().find(|rival| rival.name == name).unwrap();
        Outcome { task, rival: rival.name, runs: (1..6).map(|seed| one(&task, rival, 3000, seed)).collect() }
    }

    #[test]
    fn the_default_turns_with_the_valley() {
        for shape in [Shape::RotatedEllipsoid, Shape::Discus, Shape::BentCigar, Shape::DifferentPowers] {
            let [own, rival] = [DEFAULT, BIPOP].map(|name| outcome(Kind::Bbob(shape), name));
            for target in 0..3 {
                let (own, rival) = (own.time(target).unwrap(), rival.time(target).unwrap());
                assert!(own < 2.0 * rival, "{shape:?}: {own} {rival}");
            }
        }
    }

    #[test]
    fn a_seed_fixes_every_run() {
        for rival in rivals() {
            let task = Task { kind: Kind::Bbob(Shape::Schaffer), dimensions: 5 };
            assert_eq!(one(&task, &rival, 200, 7), one(&task, &rival, 200, 7), "{}", rival.name);
        }
    }
}
