//! What is searched: the thesis's functions shifted and rotated, and BBOB's, over the unit cube.

use super::bbob::{Bbob, HALF_WIDTH, Shape, place, rotation};
use lampyris_core::optimise::functions::Function;
use nalgebra::{DMatrix, DVector};

/// A function in one of its sizes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// One of thesis chapter 5.
    Thesis(Function),
    /// One of the suite.
    Bbob(Shape),
}

/// A function in one of its sizes; each seed searches another instance of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Task {
    pub kind: Kind,
    pub dimensions: usize,
}

/// All of them: the six of chapter 5, then BBOB's.
pub fn tasks() -> Vec<Task> {
    let thesis =
        [(Function::Schwefel, [5, 10]), (Function::Rosenbrock, [5, 15]), (Function::Ackley, [5, 15])];
    let thesis = thesis.into_iter().map(|(function, sizes)| (Kind::Thesis(function), sizes));
    let bbob = Shape::ALL.into_iter().map(|shape| (Kind::Bbob(shape), [5, 10]));
    thesis.chain(bbob).flat_map(|(kind, sizes)| sizes.map(|dimensions| Task { kind, dimensions })).collect()
}

impl Task {
    pub fn name(&self) -> String {
        let name = match self.kind {
            Kind::Thesis(Function::Schwefel) => "turned Schwefel".to_owned(),
            Kind::Thesis(Function::Rosenbrock) => "turned Rosenbrock".to_owned(),
            Kind::Thesis(Function::Ackley) => "turned Ackley".to_owned(),
            Kind::Bbob(shape) => format!("f{} {}", shape.number(), shape.name()),
        };
        format!("{name}, {}", self.dimensions)
    }

    /// Whether its axes are not those of the box.
    pub fn rotated(&self) -> bool {
        match self.kind {
            Kind::Thesis(_) => true,
            Kind::Bbob(shape) => shape.rotated(),
        }
    }

    /// An instance of it.
    pub fn instance(&self, number: u64) -> Landscape {
        // More instances than anybody asks for, and none that the suite's generator cannot number.
        let number = (number % 100_000) as i64;
        match self.kind {
            Kind::Thesis(function) => Landscape::Turned(Turned::new(function, self.dimensions, number)),
            Kind::Bbob(shape) => Landscape::Bbob(Bbob::new(shape, self.dimensions, number)),
        }
    }
}

/// An instance of a function.
#[derive(Debug)]
pub enum Landscape {
    Turned(Turned),
    Bbob(Bbob),
}

impl Landscape {
    /// The error at a point of the unit cube: the value above the optimum's.
    pub fn error(&self, unit: &[f64]) -> f64 {
        match self {
            Self::Turned(function) => function.error(unit),
            Self::Bbob(function) => {
                let x: Vec<f64> = unit.iter().map(|unit| (2.0 * unit - 1.0) * HALF_WIDTH).collect();
                function.error(&x)
            }
        }
    }
}

/// A function of the thesis whose optimum has been moved to a random place and whose axes have been turned
/// around it.
#[derive(Debug)]
pub struct Turned {
    function: Function,
    /// Where the optimum is now and where it was, in the unit cube.
    now: DVector<f64>,
    was: f64,
    rotation: DMatrix<f64>,
}

impl Turned {
    fn new(function: Function, dimensions: usize, instance: i64) -> Self {
        // The suite's generator, with numbers that none of its functions has.
        let seed = 900 + 10_000 * instance;
        let was = match function {
            Function::Schwefel => 420.968_746,
            Function::Rosenbrock => 1.0,
            Function::Ackley => 0.0,
        };
        Self {
            function,
            now: place(seed, dimensions).map(|x| (x / HALF_WIDTH + 1.0) / 2.0),
            was: (was / function.half_width() + 1.0) / 2.0,
            rotation: rotation(seed + 1_000_000, dimensions),
        }
    }

    fn error(&self, unit: &[f64]) -> f64 {
        let there = (&self.rotation * (DVector::from_column_slice(unit) - &self.now)).add_scalar(self.was);
        // A turned box has corners outside of the function's own, where Schwefel's function falls for ever:
        // there the value of the edge holds, and what lies beyond it costs.
        let inside: Vec<f64> = there.iter().map(|x| x.clamp(0.0, 1.0)).collect();
        let beyond: f64 = there.iter().zip(&inside).map(|(x, inside)| (x - inside).powi(2)).sum();
        self.function.cost(&inside) + 4.0 * self.function.half_width().powi(2) * beyond
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_optimum_has_moved_and_is_the_lowest_place() {
        for task in tasks() {
            let Landscape::Turned(turned) = task.instance(3) else { continue };
            let at = turned.now.as_slice();
            assert!(turned.error(at).abs() < 1e-6, "{}: {}", task.name(), turned.error(at));
            for i in 0..task.dimensions {
                let mut near = at.to_vec();
                near[i] += 0.01;
                assert!(turned.error(&near) > 1e-3, "{}", task.name());
                assert!(turned.error(&vec![0.0; task.dimensions]) > 1.0);
            }
            assert_ne!(task.instance(4).error(at), turned.error(at));
        }
    }
}
