//! Autoregressive models of residuals: what is left of them when their own past has explained what it can.

use nalgebra::{DMatrix, DVector};

/// Orders that are tried.
const ORDERS: [usize; 7] = [1, 2, 3, 4, 6, 8, 12];

/// An AR(p) model, `e_t = a_1 e_(t-1) + … + a_p e_(t-p) + w_t`.
#[derive(Debug, Clone, PartialEq)]
pub struct Ar {
    /// Coefficients, the most recent lag first.
    pub coefficients: Vec<f64>,
    /// Standard deviation of the innovations w.
    pub deviation: f64,
    /// Bayesian information criterion of the series under this model, its order counted.
    pub bic: f64,
    /// Samples that the criterion is taken over.
    pub samples: usize,
}

impl Ar {
    /// The order with the lowest BIC among 1, 2, 3, 4, 6, 8 and 12. `None` where nothing can be fitted. A
    /// `None` in the series is a gap, behind which the recursion starts anew.
    pub fn fit(series: &[Option<f64>]) -> Option<Self> {
        Self::fit_orders(series, &ORDERS)
    }

    /// The same on the samples at which something was measured, counted in the step of those: an output that
    /// is measured at every other point of a grid has no gap at each.
    pub fn fit_samples(samples: &[usize], value: impl Fn(usize) -> f64) -> Option<Self> {
        let (first, last) = (samples.first()?, samples.last()?);
        let stride = stride(samples);
        let mut series = vec![None; (last - first) / stride + 1];
        samples.iter().for_each(|k| series[(k - first) / stride] = Some(value(*k)));
        Self::fit(&series)
    }

    /// The same among these orders, which ascend.
    pub fn fit_orders(series: &[Option<f64>], orders: &[usize]) -> Option<Self> {
        let longest = *orders.last()?;
        // All orders are compared on the samples that the longest one can use.
        let rows: Vec<usize> =
            (longest..series.len()).filter(|t| (0..=longest).all(|lag| series[t - lag].is_some())).collect();
        if rows.len() < 4 * longest {
            return None;
        }
        orders
            .iter()
            .filter_map(|order| {
                let value = |t: usize| series[t].unwrap_or(0.0);
                let x = DMatrix::from_fn(rows.len(), *order, |i, j| value(rows[i] - 1 - j));
                let y = DVector::from_fn(rows.len(), |i, _| value(rows[i]));
                let mut normal = x.transpose() * &x;
                // A series that repeats itself leaves the normal equations singular.
                let ridge = 1e-12 * normal.trace().max(f64::MIN_POSITIVE);
                (0..*order).for_each(|i| normal[(i, i)] += ridge);
                let coefficients = normal.cholesky()?.solve(&(x.transpose() * &y));
                let n = rows.len() as f64;
                let variance = (y - x * &coefficients).norm_squared() / n;
                let bic = n * variance.max(f64::MIN_POSITIVE).ln() + *order as f64 * n.ln();
                let coefficients = coefficients.iter().copied().collect();
                Some(Ar { coefficients, deviation: variance.sqrt(), bic, samples: rows.len() })
            })
            .min_by(|a, b| a.bic.total_cmp(&b.bic))
    }

    /// The innovations of a series under this model: `None` within the order behind each gap.
    pub fn whiten(&self, series: &[Option<f64>]) -> Vec<Option<f64>> {
        (0..series.len())
            .map(|t| {
                let mut rest = series[t]?;
                for (lag, coefficient) in self.coefficients.iter().enumerate() {
                    rest -= coefficient * t.checked_sub(lag + 1).and_then(|past| series[past])?;
                }
                Some(rest)
            })
            .collect()
    }
}

/// The step of some ascending samples: the largest number of points that divides every distance of two.
pub fn stride(samples: &[usize]) -> usize {
    samples.windows(2).map(|pair| pair[1] - pair[0]).fold(0, common_divisor).max(1)
}

/// Euclid's greatest common divisor; of a number and nothing it is the number.
pub fn common_divisor(mut a: usize, mut b: usize) -> usize {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_autoregressive_series_is_recognised_and_whitened() {
        // A deterministic pseudo-random drive; the closed form of the variance of AR(1) is s2 / (1 - a2).
        let mut state = 12345u64;
        let mut noise = || {
            (0..12)
                .map(|_| {
                    state =
                        state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    (state >> 11) as f64 / (1u64 << 53) as f64
                })
                .sum::<f64>()
                - 6.0
        };
        let mut series = vec![Some(0.0)];
        for _ in 0..4000 {
            let last = series[series.len() - 1].unwrap_or(0.0);
            series.push(Some(0.8 * last + noise()));
        }
        series[2000] = None;
        let ar = Ar::fit(&series).unwrap();
        assert!((ar.coefficients[0] - 0.8).abs() < 0.05, "{ar:?}");
        assert!((ar.deviation - 1.0).abs() < 0.05, "{ar:?}");
        let white = ar.whiten(&series);
        assert_eq!(white[2000], None);
        assert_eq!(white[2001], None);
        let spread =
            white.iter().flatten().map(|w| w * w).sum::<f64>() / white.iter().flatten().count() as f64;
        assert!((spread.sqrt() - ar.deviation).abs() < 0.02);
    }

    #[test]
    fn every_other_point_is_a_series_of_its_own() {
        let values: Vec<f64> =
            (0..400).map(|k| (f64::from(k) * 0.37).sin() + 0.1 * f64::from(k * k % 7)).collect();
        let sparse: Vec<usize> = (0..400).map(|k| 3 + 2 * k).collect();
        let own = Ar::fit(&values.iter().copied().map(Some).collect::<Vec<_>>());
        assert_eq!(Ar::fit_samples(&sparse, |k| values[(k - 3) / 2]), own);
        assert!(own.is_some());
        assert_eq!((stride(&[4, 8, 14]), stride(&[7]), stride(&[1, 2, 9])), (2, 1, 1));
    }
}
