//! The unexplained error beside an effect's own shape: what a person looks at before believing a finding.

use super::library::CandidateEffect;
use super::null_model::NullModel;
use super::score_test::{Look, RANKING_HOURS};
use super::screen::Screen;
use crate::data::Seconds;
use crate::data::rfc3339;
use crate::estimate::Problem;
use crate::estimate::assess::metrics::worst_output;
use crate::estimate::assess::regimes::interval;
use crate::estimate::problem::predictor::Predictor;
use crate::estimate::problem::whiten::stride;
use crate::schema::Interval;
use crate::units::error_unit;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most points of a line.
const POINTS: usize = 400;
/// Most bins of an effect's change, and fewest of which a line means anything.
const BINS: usize = 10;
const LEAST_BINS: usize = 3;
/// Fixes the resampling of the intervals.
const SEED: u64 = 1;

/// What the model without an effect leaves unexplained, and what the effect changes, side by side in the same
/// unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Shape {
    /// The output whose error it is: of several the one that fails most; empty in a diagnosis that was made
    /// before it was told, which shows the first one.
    #[serde(default)]
    #[schema(example = "T_room")]
    pub output: String,
    /// Unit of all numbers.
    #[schema(example = "K")]
    pub unit: String,
    /// Length of the stretches whose means the points of the lines are, in seconds.
    pub mean_over_s: Seconds,
    /// The middles of the stretches, RFC 3339.
    pub time: Vec<String>,
    /// Measured minus simulated in the free run of the model without the effect; `null` where less than half
    /// of a stretch is comparable.
    pub unexplained: Vec<Option<f64>>,
    /// How much higher the free run is with the effect, both models at their own least squares. What is left
    /// between the two lines is left unexplained by the model with the effect.
    pub effect: Vec<Option<f64>>,
    /// The first sample of the validation part, from which neither line has learnt anything.
    #[schema(format = DateTime)]
    pub validation_from: String,
    /// The first sample of the test part, where there is one.
    #[schema(format = DateTime)]
    pub test_from: Option<String>,
    /// What is unexplained by what the effect would add; `null` where it takes too few values.
    pub added: Option<Added>,
}

/// The error of the model without an effect against the change that the effect would make in it, when all
/// that the model's own parameters can imitate is taken from both: an added-variable plot. Of rooms it is the
/// error along segments of 12 hours with states of their own, of plants that of the free run over the
/// training part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Added {
    /// Samples with about the same change, as many in each bin as ties allow, the smallest changes first.
    pub bins: Vec<AddedBin>,
    /// Slope of the straight line through all samples: 1 where the effect is as large as the finding says, 0
    /// where it adds nothing.
    pub slope: f64,
    /// Its height at no change.
    pub intercept: f64,
}

/// Samples at which an effect would change the output about as much.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AddedBin {
    /// Mean of what the effect would add, at the values that the finding states.
    pub effect: f64,
    /// Mean of what is unexplained.
    pub unexplained: f64,
    /// Its 95 % interval from resampled days; `null` where there are fewer than four.
    #[schema(value_type = Option<Interval>)]
    pub unexplained_ci95: Option<[f64; 2]>,
    /// How many samples.
    pub samples: usize,
}

/// The shape of a candidate that was found. `next` is the model with it, `sized` a vector of its parameters
/// with the values that the finding states.
pub fn shape(null: &NullModel, next: &NullModel, candidate: &CandidateEffect, sized: &[f64]) -> Shape {
    let (problem, grid) = (&null.problem, null.problem.grid());
    let [without, with] = [null, next].map(|one| one.problem.simulate(&one.fitted.plain));
    let output = worst_output(problem, &without);
    let error = problem.residual(output, &without.outputs[output]);
    let change: Vec<f64> = with.outputs[output]
        .iter()
        .zip(&without.outputs[output])
        .map(|(with, without)| with - without)
        .collect();
    let usable = problem.usable(output, 0..grid.len());
    let about = problem.model().outputs().get(output);
    let span = grid.len().div_ceil(POINTS).max(1);
    let middle = |first: usize| grid.time(first) + (span as i64 - 1) * grid.step() / 2;
    Shape {
        output: about.map_or("", |output| output.channel.as_str()).to_owned(),
        unit: about.map_or("", |output| error_unit(&output.unit)).to_owned(),
        mean_over_s: Seconds::of_millis(span as i64 * grid.step()),
        time: (0..grid.len()).step_by(span).map(|first| rfc3339(middle(first))).collect(),
        unexplained: means(&error, &usable, span),
        effect: means(&change, &usable, span),
        validation_from: rfc3339(grid.time(problem.split().validation.start)),
        test_from: (!problem.split().test.is_empty()).then(|| rfc3339(grid.time(problem.split().test.start))),
        added: added(null, candidate, sized, output),
    }
}

