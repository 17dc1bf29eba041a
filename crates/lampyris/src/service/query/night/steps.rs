//! What is not to be relied on now, and what to do next.

use super::report::{DoubtfulSystem, NightStep, RefusalGroup};
use crate::service::query::matrix::effects::{MatrixEffect, WORTHWHILE};
use crate::service::serving::body::Status;
use crate::store::jobs::Outcome;
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::Duration;

/// Effects that are proposed at most.
const PROPOSED: usize = 3;

/// How old the measurements of a system are, and how old they may be.
pub(super) struct SampleAge {
    pub(super) to: Option<Timestamp>,
    pub(super) stale_after: Duration,
    pub(super) now: Timestamp,
}

impl SampleAge {
    fn is_too_old(&self) -> bool {
        let longest = SignedDuration::from_millis(self.stale_after.millis());
        self.to.is_none_or(|to| self.now.duration_since(to) > longest)
    }
}

/// Why a system of this status is not to be relied on.
pub(super) fn doubt(
    system: String,
    status: Status,
    since: Option<Timestamp>,
    measured: &SampleAge,
) -> DoubtfulSystem {
    let (lost, measured_to) = (measured.is_too_old(), measured.to);
    let minute = |at: Timestamp| at.strftime("%-d %B %Y %H:%M UTC");
    let why = match (status, lost, measured_to) {
        (Status::Degraded, ..) => Status::CONTRADICTED.to_owned(),
        (_, true, Some(to)) => format!("Nothing was measured since {}.", minute(to)),
        (_, true, None) => "It has no measurements.".to_owned(),
        _ => "It is measured, and no fit was validated for longer than its policy wants.".to_owned(),
    };
    let since = since.filter(|_| status == Status::Stale);
    DoubtfulSystem { system, status, since, measured_to, lost: lost && status == Status::Stale, why }
}

/// What to do: what misleads a controller now, then what is not measured any more, then what saves most, then
/// what waits for a word, then what the gate has refused.
pub(super) fn next_steps(
    doubtful: &[DoubtfulSystem],
    effects: &[MatrixEffect],
    waiting: &[String],
    refused: &[RefusalGroup],
) -> Vec<NightStep> {
    let names = |wanted: &dyn Fn(&DoubtfulSystem) -> bool| -> Vec<String> {
        doubtful.iter().filter(|one| wanted(one)).map(|one| one.system.clone()).collect()
    };
    let degraded = names(&|one| one.status == Status::Degraded);
    let lost = names(&|one| one.lost);
    let mut steps = Vec::new();
    if !degraded.is_empty() {
        let what = format!("Look at {}: forecasts no longer fit what is measured there.", counted(&degraded));
        steps.push(NightStep { what, link: place(&degraded, "fails", "/ui/?health=bad"), systems: degraded });
    }
    if !lost.is_empty() {
        let verb = if lost.len() == 1 { "sends" } else { "send" };
        let what = format!("Find out why {} {verb} no measurements.", counted(&lost));
        steps.push(NightStep { what, link: place(&lost, "data", "/ui/?health=attention"), systems: lost });
    }
    let worthwhile =
        |one: &&MatrixEffect| one.lacking > 0 && one.mean_saving.is_some_and(|s| s >= WORTHWHILE);
    for effect in effects.iter().filter(worthwhile).take(PROPOSED) {
        let what = format!("Add an effect: {}.", effect.sentence);
        let link = format!("/ui/building?effect={}", effect.effect);
        steps.push(NightStep { what, link, systems: Vec::new() });
    }
    if !waiting.is_empty() {
        let what = format!("Say yes or no to the fit of {}: the gate leaves it to you.", counted(waiting));
        let link = place(waiting, "parameters", "/ui/?health=attention");
        steps.push(NightStep { what, link, systems: waiting.to_vec() });
    }
    for group in refused.iter().filter(|group| group.outcome != Outcome::Held.as_str()) {
        let of = if group.systems.len() == 1 { "" } else { " of the first" };
        let what = format!("Look at {}, by {}{of}: {}.", counted(&group.systems), group.rule, group.why);
        let link = place(&group.systems, "parameters", "/ui/?health=attention");
        steps.push(NightStep { what, link, systems: group.systems.clone() });
    }
    steps
}

/// One system by its name, several by their number.
fn counted(systems: &[String]) -> String {
    match systems {
        [one] => one.clone(),
        many => format!("{} systems", many.len()),
    }
}

/// The page of one system, or the list for several.
fn place(systems: &[String], tab: &str, list: &str) -> String {
    match systems {
        [one] => format!("/ui/systems/{one}/{tab}"),
        _ => list.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_misleads_a_controller_comes_before_what_saves() {
        let now: Timestamp = "2026-02-10T06:00:00Z".parse().unwrap();
        let day = |text: &str| text.parse::<Timestamp>().ok();
        let measured = |to: &str| SampleAge { to: day(to), stale_after: Duration::from_hours(72), now };
        let since = day("2026-02-04T00:00:00Z");
        let stale = doubt("room/1".into(), Status::Stale, since, &measured("2026-02-01T00:00:00Z"));
        assert!(
            stale.lost && stale.why == "Nothing was measured since 1 February 2026 00:00 UTC.",
            "{stale:?}"
        );
        let unfitted = doubt("room/2".into(), Status::Stale, None, &measured("2026-02-08T05:00:00Z"));
        assert!(!unfitted.lost);
        let degraded = doubt("room/3".into(), Status::Degraded, None, &measured(""));
        let effect = MatrixEffect {
            effect: "wind_infiltration".into(),
            title: "Wind infiltration".into(),
            lacking: 2,
            in_model: 0,
            not_testable: 0,
            diagnosed: 3,
            mean_saving: Some(0.2),
            total_saving: Some(0.4),
            unit: Some("K".into()),
            sentence: "2 of 3 rooms lack wind infiltration".into(),
        };
        let steps =
            next_steps(&[degraded, stale, unfitted], &[effect], &["room/4".into(), "room/5".into()], &[]);
        let links: Vec<&str> = steps.iter().map(|step| step.link.as_str()).collect();
        assert_eq!(
            links,
            [
                "/ui/systems/room/3/fails",
                "/ui/systems/room/1/data",
                "/ui/building?effect=wind_infiltration",
                "/ui/?health=attention"
            ]
        );
    }
}
