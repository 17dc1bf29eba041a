//! A synthetic treatment plant that hides an effect: its parameters are not those of the document, and one
//! thing happens in it that its model does not know.

use super::dice::Dice;
use super::plant::{PlantRequest, plant};
use crate::fault::Fault;
use crate::model::spec::EffectSpec;
use crate::model::{Bindings, Catalogue, Nominal, compile};
use serde::Serialize;

/// The plant of all worlds.
pub const PLANT: &str = "asm1_h";
/// Effects of the catalogue that these worlds hide, each with the least and the largest of its strength.
const STRENGTHS: [(&str, &str, [f64; 2]); 5] = [
    ("aeration_limit", "s_aeration", [0.45, 0.75]),
    ("water_temperature", "s_temperature", [0.7, 1.3]),
    ("rain_infiltration", "a_rain", [0.15, 0.6]),
    ("toxic_inflow", "s_toxic", [0.3, 0.9]),
    ("oxygen_sensor_bias", "b_S_O", [0.3, 1.0]),
];
/// Effects that no catalogue has, as documents. A side stream of the digesters carries ammonium at the same
/// hours of every day; too much ammonium slows the nitrifiers; when the inflow is high, some of it passes the
/// plant untreated.
const STRANGE_EFFECTS: [&str; 3] = [
    r#"
id = "reject_water"
title = "Reject water"
explain = "The digesters send their water back at some hours of the day."
[states.sine]
unit = "-"
initial = "0.8"
[states.cosine]
unit = "-"
initial = "-0.6"
[parameters]
a_reject = { unit = "g/m3", lower = 0, upper = 60, scale = "linear", nominal = 20 }
[terms]
sine = "0.2617993878[1/h] * cosine"
cosine = "-0.2617993878[1/h] * sine"
[replace]
S_NH = "S_NH + a_reject * max(0, sine) * max(0, sine) * max(0, sine)"
"#,
    r#"
id = "ammonium_inhibition"
title = "Inhibition by ammonium"
explain = "Too much ammonium slows the bacteria that live on it."
[parameters]
K_I = { unit = "g/m3", lower = 0.5, upper = 50, scale = "log", nominal = 3 }
[replace]
K_NH = "K_NH + S_NH[aerobic] * S_NH[aerobic] / K_I"
"#,
    r#"
id = "bypass"
title = "Bypass"
explain = "When much arrives, some of it passes the plant untreated."
[parameters]
s_bypass = { unit = "-", lower = 0, upper = 1, scale = "linear", nominal = 0.3 }
[define]
passes = "s_bypass * max(0, Q - 20000[m3/d]) / Q"
[outputs]
S_S_e = "passes * (S_S - S_S_e)"
X_S_e = "passes * (X_S - X_S_e)"
S_NH_e = "passes * (S_NH - S_NH_e)"
S_NO_e = "passes * (S_NO - S_NO_e)"
"#,
];
/// Their strengths, as those above.
const STRANGE_STRENGTHS: [(&str, &str, [f64; 2]); 3] = [
    ("reject_water", "a_reject", [10.0, 30.0]),
    ("ammonium_inhibition", "K_I", [1.0, 4.0]),
    ("bypass", "s_bypass", [0.1, 0.4]),
];
/// How far the true parameters are from those of the document, as a share.
const SPREAD: f64 = 0.12;
/// And least distance from their bounds, as a share of these.
const INSIDE: f64 = 0.03;

/// The effects of the catalogue that a world can hide.
pub fn catalogued() -> impl Iterator<Item = &'static str> {
    STRENGTHS.iter().map(|(effect, _, _)| *effect)
}

/// The effects that no catalogue has.
pub fn strange() -> impl Iterator<Item = &'static str> {
    STRANGE_STRENGTHS.iter().map(|(effect, _, _)| *effect)
}

/// What a world is to be like.
#[derive(Debug, Clone, Copy)]
pub struct PlantWorldRequest {
    /// Fixes everything that is drawn.
    pub seed: u64,
    /// The effect that it hides, if any.
    pub effect: Option<&'static str>,
    /// Days of the record.
    pub days: usize,
}

