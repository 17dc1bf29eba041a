//! Fits of measured houses, one folder each under `fits/`: the errors beside those that another program
//! reached on the same parts, and what the gate says.

use super::folders::{case, cases};
use super::houses::House;
use super::{fit, problem, request, squares};
use lampyris_core::estimate::{EstimateRequest, GatePolicy, Past, Site, validate};
use serde::Deserialize;
use std::collections::BTreeMap;

/// A folder's `case.toml`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    house: House,
    expect: Expected,
}

/// What must hold of a fit, as far as it is said.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Expected {
    /// Largest mean square errors of the free run, in K2: training part and test part.
    errors: Option<[f64; 2]>,
    /// What the gate says of it.
    verdict: Option<String>,
    /// Checks that fail, each with a part of what it says.
    #[serde(default)]
    failed: BTreeMap<String, String>,
}

cases!("fits", fitted, {
    bathroom_is_held
    dk_radiator_room
    flexhouse
    flexhouse_beside_the_reference
    hourly_house
    hourly_house_beside_the_reference
    laundry_is_held
    laundry_with_its_meter
    living_room_is_held
    nl_home3
    teen_room_is_held
}, full {});

fn fitted(name: &str) {
    let Case { house, expect } = case("fits", name);
    let Some(problem) = house.problem() else { return };
    let fit = fit(&problem, &house.ask);
    if let Some([most_train, most_test]) = expect.errors {
        let (train, test) = squares(&fit);
        println!("{name}: train {train:.4} K2, test {test:.4} K2");
        assert!(train <= most_train && test <= most_test, "{train} {test}");
    }
    if let Some(verdict) = expect.verdict {
        let judgement = validate(&problem, &fit, &Past::default(), &GatePolicy::default());
        println!("{name}: {}", judgement.summary);
        assert_eq!(judgement.verdict.as_str(), verdict, "{}", judgement.summary);
        for (check, says) in expect.failed {
            let found = judgement.checks.iter().find(|found| found.name == check).unwrap();
            assert!(!found.pass && found.comment.contains(&says), "{check}: {}", found.comment);
        }
    }
}

/// Giving the heating channel back cuts the unseen error of the hourly house.
#[test]
fn heating_power_explains_the_hourly_house() {
    let csv = include_str!("../../../../config/demo/hourly_house.csv");
    let asked: EstimateRequest = request("PT500H", "P0D", "PT292H", 13);
    let binds = ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"];
    let errors = |model: &str| squares(&fit(&problem(csv, model, &binds, &Site::default(), &asked), &asked));
    let (train, test) = errors("tite+constant_gain+direct_outdoor_loss");
    let (blind_train, blind_test) = errors("tite-metered_gain:P_heater+constant_gain+direct_outdoor_loss");
    println!(
        "hourly house without its heating: train {blind_train:.3}, test {blind_test:.3}; with it: \
        {train:.3}, {test:.3} K2"
    );
    assert!(train < 0.1 * blind_train && test < 0.3 * blind_test);
}
