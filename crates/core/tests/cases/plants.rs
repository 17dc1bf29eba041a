//! Plants against reference series that another implementation computed, one folder each under `plants/`, and
//! against a second transcription of the equations. The steps are those of the classical Runge-Kutta method,
//! ten seconds long.

mod documents;
mod transcription;

use super::folders::{case, cases};
use super::full;
use indexmap::IndexMap;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::expr::Node;
use lampyris_core::model::spec::{EffectSpec, ModelSpec, OutputSpec, WarmUpSpec};
use lampyris_core::model::{Bindings, Catalogue, Model, compile};
use lampyris_core::simulate::{Inputs, Simulator, Stepper};
use serde::Deserialize;
use std::collections::HashMap;
use std::path::Path;

const COMPONENTS: [&str; 13] =
    ["S_I", "S_S", "X_I", "X_S", "X_BH", "X_BA", "X_P", "S_O", "S_NO", "S_NH", "S_ND", "X_ND", "S_ALK"];
/// The constant influent of the benchmark.
const CONSTANT: [f64; 13] = [30.0, 69.5, 51.2, 202.32, 28.17, 0.0, 0.0, 0.0, 0.0, 31.56, 6.95, 10.59, 7.0];

/// A folder's `case.toml`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    model: String,
    /// Tables of `data/asm1` beside the project: what flows in every fifteen minutes, and what comes out.
    influent: String,
    reference: String,
    /// Length of an interval of the simulation.
    minutes: f64,
    /// Columns of the reference that are not of the effluent.
    #[serde(default)]
    outputs: IndexMap<String, Output>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Output {
    expr: String,
    unit: String,
}

cases!("plants", simulated, {
    benchmark
    healthy
    of_the_thesis
}, full {});

/// A table of the reference data by columns; says so where it is not there.
fn table(name: &str) -> Option<HashMap<String, Vec<f64>>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/asm1").join(name);
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("SKIPPED: the reference series {name} is not beside the project");
        return None;
    };
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect()).collect();
    Some(
        header
            .iter()
            .enumerate()
            .map(|(at, name)| ((*name).to_owned(), rows.iter().map(|row| row[at]).collect()))
            .collect(),
    )
}

fn spec(id: &str) -> ModelSpec {
    match Catalogue::builtin().unwrap().model(id) {
        Some(ModelDocument::Spec(spec)) => (**spec).clone(),
        other => panic!("{id}: {other:?}"),
    }
}

fn built(spec: ModelSpec) -> Model {
    let id = spec.id.parse().unwrap();
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_model(ModelDocument::Spec(Box::new(spec)));
    compile(&catalogue.compose(&id).unwrap(), &Bindings::default()).unwrap()
}

/// The plant with these measurements instead of its own.
fn measuring(id: &str, outputs: &[(&str, &str, &str)]) -> Model {
    let mut spec = spec(id);
    spec.outputs.clear();
    for (channel, expr, unit) in outputs {
        spec.outputs.insert(
            (*channel).to_owned(),
            OutputSpec { expr: (*expr).to_owned(), unit: (*unit).to_owned(), noise_sd: 1.0 },
        );
    }
    built(spec)
}

/// The effluent of all components and of the suspended solids, under the names of the reference series.
fn effluent() -> Vec<(&'static str, String, &'static str)> {
    let unit = |name| if name == "S_ALK" { "mol/m3" } else { "g/m3" };
    let components = COMPONENTS.iter().map(|name| (*name, format!("{name}_e"), unit(*name)));
    components.chain([("TSS", "TSS[1]".to_owned(), "g/m3")]).collect()
}

fn nominal(model: &Model) -> Vec<f64> {
    let value = |parameter: &lampyris_core::model::Parameter| match parameter.nominal {
        lampyris_core::model::Nominal::Value(value) => value,
        lampyris_core::model::Nominal::Measured(_) => f64::NAN,
    };
    model.parameters().iter().map(value).collect()
}

/// Inputs that `value` gives by name and interval.
fn inputs(model: &Model, samples: usize, hours: f64, value: impl Fn(&str, usize) -> f64) -> Inputs {
    let columns =
        model.inputs().iter().map(|input| (0..samples).map(|k| value(&input.name, k)).collect()).collect();
    Inputs::from_columns(model, columns, hours)
}

fn constant(name: &str, flow: f64) -> f64 {
    COMPONENTS.iter().position(|component| *component == name).map_or(flow, |at| CONSTANT[at])
}

