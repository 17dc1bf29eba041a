//! Which rooms lack which effects: every system beside every effect, from its newest diagnosis and from what
//! its windows show together.

use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::diagnoses::{DiagnosedSystem, NamedFinding, NewestDiagnosis};
use crate::store::reach::SystemScope;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::ledger::{CLEAR_T, Ledger, LedgerEntry, ledgers};
use lampyris_core::model::Catalogue;
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};
use utoipa::ToSchema;

/// Systems that are read at a time where all are asked for.
const AT_ONCE: i64 = 200;
/// The kind of systems that people call rooms.
const ROOM: &str = "room";

/// What a system's data say of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EffectState {
    /// The newest diagnosis names it as missing.
    Named,
    /// The model has it.
    InModel,
    /// It was not named, and its windows together show more than chance.
    Suspected,
    /// It was looked for, and these data do not show it.
    Absent,
    /// These data cannot show it. Silence is not absence.
    NotTestable,
}

/// What a system's data say of an effect, or of a family of effects with one member per channel.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MatrixCell {
    /// The effect, without the channel that a member of a family has.
    pub effect: String,
    /// What the data say of the member that they say most of.
    pub state: EffectState,
    /// The members of which this is said, as they are added to a model.
    pub members: Vec<String>,
    /// The pooled t of the windows beside the diagnosed model; `null` where it was not looked at.
    pub t: Option<f64>,
    /// How much the error on unseen data falls where it is added, as the diagnosis has measured it; `null`
    /// where it is not named.
    pub saving: Option<f64>,
    /// The unit of the saving; `null` where errors of several outputs are taken together.
    pub unit: Option<String>,
    /// In a sentence.
    pub why: String,
}

/// What a system's data say of all effects.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MatrixRow {
    /// The system.
    pub system: SystemId,
    /// The model whose fits are served now.
    pub model: String,
    /// The newest diagnosis; `null` where nobody has looked yet.
    pub diagnosis: Option<String>,
    /// The model that it looked at.
    pub diagnosed: Option<String>,
    /// When it was made.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub created_at: Option<Timestamp>,
    /// What is known of each effect; one of which nothing is known has no entry.
    pub cells: Vec<MatrixCell>,
}

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

/// The effect of an id, without the channel that a member of a family has.
fn family(effect: &str) -> &str {
    effect.split(':').next().unwrap_or(effect)
}

/// The errors without and with a finding: on data that no decision has seen, where there are some, else on
/// those that decided.
fn unseen(finding: &NamedFinding) -> Option<[f64; 2]> {
    finding.rmse.test.or(finding.rmse.validation)
}

/// What the data say of one member of a family.
struct Member {
    id: String,
    state: EffectState,
    t: Option<f64>,
    saving: Option<f64>,
    unit: Option<String>,
    why: String,
}

/// What a system's data say of every effect: what its model has, its newest diagnosis, and what its windows
/// show together beside the model that was diagnosed.
fn cells(system: &DiagnosedSystem, evidence: &[LedgerEntry]) -> Vec<MatrixCell> {
    let mut members: Vec<Member> = Vec::new();
    let effects = |model: &str| model.split('+').skip(1).map(str::to_owned).collect::<Vec<_>>();
    for id in effects(&system.model) {
        let why = format!("The model {} has it.", system.model);
        members.push(Member { id, state: EffectState::InModel, t: None, saving: None, unit: None, why });
    }
    if let Some(diagnosis) = &system.diagnosis {
        let beside: Vec<LedgerEntry> =
            evidence.iter().filter(|entry| entry.model == diagnosis.model).cloned().collect();
        let ledgers = ledgers(&beside);
        for member in seen(diagnosis, &ledgers) {
            if !members.iter().any(|known| known.id == member.id) {
                members.push(member);
            }
        }
    }
    let mut families: BTreeMap<String, Vec<Member>> = BTreeMap::new();
    for member in members {
        families.entry(family(&member.id).to_owned()).or_default().push(member);
    }
    families.into_iter().map(|(effect, members)| folded(effect, members)).collect()
}

