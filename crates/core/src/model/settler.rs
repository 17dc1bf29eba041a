//! The secondary settler of Takacs, Patry and Nolasco (Water Research 25, 1991): layers through which solids
//! settle.
//!
//! Layer 1 is the top. Each layer has a state for the suspended solids, `TSS[3]`, and one for each dissolved
//! component, `S_NH[s3]`. The components that settle leave in the proportions of the feed at that instant.

use super::process::ReactionsSpec;
use super::spec::StateSpec;
use super::spec::{Definition, ModelSpec};
use crate::fault::Fault;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most layers.
pub(super) const MAX_LAYERS: usize = 20;

/// A settler as a plant's document says it; quantities are texts with their units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PlantSettler)]
pub struct Settler {
    /// Its surface.
    pub area: String,
    /// Its height, all layers together.
    pub height: String,
    /// How many layers there are.
    #[schema(minimum = 2, maximum = 20)]
    pub layers: usize,
    /// The layer that is fed, counted from the top.
    #[schema(minimum = 1, maximum = 20)]
    pub feed: usize,
    /// Highest settling velocity in practice.
    pub v0_max: String,
    /// Highest settling velocity of Vesilind's law.
    pub v0: String,
    /// What hinders settling.
    pub r_h: String,
    /// What slows the settling of thin suspensions.
    pub r_p: String,
    /// The share of the feed's solids that does not settle.
    pub f_ns: String,
    /// The solids above which a layer over the feed slows the settling into it.
    #[serde(rename = "X_t")]
    pub x_t: String,
    /// What each layer holds at the start, from the top: the suspended solids `TSS` and the dissolved
    /// components.
    pub initial: IndexMap<String, Vec<f64>>,
}

impl Settler {
    /// What makes no sense.
    pub(super) fn faults(&self, reactions: &ReactionsSpec) -> Vec<Fault> {
        let mut faults = Vec::new();
        if !(2..=MAX_LAYERS).contains(&self.layers) {
            faults.push(Fault::new(
                "/settler/layers",
                "limit",
                format!("a settler has 2 to {MAX_LAYERS} layers"),
            ));
        }
        if !(1..=self.layers).contains(&self.feed) {
            faults.push(Fault::new(
                "/settler/feed",
                "limit",
                "one of the layers is fed, counted from the top",
            ));
        }
        let held: Vec<&str> = reactions
            .kept()
            .filter(|(_, about)| about.tss.is_none())
            .map(|(name, _)| name)
            .chain(["TSS"])
            .collect();
        for name in &held {
            if self.initial.get(*name).is_none_or(|values| values.len() != self.layers) {
                let detail = format!("`{name}` needs {} values, one per layer", self.layers);
                faults.push(Fault::new(format!("/settler/initial/{name}"), "length", detail));
            }
        }
        for name in self.initial.keys().filter(|name| !held.contains(&name.as_str())) {
            let detail =
                format!("a layer holds no `{name}`: the dissolved components, and TSS for all solids");
            faults.push(Fault::new(format!("/settler/initial/{name}"), "unknown-name", detail));
        }
        faults
    }

