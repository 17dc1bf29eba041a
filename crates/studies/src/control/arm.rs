//! One controller in one house: a day of decisions, what they cost, and how well the day was foreseen.

use super::grey::{Grey, Observer};
use super::mpc::{self, Output, Step, Task};
use lampyris::cli::Failure;
use lampyris_core::data::rfc3339;
use lampyris_core::twin::heated::{self, HeatedRoom, LARGEST_POWER, SAMPLE_HOURS, SAMPLES_PER_DAY};
use nalgebra::{DMatrix, DVector, RowDVector};
use serde::Serialize;
use std::fmt::Write;

/// Days of its own log over which a controller finds the states of new parameters.
const CATCH_UP_DAYS: usize = 3;

/// Samples that a controller looks ahead: a day.
const HORIZON: usize = SAMPLES_PER_DAY;

/// The bounds of comfort at a local time, in degC: the house is set back at night.
pub fn comfort(hour: f64) -> (f64, f64) {
    (if (6.0..22.0).contains(&hour) { 21.0 } else { 18.5 }, 24.0)
}

/// Where a controller has its parameters from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The model's nominal values, for ever.
    Nominal,
    /// Fitted before the first day.
    Once,
    Weekly,
    Nightly,
    /// Nightly, and what a diagnosis names is added.
    Found,
    /// The truth itself: its equations, its parameters as they are, its states.
    Perfect,
}

impl Kind {
    pub const ALL: [Kind; 6] =
        [Kind::Nominal, Kind::Once, Kind::Weekly, Kind::Nightly, Kind::Found, Kind::Perfect];

    pub fn title(self) -> &'static str {
        match self {
            Kind::Nominal => "nominal values",
            Kind::Once => "fitted once",
            Kind::Weekly => "fitted weekly",
            Kind::Nightly => "fitted nightly",
            Kind::Found => "nightly, effect added",
            Kind::Perfect => "perfect knowledge",
        }
    }

    pub fn id(self) -> &'static str {
        match self {
            Kind::Nominal => "nominal",
            Kind::Once => "once",
            Kind::Weekly => "weekly",
            Kind::Nightly => "nightly",
            Kind::Found => "found",
            Kind::Perfect => "perfect",
        }
    }

    /// Whether the night before this day re-estimates, counted from the first day under control.
    pub fn is_due(self, day: usize) -> bool {
        match self {
            Kind::Nominal | Kind::Perfect => false,
            Kind::Once => day == 0,
            Kind::Weekly => day.is_multiple_of(7),
            Kind::Nightly | Kind::Found => true,
        }
    }
}

/// What a stretch of time came to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Measures {
    /// EUR.
    pub bill: f64,
    /// Kelvin-hours below and above the bounds.
    pub cold: f64,
    pub warm: f64,
    /// Of the forecasts a day ahead: sum of squares in K2, and how many.
    pub squares: f64,
    pub forecasts: f64,
}

impl Measures {
    pub fn discomfort(&self) -> f64 {
        self.cold + self.warm
    }

    /// The bill and what discomfort is worth, in EUR: what the controller minimises.
    pub fn total(&self) -> f64 {
        self.bill + mpc::DISCOMFORT * self.discomfort()
    }

    /// In K.
    pub fn rmse(&self) -> f64 {
        (self.squares / self.forecasts.max(1.0)).sqrt()
    }

    pub fn sum<'a>(parts: impl IntoIterator<Item = &'a Measures>) -> Measures {
        parts.into_iter().fold(Measures::default(), |sum, part| Measures {
            bill: sum.bill + part.bill,
            cold: sum.cold + part.cold,
            warm: sum.warm + part.warm,
            squares: sum.squares + part.squares,
            forecasts: sum.forecasts + part.forecasts,
        })
    }
}

/// What the controller believes in.
#[derive(Debug)]
pub enum Belief {
    Grey(Box<Grey>),
    Truth,
}

impl Belief {
    fn states(&self) -> usize {
        match self {
            Belief::Grey(grey) => grey.states(),
            Belief::Truth => heated::MASSES,
        }
    }

    fn step(&self, room: &HeatedRoom, sample: usize, about: &DVector<f64>) -> Step {
        match self {
            Belief::Grey(grey) => grey.step(room, sample, about),
            Belief::Truth => {
                let linear = room.linear(sample);
                let matrix = DMatrix::from_fn(heated::MASSES, heated::MASSES, |i, j| linear.matrix[i][j]);
                Step::over_a_sample(
                    &matrix,
                    &DVector::from_row_slice(&linear.heat),
                    &DVector::from_row_slice(&linear.constant),
                )
            }
        }
    }

    fn output(&self, about: &DVector<f64>) -> Output {
        match self {
            Belief::Grey(grey) => grey.output(about),
            Belief::Truth => {
                Output { row: RowDVector::from_fn(heated::MASSES, |_, i| f64::from(i == 0)), offset: 0.0 }
            }
        }
    }
}

/// A controller, its room, and what both have been through.
#[derive(Debug)]
pub struct Arm {
    pub kind: Kind,
    belief: Belief,
    observer: Observer,
    state: heated::MassTemperatures,
    plan: DVector<f64>,
    /// Measured temperature, heat, and the true one, per sample from the first on.
    log: Vec<(f64, f64)>,
    /// One for every day under control.
    pub days: Vec<Measures>,
}

impl Arm {
    /// A room that a thermostat has kept until now, under a controller that believes in something.
    pub fn new(kind: Kind, before: &Before, belief: Belief) -> Self {
        let (plan, observer) = (DVector::zeros(HORIZON), Observer::new(belief.states()));
        Self { kind, belief, observer, state: before.state, plan, log: before.log.clone(), days: Vec::new() }
    }

