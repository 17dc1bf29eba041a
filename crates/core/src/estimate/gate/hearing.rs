//! The rules of the gate that ask whether what was logged moves the room: G9 of its inputs, G10 of forecasts
//! that know less, G11 of the channels themselves, G12 of how much is determined at all.
//!
//! What is shown to be wrong holds a fit, and so does a room that nothing logged is seen to move; what is
//! merely not seen is a flag. They hold and do not reject: the measurements are at fault, and an operator can
//! look at a sensor.

use super::channels;
use super::check::Severity;
use super::context::ValidationContext;
use super::evidence::{BELIEVED, Evidence, InputEvidence, Rival, Role};
use super::opponents;
use super::opponents::Match;
use super::physics;
use super::table::CheckTable;
use crate::data::{HOUR, Seconds};
use crate::estimate::assess::metrics::horizon_name;
use crate::estimate::fit::Estimate;
use crate::estimate::fit::levels::levels;

/// What moves a room unexplained, in deviations of its sensor's noise, where its heating must be seen: what
/// chance and the sensor add in a day stays below.
const UNEXPLAINED: f64 = 2.5;
/// What is left of the squared error where the clock of the room itself is put right.
const CLOCK: f64 = 0.9;
/// Draws of unseen targets below which no forecast is compared: of two the first part is no target.
const LEAST_DRAWS: f64 = 1.5;
/// Time constants after which a process has forgotten what it was.
const FORGOTTEN: f64 = 4.0;
const DAY_HOURS: f64 = 24.0;
/// A fit that errs by this much more than the free regression on the same inputs, surely, lacks what the
/// inputs say.
const REGRESSION: f64 = 1.45;
const SURELY: f64 = -2.5;
/// The share of the parameters that may be undetermined or on a bound: in rooms of which everything is right
/// it was up to twelve of thirteen.
const UNDETERMINED: f64 = 0.95;
/// Of fewer parameters than these the errors say more than the intervals.
const HANDFUL: usize = 6;

/// The checks of the rule `G9`.
pub(super) fn inputs(context: &ValidationContext, table: &mut CheckTable) {
    let Some(evidence) = context.evidence() else { return };
    for input in &evidence.inputs {
        seen(input, table);
    }
    let wrong: Vec<(&InputEvidence, String, f64)> =
        evidence.inputs.iter().filter_map(|input| Some((input, says(input)?, statistic(input)))).collect();
    for (input, comment, statistic) in &wrong {
        table.check(
            &format!("G9 right {}", input.channel),
            Some(*statistic),
            "",
            None,
            "-",
            false,
            Severity::Hold,
            comment.clone(),
        );
    }
    clock(context, evidence, !wrong.is_empty(), table);
    heating(context, evidence, table);
}

/// The channel of the first output.
fn room<'a>(context: &'a ValidationContext) -> &'a str {
    context.problem.model().outputs().first().map_or("the room", |output| output.channel.as_str())
}

fn seen(input: &InputEvidence, table: &mut CheckTable) {
    let (channel, pass) = (&input.channel, input.is_seen());
    let t = input.claimed.map(|(explained, _)| explained.t);
    let comment = match (input.claimed, pass) {
        (Some((explained, hours)), true) if explained.t >= BELIEVED => format!(
            "{channel} moves this room, {:.2} times as much as the fit says: it explains {:.0} % of what the \
            rest leaves open over {hours:.0} h",
            explained.size,
            100.0 * explained.share
        ),
        (_, true) => format!("{channel} moves this room: shifted by whole days it forecasts worse"),
        (_, false) => format!(
            "{channel} is not seen to drive this room: it stood still, does little here, or is another room's"
        ),
    };
    if !pass {
        table.flags.push(format!("unseen:{channel}"));
    }
    table.check(&format!("G9 seen {channel}"), t, ">=", Some(BELIEVED), "t", pass, Severity::Flag, comment);
}

/// What is wrong with an input, where something is shown to be.
fn says(input: &InputEvidence) -> Option<String> {
    let channel = &input.channel;
    // Clouds are what they take from the sun, and both are read from the same height.
    if channel == "cloud_cover" {
        return None;
    }
    if let Some((rival, _)) = input.better() {
        return Some(match rival {
            Rival::Late(hours) => {
                format!("{channel} fits better {hours} h earlier: is the clock of this channel late?")
            }
            Rival::Early(hours) => {
                format!("{channel} fits better {hours} h later: is the clock of this channel early?")
            }
            Rival::Exchanged(other) => {
                format!("{channel} and {other} look swapped: in its place {other} forecasts better")
            }
        });
    }
    if input.is_mirrored() {
        let way = if input.rises { "falls" } else { "rises" };
        return Some(format!(
            "mirrored, {channel} fits better: the room {way} where it should do the opposite, so its sign is \
            wrong"
        ));
    }
    let unheard =
        format!("this room follows {channel}, and the fit does not: is its unit or its level wrong?");
    input.is_unheard().then_some(unheard)
}

