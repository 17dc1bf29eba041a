//! The page: the convergence plots of Figure 5.3, the swarm of Figure 4.2, and the tables behind them.

use super::super::page::{self, escaped, table};
use super::figures::Claim;
use super::methods::{CASES, Case, DEFAULT, GRID, LSHADE, MODIFIED, ORIGINAL, THESIS};
use super::outcome::{HEAD, Outcome, PLACES, cells};
use lampyris::cli::Failure;
use lampyris_core::optimise::clustered::{Seen, watch};
use lampyris_core::optimise::functions::Function;
use lampyris_core::optimise::thesis_options::CfaThesisOptions;
use lampyris_core::optimise::{Crowd, Search};
use std::fmt::Write;

/// What is drawn, each with a colour and a dash of its own.
const DRAWN: [(&str, &str); 6] = [
    (ORIGINAL, "original"),
    (MODIFIED, "modified"),
    (THESIS, "thesis"),
    (GRID, "zoom"),
    (DEFAULT, "default"),
    (LSHADE, "rival"),
];
/// Added before the logarithm (eq 5.2).
const LEAST: f64 = 1e-8;
/// Generations of which the swarm is shown.
const SHOWN: [usize; 6] = [0, 5, 10, 15, 20, 30];

const STYLE: &str = "
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr)); gap: 1rem; }
.plots.small { grid-template-columns: repeat(auto-fit, minmax(14rem, 1fr)); }
svg.chart path.curve, svg.sample path { fill: none; stroke-width: 2; stroke-linejoin: round; }
path.original { stroke: var(--quiet); stroke-dasharray: 2 3; }
path.modified { stroke: var(--previous); stroke-dasharray: 8 3; }
path.thesis { stroke: var(--model); }
path.zoom { stroke: var(--heldout); stroke-dasharray: 8 3 2 3; }
path.default { stroke: var(--ok); stroke-width: 3; }
path.rival { stroke: var(--measured); stroke-dasharray: 4 2; }
svg.sample { width: 34px; height: 12px; vertical-align: middle; margin-right: .35rem; }
ul.legend { list-style: none; padding: 0; display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; }
.c0 { fill: var(--model); } .c1 { fill: var(--heldout); } .c2 { fill: var(--ok); } .c3 { fill: \
    var(--previous); } .c4 { fill: var(--measured); }
.c5 { fill: none; stroke: var(--model); stroke-width: 2; } .c6 { fill: none; stroke: var(--heldout); \
    stroke-width: 2; }
.c7 { fill: none; stroke: var(--ok); stroke-width: 2; } .c8 { fill: none; stroke: var(--previous); \
    stroke-width: 2; } .c9 { fill: none; stroke: var(--measured); stroke-width: 2; }
.star { fill: none; stroke: var(--bad); stroke-width: 2.5; }
.optimum { stroke: var(--quiet); }
details { margin: .4rem 0; }
summary { cursor: pointer; color: var(--link); min-height: 24px; }
td, th { white-space: nowrap; font-variant-numeric: tabular-nums; }
";

