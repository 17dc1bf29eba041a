//! Table 6.8 of the thesis with our own estimates.

use super::super::page::{NONE, Table, number};
use super::case::{Fitted, errors};
use super::thesis;

/// Truth, the thesis's estimate where its truth is ours, and ours without and with noise. Errors are those of
/// eq. 6.6 against the effluent without noise.
pub fn table_6_8(clean: &Fitted, noisy: &Fitted) -> Table {
    let published = thesis::published(&clean.case);
    let mut head = vec!["parameter", "truth"];
    head.extend(published.as_ref().map(|_| "thesis"));
    head.extend(["no noise", "noise of 2 %", "95 % interval", "can hardly be told from"]);
    let mut rows: Vec<Vec<String>> = (0..clean.case.truth.len())
        .map(|place| parameter(place, published.as_deref(), clean, noisy))
        .collect();
    let [of_thesis, ours, with_noise] =
        [published.as_deref(), Some(&clean.fit.theta()[..]), Some(&noisy.fit.theta()[..])]
            .map(|theta| theta.map(|theta| errors(&clean.problem, theta)));
    let at_truth = errors(&clean.problem, &clean.truth());
    for (part, name) in
        ["error of eq. 6.6, three days", "error of eq. 6.6, eleven unseen days"].into_iter().enumerate()
    {
        let cell = |errors: Option<[f64; 2]>| errors.map(|errors| format!("{:.1e}", errors[part]));
        rows.push(line(
            name,
            [Some(format!("{:.1e}", at_truth[part])), cell(of_thesis), cell(ours), cell(with_noise)],
            published.is_some(),
        ));
    }
    let count = |fitted: &Fitted| Some(fitted.fit.evaluations.to_string());
    rows.push(line("evaluations", [None, None, count(clean), count(noisy)], published.is_some()));
    let took = |seconds: f64| Some(format!("{seconds:.0} s"));
    rows.push(line(
        "time",
        [None, took(thesis::SECONDS), took(clean.seconds), took(noisy.seconds)],
        published.is_some(),
    ));
    Table {
        id: if published.is_some() { "table-6-8" } else { "table-6-8-h" },
        title: format!("Table 6.8, plant {}", clean.case.id),
        note: "The errors are all taken against the effluent without noise, which no search has seen where \
            there is noise."
            .to_owned(),
        head: head.into_iter().map(str::to_owned).collect(),
        rows,
    }
}

fn parameter(place: usize, published: Option<&[f64]>, clean: &Fitted, noisy: &Fitted) -> Vec<String> {
    let (name, truth) = &clean.case.truth[place];
    let mut cells = vec![name.to_owned(), number(*truth)];
    cells.extend(published.map(|published| number(published[place])));
    let estimate = &noisy.fit.parameters[name];
    let interval = estimate
        .ci95
        .map_or_else(|| NONE.to_owned(), |[low, high]| format!("{} to {}", number(low), number(high)));
    let others: Vec<&str> =
        noisy.fit.correlated.iter().filter_map(|pair| other(&pair.parameters, name)).collect();
    let others = if others.is_empty() { NONE.to_owned() } else { others.join(", ") };
    cells.extend([number(clean.fit.parameters[name].value), number(estimate.value), interval, others]);
    cells
}

fn other<'a>([a, b]: &'a [String; 2], name: &str) -> Option<&'a str> {
    if a == name { Some(b) } else { (b == name).then_some(a) }
}

/// A line that is no parameter: at the truth, of the thesis, and of ours.
fn line(name: &str, [truth, of_thesis, clean, noisy]: [Option<String>; 4], with_thesis: bool) -> Vec<String> {
    let columns =
        [Some(truth), with_thesis.then_some(of_thesis), Some(clean), Some(noisy), Some(None), Some(None)];
    let cells = columns.into_iter().flatten().map(|cell| cell.unwrap_or_else(|| NONE.to_owned()));
    std::iter::once(name.to_owned()).chain(cells).collect()
}
