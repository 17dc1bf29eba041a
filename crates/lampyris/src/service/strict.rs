//! Hands a JSON document to `serde` as it is. `serde_json` would also read an object from a list of its
//! values or from nothing, which no description promises.

use serde::de::value::{MapAccessDeserializer, MapDeserializer, SeqDeserializer};
use serde::de::{Deserializer, Error as _, IntoDeserializer, Unexpected, Visitor};
use serde::forward_to_deserialize_any;
use serde_json::{Error, Value};

/// A JSON document of which an object is read from an object only.
#[derive(Debug, Clone, Copy)]
pub struct Strict<'de>(pub &'de Value);

impl<'de> Deserializer<'de> for Strict<'de> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(truth) => visitor.visit_bool(*truth),
            Value::Number(number) => number.deserialize_any(visitor),
            Value::String(text) => visitor.visit_borrowed_str(text),
            Value::Array(items) => {
                let mut items = SeqDeserializer::new(items.iter().map(Strict));
                let value = visitor.visit_seq(&mut items)?;
                items.end().map(|()| value)
            }
            Value::Object(fields) => {
                let mut fields =
                    MapDeserializer::new(fields.iter().map(|(name, value)| (name.as_str(), Strict(value))));
                let value = visitor.visit_map(&mut fields)?;
                fields.end().map(|()| value)
            }
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        if self.0.is_null() { visitor.visit_none() } else { visitor.visit_some(self) }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        if self.0.is_array() {
            Err(Error::invalid_type(Unexpected::Seq, &visitor))
        } else {
            self.deserialize_any(visitor)
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        // The maps of `serde_json` would take `null` for an empty one.
        if self.0.is_null() {
            Err(Error::invalid_type(Unexpected::Unit, &visitor))
        } else {
            self.deserialize_any(visitor)
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        match self.0 {
            Value::String(word) => visitor.visit_enum(word.as_str().into_deserializer()),
            Value::Object(fields) if fields.len() > 1 => {
                Err(Error::custom("the object says several things of which only one can be"))
            }
            Value::Object(fields) => {
                let fields =
                    MapDeserializer::new(fields.iter().map(|(name, value)| (name.as_str(), Strict(value))));
                visitor.visit_enum(MapAccessDeserializer::new(fields))
            }
            other => Strict(other).deserialize_any(visitor),
        }
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit
        unit_struct seq tuple tuple_struct identifier ignored_any
    }
}

impl<'de> IntoDeserializer<'de, Error> for Strict<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::Strict;
    use serde::Deserialize;
    use serde_json::{Value, json};

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Shape {
        Round,
        Box(Corner),
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Corner {
        at: [f64; 2],
        name: Option<String>,
    }

    fn read(value: Value) -> Result<Shape, String> {
        Shape::deserialize(Strict(&value)).map_err(|error| error.to_string())
    }

    #[test]
    fn objects_are_objects_and_everything_else_is_as_usual() {
        assert_eq!(read(json!("round")).unwrap(), Shape::Round);
        assert_eq!(
            read(json!({"box": {"at": [1, 2.5]}})).unwrap(),
            Shape::Box(Corner { at: [1.0, 2.5], name: None })
        );
        assert!(read(json!({"box": {"at": [1, 2]}, "more": 1})).unwrap_err().contains("only one"));
        assert_eq!(
            read(json!({"box": {"at": [1, 2], "name": "a"}})).unwrap(),
            Shape::Box(Corner { at: [1.0, 2.0], name: Some("a".into()) })
        );
        assert!(read(json!({"box": [[1, 2], "a"]})).unwrap_err().contains("sequence"), "a list is no object");
        for bad in [
            json!({"box": {"at": [1, 2, 3]}}),
            json!({"box": {"at": [1]}}),
            json!({"box": null}),
            json!(["round"]),
            json!("square"),
            json!({}),
        ] {
            assert!(read(bad.clone()).is_err(), "{bad}");
        }
        assert!(serde_json::Map::deserialize(Strict(&json!(null))).is_err());
    }
}
