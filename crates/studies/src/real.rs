//! Real rooms with a known driver withheld: is it named, do forecasts of the two weeks after fall, and are
//! the channels of other days accused?

pub mod bands;
pub mod priors;
pub mod proposals;
mod rooms;

use super::file::write;
use super::options::{Each, Html, Only};
use super::page::{self, NONE, STYLE, Table, section};
use super::row::Row;
use super::verdicts::share;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{Column, ColumnBindings, DAY, Grid, HOUR, Window, is_computed, rfc3339};
use lampyris_core::diagnose::diagnose;
use lampyris_core::diagnose::library::{EffectSource, align};
use lampyris_core::diagnose::null_model::NullModel;
use lampyris_core::diagnose::report::Finding;
use lampyris_core::diagnose::surrogates::{Heard, Tests, is_driven};
use lampyris_core::estimate::assess::metrics::{ProcessNoise, ahead, filter};
use lampyris_core::estimate::problem::request::{AccusationRate, WindowRange};
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Problem, Site, estimate, prepare};
use lampyris_core::model::{Catalogue, ModelId};
use rayon::prelude::*;
use rooms::{BELGIAN, ROOMS, Room};
use std::fmt::Display;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Days of a window, half of them to learn from.
const DAYS: i64 = 14;
/// Records of at most so many days are also looked at as a whole, two thirds of them to learn from: what is
/// seen on few days, as people in a teaching room, is not seen in every window.
const SHORT_DAYS: i64 = 35;
/// Hours ahead of the forecasts of the days after.
const AHEAD: [(&str, i64); 2] = [("PT6H", 6 * HOUR), ("PT12H", 12 * HOUR)];
/// Shifts of the channels of every window, as true negatives.
const SHIFTS: i64 = 6;
/// Accusation rates at which the negatives are counted.
const RATES: [f64; 3] = [0.001, 0.01, 0.05];

/// A part of a room's record, in milliseconds since 1970 and hours.
#[derive(Clone, Copy)]
struct Part {
    from: i64,
    hours: i64,
    /// Hours of it to learn from.
    train: i64,
    whole: bool,
}

impl Part {
    fn window(from: i64) -> Self {
        Part { from, hours: 24 * DAYS, train: 12 * DAYS, whole: false }
    }

    fn whole(from: i64, to: i64) -> Self {
        let hours = (to - from) / HOUR;
        Part { from, hours, train: 2 * hours / 3, whole: true }
    }

    fn to(&self) -> i64 {
        self.from + HOUR * self.hours
    }
}

/// What came of a window.
struct Judged {
    whole: bool,
    named: bool,
    driven: bool,
    decoy: bool,
    /// Errors so far ahead on the two weeks after, without and with what was named first.
    after: Option<[[f64; 2]; AHEAD.len()]>,
    /// Candidates with channels of other days, and how many of them are accused at each rate.
    negatives: usize,
    accused: [usize; 3],
    /// Its line of the table.
    cells: Vec<String>,
}

const HEAD: [&str; 13] = [
    "room",
    "window",
    "withheld",
    "named first",
    "named",
    "over",
    "share",
    "t",
    "chance",
    "p of shifts",
    "lost 12 h ahead without it",
    "error 6 and 12 h ahead, two weeks after",
    "accused of other days at .001, .01, .05",
];

// A comment of the documentation would become the text of the command that has these options.
#[derive(Debug, clap::Args)]
struct MeasuredRooms {
    /// The folder of measured rooms.
    #[arg(long, value_name = "FOLDER", default_value = "../shared/data/rooms")]
    data: PathBuf,
    #[command(flatten)]
    only: Only,
}

impl MeasuredRooms {
    fn rooms(&self) -> impl Iterator<Item = &'static Room> {
        ROOMS.iter().filter(|room| self.only.only.as_deref().is_none_or(|only| room.name.contains(only)))
    }

    /// All that was measured in a room.
    fn window(&self, room: &Room) -> Result<Window, Failure> {
        let bindings = ColumnBindings::parse(room.binds.iter().copied()).map_err(|found| faults(&found))?;
        let text = read(&self.data.join(room.file))?;
        Ok(Window::parse_csv(&text, &bindings).map_err(|found| faults(&found))?.0)
    }
}

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredRooms,
    #[command(flatten)]
    each: Each,
    #[command(flatten)]
    html: Html,
}

