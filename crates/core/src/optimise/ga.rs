//! A genetic algorithm on real numbers, as a rival: tournaments, simulated binary crossover, polynomial
//! mutation, an elite.
//!
//! K. Deb, R. B. Agrawal, "Simulated binary crossover for continuous search space", Complex Systems 9 (1995)
//! 115-148; K. Deb, M. Goyal, "A combined genetic adaptive search (GeneAS)", Computer Science and Informatics
//! 26 (1996) 30-45.

use rand::{Rng, RngExt};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::budget::Strategy;
use super::firefly::{random_point, stream};
use super::search::Search;
use super::{Ask, Candidate, Cost, Evaluation};

/// The hyperparameters of the genetic algorithm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GaOptions {
    /// Population.
    pub n: usize,
    /// Probability that two parents are crossed.
    pub crossover: f64,
    /// How near children are to their parents: the index of the crossover's distribution.
    pub crossover_index: f64,
    /// How near a mutant is to what it was: the index of the mutation's distribution.
    pub mutation_index: f64,
    /// The best ones, which pass into the next generation as they are.
    pub elite: usize,
}

impl Default for GaOptions {
    fn default() -> Self {
        Self { n: 100, crossover: 0.9, crossover_index: 15.0, mutation_index: 20.0, elite: 2 }
    }
}

/// The population between two generations.
#[derive(Debug)]
pub struct Ga {
    options: GaOptions,
    stream: Xoshiro256PlusPlus,
    /// The cheapest first, once they are known.
    parents: Vec<(Vec<f64>, Cost)>,
    children: Vec<Vec<f64>>,
    generation: usize,
}

impl Ga {
    /// Random candidates; warm starts take the places of the first ones.
    pub fn new(options: GaOptions, search: &Search) -> Self {
        let mut stream = stream(search.seed, 0);
        let warm = search.warm_starts();
        let children = (0..options.n.max(4))
            .map(|index| {
                let drawn = random_point(search.dimensions, &mut stream);
                warm.get(index).map_or(drawn, |start| start.0.clone())
            })
            .collect();
        Self { options, stream, parents: Vec::new(), children, generation: 0 }
    }

    /// The better one of two; the parents are sorted.
    fn tournament(&mut self) -> usize {
        let n = self.parents.len();
        self.stream.random_range(0..n).min(self.stream.random_range(0..n))
    }

    fn breed(&mut self) {
        let elite = self.options.elite.min(self.parents.len() - 1);
        let wanted = self.options.n.max(4) - elite;
        self.children.clear();
        while self.children.len() < wanted {
            let (a, b) = (self.tournament(), self.tournament());
            let (mut first, mut second) = (self.parents[a].0.clone(), self.parents[b].0.clone());
            if self.stream.random::<f64>() < self.options.crossover {
                cross(&mut first, &mut second, self.options.crossover_index, &mut self.stream);
            }
            for mut child in [first, second] {
                mutate(&mut child, self.options.mutation_index, &mut self.stream);
                self.children.push(child);
            }
        }
        self.children.truncate(wanted);
    }
}

/// Simulated binary crossover of half of the coordinates.
fn cross<R: Rng>(first: &mut [f64], second: &mut [f64], index: f64, stream: &mut R) {
    for (a, b) in first.iter_mut().zip(second) {
        if stream.random::<f64>() < 0.5 {
            let u = stream.random::<f64>();
            let power = 1.0 / (index + 1.0);
            let spread = if u <= 0.5 { (2.0 * u).powf(power) } else { (1.0 / (2.0 * (1.0 - u))).powf(power) };
            let (middle, half) = (0.5 * (*a + *b), 0.5 * spread * (*a - *b));
            (*a, *b) = ((middle + half).clamp(0.0, 1.0), (middle - half).clamp(0.0, 1.0));
        }
    }
}

/// Polynomial mutation, of one coordinate in the mean.
fn mutate<R: Rng>(child: &mut [f64], index: f64, stream: &mut R) {
    let rate = 1.0 / child.len().max(1) as f64;
    for x in child {
        if stream.random::<f64>() < rate {
            let u = stream.random::<f64>();
            let power = 1.0 / (index + 1.0);
            let step =
                if u < 0.5 { (2.0 * u).powf(power) - 1.0 } else { 1.0 - (2.0 * (1.0 - u)).powf(power) };
            *x = (*x + step).clamp(0.0, 1.0);
        }
    }
}

impl Strategy for Ga {
    fn propose(&mut self) -> Ask {
        if !self.parents.is_empty() {
            self.breed();
            self.generation += 1;
        }
        Ask::Costs(self.children.iter().map(|child| Candidate(child.clone())).collect())
    }

    fn digest(&mut self, candidates: &[Candidate], answers: &[Evaluation]) {
        self.parents.truncate(self.options.elite.min(self.options.n.max(4) - 1));
        self.parents.extend(
            candidates.iter().zip(answers).map(|(candidate, answer)| (candidate.0.clone(), answer.cost)),
        );
        // The order of equals is that of their making.
        self.parents.sort_by_key(|parent| parent.1);
    }

    fn generation(&self) -> usize {
        self.generation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::{Function, drive};
    use crate::optimise::method::Method;

    #[test]
    fn it_comes_near_and_never_loses_its_best() {
        let search =
            |seed| Search { dimensions: 5, seed, budget: 20_000, warm: Vec::new(), residuals: false };
        for seed in 0..5 {
            let run = drive(Method::Ga(GaOptions::default()).optimiser(search(seed)).as_mut(), |x| {
                Function::Ackley.cost(x)
            });
            assert!(run.best.value() < 0.5, "{}", run.best.value());
        }
        let mut ga = Ga::new(GaOptions::default(), &search(1));
        let mut last = f64::INFINITY;
        for _ in 0..50 {
            let Ask::Costs(batch) = ga.propose() else { panic!() };
            let answers: Vec<Evaluation> = batch
                .iter()
                .map(|x| Evaluation {
                    cost: Cost::new(Function::Schwefel.cost(&x.0)),
                    residuals: Vec::new(),
                    slope: None,
                })
                .collect();
            ga.digest(&batch, &answers);
            let best = ga.parents[0].1.value();
            assert!(best <= last);
            last = best;
        }
    }

    #[test]
    fn divergence_is_survived_and_a_seed_fixes_every_bit() {
        let search = Search { dimensions: 3, seed: 5, budget: 1000, warm: Vec::new(), residuals: false };
        let run = |cost: &dyn Fn(&[f64]) -> f64| {
            drive(Method::Ga(GaOptions::default()).optimiser(search.clone()).as_mut(), cost)
        };
        assert_eq!(run(&|_| f64::NAN).best, Cost::Diverged);
        let half = |x: &[f64]| if x[0] > 0.5 { f64::NAN } else { Function::Ackley.cost(x) };
        assert_eq!(run(&half), run(&half));
    }
}
