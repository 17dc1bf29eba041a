//! The likelihood of a record for eight guesses side by side: the search for the likeliest comes here a dozen
//! times a record. What is summed up over an hour plays no part in it.

use super::record::LinearRecord;
use crate::cpu::{Cpu, Kernel, dispatch};
use crate::model::math;
use crate::simulate::lane::Lane;

/// What the filter is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::diagnose) struct Guess {
    /// Deviation of the sensors in their scale.
    pub sensor: f64,
    /// Deviation of the missing rate over all time, in the state's unit per hour.
    pub size: f64,
    /// How long it remembers, in hours.
    pub memory: f64,
}

/// What is sought beside the states: what comes and goes of the rate, and what is always there of it.
const BESIDE_STATES: usize = 2;
/// Guesses side by side.
pub(super) const WIDTH: usize = 8;

/// A record by the numbers that a filter needs, sample by sample.
pub(super) struct GuessedRecord {
    states: usize,
    hours: f64,
    mean: Vec<f64>,
    /// How free each of them is at the start, but for what comes and goes.
    free: Vec<f64>,
    /// How many values each sample has, and for each value what the states show in it, what is shown without
    /// them, what was measured, and the unit of its noise.
    counts: Vec<usize>,
    readings: Vec<f64>,
    /// Of each step, by rows: what becomes of the states, of either rate in them, what comes on top, and the
    /// covariance that it adds.
    steps: Vec<f64>,
}

impl GuessedRecord {
    pub fn new(record: &LinearRecord) -> Self {
        let states = record.rate();
        let width = states + BESIDE_STATES;
        let (mean, covariance) = record.begin(0.0);
        let mut readings = Vec::new();
        for reading in record.readings.iter().flatten() {
            readings.extend(reading.row.iter().take(states));
            readings.extend([reading.constant, reading.value, reading.scale]);
        }
        let mut steps = Vec::with_capacity(record.steps.len() * states * (2 * states + 2));
        for step in &record.steps {
            for i in 0..states {
                steps.extend((0..states).map(|j| step.matrix[(i, j)]));
                steps.extend([step.matrix[(i, states)], step.constant[i]]);
                steps.extend((0..states).map(|j| step.covariance[(i, j)]));
            }
        }
        Self {
            states,
            hours: record.hours,
            mean: mean.iter().take(width).copied().collect(),
            free: (0..width).map(|i| covariance[(i, i)]).collect(),
            counts: record.readings.iter().map(Vec::len).collect(),
            readings,
            steps,
        }
    }

    /// The logarithm of the likelihood with each guess, without its constant.
    pub fn likelihoods(&self, guesses: &[Guess; WIDTH]) -> [f64; WIDTH] {
        let found = dispatch(Cpu::detect(), Pass { of: self, guesses });
        found.map(|likelihood| if likelihood.is_finite() { likelihood } else { f64::NEG_INFINITY })
    }
}

struct Pass<'a> {
    of: &'a GuessedRecord,
    guesses: &'a [Guess; WIDTH],
}

impl Kernel for Pass<'_> {
    type Output = [f64; WIDTH];

    #[inline(always)]
    fn run(self) -> Self::Output {
        // Compiled for the few states of most models: loops whose length is known are no loops.
        match self.of.states {
            1 => self.of_states(1),
            2 => self.of_states(2),
            3 => self.of_states(3),
            4 => self.of_states(4),
            n => self.of_states(n),
        }
    }
}

