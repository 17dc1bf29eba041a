//! A cloud of candidates that learns the shape of a valley: CMA-ES with active covariance matrix adaptation.
//!
//! N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772 (2016), with the constants of its
//! appendix A; steps along the learnt axes make it indifferent to how a function is rotated. Whoever restarts
//! it chooses the size of the cloud and its width.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::lshade::normal;
use super::{Candidate, Cost};

/// A run ends where its costs differ by less than this, in their own unit.
const FLAT: f64 = 1e-12;
/// It ends where its steps are shorter than this share of the first ones.
const SHORT: f64 = 1e-11;
/// It ends where the longest axis is so many times the shortest, squared.
const NEEDLE: f64 = 1e14;

/// The constants of a run, which follow from the dimension and the size of the cloud.
#[derive(Debug, Clone)]
struct Constants {
    /// Weights by rank; those of the worse half are negative.
    weights: Vec<f64>,
    /// How many of them are positive.
    parents: usize,
    /// The variance effective selection mass.
    mass: f64,
    path_sigma: f64,
    damping: f64,
    path: f64,
    rank_one: f64,
    rank_mu: f64,
    /// Expected length of a standard normal vector.
    chi: f64,
}

impl Constants {
    fn new(dimensions: usize, size: usize) -> Self {
        let n = dimensions as f64;
        let parents = size / 2;
        let raw: Vec<f64> =
            (1..=size).map(|rank| ((size as f64 + 1.0) / 2.0).ln() - (rank as f64).ln()).collect();
        let mass = |part: &[f64]| {
            let (sum, square) = (part.iter().sum::<f64>(), part.iter().map(|w| w * w).sum::<f64>());
            if square > 0.0 { sum * sum / square } else { 0.0 }
        };
        let (good, bad) = (mass(&raw[..parents]), mass(&raw[parents..]));
        let rank_one = (size as f64 / 6.0).min(1.0) * 2.0 / ((n + 1.3).powi(2) + good);
        let rank_mu =
            (1.0 - rank_one).min(2.0 * (0.25 + good + 1.0 / good - 2.0) / ((n + 2.0).powi(2) + good));
        let positive: f64 = raw[..parents].iter().sum();
        let negative: f64 = -raw[parents..].iter().sum::<f64>();
        // The last bound keeps the matrix positive definite.
        let unlearn = (1.0 + rank_one / rank_mu)
            .min(1.0 + 2.0 * bad / (good + 2.0))
            .min((1.0 - rank_one - rank_mu) / (n * rank_mu))
            .max(0.0);
        let weights = raw.iter().map(|w| if *w >= 0.0 { w / positive } else { unlearn * w / negative });
        let path_sigma = (good + 2.0) / (n + good + 3.0);
        Self {
            weights: weights.collect(),
            parents,
            mass: good,
            path_sigma,
            damping: 1.0 + 2.0 * (((good - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + path_sigma,
            path: (4.0 + good / n) / (n + 4.0 + 2.0 * good / n),
            rank_one,
            rank_mu,
            chi: n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
        }
    }
}

/// One run of the cloud.
#[derive(Debug)]
pub struct Cloud {
    constants: Constants,
    stream: Xoshiro256PlusPlus,
    mean: DVector<f64>,
    sigma: f64,
    first_sigma: f64,
    matrix: DMatrix<f64>,
    axes: DMatrix<f64>,
    /// Standard deviations along the axes.
    lengths: DVector<f64>,
    path_sigma: DVector<f64>,
    path: DVector<f64>,
    /// The steps of the pending generation, in units of sigma.
    steps: Vec<DVector<f64>>,
    generation: usize,
    /// The generation in which the axes were last computed.
    turned: usize,
    /// The lowest cost of each generation, and its median.
    history: Vec<[f64; 2]>,
    best: (Candidate, Cost),
    ended: bool,
}

impl Cloud {
    /// How many candidates a generation has unless somebody knows better.
    pub fn size(dimensions: usize) -> usize {
        4 + (3.0 * (dimensions.max(1) as f64).ln()).floor() as usize
    }

    /// A cloud of `size` candidates around a place, as wide as `sigma` in the unit cube.
    pub fn new(start: &Candidate, sigma: f64, size: usize, stream: Xoshiro256PlusPlus) -> Self {
        let n = start.0.len();
        Self {
            constants: Constants::new(n.max(1), size.max(4)),
            stream,
            mean: DVector::from_column_slice(&start.0),
            sigma,
            first_sigma: sigma,
            matrix: DMatrix::identity(n, n),
            axes: DMatrix::identity(n, n),
            lengths: DVector::from_element(n, 1.0),
            path_sigma: DVector::zeros(n),
            path: DVector::zeros(n),
            steps: Vec::new(),
            generation: 0,
            turned: 0,
            history: Vec::new(),
            best: (start.clone(), Cost::Diverged),
            // There is nothing to search.
            ended: n == 0,
        }
    }

    /// The best place so far, and what it costs.
    pub fn place(&self) -> (&[f64], Cost) {
        (&self.best.0.0, self.best.1)
    }

    /// The next generation; none when the run has ended.
    pub fn propose(&mut self) -> Option<Vec<Candidate>> {
        if self.ended {
            return None;
        }
        if self.steps.is_empty() {
            let n = self.mean.len();
            self.steps = (0..self.constants.weights.len())
                .map(|_| {
                    let drawn = DVector::from_fn(n, |_, _| normal(&mut self.stream));
                    &self.axes * drawn.component_mul(&self.lengths)
                })
                .collect();
        }
        let place = |step: &DVector<f64>| {
            Candidate(self.mean.iter().zip(step).map(|(mean, step)| fold(mean + self.sigma * step)).collect())
        };
        Some(self.steps.iter().map(place).collect())
    }

    /// Answers it.
    pub fn digest(&mut self, candidates: &[Candidate], costs: &[Cost]) {
        let mut order: Vec<usize> = (0..self.steps.len().min(costs.len())).collect();
        order.sort_by_key(|index| (costs[*index], *index));
        let Some(first) = order.first().copied().filter(|_| order.len() == self.constants.weights.len())
        else {
            self.ended = true;
            return;
        };
        if costs[first] < self.best.1 {
            self.best = (candidates[first].clone(), costs[first]);
        }
        self.history.push([first, order[order.len() / 2]].map(|index| costs[index].value()));
        self.generation += 1;
        let ranked: Vec<DVector<f64>> = order.iter().map(|index| self.steps[*index].clone()).collect();
        self.steps.clear();
        self.adapt(&ranked);
        let spread = costs[*order.last().unwrap_or(&first)].value() - costs[first].value();
        self.ended = self.is_over(spread);
    }

    /// Moves the mean, and learns the width and the shape from the steps, the best first.
    fn adapt(&mut self, ranked: &[DVector<f64>]) {
        let n = self.mean.len() as f64;
        let Constants { mass, path_sigma, damping, path, rank_one, rank_mu, chi, .. } = self.constants;
        let mut shift = DVector::zeros(self.mean.len());
        for (step, weight) in ranked.iter().zip(&self.constants.weights[..self.constants.parents]) {
            shift.axpy(*weight, step, 1.0);
        }
        self.mean.axpy(self.sigma, &shift, 1.0);
        let whitened = |step: &DVector<f64>| self.axes.tr_mul(step).component_div(&self.lengths);
        let push = &self.axes * whitened(&shift);
        self.path_sigma.axpy((path_sigma * (2.0 - path_sigma) * mass).sqrt(), &push, 1.0 - path_sigma);
        let length = self.path_sigma.norm();
        let faded = 1.0 - (1.0 - path_sigma).powf(2.0 * self.generation as f64);
        let calm = length * length / faded < n * (2.0 + 4.0 / (n + 1.0));
        let pull = if calm { (path * (2.0 - path) * mass).sqrt() } else { 0.0 };
        self.path.axpy(pull, &shift, 1.0 - path);

        let lost = if calm { 0.0 } else { rank_one * path * (2.0 - path) };
        let sum: f64 = self.constants.weights.iter().sum();
        let scales: Vec<f64> = ranked
            .iter()
            .zip(&self.constants.weights)
            .map(|(step, weight)| {
                // A bad step counts by its direction, however long it was.
                let long = if *weight < 0.0 { n / whitened(step).norm_squared().max(1e-300) } else { 1.0 };
                rank_mu * weight * long
            })
            .collect();
        self.matrix *= 1.0 + lost - rank_one - rank_mu * sum;
        self.matrix.ger(rank_one, &self.path, &self.path, 1.0);
        for (step, scale) in ranked.iter().zip(scales) {
            self.matrix.ger(scale, step, step, 1.0);
        }
        self.sigma *= (path_sigma / damping * (length / chi - 1.0)).min(1.0).exp();
        let pace = 1.0 / ((rank_one + rank_mu) * n * 10.0);
        if (self.generation - self.turned) as f64 > pace {
            self.turn();
        }
    }

    /// Computes the axes of the matrix.
    fn turn(&mut self) {
        self.turned = self.generation;
        // Rounding must not make it lopsided.
        self.matrix = (&self.matrix + self.matrix.transpose()) * 0.5;
        if !self.matrix.iter().all(|x| x.is_finite()) {
            self.ended = true;
            return;
        }
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(self.matrix.clone());
        self.lengths = eigenvalues.map(|value| value.max(0.0).sqrt());
        self.axes = eigenvectors;
    }

    /// Whether there is nothing more to expect of this run: the criteria of Hansen's BIPOP-CMA-ES (2009).
    fn is_over(&self, spread: f64) -> bool {
        let (n, size) = (self.mean.len() as f64, self.constants.weights.len() as f64);
        let (least, most) = (self.lengths.min(), self.lengths.max());
        if self.ended || !self.sigma.is_finite() || least <= 0.0 || most * most > NEEDLE * least * least {
            return true;
        }
        let recent = self.history.len().saturating_sub(10 + (30.0 * n / size).ceil() as usize);
        let best = |range: &[[f64; 2]]| {
            range.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], [cost, _]| {
                [low.min(*cost), high.max(*cost)]
            })
        };
        let [low, high] = best(&self.history[recent..]);
        let flat = recent > 0 && (high - low).max(spread) < FLAT;
        // Where nothing can be computed there is nothing to learn, and where all is one nothing to choose.
        let blind = recent > 0 && (low.is_infinite() || high == low);
        let short = self.sigma * most.max(self.path.amax()) < SHORT * self.first_sigma;
        let adrift = self.sigma * most > 1e4 * self.first_sigma;
        let lost = self.generation as f64 > 100.0 + 50.0 * (n + 3.0).powi(2) / size.sqrt();
        flat || blind || short || adrift || lost || self.stagnates()
    }

    /// Whether neither the lowest costs nor the medians have fallen for long.
    fn stagnates(&self) -> bool {
        let (n, size) = (self.mean.len() as f64, self.constants.weights.len() as f64);
        let least = (120.0 + 30.0 * n / size).ceil() as usize;
        let long = least.max(self.history.len() / 5).min(20_000);
        if self.history.len() <= long {
            return false;
        }
        let window = &self.history[self.history.len() - long..];
        let part = (0.3 * long as f64).ceil() as usize;
        [0, 1].into_iter().all(|kind| {
            let median = |range: &[[f64; 2]]| {
                let mut values: Vec<f64> = range.iter().map(|costs| costs[kind]).collect();
                values.sort_by(f64::total_cmp);
                values[values.len() / 2]
            };
            median(&window[long - part..]) >= median(&window[..part])
        })
    }
}

/// Maps the line onto the unit interval by reflecting it at both ends, so that the cost is a function of the
/// whole space and the cloud needs no bounds.
fn fold(x: f64) -> f64 {
    let turn = x.rem_euclid(2.0);
    if turn > 1.0 { 2.0 - turn } else { turn }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::firefly::stream;
    use crate::optimise::functions::Function;

    fn lowest(start: Vec<f64>, seed: u64, cost: impl Fn(&[f64]) -> f64) -> (f64, usize) {
        let size = Cloud::size(start.len());
        let mut cloud = Cloud::new(&Candidate(start), 0.2, size, stream(seed, 0));
        let mut evaluations = 0;
        while let Some(batch) = cloud.propose() {
            assert!(batch.iter().all(|candidate| candidate.0.iter().all(|x| (0.0..=1.0).contains(x))));
            evaluations += batch.len();
            let costs: Vec<Cost> = batch.iter().map(|candidate| Cost::new(cost(&candidate.0))).collect();
            cloud.digest(&batch, &costs);
        }
        (cloud.place().1.value(), evaluations)
    }

    #[test]
    fn needles_valleys_and_optima_at_an_edge_are_found() {
        // Ten thousand times as steep across the diagonal as along it.
        let needle = |x: &[f64]| {
            let along: f64 = x.iter().sum::<f64>() - 1.5;
            x.iter().map(|x| (x - 0.3).powi(2)).sum::<f64>() * 1e-4 + along * along
        };
        for seed in 0..5 {
            let (cost, evaluations) = lowest(vec![0.9; 5], seed, needle);
            assert!(cost < 1e-10 && evaluations < 6_000, "{seed}: {cost} {evaluations}");
            let edge = |x: &[f64]| x.iter().map(|x| x * x).sum();
            assert!(lowest(vec![0.5; 4], seed, edge).0 < 1e-9);
        }
        let solved = (0..5).filter(|seed| {
            lowest(vec![0.5, 0.52, 0.49, 0.5], *seed, |x| Function::Rosenbrock.cost(x)).0 < 1e-9
        });
        assert!(solved.count() >= 4);
    }

    #[test]
    fn a_run_without_anything_to_learn_ends() {
        assert!(lowest(vec![0.5; 3], 1, |_| 1.0).1 < 1_000);
        assert!(lowest(vec![0.5; 3], 1, |_| f64::NAN).1 < 1_000);
        assert_eq!(lowest(Vec::new(), 1, |_| 1.0).1, 0);
        assert_eq!(lowest(vec![0.5; 3], 4, |x| x[0]), lowest(vec![0.5; 3], 4, |x| x[0]));
    }

    #[test]
    fn the_line_is_folded_onto_the_interval() {
        for (x, folded) in [(0.25, 0.25), (-0.25, 0.25), (1.25, 0.75), (2.25, 0.25), (-1.25, 0.75)] {
            assert!((fold(x) - folded).abs() < 1e-15);
        }
    }
}
