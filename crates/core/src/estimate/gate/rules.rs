//! The rules of the gate, as a table: what each looks at, and what it writes down.
//!
//! A rule knows nothing of the others, and none decides: `validate` reads what they wrote.

use super::change;
use super::check::Severity;
use super::context::ValidationContext;
use super::hearing;
use super::limits::{OutputScale, ticks};
use super::physics;
use super::table::{CheckTable, Rule};
use crate::data::{DAY, HOUR};
use crate::estimate::assess::metrics::horizon_name;
use crate::estimate::fit::Stop;
use crate::estimate::problem::predictor::Predictor;
use crate::estimate::problem::request::Budget;
use crate::estimate::problem::whiten::stride;
use crate::model::Output;

/// The check whose statistic is the ratio of the forecast errors of a fit and of what it would replace.
pub const NO_WORSE_THAN_INCUMBENT: &str = "G4 no worse than incumbent";

const INCUMBENT_RATIO: f64 = 1.10;
const BARELY: f64 = 0.9;
// Limits of temperatures, in K; `limits` says what they are for other outputs.
const LARGEST_ERROR: f64 = 10.0;
const LARGEST_EXCURSION: f64 = 5.0;
const LEAST_VALID: f64 = 0.9;
/// No room changes by this much from one sample to the next; a sensor that changes its unit does.
const LARGEST_CHANGE: f64 = 15.0;
const STUCK_HOURS: f64 = 24.0;
const STUCK_HOURS_MOVING: f64 = 12.0;
/// What a search may spend where nobody says anything else.
const USUAL_BUDGET: usize = Budget::USUAL.evaluations;
const FORTNIGHT: i64 = 14 * DAY;

/// Every rule, in the order in which an operator reads them.
pub const ALL: &[Rule] = &[
    Rule { name: "G1 finite", look: finite },
    Rule { name: "G2 bounds", look: bounds },
    Rule { name: "G3", look: physical },
    Rule { name: "G4 beats persistence", look: persistence },
    Rule { name: NO_WORSE_THAN_INCUMBENT, look: incumbent },
    Rule { name: "G5 largest error", look: largest_error },
    Rule { name: "G5 excursion", look: excursion },
    Rule { name: "G6 jump", look: change::look },
    Rule { name: "G7 repeat", look: repeat },
    Rule { name: "G8 unseen data", look: unseen },
    Rule { name: "G8 complete", look: complete },
    Rule { name: "G8 excited", look: excited },
    Rule { name: "G8 no unit jump", look: unit_jump },
    Rule { name: "G8 not stuck", look: stuck },
    Rule { name: "G9", look: hearing::inputs },
    Rule { name: "G10", look: hearing::opponents },
    Rule { name: "G11", look: hearing::channels },
    Rule { name: "G12 determined", look: hearing::determined },
];

fn finite(context: &ValidationContext, table: &mut CheckTable) {
    let of_output = |(index, output): (usize, &Output)| {
        let again = context
            .problem
            .mean_square_error(&context.trajectory, index, context.problem.split().train.clone())?
            .sqrt();
        let stored = context.fit.metrics.get(&output.channel)?.train_rmse;
        Some(((again - stored) / stored.max(f64::MIN_POSITIVE)).abs())
    };
    let differences: Option<Vec<f64>> =
        context.problem.model().outputs().iter().enumerate().map(of_output).collect();
    // A difference that is not a number is as large as can be.
    let largest = |worst: f64, d: f64| if d.is_nan() { f64::INFINITY } else { worst.max(d) };
    let difference = differences.map(|differences| differences.into_iter().fold(0.0, largest));
    let comment = "every number is finite, and the stored parameters reproduce the stored error".to_owned();
    table.at_most("G1 finite", difference, 1e-9, "-", Severity::Reject, comment);
}

fn bounds(context: &ValidationContext, table: &mut CheckTable) {
    let estimates = &context.fit.parameters;
    let outside = estimates.values().filter(|e| !(e.bounds[0]..=e.bounds[1]).contains(&e.value)).count();
    let comment = "every parameter, estimated or fixed, lies inside its bounds".to_owned();
    table.at_most("G2 bounds", Some(outside as f64), 0.0, "parameters", Severity::Reject, comment);
    for name in &context.fit.non_identifiable {
        table.flags.push(format!("non_identifiable:{name}"));
    }
    for (name, _) in estimates.iter().filter(|(_, estimate)| estimate.at_bound) {
        table.flags.push(format!("at_bound:{name}"));
        let comment = format!("{name} sits on a bound of the search: its value is a limit, not an estimate");
        table.plain("G2 at bound", false, Severity::Flag, comment);
    }
}

fn physical(context: &ValidationContext, table: &mut CheckTable) {
    table.checks.extend(physics::checks(&context.problem, &context.theta, &context.trajectory));
}

