//! The ways in which a room is estimated, and what comes of each: week 1 fits, week 2 judges.

use super::super::search::path;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, DAY, Duration, SplitRequest, Window, rfc3339};
use lampyris_core::estimate::problem::objective::{ShapeDelta, swmse};
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{
    Control, EstimateError, EstimateRequest, Fit, GatePolicy, Past, Problem, Site, estimate, prepare,
};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::ParameterSpec;
use lampyris_core::model::{Catalogue, ModelId, Nominal, Scale};
use serde::Serialize;
use std::ops::Range;
use std::time::Instant;

/// Lower end of the thesis's box (Table 7.5).
const THESIS_LOWER: f64 = 1e-4;

/// The box of the rates and capacities. Temperatures, steepness and set-point have the same bounds in all.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Coefficients {
    /// From 1e-4 up to this, spread evenly, without a nominal value (Table 7.5 up to 1000; up to 15 in
    /// 7.6.2).
    Linear(f64),
    /// From 1e-4 up to this, spread evenly in the logarithm.
    Log(f64),
    /// The model's own.
    Physical,
}

/// A way to estimate: a line of the tables.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Way {
    /// What the tables call it.
    pub name: &'static str,
    /// Where it looks.
    pub coefficients: Coefficients,
    /// What is asked, as the body of a job.
    pub request: &'static str,
    /// Whether the valve is measured; otherwise the model has a sigmoid.
    pub valve: bool,
    /// Whether the search is left to itself, as published. An estimation starts one candidate at the nominal
    /// values and polishes by least squares where the result needs shorter steps.
    pub bare: bool,
}

const fn way(name: &'static str, coefficients: Coefficients, request: &'static str) -> Way {
    Way { name, coefficients, request, valve: false, bare: false }
}

