//! The tables of chapter 7 for the twin house, with the thesis's own figures beside them.

use super::super::page::{NONE, Table, number};
use super::found::{House, median};
use super::published::{ROOMS, TABLE_7_6, TABLES_7_8_AND_7_9, place};
use super::ways::{BOXES, DEFAULT, METHODS, Run, Solution, THESIS, THESIS_MSE, VALVE, Way};

/// All tables, in the order of the thesis.
pub fn tables(house: &House) -> Vec<Table> {
    let mut tables = vec![
        layout(house),
        table_7_6(house),
        table_7_8(house),
        table_7_9(house),
        shapes(house),
        boxes(house),
    ];
    tables.extend(worst(house));
    tables.extend([valves(house), times(house)]);
    tables
}

fn seconds(value: f64) -> String {
    format!("{value:.2}")
}

fn found(run: Option<&Run>) -> Option<&Solution> {
    run.and_then(|run| run.solution.as_ref())
}

fn shown(solution: Option<&Solution>, of: impl Fn(&Solution) -> f64) -> String {
    solution.map_or_else(|| NONE.to_owned(), |solution| number(of(solution)))
}

fn evaluations(solution: Option<&Solution>) -> String {
    solution.map_or_else(|| NONE.to_owned(), |solution| solution.evaluations.to_string())
}

fn heads(words: &[&str]) -> Vec<String> {
    words.iter().map(|word| (*word).to_owned()).collect()
}

fn layout(house: &House) -> Table {
    let joined = |names: &[String]| if names.is_empty() { NONE.to_owned() } else { names.join(" ") };
    let rows = house.layout.rooms.iter().map(|room| {
        let walls = house.walls(&room.id);
        let proposed = house.proposed(&room.id);
        let without = |a: &[String], b: &[String]| -> Vec<String> {
            a.iter().filter(|name| !b.contains(name)).cloned().collect()
        };
        vec![
            room.id.clone(),
            room.sensors
                .iter()
                .map(|sensor| sensor.trim_start_matches("T_room_"))
                .collect::<Vec<_>>()
                .join(" "),
            room.correlation.map_or_else(|| NONE.to_owned(), |correlation| format!("{correlation:.3}")),
            joined(&proposed),
            joined(&without(&walls, &proposed)),
            joined(&without(&proposed, &walls)),
        ]
    });
    Table {
        id: "layout",
        title: format!(
            "Layout: {} sensors, {} rooms (thesis 7.3: 17 and 11)",
            house.layout.sensors.len(),
            house.layout.rooms.len()
        ),
        note: "Proposed from the correlations of the temperatures. The plan is known here: the last two \
            columns say where the proposal differs from it."
            .to_owned(),
        head: heads(&[
            "room",
            "sensors",
            "correlation",
            "proposed neighbours",
            "walls not proposed",
            "proposed without a wall",
        ]),
        rows: rows.collect(),
    }
}

