//! Tuning: settings of the default search that suit a system, chosen on its own past (thesis chapter 8).
//!
//! The record is cut into windows. On the older ones, candidates are compared by successive halving; the
//! newer ones, which the choice never saw, say whether the winner is better than what the system has. Every
//! search starts from nothing: where the parameters in use still hold, any settings do.

mod arena;
mod performance;

use super::fit::Span;
use super::problem::Problem;
use crate::data::{Duration, SplitRequest, Window, rfc3339};
use crate::estimate::problem::method::SeededMethod;
use crate::estimate::problem::objective::Objective;
use crate::estimate::problem::request::{EstimateRequest, Site, WindowRange, prepare, range};
use crate::estimate::search::control::{Control, EstimateError};
use crate::fault::Fault;
use crate::model::{Catalogue, ModelId};
use crate::optimise::Method;
use crate::optimise::cfa_options::{CfaOptions, LocalFrom};
use arena::{Arena, Run, mean};
pub use performance::{Performance, TuningJudgement};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::ops::Range;
use utoipa::ToSchema;

/// The parts of a record that a tuning asks for by default: windows of a week, all of it training.
pub const SPLIT: SplitRequest =
    SplitRequest { train: Duration::from_days(7), validation: Duration::from_days(0), test: None };
/// Fewest windows; a shorter record has shorter ones.
const LEAST_WINDOWS: usize = 4;
/// Most windows, the newest.
const MOST_WINDOWS: usize = 12;
/// Settings that are compared, those in use among them.
const CANDIDATES: usize = 16;
/// Searches of each candidate in the first round.
const FIRST: usize = 2;

/// What a tuning found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Tuning {
    /// The model.
    pub model: String,
    /// In a sentence.
    pub summary: String,
    /// Whether the tuned settings are better on the unseen windows and succeed as often.
    pub better: bool,
    /// What is different, by hyperparameter: before and tuned.
    #[schema(value_type = std::collections::HashMap<String, Vec<Value>>)]
    pub changes: Map<String, Value>,
    /// What the system had.
    pub before: SeededMethod,
    /// What came out.
    pub tuned: SeededMethod,
    /// Both on the unseen windows; `null` where no candidate was better than what the system had.
    pub judged: Option<TuningJudgement>,
    /// The windows on which the settings were chosen.
    pub windows: Vec<Span>,
    /// The newer windows, which only judge.
    pub unseen: Vec<Span>,
    /// The rounds of the comparison: each keeps the better half.
    pub rounds: Vec<TuningRound>,
    /// Simulations of the whole tuning.
    pub evaluations: usize,
}

/// A round of the comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TuningRound {
    /// Settings that were left.
    pub candidates: usize,
    /// Searches of each so far.
    pub searches: usize,
    /// Evaluations to come within 1 % of the best known cost, as a geometric mean in which a search that does
    /// not come there counts as three budgets: of the best candidate.
    pub best: f64,
    /// The same of the settings in use, while they were left.
    pub before: Option<f64>,
}

/// Why there is no tuning.
#[derive(Debug)]
pub enum TuneError {
    /// What is asked, or the record, does not serve.
    Faults(Vec<Fault>),
    /// Nothing finite was found, or somebody stopped it.
    Estimate(EstimateError),
}

/// What cannot be tuned: the default method alone has settings to choose.
pub fn faults(request: &EstimateRequest) -> Vec<Fault> {
    let method = &request.method.method;
    if matches!(method, Method::Cfa(_)) && request.objective != Objective::Likelihood {
        return Vec::new();
    }
    let detail = format!("only `cfa` is tuned, not `{}`", method.name());
    vec![Fault::new("/method/name", "contradiction", detail).suggest("leave the method out")]
}

