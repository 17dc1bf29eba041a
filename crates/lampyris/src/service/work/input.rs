//! Collects what an estimate needs: measurements of the system and its neighbours, and what is served now.

use crate::service::catalogue::proposed;
use crate::service::catalogue::system::{SharedChannel, SystemDocument};
use crate::service::catalogue::systems;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::fits::FitRecord;
use crate::store::jobs::{JobKind, JobRecord, Origin};
use crate::store::measured::OwnedDays;
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::{ChannelView, DAY, Series, SystemId, Window, read_time};
use lampyris_core::diagnose::ledger::LedgerEntry;
use lampyris_core::estimate::gate::past::NextDoor;
use lampyris_core::estimate::pooling::pooled;
use lampyris_core::estimate::problem::prior::Prior;
use lampyris_core::estimate::problem::request::{BEFORE, SearchExtent, WindowRange};
use lampyris_core::estimate::{EstimateRequest, Fit, Incumbent, Past, Problem, Reference, prepare};
use lampyris_core::fault::Fault;
use lampyris_core::model::{Catalogue, ModelId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// How old the parameters are that a fit is compared with beside those that are served now.
const LOOK_BACK: SignedDuration = SignedDuration::from_hours(30 * 24);
/// Most systems of a building that one learns from: more would tell little more.
const MOST_SIBLINGS: i64 = 40;
/// So many days to learn from are left at least where what was before a change is forgotten.
const LEAST_DAYS: i64 = 5;
/// One night in so many a system is searched everywhere.
const NIGHTS: i64 = 10;
/// The channel of a room that its neighbours see.
const ROOM_TEMPERATURE: &str = "T_room";
/// The channel of the weather that each of them may measure for itself.
const OUTDOOR_TEMPERATURE: &str = "T_out";

/// Everything that an estimate reads, taken from the database before the work begins.
#[derive(Debug)]
pub struct JobInput {
    /// Models and effects.
    pub catalogue: Arc<Catalogue>,
    /// Those effects that a diagnosis tries.
    pub tried: Arc<Catalogue>,
    /// The model to estimate.
    pub model: ModelId,
    /// What is asked.
    pub request: EstimateRequest,
    /// The system.
    pub system: SystemDocument,
    /// The fit that is served now.
    pub served: Option<FitRecord>,
    /// Whether somebody has asked for the job; the others come by themselves.
    pub posted: bool,
    /// Whether this is a night on which a system is searched everywhere in any case.
    pub drawn: bool,
    /// What a fit is judged beside, apart from what is served now.
    pub past: Past,
    /// What the other systems of its building serve, by name; only an estimate with such a prior asks.
    pub siblings: Vec<(String, Fit)>,
    /// What earlier diagnoses of the system saw, beside any model; of jobs that do not diagnose nothing is
    /// collected.
    pub evidence: Vec<LedgerEntry>,
    /// The instant from which on it is fitted, where a parameter has changed then and the policy wants to
    /// forget what was before.
    pub forgotten: Option<i64>,
    measurements: Measurements,
}

/// What was measured of a system and its neighbours over a stretch of time, still packed.
#[derive(Debug)]
pub struct Measurements {
    own: OwnedDays,
    neighbours: Vec<(SystemId, OwnedDays)>,
    shared: Vec<(SharedChannel, OwnedDays)>,
    /// The stretches that are not to be trusted, in milliseconds; both ends belong to them.
    excluded: Vec<(i64, i64)>,
}

/// Collects the input of a job.
///
/// # Errors
/// Where the system is gone or the database fails.
pub(crate) async fn load(service: &Service, job: &JobRecord) -> Result<JobInput, ServiceError> {
    let document = systems::require(service, &job.system).await?;
    let request: EstimateRequest = serde_json::from_value(job.request.clone())
        .map_err(|error| ServiceError::Faults(vec![Fault::new("", "outdated-request", error.to_string())]))?;
    // A fit is judged on the days before its own as well.
    let input = collect(service, &job.system, document, job.model.clone(), request, BEFORE.millis()).await?;
    let past = past(service, job, input.served.as_ref()).await?;
    let tried = match job.kind {
        JobKind::Diagnose | JobKind::Ladder => proposed::tried(service, &input.model).await?,
        _ => input.tried.clone(),
    };
    let evidence = match job.kind {
        JobKind::Diagnose => store::evidence::of(&service.store, &job.system, None, None).await?,
        _ => Vec::new(),
    };
    let siblings = siblings(service, job, &input).await?;
    let forgotten = forgotten(service, job, &input).await?;
    let (posted, drawn) = (job.origin == Origin::Posted, is_drawn(&job.system, service.now()));
    Ok(JobInput { forgotten, tried, past, siblings, evidence, posted, drawn, ..input })
}

/// Whether a system is searched everywhere in this night: each on its own one of ten, so that no night has
/// many of them, and what a search next to the served parameters has missed is found soon.
fn is_drawn(system: &SystemId, now: Timestamp) -> bool {
    let night = now.as_millisecond().div_euclid(DAY);
    let own = blake3::hash(system.to_string().as_bytes()).as_bytes()[0];
    (night + i64::from(own)).rem_euclid(NIGHTS) == 0
}

/// What the other systems of a building serve, where an estimate shall learn from them.
async fn siblings(
    service: &Service,
    job: &JobRecord,
    input: &JobInput,
) -> Result<Vec<(String, Fit)>, ServiceError> {
    let building = input.system.building();
    let is_asked = job.kind == JobKind::Estimate && input.request.prior == Prior::Siblings;
    if !is_asked || !service.settings.estimate.borrow || building.is_empty() {
        return Ok(Vec::new());
    }
    let place = (input.system.tenant.as_str(), building);
    let found =
        store::fits::of_siblings(&service.store, &job.system, place, &input.model, MOST_SIBLINGS).await?;
    Ok(found.into_iter().map(|record| (record.system.to_string(), record.fit)).collect())
}

/// From when on the newest measurements are of another room than those before: the newest fit that nobody
/// asked for has seen a parameter change, and enough days to learn from lie behind. `None` where the policy
/// does not want to forget, or somebody asks.
async fn forgotten(
    service: &Service,
    job: &JobRecord,
    input: &JobInput,
) -> Result<Option<i64>, ServiceError> {
    let is_wanted = input.system.policy.forget_before_change;
    if !is_wanted || job.kind != JobKind::Estimate || job.origin == Origin::Posted {
        return Ok(None);
    }
    let Some(seen) = store::fits::newest_change(&service.store, &job.system).await? else { return Ok(None) };
    let Some((_, newest)) = store::measured::extent(&service.store, &job.system).await? else {
        return Ok(None);
    };
    let split = &input.request.split;
    let unseen = split.validation.millis() + split.test.map_or(0, |test| test.millis());
    // By then it had changed, at 95 %.
    let since = read_time("", &seen.since_95[1]).ok();
    Ok(since.filter(|since| newest - unseen - since >= LEAST_DAYS * DAY))
}

/// What is known of older parameters, and of newer measurements.
async fn past(service: &Service, job: &JobRecord, served: Option<&FitRecord>) -> Result<Past, ServiceError> {
    let then = service.now().saturating_sub(LOOK_BACK).unwrap_or(Timestamp::MIN);
    let trusted = store::revisions::trusted(&service.store, &job.system, then).await?;
    let reference = |name: &str, record: Option<FitRecord>| {
        // What is served still is the incumbent, which has its own checks.
        let record = record.filter(|record| served.is_none_or(|served| served.id != record.id))?;
        Some(Reference { name: name.to_owned(), fit: record.fit })
    };
    let served_then = reference("the parameters served 30 days ago", trusted.served_then);
    let confirmed = reference("the last parameters that an operator confirmed", trusted.confirmed);
    Ok(Past {
        references: served_then.into_iter().chain(confirmed).collect(),
        degraded: degraded(service, job).await?,
        ..Past::default()
    })
}

/// Since when newer measurements contradict what is served, where a job is nobody's wish: whoever posts one
/// may know why the room has changed. While that stands every night has to answer for itself, not only the
/// job that is submitted at once.
async fn degraded(service: &Service, job: &JobRecord) -> Result<Option<i64>, ServiceError> {
    if job.origin == Origin::Posted {
        return Ok(None);
    }
    let standing = store::params::standing(&service.store, &job.system).await?;
    let found = standing.and_then(|standing| standing.degradation).map(|record| record.degradation);
    Ok(found.and_then(|found| read_time("", &found.from).ok()))
}

/// Collects the input of one computation on a system, with so many milliseconds of measurements before those
/// that are asked for.
///
/// # Errors
/// Where there are no measurements or the database fails.
pub(crate) async fn collect(
    service: &Service,
    name: &SystemId,
    system: SystemDocument,
    model: ModelId,
    request: EstimateRequest,
    before: i64,
) -> Result<JobInput, ServiceError> {
    let extent = store::measured::extent(&service.store, name).await?;
    let Some((first, newest)) = extent else {
        return Err(ServiceError::Faults(vec![Fault::new(
            "/window",
            "no-data",
            format!("there are no measurements of {name}"),
        )]));
    };
    let (from, to) = range(request.window.as_ref(), first, newest).map_err(ServiceError::Faults)?;
    let catalogue = service.catalogue.current();
    Ok(JobInput {
        tried: catalogue.clone(),
        catalogue,
        model,
        measurements: measurements(service, name, &system, (from.saturating_sub(before), to)).await?,
        served: store::fits::served(&service.store, name).await?,
        posted: false,
        drawn: false,
        past: Past::default(),
        siblings: Vec::new(),
        forgotten: None,
        evidence: Vec::new(),
        request,
        system,
    })
}

/// Collects what was measured of a system, its neighbours and the others that share a channel with it,
/// between two instants.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn measurements(
    service: &Service,
    system: &SystemId,
    document: &SystemDocument,
    (from, to): (i64, i64),
) -> Result<Measurements, ServiceError> {
    // A sample at either end may stand between two of which one lies beyond it.
    let span = (from.saturating_sub(DAY), to.saturating_add(DAY));
    let of_neighbours = [ROOM_TEMPERATURE, OUTDOOR_TEMPERATURE].map(str::to_owned);
    let mut neighbours = Vec::new();
    for neighbour in &document.neighbours {
        let days = store::measured::read_owned(&service.store, neighbour, span, Some(&of_neighbours)).await?;
        neighbours.push((neighbour.clone(), days));
    }
    let mut shared = Vec::new();
    for channel in document.shared() {
        let name = [channel.there.clone()];
        let days = store::measured::read_owned(&service.store, &channel.system, span, Some(&name)).await?;
        shared.push((channel, days));
    }
    Ok(Measurements {
        own: store::measured::read_owned(&service.store, system, span, None).await?,
        neighbours,
        shared,
        excluded: document.excluded(),
    })
}

