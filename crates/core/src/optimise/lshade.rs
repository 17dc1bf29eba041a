//! L-SHADE: differential evolution that learns its own step and crossover and shrinks its population.
//!
//! R. Tanabe, A. Fukunaga, "Improving the search performance of SHADE using linear population size
//! reduction", IEEE CEC 2014. The rival to beat on functions with many local optima.

use rand::{Rng, RngExt};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::budget::Strategy;
use super::firefly::{random_point, stream};
use super::search::Search;
use super::{Ask, Candidate, Cost, Evaluation};

/// The smallest population of L-SHADE: a mutation needs that many.
const LEAST: usize = 4;

/// The hyperparameters of L-SHADE, as published.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LshadeOptions {
    /// Initial population per parameter.
    pub n_per_parameter: usize,
    /// Entries of the memory of what succeeded.
    pub memory: usize,
    /// The share of the population that counts as the best.
    pub p: f64,
    /// Size of the archive of beaten candidates, in populations.
    pub archive: f64,
}

impl Default for LshadeOptions {
    fn default() -> Self {
        Self { n_per_parameter: 18, memory: 6, p: 0.11, archive: 2.6 }
    }
}

#[derive(Debug, Clone)]
struct Member {
    position: Vec<f64>,
    cost: Cost,
}

/// How a trial was made: its scale factor and its crossover rate.
#[derive(Debug, Clone, Copy)]
struct Way {
    scale: f64,
    crossover: f64,
}

/// L-SHADE between two generations.
#[derive(Debug)]
pub struct Lshade {
    options: LshadeOptions,
    dimensions: usize,
    budget: usize,
    spent: usize,
    first: usize,
    stream: Xoshiro256PlusPlus,
    population: Vec<Member>,
    archive: Vec<Vec<f64>>,
    /// Scale factors that succeeded.
    scales: Vec<f64>,
    /// Crossover rates that succeeded; none for an entry that has come down to no crossover at all.
    crossovers: Vec<Option<f64>>,
    /// The entry of the memory that is written next.
    entry: usize,
    ways: Vec<Way>,
    generation: usize,
}

impl Lshade {
    /// Random candidates; warm starts take the places of the first ones.
    pub fn new(options: LshadeOptions, search: &Search) -> Self {
        let mut stream = stream(search.seed, 0);
        let first = (options.n_per_parameter * search.dimensions).max(LEAST);
        let mut population: Vec<Member> = search
            .warm_starts()
            .into_iter()
            .take(first)
            .map(|start| Member { position: start.0, cost: Cost::Diverged })
            .collect();
        while population.len() < first {
            population.push(Member {
                position: random_point(search.dimensions, &mut stream),
                cost: Cost::Diverged,
            });
        }
        let entries = options.memory.max(1);
        Self {
            dimensions: search.dimensions,
            budget: search.budget.max(1),
            spent: 0,
            first,
            stream,
            population,
            archive: Vec::new(),
            scales: vec![0.5; entries],
            crossovers: vec![Some(0.5); entries],
            entry: 0,
            ways: Vec::new(),
            generation: 0,
            options,
        }
    }

    /// How a trial is made: from a random entry of the memory.
    fn way(&mut self) -> Way {
        let entry = self.stream.random_range(0..self.scales.len());
        let crossover = self.crossovers[entry]
            .map_or(0.0, |mean| (mean + 0.1 * normal(&mut self.stream)).clamp(0.0, 1.0));
        let scale = loop {
            let turn = std::f64::consts::PI * (self.stream.random::<f64>() - 0.5);
            let drawn = self.scales[entry] + 0.1 * turn.tan();
            if drawn > 0.0 {
                break drawn.min(1.0);
            }
        };
        Way { scale, crossover }
    }

    /// current-to-pbest/1 with the archive, then binomial crossover.
    fn trial(&mut self, target: usize, order: &[usize], way: Way) -> Vec<f64> {
        let n = self.population.len();
        let best =
            order[self.stream.random_range(0..((self.options.p * n as f64).round() as usize).clamp(2, n))];
        let first = draw(&mut self.stream, n, &[target]);
        let second = draw(&mut self.stream, n + self.archive.len(), &[target, first]);
        let position = |index: usize| {
            if index < n { &self.population[index].position } else { &self.archive[index - n] }
        };
        let (own, best, first, second) =
            (position(target), position(best), position(first), position(second));
        let certain = self.stream.random_range(0..self.dimensions.max(1));
        (0..self.dimensions)
            .map(|j| {
                if j != certain && self.stream.random::<f64>() >= way.crossover {
                    return own[j];
                }
                let moved = own[j] + way.scale * (best[j] - own[j]) + way.scale * (first[j] - second[j]);
                // Over the edge: half of the way to it.
                if moved < 0.0 {
                    0.5 * own[j]
                } else if moved > 1.0 {
                    0.5 * (1.0 + own[j])
                } else {
                    moved
                }
            })
            .collect()
    }

