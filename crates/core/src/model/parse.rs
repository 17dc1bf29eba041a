//! Text to syntax tree: a Pratt parser with positions and a depth limit, for expressions that strangers send.
//! `grammar` says what it takes.

use super::builtin::SUMMATION;
use super::expr::Binary;
use super::token::{MAX_NAME, Placed, SyntaxError, TextPosition, Token, describe, is_name, tokens};

/// A syntax tree with the place where each part stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Expr {
    /// Where it begins, or where its operator stands.
    pub at: TextPosition,
    /// What it is.
    pub kind: ExprKind,
    /// How many levels it nests, chains of operators included.
    height: usize,
}

impl Expr {
    /// The same tree with one name or member replaced by another name.
    #[must_use]
    pub fn renamed(self, from: &str, to: &str) -> Self {
        let inner = |x: Box<Expr>| Box::new(x.renamed(from, to));
        let kind = match self.kind {
            ExprKind::Name(name) if name == from => ExprKind::Name(to.to_owned()),
            ExprKind::Member(family, index) if format!("{family}[{index}]") == from => {
                ExprKind::Name(to.to_owned())
            }
            ExprKind::Negate(x) => ExprKind::Negate(inner(x)),
            ExprKind::Binary(op, a, b) => ExprKind::Binary(op, inner(a), inner(b)),
            ExprKind::Call(name, arguments) => {
                ExprKind::Call(name, arguments.into_iter().map(|x| x.renamed(from, to)).collect())
            }
            ExprKind::Sum { variable, set, body } => ExprKind::Sum { variable, set, body: inner(body) },
            other => other,
        };
        Self { kind, ..self }
    }

    fn new(at: TextPosition, kind: ExprKind) -> Self {
        let below = match &kind {
            ExprKind::Number(..) | ExprKind::Name(_) | ExprKind::Member(..) => 0,
            ExprKind::Negate(x) => x.height,
            ExprKind::Binary(_, a, b) => a.height.max(b.height),
            ExprKind::Call(_, arguments) => arguments.iter().map(|x| x.height).max().unwrap_or(0),
            ExprKind::Sum { body, .. } => body.height,
        };
        Self { at, kind, height: below + 1 }
    }
}

/// The kinds of expressions.
#[derive(Debug, Clone, PartialEq)]
pub enum ExprKind {
    /// A number with the unit behind it, if any.
    Number(f64, Option<String>),
    /// A name.
    Name(String),
    /// A member of a family, `alpha_n[n]` by the index of a sum or `TSS[1]` by its own name.
    Member(String, String),
    /// Change of sign.
    Negate(Box<Expr>),
    /// An operation on two operands.
    Binary(Binary, Box<Expr>, Box<Expr>),
    /// A function call.
    Call(String, Vec<Expr>),
    /// `sum(variable in set: body)`.
    Sum {
        /// The index variable.
        variable: String,
        /// The set that it runs over.
        set: String,
        /// What is summed.
        body: Box<Expr>,
    },
}

/// Longest text of one expression in bytes.
pub const MAX_LENGTH: usize = 16 * 1024;
/// Deepest nesting of parentheses, calls and signs.
pub const MAX_DEPTH: usize = 64;
/// Deepest tree: a chain of sums nests to the left without parentheses.
pub(super) const MAX_HEIGHT: usize = 512;

/// Parses one expression.
///
/// # Errors
/// [`SyntaxError`] at the first place where the text cannot go on.
pub fn parse(text: &str) -> Result<Expr, SyntaxError> {
    if text.len() > MAX_LENGTH {
        let at = TextPosition { line: 1, column: 1 };
        return Err(SyntaxError {
            at,
            message: format!("the expression has {} bytes, the limit is {MAX_LENGTH}", text.len()),
        });
    }
    let mut parser = Parser { tokens: tokens(text)?, next: 0, text };
    let expr = parser.expression(0, 0)?;
    match parser.peek() {
        (Token::End, _) => Ok(expr),
        (token, at) => Err(SyntaxError { at, message: format!("{} is not expected here", describe(&token)) }),
    }
}

/// The name, index variable and set of a declaration such as `alpha_n[n in neighbours]`; the bare name
/// otherwise.
pub fn declaration(text: &str) -> Option<(&str, Option<(&str, &str)>)> {
    let Some((name, rest)) = text.split_once('[') else {
        return is_name(text).then_some((text, None));
    };
    let (variable, set) = rest.strip_suffix(']')?.split_once(" in ")?;
    let (variable, set) = (variable.trim(), set.trim());
    (is_name(name) && is_name(variable) && is_name(set)).then_some((name, Some((variable, set))))
}

