//! What nights cost that begin at the served parameters, and what they lose: synthetic rooms, night by night,
//! with the search from there beside a search everywhere.

use super::options::Worlds;
use super::row::Row;
use super::twin_room::{TwinRoom, measured, twin_room, watched};
use super::verdicts::{judge_all, share};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{DAY, SplitRequest, Window};
use lampyris_core::diagnose::change::{WINDOW_DAYS, changes};
use lampyris_core::estimate::assess::metrics::ProcessNoise;
use lampyris_core::estimate::assess::regimes::with_worst_regime;
use lampyris_core::estimate::fit::Searched;
use lampyris_core::estimate::problem::request::SearchExtent;
use lampyris_core::estimate::{
    Control, EstimateRequest, Fit, GatePolicy, Incumbent, Past, Verdict, estimate, validate,
};
use lampyris_core::twin::{Level, World, WorldRequest, world};
use rayon::{ThreadPool, ThreadPoolBuilder};
use rustix::time::{ClockId, clock_gettime};

/// Days of a fit, and nights.
const FITTED: i64 = 28;
const NIGHTS: i64 = 30;
/// Minutes between samples: a world has some that divide an hour by three.
const STEP: usize = 9;
/// In so many nights one is searched everywhere to compare with.
const COMPARED: i64 = 5;
/// In so many nights one is searched everywhere in any case.
const DRAWN: i64 = 10;
/// What is no worse.
const NO_WORSE: f64 = 1.01;

/// A room, night by night.
struct WatchedRoom {
    nights: Vec<Night>,
}

/// What a night took of one thread, in seconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Spent {
    prepared: f64,
    estimated: f64,
    regimes: f64,
    changes: f64,
    judged: f64,
}

impl Spent {
    fn all(&self) -> f64 {
        self.prepared + self.estimated + self.regimes + self.changes + self.judged
    }
}

/// A night of one room.
struct Night {
    spent: Spent,
    evaluations: usize,
    is_local: bool,
    is_served: bool,
    /// Where everywhere was searched as well: the error of what the night has found over that one's, on the
    /// days of the fit and on the days behind.
    beside: Option<[f64; 2]>,
    /// What that search took.
    cold: Option<Spent>,
}

/// Rooms of both levels in turns.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, only, each) = asked.parts();
    let name = |level: Level| if level == Level::Matched { "matched" } else { "rich" };
    let worlds: Vec<(u64, Level)> = (0..worlds)
        .map(|at| (first * 1_000_000 + at, if at % 2 == 0 { Level::Matched } else { Level::Rich }))
        .filter(|(_, level)| only.is_none_or(|only| name(*level).contains(only)))
        .collect();
    let rooms = judge_all(&worlds, |(seed, level)| room(*seed, *level), each.then_some(line))?;
    Ok(rows(&rooms))
}

fn line(WatchedRoom { nights }: &WatchedRoom) -> String {
    let beside: Vec<f64> = nights.iter().filter_map(|night| Some(night.beside?[0])).collect();
    let local = nights.iter().filter(|night| night.is_local).count();
    let took: Vec<f64> = nights.iter().map(|night| 1e3 * night.spent.all()).collect();
    format!(
        "{local} of {} nights local; error over that of a search everywhere {beside:.3?}; ms {took:.0?}",
        nights.len()
    )
}

/// Seconds that this thread has worked.
fn worked() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

fn timed<T>(clock: fn() -> f64, spent: &mut f64, work: impl FnOnce() -> T) -> T {
    let begun = clock();
    let done = work();
    *spent += clock() - begun;
    done
}

fn failed(fault: impl std::fmt::Display) -> Failure {
    Failure::Error(fault.to_string())
}

fn room(seed: u64, level: Level) -> Result<WatchedRoom, Failure> {
    let pool: ThreadPool = ThreadPoolBuilder::new().num_threads(1).build().map_err(failed)?;
    let days = (FITTED + NIGHTS) as usize;
    let request = WorldRequest { days, step_minutes: STEP, ..WorldRequest::new(seed, &[], level) };
    let made = world(&request).map_err(failed)?;
    let window = measured(&made)?;
    pool.install(|| {
        let mut served: Option<Fit> = None;
        let mut nights = Vec::new();
        for night in 0..NIGHTS {
            let from = window.from() + night * DAY;
            let fitted = window.slice(from, from + FITTED * DAY).map_err(|found| faults(&found))?;
            let is_drawn = (night + seed as i64) % DRAWN == 0;
            let search = if is_drawn { SearchExtent::Global } else { SearchExtent::Local };
            let (fit, is_served, spent) = a_night(&made, &fitted, search, served.as_ref(), worked)?;
            let mut here = Night {
                spent,
                evaluations: fit.evaluations,
                is_local: fit.searched == Some(Searched::Local),
                is_served,
                beside: None,
                cold: None,
            };
            if (night + 1) % COMPARED == 0 {
                let (cold, _, took) = a_night(&made, &fitted, SearchExtent::Global, served.as_ref(), worked)?;
                here.beside = Some(errors(&fit, &cold));
                here.cold = Some(took);
            }
            if is_served {
                served = Some(fit);
            }
            nights.push(here);
        }
        Ok(WatchedRoom { nights })
    })
}

