//! Reports that stand on their own: what the command line found, as one file that asks nobody for anything.

use crate::support::process::{Said, verb};
use crate::twin_csv;
use serde_json::Value;
use std::path::Path;

/// A name of a file that would begin an element where it is written as it is.
const HOSTILE: &str = "room <!--<script>alert(1).csv";
const DATA: &str = "<script type=\"application/json\" id=\"report\">";

/// Runs a verb on a synthetic room with a report; what it printed, and the report.
fn reported(folder: &Path, name: &str, further: &[&str]) -> (Said, String) {
    let (csv, report) = (folder.join(HOSTILE), folder.join("report.html"));
    std::fs::write(&csv, twin_csv(5)).unwrap();
    let paths =
        [csv.to_str().unwrap(), "--report", report.to_str().unwrap(), "--neighbours", "1,2", "--json"];
    let said = verb("http://127.0.0.1:1", &[&[name], &paths[..], further].concat());
    (said, std::fs::read_to_string(report).unwrap())
}

fn data(report: &str) -> Value {
    let (_, rest) = report.split_once(DATA).unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_report_of_a_fit_holds_what_was_printed_and_asks_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let (said, report) =
        reported(folder.path(), "fit", &["--method", "lm_multistart", "--evaluations", "2000"]);
    let printed = said.json();
    let data = data(&report);
    assert_eq!(data["kind"], "fit");
    let answers = data["answers"].as_object().unwrap();
    let fit = &answers["/fits/report"];
    for (name, value) in printed.as_object().unwrap().iter().filter(|(name, _)| *name != "created_at") {
        assert_eq!(&fit[name], value, "{name}");
    }
    assert!(printed["verdict"].is_string() && !printed["checks"].as_array().unwrap().is_empty());
    // What is drawn is what the printed errors were computed from: every sample, and the same number out of
    // them.
    let run = &answers["/fits/report/comparison?mode=free_run"];
    assert_eq!((&run["thinning"], &run["provenance"]["reproduced"]), (&Value::Null, &Value::Bool(true)));
    let numbers =
        |values: &Value| values["values"].as_array().unwrap().iter().map(Value::as_f64).collect::<Vec<_>>();
    let (measured, simulated) =
        (numbers(&run["outputs"]["T_room"]["measured"]), numbers(&run["outputs"]["T_room"]["simulated"]));
    let end = run["time"]
        .as_array()
        .unwrap()
        .iter()
        .position(|time| *time == printed["parts"]["train"]["to"])
        .unwrap();
    let squares: Vec<f64> = measured
        .iter()
        .zip(&simulated)
        .take(end + 1)
        .filter_map(|(a, b)| Some(((*a)? - (*b)?).powi(2)))
        .collect();
    let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let stored = printed["metrics"]["T_room"]["train_rmse"].as_f64().unwrap();
    assert!((rmse - stored).abs() < 1e-9, "{rmse} beside {stored}");
    assert!(answers["/fits/report/diagnostics"]["by_regime"].as_array().unwrap().len() > 3);

    // The name of the file is there, and is no element.
    assert!(data["command"].as_array().unwrap().iter().any(|word| word.as_str().unwrap().ends_with(HOSTILE)));
    assert_eq!(report.matches("<script").count(), 5, "data, licences and three scripts");
    // Nothing comes from elsewhere. What licences say is no address, nor is the name of a vocabulary or of an
    // author.
    let (head, rest) = report.split_once("id=\"licences\">").unwrap();
    let (licences, tail) = rest.split_once("</script>").unwrap();
    assert!(licences.contains("MIT") && licences.contains("Apache License"));
    let document = format!("{head}{tail}");
    for (at, _) in document.match_indices("://") {
        let address: String = document[at..].chars().take(40).collect();
        assert!(
            address.starts_with("://www.w3.org/") || address.starts_with("://github.com/leeoniya/uPlot"),
            "{address}"
        );
    }
    for word in [" src=", "@import", "import(", "rel=\"stylesheet"] {
        assert!(!document.contains(word), "{word}");
    }
    let policy =
        head.split_once("Content-Security-Policy\" content=\"").unwrap().1.split('"').next().unwrap();
    assert!(
        policy.starts_with("default-src 'none'; script-src 'nonce-") && !policy.contains("unsafe"),
        "{policy}"
    );
}

#[test]
fn a_fit_without_unseen_data_is_a_study_and_has_no_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let words =
        ["--method", "lm_multistart", "--evaluations", "500", "--train", "P10D", "--validation", "PT0H"];
    let (said, report) = reported(folder.path(), "fit", &words);
    said.expect(0);
    let fit = &data(&report)["answers"]["/fits/report"];
    assert_eq!((&fit["verdict"], &fit["checks"]), (&Value::Null, &serde_json::json!([])));
}

#[test]
fn reports_of_a_diagnosis_and_of_a_ladder_hold_what_was_printed() {
    let folder = tempfile::tempdir().unwrap();
    for (name, path, further) in [
        ("diagnose", "/diagnoses/report", &[][..]),
        ("ladder", "/systems/report/ladder", &["--max-steps", "1"]),
    ] {
        let (said, report) = reported(folder.path(), name, further);
        let (printed, data) = (said.json(), data(&report));
        assert_eq!(data["kind"], name);
        for (field, value) in printed
            .as_object()
            .unwrap()
            .iter()
            .filter(|(field, _)| !["system", "fit"].contains(&field.as_str()))
        {
            assert_eq!(&data["answers"][path][field], value, "{field} of {name}");
        }
    }
}
