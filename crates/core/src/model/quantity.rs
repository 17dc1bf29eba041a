//! What is wrong with the numbers and names of a plant's document, each at its place. Expressions that these
//! numbers go into would say it at places that its author never wrote.

use super::lower::{Lowering, Value};
use super::plant::PlantSpec;
use super::token::is_name;
use crate::fault::Fault;
use crate::units::Unit;
use std::collections::BTreeMap;

/// A quantity of the document: its place, its text, the unit that it must have, and whether it may be zero.
struct Quantity<'a>(String, &'a str, &'static str, bool);

impl PlantSpec {
    /// Every quantity without the unit that belongs there or out of physics, and every tank that cannot have
    /// its name.
    pub(super) fn own_faults(&self) -> Vec<Fault> {
        let mut faults: Vec<Fault> = self.quantities().iter().flat_map(Quantity::faults).collect();
        for (name, tank) in &self.tanks {
            if !is_name(name) || is_layer(name) {
                let detail = format!(
                    "`{name}` names no tank: a letter, then letters, digits and `_`, and not `s1`, which is \
                    a layer of the settler"
                );
                faults.push(Fault::new(format!("/tanks/{name}"), "name", detail));
            }
            faults.extend(negative(&format!("/tanks/{name}/initial"), &tank.initial));
        }
        for (name, values) in &self.settler.initial {
            faults.extend(negative(&format!("/settler/initial/{name}"), values));
        }
        faults
    }

    fn quantities(&self) -> Vec<Quantity<'_>> {
        let settler = &self.settler;
        let fixed = [
            ("/S_O_sat", &self.saturation, "g/m3", false),
            ("/flows/Q_a", &self.flows.internal, "m3/d", true),
            ("/flows/Q_r", &self.flows.returned, "m3/d", true),
            ("/flows/Q_w", &self.flows.wasted, "m3/d", true),
            ("/settler/area", &settler.area, "m2", false),
            ("/settler/height", &settler.height, "m", false),
            ("/settler/v0_max", &settler.v0_max, "m/d", false),
            ("/settler/v0", &settler.v0, "m/d", false),
            ("/settler/r_h", &settler.r_h, "m3/g", false),
            ("/settler/r_p", &settler.r_p, "m3/g", false),
            ("/settler/f_ns", &settler.f_ns, "-", true),
            ("/settler/X_t", &settler.x_t, "g/m3", true),
        ];
        let controller = self.controller.iter().flat_map(|controller| {
            [
                ("/controller/set_point", &controller.set_point, "g/m3", true),
                ("/controller/gain", &controller.gain, "m3/g/d", false),
                ("/controller/integral_time", &controller.integral_time, "d", false),
                ("/controller/base", &controller.base, "1/d", true),
                ("/controller/highest", &controller.highest, "1/d", true),
            ]
        });
        let tanks = self.tanks.iter().flat_map(|(name, tank)| {
            let volume = Quantity(format!("/tanks/{name}/volume"), &tank.volume, "m3", false);
            let aeration =
                tank.aeration.as_ref().map(|text| Quantity(format!("/tanks/{name}/kLa"), text, "1/d", true));
            [Some(volume), aeration].into_iter().flatten()
        });
        let named = fixed.into_iter().chain(controller);
        named
            .map(|(pointer, text, unit, zero)| Quantity(pointer.to_owned(), text, unit, zero))
            .chain(tanks)
            .collect()
    }
}

impl Quantity<'_> {
    fn faults(&self) -> Vec<Fault> {
        let Self(pointer, text, unit, zero) = self;
        let mut lowering = Lowering::new(BTreeMap::new());
        let Value { node, unit: found, .. } = lowering.text(pointer, text);
        if !lowering.faults.is_empty() {
            return lowering.faults;
        }
        let fits = |found: Unit| Unit::parse(unit).is_ok_and(|wanted| found.same_dimension(&wanted));
        if found.is_some_and(|found| !fits(found)) {
            let fault = Fault::new(pointer.clone(), "unit", format!("`{text}` is no quantity in {unit}"));
            return vec![if *unit == "-" {
                fault
            } else {
                fault.suggest(format!("write a number with its unit, such as 2[{unit}]"))
            }];
        }
        let value = lowering.graph.evaluate(&[node], |_| f64::NAN).first().copied().unwrap_or(f64::NAN);
        if value.is_finite() && (value > 0.0 || (*zero && value == 0.0)) {
            return Vec::new();
        }
        let least = if *zero { "at least zero" } else { "above zero" };
        vec![Fault::new(pointer.clone(), "bounds", format!("`{text}` must be a number {least}"))]
    }
}

/// Whether `S_NH[name]` would be a layer of the settler.
fn is_layer(name: &str) -> bool {
    name.strip_prefix('s')
        .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit()))
}

/// So many faults of one list are enough.
const MOST_FAULTS: usize = 50;

/// Concentrations below zero.
fn negative(pointer: &str, values: &[f64]) -> Vec<Fault> {
    let wrong = values.iter().enumerate().filter(|(_, value)| !(value.is_finite() && **value >= 0.0));
    wrong
        .take(MOST_FAULTS)
        .map(|(index, value)| {
            Fault::new(format!("{pointer}/{index}"), "bounds", format!("{value} is no concentration"))
        })
        .collect()
}
