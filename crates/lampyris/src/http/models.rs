//! Models: documents that say what physics is thought to be at work.

use super::access::Caller;
use super::extract::{Asked, Json, JsonOrToml};
use super::language;
use super::negotiate::rendered;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::{Shared, shared_body};
use crate::service::ServiceError;
use crate::service::blocking;
use crate::service::catalogue::models::{self, AddedEffect, ModelDiff, ModelVersion};
use crate::service::catalogue::windows::Format;
use crate::store;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use lampyris_core::fault::Fault;
use lampyris_core::interrupt::Brake;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::ModelSpec;
use lampyris_core::model::{Input, InputHold, Model, ModelId, Nominal, Output, Parameter, Scale};
use lampyris_core::schema::Interval;
use serde::Serialize;
use serde_json::Value;
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
    id: ModelId,
    /// A title for people.
    title: String,
    /// The model that it was made from, where an effect was added.
    parent: Option<ModelId>,
    /// What was added.
    #[schema(value_type = Option<ModelDiff>)]
    diff: Option<Value>,
    /// Hash of its content.
    hash: String,
    /// The effects that take part.
    effects: Vec<String>,
    /// The sets that a system binds.
    sets: Vec<String>,
    /// States with their units.
    states: Vec<ModelState>,
    /// Inputs with channels and units.
    inputs: Vec<ModelInput>,
    /// Parameters with units, bounds, scale and nominal value.
    parameters: Vec<ModelParameter>,
    /// Outputs with units and sensor noise.
    outputs: Vec<ModelOutput>,
    /// The document of its base, as it was posted.
    document: Option<ModelDocument>,
    /// The whole model with all equations, where the document is that of a plant.
    expanded: Option<ModelSpec>,
}

/// A state of a compiled model.
#[derive(Debug, Serialize, ToSchema)]
struct ModelState {
    name: String,
    unit: String,
}

/// An input of a compiled model.
#[derive(Debug, Serialize, ToSchema)]
struct ModelInput {
    name: String,
    /// The channel that it is read from.
    channel: String,
    unit: String,
    hold: InputHold,
}

/// A parameter of a compiled model.
#[derive(Debug, Serialize, ToSchema)]
struct ModelParameter {
    name: String,
    unit: String,
    #[schema(value_type = Interval)]
    bounds: [f64; 2],
    scale: Scale,
    /// A number, or the channel whose first samples give it.
    nominal: Nominal,
    title: String,
}

/// An output of a compiled model.
#[derive(Debug, Serialize, ToSchema)]
struct ModelOutput {
    channel: String,
    unit: String,
    /// Standard deviation of the sensor's noise.
    noise_sd: f64,
}

/// What a dry run found.
#[derive(Debug, Serialize, ToSchema)]
struct ModelCheck {
    /// Whether the document would be taken.
    valid: bool,
    /// Every fault.
    errors: Vec<Fault>,
    /// The page about the language of models, where there are faults.
    #[serde(skip_serializing_if = "Option::is_none")]
    see: Option<&'static str>,
}