fn statistic(input: &InputEvidence) -> f64 {
    input.better().map_or_else(
        || input.followed.map_or(f64::NAN, |followed| followed.gain_t),
        |(_, compared)| compared.ratio,
    )
}

/// The clock of the room itself, where no single input explains the same.
fn clock(context: &ValidationContext, evidence: &Evidence, told: bool, table: &mut CheckTable) {
    let Some((late, compared)) = evidence.clock else { return };
    let (is_better, is_sure) = (compared.ratio <= CLOCK, compared.t >= BELIEVED);
    let pass = told || !(is_better && is_sure);
    let channel = room(context);
    let inputs = evidence.names(|_| true);
    let comment = match (pass, late > 0) {
        (true, _) if !is_better => format!("{channel} follows its inputs by their clock"),
        (true, _) if is_sure => {
            format!("what another clock of {channel} would mend is told of one input already")
        }
        (true, _) => format!("another clock of {channel} fits better, but not on enough days to be sure"),
        (false, true) => format!(
            "{channel} fits its inputs better {late} h earlier: is its clock late, or that of {inputs} early?"
        ),
        (false, false) => format!(
            "{channel} fits its inputs better {} h later: is its clock early, or that of {inputs} late?",
            -late
        ),
    };
    table.check("G9 clock", Some(compared.ratio), ">", Some(CLOCK), "-", pass, Severity::Hold, comment);
}

/// A room that something moves must be seen to follow its heating, where that is among the inputs.
fn heating(context: &ValidationContext, evidence: &Evidence, table: &mut CheckTable) {
    let heat: Vec<&InputEvidence> = evidence.inputs.iter().filter(|input| input.role == Role::Heat).collect();
    let Some(unexplained) = evidence.unexplained.filter(|_| !heat.is_empty()) else { return };
    let is_quiet = unexplained < UNEXPLAINED;
    let pass = is_quiet || heat.iter().any(|input| input.is_seen());
    let names = evidence.names(|input| input.role == Role::Heat);
    let room = room(context);
    let comment = if is_quiet {
        "nothing moves this room that is not explained".to_owned()
    } else if pass {
        format!("something moves {room} that is not explained, but its heating is seen")
    } else {
        format!(
            "{names} does not drive {room}, and something does: unplugged, another room's, wrong unit? \
            Shifted by days it forecasts as well"
        )
    };
    table.check(
        "G9 heating",
        Some(unexplained),
        "<",
        Some(UNEXPLAINED),
        "times the noise of the sensor",
        pass,
        Severity::Hold,
        comment,
    );
}

/// Hours of measurements that are one draw: what the weather drives repeats by days, and so may anything that
/// remembers them; what forgets within minutes and has no weather has many draws in a day.
fn draw(context: &ValidationContext) -> f64 {
    let mut inputs = context.problem.model().inputs().iter();
    let has_weather = inputs.any(|input| Role::of(&input.channel) == Role::Weather);
    let slowest = || physics::slowest(&context.problem, &context.theta, &context.trajectory);
    match if has_weather { None } else { slowest() } {
        Some(hours) => (FORGOTTEN * hours).max(context.policy.horizon.hours()).min(DAY_HOURS),
        None => DAY_HOURS,
    }
}

