//! The linear discrete model of the hours to come, as a controller needs it.

use super::ahead::{ForecastAsked, Onward, newest_of, standing_still};
use super::disturbance::{Disturbance, disturbance};
use super::inputs::InputsToCome;
use crate::data::{Duration, Window, rfc3339};
use crate::estimate::assess::replay::Replay;
use crate::estimate::fit::Fit;
use crate::fault::Fault;
use crate::model::spec::AS_IT_COMES;
use crate::model::{InputHold, Model};
use crate::simulate::linearise::{LinearStep, Linearisation};
use serde::Serialize;
use utoipa::ToSchema;

/// A state of a linear model.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LinearState {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
}

/// An input of a linear model.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LinearInput {
    /// The channel.
    pub channel: String,
    /// Its unit in these matrices.
    pub unit: String,
    /// How long ago it counts, in hours: what it was so long before the start (and the end) of a step.
    pub delay_h: f64,
}

/// An output of a linear model.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LinearOutput {
    /// The channel that measures it.
    pub channel: String,
    /// Its unit.
    pub unit: String,
}

/// One step: `x(k+1) = a x(k) + b u(k) + e w(k) + e_next w(k+1) + offset`, and at its start
/// `y(k) = c x(k) + d_held u(k) + d_moving w(k) + output_offset`. A matrix is a list of rows.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MatricesStep {
    /// The start.
    #[schema(format = DateTime)]
    pub at: String,
    /// The states where the model was linearised.
    pub states: Vec<f64>,
    /// The inputs that are held over the step, there.
    pub held: Vec<f64>,
    /// The inputs that go in a straight line, at its start.
    pub moving: Vec<f64>,
    /// The same at its end.
    pub moving_next: Vec<f64>,
    /// States by states.
    pub a: Vec<Vec<f64>>,
    /// States by held inputs.
    pub b: Vec<Vec<f64>>,
    /// States by moving inputs at the start.
    pub e: Vec<Vec<f64>>,
    /// States by moving inputs at the end.
    pub e_next: Vec<Vec<f64>>,
    /// States by a steady rate of change, per hour, that comes on top of each state's own: what a disturbance
    /// does.
    pub g: Vec<Vec<f64>>,
    /// What neither explains of the states.
    pub offset: Vec<f64>,
    /// The covariance that the process noise adds in the step.
    pub q: Vec<Vec<f64>>,
    /// Outputs by states.
    pub c: Vec<Vec<f64>>,
    /// Outputs by held inputs.
    pub d_held: Vec<Vec<f64>>,
    /// Outputs by moving inputs.
    pub d_moving: Vec<Vec<f64>>,
    /// What neither explains of the outputs.
    pub output_offset: Vec<f64>,
}

/// A model as a linear discrete one, step by step.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = LinearisationBody)]
pub struct Matrices {
    /// The model.
    pub model: String,
    /// The newest measurement, from which it starts.
    #[schema(format = DateTime)]
    pub at: String,
    /// The length of a step.
    #[schema(example = "PT15M")]
    pub step: String,
    /// The states, x.
    pub states: Vec<LinearState>,
    /// The inputs that are held over a step, u: valves, pumps, powers that are set.
    pub held: Vec<LinearInput>,
    /// The inputs that go in a straight line from the start of a step to its end, w: temperatures, the sun.
    pub moving: Vec<LinearInput>,
    /// The outputs, y.
    pub outputs: Vec<LinearOutput>,
    /// Whether all steps have the same matrices, but for offsets.
    pub constant: bool,
    /// The steps.
    pub steps: Vec<MatricesStep>,
    /// The covariance of the states at the start.
    pub covariance: Vec<Vec<f64>>,
    /// The covariance of the noise of the sensors.
    pub r: Vec<Vec<f64>>,
    /// What the model does not explain now, as a rate that column of `g` carries on; `null` where the
    /// measurements of the last three days show none.
    pub disturbance: Option<Disturbance>,
}

/// The linear model at the newest measurement of a replay until an instant (in milliseconds), with the inputs
/// standing still for one step.
///
/// # Errors
/// As [`along`]; an input that was never measured before.
pub fn now(
    replay: &Replay,
    fit: &Fit,
    measured: &Window,
    step: Duration,
    until: Option<i64>,
) -> Result<Matrices, Vec<Fault>> {
    let at = newest_of(replay, until)?;
    // A step that is out of range is refused behind.
    let end = at.saturating_add(step.millis().max(1));
    let still = standing_still(replay, measured, at, end)?;
    along(replay, fit, measured, &InputsToCome::given(&still), ForecastAsked { horizon: step, step, until })
}

