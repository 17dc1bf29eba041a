//! The names that the language has a meaning for: its functions and its numbers. The parser, the lowering and
//! whoever describes the language read the same tables.

use super::expr::{Binary, Unary};
use serde::Serialize;
use utoipa::ToSchema;

/// A function of the language, for people.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct LanguageFunction {
    /// Its name.
    pub name: &'static str,
    /// What stands between its parentheses, in order.
    pub arguments: &'static [&'static str],
    /// What it gives.
    pub meaning: &'static str,
    /// Which units its arguments may have, and which one it has.
    pub units: &'static str,
}

/// A number with a name.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct LanguageConstant {
    /// Its name. A model may give it to something of its own.
    pub name: &'static str,
    /// Its value, a pure number.
    pub value: f64,
}

/// What a function does with the values of its arguments.
#[derive(Debug, Clone, Copy)]
pub(super) enum Builtin {
    If,
    Convert,
    /// Of two like quantities.
    Alike(Binary),
    Abs,
    Sqrt,
    /// Of a pure number.
    Transcendental(Unary),
}

const fn function(
    name: &'static str,
    arguments: &'static [&'static str],
    meaning: &'static str,
    units: &'static str,
) -> LanguageFunction {
    LanguageFunction { name, arguments, meaning, units }
}

const LIKE: &str = "a and b are like quantities; the result is one, too";
const OF_A_NUMBER: &str =
    "x is a pure number, or one in deg or pct, which is scaled first; the result is a pure number";

/// The functions of the values of their arguments.
pub(super) const FUNCTIONS: [(LanguageFunction, Builtin); 11] = [
    (
        function(
            "if",
            &["condition", "then", "else"],
            "`then` where the condition is not 0, else `else`; both are computed",
            "then and else are like quantities; the result is one of them",
        ),
        Builtin::If,
    ),
    (
        function(
            "convert",
            &["x", "1[unit]"],
            "the same quantity, counted in another unit",
            "the units differ by a factor alone; the result has that of the second argument",
        ),
        Builtin::Convert,
    ),
    (function("min", &["a", "b"], "the smaller one", LIKE), Builtin::Alike(Binary::Min)),
    (function("max", &["a", "b"], "the larger one", LIKE), Builtin::Alike(Binary::Max)),
    (function("abs", &["x"], "x without its sign", "any; the result has that of x"), Builtin::Abs),
    (
        function(
            "sqrt",
            &["x"],
            "the square root of something that cannot be negative",
            "a unit whose exponents are even; the result has half of each",
        ),
        Builtin::Sqrt,
    ),
    (function("exp", &["x"], "e to the power of x", OF_A_NUMBER), Builtin::Transcendental(Unary::Exp)),
    (function("log", &["x"], "the natural logarithm", OF_A_NUMBER), Builtin::Transcendental(Unary::Log)),
    (function("sin", &["x"], "the sine", OF_A_NUMBER), Builtin::Transcendental(Unary::Sin)),
    (function("cos", &["x"], "the cosine", OF_A_NUMBER), Builtin::Transcendental(Unary::Cos)),
    (function("tanh", &["x"], "the hyperbolic tangent", OF_A_NUMBER), Builtin::Transcendental(Unary::Tanh)),
];

/// What reads its arguments itself, because it needs the input behind the first one.
pub(super) const DELAY: LanguageFunction = function(
    "delay",
    &["input", "hours"],
    "what an input was so many hours ago; the delay is made of parameters and numbers, is never negative and has \
    a limit",
    "the delay has the unit h; the result has that of the input",
);

/// What the parser reads by itself, because it declares an index.
pub(super) const SUMMATION: LanguageFunction = function(
    "sum",
    &["n in set: x"],
    "the sum of x over the members of a set; nothing over none",
    "any; the result has that of x",
);

/// The numbers that have names.
pub const CONSTANTS: [LanguageConstant; 1] = [LanguageConstant { name: "pi", value: std::f64::consts::PI }];

/// Every function of the language.
pub fn functions() -> impl Iterator<Item = LanguageFunction> {
    FUNCTIONS.iter().map(|(function, _)| *function).chain([DELAY, SUMMATION])
}