/// Diagnoses every window of every room below a folder: the figures, and a line for every window, on a page
/// where asked to.
pub fn run(asked: &Arguments) -> Result<(Vec<Row>, Table), Failure> {
    let (each, html) = (asked.each.each, asked.html.html.as_deref());
    let mut judged = Vec::new();
    for room in asked.measured.rooms() {
        let window = asked.measured.window(room)?;
        for part in parts(room, &window) {
            judged.push(judge(room, &window, part)?);
            if let Some(one) = judged.last().filter(|_| each) {
                eprintln!("{}", one.cells.join("  "));
            }
        }
    }
    let rows = rows(&judged);
    let windows = Table {
        id: "windows",
        title: "Windows of measured rooms with a known driver withheld".to_owned(),
        note: format!(
            "Windows of {DAYS} days, half of them to learn from, and records of up to {SHORT_DAYS} days as a \
            whole, two thirds of them to learn from. Evidence is that of what was named first, and the \
            chance that of anything being shown so clearly where nothing is missing; of the channels of \
            other days none should be accused."
        ),
        head: HEAD.map(str::to_owned).to_vec(),
        rows: judged.into_iter().map(|one| one.cells).collect(),
    };
    if let Some(file) = html {
        write(file, &document(&rows, &windows)?)?;
    }
    Ok((rows, windows))
}

/// The windows of a room, and a short record as a whole.
fn parts(room: &Room, window: &Window) -> Vec<Part> {
    // The windows of the Belgian house are those of the reference figures, from a Monday on.
    let output = window.iter().find(|series| series.channel() == "T_room");
    let first = output.map(lampyris_core::data::Series::from).unwrap_or_default();
    let mut from = first + (6 * DAY + 8 * HOUR) * i64::from(room.file == BELGIAN);
    let mut parts = Vec::new();
    if window.to() - first <= SHORT_DAYS * DAY {
        parts.push(Part::whole(first, window.to()));
    }
    while from + DAYS * DAY <= window.to() + HOUR {
        parts.push(Part::window(from));
        from += DAYS * DAY;
    }
    parts
}

fn document(rows: &[Row], windows: &Table) -> Result<String, Failure> {
    let figures = Table {
        id: "figures",
        title: "In short".to_owned(),
        note: "Every figure beside its limit, where it has one.".to_owned(),
        head: ["what", "figure", "unit", "limit", ""].map(str::to_owned).to_vec(),
        rows: rows.iter().map(|row| row.cells().to_vec()).collect(),
    };
    page::document("What real rooms say", STYLE, &[section(&figures), section(windows)].concat())
}

fn read(path: &Path) -> Result<String, Failure> {
    let failed = |error: std::io::Error| Failure::NotFound(format!("{}: {error}", path.display()));
    let bytes = std::fs::read(path).map_err(failed)?;
    let mut text = String::new();
    match bytes.starts_with(&[0x1f, 0x8b]) {
        true => flate2::read::GzDecoder::new(bytes.as_slice()).read_to_string(&mut text).map_err(failed)?,
        false => bytes.as_slice().read_to_string(&mut text).map_err(failed)?,
    };
    Ok(text)
}

fn asked(part: Part) -> Result<EstimateRequest, Failure> {
    let range = WindowRange { last: None, from: Some(rfc3339(part.from)), to: Some(rfc3339(part.to() - 1)) };
    let split = serde_json::json!({
        "train": format!("PT{}H", part.train), "validation": format!("PT{}H", part.hours - part.train)
    });
    let split = serde_json::from_value(split).map_err(|error| Failure::Error(error.to_string()))?;
    Ok(EstimateRequest { window: Some(range), split, ..EstimateRequest::default() })
}

/// The room's own model, which does not know what drives it, or that with what does.
fn model_of(room: &Room, driver: Option<&&str>) -> Result<ModelId, Failure> {
    let own: ModelId =
        room.model.parse().map_err(|error| Failure::Error(format!("{}: {error}", room.name)))?;
    Ok(driver.map_or(own.clone(), |driver| own.plus(driver)))
}

/// A part of a room's record with a model.
struct FittedPart {
    catalogue: Catalogue,
    site: Site,
    problem: Problem,
    fit: Fit,
}

impl FittedPart {
    /// By the room's own model.
    fn new(room: &Room, window: &Window, part: Part) -> Result<Self, Failure> {
        Self::by(&model_of(room, None)?, &asked(part)?, room, window, part)
    }

    fn by(
        model: &ModelId,
        request: &EstimateRequest,
        room: &Room,
        window: &Window,
        part: Part,
    ) -> Result<Self, Failure> {
        let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
        let site = Site { location: Some(room.place), ..Site::default() };
        let problem = prepare(&catalogue, model, request, window, &site).map_err(|found| faults(&found))?;
        let fit =
            estimate(&problem, request, None, &Control::NONE).map_err(|error| failed(room, part, &error))?;
        Ok(Self { catalogue, site, problem, fit })
    }
}

