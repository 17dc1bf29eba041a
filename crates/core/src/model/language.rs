//! The language of model documents, described from the tables and types that read it: grammar, functions,
//! units, the fields of all documents, and limits.

use super::builder::MAX_STATES;
use super::builtin::{CONSTANTS, LanguageConstant, LanguageFunction, functions};
use super::check::Check;
use super::compile::{MAX_CHECKS, MAX_PARAMETERS};
use super::functions::MAX_DELAY;
use super::grammar::GRAMMAR;
use super::id::MAX_EFFECTS;
use super::lower::{MAX_INTEGER_POWER, MAX_NESTED, MAX_NODES};
use super::parse::{MAX_DEPTH, MAX_HEIGHT, MAX_LENGTH};
use super::plant::{Controller, Flows, MAX_TANKS, PlantSpec, Setting, Tank};
use super::process::{Component, Constant, Process, ReactionsSpec};
use super::settler::{MAX_LAYERS, Settler};
use super::spec::{
    CompositionSpec, EffectSpec, InputHold, InputSpec, MAX_DOCUMENT, ModelSpec, OutputSpec, ParameterSpec,
    Scale, Sign, StateSpec, Stepper, Variant, WarmUpSpec,
};
use super::token::MAX_NAME;
use super::warm_up::MAX_HOURS;
use crate::units::{BASE, MAX_EXPONENT, UnitSymbol, symbols};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use utoipa::{PartialSchema, ToSchema};

/// The whole language.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Language {
    /// Expressions, units and declarations in extended Backus-Naur form.
    pub grammar: &'static str,
    /// The functions that expressions may call.
    pub functions: Vec<LanguageFunction>,
    /// The numbers that have names.
    pub constants: Vec<LanguageConstant>,
    /// The units that all others are made of.
    pub base_units: [&'static str; 7],
    /// Every symbol that a unit may be written with. There are no prefixes beside these.
    pub units: Vec<UnitSymbol>,
    /// What an input is between two samples.
    pub holds: Vec<LanguageWord>,
    /// How a search spreads over the interval of a parameter.
    pub scales: Vec<LanguageWord>,
    /// How a model is stepped.
    pub steppers: Vec<LanguageWord>,
    /// Which sign physics gives the coefficient of an effect.
    pub signs: Vec<LanguageWord>,
    /// What physics may demand of an estimate: the entries of `[[check]]`, by their `kind`.
    pub checks: Vec<LanguageTable>,
    /// The documents and their tables, with all fields. A field that is not known is refused.
    pub documents: Vec<LanguageTable>,
    /// How large things may be.
    pub limits: Vec<LanguageLimit>,
}

/// A word that a field may hold.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LanguageWord {
    /// The word.
    pub name: String,
    /// What it stands for.
    pub meaning: &'static str,
}

/// A document, or a table inside of one.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LanguageTable {
    /// What it is called.
    pub name: String,
    /// What it is.
    pub meaning: String,
    /// Its fields.
    pub fields: Vec<LanguageField>,
}

/// A field of a document.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LanguageField {
    /// Its name.
    pub name: String,
    /// What it says.
    pub meaning: String,
    /// Whether it has to be there.
    pub required: bool,
}

/// How large something may be.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LanguageLimit {
    /// What is limited.
    pub name: &'static str,
    /// The largest value.
    pub value: f64,
    /// The unit of the value; `-` for a count.
    pub unit: &'static str,
    /// What it is the limit of.
    pub meaning: &'static str,
}

/// The language that this program reads.
pub fn language() -> Language {
    Language {
        grammar: GRAMMAR,
        functions: functions().collect(),
        constants: CONSTANTS.to_vec(),
        base_units: BASE,
        units: symbols().collect(),
        holds: words(|hold| match hold {
            InputHold::Linear => "a straight line between samples",
            InputHold::ZeroOrder => "the value of a sample until the next one",
        }),
        scales: words(|scale| match scale {
            Scale::Linear => "evenly",
            Scale::Log => "evenly in the logarithm; both bounds are above zero",
        }),
        steppers: words(|stepper| match stepper {
            Stepper::Ros2 => "an L-stable Rosenbrock method of order 2; what has a filter needs it",
            Stepper::Rkc => {
                "a stabilised explicit method of order 2 for large models, without a filter: inputs are held and \
                not delayed"
            }
            Stepper::Rk4 => "a reference that no document asks for",
        }),
        signs: words(|sign| match sign {
            Sign::Positive => "never negative",
            Sign::Negative => "never positive",
            Sign::Any => "either",
        }),
        checks: checks(),
        documents: documents(),
        limits: limits(),
    }
}

/// The words of an enumeration, as its documents spell them.
fn words<T: DeserializeOwned + PartialSchema>(meaning: impl Fn(T) -> &'static str) -> Vec<LanguageWord> {
    let schema = serde_json::to_value(T::schema()).unwrap_or_default();
    let names = schema["enum"].as_array().into_iter().flatten();
    let word = |name: &Value| {
        let meaning = meaning(serde_json::from_value(name.clone()).ok()?);
        Some(LanguageWord { name: name.as_str()?.to_owned(), meaning })
    };
    names.filter_map(word).collect()
}