/// The stretch of time whose days are read; the core cuts it to the second.
fn range(asked: Option<&WindowRange>, first: i64, newest: i64) -> Result<(i64, i64), Vec<Fault>> {
    let Some(asked) = asked else {
        return Ok((first, newest));
    };
    let time = |field: &str, text: &Option<String>| {
        text.as_ref().map(|text| read_time(field, text)).transpose().map_err(|fault| vec![fault])
    };
    let to = time("/window/to", &asked.to)?.unwrap_or(newest);
    let from =
        time("/window/from", &asked.from)?.or(asked.last.map(|last| to - last.millis())).unwrap_or(first);
    Ok((from, to))
}

impl Measurements {
    /// Unpacks and joins all measurements. This is work for the CPU pool.
    ///
    /// # Errors
    /// Faults where there are none, or two windows do not fit together.
    pub fn window(&self, catalogue: &Catalogue, model: &ModelId) -> Result<Window, ServiceError> {
        self.since(None, catalogue, model)
    }

    /// The same with outputs from an instant on.
    fn since(
        &self,
        forgotten: Option<i64>,
        catalogue: &Catalogue,
        model: &ModelId,
    ) -> Result<Window, ServiceError> {
        let mut windows = Vec::new();
        // What a system measures itself counts before what another one shares with it.
        for (channel, days) in &self.shared {
            if let Some(series) = days.days.series(&channel.there)? {
                let renamed = vec![renamed(&series, &channel.here)?];
                windows.push(Window::from_series(renamed).map_err(ServiceError::Faults)?);
            }
        }
        for (neighbour, days) in &self.neighbours {
            // A neighbour that is a system of its own is measured there; otherwise it is a column here.
            if let Some(series) = days.days.series(ROOM_TEMPERATURE)? {
                let renamed = vec![renamed(&series, &next_door(neighbour))?];
                windows.push(Window::from_series(renamed).map_err(ServiceError::Faults)?);
            }
        }
        let own = self.own.days.channels()?;
        let own = own.into_iter().filter_map(|name| self.own.days.series(name).transpose());
        let own: Vec<Series> = own.collect::<Result<_, _>>()?;
        if !own.is_empty() {
            windows.push(Window::from_series(own).map_err(ServiceError::Faults)?);
        }
        let mut spans = self.excluded.clone();
        spans.extend(forgotten.map(before));
        without(&spans, Window::stitch(&windows).map_err(ServiceError::Faults)?, catalogue, model)
    }

