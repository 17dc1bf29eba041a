//! Bad candidates, each made on purpose from a good room, and what has to refuse them.

use super::{CATALOGUE, Candidate, Refused, fit, problem, problem_of};
use lampyris_core::data::SplitRequest;
use lampyris_core::estimate::gate::regression::Regression;
use lampyris_core::estimate::problem::request::{Budget, SeededMethod};
use lampyris_core::estimate::{EstimateRequest, Fit, Incumbent, Problem};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::optimise::Method;
use lampyris_core::optimise::multistart::LmOptions;
use lampyris_core::twin::{RoomTwin, room};

/// A candidate, or why there is none.
pub type Made = Result<Candidate, Refused>;

/// A way to be bad.
pub struct Kind {
    pub name: &'static str,
    /// One of these has to be among the checks that refuse it.
    pub refused_by: &'static [&'static str],
    pub make: fn(u64) -> Made,
}

/// Rules whose failure another one always notices too: no forecast can be judged where nothing is unseen. The
/// two flags refuse nothing.
pub const SECOND: [&str; 2] = ["G7 repeat", "G8 unseen data"];

const STEP_MINUTES: usize = 30;
const PER_DAY: usize = 24 * 60 / STEP_MINUTES;
const DAYS: usize = 14;

pub const KINDS: &[Kind] = &[
    Kind { name: "a parameter that is no number", refused_by: &["G1"], make: not_a_number },
    Kind { name: "an error that the parameters do not give", refused_by: &["G1"], make: embellished },
    Kind { name: "a parameter changed after the fit", refused_by: &["G1"], make: changed_afterwards },
    Kind { name: "an estimate outside its bounds", refused_by: &["G2 bounds"], make: outside },
    Kind { name: "a loss that heats", refused_by: &["no fit", "G1", "G3"], make: sign_flip },
    Kind { name: "an unstable matrix", refused_by: &["G3 stable"], make: unstable },
    Kind { name: "a capacity of a thousand times", refused_by: &["G2 bounds"], make: thousandfold },
    Kind { name: "heat that cools", refused_by: &["G3", "no fit"], make: cooling_heat },
    Kind { name: "fitted to hours of data", refused_by: &["G4", "G5"], make: overfitted },
    Kind {
        name: "forecasts worse than holding the last value",
        refused_by: &["G4 beats persistence"],
        make: worse_than_persistence,
    },
    Kind { name: "forecasts that leave the numbers", refused_by: &["G4 beats persistence"], make: exploding },
    Kind {
        name: "worse than the incumbent",
        refused_by: &["G4 no worse than incumbent"],
        make: worse_than_incumbent,
    },
    Kind { name: "the parameters of another room", refused_by: &["G4", "G5"], make: swapped },
    Kind { name: "a sensor that spikes", refused_by: &["G5 largest error"], make: spike },
    Kind { name: "a free run that is far away", refused_by: &["G5 excursion"], make: leaves_the_range },
    Kind { name: "far from the incumbent", refused_by: &["G6 jump"], make: jumped },
    Kind { name: "nothing unseen", refused_by: &["G8 unseen data"], make: nothing_unseen },
    Kind { name: "too many gaps", refused_by: &["G8 complete"], make: gaps },
    Kind { name: "an input that never changes", refused_by: &["G8 excited"], make: unexcited },
    Kind { name: "Fahrenheit from one day on", refused_by: &["implausible-values"], make: fahrenheit },
    Kind { name: "a sensor that jumps", refused_by: &["G8 no unit jump"], make: breathed_upon },
    Kind { name: "a sensor that hangs", refused_by: &["G8 not stuck"], make: stuck },
    Kind { name: "a sensor that drifts", refused_by: &["G"], make: drifting },
    Kind {
        name: "a neighbour that is mirrored",
        refused_by: &["G9 right T_room_1"],
        make: mirrored_neighbour,
    },
    Kind { name: "a room whose days are shuffled", refused_by: &["G10", "G11 T_room"], make: shuffled_days },
    Kind { name: "two neighbours of one sensor", refused_by: &["G11"], make: one_sensor },
    Kind {
        name: "against the physics of its model",
        refused_by: &["G3 time constants"],
        make: against_its_model,
    },
    Kind { name: "parameters that nothing determines", refused_by: &["G12 determined"], make: undetermined },
];

/// Ten days to learn from and four to judge by.
fn asked() -> EstimateRequest {
    let day = |days: &str| days.parse().unwrap();
    EstimateRequest {
        split: SplitRequest { train: day("P10D"), validation: day("P4D"), test: None },
        // Least squares from a few points is quick, and finds these rooms.
        method: SeededMethod { method: Method::LmMultistart(LmOptions::default()), seed: 1 },
        ..EstimateRequest::default()
    }
}

