//! What the arms came to, as a table and in sentences: every difference within one house, then over the
//! houses.

use super::super::row::Row;
use super::arm::{Kind, Measures};
use super::mpc;
use super::outcome::{BEFORE_DAYS, Measured, Outcome, shown};
use serde::Serialize;
use std::fmt::Write;

/// Arms whose totals differ by less than this share are called alike.
const ALIKE: f64 = 0.01;

/// A mean over houses, and the smallest and largest of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    pub mean: f64,
    pub low: f64,
    pub high: f64,
}

impl Spread {
    pub fn of(values: &[f64]) -> Self {
        let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(*value), high.max(*value))
        });
        Self { mean: values.iter().sum::<f64>() / values.len().max(1) as f64, low, high }
    }

    fn is_one(&self) -> bool {
        self.high - self.low < 1e-9
    }
}

/// One arm over all houses.
#[derive(Debug, Serialize)]
pub struct Line {
    pub kind: Kind,
    pub bill: Spread,
    pub discomfort: Spread,
    /// Bill and discomfort in EUR.
    pub total: Spread,
    pub rmse: Spread,
    /// The second half alone: total in EUR, and error in K.
    pub late_total: Spread,
    pub late_rmse: Spread,
    /// Total over that of perfect knowledge in the same house, in EUR.
    pub beside_perfect: Option<Spread>,
}

/// The table and the sentences.
#[derive(Debug, Serialize)]
pub struct Answer {
    pub lines: Vec<Line>,
    pub sentences: Vec<String>,
}

/// An arm in each of the houses.
fn arms(measured: &Measured, kind: Kind) -> Vec<&Outcome> {
    measured.houses.iter().filter_map(|house| house.iter().find(|outcome| outcome.kind == kind)).collect()
}

fn whole(outcome: &Outcome) -> Measures {
    Measures::sum(&outcome.days)
}

impl Answer {
    pub fn of(measured: &Measured) -> Self {
        let late = |outcome: &Outcome| Measures::sum(&outcome.days[measured.plan.leaks_from()..]);
        let lines: Vec<Line> = measured
            .plan
            .arms
            .iter()
            .map(|kind| {
                let arms = arms(measured, *kind);
                let spread = |of: &dyn Fn(&Outcome) -> f64| {
                    Spread::of(&arms.iter().map(|outcome| of(outcome)).collect::<Vec<_>>())
                };
                Line {
                    kind: *kind,
                    bill: spread(&|outcome| whole(outcome).bill),
                    discomfort: spread(&|outcome| whole(outcome).discomfort()),
                    total: spread(&|outcome| whole(outcome).total()),
                    rmse: spread(&|outcome| whole(outcome).rmse()),
                    late_total: spread(&|outcome| late(outcome).total()),
                    late_rmse: spread(&|outcome| late(outcome).rmse()),
                    beside_perfect: difference(measured, *kind, Kind::Perfect, &whole),
                }
            })
            .collect();
        let sentences = [
            often(measured, &lines),
            nights(measured),
            fits(measured),
            missing(measured, &late),
            errors(&lines),
        ]
        .into_iter()
        .flatten()
        .collect();
        Self { lines, sentences }
    }

    /// Means over the houses, of each arm.
    pub fn rows(&self) -> Vec<Row> {
        let rows = |line: &Line| {
            let mut rows = vec![
                Row::new(
                    format!("{}: bill and discomfort together", line.kind.title()),
                    line.total.mean,
                    "EUR",
                ),
                Row::new("  bill", line.bill.mean, "EUR"),
                Row::new("  discomfort", line.discomfort.mean, "K h"),
                Row::new("  error a day ahead", line.rmse.mean, "K"),
            ];
            let beside = line.beside_perfect.map(|spread| spread.mean);
            rows.extend(beside.map(|more| Row::new("  more than with perfect knowledge", more, "EUR")));
            rows
        };
        self.lines.iter().flat_map(rows).collect()
    }

    pub fn text(&self) -> String {
        let mut text = format!(
            "{:<22} {:>9} {:>12} {:>24} {:>10} {:>15} {:>24}\n",
            "parameters", "bill", "discomfort", "worth in all", "day ahead", "2nd half", "beside perfect"
        );
        let _ = writeln!(
            text,
            "{:<22} {:>9} {:>12} {:>24} {:>10} {:>15} {:>24}",
            "", "EUR", "K h", "EUR", "K rms", "EUR, K rms", "EUR"
        );
        for line in &self.lines {
            let beside = line.beside_perfect.map_or_else(String::new, |spread| span(&spread, 2));
            let _ = writeln!(
                text,
                "{:<22} {:>9.2} {:>12.1} {:>24} {:>10.3} {:>15} {:>24}",
                line.kind.title(),
                line.bill.mean,
                line.discomfort.mean,
                span(&line.total, 1),
                line.rmse.mean,
                format!("{:.2}, {:.3}", line.late_total.mean, line.late_rmse.mean),
                beside
            );
        }
        text.push('\n');
        self.sentences.iter().for_each(|sentence| {
            let _ = writeln!(text, "{sentence}");
        });
        text.trim_end().to_owned()
    }
}

