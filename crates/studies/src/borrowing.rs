//! Whether the rooms of a house learn from each other: each of the eleven rooms of synthetic houses is fitted
//! to some days alone and with the prior that the others' fits give, and both are judged by the week that
//! follows.

use super::options::Worlds;
use super::row::Row;
use super::verdicts::judge_all;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, DAY, Duration, SplitRequest, Window, rfc3339};
use lampyris_core::estimate::pooling::{family, pooled};
use lampyris_core::estimate::problem::prior::{KnownParameter, KnownPrior, Prior};
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Problem, Site, estimate, prepare};
use lampyris_core::model::Catalogue;
use lampyris_core::twin::{HouseRequest, HouseTwin, house};

/// Days that are fitted: what a new room has, and what the others have.
const DAYS: [usize; 2] = [5, 28];
/// How much lower the error of the week that follows is to be with five days, and how much higher it may be
/// with 28.
const GAIN: f64 = 0.85;
const HARM: f64 = 1.01;
/// The week that follows.
const WEEK: usize = 7;
const STEP_MINUTES: usize = 15;
/// Nights of which each begins with what the one before has found in the others.
const NIGHTS: usize = 3;

/// The root mean square errors of the rooms of a house over the following week, by the days that were fitted.
struct Judged {
    seed: u64,
    alone: [Vec<f64>; 2],
    borrowed: [Vec<f64>; 2],
    /// With what the others truly are, which nobody can know.
    oracle: [Vec<f64>; 2],
    known: usize,
}

/// Houses by seed; `worlds` says how many.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, _, each) = asked.parts();
    let seeds: Vec<u64> = (0..worlds).map(|at| first * 1_000 + at).collect();
    let judged = judge_all(&seeds, |seed| judge(*seed), each.then_some(line))?;
    let mut rows = vec![Row::new("houses of eleven rooms", judged.len() as f64, "houses")];
    for (which, days) in DAYS.iter().enumerate() {
        let all =
            |of: &dyn Fn(&Judged) -> &Vec<f64>| judged.iter().flat_map(of).copied().collect::<Vec<f64>>();
        let (alone, borrowed) = (all(&|one| &one.alone[which]), all(&|one| &one.borrowed[which]));
        let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let name = |what: &str| format!("{days} days: {what}");
        rows.push(Row::new(name("error of the following week alone, mean"), mean(&alone), "K"));
        rows.push(Row::new(name("with what the others have"), mean(&borrowed), "K"));
        let ratio = mean(&borrowed) / mean(&alone);
        let limit = if which == 0 { GAIN } else { HARM };
        rows.push(Row::new(name("ratio of the means"), ratio, "").at_most(limit));
        let oracle = mean(&all(&|one| &one.oracle[which]));
        rows.push(Row::new(name("the same with what the others truly are"), oracle / mean(&alone), ""));
        let mut ratios: Vec<f64> = alone.iter().zip(&borrowed).map(|(alone, with)| with / alone).collect();
        ratios.sort_by(f64::total_cmp);
        rows.push(Row::new(name("median of the ratios"), ratios[ratios.len() / 2], ""));
        let better = ratios.iter().filter(|ratio| **ratio < 1.0).count() as f64;
        rows.push(Row::new(name("rooms that are better off"), 100.0 * better / ratios.len() as f64, "%"));
    }
    Ok(rows)
}

fn line(judged: &Judged) -> String {
    let of = |rooms: &[f64]| rooms.iter().map(|error| format!(" {error:.3}")).collect::<String>();
    let mut told = format!("house {}, {} parameters known", judged.seed, judged.known);
    for (which, days) in DAYS.iter().enumerate() {
        told += &format!("\n  {days:2} d alone   {}", of(&judged.alone[which]));
        told += &format!("\n  {days:2} d borrowed{}", of(&judged.borrowed[which]));
        told += &format!("\n  {days:2} d oracle  {}", of(&judged.oracle[which]));
    }
    told
}

