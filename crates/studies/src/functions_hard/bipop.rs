//! The rival: BIPOP-CMA-ES, the clouds of the default search without its fireflies.
//!
//! The cloud is the one of Hansen's tutorial of 2016, which also learns from bad steps as pycma does: a
//! harder rival than that of 2009.

use super::watch::Watch;
use lampyris_core::optimise::Cost;
use lampyris_core::optimise::clouds::Clouds;

/// Standard deviation of the first steps, as a share of the box.
const SIGMA: f64 = 0.2;

/// Searches until nobody wants to know more.
pub fn bipop(dimensions: usize, seed: u64, watch: &mut Watch) {
    let mut clouds = Clouds::new(dimensions, SIGMA, seed);
    while !watch.over() {
        let Some(batch) = clouds.propose() else {
            clouds.restart();
            continue;
        };
        let costs: Vec<Cost> = batch.iter().map(|candidate| Cost::new(watch.error(&candidate.0))).collect();
        clouds.digest(&batch, &costs);
    }
}

#[cfg(test)]
mod tests {
    use lampyris_core::optimise::covariance::Cloud;
    use lampyris_core::optimise::{Candidate, Cost, random_stream};

    /// Half the width of a box whose edges are far from where the cloud goes.
    const HALF: f64 = 20.0;

    fn evaluations(cost: fn(&[f64]) -> f64, start: f64, dimensions: usize, seed: u64) -> usize {
        let start = Candidate(vec![(start / HALF + 1.0) / 2.0; dimensions]);
        let size = Cloud::size(dimensions);
        let mut cloud = Cloud::new(&start, 0.5 / HALF, size, random_stream(seed, 0));
        let mut count = 0;
        while let Some(batch) = cloud.propose() {
            let cost = |candidate: &Candidate| {
                let x: Vec<f64> = candidate.0.iter().map(|unit| (2.0 * unit - 1.0) * HALF).collect();
                cost(&x)
            };
            let costs: Vec<f64> = batch.iter().map(cost).collect();
            if let Some(hit) = costs.iter().position(|cost| *cost <= 1e-8) {
                return count + hit + 1;
            }
            count += batch.len();
            cloud.digest(&batch, &costs.into_iter().map(Cost::new).collect::<Vec<_>>());
        }
        usize::MAX
    }

    fn sphere(x: &[f64]) -> f64 {
        x.iter().map(|x| x * x).sum()
    }

    fn ellipsoid(x: &[f64]) -> f64 {
        let power = |i: usize| 1e6f64.powf(i as f64 / (x.len() as f64 - 1.0));
        x.iter().enumerate().map(|(i, x)| power(i) * x * x).sum()
    }

    fn rosenbrock(x: &[f64]) -> f64 {
        x.windows(2).map(|x| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (x[0] - 1.0).powi(2)).sum()
    }

    /// Median evaluations until an error of 1e-8 over 15 seeds; those of pycma 4.5.0 come from `pycma.py`.
    #[test]
    fn the_cloud_takes_as_long_as_pycma() {
        type Function = fn(&[f64]) -> f64;
        let cases: [(Function, f64, usize, f64); 6] = [
            (sphere, 3.0, 5, 710.0),
            (sphere, 3.0, 10, 1493.0),
            (ellipsoid, 3.0, 5, 1564.0),
            (ellipsoid, 3.0, 10, 4101.0),
            (rosenbrock, 0.0, 5, 1715.0),
            (rosenbrock, 0.0, 10, 5059.0),
        ];
        for (cost, start, dimensions, pycma) in cases {
            let mut counts: Vec<usize> =
                (1..16).map(|seed| evaluations(cost, start, dimensions, seed)).collect();
            counts.sort_unstable();
            let ratio = counts[7] as f64 / pycma;
            assert!((0.85..1.15).contains(&ratio), "{dimensions}, pycma {pycma}: {counts:?}");
        }
    }
}