fn table_7_6(house: &House) -> Table {
    let mut rows: Vec<Vec<String>> = house
        .rooms
        .iter()
        .map(|room| {
            let (shape, plain) = (house.run(&room.id, &THESIS), house.run(&room.id, &THESIS_MSE));
            let mut cells = vec![room.id.clone()];
            for (run, value) in [
                (shape, shown(found(shape), |s| s.errors.swmse[0])),
                (plain, shown(found(plain), |s| s.errors.mse[0])),
            ] {
                cells.extend([
                    value,
                    run.map_or_else(String::new, |run| seconds(run.seconds)),
                    evaluations(found(run)),
                ]);
            }
            match place(&room.id) {
                Some(place) => cells.extend(TABLE_7_6[place].iter().enumerate().map(|(column, value)| {
                    if column % 2 == 0 { format!("{value:.3}") } else { seconds(*value) }
                })),
                None => cells.extend(vec![NONE.to_owned(); 4]),
            }
            cells
        })
        .collect();
    let total = |way: &Way| seconds(house.of(way).map(|run| run.seconds).sum());
    let spent = |way: &Way| {
        house.of(way).filter_map(|run| found(Some(run))).map(|s| s.evaluations).sum::<usize>().to_string()
    };
    let published = |column: usize| seconds(TABLE_7_6.iter().map(|row| row[column]).sum());
    rows.push(vec![
        "all".to_owned(),
        String::new(),
        total(&THESIS),
        spent(&THESIS),
        String::new(),
        total(&THESIS_MSE),
        spent(&THESIS_MSE),
        String::new(),
        published(1),
        String::new(),
        published(3),
    ]);
    Table {
        id: "table-7-6",
        title: "Table 7.6: objective and time of the thesis's cFA with both objectives, week 1".to_owned(),
        note: "cfa_thesis with Table 7.4's hyperparameters in Table 7.5's box. The thesis's columns are of \
            its own house, which is not public: compare their sizes, not their rows. Errors are positive \
            here."
            .to_owned(),
        head: heads(&[
            "room",
            "swMSE",
            "s",
            "evaluations",
            "MSE",
            "s",
            "evaluations",
            "thesis swMSE",
            "thesis s",
            "thesis MSE",
            "thesis s",
        ]),
        rows,
    }
}

fn table_7_8(house: &House) -> Table {
    let mut head = heads(&["room"]);
    for way in METHODS {
        head.extend([format!("{} MSE", way.name), "s".to_owned(), "evaluations".to_owned()]);
    }
    head.extend(heads(&["thesis CTSM-R MSE", "s", "thesis cFA MSE", "s"]));
    let mut rows: Vec<Vec<String>> = house
        .rooms
        .iter()
        .map(|room| {
            let mut cells = vec![room.id.clone()];
            for way in METHODS {
                let run = house.run(&room.id, way);
                let took = run.map_or_else(|| NONE.to_owned(), |run| seconds(run.seconds));
                cells.extend([shown(found(run), |s| s.errors.mse[0]), took, evaluations(found(run))]);
            }
            match place(&room.id).map(|place| TABLES_7_8_AND_7_9[place]) {
                Some(row) => cells.extend([
                    row.ctsm_r.map_or_else(|| NONE.to_owned(), |errors| format!("{:.3}", errors[0])),
                    seconds(row.ctsm_r_seconds),
                    format!("{:.3}", row.cfa[0]),
                    seconds(row.cfa_seconds),
                ]),
                None => cells.extend(vec![NONE.to_owned(); 4]),
            }
            cells
        })
        .collect();
    let mut last = vec!["all".to_owned()];
    for way in METHODS {
        let solved = house.of(way).filter(|run| run.solution.is_some()).count();
        let spent: usize = house.of(way).filter_map(|run| found(Some(run))).map(|s| s.evaluations).sum();
        last.extend([
            format!("{solved} of {}", house.rooms.len()),
            seconds(house.of(way).map(|run| run.seconds).sum()),
            spent.to_string(),
        ]);
    }
    let solved = TABLES_7_8_AND_7_9.iter().filter(|row| row.ctsm_r.is_some()).count();
    last.extend([
        format!("{solved} of {}", ROOMS.len()),
        seconds(TABLES_7_8_AND_7_9.iter().map(|row| row.ctsm_r_seconds).sum()),
        format!("{0} of {0}", ROOMS.len()),
        seconds(TABLES_7_8_AND_7_9.iter().map(|row| row.cfa_seconds).sum()),
    ]);
    rows.push(last);
    Table {
        id: "table-7-8",
        title: "Table 7.8: mean square error and time by method, week 1".to_owned(),
        note: "K2 of the free run over the week that was fitted. The methods named cfa_thesis look in Table \
            7.5's box, the others in the model's physical bounds. A dash is a room without a solution; the \
            last line counts solutions and adds up times."
            .to_owned(),
        head,
        rows,
    }
}

