//! The documents: model specs, effects and their compositions, as TOML or JSON.
//!
//! A spec says its states, inputs, parameters, named subexpressions, equations and outputs as text. An
//! effect says what it adds to the equations of any model that has the states it names. A composition
//! names a base and its effects. Unknown fields are refused. See `config/` for the built-in ones.

pub use super::check::Check;
use super::waivers::Waivers;
use crate::fault::Fault;
use indexmap::IndexMap;
use serde::de::value::SeqAccessDeserializer;
use serde::de::{Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Largest document in bytes.
pub const MAX_DOCUMENT: usize = 64 * 1024;

/// A grey-box model as its author wrote it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelSpec {
    /// The name by which jobs ask for it.
    #[schema(pattern = "^[A-Za-z0-9_]{1,64}$")]
    pub id: String,
    /// A short title for people.
    pub title: String,
    /// What the model describes and where it comes from.
    #[serde(default)]
    pub description: String,
    /// Names of the sets that families run over; a system binds their members.
    #[serde(default)]
    pub sets: Vec<String>,
    /// State variables.
    pub states: IndexMap<String, StateSpec>,
    /// Measured inputs.
    #[serde(default)]
    pub inputs: IndexMap<String, InputSpec>,
    /// Unknown parameters.
    #[serde(default)]
    pub parameters: IndexMap<String, ParameterSpec>,
    /// Named subexpressions.
    #[serde(default)]
    pub define: IndexMap<String, Definition>,
    /// One expression per state: its derivative per hour.
    pub equations: IndexMap<String, String>,
    /// What is measured: one expression per output channel.
    pub outputs: IndexMap<String, OutputSpec>,
    /// What physics demands of any estimate.
    #[serde(default, rename = "check")]
    pub checks: Vec<Check>,
    /// Rules of the gate that do not hold for what it describes, by name (`G8 no unit jump`, or `G9` for all
    /// that begin so), each with the reason. They flag a fit and do not stop it.
    #[serde(default, skip_serializing_if = "Waivers::is_empty")]
    #[schema(value_type = IndexMap<String, String>)]
    pub waive: Waivers,
    /// How it is stepped.
    #[serde(default, skip_serializing_if = "Stepper::is_default")]
    pub stepper: Stepper,
    /// What every candidate goes through before the first sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_up: Option<WarmUpSpec>,
}

/// The unit of an input whose channel may have any.
pub const AS_IT_COMES: &str = "*";

/// How a model is stepped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Stepper {
    /// The L-stable Rosenbrock method of order 2 (Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci. Comput.
    /// 20, 1999) with gamma = 1 - 1/sqrt(2) and the df/dt term. It stays stable for the stiff candidates of
    /// wide boxes.
    #[default]
    Ros2,
    /// The stabilised explicit method of order 2 (Sommeijer, Shampine and Verwer, J. Comput. Appl. Math. 88,
    /// 1997) with steps of its own for each candidate: for large models whose stiffness is dissipative, as
    /// treatment plants are.
    Rkc,
    /// The classical Runge-Kutta method of order 4, for references; no document asks for it.
    #[serde(skip)]
    Rk4,
}

impl Stepper {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Constant inputs that lead every candidate from the states' initial values to the first sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = WarmUp)]
pub struct WarmUpSpec {
    /// How long, in hours.
    pub hours: f64,
    /// What each input is meanwhile.
    #[serde(default)]
    pub inputs: WarmUpInputs,
}

/// What the inputs are during a warm-up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged, expecting = "the value of each input, or \"mean\"")]
pub enum WarmUpInputs {
    /// What they are on average in the record: for a plant that has run for so many hours since the stated
    /// state. With much fewer or more of them its sludge is not what it was when the record began.
    Record(RecordMean),
    /// The value of each in its unit. An input that an effect adds keeps its first value where none is given.
    Values(IndexMap<String, f64>),
}

/// The word for the means of the record's own inputs, over its training part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RecordMean {
    /// The mean.
    Mean,
}

impl Default for WarmUpInputs {
    fn default() -> Self {
        Self::Values(IndexMap::new())
    }
}

impl FromIterator<(String, f64)> for WarmUpInputs {
    fn from_iter<I: IntoIterator<Item = (String, f64)>>(values: I) -> Self {
        Self::Values(values.into_iter().collect())
    }
}

