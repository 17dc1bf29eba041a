//! The results as one HTML file: the table, the sentences, and charts that are drawn here, so that nothing
//! needs a script.

use super::super::page::{self, escaped};
use super::answer::{Answer, Spread, basis, span};
use super::arm::{Kind, Measures};
use super::outcome::{Measured, Outcome};
use lampyris::cli::Failure;
use std::fmt::Write;
use std::path::Path;

/// A colour of the page for each arm; perfect knowledge is dashed.
const STYLE: &str = "
.arm { fill: none; stroke-width: 2; }
.swatch { display: inline-block; width: 1.4em; height: 0.55em; margin-right: 0.4em; border-radius: 2px; }
.nominal { stroke: var(--quiet); } .swatch.nominal, .dot.nominal { fill: var(--quiet); background: \
    var(--quiet); }
.once { stroke: var(--previous); } .swatch.once, .dot.once { fill: var(--previous); background: \
    var(--previous); }
.weekly { stroke: var(--heldout); } .swatch.weekly, .dot.weekly { fill: var(--heldout); background: \
    var(--heldout); }
.nightly { stroke: var(--model); } .swatch.nightly, .dot.nightly { fill: var(--model); background: \
    var(--model); }
.found { stroke: var(--ok); } .swatch.found, .dot.found { fill: var(--ok); background: var(--ok); }
.perfect { stroke: var(--measured); stroke-dasharray: 5 4; } .swatch.perfect, .dot.perfect { fill: \
    var(--measured); background: var(--measured); }
.dot { stroke: none; }
.event { stroke: var(--bad); stroke-dasharray: 2 3; }
svg.chart .right { text-anchor: end; }
svg.chart .middle { text-anchor: middle; }
.grid svg.chart text { font-size: 17px; }
";
const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 52.0;
const RIGHT: f64 = 10.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 40.0;

/// Writes the page.
///
/// # Errors
/// Where the file cannot be written.
pub fn write(file: &Path, measured: &Measured, answer: &Answer) -> Result<(), Failure> {
    std::fs::write(file, document(measured, answer)?)
        .map_err(|error| Failure::Error(format!("{}: {error}", file.display())))?;
    eprintln!("page: {}", file.display());
    Ok(())
}

fn document(measured: &Measured, answer: &Answer) -> Result<String, Failure> {
    let paragraphs =
        |lines: &[String]| lines.iter().map(|line| format!("<p>{}</p>\n", escaped(line))).collect::<String>();
    let late = measured.plan.leaks_from() as f64 / 7.0;
    let weekly = |of: &dyn Fn(&Measures) -> f64| weeks(measured, of);
    let body = format!(
        "{}<h2>The arms</h2>\n{}{}<div \
         class=\"grid\">{}{}</div><h2>What was run</h2>\n{}",
        paragraphs(&answer.sentences),
        table(answer),
        totals(answer),
        lines("The room a day ahead, week by week", "K rms", &weekly(&Measures::rmse), late),
        lines(
            "Bill and discomfort beside perfect knowledge",
            "EUR a week",
            &beside(weekly(&Measures::total)),
            late
        ),
        paragraphs(&basis(measured)),
    );
    page::document("What fresh parameters are worth to a controller", STYLE, &body)
}

fn table(answer: &Answer) -> String {
    let head = [
        "bill, EUR",
        "discomfort, K h",
        "worth in all, EUR",
        "a day ahead, K",
        "2nd half, EUR",
        "2nd half, K",
        "beside perfect, EUR",
    ];
    let rows = answer.lines.iter().map(|line| {
        let cells = [
            format!("{:.2}", line.bill.mean),
            format!("{:.1}", line.discomfort.mean),
            span(&line.total, 1),
            format!("{:.3}", line.rmse.mean),
            format!("{:.2}", line.late_total.mean),
            format!("{:.3}", line.late_rmse.mean),
            line.beside_perfect.map_or_else(String::new, |spread| span(&spread, 2)),
        ];
        (line.kind.title().to_owned(), cells.to_vec())
    });
    format!(
        "<figure class=\"frame\"><div class=\"scroll\">{}</div><p class=\"note\">Means over the houses, with \
        the smallest and the largest.</p></figure>\n",
        cells("parameters", &head, rows)
    )
}

