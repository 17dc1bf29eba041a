//! A model as a Python module on numpy, and what both Python modules share.

use super::dialect::Dialect;
use super::json::start;
use super::listing::{Listing, listing, numbered};
use super::names::Names;
use super::source::ExportSource;
use crate::model::derivative::derivatives;
use crate::model::expr::NodeId;
use crate::model::{InputHold, Model, Stepper};
use std::fmt::Write;

/// One step of ROS2 as the service takes it, on numpy.
const ROS2: &str = r#"

def step(x, u, u_next, hours, p=PARAMETERS):
    """The states so many hours later (ROS2). `u` is what enters at the start, `u_next` at the end."""
    x, u = np.asarray(x, float), np.asarray(u, float)
    u_next = np.where(LINEAR, u_next, u)
    by_state, by_input = slopes(x, u, p)
    left = np.eye(len(x)) - GAMMA * hours * by_state
    now = rates(x, u, p)
    k = np.linalg.solve(left, now + GAMMA * (by_input @ (u_next - u)))
    moved = x + hours * k
    both = np.linalg.solve(left, now + rates(moved, u_next, p) - 2.0 * k)
    return moved + 0.5 * hours * both
"#;

/// One step of the classical method of Runge and Kutta, on numpy.
const RK4: &str = r#"

def step(x, u, u_next, hours, p=PARAMETERS):
    """The states so many hours later (RK4). `u` is what enters at the start, `u_next` at the end."""
    x, u = np.asarray(x, float), np.asarray(u, float)
    u_next = np.where(LINEAR, u_next, u)
    middle = 0.5 * (u + u_next)
    a = rates(x, u, p)
    b = rates(x + 0.5 * hours * a, middle, p)
    c = rates(x + 0.5 * hours * b, middle, p)
    d = rates(x + hours * c, u_next, p)
    return x + hours / 6.0 * (a + 2.0 * b + 2.0 * c + d)
"#;

/// What enters at any time.
const ENTERING: &str = r#"

def entering(inputs, k, fraction, hours, p=PARAMETERS):
    """What enters the equations, a fraction of the way from sample `k` of the inputs to the next."""
    found = []
    for (column, linear), delay in zip(zip(COLUMNS, LINEAR), delays(p)):
        values, place = inputs[:, column], k + fraction
        if delay is not None:
            place = min(max(place - delay / hours, 0.0), len(values) - 1.0)
            first = int(place) if linear else int(place + 1e-9)
        else:
            first = k
        last = min(first + 1, len(values) - 1)
        found.append(values[first] + (values[last] - values[first]) * (place - first) * linear)
    return np.array(found)
"#;

/// A free run with the stepper above.
const SIMULATE: &str = r#"

def simulate(x, inputs, hours, p=PARAMETERS, steps=None):
    """The states at every sample. `inputs` has a row per sample, so many hours apart, and a column per
    channel of INPUTS."""
    inputs = np.asarray(inputs, float)
    steps = steps or max(int(np.ceil(hours / LONGEST_STEP_H - 1e-9)), 1)
    states = [np.asarray(x, float)]
    for k in range(len(inputs) - 1):
        x = states[-1]
        for part in range(steps):
            u = entering(inputs, k, part / steps, hours, p)
            u_next = entering(inputs, k, (part + 1) / steps, hours, p)
            x = step(x, u, u_next, hours / steps, p)
        states.append(x)
    return np.array(states)
"#;

/// The module.
pub fn text(model: &Model, theta: &[f64], source: &ExportSource) -> String {
    let names = Names::new(model);
    let mut text = head(model, theta, source, "import numpy as np");
    let write = |graph, roots: &[NodeId]| listing(graph, roots, &names, Dialect::Numpy, numbered(&names));
    let delays: Vec<NodeId> = names.entrances.iter().filter_map(|(entrance, _)| entrance.hours()).collect();
    let mut hours = write(model.graph(), &delays);
    let mut told = std::mem::take(&mut hours.roots).into_iter();
    let listed: Vec<String> = names
        .entrances
        .iter()
        .map(|(entrance, _)| entrance.hours().and_then(|_| told.next()).unwrap_or_else(|| "None".to_owned()))
        .collect();
    let body = |listing: &Listing, given: &str, answer: &str| function(&names, listing, given, answer);
    let _ = write!(
        text,
        "\n\ndef delays(p=PARAMETERS):\n    \"\"\"How many hours ago each of what enters counts.\"\"\"\n{}",
        body(&hours, "p", &format!("[{}]", listed.join(", ")))
    );
    let rates = write(model.graph(), model.rhs());
    let _ = write!(
        text,
        "\n\ndef rates(x, u, p=PARAMETERS):\n    \"\"\"Time derivatives of the states, per hour.\"\"\"\n{}",
        body(&rates, "xup", &array(&rates.roots))
    );
    let outputs: Vec<NodeId> = model.outputs().iter().map(|output| output.node).collect();
    let outputs = write(model.graph(), &outputs);
    let _ = write!(
        text,
        "\n\ndef outputs(x, u, p=PARAMETERS):\n    \"\"\"What the sensors should show.\"\"\"\n{}",
        body(&outputs, "xup", &array(&outputs.roots))
    );
    text.push_str(ENTERING);
    match model.stepper() {
        Stepper::Ros2 => {
            let (n, m) = (model.states().len(), names.entrances.len());
            let mut graph = model.graph().clone();
            let by_input: Vec<Vec<NodeId>> = names
                .entrances
                .iter()
                .map(|(one, _)| derivatives(&mut graph, model.rhs(), one.leaf))
                .collect();
            let mut roots: Vec<NodeId> = model.jacobian().iter().flatten().copied().collect();
            roots.extend((0..n).flat_map(|i| by_input.iter().map(move |column| column[i])));
            let slopes = write(&graph, &roots);
            let (states, inputs) = slopes.roots.split_at(n * n);
            let shaped = |roots: &[String], columns| format!("{}.reshape({n}, {columns})", array(roots));
            let answer = format!("{}, {}", shaped(states, n), shaped(inputs, m));
            let _ = write!(
                text,
                "\n\ndef slopes(x, u, p=PARAMETERS):\n    \"\"\"Derivatives of the rates by states and by u.\"\"\"\n{}",
                body(&slopes, "xup", &answer)
            );
            text.push_str(ROS2);
            text.push_str(SIMULATE);
        }
        Stepper::Rk4 => {
            text.push_str(RK4);
            text.push_str(SIMULATE);
        }
        // Large stiff models have an integrator of the reader's own.
        Stepper::Rkc => {}
    }
    text
}

