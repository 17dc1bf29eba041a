//! Maximum likelihood on synthetic rooms: convergence, wall time, errors beside those of the free-run fit,
//! and how often the 95 % intervals hold the truth.

use super::options::{Each, First, RoomCount};
use super::row::Row;
use indexmap::IndexMap;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, DAY, HOUR, Window};
use lampyris_core::estimate::assess::metrics;
use lampyris_core::estimate::fit::Stop;
use lampyris_core::estimate::fit::likelihood::NoiseEstimate;
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Problem, Site, estimate, prepare};
use lampyris_core::model::Catalogue;
use lampyris_core::twin;
use std::time::Instant;

/// Days that are fitted.
const DAYS: usize = 7;
/// Days behind them that are forecast: a forecast of a day says little about parameters where it is the only
/// one.
const HELD_OUT: usize = 7;

fn problem(
    csv: &str,
    model: &str,
    method: &serde_json::Value,
    split: &serde_json::Value,
    site: &Site,
) -> Result<(Problem, EstimateRequest), Failure> {
    let error = |error: &dyn std::fmt::Display| Failure::Error(error.to_string());
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
    let request: EstimateRequest =
        serde_json::from_value(serde_json::json!({ "method": method, "split": split }))
            .map_err(|found| error(&found))?;
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let id = model.parse().map_err(|found| error(&found))?;
    let problem = prepare(&catalogue, &id, &request, &window, site).map_err(|found| faults(&found))?;
    Ok((problem, request))
}

/// A fit and its seconds.
fn fitted(problem: &Problem, request: &EstimateRequest) -> Result<(Fit, f64), Failure> {
    let start = Instant::now();
    let fit = estimate(problem, request, None, &Control::NONE)
        .map_err(|error| Failure::Error(error.to_string()))?;
    Ok((fit, start.elapsed().as_secs_f64()))
}

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    pub first: First,
    #[command(flatten)]
    rooms: RoomCount,
    /// In how many worlds the intervals are looked at.
    #[arg(long, default_value_t = 30)]
    worlds: u64,
    #[command(flatten)]
    each: Each,
}

pub fn run(asked: &Arguments) -> Result<Vec<Row>, Failure> {
    let (first, rooms, each) = (asked.first.seed, asked.rooms.rooms, asked.each.each);
    let mut rows = if rooms > 0 { convergence(first, rooms, each)? } else { Vec::new() };
    if asked.worlds > 0 {
        rows.extend(coverage(first, asked.worlds, each)?);
    }
    Ok(rows)
}

/// A week to fit, a week to forecast.
fn split() -> serde_json::Value {
    serde_json::json!({"train": format!("P{DAYS}D"), "validation": format!("P{HELD_OUT}D"), "test": "P0D"})
}

/// Rooms of the thesis's kind with four neighbours in half hours, then rooms that chance moves in ten
/// minutes.
fn convergence(first: u64, rooms: u64, each: bool) -> Result<Vec<Row>, Failure> {
    let (mut still, mut moved) = (Vec::new(), Vec::new());
    for room in first..first + rooms {
        let twin = twin::room(room, 4, DAYS + HELD_OUT, 30).map_err(|found| faults(&found))?;
        let site =
            Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
        still.push(Beside::new(&twin.csv, "room3", room, &site)?);
        moved.push(Beside::new(&twin::noisy(room, DAYS + HELD_OUT).csv, "tite", room, &Site::default())?);
        if each {
            still
                .iter()
                .chain(&moved)
                .filter(|beside| beside.room == room)
                .for_each(|beside| eprintln!("{}", beside.line()));
        }
    }
    let mut found = rows(&format!("ctsm on {rooms} synthetic rooms of 15 parameters"), &still, None);
    // Without process noise the free run is the likeliest forecast of all, and nothing is left to gain.
    found.extend(rows(
        &format!("ctsm on {rooms} rooms with process noise, of 6 parameters"),
        &moved,
        Some(1.0),
    ));
    Ok(found)
}

/// A room fitted both ways.
struct Beside {
    room: u64,
    model: &'static str,
    stop: Stop,
    evaluations: usize,
    seconds: f64,
    plain_seconds: f64,
    /// Hold-out errors by horizon, and those of the free-run fit.
    errors: [Vec<f64>; 2],
}

/// The horizons at which the hold-out is forecast, and how they are called.
const AHEAD: [(&str, i64, &str); 3] =
    [("step", 0, "one step"), ("PT1H", HOUR, "an hour"), ("PT24H", DAY, "a day")];

