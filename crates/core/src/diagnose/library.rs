//! The library of what may be missing: every effect of the catalogue, compiled into the model and put on the
//! data.

use crate::data::{CALENDAR, ChannelKind, Column, Grid, Window, is_computed};
use crate::estimate::problem::choices::Choices;
use crate::estimate::problem::widen::widen;
use crate::estimate::{Problem, Site};
use crate::fault::Fault;
use crate::model::catalogue::Catalogue;
use crate::model::id::family;
use crate::model::spec::{AS_IT_COMES, EffectSpec, ModelSpec, Sign};
use crate::model::{Bindings, Model, ModelId, Scale, compile};
use crate::units::Unit;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Largest rate that one channel may explain on its own, in K/h.
const LARGEST_RATE: f64 = 3.0;
/// Water that heats a room is at times this much warmer than the room ever was, in K.
const WARMER: f64 = 3.0;

/// An effect that the model may be missing.
#[derive(Debug, Clone)]
pub struct CandidateEffect {
    /// Its id, with its argument.
    pub id: String,
    /// Its document, with the argument filled in.
    pub spec: EffectSpec,
    /// The model with the effect, on the same data.
    pub problem: Problem,
    /// The effect's own parameters in the full vector, each with the value at which it does nothing.
    pub own: Vec<(usize, f64)>,
    /// Whether it reads a channel that follows from the output.
    pub endogenous: bool,
    /// Whether all that it reads beyond the model is the clock: such a shape imitates whatever happens at
    /// those hours.
    pub by_clock: bool,
    /// Whether temperatures are all that it reads: a conductance that is always there, as those of the model
    /// are.
    pub conducts: bool,
}

/// A candidate that these data cannot show.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct NotTestable {
    /// The effect's id.
    pub effect: String,
    /// Why.
    pub reason: String,
}

impl CandidateEffect {
    /// The id without its argument.
    pub fn family(&self) -> &str {
        family(&self.id)
    }

    /// Whether its members are the choices of one shape, of which the best stands for all.
    pub fn is_choice(&self) -> bool {
        self.spec.argument.is_some() && self.spec.argument.as_deref() != Some("channel")
    }

    /// A parameter vector of the model without the effect, with the effect switched off.
    pub fn lift(&self, base: &Problem, theta: &[f64]) -> Vec<f64> {
        let mut lifted = carried(base, theta, &self.problem);
        self.own.iter().for_each(|(index, off)| lifted[*index] = *off);
        lifted
    }

    /// The vector of the model without the effect that a vector with it contains.
    pub fn lower(&self, base: &Problem, theta: &[f64]) -> Vec<f64> {
        carried(&self.problem, theta, base)
    }
}

/// A full vector of `to` from one of another model: its values where names are the same, the nominal ones
/// elsewhere.
pub fn carried(from: &Problem, theta: &[f64], to: &Problem) -> Vec<f64> {
    let known = from.model().parameters();
    let place = |name: &str| known.iter().position(|parameter| parameter.name == name);
    let parameters = to.model().parameters().iter().zip(to.nominal());
    parameters
        .map(|(parameter, nominal)| place(&parameter.name).map_or(*nominal, |place| theta[place]))
        .collect()
}

/// What candidate effects are made from: their documents, and everything that was measured at a place.
#[derive(Debug, Clone)]
pub struct EffectSource<'a> {
    /// The effects.
    pub catalogue: &'a Catalogue,
    /// It gives the members of sets.
    pub site: &'a Site,
    /// Every channel of a window, so that any effect finds its inputs there.
    pub grid: Grid,
    /// The channels with holes too large to bridge: they are left out.
    pub holes: Vec<String>,
}

impl<'a> EffectSource<'a> {
    /// What effects of a catalogue find in a window, on the grid of a problem.
    ///
    /// # Errors
    /// A fault where the window does not fit the problem, or the time zone is unknown.
    pub fn new(
        catalogue: &'a Catalogue,
        problem: &Problem,
        window: &Window,
        site: &'a Site,
    ) -> Result<Self, Fault> {
        let (grid, holes) = widen(problem, window, site)?;
        Ok(Self { catalogue, site, grid, holes })
    }

