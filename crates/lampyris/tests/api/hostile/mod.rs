//! Hundreds of bad inputs, each made from a good one by one to three known mutations: every fault is named
//! with its place, nothing else is, and nothing of it reaches the database.

mod documents;
mod jobs;
mod plants;
mod raw;
mod windows;

use crate::support::cluster;
use crate::support::{Answer, TestApp};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// What is wrong with a document afterwards.
struct Mutation<D> {
    /// What it touches; two mutations of one document touch different things.
    area: &'static str,
    /// Areas that nobody looks at any more once this is wrong. `*` stands for all.
    hides: &'static [&'static str],
    /// The faults that it makes: place and code.
    faults: &'static [(&'static str, &'static str)],
    apply: fn(&mut D),
}

impl<D> Mutation<D> {
    fn hides(&self, area: &str) -> bool {
        self.hides.iter().any(|hidden| *hidden == "*" || area.starts_with(hidden))
    }
}

/// Draws one to three mutations that can be told apart.
fn draw<'a, D>(
    all: &'a [Mutation<D>],
    wanted: usize,
    random: &mut Xoshiro256PlusPlus,
) -> Vec<&'a Mutation<D>> {
    let mut order: Vec<&Mutation<D>> = all.iter().collect();
    order.shuffle(random);
    let mut drawn: Vec<&Mutation<D>> = Vec::new();
    for mutation in order {
        let fits = |other: &&Mutation<D>| {
            other.area != mutation.area && !other.hides(mutation.area) && !mutation.hides(other.area)
        };
        if drawn.iter().all(fits) && drawn.len() < wanted {
            drawn.push(mutation);
        }
    }
    drawn
}

/// A request, and what it must be told.
struct Case {
    what: String,
    method: &'static str,
    path: String,
    media_type: &'static str,
    body: Vec<u8>,
    faults: BTreeSet<(String, String)>,
}

/// Cases from a good document: every mutation alone, then so many mixtures.
fn cases<D: Clone>(
    good: &D,
    mutations: &[Mutation<D>],
    mixtures: usize,
    seed: u64,
    send: impl Fn(&D) -> (&'static str, String, &'static str, Vec<u8>),
) -> Vec<Case> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut drawn: Vec<Vec<&Mutation<D>>> = mutations.iter().map(|mutation| vec![mutation]).collect();
    drawn.extend((0..mixtures).map(|_| {
        let wanted = random.random_range(2..=3);
        draw(mutations, wanted, &mut random)
    }));
    let case = |drawn: Vec<&Mutation<D>>| {
        let mut document = good.clone();
        // Headers last: rows are mutated by their columns.
        let mut ordered = drawn.clone();
        ordered.sort_by_key(|mutation| std::cmp::Reverse(mutation.area));
        ordered.iter().for_each(|mutation| (mutation.apply)(&mut document));
        let (method, path, media_type, body) = send(&document);
        let faults = drawn
            .iter()
            .flat_map(|mutation| mutation.faults)
            .map(|(pointer, code)| ((*pointer).to_owned(), (*code).to_owned()));
        let what = drawn
            .iter()
            .map(|mutation| format!("{} {:?}", mutation.area, mutation.faults))
            .collect::<Vec<_>>()
            .join(" + ");
        Case { what, method, path, media_type, body, faults: faults.collect() }
    };
    drawn.into_iter().map(case).collect()
}

/// Sends a document as JSON.
fn as_json(
    method: &'static str,
    path: &'static str,
) -> impl Fn(&Value) -> (&'static str, String, &'static str, Vec<u8>) {
    move |document| (method, path.to_owned(), "application/json", document.to_string().into_bytes())
}

/// The places and codes of all faults of a list.
fn named(errors: &Value) -> BTreeSet<(String, String)> {
    let text = |fault: &Value, field: &str| {
        fault[field]
            .as_str()
            .filter(|text| !text.is_empty() || field == "pointer")
            .unwrap_or_else(|| panic!("{field} of {fault}"))
            .to_owned()
    };
    let fault = |fault: &Value| {
        text(fault, "detail");
        (text(fault, "pointer"), text(fault, "code"))
    };
    errors.as_array().unwrap_or_else(|| panic!("no list of faults: {errors}")).iter().map(fault).collect()
}

