//! Windows from good, bad and hostile texts, and from the measured files.

use std::io::Read;
use std::path::Path;

use super::{ColumnBindings, GridRequest, Hold, SECOND, Seconds, Window, WindowReport};
use crate::fault::Fault;
use proptest::prelude::{any, prop_assert, prop_assert_eq, proptest};

/// A measured file from the folder of shared data beside the project; `None`, said aloud, where that is
/// absent.
pub(super) fn real_file(name: &str) -> Option<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/rooms").join(name);
    let Ok(bytes) = std::fs::read(&path) else {
        eprintln!("SKIPPED: {} is not there", path.display());
        return None;
    };
    let mut text = String::new();
    match name.ends_with(".gz") {
        true => flate2::read::GzDecoder::new(bytes.as_slice()).read_to_string(&mut text).map(drop),
        false => bytes.as_slice().read_to_string(&mut text).map(drop),
    }
    .unwrap();
    Some(text)
}

fn parse(text: &str) -> Result<(Window, WindowReport), Vec<Fault>> {
    Window::parse_csv(text, &ColumnBindings::none())
}

fn codes(result: Result<(Window, WindowReport), Vec<Fault>>) -> Vec<String> {
    result.unwrap_err().into_iter().map(|fault| fault.code).collect()
}

/// Rows every ten minutes; `cell` writes the cells behind the time.
fn rows(header: &str, count: usize, cell: impl Fn(usize) -> String) -> String {
    let mut text = format!("{header}\n");
    for i in 0..count {
        text += &format!("{},{}\n", super::rfc3339((1_452_528_000 + 600 * i as i64) * SECOND), cell(i));
    }
    text
}

#[test]
fn a_plain_window() {
    let text =
        rows("time,T_room[degF],P_heater_W,note_pct", 20, |i| format!("{},{},", 68 + i % 2, 1_000 * i));
    let (window, report) = parse(&text).unwrap();
    assert_eq!(window.channels().collect::<Vec<_>>(), ["T_room", "P_heater"]);
    let room = window.series("T_room").unwrap();
    assert_eq!((room.unit(), room.values()[0]), ("degC", 20.0));
    assert_eq!(window.series("P_heater").unwrap().values()[3], 3.0);
    assert_eq!(
        (report.rows, report.from.as_str(), report.to.as_str()),
        (20, "2016-01-11T16:00:00Z", "2016-01-11T19:10:00Z")
    );
    assert_eq!(report.channels["T_room"].median_step_s, Some(Seconds::of_millis(600_000)));
    assert_eq!(report.warnings, ["`note_pct` has no values and was left out".replace("_pct", "")]);
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<WindowReport>(&json).unwrap(), report);
}

#[test]
fn rubbish_costs_its_cell_or_its_row_only() {
    let text = rows("time,T_room,valve", 60, |i| match i {
        3 => "abc,0".to_owned(),
        4 => "20,NaN".to_owned(),
        5 => "20".to_owned(),
        6 => ",null".to_owned(),
        7 => "20,-inf".to_owned(),
        8 => "85,0".to_owned(),
        _ => "20.5,0.5".to_owned(),
    });
    let (window, report) = parse(&text).unwrap();
    let lines: Vec<u64> = report.rejected_rows.iter().map(|row| row.line).collect();
    assert_eq!(lines, [7]);
    assert_eq!(report.rejected_rows[0].reason, "not the 3 cells of the header");
    assert_eq!((report.rows, window.series("T_room").unwrap().len()), (59, 56));
    assert_eq!([&report.channels["T_room"], &report.channels["valve"]].map(|found| found.missing), [3, 3]);
    assert_eq!(
        report.warnings,
        [
            "`T_room`: 1 cells that are no numbers left out, the first in line 5: `abc`",
            "`valve`: 1 cells that are no numbers left out, the first in line 9: `-inf`",
            "`T_room`: 1 values outside -20 to 50 degC left out, the first in line 10: 85"
        ]
    );
}

