//! The missing heat of rooms whose hidden heat is known, and the smoother beside plain conditioning.

use super::events::{events, habits};
use super::guesses::Guess;
use super::hours::{Hour, week};
use super::record::{LinearRecord, MissingHeatAsked};
use super::smoother::smooth;
use super::{MissingHeat, missing_heat};
use crate::data::{ColumnBindings, HOUR, SplitRequest, Window, rfc3339};
use crate::diagnose::tests::site;
use crate::estimate::{EstimateRequest, Problem, prepare};
use crate::model::Catalogue;
use crate::twin::{Level, World, WorldRequest, world};
use nalgebra::{DMatrix, DVector};

/// A room with one hidden effect, and room3 with the parameters that it was made with.
fn known_room(seed: u64, effect: &str, days: usize) -> (World, Problem, Vec<f64>) {
    let made = world(&WorldRequest { days, ..WorldRequest::new(seed, &[effect], Level::Matched) }).unwrap();
    let problem = problem_of("room3", &made.csv);
    let mut theta = problem.nominal().to_vec();
    for (index, parameter) in problem.model().parameters().iter().enumerate() {
        if let Some((_, value)) = made.parameters.iter().find(|(name, _)| *name == parameter.name) {
            theta[index] = *value;
        }
    }
    (made, problem, theta)
}

fn problem_of(model: &str, csv: &str) -> Problem {
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::none()).unwrap();
    let asked = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
    prepare(&Catalogue::builtin().unwrap(), &model.parse().unwrap(), &asked, &window, &site()).unwrap()
}

/// The mean of a series by hour.
fn by_hour(problem: &Problem, series: &[f64]) -> Vec<f64> {
    let samples = (1.0 / problem.grid().step_hours()).round() as usize;
    series.chunks(samples).map(|hour| hour.iter().sum::<f64>() / hour.len() as f64).collect()
}

/// How many of the events touch one of the stretches in which the heat is a quarter of its most, and how many
/// of those are touched.
fn overlaps(found: &MissingHeat, heat: &[f64]) -> (usize, usize, usize) {
    let most = heat.iter().map(|heat| heat.abs()).fold(0.0, f64::max);
    let is_on: Vec<bool> = heat.iter().map(|heat| heat.abs() > 0.25 * most).collect();
    let mut stretches: Vec<Vec<usize>> = Vec::new();
    for hour in (0..is_on.len()).filter(|hour| is_on[*hour]) {
        match stretches.last_mut().filter(|stretch| stretch.last() == hour.checked_sub(1).as_ref()) {
            Some(stretch) => stretch.push(hour),
            None => stretches.push(vec![hour]),
        }
    }
    let of = |event: &super::HeatEvent| event.at.0..=event.at.1;
    let right = found.events.iter().filter(|event| of(event).any(|hour| is_on[hour])).count();
    let seen = |stretch: &Vec<usize>| {
        found.events.iter().any(|event| stretch.iter().any(|hour| of(event).contains(hour)))
    };
    (right, stretches.iter().filter(|stretch| seen(stretch)).count(), stretches.len())
}

#[test]
fn the_bands_hold_the_heat_that_was_hidden_and_events_are_where_it_flows() {
    for (seed, effect) in [(21, "stove"), (22, "laundry"), (23, "occupancy_gain")] {
        let (made, problem, theta) = known_room(seed, effect, 21);
        let found = missing_heat(&problem, &theta, None, &|_| true).unwrap();
        assert_eq!((found.state.as_str(), found.unit.as_str()), ("T_r", "K/h"));
        let hidden = by_hour(&problem, &made.hidden_heat);
        let household = by_hour(&problem, &made.household);
        let errors: Vec<f64> = found
            .hours
            .iter()
            .zip(hidden.iter().zip(&household))
            .filter_map(|(hour, (hidden, household))| Some((hour.rate? - hidden - household) / hour.sd?))
            .collect();
        let within =
            |band: f64| errors.iter().filter(|error| error.abs() < band).count() as f64 / errors.len() as f64;
        assert!(errors.len() > 450, "{effect}: {}", errors.len());
        assert!((0.4..0.75).contains(&within(0.6745)), "{effect}: {} within 50 %", within(0.6745));
        assert!((0.85..=1.0).contains(&within(1.96)), "{effect}: {} within 95 %", within(1.96));
        let (right, seen, all) = overlaps(&found, &hidden);
        let (precision, recall) = (right as f64 / found.events.len() as f64, seen as f64 / all as f64);
        let f1 = 2.0 * precision * recall / (precision + recall);
        assert!(f1 >= 0.7, "{effect}: {right} of {} events, {seen} of {all} stretches", found.events.len());
    }
}

