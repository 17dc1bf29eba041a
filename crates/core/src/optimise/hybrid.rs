//! The default search: a small swarm finds basins, a local stage goes to their bottoms, and restarts confirm
//! them.
//!
//! It is the Clustered Firefly Algorithm (thesis section 4.3) with a synchronous update and schedules that
//! run on evaluations, followed by Levenberg-Marquardt from the best places of distinct clusters. The
//! published algorithm keeps its randomness for convergence as well and spends most of its evaluations on
//! that; a handful of least-squares steps does it better. Where there are no residuals the moves are greedy,
//! change few coordinates and sometimes leap, and BOBYQA descends.
//!
//! Moves of few coordinates are lost in a valley that runs across the axes. Where there are only costs,
//! swarms therefore take turns with clouds that learn the axes (`clouds`) and have two thirds of the
//! evaluations, so that a search takes about half as long again as clouds alone at worst.

use super::cfa_options::CfaOptions;
use rand_xoshiro::Xoshiro256PlusPlus;

use super::agreement::Agreement;
use super::budget::Strategy;
use super::clouds::Clouds;
use super::firefly::{random_point, stream};
use super::local::{LocalStage, LocalWay};
use super::search::Search;
use super::swarm::Swarm;
use super::{Ask, Candidate, Cost, Evaluation, LocalRun, Origin, Termination};

/// Evaluations of the clouds for each one of the swarms.
const CLOUDS: usize = 2;

/// What the search is doing.
#[derive(Debug)]
enum Stage {
    Swarm(Box<Swarm>),
    Local(LocalStage),
    Cloud,
    Termination(Termination),
}

/// The hybrid between two batches.
#[derive(Debug)]
pub struct Cfa {
    options: CfaOptions,
    dimensions: usize,
    seed: u64,
    way: LocalWay,
    /// The stream of the scouts; swarms and fireflies own others.
    stream: Xoshiro256PlusPlus,
    stage: Stage,
    /// The polished warm starts, while the first swarm knows them.
    warm: Vec<Candidate>,
    /// Swarms begun, each with its own random streams.
    swarms: usize,
    /// What takes turns with the swarms where there are only costs.
    clouds: Clouds,
    /// Evaluations of the swarms with their local runs, and of the clouds.
    spent: [usize; 2],
    agreement: Agreement,
    /// Where the runs of the present local stage came from, and the runs of those before it.
    origins: Vec<Origin>,
    runs: Vec<LocalRun>,
    /// Generations of the swarms and batches of the local stages completed.
    generation: usize,
}

impl Cfa {
    /// A search that polishes the warm starts first, if there are any: a recalibration whose parameters still
    /// hold has its optimum at once, and a swarm whose own local runs end at the same cost confirms it.
    pub fn new(options: CfaOptions, search: &Search) -> Self {
        let way = LocalWay::on_residuals(&options.local, search.residuals);
        Self::with(options, way, search)
    }

    /// The same search with another local stage.
    pub fn with(options: CfaOptions, way: LocalWay, search: &Search) -> Self {
        let warm = search.warm_starts();
        let mut cfa = Self {
            dimensions: search.dimensions,
            seed: search.seed,
            stream: stream(search.seed, u64::MAX),
            stage: Stage::Local(LocalStage::new(&way, &warm)),
            way,
            warm: Vec::new(),
            swarms: 0,
            clouds: Clouds::new(search.dimensions, options.on_costs.cloud, search.seed),
            spent: [0, 0],
            origins: vec![Origin::Warm; warm.len()],
            runs: Vec::new(),
            agreement: Agreement::new(options.agreement),
            generation: 0,
            options,
        };
        if warm.is_empty() {
            cfa.stage = cfa.set_out();
        }
        cfa
    }

    /// What comes after a restart. The first swarm knows the polished warm starts and confirms them.
    fn set_out(&mut self) -> Stage {
        let clouds = matches!(self.way, LocalWay::Costs(_))
            && self.options.on_costs.cloud > 0.0
            && self.dimensions > 0;
        if clouds && self.warm.is_empty() && self.spent[1] <= CLOUDS * self.spent[0] {
            self.next_cloud()
        } else {
            self.next_swarm()
        }
    }

    fn next_cloud(&mut self) -> Stage {
        if self.spent[1] > 0 {
            self.clouds.restart();
        }
        Stage::Cloud
    }

