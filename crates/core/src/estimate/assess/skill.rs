//! How well a series follows its measurements, in the numbers that the field uses.

use super::metrics::{FREE_RUN, HORIZONS, lead};
use super::replay::{Part, Replay};
use crate::units::error_unit;
use indexmap::IndexMap;
use serde::Serialize;
use std::ops::Range;
use utoipa::ToSchema;

/// The skill of a simulated series y beside measurements m, with the residual e = m - y: positive where the
/// model is too low. All but `n` and `r2` are in the unit of the error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Skill {
    /// Pairs that were compared.
    #[schema(value_type = u64)]
    pub n: usize,
    /// Mean of e.
    pub bias: f64,
    /// Root of the mean of e2.
    pub rmse: f64,
    /// Root mean square of e without its mean: rmse2 = bias2 + urmse2.
    pub urmse: f64,
    /// Mean of |e|.
    pub mae: f64,
    /// Coefficient of determination, 1 - sum e2 / sum (m - mean m)2: 1 is perfect, 0 is as good as the mean
    /// of the measurements, below 0 is worse. `null` where the measurements do not change.
    pub r2: Option<f64>,
}

impl Skill {
    /// The skill over pairs of a simulated and a measured value; `None` without any pair, or where the
    /// numbers overflow.
    pub fn of(pairs: &[(f64, f64)]) -> Option<Self> {
        let n = pairs.len() as f64;
        let mean = |value: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(value).sum::<f64>() / n;
        let error = |(simulated, measured): &(f64, f64)| measured - simulated;
        // Squares about the means, and not differences of sums of squares, which would lose all digits of a
        // small scatter about a large mean.
        let (bias, level) = (mean(&error), mean(&|pair| pair.1));
        let square = mean(&|pair| error(pair).powi(2));
        let scatter = mean(&|pair| (error(pair) - bias).powi(2));
        let variance = mean(&|pair| (pair.1 - level).powi(2));
        let skill = Self {
            n: pairs.len(),
            bias,
            rmse: square.sqrt(),
            urmse: scatter.sqrt(),
            mae: mean(&|pair| error(pair).abs()),
            r2: (variance > 0.0).then(|| 1.0 - square / variance).filter(|r2| r2.is_finite()),
        };
        (skill.rmse.is_finite() && skill.mae.is_finite()).then_some(skill)
    }

    /// The skill of a series over a range of samples, where both it and the measurements are there.
    pub fn over(simulated: &[Option<f64>], measured: &[Option<f64>], range: Range<usize>) -> Option<Self> {
        let pairs: Vec<(f64, f64)> = range.filter_map(|k| Some((simulated[k]?, measured[k]?))).collect();
        Self::of(&pairs)
    }
}

/// The free run of one output by part.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PartSkill {
    /// Unit of the errors.
    pub unit: String,
    /// Estimation data.
    pub train: Option<Skill>,
    /// Data that the gate saw and the search did not.
    pub validation: Option<Skill>,
    /// Data that neither saw.
    pub test: Option<Skill>,
}

/// The skill at one horizon.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct HorizonSkill {
    /// `PT1H`, `PT6H`, `PT24H` or `free_run`.
    pub horizon: String,
    /// The skill.
    #[serde(flatten)]
    #[schema(inline)]
    pub skill: Skill,
    // The origin of a free run is the start of the window.
    /// The error of the value measured at the origin, held, on the same samples.
    pub persistence_rmse: Option<f64>,
}

/// The skill of every output's free run in the parts of the fit's window.
pub fn by_part(replay: &Replay) -> IndexMap<String, PartSkill> {
    let over = |output: usize, part: Part| {
        Skill::over(&replay.free_run(output), &replay.measured(output), replay.range(part))
    };
    let outputs = replay.problem().model().outputs().iter().enumerate();
    let skill = outputs.map(|(index, output)| {
        let skill = PartSkill {
            unit: error_unit(&output.unit).to_owned(),
            train: over(index, Part::Train),
            validation: over(index, Part::Validation),
            test: over(index, Part::Test),
        };
        (output.channel.clone(), skill)
    });
    skill.collect()
}

/// The skill of every output over one part: forecasts whose origin and target lie in it, and the free run.
pub fn by_horizon(replay: &Replay, part: Part) -> IndexMap<String, Vec<HorizonSkill>> {
    let (range, step) = (replay.range(part), replay.problem().grid().step());
    let leads: Vec<(&str, usize)> =
        HORIZONS.iter().filter_map(|(name, horizon)| Some((*name, lead(*horizon, step)?))).collect();
    let samples: Vec<usize> = leads.iter().map(|(_, lead)| *lead).collect();
    let ahead = replay.ahead(range.clone(), &samples);
    let mut found = IndexMap::new();
    for (output, ahead) in ahead.iter().enumerate() {
        let measured = replay.measured(output);
        let mut skills = Vec::new();
        for ((name, lead), forecast) in leads.iter().zip(ahead) {
            let held: Vec<Option<f64>> = (0..measured.len())
                .map(|k| forecast[k].and(k.checked_sub(*lead)).and_then(|origin| measured[origin]))
                .collect();
            skills.extend(horizon_skill(name, forecast, &held, &measured, range.start + lead..range.end));
        }
        let free_run = replay.free_run(output);
        let held: Vec<Option<f64>> =
            free_run.iter().map(|value| value.and(replay.measured_start(output))).collect();
        skills.extend(horizon_skill(FREE_RUN, &free_run, &held, &measured, range.clone()));
        found.insert(replay.problem().model().outputs()[output].channel.clone(), skills);
    }
    found
}

