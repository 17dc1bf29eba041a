//! The page of chapter 7: one HTML file without scripts, in the style of the service's own page. Every chart
//! has the table of its numbers below it.

use super::super::charts::{Edge, Frame, Line, dots, graph, heat, lines, mark};
use super::super::page::{self, Table, escaped, figure, line_legend, number, section};
use super::found::House;
use super::ways::{BOXES, DEFAULT, METHODS, Measured, NARROWED, PRIOR, THESIS_MSE, VALVE, Way};
use lampyris::cli::Failure;
use lampyris_core::data::rfc3339;
use std::fmt::Write;

/// The document.
///
/// # Errors
/// Where the page's style is not in the binary.
pub fn document(house: &House, tables: &[Table]) -> Result<String, Failure> {
    page::document("The house of chapter 7", page::STYLE, &body(house, tables))
}

fn body(house: &House, tables: &[Table]) -> String {
    let shown = |id: &str| tables.iter().find(|table| table.id == id).map(section).unwrap_or_default();
    let mut body = format!(
        "<p>A twin of the thesis's house with a known truth: {} rooms that warm each other, {} sensors, two \
        weeks of March at {} minutes, {} K of sensor noise, thermostats, people. Week 1 is fitted, week 2 is \
        unseen. The thesis's own figures stand beside ours where there are any; its house is another one and \
        not public, so sizes can be compared, rows cannot.</p>",
        house.truths.len(),
        house.layout.sensors.len(),
        house.request.step_minutes,
        house.sensor_noise,
    );
    body += &figures(house);
    body += "<h2>Which rooms there are</h2>";
    body += &layout_charts(house);
    body += &shown("layout");
    body += "<h2>The thesis's cFA</h2>";
    body += &shown("table-7-6");
    body += "<h2>Methods</h2>";
    for (part, title) in ["Week 1, fitted", "Week 2, unseen"].into_iter().enumerate() {
        body += &methods_chart(house, part, title);
    }
    for id in ["table-7-8", "table-7-9", "shapes"] {
        body += &shown(id);
    }
    body += "<h2>Two weeks, room by room (figures 7.4 to 7.6)</h2>";
    body += &rooms_charts(house);
    body += "<h2>Bounds and prior</h2>";
    body += &boxes_chart(house);
    body += &shown("boxes");
    body += &overfit_chart(house);
    body += &shown("figure-7-7");
    body += "<h2>Valve or sigmoid</h2>";
    body += &valve_chart(house);
    body += &shown("valves");
    body += "<h2>Times</h2>";
    body += &shown("times");
    body
}

