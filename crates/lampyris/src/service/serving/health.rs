//! How a system fares, in a word and a sentence, and what somebody can do about it: what a list of systems is
//! for.
//!
//! What is served is read off the body of `/params`, so that the two cannot disagree. Quality decides and not
//! age: what newer measurements contradict, effects that a diagnosis has named, errors beyond the noise or
//! beyond holding the last measurement. `attention` is only told where there is a next step.

use super::body::{Rendered, Status};
use crate::store::fits::ListedFit;
use crate::store::jobs::{JobKind, JobRecord, JobState, Outcome};
use crate::store::overview::PresentDiagnosis;
use indexmap::IndexMap;
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::{Duration, SystemId};
use lampyris_core::diagnose::{ADEQUATE_RHO, Adequacy};
use lampyris_core::estimate::fit::{AheadError, OutputMetrics};
use lampyris_core::estimate::gate::evidence::Role;
use lampyris_core::estimate::gate::served::ServedError;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How a system fares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Health {
    /// Nothing to do.
    Ok,
    /// Somebody can do something about it: the next step says what.
    Attention,
    /// What is served is not to be relied on, or nothing can be served.
    Bad,
    /// Nothing was ever validated, and nothing has failed yet.
    Unknown,
}

/// What somebody can do about a system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = NextStepCode)]
pub enum NextCode {
    /// Nothing.
    None,
    /// Wait for a job that waits or runs.
    Wait,
    /// Add an effect that a diagnosis has named.
    AddEffect,
    /// Find out what the model is missing.
    Diagnose,
    /// Estimate again.
    Refit,
    /// Decide on a fit that waits for an operator.
    Promote,
    /// Release the parameters that an operator holds.
    Unpin,
    /// Send measurements.
    Upload,
    /// Look at what is named: nobody but a person can judge it.
    Look,
}

/// The next step with a system.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct NextStep {
    /// What to do, in a word that stays.
    pub code: NextCode,
    /// The same for people.
    #[schema(example = "Add wind infiltration")]
    pub text: String,
    /// Where on the page.
    #[schema(example = "/ui/systems/room/4/missing")]
    pub href: String,
}

/// How a system fares, why, and what to do about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SystemHealth {
    /// In a word.
    pub health: Health,
    /// Why, in a sentence.
    pub why: String,
    /// What to do.
    pub next: NextStep,
}

/// What is known of a system.
#[derive(Debug, Clone, Copy)]
pub struct Facts<'a> {
    /// The system.
    pub system: &'a SystemId,
    /// What is served.
    pub served: Option<&'a Served>,
    /// Its newest job.
    pub newest: Option<&'a JobRecord>,
    /// Whether a fit that is newer than what is served waits for an operator.
    pub waits: bool,
    /// The fit that is served; where none is, the newest of its model.
    pub fit: Option<&'a ListedFit>,
    /// The newest diagnosis of its model.
    pub diagnosis: Option<&'a PresentDiagnosis>,
    /// The instant of its newest sample.
    pub measured_to: Option<Timestamp>,
    /// How old its measurements may be.
    pub stale_after: Duration,
    /// Now.
    pub now: Timestamp,
}

/// What the list says of what is served.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Served {
    status: String,
    fallback: Option<FallbackReason>,
    /// What the gate wants said.
    pub flags: Vec<String>,
    /// Errors by output.
    pub error: IndexMap<String, ServedError>,
    /// When it was found.
    pub fitted_at: Option<Timestamp>,
    /// When the gate last found it fit to be served.
    pub validated_at: Option<Timestamp>,
    /// When it turns stale.
    pub stale_after: Option<Timestamp>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
struct FallbackReason {
    reason: String,
    job: String,
}

impl Served {
    /// Reads the body that is served; nothing where it cannot be read.
    pub fn of(rendered: &Rendered) -> Option<Self> {
        serde_json::from_slice(&rendered.body).ok()
    }
}

/// What is known at a horizon, or at the longest one below it that is known; else at the shortest.
pub fn ahead<T>(known: &IndexMap<String, T>, horizon: Duration) -> Option<(&str, &T)> {
    let known = || known.iter().filter_map(|(name, of)| Some((name.parse::<Duration>().ok()?, name, of)));
    let below = known().filter(|(length, ..)| *length <= horizon).max_by_key(|(length, ..)| *length);
    below.or_else(|| known().min_by_key(|(length, ..)| *length)).map(|(_, name, of)| (name.as_str(), of))
}

