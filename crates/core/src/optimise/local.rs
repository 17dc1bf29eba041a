//! The local stage: several runs from several starts that advance in lockstep, their batches side by side.

use super::local_options::LocalOptions;

use super::lm::LevenbergMarquardt;
use super::scoring::{Scoring, ScoringOptions};
use super::trust_region::TrustRegion;
use super::{Ask, Candidate, Cost, Evaluation, LocalRun, Origin};

/// What the runs of a local stage can ask for, and how they go about it.
#[derive(Debug, Clone)]
pub enum LocalWay {
    /// Levenberg-Marquardt on residuals.
    Residuals(LocalOptions),
    /// A search without derivatives on costs.
    Costs(LocalOptions),
    /// Fisher scoring on the slopes of a likelihood.
    Slopes(ScoringOptions),
}

impl LocalWay {
    /// Residuals where there are any, else costs.
    pub fn on_residuals(options: &LocalOptions, residuals: bool) -> Self {
        if residuals { LocalWay::Residuals(options.clone()) } else { LocalWay::Costs(options.clone()) }
    }

    /// How close two places have to be to count as one.
    pub fn merge(&self) -> f64 {
        match self {
            LocalWay::Residuals(options) | LocalWay::Costs(options) => options.merge,
            LocalWay::Slopes(options) => options.merge,
        }
    }
}

/// Runs in lockstep, in one of the ways.
#[derive(Debug)]
pub enum LocalStage {
    /// Runs on residuals.
    Residuals(Vec<LevenbergMarquardt>, f64),
    /// Runs on costs.
    Costs(Vec<TrustRegion>),
    /// Runs on slopes.
    Slopes(Vec<Scoring>, f64),
}

impl LocalStage {
    /// One run from each start.
    pub fn new(way: &LocalWay, starts: &[Candidate]) -> Self {
        match way {
            LocalWay::Residuals(options) => {
                let run = |start| LevenbergMarquardt::new(options.clone(), start);
                LocalStage::Residuals(starts.iter().map(run).collect(), options.merge)
            }
            LocalWay::Costs(options) => {
                LocalStage::Costs(starts.iter().map(|start| TrustRegion::new(options, start)).collect())
            }
            LocalWay::Slopes(options) => LocalStage::Slopes(
                starts.iter().map(|start| Scoring::new(options, start)).collect(),
                options.merge,
            ),
        }
    }

    /// The next batch of all runs together; none when every run has ended.
    pub fn propose(&self) -> Option<Ask> {
        let ask = match self {
            LocalStage::Residuals(runs, _) => {
                Ask::Residuals(runs.iter().flat_map(LevenbergMarquardt::propose).collect())
            }
            LocalStage::Costs(runs) => Ask::Costs(runs.iter().filter_map(TrustRegion::propose).collect()),
            LocalStage::Slopes(runs, _) => Ask::Slopes(runs.iter().filter_map(Scoring::propose).collect()),
        };
        match &ask {
            Ask::Residuals(batch) | Ask::Costs(batch) | Ask::Slopes(batch) if !batch.is_empty() => Some(ask),
            _ => None,
        }
    }

    /// Answers it.
    pub fn digest(&mut self, mut answers: &[Evaluation]) {
        match self {
            LocalStage::Residuals(runs, merge) => {
                for run in runs.iter_mut() {
                    let own = answers.split_off(..run.propose().len()).unwrap_or_default();
                    run.digest(own);
                }
                end_twins(runs, *merge);
            }
            LocalStage::Costs(runs) => {
                let open = runs.iter_mut().filter(|run| !run.ended());
                for (run, answer) in open.zip(answers) {
                    run.digest(answer.cost);
                }
            }
            LocalStage::Slopes(runs, merge) => {
                let open = runs.iter_mut().filter(|run| !run.ended());
                open.zip(answers).for_each(|(run, answer)| run.digest(answer));
                end_twins(runs, *merge);
            }
        }
    }

    /// Where the runs are, and what these places cost.
    pub fn places(&self) -> Vec<(Candidate, Cost)> {
        let own = |(position, cost): (&[f64], Cost)| (Candidate(position.to_vec()), cost);
        match self {
            LocalStage::Residuals(runs, _) => runs.iter().map(|run| own(run.place())).collect(),
            LocalStage::Costs(runs) => runs.iter().map(|run| own(run.place())).collect(),
            LocalStage::Slopes(runs, _) => runs.iter().map(|run| own(run.place())).collect(),
        }
    }

    /// The runs, which came from these places; only those on slopes keep count.
    pub fn runs(&self, origins: &[Origin]) -> Vec<LocalRun> {
        match self {
            LocalStage::Slopes(runs, _) => {
                runs.iter().zip(origins).map(|(run, origin)| run.run(*origin)).collect()
            }
            LocalStage::Residuals(..) | LocalStage::Costs(_) => Vec::new(),
        }
    }

    /// The best place of all runs, with its cost.
    pub fn optimum(&self) -> Option<(Candidate, Cost)> {
        self.places().into_iter().min_by_key(|(_, cost)| *cost)
    }
}

/// A run among others.
trait Run {
    fn place(&self) -> (&[f64], Cost);
    fn ended(&self) -> bool;
    fn end(&mut self);
}

impl Run for LevenbergMarquardt {
    fn place(&self) -> (&[f64], Cost) {
        self.place()
    }

    fn ended(&self) -> bool {
        self.ended()
    }

    fn end(&mut self) {
        self.end();
    }
}

impl Run for Scoring {
    fn place(&self) -> (&[f64], Cost) {
        self.place()
    }

    fn ended(&self) -> bool {
        self.ended()
    }

    fn end(&mut self) {
        self.end();
    }
}

/// Ends the worse of any two runs that have come to the same place: the rest of its way would be a
/// repetition.
fn end_twins(runs: &mut [impl Run], merge: f64) {
    for i in 0..runs.len() {
        for j in 0..runs.len() {
            let (a, b) = (runs[i].place(), runs[j].place());
            let near = a.0.iter().zip(b.0).all(|(a, b)| (a - b).abs() < merge);
            // Of equals the first goes on; before its first answer a run has no cost to compare.
            let loses = (a.1, i) > (b.1, j) && a.1 != Cost::Diverged;
            if i != j && near && loses && !runs[i].ended() {
                runs[i].end();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::rosenbrock_residuals;

    #[test]
    fn runs_advance_side_by_side_and_twins_end() {
        let starts = [vec![0.45, 0.55], vec![0.55, 0.45], vec![0.45, 0.55 + 1e-5]].map(Candidate);
        let mut stage = LocalStage::new(&LocalWay::Residuals(LocalOptions::default()), &starts);
        let mut sizes = Vec::new();
        while let Some(Ask::Residuals(batch)) = stage.propose() {
            sizes.push(batch.len());
            let answers: Vec<Evaluation> = batch
                .iter()
                .map(|candidate| {
                    let residuals = rosenbrock_residuals(&candidate.0);
                    let cost =
                        Cost::new(residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64);
                    Evaluation { cost, residuals, slope: None }
                })
                .collect();
            stage.digest(&answers);
        }
        // Three starts with two slopes each, then two runs only.
        assert_eq!(sizes[..2], [9, 8]);
        assert!(stage.optimum().unwrap().1.value() < 1e-15, "{:?}", stage.optimum());
    }
}