fn cells(first: &str, head: &[impl AsRef<str>], rows: impl Iterator<Item = (String, Vec<String>)>) -> String {
    let mut text = format!("<table><thead><tr><th>{first}</th>");
    head.iter().for_each(|title| {
        let _ = write!(text, "<th class=\"number\">{}</th>", escaped(title.as_ref()));
    });
    text.push_str("</tr></thead><tbody>");
    for (title, values) in rows {
        let _ = write!(text, "<tr><th>{}</th>", escaped(&title));
        values.iter().for_each(|value| {
            let _ = write!(text, "<td class=\"number\">{value}</td>");
        });
        text.push_str("</tr>");
    }
    text + "</tbody></table>"
}

/// A chart with its title and, behind it, its numbers.
fn framed(title: &str, more: &str, chart: &str, numbers: &str) -> String {
    format!(
        "<figure class=\"frame\"><figcaption><h3>{title}</h3>{more}</figcaption>{chart}<details \
        class=\"numbers\"><summary>The numbers</summary><div \
        class=\"scroll\">{numbers}</div></details></figure>\n"
    )
}

/// What every arm cost in all, as its mean and the span of the houses.
fn totals(answer: &Answer) -> String {
    let (row, left) = (30.0, 150.0);
    let height = TOP + row * answer.lines.len() as f64 + BOTTOM;
    let most = answer.lines.iter().map(|line| line.total.high).fold(0.0, f64::max);
    let ticks = Ticks::over(0.0, most);
    let x = |value: f64| left + (WIDTH - left - RIGHT) * (value - ticks.low) / (ticks.high - ticks.low);
    let mut chart = opened(height, "bill and discomfort in EUR by arm");
    for tick in ticks.all() {
        let at = x(tick);
        let _ = write!(
            chart,
            r#"<line class="grid-line" x1="{at:.1}" x2="{at:.1}" y1="{TOP}" y2="{bottom:.1}"/><text class="quiet middle" x="{at:.1}" y="{label:.1}">{}</text>"#,
            ticks.label(tick),
            bottom = height - BOTTOM,
            label = height - BOTTOM + 16.0
        );
    }
    for (index, line) in answer.lines.iter().enumerate() {
        let y = TOP + row * (index as f64 + 0.5);
        let Spread { mean, low, high } = line.total;
        let _ = write!(
            chart,
            r#"<text class="right" x="{at:.1}" y="{text:.1}">{title}</text><line class="arm {id}" x1="{from:.1}" x2="{to:.1}" y1="{y:.1}" y2="{y:.1}"/><circle class="dot {id}" cx="{dot:.1}" cy="{y:.1}" r="5"/><text class="middle" x="{dot:.1}" y="{above:.1}">{mean:.1}</text>"#,
            at = left - 10.0,
            text = y + 4.0,
            title = line.kind.title(),
            id = line.kind.id(),
            from = x(low),
            to = x(high),
            dot = x(mean),
            above = y - 8.0
        );
    }
    chart.push_str("</svg>");
    let rows = answer.lines.iter().map(|line| {
        let Spread { mean, low, high } = line.total;
        (line.kind.title().to_owned(), [mean, low, high].map(|value| format!("{value:.2}")).to_vec())
    });
    let numbers = cells("parameters", &["mean, EUR", "smallest", "largest"], rows);
    framed("Bill and discomfort in all, EUR: mean and span of the houses", "", &chart, &numbers)
}

/// The mean over the houses of every arm in every week.
fn weeks(measured: &Measured, of: &dyn Fn(&Measures) -> f64) -> Vec<(Kind, Vec<f64>)> {
    let mean = |kind: &Kind, week: usize| {
        let arms: Vec<&Outcome> =
            measured.houses.iter().flatten().filter(|outcome| outcome.kind == *kind).collect();
        arms.iter().map(|outcome| of(&Measures::sum(&outcome.days[7 * week..7 * week + 7]))).sum::<f64>()
            / arms.len().max(1) as f64
    };
    measured
        .plan
        .arms
        .iter()
        .map(|kind| (*kind, (0..measured.plan.weeks).map(|week| mean(kind, week)).collect()))
        .collect()
}

/// The same less what perfect knowledge came to, where it took part.
fn beside(series: Vec<(Kind, Vec<f64>)>) -> Vec<(Kind, Vec<f64>)> {
    let Some((_, perfect)) = series.iter().find(|(kind, _)| *kind == Kind::Perfect).cloned() else {
        return series;
    };
    let less =
        |values: Vec<f64>| values.iter().zip(&perfect).map(|(value, perfect)| value - perfect).collect();
    series.into_iter().map(|(kind, values)| (kind, less(values))).collect()
}

