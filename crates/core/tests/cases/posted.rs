//! Effects that a user posts and that no catalogue has: the right one is found, a wrong one is told all its
//! faults.

use super::clock::house;
use super::request;
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::diagnose::{Adequacy, diagnose, preview};
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Control, Site, prepare};
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::model::{Bindings, Catalogue, compile};
use std::collections::BTreeSet;

const VENTILATION: &str = r#"
    id = "shop_ventilation"
    title = "Ventilation of the shop"
    explain = "A fan blows outdoor air in while the shop is open, which is from noon on every second day."
    [inputs]
    T_out = { unit = "degC" }
    hour_of_day = { unit = "h", hold = "zero_order" }
    weekday = { unit = "-", hold = "zero_order" }
    [parameters]
    c_shop = { unit = "1/h", lower = 0, upper = 1, scale = "linear", nominal = 0.05 }
    [define]
    open = "max((weekday == 1), max((weekday == 3), max((weekday == 5), (weekday == 7)))) * (hour_of_day >= 12[h]) * (hour_of_day < 20[h])"
    [terms]
    T_r = "c_shop * open * (T_out - T_r)"
"#;

const IMPOSSIBLE: &str = r#"
    id = "impossible"
    title = "Impossible"
    explain = "Whatever can be wrong is wrong."
    [inputs]
    T_attic = { unit = "degC" }
    [parameters]
    c_attic = { unit = "1/h", lower = 0, upper = 1, scale = "linear", nominal = 0.05 }
    [terms]
    T_r = "c_attic * (T_attic - T_out)^2"
    T_cellar = "c_attic * (T_attic - T_r)"
"#;

/// Half-hourly samples of a room whose fan runs as posted, and no fan that the catalogue knows.
fn shop() -> Window {
    let csv = house(21, |local, out, room| {
        let weekday = local.weekday().to_monday_one_offset();
        let open = weekday % 2 == 1 && (12..20).contains(&local.hour());
        if open { 0.08 * (out - room) } else { 0.0 }
    });
    Window::parse_csv(&csv, &ColumnBindings::none()).unwrap().0
}

#[test]
fn an_effect_that_a_user_posts_is_ranked_first_and_accepted() {
    let (window, asked) = (shop(), request("P12D", "P7D", "P2D", 51));
    let site = Site { zone: Some("Europe/Copenhagen".to_owned()), ..Site::default() };
    let mut catalogue = Catalogue::builtin().unwrap();
    let problem = prepare(&catalogue, &"rc2".parse().unwrap(), &asked, &window, &site).unwrap();
    let theta = super::fit(&problem, &asked).theta();
    let without =
        diagnose(&catalogue, &problem, &theta, &window, &site, AccusationRate::USUAL, &[], &Control::NONE)
            .unwrap();
    println!("without it: {}", without.summary);
    assert!(without.rho.unwrap() > 2.0, "no effect of the catalogue explains the shop: {:?}", without.rho);
    catalogue.add_effect(EffectSpec::from_toml(VENTILATION).unwrap());
    let previews = preview(&catalogue, &problem, &theta, &window, &site).unwrap();
    assert_eq!(previews[0].effect, "shop_ventilation");
    let with =
        diagnose(&catalogue, &problem, &theta, &window, &site, AccusationRate::USUAL, &[], &Control::NONE)
            .unwrap();
    println!("with it: {}", with.summary);
    assert_eq!((with.verdict, with.findings[0].effect.as_str()), (Adequacy::Named, "shop_ventilation"));
    let coefficient = &with.findings[0].parameters["c_shop"];
    assert!((coefficient.value - 0.08).abs() < 0.005, "{}", coefficient.value);
    let [before, after] = with.findings[0].rmse.validation.unwrap();
    assert!(after < 0.3 * before, "{before} {after}");
}

#[test]
fn an_impossible_effect_is_told_all_its_faults_and_stops_no_diagnosis() {
    let (window, asked) = (shop(), request("P12D", "P7D", "P2D", 52));
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_effect(EffectSpec::from_toml(IMPOSSIBLE).unwrap());
    let composition = catalogue.compose(&"rc2+impossible".parse().unwrap()).unwrap();
    let channels: BTreeSet<String> = window.iter().map(|series| series.channel().to_owned()).collect();
    let faults =
        compile(&composition, &Bindings { channels: Some(channels), ..Bindings::default() }).unwrap_err();
    let codes: Vec<&str> = faults.iter().map(|fault| fault.code.as_ref()).collect();
    println!("{faults:#?}");
    assert!(
        ["unknown-state", "unit", "missing-channel"].iter().all(|code| codes.contains(code)),
        "{codes:?}"
    );
    let problem = prepare(&catalogue, &"rc2".parse().unwrap(), &asked, &window, &Site::default()).unwrap();
    let found = diagnose(
        &catalogue,
        &problem,
        problem.nominal(),
        &window,
        &Site::default(),
        AccusationRate::USUAL,
        &[],
        &Control::NONE,
    )
    .unwrap();
    let told = found.not_testable.iter().find(|one| one.effect == "impossible").unwrap();
    for part in ["T_cellar", "T_attic"] {
        assert!(told.reason.contains(part), "{}", told.reason);
    }
}
