//! What operators did.

use super::access::Caller;
use super::extract::Asked;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::store;
use crate::store::audit::{Action, DeedRecord};
use axum::extract::State;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_audit))
}

/// Something that was done.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AuditEntry)]
struct EntryAnswer {
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    /// The name of the token; `local` where no token was needed, `service` for what the service did by
    /// itself.
    who: String,
    action: Action,
    /// The system, where it is about one. It may be gone.
    system: Option<SystemId>,
    /// To what: a fit, a window, a system, a schedule, a model, an effect, a token.
    subject: String,
    /// Why, where a reason is asked for.
    reason: Option<String>,
}

/// Which entries.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct AuditQuery {
    /// Only what was done to this system.
    system: Option<SystemId>,
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

/// What operators did, newest first: who let a fit out, pinned, deleted, changed a schedule, made a token,
/// and why.
///
/// A token that is good for some systems is shown what was done to these.
#[utoipa::path(
    get,
    path = "/audit",
    tag = "service",
    params(AuditQuery),
    responses((status = 200, body = Page<EntryAnswer>), Problems)
)]
async fn list_audit(
    State(service): State<Shared>,
    caller: Caller,
    Asked(query): Asked<AuditQuery>,
) -> Result<axum::Json<Page<EntryAnswer>>, ApiError> {
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let size = page.size()?;
    let records =
        store::audit::page(&service.store, caller.reach(), query.system.as_ref(), page.before()?, size + 1)
            .await?;
    let entry = |record: DeedRecord| EntryAnswer {
        at: record.at,
        who: record.who,
        action: record.action,
        system: record.system,
        subject: record.subject,
        reason: record.reason,
    };
    Ok(axum::Json(Page::of(records, size, |record| record.sequence.to_string(), entry)))
}
