//! Sequences of inputs that somebody could drive for some days, drawn by seed from three families.
//!
//! Steps let slow states answer, a random binary sequence excites all frequencies up to its clock (Ljung
//! 1999, System Identification, 13.3), and pulses at night leave the day as it is: then the sun is down and
//! nobody is up.

use crate::data::{Grid, hour_of_day};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Sequences that are drawn of each family.
pub const DRAWN: u64 = 12;
/// Hours for which a step is kept, one of them; and so many levels between the bounds.
const STEP_HOURS: [f64; 5] = [4.0, 6.0, 8.0, 12.0, 24.0];
const LEVELS: usize = 5;
/// The clock of a random binary sequence in hours, one of these.
const CLOCK_HOURS: [f64; 5] = [1.0, 2.0, 3.0, 4.0, 6.0];
/// Hours of a pulse at night, one of these, and the pause behind it at least.
const PULSE_HOURS: [f64; 4] = [1.0, 1.5, 2.0, 3.0];
/// The night begins and ends at these hours.
const NIGHT: (usize, usize) = (22, 6);

/// How a sequence is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlanFamily {
    /// One of some levels for hours each.
    Steps,
    /// The lowest or the highest value by chance at each tick of a clock of hours.
    RandomBinary,
    /// The other bound for an hour or three in the nights; by day the inputs are as they were.
    NightPulses,
}

impl PlanFamily {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Steps, Self::RandomBinary, Self::NightPulses];

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Steps => "steps",
            Self::RandomBinary => "a random binary sequence",
            Self::NightPulses => "pulses at night",
        }
    }
}

/// An input that may be driven, in the unit of its channel.
#[derive(Debug, Clone, PartialEq)]
pub struct DrivenInput {
    /// The channel.
    pub channel: String,
    /// Its lowest and its highest value.
    pub range: [f64; 2],
    /// The most that it may change in an hour.
    pub slew: f64,
}

/// Sequences of a family, one for every driven input; a value at each sample of a grid from `past` on.
/// `usual` has what the inputs are when nobody drives them.
pub fn drawn(
    family: PlanFamily,
    seed: u64,
    inputs: &[DrivenInput],
    usual: &[Vec<f64>],
    grid: &Grid,
    past: usize,
) -> Vec<Vec<f64>> {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed);
    let one = |(input, usual): (&DrivenInput, &Vec<f64>)| {
        let wanted = match family {
            PlanFamily::Steps => steps(&mut dice, input, grid, usual.len()),
            PlanFamily::RandomBinary => binary(&mut dice, input, grid, usual.len()),
            PlanFamily::NightPulses => pulses(&mut dice, input, grid, past, usual),
        };
        slowed(input, usual, &wanted, grid.step_hours())
    };
    inputs.iter().zip(usual).map(one).collect()
}

/// A plan that goes so far from the usual inputs to what it is.
pub fn nearer(plan: &[Vec<f64>], usual: &[Vec<f64>], share: f64) -> Vec<Vec<f64>> {
    let between = |(plan, usual): (&Vec<f64>, &Vec<f64>)| {
        usual.iter().zip(plan).map(|(usual, plan)| plan + (1.0 - share) * (usual - plan)).collect()
    };
    plan.iter().zip(usual).map(between).collect()
}

fn any<T: Copy>(dice: &mut Xoshiro256PlusPlus, of: &[T]) -> T {
    of[dice.random_range(0..of.len())]
}

/// How many samples so many hours are, one at least.
fn samples(hours: f64, grid: &Grid) -> usize {
    ((hours / grid.step_hours()).round() as usize).max(1)
}

fn steps(dice: &mut Xoshiro256PlusPlus, input: &DrivenInput, grid: &Grid, length: usize) -> Vec<f64> {
    let [low, high] = input.range;
    let mut wanted = Vec::with_capacity(length);
    let mut level = LEVELS;
    while wanted.len() < length {
        // Never the same level twice.
        let next = dice.random_range(0..LEVELS - usize::from(level < LEVELS));
        level = next + usize::from(level < LEVELS && next >= level);
        let value = low + (high - low) * level as f64 / (LEVELS - 1) as f64;
        let kept = samples(any(dice, &STEP_HOURS), grid);
        wanted.extend(std::iter::repeat_n(value, kept));
    }
    wanted.truncate(length);
    wanted
}

fn binary(dice: &mut Xoshiro256PlusPlus, input: &DrivenInput, grid: &Grid, length: usize) -> Vec<f64> {
    let clock = samples(any(dice, &CLOCK_HOURS), grid);
    let ticks = length.div_ceil(clock);
    let values: Vec<f64> = (0..ticks).map(|_| any(dice, &input.range)).collect();
    (0..length).map(|k| values[k / clock]).collect()
}

fn pulses(
    dice: &mut Xoshiro256PlusPlus,
    input: &DrivenInput,
    grid: &Grid,
    past: usize,
    usual: &[f64],
) -> Vec<f64> {
    let mut wanted = usual.to_vec();
    let is_night = |k: usize| {
        let hour = hour_of_day(grid, past + k);
        hour >= NIGHT.0 || hour < NIGHT.1
    };
    let base = any(dice, &input.range);
    let [low, high] = input.range;
    let other = low + high - base;
    let mut k = 0;
    while k < wanted.len() {
        let length = samples(any(dice, &PULSE_HOURS), grid);
        let pause = length + samples(dice.random_range(0.0..2.0), grid);
        for value in
            [base, other].into_iter().zip([pause, length]).flat_map(|(v, n)| std::iter::repeat_n(v, n))
        {
            if k < wanted.len() && is_night(k) {
                wanted[k] = value;
            }
            k += 1;
        }
    }
    wanted
}

/// A sequence that follows the wanted one no faster than it may, from what it usually is at the start, within
/// its range.
fn slowed(input: &DrivenInput, usual: &[f64], wanted: &[f64], step_hours: f64) -> Vec<f64> {
    let [low, high] = input.range;
    let most = input.slew * step_hours;
    let mut value = usual.first().copied().unwrap_or(low);
    let next = |wanted: &f64| {
        let wanted = wanted.clamp(low, high);
        value = if (wanted - value).abs() <= most { wanted } else { value + most.copysign(wanted - value) };
        value
    };
    wanted.iter().map(next).collect()
}
