//! What a user asks for, in words that the command line, the jobs and their schedule share.

use super::basis::Basis;
use super::choices::{Choices, Source};
pub use super::method::SeededMethod;
use super::objective::{Objective, ShapeDelta};
use super::predictor::Predictor;
use super::prior::Prior;
use super::stop::EarlyStopping;
use super::whiten::common_divisor;
use crate::data::{
    CALENDAR, DROPS, Duration, Grid, GridRequest, Length, MINUTE, SUN, Split, SplitRequest, Window,
    add_calendar, add_drops, add_sun, read_time, rfc3339,
};
use crate::estimate::problem::Problem;
use crate::fault::Fault;
use crate::model::{Bindings, Catalogue, InputHold, Model, ModelId, compile};
use crate::optimise::Method;
use crate::schema::Interval;
use crate::simulate::Stepper;
use crate::simulate::drive::samples_back;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// The shortest step of a grid that is chosen for several channels.
const SHORTEST_STEP: i64 = MINUTE;
/// How much of what came before the days of a fit is looked at: a season is not to pass meanwhile.
pub const BEFORE: Duration = Duration::from_days(14);

/// What keeps a step of a ladder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// The gates of a diagnosis, and an error on unseen data that falls.
    #[default]
    HeldOut,
    /// A likelihood-ratio test of the nested models on the training part.
    Lrt,
}

impl Criterion {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
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

/// How widely is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SearchExtent {
    /// Locally where nobody asked for the fit and parameters are served, but for one night in ten; globally
    /// elsewhere.
    #[default]
    Usual,
    /// From the served parameters to the optimum next to them, and globally only where that errs by more than
    /// they did over their own days.
    Local,
    /// Everywhere within the bounds.
    Global,
}

impl SearchExtent {
    fn is_usual(&self) -> bool {
        *self == Self::default()
    }
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

impl Budget {
    /// What is spent where nobody says anything else.
    pub const USUAL: Budget = Budget { evaluations: 20_000, wall: None };
}

impl Default for Budget {
    fn default() -> Self {
        Self::USUAL
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

/// The share of rooms with nothing missing that may be accused, above 0 and at most a fifth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct AccusationRate(f64);

impl AccusationRate {
    /// One in a hundred.
    pub const USUAL: Self = Self(0.01);

    /// Whether it is the usual one, which documents need not name.
    pub fn is_usual(&self) -> bool {
        *self == Self::default()
    }
}

impl Default for AccusationRate {
    fn default() -> Self {
        Self::USUAL
    }
}

impl TryFrom<f64> for AccusationRate {
    type Error = String;

    fn try_from(rate: f64) -> Result<Self, String> {
        let serves = rate > 0.0 && rate <= 0.2;
        if serves {
            Ok(Self(rate))
        } else {
            Err(format!("an accusation rate is above 0 and at most 0.2, not {rate}"))
        }
    }
}

impl From<AccusationRate> for f64 {
    fn from(rate: AccusationRate) -> f64 {
        rate.0
    }
}

impl std::str::FromStr for AccusationRate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse::<f64>().map_err(|error| error.to_string())?.try_into()
    }
}

/// An estimation as it is asked for. Every field has a default that serves.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EstimateRequest {
    /// The model; the system's own by default.
    pub model: Option<ModelId>,
    /// Which measurements; all by default.
    pub window: Option<WindowRange>,
    /// The step of the fit; that of the first output in whole seconds by default, but at least a minute.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Length>)]
    pub step: Option<Duration>,
    /// How they are parted.
    pub split: SplitRequest,
    /// What is minimised.
    pub objective: Objective,
    /// What the shape counts in `swmse` (delta of thesis eq. 7.6): 1 is the mean square error alone; 0.5 by
    /// default.
    #[serde(skip_serializing_if = "ShapeDelta::is_usual")]
    #[schema(value_type = f64, minimum = 0, maximum = 1)]
    pub delta: ShapeDelta,
    /// What is known beforehand.
    pub prior: Prior,
    /// How it is searched, and from which seed.
    pub method: SeededMethod,
    /// When the search stops although budget and method would let it go on; by default they alone decide.
    pub early_stopping: Option<EarlyStopping>,
    /// How much may be spent.
    pub budget: Budget,
    /// Other bounds than the model's.
    #[schema(value_type = IndexMap<String, Interval>)]
    pub bounds: IndexMap<String, [f64; 2]>,
    /// Parameters that are not estimated.
    pub fixed: IndexMap<String, f64>,
    /// Where the search starts.
    pub start_from: StartFrom,
    /// How widely is searched.
    #[serde(skip_serializing_if = "SearchExtent::is_usual")]
    pub search: SearchExtent,
    /// How often a diagnosis may accuse where nothing is missing, other jobs do not: the share of such rooms
    /// in which segments of hours name an effect that a logged channel drives.
    #[serde(skip_serializing_if = "AccusationRate::is_usual")]
    #[schema(value_type = f64, exclusive_minimum = 0, maximum = 0.2)]
    pub accusation_rate: AccusationRate,
    /// What keeps a step of a ladder; other jobs have none.
    #[serde(skip_serializing_if = "Criterion::is_default")]
    pub criterion: Criterion,
}

