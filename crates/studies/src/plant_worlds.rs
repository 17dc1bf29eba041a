//! What a diagnosis names on synthetic treatment plants whose truth is known.

use super::judged::MATERIAL;
use super::options::Worlds;
use super::row::Row;
use super::verdicts::{judge_all, share, spread};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::diagnose::null_model::NullModel;
use lampyris_core::diagnose::{Adequacy, Diagnosis, diagnose};
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Control, EstimateRequest, Problem, Progress, Site, prepare};
use lampyris_core::model::Catalogue;
use lampyris_core::twin::plant_world::{
    PLANT, PlantTruth, PlantWorldRequest, catalogued, plant_world, strange,
};
use std::sync::Mutex;
use std::time::Instant;

/// Days of a record: fitted, judged, and kept aside to see whether naming an effect helped.
const DAYS: [usize; 3] = [4, 2, 2];
/// Of sixty worlds so many hide nothing, an effect that no catalogue has, and one of the catalogue's.
const SHARES: [u64; 3] = [20, 8, 32];

/// A world and its diagnosis.
struct Judged {
    kind: &'static str,
    truth: PlantTruth,
    diagnosis: Diagnosis,
    /// Error of the free run over the test part, in the noise of the sensors: without anything that was
    /// named, with all of it, and with the truth.
    test: [Option<f64>; 3],
    seconds: f64,
    /// After so many seconds so many were said to be left.
    told: Vec<[f64; 2]>,
}

impl Judged {
    fn material(&self) -> bool {
        matches!(self.test, [Some(without), _, Some(truth)] if truth <= (1.0 - MATERIAL) * without)
    }

    fn right(&self) -> bool {
        let Some(finding) = self.diagnosis.findings.first() else { return false };
        let group = [&finding.effect].into_iter().chain(&finding.tied_with);
        finding.tied_with.len() <= 1
            && group.into_iter().any(|named| Some(named) == self.truth.effect.as_ref())
    }

    fn named(&self) -> bool {
        !self.diagnosis.findings.is_empty()
    }

    /// Whether the interval of the strength holds the true one, where the effect is the first that was named.
    fn covered(&self) -> Option<bool> {
        let finding = self
            .diagnosis
            .findings
            .first()
            .filter(|finding| Some(&finding.effect) == self.truth.effect.as_ref())?;
        let [low, high] = finding.parameters.values().next()?.ci95?;
        Some((low..=high).contains(&self.truth.strength))
    }
}

/// Diagnoses about so many worlds.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, only, each) = asked.parts();
    let kinds: [Vec<Option<&'static str>>; 3] =
        [vec![None], strange().map(Some).collect(), catalogued().map(Some).collect()];
    let total: u64 = SHARES.iter().sum();
    let wanted = kinds
        .iter()
        .zip(SHARES)
        .flat_map(|(kinds, share)| kinds.iter().cycle().take((worlds * share).div_ceil(total) as usize));
    let mut requests: Vec<PlantWorldRequest> = wanted
        .zip(first * 1_000_000..)
        .map(|(effect, seed)| PlantWorldRequest { seed, effect: *effect, days: DAYS.iter().sum() })
        .collect();
    requests.retain(|request| only.is_none_or(|only| request.effect.unwrap_or("none").contains(only)));
    Ok(rows(&judge_all(&requests, judge, each.then_some(line))?))
}

fn problem(catalogue: &Catalogue, window: &Window, model: &str) -> Result<Problem, Failure> {
    let text = |found: &dyn std::fmt::Display| Failure::Error(found.to_string());
    let [train, validation, test] = DAYS.map(|days| format!("P{days}D"));
    let request: EstimateRequest = serde_json::from_value(
        serde_json::json!({"split": {"train": train, "validation": validation, "test": test}}),
    )
    .map_err(|error| text(&error))?;
    let id = model.parse().map_err(|error| text(&error))?;
    prepare(catalogue, &id, &request, window, &Site::default()).map_err(|found| faults(&found))
}

