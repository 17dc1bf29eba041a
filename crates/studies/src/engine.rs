//! How fast a candidate is simulated: the tape beside code written by hand, and beside a scalar RK4.

use super::hand::{HandRoom, half_steps, scalar_rk4};
use super::row::Row;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::{EstimateRequest, Problem, Site, prepare};
use lampyris_core::model::{Catalogue, ModelId};
use lampyris_core::simulate::{LANES, Simulator, Stepper};
use lampyris_core::twin;
use std::hint::black_box;
use std::time::Instant;

/// Candidates per timed round.
const CANDIDATES: usize = 32 * LANES;
/// Candidates of the scalar solver per round: it is slow.
const SCALAR: usize = 8;
const ROUNDS: usize = 25;

/// A week of a synthetic room with four neighbours, as a problem whose training part is all of it.
pub fn week(seed: u64, step_minutes: usize) -> Result<(twin::RoomTwin, Problem), Failure> {
    let twin = twin::room(seed, 4, 7, step_minutes).map_err(|found| faults(&found))?;
    let (window, _) =
        Window::parse_csv(&twin.csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
    let model: ModelId = "room3".parse().map_err(|error| Failure::Error(format!("{error}")))?;
    let request: EstimateRequest =
        serde_json::from_value(serde_json::json!({ "split": { "train": "P7D", "validation": "P0D" } }))
            .map_err(|error| Failure::Error(error.to_string()))?;
    let site = Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let problem = prepare(&catalogue, &model, &request, &window, &site).map_err(|found| faults(&found))?;
    Ok((twin, problem))
}

/// Shortest seconds of one round of each: whatever else the machine does can only lengthen a round, and turns
/// let a change of its clock hit all of them.
fn time<const N: usize>(mut rounds: [&mut dyn FnMut(); N]) -> [f64; N] {
    let mut shortest = [f64::INFINITY; N];
    for _ in 0..ROUNDS {
        for (round, shortest) in rounds.iter_mut().zip(&mut shortest) {
            let start = Instant::now();
            round();
            *shortest = shortest.min(start.elapsed().as_secs_f64());
        }
    }
    shortest
}

pub fn run(seed: u64) -> Result<Vec<Row>, Failure> {
    let (twin, problem) = week(seed, 10)?;
    // One thread for all: the ratio compares code, not cores.
    let single = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|error| Failure::Error(error.to_string()))?;
    single.install(|| {
        // Candidates spread about the truth, as a search sees them.
        let thetas: Vec<Vec<f64>> = (0..CANDIDATES)
            .map(|i| {
                twin.theta
                    .iter()
                    .map(|value| value * (1.0 + 0.2 * (i as f64 / CANDIDATES as f64 - 0.5)))
                    .collect()
            })
            .collect();
        let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let samples = problem.grid().len();
        let hand = HandRoom::new(&problem);
        let minutes = half_steps(&hand, 10);
        let measured = problem.measured();
        let reference = Simulator::new(problem.model(), problem.inputs(), &measured, Stepper::Rk4, 100);
        let exact = &reference.run(&[&twin.theta], samples)[0].outputs[0];
        let worst = |y: &[f64]| y.iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let tape_error = worst(&problem.simulate(&twin.theta).outputs[0]);
        let hand_error = worst(&hand.run(&[&twin.theta])[0]);
        let rk4_error = worst(&scalar_rk4(&hand, &minutes, &twin.theta, 10));

        let per_candidate = |seconds: f64| seconds / CANDIDATES as f64 * 1e6;
        let [tape, by_hand, rk4] = time([
            &mut || drop(black_box(problem.simulator().run(black_box(&slices), samples))),
            &mut || slices.chunks(LANES).for_each(|block| drop(black_box(hand.run(black_box(block))))),
            &mut || {
                slices[..SCALAR]
                    .iter()
                    .for_each(|theta| drop(black_box(scalar_rk4(&hand, &minutes, black_box(theta), 10))))
            },
        ]);
        let (tape, by_hand, rk4) = (per_candidate(tape), per_candidate(by_hand), rk4 / SCALAR as f64 * 1e6);
        Ok(vec![
            Row::new("room3, 4 neighbours, 7 d at 10 min: tape in lanes, per candidate", tape, "us"),
            Row::new("  the same ROS2 compiled by hand in lanes, per candidate", by_hand, "us"),
            Row::new("  tape / hand-compiled", tape / by_hand, "x").at_most(2.0),
            Row::new("  scalar RK4 at 1 min, hand-compiled, per candidate", rk4, "us"),
            Row::new("  scalar RK4 / tape", rk4 / tape, "x").at_least(25.0),
            Row::new("  tape: largest error against RK4 at 6 s", tape_error, "K").at_most(0.01),
            Row::new("  hand-compiled: largest error", hand_error, "K").at_most(0.01),
            Row::new("  scalar RK4 at 1 min: largest error", rk4_error, "K"),
        ])
    })
}