/// What a diagnosis and the ledgers say of effects, what is said first of an effect counts.
fn seen(diagnosis: &NewestDiagnosis, ledgers: &[Ledger]) -> Vec<Member> {
    let pooled = |effect: &str| ledgers.iter().find(|one| one.effect == effect)?.pooled.as_ref();
    let named = diagnosis.findings.iter().map(|finding| {
        let errors = unseen(finding);
        let unit = finding.size.as_ref().map(|size| size.unit.clone());
        let why = match errors {
            Some([without, with]) => format!(
                "{} is missing: with it the error on unseen data goes from {without:.2} to {with:.2}{}.",
                finding.title,
                unit.as_ref().map(|unit| format!(" {unit}")).unwrap_or_default()
            ),
            None => format!("{} is missing.", finding.title),
        };
        Member {
            id: finding.effect.clone(),
            state: EffectState::Named,
            t: pooled(&finding.effect).map(|pooled| pooled.t),
            saving: errors.map(|[without, with]| without - with),
            unit,
            why,
        }
    });
    let shown = ledgers.iter().filter_map(|ledger| {
        let pooled = ledger.pooled.as_ref()?;
        let is_clear = pooled.t >= CLEAR_T && pooled.taken_back.is_none();
        let state = if is_clear { EffectState::Suspected } else { EffectState::Absent };
        let (t, why) = (Some(pooled.t), pooled.sentence.clone());
        Some(Member { id: ledger.effect.clone(), state, t, saving: None, unit: None, why })
    });
    let plain = |id: &str, state, why: &str| Member {
        id: id.to_owned(),
        state,
        t: None,
        saving: None,
        unit: None,
        why: why.to_owned(),
    };
    let tried =
        diagnosis.considered.iter().map(|tried| plain(&tried.effect, EffectState::Absent, &tried.why));
    let untried =
        diagnosis.not_testable.iter().map(|one| plain(&one.effect, EffectState::NotTestable, &one.reason));
    let mut all: Vec<Member> = Vec::new();
    for member in named.chain(shown).chain(tried).chain(untried) {
        if !all.iter().any(|known| known.id == member.id) {
            all.push(member);
        }
    }
    all
}

/// A family as the member speaks of which most is said; what its members save adds up.
fn folded(effect: String, members: Vec<Member>) -> MatrixCell {
    let state = members.iter().map(|member| member.state).min().unwrap_or(EffectState::NotTestable);
    let mut of_state: Vec<Member> = members.into_iter().filter(|member| member.state == state).collect();
    of_state.sort_by(|one, other| other.t.unwrap_or(0.0).total_cmp(&one.t.unwrap_or(0.0)));
    MatrixCell {
        effect,
        state,
        t: of_state.iter().filter_map(|member| member.t).reduce(f64::max),
        saving: of_state.iter().filter_map(|member| member.saving).reduce(|sum, saving| sum + saving),
        unit: of_state.iter().find_map(|member| member.unit.clone()),
        why: of_state.iter().map(|member| member.why.as_str()).collect::<Vec<_>>().join(" "),
        members: of_state.into_iter().map(|member| member.id).collect(),
    }
}

fn row(system: DiagnosedSystem, evidence: &[LedgerEntry]) -> MatrixRow {
    MatrixRow {
        cells: cells(&system, evidence),
        diagnosis: system.diagnosis.as_ref().map(|newest| newest.id.clone()),
        diagnosed: system.diagnosis.as_ref().map(|newest| newest.model.clone()),
        created_at: system.diagnosis.as_ref().map(|newest| newest.created_at),
        system: system.system,
        model: system.model,
    }
}

/// What is counted of an effect, system by system.
#[derive(Debug, Default)]
struct EffectCount {
    lacking: usize,
    in_model: usize,
    not_testable: usize,
    savings: Vec<f64>,
    units: Vec<Option<String>>,
}

/// What is counted of all systems.
#[derive(Debug, Default)]
struct Tally {
    diagnosed: usize,
    rooms_alone: bool,
    effects: BTreeMap<String, EffectCount>,
}

impl Tally {
    fn add(&mut self, row: &MatrixRow) {
        if row.diagnosis.is_none() {
            return;
        }
        self.rooms_alone = row.system.kind() == ROOM && (self.rooms_alone || self.diagnosed == 0);
        self.diagnosed += 1;
        for cell in &row.cells {
            let count = self.effects.entry(cell.effect.clone()).or_default();
            match cell.state {
                EffectState::Named => {
                    count.lacking += 1;
                    if let Some(saving) = cell.saving {
                        count.savings.push(saving);
                        count.units.push(cell.unit.clone());
                    }
                }
                EffectState::InModel => count.in_model += 1,
                EffectState::NotTestable => count.not_testable += 1,
                EffectState::Suspected | EffectState::Absent => {}
            }
        }
    }

