//! A term as an effect's document and in words.

use super::stock::{Stock, StockChannel};
use super::term::{Factor, Form, Memory, SOFT, Schedule, ScheduleDays, Term, TermSubject};
use crate::data::{CALENDAR, Hold};
use crate::model::Model;
use crate::model::catalogue::Catalogue;
use crate::model::spec::{
    AS_IT_COMES, EffectSpec, InputHold, InputSpec, Nominal, ParameterSpec, Scale, Sign, StateSpec,
};
use crate::model::token::is_name;
use crate::units::{Unit, error_unit};

/// How the ids begin of effects that were proposed.
pub const PROPOSED: &str = "proposed_";
/// The effect of the catalogue whose definition of the sun is taken.
const SUN_OF: &str = "solar_gain";
/// How much larger and smaller than it was found a size may become.
const ROOM_FOR_SIZE: f64 = 10.0;
/// How far a time constant may move, as a factor.
const ROOM_FOR_LAG: f64 = 5.0;

/// What a term is written with.
pub(super) struct TermWriting<'a> {
    pub stock: &'a Stock,
    pub catalogue: &'a Catalogue,
    pub model: &'a Model,
    /// What the state is called for people.
    pub place: &'a str,
    pub term: Term,
    pub size: f64,
}

impl TermWriting<'_> {
    /// The effect that adds the term, as `POST /effects` takes it, and whether the catalogue has it already:
    /// one that is the same but for its numbers serves other rooms as well. Where another effect has its
    /// name, or another term of the same answer was given it, it gets a number.
    pub fn effect(&self, is_given: impl Fn(&str) -> bool) -> (EffectSpec, bool) {
        let name = self.id();
        let mut number = 1;
        loop {
            let id = if number == 1 { name.clone() } else { format!("{name}_{number}") };
            if is_given(&id) {
                number += 1;
                continue;
            }
            let effect = self.called(id);
            match self.catalogue.effect_document(&effect.id) {
                None => return (effect, false),
                Some(known) if !self.is_part(known) && is_same(known, &effect) => {
                    return (known.clone(), true);
                }
                Some(_) => number += 1,
            }
        }
    }

    /// Whether the model has an effect already.
    fn is_part(&self, effect: &EffectSpec) -> bool {
        self.model.effects().contains(&effect.id)
    }

    /// The effect under a name.
    fn called(&self, id: String) -> EffectSpec {
        let state = &self.model.states()[self.term.into];
        let mut effect = EffectSpec {
            title: format!("Proposed: {}", self.subject()),
            explain: self.sentence(),
            measure: "what stands behind it: it was found by what it goes with".to_owned(),
            sign: if self.size > 0.0 { Sign::Positive } else { Sign::Negative },
            ..EffectSpec::default()
        };
        let value = self.value(&mut effect, &id);
        let size = format!("c_{id}");
        let unit = self.size_unit();
        let (low, high) =
            if self.size > 0.0 { (0.0, ROOM_FOR_SIZE * self.size) } else { (ROOM_FOR_SIZE * self.size, 0.0) };
        let title = format!("size of what goes with {}", self.subject());
        effect
            .parameters
            .insert(size.clone(), parameter(&unit, [low, high], self.size, Scale::Linear, title));
        let factor = match self.term.factor {
            _ if self.term.is_a_difference(self.stock) => String::new(),
            Factor::One => String::new(),
            Factor::Outdoors => match self.stock.outdoors.map(|place| &self.stock.channels[place]) {
                Some(outdoors) => {
                    let name = self.reads(&mut effect, outdoors);
                    format!(" * ({name} - {})", state.name)
                }
                None => String::new(),
            },
            Factor::Sun => {
                self.with_sun(&mut effect);
                " * S".to_owned()
            }
        };
        effect.terms.insert(state.name.clone(), format!("{size} * {value}{factor}"));
        effect.id = id;
        effect
    }

    /// What makes the term come and go, as an expression; declares what it is made of.
    fn value(&self, effect: &mut EffectSpec, id: &str) -> String {
        let into = &self.model.states()[self.term.into];
        let (now, channel, form) = match self.term.subject {
            TermSubject::Channel(place, form) => {
                let channel = &self.stock.channels[place];
                (self.reads(effect, channel), channel, form)
            }
            TermSubject::Sun(form) => {
                self.with_sun(effect);
                let Some(sun) = &self.stock.sun else { return "S".to_owned() };
                ("S".to_owned(), sun, form)
            }
            TermSubject::Warm(above) => {
                let unit = error_unit(&into.unit);
                let level = format!("{above:.2}[{}]", into.unit);
                return format!("(1 / (1 + exp(({level} - {}) / {SOFT}[{unit}])))", into.name);
            }
            TermSubject::Hours(schedule) => return hours(effect, schedule),
        };
        let name = match self.term.memory {
            Memory::Delay(hours) => format!("delay({now}, {hours:.2}[h])"),
            _ => now,
        };
        let unit = &channel.unit;
        let threshold = format!("q_{id}");
        let formed = match form {
            Form::Plain => name,
            Form::On(least) => format!("({name} > {}[{unit}])", rounded(least)),
            Form::Above(at) | Form::Below(at) => {
                let (low, high) = super::search::range(&channel.values);
                let title = format!("{} from which on it acts", channel.name);
                effect
                    .parameters
                    .insert(threshold.clone(), parameter(unit, [low, high], at, Scale::Linear, title));
                match form {
                    Form::Above(_) => format!("max(0, {name} - {threshold})"),
                    _ => format!("max(0, {threshold} - {name})"),
                }
            }
        };
        let Memory::Lag(hours) = self.term.memory else {
            return if self.term.is_a_difference(self.stock) {
                format!("({formed} - {})", into.name)
            } else {
                formed
            };
        };
        let (late, constant) = (format!("late_{id}"), format!("tau_{id}"));
        let around = [hours / ROOM_FOR_LAG, hours * ROOM_FOR_LAG];
        let title = format!("time constant of what {} warms or cools first", channel.name);
        effect.parameters.insert(constant.clone(), parameter("h", around, hours, Scale::Log, title));
        let unit = if matches!(form, Form::On(_)) { "-" } else { unit };
        let begins = channel.values.first().copied().unwrap_or_default();
        effect.states.insert(
            late.clone(),
            StateSpec {
                unit: unit.to_owned(),
                initial: rounded(form.of(begins)),
                title: format!("what has come through of {}", channel.name),
            },
        );
        effect.terms.insert(late.clone(), format!("({formed} - {late}) / {constant}"));
        if self.term.is_a_difference(self.stock) { format!("({late} - {})", into.name) } else { late }
    }

    /// Declares a channel as an input; gives its name in the equations.
    fn reads(&self, effect: &mut EffectSpec, channel: &StockChannel) -> String {
        let known = Unit::parse(&channel.unit).is_ok();
        let name = if is_name(&channel.name) { channel.name.clone() } else { plain(&channel.name) };
        let hold = match channel.hold {
            Hold::Linear => InputHold::Linear,
            Hold::ZeroOrder => InputHold::ZeroOrder,
        };
        let input = InputSpec {
            unit: if known { channel.unit.clone() } else { AS_IT_COMES.to_owned() },
            hold,
            channel: (name != channel.name).then(|| channel.name.clone()),
            min: None,
            may_be_constant: false,
        };
        effect.inputs.insert(name.clone(), input);
        name
    }

    /// Declares the sun as the catalogue's own effect does.
    fn with_sun(&self, effect: &mut EffectSpec) {
        if let Ok(sun) = self.catalogue.effect(SUN_OF) {
            effect.inputs.extend(sun.inputs);
            effect.define.extend(sun.define);
        }
    }

    /// The unit of the size.
    pub fn size_unit(&self) -> String {
        let state = error_unit(&self.model.states()[self.term.into].unit);
        let is_rate = self.term.is_a_difference(self.stock) || self.term.factor == Factor::Outdoors;
        let flow = if is_rate { "1/h".to_owned() } else { format!("{state}/h") };
        let per = match self.term.subject {
            TermSubject::Channel(place, form) if !matches!(form, Form::On(_)) => {
                let channel = &self.stock.channels[place];
                (!self.term.is_a_difference(self.stock)).then(|| error_unit(&channel.unit))
            }
            _ => None,
        };
        match per {
            Some(unit) if unit != "-" && Unit::parse(unit).is_ok() => format!("{flow} per {unit}"),
            _ => flow,
        }
    }

    /// [`PROPOSED`] and what it goes with.
    fn id(&self) -> String {
        let what = match self.term.subject {
            TermSubject::Channel(place, form) => {
                let name = plain(&self.stock.channels[place].name);
                let form = match form {
                    Form::Plain => "",
                    Form::Above(_) => "_above",
                    Form::Below(_) => "_below",
                    Form::On(_) => "_on",
                };
                format!("{name}{form}")
            }
            TermSubject::Sun(_) => "sun".to_owned(),
            TermSubject::Warm(_) => "warm".to_owned(),
            TermSubject::Hours(schedule) => {
                let days = match schedule.days {
                    ScheduleDays::All => "daily",
                    ScheduleDays::Working => "working_days",
                    ScheduleDays::Weekend => "weekends",
                };
                format!("{days}_{:.0}_{:.0}", schedule.from, schedule.to)
            }
        };
        let factor = match self.term.factor {
            Factor::One => "",
            Factor::Outdoors => "_outdoors",
            Factor::Sun => "_sun",
        };
        let memory = match self.term.memory {
            Memory::None => "",
            Memory::Lag(_) => "_late",
            Memory::Delay(_) => "_delayed",
        };
        let mut what: String = what.chars().take(30).collect();
        what.push_str(factor);
        what.push_str(memory);
        format!("{PROPOSED}{what}")
    }

    /// What it is made of, as a short title.
    pub fn subject(&self) -> String {
        let subject = match self.term.subject {
            TermSubject::Channel(place, form) => {
                let StockChannel { name, unit, .. } = &self.stock.channels[place];
                let unit = if unit == "-" { String::new() } else { format!(" {unit}") };
                match form {
                    Form::Plain => name.clone(),
                    Form::Above(at) | Form::On(at) => format!("{name} above {}{unit}", rounded(at)),
                    Form::Below(at) => format!("{name} below {}{unit}", rounded(at)),
                }
            }
            TermSubject::Sun(_) => "the sun".to_owned(),
            TermSubject::Warm(above) => {
                let state = &self.model.states()[self.term.into];
                format!("{} above {above:.1} {}", state.name, state.unit)
            }
            TermSubject::Hours(Schedule { from, to, days }) => {
                let days = match days {
                    ScheduleDays::All => "every day",
                    ScheduleDays::Working => "working days",
                    ScheduleDays::Weekend => "weekends",
                };
                format!("{days}, {} to {} h", clock(from), clock(to))
            }
        };
        match self.term.memory {
            Memory::None => subject,
            Memory::Lag(hours) => format!("{subject}, felt through a lag of about {hours:.1} h"),
            Memory::Delay(hours) => format!("{subject}, {hours:.1} h later"),
        }
    }

    /// What it does, for an operator.
    pub fn sentence(&self) -> String {
        let (place, subject) = (self.place, self.subject());
        if self.term.is_a_difference(self.stock) {
            return format!("Heat flows between {subject} and the {place}, by their difference.");
        }
        let what = match (self.term.factor, self.size > 0.0) {
            (Factor::Outdoors, true) => format!("Air is exchanged between the outdoors and the {place}"),
            (Factor::Outdoors, false) => {
                format!("Less is exchanged between the outdoors and the {place} than the model knows")
            }
            (Factor::Sun, true) => format!("The sun warms the {place} more than the model knows"),
            (Factor::Sun, false) => format!("Less sun comes to the {place} than the model knows"),
            (Factor::One, true) => format!("The {place} is warmed"),
            (Factor::One, false) => format!("The {place} is cooled"),
        };
        match self.term.subject {
            TermSubject::Hours(_) => format!("{what} at the same hours: {subject}."),
            TermSubject::Warm(_) | TermSubject::Channel(_, Form::On(_)) => format!("{what}: {subject}."),
            _ => format!("{what}, in proportion to {subject}."),
        }
    }
}

