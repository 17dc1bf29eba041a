//! The matrices of a step beside matrix exponentials and differences of simulations.

use super::drive::Inputs;
use super::kalman::Noise;
use super::linearise::{LinearStep, Linearisation, StepStart};
use super::trajectory::Simulator;
use crate::interrupt::Brake;
use crate::model::document::ModelDocument;
use crate::model::{Bindings, Catalogue, Model, Stepper, compile};
use nalgebra::{DMatrix, DVector};

fn model(text: &str) -> Model {
    let document = ModelDocument::from_toml(text).unwrap();
    let id = document.id().parse().unwrap();
    let mut catalogue = Catalogue::default();
    catalogue.add_model(document);
    compile(&catalogue.compose(&id).unwrap(), &Bindings::default()).unwrap()
}

/// An interior and an envelope, as in CTSM's `tite`: heated in steps, the outdoor temperature in straight
/// lines.
const TITE: &str = r#"
    id = "house"
    title = "interior and envelope"
    [states]
    T_i = { unit = "degC", initial = "y" }
    T_e = { unit = "degC", initial = "15" }
    [inputs]
    T_a = { unit = "degC" }
    P = { unit = "-", hold = "zero_order" }
    [parameters]
    k_ie = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    k_ei = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    k_ea = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    g = { unit = "K/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    [equations]
    T_i = "k_ie*(T_e - T_i) + g*P"
    T_e = "k_ei*(T_i - T_e) + k_ea*(T_a - T_e)"
    [outputs]
    y = { expr = "T_i", unit = "degC", noise_sd = 0.05 }
"#;

fn quiet(n: usize) -> Noise {
    Noise { process: vec![0.3; n], measurement: vec![0.01] }
}

#[test]
fn a_linear_model_has_the_matrices_of_the_exponential() {
    let model = model(TITE);
    let theta = [0.8, 0.25, 0.06, 1.7];
    let hours = 0.25;
    let inputs = Inputs::from_columns(&model, vec![vec![3.0, 5.0, 4.0], vec![2.0, 0.5, 0.5]], hours);
    let linear = Linearisation::new(&model, &inputs, &theta);
    let steps = linear.steps(0..2, &[20.0, 15.0], &quiet(2), &Brake::NONE).unwrap();
    assert_eq!(steps.len(), 2);
    // The exponential of the system with its inputs as further states: T_a, its slope, and P (Van Loan 1978,
    // IEEE Trans. Automat. Contr. 23, 395-404).
    let [k_ie, k_ei, k_ea, g] = theta;
    #[rustfmt::skip]
    let system = DMatrix::from_row_slice(5, 5, &[
        -k_ie, k_ie, 0.0, 0.0, g,
        k_ei, -k_ei - k_ea, k_ea, 0.0, 0.0,
        0.0, 0.0, 0.0, 1.0, 0.0,
        0.0, 0.0, 0.0, 0.0, 0.0,
        0.0, 0.0, 0.0, 0.0, 0.0,
    ]) * hours;
    let whole = system.exp();
    let near = |ours: f64, exact: f64| assert!((ours - exact).abs() < 1e-12, "{ours} {exact}");
    for step in &steps {
        for i in 0..2 {
            (0..2).for_each(|j| near(step.a[i * 2 + j], whole[(i, j)]));
            // The slope is the difference of both ends by the hours.
            near(step.e[i * 2], whole[(i, 3)] / hours);
            near(step.b[i * 2], whole[(i, 2)] - whole[(i, 3)] / hours);
            near(step.b[i * 2 + 1], whole[(i, 4)]);
            near(step.e[i * 2 + 1], 0.0);
            // A steady rate of the interior does what the heater does, whose gain is g.
            near(step.g[i * 2], whole[(i, 4)] / g);
            near(step.offset[i], 0.0);
        }
        assert_eq!((step.c.as_slice(), step.d.as_slice()), ([1.0, 0.0].as_slice(), [0.0, 0.0].as_slice()));
        near(step.output_offset[0], 0.0);
    }
    // By the states alone, what enters is in the offset.
    let by_states = Linearisation::of_states(&model, &inputs, &theta);
    let alone = by_states.steps(0..2, &[20.0, 15.0], &quiet(2), &Brake::NONE).unwrap();
    for (step, alone) in steps.iter().zip(&alone) {
        assert!(alone.b.is_empty() && alone.e.is_empty());
        assert_eq!((&alone.a, &alone.q, &alone.next), (&step.a, &step.q, &step.next));
        let k = usize::from(!std::ptr::eq(step, &steps[0]));
        for i in 0..2 {
            let now = [inputs.at(0, k), inputs.at(1, k)];
            let then = [inputs.at(0, k + 1), inputs.at(1, k + 1)];
            let entered: f64 = (0..2).map(|j| step.b[i * 2 + j] * now[j] + step.e[i * 2 + j] * then[j]).sum();
            near(alone.offset[i], entered);
        }
    }
    // The covariance by the exponential of the doubled system (Van Loan, the same paper).
    let a = system.view((0, 0), (2, 2)).into_owned();
    let mut doubled = DMatrix::zeros(4, 4);
    doubled.view_mut((0, 0), (2, 2)).copy_from(&-a.clone());
    doubled.view_mut((0, 2), (2, 2)).copy_from(&(DMatrix::identity(2, 2) * 0.09 * hours));
    doubled.view_mut((2, 2), (2, 2)).copy_from(&a.transpose());
    let parts = doubled.exp();
    let q = parts.view((2, 2), (2, 2)).transpose() * parts.view((0, 2), (2, 2));
    (0..4).for_each(|place| near(steps[0].q[place], q[(place / 2, place % 2)]));
}

/// Much that is not linear: a product of an input and a state, a wind through a root, a delayed supply, a
/// saturating exchange, and an output that is not a state.
const CURVED: &str = r#"
    id = "curved"
    title = "curved"
    [states]
    x = { unit = "degC", initial = "y" }
    z = { unit = "degC", initial = "18" }
    [inputs]
    T_out = { unit = "degC" }
    wind = { unit = "m/s", min = 0 }
    valve = { unit = "-", hold = "zero_order" }
    supply = { unit = "degC" }
    [parameters]
    a = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    b = { unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }
    lag = { unit = "h", lower = 0.1, upper = 2, scale = "linear", nominal = 1 }
    [equations]
    x = "a*(T_out - x)*sqrt(1 + wind/1[m/s]) + b*valve*(delay(supply, lag) - x) + a*(z - x)"
    z = "a*5[K]*tanh((x - z)/5[K])"
    [outputs]
    y = { expr = "x + 0.1*(z - x)*valve", unit = "degC", noise_sd = 0.05 }
"#;

/// States and output after one step by the simulation itself, in very short steps.
fn simulated(model: &Model, theta: &[f64], columns: &[Vec<f64>], states: [f64; 2], hours: f64) -> [f64; 3] {
    // Both states start at a measurement or at a value, so a model with these numbers is simulated.
    let inputs = Inputs::from_columns(model, columns.to_vec(), hours);
    let samples = inputs.samples();
    let measured = vec![states[0]; samples];
    let simulator = Simulator::new(model, &inputs, &[(&measured, &vec![true; samples])], Stepper::Rk4, 4000);
    let run = simulator.run_with_states(theta);
    [run.states[0][samples - 1], run.states[1][samples - 1], run.outputs[0][samples - 1]]
}

#[test]
fn a_curved_model_has_the_slopes_of_its_simulation() {
    let theta = [0.4, 0.9, 0.5];
    let hours = 0.5;
    let columns = vec![vec![2.0, 3.5, 3.0], vec![4.0, 7.0, 5.0], vec![0.3, 0.6, 0.6], vec![40.0, 45.0, 38.0]];
    let at = |start: f64| model(&CURVED.replace("initial = \"18\"", &format!("initial = \"{start}\"")));
    let states = [20.0, 18.0];
    let curved = at(states[1]);
    let inputs = Inputs::from_columns(&curved, columns.clone(), hours);
    let linear = Linearisation::new(&curved, &inputs, &theta);
    let step = linear.steps(0..2, &states, &quiet(2), &Brake::NONE).unwrap().remove(0);
    let names: Vec<(&str, f64)> = linear
        .entering()
        .iter()
        .map(|entrance| (curved.inputs()[entrance.input].name.as_str(), entrance.delay))
        .collect();
    assert_eq!(names, [("T_out", 0.0), ("wind", 0.0), ("valve", 0.0), ("supply", 0.5)]);
    let cut = |columns: &[Vec<f64>]| -> Vec<Vec<f64>> {
        columns.iter().map(|column| column[..2].to_vec()).collect()
    };
    let run = |columns: &[Vec<f64>], states: [f64; 2]| {
        simulated(&at(states[1]), &theta, &cut(columns), states, hours)
    };
    let found = run(&columns, states);
    (0..2).for_each(|i| assert!((step.next[i] - found[i]).abs() < 1e-8, "{:?} {found:?}", step.next));
    let slope = |moved: &dyn Fn(f64) -> [f64; 3], by: f64| -> Vec<f64> {
        let (up, down) = (moved(by), moved(-by));
        up.iter().zip(down).map(|(up, down)| (up - down) / (2.0 * by)).collect()
    };
    let near = |ours: f64, theirs: f64, what: &str| {
        assert!((ours - theirs).abs() <= 1e-6, "{what}: {ours} {theirs}");
    };
    for j in 0..2 {
        let found = slope(
            &|by| {
                let mut states = states;
                states[j] += by;
                run(&columns, states)
            },
            1e-3,
        );
        (0..2).for_each(|i| near(step.a[i * 2 + j], found[i], &format!("state {i} by state {j}")));
    }
    for (column, end, what) in
        [(0, 0, "T_out"), (0, 1, "T_out"), (1, 0, "wind"), (1, 1, "wind"), (2, 0, "valve")]
    {
        let found = slope(
            &|by| {
                let mut columns = columns.clone();
                columns[column][end] += by;
                run(&columns, states)
            },
            1e-3,
        );
        let ours = if end == 0 { &step.b } else { &step.e };
        (0..2)
            .for_each(|i| near(ours[i * 4 + column], found[i], &format!("state {i} by {what} at end {end}")));
    }
    // The output at the start, by its closed form.
    let valve = columns[2][0];
    near(step.c[0], 1.0 - 0.1 * valve, "output by x");
    near(step.c[1], 0.1 * valve, "output by z");
    near(step.d[2], 0.1 * (states[1] - states[0]), "output by valve");
    // The whole step once more by its matrices: nothing is left over at the point itself.
    let again = |step: &LinearStep| {
        let (a, b, e) = (
            DMatrix::from_row_slice(2, 2, &step.a),
            DMatrix::from_row_slice(2, 4, &step.b),
            DMatrix::from_row_slice(2, 4, &step.e),
        );
        let value = |position: f64| {
            DVector::from_iterator(
                4,
                linear.entering().iter().map(|entrance| linear.value(*entrance, position)),
            )
        };
        a * DVector::from_row_slice(&states)
            + b * value(0.0)
            + e * value(1.0)
            + DVector::from_row_slice(&step.offset)
    };
    (0..2).for_each(|i| assert!((again(&step)[i] - step.next[i]).abs() < 1e-9));
}

#[test]
fn a_rate_on_top_moves_the_end_by_what_the_matrix_of_rates_says() {
    let model = model(TITE);
    let theta = [0.8, 0.25, 0.06, 1.7];
    let inputs = Inputs::from_columns(&model, vec![vec![3.0, 5.0], vec![2.0, 0.5]], 0.25);
    let linear = Linearisation::new(&model, &inputs, &theta);
    let from = |on_top: &[f64]| {
        let start = StepStart { sample: 0, states: vec![20.0, 15.0], on_top: on_top.to_vec() };
        linear.steps_along(&[start], &quiet(2), &Brake::NONE).unwrap().remove(0)
    };
    let (without, with) = (from(&[]), from(&[1.3, -0.4]));
    for i in 0..2 {
        let moved = with.next[i] - without.next[i];
        let told = with.g[i * 2] * 1.3 - with.g[i * 2 + 1] * 0.4;
        assert!(moved.abs() > 0.05 && (moved - told).abs() < 1e-12, "{moved} {told}");
        assert!((with.offset[i] - without.offset[i]).abs() < 1e-12);
    }
}
