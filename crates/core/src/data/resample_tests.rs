//! The gap rules, on cases small enough to work out by hand.

use super::{Grid, GridRequest, Hold, MINUTE, SECOND, Series, Window};
use crate::fault::Fault;
use proptest::prelude::{any, prop_assert, prop_assert_eq, proptest};

/// Samples at these seconds.
fn series(channel: &str, hold: Hold, samples: &[(i64, f64)]) -> Series {
    let (times, values) = samples.iter().map(|(time, value)| (time * SECOND, *value)).unzip();
    Series::new(channel, "-", hold, times, values).unwrap()
}

/// An output every 60 s from 0 to 600 s, and one input.
fn gridded(input: Series) -> Grid {
    let hold = input.hold();
    let name = input.channel().to_owned();
    let output: Vec<(i64, f64)> = (0..=10).map(|i| (60 * i, i as f64)).collect();
    let window = Window::from_series(vec![series("y", Hold::Linear, &output), input]).unwrap();
    window.grid(&GridRequest::new("y", &[(&name, hold)])).unwrap()
}

fn marks(grid: &Grid, name: &str) -> String {
    grid.column(name).unwrap().valid().iter().map(|valid| if *valid { '1' } else { '0' }).collect()
}

fn codes(result: Result<Grid, Vec<Fault>>) -> Vec<String> {
    result.unwrap_err().into_iter().map(|fault| fault.code).collect()
}

#[test]
fn an_output_is_its_nearest_sample_and_never_a_line() {
    // Samples a little off the grid, one missing, one exactly half a step after its point.
    let output = series(
        "y",
        Hold::Linear,
        &[(0, 0.0), (62, 1.0), (118, 2.0), (240, 4.0), (330, 5.0), (360, 6.0), (420, 7.0)],
    );
    let grid = Window::from_series(vec![output]).unwrap().grid(&GridRequest::new("y", &[])).unwrap();
    assert_eq!((grid.start(), grid.step(), grid.len()), (0, MINUTE, 8));
    assert_eq!(marks(&grid, "y"), "11101011");
    // The sample at 330 belongs to the point at 360, which has a nearer one; the point at 300 gets nothing.
    let y = grid.column("y").unwrap();
    assert_eq!(y.values(), [0.0, 1.0, 2.0, 2.0, 4.0, 4.0, 6.0, 7.0]);
    assert_eq!(grid.valid_share(), 0.75);
}

#[test]
fn lines_bridge_three_steps_and_no_more() {
    // Distances of the samples: 60, 180 (three steps: bridged), 240 (a gap).
    let grid = gridded(series("u", Hold::Linear, &[(0, 0.0), (60, 1.0), (240, 4.0), (480, 8.0), (540, 9.0)]));
    assert_eq!(marks(&grid, "u"), "11111000110");
    let u = grid.column("u").unwrap();
    assert_eq!(&u.values()[..5], [0.0, 1.0, 2.0, 3.0, 4.0]);
    assert_eq!(&u.values()[5..], [4.0, 4.0, 4.0, 8.0, 9.0, 9.0], "invalid points hold the last value");
}

#[test]
fn a_coarse_channel_has_a_coarse_gap_rule() {
    // Hourly weather under minutes: neighbours 3,600 s apart are no gap.
    let output: Vec<(i64, f64)> = (0..=120).map(|i| (60 * i, 0.0)).collect();
    let weather = series("u", Hold::Linear, &[(0, 0.0), (3_600, 60.0), (7_200, 0.0)]);
    let window = Window::from_series(vec![series("y", Hold::Linear, &output), weather]).unwrap();
    let grid = window.grid(&GridRequest::new("y", &[("u", Hold::Linear)])).unwrap();
    assert_eq!(grid.valid_share(), 1.0);
    assert_eq!(grid.column("u").unwrap().values()[90], 30.0);
}

#[test]
fn the_first_valid_value_stands_before_it() {
    let grid = gridded(series("u", Hold::Linear, &[(130, 2.0), (190, 3.0)]));
    assert_eq!(marks(&grid, "u"), "00010000000");
    assert_eq!(grid.column("u").unwrap().values()[0], grid.column("u").unwrap().values()[3]);
}

