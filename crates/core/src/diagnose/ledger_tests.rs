//! The ledger against closed forms, a published analysis, and the windows of a real room.

use super::findings::pool_findings;
use super::ledger::{
    Apart, EffectScore, LedgerEntry, Looked, LookedSpan, Pooled, beside, entries, ledgers, pooled_with,
};
use super::report::Diagnosis;
use crate::data::{DAY, SECOND};

/// 2016-01-12T00:00:00Z.
const START: i64 = 1_452_556_800 * SECOND;

/// Fourteen days beginning this many days after the start.
fn entry(after: i64, size: f64, deviation: f64) -> LedgerEntry {
    let from = START + after * DAY;
    LedgerEntry {
        diagnosis: format!("dia_{after}"),
        model: "rc2".to_owned(),
        model_hash: Some("a".to_owned()),
        span: LookedSpan { from, to: from + 14 * DAY, hours: 12.0 },
        score: EffectScore {
            effect: "metered_gain:P".to_owned(),
            size,
            deviation,
            unit: "K/(h*kW)".to_owned(),
            share: 0.2,
            t: size / deviation,
            beyond_clock: 0.5 * size / deviation,
            days: 14,
            shift_p: None,
        },
    }
}

fn pooled(entries: &[LedgerEntry]) -> Pooled {
    ledgers(entries)[0].pooled.clone().unwrap()
}

fn near(one: f64, other: f64, within: f64) {
    assert!((one - other).abs() < within, "{one} is not {other}");
}

/// Thirteen trials of the BCG vaccine (Colditz et al. 1994, J. Am. Med. Assoc. 271, 698-702): vaccinated with
/// and without tuberculosis, others with and without. The mean of the logarithms of the relative risks, its
/// interval, Q and I2 are those of the documentation of metafor (Viechtbauer 2010, J. Stat. Softw. 36) for
/// the model of equal effects.
#[test]
fn a_published_analysis_comes_out_again() {
    let trials: [[f64; 4]; 13] = [
        [4.0, 119.0, 11.0, 128.0],
        [6.0, 300.0, 29.0, 274.0],
        [3.0, 228.0, 11.0, 209.0],
        [62.0, 13_536.0, 248.0, 12_619.0],
        [33.0, 5_036.0, 47.0, 5_761.0],
        [180.0, 1_361.0, 372.0, 1_079.0],
        [8.0, 2_537.0, 10.0, 619.0],
        [505.0, 87_886.0, 499.0, 87_892.0],
        [29.0, 7_470.0, 45.0, 7_232.0],
        [17.0, 1_699.0, 65.0, 1_600.0],
        [186.0, 50_448.0, 141.0, 27_197.0],
        [5.0, 2_493.0, 3.0, 2_338.0],
        [27.0, 16_886.0, 29.0, 17_825.0],
    ];
    let entries: Vec<LedgerEntry> = trials
        .iter()
        .zip(0..)
        .map(|([ill, well, others_ill, others_well], place)| {
            let (all, others) = (ill + well, others_ill + others_well);
            let variance = ill.recip() - all.recip() + others_ill.recip() - others.recip();
            entry(14 * place, ((ill / all) / (others_ill / others)).ln(), variance.sqrt())
        })
        .collect();
    let found = pooled(&entries);
    assert_eq!(found.windows, 13);
    near(found.size, -0.4303, 5e-5);
    near(found.deviation, 0.0405, 5e-5);
    near(found.ci95[0], -0.5097, 1e-4);
    near(found.ci95[1], -0.3509, 1e-4);
    near(found.q, 152.2330, 5e-4);
    near(found.i2.unwrap(), 0.9212, 5e-5);
    assert!(found.sentence.ends_with("its size differs from window to window."), "{}", found.sentence);
}

/// The laundry of a house near Stambruges and its appliances, nine windows of two weeks.
#[test]
fn the_windows_of_a_room_add_up() {
    let t = [6.4, 4.4, 8.3, 6.1, 10.1, 4.5, 3.4, 3.7, 2.4];
    let size = [0.23, 0.28, 0.36, 0.34, 0.35, 0.20, 0.28, 0.23, 0.21];
    let mut entries: Vec<LedgerEntry> =
        t.iter().zip(size).zip(0..).map(|((t, size), place)| entry(14 * place, size, size / t)).collect();
    entries[0].score.share = 0.5;
    entries[0].score.days = 7;
    let found = pooled(&entries);
    near(found.t, 49.3 / 3.0, 1e-9);
    near(found.beyond_clock, 0.5 * 49.3 / 3.0, 1e-9);
    near(found.share, (0.5 * 7.0 + 0.2 * 8.0 * 14.0) / (7.0 + 8.0 * 14.0), 1e-12);
    assert!(found.taken_back.is_none() && found.shift_p.is_none(), "{found:?}");
    let opening = "In 9 windows since 12 January 2016 it explains 22 % of the error 12 h ahead, always with \
        the same sign (pooled t 16.4, size 0.2";
    assert!(found.sentence.starts_with(opening), "{}", found.sentence);
}

