//! Files of other programs, and what the parser makes of them.

use super::{CsvDialect, DateForm, DecimalMark, DialectAsked, recognise};
use crate::data::{ColumnBindings, Window, rfc3339};
use crate::fault::Fault;

fn zone(name: &str) -> DialectAsked {
    DialectAsked { zone: Some(name.to_owned()), ..DialectAsked::default() }
}

fn read(body: &[u8], asked: &DialectAsked) -> Result<(String, CsvDialect, Window), Vec<Fault>> {
    let found = recognise(body, asked)?;
    let (window, _) = Window::parse_csv(&found.text, &ColumnBindings::none())?;
    Ok((found.text.into_owned(), found.dialect.unwrap(), window))
}

fn samples(window: &Window, channel: &str) -> Vec<(String, f64)> {
    let series = window.series(channel).unwrap();
    series.times().iter().map(|time| rfc3339(*time)).zip(series.values().iter().copied()).collect()
}

#[test]
fn what_a_german_logger_writes_is_read() {
    let text = "Gerät: Logger 7\r\n\r\nDatum;Uhrzeit;T_room [°C];Druck\r\n31.01.2026;12:00;21,5;1.013,25\r\n\
        31.01.2026;12:10;21,25;n/a\r\n31.01.2026;12:20;;998,5\r\n";
    let (body, _, _) = encoding_rs::WINDOWS_1252.encode(text);
    let (_, dialect, window) = read(&body, &zone("Europe/Berlin")).unwrap();
    assert_eq!((dialect.encoding.as_str(), dialect.separator, dialect.header), ("windows-1252", ';', 3));
    assert_eq!((dialect.decimal, dialect.dates), (DecimalMark::Comma, DateForm::DayFirst));
    assert_eq!(
        samples(&window, "T_room"),
        [("2026-01-31T11:00:00Z".to_owned(), 21.5), ("2026-01-31T11:10:00Z".to_owned(), 21.25)]
    );
    assert_eq!(samples(&window, "Druck")[0].1, 1013.25);
    assert_eq!(
        dialect.summary().unwrap(),
        "The file was read with the encoding windows-1252, decimal commas, the day before the month and times of \
        Europe/Berlin."
    );
}

#[test]
fn spreadsheets_write_utf_16_and_lines_of_units() {
    let text =
        "\u{feff}Time\tT_room\tT_out\n\t°C\t°F\n2026/01/31 12:00\t21.5\t50\n2026/01/31 13:00\t21.5\t41\n";
    let body: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let (_, dialect, window) = read(&body, &zone("UTC")).unwrap();
    assert_eq!((dialect.encoding.as_str(), dialect.separator), ("UTF-16LE", '\t'));
    assert_eq!(samples(&window, "T_out")[1], ("2026-01-31T13:00:00Z".to_owned(), 5.0));
}

#[test]
fn both_hours_of_the_autumn_night_are_read_and_the_one_of_spring_is_not() {
    let night = |day: &str, clocks: &[&str]| {
        let rows: Vec<String> = clocks.iter().map(|clock| format!("{day} {clock};1")).collect();
        format!("Zeit;T_room\n{}\n", rows.join("\n"))
    };
    let autumn = night("25.10.2026", &["01:30", "02:00", "02:30", "02:00", "02:30", "03:00"]);
    let (_, _, window) = read(autumn.as_bytes(), &zone("Europe/Berlin")).unwrap();
    let times: Vec<String> = samples(&window, "T_room").into_iter().map(|(time, _)| time).collect();
    let wanted = ["24T23:30", "25T00:00", "25T00:30", "25T01:00", "25T01:30", "25T02:00"];
    assert_eq!(times, wanted.map(|time| format!("2026-10-{time}:00Z")));
    let mut clocks: Vec<String> = (0..24).map(|hour| format!("{hour:02}:00")).collect();
    clocks.insert(3, "02:30".to_owned());
    let clocks: Vec<&str> = clocks.iter().map(String::as_str).collect();
    let spring = night("29.03.2026", &clocks);
    let spring = recognise(spring.as_bytes(), &zone("Europe/Berlin")).unwrap();
    let (_, report) = Window::parse_csv(&spring.text, &ColumnBindings::none()).unwrap();
    let lines: Vec<u64> = report.rejected_rows.iter().map(|row| row.line).collect();
    assert_eq!(lines, [4, 5], "02:00 and 02:30 of that night never were");
}

