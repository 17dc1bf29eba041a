//! What a diagnosis names on synthetic rooms whose truth is known: right, wrong or silent, with intervals.

use super::judged::{Judged, Outcome, same};
use super::options::Worlds;
use super::row::Row;
use super::verdicts::{judge_all, rows, spread};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, SplitRequest, Window};
use lampyris_core::diagnose::library::carried;
use lampyris_core::diagnose::null_model::NullModel;
use lampyris_core::diagnose::report::Considered;
use lampyris_core::diagnose::{Diagnosis, diagnose, preview};
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Control, EstimateRequest, Problem, Site, estimate, prepare};
use lampyris_core::model::Catalogue;
use lampyris_core::twin::{CATALOGUED, Level, STRANGE, World, WorldRequest, world};
use std::time::Instant;

/// Pairs of effects that show.
const PAIRS: [[&str; 2]; 6] = [
    ["wind_infiltration", "metered_gain"],
    ["oriented_solar_gain", "night_setback"],
    ["window_opening", "wind_infiltration"],
    ["metered_gain", "oriented_solar_gain"],
    ["sky_radiation", "metered_gain"],
    ["night_setback", "wind_infiltration"],
];

/// Of three hundred worlds so many hide nothing, an effect that no catalogue has, one effect, and two.
const SHARES: [u64; 4] = [100, 40, 100, 60];

/// So many of them are diagnosed once more, one after the other, for the time that it takes.
const TIMED: usize = 12;

/// Diagnoses about so many worlds of each level.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, only, each) = asked.parts();
    let kinds: [Vec<Vec<&str>>; 4] = [
        vec![Vec::new()],
        STRANGE.iter().map(|effect| vec![*effect]).collect(),
        CATALOGUED.iter().map(|effect| vec![*effect]).collect(),
        PAIRS.iter().map(|pair| pair.to_vec()).collect(),
    ];
    let total: u64 = SHARES.iter().sum();
    let mut requests = Vec::new();
    for level in [Level::Matched, Level::Rich] {
        let mut seed = first * 1_000_000 + u64::from(level == Level::Rich);
        for (kinds, share) in kinds.iter().zip(SHARES) {
            for effects in kinds.iter().cycle().take((worlds * share).div_ceil(total) as usize) {
                requests.push(WorldRequest::new(seed, effects, level));
                seed += 2;
            }
        }
    }
    requests.retain(|request| only.is_none_or(|only| name(request).contains(only)));
    let mut table = rows(&judge_all(&requests, judge, each.then_some(line))?);
    let stride = requests.len().div_ceil(TIMED).max(1);
    let seconds: Vec<[f64; 2]> = requests.iter().step_by(stride).map(seconds).collect::<Result<_, _>>()?;
    let of = |place: usize| seconds.iter().map(|seconds| seconds[place]).collect();
    table.extend(spread("a preview alone on this machine", "s", of(0)));
    table.extend(spread("a diagnosis alone on this machine, all rounds", "s", of(1)));
    Ok(table)
}

fn name(request: &WorldRequest) -> String {
    let effects = if request.effects.is_empty() { "none".to_owned() } else { request.effects.join("+") };
    format!("{:?} {effects}", request.level).to_lowercase()
}

/// A world that was made, and the fit of room3 to it.
struct Fitted {
    catalogue: Catalogue,
    world: World,
    window: Window,
    problem: Problem,
    site: Site,
    theta: Vec<f64>,
}