    /// From here on it believes in this, and has looked for the states in what was measured lately.
    pub fn believe(&mut self, room: &HeatedRoom, grey: Grey) {
        self.belief = Belief::Grey(Box::new(grey));
        self.observer = Observer::new(self.belief.states());
        let now = self.log.len();
        for sample in now.saturating_sub(CATCH_UP_DAYS * SAMPLES_PER_DAY)..now {
            let (measured, heat) = self.log[sample];
            self.observer.update(&self.belief.output(&self.observer.x), measured);
            let step = self.belief.step(room, sample, &self.observer.x);
            self.observer.predict(&step, heat);
        }
    }

    /// Lives through the next day.
    pub fn live(&mut self, room: &HeatedRoom) -> Result<(), Failure> {
        let first = self.log.len();
        let about = self.states();
        let steps: Vec<Step> = (first..first + SAMPLES_PER_DAY + HORIZON)
            .map(|sample| self.belief.step(room, sample, &about))
            .collect();
        let output = self.belief.output(&about);
        let mut measures = Measures::default();
        let mut origin = DVector::zeros(0);
        for turn in 0..SAMPLES_PER_DAY {
            let sample = first + turn;
            let measured = room.measured(sample, self.state[0]);
            self.observer.update(&output, measured);
            let state = self.states();
            if turn == 0 {
                origin.clone_from(&state);
            }
            let power = self.decide(room, sample, &steps[turn..turn + HORIZON], &output, &state);
            let heat = power * heated::cop(room.weather(sample).out);
            self.log.push((measured, heat));
            let path = room.advance(&mut self.state, sample, heat);
            for temperature in path {
                let (low, high) = comfort(room.clock(sample).0);
                let hours = SAMPLE_HOURS / path.len() as f64;
                measures.cold += (low - temperature).max(0.0) * hours;
                measures.warm += (temperature - high).max(0.0) * hours;
            }
            measures.bill += power * room.price(sample) * SAMPLE_HOURS;
            self.observer.predict(&steps[turn], heat);
            if !self.state.iter().chain(self.observer.x.iter()).all(|value| value.is_finite()) {
                return Err(Failure::Error(format!("{}: the room left the numbers", self.kind.title())));
            }
        }
        // The forecast of the midnight before, under the heat that there was, beside what was measured.
        let mut x = origin;
        for turn in 0..SAMPLES_PER_DAY {
            x = steps[turn].advance(&x, self.log[first + turn].1);
            let measured = if turn + 1 < SAMPLES_PER_DAY {
                self.log[first + turn + 1].0
            } else {
                room.measured(first + turn + 1, self.state[0])
            };
            measures.squares += (output.of(&x) - measured).powi(2);
            measures.forecasts += 1.0;
        }
        self.days.push(measures);
        Ok(())
    }

    /// What the controller takes for the states.
    fn states(&self) -> DVector<f64> {
        match self.belief {
            Belief::Grey(_) => self.observer.x.clone(),
            Belief::Truth => DVector::from_row_slice(&self.state),
        }
    }

    /// Electric power in kW.
    fn decide(
        &mut self,
        room: &HeatedRoom,
        sample: usize,
        steps: &[Step],
        output: &Output,
        state: &DVector<f64>,
    ) -> f64 {
        let coming = sample..sample + HORIZON;
        let prices: Vec<f64> = coming.clone().map(|k| room.price(k)).collect();
        let cops: Vec<f64> = coming.clone().map(|k| heated::cop(room.weather(k).out)).collect();
        // The bounds hold at the end of a step.
        let bounds: Vec<(f64, f64)> = coming.map(|k| comfort(room.clock(k + 1).0)).collect();
        let task = Task {
            steps,
            output,
            state,
            prices: &prices,
            cops: &cops,
            bounds: &bounds,
            largest: LARGEST_POWER,
        };
        let guess = DVector::from_fn(HORIZON, |i, _| self.plan[(i + 1).min(HORIZON - 1)]);
        self.plan = mpc::decide(&task, &guess);
        self.plan[0]
    }

    /// What was measured since a sample, as CSV.
    pub fn csv(&self, room: &HeatedRoom, since: usize) -> String {
        let mut csv = String::from("time,T_room,T_out,irradiance,wind_speed,P_heater\n");
        for (sample, (measured, heat)) in self.log.iter().enumerate().skip(since) {
            let weather = room.weather(sample);
            let time = rfc3339(room.time(sample));
            let _ = writeln!(
                csv,
                "{time},{measured:.1},{:.2},{:.1},{:.2},{heat:.3}",
                weather.out, weather.irradiance, weather.wind
            );
        }
        csv
    }

    /// Samples that were lived through.
    pub fn samples(&self) -> usize {
        self.log.len()
    }
}

/// The weeks before: a thermostat that is set back at night, and turned a little up or down every day.
#[derive(Debug)]
pub struct Before {
    state: heated::MassTemperatures,
    log: Vec<(f64, f64)>,
}

impl Before {
    pub fn new(room: &HeatedRoom, days: usize) -> Self {
        let (mut state, mut log) = (HeatedRoom::start(), Vec::new());
        for sample in 0..days * SAMPLES_PER_DAY {
            let measured = room.measured(sample, state[0]);
            let turned = 0.4 * f64::from((sample / SAMPLES_PER_DAY * 5 % 4) as u32) - 0.6;
            let wanted = comfort(room.clock(sample).0).0 + 0.7 + turned;
            let power = (1.5 * (wanted - measured) + 0.8).clamp(0.0, LARGEST_POWER);
            let heat = power * heated::cop(room.weather(sample).out);
            log.push((measured, heat));
            room.advance(&mut state, sample, heat);
        }
        Self { state, log }
    }
}
