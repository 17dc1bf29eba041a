//! What the thesis' algorithm and the default hybrid share: a firefly, its own random stream and its moves.

use rand::{Rng, RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::kmeans::squared_distance;
use super::{Candidate, Cost};
use utoipa::ToSchema;

/// The random stream number `id` of a search.
///
/// Both numbers are scrambled before use, so that neighbouring seeds and ids give unrelated streams.
pub fn stream(seed: u64, id: u64) -> Xoshiro256PlusPlus {
    Xoshiro256PlusPlus::seed_from_u64(scramble(scramble(seed).wrapping_add(id)))
}

/// The finaliser of splitmix64, a bijection in which every input bit reaches every output bit.
fn scramble(word: u64) -> u64 {
    let word = (word ^ 0x5851_F42D_4C95_7F2D).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let word = (word ^ (word >> 31)).wrapping_mul(0x94D0_49BB_1331_11EB);
    word ^ (word >> 29)
}

/// A point drawn evenly from the cube.
pub fn random_point<R: Rng>(dimensions: usize, stream: &mut R) -> Vec<f64> {
    (0..dimensions).map(|_| stream.random::<f64>()).collect()
}

/// A parameter set that flies. Its light intensity is its cost: brighter means cheaper.
#[derive(Debug, Clone)]
pub struct Firefly {
    /// Where it is, in the unit cube.
    pub position: Vec<f64>,
    /// What that place costs; diverged until told.
    pub cost: Cost,
    /// The best place it has seen. Moves are not greedy, so this may not be where it is.
    pub best: (Candidate, Cost),
    stream: Xoshiro256PlusPlus,
}

impl Firefly {
    /// Firefly number `id` of a search, at a random place of its own stream.
    pub fn random(seed: u64, id: u64, dimensions: usize) -> Self {
        let mut stream = stream(seed, id);
        let position = random_point(dimensions, &mut stream);
        Self { best: (Candidate(position.clone()), Cost::Diverged), position, cost: Cost::Diverged, stream }
    }

    /// Firefly number `id` of a search, at a given place.
    pub fn at(seed: u64, id: u64, start: &Candidate) -> Self {
        let mut firefly = Self::random(seed, id, start.0.len());
        firefly.position.clone_from(&start.0);
        firefly
    }

    /// The same firefly at a fresh random place.
    pub fn redraw(&mut self) {
        self.position = random_point(self.position.len(), &mut self.stream);
    }

    /// The candidate that it stands for.
    pub fn candidate(&self) -> Candidate {
        Candidate(self.position.clone())
    }

    /// Takes the cost of the place where it is.
    pub fn settle(&mut self, cost: Cost) {
        self.cost = cost;
        if cost < self.best.1 {
            self.best = (self.candidate(), cost);
        }
    }

    /// Returns to the best place that it has seen from one that is worse.
    pub fn turn_back(&mut self) {
        if self.best.1 < self.cost {
            self.position.clone_from(&self.best.0.0);
            self.cost = self.best.1;
        }
    }

    /// Moves toward `target`: eq 4.2, and for a centroid of `crowd` fireflies eq 4.10.
    ///
    /// In the unit cube the scaling vector S, the range of each parameter, is 1 everywhere.
    pub fn fly(&mut self, target: &[f64], crowd: f64, flight: &Flight) {
        let pull = flight.pull(squared_distance(&self.position, target), crowd);
        // One coordinate always takes part, otherwise the evaluation would repeat the old place.
        let certain =
            if flight.crossover > 0.0 { self.stream.random_range(0..self.position.len().max(1)) } else { 0 };
        for (coordinate, (x, to)) in self.position.iter_mut().zip(target).enumerate() {
            let noise = self.stream.random::<f64>() - 0.5;
            // The draw is made only with a mask, so that the thesis' algorithm spends one number per
            // coordinate.
            let kept = flight.crossover > 0.0 && self.stream.random::<f64>() < flight.crossover;
            if kept && coordinate != certain {
                continue;
            }
            let leaps = flight.leap > 0.0 && self.stream.random::<f64>() < flight.leap;
            let moved = *x + pull * (to - *x) + flight.alpha * noise;
            *x = match flight.edges {
                _ if leaps => self.stream.random(),
                Edges::Bounce => bounce(moved),
                Edges::Clamp => moved.clamp(0.0, 1.0),
            };
        }
    }
}

/// How the size of a cluster strengthens the attraction of its centroid (eq 4.10).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Crowd {
    /// As the equation is printed: the distance is divided by the square root of the size, so that the light
    /// of a large cluster is seen from further away.
    Distance,
    /// As the text around it says, "the movement is scaled": the step is multiplied by the square root of the
    /// size and may overshoot the centroid. This is the reading that gives the results of thesis section 5.4.
    Step,
    /// Nothing: a centroid attracts as one firefly does.
    Ignored,
}

