//! Which series of a Prometheus, or of whatever answers as it does, are measurements of which systems.

use super::line_rules::{LineRouter, LineRule, LineRules};
use crate::service::decode;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::sources::SourceRecord;
use lampyris_core::data::{Duration, FieldValue, Length, LinePoint};
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::borrow::Cow;
use utoipa::ToSchema;

/// What the store calls the document.
const SOURCE: &str = "prometheus";
const MOST_QUERIES: usize = 100;
/// Longest query and longest address, in bytes.
const LONGEST: usize = 4_096;
/// How often is asked, and how far back a start looks.
const EVERY: [Duration; 2] = [Duration::from_seconds(10), Duration::from_days(1)];
const LOOKBACK: [Duration; 2] = [Duration::ZERO, Duration::from_days(31)];
const STEP: [Duration; 2] = [Duration::from_seconds(1), Duration::from_hours(1)];
/// The name of a series, among its labels.
const NAME: &str = "__name__";

/// A Prometheus that is asked now and then, and what its series mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PrometheusSource {
    /// Its address, without `/api/v1`: `http://prometheus:9090`.
    #[schema(example = "http://prometheus:9090")]
    pub url: String,
    /// What is asked for, in PromQL; nothing is asked where there is none.
    #[schema(max_items = 100)]
    pub queries: Vec<String>,
    /// How often.
    #[serde(default = "a_minute")]
    #[schema(value_type = Length, example = "PT1M")]
    pub every: Duration,
    /// The time between two values of a series.
    #[serde(default = "a_minute")]
    #[schema(value_type = Length, example = "PT1M")]
    pub step: Duration,
    /// How far back the first question after a start or a change reaches.
    #[serde(default = "an_hour")]
    #[schema(example = "PT1H")]
    pub lookback: Duration,
    /// Which values are which channels: `measurement` is the name of a series, `tags` are its labels, and the
    /// field is `value`.
    #[schema(max_items = 1000)]
    pub rules: Vec<LineRule>,
}

fn a_minute() -> Duration {
    Duration::from_seconds(60)
}

fn an_hour() -> Duration {
    Duration::from_hours(1)
}

impl PrometheusSource {
    /// The rules.
    pub fn rules(&self) -> LineRules {
        LineRules { rules: self.rules.clone() }
    }

    fn faults(&self) -> Vec<Fault> {
        let mut faults = LineRouter::of(&self.rules()).err().unwrap_or_default();
        let host = ["http://", "https://"].iter().find_map(|scheme| self.url.strip_prefix(scheme));
        if host.is_none_or(|host| host.is_empty() || host.contains(['@', '?', '#']))
            || self.url.len() > LONGEST
        {
            let detail = "an address is http://HOST:PORT or https://HOST:PORT, without names and passwords";
            faults.push(Fault::new("/url", "bad-address", detail));
        }
        if self.queries.len() > MOST_QUERIES {
            let detail = format!("{} queries, where {MOST_QUERIES} are possible", self.queries.len());
            faults.push(Fault::new("/queries", "too-many", detail));
        }
        for (place, query) in self.queries.iter().enumerate().take(MOST_QUERIES) {
            if query.trim().is_empty() || query.len() > LONGEST {
                let detail = format!("a query has 1 to {LONGEST} bytes");
                faults.push(Fault::new(format!("/queries/{place}"), "bad-query", detail));
            }
        }
        for (field, asked, [least, most]) in
            [("every", self.every, EVERY), ("step", self.step, STEP), ("lookback", self.lookback, LOOKBACK)]
        {
            if !(least..=most).contains(&asked) {
                let detail = format!("{asked} is not between {least} and {most}");
                let code = if asked < least { "too-short" } else { "too-long" };
                faults.push(Fault::new(format!("/{field}"), code, detail));
            }
        }
        faults
    }
}

/// The document as it is kept; `None` where nobody has written one.
///
/// # Errors
/// Where the database fails, or what it holds is no such document.
pub(crate) async fn get(service: &Service) -> Result<Option<(PrometheusSource, SourceRecord)>, ServiceError> {
    let Some(record) = store::sources::get(&service.store, SOURCE).await? else { return Ok(None) };
    let source = serde_json::from_value(record.document.clone())
        .map_err(|error| ServiceError::Internal(format!("the source `{SOURCE}`: {error}")))?;
    Ok(Some((source, record)))
}