/// The objective and the method that go with each other, as far as they were named: the likelihood is
/// maximised by `ctsm` and by no other method, and `ctsm` maximises nothing else.
///
/// # Errors
/// A fault where they contradict each other.
pub fn agreed(objective: Option<Objective>, method: Option<Method>) -> Result<(Objective, Method), Fault> {
    let is_ctsm = |method: &Method| matches!(method, Method::Ctsm(_));
    match (objective, method) {
        (Some(Objective::Likelihood), None) => Ok((Objective::Likelihood, Method::Ctsm(Default::default()))),
        (None | Some(Objective::Likelihood), Some(method)) if is_ctsm(&method) => {
            Ok((Objective::Likelihood, method))
        }
        (Some(Objective::Likelihood), Some(method)) => {
            let detail =
                format!("the likelihood is maximised by the method `ctsm`, not by `{}`", method.name());
            Err(Fault::new("/objective", "contradiction", detail)
                .suggest("name the method `ctsm`, or no method"))
        }
        (Some(objective), Some(method)) if is_ctsm(&method) => {
            let detail = format!("the method `ctsm` maximises the likelihood, not `{}`", objective.as_str());
            Err(Fault::new("/objective", "contradiction", detail).suggest("leave the objective out"))
        }
        (objective, method) => Ok((objective.unwrap_or_default(), method.unwrap_or_default())),
    }
}

impl EstimateRequest {
    /// What is asked different from the model's own document.
    pub fn choices(&self) -> Choices {
        Choices {
            objective: self.objective,
            delta: self.delta,
            prior: self.prior.clone(),
            bounds: self.bounds.clone(),
            fixed: self.fixed.clone(),
        }
    }
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

impl Site {
    /// The place that a problem was put together for.
    pub fn of(basis: &Basis) -> Self {
        Self { location: basis.location, zone: basis.zone.clone(), sets: basis.sets.clone() }
    }
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
    let mut basis = Basis {
        from: rfc3339(window.from()),
        to: rfc3339(window.to()),
        channels: channels(window, site),
        sets: site.sets.clone(),
        location: site.location,
        zone: site.zone.clone(),
        lead: 0,
    };
    let model = bound(catalogue, model, &basis)?;
    let (from, to) = range(request.window.as_ref(), window)?;
    let columns = Columns::of(&model, window);
    let step = request.step.map(Duration::millis).or(columns.step);
    let grid = window.grid(&GridRequest { from, to, step, ..columns.request() })?;
    let grid = with_computed(grid, &model, &basis)?;
    let split = Split::new(grid.len(), grid.step(), &request.split).map_err(|fault| vec![fault])?;
    if request.early_stopping.is_some_and(|rule| rule.validation) && split.validation.is_empty() {
        return Err(vec![Fault::new(
            "/early_stopping/validation",
            "no-validation",
            "there is no validation part to watch",
        )]);
    }
    // A longer record gives its newest part, and the simulation starts where that part does; what the model
    // delays needs as much past before it, where the record has it.
    let past = (0..model.inputs().len())
        .map(|input| samples_back(model.longest_delay(input), grid.step_hours()))
        .max()
        .unwrap_or(0);
    let first = split.train.start.saturating_sub(past);
    basis.lead = split.train.start - first;
    let grid = grid.slice(first..split.all().end);
    let moved = |range: std::ops::Range<usize>| range.start - first..range.end - first;
    let split =
        Split { train: moved(split.train), validation: moved(split.validation), test: moved(split.test) };
    let choices = request.choices();
    let source = source(&model, window, &grid, basis)?;
    Problem::new(model, grid, split, &choices, source)
}

/// The same model on the measurements right before those of a problem, at most so many: what a fit to the
/// problem has not seen, and what came before it. `None` where there is nothing to judge by.
pub fn days_before(
    catalogue: &Catalogue,
    request: &EstimateRequest,
    window: &Window,
    site: &Site,
    problem: &Problem,
) -> Option<Problem> {
    let start = problem.grid().time(problem.split().train.start);
    let window = window.slice(start - BEFORE.millis(), start).ok()?;
    let split = SplitRequest { train: BEFORE, validation: Duration::from_seconds(0), test: None };
    let asked = EstimateRequest { window: None, split, early_stopping: None, ..request.clone() };
    match problem.predictor() {
        Predictor::Filtered => {
            let before = prepare(catalogue, problem.model().id(), &asked, &window, site).ok()?;
            Some(before.with_brake(problem.brake()))
        }
        // A free run of other days says nothing of this one.
        Predictor::FreeRun => None,
    }
}

/// The channels that a model can choose from: the window's, the clock's, the openings of a window, which can
/// be read off the first output, and the sun's where the place is known.
fn channels(window: &Window, site: &Site) -> Vec<String> {
    let mut channels: BTreeSet<String> =
        window.channels().chain(CALENDAR).chain([DROPS]).map(str::to_owned).collect();
    if site.location.is_some() {
        channels.extend(SUN.map(str::to_owned));
    }
    channels.into_iter().collect()
}

/// The model, compiled for the channels and sets that there are.
pub(in crate::estimate) fn bound(
    catalogue: &Catalogue,
    model: &ModelId,
    basis: &Basis,
) -> Result<Model, Vec<Fault>> {
    let composition = catalogue.compose(model)?;
    let sets = basis.sets.iter().filter(|(set, _)| composition.spec.sets.contains(*set));
    let sets = sets.map(|(set, members)| (set.clone(), members.clone())).collect();
    compile(&composition, &Bindings { sets, channels: Some(basis.channels.iter().cloned().collect()) })
}

/// The columns that a model is simulated on.
pub(in crate::estimate) struct Columns<'a> {
    outputs: Vec<&'a str>,
    holds: Vec<(&'a str, crate::data::Hold)>,
    /// Seconds between points, where it is not for the first output to say.
    step: Option<i64>,
}

impl<'a> Columns<'a> {
    /// The outputs of a model, and those of its inputs that the window has.
    pub(in crate::estimate) fn of(model: &'a Model, window: &Window) -> Self {
        let hold = |hold: InputHold| match hold {
            InputHold::Linear => crate::data::Hold::Linear,
            InputHold::ZeroOrder => crate::data::Hold::ZeroOrder,
        };
        let inputs = model.inputs().iter().filter(|input| window.series(&input.channel).is_some());
        let outputs: Vec<&str> = model.outputs().iter().map(|output| output.channel.as_str()).collect();
        let holds: Vec<(&str, crate::data::Hold)> =
            inputs.map(|input| (input.channel.as_str(), hold(input.hold))).collect();
        // Held inputs that change between two samples of the outputs have to change there: the stepper does
        // not know half of an interval. The step that divides all of them does.
        let names = outputs.iter().chain(holds.iter().map(|(name, _)| name));
        let steps = names.filter_map(|name| usize::try_from(window.series(name)?.median_step()?).ok());
        let common = steps.fold(0, common_divisor) as i64;
        let step = (model.stepper() == Stepper::Rkc && common >= SHORTEST_STEP).then_some(common);
        Self { outputs, holds, step }
    }

