//! Treatment plants: tanks in a row, recycles, a settler and a controller, put together as an ordinary model
//! document.
//!
//! A plant's document says volumes, flows and numbers; what is layout and logic is here. It expands into the
//! texts of a [`ModelSpec`], one equation per state, so that everything that works on models works on plants:
//! effects add terms to `S_NH[aerobic]`, and replace names such as `mu_A`, `Q` or `kLa[aerobic]`.

use super::process::{Constant, ReactionsSpec};
use super::settler::state;
use super::waivers::Waivers;

use super::settler::Settler;
use super::spec::{
    Check, Definition, InputHold, InputSpec, ModelSpec, Nominal, OutputSpec, ParameterSpec, Scale, Stepper,
    WarmUpSpec, from_toml,
};
use crate::fault::{Fault, nearest};
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The component that aeration brings in.
const OXYGEN: &str = "S_O";

/// A plant as its author wrote it; quantities are texts with their units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Plant)]
pub struct PlantSpec {
    /// The name by which jobs ask for it.
    pub id: String,
    /// A short title for people.
    pub title: String,
    /// What it describes and where it comes from.
    #[serde(default)]
    pub description: String,
    /// The components and processes.
    pub reactions: String,
    /// The parameters that an estimate searches; all others are fixed.
    pub free: Vec<String>,
    /// Saturation of oxygen.
    #[serde(rename = "S_O_sat")]
    pub saturation: String,
    /// The tanks in the order of the flow.
    pub tanks: IndexMap<String, Tank>,
    /// The flows that are set.
    pub flows: Flows,
    /// What sets the aeration of one tank, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controller: Option<Controller>,
    /// The settler behind the last tank.
    pub settler: Settler,
    /// What differs from the numbers of the reactions.
    #[serde(default)]
    pub parameters: IndexMap<String, Setting>,
    /// What is measured.
    pub outputs: IndexMap<String, OutputSpec>,
    /// What physics demands of any estimate.
    #[serde(default, rename = "check")]
    pub checks: Vec<Check>,
    /// Rules of the gate that do not hold for it, each with the reason.
    #[serde(default, skip_serializing_if = "Waivers::is_empty")]
    #[schema(value_type = IndexMap<String, String>)]
    pub waive: Waivers,
    /// What every candidate goes through before the first sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_up: Option<WarmUpSpec>,
}

/// A completely mixed tank.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PlantTank)]
pub struct Tank {
    /// Its volume.
    pub volume: String,
    /// Its aeration, where that is constant.
    #[serde(default, rename = "kLa", skip_serializing_if = "Option::is_none")]
    pub aeration: Option<String>,
    /// What it holds at the start, in the order of the components.
    pub initial: Vec<f64>,
}

/// The flows beside the influent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PlantFlows)]
pub struct Flows {
    /// Internal recycle from the last tank to the first.
    #[serde(rename = "Q_a")]
    pub internal: String,
    /// Return sludge from the settler to the first tank.
    #[serde(rename = "Q_r")]
    pub returned: String,
    /// Wasted sludge.
    #[serde(rename = "Q_w")]
    pub wasted: String,
}

/// A proportional-integral controller of the oxygen in a tank, whose integral follows the limits of the
/// aeration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PlantController)]
pub struct Controller {
    /// The tank.
    pub tank: String,
    /// The oxygen that it holds.
    pub set_point: String,
    /// Aeration per oxygen that is missing.
    pub gain: String,
    /// Time in which the integral does as much as the gain.
    pub integral_time: String,
    /// Aeration at no error.
    pub base: String,
    /// The most aeration; the least is none.
    pub highest: String,
    /// The integral at the start, in g d/m3.
    pub initial: f64,
}

/// A plant's own value of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PlantSetting)]
pub struct Setting {
    /// The value.
    pub value: f64,
    /// Lower bound, where it is another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<f64>,
    /// Upper bound, where it is another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper: Option<f64>,
}

impl PlantSpec {
    /// Reads a document in TOML.
    ///
    /// # Errors
    /// One fault with the place where the document stops making sense.
    pub fn from_toml(text: &str) -> Result<Self, Fault> {
        from_toml(text)
    }