/// One world: made, diagnosed from the values of the model's document.
fn judge(request: &PlantWorldRequest) -> Result<Judged, Failure> {
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let world = plant_world(&catalogue, request).map_err(|found| faults(&found))?;
    let (window, _) =
        Window::parse_csv(&world.csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
    let base = problem(&catalogue, &window, PLANT)?;
    let theta = base.nominal().to_vec();
    let (diagnosis, seconds, told) = diagnosed(&catalogue, &base, &theta, &window)?;
    let named = |place: usize| -> Option<f64> {
        let findings = &diagnosis.findings;
        let finding = if place == 0 { findings.first() } else { findings.last() }?;
        Some(finding.rmse.test?[place])
    };
    let without = named(0).or_else(|| {
        Some(NullModel::settle(base.clone(), &theta, None, &|| false)?.measured.plain[2]?.sqrt())
    });
    let truth = match &world.truth.effect {
        Some(effect) if world.truth.in_catalogue => {
            let informed = problem(&catalogue, &window, &format!("{PLANT}+{effect}"))?;
            let values = &world.truth.values;
            let value = |name: &str| {
                values.iter().find(|(known, _)| known == name).map_or(f64::NAN, |(_, value)| *value)
            };
            let theta: Vec<f64> =
                informed.model().parameters().iter().map(|parameter| value(&parameter.name)).collect();
            informed.free_run_error(&informed.simulate(&theta), informed.split().test.clone())
        }
        _ => None,
    };
    let test = [without, named(1), truth];
    Ok(Judged { kind: request.effect.unwrap_or("none"), truth: world.truth, diagnosis, test, seconds, told })
}

/// A diagnosis, the seconds that it took, and the time left that it told on its way: when, and how much.
fn diagnosed(
    catalogue: &Catalogue,
    base: &Problem,
    theta: &[f64],
    window: &Window,
) -> Result<(Diagnosis, f64, Vec<[f64; 2]>), Failure> {
    let begun = Instant::now();
    let told: Mutex<Vec<[f64; 2]>> = Mutex::default();
    let note = |progress: &Progress| {
        let share = progress.trials.as_ref().and_then(|trials| trials.share);
        let elapsed = begun.elapsed().as_secs_f64();
        if let (Some(share), Ok(mut told)) = (share, told.lock()) {
            told.push([elapsed, elapsed * (1.0 - share) / share]);
        }
    };
    let control = Control { progress: &note, ..Control::NONE };
    let diagnosis =
        diagnose(catalogue, base, theta, window, &Site::default(), AccusationRate::default(), &[], &control)
            .map_err(|error| Failure::Error(error.to_string()))?;
    let seconds = begun.elapsed().as_secs_f64();
    Ok((diagnosis, seconds, told.into_inner().unwrap_or_default()))
}

fn rows(judged: &[Judged]) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut kinds: Vec<&str> = judged.iter().map(|one| one.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    for kind in kinds {
        let worlds: Vec<&Judged> = judged.iter().filter(|one| one.kind == kind).collect();
        let count = |test: &dyn Fn(&Judged) -> bool| worlds.iter().filter(|one| test(one)).count();
        let what = format!(
            "plant {kind}: {} material; right {}, something else {}, nothing {} of",
            count(&Judged::material),
            count(&Judged::right),
            count(&|one| one.named() && !one.right()),
            count(&|one| !one.named())
        );
        rows.push(Row::new(what, worlds.len() as f64, "worlds"));
    }
    let these =
        |keep: &dyn Fn(&Judged) -> bool| -> Vec<&Judged> { judged.iter().filter(|one| keep(one)).collect() };
    let none = these(&|one| one.truth.effect.is_none());
    let foreign = these(&|one| one.truth.effect.is_some() && !one.truth.in_catalogue);
    let material = these(&|one| one.truth.in_catalogue && one.material());
    let falls = these(&|one| one.named() && one.test[1].is_some());
    let covered = these(&|one| one.covered().is_some());
    let verdict = |verdict: Adequacy| move |one: &&Judged| one.diagnosis.verdict == verdict;
    let goals = [
        share("nothing hidden, something named", &none, |one| one.named()).map(|row| row.at_most(0.0)),
        share("nothing hidden, adequate", &none, verdict(Adequacy::Adequate)),
        share("not in the catalogue, something named", &foreign, |one| one.named())
            .map(|row| row.at_most(0.25)),
        share("not in the catalogue, unknown", &foreign, verdict(Adequacy::Unknown)),
        share("one material effect, right first", &material, |one| one.right()).map(|row| row.at_least(0.93)),
        share("one material effect, wrong first", &material, |one| one.named() && !one.right()),
        share(
            "something named, test error falls",
            &falls,
            |one| matches!(one.test, [Some(before), Some(after), _] if after < before),
        ),
        share("interval of 95 % holds the true strength", &covered, |one| one.covered() == Some(true)),
    ];
    rows.extend(goals.into_iter().flatten());
    // The last moments are no time to wait for.
    let promises = judged
        .iter()
        .flat_map(|one| one.told.iter().map(|[at, left]| [*left, one.seconds - at, 0.05 * one.seconds]));
    let promises: Vec<[f64; 3]> = promises.filter(|[_, really, least]| really >= least).collect();
    rows.extend(share("time left comes true within a factor of two", &promises, |[told, really, _]| {
        (0.5..=2.0).contains(&(told / really))
    }));
    rows.extend(spread(
        "a diagnosis, wall time beside others",
        "s",
        judged.iter().map(|one| one.seconds).collect(),
    ));
    let rounds = judged.iter().flat_map(|one| &one.diagnosis.evaluations).map(|count| *count as f64);
    rows.extend(spread("a round, simulations", "-", rounds.collect()));
    rows
}

fn line(judged: &Judged) -> String {
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let findings = judged.diagnosis.findings.iter().map(|finding| {
        let tied = finding.tied_with.iter().map(|name| format!("~{name}")).collect::<String>();
        format!(
            "{}{tied} dbic {:.0} share {:.2}",
            finding.effect,
            finding.delta_bic,
            number(finding.explained_share)
        )
    });
    let considered = judged.diagnosis.considered.iter().map(|one| {
        let gate = one.gate.map_or_else(String::new, |gate| format!(" {gate:?}"));
        let measures = one.measures.map_or_else(String::new, |measures| {
            format!(
                " fall {:.2} white {:.2} slow {:.0}",
                number(measures.fall),
                number(measures.white_share),
                number(measures.slow_delta_bic)
            )
        });
        format!(
            "{} dbic {:.0} share {:.2}{measures}{gate}",
            one.effect,
            number(one.delta_bic),
            number(one.explained_share)
        )
    });
    let blind = judged.diagnosis.not_testable.iter().map(|one| format!("{}: {}", one.effect, one.reason));
    let [without, with, truth] = judged.test.map(number);
    format!(
        "{} seed {}{}{} strength {:.2} test {without:.2} named {with:.2} truth {truth:.2} rho {:.2} NAMED {} \
        CONSIDERED {} BLIND {} simulations {:?} {:.0} s",
        judged.kind,
        judged.truth.seed,
        if judged.material() { " material" } else { "" },
        if judged.right() { " RIGHT" } else { "" },
        judged.truth.strength,
        number(judged.diagnosis.rho),
        findings.collect::<Vec<_>>().join("; "),
        considered.collect::<Vec<_>>().join(" | "),
        blind.collect::<Vec<_>>().join(" | "),
        judged.diagnosis.evaluations,
        judged.seconds
    )
}