/// What is unexplained by what the candidate would add to it: over segments of hours, or, of a model that has
/// none, in the free run. Both are counted in the unit of the output.
fn added(null: &NullModel, candidate: &CandidateEffect, with: &[f64], output: usize) -> Option<Added> {
    let scale = null.problem.scale(output);
    let point = |(row, x, y): (usize, f64, f64)| Point { row, x: scale * x, y: scale * y };
    let points: Vec<Point> = match null.problem.predictor() {
        Predictor::Filtered => {
            let samples = null.problem.split().train.start..null.problem.split().validation.end;
            let look = Look::new(&null.problem, &null.fitted.plain, samples, RANKING_HOURS, &|| false)?;
            look.added(candidate, with, output)?.into_iter().map(point).collect()
        }
        Predictor::FreeRun => {
            let plain = &null.filters.plain;
            let (effect, unexplained) =
                Screen::new(&null.problem, &null.fitted.plain, plain, &|| false)?.added(candidate, with)?;
            plain
                .rows_of(output)
                .map(|(place, row)| point((row, effect[place], unexplained[place])))
                .collect()
        }
    };
    let [slope, intercept] = straight_line(&points)?;
    let bins = bins(&null.problem, points);
    (bins.len() >= LEAST_BINS).then_some(Added { bins, slope, intercept })
}

/// Means over stretches of so many samples; `None` where less than half of one is usable.
fn means(series: &[f64], usable: &[usize], span: usize) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0usize); series.len().div_ceil(span)];
    for k in usable {
        let (sum, count) = &mut sums[k / span];
        (*sum, *count) = (*sum + series[*k], *count + 1);
    }
    let stride = stride(usable);
    let mean = |(sum, count): &(f64, usize)| {
        (*count > 0 && 2 * count * stride >= span).then(|| rounded(sum / *count as f64))
    };
    sums.iter().map(mean).collect()
}

/// Four decimals: a tenth of a millikelvin is less than any thermometer knows, and keeps the document short.
fn rounded(value: f64) -> f64 {
    (1e4 * value).round() / 1e4
}

/// A sample of the grid with what an effect would add there and what is unexplained.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    row: usize,
    x: f64,
    y: f64,
}

fn bins(problem: &Problem, mut points: Vec<Point>) -> Vec<AddedBin> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.row.cmp(&b.row)));
    let mut series = vec![0.0; problem.grid().len()];
    points.iter().for_each(|point| series[point.row] = point.y);
    let one = |bin: &[Point]| {
        let mean = |of: fn(&Point) -> f64| bin.iter().map(of).sum::<f64>() / bin.len() as f64;
        let rows: Vec<usize> = bin.iter().map(|point| point.row).collect();
        let unexplained_ci95 = interval(problem, &series, &rows, SEED);
        AddedBin {
            effect: mean(|point| point.x),
            unexplained: mean(|point| point.y),
            unexplained_ci95,
            samples: bin.len(),
        }
    };
    equal_bins(&points, BINS).into_iter().map(one).collect()
}

