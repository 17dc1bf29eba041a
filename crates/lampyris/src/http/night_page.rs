//! The report of a night as a page by itself: no scripts, nothing from elsewhere, styles on every element, so
//! that mail programs show it as a browser does.

use super::shared::Shared;
use crate::service::query::night::report::{
    ChangedSystem, DoubtfulSystem, NightReport, RefusalGroup, SkippedGroup,
};
use axum::http::{HeaderMap, header};
use std::fmt::Write;

/// Systems that are named in a row; of more the number is told.
const NAMED: usize = 12;
/// Rows of a table.
const ROWS: usize = 60;
const CELL: &str =
    "padding:4px 10px 4px 0;text-align:left;vertical-align:top;border-bottom:1px solid #d0d7de";
const NUMBER: &str =
    "padding:4px 10px 4px 0;text-align:right;vertical-align:top;border-bottom:1px solid #d0d7de";
const TITLE: &str = "font-size:17px;margin:24px 0 6px";

/// The address at which people reach the page, or else that under which the service was asked: links of a
/// mail need all of it.
pub fn base(service: &Shared, headers: &HeaderMap) -> String {
    if let Some(notify) = service.settings.notify.as_ref().filter(|notify| !notify.page.is_empty()) {
        return notify.page.trim_end_matches('/').to_owned();
    }
    let scheme = if service.settings.tls.is_some() { "https" } else { "http" };
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    host.map(|host| format!("{scheme}://{host}")).unwrap_or_default()
}

fn escaped(text: &str) -> String {
    let mut safe = String::new();
    // Writing to a text cannot fail, here and below.
    let _ = pulldown_cmark_escape::escape_html(&mut safe, text);
    safe
}

fn link(base: &str, path: &str, text: &str) -> String {
    format!("<a style=\"color:#005d94\" href=\"{}\">{}</a>", escaped(&format!("{base}{path}")), escaped(text))
}

/// Systems as links, the first ones by name.
fn names(base: &str, systems: &[String], tab: &str) -> String {
    let shown: Vec<String> = systems
        .iter()
        .take(NAMED)
        .map(|system| link(base, &format!("/ui/systems/{system}{tab}"), system))
        .collect();
    let more = systems.len().saturating_sub(NAMED);
    let rest = if more == 0 { String::new() } else { format!(" and {more} more") };
    format!("{}{rest}", shown.join(", "))
}

fn table(heads: &[(&str, bool)], rows: &[Vec<String>]) -> String {
    let mut text = String::from("<table style=\"border-collapse:collapse;font-size:14px;width:100%\"><tr>");
    let style = |at: usize| if heads.get(at).is_some_and(|(_, number)| *number) { NUMBER } else { CELL };
    for (at, (head, _)) in heads.iter().enumerate() {
        let _ =
            write!(text, "<th style=\"{};color:#57606a;font-weight:600\">{}</th>", style(at), escaped(head));
    }
    text.push_str("</tr>");
    for row in rows.iter().take(ROWS) {
        text.push_str("<tr>");
        for (at, cell) in row.iter().enumerate() {
            let _ = write!(text, "<td style=\"{}\">{cell}</td>", style(at));
        }
        text.push_str("</tr>");
    }
    text.push_str("</table>");
    if rows.len() > ROWS {
        let _ = write!(text, "<p>The first {ROWS} of {}.</p>", rows.len());
    }
    text
}

fn error(value: Option<f64>, unit: Option<&str>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| escaped(&format!("{value:.2} {}", unit.unwrap_or_default())))
}

fn changed(base: &str, all: &[ChangedSystem]) -> String {
    let row = |one: &ChangedSystem| {
        let unit = one.unit.as_deref();
        vec![
            link(base, &format!("/ui/systems/{}/parameters", one.system), &one.system),
            escaped(&one.model),
            one.revision.map(|revision| revision.to_string()).unwrap_or_default(),
            error(one.before, unit),
            error(one.after, unit),
            escaped(one.horizon.as_deref().unwrap_or("free run")),
        ]
    };
    let heads = [
        ("system", false),
        ("model", false),
        ("revision", true),
        ("error before", true),
        ("error now", true),
        ("ahead", false),
    ];
    table(&heads, &all.iter().map(row).collect::<Vec<_>>())
}

