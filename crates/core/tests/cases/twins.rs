//! Synthetic rooms with a known truth: what a fit finds, what the gate says, and that threads change nothing.

use super::{fit, problem, request};
use lampyris_core::estimate::fit::Searched;
use lampyris_core::estimate::problem::objective::Objective;
use lampyris_core::estimate::problem::prior::Prior;
use lampyris_core::estimate::problem::request::{EstimateRequest, SearchExtent};
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{
    Control, EarlyStopping, GatePolicy, Incumbent, Past, Problem, Progress, Site, Stop, Verdict, estimate,
};
use lampyris_core::twin::{self, RoomTwin};

fn room(seed: u64, days: usize, asked: &EstimateRequest) -> (RoomTwin, Problem) {
    let twin = twin::room(seed, 2, days, 30).unwrap();
    let site = Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
    let problem = problem(&twin.csv, "room3", &[], &site, asked);
    (twin, problem)
}

#[test]
fn a_well_specified_room_is_fitted_to_its_noise_and_accepted() {
    let asked = request("P10D", "P4D", "P0D", 21);
    for seed in [401, 402, 403] {
        let (_, problem) = room(seed, 14, &asked);
        let fit = fit(&problem, &asked);
        let metrics = fit.first_metrics().unwrap();
        println!(
            "twin {seed}: train {:.4}, validation {:?}, {:?}",
            metrics.train_rmse, metrics.validation_rmse, fit.stopped_by
        );
        assert!(metrics.train_rmse < 0.055, "{}", metrics.train_rmse);
        assert!(metrics.validation_rmse.unwrap() < 0.08);
        let judgement = validate(&problem, &fit, &Past::default(), &GatePolicy::default());
        assert!(matches!(judgement.verdict, Verdict::Accepted(_)), "{}", judgement.summary);
    }
}

#[test]
fn what_is_sought_at_half_hours_is_an_optimum_at_ten_minutes() {
    let asked = request("P10D", "P4D", "P0D", 27);
    let of = |seed: u64, minutes: usize| {
        let twin = twin::room(seed, 2, 14, minutes).unwrap();
        let sets = [("neighbours".to_owned(), twin.neighbours.clone())].into();
        let problem = problem(&twin.csv, "room3", &[], &Site { sets, ..Site::default() }, &asked);
        (twin.theta, problem)
    };
    for seed in [441, 442] {
        let (truth, problem) = of(seed, 10);
        let coarser = problem.coarser().unwrap();
        let (fine, coarse) = (problem.simulate(&truth), coarser.simulate(&truth));
        let apart =
            coarse.outputs[0].iter().zip(fine.outputs[0].iter().step_by(3)).map(|(a, b)| (a - b).abs());
        let apart = apart.fold(0.0, f64::max);
        let found = fit(&problem, &asked);
        let cost = |problem: &Problem| problem.evaluate(&[problem.candidate(&truth)], false)[0].cost.value();
        println!("twin {seed}: {apart:.4} K apart, {:.6} K2 beside {:.6}", found.cost, cost(&problem));
        assert_eq!(
            (coarser.grid().len(), coarser.grid().step_hours()),
            (problem.grid().len().div_ceil(3), 0.5)
        );
        assert!(apart < 0.1 && found.cost <= cost(&problem), "{apart} {}", found.cost);
        assert!((cost(&coarser) / cost(&problem) - 1.0).abs() < 0.2, "{}", cost(&coarser));
        assert!(coarser.coarser().is_none() && problem.with_substeps(2).coarser().is_none());
    }
    // Points half an hour apart are left as they are.
    assert!(of(443, 30).1.coarser().is_none());
}

#[test]
fn a_fit_is_bit_identical_on_one_and_two_threads() {
    let asked = request("P7D", "P2D", "P0D", 22);
    let (_, problem) = room(411, 9, &asked);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| serde_json::to_string(&fit(&problem, &asked)).unwrap())
    };
    assert_eq!(on(1), on(2));
}

