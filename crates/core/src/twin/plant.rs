//! A treatment plant whose truth is known: the dry-weather influent of a town with some rain, and the
//! effluent that the plant makes of it. The truth takes steps of ten seconds by the classical Runge-Kutta
//! method: it owes nothing to the stepper under test.

use super::dice::Dice;
use crate::data::{DRY_INFLUENT, rfc3339};
use crate::data::{MINUTE, SECOND};
use crate::fault::Fault;
use crate::model::document::ModelDocument;
use crate::model::spec::WarmUpSpec;
use crate::model::{Bindings, Catalogue, Model, ModelId, Nominal, compile};
use crate::simulate::{Inputs, Simulator, Stepper};
use std::f64::consts::TAU;
use std::fmt::Write;

/// Start of every record: 2026-01-12T00:00:00Z.
const START: i64 = 1_768_176_000 * SECOND;
/// Minutes between rows, between values of the influent, and between samples of the effluent (thesis 6.2.3).
const ROW: usize = 5;
const INFLUENT: usize = 15;
const EFFLUENT: usize = 10;
/// Length of an internal step of the truth, in seconds.
const STEP: usize = 10;
/// What every plant goes through before its record, in minutes (thesis 6.2.3).
const WARM_UP: usize = 10_000;
/// What the warm-up holds beside the influent: the temperature of the water in degC, no rain and nothing
/// toxic.
const BESIDE: [(&str, f64); 3] = [("temperature", 15.0), ("rain", 0.0), ("toxic", 0.0)];

/// What plant is wanted.
#[derive(Debug, Clone, Copy)]
pub struct PlantRequest<'a> {
    /// All its chances.
    pub seed: u64,
    /// The plant, with the effects that are hidden in it: `asm1_h+aeration_limit`.
    pub model: &'a str,
    /// True values that are not the nominal ones.
    pub values: &'a [(&'a str, f64)],
    /// Days of the record.
    pub days: usize,
    /// Noise of the sensors, in the deviations that the plant's document states.
    pub noise: f64,
    /// Whether it goes through the warm-up of [`with_warm_up`] before its record; otherwise the record starts
    /// at the stated state.
    pub warm_up: bool,
}

/// A synthetic plant.
#[derive(Debug, Clone)]
pub struct PlantTwin {
    /// The measurements as CSV.
    pub csv: String,
    /// The true values by name.
    pub truth: Vec<(String, f64)>,
}

/// Makes a plant.
///
/// # Errors
/// Faults of the model, and of a plant that these values drive out of physics.
pub fn plant(catalogue: &Catalogue, request: &PlantRequest) -> Result<PlantTwin, Vec<Fault>> {
    let id: ModelId =
        request.model.parse().map_err(|error| vec![Fault::new("/model", "model-id", format!("{error}"))])?;
    let model = compile(&catalogue.compose(&id)?, &Bindings::default())?;
    let mut dice = Dice::new(request.seed);
    // As many rows as a fit of all days takes: one more, and it would begin a row later than the truth does.
    let rows = request.days * 1440 / ROW;
    let inflow = inflow(&mut dice, rows);
    let theta: Vec<f64> =
        model.parameters().iter().map(|parameter| truth(parameter, request.values)).collect();
    let warm = if request.warm_up { WARM_UP / ROW } else { 0 };
    let columns = model.inputs().iter().map(|input| column(&inflow, &input.channel, warm)).collect();
    let inputs = Inputs::from_columns(&model, columns, ROW as f64 / 60.0);
    let simulator =
        Simulator::new(&without_warm_up(catalogue, &id)?, &inputs, &[], Stepper::Rk4, ROW * 60 / STEP);
    let run = simulator.run(&[&theta], warm + rows).pop().filter(|run| !run.diverged);
    let run = run.ok_or_else(|| {
        vec![Fault::new("/values", "diverged", "the plant leaves physics with these values")]
    })?;
    let mut csv = String::from("time");
    let header = |name: &'static str| if name == "rain" { "rain[mm/h]" } else { name };
    model
        .outputs()
        .iter()
        .map(|output| output.channel.as_str())
        .chain(inflow.iter().map(|(name, _)| header(name)))
        .for_each(|name| {
            let _ = write!(csv, ",{name}");
        });
    csv.push('\n');
    for k in 0..rows {
        csv.push_str(&rfc3339(START + (k * ROW) as i64 * MINUTE));
        for (output, values) in model.outputs().iter().zip(&run.outputs) {
            csv.push(',');
            if (k * ROW).is_multiple_of(EFFLUENT) {
                let _ =
                    write!(csv, "{:.9}", values[warm + k] + request.noise * output.noise_sd * dice.normal());
            }
        }
        for (_, values) in &inflow {
            let _ = write!(csv, ",{}", values[k]);
        }
        csv.push('\n');
    }
    let names = model.parameters().iter().map(|parameter| parameter.name.clone());
    Ok(PlantTwin { csv, truth: names.zip(theta).collect() })
}

