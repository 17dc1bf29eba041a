//! What is known about a room or a plant: the document behind `/systems/{kind}/{id}`.

use crate::service::error::ServiceError;
use indexmap::IndexMap;
use lampyris_core::data::{ColumnBindings, Duration, Length, SystemId, read_time};
use lampyris_core::estimate::EstimateRequest;
use lampyris_core::estimate::problem::choices::Choices;
use lampyris_core::estimate::problem::prior::Prior;
use lampyris_core::estimate::problem::request::{SeededMethod, Site};
use lampyris_core::fault::{Fault, nearest};
use lampyris_core::model::waivers::{Waivers, waiver_faults};
use lampyris_core::model::{Bindings, Catalogue, ModelId, compile};
use lampyris_core::optimise::Method;
use lampyris_core::schema::Interval;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The longest name for people.
const LONGEST_LABEL: usize = 200;
/// The longest path of a group.
const LONGEST_GROUP: usize = 200;
/// Most letters of the name of a tenant.
const LONGEST_TENANT: usize = 64;

/// The set whose members are the neighbours of a room.
pub const NEIGHBOURS: &str = "neighbours";

/// A system, as its owner describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = System)]
pub struct SystemDocument {
    /// A name for people.
    #[serde(default)]
    pub label: String,
    /// Where people look for it: a building, a floor, a process line, the levels with `/` between them.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    #[schema(max_length = 200, example = "North house/Floor 2")]
    pub group: String,
    /// Whose it is, where several share a service: tenants take turns in the queue, a job of one after a job
    /// of the other, however many each has. 1 to 64 letters, digits, `_` and `-`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    #[schema(max_length = 64, pattern = "^[A-Za-z0-9_-]*$", example = "north-estate")]
    pub tenant: String,
    /// Where it is, for the position of the sun, and on which clock people live there.
    #[serde(default)]
    pub location: Option<Location>,
    /// The model whose fits are served. Only a site, whose measurements others share, may have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelId>,
    /// Which column feeds which channel, where the names alone do not say it. `site/home:T_out` is the
    /// channel `T_out` of the system `site/home`, which measures it for all that name it.
    #[serde(default)]
    #[schema(value_type = std::collections::HashMap<String, String>)]
    pub channels: ColumnBindings,
    /// The rooms next door.
    #[serde(default)]
    pub neighbours: Vec<SystemId>,
    /// The members of the other sets of its model; a set that is not named is empty.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schema(
        value_type = std::collections::HashMap<String,
        Vec<String>>,
        example = json!({"zones": ["north", "south"]})
    )]
    pub sets: BTreeMap<String, Vec<String>>,
    /// What happens to an accepted fit, and how long it is fresh.
    #[serde(default)]
    pub policy: Policy,
    /// What is known about the parameters before any data. `siblings`, the default, takes it from the other
    /// systems of its building (the first level of `group`) that have the same model; `none` does not.
    #[serde(default = "siblings")]
    pub prior: Prior,
    /// Other bounds than the model's, for jobs that name none.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    #[schema(value_type = IndexMap<String, Interval>)]
    pub bounds: IndexMap<String, [f64; 2]>,
    /// Parameters that are known and not estimated, for jobs that name none.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub fixed: IndexMap<String, f64>,
    /// How its jobs search where they do not say it; `cfa` with its defaults where there is none. A tuning
    /// writes it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub method: Option<SeededMethod>,
    /// Stretches of time whose measurements are not to be trusted.
    #[serde(default)]
    pub exclude: Vec<Exclusion>,
}

/// What is taken to be known of a system of which nobody says it.
fn siblings() -> Prior {
    Prior::Siblings
}

/// A place on earth, its time zone, or both.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Location {
    /// Latitude in degrees, north positive. Without a place, the position of the sun is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = -90, maximum = 90)]
    pub lat: Option<f64>,
    /// Longitude in degrees, east positive; it goes with the latitude.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = -180, maximum = 180)]
    pub lon: Option<f64>,
    /// IANA time zone of the inputs `hour_of_day` and `weekday`; UTC where it is not given.
    #[serde(default)]
    pub zone: Option<String>,
}

