//! Charts as SVG text. Colours come from the style sheet by class, and every series has a line or a mark of
//! its own, so that none is told by colour alone.

use super::page::{escaped, number};
use std::fmt::Write;

/// A series over samples; a gap is no number.
pub struct Line<'a> {
    /// Its class.
    pub style: &'static str,
    /// Its values.
    pub values: Vec<Option<f64>>,
    /// What it is.
    pub name: &'a str,
}

/// What a line chart shows beside its lines.
pub struct Frame<'a> {
    /// The sentence for those who do not see it.
    pub label: &'a str,
    /// The first sample that was not fitted.
    pub unseen: usize,
    /// Samples of a day.
    pub per_day: usize,
    /// Width and height.
    pub size: (f64, f64),
}

/// Lines over days, the unseen part shaded. What leaves the measured range by far is cut at the edge of the
/// chart.
pub fn lines(frame: &Frame, lines: &[Line]) -> String {
    let (width, height) = frame.size;
    let (left, right, top, bottom) = (34.0, 6.0, 6.0, 20.0);
    let samples = lines.iter().map(|line| line.values.len()).max().unwrap_or(0).max(2);
    let measured =
        lines.first().map(|line| range(line.values.iter().flatten().copied())).unwrap_or((0.0, 1.0));
    let all = range(lines.iter().flat_map(|line| line.values.iter().flatten().copied()));
    // Ten units beyond what was measured tell enough of a run that leaves it.
    let (low, high) = (all.0.max(measured.0 - 10.0), all.1.min(measured.1 + 10.0));
    let step = nice((high - low) / 4.0);
    let (low, high) = ((low / step).floor() * step, (high / step).ceil() * step);
    let x = |sample: f64| left + sample / (samples - 1) as f64 * (width - left - right);
    let y = |value: f64| top + (high - value.clamp(low, high)) / (high - low) * (height - top - bottom);
    let mut svg = format!(
        r#"<svg class="chart" role="img" viewBox="0 0 {width} {height}" aria-label="{}">"#,
        escaped(frame.label)
    );
    let from = x(frame.unseen as f64);
    let _ = write!(
        svg,
        r#"<rect class="unseen-part" x="{from:.1}" y="{top}" width="{:.1}" height="{:.1}"/>"#,
        x((samples - 1) as f64) - from,
        height - top - bottom
    );
    let mut value = low;
    while value <= high + 0.01 * step {
        let _ = write!(
            svg,
            r#"<line class="grid-line" x1="{left}" x2="{:.1}" y1="{1:.1}" y2="{1:.1}"/>"#,
            width - right,
            y(value)
        );
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="end" x="{:.1}" y="{:.1}">{}</text>"#,
            left - 4.0,
            y(value) + 4.0,
            short(value)
        );
        value += step;
    }
    let days = samples.div_ceil(frame.per_day);
    for day in (0..=days).step_by(if width < 500.0 && days > 7 { 7 } else { 1 }) {
        let at = x((day * frame.per_day).min(samples - 1) as f64);
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="middle" x="{at:.1}" y="{:.1}">{day} d</text>"#,
            height - 5.0
        );
    }
    for line in lines {
        let _ = write!(
            svg,
            r#"<path class="{}" d="{}"><title>{}</title></path>"#,
            line.style,
            path(&line.values, &x, &y),
            escaped(line.name)
        );
    }
    svg.push_str("</svg>");
    svg
}

fn path(values: &[Option<f64>], x: &dyn Fn(f64) -> f64, y: &dyn Fn(f64) -> f64) -> String {
    let mut text = String::new();
    let mut is_down = false;
    for (sample, value) in values.iter().enumerate() {
        match value.filter(|value| value.is_finite()) {
            Some(value) => {
                let _ = write!(
                    text,
                    "{}{:.1} {:.1}",
                    if is_down { 'L' } else { 'M' },
                    x(sample as f64),
                    y(value)
                );
                is_down = true;
            }
            None => is_down = false,
        }
    }
    text
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low < high { (low, high) } else { (0.0, 1.0) }
}

/// 1, 2 or 5 times a power of ten, no less than asked for.
fn nice(step: f64) -> f64 {
    let power = 10f64.powf(step.max(1e-9).log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|factor| factor * power).find(|nice| *nice >= step).unwrap_or(step)
}

fn short(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Marks of one row on a logarithmic scale, one per series; a series without a value has none.
pub fn dots(label: &str, series: &[&str], rows: &[(String, Vec<Option<f64>>)]) -> String {
    let (width, left, right, top, pitch) = (760.0, 190.0, 14.0, 8.0, 22.0);
    let height = top + pitch * rows.len() as f64 + 24.0;
    let (low, high) = range(rows.iter().flat_map(|(_, values)| values.iter().flatten().copied()));
    let (low, high) = (low.max(1e-6).log10().floor(), high.max(1e-5).log10().ceil());
    let x =
        |value: f64| left + (value.max(1e-6).log10() - low) / (high - low).max(1.0) * (width - left - right);
    let mut svg = format!(
        r#"<svg class="chart dots" role="img" viewBox="0 0 {width} {height}" aria-label="{}">"#,
        escaped(label)
    );
    for decade in low as i32..=high as i32 {
        let value = 10f64.powi(decade);
        let _ = write!(
            svg,
            r#"<line class="grid-line" x1="{0:.1}" x2="{0:.1}" y1="{top}" y2="{1:.1}"/>"#,
            x(value),
            height - 22.0
        );
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="middle" x="{:.1}" y="{:.1}">{}</text>"#,
            x(value),
            height - 7.0,
            short(value)
        );
    }
    for (index, (name, values)) in rows.iter().enumerate() {
        let y = top + pitch * (index as f64 + 0.5);
        let _ = write!(
            svg,
            r#"<line class="grid-line" x1="{left}" x2="{:.1}" y1="{y:.1}" y2="{y:.1}"/>"#,
            width - right
        );
        let _ = write!(
            svg,
            r#"<text text-anchor="end" x="{:.1}" y="{:.1}">{}</text>"#,
            left - 8.0,
            y + 4.0,
            escaped(name)
        );
        for (place, value) in values.iter().enumerate().filter_map(|(place, value)| Some((place, (*value)?)))
        {
            let title = format!("{}, {}: {}", escaped(name), escaped(series[place]), number(value));
            let _ = write!(svg, "{}", mark(place, x(value), y, &title));
        }
    }
    svg.push_str("</svg>");
    svg
}

