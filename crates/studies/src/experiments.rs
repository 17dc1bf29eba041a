//! Whether planned experiments teach what they promise, on synthetic rooms whose truth is known: a plan is
//! made from four weeks, the room itself is driven by it for two days, and the same knowledge is taken again.

use super::options::Worlds;
use super::row::Row;
use super::twin_room::{measured, twin_room, whole};
use super::verdicts::{judge_all, share};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::DAY;
use lampyris_core::diagnose::experiment::information::Knowledge;
use lampyris_core::diagnose::experiment::{
    ComfortBounds, DrivenInput, Experiment, ExperimentAsked, ExperimentPlan, ExperimentPurpose, experiment,
};
use lampyris_core::estimate::assess::metrics::{ProcessNoise, filter, measurement_variance};
use lampyris_core::estimate::forecast::InputsToCome;
use lampyris_core::estimate::{Control, EstimateRequest, Problem, estimate};
use lampyris_core::simulate::kalman::Noise;
use lampyris_core::twin::{DrivenForward, Level, World, WorldRequest, world};

/// Days of the record, and of the experiment.
const DAYS: usize = 28;
const DRIVEN: usize = 2;
/// Samples of a day and of an hour.
const PER_DAY: usize = 96;
const PER_HOUR: usize = 4;
/// What may be driven, in degC.
const FORWARD: [f64; 2] = [28.0, 45.0];
/// Comfort is so many kelvins around the middle of the last week.
const COMFORT: f64 = 2.0;
/// What is called told apart: a t of three, or a correlation below this with the right one preferred.
const TOLD: f64 = 3.0;
const APART: f64 = 0.9;
/// Widths that differ by no more than this share are as promised.
const AS_PROMISED: f64 = 0.25;

/// A kind of world, and what is asked of it.
struct Case {
    name: &'static str,
    hidden: &'static [&'static str],
    model: &'static str,
    purpose: ExperimentPurpose,
    about: &'static [&'static str],
    /// The place of the one that is there, where one of two is.
    right: usize,
}

const SUN: &str = "room3+envelope_solar_gain";
const SUNS: &[&str] = &["alpha_s", "c_wall"];
const LOSS: &str = "room3+direct_outdoor_loss+emitter_exponent";
const LOSSES: &[&str] = &["c_outdoor", "n_emitter"];
const CASES: [Case; 5] = [
    Case {
        name: "one parameter",
        hidden: &[],
        model: "room3",
        purpose: ExperimentPurpose::Determine,
        about: &["alpha_a"],
        right: 0,
    },
    Case { name: "sun, not on the walls", right: 0, ..tie(SUN, SUNS, &[]) },
    Case { name: "sun on the walls", right: 1, ..tie(SUN, SUNS, &["envelope_solar_gain"]) },
    Case { name: "outdoor loss", right: 0, ..tie(LOSS, LOSSES, &["direct_outdoor_loss"]) },
    Case { name: "emitter exponent", right: 1, ..tie(LOSS, LOSSES, &["emitter_exponent"]) },
];

