//! The diagnosis of small worlds, end to end.

use super::failures::{failures, sentences};
use super::ladder::ladder;
use super::library;
use super::report::EffectGate;
use super::{Adequacy, DiagnoseError, Diagnosis, diagnose, preview};
use crate::data::{ColumnBindings, SplitRequest, Window};
use crate::estimate::assess::metrics::{ProcessNoise, filter};
use crate::estimate::assess::regimes::{regimes, with_worst_regime};
use crate::estimate::problem::request::{AccusationRate, SeededMethod};
use crate::estimate::{Control, EstimateError, EstimateRequest, Interrupt, Problem, Site, estimate, prepare};
use crate::model::Catalogue;
use crate::twin::{Level, World, WorldRequest, world};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A world of four weeks with these effects hidden, sampled every half hour.
fn small_twin(effects: &[&str]) -> World {
    world(&WorldRequest { step_minutes: 30, ..WorldRequest::new(77, effects, Level::Matched) }).unwrap()
}

/// It as a window, and its problem for room3.
pub(super) fn small_world(effects: &[&str]) -> (Problem, Window) {
    let made = small_twin(effects);
    let (window, _) = Window::parse_csv(&made.csv, &ColumnBindings::none()).unwrap();
    let request = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
    let id = "room3".parse().unwrap();
    (prepare(&Catalogue::builtin().unwrap(), &id, &request, &window, &site()).unwrap(), window)
}

const RATE: AccusationRate = AccusationRate::USUAL;

pub(super) fn site() -> Site {
    Site { sets: [("neighbours".to_owned(), vec!["1".to_owned(), "2".to_owned()])].into(), ..Site::default() }
}

pub(super) fn fitted(problem: &Problem) -> crate::estimate::Fit {
    let request = EstimateRequest {
        method: SeededMethod { seed: 3, ..SeededMethod::default() },
        ..EstimateRequest::default()
    };
    estimate(problem, &request, None, &Control::NONE).unwrap()
}

fn diagnosis(effects: &[&str]) -> Diagnosis {
    let (problem, window) = small_world(effects);
    diagnosed(&problem, &fitted(&problem).theta(), &window)
}

fn diagnosed(problem: &Problem, theta: &[f64], window: &Window) -> Diagnosis {
    let catalogue = Catalogue::builtin().unwrap();
    diagnose(&catalogue, problem, theta, window, &site(), RATE, &[], &Control::NONE).unwrap()
}

#[test]
fn the_hidden_wind_is_named_first_and_the_unseen_error_falls() {
    let found = diagnosis(&["wind_infiltration"]);
    assert_eq!(found.verdict, Adequacy::Named, "{}", found.summary);
    let first = &found.findings[0];
    assert_eq!(first.effect, "wind_infiltration");
    let [before, after] = first.rmse.test.unwrap();
    assert!(after < 0.6 * before, "{before} {after}");
    assert!(first.parameters["c_wind"].ci95.is_some_and(|[low, _]| low > 0.0));
    // What forecasts lose without it, against the twin's own equations.
    let truth = small_twin(&["wind_infiltration"]).truth.ahead;
    let size = first.size.as_ref().unwrap();
    assert!((0.85..1.15).contains(&(size.value / truth)), "{size:?} of {truth}");
    assert!(
        size.unit == "K" && size.ci95.is_some_and(|[low, high]| low > 0.5 * truth && high < 2.0 * truth),
        "{size:?} of {truth}"
    );
    let solar = found.not_testable.iter().find(|one| one.effect == "solar_gain").unwrap();
    assert!(solar.reason.contains("own parameters"), "{}", solar.reason);
    assert!(found.considered.iter().all(|one| one.gate.is_some() || one.effect == "wind_infiltration"));
}