/// The checks of the rule `G10`.
pub(super) fn opponents(context: &ValidationContext, table: &mut CheckTable) {
    let (Some(run), Some(evidence)) = (context.run(), context.evidence()) else { return };
    let problem = &context.problem;
    let room = room(context);
    let unseen = evidence.names(|input| !input.is_seen());
    let unseen = if unseen.is_empty() { String::new() } else { format!("; not seen to drive it: {unseen}") };
    let name = horizon_name(context.policy.horizon);
    let met = opponents::without_inputs(problem, &context.theta, run, context.policy.horizon.millis());
    let days = met.map_or(0.0, |met| met.days);
    let draw = draw(context);
    let draws = days * DAY_HOURS / draw;
    let comment = if draw < DAY_HOURS {
        format!(
            "unseen measurements with a forecast {name} ahead are {draws:.1} times as long as the {} after which \
            it has forgotten what it was; that is one draw",
            Seconds::of_millis((draw * HOUR as f64).round() as i64)
        )
    } else {
        format!("{days:.1} days of unseen measurements have a forecast {name} ahead; a day is one draw")
    };
    let enough = draws >= LEAST_DRAWS;
    table.check(
        "G10 unseen days",
        Some(draws),
        ">=",
        Some(LEAST_DRAWS),
        "draws",
        enough,
        Severity::Hold,
        comment,
    );
    if let Some(met) = met.filter(|_| enough) {
        let comment = match (met.ratio() < 1.0, evidence.anything_seen()) {
            (true, _) => format!(
                "forecasts {name} ahead err by {:.2}, the room's own daily profile by {:.2}",
                met.fit, met.opponent
            ),
            (false, false) => {
                format!(
                    "nothing that was logged is seen to move {room}: its own daily profile forecasts {name} \
                    as well without any input{unseen}"
                )
            }
            (false, true) => format!(
                "forecasts of {room} {name} ahead err by {:.2}, its own daily profile without any input by \
                {:.2}: what moves it was not logged, or {room} is another room's or out of order{unseen}",
                met.fit, met.opponent
            ),
        };
        table.check(
            "G10 beats its own past",
            Some(met.ratio()),
            "<",
            Some(1.0),
            "-",
            met.ratio() < 1.0,
            Severity::Hold,
            comment,
        );
    }
    if let Some(met) = evidence.beside_regression.filter(|met| met.days >= LEAST_DRAWS) {
        regression(met, room, evidence, table);
    }
}

fn regression(met: Match, room: &str, evidence: &Evidence, table: &mut CheckTable) {
    let pass = met.ratio() <= REGRESSION || met.t > SURELY;
    let comment = if pass {
        format!(
            "forecasts 6 h ahead err by {:.2}, a plain regression on the same inputs by {:.2}",
            met.fit, met.opponent
        )
    } else {
        format!(
            "a plain regression on the same inputs errs by {:.2} 6 h ahead, this fit by {:.2}: {room} \
            follows them in a way that the model cannot, by the level, the unit or the clock of a channel; \
            look first at {}",
            met.opponent,
            met.fit,
            evidence.least_heard().unwrap_or(room)
        )
    };
    table.check(
        "G10 as good as a regression",
        Some(met.ratio()),
        "<=",
        Some(REGRESSION),
        "-",
        pass,
        Severity::Hold,
        comment,
    );
}

/// The checks of the rule `G11`.
pub(super) fn channels(context: &ValidationContext, table: &mut CheckTable) {
    let mut faults = channels::faults(&context.problem);
    faults.extend(channels::weather_elsewhere(&context.problem, &context.past.next_door));
    if faults.is_empty() {
        let comment =
            "every temperature moves as such, at a level that its place and the season allow".to_owned();
        table.check("G11 channels", Some(0.0), "<=", Some(0.0), "faults", true, Severity::Hold, comment);
    }
    for fault in faults {
        table.plain(&format!("G11 {}", fault.channel), false, Severity::Hold, fault.says);
    }
    let now = levels(&context.problem);
    for (when, before) in &context.levels {
        for fault in channels::strangers(&now, before, when) {
            table.plain(&format!("G11 level of {}", fault.channel), false, Severity::Hold, fault.says);
        }
    }
}

/// The check of the rule `G12`: models of a handful of parameters are judged by their errors alone. What the
/// data leave open is flagged in all of them.
pub(super) fn determined(context: &ValidationContext, table: &mut CheckTable) {
    let is_open = |estimate: &Estimate| !estimate.fixed && !estimate.at_bound && estimate.ci95.is_none();
    let open = context.fit.parameters.iter().filter(|(_, estimate)| is_open(estimate));
    table.flags.extend(open.map(|(name, _)| format!("undetermined:{name}")));
    let free = || context.fit.parameters.values().filter(|estimate| !estimate.fixed);
    if free().count() < HANDFUL {
        return;
    }
    let open = free().filter(|estimate| estimate.ci95.is_none() || estimate.at_bound).count();
    let share = open as f64 / free().count() as f64;
    let comment =
        format!("{open} of {} parameters are on a bound or not determined by these data", free().count());
    table.at_most("G12 determined", Some(share), UNDETERMINED, "-", Severity::Hold, comment);
}