const fn tie(model: &'static str, about: &'static [&'static str], hidden: &'static [&'static str]) -> Case {
    Case { name: "", hidden, model, purpose: ExperimentPurpose::Separate, about, right: 0 }
}

/// What is known of a tie: the t of the one that is there and of the other, and their correlation.
#[derive(Clone, Copy)]
struct Tie {
    right: f64,
    other: f64,
    correlation: f64,
}

/// How the best plan of a world came out.
struct Executed {
    /// Of what was asked about and of the other parameters: the width that came over the promised one.
    asked: Vec<f64>,
    others: Vec<f64>,
    /// Whether the intervals hold the truth.
    holds: Vec<bool>,
    /// Before and behind it.
    ties: Option<[Tie; 2]>,
    /// Measured hours, and those outside the comfort bounds; the same where nobody drives anything.
    hours: [usize; 2],
    undriven: [usize; 2],
    expected_outside: f64,
}

/// A world with its plans.
struct Seen {
    case: &'static str,
    /// `None` where no plan keeps the comfort bounds.
    executed: Option<Executed>,
}

/// Rooms of every case in turns.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, only, each) = asked.parts();
    let worlds: Vec<(u64, &'static Case)> = (0..worlds)
        .map(|at| (first * 1_000_000 + at, &CASES[at as usize % CASES.len()]))
        .filter(|(_, case)| only.is_none_or(|only| case.name.contains(only)))
        .collect();
    let seen = judge_all(&worlds, |(seed, case)| judge(*seed, case), each.then_some(line))?;
    Ok(rows(&seen))
}

fn failed(fault: impl std::fmt::Display) -> Failure {
    Failure::Error(fault.to_string())
}

fn judge(seed: u64, case: &'static Case) -> Result<Seen, Failure> {
    let request =
        WorldRequest { days: DAYS + DRIVEN, ..WorldRequest::new(seed, case.hidden, Level::Matched) };
    let made = world(&request).map_err(failed)?;
    let now = problem(&made, case.model, DAYS)?;
    let fit = estimate(&now, &EstimateRequest::default(), None, &Control::NONE).map_err(failed)?;
    let now = now.with_substeps(fit.substeps);
    let states = now.model().states().len();
    let noise = Noise {
        process: vec![filter(&now, &fit.theta(), ProcessNoise::Likeliest).process_noise; states],
        measurement: measurement_variance(&now),
    };
    let comfort = comfort(&now);
    let asked = ExperimentAsked {
        days: DRIVEN,
        inputs: vec![DrivenInput {
            channel: "T_forward".to_owned(),
            range: FORWARD,
            slew: FORWARD[1] - FORWARD[0],
        }],
        comfort: vec![comfort.clone()],
        purpose: case.purpose,
        about: case.about.iter().map(|name| (*name).to_owned()).collect(),
        seed,
    };
    let found = experiment(&now, &fit.theta(), &noise, &asked, &InputsToCome::default())
        .map_err(|found| faults(&found))?;
    let Some(plan) = found.plans.first() else { return Ok(Seen { case: case.name, executed: None }) };
    let driven = DrivenForward { from: DAYS * PER_DAY, values: driven(&found, plan)? };
    let done = world(&WorldRequest { driven: Some(driven), ..request }).map_err(failed)?;
    let then = problem(&done, case.model, DAYS + DRIVEN)?.with_substeps(fit.substeps);
    let executed = executed(case, &made, plan, &fit.theta(), (&now, &then), &comfort)?;
    Ok(Seen { case: case.name, executed: Some(executed) })
}

fn driven(found: &Experiment, plan: &ExperimentPlan) -> Result<Vec<f64>, Failure> {
    let series = plan.inputs.get("T_forward").ok_or_else(|| failed("a plan without its input"))?;
    if series.values.len() == found.time.len() {
        Ok(series.values.clone())
    } else {
        Err(failed("a short plan"))
    }
}

/// The first days of a world under a model.
fn problem(made: &World, model: &str, days: usize) -> Result<Problem, Failure> {
    let window = measured(made)?;
    let window =
        window.slice(window.from(), window.from() + days as i64 * DAY).map_err(|found| faults(&found))?;
    Ok(twin_room(made, &window, model, whole(days))?.problem)
}

/// What whoever lives there would ask for: the middle of the last week, and some kelvins around it.
fn comfort(problem: &Problem) -> ComfortBounds {
    let mut week: Vec<f64> = Vec::new();
    if let Some((values, valid)) = problem.measured().first() {
        let last = values.iter().zip(*valid).rev().take(7 * PER_DAY);
        week.extend(last.filter(|(_, valid)| **valid).map(|(value, _)| *value));
    }
    week.sort_by(f64::total_cmp);
    let middle = week.get(week.len() / 2).copied().unwrap_or(f64::NAN);
    ComfortBounds { channel: "T_room".to_owned(), range: [middle - COMFORT, middle + COMFORT] }
}

/// What came of a plan.
fn executed(
    case: &Case,
    made: &World,
    plan: &ExperimentPlan,
    theta: &[f64],
    (now, then): (&Problem, &Problem),
    comfort: &ComfortBounds,
) -> Result<Executed, Failure> {
    let parameters = now.model().parameters();
    let place = |name: &&str| parameters.iter().position(|one| one.name == *name);
    let places: Vec<usize> = case.about.iter().filter_map(place).collect();
    let may_be_nothing: &[usize] = if case.purpose == ExperimentPurpose::Determine { &[] } else { &places };
    let before = Knowledge::of(now, theta, may_be_nothing).map_err(failed)?;
    let after = Knowledge::of(then, &before.theta, may_be_nothing).map_err(failed)?;
    let covariance = after.covariance().map_err(failed)?;
    let mut out = Executed {
        asked: Vec::new(),
        others: Vec::new(),
        holds: Vec::new(),
        ties: None,
        hours: [0; 2],
        undriven: [0; 2],
        expected_outside: plan.comfort.hours_outside,
    };
    for (at, index) in after.along.iter().enumerate() {
        let name = &parameters[*index].name;
        let deviation = covariance[(at, at)].max(0.0).sqrt();
        let Some(lesson) = plan.lessons.iter().find(|lesson| lesson.parameter == *name) else { continue };
        let (width, unit) = after.width(then, at, deviation);
        let ratio = width / lesson.width_after;
        if places.contains(index) { &mut out.asked } else { &mut out.others }.push(ratio);
        let (found, truth) = (after.theta[*index], truth(made, name));
        let error = if unit == "%" { 100.0 * (found / truth).ln() } else { found - truth };
        out.holds.push(error.abs() <= 0.5 * width);
    }
    if let [a, b] = places[..] {
        let right = [(a, b), (b, a)][case.right];
        out.ties = Some([tied(&before, right)?, tied(&after, right)?]);
    }
    out.hours = comfortable(then, comfort)?;
    out.undriven = comfortable(&problem(made, case.model, DAYS + DRIVEN)?, comfort)?;
    Ok(out)
}

/// Measured hours of the driven days, and those outside the comfort bounds.
fn comfortable(then: &Problem, comfort: &ComfortBounds) -> Result<[usize; 2], Failure> {
    let measured = then.measured();
    let (values, valid) = measured.first().ok_or_else(|| failed("a room without a temperature"))?;
    let mut hours = [0; 2];
    for hour in 0..DRIVEN * 24 {
        let from = DAYS * PER_DAY + hour * PER_HOUR;
        let seen: Vec<f64> =
            (from..(from + PER_HOUR).min(values.len())).filter(|k| valid[*k]).map(|k| values[k]).collect();
        if seen.is_empty() {
            continue;
        }
        let mean = seen.iter().sum::<f64>() / seen.len() as f64;
        hours[0] += 1;
        hours[1] += usize::from(mean < comfort.range[0] || mean > comfort.range[1]);
    }
    Ok(hours)
}

/// The value that a parameter has in the twin: nothing of effects that it does not hide.
fn truth(made: &World, name: &str) -> f64 {
    let own = made.parameters.iter().find(|(known, _)| known == name).map(|(_, value)| *value);
    let hidden = made.truth.effects.first().filter(|effect| {
        [
            ("c_wall", "envelope_solar_gain"),
            ("c_outdoor", "direct_outdoor_loss"),
            ("n_emitter", "emitter_exponent"),
        ]
        .contains(&(name, effect.effect.as_str()))
    });
    own.or_else(|| hidden.map(|effect| effect.strength)).unwrap_or(0.0)
}

fn tied(known: &Knowledge, (right, other): (usize, usize)) -> Result<Tie, Failure> {
    let covariance = known.covariance().map_err(failed)?;
    let place = |index: usize| known.along.iter().position(|along| *along == index).unwrap_or(0);
    let (i, j) = (place(right), place(other));
    let t = |at: usize, index: usize| {
        known.theta[index].abs() / (covariance[(at, at)].max(f64::MIN_POSITIVE).sqrt() * known.units[at])
    };
    let correlation = covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
    Ok(Tie { right: t(i, right), other: t(j, other), correlation })
}

impl Tie {
    fn is_told(&self) -> bool {
        self.right >= TOLD || (self.correlation.abs() < APART && self.right > self.other)
    }
}

fn line(seen: &Seen) -> String {
    let Some(executed) = &seen.executed else { return format!("{:<22} no plan keeps comfort", seen.case) };
    let tie = executed.ties.map_or(String::new(), |[before, after]| {
        format!(
            "; t {:.1} and {:.1} at {:.2} before, {:.1} and {:.1} at {:.2} behind",
            before.right, before.other, before.correlation, after.right, after.other, after.correlation
        )
    });
    format!(
        "{:<22} widths over promised {:.2?}, outside {:?} of {} h{tie}",
        seen.case, executed.asked, executed.hours[1], executed.hours[0]
    )
}

fn rows(seen: &[Seen]) -> Vec<Row> {
    let executed: Vec<(&str, &Executed)> =
        seen.iter().filter_map(|one| Some((one.case, one.executed.as_ref()?))).collect();
    let mut rows = Vec::new();
    rows.extend(share("rooms in which a plan keeps comfort", seen, |one| one.executed.is_some()));
    let kept = |ratio: &f64| (1.0 / (1.0 + AS_PROMISED)..=1.0 + AS_PROMISED).contains(ratio);
    let mut widths = |what: &str, mut ratios: Vec<f64>| {
        ratios.sort_by(f64::total_cmp);
        for (name, share) in [("10th percentile", 0.1), ("median", 0.5), ("90th percentile", 0.9)] {
            if let Some(value) = ratios.get((ratios.len() as f64 * share) as usize) {
                rows.push(Row::new(format!("{what}: width over promised, {name}"), *value, "-"));
            }
        }
        rows.extend(self::share(&format!("{what}: widths within 25 % of the promised"), &ratios, kept));
    };
    let all = |of: fn(&Executed) -> &Vec<f64>| executed.iter().flat_map(|(_, one)| of(one).clone()).collect();
    widths("asked about", all(|one| &one.asked));
    widths("others", all(|one| &one.others));
    let holds: Vec<bool> = executed.iter().flat_map(|(_, one)| one.holds.clone()).collect();
    rows.extend(share("intervals of 95 % behind it hold the truth", &holds, |holds| *holds));
    for case in CASES.iter().filter(|case| case.about.len() == 2) {
        let ties: Vec<[Tie; 2]> =
            executed.iter().filter(|(name, _)| *name == case.name).filter_map(|(_, one)| one.ties).collect();
        for (when, at) in [("before", 0), ("behind", 1)] {
            let what = |of: &str| format!("{}: {of} {when}", case.name);
            rows.extend(share(&what("a t of 3"), &ties, |tie| tie[at].right >= TOLD));
            let told = share(&what("told apart"), &ties, |tie| tie[at].is_told());
            rows.extend(told.map(|row| if at == 1 { row.at_least(0.8) } else { row }));
        }
        let tied: Vec<&[Tie; 2]> = ties.iter().filter(|tie| !tie[0].is_told()).collect();
        let what = format!("{}: told apart behind, of those that were not before", case.name);
        rows.extend(share(&what, &tied, |tie| tie[1].is_told()));
    }
    let sum = |of: fn(&Executed) -> f64| executed.iter().map(|(_, one)| of(one)).sum::<f64>();
    let hours = sum(|one| one.hours[0] as f64).max(1.0);
    let outside = sum(|one| one.hours[1] as f64);
    rows.push(Row::new("hours within the comfort bounds", 1.0 - outside / hours, "-").at_least(0.99));
    let undriven = sum(|one| one.undriven[1] as f64) / sum(|one| one.undriven[0] as f64).max(1.0);
    rows.push(Row::new("the same if nobody had driven anything", 1.0 - undriven, "-"));
    rows.push(Row::new("the same as expected", 1.0 - sum(|one| one.expected_outside) / hours, "-"));
    rows
}
