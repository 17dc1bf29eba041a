//! What a caller wants different from a model's own document, and where the measurements come from.

use super::basis::Basis;
use super::objective::{Objective, ShapeDelta};
use super::prior::Prior;
use crate::fault::{Fault, nearest};
use crate::model::{Model, Scale};
use indexmap::IndexMap;

/// Where the parameters of a prior stand that is written down.
const PRIOR: &str = "prior/known/parameters";

/// What the caller wants different from the model's own document.
#[derive(Debug, Clone, Default)]
pub struct Choices {
    /// What is minimised.
    pub objective: Objective,
    /// What the shape counts in it.
    pub delta: ShapeDelta,
    /// What is known of the parameters beforehand.
    pub prior: Prior,
    /// Other bounds, by parameter.
    pub bounds: IndexMap<String, [f64; 2]>,
    /// Values that are not estimated, by parameter.
    pub fixed: IndexMap<String, f64>,
}

impl Choices {
    /// What makes no sense for this model: unknown parameters, and bounds that are no interval on their
    /// scale. A parameter that only other variants of the model use is known, and what is asked of it waits
    /// for their channels: which variant it is shows when the measurements are there.
    pub fn faults(&self, model: &Model) -> Vec<Fault> {
        let mut faults = Vec::new();
        let names = || model.parameters().iter().map(|parameter| parameter.name.as_str());
        for (field, name) in self
            .bounds
            .keys()
            .map(|name| ("bounds", name))
            .chain(self.fixed.keys().map(|name| ("fixed", name)))
            .chain(self.prior.parameters().map(|(name, _)| (PRIOR, name)))
        {
            if !names().chain(model.unused().iter().map(String::as_str)).any(|known| known == name) {
                let fault = Fault::new(
                    format!("/{field}/{name}"),
                    "unknown-parameter",
                    format!("the model has no parameter `{name}`"),
                );
                faults.push(match nearest(name, names()) {
                    Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                    None => fault,
                });
            }
        }
        for parameter in model.parameters() {
            if let Some([lower, upper]) = self.bounds.get(&parameter.name)
                && (!(lower.is_finite() && upper.is_finite() && lower < upper)
                    || (parameter.scale == Scale::Log && *lower <= 0.0))
            {
                let detail =
                    format!("[{lower}, {upper}] is not an interval on the scale of `{}`", parameter.name);
                faults.push(Fault::new(format!("/bounds/{}", parameter.name), "bounds", detail));
            }
            if let Some(value) = self.fixed.get(&parameter.name).filter(|value| !value.is_finite()) {
                faults.push(Fault::new(
                    format!("/fixed/{}", parameter.name),
                    "not-finite",
                    format!("{value} is not a finite number"),
                ));
            }
        }
        for (name, known) in self.prior.parameters() {
            let parameter = model.parameters().iter().find(|parameter| parameter.name == *name);
            let is_log = parameter.is_some_and(|parameter| parameter.scale == Scale::Log);
            if !known.value.is_finite() || (is_log && known.value <= 0.0) {
                let detail = format!("{} does not lie on the scale of `{name}`", known.value);
                faults.push(Fault::new(format!("/{PRIOR}/{name}/value"), "off-scale", detail));
            }
        }
        for delay in model.delays() {
            let Some(parameter) = delay.parameter.map(|index| &model.parameters()[index]) else { continue };
            let (field, asked) = match (self.fixed.get(&parameter.name), self.bounds.get(&parameter.name)) {
                (Some(value), _) => ("fixed", [*value, *value]),
                (None, Some(bounds)) => ("bounds", *bounds),
                (None, None) => continue,
            };
            // A window brings as much past along as the model declares.
            if !(asked[0] >= 0.0 && asked[1] <= delay.longest) {
                let detail = format!(
                    "`{}` delays an input: the model allows 0 to {} h",
                    parameter.name, delay.longest
                );
                faults.push(Fault::new(format!("/{field}/{}", parameter.name), "bounds", detail));
            }
        }
        faults
    }
}

/// Where the measurements come from.
#[derive(Debug, Clone, Default)]
pub struct Source {
    /// Hash of the stitched measurements.
    pub hash: String,
    /// The quantisation step of each output's sensor, where it has one.
    pub quanta: Vec<Option<f64>>,
    /// The median step of the first output, in milliseconds.
    pub step: Option<i64>,
    /// What is needed to put the problem together again.
    pub basis: Basis,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Bindings, Catalogue, compile};

    #[test]
    fn what_another_variant_needs_may_be_bounded_and_what_none_has_may_not() {
        let catalogue = Catalogue::builtin().unwrap();
        let composition = catalogue.compose(&"room2".parse().unwrap()).unwrap();
        let compiled = |channels: Option<&[&str]>| {
            let channels = channels.map(|names| names.iter().map(|&name| name.to_owned()).collect());
            compile(&composition, &Bindings { sets: Default::default(), channels }).unwrap()
        };
        let bare = compiled(Some(&["T_room", "T_out", "valve", "T_forward", "sun_south_W_m2", "occupied"]));
        let other = compiled(None);
        let unused: Vec<&String> = bare.unused().iter().chain(other.unused()).collect();
        assert!(!unused.is_empty());
        let with =
            |name: &str| Choices { bounds: [(name.to_owned(), [0.1, 0.2])].into(), ..Choices::default() };
        for name in unused {
            for model in [&bare, &other] {
                let faults = with(name).faults(model);
                assert!(faults.iter().all(|fault| fault.code != "unknown-parameter"), "{faults:?}");
            }
        }
        assert_eq!(with("nobody").faults(&bare)[0].code, "unknown-parameter");
    }
}
