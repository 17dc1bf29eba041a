//! A plant with its record, what is estimated from it, and how near that comes to the truth.

use super::super::row::Row;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Problem, Site, estimate, prepare};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::{Catalogue, Nominal};
use lampyris_core::optimise::Candidate;
use lampyris_core::simulate::{Simulator, Stepper};
use lampyris_core::twin::plant::{PlantRequest, plant, with_warm_up};
use std::time::Instant;

/// Days of a record, and how many of them are fitted (thesis 6.2.3 and 6.3).
const DAYS: usize = 14;
const TRAIN: &str = "P3D";
/// Minutes between rows of a record.
const ROW: usize = 5;
/// Candidates whose simulation is measured: one block.
const CANDIDATES: usize = 32;
/// Candidates of them that are also simulated by the oracle.
const CHECKED: usize = 4;
/// Internal steps per five minutes of the oracle: five seconds, within the stable region of the stiffest
/// candidates.
const ORACLE_STEPS: usize = 60;
/// How far from the truth, as a share of it, a parameter may be that is on no ridge.
const NEAR: f64 = 0.02;
/// Mean square error of thesis eq. 6.6 over the unseen days.
const UNSEEN: f64 = 1e-5;
/// Largest error of an effluent, as a share of its range.
pub const OF_RANGE: f64 = 5e-3;

/// What a record is made of.
pub struct Record<'a> {
    /// The plant that is fitted.
    pub id: &'static str,
    /// What its truth has beside, such as `+aeration_limit`.
    pub beside: &'a str,
    pub seed: u64,
    /// Noise of the sensors, in the deviations of the plant's document.
    pub noise: f64,
    /// Whether a sample of the effluent is kept, by its minute.
    pub keep: &'a dyn Fn(usize) -> bool,
}

/// A plant with its record.
pub struct Case {
    pub id: &'static str,
    pub seed: u64,
    pub catalogue: Catalogue,
    pub window: Window,
    pub truth: Vec<(String, f64)>,
}

impl Case {
    pub fn new(id: &'static str, seed: u64, noise: f64) -> Result<Self, Failure> {
        let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
        Self::of(&catalogue, &Record { id, beside: "", seed, noise, keep: &|_| true })
    }

