//! The models of Bacher and Madsen (2011) beside their equations, written out by hand, and on the house of
//! the paper.

use super::houses::beside;
use super::{fit, problem, request, squares};
use lampyris_core::estimate::Site;
use std::collections::BTreeMap;
use std::fmt::Write;

/// What the equations are driven by: a straight line between hours, and power that holds over each.
struct Weather {
    out: Vec<f64>,
    sun: Vec<f64>,
    power: Vec<f64>,
}

const HOURS: usize = 72;

fn weather() -> Weather {
    let hour = |k: usize| k as f64;
    Weather {
        out: (0..=HOURS).map(|k| 4.0 + 6.0 * (hour(k) * 0.26).sin()).collect(),
        sun: (0..=HOURS).map(|k| (600.0 * ((hour(k) - 7.0) * 0.262).sin()).max(0.0)).collect(),
        power: (0..=HOURS).map(|k| if (k * 7 / 5) % 3 == 0 { 1.5 } else { 0.0 }).collect(),
    }
}

/// The temperatures of interior, heater and envelope per hour by the classical Runge-Kutta method with steps
/// of two seconds. A model without heater or envelope leaves that state where it is.
fn by_hand(model: &str, value: &BTreeMap<&str, f64>, weather: &Weather) -> Vec<f64> {
    let of = |name: &str| value.get(name).copied().unwrap_or(f64::NAN);
    let (heater, envelope) = (model.ends_with("th"), model.contains("te"));
    let rate = |x: [f64; 3], out: f64, sun: f64, power: f64| {
        let [t_i, t_h, t_e] = x;
        let mut d_i = of("c_solar") * sun / 1000.0;
        let (mut d_h, mut d_e) = (0.0, 0.0);
        if heater {
            d_i += of("alpha_h") * (t_h - t_i);
            d_h = of("alpha_h") / of("beta_h") * (t_i - t_h) + of("c_heater") * power;
        } else {
            d_i += of("c_P_heater") * power;
        }
        if envelope {
            d_i += of("alpha_e") * (t_e - t_i);
            d_e = of("alpha_e") / of("beta_e") * (t_i - t_e) + of("alpha_a") * (out - t_e);
        } else {
            d_i += of("alpha_a") * (out - t_i);
        }
        [d_i, d_h, d_e]
    };
    let mut x = [20.0, value.get("T_h0").copied().unwrap_or(0.0), value.get("T_e0").copied().unwrap_or(0.0)];
    let mut room = vec![x[0]];
    let parts = 1800;
    let h = 1.0 / f64::from(parts);
    for k in 0..HOURS {
        for part in 0..parts {
            let at = |offset: f64| (f64::from(part) + offset) * h;
            let line = |series: &[f64], offset: f64| series[k] + (series[k + 1] - series[k]) * at(offset);
            let f = |x: [f64; 3], offset: f64| {
                rate(x, line(&weather.out, offset), line(&weather.sun, offset), weather.power[k])
            };
            let moved = |slope: [f64; 3], step: f64| {
                [x[0] + step * slope[0], x[1] + step * slope[1], x[2] + step * slope[2]]
            };
            let a = f(x, 0.0);
            let b = f(moved(a, h / 2.0), 0.5);
            let c = f(moved(b, h / 2.0), 0.5);
            let d = f(moved(c, h), 1.0);
            for i in 0..3 {
                x[i] += h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]);
            }
        }
        room.push(x[0]);
    }
    room
}

#[test]
fn the_family_means_the_equations_of_the_paper() {
    let weather = weather();
    let mut csv = "time,T_room[degC],T_out[degC],irradiance[W/m2],P_heater[kW]\n".to_owned();
    let start: jiff::Timestamp = "2026-02-01T00:00:00Z".parse().unwrap();
    for k in 0..=HOURS {
        let time = start + jiff::SignedDuration::from_hours(k as i64);
        writeln!(csv, "{time},20,{},{},{}", weather.out[k], weather.sun[k], weather.power[k]).unwrap();
    }
    let names = [
        "alpha_h",
        "alpha_e",
        "alpha_a",
        "beta_h",
        "beta_e",
        "c_heater",
        "c_P_heater",
        "c_solar",
        "T_h0",
        "T_e0",
    ];
    let values = [0.9, 0.6, 0.12, 0.08, 4.0, 25.0, 2.2, 1.7, 24.0, 15.0];
    for model in ["ti", "tith", "tite", "titeth"] {
        let problem =
            problem(&csv, model, &[], &Site::default(), &request("P4D", "P0D", "P0D", 1)).with_substeps(120);
        let used = |name: &&str| problem.model().parameters().iter().any(|parameter| parameter.name == *name);
        let value: BTreeMap<&str, f64> =
            names.iter().copied().zip(values).filter(|(name, _)| used(name)).collect();
        let theta: Vec<f64> =
            problem.model().parameters().iter().map(|parameter| value[parameter.name.as_str()]).collect();
        assert!(problem.model().dropped().is_empty());
        let (ours, theirs) = (problem.simulate(&theta).outputs[0].clone(), by_hand(model, &value, &weather));
        assert_eq!(ours.len(), theirs.len());
        let worst = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("{model}: {} parameters, worst difference {worst:.1e} K", theta.len());
        assert!(worst < 1e-5, "{model}: {worst}");
    }
}

/// The house of the paper: every state that is added lowers the error on the training part.
#[test]
fn flexhouse_gains_from_every_state_of_the_family() {
    let Some(csv) = beside("dtu_flexhouse_prbs/flexhouse_5min.csv") else { return };
    let asked = request("P4D", "P0D", "PT44H55M", 11);
    let binds =
        ["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=P_heater_W", "irradiance=ghi_W_m2"];
    let error = |model: &str| {
        let (train, test) = squares(&fit(&problem(&csv, model, &binds, &Site::default(), &asked), &asked));
        println!("FlexHouse, {model}: train {train:.4} K2, test {test:.4} K2");
        train
    };
    let (ti, tith, tite, titeth) = (error("ti"), error("tith"), error("tite"), error("titeth"));
    assert!(
        tite < 0.9 * ti && titeth < tite && tith <= 1.001 * ti && titeth < tith,
        "{ti} {tith} {tite} {titeth}"
    );
}