/// The catalogue in which a plant goes through the warm-up of the twins with every candidate (thesis 6.2.3).
#[must_use]
pub fn with_warm_up(catalogue: &Catalogue, base: &str) -> Catalogue {
    let mut warmed = catalogue.clone();
    if let Some(ModelDocument::Spec(spec)) = catalogue.model(base) {
        let mut spec = spec.clone();
        let inputs = spec.inputs.keys().filter_map(|name| Some((name.clone(), mean(name)?))).collect();
        spec.warm_up = Some(WarmUpSpec { hours: WARM_UP as f64 / 60.0, inputs });
        warmed.add_model(ModelDocument::Spec(spec));
    }
    warmed
}

/// The model on which the truth is simulated: its warm-up is part of the record.
fn without_warm_up(catalogue: &Catalogue, id: &ModelId) -> Result<Model, Vec<Fault>> {
    let mut composition = catalogue.compose(id)?;
    composition.spec.warm_up = None;
    compile(&composition, &Bindings::default())
}

fn mean(channel: &str) -> Option<f64> {
    DRY_INFLUENT.iter().chain(&BESIDE).find(|(name, _)| *name == channel).map(|(_, value)| *value)
}

fn truth(parameter: &crate::model::Parameter, values: &[(&str, f64)]) -> f64 {
    let chosen = values.iter().find(|(name, _)| *name == parameter.name).map(|(_, value)| *value);
    chosen.unwrap_or(match parameter.nominal {
        Nominal::Value(value) => value,
        Nominal::Measured(_) => f64::NAN,
    })
}

