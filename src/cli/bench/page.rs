//! One HTML file without scripts, in the style of the service's own page: the frame of every benchmark's page.

use super::super::Failure;
use jiff::Timestamp;
use lampyris::http::page_part;
use std::fmt::Write;

/// Text that may stand in a document.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The document around a body; `style` is what its charts need beside the style of the page.
///
/// # Errors
/// Where the page's style is not in the binary.
pub fn document(title: &str, style: &str, body: &str) -> Result<String, Failure> {
    let part = |path: &str| page_part(path).ok_or_else(|| Failure::Error(format!("the page has no part `{path}`")));
    let styles = format!("{}\n{}\n{style}", part("style.css")?, part("parts.css")?);
    // The folders of this machine are nobody else's business.
    let command: Vec<String> = std::env::args().skip(1).map(|word| word.rsplit('/').next().unwrap_or_default().to_owned()).collect();
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
<div class="command"><code>lampyris {}</code></div>
{body}
</main>
</body>
</html>
"#,
        Timestamp::now().strftime("%Y-%m-%d %H:%M"),
        env!("CARGO_PKG_VERSION"),
        escaped(&command.join(" ")),
    ))
}

/// A table: the first column holds words, the others figures.
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let mut text = "<div class=\"scroll\"><table><thead><tr>".to_owned();
    // Writing to a text cannot fail, here and below.
    for (index, title) in head.iter().enumerate() {
        let _ = write!(text, "<th{}>{}</th>", if index == 0 { "" } else { " class=\"number\"" }, escaped(title));
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
