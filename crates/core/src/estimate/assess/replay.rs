//! A stored fit on measurements once more: the same points, the same steps and the same noise as when it was
//! made, so that what is shown beside the measurements is what the stored errors were computed from.
//!
//! The run always starts where the fit's window does, because the estimated initial states belong there. It
//! may go on beyond the window, over newer measurements. Those are taken as they are now: where newer uploads
//! have changed the window itself, [`Provenance`] says so.

use super::metrics::{FilterRun, filter_with, forecast_series, noise_of};
use crate::data::{Grid, Split, Window, read_time, rfc3339};
use crate::estimate::fit::{Fit, Parts, Span};
use crate::estimate::problem::Problem;
use crate::estimate::problem::basis::Basis;
use crate::estimate::problem::choices::Choices;
use crate::estimate::problem::request::{Columns, bound, source, with_computed};
use crate::fault::Fault;
use crate::interrupt::Brake;
use crate::model::id::NotAModelId;
use crate::model::{Catalogue, Model};
use crate::simulate::Trajectory;
use crate::simulate::kalman::Noise;
use serde::Serialize;
use std::ops::Range;
use std::sync::OnceLock;
use utoipa::ToSchema;

/// Most samples of a run: half a year of one-minute data.
pub const MOST_SAMPLES: usize = 300_000;
/// Two errors that differ by less, relative to one of them, are the same.
const SAME: f64 = 1e-9;

/// Where a sample lies, as seen by a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// Estimation data.
    Train,
    /// Data that the gate saw and the search did not.
    Validation,
    /// Data of the fit's window that neither saw.
    Test,
    /// Measured after the fit's window.
    After,
}

impl Part {
    /// All parts, in the order of time.
    pub const ALL: [Part; 4] = [Part::Train, Part::Validation, Part::Test, Part::After];
}

/// Whether a stored fit and what is shown of it belong together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Provenance {
    /// Hash of the measurements of the fit's window as they are now.
    pub input_hash: String,
    /// Hash of those that the fit was made from.
    pub fit_input_hash: String,
    /// Whether newer uploads or exclusions have changed them.
    pub measurements_changed: bool,
    /// Whether the documents of the model say something else by now.
    pub model_changed: bool,
    /// Whether the stored error on the training part comes out again.
    pub reproduced: bool,
    /// All of this in a sentence.
    pub comment: String,
}

/// A stored fit that was run again.
#[derive(Debug)]
pub struct Replay {
    problem: Problem,
    theta: Vec<f64>,
    noise: Noise,
    trajectory: Trajectory,
    filter: OnceLock<FilterRun>,
    /// Samples of the fit's own window.
    own: usize,
    provenance: Provenance,
}

impl Replay {
    /// Runs a fit again, from the start of its window through its end, and on to `until` where that is later
    /// and measured. `window` holds what was measured from the basis of the fit on. All that is asked of the
    /// run unwinds to a [`Brake::guard`] where the brake is pulled.
    ///
    /// # Errors
    /// Faults where the fit does not say what it was made from, its model or its channels are gone, its
    /// parameters are no longer those of the model, or the run would be longer than [`MOST_SAMPLES`].
    pub fn new(
        catalogue: &Catalogue,
        fit: &Fit,
        window: &Window,
        until: Option<i64>,
        brake: &Brake,
    ) -> Result<Self, Vec<Fault>> {
        let (basis, model) = (basis(fit)?, model_of(catalogue, fit)?);
        let model_changed = model.hash() != fit.model_hash;
        let first = |output: &str| window.series(output).map_or(i64::MIN, |series| series.to());
        let newest = first(&model.outputs()[0].channel);
        let split = split(&fit.parts, fit.sample_s.millis(), basis.lead)?;
        let start = start(&fit.parts)? - i64::try_from(basis.lead).unwrap_or(0) * fit.sample_s.millis();
        let window = offered(window, basis, until)?;
        let own = split.test.end;
        let last = until.unwrap_or(i64::MIN).min(newest);
        let samples = usize::try_from((last.saturating_sub(start)).div_euclid(fit.sample_s.millis()))
            .map_or(own, |steps| own.max(steps + 1));
        if samples > MOST_SAMPLES {
            let detail = format!(
                "the run from {} on has {samples} samples; {MOST_SAMPLES} are the most",
                rfc3339(start)
            );
            return Err(vec![
                Fault::new("query to", "range-too-long", detail)
                    .suggest("ask for an earlier end, or fit newer measurements"),
            ]);
        }
        let frame = Grid::new(start, fit.sample_s.millis(), samples).map_err(|fault| vec![fault])?;
        let columns = Columns::of(&model, &window);
        let grid = with_computed(window.grid_on(frame, &columns.request())?, &model, basis)?;
        // Hash and resolution of the sensors are those of the fit's own window, whatever comes after it.
        let source = source(&model, &window, &grid.slice(0..own), basis.clone())?;
        let problem =
            fit.simulated(&Problem::new(model, grid, split, &Choices::default(), source)?.with_brake(brake));
        let theta = fit.theta();
        let trajectory = problem.simulate(&theta);
        let provenance = provenance(&problem, fit, &trajectory, model_changed);
        let noise = noise_of(&problem, fit);
        Ok(Self { problem, theta, noise, trajectory, filter: OnceLock::new(), own, provenance })
    }

