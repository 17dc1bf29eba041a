//! Measured houses, as the cases speak of them.

use flate2::read::GzDecoder;
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::{EstimateRequest, Problem, Site, prepare};
use lampyris_core::model::{Catalogue, ModelId};
use serde::Deserialize;
use std::io::Read;
use std::path::Path;

/// A measured house with a model of it, and what is asked.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct House {
    /// A file of `config/demo`, or one of `data/rooms` beside the project, packed or not.
    file: String,
    pub model: ModelId,
    /// Texts such as `T_room=T_indoor_degC`.
    binds: Vec<String>,
    location: Option<(f64, f64)>,
    #[serde(default)]
    pub ask: EstimateRequest,
}

impl House {
    /// Its measurements; says so where they are not there, because they may not be part of the project.
    pub fn csv(&self) -> Option<String> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        std::fs::read_to_string(root.join("config/demo").join(&self.file)).ok().or_else(|| beside(&self.file))
    }

    pub fn window(&self, csv: &str) -> Window {
        let bindings = ColumnBindings::parse(self.binds.iter().map(String::as_str)).unwrap();
        Window::parse_csv(csv, &bindings).unwrap().0
    }

    pub fn site(&self) -> Site {
        Site { location: self.location, ..Site::default() }
    }

    /// What is asked of it; nothing where its measurements are not there.
    pub fn problem(&self) -> Option<Problem> {
        let window = self.window(&self.csv()?);
        let catalogue = Catalogue::builtin().unwrap();
        Some(prepare(&catalogue, &self.model, &self.ask, &window, &self.site()).unwrap())
    }
}

/// A file of `data/rooms` beside the project, packed or not; says so where it is not there.
pub fn beside(file: &str) -> Option<String> {
    let rooms = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/rooms");
    let Ok(bytes) = std::fs::read(rooms.join(file)) else {
        println!("SKIPPED: {file} may not be copied into the project and is not beside it");
        return None;
    };
    let mut text = String::new();
    match bytes.starts_with(&[0x1f, 0x8b]) {
        true => GzDecoder::new(bytes.as_slice()).read_to_string(&mut text).unwrap(),
        false => bytes.as_slice().read_to_string(&mut text).unwrap(),
    };
    Some(text)
}
