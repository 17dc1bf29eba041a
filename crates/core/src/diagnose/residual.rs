//! The residual of a free run, measured minus simulated, and its innovations.
//!
//! A room that is warmer than its model has a positive residual: it lacks a gain. The residual of a model
//! with one output is in the unit of that; those of several outputs are counted in the noise of their
//! sensors, so that they may stand side by side.

use crate::estimate::Problem;
use crate::estimate::problem::whiten::{Ar, stride};
use crate::simulate::Trajectory;
use crate::simulate::trajectory::MeasuredOutput;
use std::ops::Range;

/// Measured minus simulated of every output at every sample, each in its weight; only the usable samples mean
/// anything.
pub fn residuals(problem: &Problem, run: &Trajectory) -> Vec<Vec<f64>> {
    let of_output = |(output, (simulated, (y, _))): (usize, (&Vec<f64>, MeasuredOutput))| {
        let weight = 1.0 / problem.scale(output);
        y.iter().zip(simulated).map(|(y, x)| (y - x) * weight).collect()
    };
    run.outputs.iter().zip(problem.measured()).enumerate().map(of_output).collect()
}

/// The samples of a part at which each output means something.
pub fn usable(problem: &Problem, range: &Range<usize>) -> Vec<Vec<usize>> {
    (0..problem.model().outputs().len()).map(|output| problem.usable(output, range.clone())).collect()
}

/// The residuals of some outputs at their usable samples, one output after another.
pub fn at(residuals: &[Vec<f64>], usable: &[Vec<usize>]) -> Vec<f64> {
    residuals.iter().zip(usable).flat_map(|(series, usable)| usable.iter().map(|k| series[*k])).collect()
}

/// A linear filter on the usable samples of a part: nothing but selection, or an autoregressive whitening
/// that starts anew behind each gap.
#[derive(Debug, Clone, PartialEq)]
pub struct Whitening(Vec<Filter>);

/// The filter of one output.
#[derive(Debug, Clone, PartialEq)]
struct Filter {
    coefficients: Vec<f64>,
    rows: Vec<usize>,
    stride: usize,
    weight: f64,
}

impl Whitening {
    /// The usable samples as they are.
    pub fn none(usable: &[Vec<usize>]) -> Self {
        Self(
            usable
                .iter()
                .map(|rows| Filter { coefficients: Vec::new(), rows: rows.clone(), stride: 1, weight: 1.0 })
                .collect(),
        )
    }

    /// The innovations under autoregressive models, at the samples whose whole past is usable. Those of
    /// several outputs have a deviation of one.
    pub fn ar(ar: &Autoregression, usable: &[Vec<usize>]) -> Self {
        let several = usable.len() > 1;
        let filter = |(ar, usable): (&Ar, &Vec<usize>)| {
            let (lags, stride) = (ar.coefficients.len(), stride(usable));
            let whole = |place: &usize| {
                place.checked_sub(lags).is_some_and(|first| usable[*place] - usable[first] == lags * stride)
            };
            let rows = (0..usable.len()).filter(whole).map(|place| usable[place]).collect();
            Filter {
                coefficients: ar.coefficients.clone(),
                rows,
                stride,
                weight: if several { 1.0 / ar.deviation } else { 1.0 },
            }
        };
        Self(ar.0.iter().zip(usable).map(filter).collect())
    }

    /// The filtered series, one value per row, one output after another.
    pub fn apply(&self, residuals: &[Vec<f64>]) -> Vec<f64> {
        self.0.iter().zip(residuals).flat_map(|(filter, series)| filter.apply(series)).collect()
    }

    /// The samples of an output, each with the place of its value in the filtered series.
    pub fn rows_of(&self, output: usize) -> impl Iterator<Item = (usize, usize)> {
        let before: usize = self.0.iter().take(output).map(|filter| filter.rows.len()).sum();
        let rows = self.0.get(output).map_or(&[][..], |filter| filter.rows.as_slice());
        rows.iter().enumerate().map(move |(place, row)| (before + place, *row))
    }
}

impl Filter {
    /// The filtered series of one output. Rows that follow each other go lag by lag, which vectorises and
    /// adds the terms of each row in the order of the lags all the same.
    fn apply(&self, series: &[f64]) -> Vec<f64> {
        let Self { coefficients, rows, stride, weight } = self;
        let mut filtered = Vec::with_capacity(rows.len());
        let mut known = vec![0.0; rows.len()];
        for run in rows.chunk_by(|row, next| next - row == *stride) {
            let known = &mut known[filtered.len()..][..run.len()];
            for (lag, a) in coefficients.iter().enumerate() {
                let past = &series[run[0] - (lag + 1) * stride..];
                match stride {
                    1 => known.iter_mut().zip(past).for_each(|(known, past)| *known += a * past),
                    _ => known
                        .iter_mut()
                        .zip(past.iter().step_by(*stride))
                        .for_each(|(known, past)| *known += a * past),
                }
            }
            filtered.extend(run.iter().zip(known).map(|(row, known)| (series[*row] - *known) * weight));
        }
        filtered
    }
}

/// The autoregressive models of the residuals of all outputs.
#[derive(Debug, Clone, PartialEq)]
pub struct Autoregression(Vec<Ar>);

