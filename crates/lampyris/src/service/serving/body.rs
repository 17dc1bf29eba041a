//! The bodies of `/params`, rendered once per event.

use crate::service::catalogue::system::SystemDocument;
use crate::service::error::ServiceError;
use crate::store::params::{RevisionRecord, ServedState};
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::SystemId;
use lampyris_core::estimate::assess::degradation::Degradation;
use lampyris_core::estimate::fit::covariance::Covariance;
use lampyris_core::estimate::gate::served::ServedError;
use lampyris_core::model::{Catalogue, ModelId, Nominal};
use serde::Serialize;
use serde_json::Value;
use std::sync::Arc;
use utoipa::ToSchema;

/// How far ahead of the clock measurements may be that are taken in; what is farther ahead is no age.
const MOST_AHEAD: SignedDuration = SignedDuration::from_hours(24);

/// A finished body.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// JSON.
    pub body: Arc<[u8]>,
    /// A strong tag: the quoted hash of the body.
    pub etag: Arc<str>,
    /// The status that the body tells.
    pub status: Status,
    /// Whether it is older than the policy wants, whatever its status says beside.
    pub stale: bool,
    /// The revision, if it is one.
    pub revision: Option<i64>,
}

/// How much a controller may trust what is served.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = ParamsStatus)]
pub enum Status {
    /// Validated on new measurements, and not long ago.
    Fresh,
    /// Validated, but longer ago, or on older measurements, than the policy wants.
    Stale,
    /// Validated; a newer attempt failed.
    Fallback,
    /// Validated, but newer measurements contradict it.
    Degraded,
    /// Validated, and kept in service by an operator.
    Pinned,
    /// Never validated: the nominal values of the model.
    Nominal,
}

impl Status {
    /// What a system may have that serves validated parameters.
    pub const VALIDATED: [Status; 5] =
        [Status::Fresh, Status::Stale, Status::Fallback, Status::Degraded, Status::Pinned];

    /// What is said of a degraded system.
    pub const CONTRADICTED: &str = "The error on new measurements is far above that of the validation.";

    /// The word in the body and in the header `Params-Status`.
    pub const fn as_str(self) -> &'static str {
        match self {
            Status::Fresh => "fresh",
            Status::Stale => "stale",
            Status::Fallback => "fallback",
            Status::Degraded => "degraded",
            Status::Pinned => "pinned",
            Status::Nominal => "nominal",
        }
    }
}

/// The parameters of a system, as a controller reads them.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Params)]
pub struct Body {
    /// The system.
    system: SystemId,
    /// Counts up by one with every set that is published.
    revision: Option<i64>,
    /// The fit behind it.
    fit: Option<String>,
    /// How much to trust it.
    status: Status,
    /// The model.
    #[schema(value_type = ModelId)]
    model: Value,
    /// Values by name.
    #[schema(value_type = HashMap<String, Option<f64>>)]
    parameters: Value,
    /// Units by name.
    #[schema(value_type = HashMap<String, String>)]
    units: Value,
    /// 95 % confidence intervals by name; `null` where the data do not determine one.
    #[schema(value_type = HashMap<String, Option<[f64; 2]>>)]
    ci95: Value,
    /// What the gate wants said.
    #[schema(value_type = Vec<String>)]
    flags: Value,
    /// Errors by output channel.
    #[schema(value_type = HashMap<String, ServedError>)]
    error: Value,
    /// When it was found.
    #[schema(value_type = Option<String>, format = DateTime)]
    fitted_at: Option<Timestamp>,
    /// When the gate last found it fit to be served.
    #[schema(value_type = Option<String>, format = DateTime)]
    validated_at: Option<Timestamp>,
    /// The measurements behind it.
    window: Option<ParamsWindow>,
    /// The job that found it.
    job: Option<String>,
    /// When the status turns to `stale`.
    #[schema(value_type = Option<String>, format = DateTime)]
    stale_after: Option<Timestamp>,
    /// Why it is not newer.
    fallback: Option<Fallback>,
    /// How newer measurements contradict it.
    degraded: Option<Degraded>,
    /// Why an operator keeps it in service.
    pin: Option<Pin>,
    /// How the estimates err together, where that was asked for (`with=covariance`).
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<Covariance>,
}

/// A stretch of time.
#[derive(Debug, Serialize, ToSchema)]
pub struct ParamsWindow {
    /// First instant.
    #[schema(format = DateTime)]
    from: String,
    /// Last instant.
    #[schema(format = DateTime)]
    to: String,
}

/// Why a newer attempt is not served.
#[derive(Debug, Serialize, ToSchema)]
pub struct Fallback {
    /// `validation_failed` or `job_failed`.
    reason: &'static str,
    /// The job behind it.
    job: String,
    /// The fit that was refused.
    fit: Option<String>,
    /// What it failed.
    failed_checks: Vec<String>,
    /// Since when no attempt has succeeded.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
}

/// How newer measurements contradict what is served.
#[derive(Debug, Serialize, ToSchema)]
pub struct Degraded {
    /// Root mean square of the forecast errors on newer measurements, at the moment at which it was noticed.
    error: f64,
    /// Twice that on the validation data, or twice the sensor's noise where that is more.
    limit: f64,
    /// Unit of both.
    unit: String,
    /// How far ahead the forecasts look; `free_run` where a model without a filter is left to itself.
    #[schema(example = "PT6H")]
    horizon: String,
    /// The newer measurements.
    window: ParamsWindow,
    /// Since when.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
}