/// The error of one fit over that of another one, where it was fitted and behind.
fn errors(one: &Fit, other: &Fit) -> [f64; 2] {
    let of = |fit: &Fit| fit.first_metrics().map(|found| [Some(found.train_rmse), found.validation_rmse]);
    let ratio = |place: usize| match (of(one), of(other)) {
        (Some(a), Some(b)) => a[place].unwrap_or(f64::NAN) / b[place].unwrap_or(f64::NAN),
        _ => f64::NAN,
    };
    [ratio(0), ratio(1)]
}

/// The fit of a night as the service makes it, whether it is served, and what it took by a clock.
pub fn a_night(
    made: &World,
    window: &Window,
    search: SearchExtent,
    served: Option<&Fit>,
    clock: fn() -> f64,
) -> Result<(Fit, bool, Spent), Failure> {
    let mut spent = Spent::default();
    let TwinRoom { problem, asked, .. } =
        timed(clock, &mut spent.prepared, || twin_room(made, window, "room3", SplitRequest::ESTIMATE))?;
    let asked = EstimateRequest { search, ..asked };
    let incumbent = served.and_then(Incumbent::of);
    let fit =
        timed(clock, &mut spent.estimated, || estimate(&problem, &asked, incumbent.as_ref(), &Control::NONE))
            .map_err(failed)?;
    let fit =
        timed(clock, &mut spent.regimes, || with_worst_regime(fit, &problem, window)).map_err(failed)?;
    timed(clock, &mut spent.changes, || changed(made, window, &fit))?;
    let past = Past::of(incumbent);
    let judgement =
        timed(clock, &mut spent.judged, || validate(&problem, &fit, &past, &GatePolicy::default()));
    let is_served = matches!(judgement.verdict, Verdict::Accepted(_));
    Ok((fit, is_served, spent))
}

/// Whether a parameter has changed within the newest weeks, as a night looks for it.
fn changed(made: &World, window: &Window, fit: &Fit) -> Result<(), Failure> {
    let weeks =
        window.slice(window.to() - WINDOW_DAYS as i64 * DAY, window.to()).map_err(|found| faults(&found))?;
    let problem = watched(made, &weeks, WINDOW_DAYS)?;
    let _ = changes(&fit.simulated(&problem), &fit.theta(), ProcessNoise::of(fit));
    Ok(())
}

fn rows(rooms: &[WatchedRoom]) -> Vec<Row> {
    let nights: Vec<&Night> = rooms.iter().flat_map(|room| &room.nights).collect();
    let median = |values: Vec<f64>, share: f64| {
        let mut values = values;
        values.sort_by(f64::total_cmp);
        values.get((values.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN)
    };
    let mut rows = Vec::new();
    rows.extend(share("nights that end next to the served parameters", &nights, |night| night.is_local));
    rows.extend(share("nights that are served", &nights, |night| night.is_served));
    let spent: Vec<Spent> = nights.iter().map(|night| night.spent).collect();
    let cold: Vec<Spent> = nights.iter().filter_map(|night| night.cold).collect();
    for (what, spent) in [("a night", &spent), ("a night that searches everywhere", &cold)] {
        let ms =
            |of: fn(&Spent) -> f64, share| median(spent.iter().map(|one| 1e3 * of(one)).collect(), share);
        rows.push(Row::new(format!("{what}, of one core: median"), ms(Spent::all, 0.5), "ms"));
        rows.push(Row::new("  of that: preparing", ms(|one| one.prepared, 0.5), "ms"));
        rows.push(Row::new("  estimating", ms(|one| one.estimated, 0.5), "ms"));
        rows.push(Row::new("  circumstances", ms(|one| one.regimes, 0.5), "ms"));
        rows.push(Row::new("  changes", ms(|one| one.changes, 0.5), "ms"));
        rows.push(Row::new("  judging", ms(|one| one.judged, 0.5), "ms"));
        let mean = spent.iter().map(Spent::all).sum::<f64>() / spent.len().max(1) as f64;
        rows.push(Row::new("  mean", 1e3 * mean, "ms"));
    }
    let evaluations = nights.iter().filter(|night| night.is_local).map(|night| night.evaluations as f64);
    rows.push(Row::new("simulations of a local night: median", median(evaluations.collect(), 0.5), "-"));
    let compared: Vec<[f64; 2]> = nights.iter().filter_map(|night| night.beside).collect();
    for (place, what) in ["on its days", "on the days behind"].into_iter().enumerate() {
        let what = format!("error {what} no more than 1 % above that of a search everywhere, nights");
        rows.extend(share(&what, &compared, |beside| beside[place] <= NO_WORSE));
    }
    let last =
        |room: &WatchedRoom| room.nights.iter().rev().find_map(|night| night.beside).map(|beside| beside[0]);
    rows.extend(
        share("rooms no worse in the last night compared", rooms, |room| {
            last(room).is_some_and(|ratio| ratio <= NO_WORSE)
        })
        .map(|row| row.at_least(0.99)),
    );
    rows
}
