//! A short simulation for an editor: what a model does with given values, over a window or a standard
//! weekday.

use crate::data::{CALENDAR, ChannelKind, DRY_INFLUENT, Hold, SUN, Series, Window, rfc3339};
use crate::data::{HOUR, MINUTE, SECOND};
use crate::estimate::problem::Problem;
use crate::estimate::problem::request::Site;
use crate::fault::Fault;
use crate::model::{Bindings, Catalogue, Model, ModelId, Stepper, compile};
use indexmap::IndexMap;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;
use utoipa::ToSchema;

/// Most graph nodes times steps of a preview; on one core this is well below two seconds.
const MOST_WORK: usize = 100_000_000;
/// Evaluations to a sample of a stepper that finds its own steps.
const OWN_STEPS: usize = 60;
/// The standard days: Thursday 2026-03-19 and the Friday after it, in UTC.
const START: i64 = 1_773_878_400 * SECOND;
const STEP: i64 = 15 * MINUTE;
const HOURS: i64 = 48;
/// Where the standard days are: the sun of Denmark.
const PLACE: (f64, f64) = (56.0, 10.0);
/// Channels that replace a part of a model; the standard days show the part itself, unless they are needed.
const REPLACEMENTS: [&str; 3] = ["flow", "valve", "irradiance"];

/// A value with its unit.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = PreviewQuantity)]
pub struct Quantity {
    /// The value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
}

/// A curve with its unit.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = PreviewCurve)]
pub struct Curve {
    /// The unit of the values.
    pub unit: String,
    /// One per time; `null` where there is none.
    pub values: Vec<Option<f64>>,
}

/// An output, measured and simulated.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = PreviewOutput)]
pub struct OutputCurves {
    /// The unit of both.
    pub unit: String,
    /// What was measured; nothing on the standard days.
    pub measured: Vec<Option<f64>>,
    /// The free run; `null` where an input is unknown.
    pub simulated: Vec<Option<f64>>,
    /// Root mean square of their difference over the whole window.
    pub rmse: Option<f64>,
}

/// What a model does.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Preview {
    /// The model with its effects.
    #[schema(example = "room3+wind_infiltration")]
    pub model: String,
    /// Hash of its content with these channels.
    pub hash: String,
    /// Whether the inputs are those of the standard days.
    pub synthetic: bool,
    /// The values that were used.
    pub parameters: IndexMap<String, Quantity>,
    /// What was left out because its channels are not there.
    pub dropped: Vec<String>,
    /// Whether the simulation left the numbers or physics.
    pub diverged: bool,
    /// Every how many samples one is shown.
    pub every: usize,
    /// The instants.
    pub time: Vec<String>,
    /// By channel.
    pub outputs: IndexMap<String, OutputCurves>,
    /// By name.
    pub states: IndexMap<String, Curve>,
    /// By channel.
    pub inputs: IndexMap<String, Curve>,
}