#[test]
fn day_and_month_change_places_only_where_the_file_says_which_is_which() {
    let file = |days: &[&str]| {
        let rows: Vec<String> = days.iter().map(|day| format!("{day} 12:00,1")).collect();
        format!("time,T_room\n{}\n", rows.join("\n"))
    };
    let form = |days: &[&str], asked: Option<DateForm>| {
        let asked = DialectAsked { dates: asked, ..zone("UTC") };
        recognise(file(days).as_bytes(), &asked).map(|found| found.dialect.unwrap().dates)
    };
    assert_eq!(form(&["12/01/2026", "13/01/2026"], None), Ok(DateForm::DayFirst));
    assert_eq!(form(&["01/12/2026", "01/13/2026"], None), Ok(DateForm::MonthFirst));
    // Each step is a day by one reading, and a month by the other.
    assert_eq!(form(&["03/04/2026", "04/04/2026", "05/04/2026"], None), Ok(DateForm::DayFirst));
    assert_eq!(form(&["04/03/2026", "04/04/2026", "04/05/2026"], None), Ok(DateForm::MonthFirst));
    assert_eq!(form(&["03/04/2026"], None).unwrap_err()[0].code, "ambiguous-dates");
    assert_eq!(form(&["03/04/2026"], Some(DateForm::MonthFirst)), Ok(DateForm::MonthFirst));
}

#[test]
fn years_may_have_two_digits() {
    let first = |rows: &[&str]| {
        let text = format!("Zeit;T_room\n{};21\n", rows.join(";20\n"));
        let (_, dialect, window) = read(text.as_bytes(), &zone("UTC")).unwrap();
        (dialect.dates, samples(&window, "T_room")[0].0.clone())
    };
    let noon = "2026-01-31T12:00:00Z".to_owned();
    assert_eq!(first(&["31.01.26 12:00", "31.01.26 12:10"]), (DateForm::DayFirst, noon.clone()));
    assert_eq!(first(&["31/01/26 12:00", "31/01/26 12:10"]), (DateForm::DayFirst, noon));
    let after = "2026-01-31T13:00:00Z".to_owned();
    assert_eq!(first(&["1/31/26 1:00 PM", "1/31/26 1:10 PM"]), (DateForm::MonthFirst, after));
}

#[test]
fn lines_above_the_header_may_have_its_width() {
    for above in ["sep=;", "Serial;123", "Export;31.01.2026", "Datum;Anlage 7"] {
        let text = format!("{above}\nZeit;T_room\n31.1.2026 12:00;21,5\n31.1.2026 12:10;20,5\n");
        let (_, dialect, window) = read(text.as_bytes(), &zone("UTC")).unwrap();
        assert_eq!((dialect.header, samples(&window, "T_room").len()), (2, 2), "{above}");
    }
}

#[test]
fn sensors_may_be_called_by_numbers() {
    let text = "Zeit;2812345678;20260131\n31.1.2026 12:00;21,5;1\n31.1.2026 12:10;20,5;1\n";
    let (_, dialect, window) = read(text.as_bytes(), &zone("UTC")).unwrap();
    assert_eq!((dialect.header, samples(&window, "2812345678").len()), (1, 2));
}

#[test]
fn commas_in_times_separate_no_cells() {
    let text = "Zeit;T_room\n31.1.2026, 12:00:00;21,5\n31.1.2026, 12:10:00;20,5\n";
    let (_, dialect, window) = read(text.as_bytes(), &zone("UTC")).unwrap();
    assert_eq!((dialect.separator, samples(&window, "T_room")[1].1), (';', 20.5));
}

