//! One HTML file without scripts, in the style of the service's own page: the frame of every benchmark's
//! page.

use jiff::Timestamp;
use lampyris::cli::Failure;
use lampyris::cli::table::aligned;
use lampyris::http::page_part;
use serde::Serialize;
use std::fmt::Write;

/// What charts and tables need beside the style of the page.
pub const STYLE: &str = "
svg.chart path.measured, svg.chart path.model, svg.chart path.previous, svg.chart path.heldout, svg.sample \
    path:not([class^=mark]) { fill: none; stroke-width: 1.5; stroke-linejoin: round; }
path.measured { stroke: var(--measured); }
path.model { stroke: var(--model); }
path.previous { stroke: var(--previous); stroke-dasharray: 2 2; }
path.heldout { stroke: var(--heldout); stroke-dasharray: 7 3; }
path.ok { fill: none; stroke: var(--ok); stroke-width: 1.5; stroke-dasharray: 9 2 2 2; }
svg.sample { width: 26px; height: 12px; vertical-align: middle; margin-right: .35rem; }
.unseen-part { fill: var(--validation); }
.mark-0 { stroke: var(--measured); stroke-width: 2; fill: none; }
.mark-1 { fill: var(--previous); }
.mark-2 { fill: var(--model); }
.mark-3 { fill: var(--heldout); }
.mark-4 { fill: var(--ok); }
svg.matrix { max-width: 32rem; }
rect.positive { fill: var(--model); }
rect.negative { fill: var(--heldout); }
line.edge-right { stroke: var(--ok); stroke-width: 3; }
line.edge-extra { stroke: var(--strong-edge); stroke-width: 1; stroke-dasharray: 3 3; }
line.edge-missed { stroke: var(--bad); stroke-width: 2.5; stroke-dasharray: 8 4; }
circle.node { fill: var(--panel); stroke: var(--strong-edge); }
details { margin: .4rem 0; }
details .scroll { max-height: 22rem; overflow: auto; }
summary { cursor: pointer; color: var(--link); min-height: 24px; }
thead th { position: sticky; top: 0; background: var(--ground); }
svg.dots { max-width: 56rem; }
td { white-space: nowrap; font-variant-numeric: tabular-nums; }
td.words { white-space: normal; min-width: 24ch; }
";

/// Stands where there is no value.
pub const NONE: &str = "-";

/// A table with its heading.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Table {
    /// Where it is put on the page.
    #[serde(skip)]
    pub id: &'static str,
    /// What it shows.
    pub title: String,
    /// How it is to be read.
    pub note: String,
    /// The heading of each column.
    pub head: Vec<String>,
    /// The cells. The first one of a row names it.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// The table for a terminal.
    pub fn text(&self) -> String {
        let lines: Vec<Vec<String>> =
            std::iter::once(self.head.clone()).chain(self.rows.iter().cloned()).collect();
        format!("{}\n{}\n\n{}", self.title, self.note, aligned(&lines))
    }
}

/// A mean square error, or another number without a fixed size.
pub fn number(value: f64) -> String {
    match value.abs() {
        size if !size.is_finite() => NONE.to_owned(),
        size if size < 100.0 => format!("{value:.4}"),
        size if size < 1e5 => format!("{value:.1}"),
        _ => format!("{value:.2e}"),
    }
}

/// Text that may stand in a document.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The command line of this run. The folders of this machine are nobody else's business, nor is what is kept
/// of the run.
pub fn command() -> String {
    let mut words = vec!["lampyris bench".to_owned()];
    let mut given = std::env::args().skip(1);
    while let Some(word) = given.next() {
        let is_kept = |option: &str| {
            word.strip_prefix(option).is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
        };
        if !["--record", "--note"].into_iter().any(is_kept) {
            words.push(word.rsplit('/').next().unwrap_or_default().to_owned());
        } else if !word.contains('=') {
            given.next();
        }
    }
    words.join(" ")
}

