//! What very many jobs that wait cost those that are claimed.

use super::Fleet;
use super::support::{full, stubs};
use lampyris::store::batches::NewBatch;
use lampyris::store::jobs::Priority;
use lampyris::store::{DatabasePlace, Store};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Claims in all, some by each of so many workers.
const CLAIMS: usize = 1_600;
const WORKERS: usize = 4;
/// How many times as much a claim may cost where ten times as many wait.
const AS_MUCH: f64 = 2.0;

#[test]
fn a_claim_costs_the_same_however_many_jobs_wait() {
    let Some(ratio) = times_as_long(1_000, 10_000) else { return };
    println!("FLEET: p99 of a claim is {ratio:.2} times as long (target {AS_MUCH})");
}

#[test]
#[ignore = "its time binds where the machine does nothing else"]
fn a_claim_takes_as_long_however_many_jobs_wait() {
    let Some(ratio) = times_as_long(10_000, 100_000) else { return };
    println!("FLEET: alone, p99 of a claim is {ratio:.2} times as long (limit {AS_MUCH})");
    assert!(ratio <= AS_MUCH, "{ratio}");
}

/// How many times as long the slowest claims take where many jobs wait as where a few do. What they read is
/// counted, which no busy machine changes, and stays the same; no transaction is long.
fn times_as_long(few: usize, many: usize) -> Option<f64> {
    let fleet = Fleet::new()?;
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async { Store::open(&fleet.place, None).await.unwrap().close().await });
    let systems = format!(
        "INSERT INTO systems (system, model, document, created_at, updated_at) SELECT 'room/' || n, 'rc1', '{{}}', 0, 0 \
        FROM generate_series(0, {}) n",
        many + CLAIMS
    );
    fleet.rows(&systems);
    let ended = Arc::new(AtomicBool::new(false));
    let longest = std::thread::spawn({
        let (place, ended) = (fleet.place.clone(), ended.clone());
        move || longest_transaction(&place, &ended)
    });
    let of_few = waiting(&fleet, &runtime, 0..few + CLAIMS);
    let of_many = waiting(&fleet, &runtime, few + CLAIMS..many + CLAIMS);
    ended.store(true, Ordering::Relaxed);
    let longest = longest.join().unwrap();
    println!("FLEET: the longest transaction took {longest:.2} s (limit 5)");
    assert_eq!(fleet.rows("SELECT COUNT(*)::TEXT FROM jobs WHERE state = 'queued'"), [many.to_string()]);
    assert!(longest < 5.0, "{longest}");
    let reads = of_many.rows / of_few.rows;
    println!("FLEET: a claim reads {reads:.2} times as many rows (limit {AS_MUCH})");
    assert!(reads <= AS_MUCH, "{} rows where {few} wait, {} where {many} do", of_few.rows, of_many.rows);
    Some(of_many.time.as_secs_f64() / of_few.time.as_secs_f64())
}

/// What a claim costs: the 99th percentile of its time, and the rows and entries of indexes that are read
/// for it and for the end of its job.
struct Claim {
    time: Duration,
    rows: f64,
}

/// Has these rooms wait for a job each, and claims some of all that wait.
fn waiting(fleet: &Fleet, runtime: &tokio::runtime::Runtime, rooms: std::ops::Range<usize>) -> Claim {
    let open = || Arc::new(runtime.block_on(Store::open(&fleet.place, None)).unwrap());
    let store = open();
    let (jobs, begun) = (rooms.len(), Instant::now());
    runtime.block_on(stubs::submit(&store, &crowd(rooms, Priority::Nightly)));
    println!("FLEET: {jobs} jobs submitted in {:?}", begun.elapsed());
    runtime.block_on(store.close());
    let before = rows_read(fleet);
    let store = open();
    let mut times: Vec<Duration> =
        runtime.block_on(taken(&store, CLAIMS / 2)).into_iter().map(|(_, time)| time).collect();
    runtime.block_on(store.close());
    times.sort();
    let time = times[times.len() * 99 / 100];
    let rows = (rows_read(fleet) - before) / times.len() as f64;
    println!("FLEET: a claim, median {:?}, p99 {time:?}, reads {rows:.1} rows", times[times.len() / 2]);
    Claim { time, rows }
}

