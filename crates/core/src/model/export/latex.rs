//! A model as equations for people.

use super::dialect::Dialect;
use super::typeset::{SymbolParts, Typesetting, lines};
use crate::model::Model;

/// How LaTeX writes the parts of an equation.
const TYPESETTING: Typesetting = Typesetting {
    dialect: Dialect::Latex,
    symbol,
    rate: |name| format!("\\frac{{\\mathrm{{d}} {name}}}{{\\mathrm{{d}} t}}"),
};

/// The equations, aligned.
pub fn text(model: &Model) -> String {
    let lines: Vec<String> =
        lines(model, &TYPESETTING).into_iter().map(|(left, right)| format!("{left} &= {right}")).collect();
    format!("\\begin{{align*}}\n{}\n\\end{{align*}}\n", lines.join(" \\\\\n"))
}

fn symbol(SymbolParts { base, greek, index }: SymbolParts) -> String {
    let base = match greek {
        Some(_) => format!("\\{base}"),
        None if base.len() <= 1 => base.to_owned(),
        None => format!("\\mathrm{{{base}}}"),
    };
    if index.is_empty() { base } else { format!("{base}_{{\\mathrm{{{index}}}}}") }
}
