//! The page: how fast each method comes down to the best known fit, and the table.

use super::super::page::{self, escaped, table};
use super::super::quantile::quantile;
use super::methods::{COSTS, DEFAULT, MULTISTART};
use super::rooms::{BUDGET, HEAD, Outcome, Rooms, Run};
use lampyris::cli::Failure;
use std::fmt::Write;

/// The first place of a curve, in evaluations.
const FIRST: f64 = 40.0;
/// Places of a curve, even in the logarithm of the evaluations.
const PLACES: usize = 120;
/// What a cost may be above the best known before a curve leaves the plot.
const LEAST: f64 = 1e-4;
const MOST: f64 = 1e3;

/// What the first plot shows, each with a colour and a dash of its own.
const DRAWN: [(&str, &str); 6] = [
    (DEFAULT, "default"),
    (MULTISTART, "multistart"),
    (COSTS, "costs"),
    ("cfa_thesis", "thesis"),
    ("lshade", "rival"),
    ("pso", "swarm"),
];

const STYLE: &str = "
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(19rem, 1fr)); gap: 1rem; }
svg.chart path.curve, svg.sample path { fill: none; stroke-width: 2; stroke-linejoin: round; stroke: \
    var(--model); }
path.band { fill: var(--model); fill-opacity: .2; stroke: none; }
svg.chart path.default, svg.sample path.default { stroke: var(--ok); stroke-width: 3; }
svg.chart path.multistart, svg.sample path.multistart { stroke: var(--measured); stroke-dasharray: 4 2; }
svg.chart path.costs, svg.sample path.costs { stroke: var(--model); stroke-dasharray: 8 3 2 3; }
svg.chart path.thesis, svg.sample path.thesis { stroke: var(--model); }
svg.chart path.rival, svg.sample path.rival { stroke: var(--heldout); stroke-dasharray: 8 3; }
svg.chart path.swarm, svg.sample path.swarm { stroke: var(--previous); stroke-dasharray: 2 3; }
svg.chart path.beside { stroke: var(--ok); stroke-width: 1.5; stroke-dasharray: 5 4; }
svg.chart line.target { stroke: var(--bad); stroke-dasharray: 2 3; }
svg.sample { width: 34px; height: 12px; vertical-align: middle; margin-right: .35rem; }
ul.legend { list-style: none; padding: 0; display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; }
details { margin: .4rem 0; }
summary { cursor: pointer; color: var(--link); min-height: 24px; }
td, th { white-space: nowrap; font-variant-numeric: tabular-nums; }
";

/// The document.
///
/// # Errors
/// Where the page's style is not in the binary.
pub fn document(rooms: &Rooms) -> Result<String, Failure> {
    let mut body = format!(
        "<p>{} synthetic rooms with four neighbours and 15 parameters, from seed {} on; one to five searches \
        of each method per room, at most {BUDGET} simulations each, one week fitted. The best known fit of a \
        room is the best of everything here and of 64 runs of least squares. A search has come there when \
        its mean square error is within 1 % of it.</p>",
        rooms.known.len(),
        rooms.first,
    );
    body += "<h2>Coming down to the best known fit</h2>";
    body += "<ul class=\"legend\">";
    for (name, class) in DRAWN {
        let _ = write!(
            body,
            r#"<li><svg class="sample" viewBox="0 0 34 12" aria-hidden="true"><path class="{class}" d="M1 6H33"/></svg>{name}</li>"#
        );
    }
    let all: Vec<(Curves, &str)> =
        DRAWN.iter().filter_map(|(name, class)| Some((curves(rooms, find(rooms, name)?), *class))).collect();
    let drawn: Vec<(&[f64], &str)> =
        all.iter().map(|(curves, class)| (curves[1].as_slice(), *class)).collect();
    let label = "Median over rooms and seeds of the best cost so far, as a share above the best known, \
        against simulations";
    let _ = write!(
        body,
        "</ul><figure class=\"frame\"><figcaption>{label}; the dotted line is 1 \
        %</figcaption>{}<details><summary>The medians in numbers</summary>{}</details></figure>",
        plot((1000.0, 380.0), label, None, &drawn),
        numbers(&all),
    );
    body += "<h2>The table</h2><p>Medians over rooms and seeds, with the quartiles in brackets. The last but \
        one is the free-run error in the week that no search saw, over that of the best known fit.</p>";
    body += &table(
        &HEAD,
        &rooms.outcomes.iter().map(|outcome| rooms.figures(outcome).cells()).collect::<Vec<_>>(),
    );
    body += "<ul>";
    for outcome in &rooms.outcomes {
        let _ =
            write!(body, "<li><b>{}</b>: {}</li>", escaped(outcome.entry.name), escaped(outcome.entry.note));
    }
    body += "</ul><h2>Each method</h2><p>The median with the band between the quartiles; the dashed line is \
        the default's median.</p><div class=\"plots\">";
    let beside = find(rooms, DEFAULT).map(|outcome| curves(rooms, outcome));
    for outcome in &rooms.outcomes {
        let name = escaped(outcome.entry.name);
        let own = curves(rooms, outcome);
        let mut lines: Vec<(&[f64], &str)> = vec![(own[1].as_slice(), "")];
        if let Some(beside) = beside.as_ref().filter(|_| outcome.entry.name != DEFAULT) {
            lines.push((beside[1].as_slice(), "beside"));
        }
        let label = format!("{name}: share above the best known against simulations, median and quartiles");
        let _ = write!(
            body,
            "<figure class=\"frame\"><figcaption>{name}</figcaption>{}</figure>",
            plot((300.0, 200.0), &label, Some([&own[0], &own[2]]), &lines)
        );
    }
    body += "</div>";
    page::document("The default search beside its rivals on rooms", STYLE, &body)
}

