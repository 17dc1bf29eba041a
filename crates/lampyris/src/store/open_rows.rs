//! The rows of live samples that are not laid into the days yet, as they are written and read.

use super::engine::Session;
use super::error::StoreError;
use super::statement::query_as;
use super::value::{corrupt, from_json, to_json};
use lampyris_core::data::{Hold, Series, Window};

/// Rows that are read beside the days.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OpenRows {
    /// The samples, of one channel.
    pub series: Series,
    /// The number of the window that gives them.
    pub owner: i64,
}

/// A channel of a post as it is written: name, unit, hold, times in milliseconds, values.
type Written = (String, String, Hold, Vec<i64>, Vec<f64>);

/// The rows of a post as they are kept.
pub(super) fn written(window: &Window) -> Result<String, StoreError> {
    let channel = |series: &Series| -> Written {
        let text = |text: &str| text.to_owned();
        let (times, values) = series.samples().unzip();
        (text(series.channel()), text(series.unit()), series.hold(), times, values)
    };
    to_json("samples", &window.iter().map(channel).collect::<Vec<_>>())
}

/// The open rows of a system that touch a stretch of time, in their order; of some channels, or of all.
pub(super) async fn open_in(
    connection: &mut Session,
    system: &str,
    (from, to): (i64, i64),
    channels: Option<&[String]>,
) -> Result<Vec<OpenRows>, StoreError> {
    let sql = "SELECT w.sequence, s.rows FROM samples s JOIN windows w ON w.id = s.window_id WHERE s.system = $1 \
        AND s.to_ms >= $2 AND s.from_ms <= $3 ORDER BY s.sequence";
    let posts: Vec<(i64, String)> =
        query_as(sql).bind(system).bind(from).bind(to).fetch_all(connection).await?;
    let mut all = Vec::new();
    for (owner, rows) in posts {
        let wanted = |series: &Series| {
            channels.is_none_or(|channels| channels.iter().any(|channel| channel == series.channel()))
        };
        all.extend(read(&rows)?.into_iter().filter(wanted).map(|series| OpenRows { series, owner }));
    }
    Ok(all)
}

/// The series of a post.
pub(super) fn read(rows: &str) -> Result<Vec<Series>, StoreError> {
    let written: Vec<Written> = from_json("samples", rows)?;
    let series = |(channel, unit, hold, times, values): Written| {
        Series::new(&channel, &unit, hold, times, values).map_err(|fault| corrupt("samples", &fault))
    };
    written.into_iter().map(series).collect()
}
