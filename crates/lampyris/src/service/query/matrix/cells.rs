//! What the data of one system say of every effect.

use crate::store::diagnoses::{DiagnosedSystem, NamedFinding, NewestDiagnosis};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::ledger::{CLEAR_T, Ledger, LedgerEntry, ledgers};
use lampyris_core::model::id::family;
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;

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

/// What errors of several outputs are counted in.
pub(super) const OF_SEVERAL: &str = "times the noise";

/// The errors without and with a finding: on data that no decision has seen, where there are some, else on
/// those that decided.
fn unseen(finding: &NamedFinding) -> Option<[f64; 2]> {
    finding.rmse.test.or(finding.rmse.validation)
}

/// What the data say of one member of a family.
struct Member {
    /// What is added to a model.
    id: String,
    /// What people call it, and ledgers: another effect where this is a way of it.
    named: String,
    state: EffectState,
    t: Option<f64>,
    saving: Option<f64>,
    unit: Option<String>,
    why: String,
}

/// What a system's data say of every effect: what its model has, its newest diagnosis, and what its windows
/// show together beside the model that was diagnosed.
fn cells(
    system: &DiagnosedSystem,
    evidence: &[LedgerEntry],
    named: &dyn Fn(&str) -> String,
) -> Vec<MatrixCell> {
    let mut members: Vec<Member> = Vec::new();
    let effects = |model: &str| model.split('+').skip(1).map(str::to_owned).collect::<Vec<_>>();
    for id in effects(&system.model) {
        let why = format!("The model {} has it.", system.model);
        let state = EffectState::InModel;
        members.push(Member { named: named(&id), id, state, t: None, saving: None, unit: None, why });
    }
    if let Some(diagnosis) = &system.diagnosis {
        let beside: Vec<LedgerEntry> =
            evidence.iter().filter(|entry| entry.model == diagnosis.model).cloned().collect();
        let ledgers = ledgers(&beside);
        for member in seen(diagnosis, &ledgers) {
            if !members.iter().any(|known| known.named == member.named) {
                members.push(member);
            }
        }
    }
    let mut families: BTreeMap<String, Vec<Member>> = BTreeMap::new();
    for member in members {
        families.entry(family(&member.named).to_owned()).or_default().push(member);
    }
    families.into_iter().map(|(effect, members)| folded(effect, members)).collect()
}

/// What a diagnosis and the ledgers say of effects, what is said first of an effect counts.
fn seen(diagnosis: &NewestDiagnosis, ledgers: &[Ledger]) -> Vec<Member> {
    let pooled = |effect: &str| ledgers.iter().find(|one| one.effect == effect)?.pooled.as_ref();
    let named = diagnosis.findings.iter().map(|finding| {
        let errors = unseen(finding);
        let named = finding.way_of.as_ref().unwrap_or(&finding.effect);
        let unit = finding.size.as_ref().map(|size| size.unit.clone());
        let why = match errors {
            Some([without, with]) => format!(
                "{} is missing: with it the error on unseen data goes from {without:.2} to {with:.2} {}.",
                finding.title,
                unit.as_deref().unwrap_or(OF_SEVERAL)
            ),
            None => format!("{} is missing.", finding.title),
        };
        Member {
            id: finding.effect.clone(),
            named: named.clone(),
            state: EffectState::Named,
            t: pooled(named).map(|pooled| pooled.t),
            saving: errors.map(|[without, with]| without - with),
            unit,
            why,
        }
    });
    let plain = |id: &str, state, why: &str| Member {
        id: id.to_owned(),
        named: id.to_owned(),
        state,
        t: None,
        saving: None,
        unit: None,
        why: why.to_owned(),
    };
    let shown = ledgers.iter().filter_map(|ledger| {
        let pooled = ledger.pooled.as_ref()?;
        let is_clear = pooled.t >= CLEAR_T && pooled.taken_back.is_none();
        let state = if is_clear { EffectState::Suspected } else { EffectState::Absent };
        let t = Some(pooled.t);
        Some(Member { t, ..plain(&ledger.effect, state, &pooled.sentence) })
    });
    let tried =
        diagnosis.considered.iter().map(|tried| plain(&tried.effect, EffectState::Absent, &tried.why));
    let untried =
        diagnosis.not_testable.iter().map(|one| plain(&one.effect, EffectState::NotTestable, &one.reason));
    let mut all: Vec<Member> = Vec::new();
    for member in named.chain(shown).chain(tried).chain(untried) {
        if !all.iter().any(|known| known.named == member.named) {
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

/// The row of a system. `named` gives what people call an effect of a model.
pub(super) fn row(
    system: DiagnosedSystem,
    evidence: &[LedgerEntry],
    named: &dyn Fn(&str) -> String,
) -> MatrixRow {
    MatrixRow {
        cells: cells(&system, evidence, named),
        diagnosis: system.diagnosis.as_ref().map(|newest| newest.id.clone()),
        diagnosed: system.diagnosis.as_ref().map(|newest| newest.model.clone()),
        created_at: system.diagnosis.as_ref().map(|newest| newest.created_at),
        system: system.system,
        model: system.model,
    }
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
            way_of: None,
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

    /// Of ways that are called `_slow`.
    fn row_of(system: DiagnosedSystem, evidence: &[LedgerEntry]) -> MatrixRow {
        row(system, evidence, &|id| id.trim_end_matches("_slow").to_owned())
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
        let lacking = row_of(system("room/1", "room3", Some([0.6, 0.4])), &evidence);
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
        let grown = row_of(system("room/1", "room3+wind_infiltration", None), &evidence);
        assert_eq!(grown.cells[3].state, EffectState::InModel);
        let unknown = row_of(DiagnosedSystem { diagnosis: None, ..system("room/1", "room3", None) }, &[]);
        assert_eq!((unknown.cells.len(), unknown.diagnosis), (0, None));
    }

    #[test]
    fn a_way_of_an_effect_is_told_as_that_effect() {
        let mut lacking = system("room/1", "room3", Some([0.6, 0.4]));
        let diagnosis = lacking.diagnosis.as_mut().unwrap();
        diagnosis.findings[0].effect = "wind_infiltration_slow".into();
        diagnosis.findings[0].way_of = Some("wind_infiltration".into());
        let row = row_of(lacking, &[entry("wind_infiltration", "room3", 6.0)]);
        let cell = row.cells.iter().find(|cell| cell.effect == "wind_infiltration").unwrap();
        assert_eq!((cell.state, cell.t), (EffectState::Named, Some(6.0)));
        assert_eq!(cell.members, ["wind_infiltration_slow"], "what is added is the way");
        assert!(row.cells.iter().all(|cell| !cell.effect.ends_with("_slow")), "{row:?}");
        let grown = row_of(system("room/1", "room3+wind_infiltration_slow", None), &[]);
        let cell = grown.cells.iter().find(|cell| cell.effect == "wind_infiltration").unwrap();
        assert_eq!(cell.state, EffectState::InModel);
    }
}
