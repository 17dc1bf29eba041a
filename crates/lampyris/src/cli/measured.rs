//! The arguments that every verb on a CSV of measurements shares, and how they become a window and a model.

use super::document::{is_document, read_document};
use super::output::{Failure, document_faults, faults};
use crate::service::catalogue::models::check_model;
use jiff::civil::Date;
use lampyris_core::data::{
    ColumnBindings, DateForm, DecimalMark, DialectAsked, Duration, SplitRequest, Window, recognise,
};
use lampyris_core::estimate::problem::request::WindowRange;
use lampyris_core::estimate::{EstimateRequest, GatePolicy, Site};
use lampyris_core::model::{Catalogue, ModelId};
use std::path::{Path, PathBuf};

/// Characters of a date without a time: `2016-02-23`.
const PLAIN_DATE: usize = 10;

#[derive(Debug, clap::Args)]
pub struct MeasuredArguments {
    /// The measurements: a CSV with a column of times. Encoding, separator, decimal comma and dates are
    /// recognised; times without offset are those of the zone.
    pub window: PathBuf,
    /// The model, such as room3, room2 or tite, or the file of a model document (.toml or .json), which is
    /// known to this run alone.
    #[arg(long, default_value = "room3", value_parser = model_argument, value_name = "MODEL|FILE")]
    model: ModelArgument,
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
    /// Use measurements from this instant on; a plain date is its first moment in the zone.
    #[arg(long)]
    from: Option<String>,
    /// Use measurements up to this instant; a plain date is its first moment in the zone.
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
    /// IANA time zone, for models and effects that read the clock on the wall, and for times in the file that
    /// have no offset; UTC by default for the former.
    #[arg(long)]
    zone: Option<String>,
    /// The mark before decimals in the file, where it cannot be recognised: point or comma.
    #[arg(long)]
    decimal: Option<DecimalMark>,
    /// The form of the dates in the file, where days and months could change places: day_first, month_first.
    #[arg(long)]
    dates: Option<DateForm>,
    /// Step of the fit, such as PT4S or PT0.01S; that of the first output by default, but at least a minute.
    #[arg(long)]
    step: Option<Duration>,
    /// The forecast horizon that the fit is judged by.
    #[arg(long, default_value = "PT6H")]
    horizon: Duration,
    /// Write a report with charts: one HTML file that needs no network.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// A model as the command line names it.
#[derive(Debug, Clone)]
enum ModelArgument {
    /// One of the catalogue.
    Known(ModelId),
    /// A document.
    File(PathBuf),
}

fn model_argument(text: &str) -> Result<ModelArgument, String> {
    if is_document(Path::new(text)) {
        return Ok(ModelArgument::File(PathBuf::from(text)));
    }
    text.parse()
        .map(ModelArgument::Known)
        .map_err(|error| format!("{error}, nor a file that ends in .toml or .json"))
}

impl MeasuredArguments {
    /// Reads the file; what it warns of goes to standard error.
    pub fn read(&self) -> Result<Window, Failure> {
        let path = self.window.display();
        let body =
            std::fs::read(&self.window).map_err(|error| Failure::NotFound(format!("{path}: {error}")))?;
        let asked =
            DialectAsked { zone: self.zone.clone(), decimal: self.decimal, dates: self.dates, only: None };
        let found = recognise(&body, &asked).map_err(|found| faults(&found))?;
        let bindings =
            ColumnBindings::parse(self.bind.iter().map(String::as_str)).map_err(|found| faults(&found))?;
        let (window, report) = Window::parse_csv(&found.text, &bindings).map_err(|found| faults(&found))?;
        if let Some(summary) = found.dialect.and_then(|dialect| dialect.summary()) {
            eprintln!("{summary}");
        }
        for warning in &report.warnings {
            eprintln!("warning: {warning}");
        }
        for row in &report.rejected_rows {
            eprintln!("warning: line {} rejected: {}", row.line, row.reason);
        }
        Ok(window)
    }