impl Beside {
    fn new(csv: &str, model: &'static str, room: u64, site: &Site) -> Result<Self, Failure> {
        let fit = |method: &str| -> Result<(Problem, Fit, f64), Failure> {
            let (task, request) =
                problem(csv, model, &serde_json::json!({"name": method, "seed": room}), &split(), site)?;
            let (fit, seconds) = fitted(&task, &request)?;
            Ok((task, fit, seconds))
        };
        let (task, likely, seconds) = fit("ctsm")?;
        let (_, plain, plain_seconds) = fit("cfa")?;
        let horizons = AHEAD.map(|(name, length, _)| (name, length.max(task.grid().step())));
        let errors = |fit: &Fit| {
            let run = metrics::filter_fit(&task, fit);
            let errors =
                metrics::ahead(&task, &fit.theta(), &run, task.split().validation.clone(), &horizons);
            AHEAD.iter().map(|(name, ..)| errors.get(*name).map_or(f64::NAN, |error| error.rmse)).collect()
        };
        let errors = [errors(&likely), errors(&plain)];
        Ok(Self {
            room,
            model,
            stop: likely.stopped_by,
            evaluations: likely.evaluations,
            seconds,
            plain_seconds,
            errors,
        })
    }

    fn line(&self) -> String {
        let Self { room, model, stop, evaluations, seconds, .. } = self;
        let ratios: Vec<f64> =
            (0..AHEAD.len()).map(|horizon| ratio(std::slice::from_ref(self), horizon)).collect();
        format!(
            "room {room}, {model}: {stop:?}, {evaluations} evaluations, {seconds:.1} s; ahead {ratios:.3?} \
            of the free-run fit's"
        )
    }
}

/// The root of the mean square hold-out error of all rooms at a horizon, over that of the free-run fits.
fn ratio(rooms: &[Beside], horizon: usize) -> f64 {
    let [likely, plain] =
        [0, 1].map(|way| rooms.iter().map(|room| room.errors[way][horizon].powi(2)).sum::<f64>().sqrt());
    likely / plain
}

fn rows(title: &str, rooms: &[Beside], limit: Option<f64>) -> Vec<Row> {
    let longest = |seconds: fn(&Beside) -> f64| rooms.iter().map(seconds).fold(0.0, f64::max);
    let converged =
        rooms.iter().filter(|room| room.stop == Stop::Converged).count() as f64 / rooms.len().max(1) as f64;
    let mut found = vec![
        Row::new(format!("{title}: share converged"), converged, "-").at_least(1.0),
        Row::new("  longest wall time of a room (target 5 s)", longest(|room| room.seconds), "s"),
        Row::new("  the same of the free-run fit", longest(|room| room.plain_seconds), "s"),
    ];
    for (index, (_, _, name)) in AHEAD.iter().enumerate() {
        let title = format!("  hold-out error {name} ahead over that of the free-run fit, all rooms");
        let row = Row::new(title, ratio(rooms, index), "x");
        found.push(match limit {
            Some(limit) => row.at_most(limit),
            None => row,
        });
    }
    found
}

/// How often each interval holds the truth, over fresh twins with process noise.
fn coverage(first: u64, worlds: u64, each: bool) -> Result<Vec<Row>, Failure> {
    let split = serde_json::json!({"train": format!("P{DAYS}D"), "validation": "P0D", "test": "P0D"});
    let mut held: IndexMap<String, (u64, u64)> = IndexMap::new();
    for world in first..first + worlds {
        let twin = twin::noisy(world, DAYS);
        let method = serde_json::json!({"name": "ctsm", "seed": world, "profile": 0});
        let (task, request) = problem(&twin.csv, "tite", &method, &split, &Site::default())?;
        let (fit, seconds) = fitted(&task, &request)?;
        let Some(found) = &fit.likelihood else { continue };
        for (name, truth) in &twin.truth {
            let noise = |prefix: &str, of: &IndexMap<String, NoiseEstimate>| {
                let key = name.strip_prefix(prefix)?.strip_suffix(')')?;
                of.get(key).filter(|noise| !noise.at_bound).and_then(|noise| noise.ci95)
            };
            let own = || {
                fit.parameters
                    .get(name)
                    .filter(|estimate| !estimate.at_bound)
                    .and_then(|estimate| estimate.ci95)
            };
            let interval = own()
                .or_else(|| noise("sigma(", &found.diffusion))
                .or_else(|| noise("sd(", &found.measurement));
            let count = held.entry(name.clone()).or_default();
            if let Some([low, high]) = interval {
                count.0 += u64::from((low..=high).contains(truth));
                count.1 += 1;
            }
        }
        if each {
            eprintln!(
                "twin {world}: {:?}, log-likelihood {:.2}, {seconds:.2} s",
                fit.stopped_by, found.log_likelihood
            );
        }
    }
    let share = |(held, all): (u64, u64)| held as f64 / all.max(1) as f64;
    let one = |(name, count): (&String, &(u64, u64))| {
        Row::new(format!("  {name}: share of {} intervals that hold the truth", count.1), share(*count), "-")
            .at_least(0.9)
    };
    let title = Row::new(format!("95 % intervals over {worlds} twins with process noise"), worlds as f64, "");
    Ok([title].into_iter().chain(held.iter().map(one)).collect())
}
