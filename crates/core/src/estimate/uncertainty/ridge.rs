//! What lies along a ridge: one parameter of a pair that the data can hardly tell apart is held at values
//! about its estimate and all others are estimated again (a profile; Raue et al. 2009, Bioinformatics 25,
//! 1923-1929).

use crate::estimate::assess::summary::digits;
use crate::estimate::fit::{CorrelatedPair, RidgePoint};
use crate::estimate::problem::Problem;
use crate::estimate::search::control::{Control, EstimateError};
use crate::estimate::uncertainty::Uncertainty;
use crate::interrupt::Interrupt;
use crate::model::Model;
use crate::optimise::local::{LocalStage, LocalWay};
use crate::optimise::local_options::LocalOptions;
use crate::optimise::{Ask, Candidate, Cost};

/// So many pairs are followed, the closest ones.
const PAIRS: usize = 2;
/// Values on either side of an estimate.
const POINTS: usize = 2;
/// They go as far as the 95 % interval is wide, and at most so far, as a share of the box.
const FARTHEST: f64 = 0.25;
/// Iterations for each value: it begins where the ridge leads, and an error is wanted to a per cent.
const ITERATIONS: usize = 3;
/// By how much the error may rise where a ridge is as good as its middle.
const AS_GOOD: f64 = 1.01;

/// One side of a ridge, from the estimate outwards, in coordinates of the search.
struct Side {
    /// The pair, by its number and by the places of its parameters, of which the first is held.
    pair: usize,
    places: [usize; 2],
    /// How far all coordinates go from one value to the next.
    steps: Vec<f64>,
    here: Vec<f64>,
    points: Vec<RidgePoint>,
    ended: bool,
}

impl Side {
    /// Goes on to the next value, all parameters to where the ridge leads; says whether there is one.
    fn go_on(&mut self) -> bool {
        let [held, _] = self.places;
        let before = self.here[held];
        self.here.iter_mut().zip(&self.steps).for_each(|(here, step)| *here = (*here + step).clamp(0.0, 1.0));
        self.ended |= self.here[held] == before;
        !self.ended
    }

    /// The coordinates beside the one that is held.
    fn others(&self) -> Candidate {
        let mut others = self.here.clone();
        others.remove(self.places[0]);
        Candidate(others)
    }

    /// The candidate that has these coordinates beside the one that is held.
    fn with(&self, others: &[f64]) -> Candidate {
        let mut all = others.to_vec();
        all.insert(self.places[0], self.here[self.places[0]]);
        Candidate(all)
    }
}

/// Follows the ridges of the closest pairs, all sides next to each other, and tells how many simulations that
/// has taken.
///
/// # Errors
/// [`EstimateError::Interrupted`] where the estimation was cancelled. A deadline leaves out what it left no
/// time for.
pub(in crate::estimate) fn follow(
    problem: &Problem,
    theta: &[f64],
    cost: f64,
    known: &mut Uncertainty,
    control: &Control,
) -> Result<usize, EstimateError> {
    // An error to a per cent needs no exact steps, and what they change is the same along a ridge.
    let problem = &problem.with_loose_steps(true);
    let middle = problem.evaluate(&[problem.candidate(theta)], false);
    let Some(Cost::Finite(loose)) = middle.first().map(|middle| middle.cost) else { return Ok(1) };
    let mut sides = sides(problem, theta, known);
    let mut evaluations = 1;
    for _ in 0..POINTS {
        let (spent, in_time) = go_on(problem, &mut sides, cost - loose, control)?;
        evaluations += spent;
        if !in_time {
            break;
        }
    }
    for (number, pair) in known.correlated.iter_mut().enumerate() {
        let mut both = sides.iter().filter(|side| side.pair == number);
        if let (Some(below), Some(above)) = (both.next(), both.next()) {
            let middle = RidgePoint { values: values(problem, theta, below.places), cost };
            let points = below.points.iter().rev().cloned().chain([middle]);
            pair.ridge = points.chain(above.points.iter().cloned()).collect();
        }
    }
    Ok(evaluations)
}

