//! Figures for Prometheus: `/metrics`, and the layer that times the answers.

use super::access::Caller;
use super::places::{Connection, ConnectionCounts};
use super::problem::Problems;
use super::shared::Shared;
use crate::service::observe::metrics::Histogram;
use crate::service::serving::body;
use crate::store;
use axum::Extension;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Systems that have series of their own; more would cost a monitor more than they tell.
const MOST_SYSTEMS: usize = 1000;
/// Requests for no path of the service are counted under this one.
const NO_ROUTE: &str = "none";

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_metrics))
}

/// Counts and times an answer by the template of its path: paths as they come would make endless series.
pub(crate) async fn measure(State(service): State<Shared>, request: Request, next: Next) -> Response {
    let method = known(request.method());
    let route = request.extensions().get::<MatchedPath>().cloned();
    let start = Instant::now();
    let response = next.run(request).await;
    let route = route.as_ref().map_or(NO_ROUTE, MatchedPath::as_str);
    service.metrics.answered(method, route, response.status().as_u16(), start.elapsed());
    response
}

/// A method may be any word.
fn known(method: &Method) -> &'static str {
    match *method {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        Method::PUT => "PUT",
        Method::DELETE => "DELETE",
        _ => "other",
    }
}

/// Figures about the service, as Prometheus reads them.
#[utoipa::path(
    get,
    path = "/metrics",
    tag = "service",
    responses(
        (
            status = 200,
            description = "Text exposition format 0.0.4",
            body = String,
            content_type = "text/plain"
        ),
        Problems
    )
)]
async fn get_metrics(
    State(service): State<Shared>,
    caller: Caller,
    place: Option<Extension<Arc<Connection>>>,
) -> Response {
    let mut text = Exposition::default();
    about_the_service(&service, &mut text).await;
    if let Some(Extension(place)) = place {
        about_connections(place.crowd(), &mut text);
    }
    about_jobs(&service, &mut text).await;
    about_lines(&service, &mut text);
    about_systems(&service, &caller, &mut text, service.now());
    about_requests(&service, &mut text);
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text.0).into_response()
}

async fn about_the_service(service: &Shared, text: &mut Exposition) {
    text.family("lampyris_build_info", "gauge", "What runs here.");
    text.sample("lampyris_build_info", &[("version", env!("CARGO_PKG_VERSION"))], 1.0);
    text.plain(
        "lampyris_boot",
        "gauge",
        "How often the service was started on this database.",
        service.membership.worker() as f64,
    );
    let started = service.metrics.started_at.as_millisecond() as f64 / 1000.0;
    text.plain(
        "process_start_time_seconds",
        "gauge",
        "When the service started, in seconds since 1970.",
        started,
    );
    let writable = service.store.writable().await.is_ok();
    text.plain(
        "lampyris_database_writable",
        "gauge",
        "Whether the database can be written.",
        f64::from(u8::from(writable)),
    );
    let refused = service.tokens.refused() as f64;
    text.plain("lampyris_refused_total", "counter", "Requests that showed no token that is good.", refused);
    let busy = store::busy() as f64;
    text.plain(
        "lampyris_database_busy_total",
        "counter",
        "How often another process held the database for too long.",
        busy,
    );
    let workers = service.workers_alive.load(Ordering::Relaxed);
    text.plain("lampyris_workers", "gauge", "Workers that wait for jobs or run one.", workers as f64);
    text.plain(
        "lampyris_jobs_abandoned",
        "gauge",
        "Jobs that were given up because they did not hear, and still hold their threads.",
        *service.abandoned.borrow() as f64,
    );
    text.plain(
        "lampyris_event_listeners",
        "gauge",
        "Open streams of events.",
        service.events.listeners() as f64,
    );
}

fn about_connections(crowd: ConnectionCounts, text: &mut Exposition) {
    let known = crowd.connections - crowd.strangers;
    text.family("lampyris_connections", "gauge", "Open connections, by whether they have shown a token.");
    text.sample("lampyris_connections", &[("of", "strangers")], crowd.strangers as f64);
    text.sample("lampyris_connections", &[("of", "known")], known as f64);
    text.plain(
        "lampyris_connections_displaced_total",
        "counter",
        "Connections that lost their place to others because there were too many.",
        crowd.displaced as f64,
    );
}