    fn next_swarm(&mut self) -> Stage {
        // Only where there is nothing but costs has the swarm to find the basin by itself.
        let guided = !matches!(self.way, LocalWay::Costs(_));
        let on_costs = self.options.on_costs.swarm.saturating_mul(self.dimensions.max(1));
        let first_swarm = if guided { self.options.swarm } else { on_costs };
        let grown = first_swarm as f64 * self.options.growth.max(1.0).powi(self.swarms as i32);
        // The cast saturates, and more than any budget is as good as infinite.
        let budget = grown as usize;
        let first_id = self.swarms as u64 * Swarm::ids(&self.options);
        self.swarms += 1;
        Stage::Swarm(Box::new(Swarm::new(
            &self.options,
            guided,
            budget,
            self.seed,
            first_id,
            self.dimensions,
            &self.warm,
        )))
    }

    /// The local stage from a swarm's bests and from the scouts' places. A polished warm start is left out:
    /// its run would end where it began, and the restart would confirm nothing but itself.
    fn descend(&mut self, bests: &[Candidate]) -> Stage {
        let merge = self.way.merge();
        let near = |a: &Candidate, b: &Candidate| a.0.iter().zip(&b.0).all(|(a, b)| (a - b).abs() < merge);
        let mut starts: Vec<Candidate> = bests
            .iter()
            .filter(|best| !self.warm.iter().any(|warm| near(best, warm)))
            .take(self.options.starts)
            .cloned()
            .collect();
        self.origins = vec![Origin::Cluster; starts.len()];
        self.origins.extend(vec![Origin::Random; self.options.scouts]);
        starts.extend(
            (0..self.options.scouts).map(|_| Candidate(random_point(self.dimensions, &mut self.stream))),
        );
        self.warm.clear();
        Stage::Local(LocalStage::new(&self.way, &starts))
    }

    /// A cloud is over. One that ends above what is known says nothing of it: a large cloud is easily drawn
    /// to the wrong basin, and would part two swarms that agree.
    fn gather(&mut self, found: (Candidate, Cost)) -> Stage {
        if self.agreement.rivals(&found) { self.restart(vec![found]) } else { self.set_out() }
    }

    /// A restart is complete: either it settles the search, or another swarm sets out. The first swarm knows
    /// the polished warm starts, later ones begin without prejudice.
    fn restart(&mut self, places: Vec<(Candidate, Cost)>) -> Stage {
        let optimum = places.iter().min_by_key(|(_, cost)| *cost).cloned();
        if let Some(ended) = self.agreement.restart(optimum) {
            return Stage::Termination(ended);
        }
        if self.swarms + self.spent[1] == 0 {
            self.warm = places.into_iter().map(|(place, _)| place).collect();
        }
        self.set_out()
    }
}

impl Strategy for Cfa {
    fn propose(&mut self) -> Ask {
        loop {
            self.stage = match &mut self.stage {
                Stage::Swarm(swarm) => match swarm.propose() {
                    Some(batch) => return Ask::Costs(batch),
                    None => {
                        let bests =
                            swarm.starts(self.options.local_from, self.options.starts + self.warm.len());
                        self.descend(&bests)
                    }
                },
                Stage::Local(local) => match local.propose() {
                    Some(ask) => return ask,
                    None => {
                        let places = local.places();
                        self.runs.extend(local.runs(&self.origins));
                        self.origins.clear();
                        self.restart(places)
                    }
                },
                Stage::Cloud => match self.clouds.propose() {
                    Some(batch) => return Ask::Costs(batch),
                    None => self.gather(self.clouds.place()),
                },
                Stage::Termination(ended) => return Ask::Done(*ended),
            };
        }
    }

    fn digest(&mut self, candidates: &[Candidate], answers: &[Evaluation]) {
        self.spent[usize::from(matches!(self.stage, Stage::Cloud))] += answers.len();
        match &mut self.stage {
            Stage::Swarm(swarm) => {
                let before = swarm.generation();
                swarm.digest(answers);
                self.generation += swarm.generation() - before;
            }
            Stage::Local(local) => {
                local.digest(answers);
                self.generation += 1;
            }
            Stage::Cloud => {
                let costs: Vec<Cost> = answers.iter().map(|answer| answer.cost).collect();
                self.clouds.digest(candidates, &costs);
                self.generation += 1;
            }
            Stage::Termination(_) => {}
        }
    }

    fn generation(&self) -> usize {
        self.generation
    }

