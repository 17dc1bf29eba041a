//! Many nights in a row, by a clock that the test sets: none is missed, none is run twice, and the database
//! keeps to what its settings say.

use crate::support::rooms::{csv_of, room};
use crate::support::{TestApp, full};
use jiff::civil::{Date, date};
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp, ToSpan};
use lampyris::service::queue::schedules;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

const ZONE: &str = "Europe/Copenhagen";
/// Days that a night looks back.
const RECORD: i64 = 14;
/// How long jobs are kept here.
const KEPT_DAYS: u32 = 7;

/// Time, room, outdoors.
type Samples = Vec<(String, f64, f64)>;

/// Rooms with what they measure from January to November, and how far that was uploaded.
struct House {
    app: TestApp,
    rooms: Vec<(String, Samples)>,
    uploaded: Timestamp,
    /// The batches that were accounted for, by their local date.
    nights: BTreeMap<Date, String>,
    outcomes: BTreeMap<String, usize>,
}

impl House {
    fn new(rooms: u64, start: Timestamp) -> Self {
        let app = TestApp::at(&start.to_string(), |settings| {
            settings.zone = ZONE.to_owned();
            settings.retention.jobs_days = KEPT_DAYS;
            settings.retention.windows_days = 60;
        });
        // Warmer by as much as keeps an unheated room within the bounds of the model.
        let warm = |(time, room, out): (String, f64, f64)| (time, room + 15.0, out + 15.0);
        let mut rooms: Vec<(String, Samples)> = (1..=rooms)
            .map(|seed| (seed.to_string(), room(seed, 320).into_iter().map(warm).collect()))
            .collect();
        // One sensor hangs all year: its nights lead to nothing that is served.
        rooms.last_mut().unwrap().1.iter_mut().for_each(|(_, room, _)| *room = 19.0);
        for (id, _) in &rooms {
            // What a night finds degraded waits for the next one: here nights are counted.
            let document = json!({"model": "rc2", "policy": {"refit_when_degraded": false}});
            app.json("PUT", &format!("/systems/room/{id}"), &document).expect(201);
        }
        let request = json!({"method": {"name": "lm_multistart", "seed": 1}, "budget": {"evaluations": 2000},
                             "split": {"train": "P9D", "validation": "P5D"}});
        app.json(
            "PUT",
            "/schedules/nightly",
            &json!({"cron": "30 2 * * *", "systems": ["room/*"], "request": request}),
        )
        .expect(200);
        let uploaded = start - SignedDuration::from_hours(24 * RECORD);
        Self { app, rooms, uploaded, nights: BTreeMap::new(), outcomes: BTreeMap::new() }
    }

    /// Sends what was measured up to an instant.
    fn measure(&mut self, until: Timestamp) {
        for (id, samples) in &self.rooms {
            let first: Timestamp = samples[0].0.parse().unwrap();
            let place =
                |instant: Timestamp| usize::try_from(instant.duration_since(first).as_mins() / 30).unwrap();
            let new = &samples[place(self.uploaded)..place(until)];
            self.app.csv(&format!("/systems/room/{id}/windows"), &csv_of(new)).expect(201);
        }
        self.uploaded = until;
    }

    /// Lives from noon to noon by steps of half an hour, and accounts for the batches that the night between
    /// has brought.
    fn live(&mut self, noon: Timestamp) {
        self.measure(noon);
        for step in 1..=48 {
            let now = noon + SignedDuration::from_mins(30 * step);
            self.app.clock.set(now);
            self.app.within(async |service| schedules::due(service, now).await.unwrap());
            self.account();
        }
    }