/// Whether a text is a name or a member of a family by name, `S_NH[aerobic]`.
pub fn is_quantity(text: &str) -> bool {
    let member = |text: &str| {
        text.len() <= MAX_NAME
            && !text.is_empty()
            && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    match text.split_once('[') {
        Some((name, rest)) => is_name(name) && rest.strip_suffix(']').is_some_and(member),
        None => is_name(text),
    }
}

struct Parser<'a> {
    tokens: Vec<Placed>,
    next: usize,
    text: &'a str,
}

/// The operators between two operands: how one is written, how strongly it binds on its left, and what it
/// means.
const OPERATORS: [(&str, u8, Binary); 10] = [
    ("<", 1, Binary::Less),
    (">", 1, Binary::Less),
    ("<=", 1, Binary::LessEqual),
    (">=", 1, Binary::LessEqual),
    ("==", 1, Binary::Equal),
    ("+", 3, Binary::Add),
    ("-", 3, Binary::Sub),
    ("*", 5, Binary::Mul),
    ("/", 5, Binary::Div),
    ("^", 9, Binary::Pow),
];

impl Parser<'_> {
    fn peek(&self) -> (Token, TextPosition) {
        let (token, at, _) = &self.tokens[self.next];
        (token.clone(), *at)
    }

    fn advance(&mut self) -> (Token, TextPosition) {
        let current = self.peek();
        // The end token stays: there is nothing behind it.
        self.next = (self.next + 1).min(self.tokens.len() - 1);
        current
    }

    fn accept(&mut self, symbol: &str) -> bool {
        let found = matches!(&self.tokens[self.next].0, Token::Symbol(s) if *s == symbol);
        if found {
            self.advance();
        }
        found
    }

    fn expect(&mut self, symbol: &str) -> Result<(), SyntaxError> {
        if self.accept(symbol) {
            return Ok(());
        }
        let (token, at) = self.peek();
        Err(SyntaxError { at, message: format!("`{symbol}` is missing before {}", describe(&token)) })
    }

    fn name(&mut self, what: &str) -> Result<String, SyntaxError> {
        match self.advance() {
            (Token::Name(name), _) => Ok(name),
            (token, at) => {
                Err(SyntaxError { at, message: format!("{what} is expected, not {}", describe(&token)) })
            }
        }
    }

    fn expression(&mut self, strength: u8, depth: usize) -> Result<Expr, SyntaxError> {
        let mut left = self.operand(depth)?;
        while let (Token::Symbol(symbol), at) = self.peek() {
            let Some((_, left_strength, op)) = OPERATORS.iter().find(|(known, ..)| *known == symbol) else {
                break;
            };
            if *left_strength <= strength {
                break;
            }
            // Whoever walks the tree recurses; its height must fit on a small stack.
            if left.height > MAX_HEIGHT {
                return Err(too_deep(at));
            }
            self.advance();
            // The power binds to the right: its right operand may hold another power.
            let inner = if *op == Binary::Pow { left_strength - 1 } else { *left_strength };
            let right = self.expression(inner, depth + 1)?;
            let swapped = matches!(symbol, ">" | ">=");
            let (a, b) = if swapped { (right, left) } else { (left, right) };
            left = Expr::new(at, ExprKind::Binary(*op, Box::new(a), Box::new(b)));
        }
        Ok(left)
    }

    fn operand(&mut self, depth: usize) -> Result<Expr, SyntaxError> {
        let (token, at) = self.advance();
        if depth >= MAX_DEPTH {
            return Err(too_deep(at));
        }
        let kind = match token {
            Token::Number(value) => ExprKind::Number(value, self.unit_behind_number()?),
            Token::Symbol("-") => ExprKind::Negate(Box::new(self.expression(6, depth + 1)?)),
            Token::Symbol("+") => return self.expression(6, depth + 1),
            Token::Symbol("(") => {
                let inner = self.expression(0, depth + 1)?;
                self.expect(")")?;
                return Ok(inner);
            }
            Token::Name(name) if self.accept("(") => self.call(name, depth)?,
            Token::Name(name) if self.accept("[") => {
                let index = match self.advance() {
                    (Token::Name(index), _) => index,
                    (Token::Number(index), _) if index.fract() == 0.0 => index.to_string(),
                    (token, at) => {
                        return Err(SyntaxError {
                            at,
                            message: format!("an index or a member is expected, not {}", describe(&token)),
                        });
                    }
                };
                self.expect("]")?;
                ExprKind::Member(name, index)
            }
            Token::Name(name) => ExprKind::Name(name),
            other => {
                return Err(SyntaxError {
                    at,
                    message: format!("a value is expected, not {}", describe(&other)),
                });
            }
        };
        Ok(Expr::new(at, kind))
    }

    /// `1000[W/m2]`: the unit's own syntax is read by the unit parser.
    fn unit_behind_number(&mut self) -> Result<Option<String>, SyntaxError> {
        let start = self.tokens[self.next].2;
        if !self.accept("[") {
            return Ok(None);
        }
        while !matches!(self.peek().0, Token::Symbol("]") | Token::End) {
            self.advance();
        }
        let end = self.tokens[self.next].2.saturating_sub(1).max(start);
        self.expect("]")?;
        Ok(Some(self.text[start..end].to_owned()))
    }

    fn call(&mut self, name: String, depth: usize) -> Result<ExprKind, SyntaxError> {
        if name == SUMMATION.name {
            let variable = self.name("an index variable")?;
            let (word, at) = self.advance();
            if word != Token::Name("in".to_owned()) {
                return Err(SyntaxError {
                    at,
                    message: "a sum is written `sum(n in set: expression)`".to_owned(),
                });
            }
            let set = self.name("the name of a set")?;
            self.expect(":")?;
            let body = Box::new(self.expression(0, depth + 1)?);
            self.expect(")")?;
            return Ok(ExprKind::Sum { variable, set, body });
        }
        let mut arguments = Vec::new();
        if !self.accept(")") {
            loop {
                arguments.push(self.expression(0, depth + 1)?);
                if !self.accept(",") {
                    break;
                }
            }
            self.expect(")")?;
        }
        Ok(ExprKind::Call(name, arguments))
    }
}