    /// Adds the settler behind the tank `last`. The flows `Q_e` (over the weir), `Q_r` and `Q_w` are defined
    /// elsewhere; what it defines for the plant is each component in the effluent, `S_NH_e`, and in the
    /// return sludge, `S_NH_r`.
    pub(super) fn build(&self, spec: &mut ModelSpec, reactions: &ReactionsSpec, last: &str) {
        let bottom = self.layers;
        let mut define = |name: String, text: String| {
            spec.define.insert(name, Definition::Text(text));
        };
        for (name, text) in [
            ("A_settler", &self.area),
            ("v0_max", &self.v0_max),
            ("v0", &self.v0),
            ("r_h", &self.r_h),
            ("r_p", &self.r_p),
            ("f_ns", &self.f_ns),
            ("X_t", &self.x_t),
        ] {
            define(name.to_owned(), text.clone());
        }
        define("z_layer".to_owned(), format!("({})/{}", self.height, self.layers));
        // Velocities are counted in layers per hour, so that the height enters what is known beforehand
        // alone.
        define("v_up".to_owned(), "convert(Q_e/(A_settler*z_layer), 1[1/h])".to_owned());
        define("v_down".to_owned(), "convert((Q_r + Q_w)/(A_settler*z_layer), 1[1/h])".to_owned());
        define("TSS_feed".to_owned(), format!("TSS[{last}]"));
        define("TSS_min".to_owned(), "f_ns*TSS_feed".to_owned());
        define("clarified".to_owned(), "TSS[1]/TSS_feed".to_owned());
        define("thickened".to_owned(), format!("TSS[{bottom}]/TSS_feed"));
        for i in 1..=bottom {
            let law = format!("exp(-r_h*(TSS[{i}] - TSS_min)) - exp(-r_p*(TSS[{i}] - TSS_min))");
            let velocity =
                format!("max(0, min(convert(v0_max/z_layer, 1[1/h]), convert(v0/z_layer, 1[1/h])*({law})))");
            define(format!("v_settling[{i}]"), velocity);
            define(format!("settling[{i}]"), format!("v_settling[{i}]*TSS[{i}]"));
        }
        for i in 1..bottom {
            // What sinks out of a layer is limited by what the next one passes on; above the feed only if
            // that is thick.
            let limited = format!("min(settling[{i}], settling[{}])", i + 1);
            let flux = if i < self.feed {
                format!("if(TSS[{}] <= X_t, settling[{i}], {limited})", i + 1)
            } else {
                limited
            };
            define(format!("sinking[{i}]"), flux);
        }
        for (name, component) in reactions.kept() {
            let (top, under) = match component.tss {
                Some(_) => (format!("{name}[{last}]*clarified"), format!("{name}[{last}]*thickened")),
                None => (format!("{name}[s1]"), format!("{name}[s{bottom}]")),
            };
            define(format!("{name}_e"), top);
            define(format!("{name}_r"), under);
        }
        for (name, component) in reactions.kept().filter(|(_, component)| component.tss.is_none()) {
            for i in 1..=bottom {
                let flow = self.carried(i, |layer| format!("{name}[s{layer}]"), &format!("{name}[{last}]"));
                let title = format!("{}, layer {i} of the settler", component.title);
                state(spec, &format!("{name}[s{i}]"), &component.unit, self.initial(name, i), title, flow);
            }
        }
        for i in 1..=bottom {
            let mut balance = self.carried(i, |layer| format!("TSS[{layer}]"), "TSS_feed");
            if i > 1 {
                balance.push_str(&format!(" + sinking[{}]", i - 1));
            }
            if i < bottom {
                balance.push_str(&format!(" - sinking[{i}]"));
            }
            let title = format!("suspended solids, layer {i} of the settler");
            state(spec, &format!("TSS[{i}]"), "g/m3", self.initial("TSS", i), title, balance);
        }
    }

    /// What the water brings into a layer: from below above the feed, from above below it.
    fn carried(&self, layer: usize, at: impl Fn(usize) -> String, feed: &str) -> String {
        let here = at(layer);
        match layer.cmp(&self.feed) {
            std::cmp::Ordering::Less => format!("v_up*({} - {here})", at(layer + 1)),
            std::cmp::Ordering::Equal => format!("(v_up + v_down)*({feed} - {here})"),
            std::cmp::Ordering::Greater => format!("v_down*({} - {here})", at(layer - 1)),
        }
    }

    fn initial(&self, name: &str, layer: usize) -> f64 {
        self.initial.get(name).and_then(|values| values.get(layer - 1)).copied().unwrap_or_default()
    }
}

/// Adds a state with its equation.
pub(super) fn state(
    spec: &mut ModelSpec,
    name: &str,
    unit: &str,
    initial: f64,
    title: String,
    equation: String,
) {
    spec.states
        .insert(name.to_owned(), StateSpec { unit: unit.to_owned(), initial: initial.to_string(), title });
    spec.equations.insert(name.to_owned(), equation);
}
