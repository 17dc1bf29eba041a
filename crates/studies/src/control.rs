//! What fresh parameters are worth to a controller (thesis 8.1): the same houses, weather, prices and people,
//! under controllers that differ in where their parameters come from.
//!
//! Each arm is a system of one service on loopback. Every midnight it posts what it measured, re-estimates
//! where its turn has come, polls `/params`, and decides for the day with what it got. The truth
//! (`twin::heated`) has two thermal masses more than the model, its parameters drift, and half-way the wind
//! begins to blow through the house.

mod answer;
mod arm;
mod grey;
mod mpc;
mod outcome;
mod page;
mod service;

use super::options::{First, Html};
use super::row::Row;
use answer::Answer;
use arm::{Arm, Before, Belief, Kind};
use grey::Grey;
use lampyris::cli::{Failure, print};
use lampyris_core::data::DAY;
use lampyris_core::model::Catalogue;
use lampyris_core::twin::heated::{HeatedRoom, SAMPLES_PER_DAY};
use outcome::{BEFORE_DAYS, Measured, Outcome, Plan, Spent};
use rayon::prelude::*;
use serde_json::json;
use service::{Added, Client, Service};
use std::path::Path;
use std::time::Instant;

/// Days of the parts of an estimate and of a diagnosis.
const ESTIMATE: (usize, usize) = (10, 3);
const DIAGNOSIS: (usize, usize) = (8, 6);
/// Days between two diagnoses, of which two in a row must name an effect, and most effects that are added.
const DIAGNOSE_EVERY: usize = 3;
const MOST_EFFECTS: usize = 2;

/// A house and the arms that live in it, each with its own copy of the rooms.
struct House {
    room: HeatedRoom,
    arms: Vec<Controlled>,
}

struct Controlled {
    arm: Arm,
    /// The truth asks no service.
    client: Option<Client>,
}

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    pub first: First,
    /// How many weeks each house is controlled.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..=26))]
    weeks: u16,
    /// How many houses are controlled.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=100))]
    houses: u16,
    #[command(flatten)]
    html: Html,
}

/// Runs all arms in all houses and prints what came of it; gives the lines of its table.
pub fn run(asked: &Arguments, as_json: bool) -> Result<Vec<Row>, Failure> {
    let measured = measure(&Plan::new(asked.first.seed, asked.houses.into(), asked.weeks.into()))?;
    let answer = Answer::of(&measured);
    if as_json {
        print(&json!({"answer": answer, "houses": measured.houses, "spent": measured.spent}).to_string());
    } else {
        print(&answer.text());
        answer::basis(&measured).iter().for_each(|line| print(line));
    }
    if let Some(file) = &asked.html.html {
        page::write(file, &measured, &answer)?;
    }
    Ok(answer.rows())
}

fn text(error: impl std::fmt::Display) -> Failure {
    Failure::Error(error.to_string())
}

fn measure(plan: &Plan) -> Result<Measured, Failure> {
    let folder = std::env::temp_dir().join(format!("lampyris-loop-{}-{}", std::process::id(), plan.seed));
    std::fs::create_dir_all(&folder).map_err(text)?;
    let measured = controlled(plan, &folder);
    std::fs::remove_dir_all(&folder).map_err(text)?;
    measured
}

fn controlled(plan: &Plan, folder: &Path) -> Result<Measured, Failure> {
    let begun = Instant::now();
    let catalogue = Catalogue::builtin().map_err(|found| lampyris::cli::faults(&found))?;
    let rooms = (0..plan.houses)
        .map(|house| {
            let days = BEFORE_DAYS + plan.days() + 2;
            HeatedRoom::new(plan.seed + house as u64, days, BEFORE_DAYS, BEFORE_DAYS + plan.leaks_from())
                .map_err(text)
        })
        .collect::<Result<Vec<_>, Failure>>()?;
    let start = rooms.first().map_or(0, |room| room.time(BEFORE_DAYS * SAMPLES_PER_DAY));
    let service = Service::start(folder, start)?;
    let mut houses = Vec::new();
    for (index, room) in rooms.into_iter().enumerate() {
        houses.push(House::new(&service, &catalogue, plan, index, room)?);
    }
    let mut spent = Spent::default();
    for day in 0..plan.days() {
        service.set_clock(start + DAY * day as i64)?;
        night(&service, &catalogue, &mut houses, day, &mut spent)?;
        let control = Instant::now();
        houses
            .par_iter_mut()
            .flat_map(|House { room, arms }| {
                let room = &*room;
                arms.par_iter_mut().map(move |controlled| controlled.arm.live(room))
            })
            .collect::<Result<(), Failure>>()?;
        spent.control_seconds += control.elapsed().as_secs_f64();
        for House { room, arms } in &houses {
            for Controlled { arm, client } in arms {
                if let Some(client) = client {
                    client.upload(&service, arm.csv(room, arm.samples() - SAMPLES_PER_DAY))?;
                }
            }
        }
        if (day + 1).is_multiple_of(7) {
            eprintln!(
                "week {} of {} after {:.0} s",
                (day + 1) / 7,
                plan.weeks,
                begun.elapsed().as_secs_f64()
            );
        }
    }
    service.stop()?;
    spent.seconds = begun.elapsed().as_secs_f64();
    let result = |Controlled { arm, client }: Controlled| {
        let (effects, fits) = client.map_or_else(Default::default, |client| (client.effects, client.fits));
        Outcome { kind: arm.kind, days: arm.days, effects, fits }
    };
    let houses = houses.into_iter().map(|house| house.arms.into_iter().map(result).collect()).collect();
    Ok(Measured { plan: plan.clone(), houses, spent })
}