fn doubtful(base: &str, all: &[DoubtfulSystem]) -> String {
    let row = |one: &DoubtfulSystem| {
        // A mark and a word, as on the page: no colour has to be seen.
        let mark = if one.status.as_str() == "degraded" { "▲" } else { "■" };
        vec![
            link(base, &format!("/ui/systems/{}", one.system), &one.system),
            format!("{mark} {}", escaped(one.status.as_str())),
            escaped(&one.why),
        ]
    };
    table(&[("system", false), ("status", false), ("why", false)], &all.iter().map(row).collect::<Vec<_>>())
}

/// The page. `base` is what its links begin with.
pub fn page(report: &NightReport, base: &str) -> String {
    let title = format!("Lampyris, night {}", report.night);
    let mut text = format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
        content=\"width=device-width,initial-scale=1\"><title>{0}</title></head><body \
        style=\"margin:0 auto;padding:16px;max-width:760px;background:#ffffff;color:#1b1f24;font:15px/1.5 \
        system-ui,-apple-system,'Segoe UI',Roboto,sans-serif\"><h1 style=\"font-size:22px;margin:0 0 8px\">{0}</h1>\
        <p style=\"margin:0 0 8px\">{1}</p>",
        escaped(&title),
        escaped(&report.summary)
    );
    let mut section = |head: &str, body: String| {
        let _ = write!(text, "<h2 style=\"{TITLE}\">{}</h2>{body}", escaped(head));
    };
    if !report.finished {
        section("It is not done yet", "<p>Some jobs still wait or run.</p>".to_owned());
    }
    if !report.next.is_empty() {
        let mut list = String::from("<ol style=\"margin:0;padding-left:22px\">");
        for step in &report.next {
            // One system is named in the sentence already.
            let named = if step.systems.len() > 1 { names(base, &step.systems, "") } else { String::new() };
            let _ = write!(
                list,
                "<li style=\"margin:4px 0\">{} {named}</li>",
                link(base, &step.link, &step.what)
            );
        }
        section("What to do next", list + "</ol>");
    }
    if !report.doubtful.is_empty() {
        section("Not to be relied on now", doubtful(base, &report.doubtful));
    }
    if !report.refused.is_empty() {
        let row = |group: &RefusalGroup| {
            vec![
                group.systems.len().to_string(),
                escaped(&group.rule),
                escaped(group.outcome),
                format!("{}<br>{}", escaped(&group.why), names(base, &group.systems, "/parameters")),
            ]
        };
        let heads = [("systems", true), ("rule", false), ("", false), ("why, of the first, and who", false)];
        section("Refused, and why", table(&heads, &report.refused.iter().map(row).collect::<Vec<_>>()));
    }
    if !report.changed.is_empty() {
        section("New parameters", changed(base, &report.changed));
    }
    if !report.confirmed.is_empty() {
        section("Good already", format!("<p>{}</p>", names(base, &report.confirmed, "")));
    }
    if !report.skipped.is_empty() {
        let row = |group: &SkippedGroup| {
            vec![group.systems.len().to_string(), escaped(&group.why), names(base, &group.systems, "/data")]
        };
        let heads = [("systems", true), ("why", false), ("who", false)];
        section("Left out", table(&heads, &report.skipped.iter().map(row).collect::<Vec<_>>()));
    }
    let _ = write!(
        text,
        "<p style=\"margin:24px 0 0;color:#57606a\">{}</p></body></html>",
        link(base, &format!("/ui/mornings/{}", report.night), "Open this report on the page")
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::query::night::report::NightStep;

    #[test]
    fn whatever_a_report_says_is_text_and_long_lists_are_counted() {
        let systems: Vec<String> = (0..20).map(|number| format!("room/{number}")).collect();
        let report = NightReport {
            night: "2026-11-26".into(),
            at: jiff::Timestamp::UNIX_EPOCH,
            finished: true,
            batches: Vec::new(),
            summary: "<script>alert(1)</script> & more".into(),
            changed: Vec::new(),
            confirmed: Vec::new(),
            refused: vec![RefusalGroup {
                rule: "G9 \"heating\"".into(),
                outcome: "held",
                systems,
                why: "<b>unplugged</b>".into(),
            }],
            skipped: Vec::new(),
            doubtful: Vec::new(),
            next: vec![NightStep { what: "Look".into(), systems: Vec::new(), link: "/ui/?a=1&b=2".into() }],
        };
        let page = page(&report, "http://127.0.0.1:8080");
        assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt; &amp; more"), "{page}");
        assert!(!page.contains("<script") && !page.contains("<b>"), "{page}");
        assert!(page.contains("href=\"http://127.0.0.1:8080/ui/?a=1&amp;b=2\""), "{page}");
        assert!(page.contains("room/11</a> and 8 more"), "{page}");
    }
}
