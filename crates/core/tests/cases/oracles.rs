//! The room of the thesis against a fine fourth-order solver, and the tape against the graph it came from.

use super::{problem, request};
use lampyris_core::estimate::Site;
use lampyris_core::model::expr::{Graph, Node, Point};
use lampyris_core::simulate::{Simulator, Stepper};
use lampyris_core::twin;

#[test]
fn room3_agrees_with_a_fine_fourth_order_solver() {
    for seed in [301, 302, 303] {
        let twin = twin::room(seed, 4, 7, 10).unwrap();
        let site =
            Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
        let problem = problem(&twin.csv, "room3", &[], &site, &request("P7D", "P0D", "P0D", 1));
        let measured = problem.measured();
        let samples = problem.grid().len();
        let fine = Simulator::new(problem.model(), problem.inputs(), &measured, Stepper::Rk4, 200)
            .run(&[&twin.theta], samples);
        let finer = Simulator::new(problem.model(), problem.inputs(), &measured, Stepper::Rk4, 400)
            .run(&[&twin.theta], samples);
        let ours = problem.simulate(&twin.theta);
        let worst = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let reference = worst(&fine[0].outputs[0], &finer[0].outputs[0]);
        let error = worst(&ours.outputs[0], &finer[0].outputs[0]);
        println!("room3, seed {seed}: error {error:.5} K, reference good to {reference:.1e} K");
        assert!(reference < 1e-9 && error <= 0.01, "{error} {reference}");
    }
}

/// A step of ROS2 evaluated node by node must equal the staged, paired tape bit for bit.
#[test]
fn the_tape_of_a_step_equals_its_graph_bit_for_bit() {
    let twin = twin::room(310, 2, 2, 10).unwrap();
    let site = Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
    let problem = problem(&twin.csv, "room3", &[], &site, &request("P2D", "P0D", "P0D", 1));
    let model = problem.model();
    let mut graph = Graph::default();
    let step = lampyris_core::simulate::stepper::ros2(&mut graph, model);
    let measured = problem.measured();
    let ours = problem.simulate(&twin.theta);
    let grid = |channel: &str, k: usize| problem.grid().column(channel).unwrap().values()[k];
    let hours = problem.grid().step_hours();
    let first = measured[0].0[..3].iter().sum::<f64>() / 3.0;
    let by_name = |name: &str| {
        twin.theta[model.parameters().iter().position(|parameter| parameter.name == name).unwrap()]
    };
    let mut x = vec![first, by_name("T_h0"), by_name("T_e0")];
    for k in 0..problem.grid().len() - 1 {
        let leaf = |node: Node| match node {
            Node::State(i) => x[usize::from(i)],
            Node::Param(i) => twin.theta[usize::from(i)],
            Node::Step => hours,
            Node::Slope(i) => {
                let channel = &model.inputs()[usize::from(i)].channel;
                (grid(channel, k + 1) - grid(channel, k)) / hours
            }
            Node::Input(i, point) => {
                let channel = &model.inputs()[usize::from(i)].channel;
                let fraction = match point {
                    Point::Start => 0.0,
                    Point::Middle => 0.5,
                    Point::End => 1.0,
                };
                grid(channel, k) + (grid(channel, k + 1) - grid(channel, k)) * fraction
            }
            _ => f64::NAN,
        };
        let next = graph.evaluate(&step, leaf);
        for (state, value) in next.iter().enumerate() {
            assert_eq!(value.to_bits(), ours.states[state][k + 1].to_bits(), "state {state} at {k}");
        }
        x = next;
    }
}