fn too_deep(at: TextPosition) -> SyntaxError {
    SyntaxError {
        at,
        message: format!(
            "the expression is nested too deep (at most {MAX_DEPTH} parentheses, {MAX_HEIGHT} operators in a \
            chain)"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{prop_assert, proptest};

    /// Fully parenthesised, for comparing shapes.
    fn shape(expr: &Expr) -> String {
        match &expr.kind {
            ExprKind::Number(value, None) => format!("{value}"),
            ExprKind::Number(value, Some(unit)) => format!("{value}[{unit}]"),
            ExprKind::Name(name) => name.clone(),
            ExprKind::Member(name, index) => format!("{name}[{index}]"),
            ExprKind::Negate(x) => format!("(-{})", shape(x)),
            ExprKind::Binary(op, a, b) => format!("({} {op:?} {})", shape(a), shape(b)),
            ExprKind::Call(name, arguments) => {
                format!("{name}({})", arguments.iter().map(shape).collect::<Vec<_>>().join(","))
            }
            ExprKind::Sum { variable, set, body } => format!("sum({variable} in {set}: {})", shape(body)),
        }
    }

    #[test]
    fn precedence_is_that_of_mathematics() {
        for (text, expected) in [
            ("-a^2", "(-(a Pow 2))"),
            ("a^b^c", "(a Pow (b Pow c))"),
            ("a-b-c", "((a Sub b) Sub c)"),
            ("a/b*c", "((a Div b) Mul c)"),
            ("1e-3*a", "(0.001 Mul a)"),
            ("2^-1", "(2 Pow (-1))"),
            ("a > b + 1", "((b Add 1) Less a)"),
            ("x/1000[W/m2]", "(x Div 1000[W/m2])"),
            ("sum(n in rooms: a[n]*(T[n]-T_e))", "sum(n in rooms: (a[n] Mul (T[n] Sub T_e)))"),
            ("max(0, sin(h))", "max(0,sin(h))"),
            ("TSS[1]-S_NH[s10]", "(TSS[1] Sub S_NH[s10])"),
        ] {
            assert_eq!(parse(text).map(|e| shape(&e)), Ok(expected.to_owned()), "{text}");
        }
    }

    #[test]
    fn errors_say_where() {
        let error = parse("a +\n  * b").unwrap_err();
        assert_eq!(error.at, TextPosition { line: 2, column: 3 });
        for bad in
            ["", "(", "a b", "1..2", "a[", "f(,)", "sum(n: a)", "é", "1e999", "a[n", "a[1.5]", "a[-1]", "2[K"]
        {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn hostile_depth_is_refused_without_a_crash() {
        for hostile in [
            "(".repeat(8000),
            "-".repeat(8000),
            "a^".repeat(5000),
            "a+".repeat(8000) + "a",
            "f(".repeat(5000),
        ] {
            assert!(parse(&hostile).is_err());
        }
    }

    proptest! {
        #[test]
        fn any_text_is_parsed_or_refused(text in "[ -~\n]{0,200}") {
            prop_assert!(parse(&text).is_ok() || parse(&text).is_err());
        }
    }
}
