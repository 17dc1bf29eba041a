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

    /// The same among these orders, which ascend.
    pub fn fit_orders(series: &[Option<f64>], orders: &[usize]) -> Option<Self> {
        let longest = *orders.last()?;
        // All orders are compared on the samples that the longest one can use.
        let rows: Vec<usize> = (longest..series.len()).filter(|t| (0..=longest).all(|lag| series[t - lag].is_some())).collect();
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
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
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
        let spread = white.iter().flatten().map(|w| w * w).sum::<f64>() / white.iter().flatten().count() as f64;
        assert!((spread.sqrt() - ar.deviation).abs() < 0.02);
    }
}
