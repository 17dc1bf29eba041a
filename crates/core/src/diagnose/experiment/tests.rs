//! Plans of experiments on a small world, end to end.

use super::information::Knowledge;
use super::plans::{self, DRAWN};
use super::{
    ComfortBounds, DrivenInput, Experiment, ExperimentAsked, ExperimentPurpose, ExperimentSubject,
    PlanFamily, PromisedWidth, experiment, learnt,
};
use crate::data::{ColumnBindings, SplitRequest, Window};
use crate::estimate::assess::metrics::measurement_variance;
use crate::estimate::forecast::InputsToCome;
use crate::estimate::{EstimateRequest, Problem, Site, prepare};
use crate::model::Catalogue;
use crate::simulate::kalman::Noise;
use crate::twin::{DrivenForward, Level, World, WorldRequest, world};
use statrs::distribution::{ContinuousCDF, StudentsT};

const DAYS: usize = 10;
const PER_DAY: usize = 48;

fn request() -> WorldRequest {
    WorldRequest { days: DAYS, step_minutes: 30, ..WorldRequest::new(12, &[], Level::Matched) }
}

fn small_room() -> (Problem, Vec<f64>, Window, World) {
    room(world(&request()).unwrap(), DAYS)
}

fn room(made: World, days: usize) -> (Problem, Vec<f64>, Window, World) {
    let (window, _) = Window::parse_csv(&made.csv, &ColumnBindings::none()).unwrap();
    let train = format!("P{days}D").parse().unwrap();
    let split = SplitRequest { train, validation: "P0D".parse().unwrap(), test: None };
    let asked = EstimateRequest { split, ..EstimateRequest::default() };
    let problem =
        prepare(&Catalogue::builtin().unwrap(), &"room3".parse().unwrap(), &asked, &window, &site(&made))
            .unwrap();
    let mut theta = problem.nominal().to_vec();
    for (value, parameter) in theta.iter_mut().zip(problem.model().parameters()) {
        if let Some((_, known)) = made.parameters.iter().find(|(name, _)| *name == parameter.name) {
            *value = *known;
        }
    }
    (problem, theta, window, made)
}

fn site(made: &World) -> Site {
    Site { sets: [("neighbours".to_owned(), made.neighbours.clone())].into(), ..Site::default() }
}

fn noise(problem: &Problem) -> Noise {
    let states = problem.model().states().len();
    Noise { process: vec![0.03; states], measurement: measurement_variance(problem) }
}

fn asked() -> ExperimentAsked {
    ExperimentAsked {
        days: 2,
        inputs: vec![DrivenInput { channel: "T_forward".to_owned(), range: [28.0, 45.0], slew: 20.0 }],
        comfort: vec![ComfortBounds { channel: "T_room".to_owned(), range: [15.0, 28.0] }],
        purpose: ExperimentPurpose::Determine,
        about: vec!["alpha_w".to_owned()],
        seed: 3,
    }
}

fn planned(problem: &Problem, theta: &[f64], asked: &ExperimentAsked) -> Experiment {
    experiment(problem, theta, &noise(problem), asked, &InputsToCome::default()).unwrap()
}

#[test]
fn the_best_of_each_family_narrows_what_it_is_about_and_is_the_same_on_two_threads() {
    let (problem, theta, _, _) = small_room();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| planned(&problem, &theta, &asked()))
    };
    let found = on(1);
    assert_eq!(found, on(2));
    assert_eq!((found.plans.len(), found.tried, found.uncomfortable), (3, 3 * DRAWN as usize, 0));
    assert_eq!(found.time.len(), 2 * PER_DAY + 1);
    let after = |plan: usize| found.plans[plan].lessons[0].t_after;
    assert!(after(0) >= after(1) && after(1) >= after(2));
    let first = &found.plans[0];
    let lesson = &first.lessons[0];
    assert_eq!((lesson.parameter.as_str(), lesson.width_unit.as_str()), ("alpha_w", "%"));
    // Two days beside ten, of a room whose thermostat hides what is asked about: little, but never less.
    assert!(lesson.width_after < lesson.width_before, "{lesson:?}");
    let narrowed = first.lessons.iter().any(|one| one.width_after < 0.9 * one.width_before);
    assert!(narrowed, "{:?}", first.lessons);
    assert!(first.outputs["T_room"].values.iter().all(|t| (15.0..=28.0).contains(t)));
    assert!(found.sentences[1].contains("alpha_w"), "{:?}", found.sentences);

    // Nothing has been driven yet: what is known is what was known before, and that is told.
    let promise =
        |width: f64| PromisedWidth { parameter: "alpha_w".to_owned(), width, width_unit: "%".to_owned() };
    let told =
        learnt(&problem, &theta, &[promise(lesson.width_after), promise(lesson.width_before)]).unwrap();
    assert!((told[0].found / lesson.width_before - 1.0).abs() < 1e-9, "{told:?} {lesson:?}");
    assert!(told[1].kept && told[1].sentence.contains("as promised"), "{told:?}");
}