impl Fitted {
    fn new(request: &WorldRequest) -> Result<Self, Failure> {
        let world = world(request).map_err(|fault| Failure::Error(fault.to_string()))?;
        let (window, _) =
            Window::parse_csv(&world.csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
        let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
        let (problem, site, asked) = ask(&catalogue, &world, &window, "room3")?;
        let fit = estimate(&problem, &asked, None, &Control::NONE)
            .map_err(|error| Failure::Error(error.to_string()))?;
        Ok(Self { catalogue, world, window, problem, site, theta: fit.theta() })
    }

    fn diagnosed(&self) -> Result<Diagnosis, Failure> {
        let Self { catalogue, window, problem, site, theta, .. } = self;
        diagnose(catalogue, problem, theta, window, site, AccusationRate::default(), &[], &Control::NONE)
            .map_err(|error| Failure::Error(error.to_string()))
    }
}

/// What a preview and a diagnosis of a world take that have the machine for themselves.
fn seconds(request: &WorldRequest) -> Result<[f64; 2], Failure> {
    let fitted = Fitted::new(request)?;
    let start = Instant::now();
    preview(&fitted.catalogue, &fitted.problem, &fitted.theta, &fitted.window, &fitted.site)
        .map_err(|error| Failure::Error(error.to_string()))?;
    let preview = start.elapsed().as_secs_f64();
    let start = Instant::now();
    fitted.diagnosed()?;
    Ok([preview, start.elapsed().as_secs_f64()])
}

/// One world: made, fitted, diagnosed.
fn judge(request: &WorldRequest) -> Result<Judged, Failure> {
    let fitted = Fitted::new(request)?;
    let diagnosis = fitted.diagnosed()?;
    let Fitted { catalogue, world, window, problem, theta, .. } = fitted;
    let first = diagnosis.findings.first().map_or(Outcome::Silent, |finding| {
        let mut group = vec![finding.named().to_owned()];
        group.extend(finding.tied_with.iter().cloned());
        let holds =
            world.truth.effects.iter().any(|hidden| group.iter().any(|named| same(named, &hidden.effect)));
        match (holds, group.len()) {
            (true, ..=2) => Outcome::Right,
            (true, _) => Outcome::Vague,
            (false, _) => Outcome::Wrong,
        }
    });
    let named = |hidden: &str| {
        diagnosis.findings.iter().any(|finding| {
            same(finding.named(), hidden) || finding.tied_with.iter().any(|tied| same(tied, hidden))
        })
    };
    let found = world.truth.effects.iter().filter(|hidden| named(&hidden.effect)).count();
    let settled = |problem: Problem, theta: &[f64]| {
        NullModel::settle(problem, theta, None, &|| false)?.measured.plain[2].map(f64::sqrt)
    };
    let test = [
        settled(problem.clone(), &theta),
        informed(&catalogue, &world, &window, &problem, &theta)?
            .and_then(|(problem, theta)| settled(problem, &theta)),
    ];
    let logged = world.csv.contains("window_open");
    let truth = world.truth;
    Ok(Judged { kind: name(request), level: request.level, truth, diagnosis, first, found, test, logged })
}

fn ask(
    catalogue: &Catalogue,
    world: &World,
    window: &Window,
    model: &str,
) -> Result<(Problem, Site, EstimateRequest), Failure> {
    let id = model.parse().map_err(|error| Failure::Error(format!("{error}")))?;
    let asked = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
    let site = Site { sets: [("neighbours".to_owned(), world.neighbours.clone())].into(), ..Site::default() };
    let problem = prepare(catalogue, &id, &asked, window, &site).map_err(|found| faults(&found))?;
    Ok((problem, site, asked))
}

/// The model with the true effects, and where to start; none where no catalogue has them.
fn informed(
    catalogue: &Catalogue,
    world: &World,
    window: &Window,
    base: &Problem,
    theta: &[f64],
) -> Result<Option<(Problem, Vec<f64>)>, Failure> {
    let known = |effect: &str| {
        if effect == "night_setback" { "night_setback:22_6".to_owned() } else { effect.to_owned() }
    };
    let effects: Vec<String> = world
        .truth
        .effects
        .iter()
        .filter(|hidden| hidden.in_catalogue)
        .map(|hidden| known(&hidden.effect))
        .collect();
    if effects.is_empty() {
        return Ok(None);
    }
    let (problem, _, _) = ask(catalogue, world, window, &format!("room3+{}", effects.join("+")))?;
    let start = carried(base, theta, &problem);
    Ok(Some((problem, start)))
}

fn line(judged: &Judged) -> String {
    let hidden: Vec<String> =
        judged.truth.effects.iter().map(|one| format!("{} {:.2}K", one.effect, one.moves)).collect();
    let named: Vec<String> = judged
        .diagnosis
        .findings
        .iter()
        .map(|finding| {
            let tied = if finding.tied_with.is_empty() {
                String::new()
            } else {
                format!("~{}", finding.tied_with.join("~"))
            };
            let [before, after] = finding.rmse.test.unwrap_or([f64::NAN; 2]);
            let share = finding.explained_share.unwrap_or(f64::NAN);
            let limit =
                if finding.parameters.values().any(|one| one.at_bound) { " at its limit" } else { "" };
            format!(
                "{}{tied} dbic {:.0} share {share:.2} test {before:.2}>{after:.2}{limit}",
                finding.effect, finding.delta_bic
            )
        })
        .collect();
    let best = judged
        .diagnosis
        .considered
        .iter()
        .find(|one| judged.truth.effects.iter().any(|hidden| same(&one.effect, &hidden.effect)));
    let missed = match best {
        Some(best) if judged.first != Outcome::Right => {
            format!(
                " [truth: dbic {:.1} share {:.2} {:?}]",
                best.delta_bic.unwrap_or(f64::NAN),
                best.explained_share.unwrap_or(f64::NAN),
                best.gate
            )
        }
        _ => String::new(),
    };
    let size = judged.hit().map(|(hidden, finding)| {
        let interval = |value: f64, ci95: Option<[f64; 2]>, truth: f64| {
            let [low, high] = ci95.unwrap_or([f64::NAN; 2]);
            format!("{value:.4} [{low:.4}, {high:.4}] of {truth:.4}")
        };
        let ahead = finding.size.as_ref().map(|size| interval(size.value, size.ci95, judged.truth.ahead));
        let strength =
            finding.parameters.values().next().map(|one| interval(one.value, one.ci95, hidden.strength));
        format!(" ahead {} size {}", ahead.unwrap_or_default(), strength.unwrap_or_default())
    });
    let size = size.unwrap_or_default();
    let near: Vec<String> = judged.diagnosis.considered.iter().filter_map(near).collect();
    let logged = if judged.logged { " LOGGED" } else { "" };
    let missed = format!("{size}{missed}{logged} <<{}>>", near.join(" | "));
    format!(
        "{} seed {} {:?}{} test {:.2}>{:.2} heat {:.3} rho {:.2} hidden ({}) named ({}){missed}",
        judged.kind,
        judged.truth.seed,
        judged.first,
        if judged.material() { " material" } else { "" },
        judged.test[0].unwrap_or(f64::NAN),
        judged.test[1].unwrap_or(f64::NAN),
        judged.truth.household_heat,
        judged.diagnosis.rho.unwrap_or(f64::NAN),
        hidden.join(", "),
        named.join("; ")
    )
}

/// A candidate that explains something, in numbers.
fn near(one: &Considered) -> Option<String> {
    let measures = one.measures?;
    let (share, gain) = (one.explained_share.unwrap_or(f64::NAN), one.delta_bic.unwrap_or(f64::NAN));
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let slow = number(measures.slow_delta_bic);
    (share > 0.3 || slow > 8.0 || gain > 8.0).then(|| {
        format!(
            "{} share {share:.2} fall {:.2} dbic {gain:.0} white {:.2} slow {slow:.0} ahead {:.2} days {:.2} \
            {:.2} rho {:.2}",
            one.effect,
            number(measures.fall),
            number(measures.white_share),
            number(measures.ahead_share),
            measures.better_days[0],
            measures.better_days[1],
            measures.rho
        )
    })
}
