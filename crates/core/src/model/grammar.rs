//! The grammar of expressions, units and declarations as a text: a test derives sentences from it and
//! compares what it allows with what the parser takes.

/// The grammar in extended Backus-Naur form, as Wirth writes it: `[ ]` once or not at all, `{ }` any number
/// of times, `|` one or the other. White space may stand between all parts of an expression.
pub const GRAMMAR: &str = r#"expression  = terms { ( "<" | "<=" | ">" | ">=" | "==" ) terms } .
terms       = product { ( "+" | "-" ) product } .
product     = signed { ( "*" | "/" ) signed } .
signed      = ( "-" | "+" ) signed | power .
power       = atom [ "^" signed ] .
atom        = quantity | summation | call | member | "(" expression ")" | name .
quantity    = number [ "[" unit "]" ] .
summation   = "sum" "(" name "in" name ":" expression ")" .
call        = name "(" [ expression { "," expression } ] ")" .
member      = name "[" ( name | digits ) "]" .

number      = ( digits [ "." { digit } ] | "." digits ) [ ( "e" | "E" ) [ "+" | "-" ] digits ] .
digits      = digit { digit } .
digit       = "0" | "1" | "2" | "3" | "4" | "5" | "6" | "7" | "8" | "9" .
name        = letter { letter | digit } .
letter      = "A" ... "Z" | "a" ... "z" | "_" .

unit        = quotient { " per " quotient } .
quotient    = factors { "/" factors } .
factors     = factor { ( " " | "*" ) factor } .
factor      = symbol [ [ "^" ] [ "-" ] digit ] .
symbol      = "-" | "1" | "K" | "kW" | ... .

declaration = name [ "[" name " in " name "]" ] .
"#;

#[cfg(test)]
mod tests {
    use super::GRAMMAR;
    use crate::model::parse::parse;
    use crate::model::token::is_name;
    use crate::units::Unit;
    use proptest::prelude::{any, prop_assert, prop_assert_eq, proptest};
    use std::collections::{BTreeMap, BTreeSet};

    /// The right side of a rule.
    enum Rule {
        Terminal(&'static str),
        Named(&'static str),
        All(Vec<Rule>),
        Any(Vec<Rule>),
        Optional(Box<Rule>),
        Repeated(Box<Rule>),
    }

    type Rules = BTreeMap<&'static str, Rule>;

    /// The rules that speak of expressions; those of characters are for the tokens.
    fn rules() -> Rules {
        let of_expressions = GRAMMAR.split("\n\n").next().unwrap();
        let rule = |line: &'static str| {
            let (name, right) = line.strip_suffix(" .").unwrap().split_once(" = ").unwrap();
            let mut words = right.split_whitespace().peekable();
            let rule = alternatives(&mut words);
            assert!(words.next().is_none(), "{line}");
            (name.trim(), rule)
        };
        of_expressions.lines().map(rule).collect()
    }

    type Words = std::iter::Peekable<std::str::SplitWhitespace<'static>>;

    fn alternatives(words: &mut Words) -> Rule {
        let mut any = vec![sequence(words)];
        while words.next_if_eq(&"|").is_some() {
            any.push(sequence(words));
        }
        Rule::Any(any)
    }

    fn sequence(words: &mut Words) -> Rule {
        let mut all = Vec::new();
        while let Some(word) = words.next_if(|word| !["|", ")", "]", "}"].contains(word)) {
            let mut inner = || {
                let inner = alternatives(words);
                words.next().unwrap();
                Box::new(inner)
            };
            all.push(match word {
                "(" => *inner(),
                "[" => Rule::Optional(inner()),
                "{" => Rule::Repeated(inner()),
                _ => match word.strip_prefix('"') {
                    Some(rest) => Rule::Terminal(rest.strip_suffix('"').unwrap()),
                    None => Rule::Named(word),
                },
            });
        }
        Rule::All(all)
    }