/// A line per arm over the weeks; the moment at which the wind comes is marked. The nominal values lie so far
/// off that they are among the numbers alone.
fn lines(title: &str, unit: &str, series: &[(Kind, Vec<f64>)], event: f64) -> String {
    let weeks = series.iter().map(|(_, values)| values.len()).max().unwrap_or(1);
    let drawn = || series.iter().filter(|(kind, _)| *kind != Kind::Nominal);
    let (least, most) = drawn()
        .flat_map(|(_, values)| values)
        .fold((0.0f64, 0.0f64), |(least, most), value| (least.min(*value), most.max(*value)));
    let ticks = Ticks::over(least, most);
    let x = |week: f64| LEFT + (WIDTH - LEFT - RIGHT) * week / weeks as f64;
    let y = |value: f64| {
        HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (value - ticks.low) / (ticks.high - ticks.low)
    };
    let mut chart = opened(HEIGHT, &format!("{title}, {unit}"));
    for tick in ticks.all() {
        let _ = write!(
            chart,
            r#"<line class="grid-line" x1="{LEFT}" x2="{end}" y1="{at:.1}" y2="{at:.1}"/><text class="quiet right" x="{label}" y="{text:.1}">{}</text>"#,
            ticks.label(tick),
            end = WIDTH - RIGHT,
            at = y(tick),
            label = LEFT - 6.0,
            text = y(tick) + 4.0
        );
    }
    for week in 0..weeks {
        let _ = write!(
            chart,
            r#"<text class="quiet middle" x="{:.1}" y="{:.1}">week {}</text>"#,
            x(week as f64 + 0.5),
            HEIGHT - BOTTOM + 22.0,
            week + 1
        );
    }
    let _ = write!(
        chart,
        r#"<line class="event" x1="{at:.1}" x2="{at:.1}" y1="{TOP}" y2="{bottom}"/><text class="haloed" x="{text:.1}" y="{top}">from here on the wind blows in</text>"#,
        at = x(event),
        bottom = HEIGHT - BOTTOM,
        text = x(event) + 5.0,
        top = TOP + 10.0
    );
    for (kind, values) in drawn() {
        let points: Vec<String> = values
            .iter()
            .enumerate()
            .map(|(week, value)| format!("{:.1},{:.1}", x(week as f64 + 0.5), y(*value)))
            .collect();
        let _ = write!(chart, r#"<polyline class="arm {}" points="{}"/>"#, kind.id(), points.join(" "));
    }
    chart.push_str("</svg>");
    let legend: String = drawn()
        .map(|(kind, _)| {
            format!(
                "<span class=\"nowrap\"><span class=\"swatch {}\"></span>{}</span> ",
                kind.id(),
                kind.title()
            )
        })
        .collect();
    let head: Vec<String> = (1..=weeks).map(|week| format!("week {week}")).collect();
    let rows = series.iter().map(|(kind, values)| {
        (kind.title().to_owned(), values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>())
    });
    let numbers = cells("parameters", &head, rows);
    let note = "<p class=\"note\">Means of the houses. The nominal values lie off the chart, and are among \
        the numbers.</p>";
    framed(
        &format!("{title}, {unit}"),
        &format!("<span>{legend}</span>"),
        &format!("{chart}{note}"),
        &numbers,
    )
}

fn opened(height: f64, label: &str) -> String {
    format!(
        r#"<svg class="chart" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{}">"#,
        escaped(label)
    )
}

/// Round numbers along an axis.
struct Ticks {
    low: f64,
    high: f64,
    step: f64,
}

impl Ticks {
    fn over(low: f64, high: f64) -> Self {
        let wide = (high - low).max(1e-9);
        let decade = 10f64.powf((wide / 4.0).log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .map(|part| part * decade)
            .into_iter()
            .find(|step| wide / step <= 6.0)
            .unwrap_or(decade);
        Self { low: step * (low / step).floor(), high: step * (high / step).ceil(), step }
    }

    fn all(&self) -> impl Iterator<Item = f64> {
        let (low, step) = (self.low, self.step);
        (0..=((self.high - low) / step).round() as usize).map(move |tick| low + step * tick as f64)
    }

    fn label(&self, value: f64) -> String {
        let digits = (-self.step.log10().floor()).max(0.0) as usize;
        format!("{value:.digits$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_hold_everything() {
        for (high, step) in [(0.9, 0.2), (37.0, 10.0), (120.0, 20.0), (4.9, 1.0)] {
            let ticks = Ticks::over(0.0, high);
            assert!((ticks.step - step).abs() < 1e-9, "{high}: {}", ticks.step);
            assert!(ticks.high >= high && ticks.all().count() <= 8);
        }
        assert_eq!(Ticks::over(0.0, 0.9).label(0.4), "0.4");
    }
}
