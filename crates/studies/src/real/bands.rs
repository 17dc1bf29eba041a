//! How often the 95 % bands of forecasts hold what was measured then, in rooms whose truth nobody knows.

use super::super::row::Row;
use super::rooms::Room;
use super::{FittedPart, MeasuredRooms, Part, asked, failed, model_of, parts};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{Duration, HOUR, Window};
use lampyris_core::estimate::Replay;
use lampyris_core::estimate::forecast::{ForecastAsked, InputsToCome, forecast};
use lampyris_core::interrupt::Brake;
use rayon::prelude::*;

/// Hours ahead.
const LEADS: [i64; 3] = [1, 6, 24];
/// Hours between two forecasts.
const EVERY: i64 = 6;
/// The share of a normal error inside of so many standard deviations is 95 %.
const BAND: f64 = 1.96;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredRooms,
    /// Windows of each room, the first ones.
    #[arg(long, default_value_t = 3)]
    windows: usize,
}

/// Forecasts of the two weeks after each window, by the parameters of the window, with the inputs that came.
pub fn run(asked: &Arguments) -> Result<Vec<Row>, Failure> {
    let mut rows = Vec::new();
    let mut all = [(0, 0); LEADS.len()];
    for room in asked.measured.rooms() {
        let window = asked.measured.window(room)?;
        let mut held = [(0, 0); LEADS.len()];
        let usual = parts(room, &window).into_iter().filter(|part| !part.whole).take(asked.windows);
        for part in usual {
            let found = shares(room, &window, part)?;
            for (sum, one) in held.iter_mut().chain(&mut all).zip(found.iter().chain(&found)) {
                *sum = (sum.0 + one.0, sum.1 + one.1);
            }
        }
        rows.extend(said(room.name, &held));
    }
    rows.extend(said("all rooms", &all));
    Ok(rows)
}

fn said(whose: &str, held: &[(usize, usize); LEADS.len()]) -> Vec<Row> {
    let row = |(lead, (inside, all)): (&i64, &(usize, usize))| {
        let share = 100.0 * *inside as f64 / *all as f64;
        Row::new(format!("{whose}: inside of the 95 % band {lead} h ahead, of {all}"), share, "%")
    };
    LEADS.iter().zip(held).filter(|(_, (_, all))| *all > 0).map(row).collect()
}

/// Forecasts that held what came, and all of them, by lead.
fn shares(room: &Room, window: &Window, part: Part) -> Result<[(usize, usize); LEADS.len()], Failure> {
    // What is known to drive the room belongs to its model.
    let model = model_of(room, room.drivers.first())?;
    let FittedPart { catalogue, problem, fit, .. } =
        FittedPart::by(&model, &asked(part)?, room, window, part)?;
    let end = window.to().min(part.to() + HOUR * 24 * super::DAYS);
    let until = window.slice(window.from(), end).map_err(|found| faults(&found))?;
    let replay =
        Replay::new(&catalogue, &fit, &until, Some(end), &Brake::NONE).map_err(|found| faults(&found))?;
    let truth = until.series("T_room").ok_or_else(|| failed(room, part, &"there is no room temperature"))?;
    let step = Duration::from_millis(problem.grid().step());
    let half = step.millis() / 2;
    let origins: Vec<i64> = (0..).map(|k| part.to() + k * EVERY * HOUR).take_while(|at| *at < end).collect();
    let one = |origin: i64| -> [Option<bool>; LEADS.len()] {
        let inputs: Vec<_> = until
            .iter()
            .filter(|series| series.channel() != "T_room")
            .filter_map(|series| series.slice(origin, end))
            .collect();
        let (Ok(to_come), Ok(measured)) = (Window::from_series(inputs), until.slice(until.from(), origin))
        else {
            return [None; LEADS.len()];
        };
        let asked = ForecastAsked { horizon: Duration::from_hours(25), step, until: Some(origin) };
        // Where an input or the room was not measured there is nothing to forecast.
        let Ok(said) = forecast(&replay, &fit, &measured, &InputsToCome::given(&to_come), asked) else {
            return [None; LEADS.len()];
        };
        let Ok(at) = said.at.parse::<jiff::Timestamp>() else { return [None; LEADS.len()] };
        let output = &said.outputs["T_room"];
        LEADS.map(|lead| {
            let (place, when) = ((lead * HOUR / step.millis()) as usize, at.as_millisecond() + lead * HOUR);
            let near = truth.times().partition_point(|time| *time < when - half);
            let known = truth.times().get(near).filter(|time| **time < when + half)?;
            let value = truth.values()[truth.times().binary_search(known).ok()?];
            Some((value - output.values.get(place)?).abs() <= BAND * output.sd.get(place)?)
        })
    };
    let found: Vec<[Option<bool>; LEADS.len()]> = origins.into_par_iter().map(one).collect();
    let mut held = [(0, 0); LEADS.len()];
    for (lead, sum) in held.iter_mut().enumerate() {
        for inside in found.iter().filter_map(|one| one[lead]) {
            *sum = (sum.0 + usize::from(inside), sum.1 + 1);
        }
    }
    Ok(held)
}