impl Location {
    fn faults(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        for (field, what, value, other, limit) in
            [("lat", "latitude", self.lat, self.lon, 90.0), ("lon", "longitude", self.lon, self.lat, 180.0)]
        {
            let pointer = format!("/location/{field}");
            match value {
                Some(value) if !value.is_finite() || value.abs() > limit => {
                    let detail = format!("a {what} lies between -{limit} and {limit}, not at {value}");
                    faults.push(Fault::new(pointer, "out-of-range", detail));
                }
                None if other.is_some() => {
                    let detail = format!("the {what} is missing: a place has a latitude and a longitude");
                    let fault = Fault::new(pointer, "half-a-place", detail);
                    faults.push(fault.suggest("give both, or neither"));
                }
                _ => {}
            }
        }
        if let Some(zone) = self.zone.as_ref().filter(|zone| jiff::tz::TimeZone::get(zone).is_err()) {
            let shown: String = zone.chars().take(40).collect();
            let detail = format!("`{}` is no IANA time zone", shown.escape_debug());
            let fault = Fault::new("/location/zone", "unknown-zone", detail);
            faults.push(fault.suggest("such as `Europe/Copenhagen`"));
        }
        faults
    }
}

/// What happens to an accepted fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Policy {
    /// Who publishes.
    pub mode: Mode,
    /// How long a revision is fresh after its last validation.
    #[schema(value_type = Length)]
    pub stale_after: Duration,
    /// The forecast horizon that the controller lives on.
    #[schema(value_type = Length)]
    pub horizon: Duration,
    /// Whether a job is submitted as soon as newer measurements contradict what is served.
    pub refit_when_degraded: bool,
    /// Whether fits that nobody asks for forget what was measured before a parameter changed, once five days
    /// to learn from lie behind. The gate judges them as all others.
    pub forget_before_change: bool,
    /// Rules of the gate that do not hold for this system, by name (`G8 excited`, or `G9` for all that begin
    /// so), each with the reason, which the log of deeds keeps. They flag a fit and do not stop it.
    #[serde(skip_serializing_if = "Waivers::is_empty")]
    #[schema(value_type = IndexMap<String, String>)]
    pub checks: Waivers,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            mode: Mode::Auto,
            stale_after: Duration::from_days(3),
            horizon: Duration::from_hours(6),
            refit_when_degraded: true,
            forget_before_change: false,
            checks: Waivers::new(),
        }
    }
}

/// Who publishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = PolicyMode)]
pub enum Mode {
    /// The gate's acceptance is enough.
    #[default]
    Auto,
    /// An operator, on the gate's suggestion.
    Suggest,
    /// Nobody: batches leave the system out.
    Observe,
}

/// A stretch of time that is left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Exclusion {
    /// Its first instant, RFC 3339.
    #[schema(format = DateTime)]
    pub from: String,
    /// Its last instant.
    #[schema(format = DateTime)]
    pub to: String,
    /// Why.
    #[serde(default)]
    pub reason: String,
}

/// A channel that another system measures, such as the weather of a site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SharedChannel {
    /// Its name here.
    pub here: String,
    /// The system that measures it.
    pub system: SystemId,
    /// Its name there.
    pub there: String,
}

impl SystemDocument {
    /// The building that it is in: the first level of its group; empty where nobody says it.
    pub fn building(&self) -> &str {
        self.group.split('/').next().unwrap_or_default()
    }

    /// The channels that other systems share with it: bound to `site/home:T_out` instead of to a column.
    pub fn shared(&self) -> Vec<SharedChannel> {
        let shared = |(here, bound): (&str, &str)| {
            let (system, there) = shared_name(bound)?;
            Some(SharedChannel { here: here.to_owned(), system, there: there.to_owned() })
        };
        self.channels.iter().filter_map(shared).collect()
    }

    /// The columns that its channels are bound to.
    pub fn columns(&self) -> ColumnBindings {
        let mut columns = ColumnBindings::none();
        for (channel, column) in self.channels.iter().filter(|(_, bound)| shared_name(bound).is_none()) {
            columns.bind(channel, column);
        }
        columns
    }

    /// What the model is told about the place.
    pub fn site(&self) -> Site {
        Site {
            location: self.location.as_ref().and_then(|place| place.lat.zip(place.lon)),
            zone: self.location.as_ref().and_then(|place| place.zone.clone()),
            sets: self.sets(),
        }
    }

