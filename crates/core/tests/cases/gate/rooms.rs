//! The rooms whose measurements are spoilt, and what is known of them before that.

use super::spoilt::{Table, weather_next_door};
use lampyris_core::data::{ColumnBindings, DAY, Window};
use lampyris_core::estimate::gate::past::NextDoor;
use lampyris_core::estimate::problem::request::days_before;
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Incumbent, Problem, Site, estimate, prepare};
use lampyris_core::fault::Fault;
use lampyris_core::model::Catalogue;
use lampyris_core::twin::{Level, WorldRequest, world};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Days of a twin's record.
const RECORD_DAYS: usize = 42;

/// A room whose data are spoilt.
#[derive(Clone)]
pub struct Room {
    pub name: String,
    model: &'static str,
    binds: &'static [&'static str],
    /// Columns by what they are: `heat`, `out`, `room`, `neighbour`, `sun`.
    pub roles: BTreeMap<&'static str, &'static str>,
    pub table: Table,
    pub other: Option<Table>,
    site: Site,
    pub asked: EstimateRequest,
    /// The clean weather, as a neighbour measures it with a sensor of its own.
    pub next_door: Vec<NextDoor>,
}

/// A room with the fit to its true measurements.
pub struct Known {
    pub room: Room,
    pub problem: Problem,
    pub fit: Fit,
}

/// The rooms that are spoilt everyday.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Everyday {
    Twin,
    HourlyHouse,
    Laundry,
}

impl Everyday {
    /// Fitted by the first case that asks for it.
    pub fn known(self) -> &'static Known {
        static TWIN: LazyLock<Known> = LazyLock::new(|| Known::of(twin(Level::Matched, 71_100)));
        static HOURLY_HOUSE: LazyLock<Known> = LazyLock::new(|| Known::of(hourly_house()));
        static LAUNDRY: LazyLock<Known> = LazyLock::new(|| Known::of(laundry()));
        match self {
            Self::Twin => &TWIN,
            Self::HourlyHouse => &HOURLY_HOUSE,
            Self::Laundry => &LAUNDRY,
        }
    }
}

impl Known {
    pub fn of(room: Room) -> Self {
        let (problem, _) = room.problems(&room.table).unwrap();
        let fit = room.fitted(&problem).unwrap();
        Self { room, problem, fit }
    }

    /// Its own fit as the one that is served.
    pub fn incumbent(&self) -> Incumbent {
        Incumbent::of(&self.fit).unwrap()
    }
}

/// A twin that hides nothing.
pub fn twin(level: Level, seed: u64) -> Room {
    let made =
        |seed| world(&WorldRequest { days: RECORD_DAYS, ..WorldRequest::new(seed, &[], level) }).unwrap();
    let (own, other) = (made(seed), made(seed + 100_000));
    let table = Table::parse(&own.csv);
    let next_door = vec![NextDoor { name: "room/2".to_owned(), weather: weather_next_door(&table, seed) }];
    Room {
        name: format!("{level:?} {seed}"),
        model: "room3",
        binds: &[],
        roles: [
            ("heat", "T_forward"),
            ("out", "T_out"),
            ("room", "T_room"),
            ("neighbour", "T_room_1"),
            ("sun", "sun_altitude"),
        ]
        .into(),
        table,
        next_door,
        other: Some(Table::parse(&other.csv)),
        site: Site { sets: [("neighbours".to_owned(), own.neighbours)].into(), ..Site::default() },
        asked: EstimateRequest::default(),
    }
}

/// The hourly house with its heating.
fn hourly_house() -> Room {
    let mut asked = EstimateRequest::default();
    asked.bounds.insert("c_P_heater".to_owned(), [0.0, 0.05]);
    Room {
        name: "hourly house".to_owned(),
        model: "tite",
        binds: &["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"],
        roles: [("heat", "heat_input_raw"), ("out", "T_outdoor_degC"), ("room", "T_indoor_degC")].into(),
        table: Table::parse(include_str!("../../../../../config/demo/hourly_house.csv")),
        other: None,
        site: Site::default(),
        asked,
        next_door: Vec::new(),
    }
}

/// The laundry with its meter.
fn laundry() -> Room {
    Room {
        name: "laundry".to_owned(),
        model: "rc2+solar_gain+metered_gain:P_appliances",
        binds: &["T_room=T_laundry", "irradiance=irradiance_clear_sky"],
        roles: [
            ("heat", "P_appliances"),
            ("out", "T_out"),
            ("room", "T_laundry"),
            ("sun", "irradiance_clear_sky"),
        ]
        .into(),
        table: Table::parse(include_str!("../../../../../config/demo/belgian_house.csv")),
        other: None,
        site: Site::default(),
        asked: EstimateRequest::default(),
        next_door: Vec::new(),
    }
}

impl Room {
    /// The problem of measurements and the days before it, or the code of the first fault.
    pub fn problems(&self, table: &Table) -> Result<(Problem, Option<Problem>), String> {
        let code = |faults: Vec<Fault>| faults[0].code.clone();
        let bindings = ColumnBindings::parse(self.binds.iter().copied()).unwrap();
        let (window, _) = Window::parse_csv(&table.csv(), &bindings).map_err(code)?;
        let catalogue = Catalogue::builtin().unwrap();
        let problem = prepare(&catalogue, &self.model.parse().unwrap(), &self.asked, &window, &self.site);
        let problem = problem.map_err(code)?;
        let before = days_before(&catalogue, &self.asked, &window, &self.site, &problem);
        Ok((problem, before))
    }

    /// The room as it was known before a row came.
    pub fn until(&self, row: usize) -> Self {
        Self { table: self.table.until(row), ..self.clone() }
    }

    /// The row from which on so many days are left.
    pub fn row(&self, days: i64) -> usize {
        let millis = |time: &String| time.parse::<jiff::Timestamp>().unwrap().as_millisecond();
        let times = &self.table.times;
        let since = millis(&times[times.len() - 1]) - days * DAY;
        times.iter().position(|time| millis(time) >= since).unwrap()
    }

    /// The channel of the model that a column is.
    pub fn channel<'a>(&'a self, role: &'a str) -> &'a str {
        let column = self.roles.get(role).copied().unwrap_or(role);
        self.binds
            .iter()
            .filter_map(|bind| bind.split_once('='))
            .find(|(_, bound)| *bound == column)
            .map_or(column, |(channel, _)| channel)
    }

    pub fn fitted(&self, problem: &Problem) -> Result<Fit, String> {
        estimate(problem, &self.asked, None, &Control::NONE).map_err(|error| error.to_string())
    }
}
