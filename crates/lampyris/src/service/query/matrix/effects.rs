//! The effects over all systems of a selection: how many lack each, and what adding it saves.

use super::cells::{EffectState, MatrixRow, OF_SEVERAL};
use crate::service::serving::health::uncapitalised;
use lampyris_core::model::Catalogue;
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The kind of systems that people call rooms.
const ROOM: &str = "room";
/// A mean saving below this is none, in the unit of the output.
pub const WORTHWHILE: f64 = 0.005;

/// An effect over all systems that were asked about.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MatrixEffect {
    /// The effect, without the channel that a member of a family has.
    pub effect: String,
    /// A short title for people.
    pub title: String,
    /// How many systems lack it.
    pub lacking: usize,
    /// How many have it in their model.
    pub in_model: usize,
    /// How many cannot show it with their data.
    pub not_testable: usize,
    /// How many systems were diagnosed.
    pub diagnosed: usize,
    /// How much the error on unseen data falls in the mean, where it is added.
    pub mean_saving: Option<f64>,
    /// The same over all systems that lack it.
    pub total_saving: Option<f64>,
    /// The unit of both.
    pub unit: Option<String>,
    /// In a sentence.
    #[schema(example = "11 of 40 rooms lack wind infiltration; adding it saves 0.21 K each on unseen data")]
    pub sentence: String,
}

/// What is counted of an effect, system by system.
#[derive(Debug, Default)]
struct EffectCount {
    lacking: usize,
    in_model: usize,
    not_testable: usize,
    savings: Vec<(f64, Option<String>)>,
}

/// What is counted of all systems.
#[derive(Debug, Default)]
pub(super) struct Tally {
    diagnosed: usize,
    others: bool,
    effects: BTreeMap<String, EffectCount>,
}

impl Tally {
    /// Counts what is said of a system that somebody has diagnosed.
    pub(super) fn add(&mut self, row: &MatrixRow) {
        if row.diagnosis.is_none() {
            return;
        }
        self.others |= row.system.kind() != ROOM;
        self.diagnosed += 1;
        for cell in &row.cells {
            let count = self.effects.entry(cell.effect.clone()).or_default();
            match cell.state {
                EffectState::Named => {
                    count.lacking += 1;
                    if let Some(saving) = cell.saving {
                        count.savings.push((saving, cell.unit.clone()));
                    }
                }
                EffectState::InModel => count.in_model += 1,
                EffectState::NotTestable => count.not_testable += 1,
                EffectState::Suspected | EffectState::Absent => {}
            }
        }
    }

    /// The effects, what saves most first.
    pub(super) fn effects(self, title: impl Fn(&str) -> String) -> Vec<MatrixEffect> {
        let (diagnosed, rooms) = (self.diagnosed, !self.others);
        let mut all: Vec<MatrixEffect> = self
            .effects
            .into_iter()
            .map(|(effect, count)| count.summary(&title(&effect), effect, diagnosed, rooms))
            .collect();
        // What has no unit compares with nothing: it stands behind what has one.
        let weight = |one: &MatrixEffect| (one.total_saving.is_some_and(|_| one.unit.is_some()), one.lacking);
        let saving = |one: &MatrixEffect| one.total_saving.unwrap_or(0.0);
        all.sort_by(|one, other| {
            let (first, second) = (weight(one), weight(other));
            second.0.cmp(&first.0).then(saving(other).total_cmp(&saving(one))).then(second.1.cmp(&first.1))
        });
        all
    }
}

impl EffectCount {
    fn summary(self, title: &str, effect: String, diagnosed: usize, rooms: bool) -> MatrixEffect {
        // Errors of different units are not added.
        let is_one = self.savings.windows(2).all(|pair| pair[0].1 == pair[1].1);
        let unit = self.savings.first().and_then(|(_, unit)| unit.clone()).filter(|_| is_one);
        let total = || self.savings.iter().map(|(saving, _)| saving).sum::<f64>();
        let total_saving = (is_one && !self.savings.is_empty()).then(total);
        let mean_saving = total_saving.map(|total| total / self.savings.len() as f64);
        let sentence = sentence(title, self.lacking, diagnosed, rooms, mean_saving, unit.as_deref());
        MatrixEffect {
            effect,
            title: title.to_owned(),
            lacking: self.lacking,
            in_model: self.in_model,
            not_testable: self.not_testable,
            diagnosed,
            mean_saving,
            total_saving,
            unit,
            sentence,
        }
    }
}

/// `11 of 40 rooms lack wind infiltration; adding it saves 0.21 K each on unseen data`.
fn sentence(
    title: &str,
    lacking: usize,
    diagnosed: usize,
    rooms: bool,
    mean_saving: Option<f64>,
    unit: Option<&str>,
) -> String {
    let noun = match (rooms, diagnosed) {
        (true, 1) => "room",
        (true, _) => "rooms",
        (false, 1) => "system",
        (false, _) => "systems",
    };
    let name = uncapitalised(title);
    if lacking == 0 {
        return format!("none of {diagnosed} {noun} lacks {name}");
    }
    let (verb, each) = if lacking == 1 { ("lacks", "") } else { ("lack", " each") };
    let unit = unit.unwrap_or(OF_SEVERAL);
    let worth = match mean_saving {
        Some(saving) if saving >= WORTHWHILE => {
            format!("; adding it saves {saving:.2} {unit}{each} on unseen data")
        }
        Some(_) => "; adding it leaves the error of a free run on unseen data as it is".to_owned(),
        None => String::new(),
    };
    format!("{lacking} of {diagnosed} {noun} {verb} {name}{worth}")
}

