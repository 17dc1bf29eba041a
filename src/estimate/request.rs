//! What a user asks for, in words that the command line, the jobs and their schedule share.

use super::problem::{Choices, Problem, Source};
use super::stop::EarlyStopping;
use crate::data::{CALENDAR, DEFAULT_MAX_GAP_STEPS, Duration, GridRequest, Split, SplitRequest, Window, read_time};
use crate::fault::Fault;
use crate::model::{Bindings, Catalogue, Hold, ModelId, compile};
use crate::optimise::Method;
use crate::simulate::drive::samples_back;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};

/// What is minimised on the training part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Objective {
    /// Mean square error of the free run (thesis eq. 6.6).
    #[default]
    Mse,
    /// Mean square error weighted by the correlation of the shapes (thesis eq. 7.6).
    Swmse,
    /// Mean square error of each output over the variance of its measurements, averaged over the outputs:
    /// `1/J sum_j [mean_k (y_j(k) - ym_j(k))^2 / mean_k (ym_j(k) - mean ym_j)^2]`. It is 1 for a model that knows
    /// nothing but the means, and outputs of any size and number of samples count alike.
    Nmse,
}

impl Objective {
    /// The word for documents.
    pub fn word(self) -> &'static str {
        match self {
            Objective::Mse => "mse",
            Objective::Swmse => "swmse",
            Objective::Nmse => "nmse",
        }
    }
}

/// What is known about the parameters before any data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// Nothing but the bounds.
    #[default]
    None,
    /// ln(theta) is normal about the nominal value with deviation 1: the regularisation that the thesis asks
    /// for in 7.6.2.
    LogNormal,
}

/// Where the search starts besides its random points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StartFrom {
    /// The parameters that are served now, if there are any.
    #[default]
    Current,
    /// The nominal values of the model.
    Nominal,
}

/// A search method with its seed: `{"name": "cfa", "seed": 1, "n": 60}`. The default method needs no name.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "Map<String, Value>")]
pub struct SeededMethod {
    /// The same seed gives the same bits.
    pub seed: u64,
    /// The method and its hyperparameters.
    #[serde(flatten)]
    pub method: Method,
}

impl TryFrom<Map<String, Value>> for SeededMethod {
    type Error = String;

    fn try_from(mut fields: Map<String, Value>) -> Result<Self, String> {
        let seed = match fields.shift_remove("seed") {
            None => 0,
            Some(seed) => seed.as_u64().ok_or_else(|| format!("the seed is a whole number from 0 on, not {seed}"))?,
        };
        let name = fields.entry("name").or_insert_with(|| Method::default().name().into());
        if let Some(name) = name.as_str().filter(|name| !Method::NAMES.contains(name)) {
            let known: Vec<String> = Method::NAMES.iter().map(|known| format!("`{known}`")).collect();
            return Err(format!("unknown variant `{name}`: the methods of this version are {}", known.join(", ")));
        }
        let method: Method = serde_json::from_value(Value::Object(fields)).map_err(|error| error.to_string())?;
        let faults: Vec<String> = method.faults().iter().map(|fault| format!("{} {}", fault.field, fault.detail)).collect();
        if faults.is_empty() { Ok(Self { seed, method }) } else { Err(faults.join("; ")) }
    }
}

/// How much may be spent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Budget {
    /// Single-candidate simulations, those of Jacobian columns included.
    pub evaluations: usize,
    /// Wall time.
    pub wall: Option<Duration>,
}

impl Default for Budget {
    fn default() -> Self {
        Self { evaluations: 20_000, wall: None }
    }
}

/// Which measurements are used.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WindowRange {
    /// This long, counted back from the newest sample.
    pub last: Option<Duration>,
    /// From this instant (RFC 3339 with offset).
    pub from: Option<String>,
    /// To this instant.
    pub to: Option<String>,
}

/// An estimation as it is asked for. Every field has a default that serves.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimateRequest {
    /// The model; the system's own by default.
    pub model: Option<ModelId>,
    /// Which measurements; all by default.
    pub window: Option<WindowRange>,
    /// How they are parted.
    pub split: SplitRequest,
    /// What is minimised.
    pub objective: Objective,
    /// What is known beforehand.
    pub prior: Prior,
    /// How it is searched, and from which seed.
    pub method: SeededMethod,
    /// When the search stops although budget and method would let it go on; by default they alone decide.
    pub early_stopping: Option<EarlyStopping>,
    /// How much may be spent.
    pub budget: Budget,
    /// Other bounds than the model's.
    pub bounds: IndexMap<String, [f64; 2]>,
    /// Parameters that are not estimated.
    pub fixed: IndexMap<String, f64>,
    /// Where the search starts.
    pub start_from: StartFrom,
}

