//! The benchmark functions of thesis chapter 5 on their boxes, as costs to minimise over the unit cube.
//!
//! The optimum of each is 0, up to the rounding of Schwefel's constant. The thesis negates them to maximise.

use std::f64::consts::{E, TAU};

/// A benchmark function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Function {
    /// Eq 4.12 on \[-500, 500\]: many local optima, the best one far from the centre.
    Schwefel,
    /// Eq 5.3 on \[-50, 50\]: one long, narrow, curved valley.
    Rosenbrock,
    /// Eq 5.4 on \[-32.768, 32.768\]: a funnel under a lattice of local optima.
    Ackley,
}

impl Function {
    /// Half the width of the box, which is centred at 0.
    pub fn half_width(self) -> f64 {
        match self {
            Function::Schwefel => 500.0,
            Function::Rosenbrock => 50.0,
            Function::Ackley => 32.768,
        }
    }

    /// The cost at a point of the unit cube.
    pub fn cost(self, unit: &[f64]) -> f64 {
        let x: Vec<f64> = unit.iter().map(|unit| (2.0 * unit - 1.0) * self.half_width()).collect();
        let d = x.len() as f64;
        match self {
            Function::Schwefel => {
                418.982_887_272_433_8 * d - x.iter().map(|x| x * x.abs().sqrt().sin()).sum::<f64>()
            }
            Function::Rosenbrock => {
                x.windows(2).map(|x| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (x[0] - 1.0).powi(2)).sum()
            }
            Function::Ackley => {
                let square = x.iter().map(|x| x * x).sum::<f64>() / d;
                let wave = x.iter().map(|x| (TAU * x).cos()).sum::<f64>() / d;
                20.0 - 20.0 * (-0.2 * square.sqrt()).exp() + E - wave.exp()
            }
        }
    }
}

/// Rosenbrock's function as residuals: their mean square is its cost divided by their number.
pub fn rosenbrock_residuals(unit: &[f64]) -> Vec<f64> {
    let half = Function::Rosenbrock.half_width();
    let x: Vec<f64> = unit.iter().map(|unit| (2.0 * unit - 1.0) * half).collect();
    x.windows(2).flat_map(|x| [10.0 * (x[1] - x[0] * x[0]), x[0] - 1.0]).collect()
}

/// What a whole run came to.
#[cfg(test)]
#[derive(Debug, PartialEq)]
pub struct DrivenRun {
    /// The best cost.
    pub best: super::Cost,
    /// Where it is.
    pub at: Vec<f64>,
    /// Evaluations asked for.
    pub evaluations: usize,
    /// Batches asked for.
    pub batches: usize,
    /// Why it ended.
    pub ended: super::Termination,
}

/// Answers every question of an optimiser from a cost function.
#[cfg(test)]
pub fn drive(optimiser: &mut dyn super::Optimiser, cost: impl Fn(&[f64]) -> f64) -> DrivenRun {
    drive_with(optimiser, |x| (cost(x), Vec::new()))
}

/// Answers every question of an optimiser from a residual function; the cost is the mean square.
#[cfg(test)]
pub fn drive_residuals(
    optimiser: &mut dyn super::Optimiser,
    residuals: impl Fn(&[f64]) -> Vec<f64>,
) -> DrivenRun {
    drive_with(optimiser, |x| {
        let residuals = residuals(x);
        (residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64, residuals)
    })
}

#[cfg(test)]
fn drive_with(
    optimiser: &mut dyn super::Optimiser,
    evaluate: impl Fn(&[f64]) -> (f64, Vec<f64>),
) -> DrivenRun {
    use super::{Ask, Cost, Evaluation};
    let (mut evaluations, mut batches) = (0, 0);
    loop {
        let (batch, wanted) = match optimiser.ask() {
            Ask::Costs(batch) => (batch, false),
            Ask::Residuals(batch) => (batch, true),
            Ask::Slopes(_) => panic!("these functions have no likelihood"),
            Ask::Done(ended) => {
                let (at, best) =
                    optimiser.best().map_or((Vec::new(), Cost::Diverged), |(at, best)| (at.0.clone(), best));
                return DrivenRun { best, at, evaluations, batches, ended };
            }
        };
        assert!(!batch.is_empty(), "an empty batch asks nothing");
        assert!(batch.iter().all(|candidate| candidate.0.iter().all(|x| (0.0..=1.0).contains(x))));
        evaluations += batch.len();
        batches += 1;
        let answers: Vec<Evaluation> = batch
            .iter()
            .map(|candidate| {
                let (cost, residuals) = evaluate(&candidate.0);
                Evaluation {
                    cost: Cost::new(cost),
                    residuals: if wanted { residuals } else { Vec::new() },
                    slope: None,
                }
            })
            .collect();
        optimiser.tell(&answers);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_optima_are_where_the_thesis_says() {
        let unit = |function: Function, x: f64| (x / function.half_width() + 1.0) / 2.0;
        assert!(Function::Schwefel.cost(&[unit(Function::Schwefel, 420.968_746); 5]).abs() < 1e-6);
        assert!(Function::Rosenbrock.cost(&[unit(Function::Rosenbrock, 1.0); 5]).abs() < 1e-20);
        assert!(Function::Ackley.cost(&[0.5; 5]).abs() < 1e-14);
    }

    #[test]
    fn the_residual_form_is_the_same_function() {
        let unit = [0.51, 0.49, 0.6];
        let sum: f64 = rosenbrock_residuals(&unit).iter().map(|r| r * r).sum();
        assert!((sum - Function::Rosenbrock.cost(&unit)).abs() < 1e-9 * sum);
    }
}
