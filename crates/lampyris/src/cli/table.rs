//! Documents as tables for people.

use serde_json::Value;

/// Stands where there is nothing.
const NOTHING: &str = "-";

/// A column: its heading, and the JSON pointer of its cells.
pub type Column<'a> = (&'a str, &'a str);

/// The items of a list with these columns; a column that no item has is left out.
pub fn items(list: &Value, columns: &[Column]) -> String {
    let rows: Vec<&Value> = list["items"].as_array().into_iter().flatten().collect();
    let mut text = if rows.is_empty() { "nothing".to_owned() } else { rows_of(&rows, columns) };
    if let Some(token) = list["next_page_token"].as_str() {
        text.push_str(&format!("\n… more: --page-token {token}"));
    }
    text
}

/// Documents with these columns; a column that none has is left out.
pub fn rows_of(rows: &[&Value], columns: &[Column]) -> String {
    let there = |column: &&Column| rows.iter().any(|row| row.pointer(column.1).is_some());
    let columns: Vec<&Column> = columns.iter().filter(there).collect();
    let head = columns.iter().map(|column| column.0.to_owned()).collect();
    let cells = rows.iter().map(|row| columns.iter().map(|column| cell(row, column.1)).collect());
    aligned(&std::iter::once(head).chain(cells).collect::<Vec<Vec<String>>>())
}

/// One document, a line per field that says something.
pub fn fields(document: &Value, fields: &[Column]) -> String {
    let cells = fields.iter().map(|field| vec![field.0.to_owned(), cell(document, field.1)]);
    aligned(&cells.filter(|cells| cells[1] != NOTHING).collect::<Vec<_>>())
}

/// Lines whose columns are as wide as their widest cells.
pub fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}"));
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// What stands at a pointer, in a word or two.
pub fn cell(document: &Value, pointer: &str) -> String {
    match document.pointer(pointer) {
        None | Some(Value::Null) => NOTHING.to_owned(),
        Some(Value::Array(values)) if values.is_empty() => NOTHING.to_owned(),
        Some(Value::String(text)) if text.is_empty() => NOTHING.to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(Value::Number(number)) => short(number),
        Some(Value::Array(values)) => {
            values.iter().map(|value| cell(value, "")).collect::<Vec<_>>().join(", ")
        }
        Some(other) => other.to_string(),
    }
}

/// Whole numbers as they are, others with at most five significant digits.
fn short(number: &serde_json::Number) -> String {
    let Some(value) = number.as_f64().filter(|value| number.is_f64() && *value != 0.0) else {
        return number.to_string();
    };
    let decimals = 4 - value.abs().log10().floor() as i32;
    if !(0..=9).contains(&decimals) {
        return format!("{value:.4e}");
    }
    let text = format!("{value:.*}", decimals.unsigned_abs() as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn columns_are_aligned_and_absent_ones_left_out() {
        let list =
            json!({"items": [{"id": "a", "n": 12}, {"id": "long", "n": null}], "next_page_token": "7"});
        let text = items(&list, &[("id", "/id"), ("number", "/n"), ("gone", "/gone")]);
        assert_eq!(text, "id    number\na     12\nlong  -\n… more: --page-token 7");
        assert_eq!(items(&json!({"items": []}), &[("id", "/id")]), "nothing");
    }

    #[test]
    fn numbers_are_short_and_texts_plain() {
        let document = json!({
            "a": 0.000123456, "b": 12345.678, "c": 1.5, "d": 3, "e": 1e-12, "f": ["x", 2.0], "g": 0.0,
            "h": -0.25
        });
        let cells: Vec<String> = ["a", "b", "c", "d", "e", "f", "g", "h"]
            .iter()
            .map(|name| cell(&document, &format!("/{name}")))
            .collect();
        assert_eq!(cells, ["0.00012346", "12346", "1.5", "3", "1.0000e-12", "x, 2", "0.0", "-0.25"]);
    }
}
