//! When did a parameter change, by how much, since when?
//!
//! ```text
//! Problem, theta --whitened--> innovations, directions --scan--> every parameter on every day --> Changes
//! ```
//!
//! A fit moves slowly: windows of nights overlap, and a change shows in their estimates when half of a window
//! has seen it. Here the record itself is asked. The model is linearised along its filtered states, with
//! parameters that need not be right, and with heat that nobody logged as a process beside it (as for the
//! missing heat); what a parameter that changes on a day adds to the innovations is a direction
//! (`whitened`), and the likelihood ratio of all parameters on all days is taken with those projected out
//! that are the same throughout (`scan`). The largest is told where it is more than chance gives once in
//! years.

mod scan;
#[cfg(test)]
mod tests;
mod whitened;

use super::missing_heat::record::MissingHeatAsked;
use super::missing_heat::shown;
use crate::data::{DAY, Duration, Window, rfc3339};
use crate::estimate::Problem;
use crate::estimate::assess::metrics::ProcessNoise;
use crate::estimate::fit::parameter_change::ParameterChange;
use crate::fault::Fault;
use crate::model::{Parameter, Scale};
use scan::{Scan, ScannedStep};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use utoipa::ToSchema;
use whitened::Whitened;

/// A change of so many deviations is told. The largest of all parameters on all days of a year of nights, in
/// synthetic rooms in which nothing changes, is from 3.2 to 4.3 in most (`lampyris bench change`).
pub const THRESHOLD: f64 = 4.5;
/// From so many deviations on the likeliest parameters are sought before anything is told.
const NEAR: f64 = 3.5;
/// A record of so many days is looked at: long enough to know how it was before, and short beside a season.
pub const WINDOW_DAYS: usize = 42;
/// The step in which a record is looked at, where its own is shorter: a change is told as soon, and a filter
/// along a third of the samples takes a third of the time.
const STEP: Duration = Duration::from_seconds(30 * 60);
/// A fall of the squared statistic by this much bounds the days on which a change may have come: the 95 %
/// quantile of chi-squared with one degree of freedom.
const SINCE_FALL: f64 = 3.84;
/// A parameter is told beside another where that is less than twenty times as likely.
const INSTEAD_FALL: f64 = 6.0;
/// How often the model is linearised anew at most, and the gain in the logarithm of the likelihood that is
/// worth another time.
const ROUNDS: usize = 4;
const GAIN: f64 = 0.5;
/// Deviations of an interval of 95 %.
const NORMAL_95: f64 = 1.96;

/// What a record says of parameters that change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterChanges {
    /// The first day that was looked at (UTC), and the instant after the last.
    pub from: String,
    /// See `from`.
    pub to: String,
    /// A change is told from so many deviations on.
    pub threshold: f64,
    /// The change that was found; `null` where none is sure.
    pub change: Option<ParameterChange>,
    /// The largest that was looked at, whether sure or not, in its deviations; `null` where the record is too
    /// short for any.
    pub largest: Option<f64>,
    /// What it says, in a plain sentence.
    pub sentence: String,
}

/// A record in which changes are looked for.
pub struct ChangeRecord<'a> {
    problem: &'a Problem,
    theta: Vec<f64>,
    noise: ProcessNoise,
    whitened: Whitened,
    scan: Scan,
}

/// The step in which a window is looked at that measures this output; `None` where it is the window's own.
pub fn step(window: &Window, output: &str) -> Option<Duration> {
    let own = window.series(output)?.median_step()?;
    (own < STEP.millis()).then_some(STEP)
}

/// What the record of a problem says of parameters that change, along those near these that are likeliest.
/// The model is linearised along the states of a filter of this noise.
///
/// # Errors
/// As [`ChangeRecord::new`].
pub fn changes(problem: &Problem, theta: &[f64], noise: ProcessNoise) -> Result<ParameterChanges, Fault> {
    let record = ChangeRecord::new(problem, theta, noise, usize::MAX)?;
    let found = record.changes(0..record.days());
    // Most nights nothing comes near, and the other passes are spared.
    if found.largest.is_none_or(|largest| largest < NEAR) {
        return Ok(found);
    }
    let record = record.likeliest();
    Ok(record.changes(0..record.days()))
}

/// The likeliest parameters of a record near others, whatever changes in it: by the method of scoring, as
/// long as that makes the record likelier. A fit of free runs lies anywhere on its ridges, and the trace of
/// one parameter would be laid to another there. The noise is as for [`changes`].
///
/// # Errors
/// As [`ChangeRecord::new`].
pub fn settled(problem: &Problem, theta: &[f64], noise: ProcessNoise) -> Result<Vec<f64>, Fault> {
    Ok(ChangeRecord::new(problem, theta, noise, usize::MAX)?.likeliest().theta)
}

