//! Whether the channels behind a fit can be what their names say: judged by themselves, by each other and by
//! the months before.

use super::evidence::Role;
use super::past::NextDoor;
use crate::data::DAY;
use crate::data::{Column, DEFAULT_MAX_GAP_STEPS, hour_of_day, sun_position};
use crate::estimate::fit::levels::{ChannelLevel, known, level, mean, read};
use crate::estimate::problem::Problem;
use indexmap::IndexMap;
use std::ops::Range;

/// A day of values is noise where successive ones differ as those of white noise do: half the mean square of
/// the differences over the variance (von Neumann's ratio) is 1 for white noise and near 0 for what moves
/// slowly.
const WHITE: f64 = 0.7;
/// Successive days of noise after which an input is no measurement. An output may be held still by its
/// thermostat, and whether it moves with anything is for other rules.
const NOISY_DAYS: usize = 2;
/// The deviation of noise about a constant, in K: less is the resolution of a sensor, more is something that
/// is switched, unless it is the weather.
const NOISE: [f64; 2] = [0.02, 2.0];
/// The mean size of the jumps at one time of the day, beside that of any other time, from which on days are
/// out of order; the same at midnight, where records are cut, beside that of the hours around it, in which
/// hardly anything is switched; the share of it that has one sign in what is switched by a clock; and the
/// days that it takes to tell.
const OUT_OF_ORDER: f64 = 2.5;
const CUT_AT_MIDNIGHT: f64 = 1.6;
const ABOUT_MIDNIGHT_HOURS: f64 = 2.0;
const ONE_SIGN: f64 = 0.5;
const ORDER_DAYS: usize = 6;
/// Steps from one sample to the next that what nobody heats cannot make, whether they stay or not: one is a
/// spike that goes again.
const JUMPS: usize = 4;
/// Hours by which the warmest time of the day follows the sun outdoors, and how many deviations it takes to
/// doubt a clock.
const FOLLOWS_SUN: [f64; 2] = [1.0, 5.0];
const DOUBTED: f64 = 4.0;
/// A step from one sample to the next that stays, in K: of an input, and of a room, which has mass.
const STEP: [f64; 2] = [8.0, 2.0];
/// Days on either side of a step that have to lie apart.
const STAYS: i64 = 3;
/// Hours for which a temperature that is not zero may show one value; thrice as many where its sensor knows
/// half degrees only.
const STUCK_HOURS: f64 = 24.0;
/// Coarse sensors show steps of at least this much, in K.
const COARSE: f64 = 0.5;
/// Sensors of two places do not agree better than this, in K, root mean square.
const SAME: f64 = 0.1;
/// The mean temperature of a room, and the highest of one that is colder outdoors than `MILD`.
const ROOM: [f64; 2] = [5.0, 32.0];
const HEATED_ROOM: f64 = 28.0;
const MILD: f64 = 18.0;
/// The lowest mean of one that is not heated.
const FREEZING: f64 = -40.0;
/// The highest mean of water that heats.
const WATER: f64 = 90.0;
/// How many deviations, and how many K at least, a channel's mean may lie from that of accepted months, and
/// how many times its deviation may have changed.
const LEVEL: (f64, f64, f64) = (3.0, 2.0, 3.0);

/// How far the outdoor temperature may lie from a neighbour's: in the mean and in deviation, in K, and as a
/// share of the deviation of the weather.
const ELSEWHERE: [f64; 3] = [4.0, 1.5, 0.5];

/// What is wrong with a channel, in a sentence.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelFault {
    /// The channel.
    pub channel: String,
    /// What was seen.
    pub says: String,
}