#[test]
fn the_benchmark_plant_stays_in_its_published_steady_state_and_comes_back_to_it() {
    let original = spec("bsm1");
    for shift in [1.0, 1.02] {
        let mut spec = original.clone();
        for state in spec.states.values_mut() {
            state.initial = (state.initial.parse::<f64>().unwrap() * shift).to_string();
        }
        let model = built(spec);
        let days = if shift == 1.0 { 5 } else { 200 };
        if shift != 1.0 && !full() {
            continue;
        }
        let inputs = inputs(&model, days * 24 + 1, 1.0, |name, _| constant(name, 18446.0));
        let run = Simulator::new(&model, &inputs, &[], Stepper::Rk4, 360).run_with_states(&nominal(&model));
        let mut worst = (0.0, String::new());
        for (state, series) in model.states().iter().zip(&run.states) {
            let stated: f64 = original.states[&state.name].initial.parse().unwrap();
            let error = (series.last().unwrap() / stated - 1.0).abs();
            if error.is_nan() || error > worst.0 {
                worst = (error, state.name.clone());
            }
        }
        println!(
            "bsm1 from {shift} times its steady state, {days} days: largest relative error {:.2e} ({})",
            worst.0, worst.1
        );
        assert!(worst.0 <= 1e-5, "{worst:?}");
    }
}

#[test]
fn the_stated_steady_state_of_the_benchmark_is_the_published_one() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/asm1/bsm1_openloop_steady_state.csv");
    let Ok(text) = std::fs::read_to_string(path) else {
        println!("SKIPPED: the steady state of the benchmark is not beside the project");
        return;
    };
    let model = measuring(
        "bsm1",
        &effluent().iter().map(|(channel, expr, unit)| (*channel, expr.as_str(), *unit)).collect::<Vec<_>>(),
    );
    let stated = |name: &str| match model.states().iter().find(|state| state.name == name).unwrap().initial {
        lampyris_core::model::Initial::Fixed(value) => value,
        other => panic!("{other:?}"),
    };
    for line in text.lines().skip(1) {
        let (unit, numbers) = line.split_once(',').unwrap();
        let numbers: Vec<f64> = numbers.split(',').map(|number| number.parse().unwrap()).collect();
        let layer = unit.strip_prefix("settler_layer").map(|rest| rest.split('_').next().unwrap());
        let solids = |tank: &str| {
            0.75 * ["X_I", "X_S", "X_BH", "X_BA", "X_P"]
                .iter()
                .map(|x| stated(&format!("{x}[{tank}]")))
                .sum::<f64>()
        };
        for (at, component) in COMPONENTS.iter().enumerate() {
            let ours = match layer {
                None => stated(&format!("{component}[{unit}]")),
                Some(layer) if component.starts_with('X') => {
                    stated(&format!("{component}[tank5]")) * stated(&format!("TSS[{layer}]"))
                        / solids("tank5")
                }
                Some(layer) => stated(&format!("{component}[s{layer}]")),
            };
            assert!(
                (ours - numbers[at]).abs() <= 1e-8 * numbers[at].abs(),
                "{component} of {unit}: {ours} {}",
                numbers[at]
            );
        }
        let ours = layer.map_or_else(|| solids(unit), |layer| stated(&format!("TSS[{layer}]")));
        assert!((ours / numbers[13] - 1.0).abs() <= 1e-8, "solids of {unit}");
    }
}