/// What happens at the edge of the cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Edges {
    /// A step over the edge is reflected (eq 4.7).
    #[default]
    Bounce,
    /// It ends at the edge.
    Clamp,
}

/// The settings of one move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flight {
    /// Attractiveness at distance zero.
    pub beta0: f64,
    /// How fast the attractiveness falls with the distance.
    pub gamma: f64,
    /// Width of the random part, as a share of each parameter's range.
    pub alpha: f64,
    /// Probability that a coordinate stays as it is in a move; 0 in the thesis.
    pub crossover: f64,
    /// Probability that a coordinate that moves is drawn anew from the cube; 0 in the thesis.
    pub leap: f64,
    /// What the size of a cluster does.
    pub crowd: Crowd,
    /// What happens at the edge of the cube.
    pub edges: Edges,
}

impl Flight {
    /// Eq 4.1 on a squared distance.
    pub fn attractiveness(&self, squared_distance: f64) -> f64 {
        self.beta0 * (-self.gamma * squared_distance).exp()
    }

    /// The share of the way to a light of `crowd` fireflies that a move goes: eq 4.2 for one, 4.10 for more.
    pub fn pull(&self, squared_distance: f64, crowd: f64) -> f64 {
        match self.crowd {
            Crowd::Distance => self.attractiveness(squared_distance / crowd),
            Crowd::Step => self.attractiveness(squared_distance) * crowd.sqrt(),
            Crowd::Ignored => self.attractiveness(squared_distance),
        }
    }
}

/// Eq 4.7 on the unit interval: a step over the edge is reflected, then clipped.
pub fn bounce(x: f64) -> f64 {
    let reflected = if x < 0.0 {
        -x
    } else if x > 1.0 {
        2.0 - x
    } else {
        x
    };
    reflected.clamp(0.0, 1.0)
}

/// The intensity of a centroid: the mean cost of its members (eq 4.9).
///
/// Diverged members are left out, as one of them would darken an otherwise bright cluster; a cluster in which
/// everything diverged has diverged.
pub fn mean_cost(costs: impl Iterator<Item = Cost>) -> Cost {
    let (mut sum, mut count) = (0.0, 0.0);
    for cost in costs {
        if let Cost::Finite(value) = cost {
            sum += value;
            count += 1.0;
        }
    }
    if count > 0.0 { Cost::new(sum / count) } else { Cost::Diverged }
}

/// The population size after the share `progress` of the schedule: eq 4.3.
pub fn population(n_max: usize, n_min: usize, progress: f64) -> usize {
    let shrunk = (n_max as f64 * (1.0 - progress)).floor().max(0.0) as usize;
    shrunk.max(n_min)
}

/// The target number of fireflies per cluster after the share `progress` of the schedule: eq 4.11.
pub fn target_size(target: f64, target_min: f64, progress: f64) -> f64 {
    target_min.max(target * (1.0 - progress))
}

