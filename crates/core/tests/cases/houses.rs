//! Measured houses: the errors of a fit beside those that another program reached on the same parts.

use super::{fit, problem, request, squares};
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{EstimateRequest, GatePolicy, Judgement, Past, Site, Verdict};
use std::io::Read;

const MODEL: &str = "tite+constant_gain+direct_outdoor_loss";

/// Bacher and Madsen's FlexHouse: four days to fit, the rest unseen. Reference: 0.129 and 0.371 K2.
#[test]
fn flexhouse_is_fitted_as_well_as_by_the_reference() {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../../shared/data/rooms/dtu_flexhouse_prbs/flexhouse_5min.csv"
    );
    let Ok(csv) = std::fs::read_to_string(path) else {
        println!("SKIPPED: the FlexHouse data may not be copied into the project and are not beside it");
        return;
    };
    let mut asked = request("P4D", "P0D", "PT44H55M", 11);
    asked.bounds.insert("c_constant".into(), [-1.0, 1.0]);
    let binds =
        ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=P_heater_W", "irradiance=ghi_W_m2"];
    let (train, test) = squares(&fit(&problem(&csv, MODEL, &binds, &Site::default(), &asked), &asked));
    println!("FlexHouse: train {train:.4} K2, test {test:.4} K2");
    assert!(train <= 0.129 && test <= 0.371, "{train} {test}");
}

/// The hourly house: 500 hours to fit, 292 unseen. Reference: 0.068 and 1.36 K2. Its solar term needs a
/// place, which the data do not state; latitude 51.5 and longitude 0 stand for a clock in UTC.
#[test]
fn hourly_house_is_fitted_as_well_as_by_the_reference() {
    let csv = include_str!("../../../../config/demo/hourly_house.csv");
    let mut asked = request("PT500H", "P0D", "PT292H", 12);
    asked.bounds.insert("c_constant".into(), [-1.0, 1.0]);
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"];
    let site = Site { location: Some((51.5, 0.0)), ..Site::default() };
    let (train, test) = squares(&fit(&problem(csv, MODEL, &binds, &site, &asked), &asked));
    println!("hourly house: train {train:.4} K2, test {test:.4} K2");
    assert!(train <= 0.068 && test <= 1.36, "{train} {test}");
}

/// Giving the heating channel back cuts the unseen error of the hourly house.
#[test]
fn heating_power_explains_the_hourly_house() {
    let csv = include_str!("../../../../config/demo/hourly_house.csv");
    let asked = request("PT500H", "P0D", "PT292H", 13);
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"];
    let without = "tite-metered_gain:P_heater+constant_gain+direct_outdoor_loss";
    let (train, test) = squares(&fit(&problem(csv, MODEL, &binds, &Site::default(), &asked), &asked));
    let (blind_train, blind_test) =
        squares(&fit(&problem(csv, without, &binds, &Site::default(), &asked), &asked));
    println!(
        "hourly house without its heating: train {blind_train:.3}, test {blind_test:.3}; with it: \
        {train:.3}, {test:.3} K2"
    );
    assert!(train < 0.1 * blind_train && test < 0.3 * blind_test);
}

/// What the gate says of a fit of the newest part of a record.
fn judged(csv: &str, model: &str, binds: &[&str], asked: &EstimateRequest) -> Judgement {
    let problem = problem(csv, model, binds, &Site::default(), asked);
    validate(&problem, &fit(&problem, asked), &Past::default(), &GatePolicy::default())
}

/// A room of the data that lie beside the project, packed or not.
pub(super) fn beside(path: &str) -> Option<String> {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/rooms").join(path);
    let bytes = std::fs::read(path).ok()?;
    let mut text = String::new();
    match bytes.starts_with(&[0x1f, 0x8b]) {
        true => flate2::read::GzDecoder::new(bytes.as_slice()).read_to_string(&mut text).ok()?,
        false => bytes.as_slice().read_to_string(&mut text).ok()?,
    };
    Some(text)
}

/// A name, its measurements, where they are there, a model, what it binds and what is asked.
type House<'a> = (&'a str, Option<String>, &'a str, &'a [&'a str], &'a EstimateRequest);

/// Houses whose heating was logged are served.
#[test]
fn houses_whose_heating_was_logged_are_accepted() {
    let usual = EstimateRequest::default();
    let mut hourly = usual.clone();
    hourly.bounds.insert("c_P_heater".to_owned(), [0.0, 0.05]);
    let dutch = ["T_room=T_room_degC", "T_out=T_out_degC", "irradiance=irradiance_W_m2"];
    let hourly_house = include_str!("../../../../config/demo/hourly_house.csv").to_owned();
    let belgian = include_str!("../../../../config/demo/belgian_house.csv").to_owned();
    let flexhouse =
        ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=P_heater_W", "irradiance=ghi_W_m2"];
    let radiator = [
        "T_room=T_room_degC",
        "T_out=T_out_degC",
        "irradiance=irradiance_W_m2",
        "T_forward=T_radiator_supply_pipe_degC",
    ];
    // Six days of FlexHouse hold two unseen ones only where fewer are learnt from.
    let short = request("PT84H", "PT56H", "P0D", 1);
    let houses: [House; 5] = [
        (
            "hourly house",
            Some(hourly_house),
            "tite",
            &["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"],
            &hourly,
        ),
        (
            "laundry with its meter",
            Some(belgian),
            "rc2+solar_gain+metered_gain:P_appliances",
            &["T_room=T_laundry", "irradiance=irradiance_clear_sky"],
            &usual,
        ),
        ("FlexHouse", beside("dtu_flexhouse_prbs/flexhouse_5min.csv"), "tite", &flexhouse, &short),
        (
            "nl_home3",
            beside("nl_home3/nl_home3.csv.gz"),
            "rc2+solar_gain+constant_gain+companion:T_heating_water_0off",
            &dutch,
            &usual,
        ),
        (
            "dk_radiator_room",
            beside("dk_radiator_room/dk_radiator_room.csv.gz"),
            "rc2+solar_gain+companion:T_forward",
            &radiator,
            &usual,
        ),
    ];
    let mut held = Vec::new();
    for (name, csv, model, binds, asked) in houses {
        let Some(csv) = csv else {
            println!("SKIPPED: the data of {name} are not beside the project");
            continue;
        };
        let judgement = judged(&csv, model, binds, asked);
        println!("{name}: {}", judgement.summary);
        if !matches!(judgement.verdict, Verdict::Accepted(_)) {
            held.push(format!("{name}: {}", judgement.summary));
        }
    }
    assert!(held.is_empty(), "{held:#?}");
}

/// Rooms of which nothing useful was logged are held, by a sentence that says so.
#[test]
fn rooms_of_which_nothing_useful_was_logged_are_held() {
    let csv = include_str!("../../../../config/demo/belgian_house.csv");
    for room in ["T_laundry", "T_living_room", "T_teen_room", "T_bathroom"] {
        let binds = [format!("T_room={room}"), "irradiance=irradiance_clear_sky".to_owned()];
        let binds: Vec<&str> = binds.iter().map(String::as_str).collect();
        let judgement = judged(csv, "room2", &binds, &EstimateRequest::default());
        println!("{room}: {}", judgement.summary);
        assert!(matches!(judgement.verdict, Verdict::Held(_)), "{room}: {}", judgement.summary);
        let own_past = judgement.checks.iter().find(|check| check.name == "G10 beats its own past").unwrap();
        assert!(!own_past.pass && own_past.comment.contains("daily profile"), "{room}: {}", own_past.comment);
    }
}