struct Base {
    twin: RoomTwin,
    problem: Problem,
    good: Fit,
}

impl Base {
    fn new(seed: u64) -> Self {
        let twin = room(seed, 2, DAYS, STEP_MINUTES).unwrap();
        let problem = problem(&twin.csv, &twin.neighbours, &asked()).unwrap();
        let good = fit(&problem, &asked()).unwrap();
        Self { twin, problem, good }
    }

    /// The room with another document than the one that was found.
    fn with(self, change: impl Fn(&mut Fit)) -> Made {
        let mut fit = self.good;
        change(&mut fit);
        Ok(Candidate { problem: self.problem, fit, incumbent: None })
    }

    fn incumbent(&self, theta: &[f64]) -> Option<Incumbent> {
        let names = self.problem.model().parameters().iter().map(|parameter| parameter.name.clone());
        let theta = names.zip(theta.iter().copied()).collect();
        Some(Incumbent::bare(self.problem.model().id().clone(), theta))
    }

    /// The good parameters with some of them changed.
    fn changed(&self, change: impl Fn(&str, f64) -> f64) -> Vec<f64> {
        self.good.parameters.iter().map(|(name, estimate)| change(name, estimate.value)).collect()
    }

    /// The honest document of a parameter vector that no search has chosen.
    fn of(&self, theta: &[f64], incumbent: Option<Incumbent>) -> Made {
        let names = self.problem.model().parameters().iter().map(|parameter| parameter.name.clone());
        let asked = EstimateRequest { fixed: names.zip(theta.iter().copied()).collect(), ..asked() };
        let problem = problem(&self.twin.csv, &self.twin.neighbours, &asked)?;
        let fit = fit(&problem, &asked)?;
        Ok(Candidate { problem, fit, incumbent })
    }

    fn scaled(&self, factors: &[(&str, f64)]) -> Vec<f64> {
        let factor = |name: &str| {
            factors.iter().find(|(scaled, _)| *scaled == name).map_or(1.0, |(_, factor)| *factor)
        };
        self.changed(|name, value| value * factor(name))
    }
}

/// The same room with other measurements.
fn measured(seed: u64, change: impl Fn(usize, &mut Vec<String>)) -> Made {
    let twin = room(seed, 2, DAYS, STEP_MINUTES).unwrap();
    fitted(&rewritten(&twin.csv, change), &twin.neighbours, &asked())
}

fn rewritten(csv: &str, change: impl Fn(usize, &mut Vec<String>)) -> String {
    let (head, rows) = csv.split_once('\n').unwrap();
    let mut csv = format!("{head}\n");
    for (row, line) in rows.lines().enumerate() {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        change(row, &mut cells);
        csv += &(cells.join(",") + "\n");
    }
    csv
}

fn fitted(csv: &str, neighbours: &[String], asked: &EstimateRequest) -> Made {
    let problem = problem(csv, neighbours, asked)?;
    let fit = fit(&problem, asked)?;
    Ok(Candidate { problem, fit, incumbent: None })
}

/// A cell of the room's temperature, changed.
fn warmer(cells: &mut [String], change: impl Fn(f64) -> f64) {
    cells[1] = format!("{:.4}", change(cells[1].parse().unwrap()));
}

/// How far a free run leaves the measured range, and how far it errs: by hand, over all samples.
fn astray(problem: &Problem, theta: &[f64]) -> (f64, f64) {
    let simulated = &problem.simulate(theta).outputs[0];
    let (values, valid) = problem.measured()[0];
    let known = || values.iter().zip(valid).filter(|(_, valid)| **valid).map(|(value, _)| *value);
    let (low, high) = (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max));
    let leaves = simulated.iter().map(|y| (low - y).max(y - high)).fold(0.0, f64::max);
    let errs = simulated
        .iter()
        .zip(values)
        .zip(valid)
        .filter(|(_, valid)| **valid)
        .map(|((y, value), _)| (y - value).abs());
    (leaves, errs.fold(0.0, f64::max))
}

fn not_a_number(seed: u64) -> Made {
    Base::new(seed).with(|fit| {
        let index = seed as usize % fit.parameters.len();
        fit.parameters[index].value = if seed.is_multiple_of(2) { f64::NAN } else { f64::INFINITY };
    })
}

fn embellished(seed: u64) -> Made {
    Base::new(seed).with(|fit| fit.metrics[0].train_rmse *= 0.9)
}