/// The document.
///
/// # Errors
/// Where the page's style is not in the binary.
pub fn document(seed: u64, outcomes: &[Outcome], claims: &[Claim]) -> Result<String, Failure> {
    let seeds = outcomes.iter().map(|outcome| outcome.runs.len()).max().unwrap_or(0);
    let mut body = format!(
        "<p>Three functions in two sizes at the thesis's budgets, {seeds} seeds from {seed} on. The error is \
        what a function is above its optimum. Curves are means over the seeds of the logarithm of the best \
        error so far (eq 5.1 and 5.2, with 1e-8 added); lower is better.</p>"
    );
    body += &legend();
    body += "<div class=\"plots\">";
    for case in &CASES {
        let _ = write!(
            body,
            "<figure class=\"frame\"><figcaption>{}</figcaption>{}</figure>",
            escaped(&case.title()),
            plot(case, outcomes)
        );
    }
    body += "</div><h2>What section 5.4 says</h2>";
    let rows: Vec<Vec<String>> = claims
        .iter()
        .map(|claim| vec![claim.text.clone(), if claim.holds { "holds" } else { "does not hold" }.to_owned()])
        .collect();
    body += &table(&["claim", "here"], &rows);
    body += "<h2>The numbers</h2>";
    for case in &CASES {
        let of: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.case == case).collect();
        let _ = write!(body, "<h3>{}</h3>", escaped(&case.title()));
        body += &table(&HEAD, &of.iter().map(|outcome| cells(outcome)).collect::<Vec<_>>());
        let _ = write!(
            body,
            "<details><summary>The curves in numbers</summary>{}</details>",
            curve_table(case, outcomes)
        );
    }
    body += "<h2>The swarm (Figure 4.2)</h2><p>Algorithm 2 on Schwefel's function in 2 dimensions: a colour \
        and a shape for each cluster at the start of a generation, a ring around the best firefly, a cross \
        at the optimum.</p><div class=\"plots small\">";
    for (generation, seen) in SHOWN.iter().zip(swarm(seed)) {
        let _ = write!(
            body,
            "<figure class=\"frame\"><figcaption>Generation {generation}</figcaption>{}</figure>",
            cloud(*generation, &seen)
        );
    }
    body += "</div>";
    page::document("The benchmark of chapter 5", STYLE, &body)
}

fn legend() -> String {
    let mut text = "<ul class=\"legend\">".to_owned();
    for (name, class) in DRAWN {
        let _ = write!(
            text,
            r#"<li><svg class="sample" viewBox="0 0 34 12" aria-hidden="true"><path class="{class}" d="M1 6H33"/></svg>{name}</li>"#
        );
    }
    text + "</ul>"
}

/// The mean over the runs of the logarithm of the best error so far.
fn curve(outcome: &Outcome) -> Vec<f64> {
    let mean = |place: usize| {
        outcome.runs.iter().map(|run| (run.curve[place].abs() + LEAST).log10()).sum::<f64>()
            / outcome.runs.len() as f64
    };
    (0..PLACES).map(mean).collect()
}

fn drawn<'a>(case: &Case, outcomes: &'a [Outcome]) -> Vec<(&'static str, &'static str, &'a Outcome)> {
    let find =
        |name: &str| outcomes.iter().find(|outcome| outcome.case == case && outcome.entry.name == name);
    DRAWN.iter().filter_map(|(name, class)| Some((*name, *class, find(name)?))).collect()
}

fn plot(case: &Case, outcomes: &[Outcome]) -> String {
    let (width, height, left, bottom, top, right) = (460.0, 300.0, 42.0, 34.0, 8.0, 8.0);
    let curves: Vec<(&str, &str, Vec<f64>)> = drawn(case, outcomes)
        .into_iter()
        .map(|(name, class, outcome)| (name, class, curve(outcome)))
        .collect();
    let high = curves.iter().flat_map(|(_, _, values)| values).copied().fold(0.0, f64::max).ceil();
    let low = LEAST.log10();
    let x = |share: f64| left + share * (width - left - right);
    let y = |value: f64| top + (high - value) / (high - low) * (height - top - bottom);
    let ends: Vec<String> = curves
        .iter()
        .map(|(name, _, values)| format!("{name} ends at 1e{:.1}", values[PLACES - 1]))
        .collect();
    let label = format!("Best error against evaluations: {}", ends.join(", "));
    let mut svg = format!(
        r#"<svg class="chart" role="img" viewBox="0 0 {width} {height}" aria-label="{}">"#,
        escaped(&label)
    );
    for decade in (low as i32..=high as i32).filter(|decade| decade % 2 == 0) {
        let at = y(f64::from(decade));
        let _ = write!(
            svg,
            r#"<line class="grid-line" x1="{left}" x2="{:.1}" y1="{at:.1}" y2="{at:.1}"/>"#,
            width - right
        );
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="end" x="{:.1}" y="{:.1}">1e{decade}</text>"#,
            left - 4.0,
            at + 4.0
        );
    }
    for part in 0..=4 {
        let share = f64::from(part) / 4.0;
        let count = case.budget as f64 * share / 1000.0;
        let _ = write!(
            svg,
            r#"<text class="quiet" text-anchor="middle" x="{:.1}" y="{:.1}">{count} k</text>"#,
            x(share),
            height - 16.0
        );
    }
    let _ = write!(
        svg,
        r#"<text class="quiet" text-anchor="middle" x="{:.1}" y="{:.1}">evaluations</text>"#,
        x(0.5),
        height - 2.0
    );
    for (name, class, values) in &curves {
        let mut path = String::new();
        for (place, value) in values.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            let _ = write!(
                path,
                "{}{:.1} {:.1}",
                if path.is_empty() { 'M' } else { 'L' },
                x((place + 1) as f64 / PLACES as f64),
                y(*value)
            );
        }
        let _ = write!(svg, r#"<path class="curve {class}" d="{path}"><title>{name}</title></path>"#);
    }
    svg + "</svg>"
}

