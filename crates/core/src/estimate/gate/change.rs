//! How far a fit has gone from what is trusted: from the parameters served now, from older ones, and from
//! older days.

use super::check::Severity;
use super::context::ValidationContext;
use super::limits::OutputScale;
use super::table::CheckTable;
use crate::data::DAY;
use crate::data::rfc3339;
use crate::estimate::problem::mean_square;
use crate::estimate::problem::predictor::Predictor;
use crate::model::Scale;

/// In K; `limits` says what it is for other outputs.
const JUMP_RMS: f64 = 1.0;
const JUMP_FACTOR: f64 = 3.0;
const JUMP_SHARE: f64 = 0.5;
const WEEK: i64 = 7 * DAY;
/// How much more a fit may err than the incumbent on days before newer measurements began to contradict the
/// incumbent. The incumbent has been fitted to most of these days and the fit to part of them, which alone is
/// worth what the gate allows between two fits on days that neither has seen, and as much again is left to
/// chance.
const OLDER_RATIO: f64 = 1.25;
/// Below this much older time nothing is said: one good day confirms no model.
const LEAST_OLDER: i64 = 2 * DAY;

/// How much more a fit may err than the incumbent on the days before its own, and how many of them there have
/// to be.
const BEFORE_RATIO: f64 = 1.25;
const LEAST_BEFORE: i64 = 4 * DAY;

/// The checks of the rule `G6 jump`, and of older days where newer ones contradict them.
pub(super) fn look(context: &ValidationContext, table: &mut CheckTable) {
    if let Some(incumbent) = &context.incumbent {
        if let Some(since) = context.past.degraded {
            older_days(context, table, incumbent, since);
        }
        days_before(context, table, incumbent);
        jump(context, table, "G6 jump", incumbent, "the incumbent's");
    }
    for (name, theta) in &context.references {
        jump(context, table, &format!("G6 jump from {name}"), theta, &format!("that of {name}"));
    }
}

/// Newer measurements contradict what is served: the room has changed, or its sensors lie. A fit for which
/// only those measurements speak cannot tell one from the other, and an operator can.
fn older_days(context: &ValidationContext, table: &mut CheckTable, incumbent: &[f64], since: i64) {
    let (grid, first) = (context.problem.grid(), context.problem.split().train.start);
    let older = first..(first..grid.len()).find(|k| grid.time(*k) >= since).unwrap_or(grid.len());
    let began = rfc3339(since);
    let long_enough = older.len() as i64 * grid.step() >= LEAST_OLDER;
    let errors =
        context.own_error(older.clone()).zip(context.error_of(incumbent, older)).filter(|_| long_enough);
    let ratio = errors.map(|(ours, theirs)| ours.rmse / theirs.rmse.max(f64::MIN_POSITIVE));
    let comment = match ratio {
        Some(ratio) if ratio <= OLDER_RATIO => {
            format!(
                "the days before {began}, when newer measurements began to contradict the parameters served \
                now, speak for these as well"
            )
        }
        Some(_) => format!(
            "only the days since {began} speak for these parameters; before them the ones served now \
            forecast better: look at the sensors first"
        ),
        None => format!(
            "newer measurements contradict the parameters served now since {began}, and there are no two \
            days from before it to judge by: look at the sensors first"
        ),
    };
    table.at_most("G6 older days", ratio, OLDER_RATIO, "-", Severity::Hold, comment);
}

/// What a fit has learnt of the building it knows of last month as well: one for which only its own days
/// speak has learnt from them what was not there before.
fn days_before(context: &ValidationContext, table: &mut CheckTable, incumbent: &[f64]) {
    let Some(before) = context
        .past
        .days_before
        .as_ref()
        .filter(|before| before.grid().len() as i64 * before.grid().step() >= LEAST_BEFORE)
    else {
        return;
    };
    let errors = context.errors_before(&context.theta).zip(context.errors_before(incumbent));
    let worse = |(ours, theirs): ([f64; 2], [f64; 2])| {
        ours.into_iter()
            .zip(theirs)
            .map(|(ours, theirs)| ours / theirs.max(f64::MIN_POSITIVE))
            .fold(0.0, f64::max)
    };
    let Some(ratio) = errors.map(worse) else { return };
    let began = rfc3339(before.grid().start());
    let ended = rfc3339(context.problem.grid().start());
    let comment = if ratio <= BEFORE_RATIO {
        format!(
            "the days from {began} to {ended}, which the fit has not seen, speak for these parameters as well"
        )
    } else {
        format!(
            "on the days from {began} to {ended}, which the fit has not seen, the parameters served now \
            forecast better: has the room changed since, or a sensor?"
        )
    };
    table.at_most("G6 days before", Some(ratio), BEFORE_RATIO, "-", Severity::Hold, comment);
}

/// Many small steps go as far as a large one: each night's fit may stay near its incumbent, and still be far
/// from what was trusted a month ago. So the same distance has the same limits, whatever it is taken from.
fn jump(context: &ValidationContext, table: &mut CheckTable, check: &str, from: &[f64], whose: &str) {
    let before = context.problem.simulate(from);
    let week = context.since(WEEK)..context.problem.grid().len();
    let apart = |scale: &OutputScale| {
        let (now, before) = (&context.trajectory.outputs[scale.output], &before.outputs[scale.output]);
        mean_square(&week.clone().map(|k| now[k] - before[k]).collect::<Vec<f64>>()).sqrt()
    };
    let Some((scale, rms, limit)) = context.worst(JUMP_RMS, apart) else { return };
    let (moved, how) = most_changed(context, from);
    let pass = !(rms > limit && moved) && rms.is_finite();
    let unit = scale.unit;
    let comment = scale.says(format!(
        "the free run differs from {whose} by {rms:.2} {unit} rms, the most changed parameter by {how}"
    ));
    table.check(check, Some(rms), "<=", Some(limit), unit, pass, Severity::Hold, comment);
}

/// Whether a parameter has moved far from what it was, and how far the one that has moved most. Parameters
/// that are searched on a logarithmic scale are compared by their ratio. Of the others some are temperatures
/// at the start, which belong to a record, so they count only in models without a filter, which start from
/// the same state always: as a share of what is searched.
fn most_changed(context: &ValidationContext, from: &[f64]) -> (bool, String) {
    let changes = || {
        context
            .theta
            .iter()
            .zip(from)
            .zip(context.problem.model().parameters().iter().zip(context.problem.bounds()))
    };
    let factor = changes()
        .filter(|(_, (parameter, _))| parameter.scale == Scale::Log)
        .map(|((new, old), _)| (new / old).max(old / new))
        .fold(1.0, f64::max);
    let share = changes()
        .filter(|(_, (parameter, _))| match context.problem.predictor() {
            Predictor::Filtered => false,
            Predictor::FreeRun => parameter.scale == Scale::Linear,
        })
        .map(|((new, old), (_, [lower, upper]))| ((new - old) / (upper - lower)).abs())
        .fold(0.0, f64::max);
    let how = if share / JUMP_SHARE > factor / JUMP_FACTOR {
        format!("{:.0} % of what is searched", 100.0 * share)
    } else {
        format!("a factor of {factor:.1}")
    };
    (factor > JUMP_FACTOR || share > JUMP_SHARE, how)
}
