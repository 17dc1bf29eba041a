//! Clouds that restart, in turn ever larger and small: the schedule of BIPOP-CMA-ES.
//!
//! N. Hansen, "Benchmarking a BI-population CMA-ES on the BBOB-2009 function testbed", GECCO 2009. Large
//! clouds see through local optima to the funnel beneath, small and narrow ones comb through single places;
//! both kinds get the same number of evaluations.

use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;

use super::covariance::Cloud;
use super::firefly::stream;
use super::{Candidate, Cost};

/// Runs start in the middle part of the cube.
const START: [f64; 2] = [0.1, 0.9];
/// The streams of the clouds are numbered from here, far from those of any firefly.
const STREAMS: u64 = 1 << 63;

/// Which kind a cloud is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// The first one, which is on nobody's account.
    First,
    Large,
    Small,
}

/// The present cloud, and what those before it have spent.
#[derive(Debug)]
pub struct Clouds {
    dimensions: usize,
    seed: u64,
    sigma: f64,
    stream: Xoshiro256PlusPlus,
    cloud: Cloud,
    kind: Kind,
    /// Evaluations of the present cloud, and most of them.
    used: usize,
    most: usize,
    /// The size of the largest cloud so far.
    largest: usize,
    /// Evaluations of all large and all small clouds.
    spent: [usize; 2],
    begun: u64,
}

impl Clouds {
    /// The first cloud, of the usual size. `sigma` is the standard deviation of its first steps in the unit
    /// cube, and those of the large ones.
    pub fn new(dimensions: usize, sigma: f64, seed: u64) -> Self {
        let mut own = stream(seed, STREAMS);
        let largest = Cloud::size(dimensions);
        let start = start(dimensions, &mut own);
        Self {
            dimensions,
            seed,
            sigma,
            stream: own,
            cloud: Cloud::new(&start, sigma, largest, stream(seed, STREAMS + 1)),
            kind: Kind::First,
            used: 0,
            most: usize::MAX,
            largest,
            spent: [0, 0],
            begun: 1,
        }
    }

    /// Sends the next cloud. Small ones have at most half of the evaluations of all large ones.
    pub fn restart(&mut self) {
        match self.kind {
            Kind::First => {}
            Kind::Large => self.spent[0] += self.used,
            Kind::Small => self.spent[1] += self.used,
        }
        let start = start(self.dimensions, &mut self.stream);
        let [grown, narrow]: [f64; 2] = std::array::from_fn(|_| self.stream.random());
        let usual = Cloud::size(self.dimensions);
        let (size, sigma);
        if self.spent[0] <= self.spent[1] {
            self.largest = self.largest.saturating_mul(2).min(1 << 24);
            (self.kind, self.most) = (Kind::Large, usize::MAX);
            (size, sigma) = (self.largest, self.sigma);
        } else {
            (self.kind, self.most) = (Kind::Small, self.spent[0] / 2);
            let growth = (0.5 * self.largest as f64 / usual as f64).powf(grown * grown);
            (size, sigma) = ((usual as f64 * growth) as usize, self.sigma * 10f64.powf(-2.0 * narrow));
        }
        self.begun += 1;
        self.used = 0;
        self.cloud = Cloud::new(&start, sigma, size, stream(self.seed, STREAMS + self.begun));
    }

    /// The next generation of the present cloud; none when it has ended.
    pub fn propose(&mut self) -> Option<Vec<Candidate>> {
        if self.used >= self.most { None } else { self.cloud.propose() }
    }

    /// Answers it.
    pub fn digest(&mut self, candidates: &[Candidate], costs: &[Cost]) {
        self.used += costs.len();
        self.cloud.digest(candidates, costs);
    }

    /// The best place of the present cloud, and what it costs.
    pub fn place(&self) -> (Candidate, Cost) {
        let (place, cost) = self.cloud.place();
        (Candidate(place.to_vec()), cost)
    }
}

fn start(dimensions: usize, stream: &mut Xoshiro256PlusPlus) -> Candidate {
    Candidate((0..dimensions).map(|_| stream.random_range(START[0]..START[1])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_and_small_clouds_spend_alike() {
        let mut clouds = Clouds::new(3, 0.2, 5);
        let mut largest = Vec::new();
        for _ in 0..40 {
            while let Some(batch) = clouds.propose() {
                // Many equal pits.
                let cost = |x: &[f64]| x.iter().map(|x| 1.0 - (60.0 * x).cos()).sum::<f64>();
                let costs: Vec<Cost> = batch.iter().map(|place| Cost::new(cost(&place.0))).collect();
                clouds.digest(&batch, &costs);
            }
            assert!(clouds.place().1 < Cost::Finite(1.0));
            clouds.restart();
            largest.push(clouds.largest);
        }
        let [large, small] = clouds.spent;
        assert!(large.abs_diff(small) < (large + small) / 2, "{large} {small}");
        assert!(largest[39] >= 8 * Cloud::size(3) && largest.is_sorted());
    }
}