#[test]
fn a_name_of_times_needs_times_below_it() {
    let text = "Timestamp (UTC),data\n2026-01-31 12:00,215.125\n2026-01-31 12:10,214.125\n";
    let (_, _, window) = read(text.as_bytes(), &zone("UTC")).unwrap();
    assert_eq!(samples(&window, "data")[1], ("2026-01-31T12:10:00Z".to_owned(), 214.125));
    // A first row that is broken hides no header, and blank ones of two columns of times are none.
    let rows: String = (10..40).map(|minute| format!("31.01.26;12:{minute};21\n")).collect();
    let text = format!("Datum;Zeit;T_room\nkaputt;kaputt;1\n{rows};;\n;;\n");
    let (_, dialect, window) = read(text.as_bytes(), &zone("UTC")).unwrap();
    assert_eq!((dialect.header, samples(&window, "T_room").len()), (1, 30));
}

#[test]
fn quotes_inside_of_cells_hide_no_separators() {
    let rows: String = (10..40).map(|minute| format!("31.01.2026 12:{minute};20,5;\n")).collect();
    let remark = "31.01.2026 12:40;21,5;\"a\nb\"\n31.01.2026 12:41;2x;\n";
    let text = format!("Datum;Rohr 5\" innen;Notiz\n{rows}{remark}");
    let (rewritten, _, window) = read(text.as_bytes(), &zone("UTC")).unwrap();
    assert_eq!(samples(&window, "Rohr 5\" innen")[0].1, 20.5);
    assert_eq!(rewritten.lines().count(), text.lines().count(), "a remark of two lines stands on the second");
}

#[test]
fn commas_of_thousands_are_no_decimals() {
    let file = |cells: [&str; 2]| {
        let rows = cells
            .map(|cell| format!("2026-01-31 12:{},{cell}\n", if cell == cells[0] { "00" } else { "10" }));
        format!("time,P_x\n{}", rows.concat())
    };
    let value = |cells, decimal| {
        let asked = DialectAsked { decimal, ..zone("UTC") };
        let (_, _, window) = read(file(cells).as_bytes(), &asked)?;
        Ok::<f64, Vec<Fault>>(samples(&window, "P_x")[0].1)
    };
    let open = ["\"1,250\"", "\"2,250\""];
    let fault = value(open, None).unwrap_err().remove(0);
    assert_eq!((fault.code.as_str(), fault.pointer.as_str()), ("ambiguous-decimals", "line 2"));
    assert_eq!(value(open, Some(DecimalMark::Comma)), Ok(1.25));
    let watts = |cells, decimal| {
        let text = file(cells).replace("P_x", "P_x[W]");
        let asked = DialectAsked { decimal, ..zone("UTC") };
        let (_, _, window) = read(text.as_bytes(), &asked).unwrap();
        samples(&window, "P_x").iter().map(|(_, value)| *value).collect::<Vec<_>>()
    };
    assert_eq!(watts(open, Some(DecimalMark::Point)), [1.25, 2.25], "in kW");
    assert_eq!(watts(["\"1,250\"", "850.5"], None), [1.25, 0.8505]);
    // With semicolons between the cells a comma is that of decimals, and 1.250 does not say otherwise.
    let german = "Zeit;P_x[W];T_room\n31.01.2026 12:00;1.250;21,5\n31.01.2026 12:10;1.350;\n";
    let (_, _, window) = read(german.as_bytes(), &zone("UTC")).unwrap();
    assert_eq!(samples(&window, "P_x")[0].1, 1.25);
    let german = "Zeit;T_room\n31.01.2026 12:00;21,125\n31.01.2026 12:10;20,125\n";
    let (_, dialect, _) = read(german.as_bytes(), &zone("UTC")).unwrap();
    assert_eq!(dialect.decimal, DecimalMark::Comma);
}

