//! The readable identity of a model: a base with the effects added and taken away.

use crate::schema;
use serde::{Deserialize, Serialize};

/// Most effects that an id names.
pub(super) const MAX_EFFECTS: usize = 32;

/// `room3+wind_infiltration`, `tite-solar_gain`: a base, effects added and effects removed, each sorted.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ModelId {
    base: String,
    with: Vec<String>,
    without: Vec<String>,
}

/// A text that is no model id.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NotAModelId(pub String);

impl std::fmt::Display for NotAModelId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "`{}` is not a model id such as `room3` or `room3+wind_infiltration`",
            self.0.chars().take(80).collect::<String>()
        )
    }
}

impl std::error::Error for NotAModelId {}

impl ModelId {
    /// Stands for the id of a document whose own makes no sense, so that the rest of it can be judged.
    pub fn unnamed() -> Self {
        Self { base: "unnamed".to_owned(), with: Vec::new(), without: Vec::new() }
    }

    /// The model that effects are added to.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Effects added to the base, sorted.
    pub fn with(&self) -> &[String] {
        &self.with
    }

    /// Effects of the base that are left out, sorted.
    pub fn without(&self) -> &[String] {
        &self.without
    }

    /// The same model with one more effect; an effect that had been left out comes back.
    #[must_use]
    pub fn plus(&self, effect: &str) -> Self {
        let mut id = self.clone();
        if let Some(place) = id.without.iter().position(|left_out| left_out == effect) {
            id.without.remove(place);
        } else if let Err(place) = id.with.binary_search_by(|known| known.as_str().cmp(effect)) {
            id.with.insert(place, effect.to_owned());
        }
        id
    }

    /// The same model with one effect fewer.
    #[must_use]
    pub fn minus(&self, effect: &str) -> Self {
        let mut id = self.clone();
        if let Some(place) = id.with.iter().position(|added| added == effect) {
            id.with.remove(place);
        } else if let Err(place) = id.without.binary_search_by(|known| known.as_str().cmp(effect)) {
            id.without.insert(place, effect.to_owned());
        }
        id
    }
}

schema::is_text!(
    ModelId,
    "ModelId",
    "^[A-Za-z0-9_]{1,64}([+-][A-Za-z0-9_]{1,64}(:[A-Za-z0-9_]{1,64})?){0,32}$",
    "room3+wind_infiltration",
    "A model: a base, `+` the effects that are added and `-` those that are left out."
);

/// The family of an effect, its id without its argument, and the argument where it has one:
/// `metered_gain` and `P_heater` of `metered_gain:P_heater`.
pub fn family_and_argument(effect: &str) -> (&str, Option<&str>) {
    effect.split_once(':').map_or((effect, None), |(family, argument)| (family, Some(argument)))
}

/// The family of an effect.
pub fn family(effect: &str) -> &str {
    family_and_argument(effect).0
}

/// `room2`, `metered_gain:P_heater`: letters, digits and underscores, with one colon in an effect.
fn is_part(text: &str, effect: bool) -> bool {
    let word = |text: &str| {
        !text.is_empty() && text.len() <= 64 && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
    };
    match text.split_once(':') {
        Some((name, argument)) => effect && word(name) && word(argument),
        None => word(text),
    }
}

impl std::str::FromStr for ModelId {
    type Err = NotAModelId;

    fn from_str(text: &str) -> Result<Self, NotAModelId> {
        let wrong = || NotAModelId(text.to_owned());
        if text.matches(['+', '-']).count() > MAX_EFFECTS {
            return Err(wrong());
        }
        let end = text.find(['+', '-']).unwrap_or(text.len());
        let mut id = ModelId { base: text[..end].to_owned(), with: Vec::new(), without: Vec::new() };
        if !is_part(&id.base, false) {
            return Err(wrong());
        }
        let mut rest = &text[end..];
        while let Some(sign) = rest.chars().next() {
            let next = rest[1..].find(['+', '-']).map_or(rest.len(), |n| n + 1);
            let effect = &rest[1..next];
            if !is_part(effect, true) {
                return Err(wrong());
            }
            id = if sign == '+' { id.plus(effect) } else { id.minus(effect) };
            rest = &rest[next..];
        }
        Ok(id)
    }
}

impl TryFrom<String> for ModelId {
    type Error = NotAModelId;

    fn try_from(text: String) -> Result<Self, NotAModelId> {
        text.parse()
    }
}

impl From<ModelId> for String {
    fn from(id: ModelId) -> String {
        id.to_string()
    }
}

impl std::fmt::Display for ModelId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.base)?;
        self.without.iter().try_for_each(|effect| write!(f, "-{effect}"))?;
        self.with.iter().try_for_each(|effect| write!(f, "+{effect}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_sorted_and_survive_a_round_trip() {
        let id: ModelId = "tite+wind_infiltration-solar_gain+metered_gain:P_lights".parse().unwrap();
        assert_eq!(id.to_string(), "tite-solar_gain+metered_gain:P_lights+wind_infiltration");
        assert_eq!(id.to_string().parse::<ModelId>().unwrap(), id);
        assert_eq!(id.plus("solar_gain").without(), &[] as &[String]);
        assert_eq!(id.minus("wind_infiltration").with(), &["metered_gain:P_lights".to_owned()]);
        for bad in ["", "+a", "room3+", "room 3", "a:b", "room3++x", "é"] {
            assert!(bad.parse::<ModelId>().is_err(), "{bad}");
        }
    }
}