    /// Waits for the batches that are new, and checks each.
    fn account(&mut self) {
        let path = "/batches?page_size=5";
        let batches = self.app.until(path, |page| {
            page["items"].as_array().unwrap().iter().all(|batch| batch["finished"] == true)
        });
        for batch in batches["items"].as_array().unwrap() {
            let id = batch["id"].as_str().unwrap();
            if self.nights.values().any(|known| known == id) {
                continue;
            }
            let at = batch["created_at"].as_str().unwrap().parse::<Timestamp>().unwrap().in_tz(ZONE).unwrap();
            assert_eq!(self.nights.insert(at.date(), id.to_owned()), None, "two batches on {}", at.date());
            if at.hour() < 12 {
                // Half past two does not exist when the clock is set forward; then the night comes with the
                // change.
                let expected = if at.date() == date(2026, 3, 29) { (3, 0) } else { (2, 30) };
                assert_eq!((at.hour(), at.minute()), expected, "{batch}");
            }
            let report = self.app.get(&format!("/batches/{id}")).expect(200).json();
            let jobs = report["jobs"].as_array().unwrap();
            let systems: BTreeSet<&str> = jobs.iter().map(|job| job["system"].as_str().unwrap()).collect();
            assert_eq!((jobs.len(), systems.len()), (self.rooms.len(), self.rooms.len()), "{report}");
            assert_eq!(
                (&report["schedule"], &report["skipped"]),
                (&json!("nightly"), &json!([])),
                "{report}"
            );
            assert!(jobs.iter().all(|job| job["state"] == "succeeded"), "{report}");
            for job in jobs {
                let why = job["why"].as_str().unwrap().split(':').next().unwrap();
                *self.outcomes.entry(why.to_owned()).or_default() += 1;
            }
        }
    }

    /// Bytes of the database and of its log.
    fn bytes(&self) -> u64 {
        let size = |end: &str| {
            std::fs::metadata(format!("{}{end}", self.app.database().display())).map_or(0, |file| file.len())
        };
        size("") + size("-wal")
    }

    fn all(&self, path: &str) -> Vec<Value> {
        let (mut items, mut token) = (Vec::new(), String::new());
        loop {
            let page = self.app.get(&format!("{path}?page_size=500{token}")).expect(200).json();
            items.extend(page["items"].as_array().unwrap().iter().cloned());
            match page["next_page_token"].as_str() {
                Some(next) => token = format!("&page_token={next}"),
                None => return items,
            }
        }
    }

    /// What is left of the past is what the settings keep: everything that was served with what it rests on,
    /// the newest fit of a room that waits for an operator, and of the rest what is young enough.
    fn check_retention(&self) -> (usize, usize) {
        let now = self.app.clock.now();
        let (mut served, mut explained) = (BTreeSet::new(), 0);
        for (id, _) in &self.rooms {
            for revision in self.all(&format!("/params/room/{id}/history")) {
                served.insert(revision["job"].as_str().unwrap().to_owned());
                self.app
                    .get(&format!("/fits/{}/comparison?max_points=10", revision["fit"].as_str().unwrap()))
                    .expect(200);
                explained += 1;
            }
        }
        let jobs = self.all("/jobs");
        // The last night came before noon, and forgot what was older by then.
        let oldest = now - SignedDuration::from_hours(24 * i64::from(KEPT_DAYS) + 12);
        let mut held = BTreeSet::new();
        let instant = |job: &Value, of: &str| job[of].as_str().unwrap().parse::<Timestamp>().unwrap();
        // The newest come first. A night forgets when it begins, and what it finds itself comes behind that.
        let begun = instant(&jobs[0], "created_at");
        for job in &jobs {
            let ended = instant(job, "ended_at");
            let is_newest_held =
                job["outcome"] == "held" && ended < begun && held.insert(job["system"].as_str().unwrap());
            assert!(
                ended > oldest || is_newest_held || served.contains(job["id"].as_str().unwrap()),
                "{job} is kept for nothing"
            );
        }
        assert!(
            served.iter().all(|id| jobs.iter().any(|job| job["id"] == id.as_str())),
            "what was served has lost its job"
        );
        (jobs.len(), explained)
    }
}

