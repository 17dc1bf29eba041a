//! A search method as a request names it: `{"name": "cfa", "seed": 1, "n": 60}`.

use crate::optimise::Method;
use crate::schema::joined;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::borrow::Cow;
use std::collections::BTreeSet;
use utoipa::openapi::schema::{ObjectBuilder, OneOfBuilder, SchemaType, Type};
use utoipa::openapi::{Ref, RefOr, Schema};
use utoipa::{Number, PartialSchema, ToSchema};

/// A search method with its seed. The default method needs no name.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "Map<String, Value>", into = "Map<String, Value>")]
pub struct SeededMethod {
    /// The same seed gives the same bits.
    pub seed: u64,
    /// The method and its hyperparameters.
    pub method: Method,
}

/// A method as a document, in its parts.
#[derive(Debug, Clone, PartialEq)]
pub struct MethodFields {
    /// What stands for the seed.
    pub seed: Value,
    /// What stands for the name.
    pub name: Value,
    /// Everything else: the hyperparameters.
    pub rest: Map<String, Value>,
}

impl From<Map<String, Value>> for MethodFields {
    fn from(mut rest: Map<String, Value>) -> Self {
        let seed = rest.shift_remove("seed").unwrap_or_else(|| json!(0));
        let name = rest.shift_remove("name").unwrap_or_else(|| Method::default().name().into());
        Self { seed, name, rest }
    }
}

impl MethodFields {
    /// The method alone, as `Method` reads it; `None` where the name is no text.
    pub fn method(&self) -> Option<Value> {
        let name = self.name.as_str()?.to_owned();
        Some(Value::Object(Map::from_iter([(name, Value::Object(self.rest.clone()))])))
    }
}

impl TryFrom<Map<String, Value>> for SeededMethod {
    type Error = String;

    fn try_from(fields: Map<String, Value>) -> Result<Self, String> {
        let fields = MethodFields::from(fields);
        let seed = fields
            .seed
            .as_u64()
            .ok_or_else(|| format!("the seed is a whole number from 0 on, not {}", fields.seed))?;
        let method = fields.method().ok_or("the name of a method is a text")?;
        let method: Method = serde_json::from_value(method).map_err(|error| error.to_string())?;
        let faults: Vec<String> =
            method.faults().iter().map(|fault| format!("{} {fault}", fault.field)).collect();
        if faults.is_empty() { Ok(Self { seed, method }) } else { Err(faults.join("; ")) }
    }
}

impl From<SeededMethod> for Map<String, Value> {
    fn from(seeded: SeededMethod) -> Self {
        let mut fields = Map::from_iter([("seed".to_owned(), seeded.seed.into())]);
        // A method is one entry: its name and its hyperparameters, which are numbers and words.
        if let Ok(Value::Object(method)) = serde_json::to_value(&seeded.method) {
            for (name, hyperparameters) in method {
                fields.insert("name".to_owned(), name.into());
                fields.extend(hyperparameters.as_object().cloned().unwrap_or_default());
            }
        }
        fields
    }
}

impl SeededMethod {
    /// The schemas that the method needs, those of its hyperparameters last. Every method is one closed
    /// object; what may be where follows from the ranges that the method checks itself.
    fn described() -> Vec<(String, RefOr<Schema>)> {
        let mut parts = Vec::new();
        Method::schemas(&mut parts);
        // What two methods share is there twice.
        let mut seen = BTreeSet::new();
        parts.retain(|(name, _)| seen.insert(name.clone()));
        let mut methods = Vec::new();
        for (name, options) in variants() {
            let Some(place) = parts.iter().position(|(known, _)| *known == options) else {
                continue;
            };
            let hyperparameters = parts[place].1.clone();
            let is_default = name == Method::default().name();
            let mut own = ObjectBuilder::new()
                .property(
                    "name",
                    ObjectBuilder::new()
                        .schema_type(SchemaType::Type(Type::String))
                        .enum_values(Some([name.clone()])),
                )
                .property(
                    "seed",
                    ObjectBuilder::new()
                        .schema_type(SchemaType::Type(Type::Integer))
                        .description(Some("The same seed gives the same bits."))
                        .minimum(Some(0))
                        .maximum(Some(u64::MAX)),
                );
            if !is_default {
                own = own.required("name");
            }
            let whole = joined([hyperparameters, own.build().into()], true);
            methods.push((options.replace("Options", "Method"), name, whole));
        }
        for (_, name, whole) in &mut methods {
            let Ok(method) = serde_json::from_value::<Method>(json!({ name.clone(): {} })) else {
                continue;
            };
            for range in method.ranges() {
                let (object, field) = match range.field.split_once('.') {
                    None => (Some(&mut *whole), range.field.as_str()),
                    Some((part, field)) => {
                        let part = component(part);
                        let found = parts.iter_mut().find(|(known, _)| *known == part);
                        (found.and_then(|(_, part)| as_object(part)), field)
                    }
                };
                if let Some(RefOr::T(Schema::Object(number))) =
                    object.and_then(|object| object.properties.get_mut(field))
                {
                    (number.minimum, number.maximum) =
                        (Some(number_of(range.from)), Some(number_of(range.to)));
                }
            }
        }
        // What is a method is described as one, and by itself only where it is a part of another.
        let nested: BTreeSet<String> = Method::NAMES
            .iter()
            .filter_map(|name| serde_json::from_value::<Method>(json!({ *name: {} })).ok())
            .flat_map(|method| method.ranges())
            .filter_map(|range| range.field.split_once('.').map(|(part, _)| component(part)))
            .collect();
        let variants = variants();
        parts
            .retain(|(name, _)| nested.contains(name) || variants.iter().all(|(_, options)| options != name));
        methods.into_iter().map(|(component, _, whole)| (component, whole.into())).chain(parts).collect()
    }
}

