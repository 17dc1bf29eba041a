//! The documents of a diagnosis, as they are stored, printed and served.

use super::evidence::Shape;
use super::ledger::{EffectScore, LedgerEntry, Looked, Pooled, entries};
use super::library::NotTestable;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a diagnosis comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Adequacy {
    /// At least one effect is named.
    Named,
    /// The model explains the data down to its noise.
    Adequate,
    /// Something is missing that the catalogue does not have.
    Unknown,
    /// The record is too short to tell.
    NotEnoughData,
}

impl Adequacy {
    /// It as documents write it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Named => "named",
            Self::Adequate => "adequate",
            Self::Unknown => "unknown",
            Self::NotEnoughData => "not_enough_data",
        }
    }
}

/// Which effect a model is missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Diagnosis {
    /// The system, where there is one.
    pub system: Option<String>,
    /// The model that was diagnosed.
    pub model: String,
    /// The fit that it started from, where it is stored.
    pub fit: Option<String>,
    /// The verdict.
    pub verdict: Adequacy,
    /// In a sentence.
    pub summary: String,
    /// Free-run error over the innovation deviation of its AR model, after the last finding.
    pub rho: Option<f64>,
    /// One-step innovation error of the free-run residual, in the output's unit; of several outputs, in the
    /// noise of their sensors.
    pub noise_floor_rmse: Option<f64>,
    /// What is missing, the most telling first.
    pub findings: Vec<Finding>,
    /// Everything that was tried in the first round.
    pub considered: Vec<Considered>,
    /// What these data cannot show. Silence is not absence.
    pub not_testable: Vec<NotTestable>,
    /// What no effect explains.
    pub unexplained: Unexplained,
    /// What segments of hours show of everything that was tried in the first round, for the ledger of the
    /// system; `null` where nothing could be looked at, and in a diagnosis that was made before there was
    /// one.
    #[serde(default)]
    pub looked: Option<Looked>,
    /// What this window shows of the effects that the model has already.
    #[serde(default)]
    pub present: Vec<PresentEffect>,
    /// What a reader should know of the data.
    pub warnings: Vec<String>,
    /// Simulations of every round, for benches.
    #[serde(skip)]
    pub evaluations: Vec<usize>,
}

impl Diagnosis {
    /// What its window adds to the ledger of the system, beside the model that was diagnosed and beside those
    /// that lack one of its effects.
    pub fn entries(&self, id: &str, model_hash: Option<&str>) -> Vec<LedgerEntry> {
        let Some((looked, span)) = self.looked.as_ref().and_then(|looked| Some((looked, looked.span()?)))
        else {
            return Vec::new();
        };
        let mut all = entries(span, id, (&self.model, model_hash), looked.effects.iter());
        for one in &self.present {
            all.extend(entries(span, id, (&one.model, Some(&one.model_hash)), std::iter::once(&one.score)));
        }
        all
    }
}

/// What a window shows of an effect that the model has already, beside the model without it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PresentEffect {
    /// The effect's id.
    pub effect: String,
    /// A short title for people.
    pub title: String,
    /// The model without it.
    pub model: String,
    /// That model's content hash.
    pub model_hash: String,
    /// What this window shows of it.
    pub score: EffectScore,
    /// What it shows together with earlier windows of the model without it; `null` where it has no size.
    pub pooled: Option<Pooled>,
    /// For people.
    pub sentence: String,
}

/// A finding is the cause of an error, or repairs what an earlier finding left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// It explains a good part of the error on unseen data.
    Cause,
    /// It came late and explains little.
    Refinement,
}

/// One missing effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Finding {
    /// 1 is the first.
    pub rank: usize,
    /// The effect's id.
    pub effect: String,
    /// The effect that was named, where this is another way of its heat into the room.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub way_of: Option<String>,
    /// A short title for people.
    pub title: String,
    /// One sentence that an operator understands.
    pub explain: String,
    /// Gain of the AR likelihood's BIC over the model without it.
    pub delta_bic: f64,
    /// Share of the unseen squared error beyond the noise that it explains.
    pub explained_share: Option<f64>,
    /// Errors without and with it.
    pub rmse: RmsePairs,
    /// What a forecast loses without it; `null` of a plant, and in a diagnosis that was made before it was
    /// asked.
    #[serde(default)]
    pub size: Option<EffectSize>,
    /// Its parameters, from segments of a day where segments have shown it, else from the likelihood that
    /// has; of a plant from the free run.
    #[schema(value_type = HashMap<String, Coefficient>)]
    pub parameters: IndexMap<String, Coefficient>,
    /// Effects that the data cannot tell from it.
    pub tied_with: Vec<String>,
    /// What would tell them apart.
    pub separate_by: Option<String>,
    /// Cause or refinement.
    pub kind: FindingKind,
    /// Why, in sentences.
    pub evidence: Vec<String>,
    /// What segments of hours show of it; `null` where no logged channel drives it, or where they are not
    /// sure of it.
    #[serde(default)]
    pub segments: Option<SegmentEvidence>,
    /// What this window shows of it together with earlier ones of the same base model; `null` where it was
    /// not looked at.
    #[serde(default)]
    pub pooled: Option<Pooled>,
    /// The unexplained error beside the effect's own shape; `null` in a diagnosis that was made before there
    /// were any.
    pub shape: Option<Shape>,
}

impl Finding {
    /// The effect that was named, whatever the way of its heat.
    pub fn named(&self) -> &str {
        self.way_of.as_deref().unwrap_or(&self.effect)
    }
}