/// All models: the built-in ones, those of users, and those made by adding effects.
#[utoipa::path(
    get,
    path = "/models",
    tag = "models",
    params(PageQuery),
    responses((status = 200, body = Page<ModelRow>), Problems)
)]
async fn list_models(
    State(service): State<Shared>,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<ModelRow>>, ApiError> {
    let catalogue = service.catalogue.current();
    let mut rows: Vec<ModelRow> = catalogue
        .models()
        .map(|document| ModelRow {
            id: document.id().to_owned(),
            title: document.title().to_owned(),
            parent: None,
        })
        .collect();
    for version in store::models::versions(&service.store).await? {
        let base = catalogue
            .model(version.id.base())
            .map_or_else(String::new, |document| document.title().to_owned());
        let title =
            version.document.pointer("/diff/title").and_then(Value::as_str).unwrap_or(&version.effect);
        rows.push(ModelRow {
            title: format!("{base} + {title}"),
            id: version.id.to_string(),
            parent: Some(version.parent.to_string()),
        });
    }
    rows.sort_by(|a, b| a.id.cmp(&b.id));
    paged(rows, &page, |row| &row.id)
}

/// One page of a list that is in memory, by id.
pub(super) fn paged<T: Serialize>(
    rows: Vec<T>,
    page: &PageQuery,
    id: impl Fn(&T) -> &str,
) -> Result<axum::Json<Page<T>>, ApiError> {
    let size = page.size()?;
    let after = page.page_token.as_deref().unwrap_or_default();
    let limit = usize::try_from(size).unwrap_or(usize::MAX).saturating_add(1);
    let rows = rows.into_iter().filter(|row| id(row) > after).take(limit).collect();
    Ok(axum::Json(Page::of(rows, size, |row| id(row).to_owned(), |row| row)))
}

/// Takes a model document, in JSON, or in TOML where `Content-Type` says `application/toml`. Documents never
/// change: another one with the same id is refused.
#[utoipa::path(
    post,
    path = "/models",
    tag = "models",
    params(("Idempotency-Key" = Option<String>, Header)),
    request_body = ModelDocument,
    responses(
        (status = 200, description = "It was there already", body = ModelAnswer),
        (
            status = 201,
            description = "Taken; `Location` leads to it",
            body = ModelAnswer,
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
async fn post_model(
    State(service): State<Shared>,
    caller: Caller,
    JsonOrToml(body): JsonOrToml,
) -> Result<Response, ApiError> {
    let taken = models::create(&service, body.value, caller.name(), body.key.as_ref())
        .await
        .map_err(ApiError::of_document)?;
    let id = taken.thing.id().to_owned();
    let answer = describe(&service, parse_id(&id)?).await?;
    Ok((created(taken.is_new), [(header::LOCATION, format!("/models/{id}"))], axum::Json(answer))
        .into_response())
}

/// Says what is wrong with a model document without taking it.
#[utoipa::path(
    post,
    path = "/models/validate",
    tag = "models",
    request_body(content = Object, description = "What is thought to be a model document"),
    responses((status = 200, body = ModelCheck), Problems)
)]
async fn validate_model(State(service): State<Shared>, body: Json) -> Result<Response, ApiError> {
    if !body.value.is_object() {
        return Err(ApiError::Invalid(vec![Fault::new("", "wrong-type", "a model document is an object")]));
    }
    let catalogue = service.catalogue.current();
    let work = move |_: &Brake| {
        let errors = models::check_model(&catalogue, body.value).err().unwrap_or_default();
        let see = (!errors.is_empty()).then_some(language::PAGE);
        serde_json::to_vec(&ModelCheck { valid: errors.is_empty(), errors, see })
            .map_err(|error| ServiceError::Internal(error.to_string()))
    };
    Ok(rendered(Format::Json, shared_body(service.interactive.once(work).await?)))
}

/// One model.
#[utoipa::path(
    get,
    path = "/models/{id}",
    tag = "models",
    params(("id" = String, Path, example = "room3")),
    responses((status = 200, body = ModelAnswer), Problems)
)]
async fn get_model(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<ModelAnswer>, ApiError> {
    describe(&service, parse_id(&id)?).await.map(axum::Json)
}

/// Makes a model by adding an effect: one of the catalogue by name, or a whole document.
#[utoipa::path(
    post,
    path = "/models/{id}/effects",
    tag = "models",
    params(("id" = String, Path, example = "room3"), ("Idempotency-Key" = Option<String>, Header)),
    request_body = AddedEffect,
    responses(
        (status = 200, description = "It was there already", body = ModelVersion),
        (
            status = 201,
            description = "Made; `Location` leads to it",
            body = ModelVersion,
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
async fn post_model_effect(
    State(service): State<Shared>,
    caller: Caller,
    Path(id): Path<String>,
    body: Json,
) -> Result<Response, ApiError> {
    let parent = parse_id(&id)?;
    let taken = models::add_effect(&service, &parent, body.value, caller.name(), body.key.as_ref())
        .await
        .map_err(ApiError::of_document)?;
    let location = format!("/models/{}", taken.thing.id);
    Ok((created(taken.is_new), [(header::LOCATION, location)], axum::Json(taken.thing)).into_response())
}

pub(super) fn created(is_new: bool) -> StatusCode {
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
    let base = catalogue.model(id.base()).cloned();
    let expanded = base.as_ref().and_then(|document| catalogue.expanded(document));
    let sets = catalogue.compose(&id).map_or_else(|_| Vec::new(), |composition| composition.spec.sets);
    let name = id.clone();
    let model = blocking(move || models::compiled(&catalogue, &name))
        .await?
        .map_err(|_| ApiError::NotFound("model", id.to_string()))?;
    let (parent, diff) = match version {
        Some(version) => (Some(version.parent), version.document.get("diff").cloned()),
        None => (None, None),
    };
    Ok(ModelAnswer { parent, diff, sets, expanded, ..answer(id, &model, base) })
}

/// A model as `GET /models/{id}` shows it, where there is no service that knows how it came about.
///
/// # Errors
/// Where it cannot be written.
pub fn document(id: ModelId, model: &Model, base: Option<ModelDocument>) -> Result<Value, serde_json::Error> {
    serde_json::to_value(answer(id, model, base))
}

/// A model as it is shown, without what only the service knows of it.
fn answer(id: ModelId, model: &Model, document: Option<ModelDocument>) -> ModelAnswer {
    let state = |state: &lampyris_core::model::State| ModelState {
        name: state.name.clone(),
        unit: state.unit.clone(),
    };
    let input = |input: &Input| ModelInput {
        name: input.name.clone(),
        channel: input.channel.clone(),
        unit: input.unit.clone(),
        hold: input.hold,
    };
    let parameter = |parameter: &Parameter| ModelParameter {
        name: parameter.name.clone(),
        unit: parameter.unit.clone(),
        bounds: [parameter.lower, parameter.upper],
        scale: parameter.scale,
        nominal: parameter.nominal.clone(),
        title: parameter.title.clone(),
    };
    let output = |output: &Output| ModelOutput {
        channel: output.channel.clone(),
        unit: output.unit.clone(),
        noise_sd: output.noise_sd,
    };
    ModelAnswer {
        id,
        title: model.title().to_owned(),
        parent: None,
        diff: None,
        sets: Vec::new(),
        hash: model.hash().to_owned(),
        effects: model.effects().to_vec(),
        states: model.states().iter().map(state).collect(),
        inputs: model.inputs().iter().map(input).collect(),
        parameters: model.parameters().iter().map(parameter).collect(),
        outputs: model.outputs().iter().map(output).collect(),
        document,
        expanded: None,
    }
}