    /// The stretches of time that are left out, in milliseconds, both ends included.
    pub fn excluded(&self) -> Vec<(i64, i64)> {
        self.exclude
            .iter()
            .filter_map(|span| Some((read_time("", &span.from).ok()?, read_time("", &span.to).ok()?)))
            .collect()
    }

    /// The members of the model's sets.
    pub fn sets(&self) -> BTreeMap<String, Vec<String>> {
        let mut sets = self.sets.clone();
        if !self.neighbours.is_empty() {
            sets.insert(
                NEIGHBOURS.to_owned(),
                self.neighbours.iter().map(|neighbour| neighbour.id().to_owned()).collect(),
            );
        }
        sets
    }

    /// What this model would be bound to here; channels are left open, as windows may bring them later.
    pub fn bindings(
        &self,
        catalogue: &Catalogue,
        model: &ModelId,
    ) -> Result<lampyris_core::model::Model, Vec<Fault>> {
        let composition = catalogue.compose(model)?;
        let sets = self.sets().into_iter().filter(|(set, _)| composition.spec.sets.contains(set)).collect();
        compile(&composition, &Bindings { sets, channels: None })
    }

    /// The model, which there must be.
    ///
    /// # Errors
    /// A fault where it is a site without one.
    pub fn require_model(&self) -> Result<&ModelId, Vec<Fault>> {
        self.model.as_ref().ok_or_else(|| {
            let detail = "a site without a model only holds measurements that others share";
            vec![Fault::new("/model", "no-model", detail)]
        })
    }

    /// Faults of its model, and of what is said about the parameters of that.
    fn model_faults(&self, catalogue: &Catalogue) -> Vec<Fault> {
        let Some(model) = &self.model else { return Vec::new() };
        match self.bindings(catalogue, model) {
            Ok(model) => {
                let choices = Choices {
                    bounds: self.bounds.clone(),
                    fixed: self.fixed.clone(),
                    prior: self.prior.clone(),
                    ..EstimateRequest::default().choices()
                };
                choices.faults(&model)
            }
            Err(faults) => faults
                .into_iter()
                .map(|fault| if fault.pointer == "/model" { fault } else { at("/model", fault) })
                .collect(),
        }
    }

    /// Every fault of a document whose form is right.
    pub(super) fn faults(&self, system: &SystemId, catalogue: &Catalogue) -> Vec<Fault> {
        let mut faults = self.model_faults(catalogue);
        if let Some(place) = &self.location {
            faults.extend(place.faults());
        }
        let in_name = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
        if self.tenant.len() > LONGEST_TENANT || !self.tenant.bytes().all(in_name) {
            let detail = format!("a tenant is 1 to {LONGEST_TENANT} letters, digits, `_` and `-`");
            faults.push(Fault::new("/tenant", "invalid-name", detail));
        }
        if self.label.chars().count() > LONGEST_LABEL {
            faults.push(Fault::new(
                "/label",
                "too-long",
                format!("a label has at most {LONGEST_LABEL} characters"),
            ));
        }
        faults.extend(self.group_fault());
        for (channel, column) in self
            .channels
            .iter()
            .filter(|(channel, column)| channel.trim().is_empty() || column.trim().is_empty())
        {
            let shown: String = channel.chars().take(60).collect();
            let fault = Fault::new(
                format!("/channels/{}", shown.escape_debug()),
                "bad-binding",
                "a channel is bound to the name of a column",
            );
            faults.push(if column.trim().is_empty() {
                fault.suggest("leave the channel out: it then takes the column of its own name")
            } else {
                fault
            });
        }
        for channel in self.shared().into_iter().filter(|channel| channel.system == *system) {
            let detail = format!("`{}` is bound to a channel of the system itself", channel.here);
            let fault = Fault::new(format!("/channels/{}", channel.here), "own-channel", detail);
            faults.push(fault.suggest("bind it to the name of a column, or leave it out"));
        }
        for (index, neighbour) in self.neighbours.iter().enumerate() {
            let pointer = format!("/neighbours/{index}");
            if neighbour == system {
                faults.push(Fault::new(&pointer, "own-neighbour", "a system is not its own neighbour"));
            }
            if self.neighbours[..index].iter().any(|earlier| earlier.id() == neighbour.id()) {
                faults.push(Fault::new(
                    pointer,
                    "named-twice",
                    format!("the neighbour `{}` is named twice", neighbour.id()),
                ));
            }
        }
        faults.extend(self.set_faults(catalogue));
        if matches!(self.method, Some(SeededMethod { method: Method::Ctsm(_), .. })) {
            let detail = "`ctsm` goes with the likelihood, which a job asks for by itself";
            faults.push(Fault::new("/method/name", "contradiction", detail));
        }
        for (field, duration) in [("stale_after", self.policy.stale_after), ("horizon", self.policy.horizon)]
        {
            if duration.is_zero() {
                faults.push(Fault::new(
                    format!("/policy/{field}"),
                    "out-of-range",
                    "it must be longer than nothing",
                ));
            }
        }
        faults.extend(waiver_faults("/policy/checks", &self.policy.checks));
        for (index, exclusion) in self.exclude.iter().enumerate() {
            let from = read_time(&format!("/exclude/{index}/from"), &exclusion.from);
            let to = read_time(&format!("/exclude/{index}/to"), &exclusion.to);
            if let (Ok(from), Ok(to)) = (&from, &to)
                && from > to
            {
                faults.push(Fault::new(
                    format!("/exclude/{index}"),
                    "out-of-order",
                    "it ends before it starts",
                ));
            }
            faults.extend([from.err(), to.err()].into_iter().flatten());
        }
        faults
    }
}

