//! What strangers' bytes are put through, each as a function that panics where something is wrong.
//!
//! The fuzzers of this folder run them on bytes that they make up; the tests of the service run them on
//! `seeds`, so that they keep compiling and what was found once stays mended.

use lampyris_core::data::{
    ColumnBindings, ColumnHeader, Duration, FieldValue, Series, SystemId, SystemPattern, Window, line_points,
    read_time,
};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::parse::parse;
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::model::{Bindings, Catalogue, ModelId, compile};
use lampyris_core::units::Unit;

fn text(data: &[u8]) -> Option<&str> {
    std::str::from_utf8(data).ok()
}

/// An equation: there is a tree, or an error that says something of a place in the text.
pub fn expression(data: &[u8]) {
    if let Some(text) = text(data)
        && let Err(error) = parse(text)
    {
        assert!(error.at.line <= text.lines().count().max(1) + 1 && !error.message.is_empty(), "{error:?}");
    }
}

/// Measurements as CSV.
pub fn window_csv(data: &[u8]) {
    if let Some(text) = text(data)
        && let Ok((window, _)) = Window::parse_csv(text, &ColumnBindings::none())
    {
        is_sound(&window);
    }
}

/// Measurements as JSON.
pub fn window_json(data: &[u8]) {
    if let Ok((window, _)) = Window::parse_json(data, &ColumnBindings::none()) {
        is_sound(&window);
    }
}

/// Measurements in line protocol: every line is a point with finite numbers, or a fault that names it.
pub fn lines(data: &[u8]) {
    let Some(text) = text(data) else { return };
    let most = text.lines().count();
    let mut count = 0;
    for read in line_points(text) {
        count += 1;
        match read {
            Ok(point) => {
                assert!(!point.fields.is_empty() && (1..=most).contains(&point.line), "{point:?}");
                for (_, value) in &point.fields {
                    assert!(!matches!(value, FieldValue::Number(number) if !number.is_finite()), "{point:?}");
                }
            }
            Err(fault) => {
                assert!(fault.pointer.starts_with("line ") && !fault.detail.is_empty(), "{fault:?}")
            }
        }
    }
    assert!(count <= most);
}

/// Times rise, values are numbers, and what is kept is what came.
fn is_sound(window: &Window) {
    for series in window.iter() {
        assert!(series.times().windows(2).all(|pair| pair[0] < pair[1]));
        assert!(series.values().iter().all(|value| value.is_finite()));
        assert_eq!(Series::decode(&series.encode()).as_ref(), Ok(series));
    }
}

/// A document of a model or an effect: what is read is written as the same, and compiles or has faults.
pub fn model(data: &[u8]) {
    let Some(text) = text(data) else { return };
    let _ = EffectSpec::from_toml(text);
    let Ok(document) = ModelDocument::from_toml(text) else { return };
    if let Ok(written) = serde_json::to_value(&document) {
        assert_eq!(ModelDocument::from_json(&written).as_ref(), Ok(&document));
    }
    let mut catalogue = Catalogue::default();
    let id = document.id().parse();
    catalogue.add_model(document);
    if let Ok(id) = id
        && let Ok(composition) = catalogue.compose(&id)
    {
        let sets = [("neighbours".to_owned(), vec!["1".to_owned(), "2".to_owned()])].into();
        let _ = compile(&composition, &Bindings { sets, channels: None });
    }
}

/// The small words of requests: what is read is written as what reads the same.
pub fn words(data: &[u8]) {
    let Some(text) = text(data) else { return };
    if let Ok(system) = text.parse::<SystemId>() {
        assert_eq!(system.to_string().parse(), Ok(system));
    }
    if let Ok(model) = text.parse::<ModelId>() {
        assert_eq!(model.to_string().parse(), Ok(model));
    }
    if let Ok(duration) = text.parse::<Duration>() {
        assert_eq!(duration.to_string().parse(), Ok(duration));
    }
    let _ = text.parse::<SystemPattern>();
    let _ = read_time("", text);
    let _ = ColumnHeader::parse(text);
    let _ = Unit::parse(text);
}