/// Every fault that the temperatures of a problem show, the outputs' own hanging apart, which is another
/// rule's.
pub fn faults(problem: &Problem) -> Vec<ChannelFault> {
    let mut faults = Vec::new();
    let mut note = |channel: &str, says: Option<String>| {
        faults.extend(says.map(|says| ChannelFault { channel: channel.to_owned(), says }));
    };
    let temperatures: Vec<(&str, &Column, bool)> = temperatures(problem).collect();
    for (name, column, is_output) in &temperatures {
        let since = |k: usize| crate::data::rfc3339(problem.grid().time(k));
        let most = if Role::of(name) == Role::Weather { f64::INFINITY } else { NOISE[1] };
        if !is_output {
            let stuck = stuck(problem, column)
                .map(|(hours, k)| format!("{name} showed one value for {hours:.0} h from {} on", since(k)));
            note(name, stuck);
            let noisy = noisy(problem, column, most);
            note(
                name,
                noisy.map(|k| {
                    format!(
                        "{name} is noise about a constant from {} on: its sensor measures nothing",
                        since(k)
                    )
                }),
            );
        }
        let step = step(problem, column, *is_output);
        let says = |(k, kelvin): (usize, f64)| {
            format!(
                "{name} steps by {kelvin:+.1} K at {} and stays there: another unit or another sensor?",
                since(k)
            )
        };
        note(name, step.map(says));
        note(name, implausible(problem, name, column));
        if *is_output || Role::of(name) != Role::Heat {
            let jump = out_of_order(problem, column);
            note(
                name,
                jump.map(|kelvin| {
                    format!(
                        "{name} jumps by {kelvin:.2} K at one time of the day, and not around it: are \
                        its days in order?"
                    )
                }),
            );
        }
        if !is_output && Role::of(name) != Role::Heat {
            let jumps = jumps(column);
            note(
                name,
                jumps.map(|n| {
                    format!(
                        "{name} jumps {n} times by more than {:.0} K from one sample to the \
                        next: a loose contact?",
                        STEP[0]
                    )
                }),
            );
        }
    }
    note("T_out", clock_of_the_weather(problem));
    for (i, (name, column, is_output)) in temperatures.iter().enumerate() {
        for (other, theirs, _) in &temperatures[i + 1..] {
            if apart(column, theirs).is_some_and(|apart| apart < SAME) {
                // The channel that is not the output is the one that was bound wrongly.
                let (wrong, right) = if *is_output { (other, name) } else { (name, other) };
                note(
                    wrong,
                    Some(format!(
                        "{wrong} and {right} are the same sensor: they differ by less than {SAME} K"
                    )),
                );
            }
        }
    }
    faults
}

/// Channels whose level or spread is another one than in a fit that was accepted before, or a reason why none
/// is compared.
pub fn strangers(
    now: &IndexMap<String, ChannelLevel>,
    before: &IndexMap<String, ChannelLevel>,
    when: &str,
) -> Vec<ChannelFault> {
    let (deviations, least, times) = LEVEL;
    let strange = |(name, now): (&String, &ChannelLevel)| {
        let before = before.get(name).filter(|_| name.starts_with("T_"))?;
        let moved = now.mean - before.mean;
        let says = if moved.abs() > (deviations * before.sd).max(least) {
            format!(
                "the mean of {name} is {moved:+.1} K from that of {when}: another unit, another place or \
                another season?"
            )
        } else if now.sd > times * before.sd.max(NOISE[0]) || now.sd * times < before.sd {
            format!(
                "{name} varies by {:.2} K, in {when} it did by {:.2}: is its sensor still the same?",
                now.sd, before.sd
            )
        } else {
            return None;
        };
        Some(ChannelFault { channel: name.clone(), says })
    };
    now.iter().filter_map(strange).collect()
}

/// Whether the outdoor temperature is that of the neighbours: sensors of one place stand in other sun and
/// wind, and see the same weather.
pub fn weather_elsewhere(problem: &Problem, next_door: &[NextDoor]) -> Option<ChannelFault> {
    let grid = problem.grid();
    let own = grid.column("T_out")?;
    let differs = |other: &NextDoor| {
        let theirs = other
            .weather
            .column_on(grid, "T_out", own.hold(), DEFAULT_MAX_GAP_STEPS)
            .filter(|theirs| theirs.unit() == own.unit())?;
        let both: Vec<usize> = (0..grid.len()).filter(|k| own.valid()[*k] && theirs.valid()[*k]).collect();
        if (both.len() as i64) * grid.step() < ORDER_DAYS as i64 * DAY {
            return None;
        }
        let apart = level(&both.iter().map(|k| own.values()[*k] - theirs.values()[*k]).collect::<Vec<_>>());
        let weather = level(&both.iter().map(|k| theirs.values()[*k]).collect::<Vec<_>>());
        let [offset, least, share] = ELSEWHERE;
        let is = apart.mean.abs() > offset || apart.sd > least.max(share * weather.sd);
        Some(is.then(|| ChannelFault {
            channel: "T_out".to_owned(),
            says: format!(
                "T_out does not follow that of {}, from which it lies by {:+.1} K in the mean and varies by \
                {:.1} K: another place, another clock or another channel?",
                other.name, apart.mean, apart.sd
            ),
        }))
    };
    // Where neighbours disagree with each other one of them may be wrong itself.
    let found: Vec<Option<ChannelFault>> = next_door.iter().filter_map(differs).collect();
    let most = 2 * found.iter().flatten().count() > found.len();
    found.into_iter().flatten().next().filter(|_| most)
}