/// A state variable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StateSpec {
    /// Its unit.
    pub unit: String,
    /// Its value at the start: the name of an output channel (near the mean of its first three valid samples)
    /// or of a parameter, or a number.
    pub initial: String,
    /// A short title for people.
    #[serde(default)]
    pub title: String,
}

/// How the search spreads over a parameter's interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Scale {
    /// Evenly.
    Linear,
    /// Evenly in the logarithm.
    Log,
}

/// What a channel is between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Hold)]
pub enum InputHold {
    /// A straight line between samples.
    Linear,
    /// Constant from the start of each interval to its end.
    ZeroOrder,
}

/// A measured input. The key may declare a family: `T_n[n in neighbours]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct InputSpec {
    /// Its unit in the equations; `*` takes the channel's numbers as they are.
    pub unit: String,
    /// Between samples.
    #[serde(default = "linear")]
    pub hold: InputHold,
    /// The channel that it is read from, its own name by default. In a family `T_n[n in neighbours]` the
    /// index in braces stands for the member, `T_room_{n}`; the default is `T_n_<member>`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channel: Option<String>,
    /// The least value that it can take, where physics gives one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Whether it may stay constant in a record: no parameter stands for its effect alone, as with the
    /// concentrations of an influent. All such inputs together may not.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub may_be_constant: bool,
}

fn linear() -> InputHold {
    InputHold::Linear
}

/// A starting value that a document gives as a number or as the channel whose first samples give it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum Nominal {
    /// A number in the parameter's unit.
    Value(f64),
    /// The first valid samples of this output channel.
    Measured(String),
}

impl<'de> Deserialize<'de> for Nominal {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberOrName;
        impl Visitor<'_> for NumberOrName {
            type Value = Nominal;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a number or the name of a channel")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Nominal, E> {
                Ok(Nominal::Value(value))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Nominal, E> {
                Ok(Nominal::Value(value as f64))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Nominal, E> {
                Ok(Nominal::Value(value as f64))
            }

            fn visit_str<E>(self, channel: &str) -> Result<Nominal, E> {
                Ok(Nominal::Measured(channel.to_owned()))
            }
        }
        deserializer.deserialize_any(NumberOrName)
    }
}

/// An unknown parameter. The key may declare a family: `alpha_n[n in neighbours]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ParameterSpec {
    /// Its unit.
    pub unit: String,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// How the search spreads over the interval.
    pub scale: Scale,
    /// A sensible value before any data.
    pub nominal: Nominal,
    /// What it is a measure of, such as `heat exchange`; stands before the title, and is no part of the hash.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub quantity: String,
    /// A short title for people.
    #[serde(default)]
    pub title: String,
    /// What would tell it apart from others, as the subject of a sentence: `a step in the oxygen set-point`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub excite: Option<String>,
}

/// A named subexpression: one text, or the first of several variants whose channels are all there.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum Definition {
    /// One expression.
    Text(String),
    /// Alternatives in order of preference.
    Variants(Vec<Variant>),
}

impl<'de> Deserialize<'de> for Definition {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TextOrVariants;
        impl<'de> Visitor<'de> for TextOrVariants {
            type Value = Definition;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an expression or a list of variants")
            }

            fn visit_str<E>(self, text: &str) -> Result<Definition, E> {
                Ok(Definition::Text(text.to_owned()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Definition, A::Error> {
                Vec::deserialize(SeqAccessDeserializer::new(seq)).map(Definition::Variants)
            }
        }
        deserializer.deserialize_any(TextOrVariants)
    }
}

/// One alternative of a definition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = DefinitionVariant)]
pub struct Variant {
    /// The inputs that it needs.
    #[serde(default)]
    pub needs: Vec<String>,
    /// The expression.
    pub expr: String,
    /// What is lost when this variant is taken; the fit says so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drops: Option<String>,
}

/// What a sensor measures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct OutputSpec {
    /// The expression of the true value.
    pub expr: String,
    /// Unit of the channel.
    pub unit: String,
    /// Standard deviation of the sensor's noise.
    pub noise_sd: f64,
}