/// The component that describes a part of a method: `on_costs` is `OnCostsOptions`.
fn component(part: &str) -> String {
    let words = part.split('_').map(|word| word[..1].to_ascii_uppercase() + &word[1..]);
    words.collect::<String>() + "Options"
}

/// A number without a point where it needs none.
fn number_of(value: f64) -> Number {
    if value.fract() == 0.0 && value.abs() < 1e15 {
        Number::Int(value as isize)
    } else {
        Number::Float(value)
    }
}

fn as_object(schema: &mut RefOr<Schema>) -> Option<&mut utoipa::openapi::Object> {
    match schema {
        RefOr::T(Schema::Object(object)) => Some(object),
        _ => None,
    }
}

/// The methods: their names, and the components that describe their hyperparameters.
fn variants() -> Vec<(String, String)> {
    let RefOr::T(Schema::OneOf(methods)) = Method::schema() else {
        return Vec::new();
    };
    let mut variants = Vec::new();
    for method in methods.items {
        if let RefOr::T(Schema::Object(method)) = method {
            for (name, options) in method.properties {
                if let RefOr::Ref(options) = options {
                    let component = options.ref_location.rsplit('/').next().unwrap_or_default().to_owned();
                    variants.push((name, component));
                }
            }
        }
    }
    variants
}

impl PartialSchema for SeededMethod {
    fn schema() -> RefOr<Schema> {
        let mut one_of = OneOfBuilder::new()
            .description(Some("A search method with its seed and hyperparameters by name."));
        for (_, options) in variants() {
            one_of = one_of.item(Ref::from_schema_name(options.replace("Options", "Method")));
        }
        one_of.into()
    }
}

impl ToSchema for SeededMethod {
    fn name() -> Cow<'static, str> {
        "Method".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        schemas.extend(Self::described());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(value: Value) -> Result<SeededMethod, String> {
        serde_json::from_value(value).map_err(|error| error.to_string())
    }

    #[test]
    fn a_method_is_named_and_survives_a_round_trip() {
        assert_eq!(read(json!({})).unwrap(), SeededMethod::default());
        for name in Method::NAMES {
            let method = read(json!({"name": name, "seed": 7})).unwrap();
            assert_eq!((method.seed, method.method.name()), (7, name));
            let document = serde_json::to_value(&method).unwrap();
            assert_eq!((&document["name"], &document["seed"]), (&json!(name), &json!(7)));
            assert_eq!(read(document).unwrap(), method);
        }
        for bad in [
            json!({"name": "annealing"}),
            json!({"name": 1}),
            json!({"seed": -1}),
            json!({"local": {"iteration": 3}}),
            json!({"n": 1}),
            json!({"name": "lm_multistart", "starts": "all"}),
        ] {
            assert!(read(bad.clone()).is_err(), "{bad}");
        }
    }

    #[test]
    fn every_method_is_described_with_its_ranges() {
        let described = SeededMethod::described();
        let RefOr::T(Schema::OneOf(methods)) = SeededMethod::schema() else { panic!() };
        assert_eq!(methods.items.len(), Method::NAMES.len());
        for item in &methods.items {
            let RefOr::Ref(item) = item else { panic!() };
            assert!(
                described.iter().any(|(name, _)| item.ref_location.ends_with(&format!("/{name}"))),
                "{}",
                item.ref_location
            );
        }
        // Every number has its range, so that nothing is promised that is refused later.
        for (name, schema) in &described {
            let schema = serde_json::to_value(schema).unwrap();
            for (field, property) in schema["properties"].as_object().into_iter().flatten() {
                let is_number = property["type"] == "number" || property["type"] == "integer";
                assert!(!is_number || property["maximum"].is_number(), "{name} {field}: {property}");
            }
        }
    }
}