/// A synthetic plant with a hidden effect.
#[derive(Debug, Clone)]
pub struct PlantWorld {
    /// The measurements as CSV.
    pub csv: String,
    /// What the measurements do not say.
    pub truth: PlantTruth,
}

/// What is hidden.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlantTruth {
    /// The seed.
    pub seed: u64,
    /// The effect, if any.
    pub effect: Option<String>,
    /// Whether the catalogue has it.
    pub in_catalogue: bool,
    /// In the unit of its coefficient.
    pub strength: f64,
    /// All true values by name, those of the effect included.
    pub values: Vec<(String, f64)>,
}

/// Makes a world. `catalogue` need not have the effects that no catalogue has.
///
/// # Errors
/// Faults of the model, and of a plant that these values drive out of physics.
pub fn plant_world(catalogue: &Catalogue, request: &PlantWorldRequest) -> Result<PlantWorld, Vec<Fault>> {
    let mut catalogue = catalogue.clone();
    for text in STRANGE_EFFECTS {
        catalogue.add_effect(EffectSpec::from_toml(text).map_err(|fault| vec![fault])?);
    }
    // The inflow and the noise come from the same seed, and must not follow the strength.
    let mut dice = Dice::new(request.seed ^ 0x7061_7274);
    let id = PLANT.parse().map_err(|error| vec![Fault::new("/model", "model-id", format!("{error}"))])?;
    let base = compile(&catalogue.compose(&id)?, &Bindings::default())?;
    let mut values: Vec<(&str, f64)> = Vec::new();
    for parameter in base.parameters() {
        let Nominal::Value(nominal) = parameter.nominal else { continue };
        let drawn = nominal * (1.0 + dice.between(-SPREAD, SPREAD));
        values.push((
            &parameter.name,
            drawn.clamp(parameter.lower * (1.0 + INSIDE), parameter.upper * (1.0 - INSIDE)),
        ));
    }
    let mut strength = 0.0;
    let mut model = PLANT.to_owned();
    if let Some(effect) = request.effect {
        let known = STRENGTHS.iter().chain(&STRANGE_STRENGTHS).find(|(name, _, _)| *name == effect);
        let Some((_, parameter, [least, most])) = known else {
            return Err(vec![Fault::new("/effect", "unknown-effect", format!("no world hides `{effect}`"))]);
        };
        strength = dice.between(*least, *most);
        // A sensor is as likely to read too little as too much.
        if effect == "oxygen_sensor_bias" && dice.uniform() < 0.5 {
            strength = -strength;
        }
        values.push((parameter, strength));
        model = format!("{PLANT}+{effect}");
    }
    let asked = PlantRequest {
        seed: request.seed,
        model: &model,
        values: &values,
        days: request.days,
        noise: 1.0,
        warm_up: false,
    };
    let twin = plant(&catalogue, &asked)?;
    let in_catalogue = request.effect.is_some_and(|effect| catalogued().any(|known| known == effect));
    let effect = request.effect.map(str::to_owned);
    Ok(PlantWorld {
        csv: twin.csv,
        truth: PlantTruth { seed: request.seed, effect, in_catalogue, strength, values: twin.truth },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of an effluent over the record.
    fn mean(csv: &str, channel: &str) -> f64 {
        let place = csv.lines().next().unwrap().split(',').position(|name| name == channel).unwrap();
        let values: Vec<f64> =
            csv.lines().skip(1).filter_map(|line| line.split(',').nth(place)?.parse().ok()).collect();
        values.iter().sum::<f64>() / values.len() as f64
    }

    #[test]
    fn every_effect_moves_the_effluent_of_the_same_plant() {
        let catalogue = Catalogue::builtin().unwrap();
        let made = |effect| plant_world(&catalogue, &PlantWorldRequest { seed: 8, effect, days: 2 }).unwrap();
        let plain = made(None);
        for effect in catalogued().chain(strange()) {
            let world = made(Some(effect));
            let shared = plain.truth.values.len();
            assert_eq!(
                world.truth.values[..shared],
                plain.truth.values,
                "{effect} is hidden in another plant"
            );
            let moved = (mean(&world.csv, "S_NH_e") - mean(&plain.csv, "S_NH_e")).abs();
            assert!(moved > 0.02, "{effect}: {moved}");
        }
    }
}
