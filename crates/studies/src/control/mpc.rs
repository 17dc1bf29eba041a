//! The controller: a day ahead in steps of a sample, the cheapest electric powers that keep the room
//! comfortable by the model that it is given.
//!
//! The model is linear in state and power, so the temperatures are too, and what is minimised is convex: the
//! bill plus what discomfort is worth. An accelerated projected gradient with restarts (Beck and Teboulle,
//! SIAM J. Imaging Sci. 2, 2009; O'Donoghue and Candes, Found. Comput. Math. 15, 2015) finds its minimum
//! between the bounds of the power.

use lampyris_core::twin::heated::SAMPLE_HOURS;
use nalgebra::{DMatrix, DVector, RowDVector};

/// What a kelvin-hour outside of the bounds is worth in EUR.
pub const DISCOMFORT: f64 = 0.5;
/// Below so many K outside of the bounds the worth is quadratic, so that it has a gradient everywhere.
const SOFT: f64 = 0.2;
const MOST_ITERATIONS: usize = 600;
/// The search ends where no power moves by more than this, in kW.
const STILL: f64 = 1e-5;
const POWER_ITERATIONS: usize = 30;

/// From one sample to the next: `x' = matrix x + heat * kW + constant`.
#[derive(Debug, Clone)]
pub struct Step {
    pub matrix: DMatrix<f64>,
    pub heat: DVector<f64>,
    pub constant: DVector<f64>,
}

impl Step {
    /// The exact step of `dx/dt = matrix x + heat * kW + constant` over a sample, by one matrix exponential.
    pub fn over_a_sample(matrix: &DMatrix<f64>, heat: &DVector<f64>, constant: &DVector<f64>) -> Self {
        let n = matrix.nrows();
        let mut rates = DMatrix::zeros(n + 2, n + 2);
        rates.view_mut((0, 0), (n, n)).copy_from(matrix);
        rates.view_mut((0, n), (n, 1)).copy_from(heat);
        rates.view_mut((0, n + 1), (n, 1)).copy_from(constant);
        let moved = (rates * SAMPLE_HOURS).exp();
        Self {
            matrix: moved.view((0, 0), (n, n)).into_owned(),
            heat: moved.view((0, n), (n, 1)).column(0).into_owned(),
            constant: moved.view((0, n + 1), (n, 1)).column(0).into_owned(),
        }
    }

    pub fn advance(&self, x: &DVector<f64>, heat: f64) -> DVector<f64> {
        &self.matrix * x + &self.heat * heat + &self.constant
    }
}

/// How the room's temperature follows from the state.
#[derive(Debug, Clone)]
pub struct Output {
    pub row: RowDVector<f64>,
    pub offset: f64,
}

impl Output {
    pub fn of(&self, x: &DVector<f64>) -> f64 {
        (&self.row * x)[0] + self.offset
    }
}

/// What is to be decided.
pub struct Task<'a> {
    pub steps: &'a [Step],
    pub output: &'a Output,
    pub state: &'a DVector<f64>,
    /// Of each step: EUR/kWh, heat per electric energy, and the bounds of the room at its end in degC.
    pub prices: &'a [f64],
    pub cops: &'a [f64],
    pub bounds: &'a [(f64, f64)],
    /// kW of electricity.
    pub largest: f64,
}

/// The temperatures as they follow from the powers: `free + response * powers`.
struct Forecast<'a> {
    task: &'a Task<'a>,
    free: DVector<f64>,
    response: DMatrix<f64>,
}

impl<'a> Forecast<'a> {
    fn new(task: &'a Task<'a>) -> Self {
        let n = task.steps.len();
        let mut free = DVector::zeros(n);
        let mut response = DMatrix::zeros(n, n);
        let mut x = task.state.clone();
        for (j, step) in task.steps.iter().enumerate() {
            x = step.advance(&x, 0.0);
            free[j] = task.output.of(&x);
            let mut moved = &step.heat * task.cops[j];
            response[(j, j)] = (&task.output.row * &moved)[0];
            for later in j + 1..n {
                moved = &task.steps[later].matrix * moved;
                response[(later, j)] = (&task.output.row * &moved)[0];
            }
        }
        Self { task, free, response }
    }

