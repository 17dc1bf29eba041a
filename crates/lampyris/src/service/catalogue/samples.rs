//! Takes live samples in: one row or many, of one system or many, kept as they come and laid into the days
//! later.

use super::systems;
use super::windows::{self, BodyAsked, Format};
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::samples::{Appended, Post};
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::{SystemId, Window, WindowReport};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;

/// One sample or many of a system, as JSON.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Samples)]
pub struct SamplesBody {
    /// Units by channel; a channel that is not named has its own.
    #[serde(default)]
    channels: IndexMap<String, SampleUnit>,
    /// When, with offset: one time, or as many as there are values. Now, where it is not said.
    #[serde(default)]
    time: Option<OneOrMany<String>>,
    /// By channel: one value, or a list with one for each time. A number, also as a text; whatever else
    /// stands there, such as `null` or `unavailable`, is a missing value.
    values: IndexMap<String, Value>,
}

/// The unit of a channel of samples.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SampleUnit {
    /// Such as `degC`.
    unit: String,
}

/// One of something, or a list.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum OneOrMany<T> {
    /// One.
    One(T),
    /// A list.
    Many(Vec<T>),
}

/// Samples of one of several systems.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SystemSamples {
    /// The system.
    pub system: SystemId,
    /// Its samples.
    pub samples: SamplesBody,
}

/// Samples that were read, with what was found in them.
pub type ReadSamples = Result<(Window, WindowReport), ServiceError>;

/// Samples that were taken.
#[derive(Debug)]
pub struct TakenSamples {
    /// The window that takes them.
    pub window: String,
    /// What was found in them.
    pub report: WindowReport,
    /// The first instant, in milliseconds.
    pub from: i64,
}

impl SamplesBody {
    /// The samples as a window of the same form as those that are uploaded.
    fn into_window(self, now: Timestamp) -> Value {
        let cell = |value: Value| match value {
            Value::Number(_) | Value::Null => value,
            Value::String(text) => text.trim().parse::<f64>().map_or_else(|_| text.into(), Value::from),
            other => other.to_string().into(),
        };
        let list = |values: Value| match values {
            Value::Array(many) => many,
            one => vec![one],
        };
        let cells = |values: Value| list(values).into_iter().map(cell).collect::<Vec<Value>>();
        let time = match self.time {
            None => vec![format!("{now:.0}")],
            Some(OneOrMany::One(time)) => vec![time],
            Some(OneOrMany::Many(times)) => times,
        };
        let values: IndexMap<String, Vec<Value>> =
            self.values.into_iter().map(|(channel, values)| (channel, cells(values))).collect();
        json!({ "channels": self.channels, "time": time, "values": values })
    }
}

/// Takes samples of a system.
///
/// # Errors
/// Every fault of the body, an unknown system, or where the database fails.
pub(crate) async fn take(
    service: &Service,
    system: &SystemId,
    body: SamplesSent,
) -> Result<TakenSamples, ServiceError> {
    let read = read(service, system, body).await;
    let taken = take_many(service, vec![(system.clone(), read)]).await?;
    taken.into_iter().map(|(_, taken)| taken).next().unwrap_or(Err(ServiceError::NoSystem(system.clone())))
}

/// Takes samples of several systems, those that could be read, in one transaction; says of each in which
/// window it is kept, or why it is not.
///
/// # Errors
/// Where the database fails; then nothing is kept.
pub(crate) async fn take_many(
    service: &Service,
    all: Vec<(SystemId, ReadSamples)>,
) -> Result<Vec<(SystemId, Result<TakenSamples, ServiceError>)>, ServiceError> {
    let (mut posts, mut outcomes) = (Vec::new(), Vec::with_capacity(all.len()));
    for (system, read) in all {
        let taken = read.map(|(window, report)| {
            let from = window.from();
            posts.push(Post { system: system.clone(), window, report: report.clone() });
            (report, from)
        });
        outcomes.push((system, taken));
    }
    let appended = store::samples::append(&service.store, &posts, windows::converts, service.now()).await?;
    service.kept_posts.add(appended.len());
    let mut appended = appended.into_iter();
    let settled = |(system, taken): (SystemId, Result<(WindowReport, i64), ServiceError>)| {
        let taken = taken.and_then(|(report, from)| {
            let window = kept(&system, appended.next().unwrap_or(Appended::NoSystem))?;
            Ok(TakenSamples { window, report, from })
        });
        (system, taken)
    };
    Ok(outcomes.into_iter().map(settled).collect())
}

/// How samples are sent.
#[derive(Debug)]
pub enum SamplesSent {
    /// As JSON.
    Json(SamplesBody),
    /// As the CSV of a window.
    Csv(Vec<u8>),
}

/// Reads samples of a system that must be there.
///
/// # Errors
/// Every fault of the body, an unknown system, or where the database fails.
pub(crate) async fn read(service: &Service, system: &SystemId, body: SamplesSent) -> ReadSamples {
    let document = systems::require(service, system).await?;
    let (columns, asked) = (document.columns(), BodyAsked::default().for_system(&document));
    let now = service.now();
    blocking(move || {
        let read = match body {
            SamplesSent::Json(body) => {
                let document = body.into_window(now).to_string();
                windows::read(Format::Json, document.as_bytes(), &columns, &asked)
            }
            SamplesSent::Csv(text) => windows::read(Format::Csv, &text, &columns, &asked),
        }?;
        require_past(&read.0, now)?;
        Ok(read)
    })
    .await?
}

fn require_past(window: &Window, now: Timestamp) -> Result<(), ServiceError> {
    match windows::ahead_of_clock(window.to(), now) {
        Some(fault) => Err(ServiceError::Faults(vec![fault])),
        None => Ok(()),
    }
}

fn kept(system: &SystemId, appended: Appended) -> Result<String, ServiceError> {
    match appended {
        Appended::Kept(window) => Ok(window),
        Appended::NoSystem => Err(ServiceError::NoSystem(system.clone())),
        Appended::Conflicts(conflicts) => {
            let fault = |(channel, unit, earlier): &(String, String, String)| {
                windows::unit_conflict(channel, unit, earlier)
            };
            Err(ServiceError::Faults(conflicts.iter().map(fault).collect()))
        }
    }
}