#[test]
fn a_worse_fit_loses_to_the_incumbent_and_a_jump_waits_for_an_operator() {
    let asked = request("P10D", "P4D", "P0D", 23);
    let (_, problem) = room(421, 14, &asked);
    let good = fit(&problem, &asked);
    let incumbent = Incumbent::of(&good).unwrap();
    let again = validate(&problem, &good, &Past::of(Some(incumbent.clone())), &GatePolicy::default());
    assert!(matches!(again.verdict, Verdict::Accepted(_)), "{}", again.summary);
    let mut worse = asked.clone();
    worse.fixed.insert("alpha_a".into(), 2.0);
    let (_, crippled) = room(421, 14, &worse);
    let judgement = validate(
        &crippled,
        &fit(&crippled, &worse),
        &Past::of(Some(incumbent.clone())),
        &GatePolicy::default(),
    );
    assert!(
        matches!(judgement.verdict, Verdict::Rejected | Verdict::Held(_) | Verdict::Unchanged),
        "{}",
        judgement.summary
    );
    assert!(!judgement.failed().is_empty(), "{}", judgement.summary);
}

#[test]
fn a_night_begins_at_what_is_served_and_looks_everywhere_where_that_disappoints() {
    let asked = request("P10D", "P4D", "P0D", 26);
    let (_, problem) = room(427, 14, &asked);
    let good = fit(&problem, &asked);
    assert_eq!(good.searched, Some(Searched::Global));
    let nightly = EstimateRequest { search: SearchExtent::Local, ..asked };
    let night =
        |incumbent: &Incumbent| estimate(&problem, &nightly, Some(incumbent), &Control::NONE).unwrap();
    let mut served = Incumbent::of(&good).unwrap();
    served.theta.values_mut().for_each(|value| *value *= 1.03);
    let found = night(&served);
    assert_eq!(found.searched, Some(Searched::Local), "{:?}", found.remarks);
    assert!(found.cost <= 1.001 * good.cost, "{} {}", found.cost, good.cost);
    assert!(3 * found.evaluations < good.evaluations, "{} {}", found.evaluations, good.evaluations);
    // What has promised more than there is was in another place.
    served.errors.values_mut().for_each(|error| *error *= 0.8);
    let found = night(&served);
    assert_eq!(found.searched, Some(Searched::Global));
    assert!(found.remarks.iter().any(|remark| remark.starts_with("everywhere was searched")), "{found:?}");
    // What the data have not determined stays as it is, and what they do is free again.
    served.errors.values_mut().for_each(|error| *error *= 2.0);
    for (name, stays) in [("alpha_e", true), ("alpha_a", false)] {
        served.undetermined = vec![name.to_owned()];
        let found = night(&served);
        assert_eq!(found.searched, Some(Searched::Local), "{:?}", found.remarks);
        assert_eq!((found.parameters[name].fixed, found.non_identifiable.len()), (stays, usize::from(stays)));
    }
    // Parameters of another model are no place to begin at.
    served.theta.shift_remove("alpha_e");
    assert_eq!(night(&served).searched, Some(Searched::Global));
}

#[test]
fn a_tampered_fit_is_refused() {
    let asked = request("P10D", "P4D", "P0D", 24);
    let (_, problem) = room(431, 14, &asked);
    let good = fit(&problem, &asked);
    for (name, factor) in [("alpha_e", f64::NAN), ("alpha_h", 1.01), ("alpha_a", 0.99)] {
        let mut tampered = good.clone();
        tampered.parameters[name].value *= factor;
        let judgement = validate(&problem, &tampered, &Past::default(), &GatePolicy::default());
        assert_eq!(judgement.verdict, Verdict::Rejected, "{name}");
        assert!(judgement.failed().contains(&"G1 finite"), "{name}");
    }
}

#[test]
fn the_prior_pulls_only_what_the_data_leave_open() {
    let asked = request("P10D", "P4D", "P0D", 25);
    let (_, plain) = room(441, 14, &asked);
    let prior = EstimateRequest { prior: Prior::LogNormal, ..asked.clone() };
    let (_, drawn) = room(441, 14, &prior);
    let (free, pulled) = (fit(&plain, &asked), fit(&drawn, &prior));
    let rmse = |fit: &lampyris_core::estimate::Fit| fit.first_metrics().unwrap().train_rmse;
    assert!(rmse(&pulled) < 1.05 * rmse(&free), "{} {}", rmse(&pulled), rmse(&free));
    let distance = |fit: &lampyris_core::estimate::Fit| {
        let logs = plain
            .model()
            .parameters()
            .iter()
            .zip(plain.nominal())
            .filter(|(parameter, _)| parameter.unit == "1/h");
        logs.map(|(parameter, nominal)| (fit.parameters[&parameter.name].value / nominal).ln().powi(2))
            .sum::<f64>()
    };
    assert!(distance(&pulled) <= distance(&free) + 1e-9);
}