/// What went wrong in a part of a room's record.
fn failed(room: &Room, part: Part, error: &dyn Display) -> Failure {
    Failure::Error(format!("{} from {}: {error}", room.name, rfc3339(part.from)))
}

fn judge(room: &Room, window: &Window, part: Part) -> Result<Judged, Failure> {
    let FittedPart { catalogue, site, problem, fit } = FittedPart::new(room, window, part)?;
    let (model, theta) = (problem.model().id().clone(), fit.theta());
    let found =
        diagnose(&catalogue, &problem, &theta, window, &site, AccusationRate::USUAL, &[], &Control::NONE)
            .map_err(|error| failed(room, part, &error))?;
    let group = |finding: &Finding| [vec![finding.named().to_owned()], finding.tied_with.clone()].concat();
    let first: Vec<String> = found.findings.first().map(group).unwrap_or_default();
    let holds =
        |effects: &[&str], names: &[String]| names.iter().any(|name| effects.contains(&name.as_str()));
    let all: Vec<String> = found.findings.iter().map(|finding| finding.effect.clone()).collect();
    let after = match found.findings.first() {
        Some(finding) => after(&catalogue, room, window, part, &model, &model.plus(&finding.effect))?,
        None => None,
    };
    let (negatives, accused) = negatives(&catalogue, &problem, &theta, window, &site)?;
    let named = holds(room.drivers, &first) && (first.len() <= 2 || room.drivers.len() > 2);
    let shown = found.findings.first().and_then(|finding| finding.segments.as_ref());
    let of = |text: Option<String>| text.unwrap_or_else(|| NONE.to_owned());
    let size = found.findings.first().and_then(|finding| finding.size.as_ref()).map(|size| {
        let interval = size.ci95.map_or_else(String::new, |[low, high]| format!(" ({low:.2} to {high:.2})"));
        format!("{:.2}{interval} {}", size.value, size.unit)
    });
    let errors =
        after.map(|after| after.map(|[without, with]| format!("{without:.2} to {with:.2}")).join(", "));
    let words = |names: &[&str]| if names.is_empty() { NONE.to_owned() } else { names.join(" or ") };
    let names: Vec<&str> = all.iter().map(String::as_str).collect();
    let cells = vec![
        room.name.to_owned(),
        format!("{:.0} days from {}", part.hours as f64 / 24.0, &rfc3339(part.from)[..10]),
        words(room.drivers),
        if room.drivers.is_empty() {
            NONE
        } else if named {
            "yes"
        } else {
            "no"
        }
        .to_owned(),
        words(&names).replace(" or ", ", "),
        of(shown.map(|shown| format!("{:.0} h", shown.hours))),
        of(shown.map(|shown| format!("{:.2}", shown.share))),
        of(shown.map(|shown| format!("{:.1}", shown.t))),
        of(shown.map(|shown| format!("{:.1e}", shown.p))),
        of(shown.map(|shown| format!("{:.2}", shown.shift_p))),
        of(size),
        of(errors),
        format!("{} of {negatives}", accused.map(|count| count.to_string()).join(", ")),
    ];
    Ok(Judged {
        whole: part.whole,
        named,
        driven: !room.drivers.is_empty(),
        decoy: holds(room.decoys, &all),
        after,
        negatives,
        accused,
        cells,
    })
}

/// Errors ahead on the two weeks after a window, by the parameters of the window without and with an effect.
fn after(
    catalogue: &Catalogue,
    room: &Room,
    window: &Window,
    part: Part,
    without: &ModelId,
    with: &ModelId,
) -> Result<Option<[[f64; 2]; AHEAD.len()]>, Failure> {
    let next = Part::window(part.to());
    if next.to() > window.to() + HOUR {
        return Ok(None);
    }
    let site = Site { location: Some(room.place), ..Site::default() };
    let errors = |model: &ModelId| -> Result<[Option<f64>; AHEAD.len()], Failure> {
        let request = asked(part)?;
        let problem = prepare(catalogue, model, &request, window, &site).map_err(|found| faults(&found))?;
        let fit = estimate(&problem, &request, None, &Control::NONE)
            .map_err(|error| Failure::Error(error.to_string()))?;
        let later =
            prepare(catalogue, model, &asked(next)?, window, &site).map_err(|found| faults(&found))?;
        let later = later.with_substeps(fit.substeps);
        let run = filter(&later, &fit.theta(), ProcessNoise::Likeliest);
        let found = ahead(&later, &fit.theta(), &run, 0..later.grid().len(), &AHEAD);
        Ok(AHEAD.map(|(name, _)| found.get(name).map(|error| error.rmse)))
    };
    let (without, with) = (errors(without)?, errors(with)?);
    let pair = |place: usize| without[place].zip(with[place]).map(|(without, with)| [without, with]);
    Ok(pair(0).zip(pair(1)).map(|(six, twelve)| [six, twelve]))
}

