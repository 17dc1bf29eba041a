//! Measured rooms with a story of their own: a known driver that is withheld must be named, the same channel
//! of other days must not, and given back the error falls.

use super::houses::beside;
use super::{fit, request};
use lampyris_core::data::{ColumnBindings, DAY, Window};
use lampyris_core::diagnose::ladder::{Step, ladder};
use lampyris_core::diagnose::{Diagnosis, diagnose};
use lampyris_core::estimate::assess::metrics::{ProcessNoise, day_ahead_mse, filter};
use lampyris_core::estimate::problem::request::{AccusationRate, WindowRange};
use lampyris_core::estimate::{Control, EstimateRequest, Site, prepare};
use lampyris_core::model::{Catalogue, ModelId};

/// The diagnosis of a model on a house.
fn diagnosis(csv: &str, model: &str, binds: &[&str], site: &Site, asked: &EstimateRequest) -> Diagnosis {
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::parse(binds.iter().copied()).unwrap()).unwrap();
    let (catalogue, id): (Catalogue, ModelId) = (Catalogue::builtin().unwrap(), model.parse().unwrap());
    let problem = prepare(&catalogue, &id, asked, &window, site).unwrap();
    let found = fit(&problem, asked);
    let problem = problem.with_substeps(found.substeps);
    let diagnosis = diagnose(
        &catalogue,
        &problem,
        &found.theta(),
        &window,
        site,
        AccusationRate::USUAL,
        &[],
        &Control::NONE,
    )
    .unwrap();
    println!("{model}: {}", diagnosis.summary);
    diagnosis
}

/// Appliances warm the laundry of the Belgian house: fitted on a week, judged on the next.
#[test]
fn the_laundry_is_missing_its_appliances() {
    let csv = include_str!("../../../../config/demo/belgian_house.csv");
    let mut asked = request("P7D", "P6D", "P0D", 31);
    asked.window = serde_json::from_value(
        serde_json::json!({ "from": "2016-02-23T00:00:00Z", "to": "2016-03-06T23:50:00Z" }),
    )
    .unwrap();
    let binds = ["T_room=T_laundry", "irradiance=irradiance_clear_sky"];
    let found = diagnosis(csv, "room2", &binds, &Site::default(), &asked);
    assert_eq!(found.findings[0].effect, "metered_gain:P_appliances", "{}", found.summary);
    // An interval over days is wider than one of the autoregression, which held the truth too seldom; the
    // size itself is no looser.
    let size = &found.findings[0].parameters["c_P_appliances"];
    assert!((0.2..0.6).contains(&size.value), "{size:?}");
    assert_eq!(size.ci95.map(|[low, high]| low > 0.1 && high < 0.7), Some(true), "{size:?}");
    let errors = day_ahead(csv, "room2", &binds, &asked);
    println!("the next days, each forecast from its midnight: {errors:.3?} K2");
    assert!(errors[1] <= 0.3 && errors[1] < 0.8 * errors[0], "{errors:?}");
}

/// The squared error of the days of the validation part, each forecast from the states of its midnight: of
/// the model and of the first step of its ladder.
fn day_ahead(csv: &str, model: &str, binds: &[&str], asked: &EstimateRequest) -> [f64; 2] {
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::parse(binds.iter().copied()).unwrap()).unwrap();
    let (catalogue, site) = (Catalogue::builtin().unwrap(), Site::default());
    let problem = |id: &str| prepare(&catalogue, &id.parse().unwrap(), asked, &window, &site).unwrap();
    let base = problem(model);
    let found =
        ladder(&catalogue, &base, &fit(&base, asked).theta(), &window, &site, 1, &Control::NONE).unwrap();
    let [first, second] = found.steps.as_slice() else { panic!("one step: {found:#?}") };
    assert!(second.kept && second.why.contains("of forecasts a day ahead from "), "{}", second.why);
    println!("{}", second.why);
    let error = |step: &Step, process_noise: ProcessNoise| {
        let problem = problem(&step.model);
        let theta: Vec<f64> =
            problem.model().parameters().iter().map(|parameter| step.parameters[&parameter.name]).collect();
        let run = filter(&problem, &theta, process_noise);
        (
            day_ahead_mse(&problem, &theta, &run, problem.split().validation.clone()).unwrap(),
            run.process_noise,
        )
    };
    let (before, process_noise) = error(first, ProcessNoise::Likeliest);
    [before, error(second, ProcessNoise::Known(process_noise)).0]
}

/// Two offices, whose people, windows and ventilation leave much unexplained: whatever is named lowers the
/// error of unseen days, in the free run or a day ahead.
#[test]
fn nothing_is_named_in_an_office_that_does_not_lower_the_unseen_error() {
    for room in ["917810", "999169"] {
        let file = format!("brains4buildings_windesheim/room_{room}_15min.csv");
        let Some(csv) = beside(&file) else { return };
        let asked = request("P12D", "P6D", "P5D", 35);
        let binds = [
            "T_room=T_room_bms_degC",
            "T_out=T_outdoor_degC",
            "irradiance=ghi_W_m2",
            "wind_speed=wind_speed_m_s",
            "CO2=CO2_bms_ppm",
            "valve=ventilation_valve_frac",
        ];
        let site =
            Site { zone: Some("Europe/Amsterdam".into()), location: Some((52.5, 6.08)), ..Site::default() };
        let found = diagnosis(&csv, "room2", &binds, &site, &asked);
        for finding in &found.findings {
            let [before, after] = finding.rmse.validation.unwrap();
            let ahead = finding.rmse.validation_ahead["PT24H"];
            assert!(after < before || ahead[1] < ahead[0], "{room}: {finding:#?}");
        }
        assert!(found.rho.unwrap() > 2.0 && found.unexplained.ask.is_some(), "the offices are not explained");
    }
}

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
    diagnosis(&room.csv, room.model, room.binds, &Site::default(), &asked)
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
        |row: &str| row.split(',').next().unwrap().parse::<jiff::Timestamp>().unwrap().as_millisecond();
    let per_day = (DAY / (time(rows[1]) - time(rows[0]))) as usize;
    let (later, whole) = (days * per_day, rows.len() - rows.len() % per_day);
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
    let Some(csv) = beside("nl_home3/nl_home3.csv.gz") else { return };
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