/// The output whose error is farthest above what noise would leave; the first where nothing says that.
pub fn worst_output(metrics: &IndexMap<String, OutputMetrics>) -> Option<(&str, &OutputMetrics)> {
    let far = |metrics: &OutputMetrics| metrics.rho.unwrap_or(f64::NEG_INFINITY);
    // Of equals the first.
    let worst = metrics.iter().rev().max_by(|(_, a), (_, b)| far(a).total_cmp(&far(b)))?;
    Some((worst.0, worst.1))
}

/// How a system fares, why, and what to do about it.
pub fn health_of(facts: &Facts) -> SystemHealth {
    let found = match facts.served {
        Some(served) => facts.of_served(served),
        None => facts.never_validated(),
    };
    match facts.under_way() {
        Some(kind) if is_about(found.next.code, kind) => SystemHealth { next: facts.wait(), ..found },
        _ => found,
    }
}

/// How a site fares that has no model and only holds measurements.
pub fn health_of_site(facts: &Facts) -> SystemHealth {
    facts.not_measured().unwrap_or_else(|| {
        let why = "Its measurements are shared; there is nothing to estimate.";
        SystemHealth::new(Health::Ok, why, facts.nothing())
    })
}

/// Whether a job of this kind is the step itself.
fn is_about(code: NextCode, kind: JobKind) -> bool {
    matches!((code, kind), (NextCode::Refit, JobKind::Estimate) | (NextCode::Diagnose, JobKind::Diagnose))
}

impl SystemHealth {
    fn new(health: Health, why: impl Into<String>, next: NextStep) -> Self {
        Self { health, why: why.into(), next }
    }
}