/// Algorithm 2 by itself, in a box of the thesis's kind or another.
const fn thesis(name: &'static str, coefficients: Coefficients) -> Way {
    Way { bare: true, ..way(name, coefficients, r#"{"method": {"name": "cfa_thesis"}}"#) }
}

/// Chapter 7 as published: Table 7.4's fireflies in Table 7.5's box, with the shape-weighted error.
pub const THESIS: Way = Way {
    request: r#"{"method": {"name": "cfa_thesis"}, "objective": "swmse"}"#,
    ..thesis("cfa_thesis, swMSE", Coefficients::Linear(1000.0))
};
/// The same with the mean square error.
pub const THESIS_MSE: Way = thesis("cfa_thesis", Coefficients::Linear(1000.0));
/// The cure of 7.6.2.
pub const NARROWED: Way = thesis("cfa_thesis up to 15", Coefficients::Linear(15.0));
/// What a job does that asks for nothing.
pub const DEFAULT: Way = way("cfa", Coefficients::Physical, "{}");
/// The same with a prior.
pub const PRIOR: Way = way("cfa, prior", Coefficients::Physical, r#"{"prior": "log_normal"}"#);
/// The same with the measured valve in the place of the sigmoid.
pub const VALVE: Way = Way { name: "cfa, valve measured", valve: true, ..DEFAULT };

/// What is compared room by room; another method is another line.
pub const METHODS: &[Way] = &[
    THESIS,
    THESIS_MSE,
    DEFAULT,
    way("lm_multistart", Coefficients::Physical, r#"{"method": {"name": "lm_multistart"}}"#),
    way("ctsm", Coefficients::Physical, r#"{"method": {"name": "ctsm"}}"#),
];

/// The boxes that are compared, with and without a prior.
pub const BOXES: &[Way] = &[
    THESIS,
    THESIS_MSE,
    NARROWED,
    thesis("cfa_thesis, physical", Coefficients::Physical),
    way("cfa, linear up to 1000", Coefficients::Linear(1000.0), "{}"),
    way("cfa, log up to 1000", Coefficients::Log(1000.0), "{}"),
    way("cfa, log up to 1000, prior", Coefficients::Log(1000.0), r#"{"prior": "log_normal"}"#),
    DEFAULT,
    PRIOR,
];

/// Every way once.
pub fn all() -> Vec<Way> {
    let mut ways: Vec<Way> = METHODS.to_vec();
    for way in BOXES.iter().chain([&VALVE]) {
        if !ways.contains(way) {
            ways.push(*way);
        }
    }
    ways
}

impl Coefficients {
    /// The catalogue in which `room3` has this box.
    fn catalogue(self) -> Result<Catalogue, Failure> {
        let mut catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
        if let Some(ModelDocument::Spec(mut spec)) = catalogue.model("room3").cloned() {
            spec.parameters
                .values_mut()
                .filter(|parameter| parameter.scale == Scale::Log)
                .for_each(|parameter| self.apply(parameter));
            catalogue.add_model(ModelDocument::Spec(spec));
        }
        Ok(catalogue)
    }

    fn apply(self, parameter: &mut ParameterSpec) {
        match self {
            Coefficients::Physical => {}
            Coefficients::Log(upper) => (parameter.lower, parameter.upper) = (THESIS_LOWER, upper),
            Coefficients::Linear(upper) => {
                (parameter.lower, parameter.upper, parameter.scale) = (THESIS_LOWER, upper, Scale::Linear);
                // The thesis knows no nominal values: the middle of the box is as good a place as any of its
                // own.
                parameter.nominal = Nominal::Value(0.5 * (THESIS_LOWER + upper));
            }
        }
    }
}

/// A room as the layout proposes it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Room {
    /// Its name, which is the number of its representative sensor.
    pub id: String,
    /// Its sensors.
    pub sensors: Vec<String>,
    /// The rooms that are proposed as its neighbours.
    pub neighbours: Vec<String>,
}

/// What does not differ between the ways.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked {
    /// Seed of the searches.
    pub seed: u64,
    /// What the shape counts in swMSE.
    pub delta: ShapeDelta,
    /// Days of each of the two parts: a week in the thesis.
    pub part_days: usize,
}

/// The mean square errors of a free run, one per part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Errors {
    /// Mean square error in K2.
    pub mse: [f64; 2],
    /// Shape-weighted mean square error (eq. 7.6).
    pub swmse: [f64; 2],
}

/// What the gate says of a fit, with week 2 as unseen data.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gate {
    /// Its word.
    pub verdict: &'static str,
    /// The rules that refused or held it.
    pub failed: Vec<String>,
    /// Its sentence.
    pub summary: String,
}

/// What a fit came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Solution {
    /// The least objective of week 1.
    pub cost: f64,
    /// Single-candidate simulations.
    pub evaluations: usize,
    /// Free-run errors.
    pub errors: Errors,
    /// The gate.
    pub gate: Gate,
    /// The largest of the estimated rates and capacities.
    pub largest: f64,
    /// The free run over both weeks.
    #[serde(skip)]
    pub output: Vec<f64>,
}

/// One room, estimated in one way.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Run {
    /// The room.
    pub room: String,
    /// The way.
    pub way: &'static str,
    /// Wall time of the search and of what follows it.
    pub seconds: f64,
    /// What was found; `None` where there is no solution.
    pub solution: Option<Solution>,
    /// Why there is none.
    pub reason: Option<String>,
}

/// What was measured in a room, on its grid: the first part, and both.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Unix seconds.
    pub times: Vec<i64>,
    /// Temperatures, where there are any.
    pub values: Vec<Option<f64>>,
}

/// What problems are put together from.
struct Place {
    catalogue: Catalogue,
    window: Window,
    model: ModelId,
    site: Site,
    part_days: usize,
}

impl Place {
    fn new(csv: &str, room: &Room, way: &Way, asked: &Asked) -> Result<Self, Failure> {
        let mut bindings = ColumnBindings::none();
        bindings.bind("T_room", format!("T_room_{}", room.id));
        if way.valve {
            bindings.bind("valve", format!("valve_{}", room.id));
        }
        let (window, _) = Window::parse_csv(csv, &bindings).map_err(|found| faults(&found))?;
        let model: ModelId = "room3".parse().map_err(|error| Failure::Error(format!("{error}")))?;
        let site =
            Site { sets: [("neighbours".to_owned(), room.neighbours.clone())].into(), ..Site::default() };
        Ok(Self { catalogue: way.coefficients.catalogue()?, window, model, site, part_days: asked.part_days })
    }

    /// The problem of the first part alone. It ends where the second one begins, and shares no sample with
    /// it.
    fn first(&self, request: &EstimateRequest) -> Result<Problem, Failure> {
        let end = self.window.from() + DAY * self.part_days as i64 - 1;
        let window = Some(WindowRange { to: Some(rfc3339(end)), ..WindowRange::default() });
        self.problem(EstimateRequest { window, ..request.clone() }, 0)
    }

