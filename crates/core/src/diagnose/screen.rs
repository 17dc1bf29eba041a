//! The instant preview: a score test of every candidate, one linearised simulation each.
//!
//! The residual, the sensitivities of the model's own parameters and that of the candidate go through the
//! same whitening filter. What the model's own parameters can imitate is projected out; what is left of the
//! residual is compared with what is left of the candidate: LM = -n ln(1 - R2) (Rao's score test; reference:
//! missing-effects 3).

use super::library::{CandidateEffect, sign_allows};
use super::refit::{Refit, filtered, simulated};
use super::residual::{Whitening, at, usable};
use crate::estimate::Problem;
use crate::estimate::problem::mean_square;
use crate::model::Scale;
use crate::simulate::trajectory::Halt;
use nalgebra::{DMatrix, DVector};

/// A candidate that moves the output by less than this at its physical bound cannot be seen, in the noise of
/// its sensor.
const VISIBLE: f64 = 0.4;
/// A candidate of which the model's own parameters imitate all but this share of the variance has no score
/// here, but may gain elsewhere: where a rate lies on its bound, one state imitates another.
const IMITATED: f64 = 1e-4;
/// All but this share, and it is the same term once more.
const SAME: f64 = 1e-8;
/// Step of a difference, as a share of the interval of a linear parameter or of the nominal value of a rate.
const STEP: f64 = 1e-3;

/// What the linearised model says of a candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// LM statistic, chi-squared with as many degrees of freedom as the effect has parameters.
    pub statistic: f64,
    /// The same less the price of its parameters, `k ln n`.
    pub net: f64,
    /// The coefficients that fit best, as changes from the values at which the effect is off.
    pub step: Vec<f64>,
    /// Whether the sign is one that physics allows.
    pub sign: bool,
    /// What is left of the candidate's first sensitivity, of length one: for ties.
    pub direction: Vec<f64>,
    /// Whether the model's own parameters imitate it at this place.
    pub imitated: bool,
}

impl Score {
    /// Of a candidate that does nothing where it was asked about.
    pub fn nothing() -> Self {
        Self {
            statistic: 0.0,
            net: 0.0,
            step: Vec::new(),
            sign: true,
            direction: Vec::new(),
            imitated: false,
        }
    }
}

/// Why a candidate has no score.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blind {
    /// Even at its physical bound it hardly moves the room.
    TooSmall,
    /// The model's own parameters can do the same.
    Imitated,
    /// Its simulation diverges.
    Diverged,
}

/// The residual and the model's own sensitivities at a parameter vector, ready to score candidates.
pub struct Screen<'a> {
    base: &'a Problem,
    theta: Vec<f64>,
    whitening: &'a Whitening,
    /// An orthonormal basis of what the model's own parameters can do.
    own: DMatrix<f64>,
    residual: DVector<f64>,
    halt: Halt<'a>,
}

impl<'a> Screen<'a> {
    /// Linearises the model at `theta`; `None` where it diverges there.
    pub fn new(base: &'a Problem, theta: &[f64], whitening: &'a Whitening, halt: Halt<'a>) -> Option<Self> {
        let task = Refit { problem: base, whitening, deviation: 0.0, halt };
        let mut slopes = task.slopes(theta)?;
        for mut column in slopes.column_iter_mut() {
            let norm = column.norm();
            if norm > 0.0 {
                column /= norm;
            }
        }
        let residual = filtered(base, whitening, &[theta.to_vec()], halt).pop().flatten()?;
        let own = slopes.qr().q();
        let mut residual = DVector::from_vec(residual);
        residual -= &own * own.tr_mul(&residual);
        Some(Self { base, theta: theta.to_vec(), whitening, own, residual, halt })
    }