/// Median errors of both weeks and the time of every method.
fn figures(house: &House) -> String {
    let mut text = String::from(r#"<dl class="figures">"#);
    for way in METHODS {
        let [first, second] =
            [0, 1].map(|part| house.median(way, part).map_or_else(|| "-".to_owned(), number));
        let took: f64 = house.of(way).map(|run| run.seconds).sum();
        let _ = write!(
            text,
            "<div><dt>{}: median MSE of week 1, week 2, time</dt><dd>{first} K², {second} K², {took:.1} \
            s</dd></div>",
            escaped(way.name)
        );
    }
    text + "</dl>"
}

fn mark_legend(names: &[&str]) -> String {
    let entry = |(place, name): (usize, &&str)| {
        format!(
            r#"<span><svg class="sample" viewBox="0 0 26 12" aria-hidden="true">{}</svg>{}</span>"#,
            mark(place, 13.0, 6.0, ""),
            escaped(name)
        )
    };
    names.iter().enumerate().map(entry).collect()
}

fn layout_charts(house: &House) -> String {
    let names: Vec<String> = house
        .layout
        .sensors
        .iter()
        .map(|sensor| sensor.channel.trim_start_matches("T_room_").to_owned())
        .collect();
    let head: Vec<String> = std::iter::once("sensor".to_owned()).chain(names.iter().cloned()).collect();
    let cell = |value: &Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
    let rows: Vec<Vec<String>> = names
        .iter()
        .zip(&house.layout.correlation)
        .map(|(name, row)| std::iter::once(name.clone()).chain(row.iter().map(cell)).collect())
        .collect();
    let matrix = heat(
        "Correlations of the sensors: the smaller one of the temperatures and of what remains without the \
        day's mean",
        &names,
        &house.layout.correlation,
    );
    let rooms: Vec<String> = house.layout.rooms.iter().map(|room| room.id.clone()).collect();
    let (mut edges, mut listed) = (Vec::new(), Vec::new());
    for a in 0..rooms.len() {
        let (proposed, walls) = (house.proposed(&rooms[a]), house.walls(&rooms[a]));
        for b in a + 1..rooms.len() {
            let (edge, word) = match (proposed.contains(&rooms[b]), walls.contains(&rooms[b])) {
                (true, true) => (Edge::Right, "proposed, and a wall"),
                (true, false) => (Edge::Extra, "proposed without a wall"),
                (false, true) => (Edge::Missed, "a wall that is not proposed"),
                (false, false) => continue,
            };
            edges.push((a, b, edge));
            listed.push(vec![format!("{} and {}", rooms[a], rooms[b]), word.to_owned()]);
        }
    }
    let legend: String = [
        ("edge-right", "proposed, and a wall"),
        ("edge-extra", "proposed without a wall"),
        ("edge-missed", "a wall, not proposed")
    ]
        .map(|(class, name)| format!(r#"<span><svg class="sample" viewBox="0 0 26 12" aria-hidden="true"><line class="{class}" x1="0" x2="26" y1="6" y2="6"/></svg>{name}</span>"#))
        .concat();
    let plan = graph("Rooms and their neighbours, as proposed and as they are", &rooms, &edges);
    format!(
        r#"<div class="grid">{}{}</div>"#,
        figure(
            "Figure 7.2: correlations of the sensors",
            "<span>the fuller the colour, the stronger</span>",
            &matrix,
            &head,
            &rows
        ),
        figure(
            "Figure 7.3: rooms and neighbours",
            &legend,
            &plan,
            &["rooms".to_owned(), "neighbours".to_owned()],
            &listed
        )
    )
}

/// The errors of some ways in every room.
fn marks(
    house: &House,
    caption: &str,
    names: &[&str],
    label: &str,
    value: impl Fn(&str, usize) -> Option<f64>,
) -> String {
    let rows: Vec<(String, Vec<Option<f64>>)> = house
        .rooms
        .iter()
        .map(|room| {
            (format!("room {}", room.id), (0..names.len()).map(|place| value(&room.id, place)).collect())
        })
        .collect();
    dotted(caption, names, label, "room", &rows)
}

fn dotted(
    caption: &str,
    names: &[&str],
    label: &str,
    first: &str,
    rows: &[(String, Vec<Option<f64>>)],
) -> String {
    let head: Vec<String> = std::iter::once(first).chain(names.iter().copied()).map(str::to_owned).collect();
    let cell = |value: &Option<f64>| value.map_or_else(|| "-".to_owned(), number);
    let listed: Vec<Vec<String>> = rows
        .iter()
        .map(|(name, values)| std::iter::once(name.clone()).chain(values.iter().map(cell)).collect())
        .collect();
    figure(caption, &mark_legend(names), &dots(label, names, rows), &head, &listed)
}

fn error(house: &House, room: &str, way: &Way, part: usize) -> Option<f64> {
    Some(house.run(room, way)?.solution.as_ref()?.errors.mse[part])
}

fn methods_chart(house: &House, part: usize, title: &str) -> String {
    let names: Vec<&str> = METHODS.iter().map(|way| way.name).collect();
    let label = format!("{title}: mean square error of each method in each room");
    marks(house, &format!("{title}: mean square error, K2, logarithmic"), &names, &label, |room, place| {
        error(house, room, &METHODS[place], part)
    })
}

fn boxes_chart(house: &House) -> String {
    let rows: Vec<(String, Vec<Option<f64>>)> = BOXES
        .iter()
        .map(|way| (way.name.to_owned(), [0, 1].map(|part| house.median(way, part)).to_vec()))
        .collect();
    dotted(
        "Median mean square error of the rooms by search and box, K2, logarithmic",
        &["week 1", "week 2"],
        "Median errors of both weeks by search and box",
        "search and box",
        &rows,
    )
}

fn valve_chart(house: &House) -> String {
    let ways = [(&DEFAULT, 0), (&VALVE, 0), (&DEFAULT, 1), (&VALVE, 1)];
    let names = ["sigmoid, week 1", "valve, week 1", "sigmoid, week 2", "valve, week 2"];
    marks(
        house,
        "Mean square error of cfa, K2, logarithmic",
        &names,
        "Errors with the sigmoid and with the measured valve in each room",
        |room, place| error(house, room, ways[place].0, ways[place].1),
    )
}

/// Measured and free runs of one room.
fn run_chart(
    house: &House,
    room: &str,
    measured: &Measured,
    caption: &str,
    ways: &[(&'static str, &Way)],
    size: (f64, f64),
) -> String {
    let output = |way: &Way| -> Vec<Option<f64>> {
        let solution = house.run(room, way).and_then(|run| run.solution.as_ref());
        solution.map(|solution| solution.output.iter().copied().map(Some).collect()).unwrap_or_default()
    };
    let mut all = vec![Line { style: "measured", values: measured.values.clone(), name: "measured" }];
    all.extend(ways.iter().map(|(style, way)| Line { style, values: output(way), name: way.name }));
    let per_day = 24 * 60 / house.request.step_minutes;
    let frame = Frame { label: caption, unseen: per_day * house.asked.part_days, per_day, size };
    let entries: Vec<(&str, &str)> = all.iter().map(|line| (line.style, line.name)).collect();
    let head: Vec<String> = ["time", "measured"]
        .into_iter()
        .chain(ways.iter().map(|(_, way)| way.name))
        .map(str::to_owned)
        .collect();
    let cell = |line: &Line, k: usize| {
        line.values.get(k).copied().flatten().map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"))
    };
    let rows: Vec<Vec<String>> = measured
        .times
        .iter()
        .enumerate()
        .map(|(k, time)| {
            std::iter::once(rfc3339(*time)).chain(all.iter().map(|line| cell(line, k))).collect()
        })
        .collect();
    figure(caption, &line_legend(&entries), &lines(&frame, &all), &head, &rows)
}

fn rooms_charts(house: &House) -> String {
    let charts = house.rooms.iter().zip(&house.measured).map(|(room, measured)| {
        let ways = [("previous", &THESIS_MSE), ("model", &DEFAULT)];
        run_chart(house, &room.id, measured, &format!("Room {}, degC", room.id), &ways, (440.0, 200.0))
    });
    format!(
        r#"<p class="note">Free runs from the start; week 2, which is shaded, was not fitted.</p><div class="grid">{}</div>"#,
        charts.collect::<String>()
    )
}

fn overfit_chart(house: &House) -> String {
    let Some((room, wide)) = house.overfit() else { return String::new() };
    let Some(measured) =
        house.rooms.iter().position(|one| one.id == room).map(|place| &house.measured[place])
    else {
        return String::new();
    };
    let ways = [("previous", wide), ("heldout", &NARROWED), ("model", &DEFAULT), ("ok", &PRIOR)];
    run_chart(
        house,
        room,
        measured,
        &format!("Figure 7.7: room {room} in wide and in physical bounds, degC"),
        &ways,
        (900.0, 300.0),
    )
}