    /// How far the room is below (negative) or above its bounds at the end of each step.
    fn outside(&self, powers: &DVector<f64>) -> DVector<f64> {
        let mut room = &self.free + &self.response * powers;
        for (value, (low, high)) in room.iter_mut().zip(self.task.bounds) {
            *value = (*value - high).max(0.0) + (*value - low).min(0.0);
        }
        room
    }

    fn cost(&self, powers: &DVector<f64>) -> f64 {
        let bill: f64 = powers.iter().zip(self.task.prices).map(|(power, price)| power * price).sum();
        let discomfort: f64 = self.outside(powers).iter().map(|outside| worth(outside.abs())).sum();
        SAMPLE_HOURS * (bill + discomfort)
    }

    fn gradient(&self, powers: &DVector<f64>) -> DVector<f64> {
        let slopes =
            self.outside(powers).map(|outside| SAMPLE_HOURS * DISCOMFORT * (outside / SOFT).clamp(-1.0, 1.0));
        let bill =
            DVector::from_iterator(powers.len(), self.task.prices.iter().map(|price| SAMPLE_HOURS * price));
        bill + self.response.tr_mul(&slopes)
    }

    /// A bound on how fast the gradient changes: the largest singular value by power iteration, which finds
    /// it from below, so some room is added.
    fn steepness(&self) -> f64 {
        let mut direction = DVector::from_element(self.free.len(), 1.0);
        let mut largest = 0.0;
        for _ in 0..POWER_ITERATIONS {
            direction = self.response.tr_mul(&(&self.response * &direction));
            largest = direction.norm();
            if largest <= f64::MIN_POSITIVE {
                return 1.0;
            }
            direction /= largest;
        }
        1.05 * SAMPLE_HOURS * DISCOMFORT / SOFT * largest
    }
}

/// What an excursion is worth: a parabola that goes over into a straight line.
fn worth(outside: f64) -> f64 {
    DISCOMFORT * if outside < SOFT { outside * outside / (2.0 * SOFT) } else { outside - 0.5 * SOFT }
}