/// The title of an effect, its id where nobody knows it any more.
pub(super) fn title(catalogue: &Catalogue, effect: &str) -> String {
    let known = catalogue.effect_document(effect);
    known.map_or_else(|| effect.replace('_', " "), |known| of_any_member(&known.title))
}

/// The title of a family without what names a member: `Metered gain` of `Metered gain {channel}`.
fn of_any_member(title: &str) -> String {
    let Some((before, _)) = title.split_once('{') else { return title.to_owned() };
    let words: Vec<&str> = before.trim().trim_end_matches(',').split(' ').collect();
    let open =
        words.iter().rposition(|word| !["to", "from", "with", "the"].contains(word)).map_or(0, |at| at + 1);
    let left = if open < words.len() { " …" } else { "" };
    format!("{}{left}", words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::super::cells::MatrixCell;
    use super::*;

    fn row(system: &str, diagnosis: Option<&str>, cells: &[(&str, EffectState, Option<f64>)]) -> MatrixRow {
        let cell = |(effect, state, saving): &(&str, EffectState, Option<f64>)| MatrixCell {
            effect: (*effect).to_owned(),
            state: *state,
            members: Vec::new(),
            t: None,
            saving: *saving,
            unit: saving.map(|_| if system.starts_with("room") { "K" } else { "g/m3" }.to_owned()),
            why: String::new(),
        };
        MatrixRow {
            system: system.parse().unwrap(),
            model: "rc2".into(),
            diagnosis: diagnosis.map(str::to_owned),
            diagnosed: None,
            created_at: None,
            cells: cells.iter().map(cell).collect(),
        }
    }

    #[test]
    fn effects_are_summed_over_rooms_and_the_dearest_comes_first() {
        let mut tally = Tally::default();
        let sun = ("solar_gain", EffectState::NotTestable, None);
        let lag = ("sensor_lag", EffectState::Named, Some(0.05));
        let wind = |saving| ("wind_infiltration", EffectState::Named, Some(saving));
        tally.add(&row("room/1", Some("dia_1"), &[sun, lag, wind(0.2)]));
        tally.add(&row("room/2", Some("dia_2"), &[sun, wind(0.1)]));
        tally.add(&row("room/3", Some("dia_3"), &[sun, ("wind_infiltration", EffectState::InModel, None)]));
        tally.add(&row("room/4", None, &[wind(9.0)]));
        let effects = tally.effects(|effect| effect.replace('_', " "));
        let names: Vec<&str> = effects.iter().map(|one| one.effect.as_str()).collect();
        assert_eq!(names, ["wind_infiltration", "sensor_lag", "solar_gain"]);
        let first = &effects[0];
        assert_eq!((first.lacking, first.in_model, first.diagnosed), (2, 1, 3));
        assert_eq!(
            first.sentence,
            "2 of 3 rooms lack wind infiltration; adding it saves 0.15 K each on unseen data"
        );
        assert!((first.total_saving.unwrap() - 0.3).abs() < 1e-12);
        assert_eq!(
            (effects[2].not_testable, effects[2].sentence.as_str()),
            (3, "none of 3 rooms lacks solar gain")
        );
    }

    #[test]
    fn errors_of_different_units_are_not_added() {
        let mut tally = Tally::default();
        tally.add(&row("room/1", Some("dia_1"), &[("sensor_lag", EffectState::Named, Some(0.2))]));
        tally.add(&row("plant/1", Some("dia_2"), &[("sensor_lag", EffectState::Named, Some(7.0))]));
        let effects = tally.effects(str::to_owned);
        assert_eq!((effects[0].total_saving, effects[0].unit.as_ref()), (None, None));
        assert_eq!(effects[0].sentence, "2 of 2 systems lack sensor_lag");
    }

    #[test]
    fn sentences_count_and_leave_abbreviations_alone() {
        let of = |title, lacking, saving| sentence(title, lacking, 4, false, saving, Some("K"));
        assert_eq!(of("CO2 from people", 1, None), "1 of 4 systems lacks CO2 from people");
        let said = of("Sensor lag", 2, Some(-0.1));
        assert!(
            said.ends_with("; adding it leaves the error of a free run on unseen data as it is"),
            "{said}"
        );
        assert_eq!(of_any_member("Metered gain {channel}"), "Metered gain");
        assert_eq!(of_any_member("Night set-back, {start} to {end} h"), "Night set-back");
        assert_eq!(of_any_member("Sun from the {facade}"), "Sun from the …");
    }
}
