//! Lengths of time that documents count in seconds.

use super::duration::SECOND;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

/// A length of time in whole milliseconds, written as a number of seconds: 900 or 0.01.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Seconds {
    millis: i64,
}

impl Seconds {
    /// So many milliseconds.
    pub const fn of_millis(millis: i64) -> Self {
        Self { millis }
    }

    /// The length in milliseconds.
    pub const fn millis(self) -> i64 {
        self.millis
    }

    /// The length in seconds.
    pub fn seconds(self) -> f64 {
        self.millis as f64 / SECOND as f64
    }
}

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} s", self.seconds())
    }
}

impl Serialize for Seconds {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.millis % SECOND {
            0 => serializer.serialize_i64(self.millis / SECOND),
            _ => serializer.serialize_f64(self.seconds()),
        }
    }
}

impl<'de> Deserialize<'de> for Seconds {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let seconds = f64::deserialize(deserializer)?;
        Ok(Self { millis: (seconds * SECOND as f64).round() as i64 })
    }
}

impl PartialSchema for Seconds {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new().schema_type(Type::Number).into()
    }
}

impl ToSchema for Seconds {}

#[cfg(test)]
mod tests {
    use super::Seconds;

    #[test]
    fn whole_seconds_are_whole_numbers() {
        for (millis, text) in [(900_000, "900"), (10, "0.01"), (0, "0"), (1_500, "1.5")] {
            let seconds = Seconds::of_millis(millis);
            assert_eq!(serde_json::to_string(&seconds).unwrap(), text);
            assert_eq!(serde_json::from_str::<Seconds>(text).unwrap(), seconds);
        }
        assert_eq!(Seconds::of_millis(10).to_string(), "0.01 s");
    }
}