fn persistence(context: &ValidationContext, table: &mut CheckTable) {
    let name = horizon_name(context.policy.horizon);
    let ratio = context.forecast.as_ref().map(|error| error.rmse / error.persistence.max(f64::MIN_POSITIVE));
    let comment = beside_persistence(context, &name);
    table.at_most("G4 beats persistence", ratio, 1.0, "-", Severity::Reject, comment);
    if ratio.is_some_and(|ratio| ratio > BARELY && ratio <= 1.0) {
        table.flags.push("barely_better_than_persistence".to_owned());
        let are = context.problem.predictor().subject();
        let comment = format!("{are} hardly better than holding the last measurement");
        table.at_most("G4 clearly beats persistence", ratio, BARELY, "-", Severity::Flag, comment);
    }
}

/// What the fit and persistence err by at a horizon, in words.
fn beside_persistence(context: &ValidationContext, horizon: &str) -> String {
    match (context.problem.predictor(), &context.forecast) {
        (Predictor::Filtered, Some(error)) => format!(
            "forecasts {horizon} ahead err by {:.2}, holding the last measurement by {:.2}",
            error.rmse, error.persistence
        ),
        (Predictor::Filtered, None) => format!(
            "there are no unseen measurements to forecast {horizon} ahead, or a forecast of them leaves the \
            numbers"
        ),
        (Predictor::FreeRun, Some(error)) => format!(
            "the free run errs by {:.2} {unit} on unseen data, holding each output's last measurement for \
            {horizon} by {:.2}",
            error.rmse,
            error.persistence,
            unit = context.problem.scale_in_words()
        ),
        (Predictor::FreeRun, None) => format!(
            "there are no unseen measurements {horizon} behind others to compare the free run with, or it \
            leaves the numbers"
        ),
    }
}

fn incumbent(context: &ValidationContext, table: &mut CheckTable) {
    let Some(incumbent) = &context.incumbent else { return };
    let theirs = context.error_of(incumbent, context.problem.split().validation.clone());
    let ratio = context
        .forecast
        .as_ref()
        .zip(theirs)
        .map(|(ours, theirs)| ours.rmse / theirs.rmse.max(f64::MIN_POSITIVE));
    let name = horizon_name(context.policy.horizon);
    let what = context.problem.predictor().error_at(&name);
    let comment = format!("{what} beside that of the parameters served now, on the same unseen data");
    table.at_most(NO_WORSE_THAN_INCUMBENT, ratio, INCUMBENT_RATIO, "-", Severity::Reject, comment);
}

fn largest_error(context: &ValidationContext, table: &mut CheckTable) {
    let error = |scale: &OutputScale| {
        let (values, _) = context.problem.measured()[scale.output];
        let used = context.problem.usable(scale.output, context.since(FORTNIGHT)..values.len());
        let errors = used.iter().map(|k| (context.trajectory.outputs[scale.output][*k] - values[*k]).abs());
        // What is not a number errs by more than any.
        errors.fold(0.0, |worst, error| if error.is_nan() { f64::INFINITY } else { worst.max(error) })
    };
    let says =
        |limit: f64, unit: &str| format!("the free run never errs by more than {} {unit}", short(limit));
    table.worst(context, "G5 largest error", LARGEST_ERROR, error, says);
}

fn excursion(context: &ValidationContext, table: &mut CheckTable) {
    let excursion = |scale: &OutputScale| {
        let (values, valid) = context.problem.measured()[scale.output];
        let known = (0..values.len()).filter(|k| valid[*k]).map(|k| values[k]);
        let (low, high) = known
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        let run = &context.trajectory.outputs[scale.output][context.since(FORTNIGHT)..];
        run.iter().map(|y| (low - y).max(y - high)).fold(0.0, f64::max)
    };
    let says = |_: f64, _: &str| "how far the free run leaves the range that was ever measured".to_owned();
    table.worst(context, "G5 excursion", LARGEST_EXCURSION, excursion, says);
}

fn repeat(context: &ValidationContext, table: &mut CheckTable) {
    let pass = context.fit.stopped_by == Stop::Converged;
    if !pass {
        table.flags.push("low_confidence".to_owned());
    }
    // A search that has spent what is usual and finds no agreement has told all that it can; one that was cut
    // short has not.
    let evaluations = context.fit.evaluations;
    let (severity, comment) = match context.fit.stopped_by {
        Stop::Converged => (Severity::Flag, "restarts of the search agree".to_owned()),
        Stop::Deadline => (
            Severity::Hold,
            "the search was cut short by its deadline, before two restarts agreed".to_owned(),
        ),
        Stop::Budget if evaluations < USUAL_BUDGET => {
            let comment = format!(
                "the search was cut short by its budget, after {evaluations} simulations and before two \
                restarts agreed: {USUAL_BUDGET} are usual"
            );
            (Severity::Hold, comment)
        }
        _ => (Severity::Flag, "the search ended before two restarts agreed".to_owned()),
    };
    table.plain("G7 repeat", pass, severity, comment);
}

fn unseen(context: &ValidationContext, table: &mut CheckTable) {
    let unseen = context.problem.split().validation.len();
    let comment = "there are measurements that the search has not seen".to_owned();
    table.check(
        "G8 unseen data",
        Some(unseen as f64),
        ">",
        Some(0.0),
        "samples",
        unseen > 0,
        Severity::Reject,
        comment,
    );
}