/// The two lines against each other and against the errors that the finding states.
#[test]
fn the_shape_of_the_wind_is_that_of_the_error() {
    let (problem, window) = small_world(&["wind_infiltration"]);
    let theta = fitted(&problem).theta();
    let found = diagnosed(&problem, &theta, &window);
    let (first, shape) = (&found.findings[0], found.findings[0].shape.as_ref().unwrap());
    assert_eq!((shape.unit.as_str(), shape.time.len()), ("K", shape.unexplained.len()));
    assert!(
        shape.effect.len() == shape.time.len() && (300..=400).contains(&shape.time.len()),
        "{} points",
        shape.time.len()
    );
    let pairs: Vec<(f64, f64)> =
        shape.unexplained.iter().zip(&shape.effect).filter_map(|(u, e)| u.zip(*e)).collect();
    let n = pairs.len() as f64;
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / n;
    let (u, e) = (mean(&|pair| pair.0), mean(&|pair| pair.1));
    let (uu, ee, ue) = (
        mean(&|pair| (pair.0 - u).powi(2)),
        mean(&|pair| (pair.1 - e).powi(2)),
        mean(&|pair| (pair.0 - u) * (pair.1 - e)),
    );
    assert!(ue / (uu * ee).sqrt() > 0.9, "{}", ue / (uu * ee).sqrt());
    // Means of two hours hide only noise: what is unexplained is the error without it, and the gap that with
    // it.
    let unseen = shape.time.iter().position(|time| *time >= shape.validation_from).unwrap();
    let rms = |of: &dyn Fn(&(f64, f64)) -> f64| {
        (pairs[..unseen].iter().map(|pair| of(pair).powi(2)).sum::<f64>() / unseen as f64).sqrt()
    };
    let noise: f64 = 0.07;
    for (mine, told) in
        [(rms(&|pair| pair.0), first.rmse.train[0]), (rms(&|pair| pair.0 - pair.1), first.rmse.train[1])]
    {
        assert!(mine < told && told.powi(2) - mine.powi(2) < noise.powi(2), "{mine} beside {told}");
    }

    let added = shape.added.as_ref().unwrap();
    assert!((0.6..1.4).contains(&added.slope), "{}", added.slope);
    assert!(added.bins.len() == 10 && added.bins.windows(2).all(|pair| pair[0].effect < pair[1].effect));
    let (first, last) = (&added.bins[0], added.bins.last().unwrap());
    assert!(first.unexplained_ci95.unwrap()[1] < last.unexplained_ci95.unwrap()[0], "{first:?} {last:?}");
}

/// An effect with a delay knows nothing behind the start and behind each gap: then no model may be judged
/// there.
#[test]
fn all_candidates_are_judged_on_the_same_samples() {
    let (problem, window) = small_world(&[]);
    let (catalogue, site) = (Catalogue::builtin().unwrap(), site());
    let (mut library, _) =
        library::EffectSource::new(&catalogue, &problem, &window, &site).unwrap().candidates(&problem);
    let all = 0..problem.grid().len();
    let delayed = |library: &[library::CandidateEffect]| {
        library.iter().find(|candidate| candidate.id == "pipe_delay").unwrap().problem.clone()
    };
    let before = delayed(&library).usable(0, all.clone()).len();
    assert!(before < problem.usable(0, all.clone()).len());
    let problem = library::align(&problem.with_substeps(5), &mut library);
    assert_eq!(problem.usable(0, all.clone()).len(), before);
    assert!(
        library
            .iter()
            .all(|candidate| candidate.problem.usable(0, all.clone()) == problem.usable(0, all.clone()))
    );
    assert!(library.iter().all(|candidate| candidate.problem.simulator().substeps() == 5));
}

#[test]
fn nothing_is_named_where_nothing_is_hidden_and_a_stove_is_unknown() {
    let nothing = diagnosis(&[]);
    assert!(nothing.findings.is_empty(), "{}", nothing.summary);
    assert_eq!(nothing.verdict, Adequacy::Adequate, "rho {:?}", nothing.rho);
    let stove = diagnosis(&["stove"]);
    assert_eq!(stove.verdict, Adequacy::Unknown, "{}", stove.summary);
    assert!(stove.unexplained.ask.is_some() && stove.unexplained.profile_by_hour.len() == 24);
    let by_hour = |hour: usize| stove.unexplained.profile_by_hour[hour].unwrap();
    assert!(by_hour(20) > by_hour(10), "a stove warms in the evening");
}

