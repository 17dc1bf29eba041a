//! A room of the thesis's kind in a Danish winter: weather, neighbours, a heat pump, and a sensor.

use crate::data::rfc3339;
use crate::data::{MINUTE, SECOND};
use crate::fault::Fault;
use crate::model::{Bindings, Catalogue, Model, ModelId, compile};
use crate::simulate::trajectory::MeasuredOutput;
use crate::simulate::{Inputs, Simulator, Stepper};
use crate::twin::dice::Dice;
use std::fmt::Write;

/// Latitude of the twin's sun.
const LATITUDE: f64 = 56.5;
/// Days before the window in which floor and envelope find their temperatures.
const WARM_UP_DAYS: usize = 5;
/// Start of every window: 2026-01-12T00:00:00Z.
const START: i64 = 1_768_176_000 * SECOND;

/// A synthetic room.
#[derive(Debug, Clone)]
pub struct RoomTwin {
    /// The measurements as CSV.
    pub csv: String,
    /// Names of the neighbours, the members of the model's set.
    pub neighbours: Vec<String>,
    /// The true parameters in the model's order; initial temperatures are those before the warm-up.
    pub theta: Vec<f64>,
}

/// Makes a room with so many neighbours, days and minutes between samples, and noise of 0.05 K.
///
/// # Errors
/// Faults of the built-in model, which its own tests exclude.
pub fn room(seed: u64, neighbours: usize, days: usize, step_minutes: usize) -> Result<RoomTwin, Vec<Fault>> {
    let mut dice = Dice::new(seed);
    let names: Vec<String> = (1..=neighbours).map(|n| n.to_string()).collect();
    let model = room3(&names)?;
    let per_day = 24 * 60 / step_minutes;
    let samples = (days + WARM_UP_DAYS) * per_day + 1;
    let columns: Vec<(String, Vec<f64>)> = weather(&mut dice, &names, samples, per_day);
    let theta: Vec<f64> =
        model.parameters().iter().map(|parameter| truth(&mut dice, &parameter.name)).collect();
    let inputs = Inputs::from_columns(
        &model,
        model
            .inputs()
            .iter()
            .map(|input| {
                columns
                    .iter()
                    .find(|(name, _)| *name == input.channel)
                    .map(|(_, values)| values.clone())
                    .unwrap_or_default()
            })
            .collect(),
        step_minutes as f64 / 60.0,
    );
    let (start, valid) = (vec![20.5; samples], vec![true; samples]);
    let measured: [MeasuredOutput; 1] = [(&start, &valid)];
    // One-minute steps of a fourth-order method: the truth owes nothing to the stepper under test.
    let simulator = Simulator::new(&model, &inputs, &measured, Stepper::Rk4, step_minutes);
    let run = simulator.run(&[&theta], samples);
    let first = WARM_UP_DAYS * per_day;
    let mut csv = String::from("time,T_room");
    columns.iter().for_each(|(name, _)| {
        let _ = write!(csv, ",{name}");
    });
    csv.push('\n');
    for k in first..samples {
        let time = START + ((k - first) * step_minutes) as i64 * MINUTE;
        let temperature = run.first().map_or(f64::NAN, |run| run.outputs[0][k]) + 0.05 * dice.normal();
        let _ = write!(csv, "{},{temperature:.4}", rfc3339(time));
        for (_, values) in &columns {
            let _ = write!(csv, ",{:.4}", values[k]);
        }
        csv.push('\n');
    }
    Ok(RoomTwin { csv, neighbours: names, theta })
}

/// The built-in room3 with a sigmoid flow and clouds.
fn room3(neighbours: &[String]) -> Result<Model, Vec<Fault>> {
    let id: ModelId =
        "room3".parse().map_err(|error| vec![Fault::new("/model", "model-id", format!("{error}"))])?;
    let mut channels: Vec<String> =
        ["T_out", "T_forward", "sun_altitude", "cloud_cover"].map(str::to_owned).to_vec();
    channels.extend(neighbours.iter().map(|n| format!("T_room_{n}")));
    let sets = [("neighbours".to_owned(), neighbours.to_vec())].into();
    compile(
        &Catalogue::builtin()?.compose(&id)?,
        &Bindings { sets, channels: Some(channels.into_iter().collect()) },
    )
}

/// A sensible value for each parameter of room3.
fn truth(dice: &mut Dice, name: &str) -> f64 {
    match name {
        "alpha_h" => dice.log_between(0.1, 1.0),
        "alpha_e" => dice.log_between(0.1, 1.5),
        "alpha_w" => dice.log_between(0.3, 2.0),
        "alpha_a" => dice.log_between(0.01, 0.2),
        "alpha_s" => dice.log_between(0.1, 1.5),
        "beta_h" => dice.log_between(2.0, 15.0),
        "beta_he" => dice.log_between(3.0, 20.0),
        "k" => dice.between(1.0, 6.0),
        "T_set" => dice.between(20.0, 22.5),
        "T_h0" => 25.0,
        "T_e0" => 18.0,
        _ => dice.log_between(0.01, 0.3),
    }
}

fn weather(dice: &mut Dice, neighbours: &[String], n: usize, per_day: usize) -> Vec<(String, Vec<f64>)> {
    let day = per_day as f64;
    let hour_angle = |k: usize| 2.0 * std::f64::consts::PI * (k as f64 / day - 0.5);
    // The sun of early February: declination -15 degrees.
    let sun: Vec<f64> = (0..n)
        .map(|k| {
            let (latitude, declination) = (LATITUDE.to_radians(), (-15f64).to_radians());
            (latitude.sin() * declination.sin() + latitude.cos() * declination.cos() * hour_angle(k).cos())
                .asin()
                .to_degrees()
        })
        .collect();
    let cloud: Vec<f64> =
        dice.wander(n, 1.2, day / 2.0).into_iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect();
    let mild = dice.between(-2.0, 6.0);
    let out: Vec<f64> = dice
        .wander(n, 3.0, 2.0 * day)
        .into_iter()
        .enumerate()
        .map(|(k, x)| mild + x + 2.5 * (hour_angle(k) - 0.7).cos())
        .collect();
    let forward: Vec<f64> =
        dice.wander(n, 1.0, day / 6.0).into_iter().zip(&out).map(|(x, out)| 36.0 - 0.6 * out + x).collect();
    let mut columns = vec![
        ("T_out".to_owned(), out),
        ("T_forward".to_owned(), forward),
        ("sun_altitude".to_owned(), sun),
        ("cloud_cover".to_owned(), cloud),
    ];
    for name in neighbours {
        let (level, phase) = (dice.between(19.0, 23.0), dice.between(0.0, 6.0));
        let wander = dice.wander(n, 0.6, day / 3.0);
        let values = wander
            .into_iter()
            .enumerate()
            .map(|(k, x)| level + x + 0.5 * (hour_angle(k) - phase).cos())
            .collect();
        columns.push((format!("T_room_{name}"), values));
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_twin_is_a_plausible_room_and_the_same_for_the_same_seed() {
        let twin = room(7, 4, 2, 30).unwrap();
        assert_eq!(twin.csv, room(7, 4, 2, 30).unwrap().csv);
        assert_ne!(twin.csv, room(8, 4, 2, 30).unwrap().csv);
        let temperatures: Vec<f64> =
            twin.csv.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse().unwrap()).collect();
        assert_eq!(temperatures.len(), 97);
        assert!(temperatures.iter().all(|t| (10.0..30.0).contains(t)), "{temperatures:?}");
    }
}