    /// The ids of the uploaded windows that gave a sample to `joined`, which is [`Measurements::window`],
    /// between two instants.
    fn cited(&self, joined: &Window, from: i64, to: i64) -> Result<Vec<String>, ServiceError> {
        let mut ids = BTreeSet::new();
        for series in joined.slice(from, to).map_err(ServiceError::Faults)?.iter() {
            let own = self.own.days.view(series.channel())?;
            let mut sources = vec![(own, &self.own.windows)];
            for (neighbour, days) in self.neighbours.iter().rev() {
                if next_door(neighbour) == series.channel() {
                    sources.push((days.days.view(ROOM_TEMPERATURE)?, &days.windows));
                }
            }
            for (channel, days) in self.shared.iter().rev().filter(|(one, _)| one.here == series.channel()) {
                sources.push((days.days.view(&channel.there)?, &days.windows));
            }
            for time in series.times() {
                let gave = |(view, ids): &(ChannelView, &BTreeMap<i64, String>)| {
                    ids.get(&view.owner(*time)?).cloned()
                };
                ids.extend(sources.iter().find_map(gave));
            }
        }
        Ok(ids.into_iter().collect())
    }

    /// The outdoor temperature of the neighbours that measure one.
    fn weather_next_door(&self) -> Result<Vec<NextDoor>, ServiceError> {
        let mut all = Vec::new();
        for (neighbour, days) in &self.neighbours {
            if let Some(series) = days.days.series(OUTDOOR_TEMPERATURE)? {
                all.push(NextDoor {
                    name: neighbour.to_string(),
                    weather: Window::from_series(vec![series]).map_err(ServiceError::Faults)?,
                });
            }
        }
        Ok(all)
    }
}

