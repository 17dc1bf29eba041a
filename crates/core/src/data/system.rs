//! The name of a system, `room/4`, and patterns over such names, `room/*`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::schema;

const MAX_KIND: usize = 32;
const MAX_ID: usize = 64;

/// The name of one system: a kind of lower-case letters and an id, written `room/4`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct SystemId {
    kind: String,
    id: String,
}

/// A pattern over system names in which `*` stands for any run of characters within a part: `room/*`,
/// `room/north-*`, `*/*`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct SystemPattern {
    kind: String,
    id: String,
}

/// A text that is no system name (or no pattern over system names).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadSystemId {
    text: String,
    pattern: bool,
}

impl fmt::Display for BadSystemId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The text may be a whole hostile body: an error never echoes more than a glance of it.
        let shown: String = self.text.chars().take(80).collect();
        let (what, example) = if self.pattern { ("system pattern", "room/*") } else { ("system", "room/4") };
        write!(
            f,
            "`{}` is not a {what}: a kind of lower-case letters, a slash and an id of at most {MAX_ID} \
            letters, digits, `_` and `-`, such as `{example}`",
            shown.escape_debug()
        )
    }
}

impl std::error::Error for BadSystemId {}

impl SystemId {
    /// The system with this kind (`room`) and id (`4`).
    ///
    /// # Errors
    /// [`BadSystemId`] where the kind is not `[a-z]{1,32}` or the id is not `[A-Za-z0-9_-]{1,64}`.
    pub fn new(kind: &str, id: &str) -> Result<Self, BadSystemId> {
        if is_part(kind, MAX_KIND, is_kind_char) && is_part(id, MAX_ID, is_id_char) {
            Ok(Self { kind: kind.to_owned(), id: id.to_owned() })
        } else {
            Err(BadSystemId { text: format!("{kind}/{id}"), pattern: false })
        }
    }

    /// What sort of system it is: `room`, `plant`.
    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// The id within its kind.
    pub fn id(&self) -> &str {
        &self.id
    }
}

impl FromStr for SystemId {
    type Err = BadSystemId;

    fn from_str(text: &str) -> Result<Self, BadSystemId> {
        let bad = || BadSystemId { text: text.to_owned(), pattern: false };
        let (kind, id) = text.split_once('/').ok_or_else(bad)?;
        Self::new(kind, id)
    }
}

impl fmt::Display for SystemId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.kind, self.id)
    }
}

impl From<SystemId> for String {
    fn from(system: SystemId) -> String {
        system.to_string()
    }
}

impl TryFrom<String> for SystemId {
    type Error = BadSystemId;

    fn try_from(text: String) -> Result<Self, BadSystemId> {
        text.parse()
    }
}

impl SystemPattern {
    /// Whether the pattern selects this system.
    pub fn matches(&self, system: &SystemId) -> bool {
        glob(self.kind.as_bytes(), system.kind.as_bytes()) && glob(self.id.as_bytes(), system.id.as_bytes())
    }

    /// Whether every system that the other pattern selects is selected by this one. A `*` of the other
    /// pattern can only be met by a `*` of this one, as if it were a character of its own.
    pub fn includes(&self, other: &SystemPattern) -> bool {
        glob(self.kind.as_bytes(), other.kind.as_bytes()) && glob(self.id.as_bytes(), other.id.as_bytes())
    }

    /// The one system that the pattern can select, where it holds no `*`.
    pub fn exact(&self) -> Option<SystemId> {
        SystemId::new(&self.kind, &self.id).ok()
    }
}

impl FromStr for SystemPattern {
    type Err = BadSystemId;

    fn from_str(text: &str) -> Result<Self, BadSystemId> {
        match text.split_once('/') {
            Some((kind, id))
                if is_part(kind, MAX_KIND, |c| c == '*' || is_kind_char(c))
                    && is_part(id, MAX_ID, |c| c == '*' || is_id_char(c)) =>
            {
                Ok(Self { kind: kind.to_owned(), id: id.to_owned() })
            }
            _ => Err(BadSystemId { text: text.to_owned(), pattern: true }),
        }
    }
}

impl fmt::Display for SystemPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.kind, self.id)
    }
}

impl From<SystemPattern> for String {
    fn from(pattern: SystemPattern) -> String {
        pattern.to_string()
    }
}

impl TryFrom<String> for SystemPattern {
    type Error = BadSystemId;

    fn try_from(text: String) -> Result<Self, BadSystemId> {
        text.parse()
    }
}

