//! Changes in rooms that were made with one, and the sums by days beside plain regression.

use super::scan::Scan;
use super::whitened::Whitened;
use super::{ChangeRecord, changes};
use crate::data::{ColumnBindings, DAY, Duration, SplitRequest, Window};
use crate::diagnose::missing_heat::record::MissingHeatAsked;
use crate::diagnose::tests::site;
use crate::estimate::assess::metrics::{ProcessNoise, filter};
use crate::estimate::{EstimateRequest, Problem, prepare};
use crate::gram::dot;
use crate::model::Catalogue;
use crate::simulate::segment::Stretch;
use crate::twin::{ChangedParameter, Level, World, WorldRequest, world};
use nalgebra::{DMatrix, DVector};

const DAYS: usize = 35;

fn problem_of(csv: &str) -> Problem {
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::none()).unwrap();
    let whole = Duration::from_days(DAYS as i64 + 1);
    let split = SplitRequest { train: whole, validation: Duration::from_days(0), test: None };
    let asked = EstimateRequest { split, ..EstimateRequest::default() };
    prepare(&Catalogue::builtin().unwrap(), &"room3".parse().unwrap(), &asked, &window, &site()).unwrap()
}

/// A room in which a parameter is this many times as large from a day on, and the parameters before.
fn room(seed: u64, change: Option<(&str, usize, f64)>) -> (Problem, Vec<f64>) {
    let change = change.map(|(parameter, day, factor)| ChangedParameter {
        parameter: parameter.to_owned(),
        day,
        factor,
    });
    let request = WorldRequest { days: DAYS, change, ..WorldRequest::new(seed, &[], Level::Matched) };
    let World { csv, parameters, .. } = world(&request).unwrap();
    let problem = problem_of(&csv);
    let mut theta = problem.nominal().to_vec();
    for (value, parameter) in theta.iter_mut().zip(problem.model().parameters()) {
        if let Some((_, made)) = parameters.iter().find(|(name, _)| *name == parameter.name) {
            *value = *made;
        }
    }
    (problem, theta)
}

fn whitened(problem: &Problem, theta: &[f64]) -> Whitened {
    Whitened::new(&MissingHeatAsked { problem, theta, output: 0, state: 0 }, ProcessNoise::Likeliest).unwrap()
}

/// The place of a parameter among those that may change.
fn place(record: &Whitened, problem: &Problem, name: &str) -> usize {
    let parameters = problem.model().parameters();
    record.parameters.iter().position(|index| parameters[*index].name == name).unwrap()
}

#[test]
fn a_change_is_told_with_its_day_and_size_and_a_room_without_one_stays_silent() {
    for (seed, name) in [(31, "alpha_h"), (32, "alpha_a")] {
        let (problem, theta) = room(seed, Some((name, 24, 1.4)));
        let found = changes(&problem, &theta, ProcessNoise::Likeliest).unwrap();
        let change = found.change.clone().unwrap_or_else(|| panic!("{name}: {found:?}"));
        // The first midnight (UTC) of the twin is its beginning, so that its days are those of the record.
        let begin = crate::data::read_time("", &found.from).unwrap();
        let since = crate::data::read_time("", &change.since).unwrap();
        assert!((since - begin - 24 * DAY).abs() <= 2 * DAY, "{name}: {change:?}");
        assert!(change.since_95[0] <= change.since && change.since <= change.since_95[1]);
        assert!(found.sentence.starts_with("Since 2026-"), "{}", found.sentence);
        // Parameters that are wrong throughout are no change, and hide none.
        let wrong: Vec<f64> = theta.iter().map(|value| value * 1.05).collect();
        let same = changes(&problem, &wrong, ProcessNoise::Likeliest).unwrap().change.unwrap();
        assert!(
            (crate::data::read_time("", &same.since).unwrap() - since).abs() <= DAY,
            "{same:?} {change:?}"
        );

        let (problem, theta) = room(seed, None);
        let found = changes(&problem, &theta, ProcessNoise::Likeliest).unwrap();
        assert!(found.change.is_none() && found.largest.unwrap() < super::THRESHOLD, "{found:?}");
        // A noise that is known is not sought, and is the same but for its last digit.
        let likeliest = filter(&problem, &theta, ProcessNoise::Likeliest).process_noise;
        let known = changes(&problem, &theta, ProcessNoise::Known(likeliest)).unwrap();
        assert!((known.largest.unwrap() - found.largest.unwrap()).abs() < 1e-6, "{known:?} {found:?}");
    }
}

