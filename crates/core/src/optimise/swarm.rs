//! One swarm of the hybrid: the clustered firefly moves with a synchronous update.
//!
//! In Algorithm 2 a firefly sees the moves of those before it, so that each move is a batch of one. Here
//! everyone sees the places and intensities of the start of the generation, and the moves go in rounds: in
//! each round every firefly that still has somebody brighter to follow makes one move, and these moves are
//! one batch. The results are as good as those of the sequential order, and the lanes are full.

use rand_xoshiro::Xoshiro256PlusPlus;

use super::cfa_options::{CfaOptions, LocalFrom, OnCostsOptions};
use super::firefly::{self, Edges, Firefly, Flight};
use super::kmeans::{Clusters, Seeding, cluster_count, kmeans};
use super::{Candidate, Cost, Evaluation};

/// Somebody or some cluster that may attract, as it was at the start of the generation.
#[derive(Debug, Clone)]
struct Light {
    position: Vec<f64>,
    intensity: Cost,
    /// 1 for a firefly, the cluster's size for a centroid (eq 4.10).
    crowd: f64,
}

/// A swarm between two batches.
#[derive(Debug)]
pub struct Swarm {
    options: CfaOptions,
    /// How everyone moves, but for the randomness, which falls.
    flight: Flight,
    /// Whether a firefly returns from a place that is worse.
    greedy: bool,
    /// Evaluations over which the schedules run.
    budget: usize,
    spent: usize,
    fireflies: Vec<Firefly>,
    /// The stream of k-means; each firefly owns another.
    stream: Xoshiro256PlusPlus,
    /// For each firefly, the lights it has not compared itself with yet, the next one last.
    lights: Vec<Vec<Light>>,
    /// The fireflies that moved in the pending round.
    movers: Vec<usize>,
    generation: usize,
    /// Lowest cost so far, and the generations since it fell noticeably.
    best: Cost,
    still: usize,
    ended: bool,
}

impl Swarm {
    /// A fresh swarm over `budget` evaluations. `first_id` numbers its random streams, so that each swarm of
    /// a search draws other numbers; `first` are the places of its first fireflies.
    pub fn new(
        options: &CfaOptions,
        guided: bool,
        budget: usize,
        seed: u64,
        first_id: u64,
        dimensions: usize,
        first: &[Candidate],
    ) -> Self {
        let CfaOptions { beta0, alpha, gamma, crossover, crowd, .. } = *options;
        let gentle = Flight { beta0, gamma, alpha, crossover, leap: 0.0, crowd, edges: Edges::Bounce };
        let OnCostsOptions { gamma, crossover, leap, .. } = options.on_costs;
        let flight = if guided { gentle } else { Flight { gamma, crossover, leap, ..gentle } };
        let fireflies: Vec<Firefly> = (0..options.n.max(2))
            .map(|index| {
                let id = first_id + 1 + index as u64;
                match first.get(index) {
                    Some(start) => Firefly::at(seed, id, start),
                    None => Firefly::random(seed, id, dimensions),
                }
            })
            .collect();
        Self {
            budget: budget.max(1),
            spent: 0,
            movers: (0..fireflies.len()).collect(),
            lights: Vec::new(),
            stream: firefly::stream(seed, first_id),
            fireflies,
            generation: 0,
            best: Cost::Diverged,
            still: 0,
            ended: false,
            flight,
            greedy: !guided,
            options: options.clone(),
        }
    }

    /// How many stream numbers a swarm uses.
    pub fn ids(options: &CfaOptions) -> u64 {
        1 + options.n.max(2) as u64
    }

    /// Generations completed.
    pub fn generation(&self) -> usize {
        self.generation
    }

    /// The next round of moves; none when the swarm has spent its evaluations or stands still.
    pub fn propose(&mut self) -> Option<Vec<Candidate>> {
        if self.ended {
            return None;
        }
        Some(self.movers.iter().map(|mover| self.fireflies[*mover].candidate()).collect())
    }