    /// All candidates that can be tested, and those that cannot, with the reason.
    pub fn candidates(&self, base: &Problem) -> (Vec<CandidateEffect>, Vec<NotTestable>) {
        let found: Vec<Result<CandidateEffect, NotTestable>> = self
            .names(base)
            .into_par_iter()
            .map(|name| {
                self.candidate(base, &name)
                    .map_err(|reason| NotTestable { effect: name, reason: why(reason, &self.holes) })
            })
            .collect();
        let (mut candidates, mut not_testable) = (Vec::new(), Vec::<NotTestable>::new());
        for one in found {
            match one {
                Ok(candidate) => candidates.push(candidate),
                // The choices of one shape lack the same thing: one line says so.
                Err(reason) => {
                    let reason = if self.has_choices(family(&reason.effect)) {
                        NotTestable { effect: family(&reason.effect).to_owned(), ..reason }
                    } else {
                        reason
                    };
                    if !not_testable.contains(&reason) {
                        not_testable.push(reason);
                    }
                }
            }
        }
        (candidates, not_testable)
    }

    /// A problem whose model lacks one of its effects, on the same data.
    pub(super) fn lacking(&self, with: &Problem, name: &str) -> Result<Problem, Vec<Fault>> {
        let model = self.relative(&with.model().id().minus(name))?;
        let choices = choices_of(with, &model);
        with.with_model(model, self.grid.clone(), &choices)
    }

    /// One candidate.
    pub(super) fn candidate(&self, base: &Problem, name: &str) -> Result<CandidateEffect, Vec<Fault>> {
        let spec = self.catalogue.effect(name).map_err(|fault| vec![fault])?;
        let model = self.relative(&base.model().id().plus(name))?;
        let mut choices = choices_of(base, &model);
        let own: Vec<usize> = (0..model.parameters().len())
            .filter(|index| {
                base.model().parameters().iter().all(|known| known.name != model.parameters()[*index].name)
            })
            .collect();
        if own.is_empty() {
            return Err(vec![Fault::new(
                "/effect",
                "nothing-new",
                "it adds nothing to this model with these channels",
            )]);
        }
        let train = base.split().train.clone();
        for input in model
            .inputs()
            .iter()
            .filter(|input| base.model().inputs().iter().all(|known| known.channel != input.channel))
        {
            let Some(column) = self.grid.column(&input.channel) else { continue };
            let values = &column.values()[train.clone()];
            let (low, high) = values
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
            if high - low <= 0.0 && !is_computed(&input.channel) {
                return Err(vec![Fault::new(
                    "/effect",
                    "constant",
                    format!("`{}` never changes in these data", input.channel),
                )]);
            }
            if high - low <= 0.0 {
                return Err(vec![Fault::new(
                    "/effect",
                    "constant",
                    "nothing of the kind is in these data".to_owned(),
                )]);
            }
            if input.unit == AS_IT_COMES {
                let largest = high.abs().max(low.abs());
                own.iter().for_each(|index| {
                    let bound = LARGEST_RATE / largest;
                    choices.bounds.insert(model.parameters()[*index].name.clone(), [-bound, bound]);
                });
            }
        }
        // A second sensor of what follows from the room follows from it as well.
        let endogenous = model
            .inputs()
            .iter()
            .any(|input| spec.endogenous.iter().any(|name| input.channel.starts_with(name.as_str())));
        let calendar = |channel: &str| CALENDAR.contains(&channel);
        let reads = |channel: &str| {
            spec.inputs.iter().any(|(name, input)| input.channel.as_deref().unwrap_or(name) == channel)
        };
        let known = |channel: &str| base.model().inputs().iter().any(|input| input.channel == channel);
        let mut own_inputs =
            model.inputs().iter().map(|input| input.channel.as_str()).filter(|channel| reads(channel));
        let by_clock =
            own_inputs.clone().any(calendar) && own_inputs.all(|channel| calendar(channel) || known(channel));
        let rates = own.iter().all(|index| model.parameters()[*index].unit == "1/h");
        let conducts =
            rates && !spec.inputs.is_empty() && spec.inputs.values().all(|input| input.unit == "degC");
        let problem = base.with_model(model, self.grid.clone(), &choices)?;
        let off = |index: usize| {
            let [lower, upper] = problem.bounds()[index];
            match problem.model().parameters()[index].scale {
                Scale::Linear => 0f64.clamp(lower, upper),
                Scale::Log => lower,
            }
        };
        let own = own.into_iter().map(|index| (index, off(index))).collect();
        Ok(CandidateEffect { id: name.to_owned(), spec, problem, own, endogenous, by_clock, conducts })
    }

