//! Worlds with hidden effects, one folder each under `hidden/`: what is hidden, and what a diagnosis says of
//! it.

use lampyris_core::data::{ColumnBindings, SplitRequest, Window};
use lampyris_core::diagnose::{Adequacy, Diagnosis, diagnose};
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Control, EstimateRequest, Site, estimate, prepare};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::model::{Catalogue, ModelId};
use lampyris_core::twin::{Level, WorldRequest, world};
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A folder's `case.toml`. The model is `room3`, or that of a `model.toml` beside it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    /// Fixes the world.
    seed: u64,
    level: Distance,
    /// What the twin hides.
    effects: Vec<String>,
    /// The answer.
    expect: Answer,
    /// What has to be named, the first one first; a tie that holds it counts.
    #[serde(default)]
    named: Vec<String>,
    /// Columns that get another name and no known meaning.
    #[serde(default)]
    rename: BTreeMap<String, String>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Distance {
    Matched,
    Rich,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Answer {
    /// The effects of `named` are missing.
    Named,
    /// Nothing is missing.
    Adequate,
    /// Something is missing that no effect explains.
    Unknown,
    /// Physics hides the effect: nothing is named, the truth in hand would not help, and the model is
    /// adequate.
    NotDetectable,
}

fn folders() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases/hidden");
    let mut folders: Vec<PathBuf> =
        std::fs::read_dir(root).unwrap().map(|entry| entry.unwrap().path()).collect();
    folders.sort();
    folders
}

fn case(folder: &Path) -> Case {
    let text = std::fs::read_to_string(folder.join("case.toml")).unwrap();
    toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
}

/// The diagnosis of a case, and the test error with the true effects beside that without, where they are
/// known.
fn run(folder: &Path, case: &Case) -> (Diagnosis, Option<[f64; 2]>) {
    let level = match case.level {
        Distance::Matched => Level::Matched,
        Distance::Rich => Level::Rich,
    };
    let effects: Vec<&str> = case.effects.iter().map(String::as_str).collect();
    let made = world(&WorldRequest::new(case.seed, &effects, level)).unwrap();
    let (head, rows) = made.csv.split_once('\n').unwrap();
    let names = head.split(',').map(|name| case.rename.get(name).map_or(name, String::as_str));
    let csv = format!("{}\n{rows}", names.collect::<Vec<_>>().join(","));
    let (window, _) = Window::parse_csv(&csv, &ColumnBindings::none()).unwrap();
    let mut catalogue = Catalogue::builtin().unwrap();
    let mut model: ModelId = "room3".parse().unwrap();
    if let Ok(text) = std::fs::read_to_string(folder.join("model.toml")) {
        let document = ModelDocument::from_toml(&text).unwrap();
        model = document.id().parse().unwrap();
        catalogue.add_model(document);
    }
    let site = Site { sets: [("neighbours".to_owned(), made.neighbours)].into(), ..Site::default() };
    let asked = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
    let fitted = |id: &ModelId| {
        let problem = prepare(&catalogue, id, &asked, &window, &site).unwrap();
        let fit = estimate(&problem, &asked, None, &Control::NONE).unwrap();
        (problem.with_substeps(fit.substeps), fit)
    };
    let (problem, fit) = fitted(&model);
    let found = diagnose(
        &catalogue,
        &problem,
        &fit.theta(),
        &window,
        &site,
        AccusationRate::USUAL,
        &[],
        &Control::NONE,
    )
    .unwrap();
    let errors = (case.expect == Answer::NotDetectable).then(|| {
        let truth = made.truth.effects.iter().fold(model, |model, hidden| model.plus(&hidden.effect));
        let test = |fit: &lampyris_core::estimate::Fit| fit.first_metrics().unwrap().test_rmse.unwrap();
        [test(&fit), test(&fitted(&truth).1)]
    });
    (found, errors)
}

/// What is wrong with an answer.
fn wrong(case: &Case, found: &Diagnosis, errors: Option<[f64; 2]>) -> Option<String> {
    let named: Vec<&str> = found.findings.iter().map(|finding| finding.effect.as_str()).collect();
    let verdict = match case.expect {
        Answer::Named => Adequacy::Named,
        Answer::Unknown => Adequacy::Unknown,
        Answer::Adequate | Answer::NotDetectable => Adequacy::Adequate,
    };
    if found.verdict != verdict {
        return Some(format!("{:?}: named {named:?}, rho {:?}", found.verdict, found.rho));
    }
    if case.expect == Answer::Named {
        let holds = |finding: &lampyris_core::diagnose::Finding, name: &String| {
            finding.effect == *name || finding.tied_with.contains(name)
        };
        if case.named.is_empty() || !holds(&found.findings[0], &case.named[0]) {
            return Some(format!("the first of {named:?} is not {:?}", case.named.first()));
        }
        if let Some(missed) =
            case.named.iter().find(|name| !found.findings.iter().any(|finding| holds(finding, name)))
        {
            return Some(format!("{missed} is missed: {named:?}"));
        }
        let [before, after] = [found.findings.first(), found.findings.last()]
            .map(|finding| finding.unwrap().rmse.test.unwrap());
        if after[1] >= before[0] {
            return Some(format!("the error on the test part does not fall: {} {}", before[0], after[1]));
        }
    }
    errors
        .filter(|[without, with]| *with < 0.9 * without)
        .map(|[without, with]| format!("the truth would show: {without} {with}"))
}

#[test]
fn every_folder_with_a_hidden_effect_gets_its_answer() {
    let folders = folders();
    assert!(folders.len() >= 24, "{}", folders.len());
    let wrong: Vec<String> = folders
        .par_iter()
        .filter_map(|folder| {
            let case = case(folder);
            let (found, errors) = run(folder, &case);
            let name = folder.file_name().unwrap().to_string_lossy().into_owned();
            println!("{name}: {}", found.summary);
            wrong(&case, &found, errors).map(|wrong| format!("{name}: {wrong}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn every_effect_of_the_catalogue_has_a_folder() {
    let cases: Vec<Case> = folders().iter().map(|folder| case(folder)).collect();
    let family = |name: &String| name.split(':').next().unwrap_or_default().to_owned();
    let shown: Vec<String> =
        cases.iter().flat_map(|case| case.named.iter().chain(&case.effects)).map(family).collect();
    let catalogue = Catalogue::builtin().unwrap();
    // Those of treatment plants, which replace names or have other sensors, are no question to a room.
    let of_room = |effect: &&EffectSpec| {
        effect.way_of.is_none()
            && effect.replace.is_empty()
            && effect.outputs.keys().all(|channel| channel == "T_room")
    };
    let of_rooms = catalogue.effects().filter(of_room).map(|effect| effect.id.as_str());
    // No twin has an emitter that its model does not know; a measured dwelling has (`withheld`).
    let measured = ["heat_emitter"];
    let without: Vec<&str> =
        of_rooms.filter(|id| !measured.contains(id) && !shown.iter().any(|name| name == id)).collect();
    assert!(without.is_empty(), "{without:?}");
    for answer in [Answer::Named, Answer::Adequate, Answer::Unknown, Answer::NotDetectable] {
        assert!(cases.iter().any(|case| case.expect == answer), "{answer:?}");
    }
    assert!(cases.iter().any(|case| case.effects.len() == 2), "a pair");
}
