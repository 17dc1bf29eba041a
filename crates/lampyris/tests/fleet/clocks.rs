//! Machines whose clocks differ.

use super::Fleet;
use super::support::TestApp;
use jiff::{SignedDuration, Timestamp};
use lampyris::service::queue::schedules;
use lampyris::store::workers::ProcessRole;

/// How far each of two clocks is off, in minutes.
const OFF: i64 = 5;

/// Two schedulers, one five minutes ahead and one five minutes late, that both look every quarter of an hour,
/// over thirty nights with both days on which the clock of the zone changes.
#[test]
fn two_clocks_make_one_batch_a_night() {
    let Some(fleet) = Fleet::new() else { return };
    let start = |time: &str| {
        TestApp::at(time, |settings| {
            settings.database = fleet.place.clone();
            settings.zone = "Europe/Copenhagen".to_owned();
            settings.roles = vec![ProcessRole::Api, ProcessRole::Scheduler];
        })
    };
    let apps = [start("2026-03-14T12:00:00Z"), start("2026-03-14T12:00:00Z")];
    apps[0].room("1", 1);
    let workers = fleet.rows("SELECT worker::TEXT FROM workers ORDER BY worker");
    let mut nights = 0;
    // Behind the first fortnight everybody sleeps until October; what was missed is made up for once.
    for (first, ticks) in [("2026-03-14T12:00:00Z", 15), ("2026-10-10T12:00:00Z", 15 + 1)] {
        let first: Timestamp = first.parse().unwrap();
        for quarter in 0..15 * 96 {
            let now = first + SignedDuration::from_mins(15 * quarter);
            for (app, off) in apps.iter().zip([OFF, -OFF]) {
                app.clock.set(now + SignedDuration::from_mins(off));
            }
            // All ticks lie between midnight and three, here and by the clock of Greenwich.
            if quarter > 0 && !(48..=64).contains(&(quarter % 96)) {
                continue;
            }
            let look = |app: &TestApp| {
                app.within(async |service| schedules::due(service, service.now()).await.map(drop).unwrap())
            };
            std::thread::scope(|scope| {
                for app in &apps {
                    scope.spawn(move || look(app));
                }
            });
            // Nobody works here: the jobs are done by hand, before the next night.
            if quarter == 0 || quarter % 96 == 64 {
                let rows =
                    "UPDATE jobs SET state = 'cancelled', ended_at = 1 WHERE state = 'queued' RETURNING id";
                fleet.rows(rows);
            }
        }
        nights += ticks;
        assert_eq!(fleet.rows("SELECT COUNT(*)::TEXT FROM batches"), [nights.to_string()]);
    }
    assert_eq!(fleet.rows("SELECT worker::TEXT FROM workers ORDER BY worker"), workers, "no lease was lost");
    // Each is the tick of its night, and none is early or late by more than the clocks are.
    let made = fleet.rows("SELECT created_at::TEXT FROM batches ORDER BY sequence");
    let zone = jiff::tz::TimeZone::get("Europe/Copenhagen").unwrap();
    let mut days = std::collections::BTreeSet::new();
    for (place, made) in made.iter().enumerate() {
        let made = Timestamp::from_millisecond(made.parse().unwrap()).unwrap().to_zoned(zone.clone());
        assert!(days.insert(made.date()), "two of {}", made.date());
        let late = made.time().duration_since(jiff::civil::time(2, 30, 0, 0)).as_mins();
        // A night in March has no half past two, and what October makes up for comes at noon.
        assert!(place == 15 || (0..=30 + 15 + OFF).contains(&late), "{made}");
    }
    println!("FLEET: {} batches in {} nights by two clocks ten minutes apart", made.len(), nights - 1);
}
