//! People who follow the clock on the wall, in a fortnight in which summer time begins.

use super::{fit, request};
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::{Site, prepare};
use lampyris_core::model::Catalogue;
use lampyris_core::model::spec::EffectSpec;
use std::fmt::Write;

const OFFICE: &str = r#"
    id = "office_hours"
    title = "Office hours"
    explain = "People warm the room on working days."
    [inputs]
    hour_of_day = { unit = "h", hold = "zero_order" }
    weekday = { unit = "-", hold = "zero_order" }
    [parameters]
    c_office = { unit = "K/h", lower = 0, upper = 3, scale = "linear", nominal = 0.2 }
    [terms]
    T_r = "c_office * (weekday <= 5) * (hour_of_day >= 8[h]) * (hour_of_day < 17[h])"
"#;

/// Half-hourly samples of a room that is warmed by `gain` in office hours of Copenhagen.
fn office(gain: f64) -> String {
    house(16, |local, _, _| {
        let working = local.weekday().to_monday_one_offset() <= 5 && (8..17).contains(&local.hour());
        if working { gain } else { 0.0 }
    })
}

/// Half-hourly samples of a room that `heat` warms, in K/h, by the time in Copenhagen, the outdoor and the
/// room temperature.
pub fn house(days: i64, heat: impl Fn(&jiff::Zoned, f64, f64) -> f64) -> String {
    let (alpha_e, beta_e, alpha_a) = (0.8, 4.0, 0.15);
    let start: jiff::Timestamp = "2026-03-20T00:00:00Z".parse().unwrap();
    let out = |hour: f64| 6.0 + 5.0 * (hour * std::f64::consts::TAU / 24.0).sin() + 3.0 * (hour / 41.0).sin();
    let (mut t_r, mut t_e) = (15.0f64, 14.0f64);
    let mut text = "time,T_room,T_out\n".to_owned();
    for step in 0..days * 48 {
        let time = start + jiff::SignedDuration::from_mins(30 * step);
        let local = time.in_tz("Europe/Copenhagen").unwrap();
        let hour = 0.5 * step as f64;
        writeln!(text, "{time},{t_r:.4},{:.4}", out(hour)).unwrap();
        let (from, to) = (out(hour), out(hour + 0.5));
        let rate = |t: f64, r: f64, e: f64| {
            let outdoors = from + (to - from) * t / 0.5;
            (
                alpha_e * (e - r) + heat(&local, outdoors, r),
                alpha_e / beta_e * (r - e) + alpha_a * (outdoors - e),
            )
        };
        // The classical Runge-Kutta method with steps of a minute.
        let h = 0.5 / 30.0;
        for part in 0..30 {
            let t = h * f64::from(part);
            let (a, b) = rate(t, t_r, t_e);
            let (c, d) = rate(t + h / 2.0, t_r + h / 2.0 * a, t_e + h / 2.0 * b);
            let (e, f) = rate(t + h / 2.0, t_r + h / 2.0 * c, t_e + h / 2.0 * d);
            let (g, i) = rate(t + h, t_r + h * e, t_e + h * f);
            t_r += h / 6.0 * (a + 2.0 * c + 2.0 * e + g);
            t_e += h / 6.0 * (b + 2.0 * d + 2.0 * f + i);
        }
    }
    text
}

#[test]
fn people_are_found_by_the_local_clock() {
    let asked = request("P11D", "P5D", "P0D", 41);
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_effect(EffectSpec::from_toml(OFFICE).unwrap());
    let (window, _) = Window::parse_csv(&office(0.9), &ColumnBindings::none()).unwrap();
    let model = "rc2+office_hours".parse().unwrap();
    let fitted = |zone: &str| {
        let site = Site { zone: Some(zone.to_owned()), ..Site::default() };
        fit(&prepare(&catalogue, &model, &asked, &window, &site).unwrap(), &asked)
    };
    let (right, wrong) = (fitted("Europe/Copenhagen"), fitted("America/New_York"));
    let error = |fit: &lampyris_core::estimate::Fit| fit.first_metrics().unwrap().validation_rmse.unwrap();
    let gain = right.parameters["c_office"].value;
    println!(
        "gain {gain:.3} K/h; validation {:.4} K by the local clock, {:.4} K by another",
        error(&right),
        error(&wrong)
    );
    assert!((gain - 0.9).abs() < 0.01 && error(&right) < 0.01, "{gain} {}", error(&right));
    assert!(error(&wrong) > 10.0 * error(&right));
    let nowhere = Site { zone: Some("Nowhere".into()), ..Site::default() };
    assert_eq!(prepare(&catalogue, &model, &asked, &window, &nowhere).unwrap_err()[0].code, "unknown-zone");
}