/// What is known about the place.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Site {
    /// Latitude and longitude in degrees, for the position of the sun.
    pub location: Option<(f64, f64)>,
    /// IANA time zone, for the clock on the wall; UTC where it is not given.
    pub zone: Option<String>,
    /// The members of the model's sets.
    pub sets: BTreeMap<String, Vec<String>>,
}

/// Compiles the model for this window and place and puts the problem together.
///
/// # Errors
/// Every fault of the request, the model and the window.
pub fn prepare(
    catalogue: &Catalogue,
    model: &ModelId,
    request: &EstimateRequest,
    window: &Window,
    site: &Site,
) -> Result<Problem, Vec<Fault>> {
    let composition = catalogue.compose(model)?;
    let mut channels: BTreeSet<String> = window.channels().chain(CALENDAR).map(str::to_owned).collect();
    if site.location.is_some() {
        channels.extend(["sun_altitude".to_owned(), "sun_azimuth".to_owned()]);
    }
    // Openings of a window can be read off the first output.
    channels.insert(crate::data::DROPS.to_owned());
    let declared =
        composition.spec.sets.iter().filter_map(|set| site.sets.get(set).map(|members| (set.clone(), members.clone()))).collect();
    let model = compile(&composition, &Bindings { sets: declared, channels: Some(channels.clone()) })?;
    let (from, to) = range(request.window.as_ref(), window)?;
    let outputs: Vec<&str> = model.outputs().iter().map(|output| output.channel.as_str()).collect();
    let holds: Vec<(&str, crate::data::Hold)> = model
        .inputs()
        .iter()
        .map(|input| {
            let hold = match input.hold {
                Hold::Linear => crate::data::Hold::Linear,
                Hold::ZeroOrder => crate::data::Hold::ZeroOrder,
            };
            (input.channel.as_str(), hold)
        })
        .filter(|(channel, _)| window.series(channel).is_some())
        .collect();
    let wanted = GridRequest {
        output: outputs[0],
        more_outputs: &outputs[1..],
        channels: &holds,
        step: None,
        from,
        to,
        max_gap_steps: DEFAULT_MAX_GAP_STEPS,
    };
    let mut grid = window.grid(&wanted)?;
    if let Some((latitude, longitude)) = site.location {
        grid = crate::data::add_sun(grid, latitude, longitude).map_err(|fault| vec![fault])?;
    }
    if model.inputs().iter().any(|input| input.channel == crate::data::DROPS) {
        grid = crate::data::add_drops(grid, outputs[0]).map_err(|fault| vec![fault])?;
    }
    if model.inputs().iter().any(|input| CALENDAR.contains(&input.channel.as_str())) {
        grid = crate::data::add_calendar(grid, site.zone.as_deref().unwrap_or("UTC")).map_err(|fault| vec![fault])?;
    }
    let split = Split::new(grid.len(), grid.step(), &request.split).map_err(|fault| vec![fault])?;
    if request.early_stopping.is_some_and(|rule| rule.validation) && split.validation.is_empty() {
        return Err(vec![Fault::new("/early_stopping/validation", "no-validation", "there is no validation part to watch")]);
    }
    // A longer record gives its newest part, and the simulation starts where that part does; what the model
    // delays needs as much past before it, where the record has it.
    let past = (0..model.inputs().len()).map(|input| samples_back(model.longest_delay(input), grid.step_hours())).max().unwrap_or(0);
    let first = split.train.start.saturating_sub(past);
    let grid = grid.slice(first..split.all().end);
    let moved = |range: std::ops::Range<usize>| range.start - first..range.end - first;
    let split = Split { train: moved(split.train), validation: moved(split.validation), test: moved(split.test) };
    let choices =
        Choices { objective: request.objective, prior: request.prior, bounds: request.bounds.clone(), fixed: request.fixed.clone() };
    let used = window.slice(grid.start(), grid.time(grid.len().saturating_sub(1)))?;
    let quanta = outputs.iter().map(|output| used.series(output).and_then(crate::data::Series::quantum)).collect();
    let source = Source { hash: used.content_hash(), quanta };
    Problem::new(model, grid, split, &choices, source)
}

/// The instants between which measurements are used.
fn range(asked: Option<&WindowRange>, window: &Window) -> Result<(Option<i64>, Option<i64>), Vec<Fault>> {
    let Some(asked) = asked else {
        return Ok((None, None));
    };
    let mut faults = Vec::new();
    let mut instant = |field: &str, text: &Option<String>| {
        text.as_ref().and_then(|text| read_time(&format!("/window/{field}"), text).map_err(|fault| faults.push(fault)).ok())
    };
    let (mut from, to) = (instant("from", &asked.from), instant("to", &asked.to));
    if let Some(last) = asked.last {
        if from.is_some() {
            faults.push(Fault::new("/window", "contradiction", "`last` and `from` exclude each other"));
        }
        from = Some(to.unwrap_or(window.to()) - last.seconds());
    }
    if faults.is_empty() { Ok((from, to)) } else { Err(faults) }
}