/// Everything in the database, as one hash.
fn contents(app: &TestApp) -> String {
    let tables = if cluster::is_on() {
        "SELECT table_name::TEXT FROM information_schema.tables WHERE table_schema = 'public' AND \
        table_name NOT IN ('workers', 'changes', 'counters', 'clock') ORDER BY 1"
    } else {
        "SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name"
    };
    let tables = app.behind(tables).unwrap();
    assert!(tables.len() > 8, "{tables:?}");
    let mut hasher = blake3::Hasher::new();
    for table in tables {
        let rows = if cluster::is_on() {
            format!("SELECT t::TEXT FROM \"{table}\" t ORDER BY 1")
        } else {
            let columns =
                app.behind(&format!("SELECT quote(name) FROM pragma_table_info('{table}')")).unwrap();
            let cells: Vec<String> =
                columns.iter().map(|name| format!("quote(\"{}\")", name.trim_matches('\''))).collect();
            format!("SELECT {} AS cells FROM \"{table}\" ORDER BY 1", cells.join(" || ',' || "))
        };
        hasher.update(table.as_bytes());
        for row in app.behind(&rows).unwrap() {
            hasher.update(row.as_bytes()).update(b"\n");
        }
    }
    hasher.finalize().to_hex().to_string()
}

/// A service with a room that has parameters, one that has three measurements, and one that has none.
fn prepared() -> TestApp {
    let app = TestApp::with(|settings| settings.limits.window_bytes = 200_000);
    // No tick may come in between.
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "0 0 1 1 *", "enabled": false, "systems": ["room/*"]}),
    )
    .expect(200);
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    for id in ["2", "3"] {
        app.json("PUT", &format!("/systems/room/{id}"), &json!({"model": "rc2"})).expect(201);
    }
    let short: String =
        crate::support::rooms::room_csv(2, 1).lines().take(4).map(|line| format!("{line}\n")).collect();
    app.csv("/systems/room/2/windows", &short).expect(201);
    app
}

/// Sends all cases, and says where something else came back than what must.
fn complaints(app: &TestApp, cases: &[Case]) -> Vec<String> {
    let complaint = |case: &Case| {
        let answer = app
            .send(case.method, &case.path, &[("content-type", case.media_type)], Some(&case.body))
            .unwrap();
        let body: String = String::from_utf8_lossy(&case.body).chars().take(600).collect();
        judge(case, &answer).err().map(|complaint| {
            format!("{} {}: {}\n  {complaint}\n  sent: {body}", case.method, case.path, case.what)
        })
    };
    cases.iter().filter_map(complaint).collect()
}

fn judge(case: &Case, answer: &Answer) -> Result<(), String> {
    // A dry run is no refusal: it lists the same faults in an answer of its own.
    let is_dry_run = case.path == "/models/validate";
    let status = if is_dry_run { 200 } else { 422 };
    if answer.status != status {
        return Err(format!("{} {}", answer.status, answer.text));
    }
    let problem = if is_dry_run { answer.json() } else { answer.clone().problem(422, "invalid-request") };
    let found = named(&problem["errors"]);
    if found == case.faults {
        Ok(())
    } else {
        Err(format!("expected {:?}\n  found {found:?}\n  in {problem}", case.faults))
    }
}

#[test]
fn hundreds_of_bad_inputs_are_named_and_change_nothing() {
    let app = prepared();
    let before = contents(&app);
    let all = [windows::cases(), documents::cases(), plants::cases(), jobs::cases()];
    let count: usize = all.iter().map(Vec::len).sum();
    let wrong: Vec<String> = all.iter().flat_map(|cases| complaints(&app, cases)).collect();
    assert!(wrong.is_empty(), "{} of {count} cases:\n{}", wrong.len(), wrong.join("\n"));
    assert_eq!(contents(&app), before, "something was kept");
    let texts = raw::check(&app);
    assert_eq!(contents(&app), before, "something was kept");
    eprintln!("{count} documents and {texts} texts");
    assert!(count + texts >= 500, "{count} documents and {texts} texts");
    // The good documents are good: without a mutation everything is taken.
    windows::check_good(&app);
    documents::check_good(&app);
    plants::check_good(&app);
    jobs::check_good(&app);
    assert_ne!(contents(&app), before, "the hash sees what is kept");
}
