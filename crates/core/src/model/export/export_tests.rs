//! Written models: the words of each language, and the same numbers when the text is read again.

use super::names::Names;
use super::{EquationFormat, ExportFormat, ExportSource, document, equations, text};
use crate::model::document::ModelDocument;
use crate::model::{Bindings, Catalogue, Model, compile};

/// Names that are words of Python or Modelica, sums that must keep their brackets, and a delay.
fn awkward() -> Model {
    let text = r#"
        id = "awkward"
        title = "a \"title\" \\ with * all"
        [states]
        x = { unit = "degC", initial = "y" }
        T_e = { unit = "degC", initial = "T_e0" }
        [inputs]
        T_out = { unit = "degC" }
        flow = { unit = "-", hold = "zero_order" }
        [parameters]
        lambda = { unit = "1/h", lower = 0, upper = 10, scale = "linear", nominal = 1 }
        k_e = { unit = "1/h", lower = 0, upper = 10, scale = "linear", nominal = 1 }
        tau = { unit = "h", lower = 0, upper = 3, scale = "linear", nominal = 1 }
        T_e0 = { unit = "degC", lower = 0, upper = 40, scale = "linear", nominal = 20 }
        [equations]
        x = "lambda*(T_out - (x - T_e)) - (k_e - (lambda - k_e))*(x/2 - (T_e - 1.5[degC]))"
        T_e = "k_e*flow*(delay(T_out, tau) - T_e)*if(x < T_e, 1, 1e-5)^3"
        [outputs]
        y = { expr = "x", unit = "degC", noise_sd = 0.05 }
    "#;
    let mut catalogue = Catalogue::default();
    catalogue.add_model(ModelDocument::from_toml(text).unwrap());
    compile(&catalogue.compose(&"awkward".parse().unwrap()).unwrap(), &Bindings::default()).unwrap()
}

const THETA: [f64; 4] = [0.4, 0.25, 1.5, 18.0];

fn written(format: ExportFormat) -> String {
    let source = ExportSource { line: "made up\nfor a test".to_owned(), longest_step_h: 0.1 };
    text(&awkward(), &THETA, &source, format)
}

#[test]
fn a_document_says_all_that_an_equation_needs() {
    let found = document(&awkward(), &THETA);
    let symbols: Vec<&str> = found.parameters.iter().map(|one| one.symbol.as_str()).collect();
    // What a language has a word for is called otherwise, and still told by its own name.
    assert_eq!(symbols, ["lambda_", "k_e", "tau", "T_e0"]);
    assert_eq!((found.parameters[0].name.as_str(), found.parameters[0].value), ("lambda", 0.4));
    let inputs: Vec<(&str, &str, f64)> =
        found.inputs.iter().map(|one| (one.symbol.as_str(), one.channel.as_str(), one.delay_h)).collect();
    assert_eq!(inputs, [("T_out", "T_out", 0.0), ("T_out_delayed", "T_out", 1.5), ("flow_", "flow", 0.0)]);
    let [x, envelope] = &found.states[..] else { panic!("two states") };
    assert_eq!((x.start, x.measured_by.as_deref()), (None, Some("y")));
    assert_eq!((envelope.start, envelope.measured_by.as_deref()), (Some(18.0), None));
    // Brackets keep what is taken from what.
    assert!(x.rate.contains("T_out - (") && x.rate.contains("k_e - (lambda_ - k_e)"), "{}", x.rate);
}

#[test]
fn each_language_has_its_own_words() {
    let python = written(ExportFormat::Python);
    assert!(python.starts_with("# a \"title\" \\ with * all\n# awkward\n# made up for a test\n"), "{python}");
    for part in ["np.where(", "lambda_ = p[\"lambda_\"]", "return [None, tau, None]", "START = [None, 18.0]"]
    {
        assert!(python.contains(part), "{part} is not in {python}");
    }
    let casadi = written(ExportFormat::Casadi);
    assert!(casadi.contains("ca.if_else(") && casadi.contains("DELAYS_H = [0.0, 1.5, 0.0]"), "{casadi}");
    let modelica = written(ExportFormat::Modelica);
    for part in [
        "model Lampyris_awkward \"a \\\"title\\\" \\\\ with * all\"",
        "T_out_delayed = delay(T_out, 3600*(tau));",
        "(if x_ < T_e then 1.0 else 1e-5)",
        "end Lampyris_awkward;",
    ] {
        assert!(modelica.contains(part), "{part} is not in {modelica}");
    }
    let latex = written(ExportFormat::Latex);
    assert!(latex.contains("\\lambda") && latex.contains("T_{\\mathrm{e}}"), "{latex}");
    assert!(latex.contains("\\begin{cases}") || latex.contains("\\left["), "{latex}");
    let mathml = written(ExportFormat::Mathml);
    for part in
        ["<mi>λ</mi>", "<msub><mi>T</mi><mtext>e</mtext></msub>", "<mo>&lt;</mo>", "<mfrac>", "<msup>"]
    {
        assert!(mathml.contains(part), "{part} is not in {mathml}");
    }
    check_elements(&mathml);
}