/// The mark of a series.
pub fn mark(place: usize, x: f64, y: f64, title: &str) -> String {
    let r = 5.0;
    let shape = match place % 5 {
        0 => format!("M{:.1} {y:.1}h{}M{x:.1} {:.1}v{}", x - r, 2.0 * r, y - r, 2.0 * r),
        1 => format!("M{:.1} {y:.1}a{r} {r} 0 1 0 {} 0a{r} {r} 0 1 0 -{} 0z", x - r, 2.0 * r, 2.0 * r),
        2 => format!(
            "M{:.1} {:.1}h{}v{}h-{}z",
            x - r + 1.0,
            y - r + 1.0,
            2.0 * r - 2.0,
            2.0 * r - 2.0,
            2.0 * r - 2.0
        ),
        3 => format!("M{x:.1} {:.1}l{r} {}h-{}z", y - r, 2.0 * r - 1.0, 2.0 * r),
        _ => format!("M{x:.1} {:.1}l{r} {r}l-{r} {r}l-{r} -{r}z", y - r),
    };
    format!(r#"<path class="mark-{}" d="{shape}"><title>{title}</title></path>"#, place % 5)
}

/// A matrix of correlations, darker for stronger ones.
pub fn heat(label: &str, names: &[String], cells: &[Vec<Option<f64>>]) -> String {
    let (left, pitch) = (36.0, 26.0);
    let size = left + pitch * names.len() as f64;
    let mut svg = format!(
        r#"<svg class="chart matrix" role="img" viewBox="0 0 {size} {size}" aria-label="{}">"#,
        escaped(label)
    );
    for (index, name) in names.iter().enumerate() {
        let at = left + pitch * (index as f64 + 0.5);
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="end" x="{:.1}" y="{:.1}">{}</text>"#,
            left - 5.0,
            at + 4.0,
            escaped(name)
        );
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="middle" x="{at:.1}" y="{:.1}">{}</text>"#,
            left - 8.0,
            escaped(name)
        );
        for (other, value) in cells[index].iter().enumerate() {
            let Some(value) = value else { continue };
            let (x, y) = (left + pitch * other as f64, left + pitch * index as f64);
            let (class, strength) = (if *value < 0.0 { "negative" } else { "positive" }, value.abs());
            let _ = write!(
                svg,
                r#"<rect class="{class}" fill-opacity="{strength:.2}" x="{x:.1}" y="{y:.1}" width="{0}" height="{0}"><title>{1} and {2}: {value:.2}</title></rect>"#,
                pitch - 1.0,
                escaped(name),
                escaped(&names[other])
            );
        }
    }
    svg.push_str("</svg>");
    svg
}

/// How sure a wall is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edge {
    /// Proposed, and there.
    Right,
    /// Proposed, and not there.
    Extra,
    /// There, and not proposed.
    Missed,
}

/// The rooms on a circle, and what is proposed and true between them.
pub fn graph(label: &str, names: &[String], edges: &[(usize, usize, Edge)]) -> String {
    let (size, radius) = (420.0, 170.0);
    let at = |index: usize| {
        let angle =
            std::f64::consts::TAU * index as f64 / names.len().max(1) as f64 - std::f64::consts::FRAC_PI_2;
        (0.5 * size + radius * angle.cos(), 0.5 * size + radius * angle.sin())
    };
    let mut svg = format!(
        r#"<svg class="chart matrix" role="img" viewBox="0 0 {size} {size}" aria-label="{}">"#,
        escaped(label)
    );
    for (a, b, edge) in edges {
        let ((x1, y1), (x2, y2)) = (at(*a), at(*b));
        let (class, word) = match edge {
            Edge::Right => ("edge-right", "proposed, and a wall"),
            Edge::Extra => ("edge-extra", "proposed without a wall"),
            Edge::Missed => ("edge-missed", "a wall that is not proposed"),
        };
        let title = format!("{} and {}: {word}", escaped(&names[*a]), escaped(&names[*b]));
        let _ = write!(
            svg,
            r#"<line class="{class}" x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}"><title>{title}</title></line>"#
        );
    }
    for (index, name) in names.iter().enumerate() {
        let (x, y) = at(index);
        let _ = write!(
            svg,
            r#"<circle class="node" cx="{x:.1}" cy="{y:.1}" r="15"/><text text-anchor="middle" x="{x:.1}" y="{:.1}">{}</text>"#,
            y + 4.0,
            escaped(name)
        );
    }
    svg.push_str("</svg>");
    svg
}
