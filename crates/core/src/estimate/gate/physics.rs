//! G3: what physics demands of an estimate, from the `[[check]]` blocks of its model.

use super::check::{CheckResult, Severity};
use crate::estimate::decompose;
use crate::estimate::problem::Problem;
use crate::model::expr::{Graph, Node};
use crate::model::{Check, InputHold};
use crate::simulate::trajectory::MeasuredOutput;
use crate::simulate::{Inputs, Simulator, Trajectory, substeps};
use indexmap::IndexMap;
use nalgebra::DMatrix;
use std::cell::LazyCell;
use std::ops::Deref;

/// Hours of a stress run.
const STRESS_HOURS: usize = 14 * 24;
/// How far a stress run moves the temperatures beyond what the window saw.
const STRESS_KELVIN: f64 = 10.0;
/// The lowest and the highest of no values.
const NOWHERE: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// Puts every check of the model to a parameter vector.
pub fn checks(problem: &Problem, theta: &[f64], trajectory: &Trajectory) -> Vec<CheckResult> {
    let model = problem.model();
    let mut extents = extents(problem, theta, trajectory).into_iter();
    let rates = LazyCell::new(|| eigenvalues(problem, theta, trajectory));
    let look = |check: &Check| match check {
        Check::Range { name, unit, lower, upper, .. } => {
            extents.next().map(|extent| inside(name, unit, (*lower, *upper), extent))
        }
        other => one(problem, theta, trajectory, &rates, other),
    };
    model.checks().iter().filter_map(look).collect()
}

/// Whether what an expression did stays within its limits.
fn inside(
    name: &str,
    unit: &str,
    (lower, upper): (Option<f64>, Option<f64>),
    (low, high): (f64, f64),
) -> CheckResult {
    let too_low = lower.is_some_and(|lower| low.is_nan() || low < lower);
    let too_high = upper.is_some_and(|upper| high.is_nan() || high > upper);
    // The limit that is broken is told, and else the lower one.
    let (statistic, operator, threshold) = match (lower, upper) {
        (Some(lower), _) if too_low || !too_high => (low, ">=", Some(lower)),
        (_, upper) => (high, "<=", upper),
    };
    let comment = format!("over the whole free run this goes from {low:.4} to {high:.4} {unit}");
    CheckResult {
        name: format!("G3 {name}"),
        statistic: Some(statistic).filter(|value| value.is_finite()),
        operator: operator.to_owned(),
        threshold,
        unit: unit.to_owned(),
        pass: !too_low && !too_high,
        severity: Severity::Reject,
        comment,
    }
}

/// The lowest and the highest value of the expressions of the range checks, over the samples that the free
/// run predicts.
fn extents(problem: &Problem, theta: &[f64], trajectory: &Trajectory) -> Vec<(f64, f64)> {
    let (model, inputs) = (problem.model(), problem.inputs());
    // A graph of their own, which is small: they are looked at as often as there are samples.
    let mut graph = Graph::default();
    let roots = graph.import(model.graph(), model.ranges(), |graph, leaf| graph.intern(leaf));
    if roots.is_empty() {
        return Vec::new();
    }
    let mut extents = vec![NOWHERE; roots.len()];
    for k in (0..inputs.samples()).filter(|k| problem.simulator().predicted(*k)) {
        let values = graph.evaluate(&roots, |leaf| match leaf {
            Node::State(i) => trajectory.states[usize::from(i)][k],
            Node::Param(i) => theta[usize::from(i)],
            Node::Input(i, _) => inputs.at(usize::from(i), k),
            // The past is not looked up, so that a check which asks for it never passes.
            Node::Delayed(..) => f64::NAN,
            _ => 0.0,
        });
        extents.iter_mut().zip(values).for_each(|(extent, value)| *extent = widened(*extent, value));
    }
    extents
}

