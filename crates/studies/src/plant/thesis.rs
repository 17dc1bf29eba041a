//! The thesis's own algorithm with its own settings (Table 6.7). It moves one firefly at a time, so its
//! evaluations share no lanes.

use super::super::page::{NONE, Table, number};
use super::super::row::Row;
use super::super::search::path;
use super::case::{Case, errors};
use lampyris::cli::Failure;
use lampyris_core::optimise::Method;

/// The estimates of Table 6.8, by parameter. Its truth, Table 6.6, is that of plant L.
const TABLE_6_8: [(&str, f64); 7] = [
    ("Y_H", 0.67),
    ("b_H", 3.34),
    ("mu_H", 8.46),
    ("mu_A", 0.49),
    ("K_OA", 1.30),
    ("K_NH", 1.28),
    ("K_S", 68.06),
];
/// How long they took (thesis 6.2.5).
pub const SECONDS: f64 = 7020.0;

/// The thesis's estimates in the model's order, for the plant that has the truth of its Table 6.6.
pub fn published(case: &Case) -> Option<Vec<f64>> {
    let estimate = |name: &str| TABLE_6_8.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
    (case.id == "asm1_l").then(|| case.truth.iter().filter_map(|(name, _)| estimate(name)).collect())
}

/// Runs it once, without noise.
pub fn run(case: &Case) -> Result<(Vec<Row>, Table), Failure> {
    let (problem, _) = case.problem()?;
    let method: Method = serde_json::from_value(serde_json::json!({
        "name": "cfa_thesis", "n": 35, "generations": 50, "n_min": 5, "target": 5.0, "target_min": 1.0,
        "alpha": 0.5, "decay": 0.97, "beta0": 1.0, "gamma_min": 0.01, "gamma_max": 10.0,
    }))
    .map_err(|error| Failure::Error(error.to_string()))?;
    let found = path(&problem, &method, case.seed, usize::MAX);
    let best = found.best.as_ref().ok_or_else(|| Failure::Error("every candidate diverged".to_owned()))?;
    let [seen, unseen] = errors(&problem, best);
    let published = published(case);
    let rows = case.truth.iter().zip(best).enumerate().map(|(place, ((name, truth), value))| {
        let known = published.as_ref().map_or_else(|| NONE.to_owned(), |published| number(published[place]));
        vec![
            name.clone(),
            number(*truth),
            known,
            number(*value),
            format!("{:+.1}", 100.0 * (value / truth - 1.0)),
        ]
    });
    let table = Table {
        id: "cfa-thesis",
        title: format!("{}: Algorithm 2 with the settings of Table 6.7", case.id),
        note: "35 fireflies, 50 generations, no noise, one run. The thesis's plant has the same truth as \
            plant L, but its volumes and its influent are not published."
            .to_owned(),
        head: ["parameter", "truth", "thesis", "Algorithm 2 here", "deviation, %"]
            .map(str::to_owned)
            .to_vec(),
        rows: rows.collect(),
    };
    let lines = vec![
        Row::new(
            format!("plant {}: Algorithm 2 of the thesis (thesis {SECONDS:.0} s)", case.id),
            found.seconds,
            "s",
        ),
        Row::new("  evaluations", found.evaluations as f64, ""),
        Row::new("  one evaluation", 1e3 * found.seconds / found.evaluations.max(1) as f64, "ms"),
        Row::new("  error of eq. 6.6 over the three days", seen, "-"),
        Row::new("  error of eq. 6.6 over the eleven unseen days", unseen, "-"),
    ];
    Ok((lines, table))
}