/// An input over the warm-up and the record.
fn column(inflow: &[(&'static str, Vec<f64>)], channel: &str, warm: usize) -> Vec<f64> {
    let record = inflow.iter().find(|(name, _)| *name == channel);
    let held = std::iter::repeat_n(mean(channel).unwrap_or(0.0), warm);
    held.chain(record.into_iter().flat_map(|(_, values)| values.iter().copied())).collect()
}

/// What arrives, row by row, as it is written: held over a quarter of an hour. Flow and loads follow the
/// hours of the day, ammonium ahead of the rest; at weekends there is less of all.
fn inflow(dice: &mut Dice, rows: usize) -> Vec<(&'static str, Vec<f64>)> {
    let quarters = (rows * ROW).div_ceil(INFLUENT);
    let per_day = 1440.0 / INFLUENT as f64;
    let day = |quarter: usize| quarter as f64 / per_day;
    let week = |quarter: usize| if day(quarter) % 7.0 >= 5.0 { 0.85 } else { 1.0 };
    let wave = |quarter: usize, lead: f64| {
        let phase = TAU * (day(quarter) - 0.45 + lead);
        1.0 + 0.28 * phase.cos() + 0.12 * (2.0 * phase).cos()
    };
    let flow = dice.wander(quarters, 0.04, per_day / 8.0);
    let load = dice.wander(quarters, 0.06, per_day / 8.0);
    let solids = dice.wander(quarters, 0.08, per_day / 12.0);
    let nitrogen = dice.wander(quarters, 0.05, per_day / 8.0);
    let warmth = dice.wander(quarters, 1.5, 3.0 * per_day);
    let cooling = dice.between(-0.3, 0.1);
    let rain = rain(dice, quarters, per_day);
    let toxic = toxic(dice, quarters, per_day);
    let digits = |value: f64| (value * 1e4).round() / 1e4;
    DRY_INFLUENT
        .iter()
        .chain(&BESIDE)
        .map(|(name, mean)| {
            let value = |quarter: usize| match *name {
                "Q" => mean * week(quarter) * wave(quarter, 0.0) * (1.0 + flow[quarter]),
                "S_S" | "S_ND" => mean * wave(quarter, 0.02) * (1.0 + load[quarter]),
                "X_S" | "X_I" | "X_BH" | "X_ND" => {
                    mean * week(quarter) * wave(quarter, 0.0) * (1.0 + solids[quarter])
                }
                "S_NH" => mean * (0.5 + 0.5 * wave(quarter, 0.06)) * (1.0 + nitrogen[quarter]),
                "temperature" => mean + warmth[quarter] + cooling * day(quarter),
                "rain" => rain[quarter],
                "toxic" => toxic[quarter],
                _ => *mean,
            };
            (*name, (0..rows).map(|k| digits(value(k * ROW / INFLUENT).max(0.0))).collect())
        })
        .collect()
}

/// Showers of some hours, about one in two days, in mm/h.
fn rain(dice: &mut Dice, quarters: usize, per_day: f64) -> Vec<f64> {
    let mut rain = vec![0.0; quarters];
    let showers = (quarters as f64 / per_day / 2.0).ceil() as usize;
    for _ in 0..showers {
        let (from, hours, strength) =
            (dice.between(0.0, quarters as f64) as usize, dice.between(2.0, 9.0), dice.between(0.5, 3.0));
        rain.iter_mut().skip(from).take((hours * 4.0) as usize).for_each(|rain| *rain = strength);
    }
    rain
}

/// Times at which something arrives that might be poison, about one in three days, as a log of 0 and 1.
fn toxic(dice: &mut Dice, quarters: usize, per_day: f64) -> Vec<f64> {
    let mut toxic = vec![0.0; quarters];
    let times = (quarters as f64 / per_day / 3.0).ceil() as usize;
    for _ in 0..times {
        let (from, hours) = (dice.between(0.0, quarters as f64) as usize, dice.between(3.0, 10.0));
        toxic.iter_mut().skip(from).take((hours * 4.0) as usize).for_each(|toxic| *toxic = 1.0);
    }
    toxic
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plant_is_plausible_and_the_same_for_the_same_seed() {
        let catalogue = Catalogue::builtin().unwrap();
        let request =
            PlantRequest { seed: 3, model: "asm1_h", values: &[], days: 1, noise: 0.0, warm_up: true };
        let twin = plant(&catalogue, &request).unwrap();
        assert_eq!(twin.csv, plant(&catalogue, &request).unwrap().csv);
        let limited =
            PlantRequest { model: "asm1_h+aeration_limit", values: &[("s_aeration", 0.65)], ..request };
        let limited = plant(&catalogue, &limited).unwrap();
        let ammonium = |twin: &PlantTwin| -> Vec<f64> {
            let place =
                twin.csv.lines().next().unwrap().split(',').position(|name| name == "S_NH_e").unwrap();
            twin.csv.lines().skip(1).filter_map(|line| line.split(',').nth(place)?.parse().ok()).collect()
        };
        let (plain, limited) = (ammonium(&twin), ammonium(&limited));
        assert_eq!(plain.len(), 144);
        assert!(plain.iter().all(|value| (0.0..20.0).contains(value)), "{plain:?}");
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        assert!(mean(&limited) > mean(&plain) + 0.5, "{} {}", mean(&limited), mean(&plain));
    }
}