    /// All of them, over the whole record.
    pub(in crate::estimate) fn request(&self) -> GridRequest<'_> {
        GridRequest {
            more_outputs: &self.outputs[1..],
            step: self.step,
            ..GridRequest::new(self.outputs[0], &self.holds)
        }
    }
}

/// The grid with what can be computed: the position of the sun where the place is known, and what else the
/// model reads of the clock and of openings.
pub(in crate::estimate) fn with_computed(
    grid: Grid,
    model: &Model,
    basis: &Basis,
) -> Result<Grid, Vec<Fault>> {
    let reads = |names: &[&str]| model.inputs().iter().any(|input| names.contains(&input.channel.as_str()));
    let computed = || {
        let mut grid = grid;
        if let Some((latitude, longitude)) = basis.location {
            grid = add_sun(grid, latitude, longitude)?;
        }
        if let (true, Some(output)) = (reads(&[DROPS]), model.outputs().first()) {
            grid = add_drops(grid, &output.channel)?;
        }
        if reads(&CALENDAR) {
            grid = add_calendar(grid, basis.zone.as_deref().unwrap_or("UTC"))?;
        }
        Ok(grid)
    };
    computed().map_err(|fault| vec![fault])
}

/// Where the measurements under a grid come from.
pub(in crate::estimate) fn source(
    model: &Model,
    window: &Window,
    grid: &Grid,
    basis: Basis,
) -> Result<Source, Vec<Fault>> {
    let used = window.slice(grid.start(), grid.time(grid.len().saturating_sub(1)))?;
    let quantum =
        |output: &crate::model::Output| used.series(&output.channel).and_then(crate::data::Series::quantum);
    let step = model.outputs().first().and_then(|output| used.series(&output.channel)?.median_step());
    let quanta = model.outputs().iter().map(quantum).collect();
    Ok(Source { hash: used.content_hash(), quanta, step, basis })
}

/// The instants between which measurements are used.
pub(in crate::estimate) fn range(
    asked: Option<&WindowRange>,
    window: &Window,
) -> Result<(Option<i64>, Option<i64>), Vec<Fault>> {
    let Some(asked) = asked else {
        return Ok((None, None));
    };
    let mut faults = Vec::new();
    let mut instant = |field: &str, text: &Option<String>| {
        text.as_ref().and_then(|text| {
            read_time(&format!("/window/{field}"), text).map_err(|fault| faults.push(fault)).ok()
        })
    };
    let (mut from, to) = (instant("from", &asked.from), instant("to", &asked.to));
    if let Some(last) = asked.last {
        if from.is_some() {
            faults.push(Fault::new("/window", "contradiction", "`last` and `from` exclude each other"));
        }
        from = Some(to.unwrap_or(window.to()) - last.millis());
    }
    if faults.is_empty() { Ok((from, to)) } else { Err(faults) }
}