    /// The problem of the fit, on a grid that may go on beyond the fit's window.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// Whether what is shown belongs to the stored fit.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// The samples of a part.
    pub fn range(&self, part: Part) -> Range<usize> {
        let split = self.problem.split();
        match part {
            Part::Train => split.train.clone(),
            Part::Validation => split.validation.clone(),
            Part::Test => split.test.clone(),
            Part::After => self.own..self.problem.grid().len(),
        }
    }

    /// What was measured of an output; `None` where it was not.
    pub fn measured(&self, output: usize) -> Vec<Option<f64>> {
        let measured = self.problem.measured();
        let (values, valid) = measured[output];
        values.iter().zip(valid).map(|(value, valid)| valid.then_some(*value)).collect()
    }

    /// Where the run starts, of an output that a state starts from.
    pub fn measured_start(&self, output: usize) -> Option<f64> {
        self.problem.simulator().measured_start(output)
    }

    /// The free run of an output: one simulation from the start of the window. `None` behind a gap in the
    /// inputs, where the simulation stands still, and where it has left the numbers.
    pub fn free_run(&self, output: usize) -> Vec<Option<f64>> {
        let predicted = |k: usize| self.problem.simulator().predicted(k);
        let simulated = self.trajectory.outputs[output].iter().enumerate();
        simulated.map(|(k, value)| (predicted(k) && value.is_finite()).then_some(*value)).collect()
    }

    /// The forecasts of all outputs, `[output][lead][k]`, from origins in a range; leads in samples, strictly
    /// increasing. States are filtered as for the stored errors.
    pub fn ahead(&self, origins: Range<usize>, leads: &[usize]) -> Vec<Vec<Vec<Option<f64>>>> {
        forecast_series(&self.problem, &self.theta, self.filtered(), origins, leads)
    }

    /// The filter over the whole run, with the noise of the fit.
    pub fn filtered(&self) -> &FilterRun {
        self.filter.get_or_init(|| filter_with(&self.problem, &self.theta, &self.noise))
    }
}

/// What a fit was made from.
///
/// # Errors
/// A fault where it does not say.
pub fn basis(fit: &Fit) -> Result<&Basis, Vec<Fault>> {
    fit.basis.as_ref().ok_or_else(|| {
        let detail = "the fit was made by a version that did not keep what is needed to run it again";
        vec![Fault::new("/fit", "outdated-fit", detail).suggest("post the job again")]
    })
}

