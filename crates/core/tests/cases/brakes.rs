//! A model as large as the language allows hears its caller wherever its work is: the filter, the
//! simulations, the intervals, the gate and the likelihood.

use super::request;
use lampyris_core::data::{ColumnBindings, Window};
use lampyris_core::estimate::assess::metrics::current_state;
use lampyris_core::estimate::problem::objective::Objective;
use lampyris_core::estimate::problem::request::SeededMethod;
use lampyris_core::estimate::{
    Control, EstimateRequest, Fit, GatePolicy, Past, Problem, Site, estimate, prepare, validate,
};
use lampyris_core::interrupt::{Brake, Interrupt};
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::{Catalogue, ModelId};
use rustix::time::{ClockId, clock_gettime};
use std::cell::Cell;
use std::fmt::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The longest that a thread may work and hear nobody, in its own time, which no other process takes from it:
/// the promise of a job is 2 s, with its judgement.
const LONGEST: Duration = Duration::from_secs(1);

/// A wall in so many layers between the room and the outdoors.
fn chain(layers: usize) -> String {
    let mut states = "T_1 = { unit = \"degC\", initial = \"T_room\" }\n".to_owned();
    let mut equations = "T_1 = \"k * (T_2 - T_1)\"\n".to_owned();
    for layer in 2..=layers {
        let next = if layer == layers { "T_out".to_owned() } else { format!("T_{}", layer + 1) };
        writeln!(states, "T_{layer} = {{ unit = \"degC\", initial = \"10\" }}").unwrap();
        writeln!(equations, "T_{layer} = \"k * (T_{} - T_{layer}) + k * ({next} - T_{layer})\"", layer - 1)
            .unwrap();
    }
    format!(
        "id = \"chain\"\ntitle = \"A wall in layers\"\n[states]\n{states}\n[inputs]\nT_out = {{ unit = \"degC\" }}\n\
         [parameters]\nk = {{ unit = \"1/h\", lower = 0.1, upper = 50, scale = \"log\", nominal = 5 }}\n\
         [equations]\n{equations}\n[outputs]\nT_room = {{ expr = \"T_1\", unit = \"degC\", noise_sd = 0.05 }}\n\
         [[check]]\nkind = \"stable\"\n[[check]]\nkind = \"state_range\"\nlower = -30\nupper = 60\n"
    )
}

/// Four days of half hours.
fn days() -> Window {
    let mut csv = "time,T_room[degC],T_out[degC]\n".to_owned();
    for half in 0..192 {
        let hour = f64::from(half) / 2.0;
        let out = 5.0 + 4.0 * (hour * std::f64::consts::TAU / 24.0).sin();
        let room = 12.0 + (hour * std::f64::consts::TAU / 24.0 - 1.0).sin() + 0.02 * f64::from(half % 7);
        let day = 1 + half / 48;
        writeln!(csv, "2026-01-{day:02}T{:02}:{:02}:00Z,{room:.3},{out:.3}", half % 48 / 2, half % 2 * 30)
            .unwrap();
    }
    Window::parse_csv(&csv, &ColumnBindings::none()).unwrap().0
}

fn problem(layers: usize, asked: &EstimateRequest) -> Problem {
    let mut catalogue = Catalogue::builtin().unwrap();
    catalogue.add_model(ModelDocument::from_toml(&chain(layers)).unwrap());
    let id: ModelId = "chain".parse().unwrap();
    prepare(&catalogue, &id, asked, &days(), &Site::default()).unwrap()
}

/// What became of work whose brake was pulled at some question.
struct Heard<T> {
    questions: usize,
    ended: Result<T, Interrupt>,
    /// The longest that a thread worked without a question, up to the end of the work.
    longest: Duration,
}

/// How long this thread has worked.
fn worked() -> Duration {
    clock_gettime(ClockId::ThreadCPUTime).try_into().unwrap()
}

/// Does work whose brake is pulled at the question of this number, on threads of its own: one that waits for
/// another takes whatever there is to do, and in the common pool that is the work of other tests.
fn pulled<T: Send>(problem: &Problem, at: usize, work: impl Fn(&Problem) -> T + Sync) -> Heard<T> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(rayon::current_num_threads()).build().unwrap();
    threads.install(|| pulled_here(problem, at, &work))
}