fn table_7_9(house: &House) -> Table {
    let mut head = heads(&["room"]);
    for way in METHODS {
        head.extend([format!("{} MSE", way.name), "gate".to_owned()]);
    }
    head.extend(heads(&["thesis CTSM-R MSE", "thesis cFA MSE"]));
    let mut rows: Vec<Vec<String>> = house
        .rooms
        .iter()
        .map(|room| {
            let mut cells = vec![room.id.clone()];
            for way in METHODS {
                let solution = found(house.run(&room.id, way));
                let verdict = solution.map_or(NONE, |solution| solution.gate.verdict);
                cells.extend([shown(solution, |s| s.errors.mse[1]), verdict.to_owned()]);
            }
            let published = place(&room.id).map(|place| TABLES_7_8_AND_7_9[place]);
            let ctsm_r = published.and_then(|row| row.ctsm_r).map(|errors| format!("{:.3}", errors[1]));
            cells.extend(
                [ctsm_r, published.map(|row| format!("{:.3}", row.cfa[1]))]
                    .map(|cell| cell.unwrap_or_else(|| NONE.to_owned())),
            );
            cells
        })
        .collect();
    let mut last = vec!["median".to_owned()];
    for way in METHODS {
        let refused =
            house.of(way).filter_map(|run| found(Some(run))).filter(|s| s.gate.verdict == "rejected").count();
        last.extend([
            house.median(way, 1).map_or_else(|| NONE.to_owned(), number),
            format!("{refused} rejected"),
        ]);
    }
    let middle =
        |values: Vec<f64>| median(values).map_or_else(|| NONE.to_owned(), |value| format!("{value:.3}"));
    last.push(middle(TABLES_7_8_AND_7_9.iter().filter_map(|row| Some(row.ctsm_r?[1])).collect()));
    last.push(middle(TABLES_7_8_AND_7_9.iter().map(|row| row.cfa[1]).collect()));
    rows.push(last);
    Table {
        id: "table-7-9",
        title: "Table 7.9: mean square error by method, week 2, which no method saw".to_owned(),
        note:
            "The free run goes on from week 1. The gate judges the fit with week 2 as its unseen data; the \
            thesis had none."
                .to_owned(),
        head,
        rows,
    }
}

fn shapes(house: &House) -> Table {
    let mut head = heads(&["room"]);
    for way in METHODS {
        head.extend([format!("{} week 1", way.name), "week 2".to_owned()]);
    }
    let rows = house.rooms.iter().map(|room| {
        let mut cells = vec![room.id.clone()];
        for way in METHODS {
            let solution = found(house.run(&room.id, way));
            cells.extend([0, 1].map(|part| shown(solution, |s| s.errors.swmse[part])));
        }
        cells
    });
    Table {
        id: "shapes",
        title: format!("Shape-weighted mean square error (eq. 7.6, delta {})", f64::from(house.asked.delta)),
        note: "K2; the mean square error over delta + (1 - delta) r, where r is the correlation of the free \
            run with the measurements."
            .to_owned(),
        head,
        rows: rows.collect(),
    }
}