fn changed_afterwards(seed: u64) -> Made {
    Base::new(seed).with(|fit| fit.parameters["alpha_e"].value *= 1.01)
}

fn outside(seed: u64) -> Made {
    Base::new(seed).with(|fit| {
        let estimate = &mut fit.parameters[seed as usize % 5];
        estimate.bounds = [1.1 * estimate.value, 2.0 * estimate.value];
    })
}

fn sign_flip(seed: u64) -> Made {
    let base = Base::new(seed);
    let rate = ["alpha_a", "alpha_e", "alpha_h"][seed as usize % 3];
    base.of(&base.scaled(&[(rate, -1.0)]), None)
}

fn unstable(seed: u64) -> Made {
    let base = Base::new(seed);
    // Neither heated nor held by its neighbours, and a loss with the wrong sign: it runs away, slowly.
    let change = |name: &str, value| match name {
        "alpha_a" => -0.0005,
        name if name == "alpha_w" || name.starts_with("alpha_n") => 1e-6,
        _ => value,
    };
    base.of(&base.changed(change), None)
}

fn thousandfold(seed: u64) -> Made {
    let base = Base::new(seed);
    base.of(&base.scaled(&[(["beta_h", "beta_he"][seed as usize % 2], 1000.0)]), None)
}

fn cooling_heat(seed: u64) -> Made {
    let base = Base::new(seed);
    base.of(&base.scaled(&[("alpha_w", -0.02)]), None)
}

fn overfitted(seed: u64) -> Made {
    let base = Base::new(seed);
    let mut asked = asked();
    asked.split = SplitRequest { train: "PT8H".parse().unwrap(), ..asked.split };
    let made = fitted(&base.twin.csv, &base.twin.neighbours, &asked)?;
    Ok(Candidate { incumbent: base.incumbent(&base.good.theta()), ..made })
}

fn worse_than_persistence(seed: u64) -> Made {
    let base = Base::new(seed);
    let mut more = 1.0;
    loop {
        // A room that loses hardly any heat is forecast well whatever its walls do: that one loses more.
        let wrong = [("alpha_e", 8.0), ("alpha_h", 4.0), ("alpha_a", more)];
        let made = base.of(&base.scaled(&wrong), None)?;
        let ahead = &made.fit.metrics[0].ahead["PT6H"];
        if ahead.rmse > ahead.persistence || more > 100.0 {
            return Ok(made);
        }
        more *= 1.3;
    }
}

/// A room that is fine as far as its free run goes, and explodes wherever a forecast starts from more than 24
/// degrees.
fn exploding(seed: u64) -> Made {
    let mut catalogue = CATALOGUE.clone();
    let document = serde_json::json!({
        "id": "exploding", "title": "A room that explodes when it is warm",
        "states": {"T_room": {"unit": "degC", "initial": "T_room"}}, "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {"k": {"unit": "1/h", "lower": 0.001, "upper": 10.0, "nominal": 0.1, "scale": "log"}},
        "equations": {"T_room": "k*(T_out - T_room) + if(T_room > 24[degC], exp(700)*exp(700)*1[K/h], \
            0[K/h])"},
        "outputs": {"T_room": {"expr": "T_room", "unit": "degC", "noise_sd": 0.05}},
    });
    catalogue.add_model(ModelDocument::from_json(&document).unwrap());
    let mut csv = "time,T_room,T_out\n".to_owned();
    let start: jiff::Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
    let (k, mut celsius) = (0.1, 18.0);
    for row in 0..DAYS * PER_DAY {
        let hour = row as f64 / 2.0;
        let out = 18.0 + 12.0 * (hour * std::f64::consts::TAU / 24.0 + 0.5 + 0.02 * (seed % 10) as f64).sin();
        // A warm hour a day in the end, of which the model knows nothing.
        let shown = if row > 10 * PER_DAY && row % PER_DAY < 2 { 24.5 } else { celsius };
        csv += &format!("{},{shown:.3},{out:.3}\n", start + jiff::SignedDuration::from_mins(30 * row as i64));
        celsius += 0.5 * k * (out - celsius);
    }
    let asked = EstimateRequest { fixed: [("k".to_owned(), k)].into(), ..asked() };
    let problem = problem_of(&catalogue, "exploding", &csv, &[], &asked)?;
    let fit = fit(&problem, &asked)?;
    Ok(Candidate { problem, fit, incumbent: None })
}

