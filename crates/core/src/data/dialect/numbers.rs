//! Numbers with commas.

use crate::fault::Fault;
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

/// What stands between thousands where the comma stands before decimals.
const THOUSANDS: [char; 5] = ['.', ' ', '\u{a0}', '\u{202f}', '\''];

/// Whether a text is a number with a decimal comma, thousands apart or not: `21,5`, `1.013,25`, `1 013,25`.
fn has_comma(text: &str) -> bool {
    let body = text.trim().trim_start_matches(['-', '+']);
    let Some((whole, decimals)) = body.split_once(',') else { return false };
    let digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    let exponent = decimals.split(['e', 'E']).next().unwrap_or_default();
    !decimals.is_empty() && digits(exponent) && !whole.is_empty() && is_grouped(whole, &THOUSANDS)
}

/// Whether digits are written together, or thousands apart.
fn is_grouped(whole: &str, thousands: &[char]) -> bool {
    let mut groups = whole.split(thousands);
    let first = groups.next().unwrap_or_default();
    let digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    digits(first) && groups.all(|group| group.len() == 3 && digits(group))
}

/// Whether the mark of a number may stand before its decimals or its thousands: `1,250`.
fn is_doubtful(text: &str, mark: char) -> bool {
    let body = text.trim().trim_start_matches(['-', '+']);
    let digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    body.split_once(mark).is_some_and(|(whole, rest)| {
        let is_start = (1..=3).contains(&whole.len()) && !whole.starts_with('0');
        is_start && rest.len() == 3 && digits(whole) && digits(rest)
    })
}

/// The mark that most numbers with decimals among these cells have. Those that may have thousands say
/// nothing; where there are no others, commas between cells leave open what those inside of numbers mean.
///
/// # Errors
/// Where it is open.
pub(super) fn decimal_mark<'a>(
    cells: impl Iterator<Item = &'a str>,
    separator: u8,
) -> Result<DecimalMark, Fault> {
    let (mut commas, mut points, mut doubtful) = (0_usize, 0_usize, None);
    for cell in cells {
        if is_doubtful(cell, ',') {
            doubtful = doubtful.or(Some(cell));
        } else if has_comma(cell) {
            commas += 1;
        } else if cell.contains('.') && !is_doubtful(cell, '.') && cell.trim().parse::<f64>().is_ok() {
            points += 1;
        }
    }
    match doubtful.filter(|_| commas == 0 && points == 0) {
        Some(cell) if separator == b',' => {
            let detail = format!("`{}` could be two numbers: is its comma one of thousands?", cell.trim());
            Err(Fault::new("decimal", "ambiguous-decimals", detail)
                .suggest("say decimal=point or decimal=comma"))
        }
        Some(_) => Ok(DecimalMark::Comma),
        None => Ok(if commas > points { DecimalMark::Comma } else { DecimalMark::Point }),
    }
}

/// A cell as the parser reads it. What is no number stays as it is.
pub(super) fn with_point(cell: &str, mark: DecimalMark) -> Cow<'_, str> {
    let trimmed = cell.trim();
    let body = trimmed.trim_start_matches(['-', '+']);
    match mark {
        DecimalMark::Comma
            if has_comma(trimmed) || body.contains(THOUSANDS) && is_grouped(body, &THOUSANDS) =>
        {
            Cow::Owned(trimmed.replace(THOUSANDS, "").replace(',', "."))
        }
        DecimalMark::Point if has_thousands(body) => Cow::Owned(trimmed.replace(',', "")),
        _ => Cow::Borrowed(cell),
    }
}

/// Whether commas stand between thousands: `1,250` and `1,250.5`, and not `0,350`.
fn has_thousands(body: &str) -> bool {
    let whole = body.split('.').next().unwrap_or_default();
    let is_start = whole.find(',').is_some_and(|at| (1..=3).contains(&at)) && !whole.starts_with('0');
    is_start && is_grouped(whole, &[','])
}
