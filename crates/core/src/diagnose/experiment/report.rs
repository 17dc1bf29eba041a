//! What is answered: plans, what each teaches and costs, and that in plain sentences.

use super::asked::{ExperimentAsked, ExperimentPurpose};
use super::plans::PlanFamily;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What is called told apart: a t of three.
const TOLD: f64 = 3.0;

/// What a plan teaches of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExpectedLesson {
    /// The parameter.
    pub parameter: String,
    /// Its unit.
    pub unit: String,
    /// The estimate by segments of hours.
    pub value: f64,
    /// The unit of the widths: its own, or per cent of the estimate where it is searched on a logarithmic
    /// scale and cannot be nothing.
    pub width_unit: String,
    /// The width of its 95 % interval now.
    pub width_before: f64,
    /// The width that is expected behind the experiment.
    pub width_after: f64,
    /// Of which size `t` speaks: the estimate, or that of an effect of a typical size.
    pub size: f64,
    /// The size over the deviation of the estimate now.
    pub t_before: f64,
    /// The same behind the experiment.
    pub t_after: f64,
}

/// How two estimates err together: 1 and -1 cannot be told apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExpectedTie {
    /// The two parameters.
    pub parameters: [String; 2],
    /// Their correlation now.
    pub correlation_before: f64,
    /// The correlation that is expected behind the experiment.
    pub correlation_after: f64,
}

/// An input or output of a plan, a value at each of its instants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlannedSeries {
    /// The unit of the values.
    pub unit: String,
    /// The values.
    pub values: Vec<f64>,
    /// Standard deviations of what is only expected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sd: Option<Vec<f64>>,
}

/// What a plan is expected to cost in comfort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ComfortCost {
    /// Expected hours outside the bounds, in the mean of the draws of the parameters and of the weather.
    pub hours_outside: f64,
    /// The same for the worst of them.
    pub worst_hours: f64,
    /// How far an output leaves them at the worst instant, with 95 % and for every draw of the parameters, in
    /// its unit; zero where it does not.
    pub largest_excursion: f64,
}

/// A plan: the inputs, and what they would teach and cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExperimentPlan {
    /// How its sequences were made.
    pub family: PlanFamily,
    /// What it teaches and costs, in a sentence.
    pub sentence: String,
    /// What it teaches of every parameter, those that it is about first.
    pub lessons: Vec<ExpectedLesson>,
    /// Parameters that are tied now or behind it, those that it is about always.
    pub ties: Vec<ExpectedTie>,
    /// What it costs.
    pub comfort: ComfortCost,
    /// The driven inputs by channel.
    pub inputs: IndexMap<String, PlannedSeries>,
    /// The outputs that are expected, by channel.
    pub outputs: IndexMap<String, PlannedSeries>,
}

/// What the inputs that nobody drives are taken to be.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ExperimentWeather {
    /// The first instant of the days that are taken to come once more.
    #[schema(format = DateTime)]
    pub measured_from: String,
    /// The last one.
    #[schema(format = DateTime)]
    pub measured_to: String,
    /// The inputs that are as they were forecast instead.
    pub forecast: Vec<String>,
}

/// The best plans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Experiment {
    /// What it is for.
    pub purpose: ExperimentPurpose,
    /// The parameters that it is about.
    pub about: Vec<String>,
    /// What it says, in plain sentences.
    pub sentences: Vec<String>,
    /// The weather that is counted on.
    pub weather: ExperimentWeather,
    /// The best of each family, the best first.
    pub plans: Vec<ExperimentPlan>,
    /// How many sequences were tried, and how many of them broke the comfort bounds.
    pub tried: usize,
    /// Those that were left out because they would leave the comfort bounds.
    pub uncomfortable: usize,
    /// What comfort is expected to cost if nobody drives anything; `null` where the model leaves the numbers.
    pub undriven: Option<ComfortCost>,
    /// The instants of every plan.
    #[schema(value_type = Vec<String>)]
    pub time: Vec<String>,
}

/// What a plan teaches and costs.
pub(super) fn sentence(plan: &ExperimentPlan, asked: &ExperimentAsked, unit: &str) -> String {
    let about = &plan.lessons[..asked.about.len().min(plan.lessons.len())];
    let lesson = |one: &ExpectedLesson| {
        format!(
            "the interval of {} narrows from {:.2} to {:.2} {} (t {:.1} to {:.1})",
            one.parameter, one.width_before, one.width_after, one.width_unit, one.t_before, one.t_after
        )
    };
    let comfort = if asked.comfort.is_empty() {
        "no comfort bounds were given".to_owned()
    } else if plan.comfort.largest_excursion > 0.0 {
        format!(
            "{:.1} h outside the comfort bounds are expected, {:.1} {unit} at the worst",
            plan.comfort.hours_outside, plan.comfort.largest_excursion
        )
    } else {
        "the comfort bounds are kept".to_owned()
    };
    let lessons: Vec<String> = about.iter().map(lesson).collect();
    format!("With {}, {}; {comfort}.", plan.family.words(), lessons.join(", "))
}

/// What all of it says.
pub(super) fn sentences(found: &Experiment, asked: &ExperimentAsked) -> Vec<String> {
    let Some(best) = found.plans.first() else {
        let mut said = vec![format!(
            "None of {} sequences keeps the comfort bounds: widen them, or narrow the range of the inputs.",
            found.tried
        )];
        said.extend(found.undriven.iter().filter(|cost| cost.hours_outside >= 0.1).map(|cost| {
            format!("Without an experiment {:.1} h outside them are expected as well.", cost.hours_outside)
        }));
        return said;
    };
    let about = best.lessons.iter().take(asked.about.len());
    let least = |t: fn(&ExpectedLesson) -> f64| about.clone().map(t).fold(f64::INFINITY, f64::min);
    let (before, after) = (least(|one| one.t_before), least(|one| one.t_after));
    let what = asked.about.join(" and ");
    let first = match asked.purpose {
        ExperimentPurpose::Separate if after >= TOLD => format!(
            "{what} can be told apart in {} days: the lesser t is expected to rise from {before:.1} to \
            {after:.1}.",
            asked.days
        ),
        ExperimentPurpose::Separate => format!(
            "{what} will hardly be told apart in {} days by these inputs: the lesser t is expected to go \
            from {before:.1} to {after:.1}, and 3 is wanted.",
            asked.days
        ),
        ExperimentPurpose::Determine => {
            format!("Of {what} the least certain is expected at t {after:.1}, {before:.1} now.")
        }
        ExperimentPurpose::Detect if after >= TOLD => {
            format!("An effect of a typical size would be seen: t {after:.1} is expected, {before:.1} now.")
        }
        ExperimentPurpose::Detect => format!(
            "An effect of a typical size would hardly be seen: t {after:.1} is expected, {before:.1} now."
        ),
    };
    let ExperimentWeather { measured_from, measured_to, forecast } = &found.weather;
    let forecast = match forecast.as_slice() {
        [] => String::new(),
        some => format!(", but for the forecast of {}", some.join(", ")),
    };
    let weather = format!("The weather is taken to be that of {measured_from} to {measured_to}{forecast}.");
    vec![first, best.sentence.clone(), weather]
}