/// How many candidates with the channels of other days there are, and how many of them segments accuse at
/// each rate.
fn negatives(
    catalogue: &Catalogue,
    problem: &Problem,
    theta: &[f64],
    window: &Window,
    site: &Site,
) -> Result<(usize, [usize; 3]), Failure> {
    let source = EffectSource::new(catalogue, problem, window, site).map_err(|fault| faults(&[fault]))?;
    let (mut library, _) = source.candidates(problem);
    let Some(null) = NullModel::settle(align(problem, &mut library), theta, None, &|| false) else {
        return Ok((0, [0; 3]));
    };
    let days = source.grid.len() as i64 * source.grid.step() / DAY;
    let (mut count, mut accused) = (0, [0; 3]);
    for shift in 1..=SHIFTS {
        let grid = of_other_days(problem, &source.grid, (shift * days / (SHIFTS + 1)).max(1))
            .map_err(|fault| faults(&[fault]))?;
        let (mut library, _) = EffectSource { grid, ..source.clone() }.candidates(problem);
        let base = align(&null.problem, &mut library);
        let most = RATES.iter().copied().fold(0.0, f64::max);
        let Some(tests) = Tests::new(&base, &null.fitted.plain, &library, most, &[], &|| false) else {
            continue;
        };
        let found: Vec<Heard> = library.par_iter().map(|candidate| tests.hear(candidate)).collect();
        count += library.iter().filter(|candidate| is_driven(candidate, &base)).count();
        for evidence in found.iter().filter_map(|heard| Some(&heard.shown.as_ref()?.evidence)) {
            accused
                .iter_mut()
                .zip(RATES)
                .for_each(|(accused, rate)| *accused += usize::from(evidence.p <= rate));
        }
    }
    Ok((count, accused))
}

/// The grid with every column that the model does not use of so many days later, circularly.
fn of_other_days(problem: &Problem, grid: &Grid, days: i64) -> Result<Grid, lampyris_core::fault::Fault> {
    let model = problem.model();
    let used = |channel: &str| {
        model.inputs().iter().any(|input| input.channel == channel)
            || model.outputs().iter().any(|output| output.channel == channel)
    };
    let per_day = (DAY / grid.step()) as usize;
    let (whole, later) = (grid.len() / per_day * per_day, days as usize * per_day);
    let mut moved = grid.clone();
    for (channel, column) in grid.columns().filter(|(channel, _)| !used(channel) && !is_computed(channel)) {
        let value = |k: usize| column.values()[if k < whole { (k + later) % whole } else { k }];
        moved = moved.with_column(
            channel,
            Column::complete(column.unit(), column.hold(), (0..grid.len()).map(value).collect())?,
        )?;
    }
    Ok(moved)
}

fn rows(judged: &[Judged]) -> Vec<Row> {
    let driven =
        |whole: bool| judged.iter().filter(|one| one.driven && one.whole == whole).collect::<Vec<&Judged>>();
    let after: Vec<[f64; 2]> = judged.iter().filter_map(|one| one.after.map(|[_, twelve]| twelve)).collect();
    let all: Vec<&Judged> = judged.iter().collect();
    let mut rows: Vec<Row> = [
        share("a known driver withheld: named first", &driven(false), |one| one.named),
        share("the same on the whole of a short record", &driven(true), |one| one.named),
        share("an effect that never acts there is named", &all, |one| one.decoy),
        share("named: forecasts 12 h ahead fall on the two weeks after", &after, |[without, with]| {
            with < without
        }),
    ]
    .into_iter()
    .flatten()
    .collect();
    let negatives: usize = judged.iter().map(|one| one.negatives).sum();
    for (place, rate) in RATES.iter().enumerate() {
        let accused: usize = judged.iter().map(|one| one.accused[place]).sum();
        let what = format!("channels of other days accused at {rate} ({accused} of {negatives})");
        rows.push(
            Row::new(what, accused as f64 / negatives.max(1) as f64, "-").at_most((1e3 * rate + 10.0) / 1e3),
        );
    }
    rows
}
