//! The way of a finding's heat: straight into the air of the room, into its walls, or through a mass of its
//! own.
//!
//! Whether heat is missing and by which way it comes are two questions. Effects that say `way_of` another are
//! therefore no candidates: they are tried where that one is named, and take its place where the likelihood
//! gains by more than their own parameters cost and unseen data agree.

use super::acceptance::LEAST_BIC;
use super::library::{CandidateEffect, EffectSource, align, carried};
use super::null_model::NullModel;
use crate::model::id::family_and_argument;
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;

/// A squared error that is not this much larger is no larger.
const WORSE: f64 = 1.02;

/// The effect that makes a sensor slow.
const SLOW_SENSOR: &str = "sensor_lag";

/// A finding by the way that its heat takes.
pub(super) struct Way {
    /// The effect that is one.
    pub candidate: CandidateEffect,
    /// The model with it.
    pub model: NullModel,
    /// What the likelihood gains in BIC over the way that was named first.
    pub delta_bic: f64,
}

impl Way {
    /// Why it is this one.
    pub fn sentence(&self) -> String {
        format!(
            "By this way of its heat the likelihood gains {:.0} in BIC more than straight into the air.",
            self.delta_bic
        )
    }
}

/// The best other way of a winner, whose model is `direct`; `None` where none is better. The second number is
/// how many simulations it took to know.
pub(super) fn other_way(
    source: &EffectSource,
    null: &NullModel,
    direct: &NullModel,
    winner: &CandidateEffect,
    halt: Halt,
) -> (Option<Way>, usize) {
    let (_, argument) = family_and_argument(&winner.id);
    let names = source.catalogue.effects().filter(|effect| effect.way_of.as_deref() == Some(winner.family()));
    let names: Vec<String> = names
        .map(|effect| argument.map_or_else(|| effect.id.clone(), |it| format!("{}:{it}", effect.id)))
        .collect();
    let settled: Vec<Way> =
        names.par_iter().filter_map(|name| settle(source, null, direct, name, halt)).collect();
    let mut evaluations = settled.iter().map(|way| way.model.fitted.evaluations).sum();
    let better = settled.into_iter().filter(|way| way.delta_bic >= LEAST_BIC && falls(direct, &way.model));
    let mut best = better.max_by(|one, other| one.delta_bic.total_cmp(&other.delta_bic));
    // A slow sensor rounds every heat alike: who is no better than it says nothing of this one's way.
    if best.is_some()
        && let Some(slow) = settle(source, direct, direct, SLOW_SENSOR, halt)
    {
        evaluations += slow.model.fitted.evaluations;
        best = best.filter(|best| best.delta_bic >= slow.delta_bic);
    }
    (best, evaluations)
}

/// A model with an effect beside those of `null`, from where `direct` has come to.
fn settle(
    source: &EffectSource,
    null: &NullModel,
    direct: &NullModel,
    name: &str,
    halt: Halt,
) -> Option<Way> {
    let mut one = [source.candidate(&null.problem, name).ok()?];
    align(&null.problem, &mut one);
    let [candidate] = one;
    // What both have in common starts where the direct way has it.
    let start = |theta: &[f64]| carried(&direct.problem, theta, &candidate.problem);
    let model = NullModel::settle(
        candidate.problem.clone(),
        &start(&direct.fitted.plain),
        Some(&start(&direct.fitted.white)),
        halt,
    )?;
    let more = candidate.problem.free().len() as f64 - direct.problem.free().len() as f64;
    let price = more * (model.measured.samples as f64).ln();
    let delta_bic = direct.measured.bic - model.measured.bic - price;
    Some(Way { candidate, model, delta_bic })
}

/// Whether the free run or the innovations of unseen data err less, and none of them more.
fn falls(direct: &NullModel, way: &NullModel) -> bool {
    let (before, after) = (&direct.measured, &way.measured);
    let pairs = [before.plain[1].zip(after.plain[1]), before.white_validation.zip(after.white_validation)];
    let mut pairs = pairs.iter().flatten();
    pairs.clone().any(|(before, after)| after < before)
        && pairs.all(|(before, after)| *after <= WORSE * before)
}