    pub fn of(catalogue: &Catalogue, record: &Record) -> Result<Self, Failure> {
        let Record { id, seed, noise, .. } = *record;
        let mut catalogue = with_warm_up(catalogue, id);
        let model = format!("{id}{}", record.beside);
        let request = PlantRequest { seed, model: &model, values: &[], days: DAYS, noise, warm_up: true };
        let twin = plant(&catalogue, &request).map_err(|found| faults(&found))?;
        let csv = kept(&twin.csv, record.keep);
        let (window, _) = Window::parse_csv(&csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
        // The document's own values are the truth: the search starts from the middle of its box instead.
        if let Some(ModelDocument::Spec(mut spec)) = catalogue.model(id).cloned() {
            spec.parameters
                .values_mut()
                .for_each(|one| one.nominal = Nominal::Value(0.5 * (one.lower + one.upper)));
            catalogue.add_model(ModelDocument::Spec(spec));
        }
        Ok(Self { id, seed, catalogue, window, truth: twin.truth })
    }

    pub fn problem(&self) -> Result<(Problem, EstimateRequest), Failure> {
        let text = |found: &dyn std::fmt::Display| Failure::Error(found.to_string());
        let request: EstimateRequest = serde_json::from_value(serde_json::json!({
            "method": {"name": "cfa", "seed": self.seed}, "objective": "nmse",
            "split": {"train": TRAIN, "validation": format!("P{}D", DAYS - 3), "test": "P0D"},
        }))
        .map_err(|error| text(&error))?;
        let id = self.id.parse().map_err(|error| text(&error))?;
        let problem = prepare(&self.catalogue, &id, &request, &self.window, &Site::default())
            .map_err(|found| faults(&found))?;
        Ok((problem, request))
    }

    /// What one evaluation takes, a warm-up and three days, in lanes on one core, beside the oracle.
    pub fn speed(&self) -> Result<Vec<Row>, Failure> {
        let (problem, _) = self.problem()?;
        let dimensions = problem.space().len();
        // A sequence of low discrepancy (Kronecker's, with the square roots of primes) fills the box.
        let roots = [2.0f64, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0].map(f64::sqrt);
        let place = |n: usize| {
            Candidate((0..dimensions).map(|d| (n as f64 * roots[d % roots.len()]).fract()).collect())
        };
        let thetas: Vec<Vec<f64>> = (1..=CANDIDATES).map(|n| problem.theta(&place(n))).collect();
        let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let until = problem.split().train.end;
        let alone = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|error| Failure::Error(error.to_string()))?;
        let begun = Instant::now();
        let ours = alone.install(|| problem.simulator().run(&slices, until));
        let seconds = begun.elapsed().as_secs_f64() / CANDIDATES as f64;
        let oracle = Simulator::new(
            problem.model(),
            problem.inputs(),
            &problem.measured(),
            Stepper::Rk4,
            ORACLE_STEPS,
        );
        let begun = Instant::now();
        let fine: Vec<_> = slices[..CHECKED]
            .iter()
            .flat_map(|theta| alone.install(|| oracle.run(&[theta], until)))
            .collect();
        let oracle_seconds = begun.elapsed().as_secs_f64() / CHECKED as f64;
        let mut worst = 0.0f64;
        for (ours, fine) in ours.iter().zip(&fine).filter(|(ours, fine)| !ours.diverged && !fine.diverged) {
            for (ours, fine) in ours.outputs.iter().zip(&fine.outputs) {
                let error = ours.iter().zip(fine).map(|(ours, fine)| (ours - fine).abs()).fold(0.0, f64::max);
                worst = worst.max(error / range(fine.iter().copied()));
            }
        }
        let title = format!("plant {}: one evaluation, 10,000 min and 3 days, in lanes on one core", self.id);
        Ok(vec![
            Row::new(title, 1e3 * seconds, "ms"),
            Row::new("  steps of 5 s by RK4, one candidate at a time", 1e3 * oracle_seconds, "ms"),
            Row::new("  the one over the other", seconds / oracle_seconds, "x").at_most(0.5),
            Row::new(format!("  largest error of {CHECKED} candidates, of the range"), worst, "-")
                .at_most(OF_RANGE),
            Row::new(
                format!("  diverged of {CANDIDATES}"),
                ours.iter().filter(|run| run.diverged).count() as f64,
                "",
            ),
        ])
    }

    pub fn fit(self) -> Result<Fitted, Failure> {
        let (problem, request) = self.problem()?;
        let begun = Instant::now();
        let fit = estimate(&problem, &request, None, &Control::NONE)
            .map_err(|error| Failure::Error(error.to_string()))?;
        Ok(Fitted { seconds: begun.elapsed().as_secs_f64(), case: self, problem, fit })
    }
}

/// A plant whose parameters were estimated.
pub struct Fitted {
    pub case: Case,
    pub problem: Problem,
    pub fit: Fit,
    pub seconds: f64,
}

impl Fitted {
    /// The true values in the model's order.
    pub fn truth(&self) -> Vec<f64> {
        self.case.truth.iter().map(|(_, truth)| *truth).collect()
    }

    /// Whether a parameter can hardly be told apart from another one.
    pub fn on_a_ridge(&self, name: &str) -> bool {
        self.fit.correlated.iter().any(|pair| pair.parameters.iter().any(|one| one == name))
    }

    /// How many of the intervals that there are hold the truth.
    pub fn held(&self) -> (usize, usize) {
        let intervals =
            self.case.truth.iter().filter_map(|(name, truth)| Some((self.fit.parameters[name].ci95?, truth)));
        let held: Vec<bool> = intervals.map(|([low, high], truth)| (low..=high).contains(truth)).collect();
        (held.iter().filter(|held| **held).count(), held.len())
    }