#[test]
fn a_diagnosis_is_the_same_on_one_thread_and_on_two() {
    let (problem, window) = small_world(&["metered_gain"]);
    let theta = fitted(&problem).theta();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| diagnosed(&problem, &theta, &window));
        serde_json::to_string(&found).unwrap()
    };
    let one = on(1);
    assert_eq!(one, on(2));
    let back: Diagnosis = serde_json::from_str(&one).unwrap();
    assert_eq!(back.findings[0].effect, "metered_gain:P_appliances");
}

#[test]
fn the_preview_and_the_ladder_begin_with_the_hidden_effect() {
    let (problem, window) = small_world(&["metered_gain"]);
    let theta = fitted(&problem).theta();
    let catalogue = Catalogue::builtin().unwrap();
    let previews = preview(&catalogue, &problem, &theta, &window, &site()).unwrap();
    assert_eq!(previews[0].effect, "metered_gain:P_appliances");
    let found = ladder(&catalogue, &problem, &theta, &window, &site(), 2, &Control::NONE).unwrap();
    assert_eq!(found.steps[1].added.as_deref(), Some("metered_gain:P_appliances"));
    assert!(found.steps[1].kept && found.steps[1].bic < found.steps[0].bic);
    assert!(found.steps[1].validation_rmse < found.steps[0].validation_rmse);
    assert!(
        found.steps[1].why.starts_with("the error on unseen data falls: of the free run from "),
        "{}",
        found.steps[1].why
    );
    assert!(
        found.steps.windows(2).all(|pair| pair[1].train_rmse <= pair[0].train_rmse + 1e-6),
        "larger models fit no worse"
    );
}

#[test]
fn a_withheld_channel_is_named_as_not_testable_and_short_records_as_too_short() {
    let (problem, window) = small_world(&[]);
    let theta = problem.nominal().to_vec();
    let request = EstimateRequest {
        split: SplitRequest {
            train: "P2D".parse().unwrap(),
            validation: "P1D".parse().unwrap(),
            test: Some("P0D".parse().unwrap()),
        },
        ..EstimateRequest::default()
    };
    let catalogue = Catalogue::builtin().unwrap();
    let short = prepare(&catalogue, problem.model().id(), &request, &window, &site()).unwrap();
    let found = diagnosed(&short, &theta, &window);
    assert_eq!(found.verdict, Adequacy::NotEnoughData);
    let series = window.iter().filter(|series| series.channel() != "wind_speed").cloned().collect();
    let calm = Window::from_series(series).unwrap();
    let found = diagnosed(&problem, &theta, &calm);
    assert!(
        found
            .not_testable
            .iter()
            .any(|one| one.effect == "wind_infiltration" && one.reason == "needs channel wind_speed")
    );
    assert!(
        found.considered.iter().all(|one| one.effect != "sensor_lag" || one.gate != Some(EffectGate::Tie))
    );
}

/// Wherever it is called off, it says so, and hardly anything is simulated any more.
#[test]
fn a_diagnosis_that_is_called_off_ends_where_it_is() {
    let (problem, window) = small_world(&["wind_infiltration"]);
    let (theta, catalogue) = (fitted(&problem).theta(), Catalogue::builtin().unwrap());
    let cancelled = DiagnoseError::Estimate(EstimateError::Interrupted(Interrupt::Cancelled));
    // How often it asks whether to go on, and how it ends, where it is called off after so many times.
    let asked = |most: usize, climbs: bool| {
        let asked = AtomicUsize::new(0);
        let interrupt = || (asked.fetch_add(1, Ordering::Relaxed) >= most).then_some(Interrupt::Cancelled);
        let control = Control { interrupt: &interrupt, ..Control::NONE };
        let end = if climbs {
            ladder(&catalogue, &problem, &theta, &window, &site(), 2, &control).err()
        } else {
            diagnose(&catalogue, &problem, &theta, &window, &site(), RATE, &[], &control).err()
        };
        (asked.into_inner(), end)
    };
    for climbs in [false, true] {
        let (all, end) = asked(usize::MAX, climbs);
        assert_eq!(end, None);
        for percent in [0, 1, 10, 30, 50, 70, 90] {
            let most = all * percent / 100;
            let (times, end) = asked(most, climbs);
            println!("called off after {most} of {all} times: {} more", times - most);
            assert_eq!(end.as_ref(), Some(&cancelled), "after {percent} %");
            assert!(times - most < 500, "{} times after the end, of {all}", times - most);
        }
    }
}