    /// The effects, what saves most first.
    fn effects(self, title: impl Fn(&str) -> String) -> Vec<MatrixEffect> {
        let (diagnosed, rooms) = (self.diagnosed, self.rooms_alone);
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
        let is_one = self.units.windows(2).all(|pair| pair[0] == pair[1]);
        let unit = self.units.first().cloned().flatten().filter(|_| is_one);
        let total_saving = (is_one && !self.savings.is_empty()).then(|| self.savings.iter().sum::<f64>());
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
    let name = in_a_sentence(title);
    if lacking == 0 {
        return format!("none of {diagnosed} {noun} lacks {name}");
    }
    let (verb, each) = if lacking == 1 { ("lacks", "") } else { ("lack", " each") };
    let unit = unit.map(|unit| format!(" {unit}")).unwrap_or_default();
    let worth = match mean_saving {
        Some(saving) if saving >= 0.005 => {
            format!("; adding it saves {saving:.2}{unit}{each} on unseen data")
        }
        Some(_) => "; adding it leaves the error of a free run on unseen data as it is".to_owned(),
        None => String::new(),
    };
    format!("{lacking} of {diagnosed} {noun} {verb} {name}{worth}")
}

/// A title within a sentence: a first letter that stands for no abbreviation is small.
fn in_a_sentence(title: &str) -> String {
    let mut letters = title.chars();
    match (letters.next(), letters.clone().next()) {
        (Some(first), Some(second)) if !second.is_uppercase() => {
            first.to_lowercase().chain(letters).collect()
        }
        _ => title.to_owned(),
    }
}

/// The title of an effect, its id where nobody knows it any more.
fn title(catalogue: &Catalogue, effect: &str) -> String {
    let known = catalogue.effects().find(|known| known.id == effect);
    known.map_or_else(|| effect.replace('_', " "), |known| of_any_member(&known.title))
}

/// The title of a family without what names a member: `Metered gain` of `Metered gain {channel}`.
fn of_any_member(title: &str) -> String {
    let Some((before, _)) = title.split_once('{') else { return title.to_owned() };
    let words: Vec<&str> = before.trim().trim_end_matches(',').split(' ').collect();
    let open = words.iter().rposition(|word| !["to", "from", "with", "the"].contains(word)).map_or(0, |at| at + 1);
    let left = if open < words.len() { " …" } else { "" };
    format!("{}{left}", words.join(" "))
}

/// One page of the rows of some systems: those that come after a name, with one more than fit.
///
/// # Errors
/// Where the database fails.
pub async fn rows(
    service: &Service,
    scopes: (&SystemScope, &SystemScope),
    after: &str,
    limit: i64,
) -> Result<Vec<MatrixRow>, ServiceError> {
    let systems = store::diagnoses::newest(&service.store, scopes, after, limit).await?;
    let names: Vec<String> = systems.iter().map(|one| one.system.to_string()).collect();
    let evidence = store::evidence::of_many(&service.store, &names).await?;
    blocking(move || all_rows(systems, &evidence)).await
}

fn all_rows(systems: Vec<DiagnosedSystem>, evidence: &HashMap<String, Vec<LedgerEntry>>) -> Vec<MatrixRow> {
    let known = |system: &SystemId| evidence.get(&system.to_string()).map_or(&[][..], Vec::as_slice);
    systems
        .into_iter()
        .map(|system| {
            let entries = known(&system.system);
            row(system, entries)
        })
        .collect()
}

/// What is known of each effect over all systems of a selection, what saves most first.
///
/// # Errors
/// Where the database fails.
pub async fn effects(
    service: &Service,
    scopes: (&SystemScope, &SystemScope),
) -> Result<Vec<MatrixEffect>, ServiceError> {
    let (mut tally, mut after) = (Tally::default(), String::new());
    loop {
        let systems = store::diagnoses::newest(&service.store, scopes, &after, AT_ONCE).await?;
        let Some(last) = systems.last().map(|one| one.system.to_string()) else { break };
        // What windows show together decides nothing that is counted here.
        let rows = blocking(move || all_rows(systems, &HashMap::new())).await?;
        rows.iter().for_each(|row| tally.add(row));
        after = last;
    }
    let catalogue = service.catalogue.current();
    Ok(tally.effects(|effect| title(&catalogue, effect)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::diagnoses::{SizeUnit, TriedEffect, UnseenPairs};
    use lampyris_core::diagnose::ledger::{EffectScore, LookedSpan};
    use lampyris_core::diagnose::library::NotTestable;

    fn entry(effect: &str, model: &str, t: f64) -> LedgerEntry {
        let unit = "K/h".to_owned();
        LedgerEntry {
            diagnosis: "dia_1".into(),
            model: model.into(),
            model_hash: None,
            span: LookedSpan { from: 0, to: 1_000_000, hours: 12.0 },
            score: EffectScore {
                effect: effect.into(),
                size: t,
                deviation: 1.0,
                unit,
                share: 0.1,
                t,
                beyond_clock: t,
                days: 14,
                shift_p: None,
            },
        }
    }

    fn system(name: &str, model: &str, test: Option<[f64; 2]>) -> DiagnosedSystem {
        let finding = |effect: &str, test| NamedFinding {
            effect: effect.into(),
            title: "Wind infiltration".into(),
            rmse: UnseenPairs { validation: Some([0.9, 0.1]), test },
            size: Some(SizeUnit { unit: "K".into() }),
        };
        let tried = |effect: &str| TriedEffect { effect: effect.into(), why: "it gains too little".into() };
        DiagnosedSystem {
            system: name.parse().unwrap(),
            model: model.into(),
            diagnosis: Some(NewestDiagnosis {
                id: "dia_1".into(),
                model: "room3".into(),
                findings: vec![finding("wind_infiltration", test)],
                considered: vec![tried("wind_infiltration"), tried("sensor_lag"), tried("metered_gain:P1")],
                not_testable: vec![NotTestable { effect: "solar_gain".into(), reason: "no sun".into() }],
                created_at: Timestamp::UNIX_EPOCH,
            }),
        }
    }

    fn states(row: &MatrixRow) -> Vec<(&str, EffectState)> {
        row.cells.iter().map(|cell| (cell.effect.as_str(), cell.state)).collect()
    }

    #[test]
    fn a_room_says_one_thing_of_each_effect() {
        let evidence = [
            entry("wind_infiltration", "room3", 6.0),
            entry("sensor_lag", "room3", 1.0),
            entry("metered_gain:P1", "room3", 1.5),
            entry("metered_gain:P2", "room3", 3.0),
            // Beside another model it says nothing of this one.
            entry("sensor_lag", "room2", 9.0),
        ];
        let lacking = row(system("room/1", "room3", Some([0.6, 0.4])), &evidence);
        assert_eq!(
            states(&lacking),
            [
                ("metered_gain", EffectState::Suspected),
                ("sensor_lag", EffectState::Absent),
                ("solar_gain", EffectState::NotTestable),
                ("wind_infiltration", EffectState::Named),
            ]
        );
        let [meter, _, sun, wind] = &lacking.cells[..] else { panic!("{lacking:?}") };
        assert_eq!((meter.members.as_slice(), meter.t), (&["metered_gain:P2".to_owned()][..], Some(3.0)));
        assert_eq!((sun.why.as_str(), wind.t), ("no sun", Some(6.0)));
        assert!((wind.saving.unwrap() - 0.2).abs() < 1e-12, "what no decision has seen counts: {wind:?}");
        assert!(wind.why.contains("from 0.60 to 0.40 K"), "{}", wind.why);
        // What was added since is no longer lacking.
        let grown = row(system("room/1", "room3+wind_infiltration", None), &evidence);
        assert_eq!(grown.cells[3].state, EffectState::InModel);
        let unknown = row(DiagnosedSystem { diagnosis: None, ..system("room/1", "room3", None) }, &[]);
        assert_eq!((unknown.cells.len(), unknown.diagnosis), (0, None));
    }

    #[test]
    fn effects_are_summed_over_rooms_and_the_dearest_comes_first() {
        let mut tally = Tally::default();
        for (name, model, test) in [
            ("room/1", "room3", Some([0.6, 0.4])),
            ("room/2", "room3", Some([0.6, 0.5])),
            ("room/3", "room3+wind_infiltration", None),
        ] {
            tally.add(&row(system(name, model, test), &[]));
        }
        tally.add(&row(DiagnosedSystem { diagnosis: None, ..system("room/4", "room3", None) }, &[]));
        let effects = tally.effects(|effect| effect.replace('_', " "));
        let first = &effects[0];
        assert_eq!((first.effect.as_str(), first.lacking, first.in_model), ("wind_infiltration", 2, 1));
        assert_eq!(
            first.sentence,
            "2 of 3 rooms lack wind infiltration; adding it saves 0.15 K each on unseen data"
        );
        assert!((first.total_saving.unwrap() - 0.3).abs() < 1e-12);
        let sun = effects.iter().find(|one| one.effect == "solar_gain").unwrap();
        assert_eq!((sun.not_testable, sun.sentence.as_str()), (3, "none of 3 rooms lacks solar gain"));
    }

    #[test]
    fn sentences_count_and_leave_abbreviations_alone() {
        let of = |title, lacking, saving| sentence(title, lacking, 4, false, saving, Some("K"));
        assert_eq!(of("CO2 from people", 1, None), "1 of 4 systems lacks CO2 from people");
        assert_eq!(of_any_member("Metered gain {channel}"), "Metered gain");
        assert_eq!(of_any_member("Night set-back, {start} to {end} h"), "Night set-back");
        assert_eq!(of_any_member("Sun from the {facade}"), "Sun from the …");
        let said = of("Sensor lag", 2, Some(-0.1));
        assert!(said.ends_with("lack sensor lag; adding it leaves the error of a free run on unseen data as it is"));
    }
}
