//! One fault in something that a user sent: what is wrong, where, and what to do about it.
//!
//! Parsers never stop at the first fault; they return a `Vec<Fault>`. The HTTP edge prints it as the
//! `errors` of a problem document, the command line as a list.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A fault in a document, a window, an expression or a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = ProblemFault)]
pub struct Fault {
    /// Where: a JSON pointer (`/equations/T_r`), or `line 12` of a text.
    pub pointer: String,
    /// A stable slug for programs, such as `unknown-name`.
    pub code: String,
    /// A sentence for people.
    pub detail: String,
    /// What would probably have been right.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suggestion: Option<String>,
}

/// Longest text of a fault in characters. What was sent may be part of it, and need not come back whole.
const LONGEST: usize = 500;

impl Fault {
    /// A fault without a suggestion.
    pub fn new(pointer: impl Into<String>, code: &str, detail: impl Into<String>) -> Self {
        Self {
            pointer: clip(pointer.into()),
            code: code.to_owned(),
            detail: clip(detail.into()),
            suggestion: None,
        }
    }

    /// The same fault with a suggestion.
    #[must_use]
    pub fn suggest(mut self, suggestion: impl Into<String>) -> Self {
        self.suggestion = Some(clip(suggestion.into()));
        self
    }
}

/// The text, or its beginning where it is too long.
fn clip(mut text: String) -> String {
    if let Some((end, _)) = text.char_indices().nth(LONGEST) {
        text.truncate(end);
        text.push('…');
    }
    text
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.pointer, self.detail)?;
        match &self.suggestion {
            Some(suggestion) => write!(f, " ({suggestion})"),
            None => Ok(()),
        }
    }
}

/// The known name closest to `wanted` in edit distance, if it is close enough to be a slip of the pen.
pub fn nearest<'a>(wanted: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let slips = |name: &str| 1 + wanted.len().min(name.len()) / 3;
    known
        .into_iter()
        // What differs by so much in length alone is not worth a comparison, which for a long text is a long
        // one.
        .filter(|name| wanted.len().abs_diff(name.len()) <= 4 * slips(name))
        .map(|name| (edit_distance(wanted, name), name))
        .min()
        .filter(|(distance, name)| *distance <= slips(name))
        .map(|(_, name)| name)
}

/// Levenshtein distance between two short names, ignoring case.
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b) = (a.to_ascii_lowercase(), b.to_ascii_lowercase());
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.bytes().enumerate() {
            let substituted = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

/// A name as an error may show it: short, on one line.
pub(crate) fn shown(name: &str) -> String {
    name.chars().take(60).collect::<String>().escape_debug().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_a_slip_away_or_none() {
        let known = ["alpha_h", "alpha_e", "T_room"];
        assert_eq!(nearest("alpa_h", known), Some("alpha_h"));
        assert_eq!(nearest("t_room", known), Some("T_room"));
        assert_eq!(nearest("wind_speed", known), None);
    }
}
