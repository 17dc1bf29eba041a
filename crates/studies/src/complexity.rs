//! How the evaluations of a generation grow with the population: the thesis says n^2 for FA and n^(3/2) for
//! cFA with sqrt(n) fireflies per cluster (section 4.3.2).

use super::options::Seeds;
use super::row::Row;
use lampyris_core::optimise::functions::Function;
use lampyris_core::optimise::thesis_options::CfaThesisOptions;
use lampyris_core::optimise::{Ask, Cost, Crowd, Evaluation, Method, Search};
use rayon::prelude::*;
use std::time::Instant;

/// How many fireflies of a population a cluster is to have.
type Target = fn(usize) -> f64;

const POPULATIONS: [usize; 7] = [32, 64, 128, 256, 512, 1024, 2000];
const DIMENSIONS: usize = 5;
/// More than any population.
const EVERYONE: f64 = 1e6;

/// Evaluations of the first generation, and the seconds that the whole took beside them.
struct Generation {
    evaluations: f64,
    seconds: f64,
}

/// Seeds that are enough to fit an exponent.
const MOST_SEEDS: u64 = 20;

pub fn run(asked: &Seeds) -> Vec<Row> {
    let (first, seeds) = (asked.first.seed, asked.seeds.min(MOST_SEEDS));
    let mut rows = Vec::new();
    let one_cluster = |_: usize| EVERYONE;
    let root = |n: usize| (n as f64).sqrt();
    let cases: [(&str, f64, Target); 2] =
        [("FA", 2.0, one_cluster), ("cFA, sqrt(n) fireflies per cluster", 1.5, root)];
    for (title, formal, target) in cases {
        let mut points = Vec::new();
        for n in POPULATIONS {
            let runs: Vec<Generation> =
                (first..first + seeds).into_par_iter().map(|seed| generation(n, target(n), seed)).collect();
            let mean =
                |value: &dyn Fn(&Generation) -> f64| runs.iter().map(value).sum::<f64>() / runs.len() as f64;
            let evaluations = mean(&|run| run.evaluations);
            points.push(((n as f64).ln(), evaluations.ln()));
            rows.push(Row::new(format!("{title}: evaluations of a generation of {n}"), evaluations, ""));
            let millis = 1e3 * mean(&|run| run.seconds);
            rows.push(Row::new("  time beside the evaluations, clustering included", millis, "ms"));
        }
        let exponent = slope(&points);
        rows.push(Row::new(format!("{title}: fitted exponent (formally {formal})"), exponent, "-"));
        rows.push(Row::new("  distance from the formal one", (exponent - formal).abs(), "-").at_most(0.1));
    }
    rows
}

/// One generation on Schwefel's function from a random population.
fn generation(n: usize, target: f64, seed: u64) -> Generation {
    let options = CfaThesisOptions {
        n,
        n_min: n,
        generations: 1,
        target,
        target_min: target,
        alpha: 0.5,
        decay: 1.0,
        gamma_min: 1.0,
        gamma_max: 1.0,
        crowd: Crowd::Step,
        ..CfaThesisOptions::default()
    };
    let search =
        Search { dimensions: DIMENSIONS, seed, budget: usize::MAX, warm: Vec::new(), residuals: false };
    let start = Instant::now();
    let mut optimiser = Method::CfaThesis(options).optimiser(search);
    let (mut evaluations, mut evaluating) = (0, 0.0);
    while let Ask::Costs(batch) | Ask::Residuals(batch) = optimiser.ask() {
        let begun = Instant::now();
        let answers: Vec<Evaluation> = batch
            .iter()
            .map(|x| Evaluation {
                cost: Cost::new(Function::Schwefel.cost(&x.0)),
                residuals: Vec::new(),
                slope: None,
            })
            .collect();
        evaluating += begun.elapsed().as_secs_f64();
        evaluations += batch.len();
        optimiser.tell(&answers);
    }
    Generation { evaluations: (evaluations - n) as f64, seconds: start.elapsed().as_secs_f64() - evaluating }
}

/// Of a straight line by least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (x, y) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let (over, under) = points
        .iter()
        .fold((0.0, 0.0), |(over, under), p| (over + (p.0 - x) * (p.1 - y), under + (p.0 - x).powi(2)));
    over / under
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_has_its_exponent() {
        let points: Vec<(f64, f64)> =
            [2.0f64, 4.0, 8.0].iter().map(|n| (n.ln(), (3.0 * n.powf(1.5)).ln())).collect();
        assert!((slope(&points) - 1.5).abs() < 1e-12);
    }
}