#[test]
fn times_must_increase() {
    let mut text = rows("time,T_room", 40, |_| "20".to_owned());
    text += "2016-01-11T16:00:00Z,20\n2016-01-11T22:30:00Z,20\n2016-01-12T00:00:00+01:00,20\n2016-01-12T01:00:00+01:00,21\nyesterday,20\n";
    let (window, report) = parse(&text).unwrap();
    let reasons: Vec<&str> = report.rejected_rows.iter().map(|row| row.reason.as_str()).collect();
    assert_eq!(
        reasons,
        [
            "the time goes backwards",
            "the time is the same as that of the row before",
            "the time cannot be read"
        ]
    );
    assert_eq!(window.series("T_room").unwrap().len(), 42);
}

#[test]
fn a_clock_change_is_two_different_hours() {
    let local = "time,T_room\n2026-10-25T02:00:00+02:00,20\n2026-10-25T02:30:00+02:00,21\n2026-10-25T02:00:00+01:00,22\n2026-10-25T02:30:00+01:00,23\n";
    let utc = "time,T_room\n2026-10-25T00:00:00Z,20\n2026-10-25T00:30:00Z,21\n2026-10-25T01:00:00Z,22\n2026-10-25T01:30:00Z,23\n";
    let (local, utc) = (parse(local).unwrap().0, parse(utc).unwrap().0);
    assert_eq!(local, utc);
    assert_eq!(local.content_hash(), utc.content_hash());
}

#[test]
fn faults_of_a_whole_window() {
    let good = |i: usize| format!("{}", 20 + i % 2);
    assert_eq!(codes(parse("")), ["no-time-column", "no-data-column"]);
    assert_eq!(codes(parse("time,T_room\n")), ["no-valid-rows"]);
    assert_eq!(codes(parse("when,T_room\n2016-01-11T16:00:00Z,1\n")), ["no-time-column"]);
    assert_eq!(codes(parse("time,timestamp,T_room[x]\n")), ["duplicate-column", "unknown-unit"]);
    assert_eq!(parse(&rows("time,T_room", 1, good)).unwrap().1.rows, 1);
    // One sensor that is wrong or away takes nothing from the others of its row.
    let (window, report) = parse(&rows("time,T_room,T_out,valve", 1, |_| "85,4,on".to_owned())).unwrap();
    assert_eq!((window.channels().collect::<Vec<_>>(), report.warnings.len()), (vec!["T_out"], 4));
    assert_eq!(codes(parse(&rows("time,T_room", 9, |_| String::new()))), ["no-valid-rows"]);
    assert_eq!(codes(parse(&rows("time,T_room", 20, good).replace('Z', ""))), ["naive-time"]);
    assert_eq!(codes(parse("time,T_room\n1452528000000,20\n1452528600000,20\n")), ["numeric-time"]);
    assert_eq!(codes(parse(&rows("time,T_room,room", 20, |i| format!("{},east", good(i))))), ["not-numbers"]);
    let mixed =
        "time,T_room\n2016-01-11,20\n1452528000,20\n9998-01-01T00:00:00Z,20\nx,20\n2016-01-11T00:00:00Z,y\n";
    assert_eq!(codes(parse(mixed)), ["naive-time", "numeric-time", "rejected-rows", "rejected-rows"]);
    let wide: String = (0..2_000).map(|i| format!(",c{i}")).collect();
    assert_eq!(codes(parse(&format!("time{wide}\n"))), ["too-many-columns"]);
    let many_faults: String = (0..500).map(|i| format!(",c{i}[furlong]")).collect();
    assert_eq!(codes(parse(&format!("time{many_faults}\n"))).len(), 100);
}