/// The kinds of checks with their fields.
fn checks() -> Vec<LanguageTable> {
    let schema = serde_json::to_value(Check::schema()).unwrap_or_default();
    let kinds = schema["oneOf"].as_array().into_iter().flatten();
    let kind = |kind: &Value| {
        let name = kind.pointer("/properties/kind/enum/0").and_then(Value::as_str).unwrap_or_default();
        let mut table = read(name, kind);
        table.fields.retain(|field| field.name != "kind");
        table
    };
    kinds.map(kind).collect()
}

fn documents() -> Vec<LanguageTable> {
    vec![
        table::<ModelSpec>("model"),
        table::<StateSpec>("state"),
        table::<InputSpec>("input"),
        table::<ParameterSpec>("parameter"),
        table::<Variant>("variant"),
        table::<OutputSpec>("output"),
        table::<WarmUpSpec>("warm_up"),
        table::<CompositionSpec>("composition"),
        table::<EffectSpec>("effect"),
        table::<ReactionsSpec>("reactions"),
        table::<Component>("component"),
        table::<Constant>("constant"),
        table::<Process>("process"),
        table::<PlantSpec>("plant"),
        table::<Tank>("tank"),
        table::<Flows>("flows"),
        table::<Controller>("controller"),
        table::<Settler>("settler"),
        table::<Setting>("setting"),
    ]
}

/// The fields of a type, with what its author wrote about them.
fn table<T: PartialSchema>(name: &str) -> LanguageTable {
    read(name, &serde_json::to_value(T::schema()).unwrap_or_default())
}

fn read(name: &str, schema: &Value) -> LanguageTable {
    // What may be absent is one of two things, of which one is nothing.
    let meaning = |value: &Value| {
        let choices = value["oneOf"].as_array().into_iter().flatten();
        let said = [value].into_iter().chain(choices).find_map(|value| value["description"].as_str());
        said.unwrap_or_default().replace('\n', " ")
    };
    let required: Vec<&str> =
        schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let field = |(name, value): (&String, &Value)| LanguageField {
        name: name.clone(),
        meaning: meaning(value),
        required: required.contains(&name.as_str()),
    };
    let fields = schema["properties"].as_object().into_iter().flatten().map(field).collect();
    LanguageTable { name: name.to_owned(), meaning: meaning(schema), fields }
}

fn limits() -> Vec<LanguageLimit> {
    let count = |name, value: usize, meaning| LanguageLimit { name, value: value as f64, unit: "-", meaning };
    let bytes = |name, value: usize, meaning| LanguageLimit { unit: "B", ..count(name, value, meaning) };
    let hours = |name, value, meaning| LanguageLimit { name, value, unit: "h", meaning };
    vec![
        bytes("document", MAX_DOCUMENT, "a document in TOML"),
        bytes("expression", MAX_LENGTH, "the text of one expression"),
        count("name", MAX_NAME, "letters of a name"),
        count("depth", MAX_DEPTH, "levels of parentheses, calls and signs"),
        count("chain", MAX_HEIGHT, "operators in a row"),
        count("nested", MAX_NESTED, "levels of expressions in definitions in expressions"),
        count("nodes", MAX_NODES, "nodes of a model, or terms of its sums, after its families are expanded"),
        count(
            "integer_power",
            MAX_INTEGER_POWER as usize,
            "a whole exponent of something with a unit or a sign",
        ),
        count("unit_exponent", usize::from(MAX_EXPONENT.unsigned_abs()), "an exponent in a unit"),
        count("states", MAX_STATES, "states of a model"),
        count("inputs", MAX_PARAMETERS, "inputs of a model, those of families one by one"),
        count("parameters", MAX_PARAMETERS, "parameters of a model, those of families one by one"),
        count("checks", MAX_CHECKS, "checks of a model"),
        count("effects", MAX_EFFECTS, "effects that the id of a model adds and leaves out"),
        hours("delay", MAX_DELAY, "a delay"),
        hours("warm_up", MAX_HOURS, "a warm-up"),
        count("tanks", MAX_TANKS, "tanks of a plant"),
        count("layers", MAX_LAYERS, "layers of a settler"),
    ]
}

#[cfg(test)]
mod tests {
    use super::language;

    #[test]
    fn every_word_and_field_says_what_it_means() {
        let language = language();
        for words in [&language.holds, &language.scales, &language.steppers, &language.signs] {
            assert!(words.len() > 1 && words.iter().all(|word| !word.meaning.is_empty()), "{words:?}");
        }
        assert_eq!(language.checks.len(), 5);
        for table in language.checks.iter().chain(&language.documents) {
            assert!(!table.meaning.is_empty(), "{}", table.name);
            let mute = table.fields.iter().find(|field| field.meaning.is_empty());
            assert!(mute.is_none(), "{} of {}", mute.unwrap().name, table.name);
        }
        let needed = |table: &str| {
            let table = language.documents.iter().find(|known| known.name == table).unwrap();
            table
                .fields
                .iter()
                .filter(|field| field.required)
                .map(|field| field.name.as_str())
                .collect::<Vec<_>>()
        };
        assert_eq!(needed("model"), ["equations", "id", "outputs", "states", "title"]);
        assert_eq!(needed("input"), ["unit"]);
        assert_eq!(needed("process"), ["name", "rate", "stoichiometry", "title"]);
        assert!(needed("reactions").contains(&"process"));
    }
}
