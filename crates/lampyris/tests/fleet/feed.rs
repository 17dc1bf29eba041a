//! The feed of changes misses nothing, however commits overtake one another.

use super::Fleet;
use super::support::{cluster, full};
use lampyris::store::{DatabasePlace, Store, feed};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Writers that take a number, sleep, and commit.
const WRITERS: usize = 16;

#[test]
fn the_feed_sees_all_that_was_committed_in_any_order() {
    let Some(fleet) = Fleet::new() else { return };
    let each = if full() { 6250 } else { 60 };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let store = runtime.block_on(Store::open(&fleet.place, None)).unwrap();
    let start = runtime.block_on(feed::newest(&store)).unwrap();
    let writers: Vec<_> = (0..WRITERS)
        .map(|writer| {
            let place: DatabasePlace = fleet.place.clone();
            std::thread::spawn(move || {
                for number in (0..each).step_by(10) {
                    // Ten notes, and a pause between their numbers and the commit.
                    let sql = format!(
                        "WITH noted AS (INSERT INTO changes (topic, name) SELECT 'system', \
                        'room/{writer}-' || n FROM generate_series({number}, {}) n RETURNING id) \
                        SELECT pg_sleep(random() * 0.02)::TEXT FROM noted LIMIT 1",
                        number + 9
                    );
                    cluster::behind(&place, &sql).unwrap();
                }
            })
        })
        .collect();
    let (mut seen, mut position) = (BTreeSet::new(), start);
    let begun = Instant::now();
    while seen.len() < WRITERS * each && begun.elapsed() < Duration::from_secs(600) {
        let news = runtime.block_on(feed::after(&store, position)).unwrap();
        assert!(!news.missed);
        position = news.position;
        seen.extend(news.systems);
    }
    writers.into_iter().for_each(|writer| writer.join().unwrap());
    println!("FLEET: the feed saw {} of {} changes of {WRITERS} writers", seen.len(), WRITERS * each);
    assert_eq!(seen.len(), WRITERS * each);
    runtime.block_on(store.close());
}
