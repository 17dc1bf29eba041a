//! Whether the log-normal prior helps in measured rooms: in windows whose model has what drives the room, and
//! in the same windows where that is withheld.

use super::super::row::Row;
use super::rooms::Room;
use super::{FittedPart, MeasuredRooms, Part, asked, failed, model_of, parts};
use lampyris::cli::Failure;
use lampyris_core::data::Window;
use lampyris_core::estimate::problem::prior::Prior;
use lampyris_core::estimate::{EstimateRequest, Fit};
use lampyris_core::model::ModelId;
use rayon::prelude::*;
use serde_json::json;

/// Windows of each room, the first ones.
const WINDOWS: usize = 6;
const SEEDS: [u64; 2] = [1, 2];
/// Fits differ where a parameter does by so much.
const APART: f64 = 0.1;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredRooms,
}

/// Fits of one window, without the prior and with it, each by every seed.
struct Compared {
    is_complete: bool,
    fits: [Vec<Fit>; 2],
}

/// Every window of the rooms of which it is known what drives them, with that and without.
pub fn run(asked: &Arguments) -> Result<Vec<Row>, Failure> {
    let mut compared = Vec::new();
    for room in asked.measured.rooms() {
        let Some(driver) = room.drivers.first() else { continue };
        let window = asked.measured.window(room)?;
        let (without, with) = (model_of(room, None)?, model_of(room, Some(driver))?);
        let usual = parts(room, &window).into_iter().filter(|part| !part.whole).take(WINDOWS);
        let both: Vec<(Part, &ModelId, bool)> =
            usual.flat_map(|part| [(part, &without, false), (part, &with, true)]).collect();
        let fitted: Result<Vec<Compared>, Failure> = both
            .par_iter()
            .map(|(part, model, is_complete)| {
                let [none, drawn] =
                    [Prior::None, Prior::LogNormal].map(|prior| fits(room, &window, *part, model, &prior));
                Ok(Compared { is_complete: *is_complete, fits: [none?, drawn?] })
            })
            .collect();
        compared.extend(fitted?);
    }
    Ok(rows(&compared))
}

fn fits(
    room: &Room,
    window: &Window,
    part: Part,
    model: &ModelId,
    prior: &Prior,
) -> Result<Vec<Fit>, Failure> {
    // The last days are seen by no fit.
    let split = serde_json::from_value(json!({ "train": "P7D", "validation": "P2D", "test": "P5D" }))
        .map_err(|error| failed(room, part, &error))?;
    let mut request = EstimateRequest { split, prior: prior.clone(), ..asked(part)? };
    let mut fit = |seed: &u64| {
        request.method.seed = *seed;
        Ok(FittedPart::by(model, &request, room, window, part)?.fit)
    };
    SEEDS.iter().map(&mut fit).collect()
}

fn rows(compared: &[Compared]) -> Vec<Row> {
    let test = |fit: &Fit| fit.first_metrics().and_then(|metrics| metrics.test_rmse);
    let ahead = |fit: &Fit| Some(fit.first_metrics()?.ahead.get("PT6H")?.rmse);
    let mut rows = Vec::new();
    for (whose, is_complete) in [("with what drives the room", true), ("without it", false)] {
        let these: Vec<&Compared> = compared.iter().filter(|one| one.is_complete == is_complete).collect();
        for (what, error) in [
            ("five unseen days", &test as &dyn Fn(&Fit) -> Option<f64>),
            ("6 h ahead on two unseen days", &ahead),
        ] {
            let ratios: Vec<f64> = these.iter().filter_map(|one| ratio(one, error)).collect();
            let mean = (ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).exp();
            let what = format!("models {whose}: error of {what}, drawn beside free, of {}", ratios.len());
            rows.push(Row::new(what, mean, "x"));
        }
    }
    for (which, how) in ["free", "drawn"].into_iter().enumerate() {
        let apart = compared.iter().filter(|one| differ(&one.fits[which])).count();
        let what = format!("seeds that find other parameters, {how}, of {}", compared.len());
        rows.push(Row::new(what, apart as f64, ""));
    }
    rows
}

/// The logarithm of the error with the prior over that without; `None` where there is no error.
fn ratio(one: &Compared, error: &dyn Fn(&Fit) -> Option<f64>) -> Option<f64> {
    let mean = |fits: &[Fit]| -> Option<f64> { fits.iter().map(error).sum::<Option<f64>>() };
    Some((mean(&one.fits[1])? / mean(&one.fits[0])?).ln())
}

/// Whether fits by several seeds differ in a parameter.
fn differ(fits: &[Fit]) -> bool {
    let Some((first, others)) = fits.split_first() else { return false };
    others.iter().any(|other| {
        first.parameters.iter().any(|(name, one)| {
            let (a, b) = (one.value, other.parameters.get(name).map_or(f64::NAN, |other| other.value));
            (a - b).abs() > APART * a.abs().max(b.abs())
        })
    })
}