schema::is_text!(
    SystemId,
    "SystemName",
    "^[a-z]{1,32}/[A-Za-z0-9_-]{1,64}$",
    "room/4",
    "The name of a system: its kind and its id."
);
schema::is_text!(
    SystemPattern,
    "SystemPattern",
    "^[a-z*]{1,32}/[A-Za-z0-9_*-]{1,64}$",
    "room/*",
    "The name of a system, in which `*` stands for any run of characters within a part."
);

fn is_kind_char(c: char) -> bool {
    c.is_ascii_lowercase()
}

fn is_id_char(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_' || c == '-'
}

fn is_part(text: &str, max: usize, allowed: impl Fn(char) -> bool) -> bool {
    !text.is_empty() && text.len() <= max && text.chars().all(allowed)
}

/// Matches `text` against `pattern` in linear space: after a mismatch the last `*` swallows one character
/// more.
fn glob(pattern: &[u8], text: &[u8]) -> bool {
    let (mut p, mut t) = (0, 0);
    let mut star: Option<(usize, usize)> = None;
    while t < text.len() {
        if pattern.get(p) == Some(&b'*') {
            star = Some((p, t));
            p += 1;
        } else if pattern.get(p) == Some(&text[t]) {
            p += 1;
            t += 1;
        } else if let Some((star_p, star_t)) = star {
            star = Some((star_p, star_t + 1));
            p = star_p + 1;
            t = star_t + 1;
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|c| *c == b'*')
}

#[cfg(test)]
mod tests {
    use super::{SystemId, SystemPattern};
    use proptest::prelude::{any, prop_assert_eq, proptest};

    #[test]
    fn names_read_and_print_alike() {
        let system: SystemId = "room/4".parse().unwrap();
        assert_eq!((system.kind(), system.id()), ("room", "4"));
        assert_eq!(serde_json::to_string(&system).unwrap(), "\"room/4\"");
        assert_eq!(serde_json::from_str::<SystemId>("\"room/4\"").unwrap(), system);
        let too_long = format!("room/{}", "x".repeat(65));
        for bad in
            ["", "room", "room/", "/4", "Room/4", "room/4/5", "room/*", "room/a b", "r\u{f6}m/4", &too_long]
        {
            assert!(bad.parse::<SystemId>().is_err(), "{bad}");
        }
        assert!(serde_json::from_str::<SystemId>("\"room\"").is_err());
    }

    #[test]
    fn patterns_select() {
        let matches = |pattern: &str, system: &str| {
            pattern.parse::<SystemPattern>().unwrap().matches(&system.parse().unwrap())
        };
        assert!(matches("room/*", "room/4"));
        assert!(!matches("room/*", "plant/4"));
        assert!(matches("*/*", "plant/4"));
        assert!(matches("room/n*-1*", "room/north-wing-12"));
        assert!(!matches("room/n*-1", "room/north-wing-12"));
        assert!(matches("room/4", "room/4"));
        assert!("room".parse::<SystemPattern>().is_err());
        assert_eq!("room/4".parse::<SystemPattern>().unwrap().exact().unwrap().to_string(), "room/4");
        assert!("room/*".parse::<SystemPattern>().unwrap().exact().is_none());
    }

    #[test]
    fn a_pattern_includes_those_that_select_no_more() {
        let includes =
            |one: &str, other: &str| one.parse::<SystemPattern>().unwrap().includes(&other.parse().unwrap());
        assert!(
            includes("*/*", "room/*")
                && includes("room/*", "room/*")
                && includes("room/*", "room/n*-1")
                && includes("room/4", "room/4")
        );
        assert!(
            !includes("room/*", "*/*")
                && !includes("room/4", "room/*")
                && !includes("room/n*", "room/*n*")
                && !includes("room/4", "room/5")
        );
    }

    proptest! {
        #[test]
        fn what_an_included_pattern_selects_is_selected(one in "[a*]{1,4}", other in "[a*]{1,4}", id in "[ab]{1,5}") {
            let [one, other] = [one, other].map(|id| format!("room/{id}").parse::<SystemPattern>().unwrap());
            let system: SystemId = format!("room/{id}").parse().unwrap();
            if one.includes(&other) && other.matches(&system) {
                prop_assert_eq!((one.matches(&system), system.to_string()), (true, system.to_string()));
            }
        }

        #[test]
        fn any_text_is_a_name_or_an_error(text in any::<String>()) {
            if let Ok(system) = text.parse::<SystemId>() {
                prop_assert_eq!(system.to_string(), text);
            }
        }
    }
}