/// Chooses settings on the older windows of a record and judges them on the newer ones. `split.train` is the
/// length of a window, `budget.evaluations` what one search may spend.
///
/// # Errors
/// Faults of the request and the record, nothing finite, or somebody stopped it.
pub fn tune(
    catalogue: &Catalogue,
    model: &ModelId,
    request: &EstimateRequest,
    window: &Window,
    site: &Site,
    control: &Control,
) -> Result<Tuning, TuneError> {
    let Method::Cfa(before) = &request.method.method else { return Err(TuneError::Faults(faults(request))) };
    let mut problems = Vec::new();
    let mut found = Vec::new();
    for (from, to) in windows(request, window).map_err(TuneError::Faults)? {
        let (span, split) = (
            Span { from: rfc3339(from), to: rfc3339(to) },
            SplitRequest { train: Duration::from_millis(to - from), ..SPLIT },
        );
        let range =
            Some(WindowRange { last: None, from: Some(span.from.clone()), to: Some(span.to.clone()) });
        let request = EstimateRequest { window: range, split, early_stopping: None, ..request.clone() };
        match prepare(catalogue, model, &request, window, site) {
            Ok(problem) => problems.push((span, problem.without_prior())),
            Err(faults) => {
                for fault in faults {
                    if !found.contains(&fault) {
                        found.push(fault);
                    }
                }
            }
        }
    }
    // A stretch without measurements is left out, as long as enough others are there.
    if problems.len() < LEAST_WINDOWS {
        return Err(TuneError::Faults(found));
    }
    let (seen, unseen) = problems.split_at(problems.len() / 2);
    choose(before, request, seen, unseen, control)
        .map(|(tuned, rounds, judged, evaluations)| {
            let method =
                |options: &CfaOptions| SeededMethod { seed: 0, method: Method::Cfa(options.clone()) };
            let (before, tuned) = (method(before), method(&tuned));
            let spans =
                |problems: &[(Span, Problem)]| problems.iter().map(|(span, _)| span.clone()).collect();
            let better = judged.as_ref().is_some_and(TuningJudgement::is_better);
            Tuning {
                model: model.to_string(),
                summary: summary(judged.as_ref(), unseen.len()),
                changes: changes(&before, &tuned),
                windows: spans(seen),
                unseen: spans(unseen),
                better,
                before,
                tuned,
                judged,
                rounds,
                evaluations,
            }
        })
        .map_err(TuneError::Estimate)
}

/// The first and last instants of the windows, the oldest first.
fn windows(request: &EstimateRequest, window: &Window) -> Result<Vec<(i64, i64)>, Vec<Fault>> {
    let (from, to) = range(request.window.as_ref(), window)?;
    let (from, to) =
        (from.unwrap_or(window.from()).max(window.from()), to.unwrap_or(window.to()).min(window.to()));
    let (record, least) = (to - from, LEAST_WINDOWS as i64);
    let asked = request.split.train.millis();
    let length = if asked <= 0 || record / asked < least { record / least } else { asked };
    if length <= 0 {
        return Err(vec![Fault::new(
            "/window",
            "no-data-in-range",
            "the record has too few measurements in that range",
        )]);
    }
    let count = (record / length).min(MOST_WINDOWS as i64);
    // Neighbours share no sample.
    Ok((1..=count).rev().map(|back| (to - back * length + 1, to - (back - 1) * length)).collect())
}

/// Settings to compare: those in use first, then others that differ from them in about half of what matters.
fn candidates(before: &CfaOptions, seed: u64) -> Vec<CfaOptions> {
    let mut stream = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut candidates = vec![before.clone()];
    while candidates.len() < CANDIDATES {
        let mut other = before.clone();
        fn draw<T: Copy>(stream: &mut Xoshiro256PlusPlus, value: &mut T, from: &[T]) {
            if stream.random_bool(0.5) {
                *value = from[stream.random_range(0..from.len())];
            }
        }
        draw(&mut stream, &mut other.n, &[12, 20, 30, 40, 60]);
        draw(&mut stream, &mut other.target, &[3.0, 5.0, 7.0, 10.0]);
        draw(&mut stream, &mut other.swarm, &[50, 100, 200, 400, 800]);
        draw(&mut stream, &mut other.stall, &[5, 10, 20]);
        draw(&mut stream, &mut other.starts, &[1, 2, 3, 4]);
        draw(&mut stream, &mut other.scouts, &[0, 1, 2]);
        draw(
            &mut stream,
            &mut other.local_from,
            &[LocalFrom::ClusterBests, LocalFrom::Centroids, LocalFrom::Fireflies],
        );
        draw(&mut stream, &mut other.local.trials, &[2, 4, 8]);
        other.n_min = other.n_min.min(other.n);
        // A system may start from scouts alone.
        if Method::Cfa(other.clone()).faults().is_empty() {
            candidates.push(other);
        }
    }
    candidates
}