fn one(
    problem: &Problem,
    theta: &[f64],
    trajectory: &Trajectory,
    rates: &impl Deref<Target = Vec<f64>>,
    check: &Check,
) -> Option<CheckResult> {
    let result = |name: &str,
                  statistic: f64,
                  operator: &str,
                  threshold: f64,
                  unit: &str,
                  pass: bool,
                  comment: String| {
        let statistic = Some(statistic).filter(|value| value.is_finite());
        let (name, operator, unit) = (format!("G3 {name}"), operator.to_owned(), unit.to_owned());
        Some(CheckResult {
            name,
            statistic,
            operator,
            threshold: Some(threshold),
            unit,
            pass,
            severity: Severity::Reject,
            comment,
        })
    };
    match check {
        Check::Stable => {
            let fastest = largest(rates);
            result(
                "stable",
                fastest,
                "<",
                0.0,
                "1/h",
                fastest < 0.0,
                "left alone, every temperature settles".to_owned(),
            )
        }
        Check::TimeConstants { lower, upper } => {
            let constants: Vec<f64> = rates.iter().map(|rate| -1.0 / rate).collect();
            let (shortest, longest) = (
                constants.iter().copied().fold(f64::INFINITY, f64::min),
                constants.iter().copied().fold(0.0, f64::max),
            );
            // The lowest and the highest of what is not known are those of nothing.
            let known = constants.iter().all(|constant| !constant.is_nan());
            let pass = known && shortest >= *lower && longest <= *upper;
            let comment = format!(
                "time constants from {shortest:.3} h to {longest:.1} h; physics allows {lower:.4} h to \
                {upper:.0} h"
            );
            result("time constants", longest, "<=", *upper, "h", pass, comment)
        }
        Check::SteadyGain { input, state, above, upto, with } => {
            let gain = steady_gain(problem, theta, input, state, with)?;
            let pass = gain > *above && upto.is_none_or(|upto| gain <= upto);
            let limit = upto.map_or_else(String::new, |upto| format!(" and at most {upto}"));
            let comment = format!(
                "one unit more of {input} moves {state} by {gain:.3} in the end; it must be above \
                {above}{limit}"
            );
            result(&format!("gain of {input}"), gain, ">", *above, "-", pass, comment)
        }
        Check::StateRange { lower, upper } => {
            let mut worst = 0.0f64;
            let runs = [
                trajectory.clone(),
                stress(problem, theta, -STRESS_KELVIN),
                stress(problem, theta, STRESS_KELVIN),
            ];
            for run in runs {
                for (low, high) in run.states.iter().map(|series| range(series)) {
                    // A range that is not a number is outside of everything.
                    let outside = (lower - low).max(high - upper);
                    worst = worst.max(if outside.is_nan() { f64::INFINITY } else { outside });
                }
            }
            let comment = format!(
                "all states stay within [{lower}, {upper}], on these data and in a fortnight of harsh weather"
            );
            result("state range", worst, "<=", 0.0, "K", worst <= 0.0, comment)
        }
        // Its expression belongs to the model (`extents`).
        Check::Range { .. } => None,
    }
}

/// Evaluates nodes of the model at states, parameters and inputs.
fn at(
    problem: &Problem,
    nodes: &[crate::model::expr::NodeId],
    states: &[f64],
    theta: &[f64],
    inputs: &[f64],
) -> Vec<f64> {
    problem.model().graph().evaluate(nodes, |leaf| match leaf {
        Node::State(i) => states[usize::from(i)],
        Node::Param(i) => theta[usize::from(i)],
        // In a steady state the past is as the present.
        Node::Input(i, _) | Node::Delayed(i, ..) => inputs[usize::from(i)],
        // Slopes and steps belong to a simulation; a steady state has none.
        _ => 0.0,
    })
}

/// The derivatives of the equations with respect to the states, per hour, at one point.
pub fn jacobian(problem: &Problem, states: &[f64], theta: &[f64], inputs: &[f64]) -> DMatrix<f64> {
    let n = states.len();
    let nodes: Vec<_> = problem.model().jacobian().iter().flatten().copied().collect();
    DMatrix::from_row_slice(n, n, &at(problem, &nodes, states, theta, inputs))
}

/// The mean of every input of the model over the window.
pub fn mean_inputs(problem: &Problem) -> Vec<f64> {
    (0..problem.model().inputs().len()).map(|input| problem.inputs().mean(input)).collect()
}

/// The longest time constant in the middle of the trajectory, in hours; `None` where something grows.
pub fn slowest(problem: &Problem, theta: &[f64], trajectory: &Trajectory) -> Option<f64> {
    let slowest = largest(&eigenvalues(problem, theta, trajectory));
    (slowest < 0.0).then(|| -1.0 / slowest)
}

