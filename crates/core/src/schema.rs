//! What openapi.yaml says of names, lengths of time and joined objects. Other documents derive what it says
//! of them, so that the description cannot say anything else than what is read and written.

use utoipa::openapi::schema::{
    AdditionalProperties, AllOf, ArrayBuilder, KnownFormat, Object, ObjectBuilder, SchemaFormat, SchemaType,
    Type,
};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

/// A text of a form that is given as a regular expression (ECMA-262).
pub fn text(form: &str) -> ObjectBuilder {
    ObjectBuilder::new().schema_type(SchemaType::Type(Type::String)).pattern(Some(form))
}

/// Describes a type that is read from a text of a certain form.
macro_rules! is_text {
    ($type:ty, $name:literal, $form:expr, $example:literal, $description:literal) => {
        impl utoipa::PartialSchema for $type {
            fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::Schema> {
                $crate::schema::text($form).examples([$example]).description(Some($description)).into()
            }
        }

        impl utoipa::ToSchema for $type {
            fn name() -> std::borrow::Cow<'static, str> {
                $name.into()
            }
        }
    };
}
pub(crate) use is_text;

/// One of these words.
pub fn word(words: impl IntoIterator<Item = &'static str>, description: &str) -> RefOr<Schema> {
    let text = ObjectBuilder::new().schema_type(SchemaType::Type(Type::String));
    text.enum_values(Some(words)).description(Some(description)).into()
}

/// What the description calls a pair of numbers, the lower one first.
#[derive(Debug, Clone, Copy)]
pub struct Interval;

impl PartialSchema for Interval {
    fn schema() -> RefOr<Schema> {
        let number = ObjectBuilder::new()
            .schema_type(SchemaType::Type(Type::Number))
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Double)));
        let pair = ArrayBuilder::new().items(number).min_items(Some(2)).max_items(Some(2));
        pair.description(Some("Lower and upper end.")).into()
    }
}

impl ToSchema for Interval {}

/// What the description calls a point in time.
#[derive(Debug, Clone, Copy)]
pub struct Instant;

impl PartialSchema for Instant {
    fn schema() -> RefOr<Schema> {
        let text = ObjectBuilder::new()
            .schema_type(SchemaType::Type(Type::String))
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::DateTime)));
        text.description(Some("An instant, RFC 3339 with offset.")).into()
    }
}

impl ToSchema for Instant {}

/// What the description calls measurements that are sent as CSV. A client sends it as it is, from a file.
#[derive(Debug, Clone, Copy)]
pub struct Csv;

impl PartialSchema for Csv {
    fn schema() -> RefOr<Schema> {
        let text = ObjectBuilder::new()
            .schema_type(SchemaType::Type(Type::String))
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)));
        text.description(Some("A CSV file: a column `time`, and one for each channel.")).into()
    }
}

impl ToSchema for Csv {}

/// What the description calls the inputs of a check. They have a name of their own, because generators of
/// clients lose maps that stand in one of several alternatives.
#[derive(Debug, Clone, Copy)]
pub struct CheckInputs;

impl PartialSchema for CheckInputs {
    fn schema() -> RefOr<Schema> {
        let number = ObjectBuilder::new()
            .schema_type(SchemaType::Type(Type::Number))
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Double)));
        let values = ObjectBuilder::new().additional_properties(Some(number));
        values.description(Some("A value for each of these inputs, in its unit.")).into()
    }
}

impl ToSchema for CheckInputs {}

/// One object that has the fields of all of these, and no others if `closed`. `allOf` says the same of open
/// objects only: each closed one forbids the fields of the others.
pub fn joined(parts: impl IntoIterator<Item = RefOr<Schema>>, closed: bool) -> Object {
    let mut whole = Object::with_type(Type::Object);
    let mut others = None;
    for part in parts {
        let object = match part {
            RefOr::T(Schema::Object(object)) => object,
            RefOr::T(Schema::AllOf(all_of)) => flattened(all_of),
            _ => continue,
        };
        whole.description = whole.description.or(object.description);
        whole.properties.extend(object.properties);
        whole.required.extend(object.required);
        // What a part says of fields that it does not name holds for the whole; that it has none does not.
        if let Some(AdditionalProperties::RefOr(_)) = object.additional_properties.as_deref() {
            others = object.additional_properties;
        }
    }
    let none = || Box::new(AdditionalProperties::FreeForm(false));
    whole.additional_properties = if closed { Some(none()) } else { others };
    whole
}

/// A struct with flattened fields as the one object that is written: `allOf` lists those fields first, and
/// what the struct has by itself last.
pub fn flattened(mut all_of: AllOf) -> Object {
    let own = all_of.items.pop();
    let mut whole = joined(own.into_iter().chain(all_of.items), false);
    whole.description = all_of.description.or(whole.description);
    whole
}
