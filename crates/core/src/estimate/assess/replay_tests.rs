//! Stored fits that are run again: against what was stored, and against plain sums.

use super::compare::{Contender, FREE_RUN, Over, compare};
use super::comparison::{ComparisonMode, comparison};
use super::metrics::lead;
use super::replay::{Part, Replay};
use super::skill::{Skill, by_horizon, by_part};
use crate::data::{DAY, Duration, HOUR, Hold, MINUTE, SECOND, Series, SplitRequest, Window, rfc3339};
use crate::estimate::problem::request::{EstimateRequest, Site, WindowRange};
use crate::estimate::{Control, Fit, estimate, prepare};
use crate::interrupt::Brake;
use crate::model::{Catalogue, ModelId};

const START: i64 = 1_767_225_600 * SECOND;

/// A room without heating, measured every `step` seconds give or take half a minute; the weather comes every
/// half hour at five past. Between `gap` days there is no weather.
fn window(days: i64, step: i64, gap: std::ops::Range<f64>) -> Window {
    let mut state = 7u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
    };
    let outdoors = |time: i64| {
        let hour = (time - START) as f64 / HOUR as f64;
        5.0 + 6.0 * (hour * std::f64::consts::TAU / 24.0).sin() + 3.0 * (hour / 37.0).sin()
    };
    let (mut t_r, mut t_e) = (15.0, 14.0);
    let (mut times, mut values) = (Vec::new(), Vec::new());
    for time in (START..START + days * DAY).step_by(MINUTE as usize) {
        if (time - START) % (step * SECOND) == 0 {
            times.push(time + (noise() * 50.0) as i64 * SECOND);
            values.push(t_r + 0.1 * noise());
        }
        let rates = (0.8 * (t_e - t_r), 0.2 * (t_r - t_e) + 0.15 * (outdoors(time) - t_e));
        (t_r, t_e) = (t_r + rates.0 / 60.0, t_e + rates.1 / 60.0);
    }
    let weather = (START + 5 * MINUTE..START + days * DAY)
        .step_by(30 * MINUTE as usize)
        .filter(|time| !gap.contains(&((time - START) as f64 / DAY as f64)));
    let weather: Vec<i64> = weather.collect();
    let outdoors: Vec<f64> = weather.iter().map(|time| outdoors(*time)).collect();
    let room = Series::new("T_room", "degC", Hold::Linear, times, values).unwrap();
    Window::from_series(vec![room, Series::new("T_out", "degC", Hold::Linear, weather, outdoors).unwrap()])
        .unwrap()
}

const NO_GAP: std::ops::Range<f64> = 0.0..0.0;

fn model() -> ModelId {
    "rc2".parse().unwrap()
}

