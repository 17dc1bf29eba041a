//! What fixed inputs cost in counts, which are the same however busy a machine is: simulations, derivatives,
//! and instructions under callgrind. What costs more than it did at the last record is told by its limit.

use super::engine::week;
use super::nights::a_night;
use super::plant::case::Case;
use super::results::record;
use super::row::{Limit, Row};
use super::twin_room::measured;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::DAY;
use lampyris_core::estimate::fit::Searched;
use lampyris_core::estimate::problem::request::SearchExtent;
use lampyris_core::estimate::{Control, EstimateRequest, estimate};
use lampyris_core::simulate::LANES;
use lampyris_core::twin::{Level, WorldRequest, world};
use std::path::PathBuf;
use std::process::Command;

/// A count may be so much larger than the recorded one.
const LARGER: f64 = 1.05;
/// Weeks that are simulated, and days of the room whose night is counted.
const WEEKS: usize = 16 * LANES;
const FITTED: i64 = 28;
/// The seed of that room, whose second night ends next to the first.
const ROOM: u64 = 3;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder with an earlier record: no count may be more than 5 % larger.
    #[arg(long, value_name = "FOLDER")]
    against: Option<PathBuf>,
    /// Only do this work, and print what it counts.
    #[arg(long, hide = true)]
    work: Option<Work>,
}

/// A piece of work on fixed inputs.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Work {
    /// To start and to end.
    Nothing,
    /// Weeks of a room, simulated from its text.
    Weeks,
    /// One fit that searches everywhere, to a week of a room.
    Fit,
    /// The first night of a room: everywhere is searched.
    FirstNight,
    /// The same, and the night behind, which begins at what is served.
    SecondNight,
    /// Warm-up and three days of a treatment plant.
    Plant,
}

/// Counts everything, or does one work.
pub fn run(asked: &Arguments) -> Result<Vec<Row>, Failure> {
    if let Some(work) = asked.work {
        return Ok(vec![Row::new("counted", count(work)?, "-")]);
    }
    let [nothing, weeks, fit, first, second, plant] =
        [Work::Nothing, Work::Weeks, Work::Fit, Work::FirstNight, Work::SecondNight, Work::Plant]
            .map(instructions);
    let nothing = nothing?;
    let mut rows = vec![
        Row::new("a week of a room: instructions", (weeks? - nothing) / WEEKS as f64, "-"),
        Row::new("a fit to a week that searches everywhere: simulations", count(Work::Fit)?, "-"),
        Row::new("  instructions", fit? - nothing, "-"),
        Row::new("a night that begins at what is served: simulations", count(Work::SecondNight)?, "-"),
        Row::new("  instructions", second? - first?, "-"),
        Row::new("a plant's warm-up and three days: derivatives", count(Work::Plant)?, "-"),
        Row::new("  instructions", plant? - nothing, "-"),
    ];
    if let Some(folder) = &asked.against {
        let earlier = record(&folder.join("counts.json"))?
            .ok_or_else(|| Failure::Error(format!("{} has no record of counts", folder.display())))?;
        for (row, earlier) in rows.iter_mut().zip(&earlier.rows) {
            if row.what != earlier.what {
                return Err(Failure::Error(format!("`{}` was recorded as `{}`", row.what, earlier.what)));
            }
            row.limit = Some(Limit::AtMost(LARGER * earlier.value));
        }
    }
    Ok(rows)
}

/// Does a work; says its simulations, those of its last night, or its derivatives.
fn count(work: Work) -> Result<f64, Failure> {
    let failed = |fault: &dyn std::fmt::Display| Failure::Error(fault.to_string());
    match work {
        Work::Nothing => Ok(0.0),
        Work::Weeks => {
            let (twin, problem) = week(1, 10)?;
            let thetas = vec![twin.theta.as_slice(); WEEKS];
            Ok(problem.simulator().run(&thetas, problem.grid().len()).len() as f64)
        }
        Work::Fit => {
            let (_, problem) = week(1, 10)?;
            let fit = estimate(&problem, &EstimateRequest::default(), None, &Control::NONE);
            Ok(fit.map_err(|error| failed(&error))?.evaluations as f64)
        }
        Work::FirstNight | Work::SecondNight => {
            let request =
                WorldRequest { days: FITTED as usize + 1, ..WorldRequest::new(ROOM, &[], Level::Matched) };
            let made = world(&request).map_err(|fault| failed(&fault))?;
            let window = measured(&made)?;
            let night = |night: i64, extent, served| {
                let from = window.from() + night * DAY;
                let fitted = window.slice(from, from + FITTED * DAY).map_err(|found| faults(&found))?;
                Ok::<_, Failure>(a_night(&made, &fitted, extent, served, || 0.0)?.0)
            };
            let first = night(0, SearchExtent::Global, None)?;
            if matches!(work, Work::FirstNight) {
                return Ok(first.evaluations as f64);
            }
            let second = night(1, SearchExtent::Local, Some(&first))?;
            if second.searched != Some(Searched::Local) {
                return Err(Failure::Error("the second night has searched everywhere".to_owned()));
            }
            Ok(second.evaluations as f64)
        }
        Work::Plant => {
            let (problem, _) = Case::new("asm1_h", 1, 0.0)?.problem()?;
            let run = problem.simulate(problem.nominal());
            Ok(run.evaluations as f64)
        }
    }
}

/// The instructions of a work in a process and on a thread of its own.
fn instructions(work: Work) -> Result<f64, Failure> {
    use clap::ValueEnum;
    let failed = |what: String| Failure::Error(format!("callgrind: {what}"));
    let program = std::env::current_exe().map_err(|error| failed(error.to_string()))?;
    let name = work.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
    let done = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(program)
        .args(["counts", "--work", &name])
        .env("RAYON_NUM_THREADS", "1")
        .output()
        .map_err(|error| failed(error.to_string()))?;
    let said = String::from_utf8_lossy(&done.stderr);
    let collected = said.lines().find_map(|line| line.split_once("Collected : ")?.1.trim().parse().ok());
    collected.filter(|_| done.status.success()).ok_or_else(|| failed(said.into_owned()))
}