/// Takes the measured outputs out of stretches that are not to be trusted; inputs stay, so that the
/// simulation runs through.
fn without(
    spans: &[(i64, i64)],
    window: Window,
    catalogue: &Catalogue,
    model: &ModelId,
) -> Result<Window, ServiceError> {
    if spans.is_empty() {
        return Ok(window);
    }
    let outputs = catalogue.compose(model).map_err(ServiceError::Faults)?.spec.outputs;
    let trusted = |time: i64| !spans.iter().any(|(from, to)| (*from..=*to).contains(&time));
    let mut all = Vec::new();
    for series in window.iter() {
        if !outputs.contains_key(series.channel()) {
            all.push(series.clone());
            continue;
        }
        let kept: Vec<(i64, f64)> = series.samples().filter(|(time, _)| trusted(*time)).collect();
        if !kept.is_empty() {
            let (times, values) = kept.into_iter().unzip();
            let one = Series::new(series.channel(), series.unit(), series.hold(), times, values);
            all.push(one.map_err(|fault| ServiceError::Faults(vec![fault]))?);
        }
    }
    Window::from_series(all).map_err(ServiceError::Faults)
}

/// All before an instant.
fn before(instant: i64) -> (i64, i64) {
    (i64::MIN, instant - 1)
}

impl JobInput {
    /// The measurements as one window. This is work for the CPU pool.
    ///
    /// # Errors
    /// As [`Measurements::window`].
    pub fn window(&self) -> Result<Window, ServiceError> {
        self.measurements.window(&self.catalogue, &self.model)
    }