    /// The model of the plant.
    ///
    /// # Errors
    /// Every name and length that makes no sense, and every process that does not conserve what it should.
    pub fn expand(&self, known: &BTreeMap<String, ReactionsSpec>) -> Result<ModelSpec, Vec<Fault>> {
        if !(1..=MAX_TANKS).contains(&self.tanks.len()) {
            return Err(vec![Fault::new(
                "/tanks",
                "limit",
                format!("a plant has between 1 and {MAX_TANKS} tanks"),
            )]);
        }
        let mut faults = self.own_faults();
        let Some(mut reactions) = known.get(&self.reactions).cloned() else {
            let fault = Fault::new(
                "/reactions",
                "unknown-name",
                format!("there are no reactions `{}`", self.reactions),
            );
            faults.push(match nearest(&self.reactions, known.keys().map(String::as_str)) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault
                    .suggest(format!("known are {}", known.keys().cloned().collect::<Vec<_>>().join(", "))),
            });
            return Err(faults);
        };
        faults.extend(self.set(&mut reactions));
        faults.extend(self.settler.faults(&reactions));
        let components = reactions.kept().count();
        for (name, tank) in self.tanks.iter().filter(|(_, tank)| tank.initial.len() != components) {
            let detail =
                format!("the tank needs {components} values, one per component, not {}", tank.initial.len());
            faults.push(Fault::new(format!("/tanks/{name}/initial"), "length", detail));
        }
        if let Some(controller) =
            self.controller.as_ref().filter(|controller| !self.tanks.contains_key(&controller.tank))
        {
            let fault = Fault::new(
                "/controller/tank",
                "unknown-name",
                format!("there is no tank `{}`", controller.tank),
            );
            faults.push(match nearest(&controller.tank, self.tanks.keys().map(String::as_str)) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault,
            });
        }
        faults.extend(reactions.continuity());
        let Some((last, _)) = self.tanks.last().filter(|_| faults.is_empty()) else {
            return Err(faults);
        };
        let mut spec = ModelSpec {
            id: self.id.clone(),
            title: self.title.clone(),
            description: self.description.clone(),
            outputs: self.outputs.clone(),
            checks: self.checks.clone(),
            waive: self.waive.clone(),
            stepper: Stepper::Rkc,
            warm_up: self.warm_up.clone(),
            ..ModelSpec::default()
        };
        self.influent(&mut spec, &reactions);
        self.numbers(&mut spec, &reactions);
        for tank in self.tanks.keys() {
            spec.define.insert(format!("TSS[{tank}]"), Definition::Text(reactions.solids(tank)));
            reactions.define_rates(&mut spec, tank);
        }
        for place in 0..self.tanks.len() {
            self.tank(&mut spec, &reactions, place);
        }
        self.settler.build(&mut spec, &reactions, last);
        if let Some(controller) = &self.controller {
            controller.build(&mut spec);
        }
        Ok(spec)
    }

    /// What is wrong in the model that this expands into, where its author can do something about it.
    #[must_use]
    pub fn place(fault: Fault) -> Fault {
        let of = |parts: &[&str]| parts.iter().any(|part| fault.pointer.starts_with(part));
        let pointer = if of(&["/process"]) {
            // A balance that does not hold is one of the numbers that the plant has written over those of its
            // reactions.
            "/parameters"
        } else if of(&["/states", "/equations", "/define", "/inputs"]) {
            "/tanks"
        } else {
            return fault;
        };
        Fault { detail: format!("{}: {}", fault.pointer, fault.detail), pointer: pointer.to_owned(), ..fault }
    }

    /// Writes the plant's own numbers over those of the reactions.
    fn set(&self, reactions: &mut ReactionsSpec) -> Vec<Fault> {
        let mut faults = Vec::new();
        let unknown = |pointer: String, name: &str, reactions: &ReactionsSpec| {
            let fault =
                Fault::new(pointer, "unknown-name", format!("`{}` has no parameter `{name}`", reactions.id));
            match nearest(name, reactions.parameters.keys().map(String::as_str)) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault,
            }
        };
        for (name, setting) in &self.parameters {
            match reactions.parameters.get_mut(name) {
                Some(constant) => {
                    constant.value = setting.value;
                    constant.lower = setting.lower.or(constant.lower);
                    constant.upper = setting.upper.or(constant.upper);
                }
                None => faults.push(unknown(format!("/parameters/{name}"), name, reactions)),
            }
        }
        for (index, name) in self.free.iter().enumerate() {
            match reactions.parameters.get(name) {
                Some(Constant { lower: Some(_), upper: Some(_), .. }) => {}
                Some(_) => faults.push(Fault::new(
                    format!("/free/{index}"),
                    "bounds",
                    format!("`{name}` is free and has no bounds"),
                )),
                None => faults.push(unknown(format!("/free/{index}"), name, reactions)),
            }
        }
        faults
    }

    /// The flow and each component of the influent are inputs.
    fn influent(&self, spec: &mut ModelSpec, reactions: &ReactionsSpec) {
        let input = |unit: &str, may_be_constant: bool| InputSpec {
            unit: unit.to_owned(),
            hold: InputHold::ZeroOrder,
            channel: None,
            min: Some(0.0),
            may_be_constant,
        };
        spec.inputs.insert("Q".to_owned(), input("m3/d", false));
        // By convention some components of an influent are constant, or zero.
        spec.inputs.extend(
            reactions.kept().map(|(name, component)| (name.to_owned(), input(&component.unit, true))),
        );
    }

    /// Parameters that are free, and definitions of all numbers that are not.
    fn numbers(&self, spec: &mut ModelSpec, reactions: &ReactionsSpec) {
        for (name, constant) in &reactions.parameters {
            match (constant.lower, constant.upper) {
                (Some(lower), Some(upper)) if self.free.contains(name) => {
                    let parameter = ParameterSpec {
                        unit: constant.unit.clone(),
                        lower,
                        upper,
                        scale: Scale::Linear,
                        nominal: Nominal::Value(constant.value),
                        quantity: String::new(),
                        title: constant.title.clone(),
                        excite: constant.excite.clone(),
                    };
                    spec.parameters.insert(name.clone(), parameter);
                }
                _ => {
                    spec.define.insert(
                        name.clone(),
                        Definition::Text(format!("{}[{}]", constant.value, constant.unit)),
                    );
                }
            }
        }
        let mut define = |name: &str, text: &str| {
            spec.define.insert(name.to_owned(), Definition::Text(text.to_owned()));
        };
        define("S_O_sat", &self.saturation);
        define("Q_a", &self.flows.internal);
        define("Q_r", &self.flows.returned);
        define("Q_w", &self.flows.wasted);
        define("Q_e", "Q - Q_w");
        // What flows through each tank.
        define("Q_through", "Q + Q_a + Q_r");
        for (name, tank) in &self.tanks {
            define(&format!("V[{name}]"), &tank.volume);
            if let Some(aeration) = &tank.aeration {
                define(&format!("kLa[{name}]"), aeration);
            }
        }
    }

    /// The balances of a tank: what flows in and out, what reacts, and the oxygen of the aeration.
    fn tank(&self, spec: &mut ModelSpec, reactions: &ReactionsSpec, place: usize) {
        let Some((name, tank)) = self.tanks.get_index(place) else { return };
        let last = self.tanks.keys().last().unwrap_or(name);
        let before = place.checked_sub(1).and_then(|before| self.tanks.get_index(before));
        // What depends on the influent alone is one value for all candidates.
        let share = |flow: &str| format!("convert({flow}/V[{name}], 1[1/h])");
        for ((component, about), initial) in reactions.kept().zip(&tank.initial) {
            let here = format!("{component}[{name}]");
            let mut balance = match before {
                Some((before, _)) => format!("{}*({component}[{before}] - {here})", share("Q_through")),
                None => format!(
                    "{}*{component} + {}*{component}[{last}] + {}*{component}_r - {}*{here}",
                    share("Q"),
                    share("Q_a"),
                    share("Q_r"),
                    share("Q_through")
                ),
            };
            if let Some(made) = reactions.made(component, name) {
                balance.push_str(&format!(" + {made}"));
            }
            let controlled = self.controller.as_ref().is_some_and(|controller| controller.tank == *name);
            if component == OXYGEN && (controlled || tank.aeration.is_some()) {
                balance.push_str(&format!(" + convert(kLa[{name}], 1[1/h])*(S_O_sat - {here})"));
            }
            state(spec, &here, &about.unit, *initial, format!("{}, {name} tank", about.title), balance);
        }
    }
}