/// The best `keep` fireflies, in their old order; of equal ones the older stay.
pub fn keep_brightest(fireflies: &mut Vec<Firefly>, keep: usize) {
    if keep >= fireflies.len() {
        return;
    }
    let mut order: Vec<usize> = (0..fireflies.len()).collect();
    order.sort_by_key(|index| (fireflies[*index].cost, *index));
    let mut stays = vec![false; fireflies.len()];
    for index in &order[..keep] {
        stays[*index] = true;
    }
    let mut stays = stays.into_iter();
    fireflies.retain(|_| stays.next().unwrap_or(false));
}

#[cfg(test)]
mod tests {
    use super::*;

    const STILL: Flight = Flight {
        beta0: 1.0,
        gamma: 1.0,
        alpha: 0.0,
        crossover: 0.0,
        leap: 0.0,
        crowd: Crowd::Distance,
        edges: Edges::Bounce,
    };

    #[test]
    fn a_move_is_equation_4_10() {
        let mut firefly = Firefly::at(1, 0, &Candidate(vec![0.2, 0.4]));
        firefly.fly(&[0.6, 0.1], 4.0, &STILL);
        let pull = (-(0.4f64 * 0.4 + 0.3 * 0.3) / 4.0).exp();
        assert_eq!(firefly.position, vec![0.2 + pull * (0.6 - 0.2), 0.4 + pull * (0.1 - 0.4)]);
    }

    #[test]
    fn the_other_reading_scales_the_step() {
        let mut firefly = Firefly::at(1, 0, &Candidate(vec![0.2, 0.4]));
        firefly.fly(&[0.4, 0.3], 4.0, &Flight { crowd: Crowd::Step, ..STILL });
        let pull = 2.0 * (-(0.2f64 * 0.2 + 0.1 * 0.1)).exp();
        assert!((firefly.position[0] - (0.2 + pull * 0.2)).abs() < 1e-15);
        assert!((firefly.position[1] - (0.4 - pull * 0.1)).abs() < 1e-15);
    }

    #[test]
    fn a_step_over_the_edge_comes_back() {
        assert_eq!(bounce(-0.25), 0.25);
        assert_eq!(bounce(1.25), 0.75);
        assert_eq!(bounce(0.3), 0.3);
        assert_eq!(bounce(2.5), 0.0);
        assert_eq!(bounce(-1.5), 1.0);
    }

    #[test]
    fn with_a_full_mask_one_coordinate_still_moves() {
        for id in 0..20 {
            let mut firefly = Firefly::at(1, id, &Candidate(vec![0.5; 6]));
            firefly.fly(&[0.9; 6], 1.0, &Flight { crossover: 1.0, ..STILL });
            assert_eq!(firefly.position.iter().filter(|x| **x != 0.5).count(), 1);
        }
    }

    #[test]
    fn streams_of_neighbouring_seeds_and_ids_differ() {
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..20 {
            for id in 0..20 {
                assert!(seen.insert(stream(seed, id).random::<u64>()));
            }
        }
    }

    #[test]
    fn schedules_are_equations_4_3_4_9_and_4_11() {
        assert_eq!(population(70, 12, 1.0 / 70.0), 69);
        assert_eq!(population(70, 12, 1.0), 12);
        assert_eq!(target_size(7.0, 1.0, 0.5), 3.5);
        assert_eq!(target_size(7.0, 1.0, 1.0), 1.0);
        let costs = [Cost::Finite(1.0), Cost::Diverged, Cost::Finite(4.0)];
        assert_eq!(mean_cost(costs.into_iter()), Cost::Finite(2.5));
        assert_eq!(mean_cost([Cost::Diverged].into_iter()), Cost::Diverged);
    }

    #[test]
    fn the_worst_go_and_the_order_stays() {
        let mut fireflies: Vec<Firefly> = (0..5).map(|id| Firefly::random(1, id, 1)).collect();
        for (firefly, cost) in fireflies.iter_mut().zip([3.0, 1.0, f64::NAN, 1.0, 2.0]) {
            firefly.settle(Cost::new(cost));
        }
        keep_brightest(&mut fireflies, 3);
        assert_eq!(fireflies.iter().map(|f| f.cost.value()).collect::<Vec<_>>(), [1.0, 1.0, 2.0]);
    }
}