/// The largest of some numbers; none where one is none.
fn largest(numbers: &[f64]) -> f64 {
    let larger = |largest: f64, number: &f64| {
        if largest.is_nan() || number.is_nan() { f64::NAN } else { largest.max(*number) }
    };
    numbers.iter().fold(f64::NEG_INFINITY, larger)
}

/// Real parts of the eigenvalues in the middle of the trajectory. Complex pairs are normal: a thermostat
/// feeds back.
fn eigenvalues(problem: &Problem, theta: &[f64], trajectory: &Trajectory) -> Vec<f64> {
    let states: Vec<f64> =
        trajectory.states.iter().map(|series| range(series)).map(|(low, high)| 0.5 * (low + high)).collect();
    let matrix = jacobian(problem, &states, theta, &mean_inputs(problem));
    if matrix.iter().any(|value| !value.is_finite()) {
        return vec![f64::NAN];
    }
    // Where they are not found nothing is known of them, and the checks fail.
    decompose::eigenvalues(&matrix).unwrap_or_else(|| vec![f64::NAN])
}

/// The steady change of a state per unit of an input, linearised in a cold room, where a thermostat is
/// open. `None` where the model does not use the input.
fn steady_gain(
    problem: &Problem,
    theta: &[f64],
    input: &str,
    state: &str,
    with: &IndexMap<String, f64>,
) -> Option<f64> {
    let model = problem.model();
    let index = model.inputs().iter().position(|known| known.name == input)?;
    let row = model.states().iter().position(|known| known.name == state)?;
    let mut inputs = mean_inputs(problem);
    for (value, known) in inputs.iter_mut().zip(model.inputs()) {
        *value = with.get(&known.name).copied().unwrap_or(*value);
    }
    let states = vec![0.0; model.states().len()];
    let step = 0.5;
    let mut moved = |change: f64| {
        let before = inputs[index];
        inputs[index] = before + change;
        let rates = at(problem, model.rhs(), &states, theta, &inputs);
        inputs[index] = before;
        rates
    };
    let (above, below) = (moved(step), moved(-step));
    let slope = DMatrix::from_fn(states.len(), 1, |i, _| (above[i] - below[i]) / (2.0 * step));
    let gain = jacobian(problem, &states, theta, &inputs).lu().solve(&-slope)?;
    Some(gain[(row, 0)])
}

/// A fortnight of constant inputs, with the temperatures moved beyond what the window saw.
fn stress(problem: &Problem, theta: &[f64], kelvin: f64) -> Trajectory {
    let model = problem.model();
    let values: Vec<f64> = model
        .inputs()
        .iter()
        .enumerate()
        .map(|(index, input)| {
            let (low, high) = problem.inputs().range(index);
            match (input.unit.as_str(), input.hold) {
                ("degC", InputHold::Linear) if kelvin < 0.0 => low + kelvin,
                ("degC", InputHold::Linear) => high + kelvin,
                // The sun does not shine for a fortnight, so everything else stays at its mean.
                _ => problem.inputs().mean(index),
            }
        })
        .collect();
    let inputs = Inputs::constant(model, &values, STRESS_HOURS, 1.0);
    let starts: Vec<f64> = (0..model.outputs().len())
        .map(|output| problem.simulator().measured_start(output).unwrap_or(20.0))
        .collect();
    let columns: Vec<(Vec<f64>, Vec<bool>)> =
        starts.iter().map(|start| (vec![*start; STRESS_HOURS + 1], vec![true; STRESS_HOURS + 1])).collect();
    let measured: Vec<MeasuredOutput> =
        columns.iter().map(|(values, valid)| (values.as_slice(), valid.as_slice())).collect();
    let simulator =
        Simulator::new(model, &inputs, &measured, model.stepper(), substeps(model.stepper(), 1.0));
    simulator.with_brake(problem.brake()).run_with_states(theta)
}

/// Lowest and highest value; a series with a value that is no number has no range either.
fn range(series: &[f64]) -> (f64, f64) {
    series.iter().fold(NOWHERE, |extent, value| widened(extent, *value))
}

/// A range that holds one more value. What is not a number stays so.
fn widened((low, high): (f64, f64), value: f64) -> (f64, f64) {
    if low.is_nan() || value.is_nan() { (f64::NAN, f64::NAN) } else { (low.min(value), high.max(value)) }
}
