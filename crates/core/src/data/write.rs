//! Columns as CSV that the parser of windows reads back to the same values.

use std::fmt::Write;

use super::header::shielded;
use super::stamp::rfc3339;
use super::thin::{Bucket, Thinned};

/// A channel on its way into a table: its name, its unit and its points.
#[derive(Debug, Clone, Copy)]
pub struct CsvChannel<'a> {
    /// The name.
    pub channel: &'a str,
    /// The unit of the values, as a unit text.
    pub unit: &'a str,
    /// The points.
    pub points: &'a Thinned,
}

/// One row per time that any channel has; a cell without a sample is empty.
///
/// A channel with all its samples has one column `T_room[degC]`; an envelope has three, `T_room.min[degC]`,
/// `T_room.mean[degC]` and `T_room.max[degC]`, so that nobody takes it for measurements of `T_room`.
pub fn write_csv(channels: &[CsvChannel<'_>]) -> String {
    let mut text = "time".to_owned();
    for CsvChannel { channel, unit, points } in channels {
        match points {
            Thinned::Samples { .. } => push_header(&mut text, &format!("{channel}[{unit}]")),
            Thinned::Envelope { .. } => ["min", "mean", "max"]
                .iter()
                .for_each(|part| push_header(&mut text, &format!("{channel}.{part}[{unit}]"))),
        }
    }
    text.push('\n');
    let mut next = vec![0; channels.len()];
    let ahead = |next: &[usize]| {
        channels
            .iter()
            .zip(next)
            .filter_map(|(channel, next)| channel.points.times().get(*next).copied())
            .min()
    };
    while let Some(time) = ahead(&next) {
        let start = text.len();
        text.push_str(&rfc3339(time));
        let mut has_value = false;
        for (channel, next) in channels.iter().zip(&mut next) {
            let here = (channel.points.times().get(*next) == Some(&time)).then_some(*next);
            *next += usize::from(here.is_some());
            has_value |= push_cells(&mut text, channel.points, here);
        }
        // The mark of a gap is nothing that was measured: the empty time says it as well.
        if has_value { text.push('\n') } else { text.truncate(start) }
    }
    text
}

/// Writes the cells of one channel; says whether there is a value in them.
fn push_cells(text: &mut String, points: &Thinned, index: Option<usize>) -> bool {
    let cells: &[Option<f64>] = match points {
        Thinned::Samples { values, .. } => &[index.and_then(|index| values[index])],
        Thinned::Envelope { buckets, .. } => match index.and_then(|index| buckets[index]) {
            Some(Bucket { min, mean, max, .. }) => &[Some(min), Some(mean), Some(max)],
            None => &[None; 3],
        },
    };
    for cell in cells {
        text.push(',');
        if let Some(value) = cell {
            // The shortest text that reads back to the same bits; writing to a text cannot fail.
            let _ = write!(text, "{value}");
        }
    }
    cells.iter().any(Option::is_some)
}

/// Adds a header, quoted where it holds what would end it.
fn push_header(text: &mut String, header: &str) {
    let header = shielded(header);
    text.push(',');
    if header.contains([',', '"', ';', '\t', '\n', '\r']) {
        text.push('"');
        text.push_str(&header.replace('"', "\"\""));
        text.push('"');
    } else {
        text.push_str(&header);
    }
}

#[cfg(test)]
mod tests {
    use super::{CsvChannel, Thinned, write_csv};
    use crate::data::{ColumnBindings, Hold, Series, Window};
    use proptest::prelude::{any, prop_assert_eq, proptest};

    fn csv(series: &[Series], max_points: usize) -> String {
        let span =
            (series.iter().map(Series::from).min().unwrap(), series.iter().map(Series::to).max().unwrap());
        let points: Vec<Thinned> = series.iter().map(|one| Thinned::new(one, span, max_points)).collect();
        let channels: Vec<CsvChannel<'_>> = series
            .iter()
            .zip(&points)
            .map(|(one, points)| CsvChannel { channel: one.channel(), unit: one.unit(), points })
            .collect();
        write_csv(&channels)
    }

    #[test]
    fn every_channel_has_its_own_times() {
        let one = |name: &str, unit: &str, times: Vec<i64>, values: Vec<f64>| {
            Series::new(name, unit, Hold::Linear, times, values).unwrap()
        };
        let a = one("T_room", "degC", vec![0, 60_000, 600_000], vec![20.0, 0.1 + 0.2, -0.5]);
        let b = one("od,d \"name\"", "kW", vec![60_000, 120_000], vec![1e-7, 1e21]);
        let expected = "time,T_room[degC],\"od,d \"\"name\"\"[kW]\"\n1970-01-01T00:00:00Z,20,\n1970-01-01T00:01:00Z,0.30000000000000004,0.0000001\n\
                        1970-01-01T00:02:00Z,,1000000000000000000000\n1970-01-01T00:10:00Z,-0.5,\n";
        assert_eq!(csv(&[a.clone(), b], usize::MAX), expected);
        let thinned = csv(&[a], 2);
        assert_eq!(
            thinned,
            "time,T_room.min[degC],T_room.mean[degC],T_room.max[degC]\n1970-01-01T00:05:01Z,-0.5,6.6000000000000005,20\n"
        );
    }

    #[test]
    fn no_header_is_a_formula_and_every_name_reads_back() {
        for name in ["=1+1", "@x", "+a", "-b", "'=c", "''-d", "= e", "'plain", "a=b"] {
            let series = Series::new(name, "degC", Hold::Linear, vec![0, 60], vec![20.0, 21.0]).unwrap();
            let text = csv(&[series], usize::MAX);
            let header = text.lines().next().unwrap().strip_prefix("time,").unwrap();
            assert!(!header.trim_start_matches('"').starts_with(['=', '+', '-', '@']), "{text}");
            let (window, _) = Window::parse_csv(&text, &ColumnBindings::none()).unwrap();
            assert!(window.iter().any(|series| series.channel() == name), "{text}");
        }
    }

    proptest! {
        #[test]
        fn a_window_reads_back_to_the_same_bits(
            samples in proptest::collection::vec((1i64..10_000, any::<f64>(), any::<f64>()), 2..60),
            held in any::<bool>(),
        ) {
            let mut time = 0;
            let (mut all, mut odd) = (Vec::new(), Vec::new());
            for (index, (step, a, b)) in samples.into_iter().enumerate() {
                time += step;
                // As far as a window takes them.
                if a.abs() <= 1e15 {
                    all.push((time, a));
                }
                if b.abs() <= 1e15 && index % 2 == 1 {
                    odd.push((time, b));
                }
            }
            let series = |name: &str, samples: Vec<(i64, f64)>| {
                let (times, values) = samples.into_iter().unzip();
                Series::new(name, "kW", Hold::Linear, times, values)
            };
            let name = if held { "load_W" } else { "a [b]" };
            if let (Ok(all), Ok(odd)) = (series(name, all), series("time", odd)) {
                let window = Window::from_series(vec![all.clone(), odd.clone()]).unwrap();
                let (read, report) = Window::parse_csv(
                    &csv(&[all, odd], usize::MAX),
                    &ColumnBindings::none()
                ).unwrap();
                prop_assert_eq!(&report.rejected_rows, &[]);
                prop_assert_eq!(read.content_hash(), window.content_hash());
            }
        }
    }
}
