//! The equations of a model as lines for people, whatever they are typeset with.

use super::dialect::Dialect;
use super::listing::{listing, numbered};
use super::names::Names;
use crate::model::Model;
use crate::model::expr::NodeId;

/// Greek letters, by the names that equations give them.
const GREEK: [(&str, char); 23] = [
    ("alpha", 'α'),
    ("beta", 'β'),
    ("gamma", 'γ'),
    ("delta", 'δ'),
    ("epsilon", 'ε'),
    ("zeta", 'ζ'),
    ("eta", 'η'),
    ("theta", 'θ'),
    ("iota", 'ι'),
    ("kappa", 'κ'),
    ("lambda", 'λ'),
    ("mu", 'μ'),
    ("nu", 'ν'),
    ("xi", 'ξ'),
    ("pi", 'π'),
    ("rho", 'ρ'),
    ("sigma", 'σ'),
    ("tau", 'τ'),
    ("upsilon", 'υ'),
    ("phi", 'φ'),
    ("chi", 'χ'),
    ("psi", 'ψ'),
    ("omega", 'ω'),
];

/// A name in its parts: what follows the first underscore is its index.
pub struct SymbolParts<'a> {
    /// What it is.
    pub base: &'a str,
    /// The letter, where the base is the name of one.
    pub greek: Option<char>,
    /// Which one it is; empty where there is but one.
    pub index: String,
}

impl<'a> SymbolParts<'a> {
    fn of(name: &'a str) -> Self {
        let (base, index) = name.split_once('_').unwrap_or((name, ""));
        let greek = GREEK.iter().find(|(name, _)| *name == base).map(|(_, letter)| *letter);
        Self { base, greek, index: index.trim_matches('_').replace('_', ",") }
    }
}

/// How a language of formulas writes what lines are made of.
pub struct Typesetting {
    /// Its expressions.
    pub dialect: Dialect,
    /// A name.
    pub symbol: fn(SymbolParts) -> String,
    /// The derivative of a symbol.
    pub rate: fn(&str) -> String,
}

/// The two sides of every equation: derivatives, outputs, and what these call by a number.
pub fn lines(model: &Model, typesetting: &Typesetting) -> Vec<(String, String)> {
    let Typesetting { dialect, symbol, rate } = typesetting;
    let names = Names::new(model);
    let numbered = numbered(&names);
    let names = names.map(|name| symbol(SymbolParts::of(name)));
    let called = |number| {
        let name: String = numbered(number);
        let digits = name.trim_start_matches(char::is_alphabetic).to_owned();
        let base = name.trim_end_matches(char::is_numeric);
        symbol(SymbolParts { base, greek: None, index: digits })
    };
    let outputs = model.outputs().iter().map(|output| output.node);
    let roots: Vec<NodeId> = model.rhs().iter().copied().chain(outputs).collect();
    let listing = listing(model.graph(), &roots, &names, *dialect, called);
    let states = names.states.iter().map(|name| rate(name));
    let left = states.chain(names.outputs.iter().cloned());
    left.zip(listing.roots).chain(listing.definitions).collect()
}