/// Simulates a problem at its nominal values (and those that were fixed), thinned to at most so many samples.
///
/// # Errors
/// A fault where the model is too large for so long a window.
pub fn preview(problem: &Problem, most: usize, synthetic: bool) -> Result<Preview, Fault> {
    let (model, grid, simulator) = (problem.model(), problem.grid(), problem.simulator());
    // A stepper that finds its own steps takes some dozens of evaluations to a sample, and as many for each
    // hour of its warm-up.
    let steps = match model.stepper() {
        Stepper::Ros2 | Stepper::Rk4 => simulator.substeps(),
        Stepper::Rkc => OWN_STEPS,
    };
    let hours = model.warm_up().map_or(0, |warm_up| warm_up.hours as usize);
    let work =
        model.graph().nodes().len().saturating_mul(grid.len().saturating_add(hours)).saturating_mul(steps);
    if work > MOST_WORK {
        let fault = Fault::new(
            "/window",
            "too-expensive",
            "the model is too large to be simulated at once over so long a window",
        );
        return Err(fault.suggest("ask for a shorter window, or submit a job"));
    }
    let run = problem.simulate(problem.nominal());
    let every = grid.len().div_ceil(most.max(1)).max(1);
    let shown: Vec<usize> = (0..grid.len()).step_by(every).collect();
    let pick = |value: &dyn Fn(usize) -> Option<f64>| -> Vec<Option<f64>> {
        shown.iter().map(|k| value(*k).filter(|value| value.is_finite())).collect()
    };
    // Where the simulation stands still it predicts nothing.
    let simulated = |series: &Vec<f64>| pick(&|k| simulator.predicted(k).then(|| series[k]));
    let measured = problem.measured();
    let outputs = model.outputs().iter().enumerate().map(|(index, output)| {
        let (values, valid) = measured[index];
        let curves = OutputCurves {
            unit: output.unit.clone(),
            measured: pick(&|k| (valid[k] && !synthetic).then(|| values[k])),
            simulated: simulated(&run.outputs[index]),
            rmse: problem.mean_square_error(&run, index, 0..grid.len()).map(f64::sqrt).filter(|_| !synthetic),
        };
        (output.channel.clone(), curves)
    });
    let states = model.states().iter().zip(&run.states);
    let columns =
        model.inputs().iter().filter_map(|input| Some((input.channel.clone(), grid.column(&input.channel)?)));
    let parameters = model.parameters().iter().zip(problem.nominal());
    Ok(Preview {
        model: model.id().to_string(),
        hash: model.hash().to_owned(),
        synthetic,
        parameters: parameters
            .map(|(parameter, value)| {
                (parameter.name.clone(), Quantity { value: *value, unit: parameter.unit.clone() })
            })
            .collect(),
        dropped: model.dropped().to_vec(),
        diverged: run.diverged,
        every,
        time: shown.iter().map(|k| rfc3339(grid.time(*k))).collect(),
        outputs: outputs.collect(),
        states: states
            .map(|(state, values)| {
                (state.name.clone(), Curve { unit: state.unit.clone(), values: simulated(values) })
            })
            .collect(),
        inputs: columns
            .map(|(channel, column)| {
                let values = pick(&|k| column.valid()[k].then(|| column.values()[k]));
                (channel, Curve { unit: column.unit().to_owned(), values })
            })
            .collect(),
    })
}

/// The standard days for a model: two days of weather, heating and people, or of the influent of a town,
/// whose outputs start at 20 degrees. Every set of the model has the one member `1`.
///
/// # Errors
/// Every fault of the model.
pub fn standard_days(catalogue: &Catalogue, id: &ModelId) -> Result<(Window, Site), Vec<Fault>> {
    let composition = catalogue.compose(id)?;
    let sets: BTreeMap<String, Vec<String>> =
        composition.spec.sets.iter().map(|set| (set.clone(), vec!["1".to_owned()])).collect();
    let full = compile(&composition, &Bindings { sets: sets.clone(), channels: None })?;
    let plain = without_replacements(&full);
    let sparse = compile(&composition, &Bindings { sets: sets.clone(), channels: Some(plain) });
    let model = sparse.unwrap_or(full);
    let computed: Vec<&str> = SUN.into_iter().chain(CALENDAR).collect();
    let times: Vec<i64> = (0..=HOURS * HOUR / STEP).map(|k| START + k * STEP).collect();
    let mut all = Vec::new();
    for output in model.outputs() {
        let start = if output.unit == "degC" { 20.0 } else { 0.0 };
        all.push(Series::new(
            &output.channel,
            &output.unit,
            Hold::Linear,
            times.clone(),
            vec![start; times.len()],
        ));
    }
    // Two inputs may read one channel: a neighbour's temperature drives the envelope, and the room where the
    // door is open.
    let mut known: BTreeSet<&str> = model.outputs().iter().map(|output| output.channel.as_str()).collect();
    for input in model.inputs() {
        if !known.insert(&input.channel) || computed.contains(&input.channel.as_str()) {
            continue;
        }
        let kind = ChannelKind::of_name(&input.channel).unwrap_or_else(|| ChannelKind::of_unit(&input.unit));
        let values = times
            .iter()
            .map(|time| standard(&input.channel, &kind.unit, (time - START) as f64 / HOUR as f64))
            .collect();
        all.push(Series::new(&input.channel, &kind.unit, kind.hold, times.clone(), values));
    }
    let series: Result<Vec<Series>, Fault> = all.into_iter().collect();
    let window = Window::from_series(series.map_err(|fault| vec![fault])?)?;
    Ok((window, Site { location: Some(PLACE), zone: None, sets }))
}

/// The channels that a model reads, and what its alternatives without a measured replacement read.
fn without_replacements(full: &Model) -> BTreeSet<String> {
    let read = full
        .inputs()
        .iter()
        .map(|input| input.channel.as_str())
        .filter(|channel| !REPLACEMENTS.contains(channel));
    read.chain(["T_out", "T_forward", "cloud_cover"]).chain(SUN).chain(CALENDAR).map(str::to_owned).collect()
}