impl House {
    fn new(
        service: &Service,
        catalogue: &Catalogue,
        plan: &Plan,
        index: usize,
        room: HeatedRoom,
    ) -> Result<Self, Failure> {
        let before = Before::new(&room, BEFORE_DAYS);
        let mut arms = Vec::new();
        for kind in &plan.arms {
            if *kind == Kind::Perfect {
                arms.push(Controlled { arm: Arm::new(*kind, &before, Belief::Truth), client: None });
                continue;
            }
            let mut client = Client::register(service, *kind, index)?;
            client.poll(service)?;
            let arm = Arm::new(*kind, &before, Belief::Grey(Box::new(Grey::new(catalogue, &client.params)?)));
            client.upload(service, arm.csv(&room, 0))?;
            arms.push(Controlled { arm, client: Some(client) });
        }
        Ok(Self { room, arms })
    }
}

/// What happens at midnight before a day: estimates, diagnoses, and the polls of all controllers.
fn night(
    service: &Service,
    catalogue: &Catalogue,
    houses: &mut [House],
    day: usize,
    spent: &mut Spent,
) -> Result<(), Failure> {
    let asked = |kind: Kind, client: &Client| {
        kind == Kind::Found
            && day > 0
            && day.is_multiple_of(DIAGNOSE_EVERY)
            && client.effects.len() < MOST_EFFECTS
    };
    let begun = Instant::now();
    let mut clients: Vec<(Kind, &mut Client)> = houses
        .iter_mut()
        .flat_map(|house| house.arms.iter_mut())
        .filter_map(|Controlled { arm, client }| client.as_mut().map(|client| (arm.kind, client)))
        .collect();
    let mut jobs = Vec::new();
    for (kind, client) in &clients {
        jobs.push(if kind.is_due(day) {
            Some(client.submit(service, "estimate", ESTIMATE.0, ESTIMATE.1)?)
        } else {
            None
        });
    }
    for ((_, client), job) in clients.iter_mut().zip(&jobs) {
        if let Some(job) = job {
            client.note(&Client::ended(service, job)?);
            spent.estimates += 1;
        }
    }
    spent.estimate_seconds += begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    let mut jobs = Vec::new();
    for (kind, client) in &clients {
        jobs.push(if asked(*kind, client) {
            Some(client.submit(service, "diagnose", DIAGNOSIS.0, DIAGNOSIS.1)?)
        } else {
            None
        });
    }
    for ((_, client), job) in clients.iter_mut().zip(&jobs) {
        let Some(job) = job else { continue };
        spent.diagnoses += 1;
        let Some((effect, summary)) = client.named(service, &Client::ended(service, job)?)? else { continue };
        // What the controller cannot forecast it cannot use.
        if Grey::new(catalogue, &json!({"model": client.model_with(&effect), "parameters": {}})).is_err() {
            continue;
        }
        client.add(service, Added { day, effect, summary })?;
        let job = client.submit(service, "estimate", ESTIMATE.0, ESTIMATE.1)?;
        client.note(&Client::ended(service, &job)?);
        spent.estimates += 1;
    }
    spent.diagnosis_seconds += begun.elapsed().as_secs_f64();
    for House { room, arms } in houses {
        for Controlled { arm, client } in arms {
            let Some(client) = client else { continue };
            if client.poll(service)? || arm.days.is_empty() {
                arm.believe(room, Grey::new(catalogue, &client.params)?);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::arm::{Measures, comfort};
    use super::*;

    /// A week of two arms over HTTP: both keep the house warm, the one that knows nothing foresees worse, and
    /// the same seed gives the same week.
    #[test]
    fn a_week_of_two_arms_is_controlled_over_http() {
        let plan = Plan { arms: vec![Kind::Nominal, Kind::Nightly, Kind::Perfect], ..Plan::new(1, 1, 1) };
        let measured = measure(&plan).unwrap();
        let [nominal, nightly, perfect] = measured.houses[0].as_slice() else { panic!("{measured:?}") };
        let week = |arm: &Outcome| Measures::sum(&arm.days);
        assert_eq!((nightly.fits.len(), nominal.fits.len(), nightly.days.len()), (7, 0, 7));
        assert!(nightly.fits.iter().any(|outcome| outcome == "accepted"), "{:?}", nightly.fits);
        assert!(
            week(nightly).rmse() < 0.8 * week(nominal).rmse(),
            "{} {}",
            week(nightly).rmse(),
            week(nominal).rmse()
        );
        assert!(
            week(perfect).total() < week(nightly).total() && week(perfect).total() < week(nominal).total()
        );
        for arm in [nominal, nightly, perfect] {
            assert!(week(arm).bill > 1.0 && week(arm).discomfort() < 100.0, "{:?}", week(arm));
        }
        let again = measure(&plan).unwrap();
        assert_eq!(again.houses[0][1].days, nightly.days);
    }

    #[test]
    fn the_house_is_set_back_at_night() {
        assert_eq!(
            (comfort(5.9), comfort(6.0), comfort(21.9), comfort(22.0)),
            ((18.5, 24.0), (21.0, 24.0), (21.0, 24.0), (18.5, 24.0))
        );
    }
}
