//! How a diagnosis of a world came out whose truth is known.

use lampyris_core::diagnose::Diagnosis;
use lampyris_core::diagnose::report::Finding;
use lampyris_core::twin::{HiddenEffect, Level, Truth};

/// An effect is material when knowing the truth cuts the test error by this share.
pub const MATERIAL: f64 = 0.10;

/// How a world came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    Right,
    Wrong,
    /// A group of more than two that holds the truth.
    Vague,
    Silent,
}

/// A world and its diagnosis.
pub struct Judged {
    pub kind: String,
    pub level: Level,
    pub truth: Truth,
    pub diagnosis: Diagnosis,
    pub first: Outcome,
    /// How many of the hidden effects are named.
    pub found: usize,
    /// Root mean square error of the free run over the test part: without any effect, and with the true ones.
    pub test: [Option<f64>; 2],
    pub logged: bool,
}

impl Judged {
    /// Whether the true effects, given to the model, cut the test error by a tenth.
    pub fn material(&self) -> bool {
        matches!(self.test, [Some(without), Some(with)] if with <= (1.0 - MATERIAL) * without)
    }

    /// The test error without anything that was named, and with all of it.
    pub fn named(&self) -> Option<[f64; 2]> {
        let first = self.diagnosis.findings.first()?.rmse.test?;
        let last = self.diagnosis.findings.last()?.rmse.test?;
        Some([first[0], last[1]])
    }

    /// The finding of the one hidden effect.
    pub fn hit(&self) -> Option<(&HiddenEffect, &Finding)> {
        let ([hidden], Some(finding)) = (self.truth.effects.as_slice(), self.diagnosis.findings.first())
        else {
            return None;
        };
        same(finding.named(), &hidden.effect).then_some((hidden, finding))
    }

    /// Whether the interval of what forecasts lose without it holds the truth, where the one hidden effect
    /// was named.
    pub fn covered(&self) -> Option<bool> {
        let [low, high] = self.hit()?.1.size.as_ref()?.ci95?;
        Some((low..=high).contains(&self.truth.ahead))
    }

    /// The same of the coefficient and the true strength, where there is one coefficient. Shapes of the truth
    /// differ from those of the catalogue, and a rich room has other masses.
    pub fn covered_strength(&self) -> Option<bool> {
        let (hidden, finding) = self.hit()?;
        let (1, Some(coefficient)) = (finding.parameters.len(), finding.parameters.values().next()) else {
            return None;
        };
        let [low, high] = coefficient.ci95?;
        Some((low..=high).contains(&hidden.strength))
    }
}

/// Whether a name means the hidden effect. Hours of a set-back are its size, not its name.
pub fn same(named: &str, hidden: &str) -> bool {
    named == hidden || (hidden == "night_setback" && named.starts_with("night_setback:"))
}