/// The document around a body; `style` is what its charts need beside the style of the page.
///
/// # Errors
/// Where the page's style is not in the binary.
pub fn document(title: &str, style: &str, body: &str) -> Result<String, Failure> {
    let part =
        |path: &str| page_part(path).ok_or_else(|| Failure::Error(format!("the page has no part `{path}`")));
    let styles = format!("{}\n{}\n{}\n{style}", part("style.css")?, part("parts.css")?, part("charts.css")?);
    // Only what is written here may style the page: nobody can know the number before the figures are there.
    let nonce = blake3::hash(body.as_bytes()).to_hex();
    let title = escaped(title);
    Ok(format!(
        r#"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'nonce-{nonce}'; img-src data:; base-uri 'none'; form-action 'none'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="referrer" content="no-referrer">
<title>{title} · Lampyris</title>
<link rel="icon" href="data:,">
<style nonce="{nonce}">{styles}</style>
</head>
<body>
<header><span class="brand"><span class="glow"></span>Lampyris</span></header>
<main>
<h1>{title}</h1>
<p class="quiet">Made {} UTC by Lampyris {} with</p>
<div class="command"><code>{}</code></div>
{body}
</main>
</body>
</html>
"#,
        Timestamp::now().strftime("%Y-%m-%d %H:%M"),
        env!("CARGO_PKG_VERSION"),
        escaped(&command()),
    ))
}

/// A table: the first column holds words, the others figures.
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let mut text = "<div class=\"scroll\"><table><thead><tr>".to_owned();
    // Writing to a text cannot fail, here and below.
    for (index, title) in head.iter().enumerate() {
        let _ =
            write!(text, "<th{}>{}</th>", if index == 0 { "" } else { " class=\"number\"" }, escaped(title));
    }
    text.push_str("</tr></thead><tbody>");
    for row in rows {
        text.push_str("<tr>");
        for (index, cell) in row.iter().enumerate() {
            let (tag, class) = if index == 0 { ("th", "") } else { ("td", " class=\"number\"") };
            let _ = write!(text, "<{tag}{class}>{}</{tag}>", escaped(cell));
        }
        text.push_str("</tr>");
    }
    text.push_str("</tbody></table></div>");
    text
}

/// A table that stands for itself.
pub fn section(table: &Table) -> String {
    format!(
        r#"<section id="{}"><h3>{}</h3><p class="note">{}</p>{}</section>"#,
        table.id,
        escaped(&table.title),
        escaped(&table.note),
        grid(&table.title, &table.head, &table.rows)
    )
}

/// Cells under their headings, in a frame that scrolls.
fn grid(caption: &str, head: &[String], rows: &[Vec<String>]) -> String {
    let mut text = format!(
        r#"<div class="scroll" tabindex="0" role="region" aria-label="{0}"><table><caption class="unseen">{0}</caption><thead><tr>"#,
        escaped(caption)
    );
    for name in head {
        let _ = write!(text, r#"<th scope="col">{}</th>"#, escaped(name));
    }
    text.push_str("</tr></thead><tbody>");
    for row in rows {
        text.push_str("<tr>");
        for (place, cell) in row.iter().enumerate() {
            let _ = match place {
                0 => write!(text, r#"<th scope="row">{}</th>"#, escaped(cell)),
                _ if cell.len() > 40 => write!(text, r#"<td class="words">{}</td>"#, escaped(cell)),
                _ => write!(text, "<td>{}</td>", escaped(cell)),
            };
        }
        text.push_str("</tr>");
    }
    text + "</tbody></table></div>"
}

/// A chart with its legend and the numbers behind it.
pub fn figure(caption: &str, legend: &str, chart: &str, head: &[String], rows: &[Vec<String>]) -> String {
    format!(
        r#"<figure class="frame"><figcaption><h3>{0}</h3></figcaption><div class="legend">{legend}</div>{chart}<details><summary>Numbers</summary>{1}</details></figure>"#,
        escaped(caption),
        grid(caption, head, rows)
    )
}

/// The names of lines by class.
pub fn line_legend(entries: &[(&str, &str)]) -> String {
    let entry = |(style, name): &(&str, &str)| {
        format!(
            r#"<span><svg class="sample" viewBox="0 0 26 12" aria-hidden="true"><path class="{style}" d="M0 6H26"/></svg>{}</span>"#,
            escaped(name)
        )
    };
    entries.iter().map(entry).collect()
}