async fn about_jobs(service: &Shared, text: &mut Exposition) {
    // Without the database the queue is unknown, and no series says that it is empty.
    match store::metrics::queue(&service.store).await {
        Ok(queue) => {
            text.family("lampyris_jobs", "gauge", "Jobs that wait or run.");
            for standing in &queue {
                text.sample("lampyris_jobs", &[("state", standing.state.as_str())], standing.count as f64);
            }
            text.family(
                "lampyris_jobs_oldest_seconds",
                "gauge",
                "How long the oldest of them has been waiting or running.",
            );
            for standing in &queue {
                let age = standing.oldest.map_or(0.0, |oldest| age(oldest, service.now()));
                text.sample("lampyris_jobs_oldest_seconds", &[("state", standing.state.as_str())], age);
            }
        }
        Err(error) => tracing::error!(%error, "the queue could not be counted"),
    }
    let tallies = service.metrics.read();
    text.family(
        "lampyris_jobs_ended_total",
        "counter",
        "Jobs that ended, by outcome; those without one by state.",
    );
    for ([kind, outcome], count) in &tallies.jobs_ended {
        text.sample("lampyris_jobs_ended_total", &[("kind", kind), ("outcome", outcome)], *count as f64);
    }
    text.family("lampyris_jobs_failed_total", "counter", "Jobs that came to no result, by reason.");
    for (code, count) in &tallies.jobs_failed {
        text.sample("lampyris_jobs_failed_total", &[("code", code)], *count as f64);
    }
    text.family("lampyris_job_duration_seconds", "histogram", "How long jobs ran.");
    text.histogram("lampyris_job_duration_seconds", &[], &tallies.job_seconds);
    text.family("lampyris_queue_wait_seconds", "histogram", "How long jobs waited.");
    text.histogram("lampyris_queue_wait_seconds", &[], &tallies.wait_seconds);
    text.plain(
        "lampyris_evaluations_total",
        "counter",
        "Simulations of the jobs that ended.",
        tallies.evaluations as f64,
    );
    text.plain(
        "lampyris_fallbacks_total",
        "counter",
        "How often a failure left a system with its parameters of before.",
        tallies.fallbacks as f64,
    );
    text.family(
        "lampyris_gate_failed_total",
        "counter",
        "Checks of the gate that kept a fit from being served.",
    );
    for (check, count) in &tallies.checks_failed {
        text.sample("lampyris_gate_failed_total", &[("check", check)], *count as f64);
    }
}

fn about_lines(service: &Shared, text: &mut Exposition) {
    let (taken, untaken) = service.lines.counts();
    text.plain(
        "lampyris_influx_points_total",
        "counter",
        "Values that came by line protocol and were taken.",
        taken as f64,
    );
    text.plain(
        "lampyris_influx_unmapped_total",
        "counter",
        "Values that came by line protocol and have no place, of which GET /sources/influx tells the latest.",
        untaken as f64,
    );
}

/// What is served, read from the finished bodies: nothing has to be counted while they are served.
fn about_systems(service: &Shared, caller: &Caller, text: &mut Exposition, now: Timestamp) {
    let mut counts = BTreeMap::from([("fresh", 0), ("stale", 0), ("fallback", 0), ("none", 0)]);
    let (mut ages, mut statuses, mut errors, mut bounds) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (system, entry) in service.params.all().into_iter().filter(|(system, _)| caller.may_see(system)) {
        let Some(served) = entry.validated() else {
            *counts.entry("none").or_default() += 1;
            continue;
        };
        *counts.entry(served.status.as_str()).or_default() += 1;
        if ages.len() == MOST_SYSTEMS {
            continue;
        }
        let body: Value = serde_json::from_slice(&served.body).unwrap_or_default();
        if let Some(validated) = body["validated_at"].as_str().and_then(|text| text.parse::<Timestamp>().ok())
        {
            ages.push((system.clone(), age(validated, now)));
        }
        let flags = body["flags"].as_array().into_iter().flatten().filter_map(Value::as_str);
        bounds.push((system.clone(), flags.filter(|flag| flag.starts_with("at_bound")).count()));
        for (output, error) in body["error"].as_object().into_iter().flatten() {
            for split in ["train", "validation", "test"] {
                let value = error[format!("{split}_rmse")].as_f64();
                errors.extend(value.map(|value| (system.clone(), output.clone(), split, value)));
            }
        }
        statuses.push((system, served.status));
    }
    text.family("lampyris_systems", "gauge", "Systems, by the status of what they serve.");
    for (status, count) in counts {
        text.sample("lampyris_systems", &[("status", status)], f64::from(count));
    }
    text.family(
        "lampyris_params_age_seconds",
        "gauge",
        "Time since the served parameters were last found fit to be served.",
    );
    ages.iter()
        .for_each(|(system, age)| text.sample("lampyris_params_age_seconds", &[("system", system)], *age));
    text.family("lampyris_params_status", "gauge", "Whether this is the status of what a system serves.");
    for (system, status) in &statuses {
        for word in body::Status::VALIDATED {
            text.sample(
                "lampyris_params_status",
                &[("system", system), ("status", word.as_str())],
                f64::from(u8::from(word == *status)),
            );
        }
    }
    text.family(
        "lampyris_live_rmse",
        "gauge",
        "Error on the newest measurements: of forecasts in the unit \
        of the output, of a model without a filter that of its free run in the noise of the sensors.",
    );
    for (system, (horizon, rmse)) in service
        .metrics
        .read()
        .live_rmse
        .iter()
        .filter(|(system, _)| ages.iter().any(|(known, _)| known == *system))
    {
        text.sample("lampyris_live_rmse", &[("system", system), ("horizon", horizon)], *rmse);
    }
    text.family("lampyris_params_at_bound", "gauge", "Served parameters that sit on a bound of the search.");
    bounds.iter().for_each(|(system, count)| {
        text.sample("lampyris_params_at_bound", &[("system", system)], *count as f64)
    });
    text.family(
        "lampyris_fit_rmse",
        "gauge",
        "Free-run error of the served parameters in the unit of the output.",
    );
    for (system, output, split, value) in &errors {
        text.sample("lampyris_fit_rmse", &[("system", system), ("output", output), ("split", split)], *value);
    }
}