    /// Answers it.
    pub fn digest(&mut self, answers: &[Evaluation]) {
        self.spent += answers.len();
        for (mover, answer) in self.movers.iter().zip(answers) {
            self.fireflies[*mover].settle(answer.cost);
            if self.greedy {
                self.fireflies[*mover].turn_back();
            }
        }
        if self.spent >= self.budget {
            self.ended = true;
        } else if !self.round() {
            self.next_generation();
        }
    }

    /// The share of the schedules that is behind.
    fn progress(&self) -> f64 {
        (self.spent as f64 / self.budget as f64).min(1.0)
    }

    /// Moves every firefly that still has a brighter light to follow; whether there was any.
    fn round(&mut self) -> bool {
        // The randomness falls geometrically with the evaluations, not with the generations, which shrink.
        let alpha = self.options.alpha * (self.options.alpha_end / self.options.alpha).powf(self.progress());
        let flight = Flight { alpha: if alpha.is_finite() { alpha } else { 0.0 }, ..self.flight };
        self.movers.clear();
        for (index, lights) in self.lights.iter_mut().enumerate() {
            while let Some(light) = lights.pop() {
                if light.intensity < self.fireflies[index].cost {
                    self.fireflies[index].fly(&light.position, light.crowd, &flight);
                    self.movers.push(index);
                    break;
                }
            }
        }
        !self.movers.is_empty()
    }

    fn next_generation(&mut self) {
        self.generation += 1;
        let progress = self.progress();
        let keep = firefly::population(self.options.n, self.options.n_min.max(2), progress);
        firefly::keep_brightest(&mut self.fireflies, keep);
        if self.stands_still() {
            self.ended = true;
            return;
        }
        self.look_around(firefly::target_size(self.options.target, self.options.target_min, progress));
        if !self.round() {
            self.nobody_moves();
        }
    }

    /// Whether the best cost has not fallen noticeably for as many generations as are patience.
    fn stands_still(&mut self) -> bool {
        let best = self.fireflies.iter().map(|firefly| firefly.best.1).min().unwrap_or(Cost::Diverged);
        let fell = match (self.best, best) {
            (Cost::Finite(old), Cost::Finite(new)) => old - new > 1e-3 * old.abs(),
            (Cost::Diverged, Cost::Finite(_)) => true,
            _ => false,
        };
        if fell {
            self.best = best;
            self.still = 0;
        } else {
            self.still += 1;
        }
        self.options.stall > 0 && self.still >= self.options.stall
    }

    /// Clusters the population and lists the lights of each firefly: its cluster's members, then the
    /// centroids of the other clusters.
    fn look_around(&mut self, target: f64) {
        let points: Vec<&[f64]> = self.fireflies.iter().map(|firefly| firefly.position.as_slice()).collect();
        let k = cluster_count(points.len(), target);
        let clusters = kmeans(&points, k, Seeding::PlusPlus, &mut self.stream);
        let centroids: Vec<Light> =
            (0..clusters.centroids.len()).map(|c| self.centroid(&clusters, c)).collect();
        self.lights = (0..self.fireflies.len())
            .map(|index| {
                let own = clusters.assignment[index];
                let others = (0..centroids.len()).filter(|c| *c != own).map(|c| centroids[c].clone());
                let near =
                    clusters.members(own).filter(|other| *other != index).map(|other| self.light(other));
                let mut lights: Vec<Light> = near.chain(others).collect();
                // They are taken from the end.
                lights.reverse();
                lights
            })
            .collect();
    }

    fn light(&self, index: usize) -> Light {
        let firefly = &self.fireflies[index];
        Light { position: firefly.position.clone(), intensity: firefly.cost, crowd: 1.0 }
    }

    fn centroid(&self, clusters: &Clusters, cluster: usize) -> Light {
        Light {
            position: clusters.centroids[cluster].clone(),
            intensity: firefly::mean_cost(
                clusters.members(cluster).map(|member| self.fireflies[member].cost),
            ),
            crowd: clusters.members(cluster).count() as f64,
        }
    }

