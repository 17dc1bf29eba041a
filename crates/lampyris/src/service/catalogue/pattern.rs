//! Texts with places in braces: they take names apart, and put others together.

use std::collections::BTreeMap;

/// A text such as `{room}_temperature` or `room/{room}`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern(Vec<Part>);

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Text(String),
    Place(String),
}

impl Pattern {
    /// Reads a pattern.
    ///
    /// # Errors
    /// A sentence where braces do not pair, a place has no name, or two places stand side by side, so that
    /// nothing says where one ends.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut parts: Vec<Part> = Vec::new();
        let mut rest = text;
        while let Some(at) = rest.find(['{', '}']) {
            let (before, from) = rest.split_at(at);
            let place = from.strip_prefix('{').and_then(|open| open.split_once('}'));
            let Some((name, behind)) = place.filter(|(name, _)| !name.contains('{')) else {
                return Err(format!("the braces of `{text}` do not pair"));
            };
            if name.is_empty() {
                return Err(format!("a place of `{text}` has no name"));
            }
            if !before.is_empty() {
                parts.push(Part::Text(before.to_owned()));
            } else if matches!(parts.last(), Some(Part::Place(_))) {
                return Err(format!("two places of `{text}` stand side by side"));
            }
            parts.push(Part::Place(name.to_owned()));
            rest = behind;
        }
        if !rest.is_empty() {
            parts.push(Part::Text(rest.to_owned()));
        }
        Ok(Self(parts))
    }

    /// The text, where the pattern has no places.
    pub fn fixed(&self) -> Option<&str> {
        match self.0.as_slice() {
            [] => Some(""),
            [Part::Text(text)] => Some(text),
            _ => None,
        }
    }

    /// Whether a text fits. What stands in the places is added to `found`; one that has been found before
    /// must be the same again. A place takes as little as it can, and at least one character.
    pub fn takes<'a>(&'a self, text: &'a str, found: &mut BTreeMap<&'a str, &'a str>) -> bool {
        let mut rest = text;
        for (place, part) in self.0.iter().enumerate() {
            match part {
                Part::Text(fixed) => match rest.strip_prefix(fixed.as_str()) {
                    Some(behind) => rest = behind,
                    None => return false,
                },
                Part::Place(name) => {
                    let end = match self.0.get(place + 1) {
                        // The last text ends the whole, wherever else it may stand before.
                        Some(Part::Text(fixed)) if place + 2 == self.0.len() => {
                            rest.strip_suffix(fixed.as_str()).map(str::len)
                        }
                        Some(Part::Text(fixed)) => {
                            let first = rest.chars().next().map_or(0, char::len_utf8);
                            rest[first..].find(fixed.as_str()).map(|at| at + first)
                        }
                        _ => Some(rest.len()),
                    };
                    let Some(end) = end.filter(|end| *end > 0) else { return false };
                    let (value, behind) = rest.split_at(end);
                    if *found.entry(name).or_insert(value) != value {
                        return false;
                    }
                    rest = behind;
                }
            }
        }
        rest.is_empty()
    }

    /// The text with its places filled; `None` where nothing is known of one.
    pub fn filled<'a>(&self, known: impl Fn(&str) -> Option<&'a str>) -> Option<String> {
        let mut text = String::new();
        for part in &self.0 {
            text.push_str(match part {
                Part::Text(fixed) => fixed,
                Part::Place(name) => known(name)?,
            });
        }
        Some(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(pattern: &str, text: &str) -> Option<Vec<(String, String)>> {
        let pattern = Pattern::parse(pattern).unwrap();
        let mut found = BTreeMap::new();
        let owned = |(name, value): (&&str, &&str)| ((*name).to_owned(), (*value).to_owned());
        pattern.takes(text, &mut found).then(|| found.iter().map(owned).collect())
    }

    #[test]
    fn a_pattern_takes_a_text_apart() {
        let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        assert_eq!(found("living", "living"), Some(Vec::new()));
        assert_eq!(found("{room}_t", "living_room_t"), Some(vec![pair("room", "living_room")]));
        assert_eq!(found("{room}_t", "a_t_t"), Some(vec![pair("room", "a_t")]));
        let topic = Some(vec![pair("room", "bad"), pair("what", "wärme/x")]);
        assert_eq!(found("home/{room}/{what}", "home/bad/wärme/x"), topic);
        assert_eq!(found("{a}-{a}", "x-x"), Some(vec![pair("a", "x")]));
        for (pattern, text) in [
            ("living", "living2"),
            ("{room}_t", "_t"),
            ("{room}_t", "living_x"),
            ("home/{room}/{what}", "home/bad"),
            ("{a}-{a}", "x-y"),
            ("", "x"),
        ] {
            assert_eq!(found(pattern, text), None, "{pattern} {text}");
        }
    }

    #[test]
    fn a_pattern_puts_a_text_together() {
        let pattern = Pattern::parse("room/{a}-{b}").unwrap();
        let known = |name: &str| (name != "c").then_some("x");
        assert_eq!(pattern.filled(known).as_deref(), Some("room/x-x"));
        assert_eq!(Pattern::parse("{c}").unwrap().filled(known), None);
        assert_eq!((Pattern::parse("x").unwrap().fixed(), pattern.fixed()), (Some("x"), None));
    }

    #[test]
    fn braces_pair_and_places_stand_apart() {
        for bad in ["{", "}", "a{b", "a}b", "{}", "{a}{b}", "{a{b}}", "}{"] {
            assert!(Pattern::parse(bad).is_err(), "{bad}");
        }
    }
}
