//! What openapi.yaml says of the bodies of jobs and schedules.

use super::request::{BatchJob, SystemJob};
use crate::store::batches::BatchKind;
use lampyris_core::estimate::EstimateRequest;
use lampyris_core::schema::{joined, word};
use std::borrow::Cow;
use utoipa::openapi::schema::{Object, ObjectBuilder, OneOfBuilder};
use utoipa::openapi::{Ref, RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

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

/// A batch of one kind.
fn batch_job(kind: BatchKind, kind_is: &str, is: &str, settings: Object) -> RefOr<Schema> {
    let kind = ObjectBuilder::new().property("kind", word([kind.as_str()], kind_is)).required("kind");
    let kind = kind.description(Some(is)).into();
    joined([kind, BatchJob::schema(), settings.into()], true).into()
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
        let one = joined([SystemJob::schema(), settings().into()], true);
        schemas.push(("SystemJob".to_owned(), one.into()));
        let recalibrate = batch_job(
            BatchKind::Recalibrate,
            "The kind of a batch of estimates.",
            "Estimates for several systems, as a batch. Everything but `kind` and `systems` has a default \
            that serves.",
            recalibration_settings(),
        );
        schemas.push(("RecalibrateJob".to_owned(), recalibrate));
        let diagnose = batch_job(
            BatchKind::Diagnose,
            "The kind of a batch of diagnoses.",
            "Diagnoses of several systems, as a batch. Everything but `kind` and `systems` has a default \
            that serves.",
            batch_settings(),
        );
        schemas.push(("DiagnoseJobs".to_owned(), diagnose));
        SystemJob::schemas(schemas);
        BatchJob::schemas(schemas);
        EstimateRequest::schemas(schemas);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lampyris_core::data::Duration;
    use lampyris_core::estimate::problem::request::{Criterion, SearchExtent};
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
            search: SearchExtent::Local,
            step: Some(Duration::from_hours(1)),
            ..EstimateRequest::default()
        };
        let read = serde_json::to_value(unusual).unwrap();
        assert_eq!(documented, read.as_object().unwrap().keys().cloned().collect());
    }
}
