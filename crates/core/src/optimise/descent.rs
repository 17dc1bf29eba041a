//! Local searches without derivatives beside BOBYQA, on the unit cube: Nelder and Mead's simplex, and a
//! pattern search.
//!
//! Each calls its objective until it is done; `trust_region` makes an asked and told search of it.

/// When a local search ends.
#[derive(Debug, Clone, Copy)]
pub struct DescentLimits {
    /// Length of the first steps.
    pub radius: f64,
    /// Length of the last ones, which is the accuracy of the optimum.
    pub radius_end: f64,
    /// Most evaluations.
    pub evaluations: usize,
}

/// The objective with its count: none when there are no evaluations left, or nobody listens any more.
struct Counted<F> {
    objective: F,
    left: usize,
}

impl<F: FnMut(&[f64]) -> f64> Counted<F> {
    fn at(&mut self, x: &[f64]) -> Option<f64> {
        self.left = self.left.checked_sub(1)?;
        let value = (self.objective)(x);
        // What could not be computed is worse than anything.
        (value != f64::NEG_INFINITY).then_some(if value.is_nan() { f64::INFINITY } else { value })
    }
}

/// Nelder and Mead's simplex with coefficients that suit the dimension (F. Gao, L. Han, Computational
/// Optimization and Applications 51 (2012) 259-277), clamped to the cube; it starts again from its best point
/// where it has shrunk.
pub fn nelder_mead<F: FnMut(&[f64]) -> f64>(objective: F, start: &[f64], limits: DescentLimits) {
    let mut counted = Counted { objective, left: limits.evaluations };
    let (mut best, mut radius) = (start.to_vec(), limits.radius);
    let Some(mut value) = counted.at(start) else { return };
    while radius >= limits.radius_end {
        let Some((found, cost)) = simplex(&mut counted, &best, value, radius, limits.radius_end) else {
            return;
        };
        // A fresh simplex that finds nothing at this size is followed by a smaller one.
        if cost >= value {
            radius *= 0.1;
        }
        (best, value) = (found, cost);
    }
}

/// One simplex from a point until it has shrunk.
fn simplex<F: FnMut(&[f64]) -> f64>(
    counted: &mut Counted<F>,
    start: &[f64],
    value: f64,
    radius: f64,
    radius_end: f64,
) -> Option<(Vec<f64>, f64)> {
    let d = start.len();
    let n = d.max(2) as f64;
    let (expand, contract, shrink) = (1.0 + 2.0 / n, 0.75 - 0.5 / n, 1.0 - 1.0 / n);
    let mut corners = vec![(start.to_vec(), value)];
    for j in 0..d {
        let mut corner = start.to_vec();
        corner[j] += if corner[j] + radius <= 1.0 { radius } else { -radius };
        corner[j] = corner[j].max(0.0);
        let cost = counted.at(&corner)?;
        corners.push((corner, cost));
    }
    loop {
        corners.sort_by(|a, b| a.1.total_cmp(&b.1));
        let size = corners[1..]
            .iter()
            .flat_map(|corner| corner.0.iter().zip(&corners[0].0))
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        if size < radius_end {
            return corners.into_iter().next();
        }
        let middle: Vec<f64> =
            (0..d).map(|j| corners[..d].iter().map(|corner| corner.0[j]).sum::<f64>() / d as f64).collect();
        let along = |t: f64| -> Vec<f64> {
            middle.iter().zip(&corners[d].0).map(|(m, w)| (m + t * (m - w)).clamp(0.0, 1.0)).collect()
        };
        let (reflected, least, second, worst) = (along(1.0), corners[0].1, corners[d - 1].1, corners[d].1);
        let cost = counted.at(&reflected)?;
        let next = if cost < least {
            let further = along(expand);
            let beyond = counted.at(&further)?;
            Some(if beyond < cost { (further, beyond) } else { (reflected, cost) })
        } else if cost < second {
            Some((reflected, cost))
        } else {
            let nearer = along(if cost < worst { contract } else { -contract });
            let between = counted.at(&nearer)?;
            (between < cost.min(worst)).then_some((nearer, between))
        };
        if let Some(next) = next {
            corners[d] = next;
            continue;
        }
        let best = corners[0].0.clone();
        for corner in &mut corners[1..] {
            corner.0.iter_mut().zip(&best).for_each(|(x, b)| *x = b + shrink * (*x - b));
            corner.1 = counted.at(&corner.0)?;
        }
    }
}

