//! The rooms, the runs of every method on them, and their figures.

use super::super::quantile::quantile;
use super::super::row::Row;
use super::super::search::{Path, path, path_in};
use super::methods::{DEFAULT, ENDLESS, Entry, LINEAR, MULTISTART, reference};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::{EstimateRequest, Problem, Site, prepare};
use lampyris_core::model::{Catalogue, ModelId};
use lampyris_core::optimise::{Dimension, DimensionScale, Space};
use lampyris_core::twin;
use serde::Serialize;
use serde_json::json;
use std::fmt::Write;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A fit counts when its cost is within this factor of the best known.
const WITHIN: f64 = 1.01;
/// Most evaluations of a search.
pub const BUDGET: usize = 20_000;

/// A search on a room.
#[derive(Debug)]
pub struct Run {
    pub room: u64,
    pub seed: u64,
    pub path: Path,
    /// Mean square of its free-run error in the week that it did not see.
    pub hold_out: Option<f64>,
}

/// The runs of a method, the rooms one after another, and what they are measured by.
#[derive(Debug)]
pub struct Outcome {
    pub entry: Entry,
    pub runs: Vec<Run>,
}

/// The best known fit of a room.
#[derive(Debug, Clone, Copy)]
pub struct Known {
    pub cost: f64,
    pub hold_out: f64,
}

/// Everything that was measured.
pub struct Rooms {
    pub first: u64,
    pub known: Vec<Known>,
    pub outcomes: Vec<Outcome>,
}

/// A synthetic room with four neighbours: the first week is fitted, the second one only judges.
fn weeks(seed: u64) -> Result<Problem, Failure> {
    let twin = twin::room(seed, 4, 14, 30).map_err(|found| faults(&found))?;
    let (window, _) =
        Window::parse_csv(&twin.csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
    let model: ModelId = "room3".parse().map_err(|error| Failure::Error(format!("{error}")))?;
    let request: EstimateRequest =
        serde_json::from_value(json!({ "split": { "train": "P7D", "validation": "P7D" } }))
            .map_err(|error| Failure::Error(error.to_string()))?;
    let site = Site { sets: [("neighbours".to_owned(), twin.neighbours)].into(), ..Site::default() };
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    prepare(&catalogue, &model, &request, &window, &site).map_err(|found| faults(&found))
}

/// The box of a problem in which every coefficient is spread evenly.
fn linear(space: &Space) -> Space {
    Space::new(
        space
            .dimensions()
            .iter()
            .map(|dimension| Dimension { scale: DimensionScale::Linear, ..dimension.clone() })
            .collect(),
    )
}

/// Mean square of the free-run error in the part that the search did not see.
fn hold_out(problem: &Problem, path: &Path) -> Option<f64> {
    let unseen = problem.split().validation.clone();
    path.best.as_ref().and_then(|theta| problem.mean_square_error(&problem.simulate(theta), 0, unseen))
}

/// Works on a list with all cores, one piece to a core and none divided, so that the wall time of a piece is
/// that of one core.
pub fn on_every_core<T: Sync, R: Send>(list: &[T], work: impl Fn(&T) -> R + Sync) -> Result<Vec<R>, Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let pools: Result<Vec<_>, _> =
        (0..cores).map(|_| rayon::ThreadPoolBuilder::new().num_threads(1).build()).collect();
    let pools = pools.map_err(|error| Failure::Error(error.to_string()))?;
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for pool in &pools {
            scope.spawn(|| {
                while let Some((index, piece)) = Some(next.fetch_add(1, Ordering::Relaxed))
                    .and_then(|index| Some((index, list.get(index)?)))
                {
                    let result = pool.install(|| work(piece));
                    if let Ok(mut done) = done.lock() {
                        done.push((index, result));
                    }
                }
            });
        }
    });
    let mut done = done.into_inner().map_err(|error| Failure::Error(error.to_string()))?;
    done.sort_by_key(|(index, _)| *index);
    Ok(done.into_iter().map(|(_, result)| result).collect())
}