impl Controller {
    fn build(&self, spec: &mut ModelSpec) {
        let tank = &self.tank;
        let mut define = |name: &str, text: &str| {
            spec.define.insert(name.to_owned(), Definition::Text(text.to_owned()));
        };
        define("S_O_set", &self.set_point);
        define("kLa_gain", &self.gain);
        define("T_integral", &self.integral_time);
        define("kLa_base", &self.base);
        define("kLa_max", &self.highest);
        define("S_O_sensor", &format!("{OXYGEN}[{tank}]"));
        define("S_O_error", "S_O_set - S_O_sensor");
        define("kLa_wanted", "kLa_base + kLa_gain*(S_O_error + I_O2/T_integral)");
        define("kLa_set", "max(0, min(kLa_max, kLa_wanted))");
        define(&format!("kLa[{tank}]"), "kLa_set");
        // Twice what the limit takes away goes back into the integral, so that it does not wind up.
        let integral = "convert(S_O_error + 2*(kLa_set - kLa_wanted)/kLa_gain, 1[g d/m3/h])";
        state(
            spec,
            "I_O2",
            "g d/m3",
            self.initial,
            "integral of the oxygen controller".to_owned(),
            integral.to_owned(),
        );
    }
}

/// Most tanks.
pub(super) const MAX_TANKS: usize = 12;
