//! Measured houses from which an effect is withheld: the diagnosis names it, and given back the error falls.

use super::{fit, request};
use lampyris::data::{Bindings, Window};
use lampyris::diagnose::{Diagnosis, diagnose};
use lampyris::estimate::{Control, EstimateRequest, Site, prepare};
use lampyris::model::{Catalogue, ModelId};

/// The diagnosis of a model on a house.
fn diagnosis(csv: &str, model: &str, binds: &[&str], site: &Site, asked: &EstimateRequest) -> Diagnosis {
    let (window, _) = Window::parse_csv(csv, &Bindings::parse(binds.iter().copied()).unwrap()).unwrap();
    let (catalogue, id): (Catalogue, ModelId) = (Catalogue::builtin().unwrap(), model.parse().unwrap());
    let problem = prepare(&catalogue, &id, asked, &window, site).unwrap();
    let found = fit(&problem, asked);
    let problem = problem.with_substeps(found.substeps);
    let diagnosis = diagnose(&catalogue, &problem, &found.theta(), &window, site, &Control::NONE).unwrap();
    println!("{model}: {}", diagnosis.summary);
    diagnosis
}

/// Appliances warm the laundry of the Belgian house: fitted on a week, judged on the next.
#[test]
fn the_laundry_is_missing_its_appliances() {
    let csv = include_str!("../../config/demo/belgian_house.csv");
    let mut asked = request("P7D", "P6D", "P0D", 31);
    asked.window = serde_json::from_value(serde_json::json!({ "from": "2016-02-23T00:00:00Z", "to": "2016-03-06T23:50:00Z" })).unwrap();
    let binds = ["T_room=T_laundry", "irradiance=irradiance_clear_sky"];
    let found = diagnosis(csv, "room2", &binds, &Site::default(), &asked);
    assert_eq!(found.findings[0].effect, "metered_gain:P_appliances", "{}", found.summary);
    let [before, after] = found.findings[0].rmse.validation_ahead["PT24H"];
    println!("a day ahead: {before:.3} -> {after:.3} K");
    assert!(after < 0.8 * before, "{before} {after}");
}

/// The hourly house without its heating channel.
#[test]
fn the_hourly_house_is_missing_its_heating() {
    let csv = include_str!("../../config/demo/hourly_house.csv");
    let asked = request("PT500H", "PT292H", "P0D", 32);
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"];
    let found = diagnosis(csv, "rc2+constant_gain+direct_outdoor_loss", &binds, &Site::default(), &asked);
    assert_eq!(found.findings[0].effect, "metered_gain:P_heater", "{}", found.summary);
    let [before, after] = found.findings[0].rmse.validation.unwrap();
    assert!(after < 0.5 * before, "{before} {after}");
}

/// The FlexHouse without the sun.
#[test]
fn the_flexhouse_is_missing_its_sun() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data/rooms/dtu_flexhouse_prbs/flexhouse_5min.csv");
    let Ok(csv) = std::fs::read_to_string(path) else {
        println!("SKIPPED: the FlexHouse data may not be copied into the project and are not beside it");
        return;
    };
    let asked = request("P4D", "PT44H", "P0D", 33);
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=P_heater_W", "irradiance=ghi_W_m2"];
    let found = diagnosis(&csv, "tite-solar_gain+constant_gain+direct_outdoor_loss", &binds, &Site::default(), &asked);
    assert_eq!(found.findings[0].effect, "solar_gain", "{}", found.summary);
    let [before, after] = found.findings[0].rmse.validation.unwrap();
    assert!(after < 0.6 * before, "{before} {after}");
}

/// Nothing in the log helps the bathroom: no effect may be accused.
#[test]
fn the_bathroom_has_nothing_to_find_in_its_log() {
    let csv = include_str!("../../config/demo/belgian_house.csv");
    let asked = request("P14D", "P7D", "P7D", 34);
    let binds = ["T_room=T_bathroom", "irradiance=irradiance_clear_sky"];
    let found = diagnosis(csv, "room2", &binds, &Site::default(), &asked);
    assert!(found.findings.is_empty(), "{}", found.summary);
}
