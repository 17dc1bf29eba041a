//! Live samples: rows as they are measured.

use super::access::Caller;
use super::extract::{Json, Named, Raw, unread};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::ServiceError;
use crate::service::catalogue::samples::{self, SamplesBody, SamplesSent, SystemSamples, TakenSamples};
use crate::service::decode;
use crate::service::serving::live;
use crate::service::serving::states::StateBody;
use axum::extract::State;
use lampyris_core::data::{SystemId, WindowReport};
use lampyris_core::fault::Fault;
use lampyris_core::schema::Csv;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Most systems of one request.
const MOST_SYSTEMS: usize = 10_000;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(post_samples)).routes(routes!(post_many_samples))
}

/// Samples that were taken.
#[derive(Debug, Serialize, ToSchema)]
struct SamplesAnswer {
    /// The system.
    system: SystemId,
    /// The window that takes the samples of this system and day.
    window: String,
    /// What was found in them.
    report: WindowReport,
    /// The states, as far as the inputs are measured; `null` where nothing is served, or its states are not
    /// known yet.
    state: Option<StateBody>,
}

/// Samples of several systems.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ManySamples)]
struct ManyBody {
    /// The systems with their samples.
    #[schema(max_items = 10_000)]
    samples: Vec<SystemSamples>,
}

/// What became of the samples of several systems.
#[derive(Debug, Serialize, ToSchema)]
struct ManySamplesAnswer {
    /// How many systems have samples that were taken.
    taken: usize,
    /// The others, in the order of the request.
    refused: Vec<RefusedSamples>,
}

/// Samples that were not taken.
#[derive(Debug, Serialize, ToSchema)]
struct RefusedSamples {
    /// The system.
    system: SystemId,
    /// All that is wrong.
    errors: Vec<Fault>,
}

/// Takes live samples of a system, one row or many, and answers its states now.
///
/// `{"values": {"T_room": 21.3, "T_out": 4.5}}` is one row of now; `time` and `values` may be lists, and CSV
/// is that of a window. What is no number (`unavailable`, `-`, empty) is a missing value. All samples that
/// come on one day belong to one window. They count at once, and the states go on over them at the pace of
/// the model: a sample that completes no step of it leaves them as they were.
#[utoipa::path(
    post,
    path = "/systems/{kind}/{id}/samples",
    tag = "windows",
    params(
        ("kind" = String, Path, example = "room"),
        ("id" = String, Path, example = "4"),
        ("Idempotency-Key" = Option<String>, Header, description = "Taken and not needed: the same \
            samples again change nothing"),
    ),
    request_body(content((SamplesBody = "application/json"), (Csv = "text/csv"))),
    responses((status = 200, description = "Taken", body = SamplesAnswer), Problems)
)]
async fn post_samples(
    State(service): State<Shared>,
    Named(system): Named,
    raw: Raw,
) -> Result<axum::Json<SamplesAnswer>, ApiError> {
    let sent = match raw.media_type.as_str() {
        "text/csv" => SamplesSent::Csv(raw.body.to_vec()),
        "application/json" => {
            let value = decode::parse(&raw.body).map_err(unread)?;
            SamplesSent::Json(decode::decode(value).map_err(ApiError::Invalid)?)
        }
        _ => return Err(ApiError::MediaType("application/json or text/csv")),
    };
    let taken = samples::take(&service, &system, sent).await?;
    let state = live::go_on(&service, &system, taken.from).await?;
    let state = state.map(|(revision, state)| StateBody::of(revision, state));
    Ok(axum::Json(SamplesAnswer { system, window: taken.window, report: taken.report, state }))
}

/// Takes live samples of several systems at once: those that can be taken, whatever is wrong with those of
/// others. What is no body of this form is refused as a whole.
#[utoipa::path(
    post,
    path = "/samples",
    tag = "windows",
    request_body = ManyBody,
    responses((status = 200, description = "What became of each", body = ManySamplesAnswer), Problems)
)]
async fn post_many_samples(
    State(service): State<Shared>,
    caller: Caller,
    body: Json,
) -> Result<axum::Json<ManySamplesAnswer>, ApiError> {
    let body: ManyBody = decode::decode(body.value).map_err(ApiError::Invalid)?;
    if body.samples.len() > MOST_SYSTEMS {
        let detail = format!("{} systems; {MOST_SYSTEMS} are the most", body.samples.len());
        return Err(ApiError::Invalid(vec![Fault::new("/samples", "too-many", detail)]));
    }
    let mut all = Vec::with_capacity(body.samples.len());
    for SystemSamples { system, samples } in body.samples {
        let read = if caller.may_see(&system.to_string()) {
            samples::read(&service, &system, SamplesSent::Json(samples)).await
        } else {
            Err(ServiceError::NoSystem(system.clone()))
        };
        all.push((system, read));
    }
    let (mut taken, mut refused) = (Vec::new(), Vec::new());
    for (system, outcome) in samples::take_many(&service, all).await? {
        match outcome {
            Ok(TakenSamples { from, .. }) => taken.push((system, from)),
            Err(error) => refused.push(RefusedSamples { errors: faults(error), system }),
        }
    }
    let answer = ManySamplesAnswer { taken: taken.len(), refused };
    live::go_on_behind(&service, taken);
    Ok(axum::Json(answer))
}

/// What is wrong, as faults.
fn faults(error: ServiceError) -> Vec<Fault> {
    match error {
        ServiceError::Faults(faults) => faults,
        ServiceError::NoSystem(_) => vec![Fault::new("/system", "system-not-found", error.to_string())],
        other => vec![Fault::new("", "internal", other.to_string())],
    }
}
