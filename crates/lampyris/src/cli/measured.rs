//! The arguments that every verb on a CSV of measurements shares, and how they become a window and a model.

use super::output::{Failure, faults};
use lampyris_core::data::{Bindings, Duration, SplitRequest, Window};
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::estimate::{EstimateRequest, Site};
use lampyris_core::model::ModelId;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Measured {
    /// The measurements: a CSV with a `time` column (RFC 3339).
    pub window: PathBuf,
    /// The model, such as room3, room2 or tite.
    #[arg(long, default_value = "room3")]
    model: ModelId,
    /// An effect to add; may be given several times.
    #[arg(long, value_name = "EFFECT")]
    with: Vec<String>,
    /// An effect to leave out; may be given several times.
    #[arg(long, value_name = "EFFECT")]
    without: Vec<String>,
    /// Take a channel from a column: T_room=T_indoor_degC.
    #[arg(long, value_name = "CHANNEL=COLUMN")]
    bind: Vec<String>,
    /// Members of the set of neighbours: 1,2,5 for the columns T_room_1, T_room_2 and T_room_5.
    #[arg(long, value_delimiter = ',')]
    neighbours: Vec<String>,
    /// Members of another set of the model: zones=north,south.
    #[arg(long, value_name = "SET=MEMBERS", value_parser = set)]
    set: Vec<(String, Vec<String>)>,
    /// Use measurements from this instant on.
    #[arg(long)]
    from: Option<String>,
    /// Use measurements up to this instant.
    #[arg(long)]
    to: Option<String>,
    /// Length of the training part, such as P14D or PT500H.
    #[arg(long)]
    train: Option<Duration>,
    /// Length of the validation part.
    #[arg(long)]
    validation: Option<Duration>,
    /// Length of the test part.
    #[arg(long)]
    test: Option<Duration>,
    /// Latitude in degrees, for the position of the sun.
    #[arg(long, requires = "lon", allow_hyphen_values = true)]
    lat: Option<f64>,
    /// Longitude in degrees.
    #[arg(long, requires = "lat", allow_hyphen_values = true)]
    lon: Option<f64>,
    /// IANA time zone, for models and effects that read the clock on the wall; UTC by default.
    #[arg(long)]
    zone: Option<String>,
    /// Write a report with charts: one HTML file that needs no network.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

impl Measured {
    /// Reads the file; what it warns of goes to standard error.
    pub fn read(&self) -> Result<Window, Failure> {
        let path = self.window.display();
        let text = std::fs::read_to_string(&self.window).map_err(|error| Failure::NotFound(format!("{path}: {error}")))?;
        let bindings = Bindings::parse(self.bind.iter().map(String::as_str)).map_err(|found| faults(&found))?;
        let (window, report) = Window::parse_csv(&text, &bindings).map_err(|found| faults(&found))?;
        for warning in &report.warnings {
            eprintln!("warning: {warning}");
        }
        for row in &report.rejected_rows {
            eprintln!("warning: line {} rejected: {}", row.line, row.reason);
        }
        Ok(window)
    }

    /// The model with the effects that are added and left out.
    pub fn model(&self) -> ModelId {
        let with = self.with.iter().fold(self.model.clone(), |model, effect| model.plus(effect));
        self.without.iter().fold(with, |model, effect| model.minus(effect))
    }

    /// What is asked for, with these parts where none are given. Who names lengths gets those and no test part beside them.
    pub fn request(&self, split: SplitRequest) -> EstimateRequest {
        let named = self.train.is_some() || self.validation.is_some();
        EstimateRequest {
            model: Some(self.model()),
            window: Some(WindowRange { last: None, from: self.from.clone(), to: self.to.clone() }),
            split: SplitRequest {
                train: self.train.unwrap_or(split.train),
                validation: self.validation.unwrap_or(split.validation),
                test: self.test.or(split.test.filter(|_| !named)),
            },
            ..EstimateRequest::default()
        }
    }

    /// Where a report is to be written.
    pub fn report(&self) -> Option<&Path> {
        self.report.as_deref()
    }

    /// What is known about the place.
    pub fn site(&self) -> Site {
        Site {
            location: self.lat.zip(self.lon),
            zone: self.zone.clone(),
            sets: self.set.iter().cloned().chain([("neighbours".to_owned(), self.neighbours.clone())]).collect(),
        }
    }
}

fn set(text: &str) -> Result<(String, Vec<String>), String> {
    let (name, members) = text.split_once('=').ok_or("write SET=MEMBER,MEMBER")?;
    Ok((name.to_owned(), members.split(',').map(str::to_owned).collect()))
}
