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

/// Where each start ends and its cost there, and the evaluations of all.
pub type Ends = (Vec<(Vec<f64>, f64)>, usize);

impl Refit<'_> {
    /// Levenberg and Marquardt's method from full parameter vectors side by side: the best end, with its cost
    /// and the evaluations of all.
    pub fn polish(&self, starts: &[Vec<f64>], iterations: usize) -> (Vec<f64>, f64, usize) {
        let [best] = polish_together([(self, starts)], iterations);
        best
    }

    /// Where each start ends, its cost there, infinite where the model diverges, and the evaluations of all.
    pub fn ends(&self, starts: &[Vec<f64>], iterations: usize) -> Ends {
        let [ends] = ends_together([(self, starts)], iterations);
        ends
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
        self.answers(&simulated(self.problem, &thetas, self.halt), &thetas)
    }

    /// What residuals of some parameter vectors make of the task.
    fn answers(&self, series: &[Option<Vec<Vec<f64>>>], thetas: &[Vec<f64>]) -> Vec<Evaluation> {
        series
            .iter()
            .zip(thetas)
            .map(|(series, theta)| {
                let mut residuals =
                    series.as_ref().map_or_else(Vec::new, |series| self.whitening.apply(series));
                if series.is_some() {
                    residuals.extend(self.pulls(theta));
                }
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

/// The best end of each of several tasks on one problem, as [`Refit::polish`] finds it.
pub fn polish_together<const N: usize>(
    tasks: [(&Refit, &[Vec<f64>]); N],
    iterations: usize,
) -> [(Vec<f64>, f64, usize); N] {
    let nominal = tasks[0].0.problem.nominal();
    ends_together(tasks, iterations).map(|(ends, evaluations)| {
        let best = ends.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let (theta, cost) = best.unwrap_or_else(|| (nominal.to_vec(), f64::INFINITY));
        (theta, cost, evaluations)
    })
}

/// The ends of several tasks on one problem, as [`Refit::ends`] finds them. Their batches are simulated in
/// the same blocks: two half-empty blocks take nearly twice as long as a full one.
fn ends_together<const N: usize>(tasks: [(&Refit, &[Vec<f64>]); N], iterations: usize) -> [Ends; N] {
    let Refit { problem, halt, .. } = *tasks[0].0;
    let options =
        LocalOptions { iterations, tolerance: Effort::of(problem).tolerance, ..LocalOptions::default() };
    let way = LocalWay::Residuals(options.with_least_step(problem.least_step()));
    let places =
        |starts: &[Vec<f64>]| starts.iter().map(|start| problem.candidate(start)).collect::<Vec<_>>();
    let mut searches = tasks.map(|(task, starts)| (task, LocalStage::new(&way, &places(starts)), 0));
    while !halt() {
        let batches = searches.each_ref().map(|(_, stage, _)| match stage.propose() {
            Some(Ask::Residuals(batch)) => batch,
            _ => Vec::new(),
        });
        let thetas: Vec<Vec<f64>> =
            batches.iter().flatten().map(|candidate| problem.theta(candidate)).collect();
        if thetas.is_empty() {
            break;
        }
        let series = simulated(problem, &thetas, halt);
        let mut first = 0;
        for ((task, stage, evaluations), batch) in searches.iter_mut().zip(&batches) {
            let own = first..first + batch.len();
            first = own.end;
            *evaluations += own.len();
            if !own.is_empty() {
                stage.digest(&task.answers(&series[own.clone()], &thetas[own]));
            }
        }
    }
    searches.map(|(_, stage, evaluations)| {
        let ends = stage.places().into_iter();
        (ends.map(|(candidate, cost)| (problem.theta(&candidate), cost.value())).collect(), evaluations)
    })
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