/// Every element is closed where it belongs, and those that have a place for each child have them all.
fn check_elements(mathml: &str) {
    let mut open: Vec<(&str, usize)> = Vec::new();
    for part in mathml.split('<').skip(1) {
        let (tag, _) = part.split_once('>').unwrap();
        if let Some(name) = tag.strip_prefix('/') {
            let (opened, children) = open.pop().unwrap();
            assert_eq!(opened, name, "{mathml}");
            assert!(
                !["mfrac", "msup", "msub"].contains(&name) || children == 2,
                "{name} {children} {mathml}"
            );
        } else {
            if let Some((_, children)) = open.last_mut() {
                *children += 1;
            }
            open.push((tag.split(' ').next().unwrap(), 0));
        }
    }
    assert!(open.is_empty(), "{open:?} {mathml}");
}

/// A written model, read again by the language of the documents: all quantities are plain numbers there.
fn read_again(model: &Model, theta: &[f64]) -> Model {
    let found = document(model, theta);
    let lines = |heading: &str, lines: Vec<String>| format!("[{heading}]\n{}\n", lines.join("\n"));
    let states =
        found.states.iter().map(|one| format!("{} = {{ unit = \"-\", initial = \"0\" }}", one.symbol));
    let inputs = found.inputs.iter().map(|one| format!("{} = {{ unit = \"-\", min = 0 }}", one.symbol));
    let parameters = found.parameters.iter().map(|one| {
        format!(
            "{} = {{ unit = \"-\", lower = 0, upper = 1e9, scale = \"linear\", nominal = 1 }}",
            one.symbol
        )
    });
    let definitions = found.definitions.iter().map(|(name, meaning)| format!("{name} = \"{meaning}\""));
    let rates = found.states.iter().map(|one| format!("{} = \"({}) * 1[1/h]\"", one.symbol, one.rate));
    let outputs = found.outputs.iter().map(|one| {
        format!("\"{}\" = {{ expr = \"{}\", unit = \"-\", noise_sd = 1 }}", one.channel, one.expression)
    });
    let text = [
        "id = \"again\"\ntitle = \"read again\"\n".to_owned(),
        lines("states", states.collect()),
        lines("inputs", inputs.collect()),
        lines("parameters", parameters.collect()),
        lines("define", definitions.collect()),
        lines("equations", rates.collect()),
        lines("outputs", outputs.collect()),
    ];
    let mut catalogue = Catalogue::default();
    catalogue.add_model(ModelDocument::from_toml(&text.concat()).unwrap());
    compile(&catalogue.compose(&"again".parse().unwrap()).unwrap(), &Bindings::default()).unwrap()
}

/// Rates and outputs with values by the written names.
fn values(model: &Model, named: impl Fn(&str) -> f64, names: &Names) -> Vec<f64> {
    let outputs = model.outputs().iter().map(|output| output.node);
    let roots: Vec<_> = model.rhs().iter().copied().chain(outputs).collect();
    model.graph().evaluate(&roots, |leaf| named(names.leaf(leaf)))
}

#[test]
fn what_is_written_of_every_built_in_model_reads_back_to_the_same_numbers() {
    let catalogue = Catalogue::builtin().unwrap();
    let models = [
        "ti",
        "tith",
        "tite",
        "titeth",
        "rc1",
        "rc2",
        "rc1_heater",
        "rc2_heater",
        "room2",
        "room3",
        "room3+pipe_delay",
        "room3+wind_infiltration+sensor_lag+emitter_exponent",
        "bsm1",
    ];
    for id in models {
        let composition = catalogue.compose(&id.parse().unwrap()).unwrap();
        let members = |set: &String| (set.clone(), vec!["a".to_owned(), "b".to_owned()]);
        let sets = composition.spec.sets.iter().map(members).collect();
        let model = compile(&composition, &Bindings { sets, channels: None }).unwrap();
        let theta: Vec<f64> = (0..model.parameters().len()).map(|i| 0.3 + 0.07 * i as f64).collect();
        let again = read_again(&model, &theta);
        let (ours, theirs) = (Names::new(&model), Names::new(&again));
        check_elements(&equations(&model, EquationFormat::Mathml));
        for round in 0..5_u32 {
            // A value of its own for every name, which both readings share.
            let value = |name: &str| {
                let sum =
                    name.bytes().fold(round, |sum, byte| sum.wrapping_mul(31).wrapping_add(byte.into()));
                0.1 + f64::from(sum % 1000) / 250.0
            };
            let (found, expected) = (values(&again, value, &theirs), values(&model, value, &ours));
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                let near = (found - expected).abs() <= 1e-12 * (1.0 + expected.abs());
                assert!(near, "{id}: {found} {expected}");
            }
        }
    }
}