    /// Where a rule may end that begins at these places of a text.
    fn ends(rules: &Rules, rule: &Rule, tokens: &[&str], from: &BTreeSet<usize>) -> BTreeSet<usize> {
        // A rule that stands in itself would go on for ever without a place to begin at.
        if from.is_empty() {
            return BTreeSet::new();
        }
        let behind = |is: &dyn Fn(usize) -> bool| {
            from.iter().filter(|at| **at < tokens.len() && is(**at)).map(|at| at + 1).collect()
        };
        match rule {
            Rule::Terminal(text) => behind(&|at| tokens[at] == *text),
            // `sum(` is no call.
            Rule::Named("name") => behind(&|at| {
                is_name(tokens[at]) && !(tokens[at] == "sum" && tokens.get(at + 1) == Some(&"("))
            }),
            Rule::Named("number") => behind(&|at| tokens[at].starts_with(|c: char| c.is_ascii_digit())),
            Rule::Named("digits") => behind(&|at| tokens[at].bytes().all(|c| c.is_ascii_digit())),
            // The parser takes whatever stands in the brackets; the lowering knows the units.
            Rule::Named("unit") => {
                let until = |at: &usize| tokens[*at..].iter().take_while(|token| **token != "]").count();
                from.iter().map(|at| at + until(at)).collect()
            }
            Rule::Named(name) => ends(rules, &rules[name], tokens, from),
            Rule::All(all) => all.iter().fold(from.clone(), |from, rule| ends(rules, rule, tokens, &from)),
            Rule::Any(any) => any.iter().flat_map(|rule| ends(rules, rule, tokens, from)).collect(),
            Rule::Optional(inner) => &ends(rules, inner, tokens, from) | from,
            Rule::Repeated(inner) => {
                let (mut all, mut newest) = (from.clone(), from.clone());
                while !newest.is_empty() {
                    newest = &ends(rules, inner, tokens, &newest) - &all;
                    all.extend(&newest);
                }
                all
            }
        }
    }

    fn allows(rules: &Rules, tokens: &[&str]) -> bool {
        ends(rules, &rules["expression"], tokens, &BTreeSet::from([0])).contains(&tokens.len())
    }

    /// A sentence of the grammar by these choices, and by the shortest where they have run out.
    fn derive(rules: &Rules, rule: &Rule, choices: &mut Vec<u8>, sentence: &mut Vec<&'static str>) {
        match rule {
            Rule::Terminal(text) => sentence.push(text),
            Rule::Named("name") => {
                sentence.push(["a", "T_r", "in", "max"][usize::from(choices.pop().unwrap_or(0)) % 4]);
            }
            Rule::Named("number") => {
                sentence.push(["1", "2.5", "1e-3", "6."][usize::from(choices.pop().unwrap_or(0)) % 4]);
            }
            Rule::Named("digits") => sentence.push("2"),
            Rule::Named("unit") => sentence.push("W/m2"),
            Rule::Named(name) => derive(rules, &rules[name], choices, sentence),
            Rule::All(all) => all.iter().for_each(|rule| derive(rules, rule, choices, sentence)),
            Rule::Any(any) => {
                let chosen = choices.pop().map_or(any.len() - 1, |choice| usize::from(choice) % any.len());
                derive(rules, &any[chosen], choices, sentence);
            }
            Rule::Optional(inner) | Rule::Repeated(inner) => {
                while choices.pop().is_some_and(|choice| choice % 4 == 0) {
                    derive(rules, inner, choices, sentence);
                    if matches!(rule, Rule::Optional(_)) {
                        break;
                    }
                }
            }
        }
    }

    const TOKENS: [&str; 20] = [
        "a", "sum", "in", "1", "2.5", "K", "(", ")", "[", "]", "+", "-", "*", "/", "^", "<", "==", ",", ":",
        "%",
    ];

    proptest! {
        #[test]
        fn the_parser_takes_what_the_grammar_allows_and_nothing_else(
            mut choices in proptest::collection::vec(any::<u8>(), 0..60),
            slips in proptest::collection::vec((any::<u8>(), 0..TOKENS.len()), 1..3),
        ) {
            let rules = rules();
            let mut sentence = Vec::new();
            derive(&rules, &rules["expression"], &mut choices, &mut sentence);
            prop_assert!(allows(&rules, &sentence) && parse(&sentence.join(" ")).is_ok(), "{sentence:?}");
            for (place, token) in slips {
                let at = usize::from(place) % sentence.len();
                sentence[at] = TOKENS[token];
            }
            // What stands in brackets behind a number is one token of the grammar.
            let text = sentence.join(" ");
            prop_assert_eq!(allows(&rules, &sentence), parse(&text).is_ok(), "{}", text);
        }
    }

    #[test]
    fn the_grammar_of_units_is_that_of_their_parser() {
        for allowed in ["-", "W/m2", "K/h per m/s", "W m^-2", "kg*m/s2", "1/h", "g d/m3/h", "m-1"] {
            assert!(Unit::parse(allowed).is_ok(), "{allowed}");
        }
        for refused in ["", "m^", "m10", "W per", "kilowatt", "(m)"] {
            assert!(Unit::parse(refused).is_err(), "{refused}");
        }
    }
}
