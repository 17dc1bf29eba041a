//! Segments, the free regression, opponents and channels: against plain sums, closed forms and rooms whose
//! truth is known.

use super::channels::{faults, strangers};
use super::evidence::{Evidence, Rival};
use super::opponents;
use super::regression::{PairedComparison, Regression};
use crate::data::{ColumnBindings, HOUR, Window};
use crate::estimate::assess::metrics::{ProcessNoise, filter, filter_fit};
use crate::estimate::fit::levels::{ChannelLevel, levels};
use crate::estimate::problem::Problem;
use crate::estimate::problem::request::{EstimateRequest, Site, prepare};
use crate::estimate::run::estimate;
use crate::estimate::segments::Segments;
use crate::estimate::{Control, Fit};
use crate::model::Catalogue;
use crate::optimise::Method;
use crate::optimise::multistart::LmOptions;
use crate::simulate::segment::Stretch;
use crate::twin;
use std::sync::LazyLock;

const DAYS: usize = 14;

/// A room with one neighbour, sampled every half hour, with the parameters that made it, and a fit.
static ROOM: LazyLock<(String, Problem, Fit)> = LazyLock::new(|| {
    let made = twin::room(909, 1, DAYS, 30).unwrap();
    let problem = problem(&made.csv);
    let fit = estimate(&problem, &asked(), None, &Control::NONE).unwrap();
    (made.csv, problem, fit)
});

fn asked() -> EstimateRequest {
    let mut asked = EstimateRequest::default();
    asked.method.method = Method::LmMultistart(LmOptions::default());
    asked
}

fn problem(csv: &str) -> Problem {
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::none()).unwrap();
    let site = Site { sets: [("neighbours".to_owned(), vec!["1".to_owned()])].into(), ..Site::default() };
    prepare(&Catalogue::builtin().unwrap(), &"room3".parse().unwrap(), &asked(), &window, &site).unwrap()
}

/// The record with another value of one column at every row: from the row, its own values and the row's
/// number.
fn rewritten(csv: &str, name: &str, change: impl Fn(usize, &[f64]) -> f64) -> String {
    let (head, rows) = csv.split_once('\n').unwrap();
    let place = head.split(',').position(|known| known == name).unwrap();
    let cells: Vec<Vec<&str>> = rows.lines().map(|row| row.split(',').collect()).collect();
    let column: Vec<f64> = cells.iter().map(|cells| cells[place].parse().unwrap()).collect();
    let line = |(k, cells): (usize, &Vec<&str>)| {
        let value = format!("{:.4}", change(k, &column));
        let cells: Vec<&str> = cells
            .iter()
            .enumerate()
            .map(|(i, cell)| if i == place { value.as_str() } else { *cell })
            .collect();
        cells.join(",") + "\n"
    };
    format!("{head}\n{}", cells.iter().enumerate().map(line).collect::<String>())
}

fn evidence(problem: &Problem, fit: &Fit) -> Evidence {
    let problem = fit.simulated(problem);
    Evidence::of(&problem, &fit.theta(), &filter_fit(&problem, fit))
}

#[test]
fn a_segment_from_the_states_of_the_free_run_is_the_free_run() {
    let (_, problem, fit) = &*ROOM;
    let theta = fit.theta();
    let run = problem.simulate(&theta);
    let start: Vec<f64> = run.states.iter().map(|series| series[100]).collect();
    let from = |start| Stretch { samples: 100..190, theta: &theta, start };
    let stretch = problem.simulator().run_stretches(&[from(&start)]);
    assert_eq!(stretch[0][0], run.outputs[0][100..190], "bit for bit");
    // In a block of lanes each pair is what it is alone.
    let other: Vec<f64> = start.iter().map(|value| value + 1.0).collect();
    let several = problem.simulator().run_stretches(&[from(&other), from(&start), from(&other)]);
    assert_eq!((&several[1], several[0] == several[2]), (&stretch[0], true));
}