/// Those of temperatures, and whether each is an output.
fn temperatures(problem: &Problem) -> impl Iterator<Item = (&str, &Column, bool)> {
    let is_output = |name: &str| problem.model().outputs().iter().any(|output| output.channel == name);
    read(problem)
        .filter(|(name, column)| column.unit() == "degC" && name.starts_with("T_"))
        .map(move |(name, column)| (name, column, is_output(name)))
}

/// Hours of the longest time for which one value was shown, and where that began, where it is too long.
fn stuck(problem: &Problem, column: &Column) -> Option<(f64, usize)> {
    let (values, valid) = (column.values(), column.valid());
    let resolution = (1..values.len())
        .map(|k| (values[k] - values[k - 1]).abs())
        .filter(|change| *change > 0.0)
        .fold(f64::INFINITY, f64::min);
    let limit = if resolution >= COARSE { 3.0 * STUCK_HOURS } else { STUCK_HOURS };
    let (mut longest, mut at, mut start) = (0, 0, 0);
    for k in 0..values.len() {
        // A zero is what a meter of water shows while nothing flows.
        if !valid[k] || values[k] != values[start] || values[k] == 0.0 {
            start = k;
        }
        if k - start > longest {
            (longest, at) = (k - start, start);
        }
    }
    let hours = longest as f64 * problem.grid().step_hours();
    (hours >= limit).then_some((hours, at))
}

/// The first of so many successive days of noise about a constant, with a deviation of less than `most`.
fn noisy(problem: &Problem, column: &Column, most: f64) -> Option<usize> {
    let per_day = (DAY / problem.grid().step()) as usize;
    if per_day < 12 {
        return None;
    }
    let white = |day: usize| {
        let values = known(column, day * per_day..(day + 1) * per_day);
        if values.len() < per_day / 2 {
            return false;
        }
        let deviation = level(&values).sd;
        let changes = values.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>()
            / (values.len() - 1) as f64;
        (NOISE[0]..most).contains(&deviation) && 0.5 * changes > WHITE * deviation.powi(2)
    };
    let days: Vec<bool> = (0..column.values().len() / per_day).map(white).collect();
    days.windows(NOISY_DAYS).position(|days| days.iter().all(|white| *white)).map(|day| day * per_day)
}

/// The mean jump of a channel at the time of the day at which it jumps beyond all that it does at others, to
/// either side.
fn out_of_order(problem: &Problem, column: &Column) -> Option<f64> {
    let per_day = (DAY / problem.grid().step()) as usize;
    let days = column.values().len() / per_day.max(1);
    if per_day < 12 || days < ORDER_DAYS {
        return None;
    }
    let change = |k: usize| {
        (column.valid()[k] && column.valid()[k - 1]).then(|| column.values()[k] - column.values()[k - 1])
    };
    // Mean of the changes at a time of the day and of their sizes, and whether it changed on enough days.
    let at = |slot: usize| {
        let changes: Vec<f64> = (0..days)
            .filter_map(|day| (day * per_day + slot).checked_sub(1).and_then(|k| change(k + 1)))
            .collect();
        let often = changes.iter().filter(|change| **change != 0.0).count() >= ORDER_DAYS - 1;
        let sizes: Vec<f64> = changes.iter().map(|change| change.abs()).collect();
        if sizes.is_empty() { (0.0, 0.0, false) } else { (mean(&changes), mean(&sizes), often) }
    };
    let slots: Vec<(f64, f64, bool)> = (0..per_day).map(at).collect();
    // Whether it jumps beyond all that it does at other times, so many samples around this one at most.
    let beyond = |slot: usize, within: usize, times: f64| {
        let apart = |other: usize| slot.abs_diff(other).min(per_day - slot.abs_diff(other));
        let others = (0..per_day).filter(|other| (1..=within).contains(&apart(*other)));
        let (mean, size, often) = slots[slot];
        let most = others.map(|other| slots[other].1).fold(0.0, f64::max);
        (often && size >= times * most && mean.abs() < ONE_SIGN * size).then_some(size)
    };
    let largest = (0..per_day).max_by(|one, other| slots[*one].1.total_cmp(&slots[*other].1))?;
    let about = (ABOUT_MIDNIGHT_HOURS / problem.grid().step_hours()) as usize;
    // A file of days may be cut by either clock.
    let mut midnights = (0..per_day).filter(|slot| {
        let k = if *slot == 0 { per_day } else { *slot };
        problem.grid().time(k) % DAY == 0
            || hour_of_day(problem.grid(), k) < hour_of_day(problem.grid(), k - 1)
    });
    beyond(largest, per_day, OUT_OF_ORDER)
        .or_else(|| midnights.find_map(|slot| beyond(slot, about, CUT_AT_MIDNIGHT)))
}