fn boxes(house: &House) -> Table {
    let rows = BOXES.iter().map(|way| {
        let solutions: Vec<&Solution> = house.of(way).filter_map(|run| found(Some(run))).collect();
        let most = |of: &dyn Fn(&Solution) -> f64| solutions.iter().map(|s| of(s)).fold(0.0, f64::max);
        let cell = |part: usize| house.median(way, part).map_or_else(|| NONE.to_owned(), number);
        vec![
            way.name.to_owned(),
            cell(0),
            cell(1),
            number(most(&|s| s.errors.mse[0])),
            number(most(&|s| s.errors.mse[1])),
            format!("{:.1}", most(&|s| s.errors.mse[1] / s.errors.mse[0])),
            number(most(&|s| s.largest)),
            format!(
                "{} of {}",
                solutions.iter().filter(|s| s.gate.verdict == "rejected").count(),
                solutions.len()
            ),
            seconds(house.of(way).map(|run| run.seconds).sum()),
        ]
    });
    Table {
        id: "boxes",
        title: "Bounds and prior: what the box does to both weeks (thesis 7.6.2)".to_owned(),
        note: "Over all rooms. cfa_thesis looks from 1e-4 up to 1000 with even spread unless its name says \
            otherwise; cfa in the model's physical bounds on logarithmic scales unless its name says \
            otherwise."
            .to_owned(),
        head: heads(&[
            "search and box",
            "median week 1",
            "median week 2",
            "worst week 1",
            "worst week 2",
            "worst week 2 / week 1",
            "largest coefficient",
            "refused by the gate",
            "s",
        ]),
        rows: rows.collect(),
    }
}

fn worst(house: &House) -> Option<Table> {
    let (room, _) = house.overfit()?;
    let rows = BOXES.iter().map(|way| {
        let solution = found(house.run(room, way));
        let said = solution.map_or_else(|| NONE.to_owned(), |solution| solution.gate.summary.clone());
        let [first, second] = [0, 1].map(|part| shown(solution, |s| s.errors.mse[part]));
        vec![way.name.to_owned(), first, second, shown(solution, |s| s.largest), said]
    });
    Some(Table {
        id: "figure-7-7",
        title: format!("Figure 7.7: room {room}, overfitted in the wide box, and its cure"),
        note: "The room whose error grows most from week 1 to week 2 after a search in Table 7.5's box. In \
            the thesis it is room 1: 0.301 in week 1, 5.228 in week 2."
            .to_owned(),
        head: heads(&["search and box", "week 1", "week 2", "largest coefficient", "what the gate says"]),
        rows: rows.collect(),
    })
}

fn valves(house: &House) -> Table {
    let mut rows: Vec<Vec<String>> = house
        .rooms
        .iter()
        .map(|room| {
            let (sigmoid, valve) = (found(house.run(&room.id, &DEFAULT)), found(house.run(&room.id, &VALVE)));
            let mut cells = vec![
                room.id.clone(),
                house.truth(&room.id).map_or_else(String::new, |truth| format!("{:.1}", truth.lowered)),
            ];
            for part in [0, 1] {
                cells.extend([sigmoid, valve].map(|solution| shown(solution, |s| s.errors.mse[part])));
            }
            cells
        })
        .collect();
    let mut last = vec!["median".to_owned(), String::new()];
    for part in [0, 1] {
        last.extend(
            [&DEFAULT, &VALVE].map(|way| house.median(way, part).map_or_else(|| NONE.to_owned(), number)),
        );
    }
    rows.push(last);
    Table {
        id: "valves",
        title: "The measured valve against the sigmoid (thesis 7.6.1)".to_owned(),
        note: "Mean square errors of `cfa` in K2. The thesis takes the flow for a sigmoid of the room \
            temperature; some thermostats of this house are turned down at night, which a sigmoid cannot \
            know and a measured valve shows."
            .to_owned(),
        head: heads(&[
            "room",
            "lowered by night, K",
            "sigmoid week 1",
            "valve week 1",
            "sigmoid week 2",
            "valve week 2",
        ]),
        rows,
    }
}

fn times(house: &House) -> Table {
    let mut rows: Vec<Vec<String>> =
        house.seconds.iter().map(|(part, took)| vec![part.clone(), seconds(*took)]).collect();
    rows.push(vec!["all".to_owned(), seconds(house.seconds.iter().map(|(_, took)| took).sum())]);
    Table {
        id: "times",
        title: "Wall times".to_owned(),
        note: format!(
            "One room after another, {} threads. The parts of a way are its searches, free runs and verdicts \
            in all rooms.",
            house.threads
        ),
        head: heads(&["part", "s"]),
        rows,
    }
}
