//! Text to tape: a model is a document, and this folder turns it into something that can be simulated.
//!
//! ```text
//! spec, effect documents --catalogue--> Composition --parse, lower--> expression graph (interned, folded,
//! units checked) --derivative--> Jacobian and df/dt --compile--> Model --tape (four stages)--> simulate/
//! ```
//!
//! A plant document (`plant`: tanks, flows, `settler`, controller) and the processes that happen in it
//! (`process`) expand into an ordinary spec first.
//!
//! Nothing here knows measurements or parameter values. Time is counted in hours.

mod bindings;
mod builder;
pub mod builtin;
pub mod catalogue;
mod check;
pub mod compile;
pub mod derivative;
pub mod document;
pub mod entrance;
pub mod export;
pub mod expr;
mod functions;
pub mod grammar;
pub mod id;
pub mod language;
mod lower;
pub mod math;
#[cfg(test)]
mod model_tests;
pub mod parse;
pub mod plant;
pub mod process;
mod quantity;
mod settler;
pub mod spec;
pub mod tape;
pub mod token;
pub mod waivers;
mod warm_up;

pub use bindings::Bindings;
pub use catalogue::{Catalogue, Composition};
pub use compile::compile;
pub use id::ModelId;
pub use spec::{Check, InputHold, Nominal, Scale, Stepper};

use expr::{Graph, NodeId};
use waivers::Waivers;

/// A compiled model. It exists only through [`compile()`].
#[derive(Debug, Clone)]
pub struct Model {
    id: ModelId,
    title: String,
    hash: String,
    states: Vec<State>,
    inputs: Vec<Input>,
    parameters: Vec<Parameter>,
    unused: Vec<String>,
    outputs: Vec<Output>,
    effects: Vec<String>,
    dropped: Vec<String>,
    checks: Vec<Check>,
    waivers: Waivers,
    ranges: Vec<NodeId>,
    graph: Graph,
    rhs: Vec<NodeId>,
    jacobian: Vec<Vec<NodeId>>,
    rate: Vec<NodeId>,
    delays: Vec<Delay>,
    stepper: Stepper,
    warm_up: Option<WarmUp>,
}

/// What every candidate goes through before the first sample.
#[derive(Debug, Clone, PartialEq)]
pub struct WarmUp {
    /// How long, in hours.
    pub hours: f64,
    /// What each input of the model is meanwhile.
    pub inputs: Vec<Held>,
}

/// What an input is during a warm-up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Held {
    /// This value.
    Value(f64),
    /// Its first value in the window.
    First,
    /// Its mean over the training part.
    Mean,
}

/// A delay of an input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delay {
    /// The input.
    pub input: usize,
    /// The parameter that is the delay, where it is one.
    pub parameter: Option<usize>,
    /// The longest that it can be, in hours.
    pub longest: f64,
}

/// A state variable of a compiled model.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Where its value at the start comes from.
    pub initial: Initial,
}

/// Where a state starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Initial {
    /// Where this output was measured first: at the mean of its first three valid samples, or where an
    /// estimate says.
    Measured(usize),
    /// At the value of this parameter.
    Parameter(usize),
    /// At this value.
    Fixed(f64),
}

/// An input of a compiled model.
#[derive(Debug, Clone, PartialEq)]
pub struct Input {
    /// Its name in the equations.
    pub name: String,
    /// The channel that it is read from.
    pub channel: String,
    /// Its unit in the equations.
    pub unit: String,
    /// Between samples.
    pub hold: InputHold,
    /// Whether it may stay constant in a record, as long as not all such inputs do.
    pub may_be_constant: bool,
}

/// A parameter of a compiled model.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its name; a member of a family is `alpha_n[2]`.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// How the search spreads over the interval.
    pub scale: Scale,
    /// A sensible value before any data.
    pub nominal: Nominal,
    /// A short title for people.
    pub title: String,
    /// What would tell it apart from others.
    pub excite: Option<String>,
}

/// An output of a compiled model.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// The channel that measures it.
    pub channel: String,
    /// Its unit.
    pub unit: String,
    /// Standard deviation of the sensor's noise.
    pub noise_sd: f64,
    /// Its expression.
    pub node: NodeId,
    /// Its derivatives with respect to the states.
    pub gradient: Vec<NodeId>,
}

impl Model {
    /// The readable identity.
    pub fn id(&self) -> &ModelId {
        &self.id
    }

    /// A short title for people.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// Hash of the documents and the bindings that it was compiled from.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The states, in order.
    pub fn states(&self) -> &[State] {
        &self.states
    }

    /// The inputs that the equations use, in order.
    pub fn inputs(&self) -> &[Input] {
        &self.inputs
    }

    /// The parameters that the equations use, in order; a parameter vector follows it.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// Names of parameters that no equation uses here, because the measured channels have chosen other
    /// variants.
    pub fn unused(&self) -> &[String] {
        &self.unused
    }

    /// The outputs, in order.
    pub fn outputs(&self) -> &[Output] {
        &self.outputs
    }

    /// The effects that took part.
    pub fn effects(&self) -> &[String] {
        &self.effects
    }

    /// What was left out because its channels are not there, in words.
    pub fn dropped(&self) -> &[String] {
        &self.dropped
    }

    /// What physics demands of an estimate.
    pub fn checks(&self) -> &[Check] {
        &self.checks
    }

    /// Rules of the gate that do not hold for it, with reasons.
    pub fn waivers(&self) -> &Waivers {
        &self.waivers
    }

    /// The expressions of the checks of kind `range`, in their order.
    pub fn ranges(&self) -> &[NodeId] {
        &self.ranges
    }

    /// The expression graph of the equations.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// The time derivative of each state, per hour.
    pub fn rhs(&self) -> &[NodeId] {
        &self.rhs
    }

    /// `jacobian()[i][j]` is the derivative of equation `i` with respect to state `j`.
    pub fn jacobian(&self) -> &[Vec<NodeId>] {
        &self.jacobian
    }

    /// The explicit time derivative of each equation through the slopes of its inputs. A delayed input moves
    /// along the straight line between its values at both ends of the step.
    pub fn rate(&self) -> &[NodeId] {
        &self.rate
    }

    /// The delays of inputs.
    pub fn delays(&self) -> &[Delay] {
        &self.delays
    }

    /// How it is stepped.
    pub fn stepper(&self) -> Stepper {
        self.stepper
    }

    /// What every candidate goes through before the first sample.
    pub fn warm_up(&self) -> Option<&WarmUp> {
        self.warm_up.as_ref()
    }

    /// The longest time, in hours, that the equations look back into an input; zero for most inputs.
    pub fn longest_delay(&self, input: usize) -> f64 {
        self.delays.iter().filter(|delay| delay.input == input).map(|delay| delay.longest).fold(0.0, f64::max)
    }
}
