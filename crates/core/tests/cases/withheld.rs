//! Measured rooms with a known driver withheld: the diagnosis must name it, and must not name the same
//! channel of other days.

use super::{fit, problem, request};
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::diagnose::{Diagnosis, diagnose};
use lampyris_core::estimate::problem::request::{AccusationRate, WindowRange};
use lampyris_core::estimate::{Control, EstimateRequest, Site};
use lampyris_core::model::Catalogue;

const DAY: usize = 86_400;

/// A room with a base model that lacks what drives it.
struct Room {
    csv: String,
    model: &'static str,
    binds: &'static [&'static str],
    /// The column that is withheld.
    column: &'static str,
}

fn laundry() -> Room {
    Room {
        csv: include_str!("../../../../config/demo/belgian_house.csv").to_owned(),
        model: "rc2+constant_gain+solar_gain",
        binds: &["T_room=T_laundry", "irradiance=irradiance_clear_sky"],
        column: "P_appliances",
    }
}

/// The diagnosis of fourteen days from an instant on, half of them to learn from.
fn diagnosed(room: &Room, from: &str, to: &str) -> Diagnosis {
    let window = Some(WindowRange { last: None, from: Some(from.to_owned()), to: Some(to.to_owned()) });
    let asked = EstimateRequest { window, ..request("P7D", "P7D", "P0D", 31) };
    let problem = problem(&room.csv, room.model, room.binds, &Site::default(), &asked);
    let theta = fit(&problem, &asked).theta();
    let (window, _) =
        Window::parse_csv(&room.csv, &ColumnBindings::parse(room.binds.iter().copied()).unwrap()).unwrap();
    let catalogue = Catalogue::builtin().unwrap();
    diagnose(
        &catalogue,
        &problem,
        &theta,
        &window,
        &Site::default(),
        AccusationRate::USUAL,
        &[],
        &Control::NONE,
    )
    .unwrap()
}

/// The room with the withheld column of so many days later, circularly: what it claims is broken, and its
/// rhythm stays.
fn of_other_days(room: &Room, days: usize) -> Room {
    let (head, rows): (Vec<&str>, Vec<&str>) = {
        let mut lines = room.csv.lines().filter(|line| !line.starts_with('#'));
        (vec![lines.next().unwrap()], lines.collect())
    };
    let place = head[0].split(',').position(|name| name.split('[').next() == Some(room.column)).unwrap();
    let time =
        |row: &str| row.split(',').next().unwrap().parse::<jiff::Timestamp>().unwrap().as_second() as usize;
    let later = days * DAY / (time(rows[1]) - time(rows[0]));
    let whole = rows.len() - rows.len() % (DAY / (time(rows[1]) - time(rows[0])));
    let moved = rows.iter().enumerate().map(|(k, row)| {
        let mut cells: Vec<&str> = row.split(',').collect();
        cells[place] = rows[(k + later) % whole].split(',').nth(place).unwrap();
        cells.join(",")
    });
    Room {
        csv: head.iter().map(|line| (*line).to_owned()).chain(moved).collect::<Vec<_>>().join("\n"),
        ..*room
    }
}

/// The meter that warms the laundry is named in both fortnights, over hours and although the minutes say
/// nothing, and the same meter of other days is not.
#[test]
fn the_meter_of_the_laundry_is_named_and_that_of_other_days_is_not() {
    let room = laundry();
    for (from, to) in
        [("2016-02-01T00:00:00Z", "2016-02-14T23:59:59Z"), ("2016-02-15T00:00:00Z", "2016-02-28T23:59:59Z")]
    {
        let found = diagnosed(&room, from, to);
        let first = found.findings.first().unwrap_or_else(|| panic!("{from}: {}", found.summary));
        let shown = first.segments.as_ref().unwrap_or_else(|| panic!("{first:?}"));
        println!("laundry from {from}: {} {shown:?}", first.effect);
        assert_eq!((first.effect.as_str(), first.tied_with.len()), ("metered_gain:P_appliances", 0));
        assert!(
            shown.t > 4.0 && shown.beyond_clock > 4.0 && shown.p <= 0.01 && shown.confirmed_share > 0.0,
            "{shown:?}"
        );
        assert!(shown.shifts >= 12 && shown.shift_p == 1.0 / (1 + shown.shifts) as f64, "{shown:?}");
        // What a person sees says the same: errors rise by what the meter would add, and by more than the
        // free run gives it.
        let added = first.shape.as_ref().and_then(|shape| shape.added.as_ref()).unwrap();
        assert!(added.slope > 0.7, "{}", added.slope);
        for days in [4, 9] {
            let found = diagnosed(&of_other_days(&room, days), from, to);
            let named = found.findings.iter().any(|finding| finding.effect == "metered_gain:P_appliances");
            assert!(!named, "{days} days later: {}", found.summary);
        }
    }
}

/// The heating water of a dwelling, which follows a schedule as people do, is named and not the people.
#[test]
fn heating_water_is_named_although_it_keeps_hours() {
    let Some(csv) = super::houses::beside("nl_home3/nl_home3.csv.gz") else {
        println!("SKIPPED: the dwelling's measurements are not beside the project");
        return;
    };
    let binds = &["T_room=T_room_degC", "T_out=T_out_degC", "irradiance=irradiance_W_m2"];
    let room =
        Room { csv, model: "rc2+constant_gain+solar_gain", binds, column: "T_heating_water_0off_degC" };
    let found = diagnosed(&room, "2021-12-03T22:15:00Z", "2021-12-17T22:00:00Z");
    let first = found.findings.first().unwrap_or_else(|| panic!("{}", found.summary));
    println!("dwelling: {} {:?}", first.effect, first.segments);
    assert_eq!((first.effect.as_str(), first.tied_with.len()), ("heat_emitter:T_heating_water_0off", 0));
    assert!(
        first.evidence.iter().any(|sentence| sentence.contains("by chance something looks like that")),
        "{:?}",
        first.evidence
    );
}
