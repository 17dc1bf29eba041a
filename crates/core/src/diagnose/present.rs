//! The effects that a model has already: does this window still show them?
//!
//! What was named once is not there for ever: a window is sealed, a stove is carried away, and a controller
//! that goes on to believe in it errs. So each effect of the model is a candidate again, beside the model
//! without it on segments of hours. Its windows go on in the ledger of the model that lacks it, where a
//! newest one that contradicts the others takes the effect back.

use super::ledger::{CLEAR_T, EffectScore, LedgerEntry, LookedSpan, beside, pooled_with};
use super::library::{EffectSource, align, carried};
use super::report::PresentEffect;
use super::score_test::RANKING_HOURS;
use super::surrogates::Tests;
use crate::estimate::Problem;
use crate::simulate::trajectory::Halt;

/// What this window shows of every effect of a model; effects that it cannot be asked about are left out:
/// those with states of their own, and those without which the model is none. `earlier` are all entries of
/// the system.
pub(super) fn present(
    source: &EffectSource,
    problem: &Problem,
    theta: &[f64],
    earlier: &[LedgerEntry],
    span: LookedSpan,
    halt: Halt,
) -> Vec<PresentEffect> {
    let effects = problem.model().effects().iter();
    effects.filter_map(|effect| shown(source, problem, theta, effect, earlier, span, halt)).collect()
}

fn shown(
    source: &EffectSource,
    problem: &Problem,
    theta: &[f64],
    effect: &str,
    earlier: &[LedgerEntry],
    span: LookedSpan,
    halt: Halt,
) -> Option<PresentEffect> {
    let without = source.lacking(problem, effect).ok()?;
    let mut library = [source.candidate(&without, effect).ok()?];
    let without = align(&without, &mut library);
    let theta = carried(problem, theta, &without);
    // What this window shows by itself and what several show together is told below; nothing is named here.
    let tests = Tests::over(&[RANKING_HOURS], &without, &theta, &library, 0.0, &[], halt)?;
    let [candidate] = &library;
    let score = tests.hear(candidate).ranked?;
    let (model, hash) = (without.model().id().to_string(), without.model().hash().to_owned());
    let pooled = pooled_with(&beside(earlier, &model, &hash), &score, span);
    let title = candidate.spec.title.clone();
    let taken_back = pooled.as_ref().and_then(|pooled| pooled.taken_back.as_ref());
    let sentence = match taken_back {
        Some(taken_back) => format!("{title} is in the model. {}", taken_back.sentence),
        None => sentence(&title, &score, span),
    };
    Some(PresentEffect { effect: effect.to_owned(), title, model, model_hash: hash, score, pooled, sentence })
}

/// What one window shows of an effect of the model, for people.
fn sentence(title: &str, score: &EffectScore, span: LookedSpan) -> String {
    let t = score.t;
    if t >= CLEAR_T {
        format!(
            "{title} is in the model, and this window shows it: it explains {:.0} % of what the model \
            without it errs by over {:.0} h (t {t:.1}).",
            100.0 * score.share,
            span.hours
        )
    } else if t <= -CLEAR_T {
        format!(
            "{title} is in the model, and this window speaks against it: it asks for a sign that physics \
            does not allow (t {t:.1})."
        )
    } else {
        format!(
            "{title} is in the model, and this window does not show it (t {t:.1}), which does not mean that \
            it is absent."
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::ledger::Looked;
    use super::super::surrogates::span;
    use super::super::tests::{fitted, site, small_world};
    use super::super::{Diagnosis, diagnose};
    use super::*;
    use crate::data::{SECOND, SplitRequest};
    use crate::estimate::problem::request::AccusationRate;
    use crate::estimate::{Control, EstimateRequest, prepare};
    use crate::model::Catalogue;

    /// A diagnosis of room3 with the appliances' heat, of a room that these effects warm.
    fn diagnosis(hidden: &[&str], earlier: &[LedgerEntry]) -> (Diagnosis, Problem) {
        let (_, window) = small_world(hidden);
        let catalogue = Catalogue::builtin().unwrap();
        let request = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
        let id = "room3+metered_gain:P_appliances".parse().unwrap();
        let problem = prepare(&catalogue, &id, &request, &window, &site()).unwrap();
        let theta = fitted(&problem).theta();
        let found = diagnose(
            &catalogue,
            &problem,
            &theta,
            &window,
            &site(),
            AccusationRate::USUAL,
            earlier,
            &Control::NONE,
        )
        .unwrap();
        (found, problem)
    }

    #[test]
    fn what_the_model_has_is_shown_and_taken_back_when_it_is_gone() {
        let (there, problem) = diagnosis(&["metered_gain"], &[]);
        let [shown] = there.present.as_slice() else { panic!("{:?}", there.present) };
        assert_eq!((shown.effect.as_str(), shown.model.as_str()), ("metered_gain:P_appliances", "room3"));
        assert!(
            shown.score.t > 5.0 && shown.score.share > 0.2 && shown.sentence.contains("this window shows it"),
            "{shown:?}"
        );
        assert!(there.warnings.is_empty(), "{:?}", there.warnings);
        // Its entries stand beside the model that lacks it, as those of a diagnosis of that model do.
        let entries = there.entries("dia_1", Some("with"));
        let own: Vec<&LedgerEntry> =
            entries.iter().filter(|entry| entry.score.effect == shown.effect).collect();
        assert_eq!(own.iter().map(|entry| entry.model.as_str()).collect::<Vec<_>>(), ["room3"]);
        assert!(
            entries
                .iter()
                .any(|entry| entry.model == there.model && entry.model_hash.as_deref() == Some("with"))
        );

        // Weeks before the appliances were carried away. The room is the same otherwise, so the weeks are
        // those of the other twin.
        let now = span(&problem).unwrap();
        let weeks = |number: i64| LookedSpan {
            from: now.from - number * 3_000_000 * SECOND,
            to: now.to - number * 3_000_000 * SECOND,
            hours: now.hours,
        };
        let before: Vec<LedgerEntry> =
            [1, 2].map(|number| LedgerEntry { span: weeks(number), ..own[0].clone() }).into();
        let (gone, _) = diagnosis(&[], &before);
        let [shown] = gone.present.as_slice() else { panic!("{:?}", gone.present) };
        let pooled = shown.pooled.as_ref().unwrap();
        assert!(shown.score.t < 3.0 && pooled.windows == 3, "{shown:?}");
        assert!(pooled.taken_back.as_ref().is_some_and(|back| back.z < -3.0), "{pooled:?}");
        assert_eq!(gone.warnings, std::slice::from_ref(&shown.sentence));
        assert!(gone.looked.as_ref().and_then(Looked::span).is_some());
    }
}
