//! Rules of the gate that do not hold for a process, each with the reason: in the document of a model, or in
//! the policy of a system.

use crate::fault::{Fault, nearest};
use indexmap::IndexMap;

/// Names of rules, or of all that begin so, and why each does not hold.
pub type Waivers = IndexMap<String, String>;

/// The rules that some process may break and be well: the others hold whatever is modelled.
pub const WAIVABLE: [&str; 9] = [
    "G5 largest error",
    "G5 excursion",
    "G8 excited",
    "G8 no unit jump",
    "G8 not stuck",
    "G9",
    "G10",
    "G11",
    "G12 determined",
];

/// The longest reason, in characters.
const LONGEST_REASON: usize = 400;

/// What makes no sense in waivers.
pub fn waiver_faults(pointer: &str, waivers: &Waivers) -> Vec<Fault> {
    let mut faults = Vec::new();
    for (rule, reason) in waivers {
        let fault = |code, detail: &str| Fault::new(format!("{pointer}/{rule}"), code, detail);
        if !WAIVABLE.iter().any(|waivable| covers(waivable, rule)) {
            let fault = fault("unknown-rule", "it is no rule of the gate that can be waived");
            faults.push(match nearest(rule, WAIVABLE) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault.suggest(format!("one of {}", WAIVABLE.join(", "))),
            });
        }
        if reason.trim().is_empty() || reason.chars().count() > LONGEST_REASON {
            faults.push(fault("no-reason", "say in at most 400 characters why the rule does not hold"));
        }
    }
    faults
}

/// Why a check is waived, where it is.
pub fn reason<'a>(waivers: &'a Waivers, check: &str) -> Option<&'a str> {
    waivers.iter().find(|(rule, _)| covers(rule, check)).map(|(_, reason)| reason.as_str())
}

/// Whether a check is the rule of a name, or one of those that begin with it.
fn covers(rule: &str, check: &str) -> bool {
    check.strip_prefix(rule).is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
}

#[cfg(test)]
mod tests {
    use super::{Waivers, reason, waiver_faults};

    #[test]
    fn a_waiver_names_a_rule_and_says_why() {
        let waivers = |rule: &str, reason: &str| Waivers::from([(rule.to_owned(), reason.to_owned())]);
        for rule in ["G9", "G9 right T_out", "G8 excited", "G11 level of T_out", "G12 determined"] {
            assert!(waiver_faults("/waive", &waivers(rule, "it is so")).is_empty(), "{rule}");
        }
        let codes = |rule: &str, reason: &str| -> Vec<String> {
            waiver_faults("/waive", &waivers(rule, reason)).into_iter().map(|fault| fault.code).collect()
        };
        for rule in
            ["G1 finite", "G2 bounds", "G3 stable", "G4 beats persistence", "G8 unseen data", "G90", ""]
        {
            assert_eq!(codes(rule, "it is so"), ["unknown-rule"], "{rule}");
        }
        assert_eq!(codes("G9", " "), ["no-reason"]);
        let waived = waivers("G9", "it is so");
        assert_eq!(reason(&waived, "G9 clock"), Some("it is so"));
        assert_eq!((reason(&waived, "G9clock"), reason(&waived, "G10 unseen days")), (None, None));
    }
}