/// Successive halving: all are scored by a few searches, the better half by twice as many in all, until one
/// is left. `score` takes who is left and the searches to add, and gives a score to each, the lower the
/// better; of equals the first stays.
fn halve<E>(
    count: usize,
    first: usize,
    mut score: impl FnMut(&[usize], Range<usize>) -> Result<Vec<f64>, E>,
) -> Result<usize, E> {
    let mut left: Vec<usize> = (0..count).collect();
    let mut searches = 0..first;
    while left.len() > 1 {
        let scores = score(&left, searches.clone())?;
        let mut ranked: Vec<(f64, usize)> = scores.into_iter().zip(left).collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        ranked.truncate(ranked.len().div_ceil(2));
        left = ranked.into_iter().map(|(_, candidate)| candidate).collect();
        left.sort_unstable();
        searches = searches.end..2 * searches.end;
    }
    Ok(left.first().copied().unwrap_or(0))
}

type Chosen = (CfaOptions, Vec<TuningRound>, Option<TuningJudgement>, usize);

/// The settings that are left, the rounds, both on the unseen windows, and what all of it cost.
fn choose(
    before: &CfaOptions,
    request: &EstimateRequest,
    seen: &[(Span, Problem)],
    unseen: &[(Span, Problem)],
    control: &Control,
) -> Result<Chosen, EstimateError> {
    let candidates = candidates(before, request.method.seed);
    let mut arena = Arena::new(seen, request, control, 0)?;
    let mut runs: Vec<Vec<Run>> = vec![Vec::new(); candidates.len()];
    let mut rounds = Vec::new();
    let best = halve(candidates.len(), FIRST, |left: &[usize], searches: Range<usize>| {
        for candidate in left {
            for number in searches.clone() {
                runs[*candidate].push(arena.run(&candidates[*candidate], number)?);
            }
        }
        let score = |candidate: &usize| {
            mean(&runs[*candidate].iter().map(|run| arena.score(run)).collect::<Vec<_>>())
        };
        let scores: Vec<f64> = left.iter().map(score).collect();
        rounds.push(TuningRound {
            candidates: left.len(),
            searches: searches.end,
            best: scores.iter().copied().fold(f64::INFINITY, f64::min).exp(),
            before: left.iter().position(|candidate| *candidate == 0).map(|place| scores[place].exp()),
        });
        Ok(scores)
    })?;
    let tuned = candidates[best].clone();
    // Nothing is judged where nothing changes, and the unseen windows stay unseen.
    if tuned == *before {
        return Ok((tuned, rounds, None, arena.spent));
    }
    let mut arena = Arena::new(unseen, request, control, arena.spent)?;
    let judged = arena.judge(before, &tuned)?;
    Ok((tuned, rounds, Some(judged), arena.spent))
}

fn summary(judged: Option<&TuningJudgement>, unseen: usize) -> String {
    let Some(judged) = judged else {
        return "No other settings were better than those in use, which stay.".to_owned();
    };
    let TuningJudgement { searches, before, tuned, ratio, fewer, .. } = judged;
    let percent = |share: f64| 100.0 * share;
    let word = if *ratio <= 1.0 { "fewer" } else { "more" };
    let figures = format!(
        "On {unseen} windows that the choice did not see, the tuned settings need {:.0} % {word} evaluations \
        to come within 1 % of the best known fit (fewer in {fewer} of {searches} searches). They come there \
        in {:.0} % of the searches, those in use in {:.0} %; a search takes {:.0} evaluations instead of \
        {:.0}.",
        percent((ratio - 1.0).abs()),
        percent(tuned.within),
        percent(before.within),
        tuned.evaluations,
        before.evaluations,
    );
    let end = if judged.is_better() {
        "They are better."
    } else {
        "That is not better, and the settings in use stay."
    };
    format!("{figures} {end}")
}