    /// Whether an effect is one of those that come in given shapes.
    fn has_choices(&self, id: &str) -> bool {
        self.catalogue.effect_document(id).is_some_and(|effect| !effect.choices.is_empty())
    }

    /// The ids of all effects that could concern this window and are no part of the model.
    fn names(&self, base: &Problem) -> Vec<String> {
        let mut names = Vec::new();
        for effect in self.catalogue.effects().filter(|effect| effect.way_of.is_none()) {
            match &effect.argument {
                None => names.push(effect.id.clone()),
                Some(_) if !effect.choices.is_empty() => {
                    names.extend(effect.choices.keys().map(|choice| format!("{}:{choice}", effect.id)))
                }
                Some(_) => {
                    let members = self.grid.columns().filter(|(channel, column)| {
                        is_member(effect, channel, column.unit(), base)
                            && (!effect.heats() || is_warm(column, &self.grid, base))
                    });
                    names.extend(members.map(|(channel, _)| format!("{}:{channel}", effect.id)));
                }
            }
        }
        let has = |name: &String| {
            let choice = self.has_choices(family(name));
            let by_way = |known: &str| {
                self.catalogue.effect(known).is_ok_and(|effect| effect.way_of.as_ref() == Some(name))
            };
            base.model()
                .effects()
                .iter()
                .any(|known| known == name || by_way(known) || (choice && family(known) == family(name)))
        };
        let composition = self.catalogue.compose(base.model().id()).ok();
        let at_home = |name: &String| {
            let spec = self.catalogue.effect(name).ok();
            spec.zip(composition.as_ref())
                .is_none_or(|(effect, composition)| is_at_home(&effect, &composition.spec))
        };
        names.retain(|name| !has(name) && at_home(name));
        names
    }

    /// Another model on the channels of a grid, with the members that the site gives to its sets.
    fn relative(&self, id: &ModelId) -> Result<Model, Vec<Fault>> {
        let composition = self.catalogue.compose(id)?;
        let sets = composition
            .spec
            .sets
            .iter()
            .filter_map(|set| self.site.sets.get(set).map(|members| (set.clone(), members.clone())))
            .collect();
        let channels = self.grid.columns().map(|(channel, _)| channel.to_owned()).collect();
        compile(&composition, &Bindings { sets, channels: Some(channels) })
    }
}

/// Puts the model and all candidates on the same footing: the same steps, and the same samples. An effect
/// with a delay knows nothing for a while behind the start and behind each gap, and there no other model may
/// gain or lose.
pub fn align(base: &Problem, library: &mut [CandidateEffect]) -> Problem {
    let whole = base.known();
    let mut known = whole.clone();
    for candidate in library.iter() {
        known.iter_mut().zip(candidate.problem.known()).for_each(|(known, own)| *known &= own);
    }
    let (steps, is_loose) = (base.simulator().substeps(), base.simulator().is_loose());
    library
        .par_iter_mut()
        .filter(|candidate| {
            let simulator = candidate.problem.simulator();
            let as_it_is = simulator.substeps() == steps && simulator.is_loose() == is_loose;
            candidate.problem.known() != known || !as_it_is
        })
        .for_each(|candidate| {
            candidate.problem = candidate.problem.aligned(&known, steps).with_loose_steps(is_loose);
        });
    if known == whole { base.clone() } else { base.aligned(&known, steps) }
}

/// Whether a temperature is at times so much warmer than the first output that it could heat it.
fn is_warm(column: &Column, grid: &Grid, base: &Problem) -> bool {
    let highest = |column: &Column| column.values().iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let room = base.model().outputs().first().and_then(|output| grid.column(&output.channel));
    room.is_some_and(|room| highest(column) >= highest(room) + WARMER)
}

