//! Measured houses: the errors of a fit beside those that another program reached on the same parts.

use super::{fit, problem, request, squares};
use lampyris::estimate::Site;

const MODEL: &str = "tite+constant_gain+direct_outdoor_loss";

/// Bacher and Madsen's FlexHouse: four days to fit, the rest unseen. Reference: 0.129 and 0.371 K2.
#[test]
fn flexhouse_is_fitted_as_well_as_by_the_reference() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data/rooms/dtu_flexhouse_prbs/flexhouse_5min.csv");
    let Ok(csv) = std::fs::read_to_string(path) else {
        println!("SKIPPED: the FlexHouse data may not be copied into the project and are not beside it");
        return;
    };
    let mut asked = request("P4D", "P0D", "PT44H55M", 11);
    asked.bounds.insert("c_constant".into(), [-1.0, 1.0]);
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=P_heater_W", "irradiance=ghi_W_m2"];
    let (train, test) = squares(&fit(&problem(&csv, MODEL, &binds, &Site::default(), &asked), &asked));
    println!("FlexHouse: train {train:.4} K2, test {test:.4} K2");
    assert!(train <= 0.129 && test <= 0.371, "{train} {test}");
}

/// The hourly house: 500 hours to fit, 292 unseen. Reference: 0.068 and 1.36 K2. Its solar term needs a place,
/// which the data do not state; latitude 51.5 and longitude 0 stand for a clock in UTC.
#[test]
fn hourly_house_is_fitted_as_well_as_by_the_reference() {
    let csv = include_str!("../../config/demo/hourly_house.csv");
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
    let csv = include_str!("../../config/demo/hourly_house.csv");
    let asked = request("PT500H", "P0D", "PT292H", 13);
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"];
    let without = "tite-metered_gain:P_heater+constant_gain+direct_outdoor_loss";
    let (train, test) = squares(&fit(&problem(csv, MODEL, &binds, &Site::default(), &asked), &asked));
    let (blind_train, blind_test) = squares(&fit(&problem(csv, without, &binds, &Site::default(), &asked), &asked));
    println!("hourly house without its heating: train {blind_train:.3}, test {blind_test:.3}; with it: {train:.3}, {test:.3} K2");
    assert!(train < 0.1 * blind_train && test < 0.3 * blind_test);
}
