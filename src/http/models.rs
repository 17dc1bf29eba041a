//! Models and effects: documents that say what physics is thought to be at work.

use super::Shared;
use super::extract::{Asked, Json};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use crate::fault::Fault;
use crate::jobs::{blocking, models};
use crate::model::spec::{EffectSpec, ModelDocument};
use crate::model::{Model, ModelId, Nominal};
use crate::store;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Value, json};
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(list_models, post_model))
        .routes(routes!(validate_model))
        .routes(routes!(get_model))
        .routes(routes!(post_model_effect))
        .routes(routes!(list_effects, post_effect))
        .routes(routes!(get_effect))
}

/// One model in a list.
#[derive(Debug, Serialize, ToSchema)]
struct ModelRow {
    /// Its id.
    #[schema(example = "room3+wind_infiltration")]
    id: String,
    /// A title for people.
    title: String,
    /// The model that it was made from, where an effect was added.
    parent: Option<String>,
}

/// A model, compiled with everything that its documents name.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Model)]
struct ModelAnswer {
    /// Its id.
    id: String,
    /// A title for people.
    title: String,
    /// The model that it was made from, where an effect was added.
    parent: Option<String>,
    /// What was added.
    diff: Option<Value>,
    /// Hash of its content.
    hash: String,
    /// The effects that take part.
    effects: Vec<String>,
    /// The sets that a system binds.
    sets: Vec<String>,
    /// States with their units.
    states: Vec<Value>,
    /// Inputs with channels and units.
    inputs: Vec<Value>,
    /// Parameters with units, bounds, scale and nominal value.
    parameters: Vec<Value>,
    /// Outputs with units and sensor noise.
    outputs: Vec<Value>,
    /// The document of its base.
    document: Value,
}

/// What a dry run found.
#[derive(Debug, Serialize, ToSchema)]
struct ModelCheck {
    /// Whether the document would be taken.
    valid: bool,
    /// Every fault.
    #[schema(value_type = Vec<super::problem::ProblemFault>)]
    errors: Vec<Fault>,
}

/// A model made by adding an effect.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes the document that `jobs::models` makes")]
struct VersionAnswer {
    /// Its id.
    id: String,
    /// The model that it was made from.
    parent: String,
    /// What was added.
    diff: Value,
    /// Hash of its content.
    hash: String,
}

/// All models: the built-in ones, those of users, and those made by adding effects.
#[utoipa::path(get, path = "/models", tag = "models", params(PageQuery), responses((status = 200, body = Page<ModelRow>), Problems))]
async fn list_models(State(service): State<Shared>, Asked(page): Asked<PageQuery>) -> Result<axum::Json<Page<ModelRow>>, ApiError> {
    let catalogue = service.catalogue.current();
    let mut rows: Vec<ModelRow> = catalogue
        .models()
        .map(|document| ModelRow { id: document.id().to_owned(), title: document.title().to_owned(), parent: None })
        .collect();
    for version in store::models::versions(&service.store).await? {
        let base = catalogue.model(version.id.base()).map_or_else(String::new, |document| document.title().to_owned());
        let title = version.document.pointer("/diff/title").and_then(Value::as_str).unwrap_or(&version.effect);
        rows.push(ModelRow { title: format!("{base} + {title}"), id: version.id.to_string(), parent: Some(version.parent.to_string()) });
    }
    rows.sort_by(|a, b| a.id.cmp(&b.id));
    paged(rows, &page, |row| &row.id)
}

/// One page of a list that is in memory, by id.
fn paged<T: Serialize>(rows: Vec<T>, page: &PageQuery, id: impl Fn(&T) -> &str) -> Result<axum::Json<Page<T>>, ApiError> {
    let size = page.size()?;
    let after = page.page_token.as_deref().unwrap_or_default();
    let limit = usize::try_from(size).unwrap_or(usize::MAX).saturating_add(1);
    let rows = rows.into_iter().filter(|row| id(row) > after).take(limit).collect();
    Ok(axum::Json(Page::of(rows, size, |row| id(row).to_owned(), |row| row)))
}

/// Takes a model document. Documents never change: another one with the same id is refused.
#[utoipa::path(
    post,
    path = "/models",
    tag = "models",
    params(("Idempotency-Key" = Option<String>, Header)),
    request_body(content = Object, description = "A model document; config/models has examples"),
    responses((status = 200, description = "It was there already", body = ModelAnswer), (status = 201, description = "Taken", body = ModelAnswer), Problems)
)]
async fn post_model(State(service): State<Shared>, body: Json) -> Result<Response, ApiError> {
    let taken = models::create(&service, body.value, body.key.as_ref()).await?;
    let id = taken.thing.id().to_owned();
    let answer = describe(&service, parse_id(&id)?).await?;
    Ok((created(taken.is_new), [(header::LOCATION, format!("/models/{id}"))], axum::Json(answer)).into_response())
}

/// Says what is wrong with a model document without taking it.
#[utoipa::path(
    post,
    path = "/models/validate",
    tag = "models",
    request_body(content = Object, description = "A model document"),
    responses((status = 200, body = ModelCheck), Problems)
)]
async fn validate_model(State(service): State<Shared>, body: Json) -> Result<axum::Json<ModelCheck>, ApiError> {
    let catalogue = service.catalogue.current();
    let errors = blocking(move || models::check_model(&catalogue, body.value).err().unwrap_or_default()).await?;
    Ok(axum::Json(ModelCheck { valid: errors.is_empty(), errors }))
}

