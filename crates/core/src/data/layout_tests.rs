//! Layouts with a known answer: in closed form, counted the slow way, and of measured buildings.

use super::window_tests::real_file;
use super::{ColumnBindings, DAY, Hold, Layout, MINUTE, Series, Window, propose_layout};
use crate::fault::Fault;
use std::f64::consts::TAU;

const STEP: i64 = 30 * MINUTE;
const COUNT: i64 = 14 * 48;

/// Half-hourly temperatures over two weeks: a mean, then amplitudes of waves with so many periods in that
/// time. Waves of different numbers have no correlation, so that every correlation of such sums is known.
fn waves(name: &str, mean: f64, waves: &[(f64, f64)], range: std::ops::Range<i64>) -> Series {
    let value = |i: i64| {
        mean + waves
            .iter()
            .map(|(amplitude, periods)| amplitude * (TAU * periods * i as f64 / COUNT as f64).sin())
            .sum::<f64>()
    };
    Series::new(
        name,
        "degC",
        Hold::Linear,
        range.clone().map(|i| STEP * i).collect(),
        range.map(value).collect(),
    )
    .unwrap()
}

fn layout(series: Vec<Series>) -> Result<Layout, Vec<Fault>> {
    propose_layout(&Window::from_series(series).unwrap())
}

fn rooms(layout: &Layout) -> Vec<(&str, Vec<&str>)> {
    layout
        .rooms
        .iter()
        .map(|room| (room.id.as_str(), room.sensors.iter().map(String::as_str).collect()))
        .collect()
}

#[test]
fn rooms_and_neighbours_are_found_where_the_answer_is_known() {
    // One wave in 14 days is the drift, 14 are the day, 28 half a day, 56 a quarter.
    let whole = 0..COUNT;
    let found = layout(vec![
        waves("T_room_0", 21.0, &[(1.0, 1.0), (1.0, 14.0)], whole.clone()),
        waves("drift", 20.0, &[(5.0, 1.0), (0.5, 28.0)], whole.clone()),
        // The first sensor again, elsewhere on the wall, with some waves of its own.
        waves("T_room_0b", 22.5, &[(1.0, 1.0), (1.0, 14.0), (0.1, 56.0)], whole.clone()),
        waves("other drift", 19.0, &[(5.0, 1.0), (0.5, 56.0)], whole.clone()),
        waves("T_hall", 20.0, &[(1.0, 1.0), (1.0, 14.0), (1.0, 42.0)], whole.clone()),
        waves("T_out", 5.0, &[(1.0, 1.0), (1.0, 14.0)], whole.clone()),
        waves("T_dead", 20.0, &[], whole),
    ])
    .unwrap();
    assert_eq!(
        rooms(&found),
        [
            ("0", vec!["T_room_0", "T_room_0b"]),
            ("drift", vec!["drift"]),
            ("other-drift", vec!["other drift"]),
            ("hall", vec!["T_hall"])
        ]
    );
    assert_eq!(found.rooms[0].representative, "T_room_0");
    let close = |found: Option<f64>, expected: f64| {
        assert!((found.unwrap() - expected).abs() < 0.02, "{found:?} {expected}")
    };
    // Squared amplitudes in common over the roots of all.
    close(found.levels[0][2], 2.0 / (2.0f64 * 2.01).sqrt());
    close(found.rooms[0].correlation, 1.0 / 1.01f64.sqrt());
    // The two that drift: 25 of 25.25 in common. Without the day's mean a fourteen-day wave keeps 0.8 per
    // cent, and a little more at the ends.
    close(found.levels[1][3], 25.0 / 25.25);
    assert!(found.daily[1][3].unwrap().abs() < 0.05 && found.correlation[1][3] == found.daily[1][3]);
    close(found.daily[0][4], 1.0 / 2f64.sqrt());
    close(found.levels[0][4], 2.0 / 6f64.sqrt());
    let pairs: Vec<(&[String; 2], usize)> =
        found.neighbours.iter().map(|pair| (&pair.rooms, pair.samples)).collect();
    assert_eq!(pairs, [(&["0".to_owned(), "hall".to_owned()], COUNT as usize)]);
    close(Some(found.neighbours[0].correlation), 1.0 / 2f64.sqrt());
    let left_out: Vec<&str> = found.left_out.iter().map(|one| one.channel.as_str()).collect();
    assert_eq!(left_out, ["T_out", "T_dead"]);
    assert!(found.summary.contains("Probably in one room: T_room_0 and T_room_0b ("), "{}", found.summary);
    assert!(found.summary.contains("drift and other drift (0.99, 0.0"), "{}", found.summary);
    assert_eq!((found.step_s.millis(), found.from.as_str()), (STEP, "1970-01-01T00:00:00Z"));
}

