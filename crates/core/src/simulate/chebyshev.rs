//! The coefficients of RKC2, the stabilised explicit Runge-Kutta method of order 2 (Sommeijer, Shampine and
//! Verwer, J. Comput. Appl. Math. 88, 1997): shifted Chebyshev polynomials, damped by 2/13. With s stages a
//! step h is stable on the negative axis down to about -0.65 (s^2 - 1) / h.

use std::sync::LazyLock;

/// Most stages: rounding errors grow with their square.
pub const MOST_STAGES: usize = 100;

/// One stage: `Y_j = (1 - mu - nu) y + mu Y_(j-1) + nu Y_(j-2) + h (slope f(Y_(j-1)) + start f(y))`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// The part of the stage before.
    pub mu: f64,
    /// The part of the stage before that.
    pub nu: f64,
    /// The part of the slope there.
    pub slope: f64,
    /// The part of the slope at the start of the step.
    pub start: f64,
}

static TABLES: LazyLock<Vec<Vec<Stage>>> = LazyLock::new(|| (2..=MOST_STAGES).map(table).collect());

/// The stages 1 to s of the method with so many; at least two, at most [`MOST_STAGES`].
pub fn stages(s: usize) -> &'static [Stage] {
    &TABLES[s.clamp(2, MOST_STAGES) - 2]
}

/// The fewest stages that keep a step stable, where `z` is its length times the spectral radius.
pub fn fewest(z: f64) -> usize {
    // The cast ends at the largest number for what is larger, and at zero for what is no number.
    ((1.54 * z + 1.0).sqrt() as usize).saturating_add(1).max(2)
}

/// The longest stable `z` with so many stages.
pub fn reach(s: usize) -> f64 {
    ((s * s) as f64 - 1.0) / 1.54
}

/// The Chebyshev polynomials of the first kind at w0 with two derivatives, by their recurrence.
fn table(s: usize) -> Vec<Stage> {
    let w0 = 1.0 + 2.0 / (13.0 * (s * s) as f64);
    let mut t = [[1.0, 0.0, 0.0], [w0, 1.0, 0.0]].to_vec();
    for j in 2..=s {
        let ([a, da, dda], [b, db, ddb]) = (t[j - 1], t[j - 2]);
        t.push([2.0 * w0 * a - b, 2.0 * a + 2.0 * w0 * da - db, 4.0 * da + 2.0 * w0 * dda - ddb]);
    }
    let w1 = t[s][1] / t[s][2];
    // b0 and b1 are free; b2 is the usual choice.
    let weight = |j: usize| t[j.max(2)][2] / (t[j.max(2)][1] * t[j.max(2)][1]);
    let mut stages = vec![Stage { mu: 1.0, nu: 0.0, slope: 0.0, start: w1 * weight(1) }];
    for j in 2..=s {
        let mu = 2.0 * w0 * weight(j) / weight(j - 1);
        let slope = 2.0 * w1 * weight(j) / weight(j - 1);
        stages.push(Stage {
            mu,
            nu: -weight(j) / weight(j - 2),
            slope,
            start: -(1.0 - t[j - 1][0] * weight(j - 1)) * slope,
        });
    }
    stages
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One step of y' = f(y) with s stages.
    fn step(f: impl Fn(f64) -> f64, y: f64, h: f64, s: usize) -> f64 {
        let [first, rest @ ..] = stages(s) else { return f64::NAN };
        let (mut before, mut last) = (y, y + h * first.start * f(y));
        for stage in rest {
            let next = (1.0 - stage.mu - stage.nu) * y
                + stage.mu * last
                + stage.nu * before
                + h * (stage.slope * f(last) + stage.start * f(y));
            (before, last) = (last, next);
        }
        last
    }

    #[test]
    fn the_order_is_two_for_any_number_of_stages() {
        // The logistic equation: y = 1 / (1 + 3 exp(-t)).
        let error = |s: usize, steps: u32| {
            let h = 2.0 / f64::from(steps);
            let y = (0..steps).fold(0.25, |y, _| step(|y| y * (1.0 - y), y, h, s));
            (y - 1.0 / (1.0 + 3.0 * (-2.0f64).exp())).abs()
        };
        for s in [2, 3, 5, 13, 40, 100] {
            let order = (error(s, 40) / error(s, 80)).log2();
            assert!((order - 2.0).abs() < 0.1, "{s} stages: {order}");
        }
    }

    #[test]
    fn the_negative_axis_is_stable_as_far_as_promised() {
        for s in [2, 3, 7, 30, 100] {
            assert_eq!(fewest(0.999 * reach(s)), s);
            for part in 1..=1000 {
                let z = reach(s) * f64::from(part) / 1000.0;
                let factor = step(|y| -z * y, 1.0, 1.0, s);
                assert!(factor.abs() < 1.0, "{s} stages, {z}: {factor}");
            }
            // An odd polynomial leaves through zero and stays small for longer.
            assert!(
                s % 2 == 1 || step(|y| -1.1 * reach(s) * y, 1.0, 1.0, s).abs() > 1.0,
                "the bound is no idle one"
            );
        }
    }
}