#[cfg(test)]
mod tests {
    use super::super::report::Diagnosis;
    use super::super::tests::{fitted, site, small_world};
    use crate::data::{DAY, HOUR, Hold, Series, SplitRequest, Window};
    use crate::estimate::problem::request::AccusationRate;
    use crate::estimate::{Control, EstimateRequest, Problem, prepare};
    use crate::model::Catalogue;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// A record that room3 with an effect has made itself, with a stove that burns on some evenings and a
    /// sensor that errs by .05 K, and room3 fitted to it.
    fn record(effect: &str, values: &[(&str, f64)]) -> (Catalogue, Window, Problem, Vec<f64>) {
        let (catalogue, mut chance) = (Catalogue::builtin().unwrap(), Xoshiro256PlusPlus::seed_from_u64(5));
        let (_, window) = small_world(&[]);
        let room = window.iter().find(|series| series.channel() == "T_room").unwrap();
        let times = room.times().to_vec();
        let burns: Vec<(i64, i64, f64)> = (0..28)
            .map(|day| {
                (
                    times[0] + day * DAY + chance.random_range(14..20) * HOUR,
                    chance.random_range(1..5) * HOUR,
                    chance.random::<f64>(),
                )
            })
            .filter(|(_, _, burns)| *burns < 0.6)
            .collect();
        let power = |time: &i64| {
            if burns.iter().any(|(from, length, _)| (*from..from + length).contains(time)) {
                1.5
            } else {
                0.0
            }
        };
        let stove =
            Series::new("P_stove", "kW", Hold::ZeroOrder, times.clone(), times.iter().map(power).collect())
                .unwrap();
        let window = Window::from_series(window.iter().cloned().chain([stove]).collect()).unwrap();
        let request = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
        let of = |model: &str, window: &Window| -> Problem {
            prepare(&catalogue, &model.parse().unwrap(), &request, window, &site()).unwrap()
        };
        let maker = of(&format!("room3+{effect}"), &window);
        let mut truth = maker.nominal().to_vec();
        for (value, parameter) in truth.iter_mut().zip(maker.model().parameters()) {
            *value =
                values.iter().find(|(name, _)| *name == parameter.name).map_or(*value, |(_, value)| *value);
        }
        let made = maker.simulate(&truth).outputs.swap_remove(0);
        let mut noise = || 0.05 * ((0..12).map(|_| chance.random::<f64>()).sum::<f64>() - 6.0);
        let values: Vec<f64> = made.iter().map(|value| value + noise()).collect();
        let room = Series::new(
            "T_room",
            "degC",
            Hold::Linear,
            (0..values.len()).map(|k| maker.grid().time(k)).collect(),
            values,
        )
        .unwrap();
        let window = window
            .iter()
            .map(|series| if series.channel() == "T_room" { room.clone() } else { series.clone() });
        let window = Window::from_series(window.collect()).unwrap();
        let base = of("room3", &window);
        let theta = fitted(&base).theta();
        (catalogue, window, base, theta)
    }

    fn diagnosis(effect: &str, values: &[(&str, f64)]) -> Diagnosis {
        let (catalogue, window, base, theta) = record(effect, values);
        super::super::diagnose(
            &catalogue,
            &base,
            &theta,
            &window,
            &site(),
            AccusationRate::USUAL,
            &[],
            &Control::NONE,
        )
        .unwrap()
    }

    #[test]
    fn heat_through_a_mass_of_its_own_is_told_from_heat_on_the_air() {
        let slow = diagnosis("metered_gain_slow:P_stove", &[("c_P_stove", 0.8), ("tau_P_stove", 2.5)]);
        let first = &slow.findings[0];
        assert_eq!(
            (first.effect.as_str(), first.named()),
            ("metered_gain_slow:P_stove", "metered_gain:P_stove"),
            "{}",
            slow.summary
        );
        // Size and time constant go together; the slope with which the room warms at first is their ratio.
        let (size, time) = (&first.parameters["c_P_stove"], &first.parameters["tau_P_stove"]);
        let holds =
            |ci95: Option<[f64; 2]>, truth: f64| ci95.is_some_and(|[low, high]| low < truth && truth < high);
        assert!(holds(size.ci95, 0.8) && holds(time.ci95, 2.5), "{size:?} {time:?}");
        assert!((0.85..1.15).contains(&(size.value / time.value / 0.32)), "{size:?} {time:?}");
        assert!(
            first.rmse.validation.is_some_and(|[before, after]| after < 0.4 * before),
            "{:?}",
            first.rmse
        );
        assert!(slow.findings.len() == 1, "{}", slow.summary);

        let direct = diagnosis("metered_gain:P_stove", &[("c_P_stove", 0.8)]);
        let first = &direct.findings[0];
        assert_eq!(
            (first.effect.as_str(), &first.way_of),
            ("metered_gain:P_stove", &None),
            "{}",
            direct.summary
        );
        assert!((0.7..0.9).contains(&first.parameters["c_P_stove"].value), "{first:?}");
    }

    #[test]
    fn heat_into_walls_is_told_from_heat_on_the_air() {
        let walls = diagnosis("metered_gain_walls:P_stove", &[("c_P_stove", 1.0)]);
        let first = &walls.findings[0];
        assert_eq!(
            (first.effect.as_str(), first.named()),
            ("metered_gain_walls:P_stove", "metered_gain:P_stove"),
            "{}",
            walls.summary
        );
        let size = &first.parameters["c_P_stove"];
        assert!(
            (0.8..1.2).contains(&size.value) && size.ci95.is_some_and(|[low, high]| low < 1.0 && 1.0 < high),
            "{size:?}"
        );
        assert!(
            first.rmse.validation.is_some_and(|[before, after]| after < 0.6 * before),
            "{:?}",
            first.rmse
        );
    }

    #[test]
    fn a_ladder_climbs_by_the_same_way() {
        let (catalogue, window, base, theta) =
            record("metered_gain_slow:P_stove", &[("c_P_stove", 0.8), ("tau_P_stove", 2.5)]);
        let ladder =
            super::super::ladder::ladder(&catalogue, &base, &theta, &window, &site(), 2, &Control::NONE)
                .unwrap();
        let steps = &ladder.steps;
        assert_eq!(steps[1].added.as_deref(), Some("metered_gain_slow:P_stove"), "{steps:?}");
        assert!(
            steps[1].kept && steps[1].validation_rmse < steps[0].validation_rmse.map(|before| 0.4 * before),
            "{steps:?}"
        );
        assert!(steps[1].bic < steps[0].bic, "{steps:?}");
    }
}
