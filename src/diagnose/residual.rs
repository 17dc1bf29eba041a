//! The residual of a free run, measured minus simulated, and its innovations.
//!
//! A room that is warmer than its model has a positive residual: it lacks a gain.

use crate::estimate::Problem;
use crate::estimate::whiten::Ar;

/// Measured minus simulated at every sample; only the usable samples mean anything.
pub fn residual(problem: &Problem, simulated: &[f64]) -> Vec<f64> {
    problem.measured().first().map_or_else(Vec::new, |(values, _)| values.iter().zip(simulated).map(|(y, x)| y - x).collect())
}

/// A linear filter on the usable samples of a part: nothing but selection, or an autoregressive whitening that
/// starts anew behind each gap.
#[derive(Debug, Clone, PartialEq)]
pub struct Whitening {
    coefficients: Vec<f64>,
    rows: Vec<usize>,
}

impl Whitening {
    /// The usable samples as they are.
    pub fn none(usable: &[usize]) -> Self {
        Self { coefficients: Vec::new(), rows: usable.to_vec() }
    }

    /// The innovations under an autoregressive model, at the samples whose whole past is usable.
    pub fn ar(ar: &Ar, usable: &[usize]) -> Self {
        let lags = ar.coefficients.len();
        let whole = |place: &usize| place.checked_sub(lags).is_some_and(|first| usable[*place] - usable[first] == lags);
        let rows = (0..usable.len()).filter(whole).map(|place| usable[place]).collect();
        Self { coefficients: ar.coefficients.clone(), rows }
    }

    /// The filtered series, one value per row.
    pub fn apply(&self, series: &[f64]) -> Vec<f64> {
        let filtered = |t: &usize| {
            let past = series[t - self.coefficients.len()..*t].iter().rev();
            series[*t] - self.coefficients.iter().zip(past).map(|(a, past)| a * past).sum::<f64>()
        };
        self.rows.iter().map(filtered).collect()
    }

    /// The samples of the filtered series.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }
}

/// The autoregressive model of a residual on its usable samples.
pub fn autoregression(residual: &[f64], usable: &[usize]) -> Option<Ar> {
    let end = usable.last().map_or(0, |last| last + 1);
    let mut series = vec![None; end];
    usable.iter().for_each(|k| series[*k] = Some(residual[*k]));
    Ar::fit(&series).filter(|ar| ar.deviation.is_finite() && ar.deviation > 0.0)
}

/// Hours over which a slow residual is averaged.
const SLOW_HOURS: f64 = 3.0;
/// Orders of its autoregressive model.
const SLOW_ORDERS: [usize; 3] = [1, 2, 3];

/// The autoregressive model of the residual's means over three hours: effects that come and go slowly hardly
/// show from one sample to the next, where the whitened residual looks for them.
pub fn slow_autoregression(problem: &Problem, residual: &[f64], usable: &[usize]) -> Option<Ar> {
    let per_mean = ((SLOW_HOURS / problem.grid().step_hours()) as usize).max(1);
    let end = usable.last().map_or(0, |last| last + 1);
    let mut sums = vec![(0.0, 0usize); end / per_mean];
    for k in usable {
        if let Some((sum, count)) = sums.get_mut(k / per_mean) {
            (*sum, *count) = (*sum + residual[*k], *count + 1);
        }
    }
    let means: Vec<Option<f64>> = sums.iter().map(|(sum, count)| (2 * count >= per_mean).then(|| sum / *count as f64)).collect();
    Ar::fit_orders(&means, &SLOW_ORDERS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitening_by_rows_equals_whitening_with_gaps() {
        let series: Vec<f64> = (0..200).map(|k| (f64::from(k) * 0.37).sin() + 0.1 * f64::from(k % 7)).collect();
        let usable: Vec<usize> = (0..200).filter(|k| !(60..65).contains(k) && *k != 120).collect();
        let ar = autoregression(&series, &usable).unwrap();
        let whitening = Whitening::ar(&ar, &usable);
        let options: Vec<Option<f64>> = (0..200).map(|k| usable.contains(&k).then(|| series[k])).collect();
        let reference: Vec<f64> = ar.whiten(&options).into_iter().flatten().collect();
        let ours = whitening.apply(&series);
        assert_eq!(ours.len(), reference.len());
        assert!(ours.iter().zip(&reference).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