#[test]
fn failures_say_where_the_wind_is_missing() {
    let (problem, window) = small_world(&["wind_infiltration"]);
    let fit = fitted(&problem);
    let run = filter(&problem, &fit.theta(), ProcessNoise::Known(fit.process_noise));
    let found = failures(&problem, &fit, 0, &run, &window).unwrap();
    assert_eq!(found, failures(&problem, &fit, 0, &run, &window).unwrap());
    // The model has no wind, and yet its errors are told by the wind.
    let windy = found.by_regime.iter().find(|regime| regime.regime == "wind_speed high").unwrap();
    assert!(
        windy.bias_ci95.is_some_and(|[_, high]| high < 0.0) && windy.error_share > windy.time_share,
        "{windy:?}"
    );
    assert!(
        found.residual_by_input.iter().any(|input| input.channel == "wind_speed" && input.correlation < 0.0)
    );
    for input in &found.residual_by_input {
        assert_eq!((input.lags_hours[0], *input.lags_hours.last().unwrap()), (0.0, 24.0));
        let strongest = input
            .lags_hours
            .iter()
            .zip(&input.correlations)
            .find(|(lag, _)| **lag == input.lag_hours)
            .unwrap();
        assert_eq!(*strongest.1, input.correlation);
        assert_eq!(input.feedback, ["flow", "valve"].contains(&input.channel.as_str()), "{}", input.channel);
    }
    let told = sentences(&problem, 0, &found);
    assert!(told.iter().any(|sentence| sentence.starts_with("wind_speed high: T_room is ")), "{told:?}");
    assert_eq!(with_worst_regime(fit, &problem, &window).unwrap().worst_regime.as_ref(), told.first());
    assert_eq!(found.episodes.len(), 5);
    assert!(found.hour_by_date.len() >= 28 && found.hour_by_date.iter().all(|day| day.hours.len() == 24));
    let worst: f64 = found.episodes.iter().map(|episode| episode.share).sum();
    assert!(worst > 0.0 && worst <= 1.0);
}

#[test]
fn the_share_of_the_error_in_a_regime_is_that_of_the_closed_form() {
    let (problem, _) = small_world(&[]);
    let grid = problem.grid();
    let out = grid.column("T_out").unwrap().values();
    let usable: Vec<usize> = (0..grid.len()).collect();
    // The error changes where the upper third of the outdoor temperatures begins, whatever the weather.
    let mut sorted = out.to_vec();
    sorted.sort_by(f64::total_cmp);
    let limit = sorted[2 * sorted.len() / 3];
    let error: Vec<f64> = out.iter().map(|t| if *t > limit { 0.5 } else { -0.1 }).collect();
    let found = regimes(&problem, grid, &error, &usable, 1);
    let warm = found.iter().find(|one| one.regime == "T_out high").unwrap();
    assert_eq!(warm.bias, 0.5);
    assert!((warm.time_share - 1.0 / 3.0).abs() < 0.01, "{}", warm.time_share);
    let (high, low) = (0.25 * warm.time_share, 0.01 * (1.0 - warm.time_share));
    assert!((warm.error_share - high / (high + low)).abs() < 1e-9, "{}", warm.error_share);
    assert!(warm.bias_ci95.is_some_and(|[low, high]| low <= 0.5 && 0.5 <= high));
    assert_eq!(found, regimes(&problem, grid, &error, &usable, 1), "the same seed resamples the same days");
}