#[test]
fn starts_take_no_part_and_a_direction_is_found_at_its_size() {
    let (_, problem, fit) = &*ROOM;
    let theta = fit.theta();
    let run = filter(problem, &theta, ProcessNoise::Likeliest);
    let segments = Segments::new(problem, 0..problem.grid().len(), 24.0).unwrap();
    assert_eq!(segments.first_samples().count(), DAYS);
    let starts: Vec<Vec<f64>> = segments.first_samples().map(|k| run.filtered.states[k].clone()).collect();
    let linear = segments.linearise(problem, problem.simulator(), &theta, &starts).unwrap();
    // From other starts the same is left: this room is nearly linear in them.
    let elsewhere: Vec<Vec<f64>> =
        starts.iter().map(|start| start.iter().map(|value| value + 0.05).collect()).collect();
    let moved = segments.linearise(problem, problem.simulator(), &theta, &elsewhere).unwrap();
    let apart = linear.residual.iter().zip(&moved.residual).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 0.01, "{apart}");
    let rms = (linear.residual.iter().map(|r| r * r).sum::<f64>() / linear.residual.len() as f64).sqrt();
    assert!((0.04..0.06).contains(&rms), "the noise of the sensor is 0.05 K: {rms}");
    // What the outdoor temperature does, laid on the residual seven tenths as large, is found at that size
    // and surely.
    let inputs = problem.inputs();
    let out = problem.model().inputs().iter().position(|input| input.channel == "T_out").unwrap();
    let still =
        problem.simulator().with_inputs(&inputs.with_values(out, vec![inputs.mean(out); inputs.samples()]));
    let outputs = |simulator| segments.outputs(problem, simulator, &[&theta], &starts).remove(0);
    let (with, without) = (outputs(problem.simulator()), outputs(&still));
    let direction = segments
        .without_starts(&linear, with.iter().zip(&without).map(|(with, without)| with - without).collect());
    let laid: Vec<f64> = linear
        .residual
        .iter()
        .zip(&direction)
        .map(|(residual, direction)| residual + 0.7 * direction)
        .collect();
    let found = segments.explained(&laid, &direction).unwrap();
    assert!((found.size - 0.7).abs() < 0.1 && found.t > 10.0 && found.share > 0.5, "{found:?}");
    // The t by plain sums over days.
    let day = |row: usize| row / 48;
    let gg: f64 = direction.iter().map(|g| g * g).sum();
    let size = direction.iter().zip(&laid).map(|(g, r)| g * r).sum::<f64>() / gg;
    let mut scores = [0.0; DAYS];
    direction
        .iter()
        .zip(&laid)
        .enumerate()
        .for_each(|(row, (g, r))| scores[day(row).min(DAYS - 1)] += g * (r - size * g));
    let n = DAYS as f64;
    let t = size * gg / (n / (n - 1.0) * scores.iter().map(|score| score * score).sum::<f64>()).sqrt();
    assert!((found.t / t - 1.0).abs() < 1e-9, "{} {t}", found.t);
}

#[test]
fn a_room_that_follows_its_inputs_says_so() {
    let (_, problem, fit) = &*ROOM;
    let found = evidence(problem, fit);
    println!("{found:#?}");
    let of = |channel: &str| found.inputs.iter().find(|input| input.channel == channel).unwrap();
    for channel in ["T_forward", "T_out"] {
        let input = of(channel);
        assert!(
            input.is_seen() && !input.is_mirrored() && !input.is_unheard() && input.better().is_none(),
            "{input:?}"
        );
        let (explained, _) = input.claimed.unwrap();
        assert!((0.6..1.6).contains(&explained.size), "{explained:?}");
    }
    assert!(found.unexplained.unwrap() < 1.5, "{:?}", found.unexplained);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| evidence(problem, fit))
    };
    assert_eq!(on(1), on(2));
}

#[test]
fn a_late_channel_a_mirrored_one_and_a_wrong_one_are_told_apart() {
    let (csv, ..) = &*ROOM;
    let followed = |csv: &str, channel: &str| {
        let problem = problem(csv);
        let regression = Regression::new(&problem).unwrap();
        let input = problem.model().inputs().iter().position(|input| input.channel == channel).unwrap();
        let beside = regression.beside(input).unwrap();
        (beside.followed(), beside.shifted(3).unwrap(), beside.shift_p())
    };
    let (clean, earlier, p) = followed(csv, "T_out");
    assert!(
        clean.gain_t > 3.0 && clean.without.ratio > 1.2 && earlier.ratio > 0.97 && p < 0.1,
        "{clean:?} {earlier:?} {p}"
    );
    let (mirrored, ..) = followed(&rewritten(csv, "T_out", |k, values| 4.0 - values[k]), "T_out");
    assert!((mirrored.gain_t + clean.gain_t).abs() < 1e-3 * clean.gain_t, "{mirrored:?}");
    let (_, right, _) = followed(&rewritten(csv, "T_out", |k, values| values[k.saturating_sub(6)]), "T_out");
    assert!(right.ratio < 0.85 && right.t > 3.0, "three hours late: {right:?}");
    let wrong =
        followed(&rewritten(csv, "T_out", |k, values| values[(k * 7919 + 13) % values.len()]), "T_out");
    assert!(wrong.0.gain_t.abs() < 3.0 && wrong.2 > 0.1, "{wrong:?}");
    // Put to the whole of the evidence, the late channel is named.
    let late = problem(&rewritten(csv, "T_out", |k, values| values[k.saturating_sub(12)]));
    let fit = estimate(&late, &asked(), None, &Control::NONE).unwrap();
    let found = evidence(&late, &fit);
    let better: Vec<&Rival> =
        found.inputs.iter().filter_map(|input| input.better()).map(|(rival, _)| rival).collect();
    assert_eq!(better, [&Rival::Late(6)]);
}