impl Rooms {
    pub fn measure(
        first: u64,
        rooms: u64,
        budget: usize,
        entries: Vec<Entry>,
        each: bool,
    ) -> Result<Self, Failure> {
        let problems = (first..first + rooms).map(weeks).collect::<Result<Vec<_>, _>>()?;
        let mut tasks = Vec::new();
        for (room, problem) in (first..).zip(&problems) {
            tasks.push((room, problem, None, 1000 + room));
            for entry in &entries {
                tasks.extend((0..entry.seeds).map(|seed| (room, problem, Some(entry), 100 * room + seed)));
            }
        }
        let reference = reference();
        let runs = on_every_core(&tasks, |(room, problem, entry, seed)| {
            let linear = linear(problem.space());
            let path = match entry {
                Some(Entry { method, residuals, scale, .. }) => {
                    let space = if *scale == DimensionScale::Linear { &linear } else { problem.space() };
                    path_in(problem, space, method, *residuals, *seed, budget)
                }
                None => path(problem, &reference, *seed, usize::MAX),
            };
            if each {
                let name = entry.map_or("the reference", |entry| entry.name);
                eprintln!(
                    "room {room}, {name}: cost {:.6} after {} evaluations, {:.2} s",
                    path.cost(),
                    path.evaluations,
                    path.seconds
                );
            }
            Run { room: *room, seed: *seed, hold_out: hold_out(problem, &path), path }
        })?;
        let best = |room: u64| {
            runs.iter().filter(|run| run.room == room).min_by(|a, b| a.path.cost().total_cmp(&b.path.cost()))
        };
        let known =
            |room| best(room).and_then(|run| Some(Known { cost: run.path.cost(), hold_out: run.hold_out? }));
        let known = (first..first + rooms)
            .map(|room| known(room).ok_or_else(|| Failure::Error(format!("room {room} has no fit"))));
        let known = known.collect::<Result<Vec<_>, _>>()?;
        let names: Vec<Option<&str>> =
            tasks.iter().map(|(_, _, entry, _)| entry.map(|entry| entry.name)).collect();
        let mut named: Vec<(Option<&str>, Run)> = names.into_iter().zip(runs).collect();
        let mut sorted: Vec<Vec<Run>> = Vec::new();
        for entry in &entries {
            let (own, others) = named.into_iter().partition(|(name, _)| *name == Some(entry.name));
            let own: Vec<(Option<&str>, Run)> = own;
            named = others;
            sorted.push(own.into_iter().map(|(_, run)| run).collect());
        }
        let outcomes = entries.into_iter().zip(sorted).map(|(entry, runs)| Outcome { entry, runs }).collect();
        Ok(Self { first, known, outcomes })
    }

    pub fn known(&self, run: &Run) -> Known {
        self.known[(run.room - self.first) as usize]
    }

    /// Evaluations until a run came within 1 % of the best known.
    pub fn reach(&self, run: &Run) -> Option<usize> {
        run.path.reach(WITHIN * self.known(run).cost)
    }

    pub fn of(&self, name: &str) -> Option<Figures> {
        self.outcomes.iter().find(|outcome| outcome.entry.name == name).map(|outcome| self.figures(outcome))
    }

    /// Evaluations of all runs of a method together.
    pub fn spent(&self, name: &str) -> f64 {
        let of = self.outcomes.iter().filter(|outcome| outcome.entry.name == name);
        of.flat_map(|outcome| &outcome.runs).map(|run| run.path.evaluations as f64).sum()
    }