#[test]
fn fine_power_is_averaged_over_the_interval_that_its_stamp_starts() {
    // Every 20 s: 0, 3, 6 kW in the first minute, then constant.
    let mut samples = vec![(0, 0.0), (20, 3.0), (40, 6.0)];
    samples.extend((3..33).map(|i| (20 * i, 1.0)));
    let grid = gridded(series("u", Hold::ZeroOrder, &samples));
    assert!((grid.column("u").unwrap().values()[0] - 3.0).abs() < 1e-12);
    assert_eq!(grid.column("u").unwrap().values()[1], 1.0);
    assert_eq!(grid.valid_share(), 1.0);
    // Off by ten seconds: the first interval is covered for 50 of its 60 s.
    let shifted: Vec<(i64, f64)> = samples.iter().map(|(time, value)| (time + 10, *value)).collect();
    let grid = gridded(series("u", Hold::ZeroOrder, &shifted));
    assert!(
        (grid.column("u").unwrap().values()[0] - (20.0 * 0.0 + 20.0 * 3.0 + 10.0 * 6.0) / 50.0).abs() < 1e-12
    );
}

#[test]
fn power_that_is_as_coarse_as_the_grid_is_held() {
    // At 180..480 a gap of five steps: the value holds for its own step only.
    let grid = gridded(series(
        "u",
        Hold::ZeroOrder,
        &[(0, 1.0), (60, 2.0), (120, 3.0), (180, 4.0), (480, 9.0), (540, 10.0)],
    ));
    assert_eq!(marks(&grid, "u"), "11110000110");
    let held = grid.column("u").unwrap();
    assert_eq!(held.values(), [1.0, 2.0, 3.0, 4.0, 4.0, 4.0, 4.0, 4.0, 9.0, 10.0, 10.0]);
    let coarse = gridded(series("u", Hold::ZeroOrder, &[(0, 1.0), (240, 2.0), (480, 3.0)]));
    assert_eq!(marks(&coarse, "u"), "11111111111");
    assert_eq!(coarse.column("u").unwrap().values()[..5], [1.0, 1.0, 1.0, 1.0, 2.0]);
}

#[test]
fn bearings_go_the_short_way_round() {
    let grid = gridded(series("wind_direction", Hold::Linear, &[(0, 350.0), (120, 10.0), (240, 350.0)]));
    let bearing = grid.column("wind_direction").unwrap().values();
    assert!(bearing[1].abs() < 1e-9 && bearing[3].abs() < 1e-9, "{bearing:?}");
}

#[test]
fn the_step_is_the_outputs_or_what_was_asked() {
    let output: Vec<(i64, f64)> = (0..100).map(|i| (5 * i, 0.0)).collect();
    let window = Window::from_series(vec![series("y", Hold::Linear, &output)]).unwrap();
    let request = GridRequest::new("y", &[]);
    assert_eq!(window.grid(&request).unwrap().step(), MINUTE, "no finer than a minute unless asked");
    assert_eq!(window.grid(&GridRequest { step: Some(5 * SECOND), ..request }).unwrap().len(), 100);
    let part =
        window.grid(&GridRequest { from: Some(101 * SECOND), to: Some(401 * SECOND), ..request }).unwrap();
    assert_eq!((part.start(), part.len()), (105 * SECOND, 5));
}

#[test]
fn stamps_that_are_milliseconds_late_do_not_move_the_grid() {
    let late = [13, 420, 7, 90, 250, 3];
    let times = late.iter().enumerate().map(|(i, late)| i as i64 * MINUTE + late).collect();
    let output = Series::new("y", "-", Hold::Linear, times, vec![1.0; late.len()]).unwrap();
    let window = Window::from_series(vec![output]).unwrap();
    let grid = window.grid(&GridRequest::new("y", &[])).unwrap();
    assert_eq!((grid.start(), grid.step(), marks(&grid, "y").as_str()), (0, MINUTE, "111111"));
    // What is asked for in milliseconds is gridded in them.
    let times = (0..100).map(|i| 7 + 10 * i).collect();
    let fast = Series::new("y", "-", Hold::Linear, times, vec![1.0; 100]).unwrap();
    let request = GridRequest { step: Some(10), ..GridRequest::new("y", &[]) };
    let grid = Window::from_series(vec![fast]).unwrap().grid(&request).unwrap();
    assert_eq!((grid.start(), grid.len(), grid.step_hours()), (7, 100, 0.01 / 3600.0));
}