#[test]
fn a_regression_loses_by_what_it_is_denied() {
    let (_, problem, _) = &*ROOM;
    let regression = Regression::new(problem).unwrap();
    // Without an input the error grows; with itself in its own place it stays.
    let beside = regression.beside(regression.inputs().next().unwrap()).unwrap();
    let (followed, itself) = (beside.followed(), beside.shifted(0).unwrap());
    assert!(followed.without.ratio > 1.0 && (itself.ratio - 1.0).abs() < 1e-9, "{followed:?} {itself:?}");
    let (_, all) = regression.with_all_shifted(&[0]).next().unwrap();
    assert!((all.ratio - 1.0).abs() < 1e-12 && all.t == 0.0, "{all:?}");
    // Two days of 4 and 9 beside 1 and 3: ratio 13 / 4, differences -3 and -6.
    let compared = PairedComparison::of(&[1.0, 3.0], &[4.0, 9.0]);
    assert!(
        (compared.ratio - 13.0 / 4.0).abs() < 1e-15
            && (compared.t + 4.5 / (4.5f64 / 2.0).sqrt()).abs() < 1e-12,
        "{compared:?}"
    );
}

#[test]
fn a_room_that_repeats_itself_is_forecast_by_its_profile() {
    let (csv, ..) = &*ROOM;
    let wave = |k: usize| 20.0 + 2.0 * (std::f64::consts::TAU * (k / 2) as f64 / 24.0).sin();
    let problem = problem(&rewritten(csv, "T_room", |k, _| wave(k)));
    let theta = problem.nominal().to_vec();
    let met = opponents::without_inputs(
        &problem,
        &theta,
        &filter(&problem, &theta, ProcessNoise::Likeliest),
        6 * HOUR,
    )
    .unwrap();
    assert!(met.opponent < 1e-3 && met.fit > 0.1 && met.ratio() > 100.0, "{met:?}");
    let (_, good, fit) = &*ROOM;
    let run = filter_fit(good, fit);
    let met = opponents::without_inputs(good, &fit.theta(), &run, 6 * HOUR).unwrap();
    assert!(met.ratio() < 0.8 && met.t > 1.0, "{met:?}");
    let beside =
        opponents::with_regression(good, &fit.theta(), &run, &Regression::new(good).unwrap()).unwrap();
    assert!(beside.ratio() < 1.2, "{beside:?}");
}

#[test]
fn channels_that_cannot_be_what_their_names_say() {
    let (csv, good, _) = &*ROOM;
    assert_eq!(faults(good), []);
    let said = |name: &str, change: &dyn Fn(usize, &[f64]) -> f64| {
        let found = faults(&problem(&rewritten(csv, name, change)));
        assert!(found.iter().all(|fault| fault.channel == name), "{found:?}");
        found.into_iter().map(|fault| fault.says).collect::<Vec<_>>().join("; ")
    };
    let half = DAYS * 24;
    assert!(
        said("T_forward", &|k, values| if k > half { values[half] } else { values[k] })
            .contains("one value for")
    );
    let dithered = |k: usize| 0.2 * ((k * 7919 % 101) as f64 / 101.0 - 0.5);
    assert!(said("T_forward", &|k, _| 35.0 + dithered(k)).contains("noise about a constant"));
    assert!(
        said("T_out", &|k, values| if k > half { 1.8 * values[k] + 32.0 } else { values[k] })
            .contains("steps by")
    );
    assert!(said("T_out", &|k, values| 1.8 * values[k] + 32.0).contains("height of the sun"));
    assert!(said("T_room_1", &|k, values| values[k] - 20.0).contains("no room has"));
    let (head, rows) = csv.split_once('\n').unwrap();
    let room: Vec<f64> = rows.lines().map(|row| row.split(',').nth(1).unwrap().parse().unwrap()).collect();
    assert!(head.starts_with("time,T_room,"));
    assert!(said("T_forward", &|k, _| room[k] + 0.01).contains("same sensor"));
    assert!(
        said("T_room_1", &|k, values| values[(k / 48 * 5 + 3) % DAYS * 48 + k % 48])
            .contains("days in order")
    );
}

#[test]
fn a_level_that_stepped_since_the_last_accepted_month_is_seen() {
    let (_, problem, _) = &*ROOM;
    let now = levels(problem);
    assert_eq!(strangers(&now, &now, "then"), []);
    let mut before = now.clone();
    let room = before["T_room"];
    before["T_room"] = ChannelLevel { mean: room.mean - 3.5, sd: room.sd };
    before["T_out"] = ChannelLevel { sd: 10.0 * before["T_out"].sd, ..before["T_out"] };
    let found = strangers(&now, &before, "the parameters served now");
    assert_eq!(found.iter().map(|fault| fault.channel.as_str()).collect::<Vec<_>>(), ["T_room", "T_out"]);
    assert!(found[0].says.contains("+3.5 K"), "{}", found[0].says);
}