#[test]
fn a_direction_is_what_a_changed_parameter_adds_to_the_innovations() {
    let (room, theta) = room(33, None);
    let run = room.simulate(&theta);
    let index = room.model().parameters().iter().position(|one| one.name == "alpha_h").unwrap();
    let by: f64 = 0.01;
    let mut moved = theta.clone();
    moved[index] *= by.exp();
    let header = "time,T_room,T_out,T_forward,sun_altitude,cloud_cover,T_room_1,T_room_2\n";
    let column = |input: &str| room.model().inputs().iter().position(|one| one.name == input).unwrap();
    let inputs = ["T_out", "T_forward", "sun_altitude", "cloud_cover", "T_n[1]", "T_n[2]"].map(column);
    // The first midnight (UTC) behind ten days.
    let grid = room.grid();
    let from = (960..grid.len()).find(|k| grid.time(*k).rem_euclid(DAY) == 0).unwrap();
    let start: Vec<f64> = run.states.iter().map(|series| series[from]).collect();
    let rest = Stretch { samples: from..grid.len(), theta: &moved, start: &start };
    let rest = room.simulator().run_stretches(&[rest]).remove(0).remove(0);
    let csv = |changed: bool| {
        let mut text = header.to_owned();
        for k in 0..grid.len() {
            let noise = 0.05 * (k as f64 * 2.4).sin() + 0.05 * ((k * k) as f64 * 1.7).sin();
            let value = if changed && k >= from { rest[k - from] } else { run.outputs[0][k] };
            let values = inputs.map(|input| format!("{:.6}", room.inputs().at(input, k)));
            let time = crate::data::rfc3339(grid.time(k));
            text.push_str(&format!("{time},{:.9},{}\n", value + noise, values.join(",")));
        }
        text
    };
    let of = |csv: &str| {
        let problem = problem_of(csv);
        let record = whitened(&problem, &theta);
        (place(&record, &problem, "alpha_h"), record)
    };
    let ((place, kept), (_, changed)) = (of(&csv(false)), of(&csv(true)));
    let first_day = (grid.time(from).div_euclid(DAY) - kept.first_day) as usize;
    let direction = kept.directions(first_day..kept.days()).swap_remove(place);
    let rows = kept.rows(first_day..kept.days());
    let apart: Vec<f64> = changed.innovations[rows.clone()]
        .iter()
        .zip(&kept.innovations[rows])
        .map(|(changed, kept)| (changed - kept) / by)
        .collect();
    assert_eq!(apart.len(), direction.len());
    let size = dot(&apart, &direction) / dot(&direction, &direction);
    let share = dot(&apart, &direction).powi(2) / (dot(&apart, &apart) * dot(&direction, &direction));
    assert!((0.97..1.03).contains(&size) && share > 0.99, "size {size}, share {share}");
}

/// The sums by days give what a regression on all rows gives: everything throughout, and one that changes.
#[test]
fn sums_by_days_are_plain_regression() {
    let (problem, theta) = room(34, None);
    let record = whitened(&problem, &theta);
    let steps = Scan::new(&record, DAYS + 1).steps(3..30, 1e-3);
    let places = record.parameters.len();
    let step = steps.iter().find(|step| step.day == 20).unwrap();
    let rows = record.rows(3..30);
    let whole: Vec<Vec<f64>> =
        record.directions(0..record.days()).iter().map(|series| series[rows.clone()].to_vec()).collect();
    let mut changing = vec![0.0; record.rows(3..20).len()];
    changing.extend(record.directions(20..30).swap_remove(step.place));
    let column = |j: usize| if j < places { &whole[j] } else { &changing };
    let mut normal = DMatrix::from_fn(places + 1, places + 1, |i, j| dot(column(i), column(j)));
    (0..places).for_each(|i| normal[(i, i)] += record.reaches[i].powi(-2));
    let innovations = &record.innovations[rows];
    let right = DVector::from_fn(places + 1, |i, _| dot(column(i), innovations));
    let factor = normal.cholesky().unwrap();
    let sizes = factor.solve(&right);
    assert!((sizes[places] - step.size).abs() < 1e-6 * step.size.abs(), "{} {}", sizes[places], step.size);
    assert!((sizes[step.place] - step.before).abs() < 1e-6 * (1.0 + step.before.abs()));
    // The interval is at least as wide as noise of deviation one makes it.
    let plain = factor.inverse()[(places, places)].sqrt();
    assert!(step.deviation >= plain * (1.0 - 1e-6) && step.deviation < 2.0 * plain);
}

#[test]
fn a_short_record_says_that_it_is_short_and_a_stretch_what_its_days_say() {
    let (problem, theta) = room(35, Some(("alpha_h", 24, 1.5)));
    let record = ChangeRecord::new(&problem, &theta, ProcessNoise::Likeliest, DAYS).unwrap();
    let short = record.changes(0..9);
    assert!(short.change.is_none() && short.largest.is_none() && short.sentence.contains("too short"));
    assert!(record.changes(0..24).change.is_none());
    assert!(record.changes(0..record.days()).change.is_some());
}
