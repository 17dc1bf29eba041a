//! Rooms of which the measurements are what they should be: the gate lets their fits pass.

use super::rooms::twin;
use crate::{full, problem};
use lampyris_core::data::SplitRequest;
use lampyris_core::estimate::{
    Control, EstimateRequest, GatePolicy, Incumbent, Judgement, Past, Site, Verdict, estimate, validate,
};
use lampyris_core::twin::{Level, WorldRequest, world};
use rayon::prelude::*;

/// Rooms with nothing hidden are served, at both distances from the model, and none is refused.
#[test]
fn rooms_with_nothing_hidden_are_served() {
    let count: u64 = if full() { 200 } else { 2 };
    for (level, held_share) in [(Level::Matched, 0.03), (Level::Rich, 0.15)] {
        let verdicts: Vec<(u64, Judgement)> = (0..count)
            .into_par_iter()
            .map(|index| {
                let seed = 85_000 + index;
                let made = world(&WorldRequest::new(seed, &[], level)).unwrap();
                let site = Site {
                    sets: [("neighbours".to_owned(), made.neighbours.clone())].into(),
                    ..Site::default()
                };
                let asked = EstimateRequest { split: SplitRequest::default(), ..EstimateRequest::default() };
                let problem = problem(&made.csv, "room3", &[], &site, &asked);
                let fit = estimate(&problem, &asked, None, &Control::NONE).unwrap();
                (seed, validate(&problem, &fit, &Past::default(), &GatePolicy::default()))
            })
            .collect();
        let held: Vec<&(u64, Judgement)> = verdicts
            .iter()
            .filter(|(_, judgement)| !matches!(judgement.verdict, Verdict::Accepted(_)))
            .collect();
        let rejected = held.iter().filter(|(_, judgement)| judgement.verdict == Verdict::Rejected).count();
        println!("GATE-2 {level:?}: {} of {count} not served, {rejected} of them rejected", held.len());
        held.iter().for_each(|(seed, judgement)| println!("  {seed}: {}", judgement.summary));
        assert_eq!(rejected, 0, "{level:?}");
        let allowed = held_share * count as f64;
        assert!(held.len() as f64 <= allowed, "{level:?}: {} of {count} held", held.len());
    }
}

/// A week later another fit of the same room is served as well: what it is held against, days before it and
/// parameters of before, stops no honest one.
#[test]
fn a_later_fit_of_the_same_room_is_served() {
    let count: u64 = if full() { 60 } else { 1 };
    for (level, held_share) in [(Level::Matched, 0.0), (Level::Rich, 0.05)] {
        let fits: Vec<(u64, Judgement)> = (0..count)
            .into_par_iter()
            .map(|index| {
                let room = twin(level, 82_000 + index);
                let week = room.row(7);
                let earlier = room.until(week);
                let (before, _) = earlier.problems(&earlier.table).unwrap();
                let served = Incumbent::of(&earlier.fitted(&before).unwrap()).unwrap();
                let (problem, days_before) = room.problems(&room.table).unwrap();
                let past = Past { days_before, next_door: room.next_door.clone(), ..Past::of(Some(served)) };
                (
                    82_000 + index,
                    validate(&problem, &room.fitted(&problem).unwrap(), &past, &GatePolicy::default()),
                )
            })
            .collect();
        let ratio = |judgement: &Judgement| {
            judgement
                .checks
                .iter()
                .find(|check| check.name == "G6 days before")
                .and_then(|check| check.statistic)
        };
        let mut ratios: Vec<f64> = fits.iter().filter_map(|(_, judgement)| ratio(judgement)).collect();
        ratios.sort_by(f64::total_cmp);
        println!("GATE-2 {level:?}: days before {ratios:.2?}");
        assert_eq!(ratios.len(), count as usize, "every one is asked");
        // What else the gate says of these rooms is measured cold.
        let past = |name: &&str| *name == "G6 days before" || name.starts_with("G11");
        let held: Vec<_> = fits.iter().filter(|(_, judgement)| judgement.failed().iter().any(past)).collect();
        held.iter().for_each(|(seed, judgement)| println!("  {seed}: {}", judgement.summary));
        let allowed = held_share * count as f64;
        assert!(held.len() as f64 <= allowed, "{level:?}: {} of {count} held", held.len());
    }
}