/// Quartiles over the runs at each place, as shares above the best known cost.
type Curves = [Vec<f64>; 3];

fn find<'a>(rooms: &'a Rooms, name: &str) -> Option<&'a Outcome> {
    rooms.outcomes.iter().find(|outcome| outcome.entry.name == name)
}

/// The evaluations at a place.
fn evaluations(place: usize) -> f64 {
    FIRST * (BUDGET as f64 / FIRST).powf(place as f64 / (PLACES - 1) as f64)
}

fn curves(rooms: &Rooms, outcome: &Outcome) -> Curves {
    let mut curves = [const { Vec::new() }; 3];
    for place in 0..PLACES {
        let above =
            |run: &Run| run.path.after(evaluations(place).round() as usize) / rooms.known(run).cost - 1.0;
        let mut values: Vec<f64> = outcome.runs.iter().map(above).collect();
        values.sort_by(f64::total_cmp);
        for (curve, share) in curves.iter_mut().zip([0.25, 0.5, 0.75]) {
            curve.push(quantile(&values, share));
        }
    }
    curves
}

/// Lines, and the band between two of them, over the logarithm of the evaluations.
fn plot(
    (width, height): (f64, f64),
    label: &str,
    band: Option<[&[f64]; 2]>,
    lines: &[(&[f64], &str)],
) -> String {
    let (left, bottom, top, right) = (58.0, 34.0, 8.0, 14.0);
    let x = |count: f64| {
        left + (count / FIRST).log10() / (BUDGET as f64 / FIRST).log10() * (width - left - right)
    };
    let y = |above: f64| {
        top + (MOST / above.clamp(LEAST, MOST)).log10() / (MOST / LEAST).log10() * (height - top - bottom)
    };
    let mut svg =
        format!(r#"<svg class="chart" role="img" viewBox="0 0 {width} {height}" aria-label="{label}">"#);
    for (share, text) in [(1e-4, "0.01 %"), (1e-2, "1 %"), (1.0, "100 %"), (100.0, "100 x")] {
        let (at, class) = (y(share), if text == "1 %" { "target" } else { "grid-line" });
        let _ = write!(
            svg,
            r#"<line class="{class}" x1="{left}" x2="{:.1}" y1="{at:.1}" y2="{at:.1}"/>"#,
            width - right
        );
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="end" x="{:.1}" y="{:.1}">{text}</text>"#,
            left - 4.0,
            at + 4.0
        );
    }
    for count in [50, 200, 1000, 5000, BUDGET] {
        let at = x(count as f64);
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="middle" x="{at:.1}" y="{:.1}">{count}</text>"#,
            height - 16.0
        );
    }
    let _ = write!(
        svg,
        r#"<text class="quiet" text-anchor="middle" x="{:.1}" y="{:.1}">simulations</text>"#,
        (left + width) / 2.0,
        height - 2.0
    );
    let points = |curve: &[f64]| -> Vec<String> {
        curve
            .iter()
            .enumerate()
            .map(|(place, above)| format!("{:.1} {:.1}", x(evaluations(place)), y(*above)))
            .collect()
    };
    if let Some([low, high]) = band {
        let mut outline = points(low);
        outline.extend(points(high).into_iter().rev());
        let _ = write!(svg, r#"<path class="band" d="M{}Z"/>"#, outline.join("L"));
    }
    for (curve, class) in lines {
        let _ = write!(svg, r#"<path class="curve {class}" d="M{}"/>"#, points(curve).join("L"));
    }
    svg + "</svg>"
}

fn numbers(all: &[(Curves, &str)]) -> String {
    let mut head = vec!["simulations"];
    let named = |class: &str| DRAWN.iter().find(|(_, known)| *known == class).map_or("", |(name, _)| name);
    head.extend(all.iter().map(|(_, class)| named(class)));
    let percent =
        |above: f64| if above.is_finite() { format!("{:.2} %", 100.0 * above) } else { "-".to_owned() };
    let rows: Vec<Vec<String>> = (0..PLACES)
        .step_by(PLACES / 12)
        .chain([PLACES - 1])
        .map(|place| {
            let medians = all.iter().map(|(curves, _)| percent(curves[1][place]));
            std::iter::once(format!("{:.0}", evaluations(place))).chain(medians).collect()
        })
        .collect();
    table(&head, &rows)
}