/// Mean, smallest and largest: `1.2 (0.9 to 1.6)`; the mean alone where all houses are alike, or there is
/// one.
pub fn span(spread: &Spread, digits: usize) -> String {
    if spread.is_one() {
        return format!("{:.digits$}", spread.mean);
    }
    format!("{:.digits$} ({:.digits$} to {:.digits$})", spread.mean, spread.low, spread.high)
}

/// The total of an arm over that of another one in the same house.
fn difference(
    measured: &Measured,
    kind: Kind,
    other: Kind,
    part: &dyn Fn(&Outcome) -> Measures,
) -> Option<Spread> {
    let (ours, theirs) = (arms(measured, kind), arms(measured, other));
    if kind == other || ours.is_empty() || ours.len() != theirs.len() {
        return None;
    }
    Some(Spread::of(
        &ours
            .iter()
            .zip(&theirs)
            .map(|(ours, theirs)| part(ours).total() - part(theirs).total())
            .collect::<Vec<_>>(),
    ))
}

/// Cheaper or dearer, and whether in every house.
fn compared(spread: &Spread, base: f64) -> String {
    let everywhere =
        if spread.low > 0.0 || spread.high < 0.0 { "in every house" } else { "but not in every house" };
    let share = 100.0 * spread.mean.abs() / base.max(f64::MIN_POSITIVE);
    let word = if spread.mean < 0.0 { "saves" } else { "costs" };
    let [near, far] = if spread.mean < 0.0 { [-spread.high, -spread.low] } else { [spread.low, spread.high] };
    if spread.is_one() {
        return format!("{word} {:.2} EUR ({share:.1} %)", spread.mean.abs());
    }
    format!("{word} {:.2} EUR ({near:.2} to {far:.2}; {share:.1} %), {everywhere}", spread.mean.abs())
}

/// How often to re-estimate: the rarest of what is about as good as the best.
fn often(measured: &Measured, lines: &[Line]) -> Option<String> {
    let frequencies = [Kind::Once, Kind::Weekly, Kind::Nightly];
    let found: Vec<&Line> =
        frequencies.iter().filter_map(|kind| lines.iter().find(|line| line.kind == *kind)).collect();
    let best = found.iter().map(|line| line.total.mean).fold(f64::INFINITY, f64::min);
    let enough = found.iter().find(|line| line.total.mean <= (1.0 + ALIKE) * best)?;
    let advice = match enough.kind {
        Kind::Once => "A fit before the first day is enough here: to re-estimate later",
        Kind::Weekly => "Re-estimate every week: to do so every night",
        _ => "Re-estimate every night: to do so more rarely",
    };
    let end = match enough.kind {
        Kind::Nightly => format!("costs more than {:.0} %", 100.0 * ALIKE),
        _ => format!("saves less than {:.0} % of bill and discomfort together", 100.0 * ALIKE),
    };
    Some(format!(
        "{advice} {end} ({} over {}).",
        count(measured.houses.len(), "house"),
        count(measured.plan.weeks, "week")
    ))
}

fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Every step from rarely to often, in money.
fn nights(measured: &Measured) -> Option<String> {
    let mut parts = Vec::new();
    for (often, rarely, what) in [
        (Kind::Once, Kind::Nominal, "A first fit, instead of nominal values,"),
        (Kind::Weekly, Kind::Once, "A fit every week, instead of one at the start,"),
        (Kind::Nightly, Kind::Weekly, "A fit every night, instead of every week,"),
    ] {
        let base = Spread::of(
            &arms(measured, rarely).iter().map(|outcome| whole(outcome).total()).collect::<Vec<_>>(),
        )
        .mean;
        if let Some(spread) = difference(measured, often, rarely, &whole) {
            parts.push(format!("{what} {}.", compared(&spread, base)));
        }
    }
    (!parts.is_empty()).then(|| parts.join(" "))
}

/// What the gate let through.
fn fits(measured: &Measured) -> Option<String> {
    let nightly = arms(measured, Kind::Nightly);
    let total: usize = nightly.iter().map(|outcome| outcome.fits.len()).sum();
    let count =
        |word: &str| nightly.iter().flat_map(|outcome| &outcome.fits).filter(|fit| *fit == word).count();
    (total > 0).then(|| {
        format!(
            "Of {total} nightly fits {} were accepted, {} left the served ones in place as no better, {} \
            were held and {} rejected.",
            count("accepted"),
            count("unchanged"),
            count("held"),
            count("rejected")
        )
    })
}