    /// The problem of both parts, the second one as unseen data.
    fn both(&self, request: &EstimateRequest) -> Result<Problem, Failure> {
        self.problem(request.clone(), self.part_days)
    }

    fn problem(&self, mut request: EstimateRequest, unseen_days: usize) -> Result<Problem, Failure> {
        let days = |days: usize| Duration::from_days(days as i64);
        request.split =
            SplitRequest { train: days(self.part_days), validation: days(unseen_days), test: None };
        prepare(&self.catalogue, &self.model, &request, &self.window, &self.site)
            .map_err(|found| faults(&found))
    }
}

/// The room's temperatures over both parts.
///
/// # Errors
/// Where the window cannot be read.
pub fn measured(csv: &str, room: &Room, asked: &Asked) -> Result<Measured, Failure> {
    let both = Place::new(csv, room, &DEFAULT, asked)?.both(&EstimateRequest::default())?;
    let (values, valid) = both.measured()[0];
    let times = (0..values.len()).map(|k| both.grid().time(k)).collect();
    Ok(Measured {
        times,
        values: values.iter().zip(valid).map(|(value, valid)| valid.then_some(*value)).collect(),
    })
}

/// Estimates a room in one way.
///
/// # Errors
/// Where the window cannot be read; a search without a solution is a line of the table.
pub fn run(csv: &str, room: &Room, way: &Way, asked: &Asked) -> Result<Run, Failure> {
    let place = Place::new(csv, room, way, asked)?;
    let mut request: EstimateRequest = serde_json::from_str(way.request)
        .map_err(|error| Failure::Error(format!("{}: {error}", way.name)))?;
    request.method.seed = asked.seed;
    request.delta = asked.delta;
    let (first, both) = (place.first(&request)?, place.both(&request)?);
    let start = Instant::now();
    let (mut fit, mut spent) = (Err(EstimateError::NothingFinite), 0);
    if way.bare {
        let found = path(&first, &request.method.method, asked.seed, request.budget.evaluations);
        spent = found.evaluations;
        if let Some(theta) = found.best {
            // A fit with nothing left to estimate says of these parameters what it says of others.
            request.fixed = first
                .model()
                .parameters()
                .iter()
                .map(|parameter| parameter.name.clone())
                .zip(theta)
                .collect();
            fit = estimate(&place.first(&request)?, &request, None, &Control::NONE);
        }
    } else {
        fit = estimate(&first, &request, None, &Control::NONE);
    }
    let seconds = start.elapsed().as_secs_f64();
    let (solution, reason) = match fit {
        Ok(mut fit) => {
            fit.evaluations += spent;
            (Some(solution(&both, &fit, asked)), None)
        }
        Err(error) => (None, Some(error.to_string())),
    };
    Ok(Run { room: room.id.clone(), way: way.name, seconds, solution, reason })
}

fn solution(both: &Problem, fit: &Fit, asked: &Asked) -> Solution {
    let judgement = validate(both, fit, &Past::default(), &GatePolicy::default());
    // The fit may have needed shorter steps than the problem starts with, and other starts.
    let problem = fit.simulated(both);
    let run = problem.simulate(&fit.theta());
    let (values, _) = problem.measured()[0];
    let pairs = |range: &Range<usize>| -> Vec<(f64, f64)> {
        problem.usable(0, range.clone()).into_iter().map(|k| (run.outputs[0][k], values[k])).collect()
    };
    let parts = [pairs(&problem.split().train), pairs(&problem.split().validation)];
    let mse = |pairs: &Vec<(f64, f64)>| {
        pairs.iter().map(|(a, b)| (a - b).powi(2)).sum::<f64>() / pairs.len() as f64
    };
    let errors = Errors {
        mse: [mse(&parts[0]), mse(&parts[1])],
        swmse: [0, 1].map(|part| swmse(&parts[part], asked.delta).unwrap_or(f64::INFINITY)),
    };
    let gate = Gate {
        verdict: judgement.verdict.as_str(),
        failed: judgement.failed().into_iter().map(str::to_owned).collect(),
        summary: judgement.summary.clone(),
    };
    let rates =
        fit.parameters.iter().filter(|(name, _)| name.starts_with("alpha_") || name.starts_with("beta_"));
    let largest = rates.map(|(_, estimate)| estimate.value).fold(0.0, f64::max);
    Solution {
        cost: fit.cost,
        evaluations: fit.evaluations,
        errors,
        gate,
        largest,
        output: run.outputs[0].clone(),
    }
}
