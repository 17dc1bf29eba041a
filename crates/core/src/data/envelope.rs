//! Fewer points for a chart: each stands for a stretch of samples and keeps its lowest and its highest value,
//! so that no spike is lost and no value is made up.

use serde::Serialize;

/// How many samples become one point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Thinning {
    samples: usize,
    per_point: usize,
}

/// The lowest and the highest value of every point; `None` where a point has no value at all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Envelope {
    /// The lowest value.
    pub min: Vec<Option<f64>>,
    /// The highest value.
    pub max: Vec<Option<f64>>,
}

impl Thinning {
    /// As few samples to a point as make at most so many points.
    pub fn new(samples: usize, max_points: usize) -> Self {
        Self { samples, per_point: samples.div_ceil(max_points.max(1)).max(1) }
    }

    /// Samples to a point; 1 where nothing is thinned.
    pub fn per_point(&self) -> usize {
        self.per_point
    }

    /// How many points there are.
    pub fn points(&self) -> usize {
        self.samples.div_ceil(self.per_point)
    }

    /// The first sample of every point.
    pub fn starts(&self) -> impl Iterator<Item = usize> {
        (0..self.samples).step_by(self.per_point)
    }

    /// The extremes of every point. Values must be finite.
    pub fn envelope(&self, values: &[Option<f64>]) -> Envelope {
        let extreme = |stretch: &[Option<f64>], better: fn(f64, f64) -> f64| {
            stretch.iter().copied().flatten().reduce(better)
        };
        Envelope {
            min: values.chunks(self.per_point).map(|stretch| extreme(stretch, f64::min)).collect(),
            max: values.chunks(self.per_point).map(|stretch| extreme(stretch, f64::max)).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Thinning;
    use proptest::prelude::{Just, Strategy, prop_assert, prop_assert_eq, prop_oneof, proptest};

    #[test]
    fn extremes_and_gaps_stay() {
        let thinning = Thinning::new(7, 3);
        assert_eq!((thinning.per_point(), thinning.points()), (3, 3));
        let values = [Some(1.0), Some(9.0), Some(-2.0), None, None, None, Some(4.0)];
        let envelope = thinning.envelope(&values);
        assert_eq!(envelope.min, [Some(-2.0), None, Some(4.0)]);
        assert_eq!(envelope.max, [Some(9.0), None, Some(4.0)]);
        assert_eq!(thinning.starts().collect::<Vec<_>>(), [0, 3, 6]);
        assert_eq!((Thinning::new(7, 7).per_point(), Thinning::new(0, 5).points()), (1, 0));
    }

    proptest! {
        #[test]
        fn every_value_lies_in_its_envelope(
            values in proptest::collection::vec(
                prop_oneof![Just(None), (-50.0f64..50.0).prop_map(Some)],
                0..200
            ),
            most in 1usize..60,
        ) {
            let thinning = Thinning::new(values.len(), most);
            let envelope = thinning.envelope(&values);
            prop_assert!(thinning.points() <= most);
            prop_assert_eq!(envelope.min.len(), thinning.points());
            prop_assert_eq!(thinning.starts().count(), thinning.points());
            for (index, value) in values.iter().enumerate() {
                let point = index / thinning.per_point();
                if let Some(value) = value {
                    prop_assert!(envelope.min[point].unwrap() <= *value && *value <= envelope.max[point].unwrap());
                }
            }
            for (min, max) in envelope.min.iter().zip(&envelope.max).filter_map(|(min, max)| Some((*min.as_ref()?, *max.as_ref()?))) {
                prop_assert!(values.contains(&Some(min)) && values.contains(&Some(max)));
            }
        }
    }
}