impl Pass<'_> {
    /// The likelihoods for a model of `n` states.
    #[inline(always)]
    fn of_states(self, n: usize) -> [f64; WIDTH] {
        let GuessedRecord { hours, mean, free, counts, readings, steps, .. } = self.of;
        let width = n + BESIDE_STATES;
        let zero = Lane([0.0; WIDTH]);
        let (mut fades, mut comes, mut sensor) = (zero, zero, zero);
        let (mut x, mut next, mut spread) = (vec![zero; width], vec![zero; width], vec![zero; width]);
        let (mut p, mut half) = (vec![zero; width * width], vec![zero; width * width]);
        for i in 0..width {
            x[i] = Lane([mean[i]; WIDTH]);
            p[i * width + i] = Lane([free[i]; WIDTH]);
        }
        for lane in 0..WIDTH {
            let guess = self.guesses[lane];
            fades.0[lane] = (-hours / guess.memory).exp();
            sensor.0[lane] = guess.sensor;
            p[n * width + n].0[lane] = guess.size * guess.size;
            comes.0[lane] = guess.size * guess.size * (1.0 - fades.0[lane] * fades.0[lane]);
        }
        let mut likelihood = [0.0; WIDTH];
        let (mut value, mut step) = (0, 0);
        for count in counts {
            for _ in 0..*count {
                let row = &readings[value..value + n + 3];
                value += n + 3;
                let (mut shown, mut variance) = ([row[n]; WIDTH], [0.0; WIDTH]);
                for lane in 0..WIDTH {
                    let noise = sensor.0[lane] * row[n + 2];
                    variance[lane] = noise * noise;
                }
                for i in 0..width {
                    let mut sum = [0.0; WIDTH];
                    for j in 0..n {
                        for lane in 0..WIDTH {
                            sum[lane] += p[i * width + j].0[lane] * row[j];
                        }
                    }
                    spread[i] = Lane(sum);
                }
                for i in 0..n {
                    for lane in 0..WIDTH {
                        shown[lane] += row[i] * x[i].0[lane];
                        variance[lane] += row[i] * spread[i].0[lane];
                    }
                }
                let mut along = [0.0; WIDTH];
                for lane in 0..WIDTH {
                    let innovation = row[n + 1] - shown[lane];
                    along[lane] = innovation / variance[lane];
                    likelihood[lane] -= 0.5 * (innovation * along[lane] + math::log(variance[lane]));
                }
                for i in 0..width {
                    let mut gain = [0.0; WIDTH];
                    for lane in 0..WIDTH {
                        x[i].0[lane] += spread[i].0[lane] * along[lane];
                        gain[lane] = spread[i].0[lane] / variance[lane];
                    }
                    for j in 0..=i {
                        let mut less = p[i * width + j];
                        for lane in 0..WIDTH {
                            less.0[lane] -= gain[lane] * spread[j].0[lane];
                        }
                        (p[i * width + j], p[j * width + i]) = (less, less);
                    }
                }
            }
            let stride = n * (2 * n + 2);
            if step + stride > steps.len() {
                continue;
            }
            let numbers = &steps[step..step + stride];
            step += stride;
            // The states: what becomes of them, of both rates in them, and what comes on top.
            for i in 0..n {
                let row = &numbers[i * (2 * n + 2)..(i + 1) * (2 * n + 2)];
                let mut sum = [row[n + 1]; WIDTH];
                for lane in 0..WIDTH {
                    sum[lane] += row[n] * (x[n].0[lane] + x[n + 1].0[lane]);
                }
                for j in 0..n {
                    for lane in 0..WIDTH {
                        sum[lane] += row[j] * x[j].0[lane];
                    }
                }
                next[i] = Lane(sum);
                for j in 0..width {
                    let mut sum = [0.0; WIDTH];
                    for lane in 0..WIDTH {
                        sum[lane] = row[n] * (p[n * width + j].0[lane] + p[(n + 1) * width + j].0[lane]);
                    }
                    for k in 0..n {
                        for lane in 0..WIDTH {
                            sum[lane] += row[k] * p[k * width + j].0[lane];
                        }
                    }
                    half[i * width + j] = Lane(sum);
                }
            }
            // What comes and goes fades, and what is always there stays.
            for j in 0..width {
                let mut fading = p[n * width + j];
                for lane in 0..WIDTH {
                    fading.0[lane] *= fades.0[lane];
                }
                half[n * width + j] = fading;
                half[(n + 1) * width + j] = p[(n + 1) * width + j];
            }
            x[..n].copy_from_slice(&next[..n]);
            for lane in 0..WIDTH {
                x[n].0[lane] *= fades.0[lane];
            }
            for i in 0..width {
                for j in 0..n.min(i + 1) {
                    let row = &numbers[j * (2 * n + 2)..(j + 1) * (2 * n + 2)];
                    let added = if i < n { numbers[i * (2 * n + 2) + n + 2 + j] } else { 0.0 };
                    let mut sum = [added; WIDTH];
                    for lane in 0..WIDTH {
                        sum[lane] += row[n] * (half[i * width + n].0[lane] + half[i * width + n + 1].0[lane]);
                    }
                    for k in 0..n {
                        for lane in 0..WIDTH {
                            sum[lane] += row[k] * half[i * width + k].0[lane];
                        }
                    }
                    (p[i * width + j], p[j * width + i]) = (Lane(sum), Lane(sum));
                }
            }
            let (mut rate, mut beside) = (half[n * width + n], half[(n + 1) * width + n]);
            for lane in 0..WIDTH {
                rate.0[lane] = rate.0[lane] * fades.0[lane] + comes.0[lane];
                beside.0[lane] *= fades.0[lane];
            }
            p[n * width + n] = rate;
            (p[(n + 1) * width + n], p[n * width + n + 1]) = (beside, beside);
        }
        likelihood
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{ColumnBindings, Window};
    use crate::diagnose::missing_heat::record::MissingHeatAsked;
    use crate::diagnose::missing_heat::smoother::passed;
    use crate::estimate::{EstimateRequest, Site, prepare};
    use crate::model::Catalogue;
    use crate::twin;

    #[test]
    fn eight_side_by_side_are_each_alone() {
        let twin = twin::room(71, 1, 6, 30).unwrap();
        let (window, _) = Window::parse_csv(&twin.csv, &ColumnBindings::none()).unwrap();
        let site =
            Site { sets: [("neighbours".to_owned(), twin.neighbours.clone())].into(), ..Site::default() };
        let (catalogue, asked) = (Catalogue::builtin().unwrap(), EstimateRequest::default());
        let problem = prepare(&catalogue, &"room3".parse().unwrap(), &asked, &window, &site).unwrap();
        let theta = problem.nominal().to_vec();
        let along = problem.simulate(&theta).states;
        let along: Vec<Vec<f64>> =
            (0..problem.grid().len()).map(|k| along.iter().map(|series| series[k]).collect()).collect();
        let asked = MissingHeatAsked { problem: &problem, theta: &theta, output: 0, state: 0 };
        let record = LinearRecord::new(&asked, &along, &[]).unwrap();
        let guesses: [Guess; WIDTH] = std::array::from_fn(|lane| Guess {
            sensor: 0.5 + 0.3 * lane as f64,
            size: 0.02 * 1.8f64.powi(lane as i32),
            memory: 20.0 / (1.0 + lane as f64),
        });
        let together = GuessedRecord::new(&record).likelihoods(&guesses);
        for (one, guess) in together.iter().zip(guesses) {
            let (_, alone) = passed(&record, guess);
            assert!((one - alone).abs() < 1e-8 * alone.abs(), "{guess:?}: {one} {alone}");
        }
    }
}
