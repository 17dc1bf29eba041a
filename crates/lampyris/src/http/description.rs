//! Completes what the handlers say of themselves: what holds for every path is said once, here.

use super::access::declared;
use super::examples;
use super::problem::{PROBLEM_JSON, Problem};
use lampyris_core::schema::{flattened, joined, text};
use serde::Serialize;
use serde_json::Value;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::marker::PhantomData;
use utoipa::openapi::path::{Operation, Parameter, ParameterIn, PathItem};
use utoipa::openapi::schema::{AdditionalProperties, ArrayBuilder, OneOf, SchemaType, Type};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{ContentBuilder, OpenApi, Ref, RefOr, Required, ResponseBuilder, Schema};
use utoipa::{PartialSchema, ToSchema};

/// The refusals that the shape of an operation implies: status, name and description.
const REFUSALS: [(&str, &str, &str); 10] = [
    ("400", "Malformed", "The body is no JSON, or ended early"),
    ("401", "Unauthorized", "There are tokens, and none that is good was sent"),
    ("403", "Forbidden", "The token is not good for this: `scope` names what is needed"),
    ("404", "NotFound", "There is no such thing, or none that the token may see"),
    ("413", "TooLarge", "The body is larger than `limit` bytes"),
    ("415", "MediaType", "`Content-Type` does not say what the body must be, or the body is compressed"),
    ("422", "Invalid", "The request has faults; all of them are listed"),
    (
        "429",
        "TooManyFailures",
        "So many wrong tokens came from this address; `Retry-After` says when another one is judged",
    ),
    ("500", "Internal", "A fault of the service"),
    ("503", "Unavailable", "The database cannot do this now; `Retry-After` says when to ask again"),
];

/// What the description calls the tokens.
const TOKEN: &str = "token";

/// What an answer adds and a document that it repeats: one object.
#[derive(Debug, Serialize)]
pub struct With<A, B> {
    /// What comes first. It gives the object its name.
    #[serde(flatten)]
    pub own: A,
    /// What follows.
    #[serde(flatten)]
    pub document: B,
}

impl<A: ToSchema, B: ToSchema> PartialSchema for With<A, B> {
    fn schema() -> RefOr<Schema> {
        joined([A::schema(), B::schema()], false).into()
    }
}

impl<A: ToSchema, B: ToSchema> ToSchema for With<A, B> {
    fn name() -> Cow<'static, str> {
        A::name()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        A::schemas(schemas);
        B::schemas(schemas);
    }
}

/// A document as it was stored, described as what it was made from.
#[derive(Debug, Serialize)]
#[serde(transparent)]
pub struct Stored<T> {
    document: Value,
    described: PhantomData<T>,
}

impl<T> Stored<T> {
    /// This document, which a `T` was written to.
    pub const fn of(document: Value) -> Self {
        Self { document, described: PhantomData }
    }
}

impl<T: ToSchema> PartialSchema for Stored<T> {
    fn schema() -> RefOr<Schema> {
        T::schema()
    }
}

impl<T: ToSchema> ToSchema for Stored<T> {
    fn name() -> Cow<'static, str> {
        T::name()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        T::schemas(schemas);
    }
}

/// The description with all that follows from the shape of a path.
pub fn completed(mut description: OpenApi) -> OpenApi {
    for (path, item) in &mut description.paths.paths {
        for (method, operation) in operations(item) {
            for parameter in operation.parameters.iter_mut().flatten() {
                if let RefOr::T(parameter) = parameter {
                    complete_parameter(path, parameter);
                }
            }
            complete_responses(method, operation);
            secure(operation);
            examples::attach(operation);
        }
    }
    if let Some(components) = &mut description.components {
        let text = "A token of `lampyris token create`. A service without any token answers its own machine \
            without one. The names after `token` are the scopes `read`, `operate` and `admin`; each includes \
            those before it.";
        let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(text)).build();
        components.add_security_scheme(TOKEN, SecurityScheme::Http(bearer));
        for (_, name, text) in REFUSALS {
            let content = ContentBuilder::new().schema(Some(Ref::from_schema_name(Problem::name()))).build();
            let response = ResponseBuilder::new().description(text).content(PROBLEM_JSON, content).build();
            components.responses.insert(name.to_owned(), RefOr::T(response));
        }
        let names: BTreeSet<String> = components.schemas.keys().cloned().collect();
        for (name, schema) in &mut components.schemas {
            complete_schema(name, schema, &names);
        }
    }
    description
}

/// Flattened fields stand beside the others; what a page lists is named, not repeated; alternatives that are
/// told apart by a word know no other fields.
fn complete_schema(name: &str, schema: &mut RefOr<Schema>, names: &BTreeSet<String>) {
    if let RefOr::T(Schema::AllOf(all_of)) = schema {
        *schema = flattened(std::mem::take(all_of)).into();
    }
    match (schema, name.strip_prefix("Page_")) {
        (RefOr::T(Schema::Object(page)), Some(item)) if names.contains(item) => {
            let items =
                ArrayBuilder::new().items(Ref::from_schema_name(item)).description(Some("What is on it."));
            page.properties.insert("items".to_owned(), items.into());
        }
        (RefOr::T(Schema::OneOf(one_of)), _) => {
            for item in &mut one_of.items {
                if let RefOr::T(Schema::Object(object)) = item
                    && !object.properties.is_empty()
                {
                    object.additional_properties = Some(Box::new(AdditionalProperties::FreeForm(false)));
                }
            }
        }
        _ => {}
    }
}