fn about_requests(service: &Shared, text: &mut Exposition) {
    let tallies = service.metrics.read();
    let polls = [("/params", &service.metrics.all_polls), ("/params/{kind}/{id}", &service.metrics.polls)];
    text.family("http_requests_total", "counter", "Requests that were answered.");
    for (route, polls) in polls {
        for (code, count) in polls.counts().filter(|(_, count)| *count > 0) {
            text.sample(
                "http_requests_total",
                &[("method", "GET"), ("route", route), ("code", &code.to_string())],
                count as f64,
            );
        }
    }
    for ((method, route, code), count) in &tallies.requests {
        text.sample(
            "http_requests_total",
            &[("method", method), ("route", route), ("code", &code.to_string())],
            *count as f64,
        );
    }
    text.family(
        "http_request_duration_seconds",
        "histogram",
        "Time until an answer began; polls of /params are not timed.",
    );
    for ((route, code), histogram) in &tallies.answer_seconds {
        text.histogram(
            "http_request_duration_seconds",
            &[("route", route), ("code", &code.to_string())],
            histogram,
        );
    }
}

/// Seconds since an instant; a clock that was set back makes none negative.
fn age(since: Timestamp, now: Timestamp) -> f64 {
    now.duration_since(since).as_secs_f64().max(0.0)
}

/// Text in the exposition format of Prometheus.
#[derive(Debug, Default)]
struct Exposition(String);

impl Exposition {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        // Writing to a text cannot fail, here and below.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        self.0.push_str(name);
        for (index, (label, text)) in labels.iter().enumerate() {
            let text = text.replace('\\', r"\\").replace('"', r#"\""#).replace('\n', r"\n");
            let _ = write!(self.0, "{}{label}=\"{text}\"", if index == 0 { "{" } else { "," });
        }
        let _ = writeln!(self.0, "{} {value}", if labels.is_empty() { "" } else { "}" });
    }

    fn plain(&mut self, name: &str, kind: &str, help: &str, value: f64) {
        self.family(name, kind, help);
        self.sample(name, &[], value);
    }

    fn histogram(&mut self, name: &str, labels: &[(&str, &str)], histogram: &Histogram) {
        let cumulative = histogram.cumulative();
        let bounds = histogram.bounds.iter().map(ToString::to_string).chain(["+Inf".to_owned()]);
        for (bound, count) in bounds.zip(&cumulative) {
            let labels: Vec<(&str, &str)> = labels.iter().copied().chain([("le", bound.as_str())]).collect();
            self.sample(&format!("{name}_bucket"), &labels, *count as f64);
        }
        self.sample(&format!("{name}_sum"), labels, histogram.sum);
        self.sample(&format!("{name}_count"), labels, cumulative.last().copied().unwrap_or(0) as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_escaped() {
        let mut text = Exposition::default();
        text.sample("a", &[("x", "b\"c\\d\ne"), ("y", "")], 0.5);
        text.plain("b", "gauge", "Help.", 3.0);
        assert_eq!(text.0, "a{x=\"b\\\"c\\\\d\\ne\",y=\"\"} 0.5\n# HELP b Help.\n# TYPE b gauge\nb 3\n");
    }
}
