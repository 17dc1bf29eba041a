//! Seeded k-means on points of the unit cube: how the fireflies are grouped (thesis section 4.3).
//!
//! Points are in the unit cube, so the plain Euclidean distance is the normalised one of equation 4.6.

use rand::{Rng, RngExt};

/// Lloyd's iteration settles within a few sweeps on populations this small; the cap only bounds the worst
/// case.
const SWEEPS: usize = 50;

/// Where the centroids start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seeding {
    /// Distinct points drawn at random, as the thesis does it.
    RandomPoints,
    /// k-means++: each further centroid is drawn with probability proportional to the squared distance from
    /// those before.
    PlusPlus,
}

/// A partition of the points.
#[derive(Debug, Clone, PartialEq)]
pub struct Clusters {
    /// The cluster of each point.
    pub assignment: Vec<usize>,
    /// The mean of each cluster; none is empty.
    pub centroids: Vec<Vec<f64>>,
}

impl Clusters {
    /// The points of one cluster, in index order.
    pub fn members(&self, cluster: usize) -> impl Iterator<Item = usize> + '_ {
        self.assignment.iter().enumerate().filter(move |(_, of)| **of == cluster).map(|(point, _)| point)
    }
}

/// The number of clusters for a population: eq 4.8, `max(1, floor(n / target))`.
pub fn cluster_count(fireflies: usize, target: f64) -> usize {
    let count = (fireflies as f64 / target.max(1.0)).floor() as usize;
    count.clamp(1, fireflies.max(1))
}

/// Partitions `points` into at most `k` clusters. Ties go to the lower index, clusters that run empty are
/// dropped.
pub fn kmeans<R: Rng>(points: &[&[f64]], k: usize, seeding: Seeding, stream: &mut R) -> Clusters {
    if points.is_empty() {
        return Clusters { assignment: Vec::new(), centroids: Vec::new() };
    }
    let k = k.clamp(1, points.len());
    let mut centroids = match seeding {
        Seeding::RandomPoints => random_points(points, k, stream),
        Seeding::PlusPlus => plus_plus(points, k, stream),
    };
    let mut assignment = vec![usize::MAX; points.len()];
    for _ in 0..SWEEPS {
        let mut changed = false;
        for (point, of) in points.iter().zip(&mut assignment) {
            let nearest = nearest(point, &centroids);
            changed |= *of != nearest;
            *of = nearest;
        }
        if !changed {
            break;
        }
        update(points, &assignment, &mut centroids);
    }
    compact(assignment, centroids)
}

/// The squared Euclidean distance.
pub fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// The first `k` of a Fisher-Yates shuffle.
fn random_points<R: Rng>(points: &[&[f64]], k: usize, stream: &mut R) -> Vec<Vec<f64>> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    (0..k)
        .map(|drawn| {
            order.swap(drawn, stream.random_range(drawn..points.len()));
            points[order[drawn]].to_vec()
        })
        .collect()
}

fn plus_plus<R: Rng>(points: &[&[f64]], k: usize, stream: &mut R) -> Vec<Vec<f64>> {
    let first = stream.random_range(0..points.len());
    let mut centroids = vec![points[first].to_vec()];
    let mut gaps: Vec<f64> = points.iter().map(|point| squared_distance(point, points[first])).collect();
    while centroids.len() < k {
        let total: f64 = gaps.iter().sum();
        let mut left = stream.random::<f64>() * total;
        // With coinciding points every gap is zero; any point then is as good as another.
        let mut chosen = centroids.len();
        for (point, gap) in gaps.iter().enumerate().filter(|(_, gap)| **gap > 0.0) {
            chosen = point;
            left -= gap;
            if left < 0.0 {
                break;
            }
        }
        centroids.push(points[chosen].to_vec());
        for (gap, point) in gaps.iter_mut().zip(points) {
            *gap = gap.min(squared_distance(point, points[chosen]));
        }
    }
    centroids
}

fn nearest(point: &[f64], centroids: &[Vec<f64>]) -> usize {
    let mut best = (0, f64::INFINITY);
    for (index, centroid) in centroids.iter().enumerate() {
        let distance = squared_distance(point, centroid);
        if distance < best.1 {
            best = (index, distance);
        }
    }
    best.0
}

/// Moves each centroid to the mean of its points; an empty cluster keeps its place.
fn update(points: &[&[f64]], assignment: &[usize], centroids: &mut [Vec<f64>]) {
    for (cluster, centroid) in centroids.iter_mut().enumerate() {
        let members = assignment.iter().filter(|of| **of == cluster).count();
        if members == 0 {
            continue;
        }
        centroid.fill(0.0);
        for (point, _) in points.iter().zip(assignment).filter(|(_, of)| **of == cluster) {
            for (sum, x) in centroid.iter_mut().zip(*point) {
                *sum += x;
            }
        }
        for sum in centroid.iter_mut() {
            *sum /= members as f64;
        }
    }
}

/// Drops the empty clusters and renumbers the others.
fn compact(assignment: Vec<usize>, centroids: Vec<Vec<f64>>) -> Clusters {
    let mut renumbered = vec![usize::MAX; centroids.len()];
    let mut kept = Vec::with_capacity(centroids.len());
    for (cluster, centroid) in centroids.into_iter().enumerate() {
        if assignment.contains(&cluster) {
            renumbered[cluster] = kept.len();
            kept.push(centroid);
        }
    }
    Clusters { assignment: assignment.into_iter().map(|of| renumbered[of]).collect(), centroids: kept }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::firefly::stream;

    fn three_heaps() -> Vec<Vec<f64>> {
        let heaps = [[0.1, 0.1], [0.9, 0.2], [0.5, 0.9]];
        (0..30).map(|i| heaps[i % 3].iter().map(|x| x + 0.001 * (i / 3) as f64).collect()).collect()
    }

    #[test]
    fn separate_heaps_are_found_by_plus_plus() {
        let points = three_heaps();
        let views: Vec<&[f64]> = points.iter().map(Vec::as_slice).collect();
        for seed in 0..20 {
            let clusters = kmeans(&views, 3, Seeding::PlusPlus, &mut stream(seed, 0));
            assert_eq!(clusters.centroids.len(), 3);
            for point in 0..30 {
                assert_eq!(clusters.assignment[point], clusters.assignment[point % 3]);
            }
            let first = &clusters.centroids[clusters.assignment[0]];
            assert!((first[0] - 0.1045).abs() < 1e-12 && (first[1] - 0.1045).abs() < 1e-12);
        }
    }

    #[test]
    fn coinciding_points_and_too_many_clusters_leave_no_empty_cluster() {
        let points = vec![vec![0.5, 0.5]; 5];
        let views: Vec<&[f64]> = points.iter().map(Vec::as_slice).collect();
        for seeding in [Seeding::RandomPoints, Seeding::PlusPlus] {
            let clusters = kmeans(&views, 9, seeding, &mut stream(3, 0));
            assert_eq!(clusters.centroids, vec![vec![0.5, 0.5]]);
            assert_eq!(clusters.members(0).count(), 5);
        }
        assert!(kmeans(&[], 3, Seeding::PlusPlus, &mut stream(3, 0)).assignment.is_empty());
    }

    #[test]
    fn the_number_of_clusters_is_equation_4_8() {
        assert_eq!(cluster_count(70, 7.0), 10);
        assert_eq!(cluster_count(12, 6.9), 1);
        assert_eq!(cluster_count(3, 7.0), 1);
        assert_eq!(cluster_count(12, 0.5), 12);
    }
}
