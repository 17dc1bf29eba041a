//! Which values of the line protocol are measurements of which systems: rules that an operator writes.

use super::pattern::Pattern;
use crate::service::decode;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::sources::SourceRecord;
use indexmap::IndexMap;
use lampyris_core::data::{ChannelIntake, LinePoint, SystemId};
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// What the store calls the rules.
const SOURCE: &str = "influx";
/// Most rules.
const MOST_RULES: usize = 1000;
/// Longest channel and longest pattern, in bytes.
const LONGEST: usize = 256;

/// Rules by which values become measurements. The first one that takes a value counts.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LineRules {
    /// The rules, in their order; at most 1000.
    #[schema(max_items = 1000)]
    pub rules: Vec<LineRule>,
}

/// A rule. Each of its texts may have places in braces: in `measurement`, `tags` and `field` they take what
/// stands there, in `system` and `channel` they give it again. A place that none of them takes stands for the
/// whole tag of its name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LineRule {
    /// The measurement; any where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "°C")]
    pub measurement: Option<String>,
    /// Tags that must be there, and how they read.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    #[schema(example = json!({"entity_id": "{room}_temperature"}))]
    pub tags: IndexMap<String, String>,
    /// The field.
    #[serde(default = "value")]
    #[schema(default = "value")]
    pub field: String,
    /// The system.
    #[schema(example = "room/{room}")]
    pub system: String,
    /// The channel, by the name that models read.
    #[schema(example = "T_room")]
    pub channel: String,
    /// The unit of the values; that of the channel where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "degC")]
    pub unit: Option<String>,
}

fn value() -> String {
    "value".to_owned()
}

/// Rules, read.
#[derive(Debug, Default)]
pub struct LineRouter(Vec<Route>);

#[derive(Debug)]
struct Route {
    measurement: Option<Pattern>,
    tags: Vec<(String, Pattern)>,
    field: Pattern,
    system: Pattern,
    channel: Pattern,
    unit: Option<String>,
}

/// Where a value belongs, as a rule says it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Destination<'a> {
    /// The system, which may be none.
    pub system: String,
    /// The channel.
    pub channel: String,
    /// The unit of the value.
    pub unit: Option<&'a str>,
}

impl LineRouter {
    /// Reads rules.
    ///
    /// # Errors
    /// Every fault of them.
    pub fn of(rules: &LineRules) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        if rules.rules.len() > MOST_RULES {
            let detail = format!("{} rules, where {MOST_RULES} are possible", rules.rules.len());
            return Err(vec![Fault::new("/rules", "too-many-rules", detail)]);
        }
        let read = |(place, rule)| route(place, rule, &mut faults);
        let routes: Vec<Route> = rules.rules.iter().enumerate().filter_map(read).collect();
        if faults.is_empty() { Ok(Self(routes)) } else { Err(faults) }
    }

    /// Where the value of a field belongs; `None` where no rule takes it.
    pub fn destination(&self, point: &LinePoint<'_>, field: &str) -> Option<Destination<'_>> {
        self.0.iter().find_map(|route| route.destination(point, field))
    }
}