    pub fn figures(&self, outcome: &Outcome) -> Figures {
        let quartiles = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            [0.25, 0.5, 0.75].map(|share| quantile(&values, share))
        };
        let over = |value: &dyn Fn(&Run) -> f64| quartiles(outcome.runs.iter().map(value).collect());
        let reached = over(&|run| self.reach(run).map_or(f64::INFINITY, |n| n as f64));
        let hit = outcome.runs.iter().filter(|run| self.reach(run).is_some()).count();
        Figures {
            method: outcome.entry.name,
            note: outcome.entry.note,
            runs: outcome.runs.len(),
            within: hit as f64 / outcome.runs.len() as f64,
            cost: over(&|run| run.path.cost() / self.known(run).cost),
            // A document has no word for infinity; neither has a quantile between a number and it.
            to_reach: reached.map(|value| value.is_finite().then_some(value)),
            evaluations: over(&|run| run.path.evaluations as f64),
            seconds: over(&|run| run.path.seconds),
            hold_out: over(&|run| {
                run.hold_out.map_or(f64::INFINITY, |error| (error / self.known(run).hold_out).sqrt())
            }),
        }
    }

    /// The limits, and what they rest on.
    pub fn rows(&self) -> Vec<Row> {
        let (Some(default), Some(endless), Some(multistart), Some(linear)) =
            (self.of(DEFAULT), self.of(ENDLESS), self.of(MULTISTART), self.of(LINEAR))
        else {
            return Vec::new();
        };
        let (rooms, seeds) = (self.known.len(), default.runs / self.known.len());
        let to_reach = |figures: &Figures| figures.to_reach[1].unwrap_or(f64::INFINITY);
        let saved = 1.0 - self.spent(DEFAULT) / self.spent(ENDLESS);
        vec![
            Row::new(
                format!("one room-week, {rooms} rooms x {seeds} seeds: share within 1 % of the best known"),
                default.within,
                "-",
            )
            .at_least(0.9),
            Row::new("  multi-start Levenberg-Marquardt, the same", multistart.within, "-"),
            Row::new("  linear instead of logarithmic scale, the same", linear.within, "-"),
            Row::new("  median evaluations to reach it", to_reach(&default), "").at_most(5000.0),
            Row::new("  multi-start, the same", to_reach(&multistart), ""),
            Row::new("  over those of multi-start", to_reach(&default) / to_reach(&multistart), "x")
                .at_most(0.75),
            Row::new("  median evaluations in all", default.evaluations[1], ""),
            Row::new("  over those of multi-start", default.evaluations[1] / multistart.evaluations[1], "x"),
            Row::new("  median wall time of a whole search on one core", default.seconds[1], "s"),
            Row::new("early stopping: evaluations saved on the rooms", saved, "-").at_least(0.5),
            Row::new("early stopping: success lost on the rooms", endless.within - default.within, "-")
                .at_most(0.01),
        ]
    }

    pub fn text(&self) -> String {
        let mut text = format!("{:<28}", HEAD[0]);
        HEAD[1..].iter().for_each(|title| {
            let _ = write!(text, "{title:>20}");
        });
        for outcome in &self.outcomes {
            let cells = self.figures(outcome).cells();
            let _ = write!(text, "\n{:<28}", cells[0]);
            cells[1..].iter().for_each(|cell| {
                let _ = write!(text, "{cell:>20}");
            });
        }
        text
    }

    /// Every run, a line each.
    pub fn listed(&self) -> String {
        let mut text =
            "room,method,seed,cost,best_known,evaluations,evaluations_to_reach,hold_out_rmse,best_known_hold_out_rmse,seconds\n".to_owned();
        for outcome in &self.outcomes {
            for run in &outcome.runs {
                let known = self.known(run);
                let reached = self.reach(run).map(|n| n.to_string()).unwrap_or_default();
                let hold_out = run.hold_out.map(|error| error.sqrt().to_string()).unwrap_or_default();
                let _ = writeln!(
                    text,
                    "{},\"{}\",{},{},{},{},{reached},{hold_out},{},{:.4}",
                    run.room,
                    outcome.entry.name,
                    run.seed,
                    run.path.cost(),
                    known.cost,
                    run.path.evaluations,
                    known.hold_out.sqrt(),
                    run.path.seconds
                );
            }
        }
        text
    }
}

/// The figures of a method; three numbers are quartiles over rooms and seeds.
#[derive(Debug, Serialize)]
pub struct Figures {
    pub method: &'static str,
    pub note: &'static str,
    pub runs: usize,
    /// Share of the runs within 1 % of the best known cost.
    pub within: f64,
    /// The cost over the best known.
    pub cost: [f64; 3],
    /// Evaluations until then, where so many runs came there.
    pub to_reach: [Option<f64>; 3],
    pub evaluations: [f64; 3],
    pub seconds: [f64; 3],
    /// The free-run error in the unseen week over that of the best known fit.
    pub hold_out: [f64; 3],
}

pub const HEAD: [&str; 7] =
    ["method", "within 1 %", "cost / best", "to reach 1 %", "evaluations", "unseen / best", "s, one core"];

impl Figures {
    pub fn cells(&self) -> Vec<String> {
        let ratio = |value: f64| if value < 100.0 { format!("{value:.3}") } else { format!("{value:.0}") };
        let spread = |[low, median, high]: [String; 3]| format!("{median} ({low}-{high})");
        let count = |value: Option<f64>| value.map_or_else(|| "never".to_owned(), |n| format!("{n:.0}"));
        vec![
            self.method.to_owned(),
            format!("{:.0} %", 100.0 * self.within),
            spread(self.cost.map(ratio)),
            spread(self.to_reach.map(count)),
            spread(self.evaluations.map(|n| format!("{n:.0}"))),
            spread(self.hold_out.map(ratio)),
            format!("{:.2}", self.seconds[1]),
        ]
    }
}