/// What the missing effect costs, and what finding it saves.
fn missing(measured: &Measured, late: &dyn Fn(&Outcome) -> Measures) -> Option<String> {
    let weeks = (measured.plan.days() - measured.plan.leaks_from()) as f64 / 7.0;
    let cost = difference(measured, Kind::Nightly, Kind::Perfect, late)?;
    let saved = difference(measured, Kind::Found, Kind::Nightly, late)?;
    let base = Spread::of(
        &arms(measured, Kind::Nightly).iter().map(|outcome| late(outcome).total()).collect::<Vec<_>>(),
    )
    .mean;
    let named: Vec<String> = arms(measured, Kind::Found)
        .iter()
        .enumerate()
        .map(|(house, outcome)| {
            let added: Vec<String> = outcome
                .effects
                .iter()
                .map(|added| format!("{} on day {}", added.effect, added.day))
                .collect();
            format!(
                "house {}: {}",
                house + 1,
                if added.is_empty() { "nothing".to_owned() } else { added.join(", ") }
            )
        })
        .collect();
    Some(format!(
        "From day {} on the wind blows through the house. Without an effect for it the nightly fits cost {} \
        EUR a week more than perfect knowledge; adding what the diagnosis named {}. Added were, {}.",
        measured.plan.leaks_from(),
        span(&Spread { mean: cost.mean / weeks, low: cost.low / weeks, high: cost.high / weeks }, 2),
        compared(&saved, base),
        named.join("; ")
    ))
}

/// How well the days were foreseen.
fn errors(lines: &[Line]) -> Option<String> {
    let parts: Vec<String> =
        lines.iter().map(|line| format!("{:.2} K {}", line.rmse.mean, line.kind.title())).collect();
    (!parts.is_empty()).then(|| format!("The room a day ahead was missed by {}.", parts.join(", ")))
}

/// What the table means, and what it rests on.
pub fn basis(measured: &Measured) -> Vec<String> {
    let plan = &measured.plan;
    let spent = &measured.spent;
    vec![
        format!(
            "{} (seeds from {} on), {} under a thermostat, then {} under control, in steps of half an hour. \
            Every arm has the same weather, prices and people, and a perfect forecast of weather and price; \
            nobody foresees people.",
            count(plan.houses, "synthetic house"),
            plan.seed,
            count(BEFORE_DAYS, "day"),
            count(plan.weeks, "week")
        ),
        format!(
            "The truth has five thermal masses, the model three; three parameters of the truth drift by a \
            factor of 1.2 to 1.45 in eight weeks. Comfort is 21 to 24 degC by day and 18.5 to 24 at night; a \
            kelvin-hour outside is worth {:.2} EUR to controller and table alike.",
            mpc::DISCOMFORT
        ),
        format!(
            "{} estimates and {} diagnoses were ordinary jobs of one service. The run took {}: {} in rooms \
            and controllers, {} waiting for estimates, {} for diagnoses and what they asked for.",
            spent.estimates,
            spent.diagnoses,
            shown(spent.seconds),
            shown(spent.control_seconds),
            shown(spent.estimate_seconds),
            shown(spent.diagnosis_seconds)
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::outcome::{Plan, Spent};
    use super::*;

    /// Two houses of two weeks in which every day of an arm costs the same.
    fn measured(daily: &[(Kind, f64)]) -> Measured {
        let plan = Plan { arms: daily.iter().map(|(kind, _)| *kind).collect(), ..Plan::new(1, 2, 2) };
        let house = |more: f64| {
            let outcome = |(kind, bill): &(Kind, f64)| Outcome {
                kind: *kind,
                days: vec![Measures { bill: bill + more, ..Measures::default() }; 14],
                effects: Vec::new(),
                fits: vec!["accepted".to_owned()],
            };
            daily.iter().map(outcome).collect()
        };
        Measured { plan, houses: vec![house(0.0), house(1.0)], spent: Spent::default() }
    }

    #[test]
    fn the_rarest_that_is_as_good_as_the_best_is_advised() {
        let advice = |daily: &[(Kind, f64)]| Answer::of(&measured(daily)).sentences[0].clone();
        assert!(
            advice(&[(Kind::Once, 3.0), (Kind::Weekly, 2.0), (Kind::Nightly, 1.999)])
                .starts_with("Re-estimate every week")
        );
        assert!(
            advice(&[(Kind::Once, 3.0), (Kind::Weekly, 2.0), (Kind::Nightly, 1.5)])
                .starts_with("Re-estimate every night")
        );
        assert!(
            advice(&[(Kind::Once, 2.0), (Kind::Weekly, 2.0), (Kind::Nightly, 2.1)])
                .starts_with("A fit before the first day")
        );
    }

    #[test]
    fn differences_are_within_a_house() {
        let answer = Answer::of(&measured(&[(Kind::Nightly, 2.0), (Kind::Found, 1.5), (Kind::Perfect, 1.0)]));
        let line = answer.lines.iter().find(|line| line.kind == Kind::Nightly).unwrap();
        // The houses differ by 14 EUR, the arms within each of them by exactly as much.
        assert_eq!((line.total.low, line.total.high), (28.0, 42.0));
        let beside = line.beside_perfect.unwrap();
        assert!((beside.low - 14.0).abs() < 1e-9 && (beside.high - 14.0).abs() < 1e-9, "{beside:?}");
        assert!(
            answer.sentences.iter().any(|sentence| sentence.contains("saves 3.50 EUR (20.0 %)")),
            "{answer:?}"
        );
    }
}