/// A physical effect: what it adds to a model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Effect)]
pub struct EffectSpec {
    /// The name by which models and users call it.
    #[schema(pattern = "^[A-Za-z0-9_]{1,64}$")]
    pub id: String,
    /// A short title for people.
    pub title: String,
    /// One sentence that an operator understands.
    pub explain: String,
    /// What its absence looks like in the residuals.
    #[serde(default)]
    pub signature: String,
    /// What could be measured to tell this effect from others.
    #[serde(default)]
    pub measure: String,
    /// `channel` where the effect is a family with one member per channel: `{channel}` stands for the name.
    /// Any other word where it is one of the `choices`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub argument: Option<String>,
    /// How the names of the channels begin that are members of a family over channels; any that has the unit
    /// where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub members: Vec<String>,
    /// How the names begin of those that are not.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub strangers: Vec<String>,
    /// The members of a family that does not run over channels, each with the constants that its texts use:
    /// with `west = { bearing = 270 }` the mark `{bearing}` stands for 270 in `oriented_solar_gain:west`.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub choices: IndexMap<String, IndexMap<String, f64>>,
    /// The sign that physics gives its coefficient.
    #[serde(default)]
    pub sign: Sign,
    /// The effect of which this is another way: the same heat by another path into the room. It is tried
    /// where that one is named.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub way_of: Option<String>,
    /// Inputs that are made from the measured output, or follow from it: an effect that reads one can explain
    /// the output by itself, so more is asked of it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub endogenous: Vec<String>,
    /// States that it adds to the model. Their equations are their `terms`.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub states: IndexMap<String, StateSpec>,
    /// Inputs that it adds to the model.
    #[serde(default)]
    pub inputs: IndexMap<String, InputSpec>,
    /// Parameters that it adds to the model.
    #[serde(default)]
    pub parameters: IndexMap<String, ParameterSpec>,
    /// Named subexpressions that it adds to the model.
    #[serde(default)]
    pub define: IndexMap<String, Definition>,
    /// New meanings of names of the model: definitions, parameters or inputs. Inside its expression the name
    /// means what it meant before: `mu_A = "mu_A * f"`. An effect that replaces a name needs all of its
    /// inputs.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub replace: IndexMap<String, String>,
    /// Terms added to the equations, by state.
    #[serde(default)]
    pub terms: IndexMap<String, String>,
    /// Terms added to the outputs, by channel.
    #[serde(default)]
    pub outputs: IndexMap<String, String>,
}

/// The sign of an effect's coefficient.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Sign {
    /// Never negative.
    Positive,
    /// Never positive.
    Negative,
    /// Either.
    #[default]
    Any,
}

/// A model that is a base with effects, such as `room2`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ModelComposition)]
pub struct CompositionSpec {
    /// The name by which jobs ask for it.
    #[schema(pattern = "^[A-Za-z0-9_]{1,64}$")]
    pub id: String,
    /// A short title for people.
    pub title: String,
    /// What the model describes and where it comes from.
    #[serde(default)]
    pub description: String,
    /// The model that it starts from.
    pub base: String,
    /// The effects that it adds. One whose inputs are not there is dropped, and the fit says so.
    pub effects: Vec<String>,
}

/// Makes parameters what documents had before there were quantities: what is kept of a model stays as it is.
pub fn clear_quantities(parameters: &mut IndexMap<String, ParameterSpec>) {
    parameters.values_mut().for_each(|one| one.quantity.clear());
}

impl ParameterSpec {
    /// What people call it: `heat exchange, floor to room air`.
    pub fn full_title(&self) -> String {
        let words = [self.quantity.as_str(), self.title.as_str()];
        words.into_iter().filter(|word| !word.is_empty()).collect::<Vec<_>>().join(", ")
    }
}

impl EffectSpec {
    /// Whether its members are temperatures of what heats: any but those that are named as strangers.
    pub fn heats(&self) -> bool {
        self.argument.as_deref() == Some("channel")
            && !self.strangers.is_empty()
            && self.inputs.values().all(|input| input.unit == "degC")
    }

    /// Reads an effect in TOML.
    ///
    /// # Errors
    /// One fault with the place where the document stops making sense.
    pub fn from_toml(text: &str) -> Result<Self, Fault> {
        from_toml(text)
    }
}

pub(super) fn from_toml<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, Fault> {
    if text.len() > MAX_DOCUMENT {
        return Err(Fault::new(
            "",
            "too-large",
            format!("the document has {} bytes, the limit is {MAX_DOCUMENT}", text.len()),
        ));
    }
    toml::from_str(text).map_err(|error| {
        let line =
            error.span().map_or(1, |span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        Fault::new(format!("line {line}"), "invalid-document", error.message().to_owned())
    })
}
