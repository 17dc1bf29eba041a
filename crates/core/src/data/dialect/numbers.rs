//! Numbers with commas.

use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use utoipa::ToSchema;

/// The mark before the decimals of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DecimalMark {
    /// 21.5
    Point,
    /// 21,5
    Comma,
}

impl std::str::FromStr for DecimalMark {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "point" => Ok(DecimalMark::Point),
            "comma" => Ok(DecimalMark::Comma),
            _ => Err("one of point, comma".to_owned()),
        }
    }
}

/// Whether a text is a number with a decimal comma, thousands apart or not: `21,5`, `1.013,25`, `1 013,25`.
fn has_comma(text: &str) -> bool {
    let body = text.trim().trim_start_matches(['-', '+']);
    let Some((whole, decimals)) = body.split_once(',') else { return false };
    let digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    let exponent = decimals.split(['e', 'E']).next().unwrap_or_default();
    !decimals.is_empty() && digits(exponent) && !whole.is_empty() && is_grouped(whole)
}

/// Whether digits are written together, or thousands apart.
fn is_grouped(whole: &str) -> bool {
    let mut groups = whole.split(['.', ' ', '\u{a0}', '\u{202f}', '\'']);
    let first = groups.next().unwrap_or_default();
    let digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    digits(first) && groups.all(|group| group.len() == 3 && digits(group))
}

/// The mark that most numbers with decimals among these cells have.
pub(super) fn decimal_mark(cells: &[&str]) -> DecimalMark {
    let commas = cells.iter().filter(|cell| has_comma(cell)).count();
    let points = cells.iter().filter(|cell| cell.contains('.') && cell.trim().parse::<f64>().is_ok()).count();
    if commas > points { DecimalMark::Comma } else { DecimalMark::Point }
}

/// A cell with decimal commas as the parser reads it. What is no such number stays as it is.
pub(super) fn with_point(cell: &str) -> Cow<'_, str> {
    let trimmed = cell.trim();
    let whole = trimmed.trim_start_matches(['-', '+']);
    let is_whole = whole.contains(['.', ' ', '\u{a0}', '\u{202f}', '\'']) && is_grouped(whole);
    if !has_comma(trimmed) && !is_whole {
        return Cow::Borrowed(cell);
    }
    let point = |mark: char| match mark {
        ',' => Some('.'),
        '.' | ' ' | '\u{a0}' | '\u{202f}' | '\'' => None,
        other => Some(other),
    };
    Cow::Owned(trimmed.chars().filter_map(point).collect())
}