impl Route {
    fn destination(&self, point: &LinePoint<'_>, field: &str) -> Option<Destination<'_>> {
        let mut found = BTreeMap::new();
        let takes = self.field.takes(field, &mut found)
            && self.measurement.as_ref().is_none_or(|pattern| pattern.takes(&point.measurement, &mut found))
            && self
                .tags
                .iter()
                .all(|(tag, pattern)| point.tag(tag).is_some_and(|value| pattern.takes(value, &mut found)));
        if !takes {
            return None;
        }
        let known = |name: &str| found.get(name).copied().or_else(|| point.tag(name));
        let (system, channel) = (self.system.filled(known)?, self.channel.filled(known)?);
        Some(Destination { system, channel, unit: self.unit.as_deref() })
    }
}

/// Reads a rule; where something is wrong with it, all of that.
fn route(place: usize, rule: &LineRule, faults: &mut Vec<Fault>) -> Option<Route> {
    let before = faults.len();
    let at = |field: &str| format!("/rules/{place}/{field}");
    let mut pattern = |field: &str, text: &str| {
        let read = if text.len() > LONGEST {
            Err(format!("a text of a rule has at most {LONGEST} bytes"))
        } else if text.is_empty() {
            Err("a text of a rule is not empty".to_owned())
        } else {
            Pattern::parse(text)
        };
        read.map_err(|detail| faults.push(Fault::new(at(field), "bad-pattern", detail))).ok()
    };
    let measurement = rule.measurement.as_ref().map(|text| pattern("measurement", text));
    let tags: Vec<Option<(String, Pattern)>> = rule
        .tags
        .iter()
        .map(|(tag, text)| pattern(&format!("tags/{tag}"), text).map(|pattern| (tag.clone(), pattern)))
        .collect();
    let field = pattern("field", &rule.field);
    let system = pattern("system", &rule.system);
    let channel = pattern("channel", &rule.channel);
    if let Some(Err(error)) = system.as_ref().and_then(Pattern::fixed).map(str::parse::<SystemId>) {
        faults.push(Fault::new(at("system"), "bad-pattern", error.to_string()));
    }
    // Of a channel that is put together only the unit can be read before there is a point.
    let named = channel.as_ref().and_then(Pattern::fixed).unwrap_or("any");
    if let Err(fault) = ChannelIntake::new(named, rule.unit.as_deref()) {
        faults.push(Fault { pointer: at("unit"), ..fault });
    }
    (faults.len() == before).then_some(())?;
    Some(Route {
        measurement: measurement.flatten(),
        tags: tags.into_iter().flatten().collect(),
        field: field?,
        system: system?,
        channel: channel?,
        unit: rule.unit.clone(),
    })
}

/// The rules as they are kept; none at first.
///
/// # Errors
/// Where the database fails, or what it holds are no rules.
pub(crate) async fn get(service: &Service) -> Result<(LineRules, Option<SourceRecord>), ServiceError> {
    let Some(record) = store::sources::get(&service.store, SOURCE).await? else {
        return Ok((LineRules::default(), None));
    };
    let rules = serde_json::from_value(record.document.clone())
        .map_err(|error| ServiceError::Internal(format!("the rules of the line protocol: {error}")))?;
    Ok((rules, Some(record)))
}

/// Replaces the rules. They count from the next write on.
///
/// # Errors
/// Every fault of the document, or where the database fails.
pub(crate) async fn put(service: &Service, body: Value, who: &str) -> Result<(), ServiceError> {
    let mut read = decode::read::<LineRules>(body, &Value::Null);
    let faults = read.document.as_ref().and_then(|rules| LineRouter::of(rules).err());
    read.add(faults.into_iter().flatten());
    let rules = read.finish().map_err(ServiceError::Faults)?;
    let text = serde_json::to_string(&rules).map_err(|error| ServiceError::Internal(error.to_string()))?;
    store::sources::put(&service.store, SOURCE, &text, who, service.now()).await?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lampyris_core::data::line_points;
    use serde_json::json;

    fn router(rules: Value) -> Result<LineRouter, Vec<Fault>> {
        LineRouter::of(&serde_json::from_value(json!({ "rules": rules })).unwrap())
    }

    fn sent(router: &LineRouter, line: &str) -> Option<(String, String)> {
        let point = line_points(line).next().unwrap().unwrap();
        let field = point.fields[0].0.clone();
        router.destination(&point, &field).map(|to| (to.system, to.channel))
    }

    #[test]
    fn one_rule_serves_many_rooms_and_the_first_that_takes_a_value_counts() {
        let router = router(json!([
            {"measurement": "°C", "tags": {"entity_id": "outdoor"}, "system": "site/home", "channel": "T_out"},
            {"measurement": "°C", "tags": {"entity_id": "{room}_temperature"},
             "system": "room/{room}", "channel": "T_room"},
            {"tags": {"topic": "home/{room}/{what}"}, "field": "{f}", "system": "room/{room}",
             "channel": "{what}_{f}"},
            {"measurement": "power", "field": "w", "system": "room/{host}", "channel": "P_heater", "unit": "W"},
        ]))
        .unwrap();
        let to = |system: &str, channel: &str| Some((system.to_owned(), channel.to_owned()));
        let entity = |id: &str| format!("°C,domain=sensor,entity_id={id} value=20");
        assert_eq!(sent(&router, &entity("outdoor")), to("site/home", "T_out"));
        assert_eq!(sent(&router, &entity("living_room_temperature")), to("room/living_room", "T_room"));
        assert_eq!(sent(&router, &entity("humidity")), None);
        assert_eq!(sent(&router, "%,entity_id=x_temperature value=1"), None);
        assert_eq!(sent(&router, "mqtt,topic=home/bath/T value=1"), to("room/bath", "T_value"));
        assert_eq!(sent(&router, "power,host=attic w=1"), to("room/attic", "P_heater"));
        // The place is a tag that is not there.
        assert_eq!(sent(&router, "power w=1"), None);
    }

    #[test]
    fn every_fault_of_rules_is_named() {
        let found = router(json!([
            {"system": "room", "channel": "T_room", "unit": "furlong"},
            {"system": "room/{a", "channel": "", "tags": {"x": "{a}{b}"}, "field": "}"},
            {"system": "room/1", "channel": "T_room", "unit": "kW"},
            {"system": "room/1", "channel": "T_room", "unit": "degF"},
        ]))
        .unwrap_err();
        let seen: Vec<(&str, &str)> =
            found.iter().map(|fault| (fault.pointer.as_str(), fault.code.as_str())).collect();
        assert_eq!(
            seen,
            [
                ("/rules/0/system", "bad-pattern"),
                ("/rules/0/unit", "unknown-unit"),
                ("/rules/1/tags/x", "bad-pattern"),
                ("/rules/1/field", "bad-pattern"),
                ("/rules/1/system", "bad-pattern"),
                ("/rules/1/channel", "bad-pattern"),
                ("/rules/2/unit", "inconvertible-unit"),
            ]
        );
    }
}