    /// What is fitted of it: all, or outputs from the instant on from which they are not forgotten.
    ///
    /// # Errors
    /// As [`Measurements::window`].
    pub fn fitted(&self) -> Result<Window, ServiceError> {
        self.measurements.since(self.forgotten, &self.catalogue, &self.model)
    }

    /// The stretches of time that count for nothing, in milliseconds; both ends belong to them.
    pub fn excluded(&self) -> Vec<(i64, i64)> {
        self.system.excluded().into_iter().chain(self.forgotten.map(before)).collect()
    }

    /// What is asked, with the search that is usual here.
    pub fn resolved(&self) -> EstimateRequest {
        let search = match self.request.search {
            SearchExtent::Usual if self.posted || self.drawn => SearchExtent::Global,
            SearchExtent::Usual => SearchExtent::Local,
            named => named,
        };
        EstimateRequest { search, ..self.request.clone() }
    }

    /// The ids of the uploaded windows that gave a sample to `joined`, which is [`JobInput::window`], between
    /// two instants.
    ///
    /// # Errors
    /// As [`JobInput::window`].
    pub fn cited(&self, joined: &Window, from: i64, to: i64) -> Result<Vec<String>, ServiceError> {
        self.measurements.cited(joined, from, to)
    }

    /// The outdoor temperature of the neighbours that measure one. This is work for the CPU pool.
    ///
    /// # Errors
    /// As [`Measurements::window`].
    pub fn weather_next_door(&self) -> Result<Vec<NextDoor>, ServiceError> {
        self.measurements.weather_next_door()
    }

    /// Puts the problem together. This is work for the CPU pool.
    ///
    /// # Errors
    /// Faults of the model, the request and the measurements.
    pub fn problem(&self, window: &Window) -> Result<Problem, ServiceError> {
        let problem = prepare(&self.catalogue, &self.model, &self.request, window, &self.system.site())
            .map_err(ServiceError::Faults)?;
        Ok(match pooled(&problem, &self.siblings) {
            Some(known) => problem.with_prior(Prior::Known(known)),
            None => problem,
        })
    }

    /// Whether somebody has narrowed this one search: such a fit may be served, but the nights to come are
    /// not to be measured by it unless an operator wants that.
    pub fn is_narrowed(&self) -> bool {
        self.posted && (self.request.bounds != self.system.bounds || self.request.fixed != self.system.fixed)
    }

    /// All that a fit is judged beside.
    pub fn past(&self) -> Past {
        Past { incumbent: self.incumbent(), ..self.past.clone() }
    }

    /// The parameters that are served now.
    fn incumbent(&self) -> Option<Incumbent> {
        Incumbent::of(&self.served.as_ref()?.fit)
    }
}

/// The channel by which the models know the air temperature of a neighbour.
fn next_door(neighbour: &SystemId) -> String {
    format!("{ROOM_TEMPERATURE}_{}", neighbour.id())
}

fn renamed(series: &Series, name: &str) -> Result<Series, ServiceError> {
    let (times, values) = series.samples().unzip();
    Series::new(name, series.unit(), series.hold(), times, values)
        .map_err(|fault| ServiceError::Faults(vec![fault]))
}
