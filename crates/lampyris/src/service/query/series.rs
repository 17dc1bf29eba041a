//! The stitched view of all windows of a system, as far as somebody wants to see it.

use crate::service::catalogue::systems;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use lampyris_core::data::{Series, SystemId, Thinned, read_time};
use lampyris_core::fault::{Fault, nearest};
use std::ops::RangeInclusive;

/// How few and how many points of a channel may be asked for.
const POINTS: RangeInclusive<usize> = 10..=100_000;
/// Points of a channel where the number is left open and the answer is for a chart.
pub const CHART_POINTS: usize = 2_000;
/// Points of all channels together: about a hundred megabytes of text.
const MOST_POINTS: usize = 4_000_000;

/// What is asked for, as it was written.
#[derive(Debug, Clone, Default)]
pub struct SeriesAsked {
    /// The first instant, itself included; that of the first sample by default.
    pub from: Option<String>,
    /// The last instant, itself included; that of the newest sample by default.
    pub to: Option<String>,
    /// Names of channels with commas between them; all by default.
    pub channels: Option<String>,
    /// Points of each channel.
    pub max_points: Option<String>,
}

/// The samples of one channel, and the points that show them.
#[derive(Debug)]
pub struct ShownChannel {
    /// All samples between the instants.
    pub series: Series,
    /// The points.
    pub points: Thinned,
}

/// The stitched measurements between two instants.
#[derive(Debug)]
pub struct View {
    /// The instants, in milliseconds; nothing where nothing was ever measured.
    pub span: Option<(i64, i64)>,
    /// The channels that have samples there, as they were asked for.
    pub channels: Vec<ShownChannel>,
}

/// What is asked for, understood.
struct Wanted {
    from: Option<i64>,
    to: Option<i64>,
    channels: Vec<String>,
    max_points: usize,
}

/// Stitches what is asked for and renders it, both off the async threads. A request that does not say how
/// many points it wants gets the default, or every sample where there is none.
///
/// # Errors
/// Every fault of what is asked, an unknown system, windows that do not fit together, or where the database
/// fails.
pub(crate) async fn view<T: Send + 'static>(
    service: &Service,
    system: &SystemId,
    asked: &SeriesAsked,
    default_points: Option<usize>,
    render: impl FnOnce(View) -> T + Send + 'static,
) -> Result<T, ServiceError> {
    systems::require(service, system).await?;
    let known = store::measured::channels(&service.store, system).await?;
    let wanted = read(asked, &known, default_points).map_err(ServiceError::Faults)?;
    let Some((first, newest)) = store::measured::extent(&service.store, system).await? else {
        return blocking(|| render(View { span: None, channels: Vec::new() })).await;
    };
    let span = (wanted.from.unwrap_or(first), wanted.to.unwrap_or(newest));
    let days = store::measured::read(&service.store, system, span, Some(&wanted.channels)).await?;
    let work = move || -> Result<T, ServiceError> {
        let mut channels = Vec::new();
        for name in &wanted.channels {
            channels.extend(days.series(name)?.and_then(|series| series.slice(span.0, span.1)));
        }
        Ok(render(View { span: Some(span), channels: shown(channels, wanted.max_points)? }))
    };
    blocking(work).await?
}

/// Thins the channels where need be, in buckets that they share.
fn shown(channels: Vec<Series>, max_points: usize) -> Result<Vec<ShownChannel>, ServiceError> {
    let points: usize = channels.iter().map(|series| series.len().min(max_points)).sum();
    if points > MOST_POINTS {
        let detail = format!("{points} points of {} channels; {MOST_POINTS} are the most", channels.len());
        let fault = Fault::new("query max_points", "too-many-points", detail);
        return Err(ServiceError::Faults(vec![
            fault.suggest("ask for fewer points, fewer channels or a shorter range"),
        ]));
    }
    let from = channels.iter().map(Series::from).min().unwrap_or_default();
    let to = channels.iter().map(Series::to).max().unwrap_or_default();
    let show =
        |series: Series| ShownChannel { points: Thinned::new(&series, (from, to), max_points), series };
    Ok(channels.into_iter().map(show).collect())
}

/// Understands what is asked, and names every fault of it.
fn read(asked: &SeriesAsked, known: &[String], default_points: Option<usize>) -> Result<Wanted, Vec<Fault>> {
    let mut faults = Vec::new();
    let mut instant = |place: &str, text: &Option<String>| {
        text.as_ref().and_then(|text| read_time(place, text).map_err(|fault| faults.push(fault)).ok())
    };
    let (from, to) = (instant("query from", &asked.from), instant("query to", &asked.to));
    if from.zip(to).is_some_and(|(from, to)| from >= to) {
        faults.push(Fault::new("query to", "out-of-order", "`to` must lie after `from`"));
    }
    let channels: Vec<String> = match &asked.channels {
        None => known.to_vec(),
        Some(names) => {
            let mut channels: Vec<String> = Vec::new();
            for name in names.split(',').map(str::trim) {
                if !known.iter().any(|known| known == name) {
                    faults.push(unknown_channel(name, known));
                } else if !channels.iter().any(|earlier| earlier == name) {
                    channels.push(name.to_owned());
                }
            }
            channels
        }
    };
    let max_points = match asked.max_points.as_deref().map(str::parse::<usize>) {
        None => default_points.unwrap_or(usize::MAX),
        Some(Ok(points)) if POINTS.contains(&points) => points,
        Some(_) => {
            let detail =
                format!("`max_points` is a whole number between {} and {}", POINTS.start(), POINTS.end());
            faults.push(Fault::new("query max_points", "out-of-range", detail));
            0
        }
    };
    if faults.is_empty() { Ok(Wanted { from, to, channels, max_points }) } else { Err(faults) }
}

fn unknown_channel(name: &str, known: &[String]) -> Fault {
    let shown: String = name.chars().take(60).collect();
    let fault = Fault::new(
        "query channels",
        "unknown-channel",
        format!("there is no channel `{}`", shown.escape_debug()),
    );
    match nearest(name, known.iter().map(String::as_str)) {
        Some(near) => fault.suggest(format!("did you mean `{near}`?")),
        None if known.is_empty() => fault.suggest("there are no measurements yet"),
        None => fault
            .suggest(format!("there are {}", known.iter().take(50).cloned().collect::<Vec<_>>().join(", "))),
    }
}
