//! Bad measurements, as CSV and as JSON.

use super::{Case, Mutation, as_json};
use crate::support::TestApp;
use crate::support::rooms::room;
use serde_json::{Value, json};

const ROWS: usize = 60;
const PATH: &str = "/systems/room/3/windows";

/// A CSV text in its parts. The time stands in column 0, then the room, outdoors and a heater in kilowatts.
#[derive(Clone)]
struct Csv {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Csv {
    fn good() -> Self {
        let row = |(index, (time, room, out)): (usize, (String, f64, f64))| {
            vec![time, format!("{:.2}", room + 14.0), format!("{out:.2}"), format!("{}", index % 3)]
        };
        Self {
            header: ["time", "T_room[degC]", "T_out[degC]", "P_heater"].map(str::to_owned).to_vec(),
            rows: room(5, 2).into_iter().take(ROWS).enumerate().map(row).collect(),
        }
    }

    fn text(&self) -> String {
        let lines = [&self.header].into_iter().chain(&self.rows);
        lines.map(|cells| cells.join(",") + "\n").collect()
    }

    /// Every other cell of a block of rows becomes another one: enough of them to be a fault.
    fn spoil(&mut self, rows: std::ops::Range<usize>, column: usize, value: impl Fn(&str) -> String) {
        for row in rows.step_by(2) {
            self.rows[row][column] = value(&self.rows[row][column]);
        }
    }

