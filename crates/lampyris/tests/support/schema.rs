//! Documents beside what the description says of them.

use serde_json::Value;

/// Where a document does not agree with its schema: fields that are not described or missing, and wrong
/// types.
pub fn disagreements(document: &Value, schema: &Value, schemas: &Value, place: &str) -> Vec<String> {
    if let Some(name) = schema["$ref"].as_str().and_then(|path| path.rsplit('/').next()) {
        return disagreements(document, &schemas[name], schemas, place);
    }
    if let Some(one_of) = schema["oneOf"].as_array() {
        let all: Vec<Vec<String>> =
            one_of.iter().map(|schema| disagreements(document, schema, schemas, place)).collect();
        return if all.iter().any(Vec::is_empty) { Vec::new() } else { all.concat() };
    }
    let mut properties = serde_json::Map::new();
    let mut required = Vec::new();
    let mut parts = vec![schema];
    while let Some(part) = parts.pop() {
        let part = part["$ref"]
            .as_str()
            .and_then(|path| path.rsplit('/').next())
            .map_or(part, |name| &schemas[name]);
        parts.extend(part["allOf"].as_array().into_iter().flatten());
        properties.extend(part["properties"].as_object().cloned().unwrap_or_default());
        required.extend(part["required"].as_array().cloned().unwrap_or_default());
    }
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    let is = |name: &str| types.is_empty() || types.contains(&name);
    let mut found = Vec::new();
    match document {
        Value::Null if is("null") => {}
        Value::Bool(_) if is("boolean") => {}
        Value::Number(_) if is("number") || is("integer") => {}
        Value::String(_) if is("string") => {}
        Value::Array(items) if is("array") => {
            for (index, item) in items.iter().enumerate() {
                found.extend(disagreements(item, &schema["items"], schemas, &format!("{place}/{index}")));
            }
        }
        Value::Object(fields) if is("object") => {
            let more = schema.get("additionalProperties").filter(|more| more.is_object());
            for (name, value) in fields {
                let place = format!("{place}/{name}");
                match (properties.get(name), more) {
                    (Some(schema), _) | (None, Some(schema)) => {
                        found.extend(disagreements(value, schema, schemas, &place))
                    }
                    (None, None) if properties.is_empty() => {}
                    (None, None) => found.push(format!("{place} is not described")),
                }
            }
            let missing =
                required.iter().filter_map(Value::as_str).filter(|name| !fields.contains_key(*name));
            found.extend(missing.map(|name| format!("{place}/{name} is missing")));
        }
        other => found.push(format!("{place} is {other}, described as {types:?}")),
    }
    found
}
