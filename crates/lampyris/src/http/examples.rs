//! Examples for the description: what may be sent to each operation, and what it answers.
//!
//! They are documents of their own (`examples/*.json`), by the id of the operation and the media type. The
//! check of the contract sends every request to a running service and holds every answer against its schema.

use indexmap::IndexMap;
use serde::Deserialize;
use serde_json::Value;
use std::sync::LazyLock;
use utoipa::openapi::example::ExampleBuilder;
use utoipa::openapi::path::Operation;
use utoipa::openapi::{Content, RefOr};

/// One per group of paths.
const DOCUMENTS: [&str; 10] = [
    include_str!("examples/audit.json"),
    include_str!("examples/comparison.json"),
    include_str!("examples/diagnoses.json"),
    include_str!("examples/fits.json"),
    include_str!("examples/influx.json"),
    include_str!("examples/jobs.json"),
    include_str!("examples/models.json"),
    include_str!("examples/params.json"),
    include_str!("examples/service.json"),
    include_str!("examples/systems.json"),
];

/// The examples of one operation.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Examples {
    /// By media type and name.
    #[serde(default)]
    requests: IndexMap<String, IndexMap<String, Value>>,
    /// What is answered to a success, by media type.
    #[serde(default)]
    answers: IndexMap<String, Value>,
}

fn read() -> Result<IndexMap<String, Examples>, serde_json::Error> {
    let mut all = IndexMap::new();
    for document in DOCUMENTS {
        all.extend(serde_json::from_str::<IndexMap<String, Examples>>(document)?);
    }
    Ok(all)
}

/// Writes the examples of an operation into its description.
pub fn attach(operation: &mut Operation) {
    // A document that cannot be read leaves its operations without examples, which a test forbids.
    static ALL: LazyLock<IndexMap<String, Examples>> = LazyLock::new(|| read().unwrap_or_default());
    let Some(examples) = operation.operation_id.as_ref().and_then(|id| ALL.get(id)) else {
        return;
    };
    if let Some(RefOr::T(body)) = &mut operation.request_body {
        for (media_type, content) in &mut body.content {
            if let (Some(named), RefOr::T(content)) = (examples.requests.get(media_type), content) {
                let named = named.iter().map(|(name, value)| {
                    (name.clone(), ExampleBuilder::new().value(Some(value.clone())).build())
                });
                content.examples = named.map(|(name, example)| (name, RefOr::T(example))).collect();
            }
        }
    }
    for (_, response) in
        operation.responses.responses.iter_mut().filter(|(status, _)| status.starts_with('2'))
    {
        if let RefOr::T(response) = response {
            for (media_type, content) in &mut response.content {
                if let RefOr::T(Content { example, .. }) = content {
                    *example = examples.answers.get(media_type).cloned();
                }
            }
        }
    }
}