fn request(range: WindowRange) -> EstimateRequest {
    let split = SplitRequest {
        train: Duration::from_days(5),
        validation: Duration::from_days(3),
        test: Some(Duration::from_days(2)),
    };
    let method = serde_json::from_str(r#"{"name": "lm_multistart"}"#).unwrap();
    let budget = crate::estimate::problem::request::Budget { evaluations: 200, wall: None };
    EstimateRequest { window: Some(range), split, method, budget, ..EstimateRequest::default() }
}

/// A fit as it comes back from where it was stored.
fn stored(window: &Window, range: WindowRange) -> Fit {
    let request = request(range);
    let problem =
        prepare(&Catalogue::builtin().unwrap(), &model(), &request, window, &Site::default()).unwrap();
    let fit = estimate(&problem, &request, None, &Control::NONE).unwrap();
    serde_json::from_str(&serde_json::to_string(&fit).unwrap()).unwrap()
}

fn replay(fit: &Fit, window: &Window, until: Option<i64>) -> Replay {
    Replay::new(&Catalogue::builtin().unwrap(), fit, window, until, &Brake::NONE).unwrap()
}

/// The window of the fit begins in the middle of the record, where no sample lies on a grid point.
fn middle() -> WindowRange {
    WindowRange {
        last: None,
        from: Some(rfc3339(START + 3 * DAY + 7 * HOUR)),
        to: Some(rfc3339(START + 15 * DAY)),
    }
}

fn root_mean_square(residuals: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = residuals.fold((0.0, 0.0), |(n, sum), e| (n + 1.0, sum + e * e));
    (sum / n).sqrt()
}

#[test]
fn the_stored_errors_come_out_of_what_is_shown() {
    let record = window(20, 900, NO_GAP);
    let fit = stored(&record, middle());
    let metrics = fit.first_metrics().unwrap();
    // Nothing asked, and asked for more than the fit has seen: the run over its own window is the same.
    for until in [None, Some(START + 19 * DAY)] {
        let replay = replay(&fit, &record, until);
        assert!(
            replay.provenance().reproduced && !replay.provenance().measurements_changed,
            "{:?}",
            replay.provenance()
        );
        let free_run = comparison(&replay, ComparisonMode::FreeRun, i64::MIN / 2, i64::MAX / 2).unwrap();
        let residual = free_run.outputs["T_room"].residual();
        for (part, stored) in [
            (Part::Train, Some(metrics.train_rmse)),
            (Part::Validation, metrics.validation_rmse),
            (Part::Test, metrics.test_rmse),
        ] {
            let shown = root_mean_square(residual[replay.range(part)].iter().flatten().copied());
            assert!((shown / stored.unwrap() - 1.0).abs() < 1e-9, "{part:?}: {shown} {stored:?}");
            assert!((free_run.errors["T_room"].parts[&part].rmse / stored.unwrap() - 1.0).abs() < 1e-9);
        }
        for (name, stored) in &metrics.ahead {
            let seconds = name.parse::<Duration>().unwrap().millis();
            let samples = lead(seconds, fit.sample_s.millis()).unwrap();
            let ahead =
                comparison(&replay, ComparisonMode::Ahead(samples), i64::MIN / 2, i64::MAX / 2).unwrap();
            let residual = ahead.outputs["T_room"].residual();
            let part = replay.range(Part::Validation);
            let shown = root_mean_square(residual[part.start + samples..part.end].iter().flatten().copied());
            assert!((shown / stored.rmse - 1.0).abs() < 1e-9, "{name}: {shown} {}", stored.rmse);
            assert_eq!(ahead.errors["T_room"].parts[&Part::Validation].n, stored.n);
            let skill = &by_horizon(&replay, Part::Validation)["T_room"];
            let skill = skill.iter().find(|skill| skill.horizon == *name).unwrap();
            assert_eq!(skill.skill.n, stored.n);
            assert!((skill.persistence_rmse.unwrap() / stored.persistence - 1.0).abs() < 1e-12);
        }
        let parts = &by_part(&replay)["T_room"];
        assert!((parts.test.unwrap().rmse / metrics.test_rmse.unwrap() - 1.0).abs() < 1e-9);
        assert_eq!(replay.range(Part::After).is_empty(), until.is_none());
    }
}

#[test]
fn a_run_goes_on_over_newer_measurements_from_where_it_was() {
    let record = window(20, 900, NO_GAP);
    let fit = stored(&record, middle());
    let (own, longer) = (replay(&fit, &record, None), replay(&fit, &record, Some(START + 18 * DAY)));
    let (first, all) = (own.free_run(0), longer.free_run(0));
    assert_eq!(all[..first.len()], first[..]);
    assert!(all.len() > first.len() + 250 && all.last().unwrap().is_some());
    // A piece of the middle shows the same numbers at the same times.
    let (from, to) = (START + 10 * DAY, START + 11 * DAY);
    let piece = comparison(&longer, ComparisonMode::FreeRun, from, to).unwrap();
    let grid = longer.problem().grid();
    let place = (0..grid.len()).position(|k| grid.time(k) == piece.start).unwrap();
    assert!(piece.start >= from && piece.start < from + 15 * MINUTE);
    assert_eq!(piece.outputs["T_room"].simulated[..], all[place..place + 96]);
    assert_eq!(piece.parts.iter().map(|span| span.part).collect::<Vec<_>>(), [Part::Validation]);
    let nothing = comparison(&longer, ComparisonMode::FreeRun, START, START + DAY).unwrap_err();
    assert_eq!(nothing[0].code, "no-data-in-range");
}

#[test]
fn what_has_changed_since_is_said() {
    let record = window(20, 900, NO_GAP);
    let fit = stored(&record, middle());
    let mut series: Vec<Series> = record.iter().cloned().collect();
    // A new channel that the model could use is none of the fit's business.
    let irradiance =
        Series::new("irradiance", "W/m2", Hold::Linear, vec![START, START + 20 * DAY], vec![0.0, 500.0])
            .unwrap();
    series.push(irradiance);
    let more = Window::from_series(series.clone()).unwrap();
    assert!(!replay(&fit, &more, None).provenance().measurements_changed);
    // One sample of the fit's window that was corrected is.
    let room = &series[0];
    let mut values = room.values().to_vec();
    values[900] += 5.0;
    series[0] = Series::new("T_room", "degC", Hold::Linear, room.times().to_vec(), values).unwrap();
    let corrected = Window::from_series(series.clone()).unwrap();
    let provenance = replay(&fit, &corrected, None).provenance().clone();
    assert!(
        provenance.measurements_changed
            && !provenance.model_changed
            && provenance.comment.contains("newer uploads"),
        "{provenance:?}"
    );
    assert_ne!(provenance.input_hash, provenance.fit_input_hash);
    // A channel that is gone, and a fit that does not say what it was made from.
    let catalogue = Catalogue::builtin().unwrap();
    let gone = Replay::new(
        &catalogue,
        &fit,
        &Window::from_series(series[..1].to_vec()).unwrap(),
        None,
        &Brake::NONE,
    )
    .unwrap_err();
    assert_eq!(gone[0].code, "missing-channel");
    let old = Replay::new(&catalogue, &Fit { basis: None, ..fit.clone() }, &record, None, &Brake::NONE)
        .unwrap_err();
    assert_eq!(old[0].code, "outdated-fit");
    let mut renamed = fit;
    let (_, value) = renamed.parameters.shift_remove_index(0).unwrap();
    renamed.parameters.shift_insert(0, "alpha_x".into(), value);
    assert_eq!(
        Replay::new(&catalogue, &renamed, &record, None, &Brake::NONE).unwrap_err()[0].code,
        "model-changed"
    );
}

#[test]
fn nothing_is_shown_behind_a_gap() {
    let record = window(20, 900, 8.0..8.5);
    let fit = stored(&record, middle());
    let replay = replay(&fit, &record, None);
    let shown = comparison(&replay, ComparisonMode::FreeRun, i64::MIN / 2, i64::MAX / 2).unwrap();
    let lines = &shown.outputs["T_room"];
    let missing = lines.simulated.iter().filter(|value| value.is_none()).count();
    // Half a day of quarter hours, and the half hours around it that no line may cross.
    assert!((48..=56).contains(&missing), "{missing}");
    assert_eq!(shown.inputs["T_out"].values.iter().filter(|value| value.is_none()).count(), missing - 1);
    assert!(
        lines
            .residual()
            .iter()
            .zip(&lines.simulated)
            .all(|(residual, simulated)| residual.is_some() <= simulated.is_some())
    );
    assert!(lines.measured.iter().all(Option::is_some));
    assert!(replay.provenance().reproduced);
}

#[test]
fn fits_are_compared_on_the_samples_that_all_have() {
    let (fine, coarse) = (window(20, 900, NO_GAP), window(20, 1_800, 9.0..9.25));
    let first = stored(&fine, middle());
    let later =
        WindowRange { last: None, from: Some(rfc3339(START + 6 * DAY)), to: Some(rfc3339(START + 18 * DAY)) };
    let second = stored(&coarse, later);
    let until = Some(START + 19 * DAY);
    let (a, b) = (replay(&first, &fine, until), replay(&second, &coarse, until));
    let contenders = [Contender { id: "a", replay: &a }, Contender { id: "b", replay: &b }];
    let (from, to) = (START + 8 * DAY + 1, START + 18 * DAY);
    let compared = compare(&contenders, None, from, to).unwrap();
    // The axis is the coarse one; the fine fit is read off between its samples, the errors by hand.
    let grid = b.problem().grid();
    assert_eq!(compared.step, 30 * MINUTE);
    let output = &compared.outputs["T_room"];
    let mine = a.problem().grid();
    let axis: Vec<i64> =
        (0..grid.len()).map(|k| grid.time(k)).filter(|time| (from..=to).contains(time)).collect();
    assert_eq!((axis[0], axis.len()), (compared.start, output.measured.len()));
    let run = a.free_run(0);
    let read = |time: i64| {
        let k = (time - mine.start()).div_euclid(15 * MINUTE) as usize;
        let way = (time - mine.time(k)) as f64 / (15 * MINUTE) as f64;
        run[k].unwrap() * (1.0 - way) + run[k + 1].unwrap() * way
    };
    let train_end = |replay: &Replay| replay.problem().grid().time(replay.range(Part::Train).end - 1);
    let unseen_from = train_end(&a).max(train_end(&b));
    let mut pairs = [Vec::new(), Vec::new()];
    for (k, time) in axis.iter().enumerate() {
        assert!((output.simulated["a"][k].unwrap() - read(*time)).abs() < 1e-12);
        if let (Some(measured), Some(_)) = (output.measured[k], output.simulated["b"][k]) {
            pairs[0].push((read(*time), measured));
            if *time > unseen_from {
                pairs[1].push((read(*time), measured));
            }
        }
    }
    assert!(pairs[0].len() < axis.len(), "the gap of one fit is a gap of the contest");
    for (over, pairs) in [Over::Range, Over::Unseen].into_iter().zip(&pairs) {
        let row = |fit: &str| {
            compared
                .errors
                .iter()
                .find(|row| row.fit == fit && row.horizon == FREE_RUN && row.over == over)
                .unwrap()
        };
        let by_hand = Skill::of(pairs).unwrap();
        assert_eq!(row("a").skill.n, by_hand.n);
        assert!((row("a").skill.rmse - by_hand.rmse).abs() < 1e-12);
        assert_eq!(row("b").skill.n, by_hand.n);
    }
    // Every horizon has a row for every fit, and the shown series follow the question.
    let horizons: Vec<&str> = compared
        .errors
        .iter()
        .filter(|row| row.fit == "b" && row.over == Over::Range)
        .map(|row| row.horizon.as_str())
        .collect();
    assert_eq!(horizons, ["free_run", "PT1H", "PT6H", "PT24H"]);
    let two_hours = compare(&contenders, Some(Duration::from_hours(2)), from, to).unwrap();
    assert_eq!(
        two_hours.errors.iter().filter(|row| row.horizon == "PT2H" && row.over == Over::Range).count(),
        2
    );
    let shown = &two_hours.outputs["T_room"].simulated["b"];
    let exact = b.ahead(0..grid.len(), &[4]);
    let place = (0..grid.len()).position(|k| grid.time(k) == two_hours.start).unwrap();
    assert_eq!(shown[..], exact[0][0][place..place + shown.len()]);
}

#[test]
fn a_training_part_without_inputs_is_refused() {
    // Every temperature is there, but the weather of the training part is not.
    let record = window(20, 900, 3.0..9.9);
    let range =
        WindowRange { last: None, from: Some(rfc3339(START + 5 * DAY)), to: Some(rfc3339(START + 15 * DAY)) };
    let faults =
        prepare(&Catalogue::builtin().unwrap(), &model(), &request(range), &record, &Site::default())
            .unwrap_err();
    assert_eq!(faults[0].code, "too-short", "{faults:?}");
}
