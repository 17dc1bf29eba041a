//! How expressions are written in a language.

use crate::model::expr::{Binary, Unary};

/// A language of expressions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dialect {
    /// That of the model documents.
    Plain,
    /// Python on numpy.
    Numpy,
    /// Python on CasADi.
    Casadi,
    /// Modelica.
    Modelica,
    /// LaTeX.
    Latex,
    /// MathML: elements that stand side by side.
    Mathml,
}

/// A written expression, and how tightly it holds together.
#[derive(Debug, Clone, PartialEq)]
pub struct Phrase {
    /// The text.
    pub text: String,
    tie: Tie,
    /// What has to hold for it to be one and not zero, where it is a comparison.
    holds: Option<String>,
}

/// How tightly an expression holds together: one that is looser than its surroundings needs brackets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Tie {
    Sum,
    Product,
    Power,
    Whole,
}

impl Phrase {
    /// A name, a number that is not negative, a call.
    pub fn whole(text: impl Into<String>) -> Self {
        Self::new(text.into(), Tie::Whole)
    }

    fn new(text: String, tie: Tie) -> Self {
        Self { text, tie, holds: None }
    }

    /// The text where it must hold together at least so tightly.
    fn at(&self, tie: Tie, dialect: Dialect) -> String {
        if self.tie >= tie { self.text.clone() } else { dialect.brackets(&self.text) }
    }
}

impl Dialect {
    fn brackets(self, text: &str) -> String {
        match self {
            Dialect::Latex => format!("\\left({text}\\right)"),
            Dialect::Mathml => format!("<mrow><mo>(</mo>{text}<mo>)</mo></mrow>"),
            _ => format!("({text})"),
        }
    }

    /// Whether it is for people, who read what is left out.
    pub fn is_typeset(self) -> bool {
        matches!(self, Dialect::Latex | Dialect::Mathml)
    }

    /// Two texts with a sign between them.
    fn joined(self, left: &str, sign: &str, right: &str) -> String {
        match self {
            Dialect::Mathml => format!("{left}<mo>{sign}</mo>{right}"),
            _ => format!("{left} {sign} {right}"),
        }
    }

    /// A number, to its last bit.
    pub fn number(self, value: f64) -> Phrase {
        let text = format!("{value:?}");
        let (digits, power) = match text.split_once('e') {
            Some((digits, power)) => (digits, Some(power)),
            None => (text.as_str(), None),
        };
        let short = digits.trim_end_matches(".0");
        let tie = if value < 0.0 { Tie::Sum } else { Tie::Whole };
        match (self, power) {
            (Dialect::Latex, Some(power)) => {
                Phrase::new(format!("{short} \\cdot 10^{{{power}}}"), tie.min(Tie::Product))
            }
            (Dialect::Mathml, Some(power)) => {
                let (digits, power) = (signed(short), signed(power));
                let text = format!("{digits}<mo>\u{22c5}</mo><msup><mn>10</mn><mrow>{power}</mrow></msup>");
                Phrase::new(text, tie.min(Tie::Product))
            }
            (Dialect::Latex | Dialect::Plain, None) => Phrase::new(short.to_owned(), tie),
            (Dialect::Mathml, None) => Phrase::new(signed(short), tie),
            _ => Phrase::new(text, tie),
        }
    }

    fn call(self, name: &str, arguments: &str) -> Phrase {
        let text = match self {
            Dialect::Numpy => format!("np.{name}({arguments})"),
            Dialect::Casadi => format!("ca.{name}({arguments})"),
            Dialect::Latex => format!("\\{name}\\left({arguments}\\right)"),
            Dialect::Mathml => {
                format!("<mrow><mi>{name}</mi><mo>\u{2061}</mo>{}</mrow>", self.brackets(arguments))
            }
            Dialect::Plain | Dialect::Modelica => format!("{name}({arguments})"),
        };
        Phrase::whole(text)
    }