#[test]
fn what_cannot_be_gridded_is_a_fault() {
    let window = Window::from_series(vec![
        series("T_room", Hold::Linear, &[(0, 0.0), (4_000_000_000, 1.0)]),
        series("late", Hold::Linear, &[(5_000_000_000, 1.0)]),
    ])
    .unwrap();
    let request = GridRequest::new("T_room", &[]);
    let inputs = [("T_out", Hold::Linear), ("lat", Hold::Linear)];
    assert_eq!(
        codes(window.grid(&GridRequest { channels: &inputs, ..request })),
        ["missing-channel", "missing-channel"]
    );
    let fault =
        window.grid(&GridRequest { channels: &[("lat", Hold::Linear)], ..request }).unwrap_err().remove(0);
    assert_eq!(fault.suggestion.as_deref(), Some("bind it: lat=late"));
    assert_eq!(
        codes(window.grid(&GridRequest { channels: &[("late", Hold::Linear)], ..request })),
        ["no-data-in-range"]
    );
    assert_eq!(codes(window.grid(&GridRequest { step: Some(MINUTE), ..request })), ["grid-too-long"]);
    assert_eq!(codes(window.grid(&GridRequest { step: Some(0), ..request })), ["bad-step"]);
    assert_eq!(
        codes(window.grid(&GridRequest { from: Some(9 * SECOND), to: Some(SECOND), ..request })),
        ["no-data-in-range"]
    );
}

proptest! {
    #[test]
    fn no_grid_invents_or_loses_data(
        steps in proptest::collection::vec((1i64..400, any::<f64>()), 2..60),
        held in any::<bool>(),
        step in 1i64..300_000,
        max_gap_steps in 0u32..5,
    ) {
        let mut time = 0;
        let samples: Vec<(i64, f64)> = steps
            .into_iter()
            .map(|(wait, value)| {
                time += wait;
                (time, if value.is_normal() { value } else { 0.0 })
            })
            .collect();
        let hold = if held { Hold::ZeroOrder } else { Hold::Linear };
        let low = samples.iter().map(|(_, value)| *value).fold(f64::MAX, f64::min);
        let high = samples.iter().map(|(_, value)| *value).fold(f64::MIN, f64::max);
        let window = Window::from_series(vec![
            series("y", Hold::Linear, &samples),
            series("u", hold, &samples)
        ]).unwrap();
        let channels = [("u", hold)];
        let request = GridRequest { step: Some(step), max_gap_steps, ..GridRequest::new("y", &channels) };
        if let Ok(grid) = window.grid(&request) {
            let used = grid.column("y").unwrap().valid().iter().filter(|valid| **valid).count();
            prop_assert!(used <= samples.len(), "no sample counts twice");
            let tolerance = 1e-9 * low.abs().max(high.abs());
            for (_, column) in grid.columns() {
                prop_assert_eq!(column.values().len(), grid.len());
                prop_assert!(column.values().iter().all(|value| value.is_finite() && low - tolerance <= *value && *value <= high + tolerance));
            }
            // The same rules on points that are given: a piece of the grid is what the piece alone would be.
            let half = grid.len() / 2;
            let frame = Grid::new(grid.time(half), step, grid.len() - half).unwrap();
            if let Ok(piece) = window.grid_on(frame, &request) {
                for (name, column) in piece.columns() {
                    let whole = grid.column(name).unwrap();
                    prop_assert_eq!(column.valid(), &whole.valid()[half..]);
                    let same = |k: usize| !column.valid()[k] || column.values()[k] == whole.values()[half + k];
                    prop_assert!((0..piece.len()).all(same), "{}", name);
                }
            }
        }
    }
}
