//! A model as a Python module that builds CasADi functions.

use super::dialect::Dialect;
use super::listing::{listing, numbered};
use super::names::Names;
use super::python::head;
use super::source::ExportSource;
use crate::model::expr::NodeId;
use crate::model::{Model, Stepper};
use std::fmt::Write;

/// The functions of a module, and a step as the service takes it.
const FUNCTIONS: &str = r#"
x, u, p, _rates, _outputs = _model()
# Time derivatives of the states, per hour, and what the sensors should show.
rates = ca.Function("rates", [x, u, p], [_rates], ["x", "u", "p"], ["rates"])
outputs = ca.Function("outputs", [x, u, p], [_outputs], ["x", "u", "p"], ["outputs"])
"#;

/// A step of ROS2.
const ROS2: &str = r#"

def step(hours, steps=None):
    """A function of (x, u, u_next, p): the states so many hours later, in internal steps (ROS2). `u` is what
    enters at the start and `u_next` at the end; what is held stays as it is at the start."""
    steps = steps or max(int(-(-(hours / LONGEST_STEP_H - 1e-9) // 1)), 1)
    u_next = ca.SX.sym("u_next", len(COLUMNS))
    end = ca.vertcat(*[u_next[i] if linear else u[i] for i, linear in enumerate(LINEAR)])
    inner = ca.SX.sym("inner", len(STATES))
    first, last = ca.SX.sym("first", len(COLUMNS)), ca.SX.sym("last", len(COLUMNS))
    h = hours / steps
    now = rates(inner, first, p)
    left = ca.SX.eye(len(STATES)) - GAMMA * h * ca.jacobian(now, inner)
    k = ca.solve(left, now + GAMMA * ca.mtimes(ca.jacobian(now, first), last - first))
    moved = inner + h * k
    both = ca.solve(left, now + rates(moved, last, p) - 2.0 * k)
    part = ca.Function("part", [inner, first, last, p], [moved + 0.5 * h * both])
    state = x
    for i in range(steps):
        at = [u + (end - u) * (j / steps) for j in (i, i + 1)]
        state = part(state, at[0], at[1], p)
    return ca.Function("step", [x, u, u_next, p], [state], ["x", "u", "u_next", "p"], ["x_next"])
"#;

/// The module.
pub fn text(model: &Model, theta: &[f64], source: &ExportSource) -> String {
    let names = Names::new(model);
    let mut text = head(model, theta, source, "import casadi as ca");
    let outputs = model.outputs().iter().map(|output| output.node);
    let roots: Vec<NodeId> = model.rhs().iter().copied().chain(outputs).collect();
    let listing = listing(model.graph(), &roots, &names, Dialect::Casadi, numbered(&names));
    let (rates, outputs) = listing.roots.split_at(model.states().len());
    let entering: Vec<String> = names.entrances.iter().map(|(_, name)| name.clone()).collect();
    let delays =
        names.entrances.iter().map(|(entrance, _)| format!("{:?}", entrance.delay(model.graph(), theta)));
    let _ = write!(
        text,
        "# How many hours ago each of what enters counts.\nDELAYS_H = [{}]\n\n\ndef _model():\n",
        delays.collect::<Vec<_>>().join(", ")
    );
    for (symbol, parts) in [("x", &names.states), ("u", &entering), ("p", &names.parameters)] {
        let _ = writeln!(text, "    {symbol} = ca.SX.sym(\"{symbol}\", {})", parts.len());
        if !parts.is_empty() {
            let _ = writeln!(text, "    ({},) = ca.vertsplit({symbol})", parts.join(", "));
        }
    }
    for (name, meaning) in &listing.definitions {
        let _ = writeln!(text, "    {name} = {meaning}");
    }
    let column = |parts: &[String]| format!("ca.SX(ca.vertcat({}))", parts.join(", "));
    let _ = writeln!(text, "    return x, u, p, {}, {}\n", column(rates), column(outputs));
    text.push_str(FUNCTIONS);
    if model.stepper() == Stepper::Ros2 {
        text.push_str(ROS2);
    }
    text
}
