//! The page of chapter 6: Table 6.8 and Figures 6.2 and 6.3 for our plants, and what else was measured.

use super::super::charts::{Frame, Line, lines};
use super::super::page::{self, Table, escaped, figure, line_legend, section};
use super::super::row::Row;
use super::case::Fitted;
use super::thesis;
use lampyris::cli::Failure;
use lampyris_core::data::{DAY, HOUR, rfc3339};

/// Samples between the points of a chart of all days.
const EVERY: usize = 3;

/// The document.
///
/// # Errors
/// Where the page's style is not in the binary.
pub fn document(
    plants: &[(Table, Fitted, Fitted)],
    listed: &[Table],
    rows: &[Row],
) -> Result<String, Failure> {
    page::document("The treatment plants of chapter 6", page::STYLE, &body(plants, listed, rows))
}

fn body(plants: &[(Table, Fitted, Fitted)], listed: &[Table], rows: &[Row]) -> String {
    let mut body = "<p>Twins of treatment plants with a known truth: an anoxic and an aerobic tank, a \
        settler, recycles, ASM1. Three days of the effluent are fitted, the eleven days after are unseen. \
        The thesis gives neither the volumes nor the influent of its plant; plant L has the truth of its \
        Table 6.6, plant H is a healthy one.</p>"
        .to_owned();
    for (table, clean, noisy) in plants {
        body += &format!("<h2>Plant {}</h2>", escaped(clean.case.id));
        body += &section(table);
        let ridges = noisy.fit.remarks.iter().filter(|remark| remark.contains("correlation"));
        body += &format!(
            "<ul>{}</ul>",
            ridges.map(|remark| format!("<li>{}</li>", escaped(remark))).collect::<String>()
        );
        body += &figures(clean, noisy);
    }
    body.extend(listed.iter().map(section));
    let cells: Vec<Vec<String>> =
        rows.iter().map(|row| vec![row.what.clone(), row.number(), row.unit.to_string()]).collect();
    body + "<h2>All figures</h2>" + &page::table(&["what", "value", "unit"], &cells)
}

/// Measured and simulated effluents: the days that were fitted, and all of them.
fn figures(clean: &Fitted, noisy: &Fitted) -> String {
    let problem = &noisy.problem;
    let mut ways = vec![
        ("model", "estimate", problem.simulate(&noisy.fit.theta())),
        ("previous", "start of the search", problem.simulate(problem.nominal())),
    ];
    if let Some(published) = thesis::published(&clean.case) {
        ways.push(("heldout", "the thesis's estimate", problem.simulate(&published)));
    }
    let train = problem.split().train.end;
    let mut text = String::new();
    for (number, until, every, what) in [
        ("6.2", train, 1, "the three days that were fitted"),
        ("6.3", problem.grid().len(), EVERY, "and the eleven unseen days, shaded"),
    ] {
        let charts = problem.model().outputs().iter().enumerate().map(|(output, about)| {
            let samples: Vec<usize> = problem.usable(output, 0..until).into_iter().step_by(every).collect();
            let series = |values: &[f64]| samples.iter().map(|k| Some(values[*k])).collect::<Vec<_>>();
            // The start of the search is far off; beside all days it would hide the rest.
            let shown = ways.iter().filter(|(style, ..)| every == 1 || *style != "previous");
            let mut all = vec![Line {
                style: "measured",
                values: series(problem.measured()[output].0),
                name: "measured",
            }];
            all.extend(shown.map(|(style, name, run)| Line {
                style,
                values: series(&run.outputs[output]),
                name,
            }));
            let caption = format!("Figure {number}: {}, {}", about.channel, about.unit);
            let step = problem.grid().step() * (samples[1] - samples[0]) as i64;
            let unseen = samples.iter().position(|k| *k >= train).unwrap_or(samples.len() - 1);
            let frame =
                Frame { label: &caption, unseen, per_day: (DAY / step) as usize, size: (440.0, 220.0) };
            let entries: Vec<(&str, &str)> = all.iter().map(|line| (line.style, line.name)).collect();
            let head: Vec<String> =
                std::iter::once("time").chain(all.iter().map(|line| line.name)).map(str::to_owned).collect();
            let row = |(place, k): (usize, &usize)| {
                let cells = all
                    .iter()
                    .map(|line| line.values[place].map_or_else(String::new, |value| format!("{value:.3}")));
                std::iter::once(rfc3339(problem.grid().time(*k))).chain(cells).collect::<Vec<_>>()
            };
            // An hour apart is enough to read.
            let rows: Vec<Vec<String>> =
                samples.iter().enumerate().step_by((HOUR / step).max(1) as usize).map(row).collect();
            figure(&caption, &line_legend(&entries), &lines(&frame, &all), &head, &rows)
        });
        text += &format!(
            r#"<h3>Figure {number}: measured with 2 % of noise, and simulated; {what}</h3><div class="grid">{}</div>"#,
            charts.collect::<String>()
        );
    }
    text
}
