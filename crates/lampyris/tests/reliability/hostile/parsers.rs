//! Expressions, windows and model documents from random trees and texts: nothing panics, what is printed is
//! read back as it was, and a compiled model gives the bits of its equations.

use super::{Random, bent, mutate};
use crate::support::full;
use crate::support::rooms::{csv_of, room};

use lampyris_core::data::{ColumnBindings, CsvChannel, SplitRequest, Thinned, Window, write_csv};
use lampyris_core::estimate::{EstimateRequest, Problem, Site, prepare};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::expr::{Binary, Unary, select};
use lampyris_core::model::parse::{Expr, ExprKind, parse};
use lampyris_core::model::{Catalogue, compile};
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use std::fmt::Write;
use std::time::{Duration, Instant};

/// Runs a case again and again, each from a number of its own: so many times, or in the full figure for two
/// minutes.
fn many(what: &str, times: u64, mut case: impl FnMut(&mut Random) -> bool) {
    let begun = Instant::now();
    let (mut cases, mut taken, mut longest) = (0, 0, Duration::ZERO);
    while if full() { begun.elapsed() < Duration::from_secs(300) } else { cases < times } {
        let one = Instant::now();
        taken += u64::from(case(&mut Random::seed_from_u64(cases)));
        longest = longest.max(one.elapsed());
        cases += 1;
    }
    println!("FUZZ-2: {what}: {cases} cases, {taken} of them good, longest {longest:?} (target 1 s)");
    assert!(taken > cases / 20 && taken < cases, "{taken} of {cases}");
}

const NAMES: [&str; 4] = ["s", "a", "b", "u"];
const FUNCTIONS: [(&str, usize); 10] = [
    ("if", 3),
    ("min", 2),
    ("max", 2),
    ("abs", 1),
    ("sqrt", 1),
    ("exp", 1),
    ("log", 1),
    ("sin", 1),
    ("cos", 1),
    ("tanh", 1),
];
const OPERATORS: [&str; 10] = ["+", "-", "*", "/", "^", "<", "<=", "==", ">", ">="];

/// A random expression as text, without a parenthesis more than by chance.
fn expression(random: &mut Random, depth: usize) -> String {
    let part = |random: &mut Random| expression(random, depth - 1);
    match if depth == 0 { random.random_range(0..2) } else { random.random_range(0..10) } {
        0 => NAMES[random.random_range(0..NAMES.len())].to_owned(),
        1 => match random.random_range(0..4) {
            0 => random.random_range(0..4).to_string(),
            1 => format!("{:?}", random.random_range(0.0..2.0)),
            2 => format!("{:e}", random.random_range(0.0..1.0) * 10f64.powi(random.random_range(-12..12))),
            _ => "1".to_owned(),
        },
        2 => format!("({})", part(random)),
        3 => format!("-{}", part(random)),
        4 | 5 => {
            let (name, count) = FUNCTIONS[random.random_range(0..FUNCTIONS.len())];
            let arguments: Vec<String> = (0..count).map(|_| part(random)).collect();
            let inner = arguments.join(", ");
            // A root of what may be negative would be refused.
            if name == "sqrt" { format!("sqrt(abs({inner}))") } else { format!("{name}({inner})") }
        }
        _ => {
            let (left, right) = (part(random), part(random));
            match OPERATORS[random.random_range(0..OPERATORS.len())] {
                "^" => format!("abs({left})^{right}"),
                operator => format!("{left} {operator} {right}"),
            }
        }
    }
}

/// A tree as text, every operation in parentheses.
fn printed(expr: &Expr) -> String {
    match &expr.kind {
        ExprKind::Number(value, None) => format!("{value:?}"),
        ExprKind::Number(value, Some(unit)) => format!("{value:?}[{unit}]"),
        ExprKind::Name(name) => name.clone(),
        ExprKind::Member(family, index) => format!("{family}[{index}]"),
        ExprKind::Negate(inner) => format!("(-{})", printed(inner)),
        ExprKind::Binary(op, a, b) => {
            let symbol = match op {
                Binary::Add => "+",
                Binary::Sub => "-",
                Binary::Mul => "*",
                Binary::Div => "/",
                Binary::Pow => "^",
                Binary::Less => "<",
                Binary::LessEqual => "<=",
                Binary::Equal => "==",
                Binary::Min | Binary::Max => unreachable!("these are functions"),
            };
            format!("({}{symbol}{})", printed(a), printed(b))
        }
        ExprKind::Call(name, arguments) => {
            format!("{name}({})", arguments.iter().map(printed).collect::<Vec<_>>().join(","))
        }
        ExprKind::Sum { variable, set, body } => format!("sum({variable} in {set}: {})", printed(body)),
    }
}