/// The electric powers in kW, from a guess such as those of the last decision.
pub fn decide(task: &Task, guess: &DVector<f64>) -> DVector<f64> {
    let forecast = Forecast::new(task);
    let pace = 1.0 / forecast.steepness();
    let inside = |powers: DVector<f64>| powers.map(|power| power.clamp(0.0, task.largest));
    let mut powers = inside(guess.clone());
    let mut ahead = powers.clone();
    let mut momentum: f64 = 1.0;
    for _ in 0..MOST_ITERATIONS {
        let next = inside(&ahead - forecast.gradient(&ahead) * pace);
        let moved = &next - &powers;
        // Momentum that leads uphill is dropped.
        if (&ahead - &next).dot(&moved) > 0.0 {
            momentum = 1.0;
            ahead.copy_from(&next);
        } else {
            let faster = 0.5 * (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt());
            ahead = &next + &moved * ((momentum - 1.0) / faster);
            momentum = faster;
        }
        powers = next;
        if moved.amax() < STILL {
            break;
        }
    }
    // The guess is at least as good only where the search was cut short.
    let guess = inside(guess.clone());
    if forecast.cost(&guess) < forecast.cost(&powers) { guess } else { powers }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A room of one state that loses a tenth of its warmth an hour.
    fn steps(n: usize) -> Vec<Step> {
        let (matrix, heat) = (DMatrix::from_element(1, 1, -0.1), DVector::from_element(1, 0.4));
        vec![Step::over_a_sample(&matrix, &heat, &DVector::from_element(1, 0.1 * 5.0)); n]
    }

    fn plain() -> Output {
        Output { row: RowDVector::from_element(1, 1.0), offset: 0.0 }
    }

    #[test]
    fn a_step_is_the_closed_form() {
        let step = &steps(1)[0];
        let keep = (-0.1 * SAMPLE_HOURS).exp();
        let by_hand = |x: f64, heat: f64| keep * x + (1.0 - keep) * (5.0 + 4.0 * heat);
        for (x, heat) in [(20.0, 0.0), (18.0, 3.0), (5.0, 1.0)] {
            assert!((step.advance(&DVector::from_element(1, x), heat)[0] - by_hand(x, heat)).abs() < 1e-12);
        }
    }

    /// Every combination of powers on a fine grid: none is cheaper, and what is found is no better than the
    /// best by more than the grid is wide.
    #[test]
    fn the_decision_is_the_brute_force_optimum() {
        let (steps, output, state) = (steps(4), plain(), DVector::from_element(1, 20.6));
        let cases = [
            ([0.2, 0.5, 0.1, 0.3], [(20.0, 24.0); 4]),
            ([0.3, 0.3, 0.3, 0.3], [(18.0, 24.0), (18.0, 24.0), (21.5, 24.0), (21.5, 24.0)]),
            ([0.1, 0.1, 0.9, 0.9], [(20.0, 20.5); 4]),
            ([-0.02, 0.2, 0.2, 0.2], [(21.0, 24.0); 4]),
        ];
        for (prices, bounds) in cases {
            let task = Task {
                steps: &steps,
                output: &output,
                state: &state,
                prices: &prices,
                cops: &[3.0, 3.0, 3.5, 3.5],
                bounds: &bounds,
                largest: 2.0,
            };
            let forecast = Forecast::new(&task);
            let found = decide(&task, &DVector::zeros(4));
            assert!(found.iter().all(|power| (0.0..=2.0).contains(power)), "{found}");
            let grid = 30;
            let mut best = f64::INFINITY;
            for code in 0..(grid + 1usize).pow(4) {
                let at =
                    |digit: u32| (code / (grid + 1usize).pow(digit) % (grid + 1)) as f64 * 2.0 / grid as f64;
                best = best.min(forecast.cost(&DVector::from_fn(4, |i, _| at(i as u32))));
            }
            let ours = forecast.cost(&found);
            assert!(ours <= best + 1e-6, "{prices:?} {bounds:?}: {ours} beside {best}");
            assert!(ours > best - 0.05, "{prices:?} {bounds:?}: {ours} is too good beside {best}");
            // From another start the same optimum is found.
            let again = forecast.cost(&decide(&task, &DVector::from_element(4, 2.0)));
            assert!((again - ours).abs() < 1e-5, "{again} {ours}");
        }
    }

    #[test]
    fn cheap_hours_are_used_to_store_heat_and_a_gradient_is_a_difference() {
        let (steps, output, state) = (steps(8), plain(), DVector::from_element(1, 20.2));
        let prices = [0.1, 0.1, 0.1, 0.1, 0.9, 0.9, 0.9, 0.9];
        let task = Task {
            steps: &steps,
            output: &output,
            state: &state,
            prices: &prices,
            cops: &[3.0; 8],
            bounds: &[(20.0, 24.0); 8],
            largest: 3.0,
        };
        let found = decide(&task, &DVector::zeros(8));
        assert!(found.rows(0, 4).sum() > 3.0 * found.rows(4, 4).sum(), "{found}");
        let forecast = Forecast::new(&task);
        let point = DVector::from_fn(8, |i, _| 0.1 + 0.05 * i as f64);
        let gradient = forecast.gradient(&point);
        for i in 0..8 {
            let moved = |by: f64| {
                forecast.cost(&DVector::from_fn(8, |j, _| point[j] + if i == j { by } else { 0.0 }))
            };
            let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            assert!(
                (gradient[i] - difference).abs() < 1e-6 * (1.0 + difference.abs()),
                "{i}: {} {difference}",
                gradient[i]
            );
        }
    }
}