impl SystemDocument {
    /// A path of a group that is too long, or whose levels are no names.
    fn group_fault(&self) -> Option<Fault> {
        if self.group.chars().count() > LONGEST_GROUP {
            let detail = format!("a group has at most {LONGEST_GROUP} characters");
            return Some(Fault::new("/group", "too-long", detail));
        }
        let is_name = |level: &str| {
            !level.is_empty() && level == level.trim() && !level.contains(|letter: char| letter.is_control())
        };
        (!self.group.is_empty() && !self.group.split('/').all(is_name)).then(|| {
            let detail = "every level of a group is a name, without spaces around it";
            Fault::new("/group", "invalid-name", detail).suggest("such as `North house/Floor 2`")
        })
    }

    /// Sets that its model does not have, and members that cannot be part of a name.
    fn set_faults(&self, catalogue: &Catalogue) -> Vec<Fault> {
        let mut faults = Vec::new();
        let Some(model) = &self.model else { return faults };
        let declared =
            catalogue.compose(model).map_or_else(|_| Vec::new(), |composition| composition.spec.sets);
        for (set, members) in &self.sets {
            let pointer = format!("/sets/{set}");
            let word = |text: &str| {
                !text.is_empty()
                    && text.len() <= 64
                    && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
            };
            if set == NEIGHBOURS {
                faults.push(
                    Fault::new(&pointer, "contradiction", "the neighbours have a field of their own")
                        .suggest("write `neighbours`"),
                );
            } else if !declared.contains(set) {
                let fault =
                    Fault::new(&pointer, "unknown-set", format!("the model `{model}` has no set `{set}`"));
                faults.push(match nearest(set, declared.iter().map(String::as_str)) {
                    Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                    None => fault,
                });
            }
            for (index, member) in members.iter().enumerate() {
                if !word(member) {
                    let detail = "a member is made of 1 to 64 letters, digits and underscores";
                    faults.push(Fault::new(format!("{pointer}/{index}"), "invalid-member", detail));
                } else if members[..index].contains(member) {
                    faults.push(Fault::new(
                        format!("{pointer}/{index}"),
                        "named-twice",
                        format!("the member `{member}` is named twice"),
                    ));
                }
            }
        }
        faults
    }
}

/// What a binding names of another system, `site/home:T_out`; `None` where it names a column.
fn shared_name(bound: &str) -> Option<(SystemId, &str)> {
    let (system, channel) = bound.split_once(':')?;
    Some((system.parse().ok()?, channel)).filter(|(_, channel)| !channel.is_empty())
}

/// The fault, found inside something that the pointer names.
pub(in crate::service) fn at(pointer: &str, fault: Fault) -> Fault {
    Fault { detail: format!("{}: {}", fault.pointer, fault.detail), pointer: pointer.to_owned(), ..fault }
}

/// Reads the document of a system that is kept.
///
/// # Errors
/// Where the row holds something else.
pub fn document(text: &str) -> Result<SystemDocument, ServiceError> {
    serde_json::from_str(text)
        .map_err(|error| ServiceError::Internal(format!("a stored system document cannot be read: {error}")))
}
