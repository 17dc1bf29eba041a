//! What openapi.yaml says of the bodies of jobs and schedules.

use crate::store::jobs::Priority;
use lampyris_core::data::{SystemId, SystemPattern};
use lampyris_core::estimate::EstimateRequest;
use lampyris_core::schema::joined;
use std::borrow::Cow;
use utoipa::openapi::schema::{Object, OneOfBuilder};
use utoipa::openapi::{Ref, RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

/// A job for one system: an estimate, a diagnosis of what its model is missing, a ladder of effects, or a
/// tuning: settings of the search that suit it, chosen on the older windows of its record (`split.train`
/// long) and judged on the newer ones. Everything but `kind` and `system` has a default that serves.
#[derive(ToSchema)]
#[expect(dead_code, reason = "describes what `queue::request` reads")]
struct OneFields {
    #[schema(inline)]
    kind: OneWord,
    /// The system.
    system: SystemId,
    /// Never alters what is served.
    #[serde(default)]
    experiment: bool,
    /// Who goes first.
    #[serde(default)]
    priority: Priority,
}

/// The kind of a job for one system.
#[derive(ToSchema)]
#[serde(rename_all = "lowercase")]
#[expect(dead_code, reason = "describes what `queue::request` reads")]
enum OneWord {
    Estimate,
    Diagnose,
    Ladder,
    Tune,
}

/// Estimates for several systems, as a batch. Everything but `kind` and `systems` has a default that serves.
#[derive(ToSchema)]
#[expect(dead_code, reason = "describes what `queue::request` reads")]
struct RecalibrateFields {
    #[schema(inline)]
    kind: RecalibrateWord,
    /// Which systems.
    #[schema(min_items = 1)]
    systems: Vec<SystemPattern>,
    /// Who goes first.
    #[serde(default)]
    priority: Priority,
}

/// Diagnoses of several systems, as a batch. Everything but `kind` and `systems` has a default that serves.
#[derive(ToSchema)]
#[expect(dead_code, reason = "describes what `queue::request` reads")]
struct DiagnoseFields {
    #[schema(inline)]
    kind: DiagnoseWord,
    /// Which systems.
    #[schema(min_items = 1)]
    systems: Vec<SystemPattern>,
    /// Who goes first.
    #[serde(default)]
    priority: Priority,
}

/// The kind of a batch of diagnoses.
#[derive(ToSchema)]
#[serde(rename_all = "lowercase")]
#[expect(dead_code, reason = "describes what `queue::request` reads")]
enum DiagnoseWord {
    Diagnose,
}

/// The kind of a batch of estimates.
#[derive(ToSchema)]
#[serde(rename_all = "lowercase")]
#[expect(dead_code, reason = "describes what `queue::request` reads")]
enum RecalibrateWord {
    Recalibrate,
}

/// What a job is asked to do. Everything but `kind` and `system` (or `systems`) has a default that serves.
#[derive(Debug)]
pub struct JobBody;

/// What is asked of each system of a batch.
#[derive(Debug)]
pub struct BatchSettings;

/// The settings of an estimate. What is absent is filled in by the system or has a value that serves; a
/// description that named the value would lead clients to send it.
fn settings() -> Object {
    let mut settings = joined([EstimateRequest::schema()], true);
    for property in settings.properties.values_mut() {
        without_default(property);
    }
    settings
}

fn without_default(property: &mut RefOr<Schema>) {
    match property {
        RefOr::T(Schema::Object(object)) => object.default = None,
        RefOr::T(Schema::Array(array)) => array.default = None,
        RefOr::T(Schema::OneOf(one_of)) => one_of.default = None,
        RefOr::T(Schema::AllOf(all_of)) => all_of.default = None,
        RefOr::Ref(reference) => reference.default = None,
        RefOr::T(_) => {}
    }
}

/// A batch takes the model of each system, and estimates or diagnoses it.
fn batch_settings() -> Object {
    let mut settings = settings();
    settings.properties.remove("model");
    settings.properties.remove("criterion");
    settings
}

/// Only diagnoses accuse.
fn recalibration_settings() -> Object {
    let mut settings = batch_settings();
    settings.properties.remove("accusation_rate");
    settings
}

impl PartialSchema for BatchSettings {
    fn schema() -> RefOr<Schema> {
        batch_settings().into()
    }
}

impl ToSchema for BatchSettings {
    fn name() -> Cow<'static, str> {
        "BatchSettings".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        EstimateRequest::schemas(schemas);
    }
}

impl PartialSchema for JobBody {
    fn schema() -> RefOr<Schema> {
        // No discriminator: a diagnosis is of one system or of several, whatever its kind says.
        OneOfBuilder::new()
            .description(Some(
                "What a job is asked to do. Everything but `kind` and `system` (or `systems`) \
                has a default that serves.",
            ))
            .item(Ref::from_schema_name("SystemJob"))
            .item(Ref::from_schema_name("RecalibrateJob"))
            .item(Ref::from_schema_name("DiagnoseJobs"))
            .into()
    }
}

impl ToSchema for JobBody {
    fn name() -> Cow<'static, str> {
        "JobBody".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        schemas.push(("SystemJob".to_owned(), joined([OneFields::schema(), settings().into()], true).into()));
        schemas.push((
            "RecalibrateJob".to_owned(),
            joined([RecalibrateFields::schema(), recalibration_settings().into()], true).into(),
        ));
        schemas.push((
            "DiagnoseJobs".to_owned(),
            joined([DiagnoseFields::schema(), BatchSettings::schema()], true).into(),
        ));
        OneFields::schemas(schemas);
        RecalibrateFields::schemas(schemas);
        DiagnoseFields::schemas(schemas);
        EstimateRequest::schemas(schemas);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lampyris_core::estimate::problem::request::Criterion;
    use std::collections::BTreeSet;

    #[test]
    fn the_documented_settings_are_those_that_are_read() {
        let documented: BTreeSet<String> = settings().properties.keys().cloned().collect();
        // What is usual is not written into documents.
        let (delta, accusation_rate) = (0.3.try_into().unwrap(), 0.05.try_into().unwrap());
        let unusual = EstimateRequest {
            delta,
            accusation_rate,
            criterion: Criterion::Lrt,
            ..EstimateRequest::default()
        };
        let read = serde_json::to_value(unusual).unwrap();
        assert_eq!(documented, read.as_object().unwrap().keys().cloned().collect());
    }
}