#[test]
fn mistaken_units_are_named() {
    let suggestion = |header: &str, value: &dyn Fn(usize) -> f64| {
        let fault = parse(&rows(header, 50, |i| value(i).to_string())).unwrap_err().remove(0);
        assert_eq!(fault.code, "implausible-values");
        fault.suggestion.unwrap()
    };
    assert!(suggestion("time,T_room", &|i| 68.0 + i as f64 * 0.1).contains("T_room[degF]"));
    assert!(suggestion("time,T_room_degC", &|i| 293.0 + i as f64 * 0.1).contains("T_room[K]"));
    assert!(suggestion("time,T_room[K]", &|_| 20.5).contains("T_room[degC]"));
    assert!(suggestion("time,cloud_cover", &|i| i as f64).contains("cloud_cover[pct]"));
    // A heater that is off most of the time: its zeros do not hide the watts.
    assert!(
        suggestion("time,P_heater", &|i| if i % 10 == 0 { 2_000.0 } else { 0.0 }).contains("P_heater[W]")
    );
    assert!(suggestion("time,T_room", &|_| 1e7).contains("check the unit"));
    // What another unit would explain as well is taken, and named.
    let warnings = |header: &str, value: f64| {
        parse(&rows(header, 50, |i| (value - i as f64 / 10.0).to_string())).unwrap().1.warnings
    };
    assert!(warnings("time,P_lamp", 60.0)[0].contains("up to 60 kW: if they are W, state it as P_lamp[W]"));
    assert!(warnings("time,T_out", 59.0)[0].contains("if they are degF, state it as T_out[degF]"));
    for (header, value) in [
        ("time,P_lamp[kW]", 60.0),
        ("time,P_lamp_kW", 60.0),
        ("time,P_lamp", 19.0),
        ("time,T_out_degC", 59.0),
        ("time,T_forward", 59.0),
    ] {
        assert_eq!(warnings(header, value), [""; 0], "{header}");
    }
    assert!(
        parse(&rows("time,P_heater_raw", 50, |i| (i * 100).to_string())).is_ok(),
        "an unknown unit is not judged"
    );
}

#[test]
fn spreadsheets_may_use_semicolons_marks_and_comments() {
    let text =
        "\u{feff}# a file\nTime;T_room\r\n2016-01-11T16:00:00Z;20\r\n\r\n2016-01-11T16:10:00Z;\"21\"\r\n";
    assert_eq!(parse(text).unwrap().0.series("T_room").unwrap().values(), [20.0, 21.0]);
}

#[test]
fn json_says_the_same_as_csv() {
    let csv =
        "time,T_room[degF],x\n2016-01-11T16:00:00Z,68,1\n2016-01-11T16:10:00Z,,2\n2016-01-11T16:20:00Z,77,\n";
    let json = r#"{"channels":{"T_room":{"unit":"degF"}},"time":["2016-01-11T16:00:00Z","2016-01-11T16:10:00Z","2016-01-11T16:20:00Z"],
        "values":{"T_room":[68,null,77.0],"x":[1,2,null]}}"#;
    let from_json = Window::parse_json(json.as_bytes(), &ColumnBindings::none()).unwrap();
    assert_eq!(parse(csv).unwrap(), from_json);
    let bound =
        Window::parse_json(json.as_bytes(), &ColumnBindings::parse(["T_out=T_room"]).unwrap()).unwrap().0;
    assert_eq!(bound.channels().collect::<Vec<_>>(), ["T_out", "x"]);
}