/// Replaces the document. It is asked at once.
///
/// # Errors
/// Every fault of the document, or where the database fails.
pub(crate) async fn put(service: &Service, body: Value, who: &str) -> Result<(), ServiceError> {
    let mut read = decode::read::<PrometheusSource>(body, &Value::Null);
    let faults = read.document.as_ref().map(PrometheusSource::faults);
    read.add(faults.unwrap_or_default());
    let source = read.finish().map_err(ServiceError::Faults)?;
    let text = serde_json::to_string(&source).map_err(|error| ServiceError::Internal(error.to_string()))?;
    store::sources::put(&service.store, SOURCE, &text, who, service.now()).await?;
    service.pulls.changed();
    Ok(())
}

/// The series of an answer of `query_range`, as points with the field `value`, whose times are milliseconds.
///
/// # Errors
/// A sentence where it is no such answer, or tells an error.
pub fn points(answer: &Value) -> Result<Vec<LinePoint<'_>>, String> {
    if answer["status"] != "success" {
        let said = answer["error"].as_str().unwrap_or("it says no more");
        return Err(format!("the answer is no success: {}", said.chars().take(200).collect::<String>()));
    }
    let series = answer.pointer("/data/result").and_then(Value::as_array);
    let Some(series) = series.filter(|_| answer.pointer("/data/resultType") == Some(&"matrix".into())) else {
        return Err("the answer is no matrix: a query gives series over time".to_owned());
    };
    let mut points = Vec::new();
    for one in series {
        let labels = one["metric"].as_object();
        let text = |value: &'static str| Cow::Borrowed(value);
        let labels =
            || labels.into_iter().flatten().filter_map(|(label, value)| Some((label, value.as_str()?)));
        let name =
            labels().find(|(label, _)| *label == NAME).map_or(text(""), |(_, name)| Cow::Borrowed(name));
        let tags: Vec<(Cow<'_, str>, Cow<'_, str>)> = labels()
            .filter(|(label, _)| *label != NAME)
            .map(|(label, value)| (Cow::Borrowed(label.as_str()), Cow::Borrowed(value)))
            .collect();
        for value in one["values"].as_array().into_iter().flatten() {
            let number = value[1].as_str().and_then(|number| number.parse::<f64>().ok());
            let (Some(time), Some(number)) = (value[0].as_f64(), number.filter(|number| number.is_finite()))
            else {
                continue;
            };
            points.push(LinePoint {
                line: points.len() + 1,
                measurement: name.clone(),
                tags: tags.clone(),
                fields: vec![(text("value"), FieldValue::Number(number))],
                time: Some((1_000.0 * time).round() as i64),
            });
        }
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::{PrometheusSource, points};
    use lampyris_core::data::FieldValue;
    use serde_json::json;

    #[test]
    fn an_answer_is_points_by_name_labels_and_time() {
        let answer = json!({"status": "success", "data": {"resultType": "matrix", "result": [
            {"metric": {"__name__": "room_celsius", "room": "4"}, "values": [[1_767_571_200.5, "20.5"], [1_767_571_260, "NaN"]]},
            {"metric": {}, "values": [[1_767_571_200, "1e3"]]},
        ]}});
        let found = points(&answer).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!((&*found[0].measurement, found[0].tag("room")), ("room_celsius", Some("4")));
        assert_eq!(found[0].time, Some(1_767_571_200_500));
        assert_eq!((&*found[1].measurement, &found[1].fields[0].1), ("", &FieldValue::Number(1000.0)));
        for (wrong, says) in [
            (json!({"status": "error", "error": "parse error"}), "parse error"),
            (json!({"status": "success", "data": {"resultType": "vector", "result": []}}), "no matrix"),
            (json!([]), "no success"),
        ] {
            assert!(points(&wrong).unwrap_err().contains(says), "{wrong}");
        }
    }

    #[test]
    fn every_fault_of_a_source_is_named() {
        let source: PrometheusSource = serde_json::from_value(json!({
            "url": "http://me:secret@host", "queries": [" "], "every": "PT1S", "lookback": "P99D",
            "rules": [{"system": "room", "channel": "T_room"}]
        }))
        .unwrap();
        let faults = source.faults();
        let places: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(places, ["/rules/0/system", "/url", "/queries/0", "/every", "/lookback"]);
    }
}