/// Whether an effect has anything to do with a model: what makes rooms warm is no question to a treatment
/// plant, and the reverse.
fn is_at_home(effect: &EffectSpec, model: &ModelSpec) -> bool {
    // A sensor that the model does not have is none of its own.
    let reads = effect.outputs.keys().any(|channel| model.outputs.contains_key(channel));
    if !effect.outputs.is_empty() && !reads {
        return false;
    }
    if effect.replace.is_empty() {
        let is_warm = model.states.values().any(|state| state.unit == "degC");
        is_warm || reads || effect.terms.keys().any(|state| model.states.contains_key(state))
    } else {
        let has = |name: &String| {
            model.define.contains_key(name)
                || model.parameters.contains_key(name)
                || model.inputs.contains_key(name)
        };
        effect.replace.keys().any(has)
    }
}

/// Whether a family that runs over channels has this one as a member.
fn is_member(effect: &EffectSpec, channel: &str, unit: &str, base: &Problem) -> bool {
    let used = base.model().inputs().iter().any(|input| input.channel == channel);
    let output = base.model().outputs().iter().any(|output| output.channel == channel);
    let begins = |names: &[String]| names.iter().any(|name| channel.starts_with(name.as_str()));
    if output
        || is_computed(channel)
        || begins(&effect.strangers)
        || !(effect.members.is_empty() || begins(&effect.members))
    {
        return false;
    }
    let wanted = effect.inputs.get("{channel}").map_or(AS_IT_COMES, |input| input.unit.as_str());
    let converts = |text: &str| {
        Unit::parse(unit).ok().zip(Unit::parse(text).ok()).is_some_and(|(from, to)| from.same_dimension(&to))
    };
    match wanted {
        // What has a meaning of its own has an effect of its own. Temperatures and humidities go with
        // everything.
        AS_IT_COMES => {
            let lower = channel.to_lowercase();
            let moist = lower.starts_with("rh") || lower.contains("humid") || lower.contains("dew");
            let known = ChannelKind::of_name(channel).is_some() && channel != "CO2";
            !used && !known && !moist && !converts("degC")
        }
        // Another room may be coupled to this one already, and its door stand open all the same.
        "degC" if !effect.members.is_empty() => converts("degC"),
        "degC" => channel.starts_with("T_") && !used,
        wanted => converts(wanted) && !used,
    }
}

/// The boxes and the prior of a fit, which may have asked for others than the document has, for what it
/// shares with another model.
fn choices_of(base: &Problem, model: &Model) -> Choices {
    let mut choices = Choices {
        objective: base.objective(),
        delta: base.delta(),
        prior: base.prior().clone(),
        ..Choices::default()
    };
    let free = base.free();
    for (index, (parameter, bounds)) in base.model().parameters().iter().zip(base.bounds()).enumerate() {
        if model.parameters().iter().all(|shared| shared.name != parameter.name) {
            continue;
        }
        choices.bounds.insert(parameter.name.clone(), *bounds);
        if !free.contains(&index) {
            choices.fixed.insert(parameter.name.clone(), base.nominal()[index]);
        }
    }
    choices
}

/// The reason in words, the most telling fault first.
fn why(faults: Vec<Fault>, holes: &[String]) -> String {
    // What is wrong with the document itself is told in full.
    let absent =
        |fault: &Fault| ["missing-channel", "unknown-state", "unknown-name"].contains(&fault.code.as_ref());
    if faults.len() > 1 && !faults.iter().all(absent) {
        return faults.iter().map(|fault| fault.detail.as_str()).collect::<Vec<_>>().join("; ");
    }
    let missing = faults.iter().find(|fault| fault.code == "missing-channel");
    if let Some(fault) = missing {
        let channel = fault.detail.split('`').nth(1).unwrap_or_default();
        if holes.iter().any(|hole| hole == channel) {
            return format!("more than a tenth of {channel} is missing");
        }
        return format!("needs channel {channel}");
    }
    match faults.first() {
        Some(fault) if fault.code == "unknown-state" || fault.code == "unknown-name" => {
            "the model has no part that it could act on".to_owned()
        }
        Some(fault) => fault.detail.clone(),
        None => "it cannot be compiled into this model".to_owned(),
    }
}

/// Whether a coefficient may have this sign.
pub fn sign_allows(sign: Sign, value: f64) -> bool {
    match sign {
        Sign::Positive => value >= 0.0,
        Sign::Negative => value <= 0.0,
        Sign::Any => true,
    }
}
