//! Least squares from a known point, on the plain residual or on its innovations.

use super::effort::Effort;
use super::residual::{Whitening, residuals};
use crate::estimate::Problem;
use crate::estimate::problem::mean_square;
use crate::estimate::problem::prior::KnownParameter;
use crate::model::Scale;
use crate::optimise::local::{LocalStage, LocalWay};
use crate::optimise::local_options::LocalOptions;
use crate::optimise::{Ask, Candidate, Cost, Evaluation};
use crate::simulate::trajectory::Halt;
use nalgebra::DMatrix;

/// Deviation of the weak prior in the logarithm of rates: it only holds what the data leave open.
const PRIOR_DEVIATION: f64 = 2.0;

/// A least-squares task on the training part.
pub struct Refit<'a> {
    /// Model and data.
    pub problem: &'a Problem,
    /// What is squared.
    pub whitening: &'a Whitening,
    /// Deviation of what is squared, the weight of the prior.
    pub deviation: f64,
    /// Whether the work is to end: what it then gives means nothing.
    pub halt: Halt<'a>,
}

impl Refit<'_> {
    /// Levenberg and Marquardt's method from full parameter vectors side by side: the best end, with its cost
    /// and the evaluations of all.
    pub fn polish(&self, starts: &[Vec<f64>], iterations: usize) -> (Vec<f64>, f64, usize) {
        let (ends, evaluations) = self.ends(starts, iterations);
        let best = ends.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let (theta, cost) = best.unwrap_or_else(|| (self.problem.nominal().to_vec(), f64::INFINITY));
        (theta, cost, evaluations)
    }

    /// Where each start ends, its cost there, infinite where the model diverges, and the evaluations of all.
    pub fn ends(&self, starts: &[Vec<f64>], iterations: usize) -> (Vec<(Vec<f64>, f64)>, usize) {
        let usual = LocalOptions {
            iterations,
            tolerance: Effort::of(self.problem).tolerance,
            ..LocalOptions::default()
        };
        let options = LocalOptions { step: self.problem.least_step().max(usual.step), ..usual };
        let places: Vec<Candidate> = starts.iter().map(|start| self.problem.candidate(start)).collect();
        let mut stage = LocalStage::new(&LocalWay::Residuals(options), &places);
        let mut evaluations = 0;
        while let (false, Some(Ask::Residuals(batch))) = ((self.halt)(), stage.propose()) {
            evaluations += batch.len();
            let answers = self.evaluate(&batch);
            stage.digest(&answers);
        }
        let ends = stage
            .places()
            .into_iter()
            .map(|(candidate, cost)| (self.problem.theta(&candidate), cost.value()));
        (ends.collect(), evaluations)
    }

    /// The cost at a full parameter vector.
    pub fn cost(&self, theta: &[f64]) -> f64 {
        self.evaluate(&[self.problem.candidate(theta)])
            .first()
            .map_or(f64::INFINITY, |answer| answer.cost.value())
    }

    /// Which start costs least; of one it is known.
    pub fn cheapest(&self, starts: &[Vec<f64>]) -> usize {
        if starts.len() < 2 {
            return 0;
        }
        let places: Vec<Candidate> = starts.iter().map(|start| self.problem.candidate(start)).collect();
        let costs: Vec<f64> = self.evaluate(&places).iter().map(|answer| answer.cost.value()).collect();
        (0..costs.len()).min_by(|one, other| costs[*one].total_cmp(&costs[*other])).unwrap_or(0)
    }

    fn evaluate(&self, candidates: &[Candidate]) -> Vec<Evaluation> {
        let thetas: Vec<Vec<f64>> =
            candidates.iter().map(|candidate| self.problem.theta(candidate)).collect();
        let series = filtered(self.problem, self.whitening, &thetas, self.halt);
        series
            .into_iter()
            .zip(&thetas)
            .map(|(series, theta)| {
                let residuals: Vec<f64> = series
                    .map_or_else(Vec::new, |series| series.into_iter().chain(self.pulls(theta)).collect());
                let cost =
                    if residuals.is_empty() { Cost::Diverged } else { Cost::new(mean_square(&residuals)) };
                Evaluation {
                    cost,
                    residuals: if cost == Cost::Diverged { Vec::new() } else { residuals },
                    slope: None,
                }
            })
            .collect()
    }

    /// The pulls of the prior: a deviation of the residual for every deviation of a logarithm.
    fn pulls(&self, theta: &[f64]) -> impl Iterator<Item = f64> {
        let (model, nominal) = (self.problem.model(), self.problem.nominal());
        let pull = move |index: &usize| {
            let known = KnownParameter { value: nominal[*index], deviation: PRIOR_DEVIATION };
            let parameter = &model.parameters()[*index];
            let is_drawn = parameter.scale == Scale::Log && known.value > 0.0;
            is_drawn.then(|| known.pull(parameter, theta[*index])).flatten()
        };
        self.problem.free().iter().filter_map(pull).map(|pull| self.deviation * pull)
    }

    /// The derivatives of the filtered simulation with respect to the free coordinates of the unit cube, one
    /// column each; `None` where a simulation diverges.
    pub fn slopes(&self, theta: &[f64]) -> Option<DMatrix<f64>> {
        let centre = self.problem.candidate(theta);
        let mut thetas = vec![self.problem.theta(&centre)];
        let difference = self.problem.difference();
        let mut steps = Vec::new();
        for along in 0..centre.0.len() {
            let mut moved = centre.clone();
            let step = if moved.0[along] + difference > 1.0 { -difference } else { difference };
            moved.0[along] += step;
            steps.push(step);
            thetas.push(self.problem.theta(&moved));
        }
        let series: Option<Vec<Vec<f64>>> =
            filtered(self.problem, self.whitening, &thetas, self.halt).into_iter().collect();
        let (here, moved) = series.as_ref().and_then(|series| series.split_first())?;
        // The residual falls where the simulation rises.
        Some(DMatrix::from_fn(here.len(), steps.len(), |row, column| {
            (here[row] - moved[column][row]) / steps[column]
        }))
    }
}

/// The residuals of some parameter vectors up to the end of the training part, by output; `None` for one that
/// diverges, or is cut short.
pub fn simulated(problem: &Problem, thetas: &[Vec<f64>], halt: Halt) -> Vec<Option<Vec<Vec<f64>>>> {
    let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
    let runs = problem.simulator().run_unless(&slices, problem.split().train.end, halt);
    runs.iter().map(|run| (!run.diverged).then(|| residuals(problem, run))).collect()
}

/// The same, filtered.
pub fn filtered(
    problem: &Problem,
    whitening: &Whitening,
    thetas: &[Vec<f64>],
    halt: Halt,
) -> Vec<Option<Vec<f64>>> {
    simulated(problem, thetas, halt)
        .into_iter()
        .map(|series| series.map(|series| whitening.apply(&series)))
        .collect()
}