    /// The model with the effects that are added and left out, and the catalogue that knows it: where it is a
    /// file, with its document, which may stand for a built-in one of the same name.
    pub fn model(&self) -> Result<(Catalogue, ModelId), Failure> {
        let mut catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
        let base = match &self.model {
            ModelArgument::Known(id) => id.clone(),
            ModelArgument::File(file) => {
                let (document, model) = check_model(&catalogue, read_document(file)?)
                    .map_err(|found| document_faults(file, &found))?;
                catalogue.add_model(document);
                model.id().clone()
            }
        };
        let with = self.with.iter().fold(base, |model, effect| model.plus(effect));
        Ok((catalogue, self.without.iter().fold(with, |model, effect| model.minus(effect))))
    }

    /// What is asked for of a model, with these parts where none are given. Who names lengths gets those and
    /// no test part beside them.
    pub fn request(&self, model: &ModelId, split: SplitRequest) -> EstimateRequest {
        let named = self.train.is_some() || self.validation.is_some();
        EstimateRequest {
            model: Some(model.clone()),
            window: Some(WindowRange {
                last: None,
                from: self.instant(self.from.as_deref()),
                to: self.instant(self.to.as_deref()),
            }),
            step: self.step,
            split: SplitRequest {
                train: self.train.unwrap_or(split.train),
                validation: self.validation.unwrap_or(split.validation),
                test: self.test.or(split.test.filter(|_| !named)),
            },
            ..EstimateRequest::default()
        }
    }

    /// What the gate demands of the fit.
    pub fn policy(&self) -> GatePolicy {
        GatePolicy { horizon: self.horizon, ..GatePolicy::default() }
    }

    /// A plain date as its first moment in the zone; anything else as it was written, for whoever reads times
    /// to judge.
    fn instant(&self, text: Option<&str>) -> Option<String> {
        let midnight = |text: &str| {
            let date: Date = text.parse().ok().filter(|_| text.len() == PLAIN_DATE)?;
            Some(date.in_tz(self.zone.as_deref().unwrap_or("UTC")).ok()?.timestamp().to_string())
        };
        text.map(|text| midnight(text).unwrap_or_else(|| text.to_owned()))
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
            sets: self
                .set
                .iter()
                .cloned()
                .chain([("neighbours".to_owned(), self.neighbours.clone())])
                .collect(),
        }
    }
}

fn set(text: &str) -> Result<(String, Vec<String>), String> {
    let (name, members) = text.split_once('=').ok_or("write SET=MEMBER,MEMBER")?;
    Ok((name.to_owned(), members.split(',').map(str::to_owned).collect()))
}

#[cfg(test)]
mod tests {
    use super::MeasuredArguments;
    use clap::Parser;
    use lampyris_core::data::SplitRequest;
    use lampyris_core::model::ModelId;

    #[derive(Parser)]
    struct Verb {
        #[command(flatten)]
        measured: MeasuredArguments,
    }

    #[test]
    fn a_plain_date_is_midnight_in_the_zone() {
        let range = |words: &[&str]| {
            let verb = Verb::parse_from(["fit", "window.csv"].iter().chain(words));
            verb.measured.request(&ModelId::unnamed(), SplitRequest::DIAGNOSE).window.unwrap()
        };
        let winter = range(&["--from", "2016-02-23", "--to", "2016-07-01", "--zone", "Europe/Copenhagen"]);
        assert_eq!(
            (winter.from.as_deref(), winter.to.as_deref()),
            (Some("2016-02-22T23:00:00Z"), Some("2016-06-30T22:00:00Z"))
        );
        assert_eq!(range(&["--from", "2016-02-23"]).from.as_deref(), Some("2016-02-23T00:00:00Z"));
        for text in ["2016-02-23T06:00:00+01:00", "2016-02-30", "yesterday"] {
            assert_eq!(range(&["--to", text]).to.as_deref(), Some(text), "it is for others to judge");
        }
    }
}