/// One model.
#[utoipa::path(
    get,
    path = "/models/{id}",
    tag = "models",
    params(("id" = String, Path, example = "room3")),
    responses((status = 200, body = ModelAnswer), Problems)
)]
async fn get_model(State(service): State<Shared>, Path(id): Path<String>) -> Result<axum::Json<ModelAnswer>, ApiError> {
    describe(&service, parse_id(&id)?).await.map(axum::Json)
}

/// Makes a model by adding an effect: one of the catalogue by name, or a whole document.
#[utoipa::path(
    post,
    path = "/models/{id}/effects",
    tag = "models",
    params(("id" = String, Path, example = "room3"), ("Idempotency-Key" = Option<String>, Header)),
    request_body(content = Object, description = "`{\"effect\": \"wind_infiltration\"}` or an effect document", example = json!({"effect": "wind_infiltration"})),
    responses((status = 200, description = "It was there already", body = VersionAnswer), (status = 201, description = "Made", body = VersionAnswer), Problems)
)]
async fn post_model_effect(State(service): State<Shared>, Path(id): Path<String>, body: Json) -> Result<Response, ApiError> {
    let parent = parse_id(&id)?;
    let taken = models::add_effect(&service, &parent, body.value, body.key.as_ref()).await?;
    let location = format!("/models/{}", taken.thing.get("id").and_then(Value::as_str).unwrap_or_default());
    Ok((created(taken.is_new), [(header::LOCATION, location)], axum::Json(taken.thing)).into_response())
}

/// All effects: the built-in ones and those of users.
#[utoipa::path(get, path = "/effects", tag = "effects", params(PageQuery), responses((status = 200, body = Page<Value>), Problems))]
async fn list_effects(State(service): State<Shared>, Asked(page): Asked<PageQuery>) -> Result<axum::Json<Page<EffectSpec>>, ApiError> {
    paged(service.catalogue.current().effects().cloned().collect(), &page, |effect| &effect.id)
}

/// Takes an effect document.
#[utoipa::path(
    post,
    path = "/effects",
    tag = "effects",
    params(("Idempotency-Key" = Option<String>, Header)),
    request_body(content = Object, description = "An effect document; config/effects has examples"),
    responses((status = 200, description = "It was there already", body = Object), (status = 201, description = "Taken", body = Object), Problems)
)]
async fn post_effect(State(service): State<Shared>, body: Json) -> Result<Response, ApiError> {
    let taken = models::create_effect(&service, body.value, body.key.as_ref()).await?;
    let location = format!("/effects/{}", taken.thing.id);
    Ok((created(taken.is_new), [(header::LOCATION, location)], axum::Json(taken.thing)).into_response())
}

/// One effect.
#[utoipa::path(get, path = "/effects/{id}", tag = "effects", params(("id" = String, Path)), responses((status = 200, body = Object), Problems))]
async fn get_effect(State(service): State<Shared>, Path(id): Path<String>) -> Result<axum::Json<EffectSpec>, ApiError> {
    let catalogue = service.catalogue.current();
    let effect = catalogue.effects().find(|effect| effect.id == id).cloned();
    effect.map(axum::Json).ok_or(ApiError::NotFound("effect", id))
}

fn created(is_new: bool) -> StatusCode {
    if is_new { StatusCode::CREATED } else { StatusCode::OK }
}

/// A text that is no model id names no model.
fn parse_id(text: &str) -> Result<ModelId, ApiError> {
    text.parse().map_err(|_| ApiError::NotFound("model", text.to_owned()))
}

async fn describe(service: &Shared, id: ModelId) -> Result<ModelAnswer, ApiError> {
    let catalogue = service.catalogue.current();
    let versions = store::models::versions(&service.store).await?;
    let version = versions.into_iter().find(|version| version.id == id);
    let name = id.to_string();
    let base = catalogue.model(id.base()).cloned();
    let sets = catalogue.compose(&id).map_or_else(|_| Vec::new(), |composition| composition.spec.sets);
    let model = blocking(move || models::compiled(&catalogue, &id)).await?.map_err(|_| ApiError::NotFound("model", name.clone()))?;
    let (parent, diff) = match version {
        Some(version) => (Some(version.parent.to_string()), version.document.get("diff").cloned()),
        None => (None, None),
    };
    let answer = answer(name, &model, base.as_ref());
    Ok(ModelAnswer { parent, diff, sets, ..answer })
}

/// A model as it is shown, without what only the service knows of it.
fn answer(id: String, model: &Model, base: Option<&ModelDocument>) -> ModelAnswer {
    let nominal = |nominal: &Nominal| match nominal {
        Nominal::Value(value) => json!(value),
        Nominal::Measured(channel) => json!(channel),
    };
    ModelAnswer {
        id,
        title: model.title().to_owned(),
        parent: None,
        diff: None,
        sets: Vec::new(),
        hash: model.hash().to_owned(),
        effects: model.effects().to_vec(),
        states: model.states().iter().map(|state| json!({"name": state.name, "unit": state.unit})).collect(),
        inputs: model.inputs().iter().map(|input| json!({"name": input.name, "channel": input.channel, "unit": input.unit, "hold": input.hold})).collect(),
        parameters: model
            .parameters()
            .iter()
            .map(|parameter| {
                json!({"name": parameter.name, "unit": parameter.unit, "bounds": [parameter.lower, parameter.upper], "scale": parameter.scale,
                       "nominal": nominal(&parameter.nominal), "title": parameter.title})
            })
            .collect(),
        outputs: model.outputs().iter().map(|output| json!({"channel": output.channel, "unit": output.unit, "noise_sd": output.noise_sd})).collect(),
        document: base.and_then(|document| serde_json::to_value(document).ok()).unwrap_or_default(),
    }
}