/// How often a channel jumps from one sample to the next further than anything does that nobody heats.
fn jumps(column: &Column) -> Option<usize> {
    let (values, valid) = (column.values(), column.valid());
    let jump = |k: &usize| valid[*k] && valid[k - 1] && (values[*k] - values[k - 1]).abs() >= STEP[0];
    Some((1..values.len()).filter(jump).count()).filter(|count| *count >= JUMPS)
}

/// What is wrong with the clock of the outdoor temperature, which follows the sun by a few hours wherever
/// there is weather: phases of the first harmonic of every day against that of the sun's height.
fn clock_of_the_weather(problem: &Problem) -> Option<String> {
    let grid = problem.grid();
    let out = grid.column("T_out")?;
    let sun = sun_heights(problem)?;
    let per_day = (DAY / grid.step()) as usize;
    if per_day < 12 {
        return None;
    }
    let wave = |values: &dyn Fn(usize) -> f64, day: usize| {
        let (mut re, mut im) = (0.0, 0.0);
        // Without the line from one midnight to the next, which has a phase of its own.
        let (first, last) = (values(day * per_day), values((day + 1) * per_day));
        for i in 0..per_day {
            let angle = std::f64::consts::TAU * i as f64 / per_day as f64;
            let value = values(day * per_day + i) - first - (last - first) * i as f64 / per_day as f64;
            (re, im) = (re + value * angle.cos(), im + value * angle.sin());
        }
        (re, im)
    };
    let whole =
        |day: &usize| (day * per_day..=(day + 1) * per_day).all(|k| out.valid()[k] && sun[k].is_finite());
    // Turned so that the sun's own phase is zero: the angle is the delay behind the sun.
    let turned: Vec<(f64, f64)> = (0..(grid.len() - 1) / per_day)
        .filter(whole)
        .map(|day| {
            let (a, b) = wave(&|k| out.values()[k], day);
            let (c, d) = wave(&|k| sun[k], day);
            let size = (c * c + d * d).sqrt().max(f64::MIN_POSITIVE);
            ((a * c + b * d) / size, (b * c - a * d) / size)
        })
        .collect();
    let n = turned.len() as f64;
    if turned.len() < ORDER_DAYS {
        return None;
    }
    let (re, im) = (turned.iter().map(|z| z.0).sum::<f64>() / n, turned.iter().map(|z| z.1).sum::<f64>() / n);
    let size = (re * re + im * im).sqrt();
    let scatter = turned.iter().map(|z| (z.0 - re).powi(2) + (z.1 - im).powi(2)).sum::<f64>() / 2.0;
    let deviation = (scatter / (n * (n - 1.0))).sqrt() / size;
    let hours = |angle: f64| angle * 24.0 / std::f64::consts::TAU;
    let (delay, deviation) = (hours(im.atan2(re)), hours(deviation));
    let [earliest, latest] = FOLLOWS_SUN;
    let beyond = (earliest - delay).max(delay - latest);
    (beyond > DOUBTED * deviation).then(|| {
        format!(
            "T_out is warmest {delay:.1} h after noon, which no weather is: is its clock late or early, \
            does the sun shine on its sensor, or is it not outdoors?"
        )
    })
}

