//! Collects what an estimate needs: measurements of the system and its neighbours, and what is served now.

use crate::service::catalogue::system::{Exclusion, SystemDocument};
use crate::service::catalogue::systems;
use crate::service::catalogue::windows::unpack;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::fits::FitRecord;
use crate::store::jobs::{JobKind, JobRecord, Origin};
use crate::store::windows::Blocks;
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::{Series, SystemId, Window, read_time};
use lampyris_core::diagnose::ledger::LedgerEntry;
use lampyris_core::estimate::gate::past::NextDoor;
use lampyris_core::estimate::problem::request::{BEFORE, WindowRange};
use lampyris_core::estimate::{EstimateRequest, Incumbent, Past, Problem, Reference, prepare};
use lampyris_core::fault::Fault;
use lampyris_core::model::{Catalogue, ModelId};
use std::sync::Arc;

/// How old the parameters are that a fit is compared with beside those that are served now.
const LOOK_BACK: SignedDuration = SignedDuration::from_hours(30 * 24);
/// The channel of a room that its neighbours see.
const ROOM_TEMPERATURE: &str = "T_room";
/// The channel of the weather that each of them may measure for itself.
const OUTDOOR_TEMPERATURE: &str = "T_out";

/// Everything that an estimate reads, taken from the database before the work begins.
#[derive(Debug)]
pub struct JobInput {
    /// Models and effects.
    pub catalogue: Arc<Catalogue>,
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
    /// What a fit is judged beside, apart from what is served now.
    pub past: Past,
    /// What earlier diagnoses of the system saw, beside any model; of jobs that do not diagnose nothing is
    /// collected.
    pub evidence: Vec<LedgerEntry>,
    measurements: Measurements,
}

/// What was measured of a system and its neighbours over a stretch of time, still packed.
#[derive(Debug)]
pub struct Measurements {
    windows: Vec<Blocks>,
    neighbours: Vec<(SystemId, Vec<Blocks>)>,
    exclude: Vec<Exclusion>,
}

