//! Particle swarm optimisation with constriction: the firefly's elder cousin, as a rival.
//!
//! M. Clerc, J. Kennedy, "The particle swarm: explosion, stability, and convergence in a multidimensional
//! complex space", IEEE Trans. Evolutionary Computation 6 (2002) 58-73; neighbours on a ring (Bratton and
//! Kennedy, IEEE SIS 2007).

use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::budget::Strategy;
use super::firefly::{random_point, stream};
use super::search::Search;
use super::{Ask, Candidate, Cost, Evaluation};

/// The hyperparameters of the particle swarm, as published.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PsoOptions {
    /// Particles.
    pub n: usize,
    /// The share of its velocity that a particle keeps.
    pub inertia: f64,
    /// The pull of the best place that it has seen, and of the best that its neighbours have.
    pub pull: f64,
    /// Neighbours on either side of the ring; as many as particles for one swarm.
    pub neighbours: usize,
}

impl Default for PsoOptions {
    fn default() -> Self {
        Self { n: 50, inertia: 0.729_84, pull: 1.496_172, neighbours: 1 }
    }
}

#[derive(Debug)]
struct Particle {
    position: Vec<f64>,
    velocity: Vec<f64>,
    best: (Vec<f64>, Cost),
}

/// The swarm between two generations.
#[derive(Debug)]
pub struct Pso {
    options: PsoOptions,
    stream: Xoshiro256PlusPlus,
    particles: Vec<Particle>,
    started: bool,
    generation: usize,
}

impl Pso {
    /// Random particles; warm starts take the places of the first ones.
    pub fn new(options: PsoOptions, search: &Search) -> Self {
        let mut stream = stream(search.seed, 0);
        let warm = search.warm_starts();
        let particles = (0..options.n.max(2))
            .map(|index| {
                let drawn = random_point(search.dimensions, &mut stream);
                let position = warm.get(index).map_or(drawn, |start| start.0.clone());
                let velocity = position.iter().map(|x| stream.random::<f64>() - x).collect();
                Particle { best: (position.clone(), Cost::Diverged), position, velocity }
            })
            .collect();
        Self { options, stream, particles, started: false, generation: 0 }
    }

    /// The best place that a particle or one of its neighbours has seen.
    fn guide(&self, index: usize) -> Vec<f64> {
        let n = self.particles.len();
        let reach = self.options.neighbours.min(n / 2);
        let ring = (0..=2 * reach).map(|offset| &self.particles[(index + n - reach + offset) % n].best);
        ring.min_by_key(|best| best.1).map_or_else(Vec::new, |best| best.0.clone())
    }

    fn fly(&mut self, index: usize) {
        let guide = self.guide(index);
        let PsoOptions { inertia, pull, .. } = self.options;
        let Particle { position, velocity, best } = &mut self.particles[index];
        for j in 0..position.len() {
            let (own, others) = (self.stream.random::<f64>(), self.stream.random::<f64>());
            velocity[j] = inertia * velocity[j]
                + pull * own * (best.0[j] - position[j])
                + pull * others * (guide[j] - position[j]);
            position[j] += velocity[j];
            // At a wall a particle stops and turns back slowly.
            if !(0.0..=1.0).contains(&position[j]) {
                position[j] = position[j].clamp(0.0, 1.0);
                velocity[j] *= -0.5;
            }
        }
    }
}

impl Strategy for Pso {
    fn propose(&mut self) -> Ask {
        if self.started {
            (0..self.particles.len()).for_each(|index| self.fly(index));
            self.generation += 1;
        }
        Ask::Costs(self.particles.iter().map(|particle| Candidate(particle.position.clone())).collect())
    }

    fn digest(&mut self, _candidates: &[Candidate], answers: &[Evaluation]) {
        self.started = true;
        for (particle, answer) in self.particles.iter_mut().zip(answers) {
            if answer.cost < particle.best.1 {
                particle.best = (particle.position.clone(), answer.cost);
            }
        }
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
    fn it_solves_ackley_and_not_schwefel() {
        let run = |function: Function, dimensions: usize, budget: usize| -> Vec<f64> {
            let run = |seed| {
                let search = Search { dimensions, seed, budget, warm: Vec::new(), residuals: false };
                drive(Method::Pso(PsoOptions::default()).optimiser(search).as_mut(), |x| function.cost(x))
                    .best
                    .value()
            };
            (0..5).map(run).collect()
        };
        assert!(run(Function::Ackley, 5, 100_000).iter().all(|error| *error < 1e-6));
        assert!(run(Function::Schwefel, 10, 40_000).iter().all(|error| *error > 1.0));
    }

    #[test]
    fn divergence_is_survived_and_a_seed_fixes_every_bit() {
        let search = Search { dimensions: 3, seed: 5, budget: 1000, warm: Vec::new(), residuals: false };
        let run = |cost: &dyn Fn(&[f64]) -> f64| {
            drive(Method::Pso(PsoOptions::default()).optimiser(search.clone()).as_mut(), cost)
        };
        assert_eq!(run(&|_| f64::NAN).best, Cost::Diverged);
        let half = |x: &[f64]| if x[0] > 0.5 { f64::NAN } else { Function::Ackley.cost(x) };
        assert_eq!(run(&half), run(&half));
    }
}