/// Takes all sides to their next values, next to each other; says how many simulations that has taken, and
/// whether there was time for it. Costs are corrected by what exact steps change.
fn go_on(
    problem: &Problem,
    sides: &mut [Side],
    correction: f64,
    control: &Control,
) -> Result<(usize, bool), EstimateError> {
    let options = LocalOptions { iterations: ITERATIONS, ..LocalOptions::default() };
    let way = LocalWay::Residuals(options.with_least_step(problem.least_step()));
    let mut runs: Vec<(&mut Side, LocalStage)> = Vec::new();
    for side in sides {
        if side.go_on() {
            let run = LocalStage::new(&way, &[side.others()]);
            runs.push((side, run));
        }
    }
    let mut evaluations = 0;
    let mut asked = ask(&runs);
    while asked.iter().any(|batch| !batch.is_empty()) {
        let batch: Vec<Candidate> = asked.iter().flatten().cloned().collect();
        let answers = problem.evaluate_unless(&batch, true, &|| control.halts());
        // Answers that were cut short are none.
        match (control.interrupt)() {
            Some(Interrupt::Deadline) => return Ok((evaluations, false)),
            Some(cancelled) => return Err(EstimateError::Interrupted(cancelled)),
            None => evaluations += answers.len(),
        }
        let mut answers = answers.as_slice();
        for ((_, run), batch) in runs.iter_mut().zip(&asked) {
            run.digest(answers.split_off(..batch.len()).unwrap_or_default());
        }
        asked = ask(&runs);
    }
    for (side, run) in runs {
        let Some((place, Cost::Finite(cost))) = run.optimum() else {
            side.ended = true;
            continue;
        };
        let here = side.with(&place.0);
        let values = values(problem, &problem.theta(&here), side.places);
        side.points.push(RidgePoint { values, cost: cost + correction });
        side.here = here.0;
    }
    Ok((evaluations, true))
}

/// The sides of the closest pairs, before their first values: of each the lower one and the upper one.
fn sides(problem: &Problem, theta: &[f64], known: &Uncertainty) -> Vec<Side> {
    let dimensions = problem.space().dimensions();
    let mut closest: Vec<(usize, (&CorrelatedPair, &Vec<f64>))> =
        known.correlated.iter().zip(&known.leads).enumerate().collect();
    closest.sort_by(|(_, (a, _)), (_, (b, _))| b.correlation.abs().total_cmp(&a.correlation.abs()));
    let mut sides = Vec::new();
    for (number, (pair, leads)) in closest.into_iter().take(PAIRS) {
        let place = |name: &String| dimensions.iter().position(|dimension| dimension.name == *name);
        let [Some(held), Some(other)] = pair.parameters.each_ref().map(place) else { continue };
        // How well it is determined, as a share of its box.
        let width = known.ci95[held]
            .map_or(FARTHEST, |[low, high]| dimensions[held].unit(high) - dimensions[held].unit(low));
        let step = width.min(FARTHEST) / POINTS as f64;
        for step in [-step, step] {
            let steps = leads.iter().map(|lead| lead * step).collect();
            let here = problem.candidate(theta).0;
            let places = [held, other];
            sides.push(Side { pair: number, places, steps, here, points: Vec::new(), ended: false });
        }
    }
    sides
}

/// What every run asks for, as candidates of the problem.
fn ask(runs: &[(&mut Side, LocalStage)]) -> Vec<Vec<Candidate>> {
    let of = |(side, run): &(&mut Side, LocalStage)| match run.propose() {
        Some(Ask::Residuals(batch)) => batch.iter().map(|others| side.with(&others.0)).collect(),
        _ => Vec::new(),
    };
    runs.iter().map(of).collect()
}

/// The values of a pair.
fn values(problem: &Problem, theta: &[f64], places: [usize; 2]) -> [f64; 2] {
    places.map(|place| theta[problem.free()[place]])
}

/// What a pair means for an operator: how far its ridge goes, and what would tell the two apart where their
/// documents say it.
pub fn sentence(pair: &CorrelatedPair, model: &Model) -> String {
    let [a, b] = &pair.parameters;
    let correlation = pair.correlation;
    let excite = |name: &String| {
        model.parameters().iter().find(|parameter| parameter.name == *name)?.excite.as_deref()
    };
    let mut ways: Vec<&str> = pair.parameters.iter().filter_map(excite).collect();
    ways.dedup();
    let along = along(pair);
    if ways.is_empty() {
        return format!(
            "{a} and {b} move together (correlation {correlation:.2}){along}: trust their effect, not their \
            separate values"
        );
    }
    let ways = ways.join(" or ");
    format!(
        "{a} and {b} can hardly be told apart with these data (correlation {correlation:.3}){along}: {ways} \
        would separate them"
    )
}

/// How far the error hardly changes along a ridge; nothing where it was not followed, or has sides that are
/// steep.
fn along(pair: &CorrelatedPair) -> String {
    let least = pair.ridge.iter().map(|point| point.cost).fold(f64::INFINITY, f64::min);
    let flat: Vec<&RidgePoint> =
        pair.ridge.iter().filter(|point| point.cost <= AS_GOOD * AS_GOOD * least).collect();
    let (Some(first), Some(last)) = (flat.first(), flat.last()) else { return String::new() };
    if flat.len() < 2 {
        return String::new();
    }
    let ([a, b], percent) = (&pair.parameters, 100.0 * (AS_GOOD - 1.0));
    let [from, to] = [first, last].map(|point| point.values.map(|value| digits(value, 3.0)));
    format!(
        "; with {a} from {} to {} and {b} from {} to {} the error rises by less than {percent:.0} %",
        from[0], to[0], from[1], to[1]
    )
}