#[test]
fn the_shape_weighted_error_is_minimised_by_the_same_search() {
    let mut asked = request("P7D", "P2D", "P0D", 26);
    asked.objective = Objective::Swmse;
    let (_, problem) = room(451, 9, &asked);
    let fit = fit(&problem, &asked);
    // At the noise floor the shapes agree, so the weight is nearly one.
    assert!(fit.cost > 0.9 * 0.05f64.powi(2) && fit.cost < 1.3 * 0.05f64.powi(2), "{}", fit.cost);
}

/// The normalised error of one output is its mean square error over a number: the same optimum, the same
/// search.
#[test]
fn the_normalised_error_of_one_output_has_the_same_optimum() {
    let mut asked = request("P7D", "P2D", "P0D", 27);
    let (_, plain) = room(461, 9, &asked);
    let mse = fit(&plain, &asked);
    asked.objective = Objective::Nmse;
    let (_, normalised) = room(461, 9, &asked);
    let nmse = fit(&normalised, &asked);
    let used = plain.usable(0, plain.split().train.clone());
    let values: Vec<f64> = used.iter().map(|k| plain.measured()[0].0[*k]).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
    assert_eq!(nmse.objective, "nmse");
    assert!((nmse.cost * variance / mse.cost - 1.0).abs() < 5e-3, "{} {}", nmse.cost * variance, mse.cost);
    assert!(nmse.cost < 0.05, "{}", nmse.cost);
}

/// The algorithm of the thesis has no rule of its own to end before its last generation.
#[test]
fn early_stopping_saves_evaluations_and_says_so() {
    let mut asked = request("P5D", "P2D", "P0D", 28);
    asked.budget.evaluations = 6000;
    asked.method = serde_json::from_str(
        r#"{"name": "cfa_thesis", "seed": 28, "n": 16, "n_min": 8, "generations": 400}"#,
    )
    .unwrap();
    let (_, problem) = room(471, 7, &asked);
    let whole = fit(&problem, &asked);
    assert_eq!(whole.stopped_by, Stop::Budget);
    asked.early_stopping = Some(EarlyStopping { patience: 10, min_delta: 0.02, ..EarlyStopping::default() });
    let early = fit(&problem, &asked);
    println!(
        "whole: {} evaluations, cost {:.5}; early: {}, {:.5}",
        whole.evaluations, whole.cost, early.evaluations, early.cost
    );
    assert_eq!(early.stopped_by, Stop::Stalled);
    assert!(early.evaluations < whole.evaluations / 2, "{} {}", early.evaluations, whole.evaluations);
    assert!(
        early.remarks.iter().any(|remark| remark.contains("stopped early: in 10 generations the cost")),
        "{:?}",
        early.remarks
    );
    // The same seed goes the same way as far as it goes.
    assert!(
        whole.trace.iter().any(|point| point.best == early.cost),
        "the early end is a point of the whole way"
    );

    asked.early_stopping = Some(EarlyStopping { validation: true, ..asked.early_stopping.unwrap() });
    let seen = std::sync::Mutex::new(f64::INFINITY);
    let progress = |progress: &Progress| {
        let mut lowest = seen.lock().unwrap();
        *lowest = lowest.min(progress.best_validation.unwrap_or(f64::INFINITY));
    };
    let watched =
        estimate(&problem, &asked, None, &Control { progress: &progress, ..Control::NONE }).unwrap();
    assert!(
        watched.remarks.iter().any(|remark| remark.contains("not that of unseen data")),
        "{:?}",
        watched.remarks
    );
    let (unseen, lowest) = (watched.first_metrics().unwrap().validation_rmse.unwrap(), *seen.lock().unwrap());
    println!(
        "on validation: {} evaluations, {unseen:.4} K; lowest on the way {lowest:.4} K",
        watched.evaluations
    );
    // A parameter on a bound may be fixed afterwards where that costs less than two per cent.
    assert!(unseen <= 1.02 * lowest, "{unseen} {lowest}");
}