fn worse_than_incumbent(seed: u64) -> Made {
    let base = Base::new(seed);
    let error = |fit: &Fit| fit.metrics[0].ahead["PT6H"].rmse;
    let mut factor = 1.5;
    loop {
        let made = base.of(&base.scaled(&[("alpha_s", factor)]), base.incumbent(&base.good.theta()))?;
        if error(&made.fit) > 1.15 * error(&base.good) || factor > 100.0 {
            return Ok(made);
        }
        factor *= 1.3;
    }
}

fn swapped(seed: u64) -> Made {
    let base = Base::new(seed);
    base.of(&Base::new(seed + 500).good.theta(), base.incumbent(&base.good.theta()))
}

fn spike(seed: u64) -> Made {
    let at = 3 * PER_DAY + seed as usize % PER_DAY;
    measured(seed, |row, cells| {
        if row == at {
            warmer(cells, |celsius| celsius + 12.0);
        }
    })
}

fn leaves_the_range(seed: u64) -> Made {
    let base = Base::new(seed);
    let hotter = |kelvin: f64| {
        base.changed(|name, value| if name == "T_h0" || name == "T_e0" { value + kelvin } else { value })
    };
    // Floor and envelope start so hot that the free run is far away for hours; forecasts start from
    // measurements.
    let kelvin =
        (0..200).map(f64::from).find(|kelvin| astray(&base.problem, &hotter(*kelvin)).0 > 5.5).unwrap();
    base.of(&hotter(kelvin), None)
}

fn jumped(seed: u64) -> Made {
    let base = Base::new(seed);
    let before = base.problem.simulate(&base.good.theta());
    let from = before.outputs[0].len() - 7 * PER_DAY;
    // What was served lost more heat than the room does and gave it less, so much that its free run was
    // another one.
    let served = |factor: f64| base.scaled(&[("alpha_a", factor), ("alpha_w", 1.0 / factor)]);
    let apart = |factor: f64| {
        let run = base.problem.simulate(&served(factor));
        let squares = run.outputs[0]
            .iter()
            .zip(&before.outputs[0])
            .skip(from)
            .map(|(one, other)| (one - other).powi(2));
        (squares.sum::<f64>() / (7 * PER_DAY) as f64).sqrt()
    };
    let factor = (0..60).map(|power| 4.0 * 1.2f64.powi(power)).find(|factor| apart(*factor) > 1.2).unwrap();
    let incumbent = base.incumbent(&served(factor));
    Ok(Candidate { incumbent, problem: base.problem, fit: base.good })
}

fn nothing_unseen(seed: u64) -> Made {
    let twin = room(seed, 2, DAYS, STEP_MINUTES).unwrap();
    let mut asked = asked();
    asked.split.validation = "P0D".parse().unwrap();
    fitted(&twin.csv, &twin.neighbours, &asked)
}

fn gaps(seed: u64) -> Made {
    measured(seed, |row, cells| {
        if row > 0 && (row + seed as usize) % (2 * PER_DAY) < PER_DAY / 3 {
            cells[1].clear();
        }
    })
}

fn unexcited(seed: u64) -> Made {
    measured(seed, |_, cells| cells[5] = "0.5".to_owned())
}

fn fahrenheit(seed: u64) -> Made {
    let from = (9 + seed as usize % 4) * PER_DAY;
    measured(seed, |row, cells| {
        if row >= from {
            warmer(cells, |celsius| celsius * 1.8 + 32.0);
        }
    })
}

fn breathed_upon(seed: u64) -> Made {
    let twin = room(seed, 2, DAYS + 7, STEP_MINUTES).unwrap();
    let mut asked = asked();
    asked.split.train = "P17D".parse().unwrap();
    let at = 2 * PER_DAY + seed as usize % PER_DAY;
    // Earlier than the fortnight that the free run is judged on.
    let csv = rewritten(&twin.csv, |row, cells| {
        if row == at {
            warmer(cells, |celsius| celsius + 16.0);
        }
    });
    known(&twin, &csv, asked)
}

/// A record whose sensor lies, and the parameters of the true one: nothing but the sensor is wrong.
fn known(twin: &RoomTwin, csv: &str, asked: EstimateRequest) -> Made {
    let good = fitted(&twin.csv, &twin.neighbours, &asked)?.fit;
    let fixed = good.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.value)).collect();
    fitted(csv, &twin.neighbours, &EstimateRequest { fixed, ..asked })
}

fn stuck(seed: u64) -> Made {
    let from = (2 + seed as usize % 6) * PER_DAY;
    let twin = room(seed, 2, DAYS, STEP_MINUTES).unwrap();
    let (_, values) = column(&twin.csv, "T_room");
    let csv = rewritten(&twin.csv, |row, cells| {
        if (from..=from + PER_DAY + 2).contains(&row) {
            warmer(cells, |_| values[from]);
        }
    });
    known(&twin, &csv, asked())
}