/// A pattern search (R. Hooke, T. A. Jeeves, J. ACM 8 (1961) 212-229): along each coordinate to and fro, on
/// in the direction that has helped, and with half of the step where nothing does.
pub fn pattern<F: FnMut(&[f64]) -> f64>(objective: F, start: &[f64], limits: DescentLimits) {
    let mut counted = Counted { objective, left: limits.evaluations };
    let (mut base, mut radius) = (start.to_vec(), limits.radius);
    let Some(mut value) = counted.at(start) else { return };
    while radius >= limits.radius_end {
        let Some((mut found, mut cost)) = around(&mut counted, base.clone(), value, radius) else { return };
        if cost >= value {
            radius *= 0.5;
            continue;
        }
        while cost < value {
            let ahead: Vec<f64> =
                found.iter().zip(&base).map(|(new, old)| (2.0 * new - old).clamp(0.0, 1.0)).collect();
            (base, value) = (found, cost);
            let Some(there) = counted.at(&ahead) else { return };
            let Some(next) = around(&mut counted, ahead, there, radius) else { return };
            (found, cost) = next;
        }
    }
}

/// The best that one step along each coordinate in turn leads to.
fn around<F: FnMut(&[f64]) -> f64>(
    counted: &mut Counted<F>,
    mut x: Vec<f64>,
    mut value: f64,
    radius: f64,
) -> Option<(Vec<f64>, f64)> {
    for j in 0..x.len() {
        let old = x[j];
        for step in [radius, -radius] {
            x[j] = (old + step).clamp(0.0, 1.0);
            let cost = counted.at(&x)?;
            if cost < value {
                value = cost;
                break;
            }
            x[j] = old;
        }
    }
    Some((x, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::Function;

    const LIMITS: DescentLimits = DescentLimits { radius: 0.05, radius_end: 1e-9, evaluations: 20_000 };

    type Search<'a> = fn(&mut dyn FnMut(&[f64]) -> f64, &[f64], DescentLimits);

    fn lowest(search: Search, start: &[f64], cost: impl Fn(&[f64]) -> f64) -> (f64, usize) {
        let (mut lowest, mut count) = (f64::INFINITY, 0);
        let mut objective = |x: &[f64]| {
            assert!(x.iter().all(|x| (0.0..=1.0).contains(x)));
            count += 1;
            let value = cost(x);
            lowest = if value < lowest { value } else { lowest };
            value
        };
        search(&mut objective, start, LIMITS);
        (lowest, count)
    }

    #[test]
    fn both_find_the_bottom_of_a_bowl_on_a_bound_and_survive_divergence() {
        let searches: [Search; 2] =
            [|f, x, limits| nelder_mead(f, x, limits), |f, x, limits| pattern(f, x, limits)];
        for search in searches {
            let bowl = |x: &[f64]| (x[0] - 0.3).powi(2) + (x[1] + 0.4).powi(2) + 2.0 * (x[2] - x[0]).powi(2);
            let (cost, count) = lowest(search, &[0.5, 0.5, 0.5], bowl);
            assert!((cost - 0.16).abs() < 1e-10 && count < 3_000, "{cost} {count}");
            let (cost, count) = lowest(search, &[0.9, 0.1], |_| f64::NAN);
            assert!(cost.is_infinite() && count < 2_000, "{count}");
            assert!(lowest(search, &[0.5, 0.51, 0.49], |x| Function::Rosenbrock.cost(x)).0 < 1e-6);
            assert!(lowest(search, &[0.9], |x| (x[0] - 0.2).powi(2)).0 < 1e-12);
            // Whoever asked has gone away.
            let mut asked = 0;
            search(
                &mut |_| {
                    asked += 1;
                    if asked > 5 { f64::NEG_INFINITY } else { 1.0 }
                },
                &[0.5; 4],
                LIMITS,
            );
            assert_eq!(asked, 6);
        }
    }
}
