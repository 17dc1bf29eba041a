//! The gate between fits and the controller: bad candidates of every kind are refused by name, good ones
//! pass, and no rule can be done without.

mod bad;
mod plants;
mod served;

use crate::support::full;
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::gate::check::Severity;
use lampyris_core::estimate::gate::rules::ALL;
use lampyris_core::estimate::gate::table::{CheckTable, Rule};
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{
    Control, EstimateRequest, Fit, GatePolicy, Incumbent, Past, Problem, Site, Verdict, estimate, prepare,
};
use lampyris_core::fault::Fault;
use lampyris_core::model::Catalogue;
use lampyris_core::twin::{Level, WorldRequest, room, world};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

static CATALOGUE: LazyLock<Catalogue> = LazyLock::new(|| Catalogue::builtin().unwrap());

/// A fit with everything that the gate is given.
struct Candidate {
    problem: Problem,
    fit: Fit,
    incumbent: Option<Incumbent>,
}

impl Candidate {
    fn table(&self, rules: &[Rule]) -> CheckTable {
        CheckTable::of(
            &self.problem,
            &self.fit,
            &Past::of(self.incumbent.clone()),
            &GatePolicy::default(),
            rules,
        )
    }

    /// The checks that keep it from the controller.
    fn failed(&self) -> Vec<String> {
        let judgement =
            validate(&self.problem, &self.fit, &Past::of(self.incumbent.clone()), &GatePolicy::default());
        let published = matches!(judgement.verdict, Verdict::Accepted(_));
        let failed: Vec<String> = judgement.failed().into_iter().map(str::to_owned).collect();
        assert!(
            published == failed.is_empty() || judgement.verdict == Verdict::Unchanged,
            "{}",
            judgement.summary
        );
        failed
    }
}

/// Why something bad does not even get as far as the gate: the code of the first fault.
type Refused = String;

/// The problem of a text of measurements, as a job puts it together.
fn problem(csv: &str, neighbours: &[String], asked: &EstimateRequest) -> Result<Problem, Refused> {
    problem_of(&CATALOGUE, "room3", csv, neighbours, asked)
}

fn problem_of(
    catalogue: &Catalogue,
    model: &str,
    csv: &str,
    neighbours: &[String],
    asked: &EstimateRequest,
) -> Result<Problem, Refused> {
    let code = |faults: Vec<Fault>| faults[0].code.clone();
    let (window, _) = Window::parse_csv(csv, &ColumnBindings::none()).map_err(code)?;
    let site = Site { sets: [("neighbours".to_owned(), neighbours.to_vec())].into(), ..Site::default() };
    prepare(catalogue, &model.parse().unwrap(), asked, &window, &site).map_err(code)
}

fn fit(problem: &Problem, asked: &EstimateRequest) -> Result<Fit, Refused> {
    estimate(problem, asked, None, &Control::NONE).map_err(|error| format!("no fit: {error}"))
}

/// Puts so many candidates of every kind to the gate: all are refused by name. Says what gets through where
/// one rule is left out.
fn refused(what: &str, kinds: &[bad::Kind], each: usize) -> BTreeSet<&'static str> {
    let cases: Vec<(&bad::Kind, u64)> =
        kinds.iter().flat_map(|kind| (0..each as u64).map(move |seed| (kind, seed))).collect();
    let looked: Vec<(String, Option<String>, BTreeSet<&'static str>)> = cases
        .par_iter()
        .map(|(kind, seed)| {
            let candidate = (kind.make)(7000 + seed);
            let failed = candidate.as_ref().map_or_else(|refused| vec![refused.clone()], Candidate::failed);
            let wrong = if failed.is_empty() {
                Some(format!("{} {seed} got through", kind.name))
            } else if !failed.iter().any(|name| kind.refused_by.iter().any(|rule| name.starts_with(rule))) {
                Some(format!("{} {seed} was refused by {failed:?}, not by {:?}", kind.name, kind.refused_by))
            } else {
                None
            };
            // The rules without which this one would have got through.
            let mut alone = BTreeSet::new();
            let rules = candidate.iter().flat_map(|candidate| ALL.iter().map(move |rule| (candidate, rule)));
            for (candidate, left_out) in
                rules.filter(|(_, rule)| failed.iter().any(|name| name.starts_with(rule.name)))
            {
                let rest: Vec<Rule> = ALL.iter().filter(|rule| rule.name != left_out.name).copied().collect();
                let table = candidate.table(&rest);
                if table.failed(Severity::Reject).or(table.failed(Severity::Hold)).is_none() {
                    alone.insert(left_out.name);
                }
            }
            (format!("{}: {}", kind.name, failed.join(", ")), wrong, alone)
        })
        .collect();
    let mut lines: BTreeMap<&str, usize> = BTreeMap::new();
    looked.iter().for_each(|(line, ..)| *lines.entry(line).or_default() += 1);
    lines.iter().for_each(|(line, count)| println!("  {count:>3} x {line}"));
    let wrong: Vec<&String> = looked.iter().filter_map(|(_, wrong, _)| wrong.as_ref()).collect();
    let alone: BTreeSet<&'static str> = looked.iter().flat_map(|(.., alone)| alone.iter().copied()).collect();
    println!(
        "GATE-1: {} bad {what} of {} kinds, {} wrong; without one rule something gets through: {alone:?}",
        cases.len(),
        kinds.len(),
        wrong.len()
    );
    assert!(wrong.is_empty(), "{wrong:#?}");
    alone
}