    /// Remembers what succeeded, weighted by how much it won.
    fn remember(&mut self, won: &[(Way, f64)]) {
        // Their sum may leave the numbers, their shares of the largest do not.
        let largest = won.iter().map(|(_, gain)| *gain).fold(0.0, f64::max);
        if largest <= 0.0 {
            return;
        }
        let lehmer = |value: &dyn Fn(&Way) -> f64| {
            let moment = |power: i32| {
                won.iter().map(|(way, gain)| gain / largest * value(way).powi(power)).sum::<f64>()
            };
            moment(2) / moment(1)
        };
        let scale = lehmer(&|way| way.scale);
        if scale.is_finite() {
            self.scales[self.entry] = scale;
        }
        // An entry that has come down to nothing stays there; one mean over nothing is none.
        let crossed = Some(lehmer(&|way| way.crossover)).filter(|mean| mean.is_finite());
        self.crossovers[self.entry] = self.crossovers[self.entry].and(crossed);
        self.entry = (self.entry + 1) % self.scales.len();
    }

    /// The population shrinks in proportion to what is spent.
    fn shrink(&mut self) {
        let progress = (self.spent as f64 / self.budget as f64).min(1.0);
        let size = (self.first as f64 + (LEAST as f64 - self.first as f64) * progress).round() as usize;
        if size < self.population.len() {
            self.population.sort_by_key(|member| member.cost);
            self.population.truncate(size.max(LEAST));
        }
        let most = (self.options.archive * self.population.len() as f64) as usize;
        while self.archive.len() > most {
            let gone = self.stream.random_range(0..self.archive.len());
            self.archive.swap_remove(gone);
        }
    }
}

impl Strategy for Lshade {
    fn propose(&mut self) -> Ask {
        if self.spent == 0 {
            return Ask::Costs(
                self.population.iter().map(|member| Candidate(member.position.clone())).collect(),
            );
        }
        let mut order: Vec<usize> = (0..self.population.len()).collect();
        order.sort_by_key(|index| (self.population[*index].cost, *index));
        self.ways.clear();
        let mut trials = Vec::with_capacity(self.population.len());
        for target in 0..self.population.len() {
            let way = self.way();
            self.ways.push(way);
            trials.push(Candidate(self.trial(target, &order, way)));
        }
        Ask::Costs(trials)
    }

    fn digest(&mut self, candidates: &[Candidate], answers: &[Evaluation]) {
        let first = self.spent == 0;
        self.spent += answers.len();
        if first {
            for (member, answer) in self.population.iter_mut().zip(answers) {
                member.cost = answer.cost;
            }
            return;
        }
        let mut won = Vec::new();
        for (index, (candidate, answer)) in candidates.iter().zip(answers).enumerate() {
            let member = &mut self.population[index];
            if answer.cost < member.cost {
                let gain = member.cost.value() - answer.cost.value();
                // What never had a cost is beaten by any, and says nothing of how much was won.
                if gain.is_finite() {
                    won.push((self.ways[index], gain));
                }
                self.archive.push(std::mem::replace(&mut member.position, candidate.0.clone()));
                member.cost = answer.cost;
            } else if answer.cost == member.cost {
                member.position.clone_from(&candidate.0);
            }
        }
        self.remember(&won);
        self.shrink();
        self.generation += 1;
    }

    fn generation(&self) -> usize {
        self.generation
    }
}

/// A standard normal number (Box and Muller).
pub(crate) fn normal<R: Rng>(stream: &mut R) -> f64 {
    let radius = (-2.0 * (1.0 - stream.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * stream.random::<f64>()).cos()
}

/// A number below `n` that is none of these. There are more numbers than exceptions.
fn draw<R: Rng>(stream: &mut R, n: usize, but: &[usize]) -> usize {
    loop {
        let drawn = stream.random_range(0..n);
        if !but.contains(&drawn) {
            return drawn;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::{Function, drive};
    use crate::optimise::method::Method;

    /// What an independent implementation (minionpy) does at the same budgets: all of them, always.
    #[test]
    fn it_solves_what_its_reference_solves() {
        let cases = [
            (Function::Schwefel, 5, 20_000, 1e-2),
            (Function::Schwefel, 10, 40_000, 1e-2),
            (Function::Rosenbrock, 5, 100_000, 1e-8),
            (Function::Ackley, 15, 100_000, 1e-6),
        ];
        for (function, dimensions, budget, within) in cases {
            for seed in 0..5 {
                let search = Search { dimensions, seed, budget, warm: Vec::new(), residuals: false };
                let run = drive(Method::Lshade(LshadeOptions::default()).optimiser(search).as_mut(), |x| {
                    function.cost(x)
                });
                assert!(
                    run.best.value() <= within,
                    "{function:?} {dimensions}, {seed}: {}",
                    run.best.value()
                );
            }
        }
    }

    #[test]
    fn divergence_is_survived_and_a_seed_fixes_every_bit() {
        let search = Search { dimensions: 3, seed: 5, budget: 3000, warm: Vec::new(), residuals: false };
        let run = |cost: &dyn Fn(&[f64]) -> f64| {
            drive(Method::Lshade(LshadeOptions::default()).optimiser(search.clone()).as_mut(), cost)
        };
        assert_eq!(run(&|_| f64::NAN).best, Cost::Diverged);
        let half = |x: &[f64]| if x[0] > 0.5 { f64::NAN } else { Function::Ackley.cost(x) };
        assert_eq!(run(&half), run(&half));
    }
}
