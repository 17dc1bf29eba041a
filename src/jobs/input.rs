//! Collects what an estimate needs: measurements of the system and its neighbours, and what is served now.

use super::systems::{self, SystemDocument};
use super::{JobsError, Service};
use crate::data::{Series, SystemId, Window, read_time};
use crate::estimate::request::WindowRange;
use crate::estimate::{EstimateRequest, Incumbent, Problem, prepare};
use crate::fault::Fault;
use crate::model::{Catalogue, ModelId};
use crate::store;
use crate::store::fits::FitRecord;
use crate::store::jobs::JobRecord;
use crate::store::windows::Blocks;
use std::sync::Arc;

/// The channel of a room that its neighbours see.
const ROOM_TEMPERATURE: &str = "T_room";

/// Everything that an estimate reads, taken from the database before the work begins.
#[derive(Debug)]
pub struct Input {
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
    windows: Vec<Blocks>,
    neighbours: Vec<(SystemId, Vec<Blocks>)>,
}

/// Collects the input of a job.
///
/// # Errors
/// Where the system is gone or the database fails.
pub async fn load(service: &Service, job: &JobRecord) -> Result<Input, JobsError> {
    let request: EstimateRequest = serde_json::from_value(job.request.clone())
        .map_err(|error| JobsError::Faults(vec![Fault::new("", "outdated-request", error.to_string())]))?;
    collect(service, &job.system, &job.model, request).await
}

/// Collects what an estimate of a system would read now.
///
/// # Errors
/// Where there is no such system, it has no measurements, or the database fails.
pub async fn collect(service: &Service, name: &SystemId, model: &ModelId, request: EstimateRequest) -> Result<Input, JobsError> {
    let system = systems::require(service, name).await?;
    let extent = store::windows::extent(&service.store, name).await?;
    let Some((first, newest)) = extent else {
        return Err(JobsError::Faults(vec![Fault::new("/window", "no-data", format!("there are no measurements of {name}"))]));
    };
    let (from, to) = range(request.window.as_ref(), first, newest).map_err(JobsError::Faults)?;
    let mut neighbours = Vec::new();
    for neighbour in &system.neighbours {
        neighbours.push((neighbour.clone(), store::windows::blocks(&service.store, neighbour, from, to).await?));
    }
    Ok(Input {
        catalogue: service.catalogue.current(),
        model: model.clone(),
        windows: store::windows::blocks(&service.store, name, from, to).await?,
        served: store::fits::served(&service.store, name).await?,
        request,
        system,
        neighbours,
    })
}

/// The stretch of time whose blocks are read; the core cuts it to the second.
fn range(asked: Option<&WindowRange>, first: i64, newest: i64) -> Result<(i64, i64), Vec<Fault>> {
    let Some(asked) = asked else {
        return Ok((first, newest));
    };
    let time =
        |field: &str, text: &Option<String>| text.as_ref().map(|text| read_time(field, text)).transpose().map_err(|fault| vec![fault]);
    let to = time("/window/to", &asked.to)?.unwrap_or(newest);
    let from = time("/window/from", &asked.from)?.or(asked.last.map(|last| to - last.seconds())).unwrap_or(first);
    Ok((from, to))
}

impl Input {
    /// Puts the problem together. This is work for the CPU pool.
    ///
    /// # Errors
    /// Faults of the model, the request and the measurements.
    pub fn problem(&self) -> Result<Problem, JobsError> {
        let window = self.window()?;
        prepare(&self.catalogue, &self.model, &self.request, &window, &self.system.site()).map_err(JobsError::Faults)
    }

    /// Unpacks and joins all measurements.
    ///
    /// # Errors
    /// Faults where there are none, or two windows do not fit together.
    fn window(&self) -> Result<Window, JobsError> {
        let mut windows = unpack(&self.windows)?;
        for (neighbour, blocks) in &self.neighbours {
            // A neighbour that is a system of its own is measured there; otherwise it is a column here.
            if let Some(series) = room_temperature(neighbour, blocks)? {
                windows.insert(0, Window::from_series(vec![series]).map_err(JobsError::Faults)?);
            }
        }
        let joined = Window::stitch(&windows).map_err(JobsError::Faults)?;
        self.without_exclusions(&joined)
    }

    /// Takes the measured outputs out of the stretches that are not to be trusted; inputs stay, so that the
    /// simulation runs through.
    fn without_exclusions(&self, window: &Window) -> Result<Window, JobsError> {
        if self.system.exclude.is_empty() {
            return Ok(window.clone());
        }
        let spans: Vec<(i64, i64)> =
            self.system.exclude.iter().filter_map(|span| Some((read_time("", &span.from).ok()?, read_time("", &span.to).ok()?))).collect();
        let outputs = self.catalogue.compose(&self.model).map_err(JobsError::Faults)?.spec.outputs;
        let trusted = |time: i64| !spans.iter().any(|(from, to)| (*from..=*to).contains(&time));
        let mut all = Vec::new();
        for series in window.iter() {
            if !outputs.contains_key(series.channel()) {
                all.push(series.clone());
                continue;
            }
            let kept: Vec<(i64, f64)> =
                series.times().iter().copied().zip(series.values().iter().copied()).filter(|(time, _)| trusted(*time)).collect();
            if !kept.is_empty() {
                let (times, values) = kept.into_iter().unzip();
                let one = Series::new(series.channel(), series.unit(), series.hold(), times, values);
                all.push(one.map_err(|fault| JobsError::Faults(vec![fault]))?);
            }
        }
        Window::from_series(all).map_err(JobsError::Faults)
    }

    /// The parameters that are served now.
    pub fn incumbent(&self) -> Option<Incumbent> {
        let served = self.served.as_ref()?;
        Some(Incumbent {
            model: served.fit.model.parse().ok()?,
            theta: served.fit.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.value)).collect(),
        })
    }
}

fn unpack(windows: &[Blocks]) -> Result<Vec<Window>, JobsError> {
    windows.iter().map(|blocks| Window::from_series(blocks.decode()?).map_err(JobsError::Faults)).collect()
}

/// The air temperature of a neighbour, as the channel by which the models know it.
fn room_temperature(neighbour: &SystemId, blocks: &[Blocks]) -> Result<Option<Series>, JobsError> {
    let windows = unpack(blocks)?;
    if windows.is_empty() {
        return Ok(None);
    }
    let joined = Window::stitch(&windows).map_err(JobsError::Faults)?;
    let Some(series) = joined.series(ROOM_TEMPERATURE) else {
        return Ok(None);
    };
    let name = format!("{ROOM_TEMPERATURE}_{}", neighbour.id());
    let renamed = Series::new(&name, series.unit(), series.hold(), series.times().to_vec(), series.values().to_vec());
    renamed.map(Some).map_err(|fault| JobsError::Faults(vec![fault]))
}