/// Collects the input of a job.
///
/// # Errors
/// Where the system is gone or the database fails.
pub async fn load(service: &Service, job: &JobRecord) -> Result<JobInput, ServiceError> {
    let document = systems::require(service, &job.system).await?;
    let request: EstimateRequest = serde_json::from_value(job.request.clone())
        .map_err(|error| ServiceError::Faults(vec![Fault::new("", "outdated-request", error.to_string())]))?;
    // A fit is judged on the days before its own as well.
    let input = collect(service, &job.system, document, job.model.clone(), request, BEFORE.seconds()).await?;
    let past = past(service, job, input.served.as_ref()).await?;
    let evidence = match job.kind {
        JobKind::Diagnose => store::evidence::of(&service.store, &job.system, None, None).await?,
        _ => Vec::new(),
    };
    Ok(JobInput { past, evidence, posted: job.origin == Origin::Posted, ..input })
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

/// Collects the input of one computation on a system, with so many seconds of measurements before those that
/// are asked for.
///
/// # Errors
/// Where there are no measurements or the database fails.
pub async fn collect(
    service: &Service,
    name: &SystemId,
    system: SystemDocument,
    model: ModelId,
    request: EstimateRequest,
    before: i64,
) -> Result<JobInput, ServiceError> {
    let extent = store::windows::extent(&service.store, name).await?;
    let Some((first, newest)) = extent else {
        return Err(ServiceError::Faults(vec![Fault::new(
            "/window",
            "no-data",
            format!("there are no measurements of {name}"),
        )]));
    };
    let (from, to) = range(request.window.as_ref(), first, newest).map_err(ServiceError::Faults)?;
    Ok(JobInput {
        catalogue: service.catalogue.current(),
        model,
        measurements: measurements(
            service,
            name,
            &system.neighbours,
            &system.exclude,
            (from.saturating_sub(before), to),
        )
        .await?,
        served: store::fits::served(&service.store, name).await?,
        posted: false,
        past: Past::default(),
        evidence: Vec::new(),
        request,
        system,
    })
}

/// Collects what was measured of a system and its neighbours between two instants.
///
/// # Errors
/// Where the database fails.
pub async fn measurements(
    service: &Service,
    system: &SystemId,
    next_door: &[SystemId],
    exclude: &[Exclusion],
    (from, to): (i64, i64),
) -> Result<Measurements, ServiceError> {
    let mut neighbours = Vec::new();
    for neighbour in next_door {
        neighbours.push((
            neighbour.clone(),
            store::windows::blocks(&service.store, neighbour, (from, to), None).await?,
        ));
    }
    Ok(Measurements {
        windows: store::windows::blocks(&service.store, system, (from, to), None).await?,
        neighbours,
        exclude: exclude.to_vec(),
    })
}

/// The stretch of time whose blocks are read; the core cuts it to the second.
fn range(asked: Option<&WindowRange>, first: i64, newest: i64) -> Result<(i64, i64), Vec<Fault>> {
    let Some(asked) = asked else {
        return Ok((first, newest));
    };
    let time = |field: &str, text: &Option<String>| {
        text.as_ref().map(|text| read_time(field, text)).transpose().map_err(|fault| vec![fault])
    };
    let to = time("/window/to", &asked.to)?.unwrap_or(newest);
    let from =
        time("/window/from", &asked.from)?.or(asked.last.map(|last| to - last.seconds())).unwrap_or(first);
    Ok((from, to))
}

impl Measurements {
    /// Unpacks and joins all measurements. This is work for the CPU pool.
    ///
    /// # Errors
    /// Faults where there are none, or two windows do not fit together.
    pub fn window(&self, catalogue: &Catalogue, model: &ModelId) -> Result<Window, ServiceError> {
        let (_, windows) = self.sources()?;
        self.without_exclusions(Window::stitch(&windows).map_err(ServiceError::Faults)?, catalogue, model)
    }

    /// The ids of the uploaded windows that gave a sample to `joined`, which is [`Measurements::window`],
    /// between two instants.
    fn cited(&self, joined: &Window, from: i64, to: i64) -> Result<Vec<String>, ServiceError> {
        let (ids, windows) = self.sources()?;
        let used = joined.slice(from, to).map_err(ServiceError::Faults)?;
        let gave = Window::contributors(&windows, &used);
        Ok(ids.into_iter().zip(gave).filter(|(_, gave)| *gave).map(|(id, _)| id.to_owned()).collect())
    }

    /// All windows with their ids, those of the neighbours first, each in the order of upload.
    fn sources(&self) -> Result<(Vec<&str>, Vec<Window>), ServiceError> {
        let (mut ids, mut windows) = (Vec::new(), Vec::new());
        for (neighbour, blocks) in &self.neighbours {
            // A neighbour that is a system of its own is measured there; otherwise it is a column here.
            for (blocks, window) in blocks.iter().zip(unpack(blocks)?) {
                if let Some(series) = room_temperature(neighbour, &window)? {
                    ids.push(blocks.window.as_str());
                    windows.push(Window::from_series(vec![series]).map_err(ServiceError::Faults)?);
                }
            }
        }
        ids.extend(self.windows.iter().map(|blocks| blocks.window.as_str()));
        windows.extend(unpack(&self.windows)?);
        Ok((ids, windows))
    }

    /// The outdoor temperature of the neighbours that measure one.
    fn weather_next_door(&self) -> Result<Vec<NextDoor>, ServiceError> {
        let mut all = Vec::new();
        for (neighbour, blocks) in &self.neighbours {
            let with_weather =
                unpack(blocks)?.into_iter().filter_map(|window| window.series(OUTDOOR_TEMPERATURE).cloned());
            let windows: Result<Vec<Window>, _> =
                with_weather.map(|series| Window::from_series(vec![series])).collect();
            let windows = windows.map_err(ServiceError::Faults)?;
            if !windows.is_empty() {
                all.push(NextDoor {
                    name: neighbour.to_string(),
                    weather: Window::stitch(&windows).map_err(ServiceError::Faults)?,
                });
            }
        }
        Ok(all)
    }

    /// Takes the measured outputs out of the stretches that are not to be trusted; inputs stay, so that the
    /// simulation runs through.
    fn without_exclusions(
        &self,
        window: Window,
        catalogue: &Catalogue,
        model: &ModelId,
    ) -> Result<Window, ServiceError> {
        if self.exclude.is_empty() {
            return Ok(window);
        }
        let spans: Vec<(i64, i64)> = self
            .exclude
            .iter()
            .filter_map(|span| Some((read_time("", &span.from).ok()?, read_time("", &span.to).ok()?)))
            .collect();
        let outputs = catalogue.compose(model).map_err(ServiceError::Faults)?.spec.outputs;
        let trusted = |time: i64| !spans.iter().any(|(from, to)| (*from..=*to).contains(&time));
        let mut all = Vec::new();
        for series in window.iter() {
            if !outputs.contains_key(series.channel()) {
                all.push(series.clone());
                continue;
            }
            let kept: Vec<(i64, f64)> = series
                .times()
                .iter()
                .copied()
                .zip(series.values().iter().copied())
                .filter(|(time, _)| trusted(*time))
                .collect();
            if !kept.is_empty() {
                let (times, values) = kept.into_iter().unzip();
                let one = Series::new(series.channel(), series.unit(), series.hold(), times, values);
                all.push(one.map_err(|fault| ServiceError::Faults(vec![fault]))?);
            }
        }
        Window::from_series(all).map_err(ServiceError::Faults)
    }
}

impl JobInput {
    /// The measurements as one window. This is work for the CPU pool.
    ///
    /// # Errors
    /// As [`Measurements::window`].
    pub fn window(&self) -> Result<Window, ServiceError> {
        self.measurements.window(&self.catalogue, &self.model)
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
        prepare(&self.catalogue, &self.model, &self.request, window, &self.system.site())
            .map_err(ServiceError::Faults)
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
        let served = self.served.as_ref()?;
        Some(Incumbent {
            model: served.fit.model.parse().ok()?,
            theta: served
                .fit
                .parameters
                .iter()
                .map(|(name, estimate)| (name.clone(), estimate.value))
                .collect(),
            levels: served.fit.levels.clone(),
        })
    }
}

/// The air temperature of a neighbour, as the channel by which the models know it.
fn room_temperature(neighbour: &SystemId, window: &Window) -> Result<Option<Series>, ServiceError> {
    let Some(series) = window.series(ROOM_TEMPERATURE) else {
        return Ok(None);
    };
    let name = format!("{ROOM_TEMPERATURE}_{}", neighbour.id());
    let renamed =
        Series::new(&name, series.unit(), series.hold(), series.times().to_vec(), series.values().to_vec());
    renamed.map(Some).map_err(|fault| ServiceError::Faults(vec![fault]))
}
