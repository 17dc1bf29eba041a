//! The largest likelihood of rooms: it is found, the same on any number of threads, and says what it rests
//! on.

use super::objective::LikelihoodObjective;
use crate::data::ColumnBindings;
use crate::data::Window;
use crate::estimate::problem::request::{EstimateRequest, Site, prepare};
use crate::estimate::run::estimate;
use crate::estimate::{Control, Interrupt, Problem, Stop};
use crate::model::Catalogue;
use crate::twin;
use serde_json::json;

/// A room of the thesis's kind without neighbours, as a problem.
fn room(seed: u64, split: serde_json::Value) -> (Problem, EstimateRequest) {
    let twin = twin::room(seed, 0, 9, 30).unwrap();
    let (window, _) = Window::parse_csv(&twin.csv, &ColumnBindings::none()).unwrap();
    let request: EstimateRequest =
        serde_json::from_value(json!({"method": {"name": "ctsm", "seed": 3}, "split": split})).unwrap();
    let catalogue = Catalogue::builtin().unwrap();
    (prepare(&catalogue, &"room3".parse().unwrap(), &request, &window, &Site::default()).unwrap(), request)
}

#[test]
fn slopes_in_the_cube_equal_high_order_differences() {
    for (prior, unit) in [("none", 0.5), ("log_normal", 0.4)] {
        let (problem, request) = room(2, json!({"train": "P3D", "validation": "P1D"}));
        let request = EstimateRequest { prior: serde_json::from_value(json!(prior)).unwrap(), ..request };
        let problem = Problem::new(
            problem.model().clone(),
            problem.grid().clone(),
            problem.split().clone(),
            &request.choices(),
            problem.source().clone(),
        )
        .unwrap();
        let task = LikelihoodObjective::new(&problem);
        let mut place = task.start(&problem.candidate(problem.nominal())).0;
        place.iter_mut().enumerate().for_each(|(i, x)| *x += 0.1 * (unit - *x) + 0.002 * i as f64);
        let moving: Vec<usize> = (0..place.len()).filter(|i| i % 5 != 4).collect();
        let slope = task.slope(&place, &moving).unwrap();
        assert_eq!(Some(slope.value), task.value(&place));
        let largest = slope.gradient.iter().fold(0.0f64, |largest, slope| largest.max(slope.abs()));
        for (index, i) in moving.iter().enumerate() {
            let h = 2e-4;
            let at = |by: f64| {
                let mut moved = place.clone();
                moved[*i] += by * h;
                task.value(&moved).unwrap()
            };
            let d = |k: f64| at(k) - at(-k);
            let difference = (d(1.0) * 672.0 - d(2.0) * 168.0 + d(3.0) * 32.0 - d(4.0) * 3.0) / (840.0 * h);
            let scale = slope.gradient[index].abs().max(1e-3 * largest);
            assert!(
                (slope.gradient[index] - difference).abs() < 1e-6 * scale,
                "{prior} {i}: {} {difference}",
                slope.gradient[index]
            );
        }
    }
}

#[test]
fn a_nonlinear_room_converges_to_the_same_bits_on_any_number_of_threads() {
    let (problem, request) = room(4, json!({"train": "P6D", "validation": "P3D"}));
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| estimate(&problem, &request, None, &Control::NONE)).unwrap()
    };
    let fit = on(1);
    assert_eq!(serde_json::to_string(&fit).unwrap(), serde_json::to_string(&on(2)).unwrap());
    assert_eq!(
        (fit.stopped_by, fit.objective.as_str(), fit.method.as_str()),
        (Stop::Converged, "likelihood", "ctsm")
    );
    let found = fit.likelihood.as_ref().unwrap();
    assert!(!found.exact);
    assert_eq!(found.estimated, problem.space().len() + 3 + 1);
    assert!((found.aic - 2.0 * found.estimated as f64 + 2.0 * found.log_likelihood).abs() < 1e-9);
    // The twin's sensor errs by 0.05 K and rounds to 0.1 K; it has no process noise.
    let sensor = found.measurement["T_room"].value;
    assert!((0.04..0.08).contains(&sensor), "{sensor}");
    let ahead = &fit.first_metrics().unwrap().ahead["PT6H"];
    assert!(ahead.rmse < 0.2 * ahead.persistence, "{ahead:?}");
    // The best start is the fit, and a profile peaks at its estimate.
    let best = found.starts.iter().filter_map(|start| start.to).fold(f64::NEG_INFINITY, f64::max);
    assert!((best - found.log_likelihood).abs() < 0.1, "{best} {}", found.log_likelihood);
    assert!(!found.profiles.is_empty());
    for (name, profile) in &found.profiles {
        let peak = profile.log_likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        assert!(
            peak < found.log_likelihood + 1e-2,
            "{name}: {peak} {} {:?}",
            found.log_likelihood,
            found.starts
        );
        assert!(profile.values.is_sorted(), "{name}");
    }
}

#[test]
fn a_deadline_leaves_what_was_found() {
    let (problem, request) = room(4, json!({"train": "P3D", "validation": "P1D"}));
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let interrupt =
        || (asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) > 40).then_some(Interrupt::Deadline);
    let fit =
        estimate(&problem, &request, None, &Control { interrupt: &interrupt, ..Control::NONE }).unwrap();
    let found = fit.likelihood.unwrap();
    assert_eq!(fit.stopped_by, Stop::Deadline);
    assert!(found.reason.starts_with("the wall time is used up"), "{}", found.reason);
    assert!(found.log_likelihood.is_finite());
}
