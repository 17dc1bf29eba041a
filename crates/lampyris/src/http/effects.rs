//! Effects: documents that add a term to a model, and how many systems have them.

use super::access::Caller;
use super::extract::{Asked, JsonOrToml};
use super::models::{created, paged};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::Shared;
use crate::service::catalogue::models;
use crate::service::catalogue::proposed::{is_tried, systems_by_effect};
use crate::store::reach::SystemScope;
use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use lampyris_core::model::spec::EffectSpec;
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_effects, post_effect)).routes(routes!(get_effect))
}

/// An effect, and who has it.
#[derive(Debug, Serialize, ToSchema)]
struct ListedEffect {
    /// How many of the systems that the caller may see have it in their model.
    systems: usize,
    /// Whether diagnoses try it wherever what it reads is measured. What was proposed for one system
    /// (`proposed_...`) has to be in the models of three first.
    tried: bool,
    #[serde(flatten)]
    #[schema(inline)]
    effect: EffectSpec,
}

/// All effects: the built-in ones and those of users, each with how many systems have it.
#[utoipa::path(
    get,
    path = "/effects",
    tag = "effects",
    params(PageQuery),
    responses((status = 200, body = Page<ListedEffect>), Problems)
)]
async fn list_effects(
    State(service): State<Shared>,
    caller: Caller,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<ListedEffect>>, ApiError> {
    let all = systems_by_effect(&service, &SystemScope::ALL).await?;
    let reach = caller.reach();
    let seen = if reach.is_all() { all.clone() } else { systems_by_effect(&service, reach).await? };
    let listed = |effect: &EffectSpec| {
        let systems = seen.get(&effect.id).copied().unwrap_or_default();
        ListedEffect { systems, tried: is_tried(&effect.id, &all), effect: effect.clone() }
    };
    let effects = service.catalogue.current().effects().map(listed).collect();
    paged(effects, &page, |listed| &listed.effect.id)
}

/// Takes an effect document, in JSON, or in TOML where `Content-Type` says `application/toml`.
#[utoipa::path(
    post,
    path = "/effects",
    tag = "effects",
    params(("Idempotency-Key" = Option<String>, Header)),
    request_body = EffectSpec,
    responses(
        (status = 200, description = "It was there already", body = EffectSpec),
        (
            status = 201,
            description = "Taken; `Location` leads to it",
            body = EffectSpec,
            headers(("Location" = String))
        ),
        (
            status = 409,
            description = "Another document has this id",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems,
    )
)]
async fn post_effect(
    State(service): State<Shared>,
    caller: Caller,
    JsonOrToml(body): JsonOrToml,
) -> Result<Response, ApiError> {
    let taken = models::create_effect(&service, body.value, caller.name(), body.key.as_ref())
        .await
        .map_err(ApiError::of_document)?;
    let location = format!("/effects/{}", taken.thing.id);
    Ok((created(taken.is_new), [(header::LOCATION, location)], axum::Json(taken.thing)).into_response())
}

/// One effect.
#[utoipa::path(
    get,
    path = "/effects/{id}",
    tag = "effects",
    params(("id" = String, Path)),
    responses((status = 200, body = EffectSpec), Problems)
)]
async fn get_effect(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<EffectSpec>, ApiError> {
    let catalogue = service.catalogue.current();
    let effect = catalogue.effect_document(&id).cloned();
    effect.map(axum::Json).ok_or(ApiError::NotFound("effect", id))
}