/// Every operation: its path, its method in capitals, and its id.
pub fn ids(description: &mut OpenApi) -> Vec<(String, &'static str, String)> {
    let mut ids = Vec::new();
    for (path, item) in &mut description.paths.paths {
        ids.extend(operations(item).map(|(method, operation)| {
            (path.clone(), method, operation.operation_id.clone().unwrap_or_default())
        }));
    }
    ids
}

/// The names of the query of every path that has one, by path and method in capitals.
pub fn queries(mut description: OpenApi) -> BTreeSet<(String, &'static str)> {
    let mut asking = BTreeSet::new();
    for (path, item) in &mut description.paths.paths {
        for (method, operation) in operations(item) {
            if has(operation, &ParameterIn::Query) {
                asking.insert((path.clone(), method));
            }
        }
    }
    asking
}

fn operations(item: &mut PathItem) -> impl Iterator<Item = (&'static str, &mut Operation)> {
    let all = [
        ("GET", &mut item.get),
        ("PUT", &mut item.put),
        ("POST", &mut item.post),
        ("DELETE", &mut item.delete),
        ("PATCH", &mut item.patch),
    ];
    all.into_iter().filter_map(|(method, operation)| Some((method, operation.as_mut()?)))
}

fn has(operation: &Operation, place: &ParameterIn) -> bool {
    operation
        .parameters
        .iter()
        .flatten()
        .any(|parameter| matches!(parameter, RefOr::T(parameter) if parameter.parameter_in == *place))
}

/// Says what a parameter may be, where its name says it.
fn complete_parameter(path: &str, parameter: &mut Parameter) {
    let named = match parameter.name.as_str() {
        "kind" if path.contains("/{kind}/{id}") => {
            Some((text("^[a-z]{1,32}$").examples(["room"]), "The kind of the system."))
        }
        "id" if path.contains("/{kind}/{id}") => {
            Some((text("^[A-Za-z0-9_-]{1,64}$").examples(["4"]), "The system within its kind."))
        }
        // Without an example: a key that everybody copies belongs to somebody else's request.
        "Idempotency-Key" => Some((
            text("^[!-~]([ -~]{0,253}[!-~])?$"),
            "The same request with the same key is done once. The key of another request is refused.",
        )),
        _ => None,
    };
    if let Some((schema, description)) = named {
        parameter.schema = Some(schema.into());
        parameter.description = Some(description.to_owned());
    }
    // A parameter is there or it is not; it cannot be null.
    if let Some(RefOr::T(schema)) = &mut parameter.schema {
        without_null(schema);
    }
}

fn without_null(schema: &mut Schema) {
    match schema {
        Schema::Object(object) => {
            if let SchemaType::Array(types) = &mut object.schema_type {
                types.retain(|one| *one != Type::Null);
                if let [only] = types.as_slice() {
                    object.schema_type = SchemaType::Type(only.clone());
                }
            }
        }
        Schema::OneOf(OneOf { items, .. }) => {
            items.retain(|item| {
                !matches!(
                    item,
                    RefOr::T(Schema::Object(object)) if object.schema_type == SchemaType::Type(Type::Null)
                )
            });
        }
        _ => {}
    }
}

/// Says which scope an operation needs, and how it is refused without.
fn secure(operation: &mut Operation) {
    let (needed, _) = declared(operation.operation_id.as_deref().unwrap_or_default());
    operation.security =
        Some(needed.iter().map(|scope| SecurityRequirement::new(TOKEN, [scope.as_str()])).collect());
    if needed.is_some() {
        for (status, name, _) in REFUSALS.iter().filter(|(status, ..)| ["401", "403", "429"].contains(status))
        {
            operation
                .responses
                .responses
                .entry((*status).to_owned())
                .or_insert_with(|| Ref::from_response_name(*name).into());
        }
    }
}

/// Says whether a body is needed, and puts the refusals that the shape of an operation implies in the place
/// of `default`. Those that only some operations know, such as 409 and 429, are theirs to say.
fn complete_responses(method: &str, operation: &mut Operation) {
    // A body is needed, but for lines of text: without one there are none.
    if let Some(RefOr::T(body)) = &mut operation.request_body
        && !body.content.contains_key("text/plain")
    {
        body.required.get_or_insert(Required::True);
    }
    // An answer that nothing more is said of is what the operation promises.
    for response in operation.responses.responses.values_mut() {
        if let RefOr::T(response) = response
            && response.description.is_empty()
        {
            response.description = operation.summary.clone().unwrap_or_default();
        }
    }
    if operation.responses.responses.remove("default").is_none() {
        return;
    }
    let has_path = has(operation, &ParameterIn::Path);
    for (status, name, _) in REFUSALS {
        let is_possible = match status {
            "400" | "413" => method != "GET",
            "404" => has_path,
            "415" => operation.request_body.is_some(),
            // These come with what an operation needs.
            "401" | "403" | "429" => false,
            _ => true,
        };
        if is_possible {
            operation
                .responses
                .responses
                .entry(status.to_owned())
                .or_insert_with(|| Ref::from_response_name(name).into());
        }
    }
}