fn pulled_here<T>(problem: &Problem, at: usize, work: impl Fn(&Problem) -> T) -> Heard<T> {
    thread_local! {
        static ASKED: Cell<Option<Duration>> = const { Cell::new(None) };
    }
    let silence = || {
        let now = worked();
        ASKED.replace(Some(now)).map_or(Duration::ZERO, |before| now - before)
    };
    let questions = Arc::new(AtomicUsize::new(0));
    let longest = Arc::new(Mutex::new(Duration::ZERO));
    let (asked, noted) = (questions.clone(), longest.clone());
    let brake = Brake::new(move || {
        let silent = silence();
        let mut noted = noted.lock().unwrap();
        *noted = silent.max(*noted);
        (asked.fetch_add(1, Ordering::Relaxed) + 1 >= at).then_some(Interrupt::Deadline)
    });
    ASKED.set(Some(worked()));
    let ended = Brake::guard(|| work(&problem.with_brake(&brake)));
    let longest = silence().max(*longest.lock().unwrap());
    Heard { questions: questions.load(Ordering::Relaxed), ended, longest }
}

/// What may be done on a problem.
type Work<'a> = &'a (dyn Fn(&Problem) + Sync);

/// Least squares from one point.
fn asked(more: &str) -> EstimateRequest {
    let method: SeededMethod = serde_json::from_str(more).unwrap();
    let mut asked = EstimateRequest { method, ..request("P2D", "P1D", "P1D", 1) };
    asked.budget.evaluations = 4;
    asked
}

#[test]
fn a_model_of_250_states_is_heard_wherever_it_is() {
    let least_squares = asked(r#"{"name": "lm_multistart", "starts": 1, "seed": 1}"#);
    // The parameter of a thin wall is one of a thick wall as well.
    let fit: Fit = estimate(&problem(3, &least_squares), &least_squares, None, &Control::NONE).unwrap();
    let thick = problem(250, &least_squares);
    let filter = |problem: &Problem| drop(current_state(problem, &fit));
    let free_run = |problem: &Problem| drop(problem.simulate(&fit.theta()));
    let gate = |problem: &Problem| {
        drop(validate(problem, &fit, &Past::default(), &GatePolicy::default()));
    };
    let all = |problem: &Problem| drop(estimate(problem, &least_squares, None, &Control::NONE));
    let ctsm = asked(r#"{"name": "ctsm", "seed": 1}"#);
    let likely = EstimateRequest { objective: Objective::Likelihood, ..ctsm };
    let by_likelihood = |problem: &Problem| drop(estimate(problem, &likely, None, &Control::NONE));
    let works: [(&str, usize, Work); 5] = [
        ("filter", 20, &filter),
        ("free run", 10, &free_run),
        ("gate", 300, &gate),
        ("estimate", 150, &all),
        ("likelihood", 20, &by_likelihood),
    ];
    for (name, at, work) in works {
        let Heard { questions, ended, longest } = pulled(&thick, at, work);
        println!("{name}: {questions} questions, the longest time without one {longest:?}");
        assert_eq!(ended, Err(Interrupt::Deadline), "{name}");
        // Every thread that works hears it at its own next question.
        assert!(questions <= at + rayon::current_num_threads(), "{name} went on: {questions} of {at}");
        assert!(longest < LONGEST, "{name} heard nobody for {longest:?}");
    }
}

#[test]
fn a_brake_that_is_not_pulled_changes_nothing() {
    let asked = asked(r#"{"name": "lm_multistart", "starts": 2, "seed": 1}"#);
    let thin = problem(3, &asked);
    let work = |problem: &Problem| {
        let fit = estimate(problem, &asked, None, &Control::NONE).unwrap();
        let judgement = validate(problem, &fit, &Past::default(), &GatePolicy::default());
        (current_state(problem, &fit), judgement, fit)
    };
    let heard = pulled(&thin, usize::MAX, work);
    assert!(heard.questions > 0);
    assert_eq!(heard.ended, Ok(work(&thin)));
}