#[test]
fn a_printed_expression_is_the_same_expression() {
    many("expressions, parsed, printed and parsed", 20_000, |random| {
        let depth = random.random_range(0..7);
        let mut text = expression(random, depth);
        if random.random_range(0..4) == 0 {
            text = bent(text.into_bytes(), random);
        }
        let Ok(tree) = parse(&text) else { return false };
        let once = printed(&tree);
        match parse(&once) {
            Ok(again) => assert_eq!(printed(&again), once, "{text}"),
            // Parentheses around everything may nest deeper than is allowed, and be longer.
            Err(error) => assert!(
                error.message.contains("deep") || error.message.contains("limit"),
                "{text}: {error:?}"
            ),
        }
        true
    });
}

/// The meaning of a tree, by the canonical operations and nothing else; `None` where something on the way is
/// no number.
fn meaning(expr: &Expr, value: &dyn Fn(&str) -> f64) -> Option<f64> {
    let of = |expr: &Expr| meaning(expr, value);
    let found = match &expr.kind {
        ExprKind::Number(number, _) => *number,
        ExprKind::Name(name) => value(name),
        ExprKind::Negate(inner) => Unary::Neg.apply(of(inner)?),
        ExprKind::Binary(Binary::Pow, base, exponent) => {
            let (base, n) = (of(base)?, of(exponent)?);
            // A whole number that stands in the text means a product.
            if is_constant(exponent, value) && n == n.trunc() && n.abs() <= 16.0 {
                let product =
                    (1..n.abs() as i32).fold(if n == 0.0 { 1.0 } else { base }, |product, _| product * base);
                if n < 0.0 { 1.0 / product } else { product }
            } else {
                Binary::Pow.apply(base, n)
            }
        }
        ExprKind::Binary(op, a, b) => op.apply(of(a)?, of(b)?),
        ExprKind::Call(name, arguments) => {
            let x: Vec<f64> = arguments.iter().map(of).collect::<Option<_>>()?;
            match name.as_str() {
                "if" => select(x[0], x[1], x[2]),
                "min" => Binary::Min.apply(x[0], x[1]),
                "max" => Binary::Max.apply(x[0], x[1]),
                "abs" => Unary::Abs.apply(x[0]),
                "sqrt" => Unary::Sqrt.apply(x[0]),
                "exp" => Unary::Exp.apply(x[0]),
                "log" => Unary::Log.apply(x[0]),
                "sin" => Unary::Sin.apply(x[0]),
                "cos" => Unary::Cos.apply(x[0]),
                "tanh" => Unary::Tanh.apply(x[0]),
                other => unreachable!("{other}"),
            }
        }
        ExprKind::Member(..) | ExprKind::Sum { .. } => unreachable!("not drawn"),
    };
    found.is_finite().then_some(found)
}

/// Whether a tree has one value whatever its names mean: it has none, or they cancel.
fn is_constant(expr: &Expr, value: &dyn Fn(&str) -> f64) -> bool {
    let of = |expr: &Expr| is_constant(expr, value);
    let zero = |expr: &Expr| of(expr) && meaning(expr, value) == Some(0.0);
    match &expr.kind {
        ExprKind::Number(..) => true,
        ExprKind::Negate(inner) => of(inner),
        ExprKind::Binary(Binary::Mul, a, b) if zero(a) || zero(b) => true,
        ExprKind::Binary(Binary::Div, a, _) if zero(a) => true,
        ExprKind::Binary(Binary::Pow, _, exponent) if zero(exponent) => true,
        ExprKind::Binary(Binary::Sub, a, b) if printed(a) == printed(b) => true,
        ExprKind::Binary(_, a, b) => of(a) && of(b),
        ExprKind::Call(name, arguments) if name == "if" && of(&arguments[0]) => {
            of(&arguments[if zero(&arguments[0]) { 2 } else { 1 }])
        }
        ExprKind::Call(_, arguments) => arguments.iter().all(of),
        _ => false,
    }
}

/// A model whose output is an expression of a state, two parameters and an input.
fn model(output: &str) -> Value {
    let parameter = |lower: f64, upper: f64| json!({"unit": "-", "lower": lower, "upper": upper, "nominal": 1.1, "scale": "linear"});
    json!({
        "id": "drawn", "title": "Drawn", "states": {"s": {"unit": "-", "initial": "s0"}},
        "inputs": {"u": {"unit": "-"}},
        "parameters": {"a": parameter(-3.0, 3.0), "b": parameter(0.1, 3.0), "s0": parameter(-2.0, 2.0)},
        "equations": {"s": "0.1[1/h] * (u - s)"},
        "outputs": {"y": {"expr": output, "unit": "-", "noise_sd": 0.1}},
    })
}