/// Why an operator keeps a revision in service.
#[derive(Debug, Serialize, ToSchema)]
pub struct Pin {
    /// The operator's words.
    reason: String,
    /// Since when.
    #[schema(value_type = String, format = DateTime)]
    since: Timestamp,
}

/// When a revision turns stale: it is as old as its newest measurement, or as the gate's last look at it
/// where that is older.
///
/// What lies in the future was written by a clock that is wrong, or was right when that of the service is
/// wrong now. It says nothing of the age, and what may be old is not called fresh.
pub(super) fn stale_after(revision: &RevisionRecord, document: &SystemDocument, now: Timestamp) -> Timestamp {
    let fresh_for = SignedDuration::from_millis(document.policy.stale_after.millis());
    let born = revision.measured_to.min(revision.validated_at);
    let latest = now.saturating_add(MOST_AHEAD).unwrap_or(Timestamp::MAX);
    if born > latest {
        return now;
    }
    // A sum beyond the end of time never comes.
    born.checked_add(fresh_for).unwrap_or(Timestamp::MAX)
}

/// The body of a revision. Of several statuses the one that matters most to a controller is told: an
/// operator's word first, then what newer measurements say, then age, then the fate of the newest attempt;
/// the objects beside it tell of the others.
pub(super) fn validated(
    standing: &ServedState,
    revision: &RevisionRecord,
    stale_after: Timestamp,
    stale: bool,
) -> Result<Rendered, ServiceError> {
    let status = if standing.pin.is_some() {
        Status::Pinned
    } else if standing.degradation.is_some() {
        Status::Degraded
    } else if stale {
        Status::Stale
    } else if standing.fallback.is_some() {
        Status::Fallback
    } else {
        Status::Fresh
    };
    let served = |field: &str| revision.served.get(field).cloned().unwrap_or_default();
    let body = Body {
        system: standing.system.clone(),
        revision: Some(revision.revision),
        fit: Some(revision.fit.clone()),
        status,
        model: served("model"),
        parameters: served("parameters"),
        units: served("units"),
        ci95: served("ci95"),
        flags: served("flags"),
        error: served("error"),
        fitted_at: Some(revision.fitted_at),
        validated_at: Some(revision.validated_at),
        window: Some(ParamsWindow { from: revision.window_from.clone(), to: revision.window_to.clone() }),
        job: Some(revision.job.clone()),
        stale_after: Some(stale_after),
        fallback: standing.fallback.as_ref().map(|fallback| Fallback {
            reason: fallback.reason.as_str(),
            job: fallback.job.clone(),
            fit: fallback.fit.clone(),
            failed_checks: fallback.failed_checks.clone(),
            since: fallback.since,
        }),
        degraded: standing.degradation.as_ref().map(|record| degraded(&record.degradation, record.since)),
        pin: standing.pin.as_ref().map(|pin| Pin { reason: pin.reason.clone(), since: pin.since }),
        covariance: None,
    };
    render(&body, stale)
}

fn degraded(found: &Degradation, since: Timestamp) -> Degraded {
    Degraded {
        error: found.error,
        limit: found.limit,
        unit: found.unit.clone(),
        horizon: found.horizon.clone(),
        window: ParamsWindow { from: found.from.clone(), to: found.to.clone() },
        since,
    }
}

/// The nominal values of the system's model, with `null` where only measurements give one; nothing where the
/// model no longer compiles.
pub(super) fn nominal(
    system: SystemId,
    document: &SystemDocument,
    catalogue: &Catalogue,
) -> Result<Option<Rendered>, ServiceError> {
    let Some(id) = &document.model else { return Ok(None) };
    let Ok(model) = document.bindings(catalogue, id) else { return Ok(None) };
    let value = |nominal: &Nominal| match nominal {
        Nominal::Value(value) => Value::from(*value),
        Nominal::Measured(_) => Value::Null,
    };
    let named = |of: &dyn Fn(&lampyris_core::model::Parameter) -> Value| -> Value {
        Value::Object(
            model.parameters().iter().map(|parameter| (parameter.name.clone(), of(parameter))).collect(),
        )
    };
    let body = Body {
        system,
        revision: None,
        fit: None,
        status: Status::Nominal,
        model: Value::from(id.to_string()),
        parameters: named(&|parameter| value(&parameter.nominal)),
        units: named(&|parameter| Value::from(parameter.unit.clone())),
        ci95: named(&|_| Value::Null),
        flags: Value::Array(Vec::new()),
        error: Value::Object(serde_json::Map::new()),
        fitted_at: None,
        validated_at: None,
        window: None,
        job: None,
        stale_after: None,
        fallback: None,
        degraded: None,
        pin: None,
        covariance: None,
    };
    render(&body, false).map(Some)
}

fn render(body: &Body, stale: bool) -> Result<Rendered, ServiceError> {
    let text = serde_json::to_vec(body).map_err(|error| ServiceError::Internal(error.to_string()))?;
    let etag = tag_of(&text);
    Ok(Rendered { body: text.into(), etag: etag.into(), status: body.status, stale, revision: body.revision })
}

/// The tag of a body (RFC 9110, 8.8.3).
pub fn tag_of(body: &[u8]) -> String {
    format!("\"{}\"", &blake3::hash(body).to_hex()[..32])
}