/// What is different between two methods, by name.
fn changes(before: &SeededMethod, tuned: &SeededMethod) -> Map<String, Value> {
    let flat = |method: &SeededMethod| {
        let mut flat = Map::new();
        for (name, value) in Map::from(method.clone()) {
            match value {
                Value::Object(part) => {
                    flat.extend(part.into_iter().map(|(field, value)| (format!("{name}.{field}"), value)))
                }
                value => drop(flat.insert(name, value)),
            }
        }
        flat
    };
    let old = flat(before);
    let differs = |(name, new): (String, Value)| {
        old.get(&name).filter(|old| **old != new).map(|old| (name, json!([old, new])))
    };
    flat(tuned).into_iter().filter_map(differs).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::ColumnBindings;
    use crate::twin;

    #[test]
    fn halving_spends_little_on_the_bad_and_keeps_the_best() {
        // The score of a candidate is its distance from 11, told in ever finer steps the more searches there
        // are.
        let mut asked = Vec::new();
        let best = halve(16, 2, |left: &[usize], searches: Range<usize>| {
            asked.push((left.len(), searches.clone()));
            let blur = 16.0 / searches.end as f64;
            Ok::<_, ()>(
                left.iter().map(|candidate| ((*candidate as f64 - 11.0).abs() / blur).floor()).collect(),
            )
        });
        assert_eq!(asked, [(16, 0..2), (8, 2..4), (4, 4..8), (2, 8..16)]);
        assert_eq!(best, Ok(11));
        // Of equals the first stays, which is what the system has.
        assert_eq!(halve(5, 1, |left, _| Ok::<_, ()>(vec![0.0; left.len()])), Ok(0));
        assert_eq!(halve(3, 1, |_, _| Err::<Vec<f64>, _>("stopped")), Err("stopped"));
    }

    #[test]
    fn candidates_begin_with_the_settings_in_use_and_are_all_in_range() {
        let before = CfaOptions { n: 33, ..CfaOptions::default() };
        let drawn = candidates(&before, 7);
        assert_eq!((drawn.len(), &drawn[0]), (CANDIDATES, &before));
        assert_eq!(drawn, candidates(&before, 7));
        assert_ne!(drawn, candidates(&before, 8));
        assert!(drawn.into_iter().all(|options| Method::Cfa(options).faults().is_empty()));
    }

    #[test]
    fn success_and_the_end_of_a_search_count_beside_the_evaluations() {
        let side = |within, evaluations| Performance { within, to_reach: Some(1000.0), evaluations };
        let judged = |ratio, tuned| TuningJudgement {
            searches: 20,
            before: side(0.95, 5000.0),
            tuned,
            ratio,
            fewer: 15,
            more: 5,
        };
        assert!(judged(0.8, side(0.95, 5200.0)).is_better());
        assert!(!TuningJudgement { fewer: 1, more: 0, ..judged(0.8, side(0.95, 5000.0)) }.is_better());
        assert!(!judged(0.97, side(0.95, 4000.0)).is_better());
        assert!(!judged(0.8, side(0.9, 4000.0)).is_better());
        assert!(!judged(0.8, side(1.0, 6000.0)).is_better());
        assert!(summary(Some(&judged(0.97, side(0.95, 4000.0))), 2).contains("3 % fewer"));
    }

    #[test]
    fn a_seed_fixes_a_tuning_on_any_number_of_threads() {
        let twin = twin::room(5, 2, 4, 60).unwrap();
        let (window, _) = Window::parse_csv(&twin.csv, &ColumnBindings::none()).unwrap();
        let site = Site { sets: [("neighbours".to_owned(), twin.neighbours)].into(), ..Site::default() };
        let request: EstimateRequest = serde_json::from_value(
            json!({"method": {"seed": 3}, "budget": {"evaluations": 400}, "split": {"train": "P1D"}}),
        )
        .unwrap();
        let (catalogue, model) = (Catalogue::builtin().unwrap(), "room3".parse().unwrap());
        let tuned = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| tune(&catalogue, &model, &request, &window, &site, &Control::NONE).unwrap())
        };
        let tuning = tuned(1);
        assert_eq!(tuning, tuned(2));
        assert_eq!((tuning.windows.len(), tuning.unseen.len(), tuning.rounds.len()), (2, 2, 4));
        let at = |text: &str| crate::data::read_time("", text).unwrap();
        assert!(at(&tuning.windows[1].to) < at(&tuning.unseen[0].from), "{tuning:?}");
        assert_eq!(tuning.judged.is_none(), tuning.changes.is_empty());
        // Only the default method has settings to choose.
        let other = EstimateRequest {
            method: serde_json::from_value(json!({"name": "pso"})).unwrap(),
            ..request.clone()
        };
        assert_eq!(faults(&other).len(), 1);
        assert!(matches!(
            tune(&catalogue, &model, &other, &window, &site, &Control::NONE),
            Err(TuneError::Faults(_))
        ));
    }
}
