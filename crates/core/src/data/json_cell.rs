//! What a JSON window may have in its lists.

use serde::de::{Deserialize, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::fmt;

/// A value of a list: a number, nothing, or something else.
pub(super) enum JsonCell {
    Missing,
    Number(f64),
    Text(Box<str>),
}

impl<'de> Deserialize<'de> for JsonCell {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl<'de> Visitor<'de> for Any {
            type Value = JsonCell;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, a time or null")
            }

            fn visit_f64<E>(self, number: f64) -> Result<JsonCell, E> {
                Ok(JsonCell::Number(number))
            }

            fn visit_u64<E>(self, number: u64) -> Result<JsonCell, E> {
                Ok(JsonCell::Number(number as f64))
            }

            fn visit_i64<E>(self, number: i64) -> Result<JsonCell, E> {
                Ok(JsonCell::Number(number as f64))
            }

            fn visit_unit<E>(self) -> Result<JsonCell, E> {
                Ok(JsonCell::Missing)
            }

            fn visit_bool<E>(self, truth: bool) -> Result<JsonCell, E> {
                Ok(JsonCell::Text(truth.to_string().into()))
            }

            fn visit_str<E>(self, text: &str) -> Result<JsonCell, E> {
                // A stamp has at most 64 bytes; of anything longer the beginning says enough.
                Ok(JsonCell::Text(text.chars().take(80).collect::<String>().into()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<JsonCell, A::Error> {
                while seq.next_element::<IgnoredAny>()?.is_some() {}
                Ok(JsonCell::Text("a list".into()))
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<JsonCell, A::Error> {
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(JsonCell::Text("an object".into()))
            }
        }
        deserializer.deserialize_any(Any)
    }
}