    /// Where nothing could be computed there is nobody to follow, and everyone is drawn anew. Where all costs
    /// are equal and finite the swarm has nothing left to say.
    fn nobody_moves(&mut self) {
        if self.fireflies.iter().any(|firefly| firefly.cost != Cost::Diverged) {
            self.ended = true;
            return;
        }
        for firefly in &mut self.fireflies {
            firefly.redraw();
        }
        self.movers = (0..self.fireflies.len()).collect();
    }

    /// Up to `count` starts for the local stage, the cheapest first: by default the fireflies' best places so
    /// far in as many clusters, and of each cluster the best one.
    pub fn starts(&mut self, from: LocalFrom, count: usize) -> Vec<Candidate> {
        let mut seen: Vec<&(Candidate, Cost)> = self
            .fireflies
            .iter()
            .map(|firefly| &firefly.best)
            .filter(|best| best.1 != Cost::Diverged)
            .collect();
        if from == LocalFrom::Fireflies {
            seen.sort_by_key(|best| best.1);
            return seen.into_iter().take(count.max(1)).map(|best| best.0.clone()).collect();
        }
        let points: Vec<&[f64]> = seen.iter().map(|best| best.0.0.as_slice()).collect();
        let clusters = kmeans(&points, count.max(1), Seeding::PlusPlus, &mut self.stream);
        let best =
            |cluster: usize| clusters.members(cluster).map(|member| seen[member]).min_by_key(|best| best.1);
        let mut starts: Vec<(Candidate, Cost)> = (0..clusters.centroids.len())
            .filter_map(|cluster| {
                let (place, cost) = best(cluster)?;
                let place = if from == LocalFrom::Centroids {
                    Candidate(clusters.centroids[cluster].clone())
                } else {
                    place.clone()
                };
                Some((place, *cost))
            })
            .collect();
        starts.sort_by_key(|start| start.1);
        starts.into_iter().map(|start| start.0).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::Function;

    fn answers(batch: &[Candidate], cost: impl Fn(&[f64]) -> f64) -> Vec<Evaluation> {
        batch
            .iter()
            .map(|c| Evaluation { cost: Cost::new(cost(&c.0)), residuals: Vec::new(), slope: None })
            .collect()
    }

    #[test]
    fn a_swarm_asks_in_large_batches_and_ends_with_its_evaluations() {
        let mut swarm = Swarm::new(&CfaOptions::default(), true, 1000, 1, 0, 5, &[]);
        let mut sizes = Vec::new();
        while let Some(batch) = swarm.propose() {
            sizes.push(batch.len());
            swarm.digest(&answers(&batch, |x| Function::Ackley.cost(x)));
        }
        let spent: usize = sizes.iter().sum();
        assert!((1000..1040).contains(&spent), "{spent}");
        assert!(spent as f64 / sizes.len() as f64 > 8.0, "{sizes:?}");
        assert!(swarm.starts(LocalFrom::ClusterBests, 4).len() == 4);
    }

    #[test]
    fn a_flat_cost_ends_at_once_and_divergence_is_drawn_anew() {
        let mut swarm = Swarm::new(&CfaOptions::default(), true, 1000, 1, 0, 5, &[]);
        let first = swarm.propose().unwrap();
        swarm.digest(&answers(&first, |_| 1.0));
        assert_eq!(swarm.propose(), None);

        let mut swarm =
            Swarm::new(&CfaOptions { stall: 0, ..CfaOptions::default() }, true, 1000, 1, 0, 5, &[]);
        let mut rounds = 0;
        while let Some(batch) = swarm.propose() {
            swarm.digest(&answers(&batch, |_| f64::NAN));
            rounds += 1;
        }
        assert!(rounds > 25, "{rounds}");
        assert!(swarm.starts(LocalFrom::ClusterBests, 4).is_empty());
    }
}