fn drifting(seed: u64) -> Made {
    measured(seed, |row, cells| warmer(cells, |celsius| celsius + 2.0 * row as f64 / PER_DAY as f64))
}

/// Candidates that are published, and the flag that has to go with them.
pub fn doubtful() -> Vec<(&'static [&'static str], Candidate)> {
    let twin = room(8000, 2, DAYS, STEP_MINUTES).unwrap();
    let with = |asked: &EstimateRequest| fitted(&twin.csv, &twin.neighbours, asked).unwrap();
    let mut bounded = asked();
    let value = with(&asked()).fit.parameters["alpha_s"].value;
    bounded.bounds.insert("alpha_s".to_owned(), [0.5 * value, 0.9 * value]);
    // A parameter on its bound is one that the data do not determine, where unseen data can do without it.
    vec![(&["at_bound:alpha_s", "non_identifiable:alpha_s"], with(&bounded))]
}

/// A good room whose search was cut short.
pub fn hurried() -> Candidate {
    let twin = room(8000, 2, DAYS, STEP_MINUTES).unwrap();
    let hurried = EstimateRequest { budget: Budget { evaluations: 600, wall: None }, ..asked() };
    fitted(&twin.csv, &twin.neighbours, &hurried).unwrap()
}

/// A column of a room's record, by its name.
fn column(csv: &str, name: &str) -> (usize, Vec<f64>) {
    let (head, rows) = csv.split_once('\n').unwrap();
    let place = head.split(',').position(|known| known == name).unwrap();
    (place, rows.lines().map(|row| row.split(',').nth(place).unwrap().parse().unwrap()).collect())
}

/// The record of a room with other values in one column.
fn replaced(seed: u64, name: &str, change: impl Fn(&[f64]) -> Vec<f64>) -> Made {
    let twin = room(seed, 2, DAYS, STEP_MINUTES).unwrap();
    let (place, values) = column(&twin.csv, name);
    let values = change(&values);
    measured(seed, |row, cells| cells[place] = format!("{:.4}", values[row]))
}

/// The first room from this one on that follows its neighbour, mirrored.
fn mirrored_neighbour(seed: u64) -> Made {
    let follows = |seed: &u64| {
        let twin = room(*seed, 2, DAYS, STEP_MINUTES).unwrap();
        let problem = problem(&twin.csv, &twin.neighbours, &asked()).unwrap();
        let neighbour =
            problem.model().inputs().iter().position(|input| input.channel == "T_room_1").unwrap();
        let regression = Regression::new(&problem).unwrap();
        regression.beside(neighbour).is_some_and(|beside| beside.followed().gain_t > 4.0)
    };
    let seed = (seed + 2..).find(follows).unwrap();
    replaced(seed, "T_room_1", |values| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|value| 2.0 * mean - value).collect()
    })
}

/// Every fifth day takes the place of the next one, first in a room whose midnights are so lively that the
/// cuts do not show.
fn shuffled_days(seed: u64) -> Made {
    replaced(seed + 1, "T_room", |values| {
        (0..values.len()).map(|k| values[(k / PER_DAY * 5 + 3) % DAYS * PER_DAY + k % PER_DAY]).collect()
    })
}

fn one_sensor(seed: u64) -> Made {
    let seed = seed + 1;
    let twin = room(seed, 2, DAYS, STEP_MINUTES).unwrap();
    let (_, values) = column(&twin.csv, "T_room_2");
    replaced(seed, "T_room_1", |_| values.iter().map(|value| value + 0.02).collect())
}

/// A document that allows no slow masses, and a good fit that has them.
fn against_its_model(seed: u64) -> Made {
    let text = include_str!("../../../../../config/models/room3.toml")
        .replace("upper = 1440", "upper = 1")
        .replace("id = \"room3\"", "id = \"quick\"");
    let mut catalogue = CATALOGUE.clone();
    catalogue.add_model(ModelDocument::from_toml(&text).unwrap());
    let twin = room(seed, 2, DAYS, STEP_MINUTES).unwrap();
    let problem = problem_of(&catalogue, "quick", &twin.csv, &twin.neighbours, &asked())?;
    let fit = fit(&problem, &asked())?;
    Ok(Candidate { problem, fit, incumbent: None })
}

/// Good values of which the data say nothing.
fn undetermined(seed: u64) -> Made {
    Base::new(seed).with(|fit| fit.parameters.values_mut().for_each(|estimate| estimate.ci95 = None))
}
