//! A synthetic room as whoever fits it has it: what was measured, where it stands, and its problem.

use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, Duration, SplitRequest, Window};
use lampyris_core::diagnose::change::step;
use lampyris_core::estimate::{EstimateRequest, Problem, Site, prepare};
use lampyris_core::fault::Fault;
use lampyris_core::model::Catalogue;
use lampyris_core::twin::World;
use std::sync::OnceLock;

/// A room with the problem of a model.
pub struct TwinRoom {
    pub catalogue: &'static Catalogue,
    pub site: Site,
    pub asked: EstimateRequest,
    pub problem: Problem,
}

/// What was measured.
pub fn measured(made: &World) -> Result<Window, Failure> {
    let (window, _) =
        Window::parse_csv(&made.csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
    Ok(window)
}

/// All of so many days to learn from: nothing is left to judge by.
pub fn whole(days: usize) -> SplitRequest {
    let train = Duration::from_days(days as i64);
    SplitRequest { train, validation: Duration::default(), test: None }
}

/// The problem of a model on some of it.
pub fn twin_room(
    made: &World,
    window: &Window,
    model: &str,
    split: SplitRequest,
) -> Result<TwinRoom, Failure> {
    prepared(made, window, model, EstimateRequest { split, ..EstimateRequest::default() })
}

/// So many days as whoever looks for changes has them.
pub fn watched(made: &World, window: &Window, days: usize) -> Result<Problem, Failure> {
    let asked =
        EstimateRequest { split: whole(days), step: step(window, "T_room"), ..EstimateRequest::default() };
    Ok(prepared(made, window, "room3", asked)?.problem)
}

fn prepared(made: &World, window: &Window, model: &str, asked: EstimateRequest) -> Result<TwinRoom, Failure> {
    // A service reads its catalogue once, not room by room.
    static BUILTIN: OnceLock<Result<Catalogue, Vec<Fault>>> = OnceLock::new();
    let catalogue = BUILTIN.get_or_init(Catalogue::builtin).as_ref().map_err(|found| faults(found))?;
    let site = Site { sets: [("neighbours".to_owned(), made.neighbours.clone())].into(), ..Site::default() };
    let model = model.parse().map_err(|error| Failure::Error(format!("{error}")))?;
    let problem = prepare(catalogue, &model, &asked, window, &site).map_err(|found| faults(&found))?;
    Ok(TwinRoom { catalogue, site, asked, problem })
}