    fn runs(&self) -> Vec<LocalRun> {
        let mut runs = self.runs.clone();
        if let Stage::Local(local) = &self.stage {
            runs.extend(local.runs(&self.origins));
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::{DrivenRun, Function, drive, drive_residuals, rosenbrock_residuals};
    use crate::optimise::method::Method;

    fn search(dimensions: usize, seed: u64, budget: usize, residuals: bool) -> Search {
        Search { dimensions, seed, budget, warm: Vec::new(), residuals }
    }

    fn on_costs(function: Function, search: Search) -> DrivenRun {
        drive(Method::default().optimiser(search).as_mut(), |x| function.cost(x))
    }

    fn on_residuals(search: Search) -> DrivenRun {
        drive_residuals(Method::default().optimiser(search).as_mut(), rosenbrock_residuals)
    }

    #[test]
    fn the_functions_of_chapter_5_are_solved_from_costs_alone_and_confirmed() {
        let cases = [
            (Function::Schwefel, 5, 20_000, 1e-2),
            (Function::Schwefel, 10, 40_000, 1e-2),
            (Function::Rosenbrock, 5, 40_000, 1e-8),
            (Function::Rosenbrock, 15, 70_000, 1e-8),
            (Function::Ackley, 5, 40_000, 1e-6),
            (Function::Ackley, 15, 40_000, 1e-6),
        ];
        for (function, dimensions, budget, within) in cases {
            for seed in 0..10 {
                let run = on_costs(function, search(dimensions, seed, budget, false));
                assert!(
                    run.best.value() < within && run.ended == Termination::Converged,
                    "{function:?} {dimensions}, {seed}: {run:?}"
                );
            }
        }
    }

    #[test]
    fn rosenbrock_15_is_solved_from_residuals_and_confirmed() {
        for seed in 0..10 {
            let run = on_residuals(search(15, seed, 100_000, true));
            assert!(run.best.value() < 1e-12 && run.ended == Termination::Converged, "{seed}: {run:?}");
        }
    }

    #[test]
    fn a_seed_fixes_every_bit() {
        let first = on_residuals(search(6, 21, 20_000, true));
        assert_eq!(first, on_residuals(search(6, 21, 20_000, true)));
        assert_eq!((first.evaluations, first.batches), GOLDEN_RESIDUALS);
        let first = on_costs(Function::Ackley, search(3, 21, 3_000, false));
        assert_eq!(first, on_costs(Function::Ackley, search(3, 21, 3_000, false)));
        assert_ne!(first.at, on_costs(Function::Ackley, search(3, 22, 3_000, false)).at);
    }

    /// Evaluations and batches until the restarts agree.
    const GOLDEN_RESIDUALS: (usize, usize) = (2235, 260);

    #[test]
    fn the_budget_is_never_exceeded() {
        for budget in [0, 1, 39, 40, 41, 999, 1100, 1500] {
            for residuals in [true, false] {
                let run = drive_residuals(
                    Method::default().optimiser(search(15, 3, budget, residuals)).as_mut(),
                    rosenbrock_residuals,
                );
                assert_eq!((run.evaluations, run.ended), (budget, Termination::Budget));
            }
        }
    }

    #[test]
    fn a_warm_start_at_the_optimum_is_confirmed_by_one_swarm() {
        let optimum = Candidate(vec![0.51; 8]);
        let warm = Search { warm: vec![optimum], ..search(8, 5, 100_000, true) };
        let run = on_residuals(warm);
        assert_eq!(run.ended, Termination::Converged);
        assert!(run.best.value() < 1e-18, "{run:?}");
        let cold = on_residuals(search(8, 5, 100_000, true));
        assert!(run.evaluations < cold.evaluations, "{} {}", run.evaluations, cold.evaluations);
    }

    #[test]
    fn when_everything_diverges_the_search_stalls_without_a_panic() {
        for residuals in [true, false] {
            let mut optimiser = Method::default().optimiser(search(4, 1, 1_000_000, residuals));
            let run = drive(optimiser.as_mut(), |_| f64::NAN);
            assert_eq!((run.best, run.ended), (Cost::Diverged, Termination::Stalled));
        }
        // Half of the cube cannot be computed.
        let mut optimiser = Method::default().optimiser(search(4, 1, 50_000, true));
        let run = drive_residuals(optimiser.as_mut(), |x| {
            if x[0] > 0.5 { vec![f64::NAN; 4] } else { x.iter().map(|x| x - 0.4).collect() }
        });
        assert!(run.best.value() < 1e-16 && run.ended == Termination::Converged, "{run:?}");
    }

    #[test]
    fn nothing_to_search_is_answered_with_one_evaluation_per_firefly() {
        let run = drive(Method::default().optimiser(search(0, 1, 100, false)).as_mut(), |_| 2.0);
        assert_eq!(run.best, Cost::Finite(2.0));
    }
}