    /// Scores one candidate.
    ///
    /// # Errors
    /// [`Blind`] where these data cannot show it.
    pub fn score(&self, candidate: &CandidateEffect) -> Result<Score, Blind> {
        let off = candidate.lift(self.base, &self.theta);
        let mut thetas = vec![off.clone()];
        let mut steps = Vec::new();
        for (index, _) in &candidate.own {
            let step = difference(candidate, *index);
            let mut moved = off.clone();
            moved[*index] += step;
            steps.push(step);
            thetas.push(moved);
        }
        if let [(index, nothing)] = candidate.own[..] {
            let mut nominal = off.clone();
            nominal[index] = candidate.problem.nominal()[index];
            let step = nominal[index] - nothing;
            if step != 0.0 {
                steps.push(step);
                thetas.push(nominal);
            }
        }
        let mut bound = off.clone();
        candidate.own.iter().for_each(|(index, _)| bound[*index] = candidate.problem.bounds()[*index][1]);
        thetas.push(bound);
        let runs = simulated(&candidate.problem, &thetas, self.halt);
        let train = usable(&candidate.problem, &candidate.problem.split().train);
        if let (Some(Some(with)), Some(Some(without))) = (runs.last(), runs.first()) {
            let difference: Vec<f64> = at(with, &train)
                .iter()
                .zip(at(without, &train))
                .map(|(with, without)| with - without)
                .collect();
            if mean_square(&difference).sqrt() < VISIBLE * candidate.problem.scaled_noise() {
                return Err(Blind::TooSmall);
            }
        }
        let whitened = |run: &Option<Vec<Vec<f64>>>| run.as_ref().map(|run| self.whitening.apply(run));
        let series: Vec<Vec<f64>> =
            runs[..runs.len() - 1].iter().map(whitened).collect::<Option<_>>().ok_or(Blind::Diverged)?;
        let column = |run: usize, step: f64| {
            series[0].iter().zip(&series[run]).map(move |(off, with)| (off - with) / step)
        };
        let k = candidate.own.len();
        let tangent = DMatrix::from_iterator(
            series[0].len(),
            k,
            (0..k).flat_map(|index| column(index + 1, steps[index])),
        );
        let score = self.explained(candidate, &tangent)?;
        // What a delay does is no multiple of what a small one does: the secant to the nominal value shows it
        // better.
        let secants =
            steps[k..].iter().map(|step| DMatrix::from_iterator(series[0].len(), 1, column(k + 1, *step)));
        let best = secants
            .filter_map(|secant| self.explained(candidate, &secant).ok())
            .find(|other| other.sign && other.statistic > score.statistic);
        Ok(best.unwrap_or(score))
    }

    /// What is left of the change that a candidate makes at these parameters, and of the residual, sample by
    /// sample of the whitened series, when all that the model's own parameters can do is taken from both: the
    /// two axes of an added-variable plot (Cook and Weisberg 1982), whose slope is 1 where the candidate is
    /// as large as that. The change is that of the grown model with and without the candidate: where an
    /// effect saturates, it is another at the parameters of a model that had to do without it. `None` where
    /// its simulation diverges.
    pub fn added(&self, candidate: &CandidateEffect, with: &[f64]) -> Option<(Vec<f64>, Vec<f64>)> {
        let mut off = with.to_vec();
        candidate.own.iter().for_each(|(index, value)| off[*index] = *value);
        let with = with.to_vec();
        let runs: Option<Vec<Vec<f64>>> =
            filtered(&candidate.problem, self.whitening, &[off, with], self.halt).into_iter().collect();
        let [off, on] = runs?.try_into().ok()?;
        let change = DVector::from_vec(off) - DVector::from_vec(on);
        let left = &change - &self.own * self.own.tr_mul(&change);
        Some((left.iter().copied().collect(), self.residual.iter().copied().collect()))
    }

    /// How much of the residual these sensitivities of a candidate explain beyond the model's own.
    fn explained(&self, candidate: &CandidateEffect, raw: &DMatrix<f64>) -> Result<Score, Blind> {
        let left = raw - &self.own * self.own.tr_mul(raw);
        let (rows, k) = left.shape();
        let n = rows as f64;
        if left.norm_squared() <= SAME * raw.norm_squared() {
            return Err(Blind::Imitated);
        }
        if left.norm_squared() <= IMITATED * raw.norm_squared() {
            // A step along what is left would leave physics: the refit starts from the nominal values.
            let step =
                candidate.own.iter().map(|(index, off)| candidate.problem.nominal()[*index] - off).collect();
            return Ok(Score {
                statistic: 0.0,
                net: -(k as f64) * n.ln(),
                step,
                sign: true,
                direction: vec![0.0; rows],
                imitated: true,
            });
        }
        let mut normal = left.tr_mul(&left);
        let ridge = 1e-9 * normal.trace();
        (0..k).for_each(|i| normal[(i, i)] += ridge);
        let right = left.tr_mul(&self.residual);
        let step = normal.cholesky().ok_or(Blind::Imitated)?.solve(&right);
        let total = self.residual.norm_squared().max(f64::MIN_POSITIVE);
        let explained = (right.dot(&step) / total).clamp(0.0, 1.0 - 1e-12);
        let statistic = -n * (-explained).ln_1p();
        let sign = step.iter().any(|value| sign_allows(candidate.spec.sign, *value));
        let first = left.column(0);
        let length = first.norm().max(f64::MIN_POSITIVE);
        let direction = first.iter().map(|value| value / length).collect();
        Ok(Score {
            statistic,
            net: statistic - k as f64 * n.ln(),
            step: step.iter().copied().collect(),
            sign,
            direction,
            imitated: false,
        })
    }
}

/// The step of a difference in the parameter's own unit.
pub(super) fn difference(candidate: &CandidateEffect, index: usize) -> f64 {
    let [lower, upper] = candidate.problem.bounds()[index];
    match candidate.problem.model().parameters()[index].scale {
        Scale::Linear => STEP * (upper - lower),
        Scale::Log => 10.0 * STEP * candidate.problem.nominal()[index],
    }
}

/// Correlation of two directions of length one.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