/// Simulates the weather from the stated state and compares every column at every sample.
fn simulated(name: &str) {
    let Case { model: id, influent, reference, minutes, outputs } = case("plants", name);
    let (Some(influent), Some(reference)) = (table(&influent), table(&reference)) else { return };
    let inside = outputs.iter().map(|(channel, output)| (channel.as_str(), &output.expr, &output.unit));
    let effluent = effluent();
    let model = measuring(
        &id,
        &effluent
            .iter()
            .map(|(channel, expr, unit)| (*channel, expr.as_str(), *unit))
            .chain(inside.map(|(channel, expr, unit)| (channel, expr.as_str(), unit.as_str())))
            .collect::<Vec<_>>(),
    );
    let days = if full() { 14.0 } else { 3.0 };
    let samples = (days * 1440.0 / minutes) as usize;
    // Each row of the influent holds for fifteen minutes from its index on; its column of times is rounded.
    let row = |k: usize| ((k as f64 * minutes / 15.0 + 1e-9) as usize).min(influent["Q_m3_d"].len() - 1);
    let inputs = inputs(&model, samples, minutes / 60.0, |name, k| {
        influent[if name == "Q" { "Q_m3_d" } else { name }][row(k)]
    });
    let substeps = (minutes * 6.0) as usize;
    let run = Simulator::new(&model, &inputs, &[], Stepper::Rk4, substeps).run(&[&nominal(&model)], samples);
    assert!(!run[0].diverged);
    let minutes_apart = (reference["t_d"][1] * 1440.0).round();
    let mut worst = (0.0, "");
    for (output, ours) in model.outputs().iter().zip(&run[0].outputs) {
        let (name, theirs) = reference.get_key_value(&output.channel).unwrap();
        let (low, high) = theirs
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
        // The reference has eight digits; what never changes has no range.
        let range = (high - low).max(1e-6 * high.abs());
        let every = (minutes_apart / minutes).round() as usize;
        let errors =
            ours.iter().step_by(every).zip(theirs).map(|(ours, theirs)| (ours - theirs).abs() / range);
        let error = errors.fold(0.0, |a: f64, b| if b <= a { a } else { b });
        println!("{id}, {days} days, {name}: largest error {error:.2e} of the range");
        if error.is_nan() || error > worst.0 {
            worst = (error, name.as_str());
        }
    }
    println!("{id}, {days} days: largest error {:.2e} of the range ({})", worst.0, worst.1);
    assert!(worst.0 <= 1e-3, "{worst:?}");
}

/// Every rate and every equation at random states and parameters, against the second transcription.
#[test]
fn a_plant_means_the_same_equations_as_a_second_transcription() {
    const RATES: [&str; 8] = [
        "growth_H_aerobic",
        "growth_H_anoxic",
        "growth_A",
        "decay_H",
        "decay_A",
        "ammonification",
        "hydrolysis",
        "hydrolysis_N",
    ];
    let rates: Vec<(String, String)> =
        RATES.iter().map(|name| ((*name).to_owned(), format!("{name}[aerobic]"))).collect();
    let rates: Vec<(&str, &str, &str)> =
        rates.iter().map(|(name, expr)| (name.as_str(), expr.as_str(), "g/m3/h")).collect();
    let model = measuring("asm1_h", &rates);
    let mut roots = model.rhs().to_vec();
    roots.extend(model.outputs().iter().map(|output| output.node));
    let mut random = transcription::Random(1);
    let (mut worst_rate, mut worst_equation) = (0.0f64, 0.0f64);
    for _ in 0..1000 {
        let x: Vec<f64> = model.states().iter().map(|state| random.state(&state.name)).collect();
        let theta: Vec<f64> = model.parameters().iter().map(|p| random.between(p.lower, p.upper)).collect();
        let flow = random.between(5_000.0, 60_000.0);
        let influent: Vec<f64> = COMPONENTS.iter().map(|_| random.between(0.0, 300.0)).collect();
        let leaf = |node: Node| match node {
            Node::State(i) => x[usize::from(i)],
            Node::Param(i) => theta[usize::from(i)],
            Node::Input(i, _) => {
                let name = &model.inputs()[usize::from(i)].name;
                COMPONENTS.iter().position(|component| component == name).map_or(flow, |at| influent[at])
            }
            _ => f64::NAN,
        };
        let ours = model.graph().evaluate(&roots, leaf);
        let free = |name: &str| model.parameters().iter().position(|p| p.name == name).map(|at| theta[at]);
        let (equations, scale, by_hand) = transcription::plant_h(&x, flow, &influent, &free);
        for i in 0..equations.len() {
            // Per day by hand, per hour here; what cancels is judged by what it was made of.
            worst_equation = worst_equation.max((24.0 * ours[i] - equations[i]).abs() / scale[i]);
        }
        for (ours, by_hand) in ours[equations.len()..].iter().zip(by_hand) {
            worst_rate = worst_rate.max((24.0 * ours / by_hand - 1.0).abs());
        }
    }
    println!(
        "1000 random states: rates within {worst_rate:.1e}, equations within {worst_equation:.1e} of their \
        terms"
    );
    assert!(worst_rate <= 1e-12 && worst_equation <= 1e-12);
}

/// The plant with the effects of these documents.
fn with_effects(id: &str, effects: &[&str]) -> Result<Model, Vec<lampyris_core::fault::Fault>> {
    let mut catalogue = Catalogue::builtin().unwrap();
    let mut name = id.to_owned();
    for effect in effects {
        let effect = EffectSpec::from_toml(effect).unwrap();
        name.push_str(&format!("+{}", effect.id));
        catalogue.add_effect(effect);
    }
    compile(&catalogue.compose(&name.parse().unwrap()).unwrap(), &Bindings::default())
}