    /// An operation on one expression.
    pub fn unary(self, op: Unary, x: &Phrase) -> Phrase {
        let name = match op {
            Unary::Neg => {
                let sign = if self == Dialect::Mathml { "<mo form=\"prefix\">\u{2212}</mo>" } else { "-" };
                return Phrase::new(format!("{sign}{}", x.at(Tie::Product, self)), Tie::Sum);
            }
            Unary::Abs if self == Dialect::Latex => {
                return Phrase::whole(format!("\\left|{}\\right|", x.text));
            }
            Unary::Abs if self == Dialect::Mathml => {
                return Phrase::whole(format!("<mrow><mo>|</mo>{}<mo>|</mo></mrow>", x.text));
            }
            Unary::Sqrt if self == Dialect::Latex => return Phrase::whole(format!("\\sqrt{{{}}}", x.text)),
            Unary::Sqrt if self == Dialect::Mathml => {
                return Phrase::whole(format!("<msqrt>{}</msqrt>", x.text));
            }
            Unary::Abs if self == Dialect::Casadi => "fabs",
            Unary::Abs => "abs",
            Unary::Exp => "exp",
            Unary::Log => "log",
            Unary::Sqrt => "sqrt",
            Unary::Sin => "sin",
            Unary::Cos => "cos",
            Unary::Tanh => "tanh",
        };
        self.call(name, &x.text)
    }

    /// An operation on two expressions. What stands on the right keeps its brackets, so that every language
    /// rounds as the service does.
    pub fn binary(self, op: Binary, a: &Phrase, b: &Phrase) -> Phrase {
        let between = |sign: &str, tie: Tie, right: Tie| {
            Phrase::new(self.joined(&a.at(tie, self), sign, &b.at(right, self)), tie)
        };
        let comma = if self == Dialect::Mathml { "<mo>,</mo>" } else { ", " };
        let both = format!("{}{comma}{}", a.text, b.text);
        match op {
            // Brackets that say nothing but the order of additions are left out where nobody computes.
            Binary::Add if self.is_typeset() => between("+", Tie::Sum, Tie::Sum),
            Binary::Add => between("+", Tie::Sum, Tie::Product),
            Binary::Sub if self == Dialect::Mathml => between("\u{2212}", Tie::Sum, Tie::Product),
            Binary::Sub => between("-", Tie::Sum, Tie::Product),
            Binary::Mul if self == Dialect::Latex => between("\\,", Tie::Product, Tie::Product),
            Binary::Mul if self == Dialect::Mathml => {
                let times = "<mo lspace=\"0.12em\" rspace=\"0.12em\">\u{2062}</mo>";
                Phrase::new(
                    [&a.at(Tie::Product, self), times, &b.at(Tie::Product, self)].concat(),
                    Tie::Product,
                )
            }
            Binary::Mul => between("*", Tie::Product, Tie::Power),
            Binary::Div if self == Dialect::Latex => {
                Phrase::new(format!("\\frac{{{}}}{{{}}}", a.text, b.text), Tie::Product)
            }
            Binary::Div if self == Dialect::Mathml => Phrase::new(
                format!("<mfrac><mrow>{}</mrow><mrow>{}</mrow></mfrac>", a.text, b.text),
                Tie::Product,
            ),
            Binary::Div => between("/", Tie::Product, Tie::Power),
            Binary::Pow => {
                let base = a.at(Tie::Whole, self);
                let text = match self {
                    Dialect::Latex => format!("{base}^{{{}}}", b.text),
                    Dialect::Mathml => format!("<msup><mrow>{base}</mrow><mrow>{}</mrow></msup>", b.text),
                    Dialect::Numpy | Dialect::Casadi => format!("{base} ** {}", b.at(Tie::Whole, self)),
                    // What is never negative need not show it any more, and the language wants to see it.
                    Dialect::Plain => format!("abs({})^{}", a.text, b.at(Tie::Whole, self)),
                    Dialect::Modelica => format!("{base}^{}", b.at(Tie::Whole, self)),
                };
                Phrase::new(text, Tie::Power)
            }
            Binary::Min => self.call(self.extreme("min"), &both),
            Binary::Max => self.call(self.extreme("max"), &both),
            Binary::Less => self.comparison(if self == Dialect::Mathml { "&lt;" } else { "<" }, a, b),
            Binary::LessEqual => {
                let sign = match self {
                    Dialect::Latex => "\\le",
                    Dialect::Mathml => "\u{2264}",
                    _ => "<=",
                };
                self.comparison(sign, a, b)
            }
            Binary::Equal => self.comparison(if self.is_typeset() { "=" } else { "==" }, a, b),
        }
    }

