//! Takes measurements in as lines of InfluxDB's protocol: read, sorted by the rules into systems and
//! channels, and delivered.

use super::line_rules::{self, LineRouter, LineRules};
use super::samples;
use super::windows::MOST_AHEAD;
use crate::service::error::ServiceError;
use crate::service::observe::lines::{LineName, LineTally, Untaken};
use crate::service::serving::snapshot::KnownSystems;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store::reach::SystemScope;
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::{
    ChannelIntake, ChannelKind, FieldValue, LinePoint, SECOND, Series, SystemId, TimePrecision, Window,
    WindowReport, line_points, rfc3339,
};
use lampyris_core::fault::Fault;

/// Most faults that an answer lists.
const MOST_FAULTS: usize = 20;
/// Most channels of one system in one request.
const MOST_CHANNELS: usize = 1_000;
/// The year 1980: what was measured before was counted in another precision than it is read in.
const EARLIEST: i64 = 315_532_800 * SECOND;

/// Lines that were taken, and what was wrong with the others.
#[derive(Debug)]
pub struct TakenLines {
    /// The systems that have got samples, each with the first instant of them, in milliseconds.
    pub systems: Vec<(SystemId, i64)>,
    /// What was wrong.
    pub faults: LineFaults,
}

/// What was wrong with some lines; all others were taken.
#[derive(Debug, Default)]
pub struct LineFaults {
    /// The first of them.
    pub listed: Vec<Fault>,
    /// How many there are.
    pub count: usize,
}

impl LineFaults {
    fn push(&mut self, fault: Fault) {
        self.count += 1;
        if self.listed.len() < MOST_FAULTS {
            self.listed.push(fault);
        }
    }

    /// Faults of the measurements of one system.
    fn add(&mut self, system: &SystemId, faults: Vec<Fault>) {
        for fault in faults {
            self.push(Fault { pointer: format!("{system} {}", fault.pointer), ..fault });
        }
    }
}

/// Takes lines. What no rule takes is counted and remembered by name, and so is what belongs to a system that
/// is not there, or that whoever sends it may not see; neither is an error. Texts such as `unavailable` are
/// left out.
///
/// # Errors
/// Where the body is no text, or something that passes stands in the way, so that it may be sent again.
pub(crate) async fn take(
    service: &Service,
    body: impl AsRef<[u8]> + Send + 'static,
    precision: TimePrecision,
    reach: &SystemScope,
) -> Result<TakenLines, ServiceError> {
    let (rules, _) = line_rules::get(service).await?;
    let mut sorter = Sorter::new(service, &rules, precision, reach)?;
    let sorted = blocking(move || {
        let text = std::str::from_utf8(body.as_ref()).map_err(|error| {
            let detail = format!("byte {} is no UTF-8", error.valid_up_to());
            ServiceError::Faults(vec![Fault::new("lines", "not-utf8", detail)])
        })?;
        sorter.sort(line_points(text));
        Ok::<_, ServiceError>(sorter.sorted())
    })
    .await??;
    keep(service, sorted, &service.lines).await
}