const BLOWER: &str = r#"
    id = "blower_limit"
    title = "Blower limit"
    explain = "The blowers give less air than the controller believes."
    parameters.kLa_limit = { unit = "1/d", lower = 60, upper = 360, scale = "linear", nominal = 150 }
    replace.kLa_max = "min(kLa_max, kLa_limit)"
"#;

/// Weak blowers: the means of three dry days were measured with another program.
#[test]
fn an_effect_that_replaces_a_name_acts_on_the_plant_as_another_program_says() {
    let Some(influent) = table("influent_dry.csv") else { return };
    let means = |model: &Model| {
        let samples = 3 * 96;
        let inputs =
            inputs(model, samples, 0.25, |name, k| influent[if name == "Q" { "Q_m3_d" } else { name }][k]);
        let run = Simulator::new(model, &inputs, &[], Stepper::Rk4, 90).run(&[&nominal(model)], samples);
        let mean = |channel: &str| {
            let at = model.outputs().iter().position(|output| output.channel == channel).unwrap();
            run[0].outputs[at].iter().sum::<f64>() / samples as f64
        };
        [mean("S_NH_e"), mean("S_NO_e")]
    };
    let plain = means(&with_effects("asm1_h", &[]).unwrap());
    let weak = means(&with_effects("asm1_h", &[BLOWER]).unwrap());
    let (ammonium, nitrate) = (weak[0] - plain[0], weak[1] - plain[1]);
    println!("blowers that end at 150 per day: ammonium {ammonium:+.2}, nitrate {nitrate:+.2} g/m3");
    assert!((ammonium - 1.3).abs() < 0.15 && (nitrate + 3.0).abs() < 0.15, "{ammonium} {nitrate}");
}

/// Random candidates of the box, each from a warm-up of 10,000 minutes on, by the stabilised stepper and by
/// RK4 with steps of five seconds: at ten seconds three of 200 candidates of plant L have left RK4's stable
/// region.
#[test]
fn random_candidates_of_plants_stay_near_fine_steps_of_rk4() {
    let Some(influent) = table("influent_dry.csv") else { return };
    let (count, samples) = if full() { (200, 433) } else { (16, 145) };
    for id in ["asm1_l", "asm1_h"] {
        let mut spec = spec(id);
        let values = COMPONENTS.iter().zip(CONSTANT).map(|(name, value)| ((*name).to_owned(), value));
        spec.warm_up = Some(WarmUpSpec {
            hours: 10_000.0 / 60.0,
            inputs: values.chain([("Q".to_owned(), 18_446.0)]).collect(),
        });
        spec.stepper = Stepper::Rkc;
        let model = built(spec);
        let inputs = inputs(&model, samples, 1.0 / 6.0, |name, k| {
            influent[if name == "Q" { "Q_m3_d" } else { name }][k * 10 / 15]
        });
        let mut random = transcription::Random(6);
        let mut thetas = vec![nominal(&model)];
        thetas.extend((1..count).map(|_| {
            model.parameters().iter().map(|p| random.between(p.lower, p.upper)).collect::<Vec<f64>>()
        }));
        let thetas: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let ours = Simulator::new(&model, &inputs, &[], Stepper::Rkc, 1).run(&thetas, samples);
        let fine = Simulator::new(&model, &inputs, &[], Stepper::Rk4, 120).run(&thetas, samples);
        let mut worst = (0.0, Vec::new());
        for ((theta, ours), fine) in
            thetas.iter().zip(&ours).zip(&fine).filter(|((_, ours), _)| !ours.diverged)
        {
            for (ours, fine) in ours.outputs.iter().zip(&fine.outputs) {
                let (low, high) = fine
                    .iter()
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
                let error = ours.iter().zip(fine).map(|(ours, fine)| (ours - fine).abs()).fold(0.0, f64::max)
                    / (high - low);
                if error > worst.0 || error.is_nan() {
                    worst = (error, theta.to_vec());
                }
            }
        }
        let evaluations = ours.iter().map(|run| run.evaluations).sum::<usize>() / count;
        let diverged = ours.iter().filter(|run| run.diverged).count();
        println!(
            "{id}: {count} candidates, {diverged} diverged, largest error {:.2e} of the range, {evaluations} \
            evaluations each beside {}",
            worst.0, fine[0].evaluations
        );
        assert!(worst.0 <= 5e-3, "{id}: {worst:?}");
        assert!(
            diverged <= count / 10 && evaluations < 90_000,
            "{id}: {diverged} diverged, {evaluations} evaluations"
        );
    }
}
