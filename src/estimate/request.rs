//! What a user asks for, in words that the command line, the jobs and their schedule share.

pub use super::method::SeededMethod;
use super::problem::{Choices, Problem, Source};
use crate::data::{DEFAULT_MAX_GAP_STEPS, Duration, GridRequest, Length, Split, SplitRequest, Window, read_time};
use crate::fault::Fault;
use crate::model::{Bindings, Catalogue, Hold, ModelId, compile};
use crate::schema::Interval;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// What is minimised on the training part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Objective {
    /// Mean square error of the free run (thesis eq. 6.6).
    #[default]
    Mse,
    /// Mean square error weighted by the correlation of the shapes (thesis eq. 7.6).
    Swmse,
}

/// What is known about the parameters before any data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum StartFrom {
    /// The parameters that are served now, if there are any.
    #[default]
    Current,
    /// The nominal values of the model.
    Nominal,
}

/// How much may be spent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Budget {
    /// Single-candidate simulations, those of Jacobian columns included.
    #[schema(minimum = 1, maximum = 100_000_000)]
    pub evaluations: usize,
    /// Wall time.
    #[schema(value_type = Option<Length>)]
    pub wall: Option<Duration>,
}

impl Default for Budget {
    fn default() -> Self {
        Self { evaluations: 20_000, wall: None }
    }
}

/// Which measurements are used.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WindowRange {
    /// This long, counted back from the newest sample.
    #[schema(value_type = Option<Length>)]
    pub last: Option<Duration>,
    /// From this instant (RFC 3339 with offset).
    #[schema(format = DateTime)]
    pub from: Option<String>,
    /// To this instant.
    #[schema(format = DateTime)]
    pub to: Option<String>,
}

/// An estimation as it is asked for. Every field has a default that serves.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
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
    /// How much may be spent.
    pub budget: Budget,
    /// Other bounds than the model's.
    #[schema(value_type = IndexMap<String, Interval>)]
    pub bounds: IndexMap<String, [f64; 2]>,
    /// Parameters that are not estimated.
    pub fixed: IndexMap<String, f64>,
    /// Where the search starts.
    pub start_from: StartFrom,
}

impl EstimateRequest {
    /// What is asked different from the model's own document.
    pub fn choices(&self) -> Choices {
        Choices { objective: self.objective, prior: self.prior, bounds: self.bounds.clone(), fixed: self.fixed.clone() }
    }
}

/// What is known about the place.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Site {
    /// Latitude and longitude in degrees, for the position of the sun.
    pub location: Option<(f64, f64)>,
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
    let mut channels: BTreeSet<String> = window.channels().map(str::to_owned).collect();
    if site.location.is_some() {
        channels.extend(["sun_altitude".to_owned(), "sun_azimuth".to_owned()]);
    }
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
    let split = Split::new(grid.len(), grid.step(), &request.split).map_err(|fault| vec![fault])?;
    // A longer record gives its newest part, and the simulation starts where that part does.
    let first = split.train.start;
    let grid = grid.slice(split.all());
    let moved = |range: std::ops::Range<usize>| range.start - first..range.end - first;
    let split = Split { train: moved(split.train), validation: moved(split.validation), test: moved(split.test) };
    let choices = request.choices();
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
