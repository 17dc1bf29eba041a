//! Twins, plants and measured houses that lack something, one folder each under `diagnoses/`: what a
//! diagnosis says of them.

use super::folders::{case, cases, folder, names};
use super::houses::House;
use lampyris_core::data::{ColumnBindings, SplitRequest, Window};
use lampyris_core::diagnose::{Adequacy, Diagnosis, Finding, diagnose};
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Problem, Site, estimate, prepare};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::model::{Catalogue, ModelId};
use lampyris_core::twin::plant_world::{PLANT, PlantWorldRequest, catalogued, plant_world};
use lampyris_core::twin::{Level, WorldRequest, world};
use serde::Deserialize;
use std::collections::BTreeMap;

/// A folder's `case.toml`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    /// Where the measurements come from.
    data: Data,
    /// The answer.
    expect: Answer,
    /// What has to be named, the first one first; a tie that holds it counts.
    #[serde(default)]
    named: Vec<String>,
    /// The share of the unseen error that the first one leaves at most.
    #[serde(default = "all")]
    falls_to: f64,
}

fn all() -> f64 {
    1.0
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Data {
    Twin(Twin),
    Plant(Plant),
    House(Box<House>),
}

/// A synthetic room. The model is `room3`, or that of a `model.toml` beside the case.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Twin {
    /// Fixes the world.
    seed: u64,
    level: Distance,
    /// What it hides.
    effects: Vec<String>,
    /// Columns that get another name and no known meaning.
    #[serde(default)]
    rename: BTreeMap<String, String>,
}

/// A synthetic plant, seen from the numbers of its document.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plant {
    seed: u64,
    /// What it hides.
    effect: String,
    days: usize,
    /// The effects that may explain it; all of the catalogue where none is said, which takes minutes.
    #[serde(default)]
    offered: Vec<String>,
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

cases!("diagnoses", diagnosed, {
    bathroom
    companion
    constant
    direct_loss
    direct_loss_imitated
    drift
    emitter
    emitter_under_control
    flexhouse
    hourly_house
    lag
    laundry
    metered
    nothing_1
    nothing_rich
    open_door
    pair_window_wind
    people
    pipe_delay
    plant_among_rivals
    setback
    sky
    stove
    sun
    sun_from_the_west
    sun_on_the_walls
    wind
    window
}, full {
    faint_delay
    lag_of_minutes
    laundry_rich
    nothing_2
    pair_metered_sky
    pair_metered_wind
    pair_sun_setback
    pair_wind_setback
    plant_aeration_limit
    plant_rain_infiltration
    plant_toxic_inflow
    stove_rich
});

/// What is asked, before anything is searched.
struct Question {
    catalogue: Catalogue,
    model: ModelId,
    window: Window,
    site: Site,
    asked: EstimateRequest,
}

impl Question {
    fn of(name: &str, data: &Data) -> Option<Self> {
        match data {
            Data::Twin(twin) => Some(Self::of_twin(name, twin)),
            Data::Plant(plant) => Some(Self::of_plant(plant)),
            Data::House(house) => Some(Self {
                catalogue: Catalogue::builtin().unwrap(),
                model: house.model.clone(),
                window: house.window(&house.csv()?),
                site: house.site(),
                asked: house.ask.clone(),
            }),
        }
    }

    fn of_twin(name: &str, twin: &Twin) -> Self {
        let made = world(&twin.request()).unwrap();
        let (head, rows) = made.csv.split_once('\n').unwrap();
        let names = head.split(',').map(|name| twin.rename.get(name).map_or(name, String::as_str));
        let csv = format!("{}\n{rows}", names.collect::<Vec<_>>().join(","));
        let (window, _) = Window::parse_csv(&csv, &ColumnBindings::none()).unwrap();
        let mut catalogue = Catalogue::builtin().unwrap();
        let mut model: ModelId = "room3".parse().unwrap();
        if let Ok(text) = std::fs::read_to_string(folder("diagnoses", name).join("model.toml")) {
            let document = ModelDocument::from_toml(&text).unwrap();
            model = document.id().parse().unwrap();
            catalogue.add_model(document);
        }
        let site = Site { sets: [("neighbours".to_owned(), made.neighbours)].into(), ..Site::default() };
        let asked = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
        Self { catalogue, model, window, site, asked }
    }

    fn of_plant(plant: &Plant) -> Self {
        let catalogue = Catalogue::builtin().unwrap();
        let effect = catalogued().find(|effect| *effect == plant.effect);
        assert!(effect.is_some(), "no plant hides {}", plant.effect);
        let request = PlantWorldRequest { seed: plant.seed, effect, days: plant.days };
        let csv = plant_world(&catalogue, &request).unwrap().csv;
        let (window, _) = Window::parse_csv(&csv, &ColumnBindings::none()).unwrap();
        let asked = super::request("P4D", "P2D", "P0D", 0);
        let catalogue = if plant.offered.is_empty() { catalogue } else { offering(&plant.offered) };
        Self { catalogue, model: PLANT.parse().unwrap(), window, site: Site::default(), asked }
    }

    fn problem(&self, model: &ModelId) -> Problem {
        prepare(&self.catalogue, model, &self.asked, &self.window, &self.site).unwrap()
    }

    /// The problem with a model, at the steps of its fit.
    fn fitted(&self, model: &ModelId) -> (Problem, Fit) {
        let problem = self.problem(model);
        let fit = estimate(&problem, &self.asked, None, &Control::NONE).unwrap();
        (problem.with_substeps(fit.substeps), fit)
    }

    fn diagnosis(&self, problem: &Problem, theta: &[f64]) -> Diagnosis {
        diagnose(
            &self.catalogue,
            problem,
            theta,
            &self.window,
            &self.site,
            AccusationRate::USUAL,
            &[],
            &Control::NONE,
        )
        .unwrap()
    }
}

