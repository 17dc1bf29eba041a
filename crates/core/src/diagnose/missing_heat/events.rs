//! Events in the missing heat, and groups of events that are alike.

use super::hours::Hour;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An hour begins an event where it leaves what is usual by so many deviations of all hours: what noise does
/// in about one hour of a hundred.
const UNUSUAL: f64 = 2.5;
/// And by so many deviations of its own.
const SURE: f64 = 1.96;
/// An event lasts while its rate is more than this share of its peak.
const EDGE: f64 = 1.0 / 3.0;
/// Events of one kind follow each other round the clock without a pause of so many hours.
const APART_HOURS: f64 = 3.0;
/// So many events make a habit.
const HABIT: usize = 3;
/// From a robust deviation to that of a normal distribution.
const NORMAL: f64 = 1.4826;
const WORKING_DAYS: usize = 5;

/// Some hours in which much more, or much less, is missing than usual.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HeatEvent {
    /// First hour, RFC 3339.
    #[schema(format = DateTime)]
    pub from: String,
    /// Hours that it lasts.
    pub hours: usize,
    /// Mean rate above what is usual; negative where heat is lost.
    pub rate: f64,
    /// The sum over its hours, in the unit of the state.
    pub sum: f64,
    #[serde(skip)]
    pub(super) at: (usize, usize),
}

/// Events that are alike: of one sign, and about the same hours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HeatHabit {
    /// How many.
    pub events: usize,
    /// When they begin on the wall, hours of the day: the middle one.
    pub begins: usize,
    /// When they end.
    pub ends: usize,
    /// The middle one of their mean rates.
    pub rate: f64,
    /// Hours that they last, the middle one.
    pub hours: usize,
    /// Share of them that begin from Monday to Friday.
    pub on_working_days: f64,
    /// Days from one to the next, the middle one.
    pub every_days: f64,
}

/// What is usual: the middle of all rates.
pub(super) fn usual(hours: &[Hour]) -> f64 {
    median(hours.iter().filter_map(|hour| hour.rate).collect())
}

/// The events, in the order of time. `length` is that of each of the hours: one, or more where samples are
/// rarer.
pub(super) fn events(hours: &[Hour], length: f64) -> Vec<HeatEvent> {
    let usual = usual(hours);
    let above = |at: usize| hours[at].known().map(|(rate, sd)| (rate - usual, sd));
    let spread = NORMAL * median((0..hours.len()).filter_map(|at| Some(above(at)?.0.abs())).collect());
    let peaks = |at: &usize| {
        above(*at).is_some_and(|(rate, sd)| rate.abs() > (UNUSUAL * spread).max(SURE * sd) && rate != 0.0)
    };
    let mut seeds: Vec<usize> = (0..hours.len()).filter(peaks).collect();
    let size = |at: usize| above(at).map_or(0.0, |(rate, _)| rate);
    seeds.sort_by(|a, b| size(*b).abs().total_cmp(&size(*a).abs()).then(a.cmp(b)));
    let mut is_taken = vec![false; hours.len()];
    let mut found = Vec::new();
    for seed in seeds {
        if is_taken[seed] {
            continue;
        }
        let lasts = |at: &usize| !is_taken[*at] && size(*at) * size(seed) > EDGE * size(seed).powi(2);
        let first = (0..=seed).rev().take_while(lasts).last().unwrap_or(seed);
        let last = (seed..hours.len()).take_while(lasts).last().unwrap_or(seed);
        is_taken[first..=last].fill(true);
        let sum: f64 = (first..=last).map(size).sum();
        let count = (last - first + 1) as f64;
        found.push(HeatEvent {
            from: hours[first].from.clone(),
            hours: (count * length).round() as usize,
            rate: sum / count,
            sum: sum * length,
            at: (first, last),
        });
    }
    found.sort_by_key(|event| event.at);
    found
}

/// The habits among events, the largest first.
pub(super) fn habits(hours: &[Hour], length: f64, events: &[HeatEvent]) -> Vec<HeatHabit> {
    let mut habits = Vec::new();
    for sign in [1.0, -1.0] {
        let mut of_sign: Vec<(f64, &HeatEvent)> = events
            .iter()
            .filter(|event| event.rate * sign > 0.0)
            .map(|event| (middle(hours, event), event))
            .collect();
        of_sign.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.at.cmp(&b.1.at)));
        habits.extend(
            round_the_clock(&of_sign)
                .into_iter()
                .filter(|kind| kind.len() >= HABIT)
                .map(|kind| habit(hours, length, &kind)),
        );
    }
    habits.sort_by(|a, b| b.events.cmp(&a.events).then(b.rate.abs().total_cmp(&a.rate.abs())));
    habits
}

/// The hour of the day on which an event has its middle.
fn middle(hours: &[Hour], event: &HeatEvent) -> f64 {
    (hours[event.at.0].hour as f64 + 0.5 * event.hours as f64).rem_euclid(24.0)
}

/// Events in the order of their hours, cut where the clock is without any for long.
fn round_the_clock<'a>(sorted: &[(f64, &'a HeatEvent)]) -> Vec<Vec<&'a HeatEvent>> {
    let n = sorted.len();
    // The pause before each event; that of the first one goes over midnight.
    let pause = |at: usize| (sorted[at].0 - sorted[(at + n - 1) % n].0).rem_euclid(24.0);
    let Some(cut) = (0..n).find(|at| n == 1 || pause(*at) > APART_HOURS) else {
        return if n == 0 { Vec::new() } else { vec![sorted.iter().map(|(_, event)| *event).collect()] };
    };
    let mut kinds: Vec<Vec<&HeatEvent>> = Vec::new();
    for step in 0..n {
        let at = (cut + step) % n;
        match kinds.last_mut().filter(|_| step > 0 && pause(at) <= APART_HOURS) {
            Some(kind) => kind.push(sorted[at].1),
            None => kinds.push(vec![sorted[at].1]),
        }
    }
    kinds
}

fn habit(hours: &[Hour], length: f64, kind: &[&HeatEvent]) -> HeatHabit {
    let of = |value: &dyn Fn(&HeatEvent) -> f64| median(kind.iter().map(|event| value(event)).collect());
    // Hours of the day are told from the kind's own middle, so that midnight is no edge.
    let around = middle(hours, kind[kind.len() / 2]);
    let on_clock = |hour: f64| around + (hour - around + 12.0).rem_euclid(24.0) - 12.0;
    let clock = |hour: f64| hour.round().rem_euclid(24.0) as usize;
    let begins = of(&|event| on_clock(hours[event.at.0].hour as f64));
    let lasts = of(&|event| event.hours as f64);
    let mut firsts: Vec<usize> = kind.iter().map(|event| event.at.0).collect();
    firsts.sort_unstable();
    HeatHabit {
        events: kind.len(),
        begins: clock(begins),
        ends: clock(begins + lasts),
        rate: of(&|event| event.rate),
        hours: lasts.round() as usize,
        on_working_days: kind.iter().filter(|event| hours[event.at.0].weekday < WORKING_DAYS).count() as f64
            / kind.len() as f64,
        every_days: median(
            firsts.windows(2).map(|pair| (pair[1] - pair[0]) as f64 * length / 24.0).collect(),
        ),
    }
}

/// The middle of values; nothing is 0.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}