#[test]
fn commas_far_below_the_header_are_seen() {
    let row = |at: usize| format!("2026-01-01T{:02}:00:00Z;{}\n", at, if at < 23 { "0" } else { "0,35" });
    let text = format!("time;valve\n{}", (0..24).map(row).collect::<String>());
    let (_, dialect, window) = read(text.as_bytes(), &DialectAsked::default()).unwrap();
    assert_eq!((dialect.decimal, samples(&window, "valve")[23].1), (DecimalMark::Comma, 0.35));
}

#[test]
fn too_many_columns_are_refused_before_any_work() {
    let wide = |time: &str, separator: &str| {
        let names: String = (0..1_001).map(|at| format!("{separator}c{at}")).collect();
        let cells = format!("{separator}1").repeat(1_001);
        recognise(format!("Zeit{names}\n{time}{cells}\n").as_bytes(), &zone("UTC")).unwrap_err()[0]
            .code
            .clone()
    };
    assert_eq!(wide("31.01.2026 12:00", ";"), "too-many-columns");
    assert_eq!(wide("2026-01-31T12:00:00Z", ","), "too-many-columns");
}

#[test]
fn times_without_a_zone_stay_a_fault_and_lines_keep_their_numbers() {
    let text = "# made by hand\n\nZeit;T_room\n31.01.2026 12:00;21,5\n31.01.2026 13:00;21,5\n";
    let found = recognise(text.as_bytes(), &DialectAsked::default()).unwrap();
    let faults = Window::parse_csv(&found.text, &ColumnBindings::none()).unwrap_err();
    assert_eq!((faults[0].code.as_str(), faults[0].pointer.as_str()), ("naive-time", "line 4"));
    assert!(found.dialect.unwrap().local);
    assert_eq!(recognise(text.as_bytes(), &zone("Middle/Earth")).unwrap_err()[0].pointer, "/zone");
}

#[test]
fn what_the_parser_reads_is_left_alone() {
    for text in [
        "time,T_room[degC]\n2026-01-01T00:00:00Z,21.5\n2026-01-01T00:10:00Z,\n",
        "time;T_room\n2026-01-01T00:00:00+01:00;21.5\n",
        "time,T_room\n",
        "",
        "nothing of the kind",
    ] {
        let found = recognise(text.as_bytes(), &DialectAsked::default()).unwrap();
        assert!(matches!(found.text, std::borrow::Cow::Borrowed(_)), "{text}");
    }
    let only = DialectAsked { only: Some(vec!["T_out".to_owned()]), ..DialectAsked::default() };
    let text = "time,T_room[degC],T_out[degC]\n2026-01-01T00:00:00Z,21.5,3\n";
    let (text, ..) = read(text.as_bytes(), &only).unwrap();
    assert_eq!(text, "time,T_out[degC]\n2026-01-01T00:00:00Z,3\n");
}

#[test]
fn seconds_since_1970_and_american_clocks_are_times() {
    let (_, dialect, window) =
        read(b"ts,T_room\n1767225600,21\n1767226200,22\n", &DialectAsked::default()).unwrap();
    assert_eq!((dialect.dates, dialect.local), (DateForm::UnixSeconds, false));
    assert_eq!(samples(&window, "T_room")[1].0, "2026-01-01T00:10:00Z");
    let text = b"Date,T_room\n1/31/2026 1:00:00 PM,21\n1/31/2026 2:00:00 PM,22\n";
    let (_, _, window) = read(text, &zone("America/New_York")).unwrap();
    assert_eq!(samples(&window, "T_room")[0].0, "2026-01-31T18:00:00Z");
}

proptest::proptest! {
    #[test]
    fn no_file_panics(body in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..300)) {
        let _ = recognise(&body, &zone("Europe/Berlin"));
    }

    #[test]
    fn no_table_panics(cells in proptest::collection::vec("[0-9,;. :/\"#a-z°-]{0,12}", 0..40)) {
        let text: String = cells.chunks(4).map(|row| row.join(";") + "\n").collect();
        if let Ok(found) = recognise(text.as_bytes(), &zone("Europe/Berlin")) {
            let _ = Window::parse_csv(&found.text, &ColumnBindings::none());
        }
    }
}
