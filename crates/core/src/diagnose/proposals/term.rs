//! The grammar of terms: a subject, what it is multiplied by, how late it acts, and where it flows.

use super::stock::{Stock, StockChannel};
use crate::data::Hold;

/// What makes a term come and go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum TermSubject {
    /// A channel, by its place in the stock.
    Channel(usize, Form),
    /// The sun.
    Sun(Form),
    /// The measured state itself: 1 where it is above this, softly.
    Warm(f64),
    /// The clock.
    Hours(Schedule),
}

/// Over so much of a state's unit what it switches comes and goes: a step that a search can follow.
pub(super) const SOFT: f64 = 0.1;

/// How a channel acts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Form {
    /// As it is; a temperature by its difference from the state into which it flows.
    Plain,
    /// What it is more than this.
    Above(f64),
    /// What it is less than this.
    Below(f64),
    /// 1 where it is more than this.
    On(f64),
}

/// Hours of the local day.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Schedule {
    /// From this hour on.
    pub from: f64,
    /// To this one, which is earlier where midnight lies between.
    pub to: f64,
    /// On which days.
    pub days: ScheduleDays,
}

/// On which days a schedule holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ScheduleDays {
    All,
    Working,
    Weekend,
}

/// What a subject is multiplied by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Factor {
    /// By nothing.
    One,
    /// By how much warmer it is outside than the state: air that is exchanged.
    Outdoors,
    /// By the sun.
    Sun,
}

/// How late a subject acts, in hours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Memory {
    /// At once.
    None,
    /// Through a mass with this time constant.
    Lag(f64),
    /// So much later.
    Delay(f64),
}

/// A term: `c * subject * factor`, into a state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Term {
    pub subject: TermSubject,
    pub factor: Factor,
    pub memory: Memory,
    /// The state that it flows into, by its place in the model.
    pub into: usize,
}

impl Form {
    pub fn of(self, value: f64) -> f64 {
        match self {
            Self::Plain => value,
            Self::Above(least) => (value - least).max(0.0),
            Self::Below(most) => (most - value).max(0.0),
            Self::On(least) => f64::from(value > least),
        }
    }

    /// The threshold, where it has one.
    pub fn threshold(self) -> Option<f64> {
        match self {
            Self::Plain => None,
            Self::Above(at) | Self::Below(at) | Self::On(at) => Some(at),
        }
    }

    /// The same with another threshold.
    pub fn at(self, threshold: f64) -> Self {
        match self {
            Self::Plain => Self::Plain,
            Self::Above(_) => Self::Above(threshold),
            Self::Below(_) => Self::Below(threshold),
            Self::On(_) => Self::On(threshold),
        }
    }
}

impl Schedule {
    fn holds(self, hour: f64, weekday: f64) -> bool {
        let day = match self.days {
            ScheduleDays::All => true,
            ScheduleDays::Working => weekday < 5.5,
            ScheduleDays::Weekend => weekday > 5.5,
        };
        let now = if self.from < self.to {
            self.from <= hour && hour < self.to
        } else {
            self.from <= hour || hour < self.to
        };
        day && now
    }
}

/// A term over time: its means from each sample to the next.
pub(super) struct TermSeries {
    /// What it is multiplied by.
    pub rate: Vec<f64>,
    /// Less the state, where it flows along a difference from it.
    pub from: Option<Vec<f64>>,
}

impl Term {
    /// How many choices it is made of, beyond a channel.
    pub fn choices(&self) -> usize {
        let form = match self.subject {
            TermSubject::Channel(_, form) | TermSubject::Sun(form) => usize::from(form != Form::Plain),
            TermSubject::Warm(_) => 1,
            TermSubject::Hours(_) => 2,
        };
        form + usize::from(self.factor != Factor::One) + usize::from(self.memory != Memory::None)
    }

    /// Of which kind it is, whatever its numbers: the best of each kind is worth a fit.
    pub fn kind(&self) -> (TermSubject, Factor, Memory) {
        let form = |form: Form| form.at(0.0);
        let subject = match self.subject {
            TermSubject::Channel(place, of) => TermSubject::Channel(place, form(of)),
            TermSubject::Sun(of) => TermSubject::Sun(form(of)),
            TermSubject::Warm(_) => TermSubject::Warm(0.0),
            TermSubject::Hours(Schedule { from, to, days }) => {
                // Short, half a day, longer.
                let class = ((to - from).rem_euclid(24.0) / 6.0).floor().min(2.0);
                TermSubject::Hours(Schedule { from: 0.0, to: class, days })
            }
        };
        let memory = match self.memory {
            Memory::None => Memory::None,
            Memory::Lag(_) => Memory::Lag(0.0),
            Memory::Delay(_) => Memory::Delay(0.0),
        };
        (subject, self.factor, memory)
    }

