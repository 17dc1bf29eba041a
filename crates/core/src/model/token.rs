//! Text to tokens, with the places where they stand.

const SYMBOLS: [&str; 17] =
    ["<=", ">=", "==", "+", "-", "*", "/", "^", "(", ")", "[", "]", ",", ":", "<", ">", "%"];

/// A place in a text, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TextPosition {
    /// Line.
    pub line: usize,
    /// Column in characters.
    pub column: usize,
}

/// Why a text is no expression.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SyntaxError {
    /// Where.
    pub at: TextPosition,
    /// What is wrong.
    pub message: String,
}

/// The smallest parts of an expression.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Token {
    Number(f64),
    Name(String),
    Symbol(&'static str),
    End,
}

/// A token, where it begins, and the byte behind it.
pub(super) type Placed = (Token, TextPosition, usize);

/// The tokens of a text, `End` the last one.
pub(super) fn tokens(text: &str) -> Result<Vec<Placed>, SyntaxError> {
    let mut tokens = Vec::new();
    let (mut line, mut column, mut counted, mut i) = (1, 1, 0, 0);
    let bytes = text.as_bytes();
    while i < bytes.len() {
        // Counted on from the token before: a count from the start of the line would make long lines
        // quadratic.
        column += text[counted..i].chars().count();
        counted = i;
        let at = TextPosition { line, column };
        let c = bytes[i];
        if c == b'\n' {
            line += 1;
            i += 1;
            (column, counted) = (1, i);
        } else if c.is_ascii_whitespace() {
            i += 1;
        } else if c.is_ascii_digit() || (c == b'.' && bytes.get(i + 1).is_some_and(u8::is_ascii_digit)) {
            let end = number_end(bytes, i);
            let value = text[i..end].parse::<f64>().ok().filter(|value| value.is_finite());
            let value = value.ok_or_else(|| SyntaxError {
                at,
                message: format!("`{}` is not a finite number", clip(&text[i..end])),
            })?;
            tokens.push((Token::Number(value), at, end));
            i = end;
        } else if c.is_ascii_alphabetic() || c == b'_' {
            let end = bytes[i..]
                .iter()
                .position(|b| !(b.is_ascii_alphanumeric() || *b == b'_'))
                .map_or(bytes.len(), |n| i + n);
            if !is_name(&text[i..end]) {
                return Err(SyntaxError {
                    at,
                    message: format!(
                        "the name `{}…` is longer than {MAX_NAME} characters",
                        clip(&text[i..end])
                    ),
                });
            }
            tokens.push((Token::Name(text[i..end].to_owned()), at, end));
            i = end;
        } else if let Some(symbol) = SYMBOLS.iter().find(|symbol| bytes[i..].starts_with(symbol.as_bytes())) {
            i += symbol.len();
            tokens.push((Token::Symbol(symbol), at, i));
        } else {
            let c = text[i..].chars().next().unwrap_or(' ');
            return Err(SyntaxError {
                at,
                message: format!("`{}` has no meaning in an expression", c.escape_default()),
            });
        }
    }
    let at = TextPosition { line, column: column + text[counted..].chars().count() };
    tokens.push((Token::End, at, bytes.len()));
    Ok(tokens)
}

/// The byte behind a number that starts at `i`.
fn number_end(bytes: &[u8], mut i: usize) -> usize {
    let digits = |mut i: usize| {
        while bytes.get(i).is_some_and(u8::is_ascii_digit) {
            i += 1;
        }
        i
    };
    i = digits(i);
    if bytes.get(i) == Some(&b'.') {
        i = digits(i + 1);
    }
    if matches!(bytes.get(i), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(i + 1), Some(b'+' | b'-')));
        if bytes.get(i + 1 + sign).is_some_and(u8::is_ascii_digit) {
            i = digits(i + 1 + sign);
        }
    }
    i
}

fn clip(text: &str) -> String {
    text.chars().take(24).collect()
}

/// A token for people.
pub(super) fn describe(token: &Token) -> String {
    match token {
        Token::Number(value) => format!("the number {value}"),
        Token::Name(name) => format!("the name `{name}`"),
        Token::Symbol(symbol) => format!("`{symbol}`"),
        Token::End => "the end of the expression".to_owned(),
    }
}

/// Longest name in bytes.
pub(super) const MAX_NAME: usize = 64;

/// Whether a text is a name: a letter or underscore, then letters, digits and underscores.
pub fn is_name(text: &str) -> bool {
    let mut chars = text.chars();
    text.len() <= MAX_NAME
        && chars.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
        && chars.all(|c| c.is_ascii_alphanumeric() || c == '_')
}