#[test]
fn a_steady_heat_is_told_where_the_thermostat_is_far_off_its_set_point() {
    // Linear in the temperature, the thermostats of these rooms would close to less than nothing.
    for seed in [211_000_032, 211_000_043, 211_000_186] {
        let (made, problem, theta) = known_room(seed, "constant_gain", 21);
        let found = missing_heat(&problem, &theta, None, &|_| true).unwrap();
        let truth = by_hour(&problem, &made.hidden_heat);
        let rates: Vec<f64> = found.hours.iter().filter_map(|hour| hour.rate).collect();
        let mean = |series: &[f64]| series.iter().sum::<f64>() / series.len() as f64;
        let error = mean(&rates) - mean(&truth);
        assert!(error.abs() < 0.03, "{seed}: {error} of {}", mean(&truth));
    }
}

/// Everything that is sought as one Gaussian vector, conditioned on all readings at once.
#[test]
fn the_smoother_is_conditioning_on_all_values_at_once() {
    let (_, problem, theta) = known_room(24, "stove", 1);
    let asked = MissingHeatAsked { problem: &problem, theta: &theta, output: 0, state: 0 };
    let run = problem.simulate(&theta);
    let along: Vec<Vec<f64>> =
        (0..problem.grid().len()).map(|k| run.states.iter().map(|series| series[k]).collect()).collect();
    let mut record = LinearRecord::new(&asked, &along, &[]).unwrap();
    record.steps.truncate(11);
    record.readings.truncate(12);
    let guess = Guess { sensor: 0.08, size: 0.7, memory: 2.0 };
    let smoothed = smooth(&record, guess);

    let (width, rate, samples) = (record.width(), record.rate(), record.readings.len());
    let (mut means, mut joint) = (vec![], DMatrix::zeros(width * samples, width * samples));
    let fades = (-record.hours / guess.memory).exp();
    let (mut mean, begin) = record.begin(guess.size.powi(2));
    joint.view_mut((0, 0), (width, width)).copy_from(&begin);
    for (k, step) in record.steps.iter().enumerate() {
        means.push(mean.clone());
        let mut matrix = step.matrix.clone();
        matrix[(rate, rate)] = fades;
        mean = &matrix * &mean + &step.constant;
        let at = (k + 1) * width;
        // The covariance with all that went before, then its own.
        let before = &matrix * joint.view((k * width, 0), (width, at));
        joint.view_mut((at, 0), (width, at)).copy_from(&before);
        joint.view_mut((0, at), (at, width)).copy_from(&before.transpose());
        let mut own = &matrix * joint.view((k * width, k * width), (width, width)) * matrix.transpose()
            + &step.covariance;
        own[(rate, rate)] += guess.size.powi(2) * (1.0 - fades * fades);
        joint.view_mut((at, at), (width, width)).copy_from(&own);
    }
    means.push(mean);
    let readings: Vec<_> = record
        .readings
        .iter()
        .enumerate()
        .flat_map(|(k, readings)| readings.iter().map(move |reading| (k, reading)))
        .collect();
    assert!(readings.len() > 8, "{}", readings.len());
    let rows = DMatrix::from_fn(readings.len(), width * samples, |i, j| {
        let (k, reading) = &readings[i];
        if j / width == *k { reading.row[j % width] } else { 0.0 }
    });
    let expected = |k: usize, row: &DVector<f64>| row.dot(&means[k]);
    let apart = DVector::from_iterator(
        readings.len(),
        readings.iter().map(|(k, reading)| reading.value - reading.constant - expected(*k, &reading.row)),
    );
    let noise = DMatrix::identity(readings.len(), readings.len()) * guess.sensor.powi(2);
    let gain = &joint * rows.transpose() * (&rows * &joint * rows.transpose() + noise).try_inverse().unwrap();
    let (moved, left) = (&gain * apart, &joint - &gain * &rows * &joint);
    for (k, (mean, covariance)) in smoothed.iter().enumerate() {
        for i in 0..width {
            let at = k * width + i;
            assert!((mean[i] - means[k][i] - moved[at]).abs() < 1e-7, "{k} {i}: {}", mean[i]);
            for j in 0..width {
                let oracle = left[(at, k * width + j)];
                assert!((covariance[(i, j)] - oracle).abs() < 1e-7, "{k} {i} {j}: {oracle}");
            }
        }
    }
}