    fn convert(&mut self, column: usize, convert: impl Fn(f64) -> f64) {
        for row in &mut self.rows {
            if let Ok(value) = row[column].parse::<f64>() {
                row[column] = format!("{:.2}", convert(value));
            }
        }
    }
}

/// Row 0 is line 2. Blocks of 16 rows lie apart, so that each mutation has lines of its own.
const A: std::ops::Range<usize> = 2..18;
const B: std::ops::Range<usize> = 22..38;
const C: std::ops::Range<usize> = 42..58;

fn csv_mutations() -> Vec<Mutation<Csv>> {
    let one = |area, faults, apply: fn(&mut Csv)| Mutation { area, hides: &[], faults, apply };
    // Without one column of times no row can be judged.
    let blind =
        |area, faults, apply: fn(&mut Csv)| Mutation { area, hides: &["rows", "values"], faults, apply };
    vec![
        // Whatever its name is, a first column of times is one.
        blind("head time", &[("line 1", "no-time-column")], |csv| {
            csv.header[0] = "when".into();
            csv.rows.iter_mut().for_each(|row| row[0].insert_str(0, "at "));
        }),
        blind("head time", &[("line 1", "duplicate-column")], |csv| {
            csv.header.push("timestamp".into());
            csv.rows.iter_mut().for_each(|row| row.push(row[0].clone()));
        }),
        // A column that is no channel is not judged further.
        Mutation {
            area: "head room",
            hides: &["values room"],
            faults: &[("column T_room[furlong]", "unknown-unit")],
            apply: |csv| csv.header[1] = "T_room[furlong]".into(),
        },
        Mutation {
            area: "head out",
            hides: &["values out"],
            faults: &[("column T_out[kW]", "inconvertible-unit")],
            apply: |csv| csv.header[2] = "T_out[kW]".into(),
        },
        one("head more", &[("column T_out", "duplicate-column")], |csv| {
            csv.header.push("T_out".into());
            csv.rows.iter_mut().for_each(|row| row.push("1".into()));
        }),
        one("head more", &[("column ", "unnamed-column")], |csv| {
            csv.header.push(String::new());
            csv.rows.iter_mut().for_each(|row| row.push(String::new()));
        }),
        one("values room", &[("column T_room[degC]", "implausible-values")], |csv| {
            csv.convert(1, |celsius| celsius * 1.8 + 32.0)
        }),
        one("values room", &[("column T_room[degC]", "implausible-values")], |csv| {
            csv.convert(1, |celsius| celsius + 273.15)
        }),
        one("values out", &[("column T_out[degC]", "implausible-values")], |csv| {
            csv.convert(2, |celsius| celsius + 273.15)
        }),
        one("values heater", &[("column P_heater", "implausible-values")], |csv| {
            csv.convert(3, |kilowatts| kilowatts * 1000.0)
        }),
        one("rows a", &[("line 4", "naive-time")], |csv| {
            csv.spoil(A, 0, |time| time.trim_end_matches('Z').to_owned())
        }),
        one("rows a", &[("line 4", "naive-time")], |csv| {
            csv.spoil(A.start..A.start + 1, 0, |_| "2026-10-25T02:30:00".into())
        }),
        one("rows b", &[("line 24", "numeric-time")], |csv| csv.spoil(B, 0, |_| "1767225600".into())),
        one("rows b", &[("line 24", "rejected-rows")], |csv| csv.spoil(B, 0, |_| "yesterday".into())),
        one("rows b", &[("line 24", "rejected-rows")], |csv| {
            csv.spoil(B, 0, |_| "1850-01-01T00:00:00Z".into())
        }),
        // The last of a reversed block comes first, and all others go backwards.
        one("rows c", &[("line 45", "rejected-rows")], |csv| csv.rows[C].reverse()),
        one("rows c", &[("line 45", "rejected-rows")], |csv| {
            for row in C.skip(1).step_by(2) {
                csv.rows[row][0] = csv.rows[row - 1][0].clone();
            }
        }),
        // Where a row is left out, its cells are not looked at.
        Mutation {
            area: "rows a",
            hides: &["values room", "head room"],
            faults: &[("column T_room[degC]", "not-numbers")],
            apply: |csv| csv.spoil(A, 1, |_| "warm".into()),
        },
        Mutation {
            area: "rows b",
            hides: &["values heater"],
            faults: &[("column P_heater", "not-numbers")],
            apply: |csv| csv.spoil(B, 3, |_| "-inf".into()),
        },
        one("rows c", &[("line 44", "rejected-rows")], |csv| csv.spoil(C, 3, |_| "1,5".into())),
    ]
}

fn good_json() -> Value {
    let rows = room(6, 2);
    let rows = &rows[..ROWS];
    json!({
        "channels": {"T_room": {"unit": "degC"}, "T_out": {"unit": "degC"}},
        "time": rows.iter().map(|row| &row.0).collect::<Vec<_>>(),
        "values": {
            "T_room": rows.iter().map(|row| row.1 + 14.0).collect::<Vec<_>>(),
            "T_out": rows.iter().map(|row| row.2).collect::<Vec<_>>(),
            "P_heater": (0..ROWS).map(|index| index % 3).collect::<Vec<_>>(),
        },
    })
}

fn spoil(document: &mut Value, pointer: &str, rows: std::ops::Range<usize>, value: &Value) {
    for row in rows.step_by(2) {
        document.pointer_mut(pointer).unwrap()[row] = value.clone();
    }
}

fn convert(document: &mut Value, pointer: &str, convert: fn(f64) -> f64) {
    for cell in document.pointer_mut(pointer).unwrap().as_array_mut().unwrap() {
        *cell = json!(convert(cell.as_f64().unwrap()));
    }
}

fn json_mutations() -> Vec<Mutation<Value>> {
    let one = |area, faults, apply: fn(&mut Value)| Mutation { area, hides: &[], faults, apply };
    let blind = |area, hides, faults, apply: fn(&mut Value)| Mutation { area, hides, faults, apply };
    vec![
        one("field", &[("/timezone", "unknown-field")], |window| window["timezone"] = json!("UTC")),
        one("channel room", &[("/channels/T_room/sensor", "unknown-field")], |window| {
            window["channels"]["T_room"]["sensor"] = json!("a")
        }),
        one("channel out", &[("/channels/T_out/unit", "wrong-type")], |window| {
            window["channels"]["T_out"]["unit"] = json!(5)
        }),
        blind("channel room", &["values room"], &[("/channels/T_room/unit", "unknown-unit")], |window| {
            window["channels"]["T_room"]["unit"] = json!("furlong");
        }),
        blind("channel out", &["values out"], &[("/channels/T_out/unit", "inconvertible-unit")], |window| {
            window["channels"]["T_out"]["unit"] = json!("kW");
        }),
        one("channel more", &[("/channels/T_forward", "no-values")], |window| {
            window["channels"]["T_forward"] = json!({"unit": "degC"})
        }),
        blind("values heater", &["rows b"], &[("/values/P_heater", "wrong-type")], |window| {
            window["values"]["P_heater"] = json!("none")
        }),
        blind("values heater", &["rows b"], &[("/values/P_heater", "length-mismatch")], |window| {
            window["values"]["P_heater"] = json!([1, 2])
        }),
        one("values heater", &[("/values/P_heater", "implausible-values")], |window| {
            convert(window, "/values/P_heater", |kw| kw * 1000.0)
        }),
        one("values room", &[("/values/T_room", "implausible-values")], |window| {
            convert(window, "/values/T_room", |c| c * 1.8 + 32.0)
        }),
        one("values out", &[("/values/T_out", "implausible-values")], |window| {
            convert(window, "/values/T_out", |c| c + 273.15)
        }),
        one("rows a", &[("/time/2", "naive-time")], |window| {
            spoil(window, "/time", A.start..A.start + 1, &json!("2026-10-25T02:30:00"))
        }),
        one("rows a", &[("/time/2", "numeric-time")], |window| {
            spoil(window, "/time", A, &json!(1_767_225_600))
        }),
        one("rows a", &[("/time/2", "rejected-rows")], |window| spoil(window, "/time", A, &json!(null))),
        blind("rows b", &["values heater"], &[("/values/P_heater", "not-numbers")], |window| {
            spoil(window, "/values/P_heater", B, &json!("off"))
        }),
        blind("rows b", &["values heater"], &[("/values/P_heater", "not-numbers")], |window| {
            spoil(window, "/values/P_heater", B, &json!({"kW": 1}))
        }),
        one("rows c", &[("/time/43", "rejected-rows")], |window| {
            window["time"].as_array_mut().unwrap()[C].reverse();
        }),
        one("rows c", &[("/time/42", "rejected-rows")], |window| {
            spoil(window, "/time", C, &json!("2200-01-01T00:00:00Z"))
        }),
        blind("time", &["*"], &[("/time", "missing-field")], |window| {
            drop(window.as_object_mut().unwrap().shift_remove("time"))
        }),
        blind("time", &["*"], &[("/time", "wrong-type")], |window| {
            window["time"] = json!("2026-01-01T00:00:00Z")
        }),
        blind("values", &["*"], &[("/values", "wrong-type")], |window| window["values"] = json!([1, 2])),
    ]
}

pub fn cases() -> Vec<Case> {
    let as_csv = |csv: &Csv| ("POST", PATH.to_owned(), "text/csv", csv.text().into_bytes());
    let mut cases = super::cases(&Csv::good(), &csv_mutations(), 60, 1, as_csv);
    cases.extend(super::cases(&good_json(), &json_mutations(), 50, 2, as_json("POST", PATH)));
    cases
}

/// What is only said, and not refused, because it costs a row or a cell and not the window: a few bad rows
/// and cells, a single value that no sensor gives, offsets that change from row to row.
pub fn check_good(app: &TestApp) {
    let mut csv = Csv::good();
    let taken = app.csv(PATH, &csv.text()).expect(201).json();
    assert_eq!(
        (&taken["rows"], &taken["rejected_rows"], &taken["warnings"]),
        (&json!(ROWS), &json!([]), &json!([])),
        "{taken}"
    );
    csv.rows[5][1] = "warm".into();
    csv.rows[9][0] = csv.rows[8][0].clone();
    csv.rows[20][1] = "85".into();
    // 15:00Z, told by a clock in Kathmandu.
    csv.rows[30][0] = "2026-01-01T20:45:00+05:45".into();
    let taken = app.csv(PATH, &csv.text()).expect(201).json();
    assert_eq!(taken["rows"], ROWS - 1, "{taken}");
    assert_eq!(taken["rejected_rows"][0]["line"], 11, "{taken}");
    for (warning, said) in ["line 7: `warm`", "line 22"].into_iter().enumerate() {
        assert!(taken["warnings"][warning].as_str().unwrap().contains(said), "{taken}");
    }
    app.json("POST", PATH, &good_json()).expect(201);
}