impl Facts<'_> {
    /// A step that is taken at a tab of the system's page.
    fn step(&self, code: NextCode, text: impl Into<String>, tab: &str) -> NextStep {
        NextStep { code, text: text.into(), href: format!("/ui/systems/{}{tab}", self.system) }
    }

    fn nothing(&self) -> NextStep {
        self.step(NextCode::None, "Nothing to do", "")
    }

    /// The newest job that says something about what is served: an experiment does not.
    fn newest(&self) -> Option<&JobRecord> {
        self.newest.filter(|job| !job.experiment)
    }

    /// The kind of the newest job while it waits or runs.
    fn under_way(&self) -> Option<JobKind> {
        let is_open =
            |job: &&JobRecord| matches!(job.state, JobState::Queued { .. } | JobState::Running { .. });
        self.newest().filter(is_open).map(|job| job.kind)
    }

    fn wait(&self) -> NextStep {
        self.at_job(
            NextCode::Wait,
            "Wait for the job that is under way",
            self.newest().map(|job| job.id.as_str()),
        )
    }

    fn at_job(&self, code: NextCode, text: &str, job: Option<&str>) -> NextStep {
        match job {
            Some(job) => NextStep { code, text: text.to_owned(), href: format!("/ui/jobs/{job}") },
            None => self.step(code, text, ""),
        }
    }

    fn decide(&self) -> NextStep {
        self.step(NextCode::Promote, "Decide on the fit that waits", "/parameters")
    }

    fn see_checks(&self) -> NextStep {
        self.step(NextCode::Look, "See which checks the fit has failed", "/parameters")
    }

    fn of_served(&self, served: &Served) -> SystemHealth {
        self.contradicted(served)
            .or_else(|| self.decided(served))
            .or_else(|| self.fallen(served))
            .or_else(|| self.lacking())
            .or_else(|| self.erring(served))
            .or_else(|| self.flagged(served))
            .or_else(|| self.not_measured())
            .or_else(|| self.not_validated(served))
            .unwrap_or_else(|| SystemHealth::new(Health::Ok, "The parameters are fresh.", self.nothing()))
    }

    /// Newer measurements say that it is wrong.
    fn contradicted(&self, served: &Served) -> Option<SystemHealth> {
        let refit = || self.step(NextCode::Refit, "Refit it", "");
        (served.status == "degraded").then(|| SystemHealth::new(Health::Bad, Status::CONTRADICTED, refit()))
    }

    /// An operator holds it, or has not decided yet.
    fn decided(&self, served: &Served) -> Option<SystemHealth> {
        if served.status == "pinned" {
            let release = self.step(NextCode::Unpin, "Release the parameters that are held", "/parameters");
            return Some(SystemHealth::new(Health::Attention, "An operator holds the parameters.", release));
        }
        self.waits
            .then(|| SystemHealth::new(Health::Attention, "A fit waits for an operator.", self.decide()))
    }

    /// The newest attempt came to nothing.
    fn fallen(&self, served: &Served) -> Option<SystemHealth> {
        let FallbackReason { reason, job } = served.fallback.as_ref()?;
        let (failure, next) = match reason.as_str() {
            "validation_failed" => ("the newest fit was rejected", self.see_checks()),
            _ => (
                "the newest job failed",
                self.at_job(NextCode::Refit, "Refit it, or see why it failed", Some(job)),
            ),
        };
        Some(SystemHealth::new(
            Health::Attention,
            format!("The previous parameters are served: {failure}."),
            next,
        ))
    }

    /// A diagnosis of its model has named an effect that it does not have.
    fn lacking(&self) -> Option<SystemHealth> {
        let missing = self.diagnosis?.missing.as_ref()?;
        let size = missing.size.as_ref().map_or_else(String::new, |size| format!(" {}", size.sentence()));
        let text = format!("Add {}", uncapitalised(&missing.title));
        let next = self.step(NextCode::AddEffect, text, "/missing");
        Some(SystemHealth::new(Health::Attention, format!("{} is missing.{size}", missing.title), next))
    }

    /// It errs by more than it should, and somebody can find out why.
    fn erring(&self, served: &Served) -> Option<SystemHealth> {
        let verdict = self.diagnosis.map(|diagnosis| diagnosis.verdict);
        if verdict == Some(Adequacy::Adequate) {
            return None;
        }
        let error = self.error(served)?;
        let (why, next) = match verdict {
            Some(Adequacy::Unknown | Adequacy::Named) => (
                "no known effect explains it",
                self.step(NextCode::Look, "See what no effect explains", "/missing"),
            ),
            Some(Adequacy::NotEnoughData) => (
                "the measurements are too short to say why",
                self.step(NextCode::Upload, "Upload more measurements", "/data"),
            ),
            Some(Adequacy::Adequate) | None => (
                "nobody has looked for what its model is missing",
                self.step(NextCode::Diagnose, "Find what is missing", "/missing"),
            ),
        };
        Some(SystemHealth::new(Health::Attention, format!("{error}, and {why}."), next))
    }

    /// What is wrong with its errors: at some horizon they are above those of holding the last measurement,
    /// or they are above what noise would leave.
    fn error(&self, served: &Served) -> Option<String> {
        let metrics = &self.fit?.metrics;
        let lost = metrics
            .iter()
            .flat_map(|(output, of)| {
                of.ahead.iter().map(move |(name, error)| (output, &of.unit, name, error))
            })
            .find(|(.., error)| error.rmse > error.persistence);
        if let Some((output, unit, horizon, AheadError { rmse, persistence, .. })) = lost {
            let hours = horizon.parse::<Duration>().map_or(0.0, Duration::hours);
            return Some(format!(
                "{hours} h ahead, holding the last measurement of {output} errs less ({persistence:.2} {unit}) \
                than the model does ({rmse:.2} {unit})"
            ));
        }
        if served.flags.iter().any(|flag| flag == "barely_better_than_persistence") {
            return Some("Its forecasts are hardly better than holding the last measurement".to_owned());
        }
        let (output, rho) = worst_output(metrics).and_then(|(output, of)| Some((output, of.rho?)))?;
        (rho >= ADEQUATE_RHO)
            .then(|| format!("The error of {output} is {rho:.1} times what noise would leave"))
    }

    /// The gate has flagged something that a person can look at.
    fn flagged(&self, served: &Served) -> Option<SystemHealth> {
        let flags: Vec<&str> =
            served.flags.iter().map(String::as_str).filter(|flag| !is_harmless(flag)).collect();
        let has = |kind: &str| flags.iter().find_map(|flag| flag.strip_prefix(kind));
        let next = if let Some(channel) = has("unseen:") {
            self.step(NextCode::Look, format!("Check the channel {channel}"), "/data")
        } else if has("at_bound:").is_some() {
            self.step(NextCode::Look, "See what lies at a bound", "/parameters")
        } else if has("low_confidence").is_some() {
            self.step(NextCode::Refit, "Refit it with a larger budget", "")
        } else {
            self.step(NextCode::Look, "See what the gate has flagged", "/parameters")
        };
        let why = || format!("The gate has flagged the parameters: {}.", flags.join(", "));
        (!flags.is_empty()).then(|| SystemHealth::new(Health::Attention, why(), next))
    }

    /// Nothing new was measured for longer than the policy wants.
    fn not_measured(&self) -> Option<SystemHealth> {
        let newest = self.measured_to?;
        let age = self.now.duration_since(newest);
        let next = || self.step(NextCode::Upload, "Upload or connect measurements", "/data");
        (age > SignedDuration::from_millis(self.stale_after.millis())).then(|| {
            SystemHealth::new(
                Health::Attention,
                format!("No new measurements since {}.", day(newest)),
                next(),
            )
        })
    }

    /// There is something newer to validate it on.
    fn not_validated(&self, served: &Served) -> Option<SystemHealth> {
        let validated_at = served.validated_at.filter(|_| served.status == "stale")?;
        let why =
            format!("It was last validated on {}, and there are newer measurements.", day(validated_at));
        Some(SystemHealth::new(Health::Attention, why, self.step(NextCode::Refit, "Refit it", "")))
    }

    fn never_validated(&self) -> SystemHealth {
        let fit = || self.step(NextCode::Refit, "Fit it", "");
        if self.waits {
            // The fit stays in sight on the system's page; what it lacks has to be looked for.
            let (why, next) = match self.lacking() {
                Some(lacking) => (format!(" {}", lacking.why), lacking.next),
                None => (String::new(), self.decide()),
            };
            let why = format!("No fit was ever accepted, and a fit waits for an operator.{why}");
            return SystemHealth::new(Health::Attention, why, next);
        }
        let Some(job) = self.newest() else {
            let next = match self.measured_to {
                Some(_) => fit(),
                None => self.step(NextCode::Upload, "Upload measurements", "/data"),
            };
            return SystemHealth::new(Health::Unknown, "Nothing was estimated yet.", next);
        };
        let (health, why, next) = match &job.state {
            JobState::Queued { .. } | JobState::Running { .. } => {
                (Health::Unknown, "the newest job has not ended", self.wait())
            }
            JobState::Cancelled { .. } => (Health::Unknown, "the newest job was cancelled", fit()),
            JobState::Failed { .. } => {
                let see = self.at_job(NextCode::Look, "See why the job failed", Some(&job.id));
                (Health::Bad, "the newest job failed", see)
            }
            JobState::Succeeded { result, .. } => match result.outcome() {
                Some(Outcome::Rejected) => {
                    let next = self.lacking().map_or_else(|| self.see_checks(), |lacking| lacking.next);
                    (Health::Bad, "the newest fit was rejected", next)
                }
                _ => (Health::Unknown, "the newest fit does not count for what is served", fit()),
            },
        };
        SystemHealth::new(health, format!("No fit was ever accepted, and {why}."), next)
    }
}

/// Whether a flag takes nothing from the forecasts, or is an operator's own word. What the data leave open
/// does not change forecasts over such data; heat that was never seen to do anything does, as the controller
/// moves it. What is said about persistence is told as an error.
fn is_harmless(flag: &str) -> bool {
    match flag.split_once(':').unwrap_or((flag, "")) {
        ("unseen", channel) => Role::of(channel) != Role::Heat,
        (kind, _) => [
            "non_identifiable",
            "undetermined",
            "barely_better_than_persistence",
            "promoted_by_operator",
            "waived",
        ]
        .contains(&kind),
    }
}

/// A title in the middle of a sentence: a first letter that stands for no abbreviation is small.
pub fn uncapitalised(title: &str) -> String {
    let mut letters = title.chars();
    match (letters.next(), letters.clone().next()) {
        (Some(first), Some(second)) if second.is_lowercase() => first.to_lowercase().chain(letters).collect(),
        _ => title.to_owned(),
    }
}

fn day(instant: Timestamp) -> impl std::fmt::Display {
    instant.strftime("%-d %b %Y")
}
