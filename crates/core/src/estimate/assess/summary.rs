//! What the numbers of a fit say, in plain sentences.

use super::replay::{Part, Provenance};
use super::skill::{HorizonSkill, PartSkill, Skill};
use crate::estimate::fit::OutputMetrics;

/// The horizons to speak of, the best one first.
const SPOKEN: [(&str, &str); 3] = [("PT6H", "6 h"), ("PT24H", "24 h"), ("PT1H", "1 h")];
/// A free-run error on unseen data this much larger than on training data is worth a word.
const MUCH_WORSE: f64 = 1.5;
/// A bias that makes more than this share of the error is an offset.
const OFFSET: f64 = 0.7;
/// From this ratio on, something physical is probably missing (measured on synthetic rooms).
const STRUCTURE: f64 = 1.6;

/// Speaks of one output: forecasts, free run, offset, structure, and whether the numbers belong to the stored
/// fit. `part` is the one that the horizons were judged on.
pub fn summary(
    part: Part,
    parts: &PartSkill,
    horizons: &[HorizonSkill],
    stored: Option<&OutputMetrics>,
    provenance: &Provenance,
) -> String {
    let mut sentences = Vec::new();
    let unit = &parts.unit;
    let data = if part == Part::Train { "the data that it was fitted to" } else { "unseen data" };
    let spoken = SPOKEN
        .iter()
        .find_map(|(name, words)| Some((*words, horizons.iter().find(|skill| skill.horizon == *name)?)));
    if let Some((words, skill)) = spoken {
        let ours = skill.skill.rmse;
        sentences.push(match skill.persistence_rmse {
            Some(held) if ours < held => {
                let less = 100.0 * (1.0 - ours / held);
                let held = number(held);
                format!(
                    "Forecasts {words} ahead err by {} {unit} on {data}, {less:.0} % less than holding \
                    the last measurement ({held} {unit}).",
                    number(ours)
                )
            }
            Some(held) => {
                format!(
                    "Forecasts {words} ahead err by {} {unit} on {data}: holding the last measurement would \
                    do no worse ({} {unit}).",
                    number(ours),
                    number(held)
                )
            }
            None => format!("Forecasts {words} ahead err by {} {unit} on {data}.", number(ours)),
        });
    }
    match (parts.train, parts.validation) {
        (Some(train), Some(unseen)) => {
            let (train, unseen) = (train.rmse, unseen.rmse);
            sentences.push(format!(
                "Left to itself the model errs by {} {unit} on unseen data and by {} {unit} on the data that \
                it was fitted to.",
                number(unseen),
                number(train)
            ));
            if unseen > MUCH_WORSE * train {
                sentences.push(
                    "That is much worse on what it has not seen: the fit follows something that \
                    does not repeat, or the conditions have changed."
                        .to_owned(),
                );
            }
        }
        (Some(train), None) => {
            sentences.push(format!(
                "Left to itself the model errs by {} {unit} on the data that it was fitted to; there are no \
                unseen data to judge it on.",
                number(train.rmse)
            ));
        }
        (None, _) => sentences.push("There is nothing that the model could be compared with.".to_owned()),
    }
    if let Some(offset) = parts
        .validation
        .or(parts.train)
        .filter(|skill| skill.bias.abs() > OFFSET * skill.rmse && skill.rmse > 0.0)
    {
        sentences.push(format!(
            "Most of that is an offset: on average the model is {} {unit} too {}.",
            number(offset.bias.abs()),
            side(unit, &offset)
        ));
    }
    if let Some(rho) = stored.and_then(|stored| stored.rho) {
        sentences.push(if rho < STRUCTURE {
            format!(
                "Its error is {rho:.1} times the noise that is left in it: there is little structure \
                that physics could explain."
            )
        } else {
            format!(
                "Its error is {rho:.1} times the noise that is left in it: something physical is \
                probably missing."
            )
        });
    }
    if provenance.measurements_changed || provenance.model_changed || !provenance.reproduced {
        sentences.push(format!("Mind that {}.", provenance.comment));
    }
    sentences.join(" ")
}

fn side(unit: &str, skill: &Skill) -> &'static str {
    match (unit == "K", skill.bias > 0.0) {
        (true, true) => "cold",
        (true, false) => "warm",
        (false, true) => "low",
        (false, false) => "high",
    }
}

/// A positive number with two digits that count.
fn number(value: f64) -> String {
    digits(value, 2.0)
}

/// A positive number with so many digits that count.
pub(in crate::estimate) fn digits(value: f64, count: f64) -> String {
    let digits = if value > 0.0 { (count - 1.0 - value.log10().floor()).clamp(0.0, 9.0) } else { 0.0 };
    format!("{value:.*}", digits as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use indexmap::IndexMap;

    fn skill(rmse: f64, bias: f64) -> Skill {
        Skill { n: 100, bias, rmse, urmse: (rmse * rmse - bias * bias).sqrt(), mae: rmse, r2: None }
    }

    fn told(train: f64, unseen: f64, bias: f64, ahead: f64, rho: f64, changed: bool) -> String {
        let parts = PartSkill {
            unit: "K".into(),
            train: Some(skill(train, 0.0)),
            validation: Some(skill(unseen, bias)),
            test: None,
        };
        let horizons =
            [HorizonSkill { horizon: "PT6H".into(), skill: skill(ahead, 0.0), persistence_rmse: Some(0.4) }];
        let stored = OutputMetrics {
            unit: "K".into(),
            train_rmse: train,
            validation_rmse: None,
            test_rmse: None,
            ahead: IndexMap::new(),
            day_ahead_mse: None,
            noise_floor: None,
            rho: Some(rho),
        };
        let provenance = Provenance {
            input_hash: String::new(),
            fit_input_hash: String::new(),
            measurements_changed: changed,
            model_changed: false,
            reproduced: true,
            comment: "newer uploads came".into(),
        };
        summary(Part::Validation, &parts, &horizons, Some(&stored), &provenance)
    }

    #[test]
    fn each_finding_has_its_sentence_and_no_other() {
        let good = told(0.2, 0.25, 0.01, 0.1, 1.2, false);
        assert!(
            good.contains("0.10 K on unseen data, 75 % less")
                && good.contains("0.25 K on unseen data and by 0.20 K"),
            "{good}"
        );
        assert!(good.contains("little structure"), "{good}");
        for word in ["does not repeat", "offset", "missing", "Mind that"] {
            assert!(!good.contains(word), "{good}");
        }
        let bad = told(0.2, 0.9, 0.8, 0.5, 3.12, true);
        for word in [
            "would do no worse (0.40 K)",
            "does not repeat",
            "0.80 K too cold",
            "3.1 times",
            "missing",
            "Mind that newer uploads came.",
        ] {
            assert!(bad.contains(word), "{word}: {bad}");
        }
    }

    #[test]
    fn numbers_have_two_digits_that_count() {
        let shown = [12.34, 1.234, 0.1234, 0.00456, 0.0].map(number);
        assert_eq!(shown, ["12", "1.2", "0.12", "0.0046", "0"]);
    }
}
