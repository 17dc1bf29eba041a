//! A model as equations that a page shows without any help: MathML Core.

use super::dialect::Dialect;
use super::typeset::{SymbolParts, Typesetting, lines};
use crate::model::Model;
use std::fmt::Write;

/// How MathML writes the parts of an equation. Names are letters, digits and underscores, which need no
/// escapes.
const TYPESETTING: Typesetting = Typesetting {
    dialect: Dialect::Mathml,
    symbol,
    rate: |name| {
        format!(
            "<mfrac><mrow><mi mathvariant=\"normal\">d</mi>{name}</mrow>\
            <mrow><mi mathvariant=\"normal\">d</mi><mi>t</mi></mrow></mfrac>"
        )
    },
};

/// The equations, one in each row of a table: left side, sign, right side.
pub fn text(model: &Model) -> String {
    let mut text = String::from(
        "<math xmlns=\"http://www.w3.org/1998/Math/MathML\" display=\"block\"><mtable displaystyle=\"true\">\n",
    );
    for (left, right) in lines(model, &TYPESETTING) {
        let _ = writeln!(text, "<mtr><mtd>{left}</mtd><mtd><mo>=</mo></mtd><mtd>{right}</mtd></mtr>");
    }
    text.push_str("</mtable></math>\n");
    text
}

fn symbol(SymbolParts { base, greek, index }: SymbolParts) -> String {
    let base = match greek {
        Some(letter) => format!("<mi>{letter}</mi>"),
        // A word stands upright, a letter does not.
        None => format!("<mi>{base}</mi>"),
    };
    if index.is_empty() { base } else { format!("<msub>{base}<mtext>{index}</mtext></msub>") }
}