fn complete(context: &ValidationContext, table: &mut CheckTable) {
    let (problem, split) = (&context.problem, context.problem.split());
    let all = split.train.start..split.validation.end.max(split.train.end);
    let excluded = |k: &usize| {
        context.policy.excluded.iter().any(|(from, to)| (*from..=*to).contains(&problem.grid().time(*k)))
    };
    let wanted = all.clone().filter(|k| !excluded(k)).count();
    let share = |scale: &OutputScale| {
        let usable = problem.usable(scale.output, all.clone());
        (usable.iter().filter(|k| !excluded(k)).count() * stride(&usable)) as f64 / wanted.max(1) as f64
    };
    let shares = context.output_scales().into_iter().map(|scale| (share(&scale), scale));
    let Some((good, scale)) = shares.min_by(|(one, _), (other, _)| one.total_cmp(other)) else { return };
    let comment = scale.says("share of samples at which the output and all inputs are known".to_owned());
    table.check(
        "G8 complete",
        Some(good),
        ">=",
        Some(LEAST_VALID),
        "-",
        good >= LEAST_VALID,
        Severity::Reject,
        comment,
    );
}

fn excited(context: &ValidationContext, table: &mut CheckTable) {
    let inputs = || context.problem.model().inputs().iter().enumerate();
    let constant = |index: usize| {
        let (low, high) = context.problem.inputs().range(index);
        high - low <= 0.0
    };
    for (_, input) in inputs().filter(|(index, input)| !input.may_be_constant && constant(*index)) {
        let comment = format!("{} never changes, so its effect cannot be estimated", input.channel);
        table.check("G8 excited", Some(0.0), ">", Some(0.0), &input.unit, false, Severity::Reject, comment);
    }
    // Each of these may stand still, and nothing is learnt from a record in which they all do.
    let together: Vec<(usize, &str)> = inputs()
        .filter(|(_, input)| input.may_be_constant)
        .map(|(index, input)| (index, input.channel.as_str()))
        .collect();
    if !together.is_empty() && together.iter().all(|(index, _)| constant(*index)) {
        let names: Vec<&str> = together.iter().map(|(_, name)| *name).collect();
        let comment = format!("none of {} ever changes, so nothing excites what they feed", names.join(", "));
        table.check("G8 excited", Some(0.0), ">", Some(0.0), "inputs", false, Severity::Reject, comment);
    }
}

fn unit_jump(context: &ValidationContext, table: &mut CheckTable) {
    let change = |scale: &OutputScale| {
        let (values, valid) = context.problem.measured()[scale.output];
        let ticks = ticks(valid);
        let pairs = ticks.clone().zip(ticks.skip(1)).filter(|(before, k)| valid[*before] && valid[*k]);
        pairs.map(|(before, k)| (values[k] - values[before]).abs()).fold(0.0, f64::max)
    };
    let says = |_: f64, _: &str| {
        "largest change of the output from one sample to the next; a change of unit would be larger"
            .to_owned()
    };
    table.worst(context, "G8 no unit jump", LARGEST_CHANGE, change, says);
}

fn stuck(context: &ValidationContext, table: &mut CheckTable) {
    let longest = |scale: &OutputScale| {
        let (values, valid) = context.problem.measured()[scale.output];
        let step = context.problem.quanta().get(scale.output).copied().flatten().unwrap_or(0.0);
        let (hours, moved) = longest_constant(
            values,
            valid,
            &context.trajectory.outputs[scale.output],
            context.problem.grid().step(),
        );
        let limit = if step > 0.0 && moved > 5.0 * step { STUCK_HOURS_MOVING } else { STUCK_HOURS };
        (hours, limit)
    };
    let judged = context.output_scales().into_iter().map(|scale| (longest(&scale), scale));
    let Some(((hours, limit), scale)) = judged.max_by(|((a, x), _), ((b, y), _)| (a / x).total_cmp(&(b / y)))
    else {
        return;
    };
    let comment = scale.says("longest time for which the output sensor showed one value".to_owned());
    table.at_most("G8 not stuck", Some(hours), limit, "h", Severity::Reject, comment);
}

/// Hours for which the sensor showed one value longest, and how far the model moved meanwhile.
fn longest_constant(values: &[f64], valid: &[bool], simulated: &[f64], step: i64) -> (f64, f64) {
    let (mut longest, mut moved) = (0, 0.0);
    let mut start = 0;
    for k in ticks(valid) {
        if !valid[k] || !valid[start] || values[k] != values[start] {
            start = k;
        }
        if valid[k] && k - start > longest {
            longest = k - start;
            let run = &simulated[start..=k];
            moved = run.iter().copied().fold(f64::NEG_INFINITY, f64::max)
                - run.iter().copied().fold(f64::INFINITY, f64::min);
        }
    }
    (longest as f64 * step as f64 / HOUR as f64, moved)
}

/// A limit in words: three digits are enough.
fn short(limit: f64) -> String {
    let digits = (2.0 - limit.log10().floor()).clamp(0.0, 9.0);
    let shown = format!("{limit:.*}", digits as usize);
    if shown.contains('.') { shown.trim_end_matches('0').trim_end_matches('.').to_owned() } else { shown }
}