impl<'a> ChangeRecord<'a> {
    /// Filters a record, of which no stretch of more than `longest` days will be asked for. The model is
    /// linearised along the states of a filter of this noise.
    ///
    /// # Errors
    /// A fault of a model that has no filter, of one no output of which shows a state, and where the numbers
    /// are left.
    pub fn new(
        problem: &'a Problem,
        theta: &[f64],
        noise: ProcessNoise,
        longest: usize,
    ) -> Result<Self, Fault> {
        let cannot = |why: &str| Fault::new("/model", "no-changes", why);
        if let Some(why) = problem.predictor().lacks_filter_for("what changes") {
            return Err(cannot(&why));
        }
        let model = problem.model();
        let (output, state) = (0..model.outputs().len())
            .find_map(|output| Some((output, shown(model, output)?)))
            .ok_or_else(|| cannot("no output of the model shows a state"))?;
        let whitened = Whitened::new(&MissingHeatAsked { problem, theta, output, state }, noise)
            .ok_or_else(|| cannot("the model leaves the numbers on this record"))?;
        let scan = Scan::new(&whitened, longest.min(whitened.days()));
        Ok(Self { problem, theta: theta.to_vec(), noise, whitened, scan })
    }

    /// The record along the likeliest parameters near its own.
    fn likeliest(self) -> Self {
        let mut record = self;
        for _ in 0..ROUNDS {
            let Some(next) = record.nearer() else { break };
            let Ok(there) = Self::new(record.problem, &next, record.noise, usize::MAX) else { break };
            if there.whitened.likelihood < record.whitened.likelihood + GAIN {
                break;
            }
            record = there;
        }
        record
    }

    /// How many days it has, the first and the last of which may be short.
    pub fn days(&self) -> usize {
        self.whitened.days()
    }

    /// What some of its days say.
    pub fn changes(&self, days: Range<usize>) -> ParameterChanges {
        let steps = self.scan.steps(days.clone(), THRESHOLD);
        let largest = steps.iter().max_by(|one, other| one.z().abs().total_cmp(&other.z().abs()));
        let change = largest.filter(|step| step.z().abs() >= THRESHOLD).map(|step| self.told(*step, &steps));
        let sentence = match (&change, largest) {
            (Some(change), _) => change.sentence(),
            (None, Some(_)) => "No parameter is seen to have changed.".to_owned(),
            (None, None) => {
                "The record is too short, or says too little, to see a parameter change.".to_owned()
            }
        };
        ParameterChanges {
            from: self.day(days.start),
            to: self.day(days.end),
            threshold: THRESHOLD,
            change,
            largest: largest.map(|step| step.z().abs()),
            sentence,
        }
    }

    /// The parameters where the record asks for them, within their bounds and reaches.
    fn nearer(&self) -> Option<Vec<f64>> {
        let apart = self.scan.apart(THRESHOLD)?;
        let mut theta = self.theta.clone();
        for (place, index) in self.whitened.parameters.iter().enumerate() {
            let reach = self.whitened.reaches[place];
            let [lower, upper] = self.problem.bounds()[*index];
            let parameter = &self.problem.model().parameters()[*index];
            theta[*index] =
                moved(parameter, theta[*index], apart[place].clamp(-reach, reach)).clamp(lower, upper);
        }
        Some(theta)
    }

    /// A day of the record, as it is written.
    fn day(&self, day: usize) -> String {
        rfc3339((self.whitened.first_day + day as i64) * DAY)
    }

    fn told(&self, step: ScannedStep, all: &[ScannedStep]) -> ParameterChange {
        let index = self.whitened.parameters[step.place];
        let parameter = &self.problem.model().parameters()[index];
        let square = step.z().powi(2);
        let near = |fall: f64| all.iter().filter(move |other| square - other.z().powi(2) < fall);
        let same = near(SINCE_FALL).filter(|other| other.place == step.place).map(|other| other.day);
        let (earliest, latest) =
            same.fold((step.day, step.day), |(first, last), day| (first.min(day), last.max(day)));
        let mut instead: Vec<usize> =
            near(INSTEAD_FALL).map(|other| other.place).filter(|place| *place != step.place).collect();
        instead.sort_unstable();
        instead.dedup();
        let name =
            |place: usize| self.problem.model().parameters()[self.whitened.parameters[place]].name.clone();
        let moved = |from: f64, by: f64| moved(parameter, from, by);
        let before = moved(self.theta[index], step.before);
        let reach = NORMAL_95 * step.deviation;
        ParameterChange {
            parameter: parameter.name.clone(),
            title: parameter.title.clone(),
            unit: parameter.unit.clone(),
            since: self.day(step.day),
            since_95: [self.day(earliest), self.day(latest)],
            before,
            after: moved(before, step.size),
            after_95: [moved(before, step.size - reach), moved(before, step.size + reach)],
            z: step.z().abs(),
            instead: instead.into_iter().map(name).collect(),
        }
    }
}

/// A parameter moved by so much of what its change is counted in.
fn moved(parameter: &Parameter, from: f64, by: f64) -> f64 {
    match parameter.scale {
        Scale::Log => from * by.exp(),
        Scale::Linear => from + by,
    }
}