/// What a channel does on the standard days, so many hours after their start.
fn standard(channel: &str, unit: &str, hours: f64) -> f64 {
    let clock = hours.rem_euclid(24.0);
    let between = |from: f64, to: f64| f64::from((from..to).contains(&clock));
    if let Some((_, average)) = DRY_INFLUENT.iter().find(|(name, _)| *name == channel) {
        // The flow follows the hours, and what it carries stays as it is.
        return if channel == "Q" {
            average * (1.0 + 0.3 * ((hours - 8.0) * PI / 12.0).sin())
        } else {
            *average
        };
    }
    match channel {
        "temperature" => 15.0,
        "rain" => 2.0 * between(3.0, 6.0),
        "toxic" => between(12.0, 14.0),
        "T_out" => 5.0 + 5.0 * ((hours - 9.0) * PI / 12.0).sin(),
        "T_forward" => 25.0 + 15.0 * between(6.0, 22.0),
        "cloud_cover" => 0.3,
        "irradiance" => 500.0 * ((clock - 6.0) * PI / 12.0).sin().max(0.0),
        "wind_speed" => 3.0 + 5.0 * between(12.0, 18.0),
        "wind_direction" => 270.0,
        "flow" | "valve" => between(6.0, 22.0),
        "window_open" => between(7.0, 7.5),
        "occupancy" => 2.0 * between(17.0, 23.0),
        "CO2" => 500.0 + 400.0 * between(17.0, 23.0),
        _ if channel.starts_with("T_room_") => 21.0,
        _ if channel.starts_with("P_") => between(18.0, 21.0),
        _ if unit == "degC" => 20.0,
        // Whatever nobody knows steps from 0 to 1 at noon.
        _ => f64::from(hours >= 12.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::SplitRequest;
    use crate::estimate::{EstimateRequest, prepare};

    fn on_standard_days(model: &str, most: usize) -> Preview {
        let catalogue = Catalogue::builtin().unwrap();
        let id: ModelId = model.parse().unwrap();
        let (window, site) = standard_days(&catalogue, &id).unwrap();
        let split = SplitRequest { validation: "P0D".parse().unwrap(), ..SplitRequest::ESTIMATE };
        let problem = prepare(
            &catalogue,
            &id,
            &EstimateRequest { split, ..EstimateRequest::default() },
            &window,
            &site,
        )
        .unwrap();
        preview(&problem, most, true).unwrap()
    }

    #[test]
    fn every_built_in_model_and_effect_has_standard_days() {
        let catalogue = Catalogue::builtin().unwrap();
        let models = catalogue.models().map(|document| document.id().to_owned());
        let effects =
            catalogue.effects().map(|effect| match (&effect.argument, effect.choices.keys().next()) {
                (Some(_), Some(choice)) => format!("room3+{}:{choice}", effect.id),
                (Some(_), None) if effect.inputs["{channel}"].unit == "degC" => {
                    format!("room3+{}:T_room_1", effect.id)
                }
                (Some(_), None) => format!("room3+{}:P_lamp", effect.id),
                (None, _) if !effect.replace.is_empty() || effect.outputs.contains_key("S_NH_e") => {
                    format!("asm1_h+{}", effect.id)
                }
                (None, _) => format!("room3+{}", effect.id),
            });
        for model in models.chain(effects) {
            let preview = on_standard_days(&model, 2000);
            assert!(!preview.diverged && preview.dropped.is_empty(), "{model}: {:?}", preview.dropped);
            assert_eq!((preview.every, preview.time.len()), (1, 193), "{model}");
            for output in preview.outputs.values() {
                assert!(
                    output.simulated.iter().flatten().count() > 150
                        && output.measured.iter().flatten().next().is_none()
                );
            }
        }
    }

    #[test]
    fn the_thermostat_shows_its_own_work_and_a_long_curve_is_thinned() {
        let whole = on_standard_days("room3", 2000);
        assert!(
            whole.parameters.contains_key("k")
                && !whole.inputs.contains_key("valve")
                && whole.inputs.contains_key("T_room_1")
        );
        let thin = on_standard_days("room3", 50);
        assert_eq!((thin.every, thin.time.len()), (4, 49));
        assert_eq!(thin.states["T_h"].values[7], whole.states["T_h"].values[28]);
        assert_eq!(thin.time[1], "2026-03-19T01:00:00Z");
        // In the morning the forward temperature rises, and the heated floor with it.
        let floor = &whole.states["T_h"].values;
        assert!(floor[40].unwrap() > floor[23].unwrap() + 1.0, "{:?} {:?}", floor[23], floor[40]);
    }
}