#[test]
fn every_night_is_run_once_over_both_changes_of_the_clock() {
    let (rooms, nights) = if full() { (10, 30) } else { (3, 3) };
    let zone = TimeZone::get(ZONE).unwrap();
    let noon = |date: Date| date.at(12, 0, 0, 0).to_zoned(zone.clone()).unwrap().timestamp();
    // So that the change falls into the middle.
    let first = |change: &str| change.parse::<Date>().unwrap().checked_sub((nights / 2 + 1).days()).unwrap();
    let (spring, autumn) = (first("2026-03-29"), first("2026-10-25"));

    let mut house = House::new(rooms, noon(spring));
    let empty = house.bytes();
    for night in 0..nights {
        house.live(noon(spring.checked_add(night.days()).unwrap()));
    }
    let full_spring = house.bytes();
    assert_eq!(house.nights.len() as i64, nights, "one batch for each night of spring");
    // Half a year without the service: the nights between are made up for once.
    house.measure(noon(spring.checked_add(nights.days()).unwrap()));
    house.app.stop();
    house.app.clock.set(noon(autumn));
    house.app.restart();
    house.app.until("/batches?page_size=1", |page| {
        !house.nights.values().any(|known| page["items"][0]["id"] == known.as_str())
    });
    house.account();
    assert_eq!(house.nights.len() as i64, nights + 1, "one batch for all the nights that were missed");
    house.uploaded = noon(autumn) - SignedDuration::from_hours(24 * RECORD);
    for night in 0..nights {
        house.live(noon(autumn.checked_add(night.days()).unwrap()));
    }

    let days: Vec<Date> = (1..=nights)
        .flat_map(|night| [spring, autumn].map(|first| first.checked_add(night.days()).unwrap()))
        .collect();
    let missing: Vec<&Date> = days.iter().filter(|day| !house.nights.contains_key(day)).collect();
    assert!(missing.is_empty(), "{missing:?}");
    let runs = i64::try_from(house.nights.len()).unwrap();
    assert_eq!(runs, 2 * nights + 1);
    let metrics = house.app.get("/metrics").expect(200).text;
    let ended = metrics
        .lines()
        .filter(|line| line.starts_with("lampyris_jobs_ended_total{"))
        .map(|line| line.rsplit_once(' ').unwrap().1);
    let since_restart: u64 = ended.map(|count| count.parse::<u64>().unwrap()).sum();
    assert_eq!(since_restart as i64, (nights + 1) * rooms as i64, "{metrics}");
    let (kept, served) = house.check_retention();
    assert!((kept as i64) < runs * rooms as i64, "nothing was forgotten");
    println!(
        "nights: {} batches of {rooms} rooms, {:?}; {} jobs kept of {}, {served} revisions explained; \
        database {} kB empty, {} kB after spring, {} kB at the end",
        runs,
        house.outcomes,
        kept,
        runs * rooms as i64,
        empty >> 10,
        full_spring >> 10,
        house.bytes() >> 10
    );
}

#[test]
fn a_schedule_never_overlaps_itself_and_makes_up_for_a_downtime_once() {
    let start: Timestamp = "2026-05-01T00:00:30Z".parse().unwrap();
    let mut app = TestApp::at(&start.to_string(), |_| {});
    app.room("1", 1);
    // The other schedule has its own tests.
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "30 2 * * *", "systems": ["room/*"], "enabled": false}),
    )
    .expect(200);
    let request = json!({
        "method": {"name": "cfa_thesis", "generations": 1_000_000}, "budget": {"evaluations": 100_000_000}
    });
    app.json(
        "PUT",
        "/schedules/often",
        &json!({"cron": "* * * * *", "systems": ["room/1"], "request": request}),
    )
    .expect(201);
    let minute = |app: &TestApp, minute: i64| -> (usize, Value) {
        let now = start + SignedDuration::from_mins(minute);
        app.clock.set(now);
        app.within(async |service| schedules::due(service, now).await.unwrap());
        let batches = app.get("/batches").expect(200).json()["items"].as_array().unwrap().len();
        (batches, app.get("/schedules/often").expect(200).json()["last_result"].clone())
    };
    let cancel = |app: &TestApp| {
        let job =
            app.get("/jobs?page_size=1").expect(200).json()["items"][0]["id"].as_str().unwrap().to_owned();
        app.post(&format!("/jobs/{job}/cancel")).expect(200);
        assert_eq!(app.ended(&job)["state"], "cancelled");
    };
    assert_eq!(minute(&app, 1), (1, json!("submitted")));
    for later in 2..=10 {
        assert_eq!(minute(&app, later), (1, json!("skipped_overlap")), "minute {later}");
    }
    cancel(&app);
    assert_eq!(minute(&app, 11), (2, json!("submitted")));
    cancel(&app);
    app.stop();
    app.clock.set(start + SignedDuration::from_mins(11 + 360));
    app.restart();
    app.until("/batches", |page| page["items"].as_array().unwrap().len() > 2);
    assert_eq!(
        minute(&app, 11 + 360).0,
        3,
        "three hundred and sixty ticks were missed, and one is made up for"
    );
    cancel(&app);
    assert_eq!(minute(&app, 12 + 360), (4, json!("submitted")), "the next one comes in its time");
    cancel(&app);
    println!("Q-4: 9 ticks skipped for an overlap, 1 catch-up for 360 missed ticks");
}