/// Sorted points in about so many bins of the same size. What is equal is never parted: half of all samples
/// are nights.
fn equal_bins(sorted: &[Point], bins: usize) -> Vec<&[Point]> {
    let least = sorted.len().div_ceil(bins).max(1);
    let mut found = Vec::new();
    let mut rest = sorted;
    while !rest.is_empty() {
        let full = least.min(rest.len());
        let end = full + rest[full..].iter().take_while(|point| point.x == rest[full - 1].x).count();
        // A rest that fills no half bin stays with the last one.
        let end = if 2 * (rest.len() - end) < least { rest.len() } else { end };
        let (bin, left) = rest.split_at(end);
        found.push(bin);
        rest = left;
    }
    found
}

/// Slope and height at zero of the straight line of least squares; `None` where x does not vary or is no
/// number.
fn straight_line(points: &[Point]) -> Option<[f64; 2]> {
    let n = points.len() as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), point| (x + point.x / n, y + point.y / n));
    let (xx, xy) =
        points.iter().fold((0.0, 0.0), |(xx, xy), p| (xx + (p.x - x).powi(2), xy + (p.x - x) * (p.y - y)));
    let line = [xy / xx, y - xy / xx * x];
    (xx > 0.0 && line.iter().all(|value| value.is_finite())).then_some(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_leave_gaps_where_less_than_half_is_known() {
        let series = [1.0, 2.0, 3.0, 4.0, 50.0, 60.0, 7.0];
        assert_eq!(means(&series, &[0, 1, 2, 3, 6], 2), [Some(1.5), Some(3.5), None, Some(7.0)]);
        assert_eq!(
            means(&series, &[0, 2, 3, 6], 3),
            [Some(2.0), None, None],
            "two of three are enough, one is not"
        );
        assert_eq!(means(&[1.0 / 3.0], &[0], 1), [Some(0.3333)]);
    }

    fn points(pairs: impl IntoIterator<Item = (f64, f64)>) -> Vec<Point> {
        pairs.into_iter().enumerate().map(|(row, (x, y))| Point { row, x, y }).collect()
    }

    #[test]
    fn bins_are_equal_and_never_part_what_is_equal() {
        // Twelve nights without sun, then eight hours that all differ.
        let sun = points((0..20).map(|k| ((f64::from(k) - 11.0).max(0.0), 1.0)));
        let sizes = |points: &[Point], bins: usize| {
            equal_bins(points, bins).iter().map(|bin| bin.len()).collect::<Vec<_>>()
        };
        assert_eq!(sizes(&sun, 10), [12, 2, 2, 2, 2]);
        assert_eq!(sizes(&sun, 7), [12, 3, 3, 2], "a rest of two is no less than half of three");
        assert_eq!(sizes(&sun[..5], 10), [5]);
    }

    #[test]
    fn the_line_is_that_of_least_squares() {
        // Residuals +1, -2, +1 sum to nothing, also against x: the line is y = 3 x - 4.
        let line = straight_line(&points([(1.0, 0.0), (2.0, 0.0), (3.0, 6.0)])).unwrap();
        assert!((line[0] - 3.0).abs() < 1e-12 && (line[1] + 4.0).abs() < 1e-12, "{line:?}");
        assert_eq!(straight_line(&points([(1.0, 0.0), (1.0, 5.0)])), None);
        assert_eq!(straight_line(&points([(f64::NAN, 0.0), (1.0, 5.0)])), None);
    }

    #[test]
    fn a_bin_holds_the_means_and_its_days() {
        let (problem, _) = super::super::tests::small_world(&[]);
        // Ten days, in the latter five of which the effect is on and the error 0.5 higher.
        let on = |k: usize| if k >= 240 { 1.0 } else { 0.0 };
        let error = |k: usize| 0.5 * on(k) + if k.is_multiple_of(2) { 0.1 } else { -0.1 };
        let found = bins(&problem, points((0..480).map(|k| (on(k), error(k)))));
        assert_eq!(
            found.iter().map(|bin| (bin.effect, bin.samples)).collect::<Vec<_>>(),
            [(0.0, 240), (1.0, 240)]
        );
        for bin in &found {
            let [low, high] = bin.unexplained_ci95.unwrap();
            // All whole days have the same mean, so that resampling them changes little.
            assert!((bin.unexplained - 0.5 * bin.effect).abs() < 1e-9 && high - low < 0.01, "{bin:?}");
        }
    }
}