#[test]
fn json_faults_are_listed() {
    let codes = |json: &str| codes(Window::parse_json(json.as_bytes(), &ColumnBindings::none()));
    for unreadable in [
        "",
        "[]",
        "{",
        "{}",
        r#"{"time":[],"values":{},"extra":1}"#,
        r#"{"time":[1e400],"values":{}}"#,
        r#"{"time":["\ud800"],"values":{}}"#,
    ] {
        assert_eq!(codes(unreadable), ["unreadable"], "{unreadable}");
    }
    let many: String = (0..2_000).map(|i| format!(r#""c{i}":[],"#)).collect();
    assert_eq!(codes(&format!(r#"{{"time":[],"values":{{{many}"x":[]}}}}"#)), ["unreadable"]);
    assert_eq!(codes(r#"{"channels":{"x":{},"x":{}},"time":[],"values":{"x":[]}}"#), ["duplicate-column"]);
    let deep = format!(r#"{{"time":[],"values":{{"x":[{}"#, "[".repeat(100_000));
    assert_eq!(codes(&deep), ["unreadable"]);
    assert_eq!(codes(r#"{"time":[],"values":{}}"#), ["no-data-column"]);
    assert_eq!(codes(r#"{"time":[],"values":{"x":[],"x":[]}}"#), ["duplicate-column"]);
    assert_eq!(
        codes(r#"{"channels":{"y":{}},"time":[],"values":{"x":[1],"z[q]":[]}}"#),
        ["no-values", "length-mismatch", "unknown-unit"]
    );
    assert_eq!(codes(r#"{"time":[1,2],"values":{"x":[1,2]}}"#), ["numeric-time"]);
    let cells = r#"{"time":["2016-01-11T16:00:00Z","2016-01-11T16:10:00Z","2016-01-11T16:20:00Z",null],"values":{"x":[[1],{"a":1},true,2]}}"#;
    assert_eq!(codes(cells), ["rejected-rows", "not-numbers"]);
}

#[test]
fn the_newest_window_wins_per_channel_and_time() {
    let older =
        parse("time,T_room,x[K]\n2016-01-11T16:00:00Z,20,300\n2016-01-11T16:10:00Z,20,300\n2016-01-11T16:20:00Z,20,300\n").unwrap().0;
    let newer =
        parse("time,T_room,x[degC],z\n2016-01-11T16:10:00Z,21,1,5\n2016-01-11T16:15:00Z,22,,5\n").unwrap().0;
    let both = Window::stitch(&[older.clone(), newer.clone()]).unwrap();
    assert_eq!(both.series("T_room").unwrap().values(), [20.0, 21.0, 22.0, 20.0]);
    let x = both.series("x").unwrap();
    assert_eq!((x.unit(), x.len(), x.values()[1]), ("degC", 3, 1.0));
    assert!((x.values()[0] - 26.85).abs() < 1e-9);
    assert_eq!(Window::stitch(std::slice::from_ref(&older)).unwrap(), older);
    let other_unit = parse("time,x[kW]\n2016-01-11T16:10:00Z,21\n2016-01-11T16:15:00Z,22\n").unwrap().0;
    assert_eq!(Window::stitch(&[older.clone(), other_unit]).unwrap_err()[0].code, "unit-conflict");
    assert_eq!(Window::stitch(&[]).unwrap_err()[0].code, "no-data-in-range");
    let part = older.slice(older.from() + 1, older.to()).unwrap();
    assert_eq!(part.series("T_room").unwrap().len(), 2);
    assert_eq!(older.slice(0, 1).unwrap_err()[0].code, "no-data-in-range");
}

#[test]
fn the_hash_is_that_of_the_content() {
    let first = parse("time,a,b\n2016-01-11T16:00:00Z,1,2\n2016-01-11T16:10:00Z,1,-0\n").unwrap().0;
    let swapped =
        parse("time,b,a\n2016-01-11T17:00:00+01:00,2.0,1\n2016-01-11T17:10:00+01:00,0,1e0\n").unwrap().0;
    let other = parse("time,a,b\n2016-01-11T16:00:00Z,1,2\n2016-01-11T16:10:00Z,1,3\n").unwrap().0;
    assert_eq!(first.content_hash(), swapped.content_hash());
    assert_ne!(first.content_hash(), other.content_hash());
    assert_eq!(first.content_hash().len(), 64);
}

#[test]
fn the_measured_files() {
    let cases: [(&str, &[&str], usize, &[&str]); 5] = [
        (
            "belgian_house/belgian_house_10min.csv.gz",
            &["T_room=T_laundry"],
            10_128,
            &["T_room", "T_out", "P_appliances", "sun_altitude", "wind_speed"],
        ),
        (
            "dtu_flexhouse_prbs/flexhouse_5min.csv",
            &["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "irradiance=ghi_W_m2"],
            1_691,
            &["T_room", "T_out", "irradiance", "P_heater"],
        ),
        (
            "darkgreybox_demo_house/darkgreybox_1h.csv",
            &["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"],
            792,
            &["T_room", "T_out", "P_heater", "T_heating_supply"],
        ),
        (
            "brains4buildings_windesheim/room_999169_15min.csv",
            &[
                "T_room=T_room_bms_degC",
                "T_out=T_outdoor_degC",
                "CO2=CO2_bms_ppm",
                "valve=ventilation_valve_frac",
            ],
            2_308,
            &["T_room", "T_out", "CO2", "valve", "wind_speed", "ghi"],
        ),
        (
            "brains4buildings_windesheim/room_917810_15min.csv",
            &["T_room=T_room_bms_degC", "T_out=T_outdoor_degC"],
            2_308,
            &["T_room", "T_out", "wind_speed"],
        ),
    ];
    for (name, binds, count, expected) in cases {
        let Some(text) = real_file(name) else {
            continue;
        };
        let (window, report) =
            Window::parse_csv(&text, &ColumnBindings::parse(binds.iter().copied()).unwrap()).unwrap();
        assert_eq!((report.rows, report.rejected_rows.len()), (count, 0), "{name}");
        for channel in expected {
            assert!(
                window.series(channel).is_some(),
                "{name} has {:?}",
                window.channels().collect::<Vec<_>>()
            );
        }
        let grid = window.grid(&GridRequest::new("T_room", &[("T_out", Hold::Linear)])).unwrap();
        assert!(grid.valid_share() > 0.99, "{name}: {}", grid.valid_share());
        for series in window.iter() {
            assert_eq!(super::Series::decode(&series.encode()).as_ref(), Ok(series));
        }
    }
    if let Some(text) = real_file("dtu_flexhouse_prbs/flexhouse_5min.csv") {
        let (window, _) = parse(&text).unwrap();
        let heater = window.series("P_heater").unwrap();
        assert_eq!((heater.unit(), heater.hold(), heater.values()[0]), ("kW", Hold::ZeroOrder, 4.825_33));
    }
}

proptest! {
    #[test]
    fn any_text_is_a_window_or_faults(
        text in any::<String>(),
        bytes in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        let _ = parse(&text);
        let _ = parse(&format!("time,T_room\n{text}"));
        let _ = Window::parse_json(&bytes, &ColumnBindings::none());
    }

    #[test]
    fn rows_of_any_cells(
        cells in proptest::collection::vec(
            ("[0-9TZ:+. -]{0,22}|2016-01-1[0-9]T1[0-9]:00:00Z", "-?[0-9.eE+]{0,12}|NaN|null|[\"',;#]{0,3}"),
            0..40,
        ),
    ) {
        let mut text = "time,T_room\n".to_owned();
        for (time, cell) in &cells {
            text += &format!("{time},{cell}\n");
        }
        match parse(&text) {
            Ok((window, report)) => {
                prop_assert!(report.rows >= 1);
                prop_assert!(window.iter().all(|series| series.values().iter().all(|value| value.is_finite())));
                prop_assert!(!serde_json::to_string(&report).unwrap().contains("NaN"));
            }
            Err(faults) => prop_assert!(!faults.is_empty() && faults.len() <= 100),
        }
    }

    #[test]
    fn json_of_any_cells(cells in proptest::collection::vec(any::<(Option<f64>, bool)>(), 2..20)) {
        let time: Vec<String> = (0..cells.len()).map(|i| super::rfc3339(600 * SECOND * i as i64)).collect();
        let values: Vec<serde_json::Value> = cells.iter().map(|(value, odd)| if *odd { "?".into() } else { serde_json::json!(value) }).collect();
        let json = serde_json::json!({"time": time, "values": {"x": values}}).to_string();
        if let Ok((window, report)) = Window::parse_json(json.as_bytes(), &ColumnBindings::none()) {
            prop_assert_eq!(report.channels["x"].samples, window.series("x").unwrap().len());
        }
    }

    #[test]
    fn stitching_keeps_every_time_once(
        a in proptest::collection::btree_set(0i64..50, 1..20),
        b in proptest::collection::btree_set(0i64..50, 1..20),
    ) {
        let window = |times: &std::collections::BTreeSet<i64>, value: f64| {
            let series = super::Series::new(
                "x",
                "-",
                Hold::Linear,
                times.iter().copied().collect(),
                vec![value; times.len()]
            );
            Window::from_series(vec![series.unwrap()]).unwrap()
        };
        let both = Window::stitch(&[window(&a, 1.0), window(&b, 2.0)]).unwrap();
        let x = both.series("x").unwrap();
        let newest = |time: &i64| (*time, if b.contains(time) { 2.0 } else { 1.0 });
        let expected: Vec<(i64, f64)> = a.union(&b).map(newest).collect();
        prop_assert_eq!(
            x.times().iter().copied().zip(x.values().iter().copied()).collect::<Vec<_>>(),
            expected
        );
    }
}
