//! Whole fits on measured and synthetic houses, against figures and solvers that are not ours.

#![allow(clippy::unwrap_used, reason = "a case that cannot go on has failed")]

mod brakes;
mod clock;
mod delays;
mod diagnoses;
mod family;
mod fits;
mod folders;
mod forecasts;
mod gate;
mod houses;
mod likelihood;
mod measured;
mod oracles;
mod own;
mod plants;
mod posted;
mod ridges;
mod twins;
mod warm_up;

use lampyris_core::data::{ColumnBindings, SplitRequest, Window};
use lampyris_core::estimate::problem::request::SeededMethod;
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Problem, Site, estimate, prepare};
use lampyris_core::model::{Catalogue, ModelId};
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Whether the full figures are asked for.
fn full() -> bool {
    std::env::var("LAMPYRIS_TESTS").is_ok_and(|figures| figures == "full")
}

/// A problem from CSV text; `binds` are texts such as `T_room=T_indoor_degC`.
fn problem(csv: &str, model: &str, binds: &[&str], site: &Site, request: &EstimateRequest) -> Problem {
    let bindings = ColumnBindings::parse(binds.iter().copied()).unwrap();
    let (window, _) = Window::parse_csv(csv, &bindings).unwrap();
    let id: ModelId = model.parse().unwrap();
    prepare(&Catalogue::builtin().unwrap(), &id, request, &window, site).unwrap()
}

/// A request with these parts and seed.
fn request(train: &str, validation: &str, test: &str, seed: u64) -> EstimateRequest {
    let split = SplitRequest {
        train: train.parse().unwrap(),
        validation: validation.parse().unwrap(),
        test: Some(test.parse().unwrap()),
    };
    let method = SeededMethod { seed, ..SeededMethod::default() };
    EstimateRequest { split, method, ..EstimateRequest::default() }
}

/// Normally distributed by the polar method.
fn normal(dice: &mut Xoshiro256PlusPlus) -> f64 {
    let (u, v): (f64, f64) = (dice.random(), dice.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn fit(problem: &Problem, request: &EstimateRequest) -> Fit {
    estimate(problem, request, None, &Control::NONE).unwrap()
}

/// Mean square errors of the free run: training and test.
fn squares(fit: &Fit) -> (f64, f64) {
    let metrics = fit.first_metrics().unwrap();
    (metrics.train_rmse.powi(2), metrics.test_rmse.unwrap().powi(2))
}