/// What segments of hours with states of their own show of an effect (score test, robust by days).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SegmentEvidence {
    /// Hours of a segment: how far ahead the error is that the effect explains.
    pub hours: f64,
    /// The effect's size, in the unit of its first parameter.
    pub size: f64,
    /// The share of the squared error over these hours that it explains.
    pub share: f64,
    /// The size over its deviation, robust by days.
    pub t: f64,
    /// The same beyond whatever happens at the same hours every day.
    pub beyond_clock: f64,
    /// Days that were looked at.
    pub days: usize,
    /// The share that it explains of each half of the days with the size from the other half.
    pub confirmed_share: f64,
    /// Shifts of its channels by whole days that were tried; 0 where several windows show it together.
    pub shifts: usize,
    /// The share of them, itself counted, with which it does as well.
    pub shift_p: f64,
    /// The chance that any effect of the catalogue is shown so clearly, over any length, where none is there.
    pub p: f64,
    /// Windows that show it together: 1 where this one does by itself.
    #[serde(default = "one")]
    pub windows: usize,
}

fn one() -> usize {
    1
}

/// Free-run errors without and with an effect, in the output's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RmsePairs {
    /// The training part.
    #[schema(min_items = 2, max_items = 2)]
    pub train: [f64; 2],
    /// The validation part, which decides.
    #[schema(min_items = 2, max_items = 2)]
    pub validation: Option<[f64; 2]>,
    /// The test part, which no decision sees.
    #[schema(min_items = 2, max_items = 2)]
    pub test: Option<[f64; 2]>,
    /// Forecasts from re-estimated states over the validation part, by horizon.
    #[schema(value_type = HashMap<String, [f64; 2]>)]
    pub validation_ahead: IndexMap<String, [f64; 2]>,
}

/// How large an effect is in what a controller sees: how far a forecast over some hours goes wrong without
/// it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EffectSize {
    /// Length of the forecasts.
    pub hours: f64,
    /// Root mean square of the difference that it makes over these hours, in the whole window.
    pub value: f64,
    /// Its 95 % interval, robust by days; `null` where the data do not determine it, or where it is read off
    /// the output itself.
    pub ci95: Option<[f64; 2]>,
    /// The output's unit.
    pub unit: String,
}

impl EffectSize {
    /// It for people.
    pub fn sentence(&self) -> String {
        let Self { hours, value, ci95, unit } = self;
        let interval = ci95.map_or_else(String::new, |[low, high]| format!(" (95 %: {low:.2} to {high:.2})"));
        format!(
            "Left out, it puts forecasts over the next {hours:.0} h wrong by {value:.2} {unit}{interval}."
        )
    }
}

/// A coefficient of a finding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Coefficient {
    /// Its value.
    pub value: f64,
    /// Its 95 % interval, robust by days; `null` where the data do not determine it, or where it is read off
    /// the output itself.
    pub ci95: Option<[f64; 2]>,
    /// Its unit.
    pub unit: String,
    /// Whether it lies on a bound, where its value is a limit and no estimate.
    pub at_bound: bool,
}

/// What stopped a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Gate)]
pub enum EffectGate {
    /// The likelihood gains too little.
    Bic,
    /// The error on unseen data does not really fall.
    HeldOut,
    /// Physics does not allow its sign.
    Sign,
    /// It ended where it does nothing, or at a limit beyond which it would be something else.
    Bound,
    /// It cannot be told from a better one.
    Tie,
}

/// A candidate and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Considered {
    /// The effect's id.
    pub effect: String,
    /// The score of the preview.
    pub score: f64,
    /// Gain of the AR likelihood's BIC, where it was refitted.
    pub delta_bic: Option<f64>,
    /// Share of the unseen squared error beyond the noise that it explains.
    pub explained_share: Option<f64>,
    /// What stopped it; nothing for a finding.
    pub gate: Option<EffectGate>,
    /// In a sentence.
    pub why: String,
    /// The measures that the gates looked at, for benches.
    #[serde(skip)]
    pub measures: Option<Measures>,
}

/// What the gates look at, beside the gain and the share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measures {
    /// The unseen free-run error with it over that without it.
    pub fall: Option<f64>,
    /// Share of the unseen innovations that it explains.
    pub white_share: Option<f64>,
    /// Gain of the BIC on three-hourly means.
    pub slow_delta_bic: Option<f64>,
    /// Share of the squared error a day ahead that it explains.
    pub ahead_share: Option<f64>,
    /// Share of the days on which the free run errs less with it: training, validation.
    pub better_days: [f64; 2],
    /// Ratio of free-run error to innovation deviation with it.
    pub rho: f64,
    /// Simulations of its refit.
    pub evaluations: usize,
}

/// The shape of what no effect explains.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Unexplained {
    /// The output that the episodes are of: of several the one that fails most; empty in a diagnosis that was
    /// made before it was told, which has those of the first one.
    #[serde(default)]
    #[schema(example = "T_room")]
    pub output: String,
    /// Share of the model's squared error beyond the noise that is left.
    pub share: Option<f64>,
    /// Mean heat that is missing by hour of the local day, in K/h at the room air: 24 numbers.
    pub profile_by_hour: Vec<Option<f64>>,
    /// The six hours that err most, several times.
    pub episodes: Vec<super::failures::Episode>,
    /// What to measure or to write down.
    pub ask: Option<String>,
}

/// An instant preview of what may be missing, by the score test alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectPreview {
    /// The effect's id.
    pub effect: String,
    /// A short title for people.
    pub title: String,
    /// One sentence that an operator understands.
    pub explain: String,
    /// The score, less the price of the effect's parameters.
    pub score: f64,
}