fn judge(seed: u64) -> Result<Judged, Failure> {
    let days = DAYS[1] + WEEK;
    let request = HouseRequest { seed, days, step_minutes: STEP_MINUTES, lived_in: true };
    let twin = house(&request).map_err(|fault| faults(&[fault]))?;
    let mut judged = Judged {
        seed,
        alone: Default::default(),
        borrowed: Default::default(),
        oracle: Default::default(),
        known: 0,
    };
    for (which, days) in DAYS.into_iter().enumerate() {
        let rooms: Vec<(String, Problem)> = (0..twin.rooms.len())
            .map(|place| Ok((twin.rooms[place].room.to_string(), problem(&twin, place, days)?)))
            .collect::<Result<_, Failure>>()?;
        let mut fits: Vec<(String, Fit)> = rooms
            .iter()
            .map(|(name, problem)| Ok((name.clone(), fitted(problem)?)))
            .collect::<Result<_, Failure>>()?;
        judged.alone[which] = fits.iter().map(|(_, fit)| error(fit)).collect();
        for _ in 0..NIGHTS {
            let night = |(name, problem): &(String, Problem)| {
                let others: Vec<(String, Fit)> =
                    fits.iter().filter(|(other, _)| other != name).cloned().collect();
                let known = pooled(problem, &others).unwrap_or_default();
                judged.known = judged.known.max(known.parameters.len());
                Ok((name.clone(), fitted(&problem.with_prior(Prior::Known(known)))?))
            };
            let newer = rooms.iter().map(night).collect::<Result<_, Failure>>()?;
            fits = newer;
        }
        judged.borrowed[which] = fits.iter().map(|(_, fit)| error(fit)).collect();
        let truly = |(place, (_, problem)): (usize, &(String, Problem))| {
            let prior = Prior::Known(true_of_others(&twin, place, problem));
            Ok(error(&fitted(&problem.with_prior(prior))?))
        };
        judged.oracle[which] = rooms.iter().enumerate().map(truly).collect::<Result<_, Failure>>()?;
    }
    Ok(judged)
}

/// The mean and the deviation of the logarithms of what the other rooms truly are; walls are of one family.
fn true_of_others(twin: &HouseTwin, place: usize, problem: &Problem) -> KnownPrior {
    let others = twin.rooms.iter().enumerate().filter(|(other, _)| *other != place);
    let all: Vec<(String, f64)> = others.flat_map(|(_, room)| &room.parameters).cloned().collect();
    let of = |name: &str| {
        let logarithms = all.iter().filter(|(other, _)| family(other) == family(name));
        let logarithms: Vec<f64> = logarithms.map(|(_, value)| value.ln()).collect();
        let count = logarithms.len() as f64;
        let mean = logarithms.iter().sum::<f64>() / count;
        let squares = logarithms.iter().map(|one| (one - mean).powi(2)).sum::<f64>();
        KnownParameter { value: mean.exp(), deviation: (squares / (count - 1.0)).sqrt() }
    };
    let names = problem.model().parameters().iter().map(|parameter| parameter.name.clone());
    let known = names.filter(|name| all.iter().any(|(other, _)| family(other) == family(name)));
    KnownPrior { from: Vec::new(), parameters: known.map(|name| (name.clone(), of(&name))).collect() }
}

fn request(twin_days: usize) -> EstimateRequest {
    let days = |days: usize| Duration::from_days(days as i64);
    let split = SplitRequest { train: days(twin_days), validation: days(0), test: Some(days(WEEK)) };
    EstimateRequest { split, ..EstimateRequest::default() }
}

/// The problem of a room: the last so many days before the week, and the week as unseen data.
fn problem(twin: &HouseTwin, place: usize, days: usize) -> Result<Problem, Failure> {
    let room = &twin.rooms[place];
    let mut bindings = ColumnBindings::none();
    bindings.bind("T_room", format!("T_room_{}", room.room));
    bindings.bind("valve", format!("valve_{}", room.room));
    let (window, _) = Window::parse_csv(&twin.csv, &bindings).map_err(|found| faults(&found))?;
    let neighbours = room.neighbours.iter().map(u32::to_string).collect();
    let site = Site { sets: [("neighbours".to_owned(), neighbours)].into(), ..Site::default() };
    let from = window.from() + DAY * (DAYS[1] - days) as i64;
    let range = Some(WindowRange { from: Some(rfc3339(from)), ..WindowRange::default() });
    let asked = EstimateRequest { window: range, ..request(days) };
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let model = "room3".parse().map_err(|error| Failure::Error(format!("{error}")))?;
    prepare(&catalogue, &model, &asked, &window, &site).map_err(|found| faults(&found))
}

fn fitted(problem: &Problem) -> Result<Fit, Failure> {
    let asked = request(0);
    estimate(problem, &asked, None, &Control::NONE).map_err(|error| Failure::Error(error.to_string()))
}

/// The error of the free run over the week.
fn error(fit: &Fit) -> f64 {
    fit.first_metrics().and_then(|metrics| metrics.test_rmse).unwrap_or(f64::NAN)
}