impl Autoregression {
    /// `None` where that of any output cannot be fitted.
    pub fn fit(residuals: &[Vec<f64>], usable: &[Vec<usize>]) -> Option<Self> {
        let one = |(residual, usable): (&Vec<f64>, &Vec<usize>)| {
            Ar::fit_samples(usable, |k| residual[k])
                .filter(|ar| ar.deviation.is_finite() && ar.deviation > 0.0)
        };
        residuals.iter().zip(usable).map(one).collect::<Option<_>>().map(Self)
    }

    /// Their criteria together, for the errors of different outputs are taken as independent, and the samples
    /// of all.
    pub fn bic(&self) -> (f64, usize) {
        (self.0.iter().map(|ar| ar.bic).sum(), self.0.iter().map(|ar| ar.samples).sum())
    }

    /// The deviation of the innovations; of several outputs the root of the mean square.
    pub fn deviation(&self) -> f64 {
        match &self.0[..] {
            [one] => one.deviation,
            several => {
                let squares: f64 =
                    several.iter().map(|ar| ar.samples as f64 * ar.deviation * ar.deviation).sum();
                (squares / self.bic().1.max(1) as f64).sqrt()
            }
        }
    }

    /// The deviation of what [`Whitening::ar`] leaves.
    pub fn deviation_filtered(&self) -> f64 {
        if let [one] = &self.0[..] { one.deviation } else { 1.0 }
    }
}

/// Hours over which a slow residual is averaged.
const SLOW_HOURS: f64 = 3.0;
/// Orders of its autoregressive model.
const SLOW_ORDERS: [usize; 3] = [1, 2, 3];

/// The autoregressive models of the residuals' means over three hours: effects that come and go slowly hardly
/// show from one sample to the next, where the whitened residual looks for them. Their criteria and samples.
pub fn slow_bic(problem: &Problem, residuals: &[Vec<f64>], usable: &[Vec<usize>]) -> Option<(f64, usize)> {
    let per_mean = ((SLOW_HOURS / problem.grid().step_hours()) as usize).max(1);
    let one = |(residual, usable): (&Vec<f64>, &Vec<usize>)| {
        let end = usable.last().map_or(0, |last| last + 1);
        let mut sums = vec![(0.0, 0usize); end / per_mean];
        for k in usable {
            if let Some((sum, count)) = sums.get_mut(k / per_mean) {
                (*sum, *count) = (*sum + residual[*k], *count + 1);
            }
        }
        let stride = stride(usable);
        let means: Vec<Option<f64>> = sums
            .iter()
            .map(|(sum, count)| (2 * count * stride >= per_mean).then(|| sum / *count as f64))
            .collect();
        Ar::fit_orders(&means, &SLOW_ORDERS)
    };
    residuals.iter().zip(usable).map(one).collect::<Option<Vec<Ar>>>().map(|ars| Autoregression(ars).bic())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitening_by_rows_equals_whitening_with_gaps() {
        let series: Vec<f64> =
            (0..200).map(|k| (f64::from(k) * 0.37).sin() + 0.1 * f64::from(k % 7)).collect();
        let usable: Vec<usize> = (0..200).filter(|k| !(60..65).contains(k) && *k != 120).collect();
        let ar = Autoregression::fit(std::slice::from_ref(&series), std::slice::from_ref(&usable)).unwrap();
        let whitening = Whitening::ar(&ar, std::slice::from_ref(&usable));
        let options: Vec<Option<f64>> = (0..200).map(|k| usable.contains(&k).then(|| series[k])).collect();
        let reference: Vec<f64> = ar.0[0].whiten(&options).into_iter().flatten().collect();
        let ours = whitening.apply(std::slice::from_ref(&series));
        assert_eq!(ours.len(), reference.len());
        assert!(ours.iter().zip(&reference).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn outputs_of_different_sizes_weigh_alike_when_whitened() {
        let mut state = 1u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let small: Vec<f64> = (0..300).map(|_| 0.01 * noise()).collect();
        let large: Vec<f64> = (0..300).map(|_| 100.0 * noise()).collect();
        let (series, usable) = ([small, large], vec![(0..300).collect::<Vec<usize>>(); 2]);
        let ar = Autoregression::fit(&series, &usable).unwrap();
        let white = Whitening::ar(&ar, &usable).apply(&series);
        let (first, second) = white.split_at(white.len() / 2);
        for half in [first, second] {
            let deviation = (half.iter().map(|x| x * x).sum::<f64>() / half.len() as f64).sqrt();
            assert!((deviation - 1.0).abs() < 0.05, "{deviation}");
        }
        let alone =
            |output: usize| Autoregression::fit(&series[output..=output], &usable[..1]).unwrap().bic();
        assert_eq!(ar.bic(), (alone(0).0 + alone(1).0, alone(0).1 + alone(1).1));
    }

    #[test]
    fn the_rows_of_an_output_lead_to_its_own_values() {
        let series = [vec![1.0, 2.0, 3.0], vec![10.0, 20.0, 30.0]];
        let whitening = Whitening::none(&[vec![0, 2], vec![1]]);
        let filtered = whitening.apply(&series);
        let values = |output: usize| -> Vec<(usize, f64)> {
            whitening.rows_of(output).map(|(place, row)| (row, filtered[place])).collect()
        };
        assert_eq!((values(0), values(1)), (vec![(0, 1.0), (2, 3.0)], vec![(1, 20.0)]));
        assert_eq!(values(2), []);
    }
}