    fn extreme(self, name: &'static str) -> &'static str {
        match (self, name) {
            (Dialect::Numpy, "min") => "minimum",
            (Dialect::Numpy, _) => "maximum",
            (Dialect::Casadi, "min") => "fmin",
            (Dialect::Casadi, _) => "fmax",
            _ => name,
        }
    }

    /// One where it holds, zero where it does not.
    fn comparison(self, sign: &str, a: &Phrase, b: &Phrase) -> Phrase {
        // Modelica compares no reals for equality.
        let holds = match (self, sign) {
            (Dialect::Modelica, "==") => format!("abs({} - {}) <= 0.0", a.text, b.at(Tie::Product, self)),
            _ => self.joined(&a.at(Tie::Sum, self), sign, &b.at(Tie::Sum, self)),
        };
        let text = match self {
            Dialect::Plain => format!("({holds})"),
            Dialect::Numpy => format!("np.where({holds}, 1.0, 0.0)"),
            Dialect::Casadi => format!("ca.if_else({holds}, 1.0, 0.0)"),
            Dialect::Modelica => format!("(if {holds} then 1.0 else 0.0)"),
            Dialect::Latex => format!("\\left[{holds}\\right]"),
            Dialect::Mathml => format!("<mrow><mo>[</mo>{holds}<mo>]</mo></mrow>"),
        };
        Phrase { holds: Some(holds), ..Phrase::whole(text) }
    }

    /// `a` where the condition is not zero, else `b`.
    pub fn select(self, condition: &Phrase, a: &Phrase, b: &Phrase) -> Phrase {
        let unequal = || match self {
            Dialect::Modelica => format!("abs({}) > 0.0", condition.text),
            Dialect::Latex => format!("{} \\ne 0", condition.at(Tie::Sum, self)),
            Dialect::Mathml => self.joined(&condition.at(Tie::Sum, self), "\u{2260}", "<mn>0</mn>"),
            _ => format!("{} != 0.0", condition.at(Tie::Sum, self)),
        };
        let (a, b) = (&a.text, &b.text);
        let holds = condition.holds.clone().unwrap_or_else(unequal);
        Phrase::whole(match self {
            // The language itself takes any number for a condition.
            Dialect::Plain => format!("if({}, {a}, {b})", condition.text),
            Dialect::Numpy => format!("np.where({holds}, {a}, {b})"),
            Dialect::Casadi => format!("ca.if_else({holds}, {a}, {b})"),
            Dialect::Modelica => format!("(if {holds} then {a} else {b})"),
            Dialect::Mathml => format!(
                "<mrow><mo>{{</mo><mtable><mtr><mtd>{a}</mtd><mtd><mtext>if\u{a0}</mtext>{holds}</mtd></mtr>\
                <mtr><mtd>{b}</mtd><mtd><mtext>else</mtext></mtd></mtr></mtable></mrow>"
            ),
            Dialect::Latex => {
                format!(
                    "\\begin{{cases}} {a} & \\text{{if }} {holds} \\\\ {b} & \\text{{else}} \\end{{cases}}"
                )
            }
        })
    }
}

/// A number in MathML, with a minus of its own.
fn signed(digits: &str) -> String {
    match digits.strip_prefix('-') {
        Some(digits) => format!("<mo form=\"prefix\">\u{2212}</mo><mn>{digits}</mn>"),
        None => format!("<mn>{digits}</mn>"),
    }
}