/// The model of a fit, with the variants and sets that it was made with.
///
/// # Errors
/// Faults where the fit does not say what it was made from, its model is gone, or its parameters are no
/// longer those of the model.
pub fn model_of(catalogue: &Catalogue, fit: &Fit) -> Result<Model, Vec<Fault>> {
    let id =
        fit.model.parse().map_err(|error: NotAModelId| one("/model", "unknown-model", error.to_string()))?;
    let model = bound(catalogue, &id, basis(fit)?)?;
    let names = model.parameters().iter().map(|parameter| parameter.name.as_str());
    if !names.eq(fit.parameters.keys().map(String::as_str)) {
        let detail = format!("`{id}` no longer has the parameters of this fit: its documents have changed");
        return Err(one("/model", "model-changed", detail));
    }
    Ok(model)
}

/// The first and the last instant of a fit's window, in milliseconds.
///
/// # Errors
/// A fault where the fit does not say.
pub fn window_of(fit: &Fit) -> Result<(i64, i64), Vec<Fault>> {
    let last = fit.parts.test.as_ref().or(fit.parts.validation.as_ref()).unwrap_or(&fit.parts.train);
    Ok((start(&fit.parts)?, time(&last.to)?))
}

fn one(pointer: &str, code: &str, detail: impl Into<String>) -> Vec<Fault> {
    vec![Fault::new(pointer, code, detail)]
}

fn time(text: &str) -> Result<i64, Vec<Fault>> {
    read_time("/parts", text).map_err(|fault| vec![fault])
}

fn start(parts: &Parts) -> Result<i64, Vec<Fault>> {
    time(&parts.train.from)
}

/// The parts of a stored fit as samples of a grid that starts so many samples before them.
fn split(parts: &Parts, step: i64, lead: usize) -> Result<Split, Vec<Fault>> {
    if step <= 0 {
        return Err(one("/sample_s", "bad-step", "the fit has no step between samples"));
    }
    let start = start(parts)?;
    let index = |text: &str| {
        Ok::<usize, Vec<Fault>>(lead + usize::try_from((time(text)? - start) / step).unwrap_or(0))
    };
    let range = |span: &Option<Span>, after: usize| match span {
        Some(span) => Ok::<Range<usize>, Vec<Fault>>(index(&span.from)?..index(&span.to)? + 1),
        None => Ok(after..after),
    };
    let train = lead..index(&parts.train.to)? + 1;
    let validation = range(&parts.validation, train.end)?;
    let test = range(&parts.test, validation.end)?;
    Ok(Split { train, validation, test })
}

/// The stretch and the channels that the fit was made from, and what was measured since up to `until`.
fn offered(window: &Window, basis: &Basis, until: Option<i64>) -> Result<Window, Vec<Fault>> {
    let (from, to) = (time(&basis.from)?, time(&basis.to)?);
    let series = window.slice(from, until.unwrap_or(to).max(to))?;
    Window::from_series(
        series
            .iter()
            .filter(|series| basis.channels.iter().any(|channel| channel == series.channel()))
            .cloned()
            .collect(),
    )
}

fn provenance(problem: &Problem, fit: &Fit, trajectory: &Trajectory, model_changed: bool) -> Provenance {
    let measurements_changed = problem.input_hash() != fit.input_hash;
    let reproduced = fit.metrics.values().enumerate().all(|(output, stored)| {
        let again =
            problem.mean_square_error(trajectory, output, problem.split().train.clone()).map(f64::sqrt);
        again.is_some_and(|again| (again - stored.train_rmse).abs() <= SAME * stored.train_rmse)
    });
    let comment = match (measurements_changed, model_changed, reproduced) {
        (false, false, true) => "the measurements and the model are those that the fit was made from",
        (true, false, _) => {
            "newer uploads or exclusions have changed the measurements of the fit's window since: what is \
            shown uses them as they are now, the stored errors belong to the older ones"
        }
        (false, true, _) => {
            "the documents of the model have changed since the fit: what is shown may differ from its stored \
            errors"
        }
        (true, true, _) => {
            "both the measurements of the fit's window and the documents of its model have changed since the \
            fit"
        }
        (false, false, false) => {
            "the stored errors do not come out again although measurements and model are the same"
        }
    };
    Provenance {
        input_hash: problem.input_hash().to_owned(),
        fit_input_hash: fit.input_hash.clone(),
        measurements_changed,
        model_changed,
        reproduced,
        comment: comment.to_owned(),
    }
}
