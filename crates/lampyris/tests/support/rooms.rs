//! Measurements of a small synthetic room.

/// Half-hourly measurements of a room that follows the model `rc2`, with a little noise.
pub fn room_csv(seed: u64, days: usize) -> String {
    csv_of(&room(seed, days))
}

/// Samples as an upload.
pub fn csv_of(samples: &[(String, f64, f64)]) -> String {
    let mut text = "time,T_room[degC],T_out[degC]\n".to_owned();
    for (time, room, out) in samples {
        text.push_str(&format!("{time},{room:.3},{out:.3}\n"));
    }
    text
}

/// Half of that record again, with a sensor that hangs: no verdict can be given on such data.
pub fn stuck_csv() -> String {
    let mut text = "time,T_room[degC],T_out[degC]\n".to_owned();
    for (time, _, out) in room(1, 14).into_iter().skip(300) {
        text.push_str(&format!("{time},19.0,{out:.3}\n"));
    }
    text
}

/// The same samples as numbers: time, room, outdoors.
pub fn room(seed: u64, days: usize) -> Vec<(String, f64, f64)> {
    room_that_changes(seed, days, |_| 0.15)
}

/// The same room, whose loss to the outdoors in 1/h changes from day to day.
pub fn room_that_changes(seed: u64, days: usize, alpha_a: impl Fn(usize) -> f64) -> Vec<(String, f64, f64)> {
    let (alpha_e, beta_e) = (0.8, 4.0);
    let start: jiff::Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut noise = || {
        // A sum of uniform numbers of a small generator is normal enough.
        let mut sum = 0.0;
        for _ in 0..4 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5;
        }
        sum
    };
    let mut front = 0.0;
    let outdoors: Vec<f64> = (0..=days * 48)
        .map(|step| {
            let hour = step as f64 / 2.0;
            front += 0.4 * noise() - 0.01 * front;
            5.0 + 6.0 * (hour * std::f64::consts::TAU / 24.0).sin() + 3.0 * (hour / 37.0).sin() + 2.0 * front
        })
        .collect();
    let (mut t_r, mut t_e) = (15.0, 14.0);
    let mut rows = Vec::new();
    for (step, pair) in outdoors.windows(2).enumerate() {
        let time = start + jiff::SignedDuration::from_mins(30 * step as i64);
        rows.push((time.to_string(), t_r + 0.03 * noise(), pair[0]));
        // Small steps of Euler's method, with the weather on a straight line between its samples.
        for part in 0..60 {
            let out = pair[0] + (pair[1] - pair[0]) * f64::from(part) / 60.0;
            let dt = 0.5 / 60.0;
            let rate_r = alpha_e * (t_e - t_r);
            let rate_e = alpha_e / beta_e * (t_r - t_e) + alpha_a(step / 48) * (out - t_e);
            (t_r, t_e) = (t_r + dt * rate_r, t_e + dt * rate_e);
        }
    }
    rows
}