/// A step from one sample to the next behind which the channel never comes back for days.
fn step(problem: &Problem, column: &Column, is_output: bool) -> Option<(usize, f64)> {
    let least = STEP[usize::from(is_output)];
    let (values, valid) = (column.values(), column.valid());
    let length = (STAYS * DAY / problem.grid().step()) as usize;
    let ends = |range: Range<usize>| {
        let mut values = known(column, range);
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values.get((share * (values.len().max(1) - 1) as f64) as usize).copied();
        // What stood still before was switched off.
        Some((at(0.05)?, at(0.95)?)).filter(|(low, high)| high > low)
    };
    let found = (1..values.len()).find(|k| {
        let change = values[*k] - values[k - 1];
        if !valid[*k] || !valid[k - 1] || change.abs() < least {
            return false;
        }
        let sides = ends(k.saturating_sub(length)..*k).zip(ends(*k..(k + length).min(values.len())));
        sides.is_some_and(
            |((low, high), (low_after, high_after))| {
                if change > 0.0 { low_after > high } else { high_after < low }
            },
        )
    })?;
    Some((found, values[found] - values[found - 1]))
}

/// A level that the name of a channel does not allow.
fn implausible(problem: &Problem, name: &str, column: &Column) -> Option<String> {
    let level = mean(&known(column, 0..column.values().len()));
    let outdoors =
        problem.grid().column("T_out").map(|column| mean(&known(column, 0..column.values().len())));
    let outside = |[low, high]: [f64; 2], of: &str| {
        let is = !(low..=high).contains(&level);
        is.then(|| format!("the mean of {name} is {level:.1} degC, {of}: another unit or another channel?"))
    };
    match name {
        "T_out" => outside(season(problem)?, "which the height of the sun does not allow outdoors"),
        "T_forward" => outside([ROOM[0], WATER], "which heating water does not have"),
        name if name.starts_with("T_room") => {
            let highest =
                if outdoors.is_some_and(|outdoors| outdoors < MILD) { HEATED_ROOM } else { ROOM[1] };
            // What nobody heats may freeze.
            let heated = problem.model().inputs().iter().any(|input| Role::of(&input.channel) == Role::Heat);
            outside([if heated { ROOM[0] } else { FREEZING }, highest], "which no room has for weeks")
        }
        _ => None,
    }
}

/// The means of outdoor temperature that the mean height of the sun at noon allows: generous bounds about the
/// climates of the earth, from the Siberian winter over Honolulu's to the autumn and the summer of Kuwait.
fn season(problem: &Problem) -> Option<[f64; 2]> {
    let heights = sun_heights(problem)?;
    let per_day = (DAY / problem.grid().step()).max(1) as usize;
    let highest = |day: &[f64]| {
        day.iter().copied().filter(|height| height.is_finite()).fold(f64::NEG_INFINITY, f64::max)
    };
    let noons: Vec<f64> =
        heights.chunks_exact(per_day).map(highest).filter(|noon| noon.is_finite()).collect();
    let noon = mean(&noons);
    noon.is_finite().then(|| [-55.0 + 0.6 * noon, 10.0 + 0.3 * noon + 0.0018 * noon * noon.abs()])
}

/// The height of the sun at every sample, as it was logged or computed for the place, not a number where it
/// is missing. `None` where neither is known.
fn sun_heights(problem: &Problem) -> Option<Vec<f64>> {
    let grid = problem.grid();
    match (grid.column("sun_altitude"), problem.basis().location) {
        (Some(column), _) => {
            let height = |(value, valid): (&f64, &bool)| if *valid { *value } else { f64::NAN };
            Some(column.values().iter().zip(column.valid()).map(height).collect())
        }
        (None, Some((latitude, longitude))) => {
            let height = |k: usize| {
                sun_position(grid.time(k), latitude, longitude).map_or(f64::NAN, |sun| sun.altitude)
            };
            Some((0..grid.len()).map(height).collect())
        }
        (None, None) => None,
    }
}

/// Root mean square of the difference of two channels, over a day of common samples at least.
fn apart(one: &Column, other: &Column) -> Option<f64> {
    let both = || (0..one.values().len()).filter(|k| one.valid()[*k] && other.valid()[*k]);
    let n = both().count();
    (n > 24).then(|| {
        (both().map(|k| (one.values()[k] - other.values()[k]).powi(2)).sum::<f64>() / n as f64).sqrt()
    })
}