/// A rule does not stand for itself alone: what it refuses has to get through where it alone is left out.
#[test]
fn bad_candidates_are_refused_by_name_and_every_rule_is_needed() {
    let each = if full() { 200usize.div_ceil(bad::KINDS.len()) } else { 1 };
    let alone = refused("candidates", bad::KINDS, each);
    let spared: Vec<&str> = ALL
        .iter()
        .map(|rule| rule.name)
        .filter(|rule| !alone.contains(rule) && !bad::SECOND.contains(rule))
        .collect();
    assert!(spared.is_empty(), "nothing gets through without {spared:?}");
}

/// What a rule that only flags says.
#[test]
fn doubts_are_published_with_their_flag() {
    let found = bad::doubtful();
    for (flags, candidate) in &found {
        let judgement =
            validate(&candidate.problem, &candidate.fit, &Past::default(), &GatePolicy::default());
        let Verdict::Accepted(acceptance) = &judgement.verdict else {
            panic!("{flags:?}: {}", judgement.summary)
        };
        assert!(
            acceptance.flags().iter().any(|said| flags.contains(&said.as_str())),
            "{flags:?}: {:?}",
            acceptance.flags()
        );
        let silent: Vec<Rule> = ALL
            .iter()
            .filter(|rule| {
                !["G2 bounds", "G4 beats persistence", "G7 repeat", "G12 determined"].contains(&rule.name)
            })
            .copied()
            .collect();
        assert!(candidate.table(&silent).flags.is_empty(), "{flags:?}");
    }
    println!("GATE-1: {} doubtful candidates carry their flags", found.len());
}

/// What a search that was cut short has found may be good, and nobody knows it.
#[test]
fn a_search_that_was_cut_short_is_held() {
    let hurried = bad::hurried();
    assert_eq!(hurried.failed(), ["G7 repeat"]);
    let judgement = validate(&hurried.problem, &hurried.fit, &Past::default(), &GatePolicy::default());
    assert!(
        judgement.summary.starts_with("held by G7 repeat: the search was cut short by its budget, after 6"),
        "{}",
        judgement.summary
    );
    let Verdict::Held(holding) = &judgement.verdict else { panic!("{}", judgement.summary) };
    assert!(holding.flags().contains(&"low_confidence".to_owned()), "{:?}", holding.flags());
}

/// Fresh rooms whose structure is that of the model, or nearly: as the service estimates and judges them.
#[test]
fn good_fits_are_published() {
    let count = if full() { 200 } else { 10 };
    let refused: Vec<String> = (0..count as u64)
        .into_par_iter()
        .filter_map(|index| {
            let seed = 9000 + index;
            let asked = EstimateRequest::default();
            let (what, csv, neighbours) = match index % 2 {
                0 => {
                    let twin = room(seed, 2, 28, 30).unwrap();
                    ("room", twin.csv, twin.neighbours)
                }
                _ => {
                    let request =
                        WorldRequest { step_minutes: 30, ..WorldRequest::new(seed, &[], Level::Matched) };
                    let world = world(&request).unwrap();
                    ("world", world.csv, world.neighbours)
                }
            };
            let problem = problem(&csv, &neighbours, &asked).unwrap();
            let judgement =
                validate(&problem, &fit(&problem, &asked).unwrap(), &Past::default(), &GatePolicy::default());
            (!matches!(judgement.verdict, Verdict::Accepted(_)))
                .then(|| format!("{what} {seed}: {}", judgement.summary))
        })
        .collect();
    refused.iter().for_each(|line| println!("  {line}"));
    println!("GATE-1: {} of {count} good candidates published", count - refused.len());
    assert!(20 * refused.len() <= count, "{refused:#?}");
}
