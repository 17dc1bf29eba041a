//! Exit codes and what is printed with them: scripts rely on both.

use crate::Scene;
use crate::support::process::verb;

#[test]
fn exit_codes_tell_what_happened() {
    let scene = Scene::open();
    let verb = |line: &str| scene.service.verb(&line.split(' ').collect::<Vec<_>>());
    verb("systems put room/1 --model rc2").expect(0);
    // Usage.
    assert!(verb("jobs post").expect(2).err.contains("room/4"));
    verb("params get room").expect(2);
    verb("jobs post room/1 --last P1D --from 2026-01-01T00:00:00Z").expect(2);
    // Known, but nothing to give; and not known at all.
    assert!(verb("params get room/1").expect(3).err.contains("no-validated-parameters"));
    assert_eq!(verb("params get room/1 --accept nominal --json").expect(0).json()["status"], "nominal");
    verb("jobs list --state queued").expect(3);
    assert_eq!(verb("jobs list --json").expect(3).json()["items"], serde_json::json!([]));
    for line in [
        "params get room/9",
        "jobs show job_none",
        "jobs watch job_none",
        "models show nothing",
        "fits show fit_none",
        "systems show room/9",
    ] {
        assert!(verb(line).expect(4).err.starts_with("not found: No such"), "{line}");
    }
    verb("windows upload room/1 no-such-file.csv").expect(4);
    // Every fault of a refused request, with its place; as a document where that is asked for.
    let line = "jobs post room/1 --method lm_multistrat --set fixd={} --wall soon";
    let refused = verb(line).expect(1).err;
    for place in [
        "/method",
        "/fixd: ",
        "/budget/wall: ",
        "/system: there are no measurements",
        "did you mean `lm_multistart`?",
    ] {
        assert!(refused.contains(place), "{place} in {refused}");
    }
    let problem = verb(&format!("{line} --json")).expect(1).json();
    assert_eq!(
        (problem["type"].as_str(), problem["errors"].as_array().unwrap().len()),
        (Some("invalid-request"), 4),
        "{problem}"
    );
}

#[test]
fn a_server_that_is_not_there_is_named() {
    // Nobody listens on port 1 of this machine.
    let said = verb("http://127.0.0.1:1", &["jobs", "list"]).expect(1);
    assert!(said.err.contains("http://127.0.0.1:1") && said.err.contains("lampyris serve"), "{}", said.err);
    let said = verb("ftp://127.0.0.1:1", &["params", "list"]).expect(2);
    assert!(said.err.contains("https://HOST:PORT"), "{}", said.err);
}

#[test]
fn shells_can_complete_every_verb() {
    for shell in ["bash", "zsh", "fish"] {
        let script = verb("http://127.0.0.1:1", &["completions", shell]).expect(0).out;
        for word in ["jobs", "params", "models", "systems", "windows", "fits", "serve", "add-effect"] {
            assert!(script.contains(word), "{word} for {shell}");
        }
    }
}

#[test]
fn bench_hands_over_to_the_studies_beside_it() {
    let help = verb("http://127.0.0.1:1", &["bench", "help"]).expect(0).out;
    for study in ["engine", "diagnose", "real", "house"] {
        assert!(help.contains(study), "{study} in {help}");
    }
}