fn curve_table(case: &Case, outcomes: &[Outcome]) -> String {
    let of = drawn(case, outcomes);
    let mut head = vec!["evaluations"];
    head.extend(of.iter().map(|(name, _, _)| *name));
    let curves: Vec<Vec<f64>> = of.iter().map(|(_, _, outcome)| curve(outcome)).collect();
    let step = PLACES / 20;
    let rows: Vec<Vec<String>> = (step - 1..PLACES)
        .step_by(step)
        .map(|place| {
            let errors = curves.iter().map(|curve| format!("{:.2e}", 10f64.powf(curve[place])));
            std::iter::once(format!("{}", case.budget * (place + 1) / PLACES)).chain(errors).collect()
        })
        .collect();
    table(&head, &rows)
}

fn swarm(seed: u64) -> Vec<Vec<Seen>> {
    let options = CfaThesisOptions {
        n_min: 30,
        target: 5.0,
        gamma_min: 1.0,
        gamma_max: 3.0,
        crowd: Crowd::Step,
        ..CfaThesisOptions::default()
    };
    let search = Search { dimensions: 2, seed, budget: 1_000_000, warm: Vec::new(), residuals: false };
    watch(options, &search, |x| Function::Schwefel.cost(x), &SHOWN)
}

fn cloud(generation: usize, seen: &[Seen]) -> String {
    let size = 220.0;
    let at = |x: f64| 6.0 + x * (size - 12.0);
    let label = format!(
        "{} fireflies in {} clusters in generation {generation}",
        seen.len(),
        seen.iter().map(|one| one.cluster).max().map_or(0, |most| most + 1)
    );
    let mut svg = format!(
        r#"<svg class="chart" role="img" viewBox="0 0 {size} {size}" aria-label="{}">"#,
        escaped(&label)
    );
    let optimum = (420.968_746 / Function::Schwefel.half_width() + 1.0) / 2.0;
    let (x, y) = (at(optimum), at(1.0 - optimum));
    let _ = write!(svg, r#"<path class="optimum" d="M{:.1} {y:.1}h12M{x:.1} {:.1}v12"/>"#, x - 6.0, y - 6.0);
    for one in seen {
        let (x, y) = (at(one.position[0]), at(1.0 - one.position[1]));
        let class = one.cluster % 10;
        let shape = match one.cluster % 3 {
            0 => format!(r#"<circle class="c{class}" cx="{x:.1}" cy="{y:.1}" r="3.5"/>"#),
            1 => format!(r#"<path class="c{class}" d="M{:.1} {:.1}h7v7h-7z"/>"#, x - 3.5, y - 3.5),
            _ => format!(r#"<path class="c{class}" d="M{x:.1} {:.1}l4.5 8h-9z"/>"#, y - 5.0),
        };
        svg += &shape;
    }
    if let Some(best) = seen.iter().min_by_key(|one| one.cost) {
        let _ = write!(
            svg,
            r#"<circle class="star" cx="{:.1}" cy="{:.1}" r="8"/>"#,
            at(best.position[0]),
            at(1.0 - best.position[1])
        );
    }
    svg + "</svg>"
}
