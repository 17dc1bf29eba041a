//! Delayed inputs: closed forms, shifted columns, lanes beside the scalar meaning, gaps, and the filter.

use super::drive::{Inputs, samples_back};
use super::kalman::{Kalman, Noise};
use super::stepper::ros2;
use super::trajectory::{MeasuredOutput, Simulator};
use crate::data::{Column, Grid, HOUR};
use crate::model::Stepper;
use crate::model::document::ModelDocument;
use crate::model::expr::{Graph, Node, Point};
use crate::model::{Bindings, Catalogue, InputHold, Model, compile};

/// x' = a (u(t - tau) - x).
fn delayed(hold: &str, term: &str) -> Model {
    let text = format!(
        r#"
        id = "delayed"
        title = "first order behind a pipe"
        states.x = {{ unit = "degC", initial = "y" }}
        inputs.u = {{ unit = "degC", hold = "{hold}" }}
        parameters.a = {{ unit = "1/h", lower = 1e-3, upper = 1e3, scale = "log", nominal = 1 }}
        parameters.tau = {{ unit = "h", lower = 0, upper = 6, scale = "linear", nominal = 1 }}
        equations.x = "{term}"
        outputs.y = {{ expr = "x + 0*tau*1[K/h]", unit = "degC", noise_sd = 0.05 }}
    "#
    );
    let mut catalogue = Catalogue::default();
    catalogue.add_model(ModelDocument::from_toml(&text).unwrap());
    compile(&catalogue.compose(&"delayed".parse().unwrap()).unwrap(), &Bindings::default()).unwrap()
}

const PIPE: &str = "a*(delay(u, tau) - x)";

fn run(
    model: &Model,
    column: Vec<f64>,
    hours: f64,
    start: f64,
    stepper: Stepper,
    substeps: usize,
    theta: &[f64],
) -> Vec<f64> {
    let samples = column.len();
    let inputs = Inputs::from_columns(model, vec![column], hours);
    let (values, valid) = (vec![start; samples], vec![true; samples]);
    let simulator = Simulator::new(model, &inputs, &[(&values, &valid)], stepper, substeps);
    simulator.run(&[theta], samples)[0].outputs[0].clone()
}

/// The end of a ramp of one degree per hour that arrives tau hours late, from 20 degrees at the start.
fn ramp_error(stepper: Stepper, substeps: usize, a: f64, tau: f64) -> f64 {
    let ours = run(
        &delayed("linear", PIPE),
        (0..=10).map(f64::from).collect(),
        1.0,
        20.0,
        stepper,
        substeps,
        &[a, tau],
    );
    let at_arrival = 20.0 * (-a * tau).exp();
    let since = 10.0 - tau;
    let exact = since - 1.0 / a + (at_arrival + 1.0 / a) * (-a * since).exp();
    (ours[10] - exact).abs()
}

#[test]
fn a_delayed_ramp_agrees_with_its_closed_form() {
    for tau in [0.0, 0.25, 1.3, 4.0, 5.99] {
        assert!(ramp_error(Stepper::Rk4, 400, 0.7, tau) < 1e-6, "{tau}");
        assert!(
            ramp_error(Stepper::Ros2, 400, 0.7, tau) < 1e-5,
            "{tau}: {}",
            ramp_error(Stepper::Ros2, 400, 0.7, tau)
        );
    }
    let observed = (ramp_error(Stepper::Ros2, 4, 0.7, 2.0) / ramp_error(Stepper::Ros2, 8, 0.7, 2.0)).log2();
    assert!((observed - 2.0).abs() < 0.15, "the order is kept: {observed}");
    assert!(ramp_error(Stepper::Ros2, 1, 500.0, 2.5) < 0.1, "and the stiff candidates stay calm");
}

#[test]
fn a_delay_of_whole_samples_is_a_shifted_column() {
    let column: Vec<f64> = (0..60).map(|k| 10.0 * (f64::from(k) * 0.37).sin()).collect();
    for (hold, hours) in [("linear", 0.5), ("zero_order", 0.5), ("zero_order", 0.1)] {
        for shift in [0, 1, 3, 7] {
            let late = (0..60usize).map(|k| column[k.saturating_sub(shift)]).collect();
            let tau = shift as f64 * hours;
            let ours = run(&delayed(hold, PIPE), column.clone(), hours, 12.0, Stepper::Ros2, 3, &[0.8, tau]);
            let theirs = run(&delayed(hold, "a*(u - x)"), late, hours, 12.0, Stepper::Ros2, 3, &[0.8]);
            for (k, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
                assert!((ours - theirs).abs() < 1e-11, "{hold}, {shift} samples, at {k}: {ours} {theirs}");
            }
        }
    }
}

#[test]
fn a_zero_order_input_between_samples_keeps_its_exact_value() {
    let mut column = vec![0.0; 12];
    column[4] = 8.0;
    let model = delayed("zero_order", "(delay(u, tau) - x)*a");
    let fast = run(&model, column, 1.0, 0.0, Stepper::Ros2, 10, &[1e3, 1.5]);
    // The pulse of hour 4 to 5 stands from half past five to half past six.
    assert!(fast[5].abs() < 1e-6 && (fast[6] - 8.0).abs() < 0.1 && fast[7].abs() < 1e-5, "{fast:?}");
}