#[test]
fn a_chain_of_likeness_is_no_room() {
    // Each next sensor resembles the one before (0.97), the ends do not (0.88).
    let turned =
        |name: &str, angle: f64| waves(name, 20.0, &[(angle.cos(), 28.0), (angle.sin(), 42.0)], 0..COUNT);
    let found = layout(vec![turned("a", 0.0), turned("b", 0.24), turned("c", 0.49)]).unwrap();
    assert!(found.correlation[0][1].unwrap() > 0.96 && found.correlation[1][2].unwrap() > 0.96);
    assert!((found.correlation[0][2].unwrap() - 0.49f64.cos()).abs() < 0.01);
    assert_eq!(rooms(&found), [("a", vec!["a", "b"]), ("c", vec!["c"])]);
}

#[test]
fn only_samples_that_both_have_are_compared() {
    let wave: &[(f64, f64)] = &[(1.0, 14.0), (1.0, 28.0)];
    // Ten days, ten days that overlap them by six, and two days at the end that overlap the first not at all.
    let (early, late, end) = (
        waves("early", 20.0, wave, 0..480),
        waves("late", 25.0, wave, 192..COUNT),
        waves("end", 22.0, wave, 576..COUNT),
    );
    let found = layout(vec![early, late, end]).unwrap();
    assert_eq!((found.correlation[0][2], found.correlation[1][2]), (None, None), "two days are too few");
    assert_eq!(rooms(&found), [("early", vec!["early", "late"]), ("end", vec!["end"])]);
    assert!(found.summary.contains("2 pairs have too little in common"), "{}", found.summary);
    let samples: Vec<usize> = found.sensors.iter().map(|sensor| sensor.samples).collect();
    assert_eq!(samples, [480, 480, 96]);
}

#[test]
fn what_cannot_be_compared_is_a_fault() {
    let code = |series: Vec<Series>| layout(series).unwrap_err().remove(0).code;
    let wave: &[(f64, f64)] = &[(1.0, 28.0)];
    assert_eq!(code(vec![waves("a", 20.0, wave, 0..COUNT)]), "sensor-count");
    let power = Series::new("P_heater", "kW", Hold::ZeroOrder, vec![0, 1_000_000], vec![0.0, 1.0]).unwrap();
    let faults = layout(vec![waves("a", 20.0, wave, 0..COUNT), power]).unwrap_err();
    assert!(faults[0].suggestion.as_ref().unwrap().contains("`P_heater`: it is in kW"), "{faults:?}");
    assert_eq!(
        code(vec![waves("a", 20.0, wave, 0..192), waves("b", 20.0, wave, 0..192)]),
        "window-too-short"
    );
    assert!(layout(vec![waves("a", 20.0, wave, 0..194), waves("b", 20.0, wave, 0..194)]).is_ok());
    assert_eq!(
        code(vec![waves("a", 20.0, wave, 0..300), waves("b", 20.0, wave, 301..600)]),
        "window-too-short"
    );
    // Ten samples over two weeks have three days in common, but no shape.
    let sparse = |name: &str| {
        Series::new(
            name,
            "degC",
            Hold::Linear,
            (0..10).map(|i| i * 130_000).collect(),
            (0..10).map(f64::from).collect(),
        )
        .unwrap()
    };
    assert_eq!(code(vec![sparse("a"), sparse("b")]), "window-too-short");
    let many: Vec<Series> = (0..201).map(|i| waves(&format!("s{i}"), 20.0, wave, 0..COUNT)).collect();
    assert_eq!(code(many), "sensor-count");
}