/// Four weeks of hours from a Monday on, with what is missing by day and hour.
fn month(rate: impl Fn(usize, usize) -> f64) -> Vec<Hour> {
    (0..28 * 24)
        .map(|at| Hour {
            from: rfc3339(at as i64 * HOUR),
            rate: Some(rate(at / 24, at % 24)),
            sd: Some(0.05),
            band_50: None,
            band_95: None,
            weekday: at / 24 % 7,
            hour: at % 24,
        })
        .collect()
}

#[test]
fn habits_are_told_by_hours_days_and_size() {
    // Noise that never repeats, 1.2 from 18 to 21 h on working days, a window at midnight each third day, and
    // one hour like no other.
    let noise = |day: usize, hour: usize| 0.05 * ((day * 24 + hour) as f64 * 2.4).sin();
    let hours = month(|day, hour| {
        noise(day, hour) + if day % 7 < 5 && (18..21).contains(&hour) { 1.2 } else { 0.0 }
            - if (day % 3 == 1 && hour == 23) || (day % 3 == 2 && hour == 0) { 0.6 } else { 0.0 }
            + if (day, hour) == (9, 9) { 3.0 } else { 0.0 }
    });
    let events = events(&hours, 1.0);
    let habits = habits(&hours, 1.0, &events);
    let told: Vec<_> = habits.iter().map(|one| (one.events, one.begins, one.ends, one.hours)).collect();
    assert_eq!(told, [(20, 18, 21, 3), (9, 23, 1, 2)]);
    assert_eq!((habits[0].on_working_days, habits[0].every_days), (1.0, 1.0));
    assert_eq!(habits[1].every_days, 3.0);
    assert!((habits[0].rate - 1.2).abs() < 0.05 && (habits[1].rate + 0.6).abs() < 0.05, "{habits:?}");
    assert_eq!(events.len(), 30, "{events:?}");
    let single = events.iter().find(|event| event.hours == 1).unwrap();
    assert_eq!(single.from, hours[9 * 24 + 9].from);
    let week = week(&hours);
    assert_eq!((week.len(), week[18].hours), (168, 4));
    assert!((week[18].rate.unwrap() - 1.2).abs() < 0.06 && week[5 * 24 + 18].rate.unwrap().abs() < 0.06);
    // A month in which nothing stands out has no events but what noise does in some hours.
    let quiet = month(noise);
    assert!(super::events::events(&quiet, 1.0).len() < 7, "{:?}", super::events::events(&quiet, 1.0));
}

#[test]
fn what_has_no_missing_heat_says_why() {
    let (_, problem, theta) = known_room(24, "stove", 1);
    assert_eq!(missing_heat(&problem, &theta, Some("T_wall"), &|_| true).unwrap_err().code, "unknown-output");
}

#[test]
fn a_meter_that_the_model_has_gives_the_kilowatts() {
    let made = world(&WorldRequest { days: 7, ..WorldRequest::new(25, &["stove"], Level::Matched) }).unwrap();
    let bare = problem_of("room3", &made.csv);
    assert_eq!(missing_heat(&bare, bare.nominal(), None, &|_| true).unwrap().per_kilowatt, None);
    let problem = problem_of("room3+metered_gain:P_appliances", &made.csv);
    let found = missing_heat(&problem, problem.nominal(), None, &|_| true).unwrap();
    assert_eq!(found.per_kilowatt_of.as_deref(), Some("c_P_appliances"));
    assert!((found.per_kilowatt.unwrap() - 0.5).abs() < 1e-12, "{:?}", found.per_kilowatt);
    let unsure = missing_heat(&problem, problem.nominal(), None, &|name| name != "c_P_appliances").unwrap();
    assert_eq!((unsure.per_kilowatt, unsure.hours), (None, found.hours));
}