/// The problem of such a model with a day of measurements.
fn drawn(output: &str) -> Option<Problem> {
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_model(ModelDocument::from_json(&model(output)).unwrap());
    let mut csv = "time,y[-],u[-]\n".to_owned();
    for hour in 0..24 {
        writeln!(csv, "2026-01-01T{hour:02}:00:00Z,1.5,{:.3}", 2.0 * f64::from(hour).sin()).unwrap();
    }
    let (window, _) = Window::parse_csv(&csv, &ColumnBindings::none()).unwrap();
    let split =
        SplitRequest { train: "P1D".parse().unwrap(), validation: "P0D".parse().unwrap(), test: None };
    let asked = EstimateRequest { split, ..EstimateRequest::default() };
    prepare(&catalogue, &"drawn".parse().unwrap(), &asked, &window, &Site::default()).ok()
}

#[test]
fn the_tape_gives_the_bits_of_the_tree() {
    let mut compared = 0;
    many("expressions, the tree beside the tape", 2000, |random| {
        let depth = random.random_range(1..6);
        let text = expression(random, depth);
        let Some(problem) = drawn(&text) else { return false };
        let tree = parse(&text).unwrap();
        let names: Vec<&str> =
            problem.model().parameters().iter().map(|parameter| parameter.name.as_str()).collect();
        let theta: Vec<f64> = names.iter().map(|_| random.random_range(0.1..2.0)).collect();
        let run = problem.simulate(&theta);
        let input = problem.grid().column("u").map(|column| column.values().to_vec());
        for k in 0..problem.grid().len() {
            let value = |name: &str| match name {
                "s" => run.states[0][k],
                "u" => input.as_ref().unwrap()[k],
                name => names.iter().position(|known| *known == name).map_or(f64::NAN, |place| theta[place]),
            };
            if let Some(expected) = meaning(&tree, &value) {
                // Zeros of either sign are one number: the graph does not tell them apart.
                assert_eq!(
                    (run.outputs[0][k] + 0.0).to_bits(),
                    (expected + 0.0).to_bits(),
                    "{text} at sample {k}: {expected}"
                );
                compared += 1;
            }
        }
        true
    });
    println!("FUZZ-2: {compared} values have the same bits");
    assert!(compared > 1000);
}

#[test]
fn a_written_window_is_the_same_window() {
    let good = csv_of(&room(3, 1));
    many("windows, parsed, written and parsed", 3000, |random| {
        let mut text = good.lines().take(random.random_range(1..40)).collect::<Vec<_>>().join("\n") + "\n";
        for _ in 0..random.random_range(0..4) {
            text = bent(text.into_bytes(), random);
        }
        let Ok((window, _)) = Window::parse_csv(&text, &ColumnBindings::none()) else { return false };
        let points: Vec<(&str, String, Thinned)> = window
            .channels()
            .map(|channel| {
                let series = window.series(channel).unwrap();
                assert!(
                    series.times().windows(2).all(|pair| pair[0] < pair[1])
                        && series.values().iter().all(|value| value.is_finite())
                );
                let values = series.values().iter().copied().map(Some).collect();
                (
                    channel,
                    series.unit().to_owned(),
                    Thinned::Samples { times: series.times().to_vec(), values },
                )
            })
            .collect();
        let channels: Vec<CsvChannel> =
            points.iter().map(|(channel, unit, points)| CsvChannel { channel, unit, points }).collect();
        let written = write_csv(&channels);
        let (again, _) = Window::parse_csv(&written, &ColumnBindings::none())
            .unwrap_or_else(|faults| panic!("{faults:?}\n{text}\n{written}"));
        for channel in window.channels() {
            let [one, other] = [&window, &again]
                .map(|window| window.series(channel).map(|series| (series.times(), series.values())));
            assert_eq!(one, other, "{channel}\n{text}\n{written}");
        }
        true
    });
}

#[test]
fn a_printed_model_is_the_same_model() {
    let catalogue = Catalogue::builtin().unwrap();
    let mut good: Vec<Value> = catalogue.models().map(|model| serde_json::to_value(model).unwrap()).collect();
    let plants = [
        include_str!("../../../../../config/plants/asm1_h.toml"),
        include_str!("../../../../../config/plants/bsm1.toml"),
    ];
    good.extend(plants.map(|text| serde_json::to_value(ModelDocument::from_toml(text).unwrap()).unwrap()));
    many("models, read, printed and read", 3000, |random| {
        let mut document = good[random.random_range(0..good.len())].clone();
        for _ in 0..random.random_range(0..4) {
            mutate(&mut document, random);
        }
        let Ok(model) = ModelDocument::from_json(&document) else { return false };
        let printed = serde_json::to_value(&model).unwrap();
        assert_eq!(ModelDocument::from_json(&printed).unwrap(), model, "{document}");
        let mut catalogue = catalogue.clone();
        let id = model.id().parse();
        catalogue.add_model(model);
        if let Ok(id) = id
            && let Ok(composition) = catalogue.compose(&id)
        {
            let sets = [("neighbours".to_owned(), vec!["1".to_owned(), "2".to_owned()])].into();
            // A fault is as good as a model: what counts is that there is one or the other.
            let _ = compile(&composition, &lampyris_core::model::Bindings { sets, channels: None });
        }
        true
    });
}