/// The correlation of two complete lists by another formula than the one that is tested.
fn slow_pearson(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let sum = |of: &dyn Fn(usize) -> f64| (0..a.len()).map(of).sum::<f64>();
    let (x, y, xy, xx, yy) =
        (sum(&|i| a[i]), sum(&|i| b[i]), sum(&|i| a[i] * b[i]), sum(&|i| a[i] * a[i]), sum(&|i| b[i] * b[i]));
    (n * xy - x * y) / ((n * xx - x * x) * (n * yy - y * y)).sqrt()
}

#[test]
fn a_measured_house_has_four_rooms() {
    let Some(text) = real_file("belgian_house/belgian_house_10min.csv.gz") else { return };
    let (window, _) = Window::parse_csv(&text, &ColumnBindings::none()).unwrap();
    let first = window.from();
    let window = window.slice(first, first + 14 * DAY - 10 * MINUTE).unwrap();
    let found = propose_layout(&window).unwrap();
    let names: Vec<(&str, usize)> =
        rooms(&found).into_iter().map(|(id, sensors)| (id, sensors.len())).collect();
    assert_eq!(names, [("laundry", 1), ("living_room", 1), ("teen_room", 1), ("bathroom", 1)]);
    let left_out: Vec<&str> = found.left_out.iter().map(|one| one.channel.as_str()).collect();
    assert!(
        ["T_out", "T_out_north", "wind_speed", "P_appliances", "RH_laundry"]
            .iter()
            .all(|name| left_out.contains(name)),
        "{left_out:?}"
    );
    // Every level against the samples themselves; every daily movement against means taken one by one.
    let values: Vec<&[f64]> =
        found.sensors.iter().map(|sensor| window.series(&sensor.channel).unwrap().values()).collect();
    let moved = |values: &[f64]| -> Vec<f64> {
        let around = |i: usize| &values[i.saturating_sub(72)..(i + 73).min(values.len())];
        // Three quarters of 145 samples are 109: the first 36 have fewer around them.
        (36..values.len() - 36)
            .map(|i| values[i] - around(i).iter().sum::<f64>() / around(i).len() as f64)
            .collect()
    };
    for a in 0..4 {
        for b in 0..4 {
            let expected =
                (slow_pearson(values[a], values[b]), slow_pearson(&moved(values[a]), &moved(values[b])));
            assert!((found.levels[a][b].unwrap() - expected.0).abs() < 1e-6, "{a} {b}");
            assert!((found.daily[a][b].unwrap() - expected.1).abs() < 1e-6, "{a} {b}");
            assert_eq!(
                found.correlation[a][b],
                found.levels[a][b].zip(found.daily[a][b]).map(|(a, b)| a.min(b))
            );
        }
    }
    // The living room and the laundry correlate by 0.89 in temperature, by 0.65 within the day.
    assert!((found.neighbours[0].correlation - 0.645).abs() < 0.005, "{:?}", found.neighbours);
    let edges: Vec<[&str; 2]> =
        found.neighbours.iter().map(|pair| [pair.rooms[0].as_str(), pair.rooms[1].as_str()]).collect();
    assert_eq!(
        edges,
        [["laundry", "living_room"], ["living_room", "bathroom"], ["living_room", "teen_room"]]
    );
}

#[test]
fn two_sensors_of_a_measured_office_are_not_recognised() {
    let mut all = Vec::new();
    for room in ["999169", "917810"] {
        let Some(text) = real_file(&format!("brains4buildings_windesheim/room_{room}_15min.csv")) else {
            return;
        };
        let (window, _) = Window::parse_csv(&text, &ColumnBindings::none()).unwrap();
        for sensor in ["T_room_bms", "T_room_sensor"] {
            let series = window.series(sensor).unwrap();
            let name = format!("{sensor}_{room}");
            all.push(
                Series::new(
                    &name,
                    series.unit(),
                    series.hold(),
                    series.times().to_vec(),
                    series.values().to_vec(),
                )
                .unwrap(),
            );
        }
    }
    let found = layout(all).unwrap();
    // What the correlations cannot know: the first two sensors are one room, and so are the last two.
    assert_eq!(found.rooms.len(), 4);
    let (first, second, across) = (
        found.correlation[0][1].unwrap(),
        found.correlation[2][3].unwrap(),
        found.correlation[0][3].unwrap(),
    );
    assert!(first < 0.8 && second < 0.8 && across > first, "{first} {second} {across}");
}