#[test]
fn equal_windows_have_closed_forms() {
    let mut entries: Vec<LedgerEntry> = (0..4).map(|place| entry(14 * place, 0.3, 0.1)).collect();
    for entry in &mut entries {
        entry.score.shift_p = Some(0.1);
    }
    let found = pooled(&entries);
    near(found.t, 6.0, 1e-12);
    near(found.size, 0.3, 1e-12);
    near(found.deviation, 0.05, 1e-12);
    assert!(found.q < 1e-20 && found.i2 == Some(0.0));
    // Of an even number of degrees of freedom chi squared is a sum: exp(-x/2) times the first four terms of
    // the exponential.
    let half = -4.0 * 0.1_f64.ln();
    near(
        found.shift_p.unwrap(),
        (-half).exp() * (1.0 + half + half.powi(2) / 2.0 + half.powi(3) / 6.0),
        1e-9,
    );

    let one = pooled(&entries[..1]);
    assert_eq!((one.windows, one.i2, one.size, one.t), (1, None, 0.3, entries[0].score.t));
    near(one.shift_p.unwrap(), 0.1, 1e-9);
    assert_eq!(
        one.sentence,
        "In one window since 12 January 2016 it explains 20 % of the error 12 h ahead (t 3.0, size 0.30 ± \
        0.20 K/(h*kW))."
    );
    let faint = pooled(&[entry(0, 0.1, 0.1), entry(14, -0.1, 0.1)]);
    assert!(faint.sentence.contains("it cannot be told from chance (pooled t 0.0"), "{}", faint.sentence);
    let mut forbidden = entry(0, 0.3, 0.1);
    forbidden.score.t = -3.0;
    assert!(pooled(&[forbidden]).sentence.contains("a sign that physics does not allow"));
}

#[test]
fn windows_that_overlap_or_tell_of_something_else_stand_apart() {
    let mut entries = vec![entry(0, 0.1, 0.1), entry(7, 0.2, 0.1), entry(20, 0.3, 0.1), entry(20, 0.4, 0.1)];
    let [mut model, mut hours, mut unit] = [entry(40, 0.5, 0.1), entry(60, 0.5, 0.1), entry(80, 0.5, 0.1)];
    model.model_hash = Some("b".to_owned());
    hours.span.hours = 6.0;
    unit.score.unit = "1/h".to_owned();
    entries.extend([model, hours, unit, entry(100, 0.5, 0.0), entry(120, 0.4, 0.1)]);
    let ledger = &ledgers(&entries)[0];
    let apart: Vec<(i64, f64, Option<Apart>)> = ledger
        .windows
        .iter()
        .map(|kept| ((kept.entry.span.from - START) / DAY, kept.entry.score.size, kept.apart))
        .collect();
    let expected = [
        (120, 0.4, None),
        (100, 0.5, Some(Apart::NoSize)),
        (80, 0.5, Some(Apart::OtherUnit)),
        (60, 0.5, Some(Apart::OtherHours)),
        (40, 0.5, Some(Apart::OtherModel)),
        // Of two looks at the same window the later one counts.
        (20, 0.4, None),
        (20, 0.3, Some(Apart::Overlaps)),
        (7, 0.2, Some(Apart::Overlaps)),
        (0, 0.1, None),
    ];
    assert_eq!(apart, expected);
    assert_eq!(ledger.pooled.as_ref().unwrap().windows, 3);
    near(ledger.pooled.as_ref().unwrap().size, 0.3, 1e-12);

    // The window of a diagnosis that is under way counts, whatever was looked at before.
    let now = entry(5, 0.9, 0.1);
    let found = pooled_with(&entries[..3], &now.score, now.span).unwrap();
    assert_eq!(found.windows, 2, "only the window from day 20 does not overlap it");
    near(found.size, 0.6, 1e-12);
    assert_eq!(pooled_with(&[], &now.score, now.span).unwrap().windows, 1);
    assert!(pooled_with(&entries, &entry(200, 0.5, f64::NAN).score, now.span).is_none());
}