/// The linear model along the forecast from the newest measurement of a replay.
///
/// # Errors
/// Those of a forecast.
pub fn along(
    replay: &Replay,
    fit: &Fit,
    measured: &Window,
    to_come: &InputsToCome,
    asked: ForecastAsked,
) -> Result<Matrices, Vec<Fault>> {
    let ahead = Onward::new(replay, fit, measured, to_come, asked)?;
    let (model, theta) = (ahead.problem.model(), fit.theta());
    let belief = ahead.belief(&theta);
    let linear = Linearisation::new(model, &ahead.inputs, &theta);
    let Some(steps) =
        linear.steps(ahead.past..ahead.grid.len() - 1, &belief.states, &ahead.noise, ahead.problem.brake())
    else {
        let detail = "the model leaves the numbers on the way: look at the inputs";
        return Err(vec![Fault::new("/inputs", "diverged", detail)]);
    };
    let is_held =
        |entrance: &usize| model.inputs()[linear.entering()[*entrance].input].hold == InputHold::ZeroOrder;
    let (held, moving): (Vec<usize>, Vec<usize>) = (0..linear.entering().len()).partition(is_held);
    let shown = |(index, step): (usize, &LinearStep)| {
        let k = ahead.past + index;
        let at = rfc3339(ahead.grid.time(k));
        shown(&linear, step, at, k as f64, &held, &moving)
    };
    let n = model.states().len();
    let variances = &ahead.noise.measurement;
    Ok(Matrices {
        model: fit.model.clone(),
        at: rfc3339(ahead.grid.time(ahead.past)),
        step: asked.step.to_string(),
        states: states(model),
        held: inputs(&ahead, &linear, &held),
        moving: inputs(&ahead, &linear, &moving),
        outputs: outputs(model),
        constant: steps.iter().all(|step| are_same(step, &steps[0])),
        steps: steps.iter().enumerate().map(shown).collect(),
        covariance: rows(&belief.covariance, n),
        r: (0..variances.len())
            .map(|i| (0..variances.len()).map(|j| if i == j { variances[i] } else { 0.0 }).collect())
            .collect(),
        disturbance: disturbance(&ahead, &theta),
    })
}

fn states(model: &Model) -> Vec<LinearState> {
    let shown =
        |state: &crate::model::State| LinearState { name: state.name.clone(), unit: state.unit.clone() };
    model.states().iter().map(shown).collect()
}

fn outputs(model: &Model) -> Vec<LinearOutput> {
    let shown = |output: &crate::model::Output| LinearOutput {
        channel: output.channel.clone(),
        unit: output.unit.clone(),
    };
    model.outputs().iter().map(shown).collect()
}

fn inputs(ahead: &Onward, linear: &Linearisation, which: &[usize]) -> Vec<LinearInput> {
    let shown = |place: &usize| {
        let entrance = linear.entering()[*place];
        let input = &ahead.problem.model().inputs()[entrance.input];
        // An input of no unit of its own counts as it comes.
        let own = ahead.grid.column(&input.channel).filter(|_| input.unit == AS_IT_COMES);
        let unit = own.map_or(input.unit.as_str(), |column| column.unit()).to_owned();
        LinearInput { channel: input.channel.clone(), unit, delay_h: entrance.delay }
    };
    which.iter().map(shown).collect()
}

/// Whether two steps do the same to small changes.
fn are_same(a: &LinearStep, b: &LinearStep) -> bool {
    (&a.a, &a.b, &a.e, &a.c, &a.d) == (&b.a, &b.b, &b.e, &b.c, &b.d)
}

fn shown(
    linear: &Linearisation,
    step: &LinearStep,
    at: String,
    position: f64,
    held: &[usize],
    moving: &[usize],
) -> MatricesStep {
    let values = |which: &[usize], position: f64| -> Vec<f64> {
        which.iter().map(|place| linear.value(linear.entering()[*place], position)).collect()
    };
    let (n, width) = (step.states.len(), linear.entering().len());
    let outputs = step.output_offset.len();
    // A row without columns is there, and empty.
    let columns = |matrix: &[f64], rows: usize, which: &[usize]| -> Vec<Vec<f64>> {
        (0..rows).map(|row| which.iter().map(|place| matrix[row * width + place]).collect()).collect()
    };
    MatricesStep {
        at,
        states: step.states.clone(),
        held: values(held, position),
        moving: values(moving, position),
        moving_next: values(moving, position + 1.0),
        a: rows(&step.a, n),
        b: columns(&step.b, n, held),
        e: columns(&step.b, n, moving),
        e_next: columns(&step.e, n, moving),
        g: rows(&step.g, n),
        offset: step.offset.clone(),
        q: rows(&step.q, n),
        c: rows(&step.c, n),
        d_held: columns(&step.d, outputs, held),
        d_moving: columns(&step.d, outputs, moving),
        output_offset: step.output_offset.clone(),
    }
}

/// A matrix of so many columns as a list of its rows.
fn rows(matrix: &[f64], columns: usize) -> Vec<Vec<f64>> {
    matrix.chunks(columns.max(1)).map(<[f64]>::to_vec).collect()
}