/// The skill of a series beside that of the value held since its origin; `None` where nothing can be
/// compared.
fn horizon_skill(
    name: &str,
    simulated: &[Option<f64>],
    held: &[Option<f64>],
    measured: &[Option<f64>],
    range: Range<usize>,
) -> Option<HorizonSkill> {
    let skill = Skill::over(simulated, measured, range.clone())?;
    let persistence_rmse = Skill::over(held, measured, range).map(|skill| skill.rmse);
    Some(HorizonSkill { horizon: name.to_owned(), skill, persistence_rmse })
}

#[cfg(test)]
mod tests {
    use super::Skill;
    use proptest::prelude::{prop_assert, prop_assert_eq, proptest};

    #[test]
    fn a_case_worked_out_by_hand() {
        // e = -1, 1, -3, -1; measured mean 3, squares about it 4 + 1 + 1 + 4.
        let skill = Skill::of(&[(2.0, 1.0), (1.0, 2.0), (7.0, 4.0), (6.0, 5.0)]).unwrap();
        assert_eq!((skill.n, skill.bias, skill.mae), (4, -1.0, 1.5));
        assert!((skill.rmse - 3f64.sqrt()).abs() < 1e-15);
        assert!((skill.urmse - 2f64.sqrt()).abs() < 1e-15);
        assert!((skill.r2.unwrap() - (1.0 - 12.0 / 10.0)).abs() < 1e-15);
    }

    #[test]
    fn the_ends_of_the_scale() {
        let measured = [3.0, 1.0, 4.0, 1.0, 5.0];
        let with = |simulated: &dyn Fn(f64) -> f64| Skill::of(&measured.map(|m| (simulated(m), m))).unwrap();
        assert_eq!(with(&|m| m), Skill { n: 5, bias: 0.0, rmse: 0.0, urmse: 0.0, mae: 0.0, r2: Some(1.0) });
        // The mean of the measurements explains nothing; an offset is all bias.
        assert!(with(&|_| 2.8).r2.unwrap().abs() < 1e-15);
        let offset = with(&|m| m - 0.5);
        assert_eq!((offset.bias, offset.rmse, offset.mae), (0.5, 0.5, 0.5));
        assert!(offset.urmse < 1e-15);
        assert_eq!(Skill::of(&[]), None);
        assert_eq!(
            Skill::of(&[(2.0, 1.0), (3.0, 1.0)]).unwrap().r2,
            None,
            "constant measurements have no variance to explain"
        );
        assert_eq!(Skill::of(&[(f64::MAX, -f64::MAX)]), None);
    }

    #[test]
    fn only_pairs_count() {
        let (simulated, measured) =
            ([Some(1.0), None, Some(3.0), Some(9.0)], [Some(2.0), Some(2.0), None, Some(7.0)]);
        let skill = Skill::over(&simulated, &measured, 0..4).unwrap();
        assert_eq!((skill.n, skill.bias), (2, -0.5));
        assert_eq!(Skill::over(&simulated, &measured, 1..3), None);
    }

    proptest! {
        /// Textbook sums over whole numbers, which are exact.
        #[test]
        fn brute_force_agrees(
            pairs in proptest::collection::vec((-1000i64..1000, -1000i64..1000), 1..60),
            level in -1_000_000i64..1_000_000,
        ) {
            let raised = |(s, m): &(i64, i64)| ((s + level) as f64, (m + level) as f64);
            let skill = Skill::of(&pairs.iter().map(raised).collect::<Vec<_>>()).unwrap();
            let n = pairs.len() as i64;
            let errors: Vec<i64> = pairs.iter().map(|(s, m)| m - s).collect();
            let (sum, squares): (i64, i64) = (errors.iter().sum(), errors.iter().map(|e| e * e).sum());
            let close = |found: f64, exact: f64| (found - exact).abs() <= 1e-9 * (1.0 + exact.abs());
            prop_assert_eq!(skill.n, pairs.len());
            prop_assert!(close(skill.bias, sum as f64 / n as f64));
            prop_assert!(close(skill.rmse, (squares as f64 / n as f64).sqrt()));
            prop_assert!(
                close(skill.urmse, ((n * squares - sum * sum) as f64).sqrt() / n as f64),
                "{} {:?}",
                skill.urmse,
                errors
            );
            prop_assert!(close(skill.mae, errors.iter().map(|e| e.abs()).sum::<i64>() as f64 / n as f64));
            prop_assert!(close(skill.rmse.powi(2), skill.bias.powi(2) + skill.urmse.powi(2)));
            let (m, mm): (i64, i64) = (
                pairs.iter().map(|(_, m)| m).sum(),
                pairs.iter().map(|(_, m)| m * m).sum()
            );
            let spread = n * mm - m * m;
            match skill.r2 {
                Some(r2) => prop_assert!(close(r2, 1.0 - (n * squares) as f64 / spread as f64), "{r2}"),
                None => prop_assert_eq!(spread, 0),
            }
        }
    }
}