#[test]
fn only_the_newest_days_count_and_of_these_only_what_was_measured() {
    const ALL: usize = 90;
    let mut made = world(&WorldRequest { days: ALL, step_minutes: 60, ..request() }).unwrap();
    let place = made.csv.lines().next().unwrap().split(',').position(|name| name == "T_room").unwrap();
    let unmeasured = 20 * 24..80 * 24;
    let line = |(row, line): (usize, &str)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if unmeasured.contains(&row) {
            cells[place] = "";
        }
        cells.join(",") + "\n"
    };
    made.csv = made.csv.lines().enumerate().map(line).collect();
    let (problem, theta, ..) = room(made, ALL);
    let known = Knowledge::of(&problem, &theta, &[]).unwrap();
    let freedom = StudentsT::new(0.0, 1.0, 9.0).unwrap();
    assert!((known.half_width() - freedom.inverse_cdf(0.975)).abs() < 1e-9, "{}", known.half_width());
}

#[test]
fn tight_comfort_leaves_no_plan_and_says_so() {
    let (problem, theta, _, _) = small_room();
    let comfort = vec![ComfortBounds { channel: "T_room".to_owned(), range: [30.0, 31.0] }];
    let found = planned(&problem, &theta, &ExperimentAsked { comfort, ..asked() });
    assert!(found.plans.is_empty() && found.uncomfortable == found.tried);
    assert!(found.undriven.is_some_and(|cost| cost.hours_outside > 40.0));
    assert!(found.sentences[0].starts_with("None of 36"), "{:?}", found.sentences);
}

#[test]
fn an_effect_is_taken_into_the_model_and_faults_are_named() {
    let (problem, theta, window, made) = small_room();
    let catalogue = Catalogue::builtin().unwrap();
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<String>>();
    let subject =
        |names: &[String]| ExperimentSubject::new(&catalogue, &problem, &theta, &window, &site(&made), names);
    let found = subject(&names(&["alpha_a", "direct_outdoor_loss"])).unwrap();
    assert_eq!(found.about, ["alpha_a", "c_outdoor"]);
    assert_eq!(found.theta.len(), theta.len() + 1);
    let faults = subject(&names(&["alpha_b", "ghost"])).unwrap_err();
    let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
    assert_eq!(pointers, ["/about/0", "/about/1"]);

    let wrong = ExperimentAsked {
        days: 15,
        inputs: vec![DrivenInput { channel: "T_forwards".to_owned(), range: [45.0, 28.0], slew: 0.0 }],
        comfort: vec![ComfortBounds { channel: "T_rooms".to_owned(), range: [f64::NAN, 1.0] }],
        purpose: ExperimentPurpose::Separate,
        about: names(&["alpha_w"]),
        seed: 1,
    };
    let faults =
        experiment(&problem, &theta, &noise(&problem), &wrong, &InputsToCome::default()).unwrap_err();
    let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
    let input = "/inputs/T_forwards";
    let wanted =
        ["/days", "/about", input, input, "/slew/T_forwards", "/comfort/T_rooms", "/comfort/T_rooms"];
    assert_eq!(pointers, wanted);
}

#[test]
fn sequences_keep_their_range_and_pace_and_pulses_leave_the_day_alone() {
    let (problem, ..) = small_room();
    let (grid, input) = (problem.grid(), asked().inputs);
    let usual = vec![grid.column("T_forward").unwrap().values()[..2 * PER_DAY].to_vec()];
    for family in PlanFamily::ALL {
        for seed in 0..20 {
            let plan = plans::drawn(family, seed, &input, &usual, grid, 0);
            assert_eq!(plan, plans::drawn(family, seed, &input, &usual, grid, 0));
            assert!(plan[0].iter().all(|value| (28.0..=45.0).contains(value)), "{family:?}");
            let pace = plan[0].windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
            assert!(pace > 0.5 && pace <= 10.0 + 1e-9, "{family:?} {pace}");
            if family == PlanFamily::NightPulses {
                let noon = (0..2 * PER_DAY).filter(|k| crate::data::hour_of_day(grid, *k) == 12);
                assert!(noon.clone().count() > 0);
                noon.for_each(|k| assert_eq!(plan[0][k], usual[0][k].clamp(28.0, 45.0), "{k}"));
            }
        }
    }
    assert_eq!(plans::nearer(&[vec![4.0]], &[vec![2.0]], 0.5), [vec![3.0]]);
}

#[test]
fn a_driven_twin_is_the_same_room_until_it_is_driven() {
    let values = vec![30.0, 30.0, 45.0, 45.0, 45.0];
    let driven =
        world(&WorldRequest { driven: Some(DrivenForward { from: 100, values }), ..request() }).unwrap();
    let plain = world(&request()).unwrap();
    let cells = |csv: &str, row: usize| -> Vec<String> {
        csv.lines().nth(row + 1).unwrap().split(',').map(str::to_owned).collect()
    };
    for row in [0, 50, 99] {
        assert_eq!(cells(&driven.csv, row), cells(&plain.csv, row));
    }
    let (there, was) = (cells(&driven.csv, 102), cells(&plain.csv, 102));
    assert_eq!((there[3].as_str(), &there[2]), ("45.00", &was[2]));
    assert_eq!(cells(&driven.csv, 105)[3], cells(&plain.csv, 105)[3]);
    assert_ne!(driven.csv, plain.csv);
}