/// Whether two effects are one term, and the first may take the numbers of the second.
fn is_same(known: &EffectSpec, effect: &EffectSpec) -> bool {
    let may_be = |(name, new): (&String, &ParameterSpec)| {
        let there = |known: &ParameterSpec| match new.nominal {
            Nominal::Value(value) => {
                (known.lower..=known.upper).contains(&value)
                    && known.unit == new.unit
                    && known.scale == new.scale
            }
            _ => false,
        };
        known.parameters.get(name).is_some_and(there)
    };
    let states = |effect: &EffectSpec| -> Vec<(String, String)> {
        effect.states.iter().map(|(name, state)| (name.clone(), state.unit.clone())).collect()
    };
    known.sign == effect.sign
        && known.inputs == effect.inputs
        && known.define == effect.define
        && known.terms == effect.terms
        && known.parameters.len() == effect.parameters.len()
        && effect.parameters.iter().all(may_be)
        && states(known) == states(effect)
}

/// Declares the clock; gives 1 at these hours and 0 at others.
fn hours(effect: &mut EffectSpec, schedule: Schedule) -> String {
    let [hour, weekday] = CALENDAR;
    let input = |unit: &str| InputSpec {
        unit: unit.to_owned(),
        hold: InputHold::ZeroOrder,
        channel: None,
        min: Some(0.0),
        may_be_constant: false,
    };
    effect.inputs.insert(hour.to_owned(), input("h"));
    let Schedule { from, to, days } = schedule;
    let both = [format!("{hour} >= {from:.2}[h]"), format!("{hour} < {to:.2}[h]")];
    let joins = if from < to { "min" } else { "max" };
    let now = format!("{joins}({}, {})", both[0], both[1]);
    let day = match days {
        ScheduleDays::All => return now,
        ScheduleDays::Working => format!("({weekday} < 5.5)"),
        ScheduleDays::Weekend => format!("({weekday} > 5.5)"),
    };
    effect.inputs.insert(weekday.to_owned(), input("-"));
    format!("{day} * {now}")
}

fn parameter(
    unit: &str,
    [lower, upper]: [f64; 2],
    nominal: f64,
    scale: Scale,
    title: String,
) -> ParameterSpec {
    ParameterSpec {
        unit: unit.to_owned(),
        lower,
        upper,
        scale,
        nominal: Nominal::Value(nominal.clamp(lower, upper)),
        quantity: String::new(),
        title,
        excite: None,
    }
}

/// Three digits.
fn rounded(value: f64) -> String {
    let digits = (2 - value.abs().max(1e-9).log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.digits$}")
}

/// Hours and minutes.
fn clock(hour: f64) -> String {
    let minutes = (hour * 60.0).round() as u32;
    if minutes.is_multiple_of(60) {
        format!("{}", minutes / 60)
    } else {
        format!("{}:{:02}", minutes / 60, minutes % 60)
    }
}

/// A name as it may stand in an equation.
fn plain(name: &str) -> String {
    let name: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if name.starts_with(|c: char| c.is_ascii_digit()) { format!("x{name}") } else { name }
}