    /// Seven parameters without noise: thesis 6.3 and Table 6.8.
    pub fn estimation(&self, each: bool) -> Vec<Row> {
        let (id, fit) = (self.case.id, &self.fit);
        let error = |name: &str, truth: f64| (fit.parameters[name].value / truth - 1.0).abs();
        let far = self
            .case
            .truth
            .iter()
            .filter(|(name, truth)| error(name, *truth) > NEAR && !self.on_a_ridge(name))
            .count();
        if each {
            let [at_truth, _] = errors(&self.problem, &self.truth());
            eprintln!("{id}: error of eq. 6.6 at the truth {at_truth:.2e}; a point every {}", fit.sample_s);
            for (name, truth) in &self.case.truth {
                let mark = if self.on_a_ridge(name) { " (on a ridge)" } else { "" };
                eprintln!("{id} {name}: {:.4}, truth {truth}{mark}", fit.parameters[name].value);
            }
        }
        let [seen, unseen] = errors(&self.problem, &fit.theta());
        vec![
            Row::new(
                format!("plant {id}: seven parameters (target 60 s; thesis 7,020 s)"),
                self.seconds,
                "s",
            ),
            Row::new("  evaluations", fit.evaluations as f64, ""),
            Row::new("  parameters farther than 2 % from the truth and on no ridge", far as f64, "")
                .at_most(0.0),
            Row::new("  pairs on a ridge", fit.correlated.len() as f64, ""),
            Row::new("  error of eq. 6.6 over the three days", seen, "-"),
            Row::new("  error of eq. 6.6 over the eleven unseen days", unseen, "-").at_most(UNSEEN),
        ]
    }

    /// The same with the noise of the sensors: whether the intervals hold the truth.
    pub fn intervals(&self, each: bool) -> Vec<Row> {
        let (held, known) = self.held();
        for (name, truth) in self.case.truth.iter().filter(|_| each) {
            let estimate = &self.fit.parameters[name];
            eprintln!(
                "{} with noise, {name}: {:.4} in {:?}, truth {truth}",
                self.case.id, estimate.value, estimate.ci95
            );
        }
        vec![
            Row::new(
                format!("plant {}: the same, with the noise of the sensors", self.case.id),
                self.seconds,
                "s",
            ),
            Row::new(format!("  intervals of {known} that hold the truth"), held as f64, ""),
        ]
    }
}

/// The record without the samples of the effluent that are not kept; the influent stays, and so does the last
/// sample, which ends the record: a shorter one would be cut into other parts.
fn kept(csv: &str, keep: &dyn Fn(usize) -> bool) -> String {
    let effluent = |name: &str| name.ends_with("_e");
    let names: Vec<&str> = csv.lines().next().unwrap_or_default().split(',').collect();
    let row = |(row, line): (usize, &str)| {
        if row == 0 || keep((row - 1) * ROW) || (row + 1) * ROW >= DAYS * 1440 {
            return line.to_owned();
        }
        let cells = line.split(',').zip(&names).map(|(cell, name)| if effluent(name) { "" } else { cell });
        cells.collect::<Vec<_>>().join(",")
    };
    csv.lines().enumerate().map(row).collect::<Vec<_>>().join("\n")
}

/// The error of eq. 6.6 over the days that are fitted, and over those that are not.
pub fn errors(problem: &Problem, theta: &[f64]) -> [f64; 2] {
    let split = problem.split();
    [split.train.clone(), split.validation.clone()].map(|part| normalised(problem, theta, part))
}

/// The mean square error of thesis eq. 6.6: each effluent in its range, all weighed alike.
pub fn normalised(problem: &Problem, theta: &[f64], part: std::ops::Range<usize>) -> f64 {
    let run = problem.simulate(theta);
    let measured = problem.measured();
    let errors = measured.iter().enumerate().filter_map(|(output, (values, _))| {
        let span = range(problem.usable(output, part.clone()).into_iter().map(|k| values[k]));
        Some(problem.mean_square_error(&run, output, part.clone())? / (span * span))
    });
    errors.sum::<f64>() / measured.len() as f64
}

pub fn range(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    high - low
}