#[test]
fn lanes_with_delays_of_their_own_equal_single_runs() {
    for hold in ["linear", "zero_order"] {
        let model = delayed(hold, PIPE);
        let column = (0..50).map(|k| (f64::from(k) * 0.3).sin()).collect();
        let inputs = Inputs::from_columns(&model, vec![column], 0.5);
        let (values, valid) = (vec![20.0; 50], vec![true; 50]);
        let simulator = Simulator::new(&model, &inputs, &[(&values, &valid)], Stepper::Ros2, 3);
        let thetas: Vec<Vec<f64>> =
            (0..37).map(|i| vec![0.01 * 1.3f64.powi(i), 0.17 * f64::from(i)]).collect();
        let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
        let together = simulator.run(&slices, 50);
        for (theta, run) in slices.iter().zip(&together) {
            assert_eq!(simulator.run(&[*theta], 50)[0], *run);
        }
        assert_ne!(together[20], simulator.run(&[&[thetas[20][0], 0.0]], 50)[0], "the delay does something");
    }
}

/// A step of ROS2 evaluated node by node, with the past looked up by hand.
#[test]
fn the_tape_equals_its_graph_bit_for_bit() {
    let model = delayed("linear", PIPE);
    let column: Vec<f64> = (0..30).map(|k| (f64::from(k) * 0.8).sin()).collect();
    let (a, tau, hours) = (0.9, 1.37, 0.5);
    let ours = run(&model, column.clone(), hours, 4.0, Stepper::Ros2, 1, &[a, tau]);
    let mut graph = Graph::default();
    let step = ros2(&mut graph, &model);
    let mut x = 4.0;
    for k in 0..29 {
        let leaf = |node: Node| match node {
            Node::State(_) => x,
            Node::Param(0) => a,
            Node::Param(_) => tau,
            Node::Step => hours,
            Node::Delayed(_, point, _) => {
                let now = if point == Point::End { (k + 1) as f64 } else { k as f64 };
                let position = (now - tau / hours).max(0.0);
                let (before, rest) = (position.floor() as usize, position - position.floor());
                column[before] + (column[before + 1] - column[before]) * rest
            }
            _ => f64::NAN,
        };
        x = graph.evaluate(&step, leaf)[0];
        assert_eq!(x.to_bits(), ours[k + 1].to_bits(), "at {k}");
    }
}

#[test]
fn the_past_must_be_known_as_far_back_as_the_longest_delay() {
    let model = delayed("linear", PIPE);
    let mut valid = vec![true; 40];
    valid[20] = false;
    let column = Column::new("degC", crate::data::Hold::Linear, vec![1.0; 40], valid).unwrap();
    let grid = Grid::new(0, HOUR, 40).unwrap().with_column("u", column).unwrap();
    let inputs = Inputs::new(&model, &grid).unwrap();
    // Six hours at the start, and six behind the two intervals that touch the missing sample.
    let unknown: Vec<usize> = (0..39).filter(|k| !inputs.known(*k)).collect();
    assert_eq!(unknown, (0..6).chain(19..27).collect::<Vec<_>>());
    let (values, valid) = ((0..40).map(f64::from).collect::<Vec<_>>(), vec![true; 40]);
    let simulator = Simulator::new(&model, &inputs, &[(&values, &valid)], Stepper::Ros2, 6);
    let y = simulator.run(&[&[0.5, 2.0]], 40)[0].outputs[0].clone();
    assert_eq!(
        (y[5], y[6], y[27]),
        (1.0, 7.0, 28.0),
        "it stands still there and starts again from the measurement"
    );
    assert!(!simulator.predicted(6) && simulator.predicted(7));
    assert_eq!((samples_back(6.0, 0.1), samples_back(0.0, 0.1), samples_back(0.05, 0.1)), (60, 0, 1));
}

#[test]
fn the_filter_and_its_forecasts_follow_delayed_inputs() {
    let model = delayed("linear", PIPE);
    let column: Vec<f64> = (0..80).map(|k| 20.0 + 5.0 * (f64::from(k) * 0.4).sin()).collect();
    let inputs = Inputs::from_columns(&model, vec![column.clone()], 0.5);
    let theta = [0.6, 2.3];
    let truth = run(&model, column, 0.5, 15.0, Stepper::Ros2, 3, &theta);
    let valid = vec![true; 80];
    let measured: [MeasuredOutput; 1] = [(&truth, &valid)];
    let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Ros2, 3);
    let kalman = Kalman::new(&model, &simulator, &measured);
    let found = kalman.filter(
        &theta,
        &Noise { process: vec![0.1; model.states().len()], measurement: vec![1e-4] },
        80,
    );
    // The filter starts from the mean of three samples; its error has gone after a day.
    let origins: Vec<usize> = (48..60).collect();
    for (origin, forecast) in origins.iter().zip(kalman.forecasts(&theta, &found, &origins, 20)) {
        for (lead, value) in forecast.iter().enumerate() {
            assert!((value.unwrap() - truth[origin + lead]).abs() < 1e-6, "{origin} {lead}");
        }
    }
    assert_eq!(model.inputs()[0].hold, InputHold::Linear);
    assert_eq!((model.delays()[0].parameter, model.longest_delay(0)), (Some(1), 6.0));
}