/// The built-in models, and of the effects only these.
fn offering(effects: &[String]) -> Catalogue {
    let builtin = Catalogue::builtin().unwrap();
    let mut catalogue = Catalogue::default();
    builtin.models().for_each(|model| catalogue.add_model(model.clone()));
    for effect in effects {
        catalogue.add_effect(builtin.effect(effect).unwrap());
    }
    catalogue
}

impl Twin {
    fn request(&self) -> WorldRequest {
        let level = match self.level {
            Distance::Matched => Level::Matched,
            Distance::Rich => Level::Rich,
        };
        let effects: Vec<&str> = self.effects.iter().map(String::as_str).collect();
        WorldRequest::new(self.seed, &effects, level)
    }
}

fn diagnosed(name: &str) {
    let case: Case = case("diagnoses", name);
    let Some(question) = Question::of(name, &case.data) else { return };
    match &case.data {
        Data::Plant(_) => {
            let problem = question.problem(&question.model);
            let found = question.diagnosis(&problem, problem.nominal());
            answered(&case, &found);
            what_is_drawn_says_the_same(&found);
        }
        Data::House(_) => {
            let (problem, fit) = question.fitted(&question.model);
            answered(&case, &question.diagnosis(&problem, &fit.theta()));
        }
        Data::Twin(twin) => {
            let (problem, fit) = question.fitted(&question.model);
            answered(&case, &question.diagnosis(&problem, &fit.theta()));
            if case.expect == Answer::NotDetectable {
                the_truth_would_not_show(&question, twin, &fit);
            }
        }
    }
}

fn answered(case: &Case, found: &Diagnosis) {
    println!("{}", found.summary);
    let named: Vec<&str> = found.findings.iter().map(|finding| finding.effect.as_str()).collect();
    let verdict = match case.expect {
        Answer::Named => Adequacy::Named,
        Answer::Unknown => Adequacy::Unknown,
        Answer::Adequate | Answer::NotDetectable => Adequacy::Adequate,
    };
    assert_eq!(found.verdict, verdict, "named {named:?}, rho {:?}", found.rho);
    if case.expect != Answer::Named {
        return;
    }
    let holds =
        |finding: &Finding, name: &String| finding.effect == *name || finding.tied_with.contains(name);
    assert!(holds(&found.findings[0], &case.named[0]), "the first of {named:?} is not {}", case.named[0]);
    for name in &case.named {
        assert!(found.findings.iter().any(|finding| holds(finding, name)), "{name} is missed: {named:?}");
    }
    // The error of days that were not learnt from, the newest ones where there is a part of those.
    let unseen = |finding: &Finding| finding.rmse.test.or(finding.rmse.validation).unwrap();
    let [before, first] = unseen(&found.findings[0]);
    let [_, after] = unseen(found.findings.last().unwrap());
    println!("the unseen error falls from {before:.4} to {first:.4}, and to {after:.4} in the end");
    assert!(first < case.falls_to * before && after < before, "{before} {first} {after}");
}

/// What a person sees of a plant says the same: the line of the errors by what the effect would add rises by
/// about one.
fn what_is_drawn_says_the_same(found: &Diagnosis) {
    assert!(found.rho.unwrap() < 1.5, "{:?}", found.rho);
    let added = found.findings[0].shape.as_ref().and_then(|shape| shape.added.as_ref()).unwrap();
    println!("slope {:.2}", added.slope);
    assert!((0.5..1.5).contains(&added.slope), "{}", added.slope);
}

/// The true effects lower the error of the test part by less than a tenth.
fn the_truth_would_not_show(question: &Question, twin: &Twin, without: &Fit) {
    let made = world(&twin.request()).unwrap();
    let truth =
        made.truth.effects.iter().fold(question.model.clone(), |model, hidden| model.plus(&hidden.effect));
    let test = |fit: &Fit| fit.first_metrics().unwrap().test_rmse.unwrap();
    let [without, with] = [test(without), test(&question.fitted(&truth).1)];
    assert!(with >= 0.9 * without, "the truth would show: {without} {with}");
}

#[test]
fn every_effect_of_the_catalogue_has_a_folder() {
    let cases: Vec<Case> = names("diagnoses").iter().map(|name| case("diagnoses", name)).collect();
    let hidden = |case: &Case| match &case.data {
        Data::Twin(twin) => twin.effects.clone(),
        Data::Plant(plant) => vec![plant.effect.clone()],
        Data::House(_) => Vec::new(),
    };
    let family = |name: String| name.split(':').next().unwrap_or_default().to_owned();
    let shown: Vec<String> =
        cases.iter().flat_map(|case| case.named.iter().cloned().chain(hidden(case))).map(family).collect();
    let catalogue = Catalogue::builtin().unwrap();
    // Those of treatment plants, which replace names or have other sensors, are no question to a room.
    let of_room = |effect: &&EffectSpec| {
        effect.way_of.is_none()
            && effect.replace.is_empty()
            && effect.outputs.keys().all(|channel| channel == "T_room")
    };
    let of_rooms = catalogue.effects().filter(of_room).map(|effect| effect.id.as_str());
    // No twin has an emitter that its model does not know; a measured dwelling has (`measured`).
    let measured = ["heat_emitter"];
    let without: Vec<&str> =
        of_rooms.filter(|id| !measured.contains(id) && !shown.iter().any(|name| name == id)).collect();
    assert!(without.is_empty(), "{without:?}");
    for answer in [Answer::Named, Answer::Adequate, Answer::Unknown, Answer::NotDetectable] {
        assert!(cases.iter().any(|case| case.expect == answer), "{answer:?}");
    }
    assert!(cases.iter().any(|case| hidden(case).len() == 2), "a pair");
}