/// Keeps what was sorted, and counts it.
///
/// # Errors
/// Where something that passes stands in the way.
pub(crate) async fn keep(
    service: &Service,
    sorted: Sorted,
    tally: &LineTally,
) -> Result<TakenLines, ServiceError> {
    tally.add(&sorted.tally);
    let Sorted { windows, mut faults, .. } = sorted;
    let mut systems = Vec::new();
    if windows.is_empty() {
        return Ok(TakenLines { systems, faults });
    }
    let sizes: Vec<usize> = windows.iter().map(|(_, window)| window.iter().map(Series::len).sum()).collect();
    let read = |(system, window): (SystemId, Window)| {
        let report = WindowReport::of(&window);
        (system, Ok((window, report)))
    };
    let taken = samples::take_many(service, windows.into_iter().map(read).collect()).await?;
    for ((system, taken), size) in taken.into_iter().zip(sizes) {
        match taken {
            Ok(taken) => {
                tally.took(size);
                systems.push((system, taken.from));
            }
            Err(ServiceError::Faults(found)) => faults.add(&system, found),
            // It was deleted meanwhile.
            Err(ServiceError::NoSystem(_)) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(TakenLines { systems, faults })
}

/// Values that were sorted into systems and channels.
#[derive(Debug)]
pub struct Sorted {
    windows: Vec<(SystemId, Window)>,
    tally: LineTally,
    faults: LineFaults,
}

/// Sorts values into systems and channels. Its work is for a blocking thread.
#[derive(Debug)]
pub struct Sorter {
    router: LineRouter,
    precision: TimePrecision,
    known: KnownSystems,
    reach: SystemScope,
    now: Timestamp,
    /// By the name of the system.
    places: IndexMap<String, Place>,
    tally: LineTally,
    faults: LineFaults,
}

/// What belongs to one system.
#[derive(Debug)]
struct Place {
    system: SystemId,
    /// By channel and the unit of what is sent.
    intakes: IndexMap<(String, Option<String>), ChannelIntake>,
    /// Values by channel, each with the kind that it is of.
    samples: IndexMap<String, (ChannelKind, Vec<(i64, f64)>)>,
}

impl Sorter {
    /// Sorts by rules, within a reach.
    ///
    /// # Errors
    /// Where the rules that are kept are none.
    pub fn new(
        service: &Service,
        rules: &LineRules,
        precision: TimePrecision,
        reach: &SystemScope,
    ) -> Result<Self, ServiceError> {
        let router = LineRouter::of(rules).map_err(|faults| {
            ServiceError::Internal(format!("{} faults in the rules that are kept", faults.len()))
        })?;
        Ok(Self {
            router,
            precision,
            known: service.params.known(),
            reach: reach.clone(),
            now: service.now(),
            places: IndexMap::new(),
            tally: LineTally::default(),
            faults: LineFaults::default(),
        })
    }

    /// Sorts points; what no rule takes is counted.
    pub fn sort<'a>(&mut self, points: impl Iterator<Item = Result<LinePoint<'a>, Fault>>) {
        for read in points {
            let point = match read {
                Ok(point) => point,
                Err(fault) => {
                    self.faults.push(fault);
                    continue;
                }
            };
            let time = point.time.map_or(self.now.as_second() * SECOND, |time| self.precision.millis(time));
            if let Some(fault) = misdated(&point, time, self.now) {
                self.faults.push(fault);
                continue;
            }
            for (field, value) in &point.fields {
                // Whoever has no number to tell tells a word.
                let FieldValue::Number(number) = value else { continue };
                if let Err(why) = self.place(&point, field, time, *number) {
                    self.tally.left(LineName::of(&point, field), why, 1, self.now);
                }
            }
        }
    }

    /// Puts a value in its place.
    fn place(&mut self, point: &LinePoint<'_>, field: &str, time: i64, number: f64) -> Result<(), Untaken> {
        let to = self.router.destination(point, field).ok_or(Untaken::NoRule)?;
        let place = match self.places.get_mut(&to.system) {
            Some(place) => place,
            None => {
                let system: SystemId = to.system.parse().map_err(|_| Untaken::NoSystem)?;
                if !self.known.has(&to.system) || !self.reach.covers(&system) {
                    return Err(Untaken::NoSystem);
                }
                let new = Place { system, intakes: IndexMap::new(), samples: IndexMap::new() };
                self.places.entry(to.system).or_insert(new)
            }
        };
        let key = (to.channel, to.unit.map(str::to_owned));
        if !place.intakes.contains_key(&key) {
            if place.intakes.len() >= MOST_CHANNELS {
                return Err(Untaken::BadChannel);
            }
            let intake = ChannelIntake::new(&key.0, to.unit).map_err(|_| Untaken::BadChannel)?;
            place.intakes.insert(key.clone(), intake);
        }
        let intake = &place.intakes[&key];
        let value = intake.value(number).ok_or(Untaken::Implausible)?;
        let (kind, samples) =
            place.samples.entry(key.0).or_insert_with(|| (intake.kind().clone(), Vec::new()));
        // Of a channel that nobody knows the unit is that of its first value.
        if kind != intake.kind() {
            return Err(Untaken::BadChannel);
        }
        samples.push((time, value));
        Ok(())
    }

    /// What was sorted.
    pub fn sorted(mut self) -> Sorted {
        Sorted { windows: self.windows(), tally: self.tally, faults: self.faults }
    }

    /// As measurements.
    fn windows(&mut self) -> Vec<(SystemId, Window)> {
        let mut windows = Vec::with_capacity(self.places.len());
        for place in std::mem::take(&mut self.places).into_values().filter(|place| !place.samples.is_empty())
        {
            let series = place.samples.into_iter().map(|(channel, (kind, samples))| {
                Series::of_samples(&channel, &kind, samples).map_err(|fault| vec![fault])
            });
            match series.collect::<Result<Vec<_>, _>>().and_then(Window::from_series) {
                Ok(window) => windows.push((place.system, window)),
                Err(faults) => self.faults.add(&place.system, faults),
            }
        }
        windows
    }
}

/// A time that cannot be meant. As the newest or the oldest of its system it would move whatever counts from
/// there.
fn misdated(point: &LinePoint<'_>, time: i64, now: Timestamp) -> Option<Fault> {
    let is_early = time < EARLIEST;
    if !is_early && time <= now.as_millisecond().saturating_add(MOST_AHEAD) {
        return None;
    }
    let (code, what) = match is_early {
        true => ("early-time", "long before anything was measured"),
        false => ("future-time", "more than a day ahead of the clock of this service"),
    };
    let detail = format!("`{}` is of {}, {what}", LineName::of(point, "").measurement, rfc3339(time));
    let fault = Fault::new(format!("line {}", point.line), code, detail);
    Some(
        fault.suggest("say the precision of the times in the query, such as precision=s, or check the clock"),
    )
}