#[test]
fn evidence_is_taken_back_where_the_newest_window_contradicts_it() {
    let clear: Vec<LedgerEntry> = (0..5).map(|place| entry(14 * place, 0.3, 0.05)).collect();
    let with = |size: f64, deviation: f64| {
        pooled(&[clear.clone(), vec![entry(70, size, deviation)]].concat()).taken_back
    };
    let taken = with(0.0, 0.05).unwrap();
    near(taken.z, -0.3 / (0.05_f64.powi(2) * 1.2).sqrt(), 1e-12);
    assert_eq!(
        taken.sentence,
        "The newest window, 22 March 2016 to 5 April 2016, speaks against it: its size is 0.000 ± 0.098 \
        K/(h*kW) there and 0.300 ± 0.044 K/(h*kW) in 5 windows before (z -5.5)."
    );
    assert!(with(-0.3, 0.05).is_some(), "the other sign");
    assert!(with(0.12, 0.05).is_none(), "smaller, but still there");
    assert!(with(0.0, 0.2).is_none(), "a window that shows nothing of anything contradicts nothing");
    let faint: Vec<LedgerEntry> =
        (0..5).map(|place| entry(14 * place, 0.3, 0.3)).chain([entry(70, -0.9, 0.05)]).collect();
    assert!(pooled(&faint).taken_back.is_none(), "nothing clear was there to be taken back");
    let once = |t: f64| pooled(&[entry(0, 0.05 * t, 0.05), entry(14, -0.2, 0.05)]).taken_back;
    assert!(once(3.0).is_none(), "of twenty effects one shows as much by chance");
    assert!(once(5.0).is_some());
    // An older window that differs is heterogeneity, and no change.
    let old = [vec![entry(-14, 0.0, 0.05)], clear].concat();
    assert!(pooled(&old).taken_back.is_none());
}

#[test]
fn a_ledger_is_of_one_effect_and_one_model() {
    let mut wind = entry(0, 0.9, 0.1);
    wind.score.effect = "wind_infiltration".to_owned();
    let mut other = entry(14, 0.5, 0.1);
    other.model = "room3".to_owned();
    let found = ledgers(&[entry(0, 0.2, 0.1), wind, other]);
    let names: Vec<(&str, &str)> =
        found.iter().map(|ledger| (ledger.effect.as_str(), ledger.model.as_str())).collect();
    assert_eq!(names, [("wind_infiltration", "rc2"), ("metered_gain:P", "room3"), ("metered_gain:P", "rc2")]);
    assert!(ledgers(&[]).is_empty());

    let broken = EffectScore { share: f64::NAN, ..entry(0, 0.2, 0.1).score };
    let looked = Looked {
        from: "2016-01-12T00:00:00Z".to_owned(),
        to: "2016-01-26T00:00:00Z".to_owned(),
        hours: 12.0,
        effects: vec![broken, entry(0, 0.2, 0.1).score],
    };
    let mut own = entry(0, 0.2, 0.1);
    own.diagnosis = "dia_1".to_owned();
    let kept = entries(looked.span().unwrap(), "dia_1", ("rc2", Some("a")), looked.effects.iter());
    assert_eq!(kept, [own.clone()], "what has no figures is not kept");
    let mut other = own.clone();
    other.model_hash = Some("b".to_owned());
    assert_eq!(beside(&[own.clone(), other], "rc2", "a"), [own.clone()]);
    assert_eq!(beside(&[own], "room3", "a"), []);
}

/// Findings are told together with earlier windows where their window was looked at, and not otherwise.
#[test]
fn findings_know_what_earlier_windows_showed() {
    let finding = |effect: &str| {
        serde_json::json!({
            "rank": 1, "effect": effect, "title": "", "explain": "", "delta_bic": 0.0,
            "explained_share": null,
            "rmse": {"train": [1.0, 1.0], "validation": null, "test": null, "validation_ahead": {}},
            "parameters": {}, "tied_with": [], "separate_by": null, "kind": "cause", "evidence": [],
            "shape": null,
        })
    };
    let mut report: Diagnosis = serde_json::from_value(serde_json::json!({
        "system": null, "model": "rc2", "fit": null, "verdict": "named", "summary": "", "rho": null,
        "noise_floor_rmse": null,
        "findings": [finding("metered_gain:P"), finding("wind_infiltration")], "considered": [],
        "not_testable": [],
        "unexplained": {"share": null, "profile_by_hour": [], "episodes": [], "ask": null}, "warnings": [],
    }))
    .unwrap();
    let earlier = [entry(0, 0.2, 0.1)];
    pool_findings(&mut report, &earlier);
    assert!(report.findings.iter().all(|finding| finding.pooled.is_none()), "nobody has looked");
    let effects = vec![entry(0, 0.4, 0.1).score];
    report.looked = Some(Looked {
        from: "2016-01-26T00:00:00Z".to_owned(),
        to: "2016-02-09T00:00:00Z".to_owned(),
        hours: 12.0,
        effects,
    });
    pool_findings(&mut report, &earlier);
    let pooled = report.findings[0].pooled.as_ref().unwrap();
    assert_eq!(pooled.windows, 2);
    near(pooled.size, 0.3, 1e-12);
    assert!(report.findings[1].pooled.is_none());
}