    /// What it follows: a channel by its place, or one of the three others.
    pub fn reads(&self) -> (u8, usize) {
        match self.subject {
            TermSubject::Channel(place, _) => (0, place),
            TermSubject::Sun(_) => (1, 0),
            TermSubject::Warm(_) => (2, 0),
            TermSubject::Hours(_) => (3, 0),
        }
    }

    /// Whether it follows the clock alone.
    pub fn is_by_clock(&self) -> bool {
        matches!(self.subject, TermSubject::Hours(_))
    }

    /// Whether all that it reads is read by the model already.
    pub fn is_of_the_model(&self, stock: &Stock) -> bool {
        match self.subject {
            TermSubject::Channel(place, _) => stock.channels[place].is_used,
            TermSubject::Sun(_) => stock.sun.as_ref().is_some_and(|sun| sun.is_used),
            TermSubject::Warm(_) | TermSubject::Hours(_) => true,
        }
    }

    /// What it is over time; `warm` is the measured state. `None` where the stock lacks what it reads.
    pub fn series(&self, stock: &Stock, warm: &[f64]) -> Option<TermSeries> {
        let formed = |channel: &StockChannel, form: Form| {
            let values = channel.values.iter().map(|value| form.of(*value)).collect();
            (self.later(stock, values, channel.hold), channel.hold)
        };
        let (values, hold) = match self.subject {
            TermSubject::Channel(place, form) => formed(&stock.channels[place], form),
            TermSubject::Sun(form) => formed(stock.sun.as_ref()?, form),
            TermSubject::Warm(least) => {
                (warm.iter().map(|state| soft_step(state - least)).collect(), Hold::ZeroOrder)
            }
            TermSubject::Hours(schedule) => {
                let (hours, days) = stock.clock.as_ref()?;
                let holds = hours.iter().zip(days).map(|(hour, day)| f64::from(schedule.holds(*hour, *day)));
                (holds.collect(), Hold::ZeroOrder)
            }
        };
        let values = means(values, hold);
        let of_place = |place: usize| means(stock.channels[place].values.clone(), stock.channels[place].hold);
        if self.is_a_difference(stock) {
            return Some(TermSeries { rate: vec![1.0; values.len()], from: Some(values) });
        }
        Some(match self.factor {
            Factor::One => TermSeries { rate: values, from: None },
            Factor::Outdoors => TermSeries { rate: values, from: Some(of_place(stock.outdoors?)) },
            Factor::Sun => {
                let sun = means(stock.sun.as_ref()?.values.clone(), Hold::Linear);
                TermSeries { rate: values.iter().zip(&sun).map(|(one, sun)| one * sun).collect(), from: None }
            }
        })
    }

    /// Whether it flows by how much warmer its channel is than the state.
    pub fn is_a_difference(&self, stock: &Stock) -> bool {
        match self.subject {
            TermSubject::Channel(place, Form::Plain) => stock.channels[place].is_warmth,
            _ => false,
        }
    }

    /// What has come through by then.
    fn later(&self, stock: &Stock, values: Vec<f64>, hold: Hold) -> Vec<f64> {
        match self.memory {
            Memory::None => values,
            Memory::Delay(hours) => {
                let late = (hours / stock.hours).round() as usize;
                (0..values.len()).map(|k| values[k.saturating_sub(late)]).collect()
            }
            Memory::Lag(hours) => {
                let keep = (-stock.hours / hours).exp();
                let steps = means(values, hold);
                let mut passed = steps.first().copied().unwrap_or_default();
                let next = |step: &f64| {
                    let now = passed;
                    passed = keep * passed + (1.0 - keep) * step;
                    now
                };
                steps.iter().map(next).collect()
            }
        }
    }
}

/// 0 far below, 1 far above; 0 where it is not known.
fn soft_step(above: f64) -> f64 {
    if above.is_nan() { 0.0 } else { 1.0 / (1.0 + (-above / SOFT).exp()) }
}

/// From the values at samples to their means from each sample to the next.
fn means(values: Vec<f64>, hold: Hold) -> Vec<f64> {
    match hold {
        Hold::ZeroOrder => values,
        Hold::Linear => {
            let next = |k: usize| values[(k + 1).min(values.len() - 1)];
            (0..values.len()).map(|k| 0.5 * (values[k] + next(k))).collect()
        }
    }
}