/// Rows and entries of indexes that were read so far: sessions tell what they read when they end.
fn rows_read(fleet: &Fleet) -> f64 {
    let others = "SELECT pid::TEXT FROM pg_stat_activity WHERE datname = current_database() AND pid <> \
        pg_backend_pid() AND backend_type = 'client backend' AND query NOT LIKE '%pg_stat_activity%'";
    for _ in 0..1_000 {
        if fleet.rows(others).is_empty() {
            let sql = "SELECT ((SELECT SUM(seq_tup_read) FROM pg_stat_user_tables) + (SELECT SUM(idx_tup_read) FROM \
                pg_stat_user_indexes))::TEXT";
            return fleet.rows(sql)[0].parse().unwrap();
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("sessions do not end");
}

/// A job for each of these rooms.
fn crowd(rooms: std::ops::Range<usize>, priority: Priority) -> NewBatch {
    stubs::batch(rooms.map(|room| format!("room/{room}").parse().unwrap()), priority)
}

/// Seconds of the longest transaction until the end, as the server tells them.
fn longest_transaction(place: &DatabasePlace, ended: &AtomicBool) -> f64 {
    let sql = "SELECT COALESCE(MAX(extract(epoch FROM clock_timestamp() - xact_start))::FLOAT8::TEXT, '0') FROM \
        pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid() AND backend_type = 'client \
        backend'";
    let mut longest = 0.0_f64;
    while !ended.load(Ordering::Relaxed) {
        let found = super::support::cluster::behind(place, sql).unwrap();
        longest = longest.max(found[0].parse().unwrap());
        std::thread::sleep(Duration::from_millis(50));
    }
    longest
}

/// Tenants share the workers of all processes: one of ten jobs beside one of very many, and ten equal ones.
#[test]
fn tenants_take_turns_over_all_processes() {
    let Some(fleet) = Fleet::new() else { return };
    let many = if full() { 100_000 } else { 5_000 };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let store = Arc::new(runtime.block_on(Store::open(&fleet.place, None)).unwrap());
    fleet.rows(&format!(
        "INSERT INTO systems (system, model, document, created_at, updated_at, tenant) SELECT 'room/' || n, 'rc1', '{{}}', \
        0, 0, CASE WHEN n < 10 THEN 'small' WHEN n < {many} + 10 THEN 'large' ELSE 'equal ' || n % 10 END FROM \
        generate_series(0, {many} + 2009) n"
    ));
    let submit = |rooms: std::ops::Range<usize>, priority| {
        runtime.block_on(stubs::submit(&store, &crowd(rooms, priority)));
    };
    submit(10..many + 10, Priority::Nightly);
    submit(0..10, Priority::Interactive);
    let taken = |claims: usize| -> Vec<String> {
        runtime.block_on(taken(&store, claims)).into_iter().map(|(system, _)| system).collect()
    };
    let number = |system: &String| system[5..].parse::<usize>().unwrap();
    let first = taken(100);
    let small: Vec<usize> = (0..100).filter(|place| number(&first[*place]) < 10).collect();
    // Whoever claims beside another may be noted before it.
    assert!(
        small.len() == 10 && small.iter().enumerate().all(|(turn, place)| *place < 2 * turn + 2 + WORKERS),
        "{small:?}"
    );
    fleet.rows("UPDATE jobs SET state = 'cancelled', ended_at = 1 WHERE state = 'queued' AND tenant = 'large' RETURNING id");
    submit(many + 10..many + 2010, Priority::Nightly);
    let mut counts = [0_usize; 10];
    taken(1000).iter().for_each(|system| counts[number(system) % 10] += 1);
    let (least, most) = (counts.iter().min().unwrap(), counts.iter().max().unwrap());
    println!(
        "FLEET: of ten jobs beside {many} the last was the claim {}; of ten tenants the least got {least} of 100 and \
        the most {most}",
        small[9] + 1
    );
    assert!(*most as f64 <= 1.2 * *least as f64, "{counts:?}");
    runtime.block_on(store.close());
}

/// Claims and ends jobs by as many workers as there are, so many in all; gives the systems in the order in
/// which they were claimed, and how long each claim took.
async fn taken(store: &Arc<Store>, jobs: usize) -> Vec<(String, Duration)> {
    let taken = Arc::new(Mutex::new(Vec::new()));
    let workers: Vec<_> =
        (0..WORKERS).map(|_| tokio::spawn(take(store.clone(), jobs / WORKERS, taken.clone()))).collect();
    for worker in workers {
        worker.await.unwrap();
    }
    taken.lock().unwrap().clone()
}

async fn take(store: Arc<Store>, jobs: usize, taken: Arc<Mutex<Vec<(String, Duration)>>>) {
    let worker = stubs::enlist(&store, "a worker").await;
    for _ in 0..jobs {
        let (system, took) = stubs::claim_and_end(&store, worker).await.unwrap();
        taken.lock().unwrap().push((system.to_string(), took));
    }
}
