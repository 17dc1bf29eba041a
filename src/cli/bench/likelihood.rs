//! Maximum likelihood on synthetic rooms: convergence, wall time, errors beside those of the free-run fit, and how often
//! the 95 % intervals hold the truth.

use super::super::{Failure, faults};
use super::Row;
use indexmap::IndexMap;
use lampyris::data::{Bindings, Window};
use lampyris::estimate::fit::Stop;
use lampyris::estimate::{Control, EstimateRequest, Fit, Problem, Site, estimate, prepare};
use lampyris::model::Catalogue;
use lampyris::twin;
use std::time::Instant;

/// Days of a noisy twin.
const DAYS: usize = 7;

fn problem(
    csv: &str,
    model: &str,
    method: &serde_json::Value,
    split: &serde_json::Value,
    site: &Site,
) -> Result<(Problem, EstimateRequest), Failure> {
    let error = |error: &dyn std::fmt::Display| Failure::Error(error.to_string());
    let (window, _) = Window::parse_csv(csv, &Bindings::none()).map_err(|found| faults(&found))?;
    let request: EstimateRequest =
        serde_json::from_value(serde_json::json!({ "method": method, "split": split })).map_err(|found| error(&found))?;
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let id = model.parse().map_err(|found| error(&found))?;
    let problem = prepare(&catalogue, &id, &request, &window, site).map_err(|found| faults(&found))?;
    Ok((problem, request))
}

/// A fit and its seconds.
fn fitted(problem: &Problem, request: &EstimateRequest) -> Result<(Fit, f64), Failure> {
    let start = Instant::now();
    let fit = estimate(problem, request, None, &Control::NONE).map_err(|error| Failure::Error(error.to_string()))?;
    Ok((fit, start.elapsed().as_secs_f64()))
}

pub fn run(first: u64, rooms: u64, worlds: u64, each: bool) -> Result<Vec<Row>, Failure> {
    let mut rows = if rooms > 0 { convergence(first, rooms, each)? } else { Vec::new() };
    if worlds > 0 {
        rows.extend(coverage(first, worlds, each)?);
    }
    Ok(rows)
}

/// Rooms of the thesis's kind with four neighbours: a week of half hours to fit, two days to forecast.
fn convergence(first: u64, rooms: u64, each: bool) -> Result<Vec<Row>, Failure> {
    let split = serde_json::json!({"train": "P7D", "validation": "P2D", "test": "P0D"});
    let (mut converged, mut longest, mut plain_longest) = (0, 0.0f64, 0.0f64);
    let (mut one_step, mut day_ahead) = (Vec::new(), Vec::new());
    for room in first..first + rooms {
        let twin = twin::room(room, 4, 9, 30).map_err(|found| faults(&found))?;
        let site = Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
        let (task, request) = problem(&twin.csv, "room3", &serde_json::json!({"name": "ctsm", "seed": room}), &split, &site)?;
        let (fit, seconds) = fitted(&task, &request)?;
        let (task, request) = problem(&twin.csv, "room3", &serde_json::json!({"name": "cfa", "seed": room}), &split, &site)?;
        let (plain, plain_seconds) = fitted(&task, &request)?;
        converged += u64::from(fit.stopped_by == Stop::Converged);
        longest = longest.max(seconds);
        plain_longest = plain_longest.max(plain_seconds);
        let error = |fit: &Fit, horizon: &str| {
            fit.first_metrics().and_then(|metrics| metrics.ahead.get(horizon)).map_or(f64::NAN, |ahead| ahead.rmse)
        };
        one_step.push(error(&fit, "PT1H") / error(&plain, "PT1H"));
        day_ahead.push(error(&fit, "PT24H") / error(&plain, "PT24H"));
        if each {
            eprintln!(
                "room {room}: {:?}, {} evaluations, {seconds:.1} s; ahead {:.3} and {:.3} of the free-run fit's",
                fit.stopped_by,
                fit.evaluations,
                one_step[one_step.len() - 1],
                day_ahead[day_ahead.len() - 1]
            );
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    Ok(vec![
        Row::new(format!("ctsm on {rooms} synthetic rooms of 15 parameters: share converged"), converged as f64 / rooms.max(1) as f64, "-")
            .at_least(1.0),
        Row::new("  longest wall time of a room", longest, "s").at_most(5.0),
        Row::new("  the same of the free-run fit", plain_longest, "s"),
        Row::new("  hold-out error an hour ahead over that of the free-run fit, mean", mean(&one_step), "x").at_most(1.0),
        Row::new("  hold-out error a day ahead over that of the free-run fit, mean", mean(&day_ahead), "x").at_most(1.0),
    ])
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
            let noise = |prefix: &str, of: &IndexMap<String, lampyris::estimate::likelihood::NoiseEstimate>| {
                let key = name.strip_prefix(prefix)?.strip_suffix(')')?;
                of.get(key).filter(|noise| !noise.at_bound).and_then(|noise| noise.ci95)
            };
            let own = || fit.parameters.get(name).filter(|estimate| !estimate.at_bound).and_then(|estimate| estimate.ci95);
            let interval = own().or_else(|| noise("sigma(", &found.diffusion)).or_else(|| noise("sd(", &found.measurement));
            let count = held.entry(name.clone()).or_default();
            if let Some([low, high]) = interval {
                count.0 += u64::from((low..=high).contains(truth));
                count.1 += 1;
            }
        }
        if each {
            eprintln!("twin {world}: {:?}, log-likelihood {:.2}, {seconds:.2} s", fit.stopped_by, found.log_likelihood);
        }
    }
    let share = |(held, all): (u64, u64)| held as f64 / all.max(1) as f64;
    let one = |(name, count): (&String, &(u64, u64))| {
        Row::new(format!("  {name}: share of {} intervals that hold the truth", count.1), share(*count), "-").at_least(0.9)
    };
    let title = Row::new(format!("95 % intervals over {worlds} twins with process noise"), worlds as f64, "");
    Ok([title].into_iter().chain(held.iter().map(one)).collect())
}
