//! What was measured, stitched from all windows of a system: for a chart as JSON, for a file as CSV.

use super::extract::{Asked, Named};
use super::negotiate::{Wanted, rendered};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::windows::Format;
use crate::service::query::series::{self, CHART_POINTS, ShownChannel, View};
use axum::body::Body;
use axum::extract::State;
use axum::response::Response;
use indexmap::IndexMap;
use lampyris_core::data::{Bucket, CsvChannel, Hold, Seconds, Thinned, rfc3339, write_csv};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_series))
}

/// Which part of the measurements.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct SeriesQuery {
    /// The first instant, itself included; that of the first sample by default.
    #[param(example = "2026-01-01T00:00:00Z")]
    from: Option<String>,
    /// The last instant, itself included; that of the newest sample by default.
    to: Option<String>,
    /// Names with commas between them; all channels by default.
    #[param(example = "T_room,T_out")]
    channels: Option<String>,
    /// Points of each channel, between 10 and 100000; 2000 by default as JSON. CSV holds every sample unless
    /// this is given.
    #[param(value_type = Option<u32>, minimum = 10, maximum = 100_000)]
    max_points: Option<String>,
}

/// The stitched measurements of a system.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Series)]
struct SeriesAnswer {
    #[schema(example = "room/4")]
    system: String,
    /// The first instant; `null` where nothing was ever measured.
    #[schema(value_type = Option<String>, format = DateTime)]
    from: Option<String>,
    /// The last instant.
    #[schema(value_type = Option<String>, format = DateTime)]
    to: Option<String>,
    /// The channels that have samples there.
    #[schema(value_type = HashMap<String, ChannelSeries>)]
    channels: IndexMap<String, ChannelSeries>,
    /// Whether any channel is thinned.
    thinned: bool,
    /// How, in a sentence; `null` where no channel is.
    thinning: Option<&'static str>,
    /// What a `null` means, in a sentence.
    gaps: &'static str,
}

/// One channel: `values` with every sample, or `min`, `max`, `mean` and `count` of buckets, each as long as
/// `time`.
#[derive(Debug, Serialize, ToSchema)]
struct ChannelSeries {
    #[schema(example = "degC")]
    unit: String,
    /// What the channel is between two samples: `linear`, or `zero_order` where a value holds until the next.
    #[schema(value_type = String)]
    hold: Hold,
    /// Samples behind the points.
    samples: usize,
    /// The median time between two samples, in seconds.
    median_step_s: Option<Seconds>,
    /// Gaps between the samples, those within a bucket included.
    gaps: usize,
    /// The width of a bucket in seconds, where the channel is thinned.
    #[serde(skip_serializing_if = "Option::is_none")]
    bucket_s: Option<Seconds>,
    /// The times of the samples, or the middles of the buckets.
    #[schema(value_type = Vec<String>)]
    time: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    values: Option<Vec<Option<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<Vec<Option<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<Vec<Option<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mean: Option<Vec<Option<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    count: Option<Vec<usize>>,
}

const THINNING: &str = "A channel with more samples than `max_points` shows, per bucket of `bucket_s` \
    seconds, the lowest, the highest and the mean \
    value and the number of its samples; `time` is the middle of the bucket, and a bucket without samples is \
    left out.";
const GAPS: &str = "Two samples further apart than three median steps of the channel have a gap between \
    them: a `null` stands there, and no line \
    should cross it. A gap within a bucket lowers its `count` only.";

impl ChannelSeries {
    fn of(ShownChannel { series, points }: ShownChannel) -> (String, Self) {
        let mut channel = Self {
            unit: series.unit().to_owned(),
            hold: series.hold(),
            samples: series.len(),
            median_step_s: series.median_step().map(Seconds::of_millis),
            gaps: series.gaps().len(),
            bucket_s: None,
            time: points.times().iter().map(|time| rfc3339(*time)).collect(),
            values: None,
            min: None,
            max: None,
            mean: None,
            count: None,
        };
        match points {
            Thinned::Samples { values, .. } => channel.values = Some(values),
            Thinned::Envelope { bucket, buckets, .. } => {
                let column =
                    |of: fn(Bucket) -> f64| Some(buckets.iter().map(|bucket| bucket.map(of)).collect());
                channel.bucket_s = Some(Seconds::of_millis(bucket));
                channel.min = column(|bucket| bucket.min);
                channel.max = column(|bucket| bucket.max);
                channel.mean = column(|bucket| bucket.mean);
                channel.count =
                    Some(buckets.iter().map(|bucket| bucket.map_or(0, |bucket| bucket.count)).collect());
            }
        }
        (series.channel().to_owned(), channel)
    }
}

/// The measurements of a system, stitched from all its windows: where several have a sample of a channel at
/// one time, the newest upload counts.
///
/// The CSV can be posted as a window again and gives the same values. It holds every sample unless
/// `max_points` is given; then a thinned channel has the columns `.min`, `.mean` and `.max` in place of its
/// own.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/series",
    tag = "windows",
    params(("kind" = String, Path), ("id" = String, Path), SeriesQuery),
    responses(
        (status = 200, content((SeriesAnswer = "application/json"), (String = "text/csv"))),
        (
            status = 406,
            description = "Neither of the two forms is acceptable",
            body = super::problem::Problem,
            content_type = "application/problem+json"
        ),
        Problems,
    )
)]
async fn get_series(
    State(service): State<Shared>,
    Named(system): Named,
    Asked(query): Asked<SeriesQuery>,
    Wanted(format): Wanted,
) -> Result<Response, ApiError> {
    let asked = series::SeriesAsked {
        from: query.from,
        to: query.to,
        channels: query.channels,
        max_points: query.max_points,
    };
    let body = match format {
        Format::Csv => series::view(&service, &system, &asked, None, |view| Ok(csv(&view))).await?,
        Format::Json => {
            let name = system.to_string();
            series::view(&service, &system, &asked, Some(CHART_POINTS), |view| json(name, view)).await?
        }
    };
    let body = body.map_err(|error| ApiError::Internal(error.to_string()))?;
    Ok(rendered(format, Body::from(body)))
}

fn json(system: String, view: View) -> Result<String, serde_json::Error> {
    let (from, to) = view.span.map(|(from, to)| (rfc3339(from), rfc3339(to))).unzip();
    let thinned = view.channels.iter().any(|channel| matches!(channel.points, Thinned::Envelope { .. }));
    let channels = view.channels.into_iter().map(ChannelSeries::of).collect();
    serde_json::to_string(&SeriesAnswer {
        system,
        from,
        to,
        channels,
        thinned,
        thinning: thinned.then_some(THINNING),
        gaps: GAPS,
    })
}

fn csv(view: &View) -> String {
    let shown = view.channels.iter();
    let channels: Vec<CsvChannel<'_>> = shown
        .map(|ShownChannel { series, points }| CsvChannel {
            channel: series.channel(),
            unit: series.unit(),
            points,
        })
        .collect();
    write_csv(&channels)
}