fn array(roots: &[String]) -> String {
    format!("np.array([{}], float)", roots.join(", "))
}

/// Title, imports and tables.
pub fn head(model: &Model, theta: &[f64], source: &ExportSource, imports: &str) -> String {
    let names = Names::new(model);
    let list = |parts: Vec<String>| format!("[{}]", parts.join(", "));
    let quoted = |text: &str| serde_json::Value::from(text).to_string();
    let states = model.states().iter().map(|state| quoted(&state.name)).collect();
    let units = model.states().iter().map(|state| quoted(&state.unit)).collect();
    let starts = model.states().iter().map(|state| match start(state.initial, theta) {
        Some(value) => format!("{value:?}"),
        None => "None".to_owned(),
    });
    let inputs =
        model.inputs().iter().map(|input| format!("({}, {})", quoted(&input.channel), quoted(&input.unit)));
    let outputs =
        model.outputs().iter().map(|one| format!("({}, {})", quoted(&one.channel), quoted(&one.unit)));
    let columns = names.entrances.iter().map(|(entrance, _)| entrance.input.to_string()).collect();
    let is_linear = |input: usize| model.inputs()[input].hold == InputHold::Linear;
    let linear = names.entrances.iter().map(|(one, _)| if is_linear(one.input) { "True" } else { "False" });
    let parameters =
        names.parameters.iter().zip(theta).map(|(name, value)| format!("    \"{name}\": {value:?},\n"));
    // A title may hold anything; a line of comment holds no line break, and no end of a text.
    let line = |text: &str| text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect::<String>();
    format!(
        "# {}\n# {}\n# {}\n# Time is counted in hours.\n\n{imports}\n\n\
        MODEL = {}\nSTATES = {}\nSTATE_UNITS = {}\n\
        # At the start of the window that it was fitted to; None where that was measured.\nSTART = {}\n\
        # Channels and their units.\nINPUTS = {}\nOUTPUTS = {}\n\
        # What enters: the column of INPUTS, and whether it goes in a straight line between samples.\n\
        COLUMNS = {}\nLINEAR = {}\n\
        PARAMETERS = {{\n{}}}\n\
        # The longest internal step of the service, and the constant of its method.\n\
        LONGEST_STEP_H = {:?}\nGAMMA = {:?}\n",
        line(model.title()),
        line(&model.id().to_string()),
        line(&source.line),
        quoted(&model.id().to_string()),
        list(states),
        list(units),
        list(starts.collect()),
        list(inputs.collect()),
        list(outputs.collect()),
        list(columns),
        list(linear.map(str::to_owned).collect()),
        parameters.collect::<String>(),
        source.longest_step_h,
        1.0 - std::f64::consts::FRAC_1_SQRT_2,
    )
}

/// The lines of a function: the names that it is `given` by (`x`, `u`, `p`), definitions, and its answer.
fn function(names: &Names, listing: &Listing, given: &str, answer: &str) -> String {
    let mut lines = String::new();
    let entering: Vec<String> = names.entrances.iter().map(|(_, name)| name.clone()).collect();
    for (argument, parts) in [('x', &names.states), ('u', &entering)] {
        if given.contains(argument) && !parts.is_empty() {
            let _ = writeln!(lines, "    ({},) = {argument}", parts.join(", "));
        }
    }
    for name in &names.parameters {
        let _ = writeln!(lines, "    {name} = p[\"{name}\"]");
    }
    for (name, meaning) in &listing.definitions {
        let _ = writeln!(lines, "    {name} = {meaning}");
    }
    let _ = writeln!(lines, "    return {answer}");
    lines
}
